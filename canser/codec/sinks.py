"""Targets of decoded frames: the caller's array, or a new one that grows."""

import threading
from collections.abc import Callable
from typing import Protocol

import numpy as np

from canser._core.buffers import Offsets, Pointer, output_room
from canser._core.stream import ParallelChunk, Stream
from canser._frames import FRAME_DTYPE, FrameArray
from canser.codec.growing import GrowingFrames

__all__ = ["SMALL", "FixedArray", "GrowingArray", "MakeChunk", "Sink"]

# A new array is made for the most frames that the bytes can hold, if these take 16 MiB or less.
# Pages that are not written take no memory. The rows that are not needed are freed at the end.
AT_ONCE = (16 << 20) // FRAME_DTYPE.itemsize

# Otherwise the new array begins with 1 MiB. The frames in it tell how many there will be.
SMALL = (1 << 20) // FRAME_DTYPE.itemsize


# Makes room for a stretch that a helper decodes: with offsets if the argument is True.
MakeChunk = Callable[[bool], ParallelChunk]


class Sink(Protocol):
    """A target of frames in their order."""

    def chunk(self) -> ParallelChunk:
        """Return room for a chunk that a helper decodes."""

    def room(self) -> tuple[Pointer, int, Pointer]:
        """Return pointers to the room for the next frames and their offsets, and its length."""

    def wrote(self, count: int) -> None:
        """Count frames that were written into the room."""

    def place(self, chunk: ParallelChunk) -> Callable[[], None]:
        """Make room for a chunk's frames; return the function that copies them there."""


class FixedArray:
    """The caller's array. Frames that find no room in it are only counted."""

    _spare: FrameArray | None = None

    def __init__(self, make_chunk: MakeChunk, out: FrameArray, offsets: Offsets | None) -> None:
        self.count = 0
        self._make_chunk = make_chunk
        self._out, self._offsets = out, offsets

    def chunk(self) -> ParallelChunk:
        """Return room for a chunk that a helper decodes."""
        return self._make_chunk(self._offsets is not None)

    def wrote(self, count: int) -> None:
        """Count frames that were written, in the array or in the room to count in."""
        self.count += count

    def room(self) -> tuple[Pointer, int, Pointer]:
        """Return the rest of the array, or room to count in."""
        if self.count < len(self._out):
            return output_room(self._out, self.count, self._offsets)
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


class GrowingArray:
    """A new array that grows by what the bytes so far have held."""

    def __init__(self, make_chunk: MakeChunk, stream: Stream, source_len: int) -> None:
        self._make_chunk, self._stream = make_chunk, stream
        self._start = stream.position
        self._end = self._start + source_len
        self._held = stream.pending
        self._frame_min = stream.protocol.frame_min
        self._copying = 0
        self._copied: threading.Condition | None = None  # made for the first copy of a helper
        most = self._most(source_len)
        self._array = GrowingFrames(most if most <= AT_ONCE else SMALL)

    def chunk(self) -> ParallelChunk:
        """Return room for a chunk that a helper decodes."""
        return self._make_chunk(False)

    def room(self) -> tuple[Pointer, int, Pointer]:
        """Return the rest of the array, which is larger now if it was full."""
        array = self._array
        if not array.room:
            self._grow(1)
        return output_room(array.frames, array.count, None)

    def wrote(self, count: int) -> None:
        """Count frames that were written."""
        self._array.count += count

    def place(self, chunk: ParallelChunk) -> Callable[[], None]:
        """Return what copies the frames, and keeps the array where it is until then."""
        array = self._array
        if array.room < chunk.count:
            self._grow(chunk.count)
        target, _, _ = output_room(array.frames, array.count, None)
        array.count += chunk.count
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
        return self._array.result()

    def _most(self, to_come: int) -> int:
        """Return room that is enough for these bytes to come, whatever they are."""
        return (to_come + self._held) // self._frame_min + 1

    def _grow(self, more: int) -> None:
        # The frames so far tell how many there will be; where the rest is denser than
        # they were, this happens again.
        array, position = self._array, self._stream.position
        done, total = max(position - self._start, 1), self._end - self._start
        expected = int((array.count + more) * (total / done) * 1.02) + SMALL
        most = array.count + more + self._most(self._end - position)
        if self._copied is not None:
            with self._copied:
                while self._copying:
                    self._copied.wait()
        array.grow(min(max(expected, 2 * (array.count + more)), most))
