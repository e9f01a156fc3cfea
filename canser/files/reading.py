"""Read one file or several, of any format, as one stream of frames: in blocks, or as a whole."""

import contextlib
import dataclasses
import os
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from datetime import datetime, tzinfo
from pathlib import Path
from typing import Any, Final, NamedTuple, Self, cast

import numpy as np

from canser._checks import instance
from canser._core.buffers import Offsets, check_array, output_offsets
from canser._core.stream import Control
from canser._core.text import NO_CHANNEL, Codes
from canser._dates import date_ns, date_text
from canser._frames import (
    FRAME_DTYPE,
    NO_TIME,
    YEAR_2000_NS,
    FrameArray,
    concat,
    copy_records,
    put_records,
)
from canser._guards import Uncopied
from canser._input import Input, Source
from canser._named import named
from canser._protocols import protocols
from canser.codec.decoder import Decoder, Stats, add_stats, check_threads
from canser.codec.growing import GrowingFrames
from canser.errors import CanserWarning, FormatError
from canser.files.formats import choose_format, find_format
from canser.files.judge import check_protocol
from canser.files.packed import unpacked
from canser.files.raw import RawReader
from canser.files.reader import Reader, ReadOptions
from canser.files.tags import RECEIVED, Tagged, joined
from canser.recording.header import RecordingInfo

__all__ = [
    "START",
    "Blocks",
    "Notes",
    "Progress",
    "Source",
    "Sources",
    "blocks",
    "checked_options",
    "listed",
    "read",
]

# Called after each block with the bytes done and the bytes in all, None if that is not known.
Progress = Callable[[int, int | None], None]

# One file, or several in their order.
Sources = Source | Sequence[Source]

# The epoch of `convert`: the start that a file names, nothing if it names none.
START: Final = "start"

# Frames that are read at a time, to be copied into one array: 1.5 MiB, which stay in a cache.
_ROOM = 1 << 16

# Frames in a block after sorting: 1.5 MiB of records.
_SORTED_BLOCK = 1 << 16


class FilePart(NamedTuple):
    """One file of those that were read; given by `Blocks.files` and `FileInfo.files`."""

    #: Name of the file, as messages write it.
    name: str
    #: Format of the file, such as "candump".
    format: str
    #: Number of frames that were read from the file so far.
    frames: int


class Notes(NamedTuple):
    """Messages about files that were read; given by `Blocks.notes`.

    Each message is one line and starts with the name of its file.
    """

    #: The protocols that "auto" has found, one line for each file.
    found: tuple[str, ...]
    #: What is damaged, what is lost, and what the frames do not hold.
    remarks: tuple[str, ...]
    #: Why the bytes are not of the protocol that they were read in; "" if they may be.
    doubt: str

    @property
    def lines(self) -> tuple[str, ...]:
        """The lines of `found`, then those of `remarks`."""
        return self.found + self.remarks

    @property
    def all_lines(self) -> tuple[str, ...]:
        """The lines of `lines`; and if there is a `doubt`, a line with it and with its remedy."""
        return (*self.lines, f"{self.doubt}; as_is=True accepts them") if self.doubt else self.lines


