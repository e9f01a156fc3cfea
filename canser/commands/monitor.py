"""`canser monitor`: show a live table of a port, with a row for each id."""

import argparse
import math
import sys
import time
from typing import Any

from canser.commands._database import (
    check_database,
    database_arguments,
    make_decoder,
    open_database,
)
from canser.commands._parser import GOOD, CallError, Commands, add_command
from canser.commands._port import duration_arguments, open_port, port_arguments
from canser.commands._screen import warnings_as_lines
from canser.commands._stop import stop_on_signals
from canser.monitoring.livetable import exact

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "monitor",
        "  canser monitor -c /dev/ttyUSB0 -p seeed --bitrate 500000\n"
        "  canser monitor -c /dev/ttyUSB0 -p seeed --filter 123 --filter 7E0:7F8\n"
        "  canser monitor -c /dev/ttyUSB0 -p seeed --db car.dbc\n\n"
        "keys:\n"
        "  i n p j d s    sort by id, count, period, jitter, dlc, last seen;\n"
        "                 the same key again reverses the order\n"
        "  /              filter; digits alone match ids that begin with them, and with\n"
        "                 a database any text the names of messages and signals\n"
        "  space          pause; frames are still counted\n"
        "  c              clear all rows\n"
        "  q              quit\n\n"
        "period: median of the last 32 times between two frames of an id, in ms\n"
        "jitter: standard deviation of those between 0.5 and 1.5 periods, in ms",
        run=run,
        parents=[port_arguments(), duration_arguments()],
    )
    parser.add_argument(
        "--filter",
        dest="filters",
        metavar="FILTER",
        action="append",
        default=[],
        help="show only ids that match, in hexadecimal: an id of up to 3 digits (standard) or of "
        "8 digits (extended), ID:MASK, ID~MASK (inverse) or #MASK (error frames); given several "
        "times, an id must match one of them; the filter line, which / opens, shows and changes "
        "the filters (default: all)",
    )
    database_arguments(parser)


def _signals(args: argparse.Namespace) -> Any:
    """Return what shows signals under ids, if a database is given."""
    check_database(args)
    if not args.databases:
        return None
    from canser.monitoring.signals import RowSignals  # noqa: PLC0415 - only with a database

    database = open_database(args)
    return RowSignals(database, make_decoder(database, args))


def run(args: argparse.Namespace) -> int:
    try:
        from canser.monitoring.monitor import Monitor  # noqa: PLC0415 - an optional extra
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith(("textual", "rich")):
            raise
        raise CallError("the monitor needs textual: pip install 'canser[monitor]'") from None
    try:
        filters = exact(" ".join(args.filters))
    except ValueError as error:
        raise CallError(str(error)) from None
    signals = _signals(args)
    streams = (sys.stdin, sys.stdout, sys.stderr)  # None for a closed one
    if not all(stream is not None and stream.isatty() for stream in streams):
        raise CallError(
            "the monitor needs a terminal, but its input or output is not one; "
            "run it without < > and |"
        )
    remarks: list[str] = []
    end = time.monotonic() + (math.inf if args.duration is None else args.duration)
    with (
        stop_on_signals() as stop,
        warnings_as_lines(remarks.append),
        open_port(args, stop) as port,
    ):
        app = Monitor(
            port,
            filters=filters,
            bitrate=args.bitrate,
            remarks=remarks,
            stopped=lambda: stop.wanted or time.monotonic() >= end,
            signals=signals,
        )
        app.run()
    if app.error is not None:
        raise app.error
    return GOOD
