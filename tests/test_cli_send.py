"""`canser send`, `play` and `ports` as their users run them."""

import contextlib
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np
import pytest
from serial.tools.list_ports_common import ListPortInfo

import canser
import canser.commands._sending
from canser.commands._sending import Sender
from canser.commands.cli import main
from canser.files.candump import Writer
from canser.live.pacing import Pacer
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter
from canser.simulation.faults import Faults
from canser.simulation.simulator import Simulator
from canser.simulation.traffic import vehicle

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are POSIX")

if sys.platform != "win32":
    from beside import fails, running
    from device import Device, until

GOOD, BAD_DATA, BAD_CALL = 0, 1, 2


@pytest.fixture
def device(tmp_path: Path) -> Iterator["Device"]:
    with Device(tmp_path / "dev") as made:
        yield made


def call(name: str, *more: str, protocol: str = "seeed") -> list[str]:
    return [name, "-c", "dev", "-p", protocol, *more]


def test_send_what_the_call_names(tmp_path: Path, device: "Device") -> None:
    texts = ["123#DEADBEEF", "18FEF100#01.02", "7E0#R8", "001#"]
    with running(tmp_path, *call("send", *texts)) as run:
        assert run.end() == GOOD
    wanted = canser.encode(canser.frames(texts), "seeed")
    assert device.read(len(wanted)) == wanted
    assert run.err == ["4 frames sent to dev"]
    assert run.out == []


def test_send_configures_first(tmp_path: Path, device: "Device") -> None:
    asked = canser.protocol("seeed").status_request
    config = canser.adapters.configuration("seeed", canser.AdapterConfig(bitrate=250_000))
    decoder, packets = canser.Decoder("seeed"), []
    frames = canser.frames([])
    with running(tmp_path, *call("send", "--bitrate", "250000", "123#01")) as run:
        while not len(frames):
            frames = decoder.feed(device.read_some())
            for control in decoder.take_controls():
                packets.append(control.data)
                if control.data == asked:
                    device.feed(asked)
        assert run.end() == GOOD
    assert packets[:2] == [config, asked]
    assert set(packets) == {config, asked}
    assert canser.encode(frames, "seeed") == canser.encode(canser.frames(["123#01"]), "seeed")
    assert decoder.stats.bytes_skipped == 0
    assert run.err == ["1 frame sent to dev"]


