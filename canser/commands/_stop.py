"""SIGINT and SIGTERM as a request to stop, for commands that run until they are told to end."""

import contextlib
import signal
from collections.abc import Iterator
from typing import Any


class Stop:
    """Whether a signal has asked the program to end."""

    def __init__(self) -> None:
        self.wanted = False
        #: Whether a signal raises KeyboardInterrupt instead. It does while the program waits for
        #: something that cannot look at the flag, such as a server that does not answer.
        self.interrupts = False

    def __bool__(self) -> bool:
        return self.wanted


@contextlib.contextmanager
def stop_on_signals() -> Iterator[Stop]:
    """Let the first SIGINT, SIGTERM or SIGHUP set a flag; the second one ends the program.

    A loop in the block looks at the flag between waits of less than a second. So it ends in good
    order: all bytes that have come are written, and the port is closed.
    """
    stop = Stop()
    before: dict[int, Any] = {}

    def wish(number: int, _: object) -> None:
        if stop.interrupts:
            raise KeyboardInterrupt
        stop.wanted = True
        signal.signal(number, before[number])

    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP; nohup ignores it
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            before[number] = signal.signal(number, wish)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
