"""`canser stats`: statistics of each id in a file."""

import argparse
import json

from canser._progress import Progress
from canser.analysis.ids import IdStats
from canser.analysis.load import BITRATE_MOST, BusLoad
from canser.analysis.stats import FileStats
from canser.commands._numbers import duration, whole
from canser.commands._parser import GOOD, CallError, Commands, add_command, show, write_line
from canser.commands._source import check_found, open_source, source_arguments, write_remarks

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "stats",
        "  canser stats run.bin -p serial\n"
        "  canser stats run.log -b 500000\n"
        "  canser stats run.pcapng --json | jq '.ids[] | select(.missing > 0)'",
        run=run,
        parents=[source_arguments()],
    )
    parser.add_argument(
        "-b",
        "--bitrate",
        metavar="BITRATE",
        type=whole(least=1, most=BITRATE_MOST),
        help="bit rate of the bus in bit/s, for its load in percent (default: that of a recording)",
    )
    parser.add_argument(
        "--window",
        metavar="TIME",
        type=duration,
        help="length of the windows in which the load is counted, such as 100ms or 1s (default: "
        "100ms, and longer for a file of over 13 minutes)",
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object on standard output; its ids have the fields of "
        "canser.id_stats, its loads those of canser.bus_load; times are in nanoseconds, unknown "
        "values are null (default: text)",
    )


def run(args: argparse.Namespace) -> int:
    stats = IdStats()
    try:
        load = BusLoad(args.bitrate, None if args.window is None else round(1e9 * args.window))
    except ValueError as error:
        raise CallError(f"--{error}") from None
    with (
        Progress(f"reading {args.sources[0]}") as progress,
        open_source(args, progress) as source,
    ):
        for frames, channels, _ in source.tagged():
            stats.add(frames, channels)
            load.add(frames)
        if args.bitrate is None and source.recording is not None:
            load.bitrate = source.recording.bitrate
    found = FileStats(stats.rows(), load.rows(), load.bitrate, stats.exact)
    show([json.dumps(found.as_dict())] if args.json else found.lines(source.channel_names))
    for remark in found.remarks():
        write_line(remark)
    write_remarks(source)
    check_found(source, as_is=args.as_is)
    return GOOD
