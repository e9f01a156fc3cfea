"""The examples run."""

import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import canser
from canser.simulation.traffic import vehicle

EXAMPLES = Path(__file__).parents[1] / "examples"
CORE = EXAMPLES.parent / "csrc"

posix = pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are POSIX")


def run(name: str, *arguments: str | Path) -> str:
    command = [sys.executable, EXAMPLES / name, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_decode_file(tmp_path: Path) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(canser.encode(canser.frames("123#01", "124#02"), "seeed"))
    assert run("decode_file.py", path, "seeed").startswith("2 frames\n")


@posix
def test_live_loop() -> None:
    with canser.Simulator("seeed", vehicle(1), loop=True) as adapter:
        output = run("live_loop.py", adapter.url, "seeed", "1.5")
    assert "frames" in output
    assert output.splitlines()[-1] == "0 bytes were in no packet"


@posix
def test_live_asyncio() -> None:
    with canser.Simulator("seeed", vehicle(1), loop=True) as adapter:
        output = run("live_asyncio.py", adapter.url, "seeed", "1000")
    assert output.splitlines()[-1].endswith("frames")
    assert "tick" in output


@posix
def test_record_trigger(tmp_path: Path) -> None:
    with canser.Simulator("seeed", vehicle(1), loop=True) as adapter:
        run("record_trigger.py", adapter.url, "seeed", "0A0", tmp_path / "event.pcapng", "1.5")
    files = list(tmp_path.iterdir())
    assert files
    assert (canser.read(files)["id"] == 0x0A0).any()


@posix
def test_send() -> None:
    with canser.Simulator("seeed", vehicle(1), loop=True, echo=True) as adapter:
        run("send.py", adapter.url, "seeed", "123#DEADBEEF", "3")
        assert adapter.report().frames > 0


@posix
def test_live_signals(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("cantools")
    monkeypatch.setenv("MPLBACKEND", "Agg")  # without a window
    with canser.Simulator("seeed", vehicle(1), loop=True) as adapter:
        path = EXAMPLES / "car.dbc"
        output = run("live_signals.py", adapter.url, "seeed", path, "0.5", "RPM", "VehicleSpeed")
    assert " frames belong to a message" in output


def test_plot_byte(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    canser.write(vehicle(2), tmp_path / "run.log")
    out = tmp_path / "byte.png"
    run("plot_byte.py", tmp_path / "run.log", "0A0", "1", out)
    assert out.read_bytes().startswith(b"\x89PNG")


@pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler")
def test_a_c_program(tmp_path: Path) -> None:
    program, path = tmp_path / "decode", tmp_path / "run.bin"
    sources = [EXAMPLES / "decode.c", *CORE.rglob("*.c")]
    flags = shlex.split("-O0 -std=c11 -Wall -Wextra -Wpedantic -Werror")
    subprocess.run(["cc", *flags, f"-I{CORE}", *sources, "-o", program], check=True)
    path.write_bytes(b"noise" + canser.encode(canser.frames("123#0102", "18FEF100#R"), "seeed"))
    done = subprocess.run([program, "seeed", path], capture_output=True, text=True, check=True)
    assert done.stdout == "123#0102\n18FEF100#R\n"
    assert done.stderr == "2 frames, 5 bytes skipped\n"
