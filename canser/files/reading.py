"""Files of any format, one or several, as one stream of frames: block by block, or as a whole."""

import contextlib
import dataclasses
import os
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self, cast

import numpy as np

from canser._core.buffers import Offsets, output_offsets
from canser._core.stream import Control
from canser._frames import FRAME_DTYPE, NO_TIME, YEAR_2000_NS, FrameArray, concat, copy_records
from canser._guards import Uncopied
from canser._input import Input, Source
from canser._named import named
from canser._protocols import protocols
from canser.codec.decoder import Decoder, Stats, add_stats, check_threads
from canser.errors import CanserWarning, FormatError
from canser.files.formats import choose_format, find_format
from canser.files.judge import check_protocol
from canser.files.raw import RawReader
from canser.files.reader import Reader, ReadOptions, refill
from canser.recording.header import RecordingInfo

__all__ = ["Blocks", "Notes", "Progress", "Source", "Sources", "blocks", "listed", "read"]

# Called after each block with the bytes done and the bytes in all, None where that is not known.
Progress = Callable[[int, int | None], None]

# One file, or several in their order.
Sources = Source | Sequence[Source]

# Frames in a block of those that are sorted: 1.5 MiB.
_SORTED_BLOCK = 1 << 16


class FilePart(NamedTuple):
    """What one of several files has given."""

    name: str
    format: str
    frames: int


class Notes(NamedTuple):
    """What to know of files besides their frames; each line has the name of its file.

    Attributes
    ----------
    found : tuple of str
        Which protocols "auto" has found.
    remarks : tuple of str
        What is damaged, what is lost, what the frames do not hold.
    doubt : str
        Why bytes are not of the protocol they were read in; "" if they may be.
    """

    found: tuple[str, ...]
    remarks: tuple[str, ...]
    doubt: str

    @property
    def lines(self) -> tuple[str, ...]:
        """What was found, and the remarks."""
        return self.found + self.remarks

    @property
    def all_lines(self) -> tuple[str, ...]:
        """These, and the doubt, with what accepts the bytes."""
        return (*self.lines, f"{self.doubt}; as_is=True accepts them") if self.doubt else self.lines


def blocks(
    source: Sources,
    protocol: str | None = None,
    *,
    format: str | None = None,  # noqa: A002 - as users call it
    ts_unit: str | None = None,
    out: FrameArray | None = None,
    offsets: Offsets | None = None,
    threads: int = 1,
    progress: Progress | None = None,
    bus: str | None = None,
    as_is: bool = False,
) -> "Blocks":
    """Read the frames of files of any size and format, block by block.

    Parameters
    ----------
    source : path, file open for reading bytes, or a list of these
        What is read, a file from where it stands. Several files are one stream, in the order
        given. A regular file is mapped, a piece at a time; a pipe is read as its bytes come.
    protocol : str, optional
        Of raw bytes, which do not say it: a name of `protocols()`, or "auto" for the one that
        fits with a score of 0.9 at least, as `identify` tells; a CanserWarning says which.
        A recording knows its own. Of several files it is that of the raw bytes among them.
    format : str, optional
        "raw", "pcapng" (a recording), "candump", "csv" or "npy". By default the format shows by
        the first bytes of the file, else by the suffix of its name, else it is "raw".
    ts_unit : str, optional
        Unit of the device's timestamps in raw bytes, "s", "ms", "us" or "ns"; "ms" by default.
    out : array of FRAME_DTYPE, shape (n,), optional
        Is filled again and again: a block is `out[:count]`, good until the next. By default
        each block is a new array.
    offsets : array of int64 or uint64, shape (n,), optional
        Goes with `out`, for raw bytes and recordings: `offsets[:count]` are the stream offsets
        of the block's frames.
    threads : int
        How many may work on a regular file of raw bytes, as for `decode`; the frames are the
        same for any number, and without `out` the blocks are cut elsewhere.
    progress : callable, optional
        Is called after each block with the bytes done, and the bytes in all or None.
    bus : str, optional
        Of a log of several buses the channel to read, such as "can0"; by default all.
    as_is : bool
        Read the bytes in that protocol whatever they look like, without a warning, though they
        are plainly another format's or a recording says another protocol.

    Returns
    -------
    Blocks
        An iterator of arrays of FRAME_DTYPE, shape (count,), count >= 1.

    Warns
    -----
    CanserWarning
        At the end, where so many bytes lie in no packet that the protocol is not theirs: half
        of 1,000 or more (in `cantalope` 4.6 %, 0.4 of what random bytes give); where a file of
        several begins earlier than the one before it has ended.

    Raises
    ------
    NoProtocolError
        A ValueError, for raw bytes without a protocol.
    WrongProtocolError
        A ValueError, for another protocol than a recording's own.
    FormatError
        For a file that is not what its format promises; ForeignFormatError for a format that
        canser does not read, and for one that holds frames where a protocol is given;
        RecordingError for pcapng that is none of canser's. For files in one stream of which one
        counts from 1970 and another one from a device's start.
    TypeError
        For what is no path and no file open for reading bytes.
    OSError
        For a file that cannot be read, or gets shorter meanwhile. (If it gets shorter in the
        milliseconds in which a block of it is decoded the system ends the process: copy a file
        that another program may cut.)

    Examples
    --------
    >>> for block in canser.blocks("run.bin", "seeed"):
    ...     print(len(block))
    """
    if offsets is not None and out is None:
        raise ValueError("offsets goes with out: give both")
    options = _checked(
        format,
        protocol=protocol,
        ts_unit=ts_unit,
        out=out,
        offsets=offsets,
        threads=threads,
        bus=bus,
        as_is=as_is,
    )
    if out is not None:
        Decoder(protocols()[0]).feed_into(b"", out, offsets)
    return Blocks(source, options, format=format, progress=progress, warns=True)


