"""`canser play`: send the frames of a file, at the times at which they were recorded."""

import argparse
from collections.abc import Iterator

from canser._signals import Stop, stop_on_signals
from canser.commands._common import (
    GOOD,
    CallError,
    Commands,
    DataError,
    add_command,
    as_is_argument,
    say,
    say_remarks,
)
from canser.commands._numbers import real
from canser.commands._port import open_port, port_arguments
from canser.commands._traffic import TrafficFile
from canser.files import FORMATS, FrameFile
from canser.frames import FrameArray
from canser.live.player import Played, play
from canser.live.ports import Port

__all__ = ["add"]

# A line that takes nothing for so long, in seconds, does not work.
_PATIENCE = 10.0

# A day between two frames: the nanoseconds of many such gaps fit in 64 bits.
_GAP_MOST_MS = 86_400_000


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "play",
        "send the frames of a file at their recorded times",
        "  canser play run.pcapng -c /dev/ttyUSB0 -p seeed --bitrate 500000\n"
        "  canser play run.log -c /dev/ttyACM0 -p serial --speed 2 --loop\n"
        "  canser play run.csv -c socket://gateway:4000 -p serial --gap 10",
        run=run,
        parents=[port_arguments()],
    )
    parser.add_argument(
        "source",
        metavar="IN",
        help="a file of frames, a recording, raw bytes of the protocol; or -",
    )
    parser.add_argument(
        "--from",
        dest="source_format",
        choices=FORMATS,
        help="format of IN (default: by its suffix; else raw bytes or a recording)",
    )
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument(
        "--speed", metavar="N", type=real(above=True), default=1.0, help="play N times as fast"
    )
    pace.add_argument(
        "--gap",
        metavar="MS",
        type=real(most=_GAP_MOST_MS),
        help="milliseconds between two frames, instead of their recorded times",
    )
    as_is_argument(parser)
    parser.add_argument("--loop", action="store_true", help="over and over, until interrupted")


def run(args: argparse.Namespace) -> int:
    if args.loop and args.source == "-":
        raise CallError("the standard input can be read only once; --loop needs a file")
    gap_ns = None if args.gap is None else int(args.gap * 1e6)
    with stop_on_signals() as stop:
        first = _open(args)
        with first, open_port(args) as port:
            sender = _Sender(port, first.name)
            played = play(
                _rounds(args, first, stop),
                sender.send,
                speed=args.speed,
                gap_ns=gap_ns,
                wanted=lambda: not stop,
            )
            port.drain(timeout=_PATIENCE)
    if not played.frames and not stop:
        raise DataError(f"{first.name} holds no frame")
    _tell(args, played)
    return GOOD


def _rounds(
    args: argparse.Namespace, first: FrameFile, stop: Stop
) -> Iterator[Iterator[FrameArray]]:
    yield first
    say_remarks(first)
    while args.loop and not stop:
        with _open(args) as again:
            yield again


def _open(args: argparse.Namespace) -> FrameFile:
    """Open IN; raw bytes are of the port's protocol, and a recording knows its own."""
    return TrafficFile(
        args.source,
        args.source_format,
        protocol=args.protocol,
        ts_unit=args.ts_unit,
        as_is=args.as_is,
    )


class _Sender:
    """Send frames, and name the place of one that cannot be sent."""

    def __init__(self, port: Port, name: str) -> None:
        self._port, self._name = port, name
        self._sent = 0

    def send(self, frames: FrameArray) -> None:
        """Send frames."""
        try:
            self._port.send(frames, timeout=_PATIENCE)
        except ValueError as error:
            raise DataError(
                f"{self._name}: {error} (counted from frame {self._sent:,}); the frames before "
                "it were sent"
            ) from None
        self._sent += len(frames)


def _tell(args: argparse.Namespace, played: Played) -> None:
    rounds = f" in {played.rounds:,} rounds" if args.loop else ""
    say(f"{played.frames:,} frames sent to {args.channel}{rounds}")
    if played.untimed == played.frames and args.gap is None:
        say("they have no times: sent as fast as the line took them; --gap MS spaces them")
        return
    late = played.lateness
    say(
        f"timing error: mean {late.mean / 1e6:.2f} ms, 99 % below {late.share(0.99) / 1e6:.2f} ms, "
        f"most {late.most / 1e6:.2f} ms"
    )
    if played.untimed:
        say(f"frames without a time, sent right behind those before them: {played.untimed:,}")
    if played.jumps:
        say(f"jumps of the recorded clock, passed over without a pause: {played.jumps:,}")
