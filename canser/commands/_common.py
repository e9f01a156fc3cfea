"""What the commands share: exit codes, errors, messages, and how the input is named."""

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NoReturn

from canser._output import standard_output
from canser._progress import Progress
from canser.captures import NoProtocolError
from canser.codec import TS_UNITS, Decoder, protocols
from canser.files import FORMATS, FrameFile, format_of

__all__ = [
    "BAD_CALL",
    "BAD_DATA",
    "GOOD",
    "CallError",
    "Commands",
    "DataError",
    "Parser",
    "ProtocolNeededError",
    "add_command",
    "check_found",
    "open_source",
    "protocol_name",
    "say",
    "say_remarks",
    "show",
    "source_arguments",
]

# Exit codes.
GOOD, BAD_DATA, BAD_CALL = 0, 1, 2

# Where a command adds its parser.
Commands = Any


class CallError(Exception):
    """The call is wrong; the message says what and the remedy."""


class ProtocolNeededError(CallError):
    """Raw bytes are to be read, and nobody said in which protocol."""


class DataError(Exception):
    """The data is bad; the message says what and the remedy."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """End the program with a line that says what is wrong."""
        self.exit(BAD_CALL, f"{self.prog}: {message}; see {self.prog} --help\n")


def add_command(
    commands: Commands,
    name: str,
    about: str,
    example: str,
    *,
    run: Callable[[argparse.Namespace], int],
    parents: Sequence[argparse.ArgumentParser] = (),
) -> argparse.ArgumentParser:
    """Add a command, with its line of help and its examples; return its parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        parents=parents,
        help=about,
        description=about[0].upper() + about[1:] + ".",
        epilog=f"examples:\n{example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    return parser


def source_arguments() -> argparse.ArgumentParser:
    """Return the arguments that name a file of frames or raw bytes, IN."""
    source = Parser(add_help=False)
    source.add_argument("source", metavar="IN", help="a file, or - for standard input")
    source.add_argument(
        "-p",
        "--protocol",
        type=protocol_name,
        help=f"of raw bytes: {', '.join(protocols())} (a recording knows it)",
    )
    source.add_argument(
        "--ts-unit",
        choices=TS_UNITS,
        help="unit of the device's timestamps in raw bytes (default: ms; a recording knows it)",
    )
    source.add_argument(
        "--from",
        dest="source_format",
        choices=FORMATS,
        help="format of IN (default: by its suffix; else raw bytes or a recording)",
    )
    return source


def protocol_name(name: str) -> str:
    """Return the protocol's own name of a spelling."""
    try:
        return Decoder(name).protocol
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def open_source(args: argparse.Namespace, progress: Progress | None = None) -> FrameFile:
    """Open IN as the arguments say."""
    try:
        return FrameFile(
            args.source,
            format_of(args.source, args.source_format),
            protocol=args.protocol,
            ts_unit=args.ts_unit,
            progress=progress,
        )
    except NoProtocolError:
        known = f"canser info {args.source}" if args.source != "-" else "canser info"
        raise ProtocolNeededError(
            f"{args.source} holds raw bytes: name their protocol with -p "
            f"({', '.join(protocols())}); '{known}' tells which fits"
        ) from None


def check_found(source: FrameFile) -> None:
    """Raise DataError if there were bytes, but nothing of the protocol."""
    if source.decoder is None:
        return
    stats = source.decoder.stats
    if stats.bytes_in and not stats.frames and not stats.controls:
        raise DataError(
            f"no {source.decoder.protocol} frame in the {stats.bytes_in:,} bytes of "
            f"{source.name}; 'canser info' without -p tells which protocol fits"
        )


def say_remarks(source: FrameFile) -> None:
    """Print on standard error what is to be known of a recording."""
    for remark in source.remarks:
        say(f"{source.name}: {remark}")


def show(lines: Iterable[str]) -> None:
    """Print lines on the standard output."""
    with standard_output() as out:
        out.write("".join(f"{line}\n" for line in lines).encode())


def say(text: str) -> None:
    """Print a line on standard error: standard output is for the data."""
    print(text, file=sys.stderr)
