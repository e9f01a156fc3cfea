"""Private: the commands of `canser`, one module each, loaded when it is called.

A command has `add(commands)`, which adds its parser with what it runs as `run`: a function
of the arguments that returns the exit code.
"""

from typing import Final

__all__ = ["COMMANDS"]

# What each does, in the order in which the help names them.
COMMANDS: Final = {
    "convert": "raw bytes or a recording to .npy, .csv or candump .log, and back",
    "info": "frames, times, ids, rates, skipped bytes; without -p, which protocol fits best",
    "dump": "print frames as candump does",
    "log": "record the bytes of a port, with their times, in pcapng files",
    "monitor": "show the live table of a port, by id",
    "play": "send the frames of a file at their recorded times",
    "send": "send frames",
    "simulate": "simulate an adapter on a pseudo terminal: no hardware needed",
    "ports": "list the serial ports that are plugged in",
    "recover": "copy the intact part of a torn or damaged recording, and say what is left out",
}
