"""`canser signals`: what signals are in a file, and their values as a file."""

import argparse
import json
from collections.abc import Iterator
from typing import BinaryIO

from canser._frames import FrameArray, concat, copy_records
from canser._output import check_apart
from canser._progress import Progress
from canser.commands._database import (
    database_arguments,
    is_database,
    make_decoder,
    open_database,
)
from canser.commands._numbers import duration
from canser.commands._parser import GOOD, CallError, Commands, add_command, show, write_line
from canser.commands._source import (
    check_found,
    open_source,
    selection,
    selection_arguments,
    source_arguments,
    write_remarks,
)
from canser.commands._summary import Summary
from canser.files.packed import packed_file, without_packing
from canser.signals import csv, parquet
from canser.signals.csv import SampleWriter
from canser.signals.decoder import SignalDecoder
from canser.signals.parquet import ParquetWriter

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "signals",
        "  canser signals run.log car.dbc\n"
        "  canser signals run.bin -p serial car.dbc --signal RPM --signal 'Wheel*'\n"
        "  canser signals run.log car.dbc -o run.csv\n"
        "  canser signals run.log car.dbc -o run.parquet --resample 10ms --max-age 1s\n"
        "  canser signals run.log car.dbc --signal RPM -o - | head\n"
        "  canser signals monday.log tuesday.log car.dbc b.dbc --json",
        run=run,
        parents=[source_arguments()],
    )
    database = parser.add_argument(
        "database",
        metavar="DB",
        help="database of messages and signals; several may be given, if their names end in .dbc, "
        ".kcd, .arxml or .sym",
    )
    parser.add_argument(
        "-o",
        dest="output",
        metavar="OUT",
        help="file to write, a row for each sample in the order of time, by its suffix: .csv, "
        "also packed as .csv.gz, or .parquet; - is CSV on standard output (default: print a "
        "summary)",
    )
    parser.add_argument(
        "--force", action="store_true", help="replace OUT if it exists (default: refuse)"
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help="print the summary as one JSON object, with the attributes of canser.DecodeReport in "
        "its report (default: text)",
    )
    group = parser.add_argument_group("one time base")
    group.add_argument(
        "--resample",
        metavar="STEP",
        type=duration,
        help="write one row for each multiple of STEP, such as 10ms, with a column for each "
        "signal; all frames must fit into memory (default: a row for each sample)",
    )
    group.add_argument(
        "--how",
        choices=("previous", "linear"),
        default="previous",
        help="a value is that of the last sample before its time, or on the line to the next one "
        "(default: previous)",
    )
    group.add_argument(
        "--max-age",
        metavar="TIME",
        type=duration,
        help="leave out values whose last sample is older, or with linear the gap between two "
        "samples longer (default: no limit)",
    )
    database_arguments(parser, instead_of=database)
    selection_arguments(parser)


def _sort_files(args: argparse.Namespace) -> list[str]:
    """Leave the files of frames in `args.sources`; return the databases."""
    files = [*args.sources, *([args.database] if args.database is not None else [])]
    databases = [each for each in files if is_database(each)]
    if not databases and not args.databases:
        databases = files[1:][-1:]
    args.sources = [each for each in files if each not in databases]
    databases += args.databases
    if not databases:
        raise CallError("no database is given: canser signals IN car.dbc")
    if not args.sources:
        raise CallError(f"no file of frames is given: canser signals IN {databases[0]}")
    return databases


def _check_output(args: argparse.Namespace) -> None:
    """Raise CallError if the options do not fit to OUT."""
    if args.resample is None and (args.how != "previous" or args.max_age is not None):
        raise CallError("--how and --max-age need a step; give it with --resample 10ms")
    if args.output is None:
        if args.resample is not None:
            raise CallError("--resample needs a file to write; name it with -o")
    elif args.json:
        raise CallError("--json is for the summary; leave it or -o out")
    elif not (args.output == "-" or _is_parquet(args) or _is_csv(args)):
        raise CallError(f"the name of {args.output} tells no format; write .csv or .parquet")


def _is_csv(args: argparse.Namespace) -> bool:
    return bool(without_packing(args.output).lower().endswith(".csv"))


def _is_parquet(args: argparse.Namespace) -> bool:
    return bool(args.output.lower().endswith(".parquet"))


def run(args: argparse.Namespace) -> int:
    databases = _sort_files(args)
    _check_output(args)
    chosen = selection(args)
    if args.output is not None:
        check_apart(args.output, *args.sources, *databases)
    database = open_database(args, databases)
    if args.output is not None and _is_parquet(args) and not (args.signals or args.resample):
        args.signals = ["*"]  # so that all blocks have the same ones
    decoder = make_decoder(database, args)
    with (
        Progress(f"reading {args.sources[0]}") as progress,
        open_source(args, progress) as source,
    ):
        blocks = (frames for frames, _, _ in chosen.apply(source.tagged()))
        if args.output is None:
            summary = Summary(database, decoder)
            for frames in blocks:
                summary.add(frames)
        else:
            with packed_file(args.output, force=args.force) as file:
                written = _write(args, file, decoder, blocks)
                check_found(source, as_is=args.as_is)
    if args.output is None:
        show([json.dumps(summary.as_dict())] if args.json else summary.lines())
    else:
        write_line(f"{', '.join(args.sources)} -> {args.output}: {written}")
        for line in str(decoder.report).splitlines():
            write_line(line)
    write_remarks(source)
    check_found(source, as_is=args.as_is)
    return GOOD


def _write(
    args: argparse.Namespace, file: BinaryIO, decoder: SignalDecoder, blocks: Iterator[FrameArray]
) -> str:
    """Write the signals of frames; return what was written."""
    is_parquet = _is_parquet(args)
    if args.resample is None:
        writer = (
            ParquetWriter(file, decoder, args.output) if is_parquet else SampleWriter(file, decoder)
        )
        for frames in blocks:
            writer.write(frames)
        writer.finish()
        return f"{writer.count:,} samples"
    whole = concat([copy_records(frames) for frames in blocks])
    grid = decoder.feed(whole).resample(
        round(1e9 * args.resample),
        how=args.how,
        max_age=None if args.max_age is None else round(1e9 * args.max_age),
    )
    if is_parquet:
        parquet.write_grid(file, grid, args.output)
    else:
        csv.write_grid(file, grid)
    return f"{len(grid):,} signals at {len(grid.ts):,} times"
