"""`canser recover`: copy the intact part of a damaged recording."""

import argparse

from canser._output import check_apart, whole_file
from canser.commands._parser import GOOD, Commands, add_command, write_line
from canser.recording.recovery import recover

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "recover",
        "  canser recover run.pcapng whole.pcapng",
        run=run,
    )
    parser.add_argument("source", metavar="IN", help="recording to read")
    parser.add_argument("target", metavar="OUT", help="recording to write")
    parser.add_argument(
        "--force", action="store_true", help="replace OUT if it exists (default: refuse)"
    )


def run(args: argparse.Namespace) -> int:
    check_apart(args.target, args.source)
    with (
        open(args.source, "rb") as source,  # noqa: PTH123
        whole_file(args.target, force=args.force) as target,
    ):
        done = recover(source, target)
    for remark in done.remarks:
        write_line(f"{args.source}: {remark}")
    left_out = f"{done.bytes_left_out:,} bytes left out" if done.bytes_left_out else "all is good"
    write_line(
        f"{args.source} -> {args.target}: {done.blocks:,} blocks, "
        f"{done.bytes_kept:,} bytes of the line; {left_out}"
    )
    return GOOD
