"""The output of a command while it runs: a status line, messages, lines for machines."""

import contextlib
import os
import stat
import sys
import threading
import time
import warnings
from array import array
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, Self, cast

from canser.errors import CanserWarning

if sys.platform != "win32":
    import fcntl
    import termios

__all__ = ["PATIENCE_S", "Lines", "StatusLine", "fit", "warnings_as_lines"]

# Lines that may wait for their reader. Above this number the oldest are dropped.
_KEPT: Final = 10_000

# Bytes written at once: a pipe takes up to PIPE_BUF bytes (4096 on Linux, pipe(7)) undivided, as
# soon as its reader has made room for them.
_PART_BYTES: Final = 4096

# At the end of a command a slow reader is waited for, until it has read nothing for this time.
PATIENCE_S: Final = 5.0

# Interval at which the end looks at the reader.
_LOOK_S: Final = 0.1

# A non-blocking descriptor without room is tried again after this time.
_RETRY_S: Final = 0.05

# Least time between two status lines: on a terminal, which rewrites the line, and elsewhere, where
# each is a new line.
_REWRITE_S: Final = 0.25
_REPEAT_S: Final = 10.0

_CLEAR: Final = "\r\x1b[K"


class Lines:
    """Write lines to a descriptor from a separate thread; a context manager.

    Otherwise a terminal stopped by Ctrl-S, or a pipe that is not read, would block the command,
    and bytes of the serial line would be lost. Here lines wait in a queue: the newest are kept,
    and `dropped` counts the others. The end of the block waits until all lines are written, as
    long as the reader reads. `unread` is True if the end has given up waiting.

    After an error of the descriptor nothing more is written; `error` holds that error.
    """

    def __init__(
        self, fd: int | None, on_error: Callable[[OSError], None] = lambda _: None
    ) -> None:
        """`fd`: None to write nothing; `on_error`: called by the thread."""
        self.dropped = 0
        self.unread = False
        self.error: OSError | None = None
        self._fd, self._on_error = fd, on_error
        self._lines: deque[str] = deque()
        self._next_status: str | None = None  # the status line to show next, without an end
        self._status = ""  # the status line that is shown
        self._written = 0  # bytes
        self._came = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="canser lines", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with self._came:
            self._closing = True
            self._came.notify()
        seen, since = (-1, -1), 0.0
        while self._thread.is_alive():
            now = self._written, _in_pipe(self._fd)
            if now != seen:
                seen, since = now, time.monotonic()
            elif time.monotonic() - since > PATIENCE_S:
                self.unread = True
                return
            self._thread.join(_LOOK_S)

    def put(self, line: str, *, last: bool = False) -> None:
        """Write a line. `last`: one of the last lines; it drops no other line."""
        with self._came:
            if self.error is not None:
                return
            self._lines.append(line)
            if len(self._lines) > _KEPT and not last:
                self._lines.popleft()
                self.dropped += 1
            self._came.notify()

    def show_status(self, text: str) -> None:
        """Show a status line below all lines, in place of the one before; for terminals."""
        with self._came:
            self._next_status = text
            self._came.notify()

    def _run(self) -> None:
        try:
            self._write_all()
        except OSError as error:
            with self._came:
                self.error = error
                self._lines.clear()
            self._on_error(error)

    def _write_all(self) -> None:
        while True:
            with self._came:
                while not (self._lines or self._next_status is not None or self._closing):
                    self._came.wait()
                text = self._take()
            if self._fd is not None:
                self._write(self._fd, text.encode("utf-8", "backslashreplace"))
            with self._came:
                if self._closing and not self._lines and self._next_status is None:
                    return

    def _write(self, fd: int, data: bytes) -> None:
        at = 0
        while at < len(data):
            try:
                # Not through sys.stderr: its lock would block the end of the program.
                done = os.write(fd, data[at : at + _PART_BYTES])
            except BlockingIOError:
                time.sleep(_RETRY_S)
                continue
            at += done
            self._written += done

    def _take(self) -> str:
        text = "".join(f"{line}\n" for line in self._lines)
        self._lines.clear()
        status = self._status if self._next_status is None else self._next_status
        self._next_status = None
        if self._status or status:
            text = f"{_CLEAR}{text}{status}"
        self._status = status
        return text


def _in_pipe(fd: int | None) -> int:
    """Return the number of unread bytes in a pipe; 0 if it is unknown."""
    if sys.platform != "win32" and fd is not None and stat.S_ISFIFO(os.fstat(fd).st_mode):
        count = array("i", [0])
        with contextlib.suppress(OSError):
            fcntl.ioctl(fd, termios.FIONREAD, count)
        return count[0]
    return 0


class StatusLine:
    """A line with the present counters: rewritten on a terminal, elsewhere written every 10 s."""

    def __init__(self, lines: Lines, fd: int | None) -> None:
        self._lines, self._fd = lines, fd
        self._terminal = fd is not None and os.isatty(fd)
        self._every = _REWRITE_S if self._terminal else _REPEAT_S
        self._due = 0.0 if self._terminal else time.monotonic() + self._every

    @property
    def due(self) -> bool:
        """Whether it is time to show the line again."""
        return time.monotonic() >= self._due

    def show(self, parts: Sequence[str]) -> None:
        """Show the line: as many parts as fit into the width of the terminal."""
        self._due = time.monotonic() + self._every
        if self._terminal:
            self._lines.show_status(fit(parts, self._columns()))
        else:
            self._lines.put("  ".join(parts))

    def clear(self) -> None:
        """Remove the status line."""
        if self._terminal:
            self._lines.show_status("")

    def _columns(self) -> int:
        assert self._fd is not None
        with contextlib.suppress(OSError):
            return os.get_terminal_size(self._fd).columns or 80
        return 80


def fit(parts: Sequence[str], columns: int) -> str:
    """Return the first parts in one line, as many as fit whole.

    Two blanks separate the parts, or one blank if more parts fit then. The last column stays
    free, because some terminals wrap a full line.
    """
    wide, narrow = _joined(parts, "  ", columns - 1), _joined(parts, " ", columns - 1)
    return narrow if len(narrow.split()) > len(wide.split()) else wide


def _joined(parts: Sequence[str], blanks: str, columns: int) -> str:
    line = parts[0][:columns]
    for part in parts[1:]:
        if len(line) + len(blanks) + len(part) > columns:
            break
        line += blanks + part
    return line


@contextlib.contextmanager
def warnings_as_lines(write: Callable[[str], None]) -> Iterator[None]:
    """Write each warning of this package as a line."""

    def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
        if issubclass(category, CanserWarning):
            write(str(message))
        else:
            before(message, category, *place)

    with warnings.catch_warnings():
        warnings.simplefilter("always", CanserWarning)
        before, warnings.showwarning = warnings.showwarning, cast(Any, show)
        yield
