"""What a command that runs on tells meanwhile: a status line, messages, lines for machines."""

import contextlib
import os
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, Self, cast

from canser.errors import CanserWarning

__all__ = ["Lines", "StatusLine", "fit", "warnings_as_lines"]

# Lines that nobody reads: the newest so many are kept.
_KEPT: Final = 10_000

# So long the end waits for somebody who reads slowly, in seconds.
_PATIENCE: Final = 2.0

# A status line is rewritten so often at most, in seconds; where it cannot be rewritten it
# is a line of its own.
_REWRITE: Final = 0.25
_REPEAT: Final = 10.0

_CLEAR: Final = "\r\x1b[K"


class Lines:
    """Write lines to a descriptor, from a thread of its own; a context manager.

    A terminal that is stopped by Ctrl-S, or a pipe that nobody reads, would hold up a writer,
    and so lose what comes over a line. Here nobody waits: lines queue up, and go with
    the descriptor when it is closed at its other end.
    """

    def __init__(self, fd: int | None) -> None:
        """`fd`: None where there is nobody to tell."""
        self._fd = fd
        self._lines: deque[str] = deque(maxlen=_KEPT)
        self._passing: str | None = None  # a line without an end, not shown yet
        self._shown = ""  # the one that stands there
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
        self._thread.join(_PATIENCE)

    def put(self, line: str) -> None:
        """Write a line."""
        with self._came:
            self._lines.append(line)
            self._came.notify()

    def stand(self, text: str) -> None:
        """Let a text stand below the lines, instead of the last one; for terminals."""
        with self._came:
            self._passing = text
            self._came.notify()

    def _run(self) -> None:
        with contextlib.suppress(OSError):  # nobody reads any more
            while True:
                with self._came:
                    while not (self._lines or self._passing is not None or self._closing):
                        self._came.wait()
                    text = self._take()
                data = memoryview(text.encode("utf-8", "backslashreplace"))
                while data and self._fd is not None:
                    # Not through sys.stderr: its lock would hold up the end of the program.
                    data = data[os.write(self._fd, data) :]
                with self._came:
                    if self._closing and not self._lines and self._passing is None:
                        return

    def _take(self) -> str:
        text = "".join(f"{line}\n" for line in self._lines)
        self._lines.clear()
        standing = self._shown if self._passing is None else self._passing
        self._passing = None
        if self._shown or standing:
            text = f"{_CLEAR}{text}{standing}"
        self._shown = standing
        return text


class StatusLine:
    """A line that tells how things stand: rewritten on a terminal, else written now and then."""

    def __init__(self, lines: Lines, fd: int | None) -> None:
        self._lines, self._fd = lines, fd
        self._terminal = fd is not None and os.isatty(fd)
        self._every = _REWRITE if self._terminal else _REPEAT
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
