"""Captures in files, raw bytes or recordings: read in place, of any size, in bounded memory."""

import mmap
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator
from typing import Self

import numpy as np

from canser import _input
from canser._core.buffers import Offsets, Pointer, input_bytes, output_offsets, output_room
from canser._core.stream import Chunk
from canser._frames import FRAME_DTYPE, FrameArray, copy_records, put_records
from canser._guards import Uncopied
from canser._input import Input, Source
from canser._protocols import protocols
from canser.codec.decoder import Decoder, check_threads, decode_pieces, decode_with
from canser.errors import CanserWarning, WrongProtocolError
from canser.files.judge import (
    check_protocol,
    choose_protocol,
    describe_doubt,
    is_auto,
)
from canser.recording.recorded import RecordedFrames
from canser.recording.recording import Recording, RecordingInfo, starts_recording

__all__ = ["Blocks", "Source", "blocks", "read"]

# Frames in a block where the caller gives no `out`: 1.5 MiB, which fits a cache.
BLOCK_FRAMES = 1 << 16


def blocks(
    path_or_file: Source,
    protocol: str | None = None,
    *,
    ts_unit: str | None = None,
    out: FrameArray | None = None,
    offsets: Offsets | None = None,
    threads: int = 1,
    progress: Callable[[int, int | None], None] | None = None,
    as_is: bool = False,
) -> "Blocks":
    """Decode a capture of any size, block by block.

    `path_or_file`: a path, or a file open for reading bytes, from where it stands. A
    regular file is mapped, a piece at a time; a pipe is read as its bytes come. What it
    holds shows by its first bytes: a recording knows its protocol and its `ts_unit`, and
    gives its frames host times, epoch nanoseconds; raw bytes need the `protocol`, and have
    device times of `ts_unit`, "ms" if that is not given. The protocol "auto" is the one that
    fits raw bytes with a score of 0.9 at least, as `identify` tells; a CanserWarning says which.
    Iterate over the result: each block is an array of FRAME_DTYPE, shape (n,), n >= 1.
    With `out` a block is `out[:n]`, good until the next; without, a new array.
    `offsets` goes with `out`: `offsets[:n]` are the stream offsets of the block.
    `threads`: how many may work on a regular file of raw bytes, as for `decode`; the frames are
    the same for any number, and without `out` the blocks are cut elsewhere.
    `progress` is called after each block with the bytes done and the bytes in all
    (None where nobody knows). `.decoder` has the stats and the control packets.

    A CanserWarning at the end tells where so many bytes lie in no packet that the protocol is
    not theirs: half of 1,000 or more (in `cantalope` 4.6 %, 0.4 of what random bytes give).
    `as_is`: read the bytes in that protocol whatever they look like, without this warning,
    though they are plainly another format's or a recording says another protocol.

    Errors as for `Decoder.feed_into`; NoProtocolError, a ValueError, for raw bytes without
    a protocol; FormatError for a file of another format; RecordingError for pcapng that is
    none of canser's; ValueError for another protocol than a recording's own; TypeError for
    what is no path and no file open for reading bytes; OSError for a file that cannot be read,
    or gets shorter meanwhile. (If it gets shorter in the milliseconds in which a block of it is
    decoded the system ends the process: copy a file that another program may cut.)
    """
    if offsets is not None and out is None:
        raise ValueError("offsets goes with out: give both")
    threads = check_threads(threads)
    # A mistake shows here and not at the first block: nothing is opened.
    check_protocol(protocol, ts_unit)
    if out is not None:
        Decoder(protocols()[0]).feed_into(b"", out, offsets)
    return Blocks(
        path_or_file,
        protocol,
        ts_unit,
        out,
        offsets,
        threads=threads,
        progress=progress,
        as_is=as_is,
        warns=True,
    )


