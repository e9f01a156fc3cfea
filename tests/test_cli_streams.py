"""Standard output and standard error as they may be: full, closed, without a reader.

The exit code is that of the work, whatever becomes of the messages.
"""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

import canser
from canser.simulation.traffic import vehicle

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="/dev/full, named pipes, a shell")

GOOD, BAD_DATA, BAD_CALL = 0, 1, 2

# A command that hangs is a failure, on the slowest machine too.
PATIENCE_S = 60

full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a capture whose frames are more than a pipe holds."""
    made = tmp_path_factory.mktemp("streams")
    (made / "run.bin").write_bytes(canser.encode(vehicle(20), "serial"))
    return made


def run(
    folder: Path, command: str, redirections: str = "", *, unbuffered: str = ""
) -> subprocess.CompletedProcess[bytes]:
    """Run a command of canser with what the shell knows for its streams, such as `2>&-`."""
    call = [sys.executable, "-m", "canser", *command.split()]
    return subprocess.run(
        ["sh", "-c", f'exec "$@" {redirections}', "sh", *call],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        env=os.environ | {"PYTHONUNBUFFERED": unbuffered},
        timeout=PATIENCE_S,
        check=False,
    )


@full
@pytest.mark.parametrize("command", ["dump", "info"])
def test_a_full_standard_output_is_named(folder: Path, command: str) -> None:
    done = run(folder, f"{command} run.bin -p serial", "> /dev/full")
    assert done.returncode == BAD_DATA
    assert done.stderr == b"canser: standard output: No space left on device\n"


def test_a_pipe_that_breaks_is_an_error_where_it_is_a_file(folder: Path, tmp_path: Path) -> None:
    """Only on the standard output a reader that ends is no error."""
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)

    def read_little() -> None:
        with fifo.open("rb", buffering=0) as file:
            file.read(10)

    reader = threading.Thread(target=read_little)
    reader.start()
    done = run(folder, f"convert run.bin {fifo} -p serial --to log")
    reader.join()
    assert (done.returncode, done.stdout) == (BAD_DATA, b"")
    assert done.stderr.decode() == f"canser: {fifo}: Broken pipe\n"


@full
def test_a_full_device_is_named(folder: Path) -> None:
    done = run(folder, "convert run.bin /dev/full -p serial --to log")
    assert done.returncode == BAD_DATA
    assert done.stderr == b"canser: /dev/full: No space left on device\n"
