"""The command as a process: called, timed out, and judged by its exit code and its one line."""

import contextlib
import io
import multiprocessing
import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

from canser.commands.cli import main

# Exit codes.
GOOD, BAD_DATA, BAD_CALL = 0, 1, 2

PRINTING = {"COLUMNS", "LINES", "PYTHONUNBUFFERED"}

# A command that hangs is a failure, on the slowest machine too.
PATIENCE = 60


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "canser", *arguments]


def environment(**more: str) -> dict[str, str]:
    """Return this environment without what changes how programs print."""
    plain = {name: os.environ[name] for name in os.environ.keys() - PRINTING}
    return plain | {"TERM": "xterm"} | more


def run(
    folder: Path, *arguments: str, stdin: bytes = b"", **more: str
) -> subprocess.CompletedProcess[bytes]:
    """Run the command in a folder, to its end."""
    if more or sys.platform != "linux":
        return subprocess.run(
            command(*arguments),
            cwd=folder,
            input=stdin,
            capture_output=True,
            env=environment(**more),
            timeout=PATIENCE,
            check=False,
        )
    return _run_forked(folder, arguments, stdin)


# Starts processes that have imported numpy already: that takes longer than most commands.
_forks = multiprocessing.get_context("forkserver") if sys.platform == "linux" else None
if _forks is not None:
    _forks.set_forkserver_preload(["numpy", "canser.commands.cli"])


def _run_forked(
    folder: Path, arguments: tuple[str, ...], stdin: bytes
) -> subprocess.CompletedProcess[bytes]:
    assert _forks is not None
    with (
        tempfile.NamedTemporaryFile() as given,
        tempfile.NamedTemporaryFile() as out,
        tempfile.NamedTemporaryFile() as err,
    ):
        given.write(stdin)
        given.flush()
        paths = given.name, out.name, err.name
        process = _forks.Process(
            target=_main, args=(os.fspath(folder), arguments, paths, environment()), daemon=True
        )
        process.start()
        process.join(PATIENCE)
        if process.exitcode is None:
            process.kill()
            raise subprocess.TimeoutExpired(command(*arguments), PATIENCE)
        return subprocess.CompletedProcess(
            command(*arguments), process.exitcode, out.read(), err.read()
        )


def _main(
    folder: str, arguments: tuple[str, ...], paths: tuple[str, str, str], variables: dict[str, str]
) -> None:
    """Do what `python -m canser` does, in a process that was forked."""
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(variables)
    pipe, end = os.pipe()  # as a command has it that reads what another one writes
    data = Path(paths[0]).read_bytes()
    threading.Thread(target=_feed, args=(end, data), daemon=True).start()
    os.dup2(pipe, 0)
    for number, path in ((1, paths[1]), (2, paths[2])):
        os.dup2(os.open(path, os.O_WRONLY), number)
    sys.stdin, sys.stdout = _standard(0, "<stdin>", "r"), _standard(1, "<stdout>", "w")
    sys.stderr = _standard(2, "<stderr>", "w")
    sys.argv = ["canser", *arguments]
    sys.exit(main())


def _standard(number: int, name: str, mode: str) -> io.TextIOWrapper:
    """Return one of the three files as Python opens it."""
    raw = io.FileIO(number, mode, closefd=False)
    raw.name = name
    buffer: Any = io.BufferedReader(raw) if mode == "r" else io.BufferedWriter(raw)
    is_error = number == 2
    errors = "backslashreplace" if is_error else "strict"
    return io.TextIOWrapper(buffer, "utf-8", errors, line_buffering=is_error)


def _feed(end: int, data: bytes) -> None:
    with contextlib.suppress(BrokenPipeError), open(end, "wb") as file:
        file.write(data)


def assert_fails(done: subprocess.CompletedProcess[bytes], code: int, *words: str) -> None:
    """Assert that a command failed with one line, and that the line has these words."""
    message = done.stderr.decode()
    assert done.returncode == code, message
    assert len(message.splitlines()) == 1, message
    assert message.startswith("canser"), message
    for word in words:
        assert word in message


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())
