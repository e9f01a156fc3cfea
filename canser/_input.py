"""Files to read: opened, read or mapped; their bytes by offset, in bounded memory."""

import errno
import io
import mmap
import os
import stat
import sys
import threading
from typing import BinaryIO, Self, cast

from canser._named import named

__all__ = ["WINDOW", "Input", "Source", "Stream"]

# A file to read: a path, or a file open for reading bytes, from its current position on.
Source = str | os.PathLike[str] | BinaryIO

# Bytes of a window. A file is mapped one window at a time, so that its pages do not add up in the
# process. It is large enough that mapping costs nothing, and small compared with any memory.
WINDOW = 8 << 20
assert WINDOW % mmap.ALLOCATIONGRANULARITY == 0

# Bytes read at a time from a regular file: enough that a system call costs nothing, and few enough
# that they are still in the processor's cache when they are looked at.
READ = 1 << 20

# Bytes read at a time from other files, such as a pipe.
CHUNK = 1 << 18

# Bytes that `ahead` has at hand before the end of the file: more than a block of a recording.
AHEAD = 1 << 17

# For systems where a file has only one position: two threads may read the same file.
_SEEKING = threading.Lock()

# Bytes at the start that are kept of a file that cannot be read twice: enough to tell its format.
HEAD_LEN = 1 << 16


