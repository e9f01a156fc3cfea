"""`canser monitor`: the live table of a port, by id."""

import argparse
import math
import sys
import time

from canser._signals import stop_on_signals
from canser.commands._parser import GOOD, CallError, Commands, add_command
from canser.commands._port import duration_arguments, open_port, port_arguments
from canser.commands._screen import warnings_as_lines
from canser.monitoring.livetable import exact

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "monitor",
        "  canser monitor -c /dev/ttyUSB0 -p seeed --bitrate 500000\n"
        "  canser monitor -c /dev/ttyUSB0 -p seeed --filter 123 --filter 7E0:7F8\n\n"
        "keys: i n p j d s sort by id, count, period, jitter, dlc, last seen (again: the\n"
        "other way round); / filter (digits alone are there the first of an id), space\n"
        "pause, c clear, q quit\n\n"
        "period: the median of the last 32 steps from one frame of an id to the next\n"
        "jitter: the standard deviation of those between 0.5 and 1.5 periods",
        run=run,
        parents=[port_arguments(), duration_arguments()],
    )
    parser.add_argument(
        "--filter",
        dest="filters",
        metavar="FILTER",
        action="append",
        default=[],
        help="only ids that pass: an id of up to three (standard) or of eight digits (extended), "
        "ID:MASK, ID~MASK (inverse) or #MASK (error frames), hexadecimal; several: any of them; "
        "the filter line, opened by /, shows and changes it",
    )


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
    streams = (sys.stdin, sys.stdout, sys.stderr)  # None: closed
    if not all(stream is not None and stream.isatty() for stream in streams):
        raise CallError(
            "the monitor needs a terminal, and its input or output is none; "
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
        )
        app.run()
    if app.error is not None:
        raise app.error
    return GOOD
