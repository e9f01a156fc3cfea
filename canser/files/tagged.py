"""The base of readers whose files tell the channel and the direction of each frame."""

from collections.abc import Callable, Container, Iterator

import numpy as np

from canser._core.text import NO_CHANNEL, SENT, Codes
from canser._frames import FRAME_DTYPE, FrameArray, put_records
from canser._input import Input
from canser._rows import Row
from canser.errors import FormatError
from canser.files.reader import Reader, ReadOptions
from canser.files.tags import RECEIVED, TagCounts, Tagged, channel_code, listed

__all__ = ["TaggedReader"]

# Frames in a block: 1.5 MiB of records.
_BLOCK = 1 << 16


class TaggedReader(Reader):
    """Reads frames with channels and directions into arrays of one length.

    A subclass defines `_fill`, which writes frames into the rows from `_count` on, raises `_count`,
    and yields when the frames may be handed on: at the latest when all rows are filled.
    """

    has_buses = True
    #: The number of the first channel, if the format numbers channels; None if it names them.
    first_channel: int | None = None

    def __init__(self, source: Input, options: ReadOptions) -> None:
        self._source, self._options = source, options
        self._tags = TagCounts()
        self._other_buses: dict[int, int] = {}  # frames of each channel that is not read
        self._codes: dict[str, int] = {}
        self.channel_names: dict[int, str] = {}
        self._new_rows()

    def _new_rows(self) -> None:
        """Begin at the first row: of the caller's array, or of a new one."""
        out = self._options.out
        self._frames: FrameArray = np.empty(_BLOCK, FRAME_DTYPE) if out is None else out
        if out is None or not hasattr(self, "_channels"):
            self._channels: Codes = np.empty(len(self._frames), np.uint8)
            self._directions: Codes = np.empty(len(self._frames), np.uint8)
        self._count = self._first = 0  # rows that are filled, and of these that were yielded

    def _fill(self) -> Iterator[None]:
        """Fill rows up to `_count`, and yield when they may be handed on."""
        raise NotImplementedError

    def blocks(self, ends: Callable[[], bool]) -> Iterator[FrameArray]:  # noqa: ARG002
        """Yield the frames, block by block. No frame continues in the next file."""
        fill, error = self._fill(), None
        while error is None:
            try:
                next(fill)
            except StopIteration:
                break
            except (FormatError, OSError) as found:
                error = found  # the frames before it come first
            block = self._take()
            if block is not None:
                yield block
        if error is not None:
            raise error
        self._check_bus()

    def _take(self) -> FrameArray | None:
        """Return the rows that were filled since the last call, None if there are none."""
        first, count = self._first, self._count
        frames = self._frames[first:count]
        channels, directions = self._channels[first:count], self._directions[first:count]
        if self._options.out is None and count < len(self._frames):
            self._first = count
        else:
            self._new_rows()
        if self._options.bus is not None:
            frames, channels, directions = self._select_bus(frames, channels, directions)
        if not len(frames):
            return None
        self._see_times(frames)
        self._tags.add(channels, directions, len(frames))
        self.tags = Tagged(frames, channels, directions)
        return frames

    def _select_bus(
        self, frames: FrameArray, channels: Codes, directions: Codes
    ) -> tuple[FrameArray, Codes, Codes]:
        """Move the frames of the bus to read to the first of these rows; count the others."""
        bus = self._options.bus or ""
        if self.first_channel is None:
            code = self._codes.get(bus, -1)
        else:
            code = int(bus) - self.first_channel if bus.isdecimal() else -1
        wanted = channels == code
        if wanted.all():
            return frames, channels, directions
        for other, number in enumerate(np.bincount(channels[~wanted], minlength=256).tolist()):
            if number:
                self._other_buses[other] = self._other_buses.get(other, 0) + number
        kept = int(np.count_nonzero(wanted))
        put_records(frames[:kept], frames.compress(wanted))
        directions[:kept] = directions.compress(wanted)
        channels[:kept] = channels.compress(wanted)
        return frames[:kept], channels[:kept], directions[:kept]

    def _check_bus(self) -> None:
        """Raise FormatError if the file has frames, but none of the bus to read."""
        if self._other_buses and not self._tags.any:
            have = {self.name_of(code): number for code, number in self._other_buses.items()}
            raise FormatError(
                f"{self._source.name} has no frame of the bus {self._options.bus}; it has "
                f"{listed(have)}"
            )

    def name_of(self, code: int) -> str:
        """Return the name of a channel as the file has it."""
        if self.first_channel is not None and code != NO_CHANNEL:
            return str(code + self.first_channel)
        return self.channel_names.get(code, "not told")

    def _see_times(self, frames: FrameArray) -> None:
        """Look at the times of a block, or change them."""

    def _put_row(self, row: Row, channel: int, *, sent: bool) -> None:
        """Write a frame into the next row; the caller makes sure that there is room."""
        arbitration_id, ext, rtr, dlc, err, data, ts = row
        at, self._count = self._count, self._count + 1
        self._frames[at] = (
            arbitration_id, ext, rtr, dlc, err, np.frombuffer(data.ljust(8, b"\0"), np.uint8), ts
        )  # fmt: skip
        self._channels[at] = channel
        self._directions[at] = SENT if sent else RECEIVED

    def _code(self, name: str | None) -> int:
        """Return the code of a channel by its name in the file; None if it is not told."""
        if name is None:
            return NO_CHANNEL
        if self.first_channel is not None:
            number = int(name) - self.first_channel
            return number if 0 <= number < NO_CHANNEL else NO_CHANNEL
        code = self._codes.get(name)
        if code is None:
            code = channel_code(name, self.channel_names)
            if code != NO_CHANNEL:
                self._codes[name], self.channel_names[code] = code, name
                self._named(name, code)
        return code

    def _named(self, name: str, code: int) -> None:
        """Take note of the name of a new channel."""

    @property
    def channels(self) -> list[int]:
        """The codes of the channels so far."""
        return self._tags.channels

    def tag_remarks(self, kept: Container[str]) -> list[str]:
        """Return remarks on "channels" and "directions", but for those that are kept."""
        return [
            *([] if "channels" in kept else self._tags.channel_remarks(self.name_of)),
            *([] if "directions" in kept else self._tags.direction_remarks()),
        ]

    @property
    def remarks(self) -> list[str]:
        """Remarks on the file."""
        left_out = sum(self._other_buses.values())
        return [f"frames of other buses, left out: {left_out:,}"] if left_out else []
