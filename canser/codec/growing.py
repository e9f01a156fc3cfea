"""A new array of frames whose number is known at the end only."""

from typing import Final

import numpy as np

from canser._frames import FRAME_DTYPE, FrameArray, put_records

__all__ = ["GrowingFrames"]

# glibc maps blocks of 128 KiB and more from the system, unless one as large was freed before;
# blocks over 32 MiB always (mallopt(3), M_MMAP_THRESHOLD).
_MAPPED: Final = (128 << 10) // FRAME_DTYPE.itemsize
_ALWAYS_MAPPED: Final = (32 << 20) // FRAME_DTYPE.itemsize


class GrowingFrames:
    """Frames in one array, with room behind them that is made as it is needed.

    `frames` is the array, of which the first `count` are taken; the owner writes behind them,
    and counts.
    """

    def __init__(self, cap: int) -> None:
        self.frames = _make_room(cap)
        self.count = 0

    @property
    def room(self) -> int:
        """How many more frames the array has room for."""
        return len(self.frames) - self.count

    def grow(self, cap: int) -> None:
        """Make the array so long, and copy what is in it."""
        larger = _make_room(cap)
        put_records(larger[: self.count], self.frames[: self.count])
        self.frames = larger

    def result(self) -> FrameArray:
        """Return the array, of just the size; it owns its memory."""
        # What is too much is given back where it is: no other object refers to it.
        self.frames.resize(self.count, refcheck=False)
        return self.frames


def _make_room(cap: int) -> FrameArray:
    """Return room for this many frames in pages that the process has already, if it can be.

    To touch a page that is new takes longer than to decode the frames in it, and a block that
    was mapped has new pages each time: a loop over `decode` would take ten times as long.
    One as large is freed first, untouched: from then on the C library keeps such blocks.
    """
    if _MAPPED <= cap <= _ALWAYS_MAPPED:
        np.empty(cap * FRAME_DTYPE.itemsize, np.uint8)
    return np.empty(cap, FRAME_DTYPE)
