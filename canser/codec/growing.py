"""A new array of frames whose number is known at the end only."""

from typing import Final

import numpy as np

from canser._frames import FRAME_DTYPE, FrameArray, put_records

__all__ = ["GrowingFrames"]

# A block of this size, 128 KiB, or larger is mapped from the system by glibc, unless a block of its
# size was freed before. Blocks over 32 MiB are always mapped (mallopt(3), M_MMAP_THRESHOLD).
_MAPPED: Final = (128 << 10) // FRAME_DTYPE.itemsize
_ALWAYS_MAPPED: Final = (32 << 20) // FRAME_DTYPE.itemsize


class GrowingFrames:
    """Frames in one array, with room behind them that grows on demand.

    `frames` is the array. Its first `count` rows are taken. The owner writes behind them, and
    raises `count`.
    """

    def __init__(self, cap: int) -> None:
        self.frames = _make_room(cap)
        self.count = 0

    @property
    def room(self) -> int:
        """How many more frames the array has room for."""
        return len(self.frames) - self.count

    def grow(self, cap: int) -> None:
        """Make the array `cap` rows long, and copy its frames."""
        larger = _make_room(cap)
        put_records(larger[: self.count], self.frames[: self.count])
        self.frames = larger

    def result(self) -> FrameArray:
        """Return the frames in an array without spare rows, which owns its memory."""
        # The spare rows are freed in place: no other object refers to the array.
        self.frames.resize(self.count, refcheck=False)
        return self.frames


def _make_room(cap: int) -> FrameArray:
    """Return room for `cap` frames, if possible in pages that the process already has.

    The first touch of a new page takes longer than decoding the frames in it, and a mapped block
    has new pages each time. Otherwise a loop over `decode` would take ten times as long. So a block
    of the same size is freed first, untouched: from then on the C library keeps such blocks.
    """
    if _MAPPED <= cap <= _ALWAYS_MAPPED:
        np.empty(cap * FRAME_DTYPE.itemsize, np.uint8)
    return np.empty(cap, FRAME_DTYPE)
