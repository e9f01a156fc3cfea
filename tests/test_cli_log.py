"""`canser log` as its users run it: pseudo terminals, signals, full disks, files afterwards."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import canser
from canser._frames import FRAME_DTYPE, FrameArray
from canser.commands.cli import main
from canser.recording.header import RecordingInfo
from canser.recording.reader import Recording
from canser.recording.writer import RecordingWriter
from canser.simulation.traffic import vehicle

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are POSIX")

if sys.platform != "win32":
    import fcntl
    import resource

    from beside import fails, open_terminal, read_terminal, running
    from canser.commands._screen import PATIENCE_S
    from canser.simulation.faults import Faults
    from canser.simulation.simulator import Simulator
    from device import Device, until

GOOD, BAD_DATA, BAD_CALL = 0, 1, 2

RAW = canser.encode(vehicle(10), "seeed")


@pytest.fixture
def device(tmp_path: Path) -> Iterator["Device"]:
    with Device(tmp_path / "dev") as made:
        yield made


def content(path: Path) -> bytes:
    with Recording(path) as recording:
        raw = b"".join(bytes(piece.data) for piece in recording)
        assert recording.remarks == []
    return raw


def recordings(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.pcapng"))


def log(*more: str) -> list[str]:
    return ["log", "-c", "dev", "-p", "seeed", *more]


def check_law(facts: dict[str, int]) -> None:
    kinds = ("framed", "control", "skipped", "pending")
    assert facts["bytes"] == sum(facts[kind] for kind in kinds)
    assert facts["bytes"] == facts["recorded"] + facts["not_recorded"] + facts["vanished"]


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_signals_end_it_with_all_on_disk(tmp_path: Path, device: "Device", name: str) -> None:
    with running(tmp_path, *log("--json", "run.pcapng")) as run:
        opened = run.wait_object("opened")
        assert opened["path"] == str(tmp_path / "run.pcapng")
        device.write(RAW)
        run.wait_object("status", bytes=len(RAW))
        assert run.end(signal.Signals[name]) == GOOD
        assert run.err == []
    (end,) = run.objects("end")
    assert (end["reason"], end["error"], end["files"]) == ("signal", None, 1)
    assert (end["frames"], end["bytes"], end["lost"]) == (len(vehicle(10)), len(RAW), 0)
    check_law(end)
    assert content(tmp_path / "run.pcapng") == RAW
    with Recording(tmp_path / "run.pcapng") as recording:
        assert recording.info.protocol == "seeed"
        assert recording.info.device == "dev"


def test_a_signal_in_the_middle_leaves_no_hole(tmp_path: Path) -> None:
    with (
        (tmp_path / "sent.bin").open("wb") as copy,
        Simulator(
            "seeed",
            vehicle(10),
            loop=True,
            pace="line",
            baudrate=10_000_000,  # five times that of the adapter
            link=str(tmp_path / "dev"),
            copy=copy,
        ),
        running(tmp_path, *log("--json", "run.pcapng")) as run,
    ):
        run.wait_for(lambda: run.objects("status")[-1:], "status")
        run.wait_for(lambda: run.objects("status")[-1]["bytes"] > len(RAW), "bytes")
        assert run.end(signal.SIGTERM) == GOOD
    (end,) = run.objects("end")
    assert (end["lost"], end["skipped"], end["gaps"]) == (0, 0, 0)
    check_law(end)
    got = content(tmp_path / "run.pcapng")
    assert len(got) == end["bytes"] > len(RAW)
    # As a value of its own: two long texts that differ would be printed.
    whole = (tmp_path / "sent.bin").read_bytes().startswith(got)
    assert whole


def test_a_simulated_adapter_to_the_byte(tmp_path: Path) -> None:
    with (
        (tmp_path / "sent.bin").open("wb") as copy,
        Simulator(
            "seeed",
            vehicle(60),
            pace="max",
            faults=Faults(noise=1e-4),
            link=str(tmp_path / "dev"),
            copy=copy,
        ) as simulator,
        running(tmp_path, *log("--bitrate", "500000", "--json", "run.pcapng")) as run,
    ):
        assert simulator.wait(60)
        sent = simulator.report().bytes_sent
        run.wait_object("status", bytes=sent)
        assert run.end(signal.SIGINT) == GOOD
        assert simulator.configuration is not None
        assert simulator.configuration.bitrate == 500_000
    assert content(tmp_path / "run.pcapng") == (tmp_path / "sent.bin").read_bytes()
    (end,) = run.objects("end")
    assert end["skipped"] > 0
    check_law(end)


def test_people_get_a_summary(tmp_path: Path, device: "Device") -> None:
    with running(tmp_path, *log("run.pcapng")) as run:
        run.wait_line(f"recording into {tmp_path / 'run.pcapng'}")
        device.write(RAW + b"\0\0\0")
        # No status is told in the first seconds: wait for the file instead.
        path = tmp_path / "run.pcapng"
        until(lambda: path.stat().st_size > len(RAW))
        assert run.end(signal.SIGINT) == GOOD
    assert run.out == []
    text = "\n".join(run.err)
    assert "\x1b" not in text
    assert re.search(r"^dev: [\d,]+ frames in [\d.]+ s$", text, re.M)
    assert re.search(r"bytes = .* framed \+ 0 control", text)
    assert "lost: 0 bytes" in text
    assert re.search(r"^recorded: [\d,]+ bytes in run\.pcapng$", text, re.M)


def test_unplugged(tmp_path: Path, device: "Device") -> None:
    with running(tmp_path, *log("--json", "run.pcapng")) as run:
        run.wait_object("opened")
        device.write(RAW)
        run.wait_object("status", bytes=len(RAW))
        device.unplug()
        assert run.end() == BAD_DATA
    assert len(run.err) == 1
    assert run.err[0].startswith("canser: dev is gone")
    assert run.objects("end")[0]["reason"] == "error"
    assert content(tmp_path / "run.pcapng") == RAW


def test_reconnect_leaves_a_gap_in_the_file(tmp_path: Path, device: "Device") -> None:
    with running(tmp_path, *log("--json", "--reconnect", "run.pcapng")) as run:
        run.wait_object("opened")
        device.write(RAW[:-5])  # the last frame is cut
        run.wait_object("status", bytes=len(RAW) - 5)
        device.unplug()
        gap = run.wait_object("gap", reason="reconnect")
        assert (gap["offset"], gap["lost"]) == (len(RAW) - 5, -1)
        with Device(tmp_path / "dev") as again:
            again.feed(RAW)
            run.wait_object("back")
            run.wait_object("status", bytes=2 * len(RAW) - 5)
            assert run.end(signal.SIGTERM) == GOOD
    (end,) = run.objects("end")
    assert (end["gaps"], end["gaps_unknown"], end["frames"]) == (1, 1, 2 * len(vehicle(10)) - 1)
    parts = [b""]
    with Recording(tmp_path / "run.pcapng") as recording:
        for piece in recording:
            if piece.gap:
                assert piece.lost == -1
                parts.append(b"")
            parts[-1] += bytes(piece.data)
    assert parts == [RAW[:-5], RAW]


@pytest.mark.parametrize("more", [[], ["--size", "150k"]], ids=["one", "turns"])
def test_a_full_disk_stops_it_loudly(tmp_path: Path, device: "Device", more: list[str]) -> None:
    def bound() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (90_000, 90_000))

    with running(tmp_path, *log("run.pcapng", *more), preexec_fn=bound) as run:
        run.wait_line("recording into")
        device.write(RAW[:200_000], lambda: run.process.poll() is not None)
        assert run.end() == BAD_DATA
    last = run.err[-1]
    assert last.startswith("canser: STOPPED: ")
    assert "File too large" in last
    (path,) = recordings(tmp_path)
    assert str(path) in last
    got = content(path)
    assert got
    assert RAW.startswith(got)
    missing = int(re.search(r"the last ([\d,]+) bytes are not", last)[1].replace(",", ""))  # type: ignore[index]
    received = int(re.search(r"^([\d,]+) bytes = ", "\n".join(run.err), re.M)[1].replace(",", ""))  # type: ignore[index]
    # What was read and is not decoded yet is missing, too.
    assert received <= len(got) + missing <= 200_000


@pytest.mark.usefixtures("device")
def test_a_disk_that_is_full_from_the_start_is_told_with_the_file(tmp_path: Path) -> None:
    def bound() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))

    with running(tmp_path, *log("run.pcapng"), preexec_fn=bound) as run:
        assert run.end() == BAD_DATA
    path = tmp_path / "run.pcapng"
    assert run.err[-1] == f"canser: STOPPED: {path}: File too large; nothing is recorded"
    assert not path.exists()


# Runs the command on a disk that takes no more syncs once a file is there.
BAD_DISK = """
import errno, os, sys
from canser.commands.cli import main

