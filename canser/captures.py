"""Captures of raw bytes in files: read in place, of any size, in bounded memory."""

import io
import mmap
import os
import stat
from collections import deque
from collections.abc import Callable, Generator, Iterator
from typing import BinaryIO, Self, cast

import numpy as np

from canser._binding import (
    BytesLike,
    Chunk,
    Offsets,
    Pointer,
    input_bytes,
    output_room,
)
from canser.codec import Decoder, check_threads, decode
from canser.frames import FRAME_DTYPE, FrameArray

__all__ = ["Blocks", "Source", "blocks", "read"]

Source = str | os.PathLike[str] | BinaryIO

# A file is mapped piece by piece, so that its pages do not add up in the process:
# large enough that mapping costs nothing, small against any memory.
_WINDOW = 8 << 20
assert _WINDOW % mmap.ALLOCATIONGRANULARITY == 0

# What is read at a time from what cannot be mapped, such as a pipe.
_CHUNK = 1 << 18

# Frames in a block where the caller gives no `out`: 1.5 MiB, which fits a cache.
BLOCK_FRAMES = 1 << 16


def blocks(
    path_or_file: Source,
    protocol: str,
    *,
    ts_unit: str = "ms",
    out: FrameArray | None = None,
    offsets: Offsets | None = None,
    threads: int = 1,
    progress: Callable[[int, int | None], None] | None = None,
) -> "Blocks":
    """Decode a capture of any size, block by block.

    `path_or_file`: a path, or a file open for reading bytes, from where it stands. A
    regular file is mapped, a piece at a time; a pipe is read as its bytes come.
    Iterate over the result: each block is an array of FRAME_DTYPE, shape (n,), n >= 1.
    With `out` a block is `out[:n]`, good until the next; without, a new array.
    `offsets` goes with `out`: `offsets[:n]` are the stream offsets of the block.
    `threads`: how many may work on a regular file; the frames are the same for any
    number, and without `out` the blocks are cut elsewhere.
    `progress` is called after each block with the bytes done and the bytes in all
    (None where nobody knows). `.decoder` has the stats and the control packets.

    Errors as for `Decoder.feed_into`; OSError for a file that cannot be read.
    """
    if offsets is not None and out is None:
        raise ValueError("offsets goes with out: give both")
    check_threads(threads)
    decoder = Decoder(protocol, ts_unit=ts_unit)
    return Blocks(path_or_file, decoder, out, offsets, threads=threads, progress=progress)


