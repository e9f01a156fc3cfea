"""python-can's own programs, unchanged, with the bus and the captures of this package."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

can = pytest.importorskip("can")
pytest.importorskip("termios", reason="pseudo terminals are POSIX's")

from can import logconvert  # noqa: E402

import canser  # noqa: E402
from canser._frames import FrameArray  # noqa: E402
from canser.simulation.traffic import vehicle  # noqa: E402
from device import PATIENCE, Device  # noqa: E402
from logs import assert_equal, raw, recording, traffic  # noqa: E402
from plugins import needs_installation  # noqa: E402

pytestmark = needs_installation


def tool(name: str, *arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", f"can.{name}", *map(str, arguments)]


def on(line: Device, protocol: str = "seeed") -> list[str]:
    return ["-i", "canser", "-c", line.url, "--bus-kwargs", f"protocol={protocol}"]


def payload(frame: np.void) -> bytes:
    return b"" if frame["rtr"] else bytes(frame["data"][: frame["dlc"]].tobytes())


def until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@contextmanager
def started(command: list[str], **how: Any) -> Iterator["subprocess.Popen[str]"]:
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "TERM": "xterm"}
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, **how}
    with subprocess.Popen(command, text=True, env=environment, **pipes) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".csv", ".log"])
@pytest.mark.parametrize("source", ["run.bin", "run.pcapng"])
def test_logconvert(
    tmp_path: Path, source: str, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = recording if source.endswith("pcapng") else raw
    path, target = made(tmp_path / source, "seeed"), tmp_path / f"run{suffix}"
    monkeypatch.setattr(sys, "argv", ["logconvert", str(path), str(target)])
    logconvert.main()
    frames = canser.read(path, "seeed")
    with can.LogReader(target) as reader:
        messages = list(reader)
    assert len(messages) == len(frames) > 0
    for message, frame in zip(messages, frames, strict=True):
        assert message.arbitration_id == frame["id"]
        assert message.is_extended_id == frame["ext"]
        assert message.is_remote_frame == frame["rtr"]
        assert bytes(message.data) == payload(frame)
    # Formats cut times; some begin at the first one.
    got = np.array([message.timestamp for message in messages])
    if source == "run.pcapng":
        assert np.abs(np.diff(got) - np.diff(frames["ts"] / 1e9)).max() < 0.002


def test_logger_prints_what_comes() -> None:
    frames = traffic("seeed")[:200]
    with Device() as line, started(tool("logger", *on(line), "-v")) as process:
        line.write(canser.encode(frames, "seeed"))
        assert process.stdout is not None
        printed: list[str] = []
        while len(printed) < len(frames):
            text = process.stdout.readline()
            assert text, "the logger has ended"
            if text.startswith("Timestamp: "):
                printed.append(text)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
    for text, frame in zip(printed, frames, strict=True):
        found = re.search(r" ID: +([0-9a-f]+) ", text)
        assert found
        assert int(found[1], 16) == frame["id"]
        assert payload(frame).hex(" ") in text


def test_logger_writes_what_comes(tmp_path: Path) -> None:
    frames = np.tile(traffic("serial"), 8)
    target = tmp_path / "run.csv"
    with Device() as line:
        command = tool("logger", "-f", target, *on(line, "serial"))
        with started(command) as process:
            line.write(canser.encode(frames, "serial"))
            until(lambda: target.exists() and target.stat().st_size > 20_000)
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE) == 0
    with can.LogReader(target) as reader:
        messages = list(reader)
    assert 300 < len(messages) <= len(frames)
    want = canser.decode(canser.encode(frames[: len(messages)], "serial"), "serial")
    assert_equal(messages, want)


def played(line: Device, command: list[str], frames: FrameArray, protocol: str) -> FrameArray:
    """Return the frames that a player puts onto the line."""
    count, bytes_ = len(canser.encode(frames, protocol)), b""
    deadline = time.monotonic() + PATIENCE
    with started(command) as process:
        # One that has failed is not waited for, and says why.
        while len(bytes_) < count and time.monotonic() < deadline:
            if line.hears(0.1):
                bytes_ += os.read(line.master, count - len(bytes_))
            elif process.poll() is not None:
                break
        output, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, output
    assert len(bytes_) == count, output
    return canser.decode(bytes_, protocol)


@pytest.mark.parametrize("extra", [[], ["--protocol=seeed"]], ids=["", "protocol given"])
def test_player_sends_raw_bytes(tmp_path: Path, extra: list[str]) -> None:
    path = raw(tmp_path / "run.bin", "seeed")
    frames = canser.read(path, "seeed")
    with Device() as line:
        command = tool("player", *on(line), "-g", "0", path, *extra)
        got = played(line, command, frames, "seeed")
    assert got.tobytes() == frames.tobytes()


@pytest.mark.parametrize("protocol", canser.protocols())
def test_player_sends_recordings(tmp_path: Path, protocol: str) -> None:
    """Their times are of day, which a counter of milliseconds cannot show as they are."""
    path = recording(tmp_path / "run.pcapng", protocol)
    frames = canser.read(path)
    with Device() as line:
        command = tool(
            "player", *on(line, protocol), "--ignore-timestamps", "-g", "0", "--error-frames", path
        )
        got = played(line, command, frames, protocol)
    if protocol == "serial":
        late = np.diff(got["ts"]) - np.diff(frames["ts"])
        assert np.abs(late).max() <= 1_000_000
    got["ts"] = frames["ts"]
    assert got.tobytes() == frames.tobytes()


def test_viewer_shows_what_comes() -> None:
    pytest.importorskip("curses")
    import fcntl  # noqa: PLC0415 - POSIX only, as below
    import struct  # noqa: PLC0415
    import termios  # noqa: PLC0415

    with Device() as line, Device() as screen:
        fcntl.ioctl(screen.master, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))
        with open(screen.url, "r+b", buffering=0) as end:  # noqa: PTH123
            streams = {"stdin": end.fileno(), "stdout": end.fileno(), "stderr": end.fileno()}
            with started(tool("viewer", *on(line)), **streams) as process:
                line.write(canser.encode(vehicle(1)[:1], "seeed"))
                line.write(bytes.fromhex("AA C2 C5 06 1F 2E 55"))
                shown = b""
                while not (b"0x6C5" in shown and b"1F 2E" in shown):
                    assert screen.hears(PATIENCE), shown
                    shown += os.read(screen.master, 4096)
                screen.write(b"q")
                until(lambda: drained(screen) and process.poll() is not None)
                assert process.returncode == 0


def drained(screen: Device) -> bool:
    """Take what a program writes at its end: it would wait for that."""
    while screen.hears(0):
        os.read(screen.master, 4096)
    return True
