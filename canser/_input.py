"""Files to read: opened, mapped where they can be, their bytes by offset in bounded memory."""

import io
import mmap
import os
import stat
from typing import BinaryIO, Self, cast

__all__ = ["WINDOW", "Input", "Source"]

# What can be read: a path, or a file open for reading bytes, from where it stands.
Source = str | os.PathLike[str] | BinaryIO

# A file is mapped piece by piece, so that its pages do not add up in the process:
# large enough that mapping costs nothing, small against any memory.
WINDOW = 8 << 20
assert WINDOW % mmap.ALLOCATIONGRANULARITY == 0

# What is read at a time from what cannot be mapped, such as a pipe.
CHUNK = 1 << 18


class Input:
    """The bytes of a file by their offsets, a part of it at a time, going forward.

    Offsets count from where the file stands. A regular file is mapped; of any other, what
    lies before the last offset asked for is forgotten. A context manager: a file that was
    given by its path is closed at the end.
    """

    def __init__(self, source: Source) -> None:
        self._opened: BinaryIO | None = None
        if isinstance(source, (str, os.PathLike)):
            # Unbuffered: a pipe's bytes are handed on as they come.
            self._opened = cast(BinaryIO, open(source, "rb", buffering=0))  # noqa: PTH123, SIM115
            self.name = os.fsdecode(source)
        else:
            self.name = str(getattr(source, "name", "the file"))
        self.file: BinaryIO = self._opened or cast(BinaryIO, source)
        self.size = _regular_size(self.file)  # None for what cannot be mapped
        self.start = 0 if self.size is None else self.file.tell()
        # One read() of the system each, so that a pipe's bytes are not waited for.
        self._read = getattr(self.file, "read1", None) or self.file.read
        self._base = 0  # the offset of the view's first byte
        self._view = memoryview(b"")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file, and close it if it was opened here."""
        self._view = memoryview(b"")  # a map holds a descriptor of its own
        if self._opened is not None:
            self._opened.close()

    @property
    def total(self) -> int | None:
        """The bytes from where the file stood to its end, None where nobody knows."""
        return None if self.size is None else max(self.size - self.start, 0)

    def at(self, offset: int, length: int) -> memoryview:
        """Return `length` bytes there, fewer at the end of the file only.

        `offset` may not lie before that of the last call. The view stays good.
        """
        begin = offset - self._base
        if begin + length > len(self._view):
            self._move(offset, length)
            begin = offset - self._base
        return self._view[begin : begin + length]

    def some(self, offset: int) -> memoryview:
        """Return the bytes there that are at hand, none at the end of the file only."""
        if offset - self._base >= len(self._view):
            self._move(offset, 1)
        return self._view[offset - self._base :]

    def map_whole(self) -> memoryview:
        """Return the bytes from where the file stood to its end in one piece; if it is mapped."""
        assert self.size is not None
        if self.size <= self.start:
            return memoryview(b"")  # nothing is there to be mapped
        whole = mmap.mmap(self.file.fileno(), self.size, access=mmap.ACCESS_READ)
        return memoryview(whole)[self.start :]

    def _move(self, offset: int, length: int) -> None:
        if self.size is None:
            self._read_on(offset, length)
            return
        place = self.start + offset
        aligned = place - place % mmap.ALLOCATIONGRANULARITY
        end = min(max(aligned + WINDOW, place + length), self.size)
        self._base, self._view = offset, memoryview(b"")
        if end > place:
            # The map goes when nobody holds the view any more.
            mapped = mmap.mmap(
                self.file.fileno(), end - aligned, access=mmap.ACCESS_READ, offset=aligned
            )
            self._view = memoryview(mapped)[place - aligned :]

    def _read_on(self, offset: int, length: int) -> None:
        # New memory: the views of the old one are in use.
        parts: list[bytes | memoryview] = [self._view[offset - self._base :]]
        held = len(parts[0])
        while held < length and (more := self._read(CHUNK)):
            parts.append(more)
            held += len(more)
        # What is read at once is not copied.
        whole = parts[1] if len(parts) == 2 and not parts[0] else b"".join(parts)
        self._base, self._view = offset, memoryview(whole)


def _regular_size(file: BinaryIO) -> int | None:
    """Return the size of a file that can be mapped, None for any other."""
    # Others may have a descriptor too, and give other bytes than it: gzip's, say.
    if not isinstance(getattr(file, "raw", file), io.FileIO):
        return None
    try:
        status = os.fstat(file.fileno())
    except (AttributeError, OSError):  # io.UnsupportedOperation is an OSError
        return None
    return status.st_size if stat.S_ISREG(status.st_mode) else None
