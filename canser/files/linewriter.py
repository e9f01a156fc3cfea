"""The base of writers of text: lines that C makes, written while the next ones are made."""

from typing import BinaryIO

from canser._core.text import Codes, TextWriter
from canser._frames import FrameArray
from canser.files.behind import Behind

__all__ = ["LineWriter"]


class LineWriter:
    """Writes frames as lines. A subclass defines `write` and `finish`, which calls `_end`."""

    def __init__(self, file: BinaryIO, lines: TextWriter) -> None:
        self._file, self._lines = Behind(file), lines

    def _put(
        self, frames: FrameArray, channels: Codes | None = None, directions: Codes | None = None
    ) -> None:
        """Append lines."""
        for part in self._lines.lines(frames, channels, directions):
            self._file.write(part)

    def _end(self) -> None:
        """Write the rest; raise its error."""
        self._file.finish()

    def abandon(self) -> None:
        """Write nothing more: an error has ended the writing."""
        self._file.abandon()
