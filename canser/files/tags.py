"""Channels and directions of frames, which the record has no field for: codes, names and counts."""

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from canser._core.text import NO_CHANNEL, SENT, Codes
from canser._frames import FrameArray, concat

__all__ = ["RECEIVED", "TagCounts", "Tagged", "channel_code", "joined", "listed", "printable"]

# The direction of a frame that the program received which wrote the file, or that no one told.
RECEIVED: Final = 0

# Names that a remark lists. A log of real buses has fewer channels.
_NAMES_MOST: Final = 16

# Characters of a name that are shown. Names of Linux interfaces have at most 15 characters.
_SHOWN: Final = 32


class Tagged(NamedTuple):
    """Frames, and arrays of the same length with what the record has no field for."""

    frames: FrameArray
    #: uint8: the channel as a number from 0, `NO_CHANNEL` if it is not told; None for none told.
    channels: Codes | None = None
    #: uint8: RECEIVED or SENT; None for none told.
    directions: Codes | None = None

    def map(self, change: Callable[[Any], Any]) -> "Tagged":
        """Return the arrays, each changed in the same way."""
        channels, directions = (
            None if codes is None else change(codes) for codes in (self.channels, self.directions)
        )
        return Tagged(change(self.frames), channels, directions)


def joined(blocks: list[Tagged], frames: FrameArray | None = None) -> Tagged:
    """Return blocks as one, with all channels and directions that are told.

    `frames` are those of all blocks, if they lie in one array already.
    """
    if frames is None:
        frames = concat([block.frames for block in blocks])

    def codes(name: str, unknown: int) -> Codes | None:
        parts = [getattr(block, name) for block in blocks]
        if all(part is None for part in parts):
            return None
        return np.concatenate(
            [
                np.full(len(block.frames), unknown, np.uint8) if part is None else part
                for part, block in zip(parts, blocks, strict=True)
            ]
        )

    return Tagged(frames, codes("channels", NO_CHANNEL), codes("directions", RECEIVED))


class TagCounts:
    """Counts frames by channel and direction, for the remarks on what is not kept."""

    def __init__(self) -> None:
        self._channels = np.zeros(256, np.int64)
        self._sent = self._frames = 0

    def add(self, channels: Codes | None, directions: Codes | None, count: int) -> None:
        """Count `count` frames."""
        self._frames += count
        if channels is not None and count:
            first = channels[0]
            if (channels == first).all():  # a look at single bytes takes a tenth of the time
                self._channels[first] += count
            else:
                self._channels += np.bincount(channels, minlength=256)
        if directions is not None:
            self._sent += int(np.count_nonzero(directions == SENT))

    @property
    def channels(self) -> list[int]:
        """The codes of all channels that were counted, in ascending order."""
        codes: list[int] = np.flatnonzero(self._channels).tolist()
        return codes

    @property
    def any(self) -> bool:
        """Whether any frame was counted."""
        return self._frames > 0

    def channel_remarks(self, name_of: Callable[[int], str]) -> list[str]:
        """Return a remark if the frames are of several channels."""
        codes = self.channels
        if len(codes) < 2:
            return []
        counts = {name_of(code): int(self._channels[code]) for code in codes}
        number = f"more than {_NAMES_MOST}" if len(codes) > _NAMES_MOST else str(len(codes))
        return [f"frames of {number} channels become one: {listed(counts)}"]

    def direction_remarks(self) -> list[str]:
        """Return a remark if the frames have two directions, or all were sent."""
        if not self._sent:
            return []
        received = self._frames - self._sent
        parts = [f"received {received:,}"] if received else []
        return [f"direction is not kept: {', '.join([*parts, f'sent {self._sent:,}'])}"]


def channel_code(name: str, names: Mapping[int, str]) -> int:
    """Return the code for a new name of a channel: the number at its end, or the next free one.

    NO_CHANNEL if all codes are taken.
    """
    digits = name[len(name.rstrip("0123456789")) :]
    number = int(digits) if digits and len(digits) < 4 else 0
    if number < NO_CHANNEL and number not in names:
        return number
    return next((code for code in range(NO_CHANNEL) if code not in names), NO_CHANNEL)


def listed(counts: Mapping[str, int]) -> str:
    """Return names and counts as text: the first 16, and the sum of the others."""
    shown = [f"{printable(name)} {count:,}" for name, count in list(counts.items())[:_NAMES_MOST]]
    more = sum(list(counts.values())[_NAMES_MOST:])
    return ", ".join([*shown, f"and more {more:,}"] if more else shown)


def printable(name: str) -> str:
    """Return a name from a file so that a terminal can show it: not empty, no control codes."""
    cut = name if len(name) <= _SHOWN else f"{name[:_SHOWN]}..."
    return cut if cut and cut.isprintable() else ascii(cut)
