"""`canser compare`: what differs between two drives."""

import argparse
import json

from canser.analysis.compare import compare_stats
from canser.analysis.ids import IdStats, IdStatsArray
from canser.commands._parser import GOOD, Commands, add_command, show
from canser.commands._source import check_found, open_source, source_arguments, write_remarks

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "compare",
        "  canser compare good.log bad.log\n"
        "  canser compare monday.bin tuesday.bin -p serial\n"
        "  canser compare a.pcapng b.pcapng --json | jq '.bits[] | [.id, .byte, .bit]'",
        run=run,
        parents=[source_arguments(two=True)],
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object on standard output, with the attributes of canser.Comparison "
        "(default: text)",
    )


def run(args: argparse.Namespace) -> int:
    found = compare_stats(_stats_of(args, args.a), _stats_of(args, args.b))
    show([json.dumps(found.as_dict())] if args.json else found.lines())
    return GOOD


def _stats_of(args: argparse.Namespace, path: str) -> IdStatsArray:
    """Return the statistics of the ids in a file."""
    stats = IdStats()
    one = argparse.Namespace(**{**vars(args), "sources": [path]})
    with open_source(one, raw_only=True) as source:
        for frames in source:
            stats.add(frames)
    write_remarks(source)
    check_found(source, as_is=args.as_is)
    return stats.rows()
