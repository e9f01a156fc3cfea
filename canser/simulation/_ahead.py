"""A thread that takes parts of a generator before they are asked for."""

import queue
import threading
from collections.abc import Generator
from typing import Generic, TypeVar

from canser._threads import start_thread
from canser.errors import PortError

__all__ = ["Ahead"]

_Part = TypeVar("_Part")

# Parts that are taken ahead. A text file is parsed in blocks of 16,384 frames, which are four
# parts; a block takes some 0.2 s. So there are two blocks: one is sent while the next is parsed.
_PARTS = 8

# Time to wait for the end of the thread. A thread whose source waits for bytes of a pipe cannot be
# ended, and is left to the end of the process. Any other source yields its part in less time.
_JOIN_S = 1.0


class Ahead(Generic[_Part]):
    """The parts of a generator, taken ahead by a thread; `ended` is True after the last part."""

    def __init__(self, parts: Generator[_Part]) -> None:
        self.ended = False
        self._parts = parts
        self._room = threading.Semaphore(_PARTS)
        self._queue: queue.SimpleQueue[_Part | BaseException | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    def take(self, *, wait: bool) -> _Part | None:
        """Return the next part, None after the last; without `wait`, None also if none is ready.

        An exception of the generator is raised here.
        """
        if self.ended:
            return None
        if self._thread is None:
            thread = threading.Thread(
                target=self._run, name="canser simulator traffic", daemon=True
            )
            start_thread(thread, "the simulator", PortError)
            self._thread = thread
        try:
            part = self._queue.get(block=wait)
        except queue.Empty:
            return None
        self._room.release()
        if part is None or isinstance(part, BaseException):
            self.ended = True
        if isinstance(part, BaseException):
            raise part
        return part

    def end(self) -> None:
        """Take no more parts, and drop those that were taken ahead."""
        self.ended = True
        self._room.release()

    def close(self) -> None:
        """End, and wait for the end of the thread."""
        self.end()
        if self._thread is not None:
            self._thread.join(_JOIN_S)

    def _run(self) -> None:
        last: BaseException | None = None
        try:
            for part in self._parts:
                self._queue.put(part)
                self._room.acquire()
                if self.ended:
                    break
            self._parts.close()
        except BaseException as error:  # noqa: BLE001 - `take` raises it again
            last = error
        self._queue.put(last)
