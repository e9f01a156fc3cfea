"""IN, the files that a command reads: arguments, opening, remarks, errors."""

import argparse
import contextlib
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import BinaryIO, Final

import numpy as np

from canser._frames import FRAME_DTYPE, FrameArray, match
from canser._input import Source
from canser._progress import Progress
from canser._protocols import TS_UNITS, protocols
from canser.codec.decoder import Stats
from canser.commands._numbers import FILE, epoch, moment, time_zone, whole
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
    "check_found",
    "format_name",
    "log_arguments",
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


def source_arguments(*, two: bool = False) -> argparse.ArgumentParser:
    """Return the arguments that name a file of frames or raw bytes, IN; or two of them, A and B."""
    source = Parser(add_help=False)
    if two:
        source.add_argument("a", metavar="A", help="file to read, or - for standard input")
        source.add_argument("b", metavar="B", help="file to compare it with")
    else:
        source.add_argument(
            "sources",
            metavar="IN",
            nargs="+",
            help="file to read, or - for standard input; several files are one stream, in this "
            "order",
        )
    source.add_argument(
        "-p",
        "--protocol",
        type=protocol_or_auto,
        help=f"protocol of raw bytes: {', '.join(protocols())}, or {AUTO} for the one that fits "
        "clearly (a recording names its protocol)",
    )
    source.add_argument(
        "--ts-unit",
        choices=TS_UNITS,
        help="unit of the timestamps of the device in raw bytes (default: ms; a recording names "
        "its unit)",
    )
    source.add_argument(
        "--from",
        dest="source_format",
        metavar="FORMAT",
        type=format_name,
        help=f"format of IN: {FORMATS} (default: by its content, otherwise by its suffix, "
        "otherwise raw)",
    )
    log_arguments(source)
    source.add_argument(
        "--sort",
        action="store_true",
        help="order all frames by their times; all must fit into memory (default: as in IN)",
    )
    as_is_argument(source)
    return source


# The formats in the order of the help.
FORMATS: Final = ", ".join(BUILT_IN)


def format_name(name: str) -> str:
    """Return the name of a format, also of one that a plugin adds; an argparse type."""
    try:
        find_format(name)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return name


def log_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments about logs of other programs."""
    parser.add_argument(
        "--bus",
        metavar="NAME",
        help="read only the frames of this channel of a log, such as can0 or 1 (default: all)",
    )
    parser.add_argument(
        "--times",
        choices=("delta",),
        help="delta: times of a text log are differences, as candump -td prints them, and are "
        "added up (default: they are times)",
    )
    parser.add_argument(
        "--tz",
        metavar="ZONE",
        type=time_zone,
        help="time zone of dates in logs, which name none: UTC, +01:00 or Europe/Berlin (default: "
        "that of this computer)",
    )
    parser.add_argument(
        "--skip-bad",
        action="store_true",
        help="leave out lines of a text log that cannot be read, and count them (default: they are "
        "an error)",
    )


def selection_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that choose frames."""
    group = parser.add_argument_group(
        "frames",
        "TIME is a time after the first frame, such as 500ms, 90s or 1h, or a date\n"
        "such as 2026-11-26T08:00:00 (UTC, unless an offset such as +01:00 follows)",
    )
    group.add_argument(
        "--start",
        metavar="TIME",
        type=moment,
        help="take only frames at TIME or later (default: from the first)",
    )
    group.add_argument(
        "--end",
        metavar="TIME",
        type=moment,
        help="take only frames before TIME (default: to the last)",
    )
    group.add_argument(
        "--count",
        metavar="N",
        type=whole(least=1),
        help="take only the first N of the chosen frames (default: all)",
    )
    group.add_argument(
        "--filter",
        dest="filters",
        metavar="FILTER",
        action="append",
        default=[],
        help="take only frames that match, in hexadecimal: an id of up to 3 digits (standard) or "
        "of 8 digits (extended), ID:MASK, ID~MASK (inverse) or #MASK (error frames); given "
        "several times, a frame must match one of them (default: all)",
    )
    group.add_argument(
        "--epoch",
        metavar="DATE",
        type=epoch,
        help="date of the first frame; times that count from the start of the device become "
        "dates. Or file: add the start that the file names, such as an ASC log (default: the "
        "times stay; convert adds that start)",
    )


