"""`canser send`: send frames that are given in the call."""

import argparse

from canser._frames import copy_records
from canser._items import frames as make_frames
from canser.codec.decoder import encode
from canser.commands._parser import GOOD, CallError, Commands, add_command, write_line
from canser.commands._port import open_port, port_arguments
from canser.commands._screen import warnings_as_lines
from canser.commands._sending import Sender, pace_argument

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "send",
        "  canser send -c /dev/ttyUSB0 -p seeed --bitrate 500000 123#DEADBEEF\n"
        "  canser send -c /dev/ttyACM0 -p serial 18FEF100#01.02 7E0#R8\n"
        "  canser send -c socket://gateway:4000 -p cantalope 123# 124#00",
        run=run,
        parents=[port_arguments()],
    )
    parser.add_argument(
        "frames",
        metavar="FRAME",
        nargs="+",
        help="frame as candump writes it: ID#DATA in hexadecimal, with 8 digits for an extended "
        "id; ID#R, or ID#R8 with a dlc of 8, for a remote frame",
    )
    pace_argument(parser)


def run(args: argparse.Namespace) -> int:
    try:
        frames = make_frames(args.frames)
        # Frames that the protocol cannot carry are refused before the port is opened.
        timed = copy_records(frames)
        timed["ts"] = 0
        encode(timed, args.protocol)
    except ValueError as error:
        raise CallError(str(error)) from None
    with warnings_as_lines(write_line), open_port(args) as port:
        sender = Sender(port, pace=args.pace)
        sender.send(frames)
        sender.drain()
    count = sender.sent
    write_line(f"{count:,} frame{'s' * (count != 1)} sent to {args.channel}")
    return GOOD
