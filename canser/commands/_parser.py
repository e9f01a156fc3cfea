"""The parser, exit codes, errors and messages that all commands share."""

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

# Exit codes: success; the data is bad; the call is wrong.
GOOD, BAD_DATA, BAD_CALL = 0, 1, 2

# The object that argparse's `add_subparsers` returns; its class is private.
Commands = Any


class CallError(Exception):
    """The call is wrong; the message gives the fault and the remedy."""


class DataError(Exception):
    """The data is bad; the message gives the fault and the remedy."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """End the program with one line that gives the fault."""
        self.exit(BAD_CALL, f"{self.prog}: {message}; see {self.prog} --help\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        # The help or the version. `show` reports a standard output that is full or closed.
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
    """Add a command with its help and its examples; return its parser."""
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
    """Print lines on standard output."""
    with standard_output() as out:
        out.write("".join(f"{line}\n" for line in lines).encode())


def write_line(text: str) -> None:
    """Print a line on standard error; standard output is for data only."""
    print(text, file=sys.stderr)


def protocol_name(name: str) -> str:
    """Return the name of the protocol that a spelling means."""
    try:
        return protocol(name).name
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
