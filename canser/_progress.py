"""A progress bar on a terminal: that of rich if it is installed, else a plain line."""

import sys
import time
from types import TracebackType
from typing import Any, Self

# Seconds before the bar is shown. Shorter work shows none.
_PATIENCE_S = 0.5

# Characters of the title. A longer one would push the bar off the line.
_TITLE_LEN = 30


class Progress:
    """Show on standard error, if it is a terminal, how many of some bytes are done."""

    def __init__(self, title: str) -> None:
        self._title = title if len(title) <= _TITLE_LEN else f"\u2026{title[1 - _TITLE_LEN :]}"
        self._begin = time.monotonic()
        self._shown = -1
        self._bar: Any = None
        self._task: Any = None
        self._on = sys.stderr.isatty()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
        elif self._shown >= 0:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def __call__(self, done: int, total: int | None) -> None:
        """Show that `done` of `total` bytes are done; `total` is None if it is not known."""
        if not self._on or time.monotonic() - self._begin < _PATIENCE_S:
            return
        if self._bar is None and self._shown < 0:
            self._start(total)
        if self._bar is not None:
            self._bar.update(self._task, completed=done)
            return
        step = done * 100 // total if total else done >> 24
        if step != self._shown:
            self._shown = step
            text = f"{step} %" if total else f"{done / 1e6:,.0f} MB"
            print(f"\r{self._title}: {text}", end="", file=sys.stderr, flush=True)

    def _start(self, total: int | None) -> None:
        try:
            from rich import progress  # noqa: PLC0415 - an optional extra
            from rich.console import Console  # noqa: PLC0415
        except ImportError:
            self._shown = 0
            return
        self._bar = progress.Progress(
            progress.TextColumn("{task.description}"),
            progress.BarColumn(),
            progress.DownloadColumn(),
            progress.TransferSpeedColumn(),
            progress.TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        self._task = self._bar.add_task(self._title, total=total)
        self._bar.start()
