"""What a command that runs on tells meanwhile: a status line, messages, lines for machines."""

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

# Lines that wait for their reader: the newest are kept, so many.
_KEPT: Final = 10_000

# A pipe takes this many bytes as one, as soon as its reader has made room for them.
_PART_BYTES: Final = 4096

# The end waits for a reader that is slow, but not for one that takes nothing for so long.
PATIENCE_S: Final = 5.0
_LOOK_S: Final = 0.1

# A descriptor that does not block is tried again after this time.
_RETRY_S: Final = 0.05

# The time between two status lines at least: where a line can be rewritten, and where each is a
# line of its own.
_REWRITE_S: Final = 0.25
_REPEAT_S: Final = 10.0

_CLEAR: Final = "\r\x1b[K"


class Lines:
    """Write lines to a descriptor, from a thread of its own; a context manager.

    A terminal that is stopped by Ctrl-S, or a pipe that is not read, would hold up a writer,
    and so lose what comes over a serial line. Here lines queue up: the newest are kept, and
    `dropped` counts the others. The end waits until all lines are written, as long as some are
    read: `unread` tells that it has given up.

    After an error of the descriptor nothing more is written; `error` has it.
    """

    def __init__(
        self, fd: int | None, on_error: Callable[[OSError], None] = lambda _: None
    ) -> None:
        """`fd`: None for lines without a reader; `on_error`: is called by the thread."""
        self.dropped = 0
        self.unread = False
        self.error: OSError | None = None
        self._fd, self._on_error = fd, on_error
        self._lines: deque[str] = deque()
        self._passing: str | None = None  # a line without an end, not shown yet
        self._shown = ""  # the one that stands there
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
        """Write a line. `last`: one of the last lines, for which no other is dropped."""
        with self._came:
            if self.error is not None:
                return
            self._lines.append(line)
            if len(self._lines) > _KEPT and not last:
                self._lines.popleft()
                self.dropped += 1
            self._came.notify()

    def stand(self, text: str) -> None:
        """Let a text stand below the lines, instead of the last one; for terminals."""
        with self._came:
            self._passing = text
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
                while not (self._lines or self._passing is not None or self._closing):
                    self._came.wait()
                text = self._take()
            if self._fd is not None:
                self._write(self._fd, text.encode("utf-8", "backslashreplace"))
            with self._came:
                if self._closing and not self._lines and self._passing is None:
                    return

    def _write(self, fd: int, data: bytes) -> None:
        at = 0
        while at < len(data):
            try:
                # Not through sys.stderr: its lock would hold up the end of the program.
                done = os.write(fd, data[at : at + _PART_BYTES])
            except BlockingIOError:
                time.sleep(_RETRY_S)
                continue
            at += done
            self._written += done

    def _take(self) -> str:
        text = "".join(f"{line}\n" for line in self._lines)
        self._lines.clear()
        standing = self._shown if self._passing is None else self._passing
        self._passing = None
        if self._shown or standing:
            text = f"{_CLEAR}{text}{standing}"
        self._shown = standing
        return text


def _in_pipe(fd: int | None) -> int:
    """Return how many bytes in a pipe are not read yet; 0 where that is not known."""
    if sys.platform != "win32" and fd is not None and stat.S_ISFIFO(os.fstat(fd).st_mode):
        count = array("i", [0])
        with contextlib.suppress(OSError):
            fcntl.ioctl(fd, termios.FIONREAD, count)
        return count[0]
    return 0


class StatusLine:
    """A line that tells how things stand: rewritten on a terminal, else written now and then."""

    def __init__(self, lines: Lines, fd: int | None) -> None:
        self._lines, self._fd = lines, fd
        self._terminal = fd is not None and os.isatty(fd)
        self._every = _REWRITE_S if self._terminal else _REPEAT_S
        self._due = 0.0 if self._terminal else time.monotonic() + self._every

    @property
    def due(self) -> bool:
        """Whether it is time to show it again."""
        return time.monotonic() >= self._due

    def show(self, parts: Sequence[str]) -> None:
        """Show it, as many parts as fit into the terminal's width."""
        self._due = time.monotonic() + self._every
        if self._terminal:
            self._lines.stand(fit(parts, self._columns()))
        else:
            self._lines.put("  ".join(parts))

    def clear(self) -> None:
        """Let no status line stand."""
        if self._terminal:
            self._lines.stand("")

    def _columns(self) -> int:
        assert self._fd is not None
        with contextlib.suppress(OSError):
            return os.get_terminal_size(self._fd).columns or 80
        return 80


def fit(parts: Sequence[str], columns: int) -> str:
    """Return the parts in one line, as many from the front as fit, whole.

    Two blanks lie between them, one where more of them fit so. One column stays free: some
    terminals wrap a line that is full.
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
def warnings_as_lines(tell: Callable[[str], None]) -> Iterator[None]:
    """Let the warnings of this package be told, each as a line."""

    def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
        if issubclass(category, CanserWarning):
            tell(str(message))
        else:
            before(message, category, *place)

    with warnings.catch_warnings():
        warnings.simplefilter("always", CanserWarning)
        before, warnings.showwarning = warnings.showwarning, cast(Any, show)
        yield
