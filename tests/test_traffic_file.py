"""What `play` and `simulate` take for frames to send: nothing else may reach a bus."""

import bz2
import contextlib
import os
import select
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import canser
from canser._frames import FrameArray
from canser.files.candump import Writer
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter
from canser.simulation.traffic import vehicle
from reference import WIRE_FORMATS

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are POSIX")

if sys.platform != "win32":
    from beside import fails, running
    from device import Device, until

GOOD, BAD_DATA, BAD_CALL = 0, 1, 2

FRAMES = vehicle(0.5)
SEEED = canser.encode(FRAMES, "seeed")

# What was sent to a vehicle as thousands of false frames.
BUSMASTER = "***BUSMASTER Ver 2.4.0***\n***PROTOCOL CAN***\n" + "".join(
    f"15:33:5{number % 10}:{number:04} Rx 1 0x{0x100 + number % 50:X} s 8 11 22 33 44 55 66 77 88\n"
    for number in range(2000)
)


@pytest.fixture
def device(tmp_path: Path) -> Iterator["Device"]:
    with Device(tmp_path / "dev") as made:
        yield made


def candump(frames: FrameArray) -> bytes:
    class File:
        text = b""

        def write(self, text: bytes) -> None:
            self.text += text

    file = File()
    Writer(file).write(frames)  # type: ignore[arg-type]
    return file.text


NOISE = np.random.default_rng(1).bytes(20_000)

# The bytes of a file with an unknown suffix, the port's protocol, the exit code and the message.
REFUSED = {
    "BUSMASTER": (BUSMASTER.encode(), "serial", BAD_DATA, "is a BUSMASTER log, not raw bytes"),
    "BUSMASTER in cantalope": (BUSMASTER.encode(), "cantalope", BAD_DATA, "is a BUSMASTER log"),
    "bzip2": (bz2.compress(SEEED), "seeed", BAD_DATA, "packed by bzip2"),
    "SQLite": (b"SQLite format 3\0" + NOISE, "cantalope", BAD_DATA, "SQLite"),
    "another protocol": (SEEED, "serial", BAD_DATA, "look like seeed (100%), not like serial"),
    "another protocol in cantalope": (SEEED, "cantalope", BAD_DATA, "look like seeed (100%)"),
    "noise": (NOISE, "cantalope", BAD_DATA, "look like no protocol"),
    "a short text": (b"hello world\n", "cantalope", BAD_DATA, "look like no protocol"),
    "mostly noise": (SEEED + 4 * NOISE, "seeed", BAD_DATA, "look like no protocol"),
}


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.parametrize("command", ["play", "simulate"])
def test_what_is_no_traffic_is_refused_before_a_port_is_opened(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], command: str, name: str
) -> None:
    data, protocol, code, words = REFUSED[name]
    path = tmp_path / "run.dat"
    path.write_bytes(data)
    # There is no such port: the file comes first.
    more = ["-c", str(tmp_path / "none")] if command == "play" else ["--traffic"]
    failed, line = fails(capfd, command, "-p", protocol, *more, str(path))
    assert words in line
    assert failed == code


def test_a_recording_of_noise_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.pcapng"
    with RecordingWriter(path, RecordingInfo("cantalope", 115_200, None, "ms", "x")) as writer:
        writer.write(NOISE, 10**18)
    code, line = fails(capfd, "play", str(path), "-c", str(tmp_path / "none"), "-p", "seeed")
    assert code == BAD_DATA
    assert "of the 20,000 bytes are in no cantalope packet" in line


def test_raw_bytes_go_out_as_they_are_if_that_is_wanted(tmp_path: Path, device: "Device") -> None:
    serial = canser.encode(FRAMES, "serial")
    (tmp_path / "run.dat").write_bytes(serial + SEEED[:13])
    with running(tmp_path, "play", "run.dat", "-c", "dev", "-p", "seeed", "--as-is") as run:
        assert run.end() == GOOD
    wanted = canser.encode(canser.decode(serial + SEEED[:13], "seeed", as_is=True), "seeed")
    assert wanted
    assert device.read(len(wanted)) == wanted


def test_a_recording_on_the_standard_input_has_its_own_protocol(
    tmp_path: Path, device: "Device"
) -> None:
    path = tmp_path / "run.pcapng"
    raw = canser.encode(FRAMES, "serial")
    with RecordingWriter(path, RecordingInfo("serial", 115_200, None, "ms", "x")) as writer:
        writer.write(raw, 10**18)
    call = ("play", "-", "-c", "dev", "-p", "seeed")
    with path.open("rb") as file, running(tmp_path, *call, stdin=file) as run:
        assert run.end() == GOOD
    assert device.read(len(SEEED)) == SEEED


@pytest.mark.parametrize("protocol", canser.protocols())
def test_a_pipe_is_judged_block_by_block(tmp_path: Path, device: "Device", protocol: str) -> None:
    """Of what comes behind the noise nothing is sent."""
    good = canser.encode(vehicle(5, extended=WIRE_FORMATS[protocol].has_ext), protocol)
    assert len(good) > 1 << 16
    reader, writer = os.pipe()

    def feed() -> None:
        with contextlib.suppress(BrokenPipeError), open(writer, "wb", buffering=0) as pipe:  # noqa: PTH123
            for part in (good, 10 * NOISE, good):
                pipe.write(part)

    def drain() -> None:
        while not ended.is_set():
            if device.hears(0.05):
                device.read_some()

    ended = threading.Event()
    threads = [threading.Thread(target=feed), threading.Thread(target=drain)]
    for thread in threads:
        thread.start()
    call = ("play", "-", "-c", "dev", "-p", protocol, "--gap", "0")
    with open(reader, "rb") as pipe, running(tmp_path, *call, stdin=pipe) as run:  # noqa: PTH123
        assert run.end() == BAD_DATA
    ended.set()
    for thread in threads:
        thread.join()
    words = f"are in no {protocol} packet; frames from there on are not sent"
    assert words in run.err[-1]


@pytest.mark.parametrize("protocol", canser.protocols())
def test_a_pipe_of_another_format_sends_nothing(
    tmp_path: Path, device: "Device", protocol: str
) -> None:
    (tmp_path / "run.txt").write_text(BUSMASTER)
    call = ("play", "-", "-c", "dev", "-p", protocol)
    with (tmp_path / "run.txt").open("rb") as file, running(tmp_path, *call, stdin=file) as run:
        assert run.end() == BAD_DATA
    assert "BUSMASTER" in run.err[-1]
    assert not device.hears()


def test_a_signal_ends_the_wait_for_a_pipe(tmp_path: Path, device: "Device") -> None:
    reader, writer = os.pipe()
    call = ("play", "-", "-c", "dev", "-p", "seeed")
    with open(reader, "rb") as pipe, running(tmp_path, *call, stdin=pipe) as run:  # noqa: PTH123
        os.write(writer, SEEED[:100])
        # The command has started when it has taken the bytes.
        until(lambda: not select.select([reader], [], [], 0)[0])
        assert run.end(signal.SIGINT) == 130
    os.close(writer)
    assert run.err == ["canser: interrupted"]
    assert not device.hears()
