"""Threads that read the usual lines of a text ahead of its reader, a stretch each.

The reader joins the stretches in their order. A stretch ends early before an unusual line: the
reader reads that line, and the rest of the stretch, by itself.
"""

import contextlib
from functools import partial
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from canser._core.arrow import shared_empty
from canser._core.text import Taken, TextReader
from canser._frames import FRAME_DTYPE, FrameArray
from canser._input import Input
from canser._threads import Helpers

__all__ = ["STRETCH", "Ahead", "Stretch"]

# Bytes of a stretch. Their reading takes long compared with the Python around it, and they fit into
# a cache.
STRETCH = 1 << 20

# Bytes behind a stretch in which its last line must end. A usual line has under 200.
_LINE: Final = 1 << 12

# Frames of a stretch that there is room for. A usual line has more than 16 bytes.
_ROWS: Final = STRETCH // 16

# Bytes from which on threads are of use.
_LEAST: Final = 4 * STRETCH

# Bytes until threads may begin for the second time; twice as many for the third time, and so on.
_REST: Final = 1 << 14

# Bytes of the text of a stretch with those around it, in whole frames; and all that one needs.
_BYTES: Final = STRETCH + 2 * _LINE
_MEMORY: Final = _BYTES + (2 + FRAME_DTYPE.itemsize) * _ROWS


class Stretch:
    """Lines of a text, from one offset to another, and the frames of those that were read.

    The first and the last line are those that begin in the bytes of the stretch.
    """

    def __init__(self, name: str, memory: npt.NDArray[np.uint8]) -> None:
        self._memory = memory[:_BYTES].data
        codes, frames = memory[_BYTES:].reshape(-1, _ROWS)[:2], memory[_BYTES + 2 * _ROWS :]
        self.channels, self.directions = codes
        self.frames: FrameArray = frames.view(FRAME_DTYPE)
        self.text = TextReader(name)
        self.text.use(self.frames, self.channels, self.directions)
        self.first = self.stop = 0  # offsets in the text: of the first line, and behind the last
        self.taken: Taken | None = None  # None if its lines were not found

    def read(self, source: Input, begin: int, setup: TextReader, *, is_start: bool) -> Self:
        """Read the lines that begin in the stretch at an offset; return this stretch.

        `is_start`: a line begins at the offset. `setup` has read the lines before, up to any one.
        """
        self.taken = None
        self.text.begin_as(setup)
        before = 0 if is_start else 1  # where the last line of the stretch before may end
        left = (source.total or 0) - begin
        data = self._memory[: before + min(STRETCH + _LINE, left)]
        if source.read_at(begin - before, data) < len(data):
            return self
        first = 0 if is_start else _find_end(data, 0)
        stop = _find_end(data, before + STRETCH - 1) if left > STRETCH else len(data)
        if first is not None and stop is not None:
            self.first, self.stop = begin - before + first, begin - before + stop
            self.taken = self.text.read(data[first:stop], 0)
        return self


def _find_end(data: memoryview, begin: int) -> int | None:
    """Return the place behind the first line end from a place on; None if it is far."""
    found = bytes(data[begin : begin + _LINE]).find(b"\n")
    return begin + found + 1 if found >= 0 else None


class Ahead:
    """Threads that read stretches of a text ahead. A context manager, which ends them.

    `take` gives stretches in their order; each is given back before the next one is taken. A
    stretch that meets an error is not there: the reader then meets it itself.
    """

    def __init__(self, source: Input, name: str, threads: int) -> None:
        self._source, self._name, self._threads = source, name, threads
        self._helpers: Helpers[Stretch] = Helpers(threads, "lines")
        self._free: list[Stretch] = []
        self._setup: TextReader | None = None  # None while no stretches are read
        self._next = 0  # offset of the next stretch
        self._from, self._rest = 0, _REST  # from where threads may begin; bytes to there next time

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._helpers.close()

    def take(self, offset: int, text: TextReader) -> Stretch | None:
        """Return the next lines, which begin at an offset, if threads have read them.

        Threads begin if that is of use. `text` has read the lines before; what was read ahead in
        another way is dropped. While it waits, this thread reads, too.
        """
        if self._setup is not None and self._setup.setup == text.setup:
            stretch = self._take(offset)
            if stretch is None:  # a line is too long, or the last one is not whole
                self._from = offset + STRETCH
            return stretch
        self.end()
        left = (self._source.total or 0) - offset
        if self._threads == 1 or offset < self._from or left < _LEAST:
            return None
        # What was read ahead is of no use where the lines are read in other ways again and again.
        self._from, self._rest = offset + self._rest, 2 * self._rest
        self._begin(offset, text)
        return self._take(offset)

    def _begin(self, offset: int, text: TextReader) -> None:
        # In one piece, which is kept for the next file: new memory takes long to be written first.
        memory = shared_empty(2 * self._threads * _MEMORY, np.uint8)
        self._free = [Stretch(self._name, each) for each in memory.reshape(-1, _MEMORY)]
        self._next, self._setup = offset, text.copy()
        self._put(is_start=True)

    def end(self) -> None:
        """Drop what was read ahead."""
        self._setup = None
        self._helpers.drop()

    def _put(self, *, is_start: bool = False) -> None:
        """Let threads read the next stretches, as many as there is room for."""
        while self._setup is not None and self._free and self._next < (self._source.total or 0):
            stretch = self._free.pop()
            self._helpers.put(
                partial(stretch.read, self._source, self._next, self._setup, is_start=is_start)
            )
            self._next += STRETCH
            is_start = False

    def _take(self, offset: int) -> Stretch | None:
        """Return the stretch that begins at an offset, None if there is none."""
        if self._helpers:
            with contextlib.suppress(OSError, MemoryError):
                stretch = self._helpers.take()
                if stretch.taken is not None and stretch.first == offset:
                    return stretch
        self.end()
        return None

    def give_back(self, stretch: Stretch) -> None:
        """Let a thread fill a stretch again."""
        self._free.append(stretch)
        self._put()
