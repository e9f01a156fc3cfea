"""`canser info`: show the contents of a file, and find its protocol."""

import argparse
import json
import os

from canser._progress import Progress
from canser._protocols import protocols
from canser.analysis import report
from canser.analysis.summary import info, rank_protocols
from canser.commands._numbers import whole
from canser.commands._parser import (
    GOOD,
    CallError,
    Commands,
    DataError,
    add_command,
    show,
    write_line,
)
from canser.commands._source import (
    opened,
    options_named,
    refuse_doubtful,
    source_arguments,
)
from canser.errors import NoProtocolError
from canser.files.judge import describe_fit

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "info",
        "  canser info run.bin\n"
        "  canser info run.bin -p serial --ts-unit us\n"
        "  canser info run.log\n"
        "  canser info run.pcapng\n"
        "  canser info monday.log tuesday.log\n"
        "  canser info two-buses.log --bus can1\n\n"
        "  $ canser info car.bin -p serial --top 2 | tail -n 4\n"
        "        id     frames   share     rate/s   period ms  dlc\n"
        "       140      9,030  10.94%     100.02       10.00  8\n"
        "       141      9,030  10.94%     100.02       10.00  8\n"
        "  ids left out: 33; frames of them: 64,498\n\n"
        "  $ canser info car.bin -p serial --json |\n"
        "        jq -c '.ids[0] | [.id, .count, .period_ns, .interval_p99_ns]'\n"
        "  [320,9030,10000000,12000000]",
        run=run,
        parents=[source_arguments()],
    )
    parser.add_argument(
        "--top",
        metavar="N",
        type=whole(least=1),
        help="show only the N most frequent ids, and count the others (default: all ids)",
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object on standard output, with the attributes of canser.FileInfo; "
        "times are in nanoseconds, unknown values are null (default: text)",
    )


def run(args: argparse.Namespace) -> int:
    try:
        with Progress(f"reading {args.sources[0]}") as progress, options_named(protocol=False):
            found = info(
                opened(args.sources),
                args.protocol,
                ts_unit=args.ts_unit,
                format=args.source_format,
                bus=args.bus,
                times=args.times,
                tz=args.tz,
                sort=args.sort,
                skip_bad=args.skip_bad,
                as_is=args.as_is,
                progress=progress,
            )
    except NoProtocolError as error:
        raise _no_protocol(error.name, ranked=not args.json) from None
    show([json.dumps(found.as_dict(args.top))] if args.json else found.lines(args.top))
    for remark in found.remarks:
        write_line(remark)
    if found.protocol is not None and found.stats is not None and not args.as_is:
        refuse_doubtful(found.name, found.protocol, found.stats, found.doubt)
    return GOOD


def _no_protocol(path: str, *, ranked: bool) -> CallError | DataError:
    """Return the error that no protocol fits a file; `ranked`: print how well each one fits."""
    if not os.path.isfile(path):  # noqa: PTH113
        return CallError(
            f"{path} can be read only once: name its protocol with -p "
            f"({', '.join(protocols())}), or put it into a file first"
        )
    size = os.path.getsize(path)  # noqa: PTH202
    if size == 0:
        return DataError(f"{path} is empty")
    fits = rank_protocols(path)
    if ranked:
        show([*report.fit_lines(fits, size), ""])
    if fits[0].rivals:
        return DataError(f"{path} may be {describe_fit(fits[0])}; name the protocol with -p")
    return DataError(f"no protocol fits {path}; name it with -p if you know better")
