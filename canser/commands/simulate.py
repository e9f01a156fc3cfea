"""`canser simulate`: simulate an adapter on a pseudo terminal, without hardware."""

import argparse
import contextlib
import dataclasses
import io
import json
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from canser._frames import FrameArray
from canser._output import check_apart, whole_file
from canser._protocols import TS_UNITS, protocols
from canser.codec.refusals import Refusals, carries
from canser.commands._numbers import duration, real, whole
from canser.commands._parser import (
    BAD_DATA,
    GOOD,
    CallError,
    Commands,
    DataError,
    add_command,
    protocol_name,
    show,
    write_line,
)
from canser.commands._source import as_is_argument, log_arguments, read_options, write_remarks
from canser.commands._stop import Stop, stop_on_signals
from canser.commands._traffic import TrafficFile
from canser.errors import ReaderGoneError
from canser.simulation.faults import Faults
from canser.simulation.simulator import PACES, Simulator, SimulatorReport
from canser.simulation.traffic import vehicle

__all__ = ["add"]

# Length of the generated traffic, which then repeats.
_ROUND_S = 60.0

# Frames in one array of this traffic: their copy takes less than 0.1 ms.
_PART = 4096

# Interval at which the command looks at its simulator.
_LOOK_S = 0.1

# At the end, a host that does not read, or that is gone and may come back, is waited for so long.
_PATIENCE_S = 2.0

# Traffic that has an end waits this time for a host, before the first byte and between two bytes.
# It is enough to type the other command, or for a slow machine to start it. Without a limit a
# script would hang for ever.
_HOST_PATIENCE_S = 30.0


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "simulate",
        "  canser simulate -p seeed    # print the name of the terminal, run until Ctrl-C\n"
        "  canser simulate -p serial --traffic run.log --link /tmp/can\n"
        "  canser simulate -p seeed --seconds 60 --pace max --copy sent.bin\n"
        "  canser simulate -p cantalope --noise 0.001 --stall 100000:2 --report sent.json\n"
        "  canser simulate -p seeed --deaf 0.7s --swallow    # as a real analyzer",
        run=run,
    )
    parser.add_argument(
        "-p",
        "--protocol",
        type=protocol_name,
        required=True,
        help=f"protocol of the adapter: {', '.join(protocols())}",
    )
    parser.add_argument(
        "--traffic",
        metavar="FILE",
        help="file of frames to send, of any format, or raw bytes of the protocol; - for "
        "standard input (default: generated traffic of a vehicle, until Ctrl-C)",
    )
    log_arguments(parser)
    as_is_argument(parser)
    parser.add_argument(
        "--seconds",
        type=real(),
        metavar="S",
        help="send S seconds of a vehicle's traffic, then end; the time runs only while a host "
        "has the terminal open. With --seconds, or --traffic without --loop, the exit code is 1 "
        f"if no host has the terminal open for {_HOST_PATIENCE_S:g} seconds (default: no end)",
    )
    parser.add_argument(
        "--loop", action="store_true", help="send FILE over and over (default: once)"
    )
    parser.add_argument(
        "--pace",
        choices=PACES,
        help="send by the frames' times (traffic), as fast as the serial line carries (line), or "
        "as fast as the host reads (max) (default: traffic; line with --baudrate, or if the "
        "frames have no times)",
    )
    parser.add_argument(
        "--baudrate",
        type=whole(least=1),
        metavar="N",
        help="rate of the serial line in bit/s (default: that of the adapters of the protocol)",
    )
    parser.add_argument(
        "--ts-unit",
        choices=TS_UNITS,
        default="ms",
        help="unit of the timestamps of the device (default: ms)",
    )
    parser.add_argument("--echo", action="store_true", help="send the frames of the host back")
    parser.add_argument(
        "--noise",
        type=real(most=1),
        default=0.0,
        metavar="SHARE",
        help="share of the bytes, 0 to 1, that is lost, has a bit flipped, or gets a byte in "
        "front, such as 0.001 (default: 0)",
    )
    parser.add_argument(
        "--loss",
        type=real(most=1),
        default=0.0,
        metavar="SHARE",
        help="share of the bytes, 0 to 1, that is lost in runs of 1 to 63 bytes (default: 0)",
    )
    parser.add_argument(
        "--stall",
        dest="stalls",
        type=_stall,
        action="append",
        default=[],
        metavar="AT:S",
        help="send nothing for S seconds after AT bytes, such as 5000:2; may be given several "
        "times (default: never)",
    )
    parser.add_argument(
        "--deaf",
        type=duration,
        default=0.0,
        metavar="TIME",
        help="ignore all bytes from the host for this time after it has opened the terminal, as "
        "real analyzers do, such as 0.7s (default: 0s)",
    )
    parser.add_argument(
        "--swallow",
        action="store_true",
        help="ignore the first packet after each configuration, as real analyzers do",
    )
    parser.add_argument(
        "--seed",
        type=whole(),
        default=1,
        metavar="N",
        help="seed of --noise and --loss; the same seed gives the same faults (default: 1)",
    )
    parser.add_argument(
        "--link",
        default="",
        metavar="PATH",
        help="make a symbolic link to the terminal at PATH (default: none)",
    )
    parser.add_argument(
        "--copy", metavar="FILE", help="write exactly the bytes that were sent to FILE"
    )
    parser.add_argument(
        "--report",
        metavar="FILE",
        help="at the end, write all counters to FILE as JSON; - for standard output",
    )
    parser.add_argument(
        "--force",
        action="store_true",
        help="replace the files of --copy and --report if they exist (default: refuse)",
    )


