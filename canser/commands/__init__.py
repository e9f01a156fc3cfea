"""Private: the commands of `canser`, one module each.

A command has `add(commands)`, which adds its parser with what it runs as `run`: a function
of the arguments that returns the exit code.
"""

from canser.commands import (
    convert,
    dump,
    info,
    log,
    monitor,
    play,
    ports,
    recover,
    send,
    simulate,
)

__all__ = ["ALL"]

# In the order in which the help names them.
ALL = (
    convert,
    info,
    dump,
    log,
    monitor,
    play,
    send,
    simulate,
    ports,
    recover,
)
