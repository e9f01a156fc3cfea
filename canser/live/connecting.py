"""Opening a line in a thread that can be left behind: a wish to stop never waits for a server."""

import contextlib
import threading
from collections.abc import Callable
from typing import Final

from canser._threads import start_thread
from canser.errors import CanserError, PortClosedError, PortError
from canser.live.line import Line

__all__ = ["connect_aside"]

# An attempt looks this often whether it shall stop.
_LOOK_EVERY_S: Final = 0.05

# An attempt that shall stop may end by itself within this time, as that of a device does. Otherwise
# the device would be open still after the port's `close`.
_LEAVE_AFTER_S: Final = 0.25


def connect_aside(url: str, connect: Callable[[], Line], stop: threading.Event) -> Line:
    """Return the line that `connect` opens, in a daemon thread; raise what it raises.

    Name servers and silent hosts keep `connect` for many seconds, and some of these calls of the
    system cannot be interrupted. So the thread is left behind when `stop` is set, with
    PortClosedError, or when an exception such as KeyboardInterrupt comes. A line that comes after
    that is closed at once. PortError where the system starts no more threads.
    """
    attempt = _Attempt(connect)
    thread = threading.Thread(target=attempt.run, name="canser connecting", daemon=True)
    try:
        start_thread(thread, url, PortError)
        while not attempt.ended.wait(_LOOK_EVERY_S):
            if stop.is_set() and not attempt.ended.wait(_LEAVE_AFTER_S):
                raise PortClosedError(f"{url} is closed")
        return attempt.result()
    except BaseException:
        attempt.leave()
        raise


class _Attempt:
    """One call of `connect`, and what has come of it."""

    def __init__(self, connect: Callable[[], Line]) -> None:
        self._connect = connect
        self._line: Line | None = None
        self._error: Exception | None = None
        # Acquired by what comes first, a line or `leave`. What comes second closes the line. No
        # thread waits for it: a thread may collect a port at any place, and wait for another one.
        self._first = threading.Lock()
        self.ended = threading.Event()

    def run(self) -> None:
        try:
            self._line = self._connect()
        except Exception as error:  # noqa: BLE001 - the caller raises it
            self._error = error
        else:
            if not self._first.acquire(blocking=False):
                self._close()
        self.ended.set()

    def result(self) -> Line:
        """Return the line, or raise the error, of an attempt that has ended."""
        try:
            if self._error is not None:
                raise self._error
        finally:
            self._error = None  # its traceback leads here
        assert self._line is not None
        return self._line

    def leave(self) -> None:
        """Close the line, now or when it comes."""
        if not self._first.acquire(blocking=False):
            self._close()

    def _close(self) -> None:
        assert self._line is not None
        with contextlib.suppress(CanserError, OSError):  # there is no caller any more
            self._line.close()