def run(args: argparse.Namespace) -> int:
    others = [] if args.traffic is None else [args.traffic]
    for written in (args.copy, args.report):
        if written is not None:
            check_apart(written, *others)
            others.append(written)
    with contextlib.ExitStack() as files:
        if args.traffic == "-" and isinstance(sys.stdin, io.TextIOWrapper):
            # Otherwise Python would abort at its end: it closes sys.stdin, but a thread that waits
            # for bytes of standard input holds the lock of the buffer.
            files.callback(sys.stdin.detach)
        copy: BinaryIO | None = None
        if args.copy is not None:
            copy = files.enter_context(whole_file(args.copy, force=args.force))
        target: BinaryIO | None = None
        if args.report is not None and args.report != "-":
            target = files.enter_context(whole_file(args.report, force=args.force))
        traffic, loop = _traffic(args)
        faults = Faults(
            noise=args.noise,
            loss=args.loss,
            stalls=args.stalls,
            deaf=args.deaf,
            swallow=args.swallow,
            seed=args.seed,
        )
        if args.baudrate is not None and args.pace in {"traffic", "max"}:
            raise CallError(f"--baudrate needs --pace line, not {args.pace}; leave one of both out")
        with (
            stop_on_signals() as stop,
            Simulator(
                args.protocol,
                traffic,
                ts_unit=args.ts_unit,
                loop=loop,
                pace=args.pace,
                baudrate=args.baudrate,
                echo=args.echo,
                faults=faults,
                link=args.link,
                copy=copy,
            ) as device,
        ):
            if args.pace is None and args.baudrate is None and device.report().pace == "line":
                write_line(
                    f"{args.traffic}: the frames have no times; sent as fast as the line carries"
                )
            with contextlib.suppress(ReaderGoneError):  # a host may know the name from --link
                show([device.url])
            endless = loop or (args.traffic is None and args.seconds is None)
            failure = _run(device, stop, endless=endless)
        report = device.report()
        text = json.dumps(dataclasses.asdict(report), indent=2)
        if target is not None:
            target.write(text.encode() + b"\n")
    # After the files are complete: an error of standard output must not remove them.
    if args.report == "-":
        show([text])
    if isinstance(traffic, _File):
        traffic.report_left_out()
    for line in _summary(report):
        write_line(line)
    if failure:
        write_line(f"canser: {failure}")
        return BAD_DATA
    return GOOD


def _run(device: Simulator, stop: Stop, *, endless: bool) -> str:
    """Serve until the end; return the failure, "" for none.

    The end: all bytes are sent and read, a signal has come, or the host is gone.
    """
    # Seconds, counted by looks, so that a machine that is busy or asleep gets more time.
    away = finished = 0.0
    while not stop and not device.wait(_LOOK_S):
        away = 0.0 if device.connected else away + _LOOK_S
        if device.finished:
            finished += _LOOK_S
            if away > _PATIENCE_S:
                return ""
            if not away and abs(finished - _PATIENCE_S) < _LOOK_S / 2:
                write_line("all is sent; waiting for the host to read the rest (Ctrl-C ends)")
        elif away > _HOST_PATIENCE_S and not endless:
            return (
                f"no host had {device.url} open for {_HOST_PATIENCE_S:g} s, and not all was sent; "
                "start the host sooner, or send traffic without an end"
            )
    if stop:
        device.stop()
        device.wait(_PATIENCE_S)
    return ""


