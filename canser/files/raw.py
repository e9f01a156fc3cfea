"""Raw bytes of an adapter's line: decoded and encoded in one of the protocols.

The bytes do not name their protocol: it is given, or found by `identify`.
"""

import mmap
from collections import deque
from collections.abc import Callable, Generator, Iterator
from typing import BinaryIO, Final

import numpy as np

from canser import _input
from canser._core.buffers import Offsets, Pointer, input_bytes, output_room
from canser._core.stream import ParallelChunk
from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray, copy_records, put_records
from canser._input import Input
from canser._protocols import protocol, tick_ns
from canser.codec.decoder import Decoder, Encoder, decode_pieces, decode_with
from canser.codec.refusals import Refusals
from canser.errors import FormatError
from canser.files.judge import choose_protocol, describe_doubt
from canser.files.reader import Reader, ReadOptions
from canser.files.writer import WriteOptions

__all__ = ["BLOCK_FRAMES", "RawReader", "RawWriter"]

about: Final = "raw bytes"

cannot_hold: Final = ("what the protocol has no place for, such as times",)

# Ticks that the counter of a device counts before it wraps: 32 bits in all protocols.
_CLOCK_TICKS: Final = 1 << 32

# The most bytes that get one time. They hold fewer frames than this, so the arrays for the frames
# of one step have this length, too.
_STEP_LEN: Final = 1 << 10

# Frames in a block if the caller gives no `out`: 1.5 MiB of records, which fit a cache.
BLOCK_FRAMES = 1 << 16


def sniff(head: bytes) -> bool:  # noqa: ARG001 - as for every format
    """Return False: raw bytes have no sign at their start."""
    return False


def read(source: Input, options: ReadOptions) -> "RawReader":
    """Open raw bytes.

    Raises
    ------
    NoProtocolError
        No protocol is given, or "auto" finds none that fits well enough.
    """
    return RawReader(source, options)


