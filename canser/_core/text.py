"""Lines of text as frames, and frames as lines: C's work for each line, and its memory."""

from collections.abc import Callable, Iterator
from itertools import cycle
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canser._core._lib import ffi, lib
from canser._core.buffers import Pointer, input_bytes, input_frames, raise_status
from canser._core.table import text
from canser._frames import NO_TIME, FrameArray

__all__ = [
    "NO_CHANNEL",
    "SENT",
    "Codes",
    "FrameWriter",
    "Taken",
    "TextReader",
    "TextWriter",
]

# Channels or directions of frames: uint8, one for each frame.
Codes = npt.NDArray[np.uint8]

# The channel of a frame for which none is told.
NO_CHANNEL: Final = int(lib.CANSER_NO_CHANNEL)

# The direction of a frame that the program sent which wrote the file; 0 is received.
SENT: Final = int(lib.CANSER_SENT)

# Bytes that are always enough for a line; see canser_text_write.
_LINE_MOST: Final = 160

# Frames that are written by one call: 0.7 MiB of lines, so that a system call costs little.
_WRITTEN_AT_ONCE: Final = 1 << 14


def _formats() -> dict[str, Pointer]:
    found: dict[str, Pointer] = {}
    while row := lib.canser_text_at(len(found)):
        found[text(row.name)] = row
    return found


_FORMATS: Final = _formats()


class Taken(NamedTuple):
    """What a call has read: the results of canser_rows."""

    used: int  # bytes
    lines: int
    frames: int


class _Text:
    """The state of one file in C."""

    def __init__(self, name: str) -> None:
        self.state = ffi.new("canser_text *", {"format": _FORMATS[name]})

    def add_name(self, name: str, channel: int) -> bool:
        """Add the name of a channel; return False if C has no room for it."""
        data = name.encode()
        return not lib.canser_text_add_name(self.state, data, len(data), channel)


class TextReader(_Text):
    """Reads usual lines of a file into rows; see canser_text_read."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._rows = ffi.new("canser_rows *")

    def copy(self) -> "TextReader":
        """Return a reader that reads lines in the same way, and has no arrays."""
        made = TextReader(text(self.state.format.name))
        made.state[0] = self.state[0]
        return made

    def begin_as(self, other: "TextReader") -> None:
        """Read lines in the same way as another reader; count them from none on."""
        state = self.state
        state[0] = other.state[0]
        state.steps_back, state.fd_count, state.before_ns = 0, 0, NO_TIME

    def join(self, other: "TextReader", frames: FrameArray) -> None:
        """Add the counts of a reader that began by `begin_as`, and has read the next frames."""
        state, more = self.state, other.state
        state.fd_count += more.fd_count
        if len(frames):
            state.steps_back += more.steps_back + (int(frames["ts"][0]) < state.before_ns)
            state.before_ns = more.before_ns

    @property
    def setup(self) -> tuple[Any, ...]:
        """What tells how lines are read; a line that Python reads may change it."""
        state = self.state
        return state.name_count, ffi.string(state.columns), state.is_decimal, state.is_relative

    def use(self, frames: FrameArray, channels: Codes, directions: Codes) -> None:
        """Read into arrays of one length from now on."""
        self._cap = len(frames)
        # These keep the arrays alive. The pointers in C's struct do not.
        self._frames = ffi.from_buffer("canser_frame[]", frames, require_writable=True)
        self._channels = ffi.from_buffer("uint8_t[]", channels, require_writable=True)
        self._directions = ffi.from_buffer("uint8_t[]", directions, require_writable=True)

    def read(self, data: bytes | memoryview, first: int) -> Taken:
        """Read lines from the start of `data`, up to one that is unusual or not whole.

        `first` is the row of the first frame.
        """
        rows = self._rows
        rows.frames, rows.frame_cap = self._frames + first, self._cap - first
        rows.channels, rows.directions = self._channels + first, self._directions + first
        status = lib.canser_text_read(self.state, input_bytes(data), len(data), rows)
        if status:
            raise_status(status)
        return Taken(rows.used, rows.line_count, rows.frame_count)


class FrameWriter:
    """Writes frames by a function of C into two rooms in turn, part by part.

    `function` has the parameters and the results of canser_text_write. `frame_most` are bytes that
    are always enough for a frame.
    """

    def __init__(self, function: Callable[..., int], state: Pointer, frame_most: int) -> None:
        self._function, self._state = function, state
        rooms = np.empty((2, _WRITTEN_AT_ONCE * frame_most), np.uint8)
        self._rooms = cycle([memoryview(each.data) for each in rooms])
        self._result = ffi.new("canser_encoded *")
        self._before = 0  # frames of all calls before

    def parts(
        self, frames: FrameArray, channels: Codes | None, directions: Codes | None
    ) -> Iterator[memoryview]:
        """Yield the bytes of frames in parts, each good until the second one behind it.

        ValueError names the first frame that is none of classic CAN.
        """
        source, done, result = input_frames(frames), 0, self._result
        codes = [
            ffi.NULL if each is None else ffi.from_buffer("uint8_t[]", each)
            for each in (channels, directions)
        ]
        while done < len(frames):
            at = [each + done if each else each for each in codes]
            left, out = len(frames) - done, next(self._rooms)
            room = ffi.from_buffer("uint8_t[]", out, require_writable=True)
            status = self._function(self._state, source + done, *at, left, room, len(out), result)
            if status and status != lib.CANSER_REFUSED:
                raise_status(status)
            yield out[: result.byte_count]
            done += result.frame_count
            if status:
                why = text(lib.canser_refusal_text(result.refusal))
                raise ValueError(f"frame {self._before + done} is none of classic CAN: {why}")
        self._before += len(frames)


class TextWriter(_Text):
    """Writes frames as lines of a file; see canser_text_write."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.lines = FrameWriter(lib.canser_text_write, self.state, _LINE_MOST).parts
