"""Recording a port beside the program that reads it, or does not."""

import contextlib
import errno
import os
import random
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import canser
from canser._frames import FrameArray
from canser.live.recorder import Recorder
from canser.live.recording import RecorderEvent
from canser.live.ring import Ring
from canser.recording.reader import Recording
from canser.recording.rotation import RecordingFiles
from canser.simulation.simulator import Simulator
from canser.simulation.traffic import vehicle
from device import PATIENCE, Device, until
from long import takes_long
from readers import Background, collect, content, plugged, waiting
from reference import Frame
from samples import array

# Bytes come here faster than any line has them, and so the device's clock looks too slow.
pytestmark = pytest.mark.filterwarnings("ignore:.*the device clock:canser.CanserWarning")

FRAMES = vehicle(3)
RAW = canser.encode(FRAMES, "seeed")
FRAME_MIN = 5  # bytes of the shortest one
SMALL = canser.LineConfig(ring_size=1 << 16)


def recorded(path: Path) -> bytes:
    """Return the bytes of the line in a recording that has no faults."""
    with Recording(path) as recording:
        raw = b"".join(bytes(piece.data) for piece in recording)
        assert recording.remarks == []
    return raw


def lost_in(path: Path) -> list[int]:
    """Return how many bytes are missing at each gap of a recording."""
    with Recording(path) as recording:
        return [piece.lost for piece in recording if piece.gap]


def words(frames: FrameArray) -> npt.NDArray[np.uint64]:
    """Return frames as rows of two words: all but the time."""
    return frames.view(np.uint64).reshape(-1, 3)[:, :2]


def arrived(port: canser.Port, count: int) -> None:
    """Wait until so many bytes have come that are not read."""
    until(lambda: waiting(port) >= count)


def write_to(device: Device, data: bytes, *rings: Ring) -> None:
    """Send bytes as fast as those who empty these small rings take them, on any machine."""
    for begin in range(0, len(data), 24_000):
        device.write(data[begin : begin + 24_000])
        # For as many bytes they wait at most: so many may stay.
        until(lambda: not device.waiting() and max(map(len, rings)) <= 4096 * FRAME_MIN)


def taken(recorder: Recorder, count: int) -> None:
    """Wait until a recorder has taken so many bytes."""
    until(lambda: recorder.status.bytes_in >= count)


class Events(list[RecorderEvent]):
    """What was told; `on_event` is `append`."""

    @property
    def kinds(self) -> list[str]:
        return [event.kind for event in self]

    def only(self, kind: str) -> RecorderEvent:
        (event,) = [event for event in self if event.kind == kind]
        return event


# All bytes


def test_all_bytes_are_recorded_though_the_port_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    with plugged() as (device, port):
        recorder = port.record(path)
        device.write(RAW)
        arrived(port, len(RAW))
        recorder.close()
        assert recorder.closed
        assert recorder.error is None
        status = recorder.status
        assert waiting(port) == len(RAW)
        assert content(collect(port, len(FRAMES))) == content(FRAMES)
    assert recorded(path) == RAW
    assert content(canser.read(path)) == content(FRAMES)
    assert status.bytes_in == status.bytes_recorded == status.stats.bytes_in == len(RAW)
    assert (status.bytes_lost, status.gaps, status.bytes_unsure) == (0, 0, 0)
    assert (status.files, status.files_kept) == (1, (str(path),))
    assert (status.file, status.last_file, status.recording) == ("", str(path), False)
    assert canser.info(path).protocol == "seeed"


def test_bytes_that_come_while_the_file_is_made_are_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with plugged() as (device, port):
        start = RecordingFiles.start

        def slow_start(files: RecordingFiles, now_ns: int) -> None:
            device.write(RAW[:1000])
            arrived(port, 1000)
            start(files, now_ns)

        monkeypatch.setattr(RecordingFiles, "start", slow_start)
        with port.record(tmp_path / "run.pcapng") as recorder:
            taken(recorder, 1000)
    assert recorded(tmp_path / "run.pcapng") == RAW[:1000]


