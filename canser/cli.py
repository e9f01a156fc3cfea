"""The command `canser`: its arguments, its exit codes, its messages."""

import argparse
import contextlib
import os
import signal
import stat
import sys
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import version
from typing import NoReturn

import numpy as np

from canser import report
from canser._output import standard_output, whole_file
from canser._progress import Progress
from canser.codec import TS_UNITS, Control, Decoder, Stats, protocols
from canser.convert import convert
from canser.errors import CanserError, StreamClosedError
from canser.files import FORMATS, RAW, FrameFile, format_of
from canser.formats.candump import Writer as CandumpWriter
from canser.frames import FRAME_DTYPE, match
from canser.identify import Fit, identify
from canser.tally import Tally

__all__ = ["main"]

# Exit codes.
GOOD, BAD_DATA, BAD_CALL = 0, 1, 2


class CallError(Exception):
    """The call is wrong; the message says what and the remedy."""


class DataError(Exception):
    """The data is bad; the message says what and the remedy."""


class _Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_CALL, f"{self.prog}: {message}; see {self.prog} --help\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="canser",
        description="Decode and encode the byte streams of serial CAN adapters.",
        epilog="examples:\n"
        "  canser info run.bin                          what is in it, in which protocol\n"
        "  canser convert run.bin run.log -p seeed      raw bytes to a candump log\n"
        "  canser convert run.log run.bin -p serial     and back\n"
        "  canser dump run.bin -p seeed --filter 123:7FF | head\n\n"
        f"protocols: {', '.join(protocols())}\n"
        "exit codes: 0 good, 1 the data is bad, 2 the call is wrong",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"canser {version('canser')}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)

    source = _Parser(add_help=False)
    source.add_argument("source", metavar="IN", help="a file, or - for standard input")
    source.add_argument(
        "-p",
        "--protocol",
        type=_protocol,
        help=f"of raw bytes: {', '.join(protocols())}",
    )
    source.add_argument(
        "--ts-unit",
        choices=TS_UNITS,
        default="ms",
        help="unit of the device's timestamps in raw bytes (default: ms)",
    )
    source.add_argument(
        "--from",
        dest="source_format",
        choices=FORMATS,
        help="format of IN (default: by its suffix; else raw bytes)",
    )

    def command(name: str, about: str, example: str) -> argparse.ArgumentParser:
        return commands.add_parser(
            name,
            parents=[source],
            help=about,
            description=about[0].upper() + about[1:] + ".",
            epilog=f"examples:\n{example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )

    one = command(
        "convert",
        "raw bytes to .npy, .csv or candump .log, and back",
        "  canser convert run.bin run.npy -p seeed\n"
        "  canser convert run.bin - -p seeed | grep ' 123#'\n"
        "  canser convert run.log run.bin -p serial --ts-unit us\n"
        "  canser convert run.npy run.csv",
    )
    one.add_argument("target", metavar="OUT", help="a file, or - for standard output")
    one.add_argument(
        "--to",
        dest="target_format",
        choices=FORMATS,
        help="format of OUT (default: by its suffix, .bin for raw bytes; on standard "
        "output log, or raw where IN holds frames)",
    )
    one.add_argument("--force", action="store_true", help="replace OUT if it is there")
    one.set_defaults(run=_convert)

    one = command(
        "info",
        "frames, times, ids, rates, skipped bytes; without -p, which protocol fits best",
        "  canser info run.bin\n"
        "  canser info run.bin -p serial --ts-unit us\n"
        "  canser info run.log",
    )
    one.set_defaults(run=_info)

    one = command(
        "dump",
        "print frames as candump does",
        "  canser dump run.bin -p seeed | head\n"
        "  canser dump run.bin -p seeed --filter 123:7FF --filter 18FEF100:1FFFFFFF\n"
        "  cat /dev/ttyUSB0 | canser dump - -p seeed",
    )
    one.add_argument(
        "--filter",
        dest="filters",
        metavar="FILTER",
        action="append",
        default=[],
        help="only frames that pass: ID:MASK, ID~MASK (inverse) or #MASK (error frames), "
        "hexadecimal; several: any of them",
    )
    one.set_defaults(run=_dump)
    return parser


def _protocol(name: str) -> str:
    """Return the protocol's own name of a spelling."""
    try:
        return Decoder(name).protocol
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _open(args: argparse.Namespace, progress: Progress | None = None) -> FrameFile:
    """Open IN as the arguments say."""
    source_format = format_of(args.source, args.source_format)
    if source_format == RAW and args.protocol is None:
        known = f"canser info {args.source}" if args.source != "-" else "canser info"
        raise CallError(
            f"{args.source} holds raw bytes: name their protocol with -p "
            f"({', '.join(protocols())}); '{known}' tells which fits"
        )
    return FrameFile(
        args.source,
        source_format,
        protocol=args.protocol,
        ts_unit=args.ts_unit,
        progress=progress,
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
    if chosen == RAW and args.protocol is None:
        raise CallError(f"raw bytes need a protocol: name it with -p ({', '.join(protocols())})")
    return chosen


def _convert(args: argparse.Namespace) -> int:
    target_format = _target_format(args)
    with (
        Progress(f"converting {args.source}") as progress,
        _open(args, progress) as source,
        whole_file(args.target, force=args.force) as target,
    ):
        done = convert(source, target, target_format, protocol=args.protocol, ts_unit=args.ts_unit)
        stats = None if source.decoder is None else source.decoder.stats
        if stats is not None:
            _check_found(stats, args)
    _say(f"{args.source} -> {args.target}: {done.frames:,} frames")
    if stats is not None:
        _say(report.conservation(stats))
        if stats.bytes_skipped:
            _say(f"skipped: {report.reject_text(stats)}; resyncs: {stats.resyncs:,}")
        if stats.controls:
            _say(f"control packets, not in the output as they are no frames: {stats.controls:,}")
    if target_format == RAW:
        _say(f"{done.frames:,} frames = {done.bytes_out:,} bytes out")
    for remark in done.remarks:
        _say(remark)
    return GOOD


def _check_found(stats: Stats, args: argparse.Namespace) -> None:
    """Raise DataError if there were bytes, but nothing of the protocol."""
    if stats.bytes_in and not stats.frames and not stats.controls:
        raise DataError(
            f"no {args.protocol} frame in the {stats.bytes_in:,} bytes of {args.source}; "
            "'canser info' without -p tells which protocol fits"
        )


def _info(args: argparse.Namespace) -> int:
    if format_of(args.source, args.source_format) == RAW and args.protocol is None:
        fit = _identify(args)
        args.protocol = fit.protocol
    tally = Tally()
    with Progress(f"reading {args.source}") as progress, _open(args, progress) as source:
        for frames in source:
            tally.add(frames)
        stats, controls = None, list[Control]()
        if source.decoder is not None:
            stats, controls = source.decoder.stats, source.decoder.take_controls()
            _check_found(stats, args)
    _print(report.info_lines(tally, stats, controls))
    return GOOD


def _identify(args: argparse.Namespace) -> Fit:
    """Print which protocol fits the bytes of IN; raise DataError if none does."""
    mode = 0 if args.source == "-" else os.stat(args.source).st_mode  # noqa: PTH116
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        name = "standard input" if args.source == "-" else args.source
        raise CallError(
            f"{name} can be read only once: name its protocol with -p "
            f"({', '.join(protocols())}), or put it into a file first"
        )
    if os.path.getsize(args.source) == 0:  # noqa: PTH202
        raise DataError(f"{args.source} is empty")
    fits = identify(np.memmap(args.source, np.uint8, mode="r"))
    best = fits[0]
    _print([*report.fit_lines(fits), ""])
    if not best.fits:
        raise DataError(f"no protocol fits {args.source}; name it with -p if you know better")
    _print([f"protocol   {best.protocol}, which explains {best.score:.1%} of it beyond chance"])
    return best


def _dump(args: argparse.Namespace) -> int:
    try:
        match(np.empty(0, FRAME_DTYPE), *args.filters)
    except ValueError as error:
        raise CallError(str(error)) from None
    with _open(args) as source, standard_output() as out:
        writer = CandumpWriter(out)
        for frames in source:
            writer.write(frames[match(frames, *args.filters)])
            out.flush()
        stats = None if source.decoder is None else source.decoder.stats
    if stats is not None:
        _check_found(stats, args)
        if stats.bytes_skipped or stats.controls:
            _say(report.conservation(stats))
    return GOOD


def _print(lines: Iterable[str]) -> None:
    """Print lines on the standard output."""
    with standard_output() as out:
        out.write("".join(f"{line}\n" for line in lines).encode())


def _say(text: str) -> None:
    """Print a line on standard error: standard output is for the data."""
    print(text, file=sys.stderr)


@contextlib.contextmanager
def _terminated_cleanly() -> Iterator[None]:
    """Let signals end the program as an exception does: half a file is not left behind."""

    def stop(number: int, _: object) -> NoReturn:
        raise SystemExit(128 + number)

    before = {}
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP; nohup ignores it
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            before[number] = signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    args = _parser().parse_args(argv)
    try:
        with _terminated_cleanly():
            code: int = args.run(args)
            return code
    except BrokenPipeError:
        return GOOD  # nobody reads any more, as in `canser dump ... | head`
    except KeyboardInterrupt:
        _say("canser: interrupted")
        return 130
    except (
        CallError,
        StreamClosedError,
        FileExistsError,
        FileNotFoundError,
        IsADirectoryError,
        NotADirectoryError,
        PermissionError,
    ) as error:
        return _fail(BAD_CALL, error)
    except (DataError, CanserError, ValueError, OSError) as error:
        return _fail(BAD_DATA, error)


def _fail(code: int, error: Exception) -> int:
    if isinstance(error, OSError) and error.filename is not None:
        text = f"{error.filename}: {error.strerror}"
    else:
        text = str(error)
    _say(f"canser: {text}")
    return code