class RawReader(Reader):
    """Reads raw bytes. A regular file is mapped, one window at a time."""

    decoder: Decoder

    def __init__(self, source: Input, options: ReadOptions) -> None:
        source.map_windows()
        self._source, self._threads = source, options.threads or 1
        self._out, self._offsets = options.out, options.offsets
        name, self.found = choose_protocol(options.protocol, source)
        unit = "ms" if options.ts_unit is None else options.ts_unit
        self.decoder = Decoder(name, ts_unit=unit)
        # The decoder's `position` and `skipped` at the start of this file.
        self._begin = self._begin_skipped = 0
        self._ended_doubt: str | None = None  # None before the end

    def carry_on(self, last: Reader) -> bool:
        """Continue the stream of the file before; return False if it is of another protocol."""
        if not isinstance(last, RawReader) or repr(last.decoder) != repr(self.decoder):
            return False
        self.decoder = last.decoder
        self._begin, self._begin_skipped = self.decoder.position, self.decoder.skipped
        return True

    def blocks(self, ends: Callable[[], bool]) -> Iterator[FrameArray]:
        """Yield the frames, block by block."""
        ahead = self._source.size is not None and self._threads > 1
        yield from self._run_ahead(ends) if ahead else self._run(ends)

    def read_all(self, offsets: Offsets | None) -> FrameArray:
        """Return all frames in one array."""
        source = self._source
        if source.total is None:
            frames = decode_with(self.decoder, b"".join(_windows(source)), offsets=offsets)
        elif self._threads == 1:
            frames = decode_pieces(self.decoder, _windows(source), source.total, offsets)
        else:
            whole = source.map_whole()
            frames = decode_with(self.decoder, whole, offsets=offsets, threads=self._threads)
        self._end()
        return frames

    @property
    def doubt(self) -> str:
        """Why the bytes so far are not of the protocol that they are read in; "" if they may be."""
        if self._ended_doubt is not None:
            return self._ended_doubt
        decoder = self.decoder
        bytes_in, skipped = decoder.position - self._begin, decoder.skipped - self._begin_skipped
        sample = self._source.sample()
        return describe_doubt(self._source.name, decoder.protocol, bytes_in, skipped, sample)

    def close(self) -> None:
        """End the reading. A file that was not read to its end gets no `doubt`."""
        if self._ended_doubt is None:
            self._ended_doubt = ""

    def sample(self) -> memoryview:
        """Return bytes of the file: all of a regular file, the first 64 KiB of a pipe.

        Waits for these bytes, or for the end of the pipe. Call it before the first block.
        """
        if self._source.size is None:
            self._source.at(0, _input.HEAD_LEN)
        return self._source.sample()

    def timed_bytes(self) -> Iterator[tuple[memoryview, int]]:
        """Yield all bytes in pieces with the time of their last byte, in nanoseconds.

        The time is that of the device's clock if frames carry it; otherwise it follows from the
        baud rate. The bytes are also decoded.
        """
        timed = protocol(self.decoder.protocol)
        byte_ns = 10e9 / timed.baudrate  # a start bit, 8 bits, a stop bit
        out, at = np.empty(_STEP_LEN, FRAME_DTYPE), np.empty(_STEP_LEN, np.int64)
        ns = 0
        while len(piece := self._source.some(self.bytes_done)[:_STEP_LEN]):
            begin, end = self.bytes_done, self.bytes_done + len(piece)
            _, count = self.decoder.feed_into(piece, out, at)
            self.bytes_done = end
            cuts = []
            if timed.has_clock:
                # A frame's time is given to its first byte and to all bytes up to the next frame.
                cuts = list(zip(at[:count].tolist(), out["ts"][:count].tolist(), strict=True))
            else:
                ns = round(end * byte_ns)
            for cut, next_ns in cuts:
                if cut > begin:
                    yield piece[begin - end + len(piece) : cut - end + len(piece)], ns
                    begin = cut
                ns = max(next_ns, 0)
            yield piece[begin - end + len(piece) :], ns
        self.decoder.flush_into(out)
        self._end()

    def _run_ahead(self, ends: Callable[[], bool]) -> Generator[FrameArray, None, None]:
        """Yield the blocks that several threads decode; the last one as `_run` does."""
        decoder = self.decoder
        sink = _Fresh(decoder) if self._out is None else _Reused(decoder, self._out, self._offsets)
        # One map for all threads. Pages that were decoded are given back to the system.
        whole = self._source.map_whole()
        kept, start, window = 0, self._source.start, _input.WINDOW
        # Helper threads need a decoder without pending bytes. A packet that began in the file
        # before is therefore finished first, by this thread.
        if decoder.pending:
            yield from self._finish_packet(whole)
        first = self.bytes_done
        if decoder.pending:  # the whole file lies within that packet
            yield from self._run(ends)
            return
        for _ in decoder.run_ahead(input_bytes(whole[first:]), sink, self._threads):
            self._source.check_size()
            self.bytes_done = decoder.position - self._begin
            for block in sink.take(last=False):
                yield block
            if start + self.bytes_done - kept > 2 * window and hasattr(mmap, "MADV_DONTNEED"):
                mapped = whole.obj
                assert isinstance(mapped, mmap.mmap)
                mapped.madvise(mmap.MADV_DONTNEED, kept, window)
                kept += window
        self.bytes_done = decoder.position - self._begin
        for block in sink.take(last=True):
            yield block
        yield from self._run(ends, sink.begun)

    def _finish_packet(self, whole: memoryview) -> Iterator[FrameArray]:
        """Decode byte by byte until no bytes are pending."""
        out, at = self._room()
        while self.decoder.pending and self.bytes_done < len(whole):
            byte = whole[self.bytes_done : self.bytes_done + 1]
            used, count = self.decoder.feed_into(byte, out, at)
            self.bytes_done += used
            if count:
                yield out[:count]
                out, at = self._room()

    def _run(self, ends: Callable[[], bool], count: int = 0) -> Generator[FrameArray, None, None]:
        """Yield the blocks. `count`: frames that are already in `out`."""
        decoder = self.decoder
        out, at = self._room()
        while len(piece := self._source.some(self.bytes_done)):
            done = 0
            while done < len(piece):
                used, more = decoder.feed_into(
                    piece[done:], out[count:], None if at is None else at[count:]
                )
                done += used
                count += more
                self.bytes_done += used
                if count == len(out):
                    yield out
                    (out, at), count = self._room(), 0
                    # The file may have become shorter while the caller used the block.
                    if self._source.size is not None:
                        self._source.check_size()
            # Otherwise frames would wait until more bytes of the pipe arrive.
            if count and self._source.size is None:
                yield out[:count]
                (out, at), count = self._room(), 0
        if not ends():
            if count:
                yield out[:count]
            self._end()
            return
        while True:
            if count < len(out):
                count += decoder.flush_into(out[count:], None if at is None else at[count:])
            if count:
                yield out[:count]
                (out, at), count = self._room(), 0
            if not decoder.pending:
                break
        self._end()

    def _end(self) -> None:
        """Keep the `doubt`: after the end the bytes cannot be read again."""
        self._ended_doubt = self.doubt

    def _room(self) -> tuple[FrameArray, Offsets | None]:
        if self._out is None:
            return np.empty(BLOCK_FRAMES, FRAME_DTYPE), None
        return self._out, self._offsets


def _windows(source: Input) -> Iterator[memoryview]:
    """Yield all bytes of a file, one window at a time."""
    at = 0
    while len(piece := source.some(at)):
        yield piece
        at += len(piece)