def test_bytes_before_the_call_are_not_recorded(tmp_path: Path) -> None:
    with plugged() as (device, port):
        device.write(RAW)
        arrived(port, len(RAW))
        with port.record(tmp_path / "run.pcapng"):
            device.write(RAW[:1000])
            arrived(port, len(RAW) + 1000)
        assert content(collect(port, len(FRAMES)))[: len(FRAMES)] == content(FRAMES)
    assert recorded(tmp_path / "run.pcapng") == RAW[:1000]


def test_two_recordings_of_one_port_have_all_bytes_each(tmp_path: Path) -> None:
    with plugged() as (device, port):
        one = port.record(tmp_path / "one.pcapng")
        device.write(RAW[:1000])
        arrived(port, 1000)
        two = port.record(tmp_path / "two.pcapng", size="100k")
        device.write(RAW[1000:])
        arrived(port, len(RAW))
        one.close()
        two.close()
    assert recorded(tmp_path / "one.pcapng") == RAW
    assert b"".join(recorded(path) for path in sorted(tmp_path.glob("two-*"))) == RAW[1000:]


def test_what_is_read_and_what_is_recorded_are_the_same(tmp_path: Path) -> None:
    with plugged() as (device, port), port.record(tmp_path / "run.pcapng"):
        device.feed(RAW * 3)
        read = collect(port, 3 * len(FRAMES))
    assert np.array_equal(words(read), words(canser.read(tmp_path / "run.pcapng")))
    assert recorded(tmp_path / "run.pcapng") == RAW * 3


