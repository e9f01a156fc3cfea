"""`canser ports`: list the serial ports of this machine."""

import argparse

from canser.commands._parser import GOOD, Commands, add_command, show, write_line
from canser.live.ports import list_ports

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    add_command(
        commands,
        "ports",
        "  canser ports",
        run=run,
    )


def run(args: argparse.Namespace) -> int:  # noqa: ARG001 - what every command takes
    rows = [tuple(port) for port in list_ports()]
    if not rows:
        write_line("no serial port is plugged in; a port in the network is opened by its URL")
        return GOOD
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    show(
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )
    return GOOD
