"""Opening a line in a thread that can be left behind: closing a port never waits for a server."""

import contextlib
import threading
from collections.abc import Callable
from typing import Final

from canser._threads import start_thread
from canser.errors import CanserError, PortClosedError, PortError
from canser.live.line import Line

__all__ = ["connect_aside"]

# An attempt checks at this interval whether it shall stop.
_LOOK_EVERY_S: Final = 0.05

# An attempt that shall stop may still end by itself within this time, as that of a local device
# does. Otherwise the device would still be open after the port's `close`.
_LEAVE_AFTER_S: Final = 0.25


def connect_aside(url: str, connect: Callable[[], Line], stop: threading.Event) -> Line:
    """Call `connect` in a daemon thread; return the line that it opens, or raise its exception.

    Name servers and silent hosts keep `connect` for many seconds, and some of these system calls
    cannot be interrupted. So the thread is left behind when `stop` is set (PortClosedError), or
    when an exception such as KeyboardInterrupt comes. A line that `connect` opens after that is
    closed at once. PortError if the system starts no more threads.
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
    """One call of `connect`, and its result."""

    def __init__(self, connect: Callable[[], Line]) -> None:
        self._connect = connect
        self._line: Line | None = None
        self._error: Exception | None = None
        # Acquired by the first of two events: a line is opened, or `leave` is called. The second
        # one closes the line. No thread waits for this lock. Otherwise there could be a deadlock:
        # the garbage collector may close a port in any thread, at any place.
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
        """Return the line of an attempt that has ended, or raise its error."""
        try:
            if self._error is not None:
                raise self._error
        finally:
            self._error = None  # otherwise a circle: its traceback refers to this object
        assert self._line is not None
        return self._line

    def leave(self) -> None:
        """Close the line, now or when it is opened."""
        if not self._first.acquire(blocking=False):
            self._close()

    def _close(self) -> None:
        assert self._line is not None
        with contextlib.suppress(CanserError, OSError):  # there is no caller to report it to
            self._line.close()