def _traffic(args: argparse.Namespace) -> tuple[FrameArray | Iterable[FrameArray], bool]:
    """Return the frames to send, and whether to send them over and over."""
    if args.traffic is None:
        if args.loop:
            raise CallError("--loop repeats a file: name it with --traffic, or leave --loop out")
        ext = carries(args.protocol, ext=True)
        if args.seconds is None:
            return vehicle(_ROUND_S, extended=ext), True
        return _generate(args.seconds, extended=ext), False
    if args.seconds is not None:
        raise CallError("--seconds is for generated traffic; leave out --seconds or --traffic")
    if args.loop and args.traffic == "-":
        raise CallError("standard input can be read only once; put it into a file, or drop --loop")
    return _File(args), args.loop


def _generate(seconds: float, *, extended: bool) -> Iterator[FrameArray]:
    """Yield the traffic of a vehicle, round by round."""
    # The slow work is done before the first frame; otherwise frames would be late.
    rounds, rest = divmod(seconds, _ROUND_S)
    whole = vehicle(_ROUND_S if rounds else 0, extended=extended)
    last = vehicle(rest, extended=extended)
    for number in range(int(rounds) + 1):
        traffic = whole if number < rounds else last
        for start in range(0, len(traffic), _PART):
            frames = traffic[start : start + _PART].copy()
            frames["ts"] += int(number * _ROUND_S * 1e9)
            yield frames


class _File:
    """The frames of a file that the protocol can carry; it may be iterated several times.

    A file is read to its end first, and so checked as a whole; of a pipe only the first frames
    are read.
    """

    def __init__(self, args: argparse.Namespace) -> None:
        self._args = args
        self._refusals = Refusals(args.protocol)
        self._remarks_reported = False
        self._reported = False
        if Path(args.traffic).is_file():
            for _ in self._open():
                pass
            if self._refusals.left_out < self._refusals.frames:
                self.report_left_out()
        self._opened: Iterator[FrameArray] | None = self._open()
        self._first = next(self._opened, None)
        if self._first is None and self._refusals.left_out:
            raise DataError(
                f"{args.traffic}: {args.protocol} can carry none of its frames: "
                f"{self._refusals.reasons}"
            )
        if self._first is None:
            raise DataError(f"there is no frame in {args.traffic}")

    def report_left_out(self) -> None:
        """Report once which frames are left out."""
        if self._refusals.left_out and not self._reported:
            self._reported = True
            write_line(
                f"{self._args.traffic}: {self._refusals}; {self._args.protocol} cannot carry them"
            )

    def __iter__(self) -> Iterator[FrameArray]:
        opened, first = self._opened or self._open(), self._first
        self._opened = self._first = None
        if first is not None:
            yield first
        yield from opened

    def _open(self) -> Iterator[FrameArray]:
        args = self._args
        with TrafficFile([args.traffic], None, read_options(args)) as file:
            yield from filter(len, map(self._refusals.keep, file))
        if not self._remarks_reported:
            self._remarks_reported = True
            write_remarks(file.blocks)


def _summary(report: SimulatorReport) -> Iterator[str]:
    """Yield the lines of the summary at the end."""
    yield f"{report.frames:,} frames, {report.bytes_sent:,} bytes sent"
    if report.frames_untimed and report.pace == "traffic":
        yield f"frames without a time, each sent with the one before: {report.frames_untimed:,}"
    if report.bytes_lost or report.bytes_inserted or report.bytes_flipped:
        yield (
            f"faults: bytes lost {report.bytes_lost:,}, added {report.bytes_inserted:,}, "
            f"flipped {report.bytes_flipped:,}; frames without any: {report.frames_intact:,}"
        )
    if report.stalls:
        yield f"stalls: {report.stalls:,}"
    if report.bytes_received:
        kinds = "".join(f", {name} {count:,}" for name, count in report.controls.items())
        yield (
            f"from the host: frames {report.frames_received:,}{kinds}, "
            f"bytes skipped {report.bytes_skipped:,}; sent back: {report.bytes_answered:,} bytes"
        )
    if report.bytes_ignored or report.packets_swallowed:
        yield (
            f"from the host, and ignored: {report.bytes_ignored:,} bytes while deaf, "
            f"packets after a configuration {report.packets_swallowed:,}"
        )
    if report.bytes_unread:
        yield f"not read by the host: {report.bytes_unread:,} of the bytes sent"
    if report.flushes:
        yield f"flushed by the host, so that some bytes may be lost: {report.flushes:,} times"


def _stall(text: str) -> tuple[int, float]:
    at, _, seconds = text.partition(":")
    try:
        return whole()(at), real()(seconds)
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no stall; write bytes and seconds, such as 5000:2"
        ) from None
