"""Writes parts to a file in a thread, each while the caller makes the next one."""

import io
import sys
from functools import partial
from typing import BinaryIO, Final

from canser._threads import Helpers

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
        # Writing to memory holds Python's lock.
        self._least = sys.maxsize if isinstance(file, io.BytesIO) else _LEAST
        self._helpers: Helpers[int] = Helpers(2, "writing")

    def write(self, part: bytes | memoryview) -> None:
        """Write a part, behind all others."""
        self._wait()
        if len(part) >= self._least:
            self._helpers.put(partial(self._file.write, part))
        else:
            self._file.write(part)

    def _wait(self) -> None:
        """Wait for the part before, and raise its error."""
        if self._helpers:
            self._helpers.take()

    def finish(self) -> None:
        """Write what was not written yet, and raise its error."""
        try:
            self._wait()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """End the thread."""
        self._helpers.close()
