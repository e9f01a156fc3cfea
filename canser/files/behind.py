"""Writes parts to a file in a thread, each while the caller makes the next one."""

import threading
from queue import SimpleQueue
from typing import BinaryIO, Final

__all__ = ["Behind"]

# Bytes of a part from which on a thread is of use.
_LEAST: Final = 1 << 16


class Behind:
    """A file to write, in parts that stay as they are until the next one was taken.

    The error of a part is raised by the next call. At the end `finish` or `abandon` ends the
    thread. Small parts, such as those of a live stream, are written at once.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._thread: threading.Thread | None = None
        self._parts: SimpleQueue[memoryview | None] = SimpleQueue()
        self._results: SimpleQueue[BaseException | None] = SimpleQueue()
        self._is_busy = False

    def write(self, part: bytes | memoryview) -> None:
        """Write a part, behind all others."""
        self._wait()
        if len(part) >= _LEAST and self._has_thread():
            self._is_busy = True
            self._parts.put(memoryview(part))
        else:
            self._file.write(part)

    def _has_thread(self) -> bool:
        """Start the thread; return False where the system has no more threads."""
        if self._thread is None:
            thread = threading.Thread(target=self._run, name="canser writing", daemon=True)
            try:
                thread.start()
            except RuntimeError:
                return False
            self._thread = thread
        return True

    def _run(self) -> None:
        while (part := self._parts.get()) is not None:
            try:
                self._file.write(part)
            except BaseException as error:  # noqa: BLE001 - raised again by the caller's thread
                self._results.put(error)
            else:
                self._results.put(None)

    def _wait(self) -> None:
        """Wait for the part before, and raise its error."""
        if self._is_busy:
            error = self._results.get()
            self._is_busy = False
            if error is not None:
                raise error

    def finish(self) -> None:
        """Write what was not written yet, and raise its error."""
        try:
            self._wait()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """End the thread."""
        if self._thread is not None:
            self._parts.put(None)
            self._thread.join()
            self._thread = None