def selection(args: argparse.Namespace) -> Selection:
    """Return the selection of frames that the arguments mean; CallError for a wrong filter."""
    try:
        match(np.empty(0, FRAME_DTYPE), *args.filters)
    except ValueError as error:
        raise CallError(str(error)) from None
    return Selection(
        filters=tuple(args.filters),
        start=args.start,
        end=args.end,
        count=args.count,
        epoch_ns=None if args.epoch == FILE else args.epoch,
    )


def as_is_argument(parser: argparse.ArgumentParser) -> None:
    """Add the argument that accepts bytes that do not look like their protocol."""
    parser.add_argument(
        "--as-is",
        action="store_true",
        help="accept raw bytes that are mostly outside packets of the protocol or look like "
        "another format, and a recording of another protocol (default: refuse them)",
    )


def protocol_or_auto(name: str) -> str:
    """Return the name of the protocol that a spelling means, or AUTO."""
    return AUTO if is_auto(name) else protocol_name(name)


def opened(paths: list[str]) -> list[Source]:
    """Return the files of these names as `Blocks` takes them; "-" is standard input."""
    return [_standard_input() if path == "-" else path for path in paths]


def _standard_input() -> BinaryIO:
    if sys.stdin is None:
        raise StreamClosedError("the standard input is closed; open it, or name a file")
    return sys.stdin.buffer


def read_options(args: argparse.Namespace) -> ReadOptions:
    """Return the options for reading IN."""
    return ReadOptions(
        protocol=args.protocol,
        ts_unit=args.ts_unit,
        bus=args.bus,
        times=args.times,
        tz=args.tz,
        skip_bad=args.skip_bad,
        epoch=FILE if getattr(args, "epoch", None) == FILE else None,
        as_is=args.as_is,
    )


def open_source(
    args: argparse.Namespace,
    progress: Progress | None = None,
    *,
    raw_only: bool = False,
    out: FrameArray | None = None,
) -> Blocks:
    """Open IN as the arguments say; `raw_only`: only raw bytes need the protocol.

    `out`: the array that is filled again for each block.
    """
    with options_named():
        return Blocks(
            opened(args.sources),
            replace(read_options(args), raw_only=raw_only, out=out),
            format=args.source_format,
            progress=progress,
            sort=args.sort,
        )


@contextlib.contextmanager
def options_named(*, protocol: bool = True) -> Iterator[None]:
    """Let errors of opening a file name the options that help; `protocol`: -p among them."""
    try:
        yield
    except NoProtocolError as error:
        if not protocol:
            raise
        raise CallError(f"{error.looks}; give -p {' or -p '.join(error.choices)}") from None
    except WrongProtocolError as error:
        raise CallError(f"{error.what}; leave -p out, or accept it with --as-is") from None
    except ForeignFormatError as error:
        if error.option:
            raise CallError(f"{error.what}; leave -p out, or read the bytes with --as-is") from None
        raise


def check_found(source: Blocks, *, as_is: bool) -> None:
    """Raise DataError if the bytes do not look like the protocol in which they were read."""
    if source.protocol is not None and source.stats is not None and not as_is:
        refuse_doubtful(source.name, source.protocol, source.stats, source.notes.doubt)


def refuse_doubtful(name: str, protocol: str, stats: Stats, doubt: str) -> None:
    """Raise DataError if the protocol of bytes is in doubt, or they hold no packet."""
    if doubt:
        raise DataError(f"{doubt}; --as-is accepts them")
    if stats.bytes_in and not stats.frames and not stats.controls:
        raise DataError(
            f"no {protocol} frame in the {stats.bytes_in:,} bytes of {name}; --as-is accepts them"
        )


def write_remarks(source: Blocks) -> None:
    """Print the remarks on files on standard error."""
    for remark in source.notes.lines:
        write_line(remark)
