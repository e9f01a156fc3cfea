"""Threads that read the usual lines of a text ahead of its reader, a stretch each.

The reader joins the stretches in their order. A stretch ends early before an unusual line: the
reader reads that line, and the rest of the stretch, by itself.
"""

import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from canser._core.arrow import shared_empty
from canser._core.text import Taken, TextReader
from canser._frames import FRAME_DTYPE, FrameArray
from canser._input import Input

__all__ = ["STRETCH", "Ahead", "Stretch"]

# Bytes of a stretch. Their reading takes long compared with the Python around it, and they fit into
# a cache.
STRETCH = 1 << 19

# Bytes behind a stretch in which its last line must end. A usual line has under 200.
_LINE: Final = 1 << 12

# Frames of a stretch that there is room for. A usual line has more than 16 bytes.
_ROWS: Final = STRETCH // 16

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
        self.is_done = False

    def read(self, source: Input, begin: int, setup: TextReader, *, is_start: bool) -> None:
        """Read the lines that begin in the stretch at an offset; `is_start`: a line begins there.

        `setup` is what has read the lines before, up to any one.
        """
        self.taken = None
        self.text.begin_as(setup)
        before = 0 if is_start else 1  # where the last line of the stretch before may end
        left = (source.total or 0) - begin
        data = self._memory[: before + min(STRETCH + _LINE, left)]
        if source.read_at(begin - before, data) < len(data):
            return
        first = 0 if is_start else _find_end(data, 0)
        stop = _find_end(data, before + STRETCH - 1) if left > STRETCH else len(data)
        if first is not None and stop is not None:
            self.first, self.stop = begin - before + first, begin - before + stop
            self.taken = self.text.read(data[first:stop], 0)


def _find_end(data: memoryview, begin: int) -> int | None:
    """Return the place behind the first line end from a place on; None if it is far."""
    found = bytes(data[begin : begin + _LINE]).find(b"\n")
    return begin + found + 1 if found >= 0 else None


class Ahead:
    """Threads that read stretches of a text ahead. A context manager, which ends them.

    `begin` starts them. Then `take` gives stretches in their order; each is given back before the
    next one is taken. A stretch that meets an error is not there: the reader then meets it itself.
    """

    def __init__(self, source: Input, name: str, threads: int) -> None:
        self._source, self._name, self._count = source, name, threads
        self._threads: list[threading.Thread] = []
        self._changed = threading.Condition()
        self._free: list[Stretch] = []
        self._claimed: deque[Stretch] = deque()  # in their order
        self._setup: TextReader | None = None  # None while no stretches are to be read
        self._start = self._next = 0  # offsets: of the first stretch, and of the next one
        self._has_begun = self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for thread in self._threads:
            # The garbage collector may close an iterator in one of these threads.
            if thread is not threading.current_thread():
                thread.join()

    @property
    def is_reading(self) -> bool:
        """Whether there are stretches to take."""
        return self._setup is not None

    def begin(self, offset: int, setup: TextReader) -> None:
        """Read from a line on, as `setup` would; stretches of before are dropped."""
        with self._changed:
            self.end()
            self._start = self._next = offset
            self._setup = setup.copy()
            if not self._has_begun:
                self._start_threads()
            self._changed.notify_all()

    def end(self) -> None:
        """Take no more stretches, and drop those that were read."""
        with self._changed:
            self._setup = None
            self._free += [each for each in self._claimed if each.is_done]
            self._claimed.clear()

    def _start_threads(self) -> None:
        self._has_begun = True
        # In one piece, which is kept for the next file: new memory takes long to be written first.
        memory = shared_empty(2 * self._count * _MEMORY, np.uint8)
        self._free = [Stretch(self._name, each) for each in memory.reshape(-1, _MEMORY)]
        for _ in range(self._count - 1):
            thread = threading.Thread(target=self._run, name="canser lines", daemon=True)
            try:
                thread.start()
            except RuntimeError:  # the system has no more: those that run do the work
                break
            self._threads.append(thread)

    def take(self, offset: int) -> Stretch | None:
        """Return the stretch that begins at an offset; None if there is none, and after the last.

        Until it was read, this thread reads others.
        """
        while True:
            with self._changed:
                if self._setup is None:
                    return None
                if self._claimed and self._claimed[0].is_done:
                    stretch = self._claimed.popleft()
                    if stretch.taken is not None and stretch.first == offset:
                        return stretch
                    self._free.append(stretch)
                    self.end()
                    return None
                work = self._claim()
                if work is None and not self._claimed:
                    self.end()
                    return None
                if work is None:
                    self._changed.wait()
            if work is not None:
                work()

    def give_back(self, stretch: Stretch) -> None:
        """Let a thread fill a stretch again."""
        with self._changed:
            self._free.append(stretch)
            self._changed.notify_all()

    def _claim(self) -> Callable[[], None] | None:
        """Return what reads the next stretch; None if there is none, or no room for it."""
        if self._setup is None or not self._free or self._next >= (self._source.total or 0):
            return None
        stretch, begin = self._free.pop(), self._next
        stretch.is_done = False
        self._claimed.append(stretch)
        self._next += STRETCH
        return partial(self._read, stretch, begin, self._setup, is_start=begin == self._start)

    def _read(self, stretch: Stretch, begin: int, setup: TextReader, *, is_start: bool) -> None:
        try:
            stretch.read(self._source, begin, setup, is_start=is_start)
        except Exception:  # noqa: BLE001 - the reader meets it again
            stretch.taken = None
        with self._changed:
            stretch.is_done = True
            if stretch not in self._claimed:  # it was dropped
                self._free.append(stretch)
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                work = self._claim()
                while work is None and not self._closed:
                    self._changed.wait()
                    work = self._claim()
                if self._closed:
                    return
            assert work is not None
            work()