def blocks(
    source: Sources,
    protocol: str | None = None,
    *,
    format: str | None = None,  # noqa: A002 - as users call it
    ts_unit: str | None = None,
    out: FrameArray | None = None,
    offsets: Offsets | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
    bus: str | None = None,
    channels: Codes | None = None,
    directions: Codes | None = None,
    times: str | None = None,
    epoch: str | datetime | None = None,
    tz: tzinfo | None = None,
    skip_bad: bool = False,
    as_is: bool = False,
) -> "Blocks":
    """Read the frames of files of any size and format, block by block.

    Parameters
    ----------
    source : str, path-like, binary file, or list of these
        The file to read. A file that is open is read from its current position. Several files
        are read as one stream, in the order given. A regular file is mapped, one window at a
        time. A pipe is read as its bytes arrive.
    protocol : str, optional
        Protocol of raw bytes, which do not name it: a name of `protocols()`, or "auto". "auto"
        takes the protocol that fits best, if its score is 0.9 or more (see `identify`); a
        CanserWarning names it. A recording names its own protocol. With several files, this is
        the protocol of those that are raw bytes.
    format : str, optional
        "raw", "pcapng" (a recording), "candump", "csv", "npy", or a format that another package
        adds. By default the first bytes of the file decide; if they do not, the suffix of its
        name; if that does not, the format is "raw".
    ts_unit : str, optional
        Unit of the device's timestamps in raw bytes: "s", "ms", "us" or "ns"; "ms" by default.
    out : array of FRAME_DTYPE, shape (n,), optional
        Array that is filled again for each block. A block is `out[:count]`, valid until the next
        block. By default each block is a new array.
    offsets : array of int64 or uint64, shape (n,), optional
        For raw bytes and recordings, together with `out`: filled with the stream offsets of the
        frames, in bytes. Those of a block are `offsets[:count]`.
    threads : int, optional
        Number of threads that may read a file, with the caller's: raw bytes as for `decode`, a log
        of text of over 4 MiB, or BLF; raw bytes and text only from regular files. By default 1 for
        raw bytes, and for logs one for each core, up to 4. The frames are the same for any number.
        Of raw bytes, without `out`, the blocks have other lengths.
    progress : callable, optional
        Called after each block as `progress(bytes_done, bytes_total)`. `bytes_total` is None if
        it is not known.
    bus : str, optional
        Channel to read from a log of several buses, such as "can0" or "1", as the file has it; all
        channels by default.
    channels : array of uint8, shape (n,), optional
        Together with `out`, and as long: filled with the channels of the frames, as numbers from 0;
        255 if none is told. `Blocks.channel_names` has their names.
    directions : array of uint8, shape (n,), optional
        Together with `out`, and as long: filled with 1 for frames that the program sent which wrote
        the file, else 0.
    times : {None, "delta"}, optional
        "delta" if the times in a text log are the differences between frames, as `candump -td`
        writes them: they are added up. They are taken as times by default.
    epoch : "file" or datetime, optional
        Time to add to all times: "file" is the start that the file names, in a format whose times
        count from there, such as "asc". A datetime without a zone is local time, or that of `tz`.
        Times are as the file states them by default.
    tz : datetime.tzinfo, optional
        Time zone of dates in a file, which name none; local time by default.
    skip_bad : bool, optional
        Leave out what cannot be read in a log, lines of text or parts of BLF, and count it. It is
        an error by default.
    as_is : bool, optional
        Read the bytes in the protocol given, whatever they look like: without a warning, and
        even if they are plainly another format, or a recording of another protocol. False by
        default.

    Returns
    -------
    Blocks
        Iterator over arrays of FRAME_DTYPE, shape (count,), count >= 1.

    Warns
    -----
    CanserWarning
        At the end, if too many bytes lie in no packet for the protocol to be right. The limit is
        half of the bytes, if there are 1,000 or more; for a protocol without marks it is 0.3 times
        the share that is skipped in random bytes (for `cantalope` 3.4 %). Also if one of several
        files starts before the end of the file before it.

    Raises
    ------
    NoProtocolError
        A ValueError: raw bytes without a protocol.
    WrongProtocolError
        A ValueError: a recording has another protocol than the one given.
    ValueError
        An option has a value that does not exist or does not go with the file, such as a
        `format` that is not known, `offsets` without `out`, or `bus` for a file without buses.
    FormatError
        The content of a file is not valid in its format, or one of several files counts its
        times from 1970 and another one from the start of a device. A ForeignFormatError: canser
        does not read the format, or a protocol is given and the format holds frames. A
        RecordingError: a pcapng file without an interface, or a damaged recording.
    TypeError
        `source` is no path and no file that is open for reading bytes.
    OSError
        A file cannot be read, or it gets shorter meanwhile.

    Notes
    -----
    The system ends the process (SIGBUS) if a mapped file gets shorter in the milliseconds in
    which a block of it is decoded. Copy a file that another program may cut.

    Examples
    --------
    >>> frames = canser.frames("123#01", "456#0203", "123#02")
    >>> frames["ts"] = [0, 1_000_000, 5_000_000]
    >>> written = canser.write(frames, "run.bin", "serial")
    >>> counts = {}
    >>> for block in canser.blocks("run.bin", "serial"):
    ...     for can_id in block["id"].tolist():
    ...         counts[can_id] = counts.get(can_id, 0) + 1
    >>> counts
    {291: 2, 1110: 1}
    """
    for name, array in (("offsets", offsets), ("channels", channels), ("directions", directions)):
        if array is not None and out is None:
            raise ValueError(f"{name} goes with out: give both")
    options = checked_options(
        format,
        protocol=protocol,
        ts_unit=ts_unit,
        out=out,
        offsets=offsets,
        threads=threads,
        bus=bus,
        channels=channels,
        directions=directions,
        times=times,
        epoch=epoch,
        tz=tz,
        skip_bad=skip_bad,
        as_is=as_is,
    )
    if out is not None:
        Decoder(protocols()[0]).feed_into(b"", out, offsets)
        _check_codes(options, len(out))
    return Blocks(source, options, format=format, progress=progress, warns=True)