class Blocks(Iterator[FrameArray]):
    """The blocks of a capture: an iterator, made by `blocks`; a context manager."""

    def __init__(
        self,
        path_or_file: Source,
        decoder: Decoder,
        out: FrameArray | None,
        offsets: Offsets | None,
        *,
        threads: int,
        progress: Callable[[int, int | None], None] | None,
    ) -> None:
        if out is not None:
            # A mistake shows here and not at the first block: nothing is taken.
            decoder.feed_into(b"", out, offsets)
        self.decoder = decoder
        self.bytes_done = 0
        self.bytes_total: int | None = None  # None where nobody knows
        self._out, self._offsets, self._progress = out, offsets, progress
        self._opened: BinaryIO | None = None
        if isinstance(path_or_file, (str, os.PathLike)):
            # Unbuffered: a pipe's bytes are handed on as they come.
            self._opened = file = cast(BinaryIO, open(path_or_file, "rb", buffering=0))  # noqa: PTH123, SIM115
        else:
            file = path_or_file
        size = _regular_size(file)
        if size is None:
            self._pieces = _read_pieces(file)
        else:
            start = file.tell()
            self.bytes_total = max(size - start, 0)
            self._pieces = _map_pieces(file, start, size)
        self._mapped = size is not None
        self._blocks = self._run()
        if size is not None and threads > 1:
            self._blocks = self._run_ahead(file, start, size, threads)

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> FrameArray:
        return next(self._blocks)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file, if `blocks` opened it. Done by itself at the end."""
        self._blocks.close()
        if self._opened is not None:
            self._opened.close()

    def _run_ahead(
        self, file: BinaryIO, start: int, size: int, threads: int
    ) -> Generator[FrameArray, None, None]:
        """Yield the blocks that several threads make, and the last one as `_run` does."""
        decoder = self.decoder
        sink = _Fresh(decoder) if self._out is None else _Reused(decoder, self._out, self._offsets)
        # One map for all threads; its pages are given back as the stream goes by.
        whole = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)
        kept = start - start % _WINDOW
        for _ in decoder.run_ahead(input_bytes(memoryview(whole)[start:]), sink, threads):
            self.bytes_done = decoder.position
            for block in sink.take(last=False):
                yield self._block(block, len(block))
            if start + self.bytes_done - kept > 2 * _WINDOW and hasattr(mmap, "MADV_DONTNEED"):
                whole.madvise(mmap.MADV_DONTNEED, kept, _WINDOW)
                kept += _WINDOW
        self.bytes_done = decoder.position
        for block in sink.take(last=True):
            yield self._block(block, len(block))
        self._pieces = _map_pieces(file, start + self.bytes_done, size)
        yield from self._run(sink.begun)

    def _run(self, count: int = 0) -> Generator[FrameArray, None, None]:
        """Yield the blocks of the pieces; `count` frames are in `out` already."""
        out, at = self._room()
        for piece in self._pieces:
            done = 0
            while done < len(piece):
                used, more = self.decoder.feed_into(
                    piece[done:], out[count:], None if at is None else at[count:]
                )
                done += used
                count += more
                self.bytes_done += used
                if count == len(out):
                    yield self._block(out, count)
                    (out, at), count = self._room(), 0
            # Bytes of a pipe may be long in coming: do not sit on frames.
            if count and not self._mapped:
                yield self._block(out, count)
                (out, at), count = self._room(), 0
        while True:
            if count < len(out):
                count += self.decoder.flush_into(out[count:], None if at is None else at[count:])
            if count:
                yield self._block(out, count)
                (out, at), count = self._room(), 0
            if not self.decoder.pending:
                break
        if self._opened is not None:
            self._opened.close()

    def _room(self) -> tuple[FrameArray, Offsets | None]:
        if self._out is None:
            return np.empty(BLOCK_FRAMES, FRAME_DTYPE), None
        return self._out, self._offsets

    def _block(self, out: FrameArray, count: int) -> FrameArray:
        if self._progress is not None:
            self._progress(self.bytes_done, self.bytes_total)
        # A block that is far from full would hold memory that nobody uses.
        wasteful = self._out is None and count < len(out) // 2
        return out[:count].copy() if wasteful else out[:count]


class _Fresh:
    """A new array for each block: a helper's as it is, or one that the caller fills."""

    begun = 0  # frames in a block that is not full: none, at the end

    def __init__(self, decoder: Decoder) -> None:
        self._make_chunk = decoder.make_chunk
        # In order; a place is empty until its helper has filled it.
        self._blocks: deque[list[FrameArray]] = deque()
        self._out: FrameArray | None = None
        self._count = 0

    def chunk(self) -> Chunk:
        return self._make_chunk(False)

    def room(self) -> tuple[Pointer, int, Pointer]:
        if self._out is None:
            self._out, self._count = np.empty(BLOCK_FRAMES, FRAME_DTYPE), 0
        return output_room(self._out, self._count, None)

    def wrote(self, count: int) -> None:
        self._count += count
        if self._out is not None and self._count == len(self._out):
            self._close()

    def place(self, chunk: Chunk) -> Callable[[], None]:
        self._close()
        place: list[FrameArray] = []
        self._blocks.append(place)
        # Made here, for memory that this thread has freed is taken again; a helper's is not.
        room = chunk.make_room()
        return lambda: place.append(chunk.hand_over(room))

    def take(self, *, last: bool) -> Iterator[FrameArray]:
        """Yield the blocks that are ready, in order; the last time all are."""
        if last:
            self._close()
        while self._blocks and self._blocks[0]:
            (block,) = self._blocks.popleft()
            if len(block):
                yield block

    def _close(self) -> None:
        if self._out is not None and self._count:
            self._blocks.append([self._out[: self._count]])
            self._out = None