class Input:
    """The bytes of a file by their offsets, a part at a time, going forward.

    Offsets count from the file's position at the start. Bytes before the last offset asked for are
    forgotten. An Input is a context manager: at the end it closes a file that was given by a path.

    The size of a regular file is measured again before each part of it; OSError if the file got
    shorter. After `map_windows` and `map_whole` such a file is mapped. If it gets shorter while a
    window is being read, the system ends the process (SIGBUS). No program can prevent that for a
    mapped file. Copy a file that another program may cut, or pass it opened by `gzip.open`, as a
    pipe or as `io.BytesIO`.

    TypeError for a source that is no path and no file open for reading bytes.
    """

    def __init__(self, source: Source, *, below: "Input | None" = None) -> None:
        """Open a file; `below` is an Input that `source` reads: it is closed, too, at the end."""
        _check_source(source)
        self._below = below
        self._opened: BinaryIO | None = None
        if isinstance(source, (str, os.PathLike)):
            # Unbuffered, so that a pipe's bytes are given as they come.
            self._opened = cast(BinaryIO, open(source, "rb", buffering=0))  # noqa: PTH123, SIM115
            self.name = os.fsdecode(source)
        else:
            name = getattr(source, "name", "the file")
            self.name = "standard input" if name == "<stdin>" else str(name)
        self.file: BinaryIO = self._opened or cast(BinaryIO, source)
        self.size = _regular_size(self.file)  # None for a file that is read as a pipe
        self.start = 0 if self.size is None else self.file.tell()
        # One system call each, so that a read of a pipe does not wait for more bytes.
        self._read = getattr(self.file, "read1", None) or self.file.read
        self._base = 0  # the offset of the view's first byte
        self._view = memoryview(b"")
        self._memory = bytearray()  # into which a regular file is read
        self._mapped = False
        self._head = bytearray()  # the first bytes of a file that is read as a pipe

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file; close it if it was opened here."""
        self._view = memoryview(b"")  # a map holds a descriptor of its own
        self._memory = bytearray()
        if self._below is not None:
            self._below.close()
        if self._opened is not None:
            self._opened.close()

    @property
    def total(self) -> int | None:
        """The bytes from the first position of the file to its end, None if that is not known."""
        return None if self.size is None else max(self.size - self.start, 0)

    def at(self, offset: int, length: int) -> memoryview:
        """Return `length` bytes from an offset; fewer only at the end of the file.

        `offset` may not lie before that of the last call. The view stays good.
        """
        begin = offset - self._base
        if begin + length > len(self._view):
            self._move(offset, length)
            begin = offset - self._base
        return self._view[begin : begin + length]

    def some(self, offset: int) -> memoryview:
        """Return the bytes from an offset that are at hand; none only at the end of the file."""
        if offset - self._base >= len(self._view):
            self._move(offset, 1)
        return self._view[offset - self._base :]

    def ahead(self, offset: int) -> memoryview:
        """Return the bytes from an offset that are at hand; of a regular file, many.

        The memory is that of the calls before: views that were given before become invalid.
        """
        end = self._base + len(self._view)
        if self.total is not None and end - offset < AHEAD and end < self.total:
            self._move(offset, 0, self._memory)
        return self.some(offset)

    def read_at(self, offset: int, room: memoryview) -> int:
        """Read bytes of a regular file into a room; return their number. For any thread.

        Less than the room has only where the file ends.
        """
        filled = 0
        while filled < len(room):
            count = _read_at(self.file, room[filled:], self.start + offset + filled)
            if not count:
                break
            filled += count
        return filled

    def map_windows(self) -> None:
        """Map a regular file from now on, instead of reading it; so its bytes are not copied."""
        self._mapped = self.size is not None
        if self._mapped:
            self._base, self._view = 0, memoryview(b"")

    def stream(self) -> "Stream":
        """Return the bytes from the first on, as a file."""
        return Stream(self)

    def map_whole(self) -> memoryview:
        """Return all bytes of a regular file in one piece, from its first position on."""
        assert self.size is not None
        if self.size <= self.start:
            return memoryview(b"")  # an empty part cannot be mapped
        self.check_size()
        with named(self.name):
            whole = mmap.mmap(self.file.fileno(), self.size, access=mmap.ACCESS_READ)
        return memoryview(whole)[self.start :]

    def sample(self) -> memoryview:
        """Return bytes that tell the format: all of a regular file, else the first ones."""
        return self.map_whole() if self.size is not None else memoryview(self._head).toreadonly()

    def check_size(self) -> None:
        """Raise OSError if a regular file is shorter than when it was opened."""
        assert self.size is not None
        size = os.fstat(self.file.fileno()).st_size
        if size < self.size:
            raise OSError(
                errno.EIO,
                f"it got shorter while it was read: {size:,} of {self.size:,} bytes are left; copy "
                "a file that another program changes, and read the copy",
                self.name,
            )

    def _move(self, offset: int, length: int, memory: bytearray | None = None) -> None:
        with named(self.name):
            if self.size is None:
                self._read_on(offset, length)
            elif self._mapped:
                self._map(self.size, offset, length)
            else:
                # Without a memory a new one is made: views of the old one are in use.
                self._read_window(self.size, offset, length, memory or bytearray())

    def _map(self, size: int, offset: int, length: int) -> None:
        self.check_size()
        place = self.start + offset
        aligned = place - place % mmap.ALLOCATIONGRANULARITY
        end = min(max(aligned + WINDOW, place + length), size)
        self._base, self._view = offset, memoryview(b"")
        if end > place:
            # The map ends with its last view.
            mapped = mmap.mmap(
                self.file.fileno(), end - aligned, access=mmap.ACCESS_READ, offset=aligned
            )
            self._view = memoryview(mapped)[place - aligned :]

    def _read_window(self, size: int, offset: int, length: int, memory: bytearray) -> None:
        """Read the part of a file behind the bytes at hand, all of it into one memory."""
        self.check_size()
        held = self._view[offset - self._base :]
        place = self.start + offset
        end = min(max(place + len(held) + READ, place + length), size)
        wanted = max(end - place, 0)
        room = memoryview(memory if len(memory) >= wanted else bytearray(wanted + AHEAD))
        filled = len(held)
        room[:filled] = held
        filled += self.read_at(offset + filled, room[filled:wanted])
        if filled < wanted:
            self.check_size()
        self._base, self._view = offset, room[:filled].toreadonly()
        self._memory = cast(bytearray, room.obj)

    def _read_on(self, offset: int, length: int) -> None:
        if type(self.file) is io.BytesIO and not self._head:
            # Shared with the file, not copied.
            self._view = memoryview(self.file.getvalue())[self.file.tell() :]
            self.file.seek(0, io.SEEK_END)
            self._head += self._view[:HEAD_LEN]
            return
        # New memory, as views of the old one are in use.
        parts: list[bytes | memoryview] = [self._view[offset - self._base :]]
        held = len(parts[0])
        while held < length and (more := self._read(CHUNK)):
            parts.append(more)
            held += len(more)
            if len(self._head) < HEAD_LEN:
                self._head += more[: HEAD_LEN - len(self._head)]
        # A part that was read at once is not copied.
        whole = parts[1] if len(parts) == 2 and not parts[0] else b"".join(parts)
        self._base, self._view = offset, memoryview(whole)


class Stream(io.RawIOBase):
    """The bytes of an Input as a file; `bytes_done` is the number of bytes that were read."""

    def __init__(self, source: Input) -> None:
        super().__init__()
        self._source = source
        self.bytes_done = 0

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, room: memoryview) -> int:  # type: ignore[override]
        """Read the bytes that are at hand; return their number, 0 at the end."""
        piece = self._source.ahead(self.bytes_done)[: len(room)]
        room[: len(piece)] = piece
        self.bytes_done += len(piece)
        return len(piece)


def _read_by_seeking(file: BinaryIO, room: memoryview, place: int) -> int:
    """Read bytes of a regular file from a place on; return their number, 0 at the end."""
    raw = cast(io.FileIO, getattr(file, "raw", file))
    with _SEEKING:
        before = raw.tell()
        try:
            raw.seek(place)
            return raw.readinto(room) or 0
        finally:
            raw.seek(before)


if sys.platform != "win32" and hasattr(os, "preadv"):  # macOS has it from 11 on

    def _read_at(file: BinaryIO, room: memoryview, place: int) -> int:
        """Read bytes of a regular file from a place on; return their number, 0 at the end."""
        return os.preadv(file.fileno(), [room], place)
else:
    _read_at = _read_by_seeking


def _check_source(source: object) -> None:
    """Raise TypeError unless this is a path or a file open for reading bytes."""
    if isinstance(source, (str, os.PathLike)):
        return
    wanted = "give a path, or a file open for reading bytes"
    if isinstance(source, io.TextIOBase):
        name = getattr(source, "name", "the file")
        raise TypeError(f"{name} is open for text; open it for bytes: open(path, 'rb')")
    if isinstance(source, (bytes, bytearray, memoryview, mmap.mmap)):
        raise TypeError(f"{wanted}, not {type(source).__name__}; canser.decode takes the bytes")
    if isinstance(source, int) and not isinstance(source, bool):
        raise TypeError(f"{wanted}, not a descriptor; open it: open({source}, 'rb')")
    if not callable(getattr(source, "read", None)):
        raise TypeError(f"{wanted}, not {type(source).__name__}")
    readable = getattr(source, "readable", None)
    if callable(readable) and not getattr(source, "closed", False) and not readable():
        raise TypeError(f"{getattr(source, 'name', 'the file')} is not open for reading; {wanted}")


def _regular_size(file: BinaryIO) -> int | None:
    """Return the size of a file that can be mapped, None for any other.

    A file of size 0 is read as a pipe: files of /proc, and some of FUSE, do not know their size.
    """
    # Other objects may have a descriptor, too, and give other bytes than it, such as gzip's.
    if not isinstance(getattr(file, "raw", file), io.FileIO):
        return None
    try:
        status = os.fstat(file.fileno())
    except (AttributeError, OSError):  # io.UnsupportedOperation is an OSError
        return None
    return status.st_size or None if stat.S_ISREG(status.st_mode) else None
