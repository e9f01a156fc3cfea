"""`canser signals`: what signals are in a file, and their values as a file."""

import argparse
import json

from canser._output import check_apart
from canser._progress import Progress
from canser.commands._database import (
    database_arguments,
    is_database,
    make_decoder,
    open_database,
)
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
from canser.signals.csv import SampleWriter

__all__ = ["add"]

CSV, PARQUET = "csv", "parquet"


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "signals",
        "  canser signals run.log car.dbc\n"
        "  canser signals run.bin -p serial car.dbc --signal RPM --signal 'Wheel*'\n"
        "  canser signals run.log car.dbc -o run.csv\n"
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
        help="file to write, a row for each sample in the order of the frames, by its suffix: "
        ".csv, also packed as .csv.gz, or - for CSV on standard output (default: print a summary)",
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


def _format(args: argparse.Namespace) -> str | None:
    """Return the format of OUT; None: none is wanted."""
    if args.output is None:
        return None
    if args.json:
        raise CallError("--json is for the summary; leave it or -o out")
    if args.output == "-" or without_packing(args.output).lower().endswith(".csv"):
        return CSV
    raise CallError(f"the name of {args.output} tells no format; write .csv")


def run(args: argparse.Namespace) -> int:
    databases = _sort_files(args)
    to = _format(args)
    chosen = selection(args)
    if to:
        check_apart(args.output, *args.sources, *databases)
    database = open_database(args, databases)
    decoder = make_decoder(database, args)
    with (
        Progress(f"reading {args.sources[0]}") as progress,
        open_source(args, progress) as source,
    ):
        blocks = (frames for frames, _, _ in chosen.apply(source.tagged()))
        if to is None:
            summary = Summary(database, decoder)
            for frames in blocks:
                summary.add(frames)
        else:
            with packed_file(args.output, force=args.force) as file:
                writer = SampleWriter(file, decoder)
                for frames in blocks:
                    writer.write(frames)
                check_found(source, as_is=args.as_is)
    report = decoder.report
    if to is None:
        show([json.dumps(summary.as_dict())] if args.json else summary.lines())
    else:
        inputs = ", ".join(args.sources)
        write_line(f"{inputs} -> {args.output}: {writer.count:,} samples")
        for line in str(report).splitlines():
            write_line(line)
    write_remarks(source)
    check_found(source, as_is=args.as_is)
    return GOOD
