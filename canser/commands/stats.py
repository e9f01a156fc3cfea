"""`canser stats`: statistics of each id in a file."""

import argparse
import json

from canser._progress import Progress
from canser.analysis.ids import IdStats
from canser.analysis.stats import stats_as_dict, stats_lines
from canser.commands._parser import GOOD, Commands, add_command, show
from canser.commands._source import check_found, open_source, source_arguments, write_remarks

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "stats",
        "  canser stats run.bin -p serial\n"
        "  canser stats run.log\n"
        "  canser stats run.pcapng --json | jq '.ids[] | select(.missing > 0)'",
        run=run,
        parents=[source_arguments()],
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object on standard output; its ids have the fields of "
        "canser.id_stats, times are in nanoseconds, unknown values are null (default: text)",
    )


def run(args: argparse.Namespace) -> int:
    stats = IdStats()
    with (
        Progress(f"reading {args.sources[0]}") as progress,
        open_source(args, progress) as source,
    ):
        for frames, channels, _ in source.tagged():
            stats.add(frames, channels)
    rows = stats.rows()
    if args.json:
        show([json.dumps(stats_as_dict(rows, exact=stats.exact))])
    else:
        show(stats_lines(rows, source.channel_names))
    write_remarks(source)
    check_found(source, as_is=args.as_is)
    return GOOD
