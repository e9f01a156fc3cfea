"""Usual blocks of recordings, walked and gathered in C."""

from typing import NamedTuple

import numpy as np

from canser._core._lib import ffi, lib
from canser._core.buffers import Times, input_bytes, raise_status

__all__ = ["BlockGatherer", "Gathered"]

# The room for pieces: if blocks have 64 bytes or more, the room for bytes is full before it.
_SMALL_BLOCK = 64


class Gathered(NamedTuple):
    """The bytes of some blocks, one block behind the other."""

    used: int  # bytes of the file
    data: memoryview  # good until the next call
    ends: Times  # where each block ends in `data`
    times: Times


class BlockGatherer:
    """Gather the bytes of blocks into one array, which each call fills anew."""

    def __init__(self, room_bytes: int) -> None:
        self._self = ffi.new("canser_recording *")
        self._result = ffi.new("canser_gathered *")
        lib.canser_recording_init(self._self)
        room = np.empty(room_bytes, np.uint8)
        self._pieces = np.empty((room_bytes // _SMALL_BLOCK + 1, 2), np.int64)
        self._data = room.data.toreadonly()
        self._room = (
            ffi.from_buffer("uint8_t[]", room),
            len(room),
            ffi.from_buffer("canser_piece[]", self._pieces),
            len(self._pieces),
        )

    def gather(self, data: memoryview, interface: int, next_id: int | None) -> Gathered:
        """Gather the blocks of an interface from the start of `data`, up to an unusual block.

        `next_id` is the id of the first block if no block is missing, or None if blocks have no
        ids. See canser_recording_gather.
        """
        self._self.interface = interface
        self._self.has_ids = next_id is not None
        self._self.next_id = next_id or 0
        status = lib.canser_recording_gather(
            self._self, input_bytes(data), len(data), *self._room, self._result
        )
        if status:
            raise_status(status)
        result = self._result
        ends, times = self._pieces[: result.piece_count].T.copy()
        return Gathered(result.used, self._data[: result.byte_count], ends, times)
