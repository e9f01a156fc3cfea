"""The command as a process: called, timed out, and judged by its exit code and its one line."""

import contextlib
import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

from forked import CAN_FORK, Forked

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
    variables = environment(**more)
    if not CAN_FORK:
        return subprocess.run(
            command(*arguments),
            cwd=folder,
            input=stdin,
            capture_output=True,
            env=variables,
            timeout=PATIENCE,
            check=False,
        )
    return _run_forked(folder, arguments, stdin, variables)


def _run_forked(
    folder: Path, arguments: tuple[str, ...], stdin: bytes, variables: dict[str, str]
) -> subprocess.CompletedProcess[bytes]:
    # Files, so that no pipe fills up; but its input is a pipe, as of another command.
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        with Forked(
            folder, arguments, (subprocess.PIPE, out.fileno(), err.fileno()), variables
        ) as process:
            assert process.stdin is not None
            feeder = threading.Thread(target=_feed, args=(process.stdin, stdin), daemon=True)
            feeder.start()
            code = process.wait(PATIENCE)
            feeder.join(PATIENCE)
        out.seek(0)
        err.seek(0)
        return subprocess.CompletedProcess(command(*arguments), code, out.read(), err.read())


def _feed(file: Any, data: bytes) -> None:
    with contextlib.suppress(BrokenPipeError):
        file.write(data)
        file.close()


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