class _Fresh:
    """Makes a new array for each block: the one of a helper thread, or one for this thread."""

    begun = 0  # frames in a block that is not full; at the end there is none

    def __init__(self, decoder: Decoder) -> None:
        self._make_chunk = decoder.make_chunk
        # Blocks in order. A list is empty until its helper thread has decoded the block.
        self._blocks: deque[list[FrameArray]] = deque()
        self._out: FrameArray | None = None
        self._count = 0

    def chunk(self) -> ParallelChunk:
        return self._make_chunk(False)

    def room(self) -> tuple[Pointer, int, Pointer]:
        if self._out is None:
            self._out, self._count = np.empty(BLOCK_FRAMES, FRAME_DTYPE), 0
        return output_room(self._out, self._count, None)

    def wrote(self, count: int) -> None:
        self._count += count
        if self._out is not None and self._count == len(self._out):
            self._close()

    def place(self, chunk: ParallelChunk) -> Callable[[], None]:
        self._close()
        place: list[FrameArray] = []
        self._blocks.append(place)
        # Made by this thread: the allocator reuses memory that this thread has freed. Memory of a
        # helper thread would not be reused.
        room = chunk.make_room()
        return lambda: place.append(chunk.hand_over(room))

    def take(self, *, last: bool) -> Iterator[FrameArray]:
        """Yield the blocks that are ready, in order. With `last` all are ready."""
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
    """Fills the caller's array again for each block."""

    def __init__(self, decoder: Decoder, out: FrameArray, offsets: Offsets | None) -> None:
        self._make_chunk = decoder.make_chunk
        self._out, self._offsets = out, offsets
        self.begun = 0  # frames in `out`
        # Frames of a helper thread that `out` had no room for.
        self._rest = np.empty(0, FRAME_DTYPE)
        self._rest_offsets = np.empty(0, np.int64)

    def chunk(self) -> ParallelChunk:
        return self._make_chunk(self._offsets is not None)

    def room(self) -> tuple[Pointer, int, Pointer]:
        return output_room(self._out, self.begun, self._offsets)

    def wrote(self, count: int) -> None:
        self.begun += count

    def place(self, chunk: ParallelChunk) -> Callable[[], None]:
        # Copied now, because the helper thread may reuse its array afterwards.
        self._rest = chunk.hand_over(chunk.make_room())
        if chunk.offsets is not None:
            self._rest_offsets = chunk.offsets[: len(self._rest)].copy()
        self._refill()
        return lambda: None

    def take(self, *, last: bool) -> Iterator[FrameArray]:  # noqa: ARG002 - as _Fresh
        """Yield `out` each time that it is full."""
        while self.begun == len(self._out):
            block, self.begun = self._out[: self.begun], 0
            yield block
            self._refill()

    def _refill(self) -> None:
        begin = self.begun
        fits = min(len(self._rest), len(self._out) - begin)
        put_records(self._out[begin : begin + fits], self._rest[:fits])
        self._rest = self._rest[fits:]
        if self._offsets is not None:
            self._offsets[begin : begin + fits] = self._rest_offsets[:fits]
            self._rest_offsets = self._rest_offsets[fits:]
        self.begun += fits


def write(file: BinaryIO, options: WriteOptions) -> "RawWriter":
    """Begin a file of raw bytes."""
    return RawWriter(file, options)


class RawWriter:
    """Writes frames as the raw bytes of a protocol.

    If the protocol's clock cannot count to the time of the first frame, such as a date, times are
    written relative to the first frame. Frames that the protocol cannot carry are left out; with
    `strict` they raise ValueError. FormatError at the end if the protocol can carry none.
    """

    def __init__(self, file: BinaryIO, options: WriteOptions) -> None:
        assert options.protocol is not None
        self._file, self._strict = file, options.strict
        self._protocol = protocol(options.protocol)
        self._tick_ns = tick_ns(options.ts_unit)
        self._encoder = Encoder(options.protocol, ts_unit=options.ts_unit)
        self._refusals = Refusals(options.protocol)
        self._remarks: list[str] = []
        self._start_ns = 0  # subtracted from each time
        self.frames = self.bytes_out = 0

    def write(self, frames: FrameArray) -> None:
        """Append the frames that the protocol can carry."""
        kept = frames if self._strict else self._refusals.keep(frames)
        if not len(kept):
            return
        if self._protocol.has_clock:
            kept = self._shifted(kept)
        raw = self._encoder.encode(kept)
        self._file.write(raw.data)
        self.frames += len(kept)
        self.bytes_out += len(raw)

    def _shifted(self, frames: FrameArray) -> FrameArray:
        """Return frames with times that the protocol's clock can count."""
        if not self.frames:
            first = int(frames["ts"][0])
            if first != NO_TIME and not 0 <= first // self._tick_ns < _CLOCK_TICKS:
                self._start_ns = first
                self._remarks.append("times are written relative to the first frame")
        if not self._start_ns:
            return frames
        shifted = copy_records(frames)
        shifted["ts"][frames["ts"] != NO_TIME] -= self._start_ns
        return shifted

    def finish(self) -> list[str]:
        """Return remarks on what the bytes do not hold."""
        name, refusals = self._protocol.name, self._refusals
        if refusals.left_out and not self.frames:
            raise FormatError(
                f"{name} can carry none of the {refusals.frames:,} frames: {refusals.reasons}; "
                "convert to another protocol"
            )
        if refusals.left_out:
            self._remarks.append(str(refusals))
        if not self._protocol.has_clock and self.frames:
            self._remarks.append(f"{name} carries no times")
        return self._remarks