plain = os.fdatasync

def fdatasync(fd):
    if os.path.exists("bad"):
        raise OSError(errno.EIO, os.strerror(errno.EIO))
    plain(fd)

os.fdatasync = fdatasync
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="fdatasync is not everywhere")
def test_a_disk_that_fails_leaves_the_last_bytes_unsure(tmp_path: Path, device: "Device") -> None:
    with running(tmp_path, *log("--json", "run.pcapng"), python=BAD_DISK) as run:
        run.wait_object("opened")
        device.write(RAW[:1000])
        run.wait_object("status", bytes=1000)
        (tmp_path / "bad").touch()
        device.write(RAW[1000:1500])
        assert run.end() == BAD_DATA
    (end,) = run.objects("end")
    unsure = end["bytes"] - end["recorded"]
    assert 0 < unsure <= 1500
    path = tmp_path / "run.pcapng"
    text = f"STOPPED: {path}: Input/output error; the last {unsure:,} bytes may not be on the disk"
    assert end["error"] == text
    assert run.err == [f"canser: {text}"]


@pytest.mark.skipif(sys.platform != "linux" or os.geteuid() != 0, reason="needs a small tmpfs")
def test_a_full_tmpfs(tmp_path: Path, device: "Device") -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=128k", "none", str(disk)],
        check=False,
        capture_output=True,
    )
    if mounted.returncode:
        pytest.skip("may not mount here")
    try:
        with running(tmp_path, *log("--size", "100k", "disk/run.pcapng")) as run:
            run.wait_line("recording into")
            device.write(RAW[:250_000], lambda: run.process.poll() is not None)
            assert run.end() == BAD_DATA
        assert "No space left on device" in run.err[-1]
        got = b"".join(content(path) for path in recordings(disk))
        assert len(got) > 50_000
        assert RAW.startswith(got)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