def checked_options(file_format: str | None, **given: Any) -> ReadOptions:
    """Return the options. An invalid one is refused before a file is opened."""
    options = ReadOptions(**given)
    if options.times not in (None, "delta"):
        raise ValueError(f"unknown times {options.times!r}; have: None, 'delta'")
    if options.tz is not None:
        instance(options.tz, "tz", tzinfo)
    if options.epoch not in (None, "file", START):
        instance(options.epoch, "epoch", datetime)
    check_protocol(options.protocol, options.ts_unit)
    if file_format is not None:
        find_format(file_format)
    if options.threads is not None:
        options = dataclasses.replace(options, threads=check_threads(options.threads))
    return options


def _check_codes(options: ReadOptions, least: int) -> None:
    """Raise unless the arrays for channels and directions are such, and have room."""
    for name in ("channels", "directions"):
        array = getattr(options, name)
        if array is not None:
            check_array(array, name, (np.dtype(np.uint8),), "np.empty(n, np.uint8)")
            if len(array) < least:
                raise ValueError(
                    f"{name} has room for {len(array)} frames; make it at least {least} long"
                )


class Blocks(Uncopied, Iterator[FrameArray]):
    """Iterator over the blocks of one file or several, made by `blocks`; a context manager.

    The files close at the end of the iteration, by `close`, and at the end of a `with`. The
    properties may be read at any time; before the first block, some wait for the first bytes of a
    pipe.

    Attributes
    ----------
    sources : list
        The files to read, as they were given.
    bytes_total : int or None
        Bytes of all files, None if that is not known.

    Examples
    --------
    >>> frames = canser.frames("123#01", "456#0203")
    >>> frames["ts"] = [0, 1_000_000]
    >>> written = canser.write(frames, "run.log")
    >>> with canser.blocks("run.log") as blocks:
    ...     lengths = [len(block) for block in blocks]
    >>> lengths, blocks.files
    ([2], [FilePart(name='run.log', format='candump', frames=2)])
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
        gathers: bool = False,
    ) -> None:
        """Open files.

        With `warns` what is to be known of them is a warning, else only a note. With `gathers`
        channels and directions of all blocks go into the caller's arrays, one behind the other.
        """
        self.sources = listed(source)
        if len(self.sources) > 1:
            # Formats may mix: the protocol is that of the raw bytes among them.
            options = dataclasses.replace(options, raw_only=True)
        self._options, self._format, self._progress = options, format, progress
        self._warns, self._gathers = warns, gathers
        # What the caller takes besides frames: there is no note that it is lost.
        self._kept = {
            name for name in ("channels", "directions") if getattr(options, name) is not None
        }
        self._tags: Tagged | None = None  # the current block
        self._count = 0  # frames of the blocks so far
        self._starts: list[str] = []  # a remark for each file whose start was added to its times
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
        # With a protocol given, a pipe need not be waited for yet.
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
            self._tags = next(self._blocks)
        except StopIteration:
            self.close()
            if self._warns and not self._options.as_is and (doubt := self.notes.doubt):
                warnings.warn(f"{doubt}; as_is=True accepts them", CanserWarning, stacklevel=2)
            self._warns = False  # once
            raise
        except BaseException:
            self.close()  # no more blocks can come
            raise
        block = self._tags.frames
        self._fill_codes(self._tags)
        if self._progress is not None:
            self._progress(self.bytes_done, self.bytes_total)
        # Otherwise a block that is far from full would keep the memory of a full one.
        whole = block.base
        if (
            self._options.out is None
            and isinstance(whole, np.ndarray)
            and whole.dtype == FRAME_DTYPE
            and len(block) < len(whole) // 2
        ):
            return copy_records(block)
        return block

    def _fill_codes(self, tagged: Tagged) -> None:
        """Fill the arrays that the caller gave for channels and directions."""
        options, count = self._options, len(tagged.frames)
        first = self._count if self._gathers else 0
        self._count += count
        for array, codes, unknown in (
            (options.channels, tagged.channels, NO_CHANNEL),
            (options.directions, tagged.directions, RECEIVED),
        ):
            if array is not None:
                if self._count > len(array) and self._gathers:
                    raise ValueError(
                        f"channels or directions has room for {len(array)} frames; the files hold "
                        "more"
                    )
                array[first : first + count] = unknown if codes is None else codes

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def tagged(self) -> Iterator[Tagged]:
        """Yield the blocks with channels and directions, for this package's own use."""
        for frames in self:
            assert self._tags is not None
            yield self._tags._replace(frames=frames)

    @property
    def channels(self) -> Codes | None:
        """The channels of the current block's frames: uint8, numbers from 0, 255 for not told.

        None if the format tells none, and before the first block.
        """
        return self._tags.channels if self._tags else None

    @property
    def directions(self) -> Codes | None:
        """The directions of the current block's frames: uint8, 1 for sent, 0 for received.

        None if the format tells none, and before the first block.
        """
        return self._tags.directions if self._tags else None

    @property
    def channel_names(self) -> Mapping[int, str]:
        """The names of the channels so far by their numbers, as the current file has them."""
        reader = self._begin()
        return {code: reader.name_of(code) for code in reader.channels}

    @property
    def start_ns(self) -> int | None:
        """The time that the current file names as its start, in nanoseconds since 1970.

        Times of frames count from there. None if the file names none, or times count from 1970. It
        is known with the first block.
        """
        return self._begin().start_ns

    def keep_tags(self) -> Mapping[int, str]:
        """Have no notes that channels and directions are lost, for this package's own use.

        Return the names of channels, to which more are added while the file is read.
        """
        self._kept |= {"channels", "directions"}
        return self._begin().channel_names

    def close(self) -> None:
        """Close the files that `blocks` opened. This also happens at the end of the iteration."""
        if not self._closed:
            self._closed = True
            self._blocks.close()
            for reader in self._readers:
                reader.close()
            for source in self._inputs:
                source.close()

    @property
    def reader(self) -> Reader:
        """The reader of the current file, for this package's own use; waits for a pipe."""
        return self._begin()

    @property
    def bytes_done(self) -> int:
        """Bytes of the files that were read so far."""
        return self._done + (self._readers[-1].bytes_done if self._readers else 0)

    @property
    def gap_count(self) -> int:
        """Gaps of the recordings so far, for this package's own use."""
        return sum(reader.gap_count for reader in self._readers)

    @property
    def name(self) -> str:
        """The name of the current file, as messages write it."""
        return self._inputs[-1].name

    @property
    def format(self) -> str:
        """The format of the current file; waits for the first bytes of a pipe."""
        self._begin()
        return self._files[-1].format

    @property
    def files(self) -> list[FilePart]:
        """The files so far, as `FilePart`: name, format, number of frames."""
        return list(self._files)

    @property
    def decoder(self) -> Decoder:
        """The decoder of the current file; waits for the first bytes of a pipe.

        Raises
        ------
        ValueError
            The format holds frames, and no bytes of an adapter.
        """
        found = self._begin().decoder
        if found is None:
            raise ValueError(f"{self.name} holds frames, and no bytes of an adapter to decode")
        return found

    @property
    def protocol(self) -> str | None:
        """The protocol of the last file with bytes of an adapter, None if there is none so far."""
        self._begin()
        decoders = self._decoders()
        return decoders[-1].protocol if decoders else None

    @property
    def stats(self) -> Stats | None:
        """The counters of all files so far, None if none has bytes of an adapter."""
        self._begin()
        total: Stats | None = None
        for decoder in self._decoders():
            total = decoder.stats if total is None else add_stats(total, decoder.stats)
        return total

    def take_controls(self) -> list[Control]:
        """Return the control packets since the last call, of all files; and forget them.

        Returns
        -------
        list of Control
            In the order of the stream, the last 65,536 of each decoder if there are more; see
            `Decoder.take_controls`.
        """
        return [control for decoder in self._decoders() for control in decoder.take_controls()]

    def _decoders(self) -> list[Decoder]:
        """Return the decoders of all files so far. Files of one stream share a decoder."""
        found = {id(each.decoder): each.decoder for each in self._readers if each.decoder}
        return list(found.values())

    @property
    def recording(self) -> RecordingInfo | None:
        """The line that a recording is of, None for other formats; waits for a pipe."""
        return self._begin().recording

    @property
    def notes(self) -> Notes:
        """Messages about the files so far; waits for the first bytes of a pipe."""
        self._begin()
        opened = list(zip(self._inputs, self._readers, strict=False))
        found = [f"{source.name}: {reader.found}" for source, reader in opened if reader.found]
        remarks = [
            f"{source.name}: {remark}"
            for source, reader in opened
            for remark in (*reader.tag_remarks(self._kept), *reader.remarks)
        ]
        doubts = (reader.doubt for _, reader in opened)
        return Notes(
            tuple(found),
            (*self._starts, *remarks, *self._order.remarks),
            next(filter(None, doubts), ""),
        )

    def sample(self) -> memoryview:
        """Return some raw bytes of the first file, for `identify`. Call it before the first block.

        Waits for the first 64 KiB of a pipe, or for its end.

        Returns
        -------
        memoryview
            Bytes of the file; those of a regular file that can be mapped are all its bytes.
        """
        reader = self._begin()
        assert isinstance(reader, RawReader)
        return reader.sample()

    def _begin(self, stacklevel: int = 3) -> Reader:
        """Open the first file, unless that is done; return the reader of the current file."""
        if not self._readers:
            self._open(stacklevel + 1)
        return self._readers[-1]

    def _open(self, stacklevel: int) -> None:
        """Find the format of the last input, and make its reader."""
        source, options = self._inputs[-1], self._options
        with named(source.name):
            if not (options.as_is and options.protocol is not None):
                source = self._inputs[-1] = unpacked(source)
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

    def _run(self) -> Generator[Tagged, None, None]:
        """Yield the blocks of all files."""
        while True:
            reader, name = self._readers[-1], self.name
            at = len(self._files) - 1
            for block in self._named(reader, name):
                if self._options.epoch is not None:
                    self._add_epoch(block, reader, name)
                if len(self.sources) > 1:
                    remark = self._order.follow(block, at, name)
                    if remark and self._warns:
                        warnings.warn(remark, CanserWarning, stacklevel=3)
                self._files[at] = self._files[at]._replace(
                    frames=self._files[at].frames + len(block)
                )
                yield reader.tags or Tagged(block)
            more = len(self._readers) > at + 1 or self._next()
            # Otherwise a long list of files would exceed the system's limit of open files.
            reader.close()
            self._inputs[at].close()
            if not more:
                return

    def _add_epoch(self, block: FrameArray, reader: Reader, name: str) -> None:
        """Add the epoch to the times of a block."""
        epoch = self._options.epoch
        if epoch == START and reader.start_ns is None:
            return
        known = block["ts"] != NO_TIME
        if not known.any():
            return
        counts_from_1970 = int(block["ts"][known][0]) >= YEAR_2000_NS
        if epoch == "file":
            start_ns = reader.start_ns
            if start_ns is None and not counts_from_1970:
                raise FormatError(f"{name} names no start; give epoch a datetime, or leave it out")
        elif epoch == START:
            start_ns = reader.start_ns
        elif counts_from_1970:
            raise FormatError(f"{name}: times count from 1970 already; leave the epoch out")
        else:
            assert isinstance(epoch, datetime)
            start_ns = date_ns(epoch, self._options.tz)
        if start_ns is not None:
            block["ts"][known] += start_ns
            if epoch == START and not any(each.startswith(f"{name}: ") for each in self._starts):
                date = date_text(start_ns, self._options.tz)
                self._starts.append(f"{name}: its start was added to all times: {date}")

    def _named(self, reader: Reader, name: str) -> Iterator[FrameArray]:
        """Yield the blocks of a file. An OSError gets the name of the file."""
        run = reader.blocks(self._stream_ends)
        while True:
            with named(name):
                block = next(run, None)
            if block is None:
                return
            yield block

    def _stream_ends(self) -> bool:
        """Open the next file; return False if it continues the stream of the current one."""
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
    """Checks that the times of several files follow each other."""

    def __init__(self, *, sorts: bool) -> None:
        self._sorts = sorts
        self.remarks: list[str] = []
        self._place, self._name = -1, ""  # the current file
        self._last_name, self._last_ns = "", NO_TIME  # the file before it, and its last time
        self._newest_ns = NO_TIME
        self._epoch: tuple[str, bool] | None = None  # a file, and whether it counts from 1970

    def follow(self, block: FrameArray, place: int, name: str) -> str:
        """Take the next block of the file at a place; return a remark if it begins too early."""
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


