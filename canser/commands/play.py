"""`canser play`: send the frames of a file at their recorded times."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from canser._frames import FrameArray
from canser.codec.refusals import Refusals
from canser.commands._numbers import real
from canser.commands._parser import GOOD, CallError, Commands, DataError, add_command, write_line
from canser.commands._port import open_port, port_arguments
from canser.commands._screen import warnings_as_lines
from canser.commands._sending import Sender, pace_argument
from canser.commands._source import (
    FORMATS,
    as_is_argument,
    format_name,
    log_arguments,
    read_options,
)
from canser.commands._stop import Stop, stop_on_signals
from canser.commands._traffic import TrafficFile
from canser.errors import CanserError
from canser.live.player import Played, play

__all__ = ["add"]

# The largest --gap, a day: the sum of 100,000 such gaps in nanoseconds fits into 64 bits.
_GAP_MOST_MS = 86_400_000


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "play",
        "  canser play run.pcapng -c /dev/ttyUSB0 -p seeed --bitrate 500000\n"
        "  canser play run.log -c /dev/ttyACM0 -p serial --speed 2 --loop\n"
        "  canser play run.csv -c socket://gateway:4000 -p serial --gap 10\n"
        "  canser play two-buses.log --bus can1 -c /dev/ttyACM0 -p serial",
        run=run,
        parents=[port_arguments()],
    )
    parser.add_argument(
        "sources",
        metavar="IN",
        nargs="+",
        help="file of frames, recording or raw bytes of the protocol to send, or - for standard "
        "input; several files are one stream, in this order. IN is checked before anything is "
        "sent: the whole of a file; the first 64 KiB of a pipe of raw bytes, then each block",
    )
    parser.add_argument(
        "--from",
        dest="source_format",
        metavar="FORMAT",
        type=format_name,
        help=f"format of IN: {FORMATS} (default: by its content, otherwise by its suffix, "
        "otherwise raw)",
    )
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument(
        "--speed",
        metavar="N",
        type=real(above=True),
        default=1.0,
        help="send N times as fast as recorded (default: 1)",
    )
    pace.add_argument(
        "--gap",
        metavar="MS",
        type=real(most=_GAP_MOST_MS),
        help="send a frame every MS milliseconds (default: at their recorded times)",
    )
    pace_argument(parser)
    log_arguments(parser)
    parser.add_argument(
        "--sort",
        action="store_true",
        help="order all frames by their times; all must fit into memory (default: as in IN)",
    )
    as_is_argument(parser)
    parser.add_argument(
        "--loop",
        action="store_true",
        help="send IN over and over, until Ctrl-C (default: once)",
    )
    parser.add_argument(
        "--strict",
        action="store_true",
        help="send nothing of a file with frames that the protocol cannot carry (default: leave "
        "these frames out, and count them)",
    )


# The errors that reading IN may raise.
_ERRORS: Final = (CallError, CanserError, DataError, ValueError, OSError)


def run(args: argparse.Namespace) -> int:
    file = all(Path(path).is_file() for path in args.sources)  # a pipe can be read only once
    if args.loop and not file:
        raise CallError(f"{args.sources[0]} can be read only once; --loop needs a file")
    gap_ns = None if args.gap is None else int(args.gap * 1e6)
    # Opening a pipe waits for its first bytes. Here a signal ends the program at once, as nothing
    # is sent yet.
    pipe = None if file else _open(args)
    with stop_on_signals() as stop:
        source = _Source(args, stop)
        if file:
            source.check()
        first = pipe or _open(args)
        with first, warnings_as_lines(write_line), open_port(args, stop) as port:
            sender = Sender(port, wanted=lambda: not stop, pace=args.pace)
            sender.wait_listening()  # the times of the frames count from here
            try:
                played = play(
                    source.rounds(first),
                    sender.send,
                    speed=args.speed,
                    gap_ns=gap_ns,
                    wanted=lambda: not stop,
                )
                sender.drain()
            finally:
                source.report_left_out()
    if sender.sent or stop:
        paced = args.pace and port.bitrate is not None
        _summarize(args, played, sender.sent, "the bus carries" if paced else "the line took")
    source.finish()
    return GOOD


class _Source:
    """The frames of IN that the protocol of the port can carry, round by round.

    An error of IN ends the last round, and is raised by `finish`: the frames before the error are
    sent, and counted.
    """

    def __init__(self, args: argparse.Namespace, stop: Stop) -> None:
        self._args, self._stop = args, stop
        self._expected = 0  # frames left out in all rounds so far, as `check` has counted
        self._checked = self._refusals()
        self._played = self._refusals()
        self._name = ""
        self._reported: set[str] = set()
        self._error: Exception | None = None

    def check(self) -> None:
        """Read the whole file, and report on it, before anything is sent."""
        with _open(self._args) as file:
            for frames in file:
                self._checked.keep(frames)
                if self._stop:
                    return
            self._report_remarks(file)
            self._check_any(file.name, self._checked)
        if self._checked.left_out:
            if self._args.strict:
                raise self._refused(file.name, self._checked)
            write_line(f"{file.name}: {self._checked}; {self._args.protocol} cannot carry them")

    def rounds(self, first: TrafficFile) -> Iterator[Iterator[FrameArray]]:
        """Yield the frames of each round."""
        self._name = first.name
        yield self._frames(first)
        while self._args.loop and not (self._stop or self._error):
            try:
                again = _open(self._args)
            except _ERRORS as error:
                self._error = error
                return
            with again:
                yield self._frames(again)

    def report_left_out(self) -> None:
        """Report the frames left out, unless `check` has: of a pipe, or of a file that changed."""
        if self._played.left_out > self._expected:
            write_line(f"{self._name}: {self._played}; {self._args.protocol} cannot carry them")

    def finish(self) -> None:
        """Raise the error that has ended the last round."""
        if self._error is not None:
            raise self._error
        if not self._stop:
            self._check_any(self._name, self._played)

    def _frames(self, file: TrafficFile) -> Iterator[FrameArray]:
        self._expected += self._checked.left_out
        try:
            for frames in file:
                kept = self._played.keep(frames)
                if self._args.strict and self._played.left_out:
                    raise self._refused(file.name, self._played)
                yield kept
        except _ERRORS as error:
            self._error = error
        self._report_remarks(file)

    def _report_remarks(self, file: TrafficFile) -> None:
        """Report each remark once, even if the file is read several times."""
        for remark in file.remarks:
            if remark not in self._reported:
                self._reported.add(remark)
                write_line(remark)

    def _check_any(self, name: str, found: Refusals) -> None:
        if not found.frames:
            raise DataError(f"{name} holds no frame")
        if found.frames == found.left_out:
            raise DataError(
                f"{name}: {self._args.protocol} can carry none of the {found.frames:,} frames: "
                f"{found.reasons}"
            )

    def _refused(self, name: str, found: Refusals) -> DataError:
        return DataError(
            f"{name}: {self._args.protocol} cannot carry {found.left_out:,} of {found.frames:,} "
            f"frames: {found.reasons}; without --strict they are left out"
        )

    def _refusals(self) -> Refusals:
        return Refusals(self._args.protocol, times_given=True)


def _open(args: argparse.Namespace) -> TrafficFile:
    """Open IN; raw bytes are in the protocol of the port, and a recording names its own."""
    return TrafficFile(
        args.sources,
        args.source_format,
        read_options(args),
        sort=args.sort,
    )


def _summarize(args: argparse.Namespace, played: Played, sent: int, pace: str) -> None:
    rounds = f" in {played.rounds:,} rounds" if args.loop else ""
    write_line(f"{sent:,} frames sent to {args.channel}{rounds}")
    if played.untimed == played.frames and args.gap is None:
        write_line(f"they have no times: sent as fast as {pace} them; --gap MS spaces them")
        return
    late = played.lateness
    write_line(
        f"timing error: mean {late.mean / 1e6:.2f} ms, 99 % below {late.share(0.99) / 1e6:.2f} ms, "
        f"most {late.most / 1e6:.2f} ms"
    )
    if played.untimed:
        write_line(
            f"frames without a time, sent right behind those before them: {played.untimed:,}"
        )
    if played.jumps:
        write_line(f"jumps of the recorded clock, passed over without a pause: {played.jumps:,}")