# Runs the command on a host whose clock is set forward by an hour once a file is there.
SET_CLOCK = """
import os, sys, time
from canser.commands.cli import main

plain = time.time_ns
time.time_ns = lambda: plain() + (3_600_000_000_000 if os.path.exists("set") else 0)
sys.exit(main(sys.argv[1:]))
"""


def test_a_clock_that_is_set_is_told(tmp_path: Path, device: "Device") -> None:
    with running(tmp_path, *log("--json", "run.pcapng"), python=SET_CLOCK) as run:
        opened = run.wait_object("opened")
        device.write(RAW)
        run.wait_object("status", bytes=len(RAW))
        (tmp_path / "set").touch()
        told = run.wait_object("clock_set")
        assert run.end(signal.SIGINT) == GOOD
    assert abs(told["step_ns"] - 3600 * 10**9) < 10**9
    assert 3590 < told["time"] - opened["time"] < 3720
    assert run.err == []
    with Recording(tmp_path / "run.pcapng") as recording:
        assert b"".join(bytes(piece.data) for piece in recording) == RAW
        (remark,) = recording.remarks
    assert "the host's clock was set forward by 3,600.0 s" in remark


def test_files_by_turns(tmp_path: Path, device: "Device") -> None:
    many = RAW * 3
    with running(tmp_path, *log("--json", "--size", "100k", "run.pcapng")) as run:
        run.wait_object("opened")
        device.write(many)
        run.wait_object("status", bytes=len(many))
        assert run.end(signal.SIGINT) == GOOD
    paths = recordings(tmp_path)
    assert len(paths) >= 3
    assert b"".join(content(path) for path in paths) == many
    assert [one["path"] for one in run.objects("opened")] == [str(path) for path in paths]
    for path in paths:
        decoder = canser.Decoder("seeed")
        decoder.feed(content(path))
        assert (decoder.stats.bytes_skipped, decoder.pending) == (0, 0)


