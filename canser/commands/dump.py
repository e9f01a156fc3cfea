"""`canser dump`: frames as candump prints them."""

import argparse

import numpy as np

from canser._frames import FRAME_DTYPE, match
from canser._output import standard_output
from canser.analysis import report
from canser.commands._parser import GOOD, CallError, Commands, add_command, say
from canser.commands._source import check_found, open_source, say_remarks, source_arguments
from canser.files.candump import Writer as CandumpWriter

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "dump",
        "  canser dump run.bin -p seeed | head\n"
        "  canser dump run.bin -p seeed --filter 123 --filter 18FEF100 --filter 7E0:7F8\n"
        "  canser dump run.pcapng\n"
        "  cat /dev/ttyUSB0 | canser dump - -p seeed",
        run=run,
        parents=[source_arguments()],
    )
    parser.add_argument(
        "--filter",
        dest="filters",
        metavar="FILTER",
        action="append",
        default=[],
        help="only frames that pass: an id of up to three (standard) or of eight digits "
        "(extended), ID:MASK, ID~MASK (inverse) or #MASK (error frames), hexadecimal; several: "
        "any of them",
    )


def run(args: argparse.Namespace) -> int:
    try:
        match(np.empty(0, FRAME_DTYPE), *args.filters)
    except ValueError as error:
        raise CallError(str(error)) from None
    with open_source(args) as source, standard_output() as out:
        writer = CandumpWriter(out)
        for frames in source:
            writer.write(frames.compress(match(frames, *args.filters)))
            out.flush()
        stats = source.stats
    if stats is not None and (stats.bytes_skipped or stats.controls):
        say(report.conservation(stats))
    say_remarks(source)
    check_found(source, as_is=args.as_is)
    return GOOD