class _Reused:
    """The caller's array, filled again and again."""

    def __init__(self, decoder: Decoder, out: FrameArray, offsets: Offsets | None) -> None:
        self._make_chunk = decoder.make_chunk
        self._out, self._offsets = out, offsets
        self.begun = 0  # frames in `out`
        # Of a helper's frames those that `out` had no room for.
        self._rest = np.empty(0, FRAME_DTYPE)
        self._rest_offsets = np.empty(0, np.int64)

    def chunk(self) -> Chunk:
        return self._make_chunk(self._offsets is not None)

    def room(self) -> tuple[Pointer, int, Pointer]:
        return output_room(self._out, self.begun, self._offsets)

    def wrote(self, count: int) -> None:
        self.begun += count

    def place(self, chunk: Chunk) -> Callable[[], None]:
        # Copied here and now: the helper may take its room again.
        self._rest = chunk.hand_over(chunk.make_room())
        if chunk.offsets is not None:
            self._rest_offsets = chunk.offsets[: len(self._rest)].copy()
        self._refill()
        return lambda: None

    def take(self, *, last: bool) -> Iterator[FrameArray]:  # noqa: ARG002 - as _Fresh
        """Yield `out` as often as it is full."""
        while self.begun == len(self._out):
            block, self.begun = self._out[: self.begun], 0
            yield block
            self._refill()

    def _refill(self) -> None:
        begin = self.begun
        fits = min(len(self._rest), len(self._out) - begin)
        self._out[begin : begin + fits] = self._rest[:fits]
        self._rest = self._rest[fits:]
        if self._offsets is not None:
            self._offsets[begin : begin + fits] = self._rest_offsets[:fits]
            self._rest_offsets = self._rest_offsets[fits:]
        self.begun += fits


def read(
    path: Source,
    protocol: str,
    *,
    ts_unit: str = "ms",
    offsets: Offsets | None = None,
    threads: int = 1,
) -> FrameArray:
    """Decode a whole capture file into one new array.

    `path`: a path, or a file open for reading bytes, from where it stands. The file is
    mapped, never read as a whole. Returns FRAME_DTYPE, shape (n,). `ts_unit`,
    `offsets`, `threads` and errors as for `decode`; OSError for a file that cannot be
    read. For files larger than memory, and for the counters, use `blocks`.
    """
    check_threads(threads)
    if not isinstance(path, (str, os.PathLike)):
        return _read_file(path, protocol, ts_unit, offsets, threads)
    with open(path, "rb", buffering=0) as file:  # noqa: PTH123
        return _read_file(cast(BinaryIO, file), protocol, ts_unit, offsets, threads)


def _read_file(
    file: BinaryIO, protocol: str, ts_unit: str, offsets: Offsets | None, threads: int
) -> FrameArray:
    size = _regular_size(file)
    if size is None:
        data: BytesLike = file.read()
    elif size <= (start := file.tell()):
        data = b""  # nothing is there to be mapped
    else:
        whole = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)
        data = memoryview(whole)[start:]
    return decode(data, protocol, ts_unit=ts_unit, offsets=offsets, threads=threads)


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


def _map_pieces(file: BinaryIO, start: int, size: int) -> Iterator[memoryview]:
    """Yield the bytes of a regular file as windows of it."""
    for window in range(start - start % _WINDOW, size, _WINDOW):
        length = min(_WINDOW, size - window)
        # The map goes when nobody holds the view any more.
        piece = mmap.mmap(file.fileno(), length, access=mmap.ACCESS_READ, offset=window)
        yield memoryview(piece)[max(start - window, 0) :]


def _read_pieces(file: BinaryIO) -> Iterator[memoryview]:
    """Yield the bytes of any other file as they come."""
    # One read() of the system each, so that a pipe's bytes are not waited for.
    take = getattr(file, "readinto1", None) or getattr(file, "readinto", None)
    if take is None:
        while data := file.read(_CHUNK):
            yield memoryview(data)
        return
    room = bytearray(_CHUNK)
    while count := take(room):
        yield memoryview(room)[:count]