def test_keep_the_newest_files(tmp_path: Path, device: "Device") -> None:
    many = RAW * 3
    with running(tmp_path, *log("--json", "--size", "100k", "--keep", "2", "run.pcapng")) as run:
        run.wait_object("opened")
        device.write(many)
        run.wait_object("status", bytes=len(many))
        assert run.end(signal.SIGINT) == GOOD
    paths = recordings(tmp_path)
    assert len(paths) == 2
    assert many.endswith(b"".join(content(path) for path in paths))
    deleted = [one["path"] for one in run.objects("deleted")]
    assert len(deleted) == run.objects("end")[0]["files"] - 2
    assert not any(os.path.exists(path) for path in deleted)  # noqa: PTH110


def frame(arbitration_id: int) -> FrameArray:
    made = np_zeros()
    made["id"], made["dlc"] = arbitration_id, 8
    return made


def np_zeros() -> FrameArray:
    return canser.decode(b"\xaa\xc8\0\0" + bytes(8) + b"\x55", "seeed").astype(FRAME_DTYPE)


def test_triggers_keep_what_was_around_them(tmp_path: Path, device: "Device") -> None:
    plain = canser.encode(frame(0x100), "seeed") * 500
    wanted = canser.encode(frame(0x7AB), "seeed")
    options = ["--trigger", "7AB:7FF", "--before", "0s", "--after", "0s"]
    with running(tmp_path, *log("--json", *options, "e.pcapng")) as run:
        sent = 0
        # Each part goes through a round of its own, so what is before is not around.
        for part in (plain, wanted, plain, wanted, plain):
            sent += len(part)
            device.write(part)
            run.wait_object("status", bytes=sent)
        assert run.end(signal.SIGINT) == GOOD
    (end,) = run.objects("end")
    assert (end["triggers"], end["files"]) == (2, 2)
    assert end["not_recorded"] > 0
    check_law(end)
    for path in recordings(tmp_path):
        got = content(path)
        assert got.count(wanted) == 1
        assert len(got) < len(plain)
    assert len(run.objects("trigger")) == 2


def test_a_trigger_keeps_what_came_before(tmp_path: Path, device: "Device") -> None:
    plain = canser.encode(frame(0x100), "seeed") * 500
    wanted = canser.encode(frame(0x7AB), "seeed")
    options = ["--trigger", "7AB:7FF", "--before", "1h", "--after", "1h"]
    with running(tmp_path, *log(*options, "e.pcapng")) as run:
        device.write(plain + wanted + plain)
        run.wait_line("recording into")
        assert run.end(signal.SIGINT) == GOOD
    assert content(tmp_path / "e-000001.pcapng").startswith(plain + wanted)
    assert any(re.match(r"triggers: 1; 0 bytes", line) for line in run.err)


def test_an_error_of_the_adapter_is_a_trigger(tmp_path: Path, device: "Device") -> None:
    options = ["--trigger", "error", "--json", "e.pcapng"]
    with running(tmp_path, "log", "-c", "dev", "-p", "cantalope", *options) as run:
        device.write(bytes.fromhex("246111 FFFF0107"))
        assert run.wait_object("error")["number"] == 7
        run.wait_object("trigger")
        run.wait_object("status", bytes=7)
        assert run.end(signal.SIGINT) == GOOD
    assert content(tmp_path / "e-000001.pcapng") == bytes.fromhex("246111 FFFF0107")


def test_without_a_trigger_there_is_no_file(tmp_path: Path, device: "Device") -> None:
    with running(tmp_path, *log("--trigger", "7FF:7FF", "--json", "e.pcapng")) as run:
        device.write(RAW)
        run.wait_object("status", bytes=len(RAW))
        assert run.end(signal.SIGINT) == GOOD
    assert recordings(tmp_path) == []
    assert run.objects("end")[0]["not_recorded"] == len(RAW)


STATUS_KEYS = {
    "type", "time", "elapsed", "frames", "frames_per_s", "bytes", "bytes_per_s", "bus_load",
    "framed", "control", "skipped", "pending", "resyncs", "lost", "gaps", "gaps_unknown", "ring",
    "recorded", "not_recorded", "vanished", "triggers", "files", "file", "lines_dropped",
}  # fmt: skip


