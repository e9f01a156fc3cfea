"""`canser convert`: from raw bytes or a recording to a file of frames, and back."""

import argparse

from canser._output import check_apart, whole_file
from canser._progress import Progress
from canser._protocols import protocols
from canser.analysis import report
from canser.commands._parser import GOOD, CallError, Commands, add_command, say
from canser.commands._source import check_found, open_source, say_remarks, source_arguments
from canser.files.conversion import convert
from canser.files.frame_file import FORMATS, RAW, format_of
from canser.files.judge import AUTO

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "convert",
        "  canser convert run.bin run.npy -p seeed\n"
        "  canser convert run.pcapng run.log\n"
        "  canser convert run.bin - -p seeed | grep ' 123#'\n"
        "  canser convert run.log run.bin -p serial --ts-unit us\n"
        "  canser convert run.npy run.csv",
        run=run,
        parents=[source_arguments()],
    )
    parser.add_argument("target", metavar="OUT", help="a file, or - for standard output")
    parser.add_argument(
        "--to",
        dest="target_format",
        choices=FORMATS,
        help="format of OUT (default: by its suffix, .bin for raw bytes; on standard "
        "output log, or raw where IN holds frames)",
    )
    parser.add_argument("--force", action="store_true", help="replace OUT if it is there")
    parser.add_argument(
        "--strict",
        action="store_true",
        help="refuse a file with frames that OUT's protocol cannot carry (default: leave these "
        "frames out, and count them)",
    )


def _target_format(args: argparse.Namespace) -> str:
    """Return the format of OUT, or raise CallError where it makes no sense."""
    source_format = format_of(args.source, args.source_format)
    if args.target_format is not None:
        chosen: str = args.target_format
    elif args.target == "-":
        chosen = "log" if source_format == RAW else RAW
    else:
        chosen = format_of(args.target)
        if chosen == RAW and not args.target.lower().endswith((".bin", ".raw")):
            raise CallError(
                f"cannot tell the format of {args.target} by its suffix; use .npy, .csv or .log, "
                ".bin for raw bytes, or --to"
            )
    if chosen == RAW and source_format == RAW:
        raise CallError(
            "IN and OUT are both raw bytes; convert to .npy, .csv or .log, and from there "
            "to another protocol"
        )
    if chosen == RAW and args.protocol in (None, AUTO):
        raise CallError(f"raw bytes need a protocol: name it with -p ({', '.join(protocols())})")
    return chosen


def run(args: argparse.Namespace) -> int:
    target_format = _target_format(args)
    check_apart(args.target, args.source)
    with (
        Progress(f"converting {args.source}") as progress,
        open_source(args, progress) as source,
        whole_file(args.target, force=args.force) as target,
    ):
        done = convert(
            *(source, target, target_format),
            protocol=args.protocol,
            ts_unit=args.ts_unit or "ms",
            strict=args.strict,
        )
        stats = None if source.decoder is None else source.decoder.stats
        check_found(source, as_is=args.as_is)
    say(f"{args.source} -> {args.target}: {done.frames:,} frames")
    if stats is not None:
        say(report.conservation(stats))
        if stats.bytes_skipped:
            say(f"skipped: {report.reject_text(stats)}; resyncs: {stats.resyncs:,}")
        if stats.controls:
            say(f"control packets, not in the output as they are no frames: {stats.controls:,}")
    if target_format == RAW:
        say(f"{done.frames:,} frames = {done.bytes_out:,} bytes out")
    for remark in done.remarks:
        say(remark)
    say_remarks(source)
    return GOOD
