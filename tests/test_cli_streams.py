"""Standard output and standard error as they may be: full, closed, without a reader.

The exit code is that of the work, whatever becomes of the messages.
"""

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import canser
from canser.simulation.traffic import vehicle
from long import longer, skipped

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="/dev/full, named pipes, a shell")

if sys.platform != "win32":
    from device import until

GOOD, BAD_DATA, BAD_CALL = 0, 1, 2

# A command that hangs is a failure, on the slowest machine too.
PATIENCE_S = 60

full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a capture whose frames are more than a pipe holds."""
    made = tmp_path_factory.mktemp("streams")
    (made / "run.bin").write_bytes(canser.encode(vehicle(20), "serial"))
    (made / "text").write_text("This is a letter and no capture.\n" * 100)
    return made


def run(folder: Path, command: str, redirections: str = "") -> subprocess.CompletedProcess[bytes]:
    """Run a command with what the shell writes for its streams; 9 is a pipe without a reader."""
    call = [sys.executable, "-m", "canser", *command.split()]
    reader, writer = os.pipe()
    os.close(reader)
    try:
        return subprocess.run(
            ["bash", "-c", f'exec 9>&{writer}; exec "$@" {redirections}', "bash", *call],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            pass_fds=[writer],
            # Buffered, as users have it: what is not written yet is written at the end.
            env={name: os.environ[name] for name in os.environ.keys() - {"PYTHONUNBUFFERED"}},
            timeout=PATIENCE_S,
            check=False,
        )
    finally:
        os.close(writer)


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

    reader = threading.Thread(target=read_little, daemon=True)
    reader.start()
    done = run(folder, f"convert run.bin {fifo} -p serial --to candump")
    reader.join(PATIENCE_S)
    assert (done.returncode, done.stdout) == (BAD_DATA, b"")
    assert done.stderr.decode() == f"canser: {fifo}: Broken pipe\n"


@full
def test_a_full_device_is_named(folder: Path) -> None:
    done = run(folder, "convert run.bin /dev/full -p serial --to candump")
    assert done.returncode == BAD_DATA
    assert done.stderr == b"canser: /dev/full: No space left on device\n"


# A command, and its exit code.
COMMANDS = {
    "convert run.bin x.npy -p serial --force": GOOD,
    "info run.bin": GOOD,
    "--version": GOOD,
    "info text": BAD_DATA,
    "info missing": BAD_CALL,
    "info": BAD_CALL,
    "monitor -c loop:// -p serial": BAD_CALL,
}


@pytest.mark.parametrize(
    "stream",
    [
        pytest.param("2> /dev/full", marks=full, id="full"),
        "2>&-",
        pytest.param("2>&9", marks=[longer, skipped]),
    ],
)
@pytest.mark.parametrize("command", COMMANDS)
def test_messages_that_cannot_be_written_change_no_exit_code(
    folder: Path, command: str, stream: str
) -> None:
    done = run(folder, command, stream)
    assert done.returncode == COMMANDS[command]


@pytest.mark.parametrize("command", ["--version", "--help", "log --help"])
@full
def test_a_help_that_cannot_be_printed_is_an_error(folder: Path, command: str) -> None:
    done = run(folder, command, "> /dev/full")
    assert done.returncode == BAD_DATA
    assert done.stderr == b"canser: standard output: No space left on device\n"


@pytest.mark.parametrize("command", ["--version", "info run.bin", "dump run.bin -p serial"])
def test_a_standard_output_without_a_reader_is_no_error(folder: Path, command: str) -> None:
    done = run(folder, command, ">&9")
    assert (done.returncode, done.stdout, done.stderr) == (GOOD, b"", b"")


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-"])
def test_a_monitor_without_a_terminal_says_so(folder: Path, closed: str) -> None:
    pytest.importorskip("textual")
    done = run(folder, "monitor -c loop:// -p serial", closed)
    assert done.returncode == BAD_CALL
    assert done.stdout == b""
    assert closed == "2>&-" or done.stderr.startswith(b"canser: the monitor needs a terminal")


@pytest.mark.parametrize("report", ["report.json", "-"])
def test_a_simulation_goes_on_without_a_reader_of_its_name(tmp_path: Path, report: str) -> None:
    raw = canser.encode(vehicle(0.1), "serial")
    (tmp_path / "run.bin").write_bytes(raw)
    link = tmp_path / "dev"
    command = f"simulate -p serial --traffic run.bin --link dev --copy sent.bin --report {report}"
    with ThreadPoolExecutor() as pool:
        simulation = pool.submit(run, tmp_path, command, ">&9")
        until(link.exists)
        host = os.open(link, os.O_RDWR | os.O_NOCTTY)
        got = b""
        while len(got) < len(raw):
            got += os.read(host, 4096)
        os.close(host)
        assert simulation.result(PATIENCE_S).returncode == GOOD
    assert (tmp_path / "sent.bin").read_bytes() == got == raw
    assert (tmp_path / "report.json").exists() == (report != "-")