def _sorted(blocks: Iterator[Tagged], out: FrameArray | None) -> Generator[Tagged, None, None]:
    """Yield all frames in the order of their times; first those without a time."""
    kept = [block.map(copy_records) for block in blocks]
    if not kept:
        return
    whole = joined(kept)
    order = np.argsort(whole.frames["ts"], kind="stable")
    ordered = whole.map(lambda array: array.take(order))
    size = _SORTED_BLOCK if out is None else len(out)
    for at in range(0, len(order), size):
        block = ordered.map(lambda array: array[at : at + size])  # noqa: B023 - called here
        if out is not None:
            count = len(block.frames)
            put_records(out[:count], block.frames)
            block = block._replace(frames=out[:count])
        yield block


def listed(source: Sources) -> list[Source]:
    """Return the list of files of an argument that is one file or several."""
    if not isinstance(source, (list, tuple)):
        return [cast(Source, source)]  # Input refuses what is no file
    if not source:
        raise ValueError("the list of files is empty; name at least one")
    return list(source)


def _total(sources: list[Source]) -> int | None:
    """Return the bytes of all files, None if that is not known."""
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


def _gather(opened: Blocks) -> FrameArray:
    """Return the frames of all blocks, which are filled into one array again and again."""
    array = GrowingFrames(_ROOM)
    for block in opened:
        need = array.count + len(block)
        if array.room < len(block):
            done, total = opened.bytes_done, opened.bytes_total
            expected = int(need * total / done * 1.02) if done and total else 0
            array.grow(max(min(expected, 64 * need), 2 * need))
        put_records(array.frames[array.count : need], block)
        array.count = need
    return array.result()


