"""`canser simulate` as its users run it: another process opens what it names."""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import canser
from calls import BAD_CALL, BAD_DATA, GOOD, PATIENCE, command, run
from canser._frames import FrameArray
from canser.commands.cli import main
from canser.commands.simulate import _traffic
from canser.simulation.simulator import Simulator
from canser.simulation.traffic import damage, vehicle
from reference import WIRE_FORMATS

if sys.platform != "win32":
    from beside import Running, running

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are POSIX")


class Command:
    """The running command, and what it has printed in the end."""

    def __init__(self, process: "Running") -> None:
        self._process = process
        process.wait_for(lambda: process.out, "the terminal")
        self.url = process.out[0]

    def end(self, number: signal.Signals | None = None) -> tuple[int, list[str], str]:
        """Return the exit code, the lines on standard error, and the rest of the output."""
        code = self._process.end(number)
        return code, self._process.err, "\n".join(self._process.out[1:])


@contextlib.contextmanager
def simulate(folder: Path, *more: str) -> Iterator[Command]:
    with running(folder, "simulate", *more) as process:
        yield Command(process)


def fails(folder: Path, *more: str) -> tuple[int, str]:
    """Run the command; return its exit code and its one line."""
    done = run(folder, "simulate", *more)
    message = done.stderr.decode()
    assert len(message.splitlines()) == 1, message
    assert message.startswith("canser")
    return done.returncode, message


