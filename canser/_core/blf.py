"""Objects of BLF as frames, and frames as objects: C's work for each object, and its memory."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from canser._core._lib import ffi, lib
from canser._core.buffers import input_bytes, input_frames, raise_status
from canser._core.table import text
from canser._core.text import Codes, Taken
from canser._frames import FrameArray

__all__ = ["OBJECT_MOST", "BlfReader", "BlfWriter"]

# The largest object that is read, in bytes.
OBJECT_MOST: Final = int(lib.CANSER_BLF_OBJECT_MAX)


class BlfReader:
    """Reads objects of a file into rows; see canser_blf_read."""

    def __init__(self) -> None:
        self.state = ffi.new("canser_blf *")
        self._rows = ffi.new("canser_rows *")

    def use(self, frames: FrameArray, channels: Codes, directions: Codes) -> None:
        """Read into arrays of one length from now on."""
        self._cap = len(frames)
        # These keep the arrays alive. The pointers in C's struct do not.
        self._frames = ffi.from_buffer("canser_frame[]", frames, require_writable=True)
        self._channels = ffi.from_buffer("uint8_t[]", channels, require_writable=True)
        self._directions = ffi.from_buffer("uint8_t[]", directions, require_writable=True)

    def read(self, data: bytes | memoryview, first: int) -> Taken:
        """Read objects from the start of `data`; `first` is the row of the first frame.

        Behind it one of the properties tells why it stopped, or the last object is not whole.
        """
        rows = self._rows
        rows.frames, rows.frame_cap = self._frames + first, self._cap - first
        rows.channels, rows.directions = self._channels + first, self._directions + first
        status = lib.canser_blf_read(self.state, input_bytes(data), len(data), rows)
        if status:
            raise_status(status)
        return Taken(rows.used, rows.line_count, rows.frame_count)

    @property
    def is_full(self) -> bool:
        """Whether the rows are full."""
        return bool(self.state.stopped == lib.CANSER_BLF_FULL)

    @property
    def at_container(self) -> bool:
        """Whether the next object is a container."""
        return bool(self.state.stopped == lib.CANSER_BLF_CONTAINER)

    @property
    def no_object(self) -> bool:
        """Whether there is no object where the next one has to begin."""
        return bool(self.state.stopped == lib.CANSER_BLF_SIGNATURE)

    @property
    def wrong_size(self) -> bool:
        """Whether the next object has an impossible size."""
        return bool(self.state.stopped == lib.CANSER_BLF_SIZE)

    @property
    def next_size(self) -> int:
        """The bytes of the next object, 0 if that is not known yet."""
        return int(self.state.size)


class BlfWriter:
    """Writes frames as objects, a container at a time; see canser_blf_write."""

    def __init__(self, container_size: int) -> None:
        self.state = ffi.new("canser_blf *")
        self.frames = 0  # so far: each is one object
        self._out = memoryview(np.empty(container_size, np.uint8).data)
        self._room = ffi.from_buffer("uint8_t[]", self._out, require_writable=True)
        self._filled = 0
        self._result = ffi.new("canser_encoded *")

    def containers(
        self, frames: FrameArray, channels: Codes | None, directions: Codes | None
    ) -> Iterator[memoryview]:
        """Yield the contents of full containers, each good until the next one.

        ValueError names the first frame that is none of classic CAN.
        """
        source, done, result = input_frames(frames), 0, self._result
        codes = [
            ffi.NULL if each is None else ffi.from_buffer("uint8_t[]", each)
            for each in (channels, directions)
        ]
        while True:
            at = [each + done if each else each for each in codes]
            status = lib.canser_blf_write(
                self.state,
                source + done,
                *at,
                len(frames) - done,
                self._room + self._filled,
                len(self._out) - self._filled,
                result,
            )
            if status and status != lib.CANSER_REFUSED:
                raise_status(status)
            done += result.frame_count
            self.frames += result.frame_count
            self._filled += result.byte_count
            if status:
                why = text(lib.canser_refusal_text(result.refusal))
                raise ValueError(f"frame {self.frames} is none of classic CAN: {why}")
            if done == len(frames):
                return
            yield self.rest()

    def rest(self) -> memoryview:
        """Return the content of the container that is not full yet, and begin the next one."""
        content, self._filled = self._out[: self._filled], 0
        return content
