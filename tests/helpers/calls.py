"""The command as a process: called, timed out, and judged by its exit code and its one line."""

import os
import subprocess
import sys
from pathlib import Path

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
    return subprocess.run(
        command(*arguments),
        cwd=folder,
        input=stdin,
        capture_output=True,
        env=environment(**more),
        timeout=PATIENCE,
        check=False,
    )


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