class Blocks(Uncopied, Iterator[FrameArray]):
    """The blocks of a capture: an iterator, made by `blocks`; a context manager."""

    def __init__(
        self,
        path_or_file: Source,
        protocol: str | None,
        ts_unit: str | None,
        out: FrameArray | None,
        offsets: Offsets | None,
        *,
        threads: int,
        progress: Callable[[int, int | None], None] | None,
        as_is: bool,
        warns: bool,
        raw_only: bool = False,
    ) -> None:
        """Open a capture, as `blocks` does.

        `warns`: CanserWarnings tell of the bytes, else `found` and `doubt` do. `raw_only`:
        `protocol` and `ts_unit` are those of raw bytes, and a recording has its own.
        """
        self._protocol, self._ts_unit, self._threads = protocol, ts_unit, threads
        self._as_is, self._warns, self._raw_only = as_is, warns, raw_only
        self._found = ""
        self._ended_doubt: str | None = None  # None before the end
        self._out, self._offsets, self._progress = out, offsets, progress
        self._input = Input(path_or_file)
        self.bytes_done = 0
        self.bytes_total = self._input.total  # None where nobody knows
        self._recorded: RecordedFrames | None = None
        self._decoder: Decoder | None = None
        self._blocks: Generator[FrameArray, None, None] | None = None
        # A pipe that needs not be asked is not waited for.
        if protocol is None or self._input.size is not None:
            try:
                self._begin(stacklevel=4)
            except BaseException:
                self._input.close()
                raise

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> FrameArray:
        try:
            return next(self._begin())
        except StopIteration:
            if self._warns and not self._as_is and self.doubt:
                warnings.warn(f"{self.doubt}; as_is=True accepts them", CanserWarning, stacklevel=2)
            self._warns = False  # once
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file, if `blocks` opened it. Done by itself at the end."""
        if self._blocks is not None:
            self._blocks.close()
        if self._ended_doubt is None:
            self._ended_doubt = ""  # bytes that were not read to their end are not judged
        self._input.close()

    @property
    def decoder(self) -> Decoder:
        """The decoder, for the stats and the control packets; a pipe is waited for."""
        self._begin()
        assert self._decoder is not None
        return self._decoder

    @property
    def recording(self) -> RecordingInfo | None:
        """What a recording knows of its line, None for raw bytes; a pipe is waited for."""
        self._begin()
        return None if self._recorded is None else self._recorded.info

    @property
    def found(self) -> str:
        """Which protocol "auto" has found, "" if it was given; a pipe is waited for."""
        self._begin()
        return self._found

    @property
    def remarks(self) -> list[str]:
        """What a caller should know of a recording so far: what is damaged, what is lost."""
        return [] if self._recorded is None else self._recorded.remarks

    def sample(self) -> memoryview:
        """Return bytes of the file: all that can be mapped, of a pipe the first 64 KiB.

        They are waited for, or for the end of the pipe. Before the first block only.
        """
        if self._input.size is None:
            self._input.at(0, _input.HEAD_LEN)
        return self._input.sample()

    @property
    def doubt(self) -> str:
        """Why the bytes so far are not of the protocol they are read in; "" if they may be."""
        if self._ended_doubt is not None:
            return self._ended_doubt
        if self._decoder is None:
            return ""
        recorded = self._recorded
        sample = self._input.sample() if recorded is None else recorded.head
        return describe_doubt(self._input.name, self._decoder, sample)

    def _begin(self, stacklevel: int = 3) -> Generator[FrameArray, None, None]:
        """Look what the file holds, unless that is known; return the blocks."""
        if self._blocks is None:
            if starts_recording(self._input):
                self._recorded = _open_recording(
                    self._input,
                    None if self._raw_only else self._protocol,
                    None if self._raw_only else self._ts_unit,
                    live=self._input.size is None,
                    as_is=self._as_is,
                )
                self._decoder = self._recorded.decoder
                self._blocks = self._run_recorded(self._recorded)
            else:
                protocol, self._found = choose_protocol(
                    self._protocol, self._input, as_is=self._as_is
                )
                if self._found and self._warns:
                    text = f"{self._input.name}: {self._found}"
                    warnings.warn(text, CanserWarning, stacklevel=stacklevel)
                unit = "ms" if self._ts_unit is None else self._ts_unit
                self._decoder = Decoder(protocol, ts_unit=unit)
                ahead = self._input.size is not None and self._threads > 1
                self._blocks = self._run_ahead() if ahead else self._run()
        return self._blocks

    def _run_recorded(self, recorded: RecordedFrames) -> Generator[FrameArray, None, None]:
        """Yield the blocks of a recording."""
        for out, count in recorded.run(self._room):
            self.bytes_done = recorded.bytes_done
            yield self._block(out, count)
        self.bytes_done = recorded.bytes_done
        self._end()

    def _run_ahead(self) -> Generator[FrameArray, None, None]:
        """Yield the blocks that several threads make, and the last one as `_run` does."""
        decoder = self.decoder
        sink = _Fresh(decoder) if self._out is None else _Reused(decoder, self._out, self._offsets)
        # One map for all threads; its pages are given back as the stream goes by.
        whole = self._input.map_whole()
        kept, start, window = 0, self._input.start, _input.WINDOW
        for _ in decoder.run_ahead(input_bytes(whole), sink, self._threads):
            self._input.check_size()
            self.bytes_done = decoder.position
            for block in sink.take(last=False):
                yield self._block(block, len(block))
            if start + self.bytes_done - kept > 2 * window and hasattr(mmap, "MADV_DONTNEED"):
                mapped = whole.obj
                assert isinstance(mapped, mmap.mmap)
                mapped.madvise(mmap.MADV_DONTNEED, kept, window)
                kept += window
        self.bytes_done = decoder.position
        for block in sink.take(last=True):
            yield self._block(block, len(block))
        yield from self._run(sink.begun)

    def _run(self, count: int = 0) -> Generator[FrameArray, None, None]:
        """Yield the blocks of raw bytes; `count` frames are in `out` already."""
        decoder = self.decoder
        out, at = self._room()
        while len(piece := self._input.some(self.bytes_done)):
            done = 0
            while done < len(piece):
                used, more = decoder.feed_into(
                    piece[done:], out[count:], None if at is None else at[count:]
                )
                done += used
                count += more
                self.bytes_done += used
                if count == len(out):
                    yield self._block(out, count)
                    (out, at), count = self._room(), 0
                    if self._input.size is not None:  # the caller may have taken long
                        self._input.check_size()
            # Bytes of a pipe may be long in coming: do not sit on frames.
            if count and self._input.size is None:
                yield self._block(out, count)
                (out, at), count = self._room(), 0
        while True:
            if count < len(out):
                count += decoder.flush_into(out[count:], None if at is None else at[count:])
            if count:
                yield self._block(out, count)
                (out, at), count = self._room(), 0
            if not decoder.pending:
                break
        self._end()

    def _end(self) -> None:
        """Judge the bytes while they can be looked at, and close the file."""
        self._ended_doubt = self.doubt
        self._input.close()

    def _room(self) -> tuple[FrameArray, Offsets | None]:
        if self._out is None:
            return np.empty(BLOCK_FRAMES, FRAME_DTYPE), None
        return self._out, self._offsets

    def _block(self, out: FrameArray, count: int) -> FrameArray:
        if self._progress is not None:
            self._progress(self.bytes_done, self.bytes_total)
        # A block that is far from full would hold memory that nobody uses.
        wasteful = self._out is None and count < len(out) // 2
        return copy_records(out[:count]) if wasteful else out[:count]


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
        put_records(self._out[begin : begin + fits], self._rest[:fits])
        self._rest = self._rest[fits:]
        if self._offsets is not None:
            self._offsets[begin : begin + fits] = self._rest_offsets[:fits]
            self._rest_offsets = self._rest_offsets[fits:]
        self.begun += fits


def read(
    path: Source,
    protocol: str | None = None,
    *,
    ts_unit: str | None = None,
    offsets: Offsets | None = None,
    threads: int = 1,
    as_is: bool = False,
) -> FrameArray:
    """Decode a whole capture file into one new array.

    `path`: a path, or a file open for reading bytes, from where it stands: raw bytes or a
    recording, with `protocol`, `ts_unit` and `as_is` as for `blocks`. The file is mapped, never
    read as a whole. Returns FRAME_DTYPE, shape (n,). `offsets`, `threads`, warnings and errors
    as for `decode` and `blocks`. What a recording has lost, or where it is damaged, is a
    CanserWarning. For files larger than memory, and for the counters, use `blocks`.
    """
    threads = check_threads(threads)
    check_protocol(protocol, ts_unit)
    output_offsets(offsets, 0)
    with Input(path) as source:
        recorded = None
        if starts_recording(source):
            recorded = _open_recording(source, protocol, ts_unit, live=False, as_is=as_is)
            frames = _read_recording(source, recorded, offsets)
            decoder = recorded.decoder
            remarks = [f"{source.name}: {remark}" for remark in recorded.remarks]
        else:
            known, found = choose_protocol(protocol, source, as_is=as_is)
            decoder = Decoder(known, ts_unit="ms" if ts_unit is None else ts_unit)
            if source.total is None:
                frames = decode_with(decoder, b"".join(_windows(source)), offsets=offsets)
            elif threads == 1:
                frames = decode_pieces(decoder, _windows(source), source.total, offsets)
            else:
                whole = source.map_whole()
                frames = decode_with(decoder, whole, offsets=offsets, threads=threads)
            remarks = [f"{source.name}: {found}"] if found else []
        sample = source.sample() if recorded is None else recorded.head
        if not as_is and (doubt := describe_doubt(source.name, decoder, sample)):
            remarks.append(f"{doubt}; as_is=True accepts them")
        for remark in remarks:
            warnings.warn(remark, CanserWarning, stacklevel=2)
        return frames


def _windows(source: Input) -> Iterator[memoryview]:
    """Yield all bytes of a file, piece by piece."""
    at = 0
    while len(piece := source.some(at)):
        yield piece
        at += len(piece)


def _open_recording(
    source: Input, protocol: str | None, ts_unit: str | None, *, live: bool, as_is: bool
) -> RecordedFrames:
    """Return the frames of a recording in its own protocol; with `as_is` in any."""
    recording = Recording(source)
    own = recording.info.protocol
    if protocol is None or is_auto(protocol):
        protocol = own
    elif not as_is and Decoder(protocol).protocol != own:
        given = Decoder(protocol).protocol
        raise WrongProtocolError(f"{source.name} is a recording in {own}, not in {given}")
    return RecordedFrames(recording, protocol, ts_unit, live=live)


def _read_recording(source: Input, recorded: RecordedFrames, offsets: Offsets | None) -> FrameArray:
    whole, count = np.empty(BLOCK_FRAMES, FRAME_DTYPE), 0
    at = np.empty(BLOCK_FRAMES, np.int64)

    def room() -> tuple[FrameArray, Offsets]:
        nonlocal whole
        if len(whole) - count < BLOCK_FRAMES:
            # The frames so far tell how many there will be; where nobody knows the size of
            # the file, or the rest is denser than they were, this happens again.
            done = recorded.decoder.position
            expected = int(count * (source.total or 2 * done) / done * 1.02)
            larger = np.empty(max(expected, count) + BLOCK_FRAMES, FRAME_DTYPE)
            put_records(larger[:count], whole[:count])
            whole = larger
        return whole[count : count + BLOCK_FRAMES], at

    for _, more in recorded.run(room):
        if offsets is not None:
            fits = max(min(more, len(offsets) - count), 0)
            offsets[count : count + fits] = at[:fits]
        count += more
    if offsets is not None and count > len(offsets):
        raise ValueError(
            f"offsets has room for {len(offsets)} frames, but the data holds {count}; "
            f"make room for at least {count}"
        )
    # Given back, not copied: no other object refers to it.
    whole.resize(count, refcheck=False)
    return whole
