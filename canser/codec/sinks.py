"""Where decoded frames go: an array of the caller's, or a new one that grows."""

import threading
from collections.abc import Callable
from typing import Protocol

import numpy as np

from canser._core.buffers import Offsets, Pointer, output_room
from canser._core.stream import ParallelChunk, Stream
from canser._frames import FRAME_DTYPE, FrameArray, put_records

__all__ = ["SMALL", "FixedArray", "GrowingArray", "MakeChunk", "Sink"]

# Where the bytes can hold no more frames than this, room for the most is made at once: 16 MiB.
# What is not written takes no memory, and goes back to the system at the end.
AT_ONCE = (16 << 20) // FRAME_DTYPE.itemsize

# Where they can, the first room is for this many, 1 MiB: they tell how many there will be.
SMALL = (1 << 20) // FRAME_DTYPE.itemsize


# Makes room for a stretch that a helper decodes, with or without offsets.
MakeChunk = Callable[[bool], ParallelChunk]


class Sink(Protocol):
    """Where frames go, in their order."""

    def chunk(self) -> ParallelChunk:
        """Return room for a chunk that a helper decodes."""

    def room(self) -> tuple[Pointer, int, Pointer]:
        """Return where the next frames may be written, how many, and their offsets."""

    def wrote(self, count: int) -> None:
        """Take notice of frames that were written there."""

    def place(self, chunk: ParallelChunk) -> Callable[[], None]:
        """Make room for a chunk's frames; return what brings them there."""


class _Array:
    """An array that frames are written into, by one thread or several."""

    def __init__(self, make_chunk: MakeChunk, out: FrameArray, offsets: Offsets | None) -> None:
        self.count = 0
        self._make_chunk = make_chunk
        self._out, self._offsets = out, offsets

    def chunk(self) -> ParallelChunk:
        return self._make_chunk(self._offsets is not None)

    def room(self) -> tuple[Pointer, int, Pointer]:
        return output_room(self._out, self.count, self._offsets)

    def wrote(self, count: int) -> None:
        self.count += count


class FixedArray(_Array):
    """The caller's array. What is too much for it is counted only."""

    _spare: FrameArray | None = None

    def room(self) -> tuple[Pointer, int, Pointer]:
        """Return the rest of the array, or room to count in."""
        if self.count < len(self._out):
            return super().room()
        if self._spare is None:
            self._spare = np.empty(SMALL, FRAME_DTYPE)
        return output_room(self._spare, 0, None)

    def place(self, chunk: ParallelChunk) -> Callable[[], None]:
        """Return what copies as many of the frames as there is room for."""
        begin = self.count
        fits = max(min(chunk.count, len(self._out) - begin), 0)
        self.count += chunk.count

        def deliver() -> None:
            if fits:
                target, _, _ = output_room(self._out, begin, None)
                chunk.deliver(target, fits)
            if self._offsets is not None and chunk.offsets is not None:
                self._offsets[begin : begin + fits] = chunk.offsets[:fits]

        return deliver


class GrowingArray(_Array):
    """A new array that grows by what the bytes so far have held."""

    def __init__(self, make_chunk: MakeChunk, stream: Stream, source_len: int) -> None:
        self._stream = stream
        self._start = stream.position
        self._end = self._start + source_len
        self._held = stream.pending
        self._frame_min = stream.protocol.frame_min
        self._copying = 0
        self._copied: threading.Condition | None = None  # made for the first copy of a helper
        most = self._most(source_len)
        super().__init__(make_chunk, _make_room(most if most <= AT_ONCE else SMALL), None)

    def room(self) -> tuple[Pointer, int, Pointer]:
        """Return the rest of the array, which is larger now if it was full."""
        if self.count == len(self._out):
            self._grow(1)
        return super().room()

    def place(self, chunk: ParallelChunk) -> Callable[[], None]:
        """Return what copies the frames, and keeps the array where it is until then."""
        if len(self._out) - self.count < chunk.count:
            self._grow(chunk.count)
        target, _, _ = super().room()
        self.count += chunk.count
        copied = self._copied = self._copied or threading.Condition()
        with copied:
            self._copying += 1

        def deliver() -> None:
            try:
                chunk.deliver(target, chunk.count)
            finally:
                with copied:
                    self._copying -= 1
                    copied.notify_all()

        return deliver

    def result(self) -> FrameArray:
        """Return the array, of just the size; it owns its memory."""
        # What is too much is given back where it is: no other object refers to it.
        self._out.resize(self.count, refcheck=False)
        return self._out

    def _most(self, to_come: int) -> int:
        """Return room that is enough for these bytes to come, whatever they are."""
        return (to_come + self._held) // self._frame_min + 1

    def _grow(self, more: int) -> None:
        # The frames so far tell how many there will be; where the rest is denser than
        # they were, this happens again.
        position = self._stream.position
        done = max(position - self._start, 1)
        count = self.count + more
        expected = int(count * ((self._end - self._start) / done) * 1.02) + SMALL
        cap = min(max(expected, 2 * self.count), count + self._most(self._end - position))
        larger = _make_room(cap)
        if self._copied is not None:
            with self._copied:
                while self._copying:
                    self._copied.wait()
        put_records(larger[: self.count], self._out[: self.count])
        self._out = larger


# glibc maps blocks of 128 KiB and more from the system, unless one as large was freed before;
# blocks over 32 MiB always (mallopt(3), M_MMAP_THRESHOLD).
_MAPPED = (128 << 10) // FRAME_DTYPE.itemsize
_ALWAYS_MAPPED = (32 << 20) // FRAME_DTYPE.itemsize


def _make_room(cap: int) -> FrameArray:
    """Return room for this many frames in pages that the process has already, if it can be.

    To touch a page that is new takes longer than to decode the frames in it, and a block that
    was mapped has new pages each time: a loop over `decode` would take ten times as long.
    One as large is freed first, untouched: from then on the C library keeps such blocks.
    """
    if _MAPPED <= cap <= _ALWAYS_MAPPED:
        np.empty(cap * FRAME_DTYPE.itemsize, np.uint8)
    return np.empty(cap, FRAME_DTYPE)
