"""The database of a command: its arguments, its opening, its remarks."""

import argparse
from collections.abc import Sequence
from pathlib import PurePath
from typing import Any, Final

from canser.commands._parser import CallError, write_line
from canser.commands._screen import warnings_as_lines
from canser.signals.database import Database
from canser.signals.decoder import SignalDecoder

__all__ = ["check_database", "database_arguments", "is_database", "make_decoder", "open_database"]

MATCHES: Final = ("auto", "id", "pgn")

_SUFFIXES: Final = (".dbc", ".kcd", ".arxml", ".sym")

# Remarks on a database that are printed.
_REMARKS_MOST: Final = 10


class _Append(argparse.Action):
    """Take a database from an option, so that the argument is not needed."""

    def __init__(self, *args: Any, instead_of: argparse.Action | None, **options: Any) -> None:
        super().__init__(*args, **options)
        self._instead_of = instead_of

    def __call__(
        self,
        parser: argparse.ArgumentParser,  # noqa: ARG002 - as argparse calls it
        namespace: argparse.Namespace,
        values: Any,
        option: str | None = None,  # noqa: ARG002
    ) -> None:
        namespace.databases = [*namespace.databases, values]
        if self._instead_of is not None:
            self._instead_of.required = False


def database_arguments(
    parser: argparse.ArgumentParser, *, instead_of: argparse.Action | None = None
) -> None:
    """Add the arguments that name a database and choose signals.

    `instead_of`: an argument that names one, and is not needed if the option does.
    """
    group = parser.add_argument_group("the database")
    group.add_argument(
        "--db",
        dest="databases",
        metavar="DB",
        action=_Append,
        instead_of=instead_of,
        default=[],
        help="database of messages and signals: DBC, KCD, ARXML or SYM; may be given several "
        "times, and the first one that has an id counts",
    )
    group.add_argument(
        "--signal",
        dest="signals",
        metavar="NAME",
        action="append",
        help="only this signal: RPM, EngineData.RPM, EngineData for all of the message, or with * "
        "and ? for any characters, in quotes; may be given several times (default: all)",
    )
    group.add_argument(
        "--match",
        choices=MATCHES,
        default="auto",
        help="how the message of a frame is found: id for its id alone; pgn for the parameter "
        "group number of extended ids; auto for the id, or the group where the database marks "
        "messages as such of J1939 (default: auto)",
    )
    group.add_argument(
        "--encoding",
        help="encoding of the database, such as cp1252 (default: UTF-8 if it is that, else cp1252)",
    )


def check_database(args: argparse.Namespace) -> None:
    """Raise CallError if signals are chosen, but no database is given."""
    if args.signals and not args.databases:
        raise CallError("--signal needs a database; give it with --db car.dbc")


def is_database(path: str) -> bool:
    """Return whether a file is named as a database."""
    return PurePath(path).suffix.lower() in _SUFFIXES


def open_database(args: argparse.Namespace, paths: Sequence[str] | None = None) -> Database:
    """Open the databases that the arguments name, or these; CallError without cantools."""
    remarks: list[str] = []
    try:
        with warnings_as_lines(remarks.append):
            database = Database(
                *(args.databases if paths is None else paths),
                match=args.match,
                encoding=args.encoding,
            )
    except ImportError as error:
        raise CallError(str(error)) from None
    except LookupError as error:
        raise CallError(f"--encoding: {error}") from None
    told = "\n".join(remarks)
    for name, reason in database.left_out.items():
        if f"{name} is left out, as {reason}" not in told:
            remarks.append(f"{name} is left out: {reason}")
    for remark in remarks[:_REMARKS_MOST]:
        write_line(remark)
    if len(remarks) > _REMARKS_MOST:
        write_line(f"and {len(remarks) - _REMARKS_MOST:,} more remarks on the database")
    return database


def make_decoder(database: Database, args: argparse.Namespace) -> SignalDecoder:
    """Return a decoder of the signals that the arguments choose; CallError for a wrong name."""
    try:
        return database.decoder(args.signals)
    except ValueError as error:
        raise CallError(str(error)) from None
