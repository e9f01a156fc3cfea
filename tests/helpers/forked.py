"""Commands of canser as processes that are forked from one which has imported numpy already.

Python and its imports take longer than most commands, and the tests run hundreds of them.
"""

import contextlib
import io
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from multiprocessing.reduction import DupFd
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from canser.commands.cli import main

# Whether processes can be forked so: elsewhere they are started as usual.
CAN_FORK = sys.platform == "linux"

if CAN_FORK:
    _context = multiprocessing.get_context("forkserver")
    _context.set_forkserver_preload(["numpy", "canser.commands.cli", "canser.files.reading"])


class Forked:
    """A process as `subprocess.Popen` gives it; `files` are PIPE, DEVNULL, or files."""

    def __init__(
        self,
        folder: Path,
        arguments: tuple[str, ...],
        files: tuple[Any, Any, Any],
        variables: Mapping[str, str],
    ) -> None:
        self.args = ["canser", *arguments]
        given, ours, to_close = [], [], []
        for number, file in enumerate(files):
            mine: int | None = None
            if file == subprocess.PIPE:
                read, write = os.pipe()
                theirs, mine = (read, write) if number == 0 else (write, read)
                to_close.append(theirs)
            elif file == subprocess.DEVNULL:
                theirs = os.open(os.devnull, os.O_RDWR)
                to_close.append(theirs)
            else:
                theirs = file if isinstance(file, int) else file.fileno()
            given.append(DupFd(theirs))
            ours.append(mine)
        self._process = _context.Process(
            target=_serve, args=(os.fspath(folder), arguments, given, dict(variables)), daemon=True
        )
        self._process.start()
        for number in to_close:
            os.close(number)
        self.stdin, self.stdout, self.stderr = (
            None if mine is None else os.fdopen(mine, "wb" if place == 0 else "rb")
            for place, mine in enumerate(ours)
        )
        assert self._process.pid is not None
        self.pid: int = self._process.pid

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for file in (self.stdout, self.stderr, self.stdin):
            if file is not None:
                with contextlib.suppress(BrokenPipeError):  # its reader has gone
                    file.close()
        self.wait(60)

    @property
    def returncode(self) -> int | None:
        return self._process.exitcode

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        self._process.join(timeout)
        code = self._process.exitcode
        if code is None:
            assert timeout is not None
            raise subprocess.TimeoutExpired(self.args, timeout)
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def _serve(
    folder: str, arguments: tuple[str, ...], given: list[Any], variables: dict[str, str]
) -> None:
    """Do what `python -m canser` does."""
    for number, file in enumerate(given):
        at = file.detach()
        os.dup2(at, number)
        os.close(at)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(variables)
    sys.stdin, sys.stdout = _standard(0, "<stdin>", "r"), _standard(1, "<stdout>", "w")
    sys.stderr = _standard(2, "<stderr>", "w")
    sys.argv = ["canser", *arguments]
    sys.exit(main())


def _standard(number: int, name: str, mode: str) -> io.TextIOWrapper:
    """Return one of the three files as Python opens it."""
    raw = io.FileIO(number, mode, closefd=False)
    raw.name = name
    buffer: Any = io.BufferedReader(raw) if mode == "r" else io.BufferedWriter(raw)
    lines = number == 2 or (mode == "w" and os.isatty(number))
    errors = "backslashreplace" if number == 2 else "strict"
    return io.TextIOWrapper(buffer, "utf-8", errors, line_buffering=lines)
