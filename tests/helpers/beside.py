"""Commands that run beside the test, and terminals for what they print."""

import contextlib
import fcntl
import json
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from canser.commands.cli import main
from device import PATIENCE
from forked import CAN_FORK, Forked


class Running:
    """A command that runs: its lines as they come."""

    def __init__(self, process: Any) -> None:
        self.process = process
        self.out: list[str] = []
        self.err: list[str] = []
        self._came = threading.Condition()
        self._threads = [
            threading.Thread(target=self._read, args=(stream, lines))
            for stream, lines in ((process.stdout, self.out), (process.stderr, self.err))
            if stream is not None
        ]
        for thread in self._threads:
            thread.start()

    def _read(self, stream: Any, lines: list[str]) -> None:
        for line in stream:
            with self._came:
                lines.append(line.decode().rstrip("\n"))
                self._came.notify_all()
        with self._came:
            self._came.notify_all()

    def wait_for(self, condition: Callable[[], object], what: str) -> None:
        """Wait until something is true of the lines."""
        with self._came:
            assert self._came.wait_for(condition, PATIENCE), (what, self.out[-5:], self.err[-5:])

    def wait_line(self, words: str) -> str:
        """Wait for a line on standard error with these words, and return it."""
        self.wait_for(lambda: any(words in line for line in self.err), words)
        return next(line for line in self.err if words in line)

    def objects(self, kind: str | None = None) -> list[dict[str, Any]]:
        """Return the JSON objects on standard output so far."""
        found = [json.loads(line) for line in list(self.out)]
        return [one for one in found if kind in (None, one["type"])]

    def wait_object(self, kind: str, **facts: object) -> dict[str, Any]:
        """Wait for an object with these facts, and return it."""

        def fitting() -> list[dict[str, Any]]:
            return [one for one in self.objects(kind) if facts.items() <= one.items()]

        self.wait_for(fitting, f"{kind} {facts}")
        return fitting()[0]

    def end(self, number: signal.Signals | None = None) -> int:
        """Send a signal, if one is given, and wait for the end; return the exit code."""
        if number is not None:
            self.process.send_signal(number)
        code: int = self.process.wait(PATIENCE)
        for thread in self._threads:
            thread.join(PATIENCE)
        return code


@contextlib.contextmanager
def running(folder: Path, *arguments: str, python: str = "", **more: Any) -> Iterator[Running]:
    """Run a command of canser; `python`: by code that calls `main` of canser.commands.cli."""
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    call = [sys.executable, *(["-c", python] if python else ["-m", "canser"]), *arguments]
    files = pipes | more
    if CAN_FORK and not python and files.keys() == pipes.keys():
        process: Any = Forked(folder, arguments, tuple(files.values()), os.environ)
    else:
        process = subprocess.Popen(call, cwd=folder, **files)
    with process:
        run = Running(process)
        try:
            yield run
        finally:
            process.kill()
            run.end()


def fails(capfd: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """Call a command that fails, in this process; return its code and its one line."""
    try:
        code = main(arguments)
    except SystemExit as end:  # the parser's
        code = end.code if isinstance(end.code, int) else -1
    out, err = capfd.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    assert line.startswith("canser")
    return code, line


def open_terminal(columns: int) -> tuple[int, int]:
    """Return a terminal of some width for a command's output: what is read, what is given."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    return master, slave


def read_terminal(master: int, condition: Callable[[str], object]) -> str:
    """Read what a terminal shows until something is true of it."""
    text = ""
    end = time.monotonic() + PATIENCE
    while not condition(text):
        ready, _, _ = select.select([master], [], [], max(end - time.monotonic(), 0))
        assert ready, text
        text += os.read(master, 65536).decode()
    return text
