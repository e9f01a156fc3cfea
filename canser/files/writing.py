"""Frames into a file of any format, and files into files."""

import dataclasses
import os
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np

from canser._frames import FRAME_DTYPE, FrameArray, refuse_mask
from canser._output import check_apart, whole_file
from canser._protocols import protocol as protocol_of
from canser._protocols import protocols, tick_ns
from canser.errors import CanserWarning, FormatError
from canser.files.formats import PCAPNG, RAW, find_format, format_names, format_of_name
from canser.files.judge import check_protocol, is_auto
from canser.files.raw import RawReader
from canser.files.reader import ReadOptions
from canser.files.reading import Blocks, Sources, listed
from canser.files.recordings import RecordingReader, open_writer
from canser.files.selection import Selection
from canser.files.writer import WriteOptions

__all__ = ["Converted", "choose_target", "convert", "convert_opened", "write"]

# Formats that hold the bytes of a line.
BYTES = (RAW, PCAPNG)

_EVERYTHING = Selection()


@dataclass(slots=True)
class Converted:
    """What has become of frames that were written.

    Attributes
    ----------
    frames : int
        Frames that are in the file.
    bytes_out : int
        Bytes of a line that are in the file; 0 for a format that holds frames.
    remarks : list of str
        What the file could not hold.
    copied : bool
        Whether the bytes of a recording were copied, and no frame was decoded.
    """

    frames: int = 0
    bytes_out: int = 0
    remarks: list[str] = field(default_factory=list)
    copied: bool = False


def choose_target(path: str, given: str | None) -> str:
    """Return the format of a file to write: the given one, or that of its name.

    ValueError where neither tells, and for a format that is only read.
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
    return chosen


def check_target(chosen: str, protocol: str | None, source: str = "") -> None:
    """Raise ValueError for raw bytes or a recording of which no protocol is known, and for two.

    `source`: the format that is read, if it is known.
    """
    if chosen in BYTES and chosen == source:
        raise ValueError(
            f"IN and OUT are both {find_format(chosen).about}; convert to another format, such as "
            ".log, and from there to another protocol"
        )
    if chosen in BYTES and source not in BYTES and (protocol is None or is_auto(protocol)):
        raise ValueError(
            f"{find_format(chosen).about} need{'s' * (chosen == PCAPNG)} a protocol: "
            f"{', '.join(protocols())}"
        )


def open_to_convert(source: Sources, options: ReadOptions, **more: Any) -> Blocks:
    """Open files of which the protocol that is given may be that of the file to write.

    A recording has a protocol of its own. WrongProtocolError where another one is given, unless
    `options.as_is` reads it in that.
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
    ts_unit: str = "ms",
    strict: bool = False,
    force: bool = False,
) -> Converted:
    """Write frames into a file.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,), or an iterable of these
        The frames; an iterable, such as `canser.blocks`, is written block by block.
    path : path
        The file. It gets its name when it is complete.
    protocol : str, optional
        Of raw bytes and of a recording, a name of `protocols()`.
    format : str, optional
        A format as `blocks` names them; by default that of the file's name.
    ts_unit : str
        Unit of the device's timestamps in raw bytes, "s", "ms", "us" or "ns".
    strict : bool
        Refuse frames that the protocol cannot carry. By default they are left out, and counted.
    force : bool
        Replace a file that is there.

    Returns
    -------
    Converted
        What is in the file.

    Warns
    -----
    CanserWarning
        For what the file could not hold.

    Raises
    ------
    OutputExistsError
        A FileExistsError, for a file that is there.
    ValueError
        For a format that is not known, raw bytes without a protocol, and with `strict` for
        frames that the protocol cannot carry.

    Examples
    --------
    >>> canser.write(frames, "run.log")
    >>> canser.write(canser.blocks("run.pcapng"), "run.csv", force=True)
    """
    name = os.fsdecode(path)
    chosen = choose_target(name, format)
    check_target(chosen, protocol)
    options = WriteOptions(protocol=protocol, ts_unit=ts_unit, strict=strict)
    tick_ns(ts_unit)
    blocks = [frames] if isinstance(frames, np.ndarray) else frames
    with whole_file(name, force=force) as file:
        done = _write_all(map(_checked, blocks), file, chosen, options)
    for remark in done.remarks:
        warnings.warn(f"{name}: {remark}", CanserWarning, stacklevel=2)
    return done


