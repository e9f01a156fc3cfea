"""What the commands share: the parser, exit codes, errors, messages."""

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NoReturn

from canser._output import standard_output
from canser._protocols import protocol
from canser.commands import COMMANDS

__all__ = [
    "BAD_CALL",
    "BAD_DATA",
    "GOOD",
    "CallError",
    "Commands",
    "DataError",
    "Parser",
    "add_command",
    "protocol_name",
    "show",
    "write_line",
]

# Exit codes.
GOOD, BAD_DATA, BAD_CALL = 0, 1, 2

# Where a command adds its parser.
Commands = Any


class CallError(Exception):
    """The call is wrong; the message says what and the remedy."""


class DataError(Exception):
    """The data is bad; the message says what and the remedy."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """End the program with a line that says what is wrong."""
        self.exit(BAD_CALL, f"{self.prog}: {message}; see {self.prog} --help\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        # A help or a version: `show` tells of a standard output that is full or closed.
        if file is not None and file is not sys.stderr:
            show(message.splitlines())
        else:
            super()._print_message(message, file)


def add_command(
    commands: Commands,
    name: str,
    example: str,
    *,
    run: Callable[[argparse.Namespace], int],
    parents: Sequence[argparse.ArgumentParser] = (),
) -> argparse.ArgumentParser:
    """Add a command, with its line of help and its examples; return its parser."""
    about = COMMANDS[name]
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


def show(lines: Iterable[str]) -> None:
    """Print lines on the standard output."""
    with standard_output() as out:
        out.write("".join(f"{line}\n" for line in lines).encode())


def write_line(text: str) -> None:
    """Print a line on standard error: standard output is for the data."""
    print(text, file=sys.stderr)


def protocol_name(name: str) -> str:
    """Return the protocol's own name of a spelling."""
    try:
        return protocol(name).name
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
