"""Private: the commands of `canser`, one module each, loaded when the command is called.

The function `add(commands)` of a module adds the parser of its command. The default `run` of the
parser is a function of the arguments that returns the exit code.
"""

from typing import Final

__all__ = ["COMMANDS"]

# The name and the help of each command, in the order of the help.
COMMANDS: Final = {
    "convert": "convert files of any format to any other",
    "info": "show frames, times, ids, rates and skipped bytes; without -p, find the protocol",
    "stats": "show period, jitter, missing frames and changes of each id",
    "compare": "show which ids, bits and periods differ between two files",
    "signals": "decode signals with a database; print a summary, or write their values",
    "plot": "draw pictures: load, ids over time, periods, payload, signals, skipped bytes",
    "dump": "print frames in the format of candump",
    "log": "record the bytes of a port, with their times, in pcapng files",
    "monitor": "show a live table of a port, with a row for each id",
    "play": "send the frames of a file to a port at their recorded times",
    "send": "send single frames to a port",
    "simulate": "simulate an adapter on a pseudo terminal, without hardware",
    "ports": "list the serial ports that are plugged in",
    "recover": "copy the intact part of a damaged recording, and report what is left out",
}
