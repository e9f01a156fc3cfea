"""Write frames to a file of any format, and convert files."""

import dataclasses
import os
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime, tzinfo
from typing import Any, BinaryIO

import numpy as np

from canser._core.text import Codes
from canser._frames import FRAME_DTYPE, FrameArray, check_codes, refuse_mask
from canser._output import check_apart
from canser._protocols import protocol as protocol_of
from canser._protocols import protocols, tick_ns
from canser.errors import CanserWarning, FormatError
from canser.files.formats import PCAPNG, RAW, find_format, format_names, format_of_name
from canser.files.judge import check_protocol, is_auto
from canser.files.packed import packed_file, without_packing
from canser.files.raw import RawReader
from canser.files.reader import ReadOptions
from canser.files.reading import START, Blocks, Sources, checked_options, listed
from canser.files.recordings import RecordingReader, open_writer
from canser.files.selection import Selection
from canser.files.tags import TagCounts, Tagged
from canser.files.writer import WriteOptions

__all__ = ["Converted", "choose_target", "convert", "convert_opened", "write"]

# Formats that hold the bytes of a serial line.
BYTES = (RAW, PCAPNG)

_EVERYTHING = Selection()


@dataclass(slots=True)
class Converted:
    """What is in a file that was written; returned by `write` and `convert`."""

    #: Number of frames in the file; 0 if `copied`.
    frames: int = 0
    #: Bytes of a serial line in the file; 0 for a format that holds frames.
    bytes_out: int = 0
    #: What the file could not hold, a line each.
    remarks: list[str] = field(default_factory=list)
    #: Whether the bytes of a recording were copied, without decoding a frame.
    copied: bool = False


def choose_target(path: str, given: str | None) -> str:
    """Return the format of a file to write: the given one, or that of its name.

    ValueError if neither names one, and for a format that canser only reads.
    """
    chosen = given or format_of_name(path)
    if chosen is None:
        suffixes = [find_format(name).suffixes[0] for name in format_names()]
        raise ValueError(
            f"cannot tell the format of {path} by its suffix; use {', '.join(suffixes)}, or name "
            "the format"
        )
    if find_format(chosen).write is None:
        raise ValueError(f"{path}: canser reads {chosen}, and does not write it")
    if chosen == PCAPNG and without_packing(path) != path:
        raise ValueError(
            f"{path}: a recording is made safe on the disk as it grows, and cannot be packed; name "
            f"it {without_packing(path)}"
        )
    return chosen


def start_epoch(chosen: str) -> str | None:
    """Return the epoch for files that are converted to a format, if no other one is given."""
    return None if chosen == RAW else START


def check_target(chosen: str, protocol: str | None, source: str = "") -> None:
    """Raise ValueError if bytes of a line are to be written and their protocol is not known.

    Also if they are to be written in their own format. `source`: the format that is read, ""
    if it is not known.
    """
    if chosen in BYTES and chosen == source:
        raise ValueError(
            f"input and output are both {find_format(chosen).about}; convert to another format, "
            "such as .log, and from there to another protocol"
        )
    if chosen in BYTES and source not in BYTES and (protocol is None or is_auto(protocol)):
        raise ValueError(
            f"{find_format(chosen).about} need{'s' * (chosen == PCAPNG)} a protocol: "
            f"{', '.join(protocols())}"
        )


def open_to_convert(source: Sources, options: ReadOptions, **more: Any) -> Blocks:
    """Open files to convert. The given protocol may be that of the file to write.

    A recording has a protocol of its own. WrongProtocolError if another one is given, unless
    `options.as_is` reads the recording in that one.
    """
    blocks = Blocks(source, dataclasses.replace(options, raw_only=True), **more)
    info, given = blocks.recording, options.protocol
    if info is None or given is None or is_auto(given) or protocol_of(given).name == info.protocol:
        return blocks
    blocks.close()
    return Blocks(source, options, **more)