def _is_cheap(source: Source) -> bool:
    """Return whether a file may be opened one more time, only to measure it."""
    return not isinstance(source, (str, os.PathLike)) or Path(source).is_file()


def read(
    source: Sources,
    protocol: str | None = None,
    *,
    format: str | None = None,  # noqa: A002 - as users call it
    ts_unit: str | None = None,
    offsets: Offsets | None = None,
    threads: int | None = None,
    bus: str | None = None,
    channels: Codes | None = None,
    directions: Codes | None = None,
    times: str | None = None,
    epoch: str | datetime | None = None,
    tz: tzinfo | None = None,
    sort: bool = False,
    skip_bad: bool = False,
    as_is: bool = False,
) -> FrameArray:
    """Read all frames of a file, or of several, into one new array.

    Parameters
    ----------
    source : str, path-like, binary file, or list of these
        The file to read, or several as one stream, as for `blocks`.
    protocol : str, optional
        Protocol of raw bytes: a name of `protocols()`, or "auto", as for `blocks`.
    format : str, optional
        "raw", "pcapng", "candump", "csv" or "npy"; by default as for `blocks`.
    ts_unit : str, optional
        Unit of the device's timestamps in raw bytes: "s", "ms", "us" or "ns"; "ms" by default.
    offsets : array of int64 or uint64, shape (n,), optional
        For one file of raw bytes or one recording: filled with the stream offsets of the frames,
        in bytes. It needs room for all frames.
    threads : int, optional
        Number of threads that may read a file, with the caller's, as for `blocks`.
    bus : str, optional
        Channel to read from a log of several buses, such as "can0"; all channels by default.
    channels, directions : array of uint8, shape (n,), optional
        Filled with the channels and the directions of the frames, as for `blocks`. They need room
        for all frames; those behind them stay as they were.
    times : {None, "delta"}, optional
        "delta" if times in a text log are differences, as for `blocks`.
    epoch : "file" or datetime, optional
        Time to add to all times, as for `blocks`.
    tz : datetime.tzinfo, optional
        Time zone of dates in a file, which name none; local time by default.
    sort : bool, optional
        Order all frames by their times; first those without a time. False by default.
    skip_bad : bool, optional
        Leave out what cannot be read in a log, lines of text or parts of BLF, and count it.
    as_is : bool, optional
        Read the bytes in the protocol given, whatever they look like, as for `blocks`.

    Returns
    -------
    array of FRAME_DTYPE, shape (n,)
        The frames, in an array that owns its memory.

    Warns
    -----
    CanserWarning
        As for `blocks`; also for what a file holds and the frames do not, what a recording has
        lost, and what is damaged in it.

    Raises
    ------
    ValueError
        As for `blocks`; `offsets` has no room for all frames, or is given for several files or
        with `sort`.
    FormatError
        As for `blocks`; so are NoProtocolError, WrongProtocolError, TypeError and OSError.

    See Also
    --------
    blocks : for files larger than memory, and for the counters.

    Examples
    --------
    >>> frames = canser.frames("123#01", "456#0203")
    >>> frames["ts"] = [0, 1_000_000]
    >>> written = canser.write(frames, "run.bin", "serial")
    >>> canser.read("run.bin", "serial")["id"]
    array([ 291, 1110], dtype=uint32)
    >>> frames["ts"] += 10_000_000
    >>> written = canser.write(frames, "next.log")
    >>> len(canser.read(["run.bin", "next.log"], "serial"))
    4
    """
    options = checked_options(
        format,
        protocol=protocol,
        ts_unit=ts_unit,
        offsets=offsets,
        threads=threads,
        bus=bus,
        channels=channels,
        directions=directions,
        times=times,
        epoch=epoch,
        tz=tz,
        skip_bad=skip_bad,
        as_is=as_is,
    )
    output_offsets(offsets, 0)
    _check_codes(options, 0)
    if not sort:
        options = dataclasses.replace(options, out=np.empty(_ROOM, FRAME_DTYPE))
    opened = Blocks(source, options, format=format, sort=sort, gathers=True)
    with opened:
        reader = opened._begin()  # a pipe is waited for
        alone = len(opened.sources) == 1 and not sort and epoch is None
        if alone and reader.decoder is not None:
            with named(opened.name):
                frames: FrameArray = reader.read_all(offsets)
        elif offsets is not None:
            raise ValueError("offsets are those of one file of raw bytes, or of one recording")
        else:
            frames = concat(opened) if sort else _gather(opened)
        notes = opened.notes
    for remark in notes.lines if as_is else notes.all_lines:
        warnings.warn(remark, CanserWarning, stacklevel=2)
    return frames