def test_json_has_the_same_keys_always(tmp_path: Path, device: "Device") -> None:
    with running(tmp_path, *log("--json", "--duration", "2.5s", "run.pcapng")) as run:
        run.wait_object("opened")
        device.write(RAW[:100_000])
        assert run.end() == GOOD
    assert run.err == []
    kinds = [one["type"] for one in run.objects()]
    assert kinds[0] == "opened"
    assert kinds[-2:] == ["closed", "end"]
    assert kinds.count("status") >= 1
    for one in run.objects("status"):
        assert one.keys() == STATUS_KEYS
        assert one["bus_load"] is None
    (end,) = run.objects("end")
    assert end.keys() == STATUS_KEYS | {"reason", "error"}
    assert end["reason"] == "duration"
    assert end["elapsed"] >= 2.5


def test_a_bit_rate_gives_the_load_of_the_bus(tmp_path: Path) -> None:
    # An adapter that cannot be set takes no configuration; its bit rate still is worth telling.
    with Device(tmp_path / "dev") as device:
        options = ["--bitrate", "500000", "--json", "run.pcapng"]
        with running(tmp_path, "log", "-c", "dev", "-p", "serial", *options) as run:
            run.wait_object("opened")
            device.write(canser.encode(vehicle(1), "serial"))
            run.wait_for(lambda: any(one["bus_load"] for one in run.objects("status")), "a load")
            assert run.end(signal.SIGINT) == GOOD
    with Recording(tmp_path / "run.pcapng") as recording:
        assert recording.info.bitrate == 500_000


@pytest.mark.parametrize("columns", [80, 40])
def test_the_status_line_fits_the_terminal(tmp_path: Path, device: "Device", columns: int) -> None:
    master, slave = open_terminal(columns)
    try:
        with running(tmp_path, *log("run.pcapng"), stderr=slave) as run:
            os.close(slave)
            text = read_terminal(master, lambda text: "recording into" in text)
            device.write(RAW[:50_000])
            text += read_terminal(master, lambda text: text.count(" frames/s") >= 3)
            run.process.send_signal(signal.SIGINT)
            text += read_terminal(master, lambda text: "lost: 0 bytes" in text)
            assert run.end() == GOOD
    finally:
        os.close(master)
    statuses = re.findall(r"\x1b\[K(\d\d:\d\d:\d\d[^\r\n]*)", text)
    assert len(statuses) >= 2
    assert max(map(len, statuses)) < columns
    parts = ["frames/s", "B/s", "skipped 0", "ring 0%"] if columns == 80 else ["frames/s"]
    for part in parts:
        assert part in statuses[-1]
    # Below the last one, which is wiped away, stands nothing but the summary.
    assert "frames/s" not in text.rsplit("\x1b[K", 1)[1]


def test_noise_is_warned_of_in_one_line(tmp_path: Path, device: "Device") -> None:
    with running(tmp_path, *log("run.pcapng")) as run:
        run.wait_line("recording into")
        device.write(b"\0" * 20_000)
        line = run.wait_line("canser: ")
        assert "are the baud rate and the protocol right?" in line
        assert run.end(signal.SIGINT) == GOOD
    assert any(line.startswith("skipped: marker") for line in run.err)