def write(
    frames: FrameArray | Iterable[FrameArray],
    path: str | os.PathLike[str],
    protocol: str | None = None,
    *,
    format: str | None = None,  # noqa: A002 - as users call it
    channels: Codes | None = None,
    directions: Codes | None = None,
    ts_unit: str = "ms",
    tz: tzinfo | None = None,
    strict: bool = False,
    force: bool = False,
) -> Converted:
    """Write frames to a file.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,), or iterable of these
        The frames. An iterable, such as `canser.blocks`, is written block by block.
    path : str or path-like
        The file to write. It gets this name when it is complete.
    protocol : str, optional
        Protocol of raw bytes or of a recording: a name of `protocols()`. Other formats need none.
    format : str, optional
        "raw", "pcapng" (a recording), "pcap" (a capture, in pcapng if the name ends in .pcapng),
        "candump", "csv", "npy", or a format that another package adds. By default the suffix of
        the file's name decides.
    channels, directions : array of uint8, shape (n,), optional
        With one array of frames: their channels, numbers from 0 and 255 for not told, and their
        directions, 1 for sent and 0 for received. `canser.blocks` brings its own.
    ts_unit : str, optional
        Unit of the device's timestamps in raw bytes: "s", "ms", "us" or "ns"; "ms" by default.
    tz : datetime.tzinfo, optional
        Time zone of dates in the file, which name none; local time by default.
    strict : bool, optional
        Refuse frames that the protocol cannot carry. By default they are left out and counted.
    force : bool, optional
        Replace an existing file. False by default.

    Returns
    -------
    Converted
        What is in the file.

    Warns
    -----
    CanserWarning
        The file could not hold all of the frames or of their fields.

    Raises
    ------
    OutputExistsError
        A FileExistsError: the file exists, and `force` is False.
    ValueError
        The format is not known or is only read, raw bytes or a recording have no protocol, or
        with `strict` the protocol cannot carry a frame.
    FormatError
        The protocol can carry none of the frames.
    TypeError
        `frames` are no arrays of FRAME_DTYPE in one dimension.
    OSError
        The file cannot be written.

    Examples
    --------
    >>> frames = canser.frames("123#01", "456#0203")
    >>> frames["ts"] = [0, 1_000_000]
    >>> canser.write(frames, "run.log").frames
    2
    >>> canser.write(frames, "run.pcapng", "serial").bytes_out
    25
    >>> canser.write(canser.blocks("run.log"), "run.csv")
    Converted(frames=2, bytes_out=0, remarks=[], copied=False)
    """
    name = os.fsdecode(path)
    chosen = choose_target(name, format)
    check_target(chosen, protocol)
    options = WriteOptions(protocol=protocol, ts_unit=ts_unit, strict=strict, tz=tz, name=name)
    tick_ns(ts_unit)
    tagged: Iterable[Tagged]
    if isinstance(frames, Blocks):
        options = dataclasses.replace(options, channel_names=frames.keep_tags())
        tagged = frames.tagged()
    elif isinstance(frames, np.ndarray):
        tagged = [_tagged(frames, channels, directions)]
    else:
        if channels is not None or directions is not None:
            raise ValueError("channels and directions go with one array of frames")
        tagged = (_tagged(each) for each in frames)
    with packed_file(name, force=force) as file:
        done = _write_all(tagged, file, chosen, options)
    for remark in done.remarks:
        warnings.warn(f"{name}: {remark}", CanserWarning, stacklevel=2)
    return done


def _tagged(
    frames: FrameArray, channels: Codes | None = None, directions: Codes | None = None
) -> Tagged:
    """Return frames with their channels and directions, checked."""
    if getattr(frames, "dtype", None) != FRAME_DTYPE or frames.ndim != 1:
        raise TypeError("frames must be arrays of canser.FRAME_DTYPE in one dimension")
    refuse_mask(frames, "frames")
    for name, codes in (("channels", channels), ("directions", directions)):
        if codes is not None:
            check_codes(codes, name, frames)
    return Tagged(frames, channels, directions).map(np.ascontiguousarray)