def test_the_ring_of_the_port_overflows_and_the_recording_is_complete(tmp_path: Path) -> None:
    path, sent = tmp_path / "run.pcapng", RAW * (5_000_000 // len(RAW))
    with plugged(line=SMALL) as (device, port):
        recorder = port.record(path)
        write_to(device, sent, recorder._ring)
        recorder.close()
        status = recorder.status
        assert (status.bytes_lost, status.gaps) == (0, 0)
        assert status.bytes_recorded == len(sent)
        assert port.bytes_lost == len(sent) - waiting(port) > 4_000_000
        assert len(port.take_gaps()) == 0  # not read yet
        port.read_batch(max_frames=20_000, min_frames=0)
        assert [gap.reason for gap in port.take_gaps()] == ["overflow"]
    whole = recorded(path) == sent
    assert whole
    rounds = len(sent) // len(RAW)
    assert np.array_equal(words(canser.read(path)), np.tile(words(FRAMES), (rounds, 1)))


@takes_long
def test_a_minute_at_2_mbaud_without_a_read(tmp_path: Path) -> None:
    """Its own ring holds 40 s of it."""
    path, copy = tmp_path / "run.pcapng", tmp_path / "sent.bin"
    with (
        copy.open("wb") as file,
        Simulator(
            "seeed",
            FRAMES,
            loop=True,
            pace="line",
            baudrate=2_000_000,
            link=str(tmp_path / "dev"),
            copy=file,
        ),
        canser.open(str(tmp_path / "dev"), "seeed") as port,
    ):
        with port.record(path) as recorder:
            threading.Event().wait(60)
        status = recorder.status
        assert port.bytes_lost > 0
    assert (status.bytes_lost, status.gaps, status.stats.bytes_skipped) == (0, 0, 0)
    sent, got = copy.read_bytes(), recorded(path)
    assert status.bytes_recorded == len(got) > 11_000_000
    whole = sent.startswith(got)
    assert whole
    frames = canser.read(path)
    assert len(frames) == status.stats.frames > 800_000
    rounds = -(-len(frames) // len(FRAMES))
    assert np.array_equal(words(frames), np.tile(words(FRAMES), (rounds, 1))[: len(frames)])


# A slow disk


class Disk:
    """A disk of which the test says when it takes what is written."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, path: Path) -> None:
        self._path = path
        self.full = False
        self._ready, self.waits = threading.Event(), threading.Event()
        self._ready.set()
        for name in {"fsync", "fdatasync"} & set(dir(os)):
            monkeypatch.setattr(os, name, self._slow(getattr(os, name)))
        monkeypatch.setattr(os, "write", self._full(os.write))

    def _is_file(self, fd: int) -> bool:
        return self._path.exists() and os.path.samestat(os.fstat(fd), self._path.stat())

    def _slow(self, sync: Any) -> Any:
        def slow(fd: int) -> None:
            if self._is_file(fd):
                self.waits.set()
                assert self._ready.wait(PATIENCE)
            sync(fd)

        return slow

    def _full(self, write: Any) -> Any:
        def full(fd: int, data: Any) -> int:
            if self.full and self._is_file(fd):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            count: int = write(fd, data)
            return count

        return full

    def stop(self) -> None:
        """Take nothing more; `waits` is set once something is to be written."""
        self.waits.clear()
        self._ready.clear()

    def go_on(self) -> None:
        self._ready.set()


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Disk]:
    made = Disk(monkeypatch, tmp_path / "run.pcapng")
    yield made
    made.go_on()


def test_a_slow_disk_loses_bytes_of_the_recording_only(tmp_path: Path, disk: Disk) -> None:
    events = Events()
    with plugged(line=SMALL) as (device, port):
        reader = Background(lambda: collect(port, 30 * len(FRAMES)))
        recorder = port.record(tmp_path / "run.pcapng", on_event=events.append)
        disk.stop()
        write_to(device, RAW, port._ring, recorder._ring)
        assert disk.waits.wait(PATIENCE)
        write_to(device, RAW * 28, port._ring)
        until(lambda: recorder._ring.lost)
        disk.go_on()
        until(lambda: not len(recorder._ring))
        write_to(device, RAW, port._ring, recorder._ring)
        frames = reader.join().result
        assert isinstance(frames, np.ndarray), reader.error
        recorder.close()
        status = recorder.status
        assert port.bytes_lost == 0
        assert port.take_gaps() == []
    assert np.array_equal(words(frames), np.tile(words(FRAMES), (30, 1)))
    gap = events.only("gap")
    assert (gap.reason, gap.lost) == ("overflow", status.bytes_lost)
    assert f"gap: {gap.lost:,} bytes are lost" in gap.text
    assert 0 < status.bytes_lost == 30 * len(RAW) - status.bytes_recorded
    assert status.gaps == 1
    assert lost_in(tmp_path / "run.pcapng") == [status.bytes_lost]
    got, at = recorded(tmp_path / "run.pcapng"), gap.offset
    assert got[:at] == (RAW * 30)[:at]
    assert got[at:] == (RAW * 30)[at + gap.lost :]
    with pytest.warns(canser.CanserWarning, match=f"gaps .*: 1, bytes lost: {gap.lost:,}"):
        canser.read(tmp_path / "run.pcapng")


# Bytes that are lost at the end, and that none follow


def overfill(device: Device, *rings: Ring) -> None:
    """Send more than small rings hold."""
    device.feed(RAW)
    device.fed()
    until(lambda: not device.waiting() and all(ring.lost for ring in rings))
    until(lambda: all(len(ring) + ring.lost == len(RAW) for ring in rings))


def test_bytes_lost_at_the_end_are_told_and_given() -> None:
    calls: list[tuple[bytes, int, int]] = []
    options: Any = {"on_bytes": lambda data, ns, lost: calls.append((bytes(data), ns, lost))}
    with plugged(line=SMALL, **options) as (device, port):
        overfill(device, port._ring)
        begin, lost = port._clock(), port.bytes_lost
        device.unplug()
        frames: list[FrameArray] = []
        with pytest.raises(canser.PortGoneError):
            frames.extend(port.batches())
        with pytest.raises(canser.PortGoneError):
            port.read_batch()
        (gap,) = port.take_gaps()
    assert (gap.offset, gap.lost, gap.reason) == (SMALL.ring_size, lost, "overflow")
    assert lost == len(RAW) - SMALL.ring_size
    assert calls[-1] == (b"", calls[-1][1], lost)
    assert [call[2] for call in calls[:-1]] == [0] * (len(calls) - 1)
    assert b"".join(call[0] for call in calls) == RAW[: SMALL.ring_size]
    assert calls[-2][1] <= calls[-1][1] <= begin
    assert sum(map(len, frames)) == len(canser.decode(RAW[: SMALL.ring_size], "seeed"))


def test_an_interruption_at_the_end_is_given() -> None:
    """As is a gap of unknown length, with the bytes that were lost before it."""
    calls: list[tuple[bytes, int]] = []
    options: Any = {"on_bytes": lambda data, _, lost: calls.append((bytes(data), lost))}
    with plugged(**options) as (device, port):
        port._ring.lose(5, 1)
        port._ring.interrupt(2, "reconnect")
        device.unplug()
        with pytest.raises(canser.PortGoneError):
            port.read_batch()
        assert [gap.lost for gap in port.take_gaps()] == [5, -1]
    assert calls == [(b"", -1)]


@pytest.mark.parametrize("end", ["recorder", "port", "device"])
def test_bytes_lost_at_the_end_are_in_the_file(tmp_path: Path, disk: Disk, end: str) -> None:
    path, events = tmp_path / "run.pcapng", Events()
    with plugged(line=SMALL) as (device, port):
        recorder = port.record(path, on_event=events.append)
        disk.stop()
        write_to(device, RAW[:1000], recorder._ring)
        assert disk.waits.wait(PATIENCE)
        device.write(RAW[1000:])
        device.write(RAW)
        until(lambda: not device.waiting())
        until(lambda: len(recorder._ring) + recorder._ring.lost >= 2 * len(RAW) - 1000)
        if end == "device":
            device.unplug()
        disk.go_on()
        {"recorder": recorder.close, "port": port.close}.get(end, lambda: None)()
        until(lambda: recorder.closed)
        status = recorder.status
    lost = status.bytes_lost
    assert lost == 2 * len(RAW) - status.bytes_recorded > 0
    assert recorded(path) == (RAW * 2)[: status.bytes_recorded]
    assert lost_in(path) == [lost]
    gap = events.only("gap")
    assert (gap.lost, gap.offset, gap.reason) == (lost, status.bytes_in, "overflow")
    assert (status.gaps, status.gaps_unknown) == (1, 0)
    with pytest.warns(canser.CanserWarning, match=f"gaps .*: 1, bytes lost: {lost:,}"):
        canser.read(path)


# Triggers


def frame(number: int, *, err: bool = False) -> FrameArray:
    return array(Frame(number, dlc=8, data=bytes(range(8)), err=err, ts=0))


def later(port: canser.Port, ms: int = 10) -> None:
    """Wait until a time has passed on the port's clock."""
    end = port._clock() + ms * 1_000_000
    until(lambda: port._clock() > end)


def test_a_trigger_by_id_without_a_reader(tmp_path: Path) -> None:
    events = Events()
    plain, wanted = canser.encode(frame(0x100), "seeed") * 20, canser.encode(frame(0x7AB), "seeed")
    with plugged() as (device, port):
        options: Any = {"triggers": "7AB", "before": 0, "after": 0}
        with port.record(tmp_path / "e.pcapng", on_event=events.append, **options) as recorder:
            assert not recorder.status.recording
            for number in range(2):
                device.write(plain)
                taken(recorder, len(plain + wanted) * number + len(plain))
                later(port)
                device.write(wanted)
                taken(recorder, len(plain + wanted) * (number + 1))
                later(port)
            assert not waiting(port) < 2 * len(plain + wanted)
        status = recorder.status
    assert [recorded(path) for path in sorted(tmp_path.iterdir())] == [wanted, wanted]
    assert (status.triggers, status.files) == (2, 2)
    assert status.bytes_passed == 2 * len(plain)
    assert status.bytes_recorded == 2 * len(wanted)
    assert status.bytes_in == status.bytes_passed + status.bytes_recorded
    assert events.kinds == ["trigger", "opened", "closed"] * 2
    assert [event.path for event in events if event.kind != "trigger"] == [
        path for name in status.files_kept for path in (name, name)
    ]
    assert abs(events[0].ts - port._clock()) < PATIENCE * 1e9
    assert events[0].text.startswith("trigger at ")


def test_before_and_after_a_trigger(tmp_path: Path) -> None:
    plain, wanted = canser.encode(frame(0x100), "seeed") * 20, canser.encode(frame(0x7AB), "seeed")
    with plugged() as (device, port):
        options: Any = {"triggers": ["7AB", "error"], "before": "1h", "after": "1h"}
        with port.record(tmp_path / "e.pcapng", **options) as recorder:
            device.write(plain)
            taken(recorder, len(plain))
            assert recorder.status.file == ""
            device.write(wanted)
            until(lambda: recorder.status.recording)
            device.write(plain)
            arrived(port, len(plain + wanted + plain))
    assert recorded(tmp_path / "e-000001.pcapng") == plain + wanted + plain
    assert recorder.status.bytes_passed == 0


def test_an_error_frame_is_a_trigger(tmp_path: Path) -> None:
    good, bad = (canser.encode(frame(4, err=err), "serial") for err in (False, True))
    with plugged("serial") as (device, port):
        options: Any = {"triggers": "error", "before": 0, "after": 0}
        with port.record(tmp_path / "e.pcapng", **options) as recorder:
            device.write(good)
            taken(recorder, len(good))
            later(port)
            device.write(bad)
            taken(recorder, len(good + bad))
    assert recorder.status.triggers == 1
    (found,) = canser.read(tmp_path / "e-000001.pcapng")
    assert found["err"]


def test_an_error_that_the_adapter_reports_is_a_trigger(tmp_path: Path) -> None:
    events = Events()
    raw = bytes.fromhex("246111 FFFF0107")
    with plugged("cantalope") as (device, port):
        options: Any = {"triggers": "error", "on_event": events.append}
        with port.record(tmp_path / "e.pcapng", **options) as recorder:
            device.write(raw)
            taken(recorder, len(raw))
    assert recorded(tmp_path / "e-000001.pcapng") == raw
    assert events.kinds == ["error", "trigger", "opened", "closed"]
    assert events[0].number == 7
    assert events[0].text == "the adapter reports error 7"
    assert events[0].ts == events[1].ts


def test_a_reported_error_is_told_where_it_is_no_trigger(tmp_path: Path) -> None:
    events = Events()
    with plugged("cantalope") as (device, port):
        with port.record(tmp_path / "run.pcapng", on_event=events.append) as recorder:
            device.write(bytes.fromhex("246111 FFFF0107"))
            taken(recorder, 7)
        assert port.read_batch(timeout=PATIENCE)["id"].tolist() == [0x123]
        assert len(port.take_controls()) == 1  # the recorder has taken its own only
    assert events.kinds == ["opened", "error", "closed"]


# Ends


def test_events_come_by_the_thread_of_the_recorder(tmp_path: Path) -> None:
    threads = []
    with plugged() as (_, port):
        with port.record(
            tmp_path / "run.pcapng", on_event=lambda _: threads.append(threading.current_thread())
        ) as recorder:
            until(lambda: threads)
        assert {thread.name for thread in threads} == {"canser recorder"}
        assert len(threads) == 2
        assert not recorder._reader._more_rings


def test_the_recording_ends_with_the_port(tmp_path: Path) -> None:
    with plugged() as (device, port):
        recorder = port.record(tmp_path / "run.pcapng")
        device.write(RAW)
        arrived(port, len(RAW))
        port.close()
        assert recorder.closed
        assert recorder.error is None
        recorder.close()
    assert recorded(tmp_path / "run.pcapng") == RAW
    assert canser.info(tmp_path / "run.pcapng").frames == len(FRAMES)
    with pytest.raises(canser.PortClosedError):
        port.record(tmp_path / "two.pcapng")
    assert [path.name for path in tmp_path.iterdir()] == ["run.pcapng"]


def test_the_recording_ends_with_the_device(tmp_path: Path) -> None:
    with plugged() as (device, port):
        with port.record(tmp_path / "run.pcapng") as recorder:
            device.write(RAW)
            arrived(port, len(RAW))
            device.unplug()
            until(lambda: recorder.closed)
            assert isinstance(recorder.error, canser.PortGoneError)
            assert str(recorder.error).startswith(f"{device.url} is gone")
            assert recorded(tmp_path / "run.pcapng") == RAW
        assert content(collect(port, len(FRAMES))) == content(FRAMES)
        with pytest.raises(canser.PortGoneError, match=f"{device.url} is gone"):
            port.record(tmp_path / "two.pcapng")
        assert [path.name for path in tmp_path.iterdir()] == ["run.pcapng"]
        assert not port._reader._more_rings
    recorder.close()


def test_the_recording_goes_on_with_a_device_that_comes_back(tmp_path: Path) -> None:
    events, link = Events(), tmp_path / "dev"
    with Device(link) as device, canser.open(str(link), "seeed", reconnect=True) as port:
        recorder = port.record(tmp_path / "run.pcapng", on_event=events.append)
        device.write(RAW)
        arrived(port, len(RAW))
        device.unplug()
        until(lambda: recorder.status.away)
        with Device(link) as again:
            again.write(RAW)
            arrived(port, 2 * len(RAW))
            until(lambda: not recorder.status.away)
            recorder.close()
        assert (recorder.status.gaps, recorder.status.gaps_unknown) == (1, 1)
    assert recorded(tmp_path / "run.pcapng") == RAW + RAW
    assert lost_in(tmp_path / "run.pcapng") == [-1]
    gap = events.only("gap")
    assert (gap.offset, gap.lost, gap.reason) == (len(RAW), -1, "reconnect")
    assert gap.text.endswith(f"the device was gone; waiting for {link}")
    assert events.kinds == ["opened", "gap", "back", "closed"]
    assert events.only("back").text == f"{link} is back"


def test_a_full_disk_ends_the_recording_and_the_port_goes_on(tmp_path: Path, disk: Disk) -> None:
    with plugged() as (device, port):
        recorder = port.record(tmp_path / "run.pcapng")
        device.write(RAW[:10_000])
        until(lambda: recorder.status.bytes_recorded > 9_900)  # whole frames
        disk.full = True

        def fill() -> None:
            device.write(RAW[10_000:])
            until(lambda: recorder.closed)

        with pytest.warns(canser.CanserWarning, match=f"{device.url}: STOPPED: .*run.pcapng"):
            fill()
        assert isinstance(recorder.error, OSError)
        assert recorder.error.errno == errno.ENOSPC
        with pytest.raises(OSError, match="what was written is good, the last") as raised:
            recorder.close()
        assert raised.value is recorder.error
        recorder.close()
        status = recorder.status
        assert content(collect(port, len(FRAMES))) == content(FRAMES)
        assert port.bytes_lost == 0
    got = recorded(tmp_path / "run.pcapng")
    assert RAW.startswith(got)
    assert len(got) == status.bytes_recorded > 9_900
    assert f"the last {status.bytes_in - len(got):,} bytes are not in it" in str(recorder.error)


def test_a_full_disk_is_an_event_where_events_are_taken(tmp_path: Path, disk: Disk) -> None:
    events = Events()
    with plugged() as (device, port):
        recorder = port.record(tmp_path / "run.pcapng", on_event=events.append)
        disk.full = True
        device.write(RAW)
        until(lambda: recorder.closed)
        assert events.kinds == ["opened", "closed", "warning"]
        assert events[-1].text == f"{device.url}: {recorder.error}"
        port.close()  # raises nothing
        with pytest.raises(OSError, match="No space left"):
            recorder.close()


def test_a_file_that_cannot_be_made(tmp_path: Path, disk: Disk) -> None:
    disk.full = True
    with plugged() as (_, port):
        for _ in range(2):
            with pytest.raises(OSError, match=r"STOPPED: .*No space left.*; nothing is recorded"):
                port.record(tmp_path / "run.pcapng")
        assert list(tmp_path.iterdir()) == []
        assert not port._reader._more_rings
        assert not port._recorders


def record_all(device: Device, port: canser.Port, path: Path, on_event: Any) -> None:
    """Record what the device sends."""
    with port.record(path, on_event=on_event) as recorder:
        device.write(RAW)
        arrived(port, len(RAW))
    assert recorder.error is None


@pytest.mark.parametrize("error", [ZeroDivisionError("no"), SystemExit(3)], ids=repr)
def test_an_event_that_is_not_taken_is_a_warning(tmp_path: Path, error: BaseException) -> None:
    def fail(_: RecorderEvent) -> None:
        raise error

    text = f"on_event failed: {type(error).__name__}: {error}"
    with plugged() as (device, port), pytest.warns(canser.CanserWarning, match=text):
        record_all(device, port, tmp_path / "run.pcapng", fail)
    assert recorded(tmp_path / "run.pcapng") == RAW


@pytest.mark.filterwarnings("error::canser.CanserWarning")
def test_where_warnings_are_errors_close_raises_them_once(tmp_path: Path) -> None:
    def fail(_: RecorderEvent) -> None:
        raise ZeroDivisionError("no")

    with plugged() as (device, port):
        recorder = port.record(tmp_path / "run.pcapng", on_event=fail)
        device.write(RAW)
        arrived(port, len(RAW))
        with pytest.raises(canser.CanserWarning, match="on_event failed: ZeroDivisionError: no"):
            recorder.close()
        recorder.close()
        assert recorder.error is None
    assert recorded(tmp_path / "run.pcapng") == RAW


ERROR = bytes.fromhex("FFFF0107")  # as cantalope reports one: an event in any recorder


@pytest.mark.parametrize("what", ["port", "own", "other"])
def test_an_event_may_close_all(tmp_path: Path, what: str) -> None:
    """And two recorders each other, at the same time."""
    things: dict[str, canser.Port | Recorder] = {}
    both = threading.Barrier(2)

    def close(event: RecorderEvent, own: str, other: str) -> None:
        if event.kind == "error":
            both.wait(PATIENCE)
            things[{"own": own, "other": other}.get(what, what)].close()
            both.wait(PATIENCE)

    with plugged("cantalope") as (device, port):
        things["port"] = port
        for own, other in (("one", "two"), ("two", "one")):
            things[own] = port.record(
                tmp_path / f"{own}.pcapng",
                on_event=lambda event, own=own, other=other: close(event, own, other),  # type: ignore[misc]
            )
        device.write(ERROR)
        until(lambda: all(things[name].closed for name in ("one", "two")))
        assert port.closed == (what == "port")
    for name in ("one", "two"):
        assert recorded(tmp_path / f"{name}.pcapng") == ERROR


@pytest.mark.parametrize("held", ["_rings_lock", "_line_lock", "port's", "recorder's"])
def test_a_close_in_the_middle_of_anything_waits_for_nothing(tmp_path: Path, held: str) -> None:
    """As a signal handler comes while its own thread holds a lock."""
    with plugged() as (device, port):
        recorder = port.record(tmp_path / "run.pcapng")
        device.write(RAW)
        arrived(port, len(RAW))
        lock = {"port's": port._ring._lock, "recorder's": recorder._ring._lock}.get(held)
        with lock or getattr(port._reader, held):
            port.close()
        port.close()  # where there is time to wait
        assert recorder.closed
    assert recorded(tmp_path / "run.pcapng") == RAW


def test_a_signal_handler_closes_the_port_at_any_time(tmp_path: Path) -> None:
    main, random_time = threading.get_ident(), random.Random(1)
    with Device() as device:
        for number in range(20):
            port = canser.open(device.url, "seeed")
            before = signal.signal(signal.SIGUSR1, lambda *_, port=port: port.close())

            def interrupt(seconds: float = random_time.uniform(0, 0.02)) -> None:
                threading.Event().wait(seconds)
                signal.pthread_kill(main, signal.SIGUSR1)

            try:
                interrupter = Background(interrupt)
                device.feed(RAW[:10_000])
                with contextlib.suppress(canser.PortClosedError), port:
                    recorder = port.record(tmp_path / f"{number}.pcapng")
                    for _ in port.batches():
                        pass
                    port.close()
                    assert recorder.closed
                    assert recorder.error is None
                interrupter.join()
                until(lambda port=port: port.closed)  # type: ignore[misc]
            finally:
                signal.signal(signal.SIGUSR1, before)
            device.fed()
            until(lambda: not any(t.name == "canser recorder" for t in threading.enumerate()))
    for path in tmp_path.iterdir():
        recorded(path)


def test_two_threads_close_at_once(tmp_path: Path) -> None:
    with plugged() as (device, port):
        recorder = port.record(tmp_path / "run.pcapng")
        device.write(RAW)
        arrived(port, len(RAW))
        calls = [Background(call) for call in (recorder.close, port.close, recorder.close)]
        for call in calls:
            assert call.join().error is None
            assert recorder.closed
    assert recorded(tmp_path / "run.pcapng") == RAW


def test_a_port_that_is_forgotten_ends_its_recording(tmp_path: Path) -> None:
    with Device() as device:
        ports = [canser.open(device.url, "seeed")]
        recorder = ports[0].record(tmp_path / "run.pcapng")
        device.write(RAW)
        arrived(ports[0], len(RAW))
        with pytest.warns(ResourceWarning, match="unclosed <canser.Port"):
            ports.clear()
        until(lambda: recorder.closed)
        assert recorder.error is None
        recorder.close()
    assert recorded(tmp_path / "run.pcapng") == RAW


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_a_child_does_not_end_the_recording(tmp_path: Path) -> None:
    with plugged() as (device, port), port.record(tmp_path / "run.pcapng") as recorder:
        device.write(RAW[:1000])
        arrived(port, 1000)
        child = os.fork()
        if not child:
            port.close()
            recorder.close()
            os._exit(0)
        until(lambda: os.waitpid(child, os.WNOHANG)[0])
        device.write(RAW[1000:])
        arrived(port, len(RAW))
    assert recorded(tmp_path / "run.pcapng") == RAW


# Ends without having closed anything, in the middle of a function.
FORGETFUL = """
import sys, time, canser
url, path, sent = sys.argv[1:]
def work():
    port = canser.open(url, "seeed")
    recorder = port.record(path)
    print("go", flush=True)
    while recorder.status.bytes_recorded < int(sent):
        time.sleep(0.01)
    time.sleep(1.5)  # as often as the file is written through
    keep.append((port, recorder, port.batches()))
    raise SystemExit(5)
keep = []
work()
"""


def test_the_end_of_the_program_does_not_wait_for_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    with Device() as device:
        program = subprocess.Popen(
            [sys.executable, "-c", FORGETFUL, device.url, str(path), str(len(RAW))],
            stdout=subprocess.PIPE,
        )
        with program:
            assert program.stdout is not None
            assert program.stdout.readline() == b"go\n"
            device.write(RAW, lambda: program.poll() is not None)
            assert program.wait(PATIENCE) == 5
    with Recording(path) as recording:
        got = b"".join(bytes(piece.data) for piece in recording)
        assert recording.remarks == []
    assert got == RAW
