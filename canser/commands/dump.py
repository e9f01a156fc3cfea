"""`canser dump`: print frames in the format of candump."""

import argparse

from canser._output import standard_output
from canser.analysis import report
from canser.commands._database import (
    check_database,
    database_arguments,
    make_decoder,
    open_database,
)
from canser.commands._parser import GOOD, Commands, add_command, write_line
from canser.commands._signal_lines import SignalLines, terminal_columns
from canser.commands._source import (
    check_found,
    open_source,
    selection,
    selection_arguments,
    source_arguments,
    write_remarks,
)
from canser.files.candump import STAMPS, Dump

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "dump",
        "  canser dump run.bin -p seeed | head\n"
        "  canser dump run.bin -p seeed --filter 123 --filter 18FEF100 --filter 7E0:7F8\n"
        "  canser dump run.pcapng --start 10s --end 20s -t z\n"
        "  canser dump two-buses.log --bus can1 --count 100\n"
        "  cat /dev/ttyUSB0 | canser dump - -p seeed\n"
        "  canser dump run.log --db car.dbc --signal RPM --signal Gear",
        run=run,
        parents=[source_arguments()],
    )
    selection_arguments(parser)
    database_arguments(parser)
    parser.add_argument(
        "-t",
        dest="stamps",
        choices=STAMPS,
        default="a",
        help="times, as candump -t: a for absolute in seconds, A for absolute with the date, d for "
        "seconds since the frame before, z for seconds since the first frame (default: a)",
    )


def run(args: argparse.Namespace) -> int:
    chosen = selection(args)
    signals = _signals(args)
    with open_source(args) as source, standard_output() as out:
        dump = Dump(args.stamps, source.keep_tags())
        for frames, channels, directions in chosen.apply(source.tagged()):
            lines = dump.text(frames, channels, directions)
            out.write(lines if signals is None else signals.under(lines, frames))
            out.flush()
        stats = source.stats
    if stats is not None and (stats.bytes_skipped or stats.controls):
        write_line(report.conservation(stats))
    write_remarks(source)
    check_found(source, as_is=args.as_is)
    return GOOD


def _signals(args: argparse.Namespace) -> SignalLines | None:
    """Return what puts signals under frames, if a database is given."""
    if not args.databases:
        check_database(args)
        return None
    database = open_database(args)
    return SignalLines(database, make_decoder(database, args), terminal_columns())