def convert(
    source: Sources,
    target: str | os.PathLike[str],
    protocol: str | None = None,
    *,
    format: str | None = None,  # noqa: A002 - as users call it
    to: str | None = None,
    ts_unit: str | None = None,
    epoch: str | datetime | None = None,
    tz: tzinfo | None = None,
    times: str | None = None,
    bus: str | None = None,
    sort: bool = False,
    skip_bad: bool = False,
    strict: bool = False,
    force: bool = False,
    as_is: bool = False,
) -> Converted:
    """Convert one file or several into one file.

    Memory is bounded, unless frames are sorted. A recording becomes raw bytes, and raw bytes
    become a recording, without a change to their bytes.

    Parameters
    ----------
    source : str, path-like, binary file, or list of these
        The file to read, or several as one stream, as for `blocks`.
    target : str or path-like
        The file to write. It gets this name when it is complete.
    protocol : str, optional
        Protocol of raw bytes: of those that are read, or of those that are written.
    format : str, optional
        Format of `source`; by default as for `blocks`.
    to : str, optional
        Format of `target`; by default the suffix of its name decides.
    ts_unit : str, optional
        Unit of the device's timestamps in raw bytes, read or written: "s", "ms", "us" or "ns";
        "ms" by default.
    epoch : "file" or datetime, optional
        Time to add to all times, as for `read`. By default it is the start that the file names, and
        a remark says so; raw bytes get times as the file states them.
    tz : datetime.tzinfo, optional
        Time zone of dates in the files, which name none; local time by default.
    times : {None, "delta"}, optional
        "delta" if times in a text log are differences, as for `read`.
    bus : str, optional
        Channel to read, as for `read`; all channels by default.
    sort : bool, optional
        Order all frames by their times, as for `read`. False by default.
    skip_bad : bool, optional
        Leave out what cannot be read in a log, lines of text or parts of BLF, and count it.
    strict : bool, optional
        Refuse frames that the protocol cannot carry. By default they are left out and counted.
    force : bool, optional
        Replace an existing file. False by default.
    as_is : bool, optional
        Read the bytes in the protocol given, whatever they look like, as for `blocks`.

    Returns
    -------
    Converted
        What is in the file.

    Warns
    -----
    CanserWarning
        As for `read` and `write`.

    Raises
    ------
    OutputExistsError
        A FileExistsError: the target exists and `force` is False, or it is one of the sources.
    FormatError
        As for `read` and `write`; also if the bytes are not of their protocol, unless `as_is`.
    ValueError
        As for `read` and `write`; also if raw bytes would become raw bytes, or a recording a
        recording.
    OSError
        A file cannot be read or written.

    Examples
    --------
    >>> frames = canser.frames("123#01", "456#0203")
    >>> frames["ts"] = [0, 1_000_000]
    >>> recorded = canser.write(frames, "run.pcapng", "serial")
    >>> canser.convert("run.pcapng", "run.bin").bytes_out
    25
    >>> canser.convert("run.bin", "run.csv", "serial").frames
    2
    """
    check_protocol(protocol, ts_unit)
    name = os.fsdecode(target)
    named = [os.fsdecode(each) for each in listed(source) if isinstance(each, (str, os.PathLike))]
    check_apart(name, *named)
    chosen = choose_target(name, to)
    options = checked_options(
        format,
        protocol=protocol,
        ts_unit=ts_unit,
        bus=bus,
        times=times,
        epoch=epoch or start_epoch(chosen),
        tz=tz,
        skip_bad=skip_bad,
        as_is=as_is,
    )
    writing = WriteOptions(
        protocol=protocol, ts_unit=ts_unit or "ms", strict=strict, tz=tz, name=name
    )
    with open_to_convert(source, options, format=format, sort=sort) as blocks:
        check_target(chosen, protocol, blocks.format)
        with packed_file(name, force=force) as file:
            done = convert_opened(blocks, file, chosen, writing)
            notes = blocks.notes
            if notes.doubt and not as_is:
                raise FormatError(f"{notes.doubt}; as_is=True accepts them")
    for remark in [
        *notes.lines,
        *(f"{name}: {each}" for each in done.remarks),
    ]:
        warnings.warn(remark, CanserWarning, stacklevel=2)
    return done


def convert_opened(
    blocks: Blocks,
    file: BinaryIO,
    to: str,
    options: WriteOptions,
    selection: Selection = _EVERYTHING,
) -> Converted:
    """Write the frames of opened files to a file in a format.

    If all frames of one file are selected, and both formats hold the bytes of a line, the bytes
    are copied. Otherwise, if `options` have no protocol, bytes are written in the protocol of the
    bytes that are read.
    """
    if selection.is_all and len(blocks.sources) == 1 and blocks.format in BYTES and to in BYTES:
        return _copy_bytes(blocks, file, options)
    if to in BYTES and options.protocol is None:
        options = dataclasses.replace(options, protocol=blocks.decoder.protocol)
    options = dataclasses.replace(options, channel_names=blocks.keep_tags())
    try:
        return _write_all(selection.apply(blocks.tagged()), file, to, options)
    except FormatError as error:
        if to not in BYTES:
            raise
        raise FormatError(f"{blocks.name}: {error}") from None


def _write_all(
    blocks: Iterable[Tagged], file: BinaryIO, to: str, options: WriteOptions
) -> Converted:
    writer = find_format(to).write(file, options)
    takes_tags = getattr(writer, "takes_tags", False)
    counts = TagCounts()
    done = Converted()
    try:
        for frames, channels, directions in blocks:
            if takes_tags:
                writer.write(frames, channels, directions)
            else:
                writer.write(frames)
                counts.add(channels, directions, len(frames))
            done.frames += len(frames)
        last = writer.finish()
    except BaseException:
        getattr(writer, "abandon", _nothing)()
        raise
    names = options.channel_names
    done.remarks += counts.channel_remarks(lambda code: names.get(code, str(code)))
    done.remarks += [*counts.direction_remarks(), *last]
    if to in BYTES:
        done.frames, done.bytes_out = writer.frames, writer.bytes_out
    return done


def _nothing() -> None:
    """End a writer that holds nothing."""


def _copy_bytes(blocks: Blocks, file: BinaryIO, options: WriteOptions) -> Converted:
    """Copy the bytes of a line out of a recording, or into one."""
    done = Converted()
    reader = blocks.reader
    if isinstance(reader, RecordingReader):
        done.copied = True
        for data in reader.line_bytes():
            file.write(data)
            done.bytes_out += len(data)
    elif isinstance(reader, RawReader):
        protocol = reader.decoder.protocol
        with open_writer(file, dataclasses.replace(options, protocol=protocol)) as writer:
            for data, ns in reader.timed_bytes():
                writer.write(data, ns)
                done.bytes_out += len(data)
        done.frames = reader.decoder.stats.frames
        done.remarks.append("times count from the start of the device's clock, or of the line")
    return done
