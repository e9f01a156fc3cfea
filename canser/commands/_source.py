"""IN, the file that a command reads: its arguments, how it is opened, and what is told of it."""

import argparse
import contextlib
import sys
from collections.abc import Iterator
from typing import BinaryIO, Final

import numpy as np

from canser._frames import FRAME_DTYPE, match
from canser._input import Source
from canser._progress import Progress
from canser._protocols import TS_UNITS, protocols
from canser.codec.decoder import Stats
from canser.commands._numbers import date, moment, whole
from canser.commands._parser import CallError, DataError, Parser, protocol_name, write_line
from canser.errors import (
    ForeignFormatError,
    NoProtocolError,
    StreamClosedError,
    WrongProtocolError,
)
from canser.files.formats import BUILT_IN, find_format
from canser.files.judge import AUTO, is_auto
from canser.files.reader import ReadOptions
from canser.files.reading import Blocks
from canser.files.selection import Selection

__all__ = [
    "FORMATS",
    "as_is_argument",
    "bus_argument",
    "check_found",
    "format_name",
    "open_source",
    "opened",
    "options_named",
    "read_options",
    "refuse_doubtful",
    "selection",
    "selection_arguments",
    "source_arguments",
    "write_remarks",
]


def source_arguments() -> argparse.ArgumentParser:
    """Return the arguments that name a file of frames or raw bytes, IN."""
    source = Parser(add_help=False)
    source.add_argument(
        "sources",
        metavar="IN",
        nargs="+",
        help="a file, or - for standard input; several are one stream, in this order",
    )
    source.add_argument(
        "-p",
        "--protocol",
        type=protocol_or_auto,
        help=f"of raw bytes: {', '.join(protocols())}, or {AUTO}: the one that plainly fits "
        "(a recording knows it)",
    )
    source.add_argument(
        "--ts-unit",
        choices=TS_UNITS,
        help="unit of the device's timestamps in raw bytes (default: ms; a recording knows it)",
    )
    source.add_argument(
        "--from",
        dest="source_format",
        metavar="FORMAT",
        type=format_name,
        help=f"format of IN: {FORMATS} (default: by its content, else by its suffix, else raw "
        "bytes)",
    )
    bus_argument(source)
    source.add_argument(
        "--sort", action="store_true", help="order all frames by their time, in memory"
    )
    as_is_argument(source)
    return source


# The formats, as the help lists them.
FORMATS: Final = ", ".join(BUILT_IN)


def format_name(name: str) -> str:
    """Return the name of a format, of another package's too; the type of an option."""
    try:
        find_format(name)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return name


def bus_argument(parser: argparse.ArgumentParser) -> None:
    """Add the argument that names one bus of a log of several."""
    parser.add_argument(
        "--bus",
        metavar="NAME",
        help="only the frames of that channel of a log, such as can0 (default: all)",
    )


def selection_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that choose frames."""
    group = parser.add_argument_group(
        "frames",
        "TIME counts from the first frame, such as 500ms, 90s, 1h; or it is a date,\n"
        "such as 2026-11-26T08:00:00 (UTC, or with its offset, +01:00)",
    )
    group.add_argument("--start", metavar="TIME", type=moment, help="only frames from TIME on")
    group.add_argument("--end", metavar="TIME", type=moment, help="only frames before TIME")
    group.add_argument("--count", metavar="N", type=whole(least=1), help="only the first N frames")
    group.add_argument(
        "--filter",
        dest="filters",
        metavar="FILTER",
        action="append",
        default=[],
        help="only frames that pass: an id of up to three (standard) or of eight digits "
        "(extended), ID:MASK, ID~MASK (inverse) or #MASK (error frames), hexadecimal; several: "
        "any of them",
    )
    group.add_argument(
        "--epoch",
        metavar="DATE",
        type=date,
        help="when the first frame came: times that count from a device's start become dates",
    )


def selection(args: argparse.Namespace) -> Selection:
    """Return the frames that the arguments choose, or raise CallError."""
    try:
        match(np.empty(0, FRAME_DTYPE), *args.filters)
    except ValueError as error:
        raise CallError(str(error)) from None
    return Selection(
        filters=tuple(args.filters),
        start=args.start,
        end=args.end,
        count=args.count,
        epoch_ns=args.epoch,
    )


def as_is_argument(parser: argparse.ArgumentParser) -> None:
    """Add the argument that accepts bytes which do not look like their protocol."""
    parser.add_argument(
        "--as-is",
        action="store_true",
        help="accept bytes of which most lie in no packet of the protocol, that look like another "
        "format, or a recording that says another protocol",
    )


def protocol_or_auto(name: str) -> str:
    """Return the protocol's own name of a spelling, or AUTO."""
    return AUTO if is_auto(name) else protocol_name(name)


def opened(paths: list[str]) -> list[Source]:
    """Return the files of these names, "-" for the standard input, as `Blocks` takes them."""
    return [_standard_input() if path == "-" else path for path in paths]


def _standard_input() -> BinaryIO:
    if sys.stdin is None:
        raise StreamClosedError("the standard input is closed; open it, or name a file")
    return sys.stdin.buffer


def read_options(args: argparse.Namespace) -> ReadOptions:
    """Return how IN is to be read."""
    return ReadOptions(protocol=args.protocol, ts_unit=args.ts_unit, bus=args.bus, as_is=args.as_is)


def open_source(args: argparse.Namespace, progress: Progress | None = None) -> Blocks:
    """Open IN as the arguments say."""
    with options_named():
        return Blocks(
            opened(args.sources),
            read_options(args),
            format=args.source_format,
            progress=progress,
            sort=args.sort,
        )


@contextlib.contextmanager
def options_named(*, protocol: bool = True) -> Iterator[None]:
    """Let errors of opening a file name the options that help; `protocol`: the protocol's, too."""
    try:
        yield
    except NoProtocolError as error:
        if not protocol:
            raise
        raise CallError(f"{error.looks}; give -p {' or -p '.join(error.choices)}") from None
    except WrongProtocolError as error:
        raise CallError(f"{error.what}; leave -p out, or accept it by --as-is") from None
    except ForeignFormatError as error:
        if error.option:
            raise CallError(f"{error.what}; leave -p out, or read the bytes by --as-is") from None
        raise


def check_found(source: Blocks, *, as_is: bool) -> None:
    """Raise DataError if the bytes are not of the protocol that they were read in."""
    if source.protocol is not None and source.stats is not None and not as_is:
        refuse_doubtful(source.name, source.protocol, source.stats, source.notes.doubt)


def refuse_doubtful(name: str, protocol: str, stats: Stats, doubt: str) -> None:
    """Raise DataError if there is a doubt that bytes are of a protocol, or no packet in them."""
    if doubt:
        raise DataError(f"{doubt}; --as-is accepts them")
    if stats.bytes_in and not stats.frames and not stats.controls:
        raise DataError(
            f"no {protocol} frame in the {stats.bytes_in:,} bytes of {name}; --as-is accepts them"
        )


def write_remarks(source: Blocks) -> None:
    """Print on standard error what is to be known of files."""
    for remark in source.notes.lines:
        write_line(remark)