def test_play_begins_when_the_adapter_listens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Otherwise its first frames would all be late."""
    frames = vehicle(0.2)
    write_log(tmp_path / "run.log", frames)
    link = str(tmp_path / "can")
    listened: list[bool] = []
    wait = Sender.wait_listening

    def watched(sender: Sender) -> None:
        assert not listened
        wait(sender)
        listened.append(sender._port._setup.listening)

    monkeypatch.setattr(Sender, "wait_listening", watched)
    with Simulator("seeed", faults=Faults(deaf=0.5, swallow=True), link=link) as adapter:
        call = ["play", str(tmp_path / "run.log"), "-c", link, "-p", "seeed"]
        assert main([*call, "--bitrate", "500000"]) == GOOD
        until(lambda: adapter.report().frames_received == len(frames))
    assert listened == [True]
    assert capfd.readouterr().err.startswith(f"{len(frames):,} frames sent to {link}\n")


@pytest.mark.parametrize("pace", [True, False])
@pytest.mark.parametrize("name", ["play", "send"])
def test_the_bus_sets_the_pace_unless_told_otherwise(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    name: str,
    pace: bool,
) -> None:
    frames = vehicle(0.1)
    frames["ts"] = canser.NO_TIME
    (tmp_path / "run.bin").write_bytes(canser.encode(frames, "seeed"))
    link = str(tmp_path / "can")
    what = [str(tmp_path / "run.bin"), "--as-is"] if name == "play" else ["123#01"] * len(frames)
    paced: list[int] = []
    take = Pacer.take

    def counted(pacer: Pacer, seconds: list[float], deadline: float | None) -> int:
        paced.append(take(pacer, seconds, deadline))
        return paced[-1]

    monkeypatch.setattr(Pacer, "take", counted)
    with Simulator("seeed", link=link) as adapter:
        options = ["-c", link, "-p", "seeed", "--bitrate", "500000"]
        assert main([name, *options, *([] if pace else ["--no-pace"]), *what]) == GOOD
        until(lambda: adapter.report().frames_received == len(frames))
    assert sum(paced) == (len(frames) if pace else 0)
    said = capfd.readouterr().err
    if name == "play":
        assert f"sent as fast as {'the bus carries' if pace else 'the line took'} them" in said


def test_send_to_an_adapter_that_does_not_answer(tmp_path: Path, device: "Device") -> None:
    raw = canser.encode(canser.frames(["123#01"]), "seeed")
    with running(tmp_path, *call("send", "--bitrate", "250000", "123#01")) as run:
        assert run.end() == GOOD
    sent = device.read(20)
    while not sent.endswith(raw):
        sent += device.read(1)
    (warning, done) = run.err
    assert warning.startswith("dev did not answer its status request within 2 s; ")
    assert done == "1 frame sent to dev"


def test_send_in_a_format_with_times(tmp_path: Path, device: "Device") -> None:
    with running(tmp_path, *call("send", "123#0102", "20000080#00", protocol="serial")) as run:
        assert run.end() == GOOD
    frames = canser.decode(device.read(13 + 12), "serial")
    assert frames["id"].tolist() == [0x123, 0x80]
    assert frames["err"].tolist() == [False, True]


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (call("send", "123"), "'123' is no frame; write 123#DEADBEEF"),
        (call("send", "123#01", "124#0"), "'124#0' is no frame"),
        (call("send", "124##0"), "CAN FD"),
        (call("send", "FFF#01"), "the id 0xfff is over 0x7ff"),
        (call("send", "123#010203040506070809"), "dlc 9"),
        (call("send", "18FEF100#", protocol="cantalope"), "extended"),
        (call("send", "20000080#00"), "error"),
        (call("send"), "FRAME"),
        (call("send", "-c", "/dev/nothing", "123#"), "there is no port"),
        (call("send", "--dtr", "off", "123#"), "has no modem lines"),
        (call("send", "--rts", "on", "123#"), "leave rts out"),
        (call("send", "--dtr", "up", "123#"), "invalid choice: 'up'"),
        (call("play", "nothing.log"), "No such file"),
        (call("play", "there.log", "--speed", "0"), "more than 0"),
        (call("play", "there.log", "--speed", "2", "--gap", "3"), "not allowed with"),
        (call("play", "there.log", "--gap", "-1"), "0 or more"),
        (call("play", "there.log", "--gap", "few"), "no number"),
        (call("play", "-", "--loop"), "--loop needs a file"),
        (call("play", "there.log", "-c", "/dev/nothing"), "there is no port"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_typos(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    arguments: list[str],
    words: str,
) -> None:
    (tmp_path / "there.log").write_text("(0.0) can0 123#01\n")
    monkeypatch.chdir(tmp_path)
    code, line = fails(capfd, *arguments)
    assert code == BAD_CALL
    assert words in line


def write_log(path: Path, frames: canser.FrameArray) -> None:
    with path.open("wb") as file:
        Writer(file).write(frames)


def test_play_a_log_at_its_times(tmp_path: Path, device: "Device") -> None:
    frames = vehicle(0.5)
    write_log(tmp_path / "run.log", frames)
    wanted = canser.encode(frames, "seeed")
    with running(tmp_path, *call("play", "run.log")) as run:
        assert device.read(len(wanted)) == wanted
        assert run.end() == GOOD
    assert run.err[0] == f"{len(frames):,} frames sent to dev"
    assert run.err[1].startswith("timing error: mean ")
    assert len(run.err) == 2


def test_play_tells_what_the_frames_of_a_log_do_not_hold(tmp_path: Path, device: "Device") -> None:
    (tmp_path / "run.log").write_text("(1.0) can0 123#11\n(1.0) can1 123#22\n")
    wanted = canser.encode(canser.frames(["123#11", "123#22"]), "seeed")
    with running(tmp_path, *call("play", "run.log")) as run:
        assert device.read(len(wanted)) == wanted
        assert run.end() == GOOD
    assert "run.log: frames of 2 channels become one: can0 1, can1 1" in run.err


def test_times_go_out_from_zero_on(tmp_path: Path, device: "Device") -> None:
    frames = canser.frames(["123#01", "124#02", "125#03"])
    frames["ts"] = np.array([1_700_000_000_000, 1_700_000_000_100, 1_700_000_000_300]) * 1_000_000
    write_log(tmp_path / "run.log", frames)
    with running(tmp_path, *call("play", "run.log", "--speed", "2", protocol="serial")) as run:
        got = canser.decode(device.read(3 * 12), "serial")
        assert run.end() == GOOD
    assert (got["ts"] // 1_000_000).tolist() == [0, 50, 150]


def test_play_a_recording_of_another_protocol(tmp_path: Path, device: "Device") -> None:
    frames = vehicle(0.2, extended=False)
    info = RecordingInfo("cantalope", 115_200, None, "ms", "/dev/other")
    with RecordingWriter(tmp_path / "run.pcapng", info) as recording:
        recording.write(canser.encode(frames, "cantalope"), 1_700_000_000_000_000_000)
    wanted = canser.encode(frames, "seeed")
    with running(tmp_path, *call("play", "run.pcapng")) as run:
        assert device.read(len(wanted)) == wanted
        assert run.end() == GOOD


def test_play_raw_bytes_as_fast_as_the_line_takes_them(tmp_path: Path, device: "Device") -> None:
    wanted = canser.encode(vehicle(1), "seeed")
    (tmp_path / "run.bin").write_bytes(wanted)
    with running(tmp_path, *call("play", "run.bin")) as run:
        assert device.read(len(wanted)) == wanted
        assert run.end() == GOOD
    assert run.err[1].startswith("they have no times: sent as fast as the line took them; --gap")


def test_play_over_and_over_until_a_signal(tmp_path: Path, device: "Device") -> None:
    frames = canser.frames(["123#01", "124#02"])
    frames["ts"] = [0, 5_000_000]
    write_log(tmp_path / "run.log", frames)
    wanted = canser.encode(frames, "seeed")
    with running(tmp_path, *call("play", "run.log", "--loop")) as run:
        assert device.read(len(wanted) * 5) == wanted * 5
        assert run.end(signal.SIGINT) == GOOD
    assert "rounds" in run.err[0]


def test_play_several_files_as_one_stream(tmp_path: Path, device: "Device") -> None:
    for name, frame, ts in (("a.log", "123#01", 0), ("b.npy", "124#02", 5_000_000)):
        frames = canser.frames(frame)
        frames["ts"] = ts
        canser.write(frames, tmp_path / name)
    wanted = canser.encode(canser.frames(["123#01", "124#02"]), "seeed")
    with running(tmp_path, *call("play", "a.log", "b.npy")) as run:
        assert device.read(len(wanted)) == wanted
        assert run.end() == GOOD
    assert "2 frames sent" in run.err[0]
    with running(tmp_path, *call("play", "b.npy", "a.log", "--sort")) as run:
        assert device.read(len(wanted)) == wanted
        assert run.end() == GOOD


@pytest.mark.usefixtures("device")
def test_each_of_several_files_is_judged_before_the_port_is_opened(tmp_path: Path) -> None:
    canser.write(canser.frames("123#01"), tmp_path / "a.npy")
    (tmp_path / "b.bin").write_bytes(canser.encode(vehicle(1), "serial"))
    with running(tmp_path, *call("play", "a.npy", "b.bin")) as run:
        assert run.end() == BAD_DATA
    assert "b.bin: these bytes look like serial" in run.err[0]


def test_play_one_bus_of_a_log(tmp_path: Path, device: "Device") -> None:
    (tmp_path / "run.log").write_text("(0.0) can0 123#01\n(0.0) can1 124#02\n")
    wanted = canser.encode(canser.frames("124#02"), "seeed")
    with running(tmp_path, *call("play", "run.log", "--bus", "can1")) as run:
        assert device.read(len(wanted)) == wanted
        assert run.end() == GOOD


def test_play_with_a_gap(tmp_path: Path, device: "Device") -> None:
    frames = canser.frames(["123#01"] * 5)
    frames["ts"] = 0
    (tmp_path / "run.bin").write_bytes(canser.encode(frames, "serial"))
    with running(tmp_path, *call("play", "run.bin", "--gap", "20", protocol="serial")) as run:
        got = canser.decode(device.read(5 * 12), "serial")
        assert run.end() == GOOD
    assert (got["ts"] // 1_000_000).tolist() == [0, 20, 40, 60, 80]


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "run.log holds no frame"),
        (
            "(0.0) can0 20000080#00\n(0.1) can0 20000080#00\n",
            "run.log: seeed can carry none of the 2 frames: error frames 2",
        ),
        ("(0.0) can0 123#01\n(0.1) can0\n", "run.log, line 2"),
    ],
)
def test_files_that_cannot_be_played(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "run.log").write_text(text)
    with running(tmp_path, *call("play", "run.log", "--loop")) as run:
        assert run.end() == BAD_DATA
    assert len(run.err) == 1
    assert words in run.err[0]


MIXED = "(0.0) can0 123#01\n(0.1) can0 20000080#00\n(0.2) can0 124#02\n"


def test_play_leaves_out_what_the_protocol_cannot_carry(tmp_path: Path, device: "Device") -> None:
    (tmp_path / "run.log").write_text(MIXED)
    wanted = canser.encode(canser.frames(["123#01", "124#02"]), "seeed")
    with running(tmp_path, *call("play", "run.log")) as run:
        assert device.read(len(wanted)) == wanted
        assert run.end() == GOOD
    assert run.err[:2] == [
        "run.log: 1 frame left out: error frames 1; seeed cannot carry them",
        "2 frames sent to dev",
    ]
    assert len(run.err) == 3


def test_play_tells_of_a_file_before_the_port_is_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.log").write_text(MIXED)
    monkeypatch.chdir(tmp_path)
    assert main(call("play", "run.log", "-c", "/dev/nothing")) == BAD_CALL
    told = capfd.readouterr().err.splitlines()
    assert told[0] == "run.log: 1 frame left out: error frames 1; seeed cannot carry them"
    assert "no port /dev/nothing" in told[1]


def test_play_strictly_refuses_a_file_before_the_port_is_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.log").write_text(MIXED)
    monkeypatch.chdir(tmp_path)
    code, line = fails(capfd, *call("play", "run.log", "-c", "/dev/nothing", "--strict"))
    assert code == BAD_DATA
    assert "run.log: seeed cannot carry 1 of 3 frames: error frames 1; " in line


@pytest.mark.parametrize("strict", [False, True])
def test_play_looks_at_a_pipe_block_by_block(
    tmp_path: Path, device: "Device", strict: bool
) -> None:
    # More than one block of lines, with an error frame behind the first block.
    log = "(0.0) can0 123#01\n" * 20_000 + "(0.0) can0 20000080#00\n" + "(0.0) can0 124#02\n"
    options = ["--strict"] if strict else []
    arguments = call("play", "-", "--from", "candump", *options)
    with running(tmp_path, *arguments, stdin=subprocess.PIPE) as run:
        assert run.process.stdin is not None
        feeder = threading.Thread(target=feed, args=(run.process.stdin, log.encode()))
        feeder.start()
        if not strict:
            wanted = canser.encode(canser.frames(["123#01"] * 20_000 + ["124#02"]), "seeed")
            assert device.read(len(wanted)) == wanted
            assert run.end() == GOOD
            assert run.err[:2] == [
                "standard input: 1 frame left out: error frames 1; seeed cannot carry them",
                "20,001 frames sent to dev",
            ]
        else:
            one = canser.encode(canser.frames(["123#01"]), "seeed")
            heard = b""
            while run.process.poll() is None or device.hears():
                heard += device.read_some() if device.hears(0.05) else b""
            assert run.end() == BAD_DATA
            count = len(heard) // len(one)
            assert heard == one * count
            assert 0 < count < 20_000
            assert f"{count:,} frames sent to dev" in run.err
            assert "standard input: seeed cannot carry 1 of 20,002 frames" in run.err[-1]
        feeder.join()


def feed(pipe: IO[bytes], data: bytes) -> None:
    with contextlib.suppress(BrokenPipeError), pipe:
        pipe.write(data)


def test_a_pipe_that_turns_bad_is_sent_up_to_there(tmp_path: Path, device: "Device") -> None:
    log = "(0.0) can0 123#01\n" * 20_000 + "nothing\n"
    with running(tmp_path, *call("play", "-", "--from", "candump"), stdin=subprocess.PIPE) as run:
        assert run.process.stdin is not None
        feeder = threading.Thread(target=feed, args=(run.process.stdin, log.encode()))
        feeder.start()
        one = canser.encode(canser.frames(["123#01"]), "seeed")
        sent = 20_000  # all frames before that line
        assert device.read(len(one) * sent) == one * sent
        assert run.end() == BAD_DATA
        feeder.join()
    assert run.err[0] == f"{sent:,} frames sent to dev"
    assert "standard input, line 20001" in run.err[-1]


def test_remarks_are_not_repeated_each_round(tmp_path: Path, device: "Device") -> None:
    frames = canser.frames(["123#01", "124#02"])
    raw = canser.encode(frames, "seeed")
    info = RecordingInfo("seeed", 115_200, None, "ms", "/dev/other")
    with RecordingWriter(tmp_path / "run.pcapng", info) as recording:
        recording.write(raw, 1_700_000_000_000_000_000)
    whole = (tmp_path / "run.pcapng").read_bytes()
    (tmp_path / "run.pcapng").write_bytes(whole[:-4])  # torn, as after a crash
    with running(tmp_path, *call("play", "run.pcapng", "--loop")) as run:
        assert device.read(len(raw) * 5) == raw * 5
        run.end(signal.SIGINT)
    remarks = [line for line in run.err if line.startswith("run.pcapng: ")]
    assert len(remarks) == len(set(remarks)) == 1


def test_a_file_that_is_gone_in_a_later_round_ends_it(tmp_path: Path, device: "Device") -> None:
    (tmp_path / "run.log").write_text("(0.0) can0 123#01\n(0.5) can0 124#02\n")
    raw = canser.encode(canser.frames(["123#01", "124#02"]), "seeed")
    with running(tmp_path, *call("play", "run.log", "--loop")) as run:
        assert device.read(len(raw)) == raw
        (tmp_path / "run.log").unlink()
        assert run.end() == BAD_CALL
    assert "frames sent to dev" in run.err[0]
    assert run.err[-1] == "canser: run.log: No such file or directory"


# Lines that do not send what they took


def sure(line: str) -> int:
    """Return how many frames were sent for sure, by the message of a command."""
    found = re.search(r"frames sent for sure: ([0-9,]+), taken", line)
    assert found, line
    return int(found[1].replace(",", ""))


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(canser.commands._sending, "_PATIENCE_S", 0.3)


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("name", ["play", "send"])
def test_a_terminal_that_is_not_read(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    device: "Device",
    name: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    frames = canser.frames(["123#0102030405060708"] * 4000)
    (tmp_path / "run.bin").write_bytes(canser.encode(frames, "seeed"))
    what = ["run.bin"] if name == "play" else ["123#0102030405060708"] * 4000
    code, line = fails(capfd, *call(name, *what))
    assert code == BAD_DATA
    assert line.startswith("canser: dev took nothing for 0.3 s; frames sent for sure: ")
    heard = b""
    while device.hears():
        heard += device.read_some()
    # A part of one more frame may have gone into the terminal.
    assert 0 < sure(line) == len(canser.decode(heard, "seeed")) < 4000


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("name", ["play", "send"])
def test_a_server_that_does_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], name: str
) -> None:
    """The system takes all of it, and holds what the server has no room for."""
    monkeypatch.chdir(tmp_path)
    count = 20_000
    one = "123#0102030405060708"
    (tmp_path / "run.bin").write_bytes(canser.encode(canser.frames([one] * count), "seeed"))
    with socket.socket() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        server.bind(("127.0.0.1", 0))
        server.listen()
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        what = ["run.bin"] if name == "play" else [one] * count
        code, line = fails(capfd, *call(name, *what, "-c", url))
        assert code == BAD_DATA
        assert line.startswith(f"canser: {url} sent nothing for 0.3 s; frames sent for sure: ")
        assert 0 < sure(line) < count
        waiting = int(line.rpartition(": ")[2].replace(",", ""))
        assert sure(line) + waiting == count
        client, _ = server.accept()
        with client:
            heard = b"".join(iter(lambda: client.recv(1 << 16), b""))
        assert len(canser.decode(heard, "seeed")) >= sure(line)


def test_unplugged_while_playing(tmp_path: Path, device: "Device") -> None:
    frames = vehicle(60)
    write_log(tmp_path / "run.log", frames)
    with running(tmp_path, *call("play", "run.log")) as run:
        heard = device.read(100)
        device.unplug()
        assert run.end() == BAD_DATA
    assert len(run.err) == 1
    assert "gone" in run.err[0]
    # What was heard the line had taken, whether or not it was known to be sent.
    waiting = int(run.err[0].rpartition(": ")[2].replace(",", ""))
    assert len(canser.decode(heard, "seeed")) <= sure(run.err[0]) + waiting < len(frames)


def test_a_server_that_resets_while_playing(tmp_path: Path) -> None:
    frames = vehicle(60)
    write_log(tmp_path / "run.log", frames)
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        with running(tmp_path, *call("play", "run.log", "-c", url)) as run:
            client, _ = server.accept()
            client.recv(100)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            client.close()
            assert run.end() == BAD_DATA
    assert len(run.err) == 1
    assert run.err[0].startswith(f"canser: {url}")
    assert "gone" in run.err[0]
    assert sure(run.err[0]) < len(frames)


def test_ports_are_a_table(
    monkeypatch: pytest.MonkeyPatch, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    found = [
        ListPortInfo("/dev/ttyUSB10"),
        ListPortInfo("/dev/ttyUSB2"),
    ]
    found[0].description, found[0].hwid = "n/a", "USB VID:PID=1A86:7523"
    found[1].description, found[1].hwid = "USB2.0-Serial", "n/a"
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: found)
    assert main(["ports"]) == GOOD
    assert capfdbinary.readouterr() == (
        b"/dev/ttyUSB2   USB2.0-Serial\n/dev/ttyUSB10                 USB VID:PID=1A86:7523\n",
        b"",
    )


def test_no_port_is_said(
    monkeypatch: pytest.MonkeyPatch, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    monkeypatch.setattr("serial.tools.list_ports.comports", list)
    assert main(["ports"]) == GOOD
    out, err = capfdbinary.readouterr()
    assert out == b""
    assert err.startswith(b"no serial port is plugged in")