@pytest.mark.usefixtures("device")
def test_closed_streams(tmp_path: Path) -> None:
    def without(fd: int) -> list[str]:
        call = [sys.executable, "-m", "canser", *log("--duration", "0.1s", "--force", "run.pcapng")]
        return ["sh", "-c", f'exec "$@" {fd}>&-', "sh", *call, *(["--json"] if fd == 1 else [])]

    done = subprocess.run(without(2), cwd=tmp_path, capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (GOOD, b"")
    assert content(tmp_path / "run.pcapng") == b""
    done = subprocess.run(without(1), cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == BAD_CALL
    assert b"the standard output is closed" in done.stderr


def test_the_help_says_what_the_options_promise(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["log", "--help"])
    text = " ".join(capfd.readouterr().out.split())
    assert "--before TIME record at least this time before a trigger" in text
    assert "rotation: with --size or --time, OUT run.pcapng becomes run-000001.pcapng" in text


# The old file that --force replaces


def test_force_replaces_the_old_file_once_there_are_bytes(tmp_path: Path, device: "Device") -> None:
    path, old = tmp_path / "run.pcapng", tmp_path / "run.pcapng.old"
    path.write_text("old")
    with running(tmp_path, *log("--force", "--json", "run.pcapng")) as run:
        run.wait_object("opened")
        assert old.read_text() == "old"
        device.write(RAW)
        until(lambda: not old.exists())
        assert path.stat().st_size > 1000
        assert run.end(signal.SIGINT) == GOOD
    assert content(path) == RAW


@pytest.mark.usefixtures("device")
def test_force_gives_the_old_file_back_where_no_byte_came(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    path.write_text("old")
    with running(tmp_path, *log("--force", "run.pcapng")) as run:
        run.wait_line("recording into")
        assert run.end(signal.SIGINT) == GOOD
    assert f"nothing was recorded; the old file has its name back: {path}" in run.err
    assert "recorded: 0 bytes in 1 file, 0 kept" in run.err
    assert path.read_text() == "old"
    assert [one.name for one in tmp_path.glob("run*")] == ["run.pcapng"]


@pytest.mark.usefixtures("device")
def test_kill_leaves_the_old_file_and_the_next_run_does_not_touch_it(tmp_path: Path) -> None:
    path, old = tmp_path / "run.pcapng", tmp_path / "run.pcapng.old"
    path.write_text("old")
    with running(tmp_path, *log("--force", "run.pcapng")) as run:
        run.wait_line("recording into")
        run.end(signal.SIGKILL)
    assert old.read_text() == "old"
    with running(tmp_path, *log("--force", "run.pcapng")) as run:
        assert run.end() == BAD_CALL
    assert len(run.err) == 1
    assert f"{old} is there already" in run.err[0]
    assert old.read_text() == "old"


@pytest.mark.usefixtures("device")
def test_force_does_not_replace_a_file_that_is_recorded_into(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    with (
        RecordingWriter(path, RecordingInfo("seeed", 1, None, "ms", "x")),
        running(tmp_path, *log("--force", "run.pcapng")) as run,
    ):
        assert run.end() == BAD_CALL
    assert len(run.err) == 1
    assert f"another program records into {path}" in run.err[0]


# Files that are removed, replaced or renamed while they are open


@pytest.mark.parametrize("how", ["removed", "renamed"])
def test_a_file_that_vanishes_is_told_and_the_exit_code_is_1(
    tmp_path: Path, device: "Device", how: str
) -> None:
    path, moved = tmp_path / "run.pcapng", tmp_path / "moved.pcapng"
    with running(tmp_path, *log("--json", "run.pcapng")) as run:
        run.wait_object("opened")
        device.write(RAW)
        run.wait_object("status", bytes=len(RAW))
        if how == "removed":
            path.unlink()
        else:
            path.rename(moved)
        told = run.wait_object("vanished", path=str(path), renamed=how == "renamed")
        run.wait_for(lambda: len(run.objects("opened")) == 2, "a new file")
        device.write(RAW)
        run.wait_object("status", bytes=2 * len(RAW))
        assert run.end(signal.SIGINT) == BAD_DATA
    (end,) = run.objects("end")
    check_law(end)
    lost = len(RAW) if how == "removed" else 0
    assert told["lost"] == end["vanished"] == lost
    assert (end["reason"], end["files"]) == ("signal", 2)
    assert end["error"] == (
        "files that were removed, replaced or renamed while they were open: 1; "
        f"{lost:,} bytes are gone"
    )
    assert run.err == [f"canser: {end['error']}"]
    assert content(path) == RAW
    if how == "renamed":
        assert content(moved) == RAW


def test_no_file_that_is_gone_is_named_at_the_end(tmp_path: Path, device: "Device") -> None:
    path = tmp_path / "run.pcapng"
    with running(tmp_path, *log("run.pcapng")) as run:
        run.wait_line("recording into")
        device.write(RAW)
        until(lambda: path.stat().st_size > len(RAW))
        path.unlink()
        assert run.end(signal.SIGINT) == BAD_DATA
    assert "recorded: 0 bytes in 1 file, 0 kept" in run.err
    lost = f"{path} was removed or replaced while it was open; its {len(RAW):,} bytes are gone"
    assert lost in run.err
    assert run.err[-1].startswith("canser: files that were removed")


def test_another_recorder_that_takes_the_name_ends_it(tmp_path: Path, device: "Device") -> None:
    path = tmp_path / "run.pcapng"
    with running(tmp_path, *log("run.pcapng")) as run:
        run.wait_line("recording into")
        device.write(RAW)
        until(lambda: path.stat().st_size > len(RAW))
        with RecordingWriter(tmp_path / "new.pcapng", RecordingInfo("seeed", 1, None, "ms", "x")):
            (tmp_path / "new.pcapng").replace(path)
            assert run.end() == BAD_DATA
    last = run.err[-1]
    assert last.startswith(f"canser: STOPPED: {path}: another program records into it now")


@pytest.mark.parametrize(("keep", "text"), [("2", "2 kept: "), ("1", "1 kept: "), ("", "")])
def test_the_summary_names_files_that_are_there(
    tmp_path: Path, device: "Device", keep: str, text: str
) -> None:
    options = ["--size", "100k", *(["--keep", keep] if keep else []), "run.pcapng"]
    with running(tmp_path, *log(*options)) as run:
        run.wait_line("recording into")
        device.write(RAW * 2)
        until(lambda: sum("recording into" in line for line in run.err) >= 5)
        assert run.end(signal.SIGINT) == GOOD
    made = sum("recording into" in line for line in run.err)
    there = [path.name for path in recordings(tmp_path)]
    assert len(there) == (int(keep) if keep else made)
    names = there[0] if keep == "1" else f"{there[0]} to {there[-1]}"
    (line,) = (line for line in run.err if line.startswith("recorded:"))
    assert line.endswith(f" bytes in {made} files, {text}{names}")


# What becomes of the messages and objects

linux = pytest.mark.skipif(sys.platform != "linux", reason="/dev/full, pipes of a page")


@contextlib.contextmanager
def pipe(*, read: bool = True) -> Iterator[tuple[int, int]]:
    """Yield the ends of a pipe; `read`: whether it has a reader."""
    reader, writer = os.pipe()
    if not read:
        os.close(reader)
    try:
        yield reader, writer
    finally:
        os.close(writer)
        if read:
            os.close(reader)


@linux
@pytest.mark.parametrize("stderr", ["full", "no reader"])
@pytest.mark.parametrize("fails", [False, True], ids=["good", "fails"])
def test_messages_change_no_exit_code(
    tmp_path: Path, device: "Device", stderr: str, fails: bool
) -> None:
    with open("/dev/full", "wb", buffering=0) as full, pipe(read=False) as (_, broken):  # noqa: PTH123
        fd = full.fileno() if stderr == "full" else broken
        with running(tmp_path, *log("run.pcapng"), stderr=fd) as run:
            path = tmp_path / "run.pcapng"
            until(path.exists)
            device.write(RAW)
            until(lambda: path.stat().st_size > len(RAW))
            if fails:
                device.unplug()
            assert run.end(None if fails else signal.SIGINT) == (BAD_DATA if fails else GOOD)
    assert content(path) == RAW


@linux
@pytest.mark.parametrize("stdout", ["full", "no reader"])
def test_the_recording_goes_on_without_the_objects(
    tmp_path: Path, device: "Device", stdout: str
) -> None:
    with open("/dev/full", "wb", buffering=0) as full, pipe(read=False) as (_, broken):  # noqa: PTH123
        fd = full.fileno() if stdout == "full" else broken
        with running(tmp_path, *log("--json", "run.pcapng"), stdout=fd) as run:
            path = tmp_path / "run.pcapng"
            until(path.exists)
            if stdout == "full":
                run.wait_line("No space left")
            device.write(RAW)
            until(lambda: path.stat().st_size > len(RAW))
            assert run.end(signal.SIGTERM) == (BAD_DATA if stdout == "full" else GOOD)
    assert content(path) == RAW
    assert run.err == [
        "canser: standard output: No space left on device; the objects from now on are missing, "
        "the recording goes on"
    ] * (stdout == "full")


@linux
def test_a_slow_reader_gets_the_end(tmp_path: Path, device: "Device") -> None:
    with pipe() as (reader, writer):
        fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
        os.write(writer, b"\n" * 4096)
        with running(tmp_path, *log("--json", "run.pcapng"), stdout=writer) as run:
            until((tmp_path / "run.pcapng").exists)
            device.write(RAW)
            run.process.send_signal(signal.SIGINT)
            # The end waits as long as some is read: for longer than its patience.
            begin, text = time.monotonic(), b""
            while time.monotonic() - begin < PATIENCE_S + 1:
                text += os.read(reader, 1)
                time.sleep(0.1)
            assert run.process.poll() is None
            while b'"end"' not in text:
                text += os.read(reader, 4096)
            assert run.end() == GOOD
    assert run.err == []
    assert json.loads(text.splitlines()[-1])["type"] == "end"


@linux
def test_a_reader_that_takes_nothing_does_not_keep_it(tmp_path: Path, device: "Device") -> None:
    with pipe() as (_, writer):
        fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
        os.write(writer, b"\n" * 4096)
        with running(tmp_path, *log("--json", "run.pcapng"), stdout=writer) as run:
            until((tmp_path / "run.pcapng").exists)
            device.write(RAW)
            assert run.end(signal.SIGINT) == BAD_DATA
    assert run.err == [
        "canser: standard output: the reader took nothing for 5 s; the last objects are missing"
    ]
    assert content(tmp_path / "run.pcapng") == RAW


@pytest.mark.usefixtures("device")
def test_a_port_in_use(tmp_path: Path) -> None:
    with running(tmp_path, *log("run.pcapng")) as first:
        first.wait_line("recording into")
        with running(tmp_path, *log("two.pcapng")) as second:
            assert second.end() == BAD_CALL
        assert first.end(signal.SIGINT) == GOOD
    assert len(second.err) == 1
    assert "open in another program" in second.err[0]
    assert [path.name for path in recordings(tmp_path)] == ["run.pcapng"]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["run.bin"], "must end in .pcapng"),
        (["there.pcapng"], "--force replaces it"),
        (["nowhere/run.pcapng"], "No such file"),
        (["run.pcapng", "--size", "100X"], "cannot read the size"),
        (["run.pcapng", "--size", "5"], "too small"),
        (["run.pcapng", "--time", "soon"], "cannot read the time"),
        (["run.pcapng", "--time", "0"], "more than 0 seconds"),
        (["run.pcapng", "--keep", "3"], "give their size or time"),
        (["run.pcapng", "--before", "5s"], "name one with --trigger"),
        (["run.pcapng", "--trigger", "12Q:7FF"], "cannot read the filter"),
        (["run.pcapng", "--trigger", "18FE"], "write 000018FE, or ID:MASK"),
        (["run.pcapng", "--bitrate", "123"], "is none of the adapter's"),
        (["run.pcapng", "--mode", "silent"], "give its bitrate"),
        (["run.pcapng", "--mode", "quiet"], "invalid choice"),
        (["run.pcapng", "--adapter-filter", "123"], "write ID:MASK"),
        (["run.pcapng", "--baudrate", "0"], "1 or more"),
        (["run.pcapng", "--ping", "1s"], "know no ping"),
        (["run.pcapng", "--dtr", "off"], "has no modem lines"),
        (["run.pcapng", "-c", "/dev/nothing"], "there is no port"),
        (["there.pcapng", "--force", "-c", "/dev/nothing"], "there is no port"),
        (["run.pcapng", "-c", "ftp://x"], "cannot open"),
        (["run.pcapng", "-p", "seed"], "unknown protocol"),
        ([], "OUT"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
@pytest.mark.usefixtures("device")
def test_typos(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    more: list[str],
    words: str,
) -> None:
    (tmp_path / "there.pcapng").write_text("old")
    monkeypatch.chdir(tmp_path)
    code, line = fails(capfd, *log(*more))
    assert code == BAD_CALL
    assert words in line
    assert [path.name for path in recordings(tmp_path)] == ["there.pcapng"]
    assert (tmp_path / "there.pcapng").read_text() == "old"