def read(url: str, count: int) -> bytes:
    """Return so many bytes of a terminal, fewer at a hangup."""
    fd = os.open(url, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        waiting = select.poll()
        waiting.register(fd, select.POLLIN)
        data = b""
        while len(data) < count:
            assert waiting.poll(PATIENCE * 1000), f"{len(data)} bytes of {count} came"
            part = os.read(fd, count - len(data))
            if not part:
                break
            data += part
        return data
    finally:
        os.close(fd)


@pytest.mark.parametrize("protocol", canser.protocols())
def test_a_file_goes_out_whole_and_is_reported(tmp_path: Path, protocol: str) -> None:
    frames = vehicle(2, extended=WIRE_FORMATS[protocol].has_ext)
    clean = canser.encode(frames, protocol)
    (tmp_path / "run.bin").write_bytes(clean)
    options = ("--traffic", "run.bin", "--pace", "max", "--copy", "sent.bin")
    with simulate(tmp_path, "-p", protocol, *options, "--report", "sent.json") as command:
        data = read(command.url, len(clean))
        code, said, rest = command.end()
    assert (code, rest) == (GOOD, "")
    assert data == clean == (tmp_path / "sent.bin").read_bytes()
    assert said == [f"{len(frames):,} frames, {len(clean):,} bytes sent"]
    report = json.loads((tmp_path / "sent.json").read_text())
    assert report["frames"] == report["frames_intact"] == len(frames)
    assert report["bytes_sent"] == len(clean)
    assert report["bytes_unread"] == 0
    assert report["configuration"] is None


def test_a_log_by_its_own_times(tmp_path: Path) -> None:
    log = "(1.000000) can0 123#11\n(1.300000) can0 123#22\n(1.500000) can0 124#R\n"
    (tmp_path / "run.log").write_text(log)
    begin = time.monotonic()
    with simulate(tmp_path, "-p", "serial", "--traffic", "run.log", "--pace", "traffic") as command:
        frames = canser.decode(read(command.url, 14 + 14 + 13), "serial")
        assert command.end()[0] == GOOD
    assert time.monotonic() - begin >= 0.5
    assert frames["id"].tolist() == [0x123, 0x123, 0x124]
    assert frames["ts"].tolist() == [1_000_000_000, 1_300_000_000, 1_500_000_000]


def test_a_log_is_sent_by_its_own_times_unless_told_otherwise(tmp_path: Path) -> None:
    (tmp_path / "run.log").write_text("(1.0) can0 123#11\n(1.8) can0 123#22\n")
    begin = time.monotonic()
    options = ("-p", "seeed", "--traffic", "run.log", "--report", "-")
    with simulate(tmp_path, *options) as command:
        read(command.url, 14)
        code, said, out = command.end()
    assert (code, said) == (GOOD, ["2 frames, 12 bytes sent"])
    assert time.monotonic() - begin >= 0.8
    assert json.loads(out)["pace"] == "traffic"


def test_frames_without_times_go_as_the_line_carries_and_that_is_said(tmp_path: Path) -> None:
    clean = canser.encode(vehicle(1), "seeed")  # has no times
    (tmp_path / "run.bin").write_bytes(clean)
    with simulate(tmp_path, "-p", "seeed", "--traffic", "run.bin") as command:
        assert read(command.url, len(clean)) == clean
        code, said, _ = command.end()
    assert code == GOOD
    assert said[0] == "run.bin: the frames have no times; sent as fast as the line carries"
    assert len(said) == 2


def test_frames_that_lack_a_time_are_told(tmp_path: Path) -> None:
    text = "timestamp,arbitration_id,extended,remote,error,dlc,data\n"
    rows = "1.0,0x123,0,0,0,1,EQ==\n,0x123,0,0,0,1,EQ==\n"
    (tmp_path / "run.csv").write_text(text + rows)
    with simulate(tmp_path, "-p", "seeed", "--traffic", "run.csv") as command:
        read(command.url, 12)
        code, said, _ = command.end()
    assert code == GOOD
    assert said[1:] == ["frames without a time, each sent with the one before: 1"]


def test_what_the_frames_of_a_log_do_not_hold_is_told(tmp_path: Path) -> None:
    log = "(1.000000) can0 123#11\n(1.000000) can1 123#22 T\n"
    (tmp_path / "run.log").write_text(log)
    with simulate(tmp_path, "-p", "serial", "--traffic", "run.log", "--pace", "max") as command:
        read(command.url, 14 + 14)
        code, said, _ = command.end()
    assert code == GOOD
    assert said[:2] == [
        "run.log: frames of 2 channels become one: can0 1, can1 1",
        "run.log: direction is not kept: received 1, sent 1",
    ]


def test_faults_by_the_seed(tmp_path: Path) -> None:
    hit = damage(canser.encode(vehicle(1), "seeed"), noise=0.01, loss=0.02, seed=(7, 1))
    faults = ("--noise", "0.01", "--loss", "0.02", "--stall", "100:0.2", "--seed", "7")
    with simulate(tmp_path, "-p", "seeed", "--seconds", "1", *faults) as command:
        data = read(command.url, len(hit.data))
        code, said, _ = command.end()
    assert code == GOOD
    assert data == hit.data
    assert said[1].startswith(
        f"faults: bytes lost {len(hit.lost):,}, added {len(hit.inserted):,}, "
        f"flipped {len(hit.flipped):,}; frames without any: "
    )
    assert said[2] == "stalls: 1"


def test_seconds_beyond_a_round_go_on(tmp_path: Path) -> None:
    with simulate(tmp_path, "-p", "serial", "--seconds", "61", "--pace", "max") as command:
        count = len(canser.encode(vehicle(60), "serial")) + len(canser.encode(vehicle(1), "serial"))
        frames = canser.decode(read(command.url, count), "serial")
        assert command.end()[0] == GOOD
    assert len(frames) == len(vehicle(60)) + len(vehicle(1))
    assert frames["ts"].max() >= 60_900_000_000


def test_a_pipe_that_gives_no_more_does_not_keep_it(tmp_path: Path) -> None:
    frames = vehicle(3)  # more than the 64 KiB by which a pipe is judged
    clean = canser.encode(frames, "serial")
    with subprocess.Popen(
        [*command("simulate", "-p", "serial", "--traffic", "-"), "--pace=max", "--link=device"],
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(clean)
        process.stdin.flush()
        assert process.stdout.readline() == b"device\n"
        # The pipe stays open: more might come.
        assert len(read(str(tmp_path / "device"), 10_000)) == 10_000
        process.send_signal(signal.SIGTERM)
        process.wait(PATIENCE)
        assert process.stderr is not None
        said = process.stderr.read().decode().splitlines()
    assert process.returncode == GOOD, said
    assert said[0].endswith("bytes sent")
    assert all(line.startswith("not read by the host") for line in said[1:])


LOG = "(0.0) can0 123#01\n(0.1) can0 20000080#00\n(0.2) can0 124#02\n"


@pytest.mark.parametrize("pipe", [False, True])
def test_what_the_protocol_cannot_carry_is_left_out_and_counted(tmp_path: Path, pipe: bool) -> None:
    path = tmp_path / "run.log"
    if pipe:
        os.mkfifo(path)
        threading.Thread(target=path.write_text, args=(LOG,), daemon=True).start()
    else:
        path.write_text(LOG)
    wanted = canser.encode(canser.frames(["123#01", "124#02"]), "seeed")
    with simulate(tmp_path, "-p", "seeed", "--traffic", "run.log") as command:
        assert read(command.url, len(wanted)) == wanted
        code, err, _ = command.end()
    assert code == GOOD
    told = "run.log: 1 frame left out: error frames 1; seeed cannot carry them"
    assert err.count(told) == 1
    assert err.index(told) == 0


def test_traffic_of_which_nothing_can_be_carried(tmp_path: Path) -> None:
    (tmp_path / "run.log").write_text("(0.0) can0 20000080#00\n" * 3)
    code, line = fails(tmp_path, "-p", "seeed", "--traffic", "run.log")
    assert code == BAD_DATA
    assert "run.log: seeed can carry none of its frames: error frames" in line


def test_traffic_is_made_before_any_of_it_is_due(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[float] = []

    def counted(seconds: float, *, extended: bool) -> FrameArray:
        made.append(seconds)
        return vehicle(seconds, extended=extended)

    monkeypatch.setattr("canser.commands.simulate.vehicle", counted)
    args = Namespace(traffic=None, loop=False, seconds=125.0, protocol="seeed")
    traffic, _ = _traffic(args)
    parts = iter(traffic)
    frames = [next(parts)]
    assert sorted(made) == [5, 60]
    frames += parts
    assert sorted(made) == [5, 60]
    assert len(np.concatenate(frames)) == 2 * len(vehicle(60)) + len(vehicle(5))
    assert (np.diff(np.concatenate(frames)["ts"]) > -2_000_000).all()  # a frame may be late by 2 ms


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_in_order(tmp_path: Path, number: signal.Signals) -> None:
    options = ("--link", "device", "--copy", "sent.bin", "--report", "-")
    with simulate(tmp_path, "-p", "seeed", *options) as command:
        assert command.url == "device"
        data = read(str(tmp_path / "device"), 10_000)
        code, said, out = command.end(number)
    assert code == GOOD
    report = json.loads(out)
    sent = (tmp_path / "sent.bin").read_bytes()
    assert len(sent) == report["bytes_sent"] == len(data) + report["bytes_unread"]
    assert sent.startswith(data)
    assert said[0].endswith(f" frames, {len(sent):,} bytes sent")
    assert not os.path.lexists(tmp_path / "device")


def test_a_signal_before_any_host(tmp_path: Path) -> None:
    with simulate(tmp_path, "-p", "seeed") as command:
        assert command.end(signal.SIGINT) == (GOOD, ["0 frames, 0 bytes sent"], "")


def test_a_host_that_leaves_does_not_keep_it(tmp_path: Path) -> None:
    with simulate(tmp_path, "-p", "seeed", "--seconds", "0.2", "--pace", "max") as command:
        assert len(read(command.url, 10)) == 10
        code, said, _ = command.end()
    assert code == GOOD
    sent = len(canser.encode(vehicle(0.2), "seeed"))
    assert said[0] == f"{len(vehicle(0.2)):,} frames, {sent:,} bytes sent"
    assert said[1] == f"not read by the host: {sent - 10:,} of the bytes sent"


@pytest.mark.parametrize(
    "options", [["--seconds", "1"], ["--traffic", "run.log"]], ids=["seconds", "file"]
)
def test_without_a_host_it_ends(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    options: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("canser.commands.simulate._HOST_PATIENCE_S", 0.3)
    Path("run.log").write_text("(1.0) can0 123#11\n(2.0) can0 123#11\n")
    assert main(["simulate", "-p", "seeed", *options, "--report", "sent.json"]) == BAD_DATA
    out, err = capfd.readouterr()
    said = err.splitlines()
    assert said[0] == "0 frames, 0 bytes sent"
    assert said[1].startswith(f"canser: no host had {out.strip()} open for 0.3 s")
    assert len(said) == 2
    assert json.loads(Path("sent.json").read_text())["bytes_sent"] == 0


def test_a_host_that_leaves_in_the_middle_ends_it(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("canser.commands.simulate._HOST_PATIENCE_S", 0.5)

    def host() -> None:
        while not os.path.lexists("device"):
            time.sleep(0.005)
        read("device", 100)

    leaving = threading.Thread(target=host)
    leaving.start()
    assert main(["simulate", "-p", "seeed", "--seconds", "3600", "--link", "device"]) == BAD_DATA
    leaving.join()
    said = capfd.readouterr().err.splitlines()
    assert not said[0].startswith("0 frames")
    assert said[-1].startswith("canser: no host had device open for 0.5 s, and not all was sent")


@pytest.mark.parametrize(
    "options", [[], ["--traffic", "run.log", "--loop"]], ids=["made", "file in a loop"]
)
def test_traffic_without_an_end_waits_for_a_host(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("canser.commands.simulate._HOST_PATIENCE_S", 0.1)
    Path("run.log").write_text("(1.0) can0 123#11\n(2.0) can0 123#11\n")
    looks: list[float | None] = []
    wait = Simulator.wait

    def counted(device: Simulator, timeout: float | None = None) -> bool:
        looks.append(timeout)
        if len(looks) == 8:  # looks, each 0.1 s: well over the patience
            signal.raise_signal(signal.SIGTERM)
        return wait(device, timeout)

    monkeypatch.setattr(Simulator, "wait", counted)
    assert main(["simulate", "-p", "seeed", *options]) == GOOD
    assert len(looks) >= 8


def test_what_the_host_sends_is_told(tmp_path: Path) -> None:
    frame, ping = canser.encode(vehicle(1, extended=False)[:1], "cantalope"), b"\xff\xff\0"
    (tmp_path / "few.bin").write_bytes(frame)
    # One frame is too little to tell its protocol by.
    options = ("--traffic", "few.bin", "--as-is", "--loop", "--echo", "--baudrate", "100000")
    with simulate(tmp_path, "-p", "cantalope", *options) as command:
        fd = os.open(command.url, os.O_RDWR | os.O_NOCTTY)
        try:
            os.write(fd, ping + frame)
            data = b""
            while ping not in data:
                data += os.read(fd, 4096)
            code, said, _ = command.end(signal.SIGINT)
        finally:
            os.close(fd)
    assert code == GOOD
    assert said[1] == (
        "from the host: frames 1, ping 1, bytes skipped 0; "
        f"sent back: {len(frame) + len(ping):,} bytes"
    )


def test_one_that_needs_time_tells_what_it_ignored(tmp_path: Path) -> None:
    config = canser.adapters.configuration("seeed", canser.AdapterConfig(bitrate=500_000))
    asked = canser.protocol("seeed").status_request
    options = ("--deaf", "300ms", "--swallow", "--report", "-")
    decoder = canser.Decoder("seeed")
    with simulate(tmp_path, "-p", "seeed", *options) as command:
        fd = os.open(command.url, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        waiting = select.poll()
        waiting.register(fd, select.POLLIN)
        try:
            os.write(fd, config)
            sent = len(config)
            while not decoder.stats.controls:
                sent += os.write(fd, asked)
                waiting.poll(20)
                with contextlib.suppress(BlockingIOError):
                    decoder.feed(os.read(fd, 4096))
            sent += os.write(fd, config + asked)  # the request is swallowed
            code, said, out = command.end(signal.SIGINT)
        finally:
            os.close(fd)
    assert code == GOOD
    report = json.loads(out)
    assert report["bytes_ignored"] > len(config)
    assert report["bytes_ignored"] + report["bytes_received"] == sent
    assert report["packets_swallowed"] == 1
    assert report["controls"]["configuration"] == 1
    assert (
        f"from the host, and ignored: {report['bytes_ignored']:,} bytes while deaf, "
        "packets after a configuration 1"
    ) in said


ERRORS = {
    "no protocol": ([], BAD_CALL, "-p/--protocol"),
    "unknown protocol": (["-p", "x"], BAD_CALL, "cantalope, seeed, serial"),
    "noise": (["-p", "seeed", "--noise", "2"], BAD_CALL, "--noise: 2 must be 0 to 1"),
    "not a number": (["-p", "seeed", "--loss", "x"], BAD_CALL, "--loss: 'x' is no number"),
    "nan": (["-p", "seeed", "--seconds", "nan"], BAD_CALL, "'nan' is no number"),
    "negative": (["-p", "seeed", "--seconds", "-1"], BAD_CALL, "-1 must be 0 or more"),
    "baudrate": (["-p", "seeed", "--baudrate", "0"], BAD_CALL, "0 must be 1 or more"),
    "stall": (["-p", "seeed", "--stall", "5"], BAD_CALL, "'5' is no stall"),
    "negative stall": (["-p", "seeed", "--stall", "5:-1"], BAD_CALL, "'5:-1' is no stall"),
    "no time": (["-p", "seeed", "--deaf", "long"], BAD_CALL, "cannot read the time 'long'"),
    "no file": (["-p", "seeed", "--traffic", "no.log"], BAD_CALL, "no.log: No such file"),
    "no frame": (["-p", "seeed", "--traffic", "empty.bin"], BAD_DATA, "no frame in empty.bin"),
    "bad file": (["-p", "seeed", "--traffic", "bad.log"], BAD_DATA, "bad.log"),
    "seconds of a file": (
        ["-p", "seeed", "--traffic", "empty.bin", "--seconds", "1"],
        BAD_CALL,
        "--seconds is for generated traffic",
    ),
    "traffic has no times": (
        ["-p", "seeed", "--traffic", "few.bin", "--pace", "traffic"],
        BAD_DATA,
        "by their times, and these have none",
    ),
    "baudrate of no line": (
        ["-p", "seeed", "--pace", "max", "--baudrate", "9600"],
        BAD_CALL,
        "--baudrate needs --pace line, not max",
    ),
    "loop of nothing": (["-p", "seeed", "--loop"], BAD_CALL, "--loop repeats a file"),
    "loop of a pipe": (
        ["-p", "seeed", "--loop", "--traffic", "-"],
        BAD_CALL,
        "standard input can be read only once",
    ),
    "copy is there": (["-p", "seeed", "--copy", "bad.log"], BAD_CALL, "--force replaces it"),
    "link is a file": (["-p", "seeed", "--link", "bad.log"], BAD_CALL, "bad.log: there already"),
    "link in no folder": (["-p", "seeed", "--link", "no/link"], BAD_CALL, "no/link: No such file"),
}


@pytest.mark.parametrize(("call", "code", "words"), ERRORS.values(), ids=ERRORS)
def test_errors_are_one_line(tmp_path: Path, call: list[str], code: int, words: str) -> None:
    (tmp_path / "empty.bin").write_bytes(b"")
    (tmp_path / "bad.log").write_text("nonsense\n")
    (tmp_path / "few.bin").write_bytes(canser.encode(vehicle(0.1), "seeed"))
    found, message = fails(tmp_path, *call)
    assert words in message
    assert found == code
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.log", "empty.bin", "few.bin"]


def test_what_the_protocol_cannot_carry_ends_it(tmp_path: Path) -> None:
    (tmp_path / "run.log").write_text("(1.0) can0 12345678#11\n")
    options = ("-p", "cantalope", "--traffic", "run.log", "--copy", "sent.bin")
    code, message = fails(tmp_path, *options)
    assert code == BAD_DATA
    assert "extended" in message
    assert [path.name for path in tmp_path.iterdir()] == ["run.log"]