def _checked(frames: FrameArray) -> FrameArray:
    if getattr(frames, "dtype", None) != FRAME_DTYPE or frames.ndim != 1:
        raise TypeError("frames must be arrays of canser.FRAME_DTYPE in one dimension")
    refuse_mask(frames, "frames")
    return np.ascontiguousarray(frames)


def convert(
    source: Sources,
    target: str | os.PathLike[str],
    protocol: str | None = None,
    *,
    format: str | None = None,  # noqa: A002 - as users call it
    to: str | None = None,
    ts_unit: str | None = None,
    sort: bool = False,
    strict: bool = False,
    force: bool = False,
    as_is: bool = False,
) -> Converted:
    """Convert files into one file, in bounded memory.

    A recording becomes raw bytes, and raw bytes become a recording, byte by byte.

    Parameters
    ----------
    source, format, sort, as_is
        As for `blocks`.
    target, strict, force
        As `path`, `strict` and `force` of `write`.
    protocol, ts_unit : str, optional
        Of raw bytes: of those that are read, or of those that are written.
    to : str, optional
        The format of `target`; by default that of its name.

    Returns
    -------
    Converted
        What is in the file.

    Warns
    -----
    CanserWarning
        As `read` and `write`.

    Raises
    ------
    OutputExistsError
        A FileExistsError, for a target that is there, or that is one of the sources.
    ValueError, FormatError, OSError
        As `read` and `write`.

    Examples
    --------
    >>> canser.convert("run.pcapng", "run.log")
    >>> canser.convert(["a.log", "b.log"], "both.bin", "serial")
    """
    check_protocol(protocol, ts_unit)
    name = os.fsdecode(target)
    named = [os.fsdecode(each) for each in listed(source) if isinstance(each, (str, os.PathLike))]
    check_apart(name, *named)
    chosen = choose_target(name, to)
    options = ReadOptions(protocol=protocol, ts_unit=ts_unit, as_is=as_is)
    writing = WriteOptions(protocol=protocol, ts_unit=ts_unit or "ms", strict=strict)
    with open_to_convert(source, options, format=format, sort=sort) as blocks:
        check_target(chosen, protocol, blocks.format)
        with whole_file(name, force=force) as file:
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

    Where all frames of one file are wanted, and both formats have the bytes of a line, these
    are copied. Else the protocol of bytes that are written is that of the bytes that are read,
    if `options` have none.
    """
    if selection.is_all and len(blocks.sources) == 1 and blocks.format in BYTES and to in BYTES:
        return _copy_bytes(blocks, file, options)
    if to in BYTES and options.protocol is None:
        options = dataclasses.replace(options, protocol=blocks.decoder.protocol)
    try:
        return _write_all(selection.apply(blocks), file, to, options)
    except FormatError as error:
        if to not in BYTES:
            raise
        raise FormatError(f"{blocks.name}: {error}") from None


def _write_all(
    blocks: Iterable[FrameArray], file: BinaryIO, to: str, options: WriteOptions
) -> Converted:
    writer = find_format(to).write(file, options)
    done = Converted()
    for frames in blocks:
        writer.write(frames)
        done.frames += len(frames)
    done.remarks += writer.finish()
    if to in BYTES:
        done.frames, done.bytes_out = writer.frames, writer.bytes_out
    return done


def _copy_bytes(blocks: Blocks, file: BinaryIO, options: WriteOptions) -> Converted:
    """Copy the bytes of a line from a recording, or into one."""
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
