"""`canser convert`: raw bytes or a recording to a file of frames, and back."""

import argparse
import dataclasses
from typing import Any

from canser._output import check_apart
from canser._progress import Progress
from canser.analysis import report
from canser.commands._parser import GOOD, CallError, Commands, add_command, write_line
from canser.commands._source import (
    FORMATS,
    check_found,
    format_name,
    opened,
    options_named,
    read_options,
    selection,
    selection_arguments,
    source_arguments,
    write_remarks,
)
from canser.files.formats import PCAPNG, RAW
from canser.files.packed import packed_file
from canser.files.reading import Blocks
from canser.files.writer import WriteOptions
from canser.files.writing import (
    BYTES,
    check_target,
    choose_target,
    convert_opened,
    open_to_convert,
    start_epoch,
)

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
        "  canser convert run.npy run.csv\n"
        "  canser convert run.pcapng run.bin    # the raw bytes of the serial line\n"
        "  canser convert monday.log tuesday.log both.npy\n"
        "  canser convert run.bin run.log -p serial --epoch 2026-11-26T08:00",
        run=run,
        parents=[source_arguments()],
    )
    target = parser.add_argument(
        "target", metavar="OUT", help="file to write, or - for standard output"
    )
    parser.add_argument(
        "-o",
        dest="output",
        metavar="OUT",
        action=_Output,
        target=target,
        help="file to write, as an option: all other files are then IN",
    )
    parser.add_argument(
        "--to",
        dest="target_format",
        metavar="FORMAT",
        type=format_name,
        help=f"format of OUT: {FORMATS} (default: by its suffix, .bin for raw; on standard "
        "output candump, or raw if IN is a file of frames)",
    )
    selection_arguments(parser)
    parser.add_argument(
        "--force", action="store_true", help="replace OUT if it exists (default: refuse)"
    )
    parser.add_argument(
        "--strict",
        action="store_true",
        help="refuse a file with frames that the protocol of OUT cannot carry (default: leave "
        "these frames out, and count them)",
    )


def _target_format(args: argparse.Namespace) -> str | None:
    """Return the format of OUT, None if that of IN decides; CallError if it cannot be found."""
    if args.target == "-" and args.target_format is None:
        return None
    try:
        return choose_target(args.target, args.target_format)
    except ValueError as error:
        raise CallError(f"{error} with --to") from None


class _Output(argparse.Action):
    """Take OUT from an option, so that no argument after IN is needed."""

    def __init__(self, *args: Any, target: argparse.Action, **options: Any) -> None:
        super().__init__(*args, **options)
        self._target = target

    def __call__(
        self,
        parser: argparse.ArgumentParser,  # noqa: ARG002 - as argparse calls it
        namespace: argparse.Namespace,
        values: Any,
        option: str | None = None,  # noqa: ARG002
    ) -> None:
        namespace.output = values
        self._target.required = False


def run(args: argparse.Namespace) -> int:
    if args.output is not None:
        args.sources += [args.target] if args.target is not None else []
        args.target = args.output
    to = _target_format(args)
    chosen = selection(args)
    check_apart(args.target, *args.sources)
    with (
        Progress(f"converting {args.sources[0]}") as progress,
        _open(args, progress, to) as source,
    ):
        if to is None:
            to = "candump" if source.format in BYTES else RAW
        try:
            check_target(to, args.protocol, source.format)
        except ValueError as error:
            remedy = "" if to == source.format else "; name it with -p"
            if to == PCAPNG and to != source.format:
                remedy += ", or write the frames themselves with --to pcap"
            raise CallError(f"{error}{remedy}") from None
        options = WriteOptions(
            protocol=args.protocol,
            ts_unit=args.ts_unit or "ms",
            strict=args.strict,
            tz=args.tz,
            name=args.target,
        )
        with packed_file(args.target, force=args.force) as target:
            done = convert_opened(source, target, to, options, chosen)
            check_found(source, as_is=args.as_is)
        stats = source.stats
    inputs = ", ".join(args.sources)
    if done.copied:
        write_line(f"{inputs} -> {args.target}: {done.bytes_out:,} bytes of the line")
        stats = None
    else:
        write_line(f"{inputs} -> {args.target}: {done.frames:,} frames")
    if stats is not None:
        write_line(report.conservation(stats))
        if stats.bytes_skipped:
            write_line(f"skipped: {report.reject_text(stats)}; resyncs: {stats.resyncs:,}")
        if stats.controls:
            write_line(
                f"control packets, not in the output as they are no frames: {stats.controls:,}"
            )
    if to in BYTES and not done.copied:
        write_line(f"{done.frames:,} frames = {done.bytes_out:,} bytes out")
    for remark in done.remarks:
        write_line(remark)
    write_remarks(source)
    return GOOD


def _open(args: argparse.Namespace, progress: Progress, to: str | None) -> Blocks:
    options = read_options(args)
    if args.epoch is None:
        options = dataclasses.replace(options, epoch=start_epoch(to or "candump"))
    with options_named():
        return open_to_convert(
            opened(args.sources),
            options,
            format=args.source_format,
            progress=progress,
            sort=args.sort,
        )