def _checked(file_format: str | None, **given: Any) -> ReadOptions:
    """Return the options; a mistake in them shows here, and no file is opened."""
    options = ReadOptions(**given)
    check_protocol(options.protocol, options.ts_unit)
    if file_format is not None:
        find_format(file_format)
    return dataclasses.replace(options, threads=check_threads(options.threads))


class Blocks(Uncopied, Iterator[FrameArray]):
    """The blocks of one file or several: an iterator, made by `blocks`; a context manager.

    Attributes
    ----------
    sources : list
        What is read, as it was given.
    bytes_total : int or None
        Bytes of all files, None where that is not known.
    """

    def __init__(
        self,
        source: Sources,
        options: ReadOptions,
        *,
        format: str | None = None,  # noqa: A002 - as users call it
        progress: Progress | None = None,
        sort: bool = False,
        warns: bool = False,
    ) -> None:
        """Open files; `warns`: CanserWarnings tell of them, else `notes` do."""
        self.sources = listed(source)
        if len(self.sources) > 1:
            # Formats may mix: the protocol is that of the raw bytes among them.
            options = dataclasses.replace(options, raw_only=True)
        self._options, self._format, self._progress = options, format, progress
        self._warns = warns
        self._inputs: list[Input] = []
        self._readers: list[Reader] = []
        self._files: list[FilePart] = []
        self._order = _Order(sorts=sort)
        self._done = 0  # bytes of the files before the one that is read
        self._closed = False
        self.bytes_total = _total(self.sources)
        self._blocks = self._run()
        if sort:
            self._blocks = _sorted(self._blocks, options.out)
        self._inputs.append(Input(self.sources[0]))
        # A pipe that needs not be asked is not waited for.
        if options.protocol is None or self._inputs[0].size is not None:
            try:
                self._begin(stacklevel=4)
            except BaseException:
                self.close()
                raise

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> FrameArray:
        try:
            self._begin()
            block = next(self._blocks)
        except StopIteration:
            self.close()
            if self._warns and not self._options.as_is and (doubt := self.notes.doubt):
                warnings.warn(f"{doubt}; as_is=True accepts them", CanserWarning, stacklevel=2)
            self._warns = False  # once
            raise
        if self._progress is not None:
            self._progress(self.bytes_done, self.bytes_total)
        # A block that is far from full would hold memory without need.
        whole = block.base
        if (
            self._options.out is None
            and isinstance(whole, np.ndarray)
            and whole.dtype == FRAME_DTYPE
            and len(block) < len(whole) // 2
        ):
            return copy_records(block)
        return block

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files that `blocks` opened. Done by itself at the end."""
        if not self._closed:
            self._closed = True
            self._blocks.close()
            for reader in self._readers:
                reader.close()
            for source in self._inputs:
                source.close()

    @property
    def reader(self) -> Reader:
        """The reader of the file that is read now; a pipe is waited for."""
        return self._begin()

    @property
    def bytes_done(self) -> int:
        """Bytes of the files that were read."""
        return self._done + (self._readers[-1].bytes_done if self._readers else 0)

    @property
    def name(self) -> str:
        """The name of the file that is read now, as messages call it."""
        return self._inputs[-1].name

    @property
    def format(self) -> str:
        """The format of the file that is read now; a pipe is waited for."""
        self._begin()
        return self._files[-1].format

    @property
    def files(self) -> list[FilePart]:
        """The files so far: name, format, number of frames."""
        return list(self._files)

    @property
    def decoder(self) -> Decoder:
        """The decoder of the file that is read now; a pipe is waited for.

        Raises
        ------
        ValueError
            For a format that holds frames, and no bytes of an adapter.
        """
        found = self._begin().decoder
        if found is None:
            raise ValueError(f"{self.name} holds frames, and no bytes of an adapter to decode")
        return found

    @property
    def protocol(self) -> str | None:
        """The protocol of the last file with bytes of an adapter, None where there is none yet."""
        self._begin()
        decoders = self._decoders()
        return decoders[-1].protocol if decoders else None

    @property
    def stats(self) -> Stats | None:
        """The counters of all files so far; None where no bytes of an adapter were decoded."""
        self._begin()
        total: Stats | None = None
        for decoder in self._decoders():
            total = decoder.stats if total is None else add_stats(total, decoder.stats)
        return total

    def take_controls(self) -> list[Control]:
        """Return the control packets of all files so far; see `Decoder.take_controls`."""
        return [control for decoder in self._decoders() for control in decoder.take_controls()]

    def _decoders(self) -> list[Decoder]:
        """Return the decoders of all files so far, each once."""
        found = {id(each.decoder): each.decoder for each in self._readers if each.decoder}
        return list(found.values())

    @property
    def recording(self) -> RecordingInfo | None:
        """What a recording knows of its line, None for other formats; a pipe is waited for."""
        return self._begin().recording

    @property
    def notes(self) -> Notes:
        """What to know of the files so far; a pipe is waited for."""
        self._begin()
        opened = list(zip(self._inputs, self._readers, strict=False))
        found = [f"{source.name}: {reader.found}" for source, reader in opened if reader.found]
        remarks = [
            f"{source.name}: {remark}" for source, reader in opened for remark in reader.remarks
        ]
        doubts = (reader.doubt for _, reader in opened)
        return Notes(tuple(found), (*remarks, *self._order.remarks), next(filter(None, doubts), ""))

    def sample(self) -> memoryview:
        """Return some of the raw bytes of the first file, to tell what they are.

        Of a pipe the first 64 KiB are waited for. Before the first block only.
        """
        reader = self._begin()
        assert isinstance(reader, RawReader)
        return reader.sample()

    def _begin(self, stacklevel: int = 3) -> Reader:
        """Look what the first file holds, unless that is known; return what is read now."""
        if not self._readers:
            self._open(stacklevel + 1)
        return self._readers[-1]

    def _open(self, stacklevel: int) -> None:
        """Look what the last one of the inputs holds."""
        source, options = self._inputs[-1], self._options
        with named(source.name):
            name = choose_format(source, options, self._format)
            reader = find_format(name).read(source, options)
        if options.bus is not None and not reader.has_buses:
            raise ValueError(f"{source.name} names no buses; leave bus out")
        if options.offsets is not None and reader.decoder is None:
            raise ValueError(
                f"{source.name} holds frames, which have no stream offsets; leave offsets out"
            )
        if reader.found and self._warns:
            warnings.warn(f"{source.name}: {reader.found}", CanserWarning, stacklevel=stacklevel)
        self._readers.append(reader)
        self._files.append(FilePart(source.name, name, 0))

    def _run(self) -> Generator[FrameArray, None, None]:
        """Yield the blocks of all files."""
        while True:
            reader, name = self._readers[-1], self.name
            at = len(self._files) - 1
            for block in self._named(reader, name):
                if len(self.sources) > 1:
                    remark = self._order.follow(block, at, name)
                    if remark and self._warns:
                        warnings.warn(remark, CanserWarning, stacklevel=3)
                self._files[at] = self._files[at]._replace(
                    frames=self._files[at].frames + len(block)
                )
                yield block
            more = len(self._readers) > at + 1 or self._next()
            # A list of files may be longer than the system lets be open at a time.
            reader.close()
            self._inputs[at].close()
            if not more:
                return

    def _named(self, reader: Reader, name: str) -> Iterator[FrameArray]:
        """Yield the blocks of a file; an error of the system names it."""
        run = reader.blocks(self._stream_ends)
        while True:
            with named(name):
                block = next(run, None)
            if block is None:
                return
            yield block

    def _stream_ends(self) -> bool:
        """Open the next file; return whether it does not go on with the stream of this one."""
        last = self._readers[-1]
        if not self._next():
            return True
        return not self._readers[-1].carry_on(last)

    def _next(self) -> bool:
        """Open the next file, if there is one."""
        if len(self._inputs) == len(self.sources):
            return False
        self._done += self._readers[-1].bytes_done
        self._inputs.append(Input(self.sources[len(self._inputs)]))
        self._open(stacklevel=6)
        return True


class _Order:
    """Watches that several files make one stream in time."""

    def __init__(self, *, sorts: bool) -> None:
        self._sorts = sorts
        self.remarks: list[str] = []
        self._place, self._name = -1, ""  # of the file that is read
        self._last_name, self._last_ns = "", NO_TIME  # where the files before have ended
        self._newest_ns = NO_TIME
        self._epoch: tuple[str, bool] | None = None  # a file, and whether it counts from 1970

    def follow(self, block: FrameArray, place: int, name: str) -> str:
        """Take the next block of a file by its place; return a remark where it begins too early."""
        ts = block["ts"]
        timed = ts[ts != NO_TIME]
        if not len(timed):
            return ""
        remark = ""
        if place != self._place:
            self._last_name, self._last_ns = self._name, self._newest_ns
            self._place, self._name = place, name
            remark = self._compare(int(timed[0]), name)
        self._newest_ns = int(timed[-1])
        return remark

    def _compare(self, first_ns: int, name: str) -> str:
        epoch = first_ns >= YEAR_2000_NS
        if self._epoch is None:
            self._epoch = name, epoch
        elif self._epoch[1] != epoch:
            since, other = ("1970", "a device's start") if epoch else ("a device's start", "1970")
            raise FormatError(
                f"{name} counts its times from {since}, {self._epoch[0]} from {other}; "
                "read them one by one"
            )
        if self._sorts or self._last_ns == NO_TIME or first_ns >= self._last_ns:
            return ""
        early = (self._last_ns - first_ns) / 1e9
        remark = (
            f"{name} begins {early:,.3f} s before the end of {self._last_name}; "
            "canser.read(..., sort=True), or --sort, orders all frames by their time"
        )
        self.remarks.append(remark)
        return remark


def _sorted(
    blocks: Iterator[FrameArray], out: FrameArray | None
) -> Generator[FrameArray, None, None]:
    """Yield all frames ordered by their time; those without one come first."""
    whole = concat(map(copy_records, blocks))
    ordered = whole.take(np.argsort(whole["ts"], kind="stable"))
    parts = (ordered[at : at + _SORTED_BLOCK] for at in range(0, len(ordered), _SORTED_BLOCK))
    yield from parts if out is None else refill(parts, out)


def listed(source: Sources) -> list[Source]:
    """Return the files of an argument that is one or several."""
    if not isinstance(source, (list, tuple)):
        return [cast(Source, source)]  # Input refuses what is none
    if not source:
        raise ValueError("the list of files is empty; name one at least")
    return list(source)


def _total(sources: list[Source]) -> int | None:
    """Return the bytes of all files, None where that is not known."""
    total = 0
    for source in sources:
        with contextlib.ExitStack() as opened:
            try:
                size = opened.enter_context(Input(source)).total if _is_cheap(source) else None
            except OSError:
                return None
        if size is None:
            return None
        total += size
    return total


def _is_cheap(source: Source) -> bool:
    """Return whether a file can be opened once more, only to ask for its size."""
    return not isinstance(source, (str, os.PathLike)) or Path(source).is_file()


def read(
    source: Sources,
    protocol: str | None = None,
    *,
    format: str | None = None,  # noqa: A002 - as users call it
    ts_unit: str | None = None,
    offsets: Offsets | None = None,
    threads: int = 1,
    bus: str | None = None,
    sort: bool = False,
    as_is: bool = False,
) -> FrameArray:
    """Read all frames of a file, or of several, into one new array.

    Parameters
    ----------
    source, protocol, format, ts_unit, threads, bus, as_is
        As for `blocks`.
    offsets : array of int64 or uint64, shape (n,), optional
        For one file of raw bytes or one recording: is filled with the stream offsets of the
        frames.
    sort : bool
        Order all frames by their time; those without one come first.

    Returns
    -------
    array of FRAME_DTYPE, shape (n,)
        The frames, in an array that owns its memory.

    Warns
    -----
    CanserWarning
        As `blocks`; and for what a file holds and the frames do not, what a recording has lost,
        and where it is damaged.

    See Also
    --------
    blocks : for files larger than memory, and for the counters; errors as there.

    Examples
    --------
    >>> frames = canser.read("run.bin", "seeed")
    >>> frames = canser.read(["monday.log", "tuesday.log"])
    """
    options = _checked(
        format,
        protocol=protocol,
        ts_unit=ts_unit,
        offsets=offsets,
        threads=threads,
        bus=bus,
        as_is=as_is,
    )
    output_offsets(offsets, 0)
    opened = Blocks(source, options, format=format, sort=sort)
    with opened:
        reader = opened._begin()  # a pipe is waited for
        alone = len(opened.sources) == 1 and not sort
        if alone and reader.decoder is not None:
            with named(opened.name):
                frames: FrameArray = reader.read_all(offsets)
        elif offsets is not None:
            raise ValueError("offsets are those of one file of raw bytes, or of one recording")
        else:
            frames = concat(opened)
        notes = opened.notes
    for remark in notes.lines if as_is else notes.all_lines:
        warnings.warn(remark, CanserWarning, stacklevel=2)
    return frames
