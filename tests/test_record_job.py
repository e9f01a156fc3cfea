"""`canser.record`, the whole job: what it is asked for, what it tells, how it ends."""

import os
import re
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import canser
import canser.live.recording
import canser.recording.rotation
from canser.live.recording import RecorderEvent, RecorderStatus, RecordingJob
from canser.recording.reader import Recording
from canser.simulation.traffic import vehicle
from device import PATIENCE, Device, descriptors, until
from readers import Background, content

FRAMES = vehicle(3)
RAW = canser.encode(FRAMES, "seeed")


@pytest.fixture
def device() -> Iterator[Device]:
    with Device() as made:
        yield made


def recorded(path: Path) -> bytes:
    """Return the bytes of the line in a recording that has no faults."""
    with Recording(path) as recording:
        raw = b"".join(bytes(piece.data) for piece in recording)
        assert recording.remarks == []
    return raw


class Job:
    """`canser.record` in a thread, with what it tells."""

    def __init__(self, device: Device, path: Path, **options: Any) -> None:
        self.events: list[RecorderEvent] = []
        self.statuses: list[RecorderStatus] = []
        self.stop = threading.Event()
        told: dict[str, Any] = {
            "stop": self.stop.is_set,
            "on_event": self.events.append,
            "on_status": self.statuses.append,
        }
        self.call = Background(lambda: canser.record(device.url, "seeed", path, **(told | options)))

    @property
    def kinds(self) -> list[str]:
        return [event.kind for event in self.events]

    def taken(self, count: int) -> None:
        """Wait until so many bytes are taken."""
        until(lambda: not self.call.running or self._count() >= count)
        assert self.call.running, self.call.error

    def _count(self) -> int:
        return self.statuses[-1].bytes_in if self.statuses else 0

    def end(self) -> RecorderStatus:
        """End it, and return its result."""
        self.stop.set()
        result = self.call.join().result
        assert isinstance(result, RecorderStatus), self.call.error
        return result


# Arguments

WRONG_FILES: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"size": 99_999}, ValueError, "the size 99999 is too small for a file; give 100k or more"),
    ({"size": "99k"}, ValueError, "the size 99k is too small for a file; give 100k or more"),
    ({"size": "100X"}, ValueError, "cannot read the size '100X'; write 500k, 100M or 1G"),
    ({"size": 1e6}, TypeError, "size is 1000000.0; it must be an integer, such as '100M'"),
    ({"size": True}, TypeError, "size is True; it must be an integer, such as '100M'"),
    ({"time": 0}, ValueError, "time is 0; it must be more than 0 seconds"),
    ({"time": "0s"}, ValueError, "time is 0; it must be more than 0 seconds"),
    ({"time": 1e-10}, ValueError, "time is 1e-10; it must be more than 0 seconds"),
    ({"time": -1}, ValueError, "time is -1; it must be 0 to 8,640,000,000 seconds"),
    ({"time": float("nan")}, ValueError, "time is nan; it must be 0 to 8,640,000,000 seconds"),
    ({"time": float("inf")}, ValueError, "time is inf; it must be 0 to"),
    ({"time": "soon"}, ValueError, "time: cannot read the time 'soon'; write 500ms, 5s, 10m"),
    ({"time": b"1h"}, TypeError, "time is b'1h'; it must be a number, such as 10 or '10s'"),
    ({"keep": 0, "size": "1M"}, ValueError, "keep is 0; it must be 1 or more"),
    ({"keep": 2.5, "size": "1M"}, TypeError, "keep is 2.5; it must be an integer, such as 20"),
    ({"keep": 2}, ValueError, "keep is about rotation; to rotate files give their size or time"),
    ({"triggers": 0x123}, TypeError, "triggers is 291; it must be a filter or several, such as"),
    ({"triggers": None}, TypeError, "triggers is None; it must be a filter or several"),
    ({"triggers": [5]}, TypeError, "a trigger is 5; it must be a string, such as '123' or 'error'"),
    ({"triggers": "wrong"}, ValueError, "cannot read the filter 'wrong'"),
    ({"triggers": ["123", ""]}, ValueError, "cannot read the filter ''"),
    ({"before": 1}, ValueError, "before and after are about a trigger; name one in triggers"),
    ({"after": "1s"}, ValueError, "before and after are about a trigger; name one in triggers"),
    ({"triggers": "123", "before": -1}, ValueError, "before is -1; it must be 0 to"),
    ({"triggers": "123", "before": "x"}, ValueError, "before: cannot read the time 'x'"),
    ({"triggers": "123", "after": 1e300}, ValueError, "after is 1e"),
    ({"triggers": "123", "after": False}, TypeError, "after is False; it must be a number"),
    ({"force": "no"}, TypeError, "force is 'no'; it must be True or False"),
]


@pytest.mark.parametrize(("options", "kind", "text"), WRONG_FILES, ids=str)
def test_wrong_files(
    device: Device, tmp_path: Path, options: Any, kind: type[Exception], text: str
) -> None:
    text = "^" + re.escape(text)
    before = descriptors()
    if options != {"keep": 2}:  # the files find this one
        with pytest.raises(kind, match=text):
            canser.RecordConfig(**options)
    with pytest.raises(kind, match=text):
        canser.record(device.url, "seeed", tmp_path / "run.pcapng", **options)
    assert descriptors() == before
    with canser.open(device.url, "seeed") as port:
        with pytest.raises(kind, match=text):
            port.record(tmp_path / "run.pcapng", **options)
        assert not port._reader._more_rings
    assert list(tmp_path.iterdir()) == []


def test_values_are_kept_as_numbers() -> None:
    config = canser.RecordConfig(
        size="1.5M", time="2h", keep=3, triggers="123", before="500ms", after=2
    )
    assert (config.size, config.time, config.keep) == (1_500_000, 7200.0, 3)
    assert (config.triggers, config.before, config.after) == (("123",), 0.5, 2.0)
    assert config == canser.RecordConfig(
        size=1_500_000, time=7200, keep=3, triggers=["123"], before=0.5, after="2s"
    )


@pytest.mark.parametrize("name", ["sizes", "path_", "on_bytes", "device_time", "config_"])
def test_an_option_that_there_is_not(device: Device, tmp_path: Path, name: str) -> None:
    options: Any = {name: None}
    with pytest.raises(TypeError, match=f"unexpected keyword argument '{name}'"):
        canser.record(device.url, "seeed", tmp_path / "run.pcapng", duration=0, **options)
    with (
        canser.open(device.url, "seeed") as port,
        pytest.raises(TypeError, match=f"unexpected keyword argument '{name}'"),
    ):
        port.record(tmp_path / "run.pcapng", **options)
    assert list(tmp_path.iterdir()) == []


WRONG_CALLS: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"duration": "10s"}, TypeError, "duration is '10s'; it must be a number of seconds"),
    ({"duration": float("nan")}, ValueError, "duration is nan; it must be a number"),
    ({"stop": 0}, TypeError, "it must be a function of nothing"),
    ({"on_event": "log"}, TypeError, "on_event is 'log'; it must be a function of an event"),
    ({"on_status": 1}, TypeError, "on_status is 1; it must be a function of a status"),
    ({"bus_bitrate": "500k"}, TypeError, "bus_bitrate is '500k'; it must be an integer"),
    ({"bus_bitrate": 0}, ValueError, "bus_bitrate is 0; it must be 1 or more"),
    ({"line": 2_000_000}, TypeError, "line is 2000000; it must be a canser.LineConfig"),
    ({"config": 500_000}, TypeError, "config is 500000; it must be a canser.AdapterConfig"),
    ({"bitrate": 123}, ValueError, "123"),
    ({"ts_unit": "m"}, ValueError, "unknown ts_unit 'm'; have"),
    ({"reconnect": 1}, TypeError, "reconnect is 1; it must be True or False"),
    ({"url": 5}, TypeError, "url is 5; it must be a string"),
    ({"protocol": "sead"}, ValueError, "unknown protocol 'sead'"),
    ({"path": 5}, TypeError, "path is 5; it must be a string, such as 'run.pcapng'"),
    ({"path": b"run.pcapng"}, TypeError, "path is b'run.pcapng'; it must be a string"),
]


@pytest.mark.parametrize(("options", "kind", "text"), WRONG_CALLS, ids=str)
def test_wrong_calls(
    device: Device, tmp_path: Path, options: Any, kind: type[Exception], text: str
) -> None:
    before = descriptors()
    plain = {"url": device.url, "protocol": "seeed", "path": tmp_path / "run.pcapng"}
    with pytest.raises(kind, match=re.escape(text)):
        canser.record(**(plain | options))
    assert descriptors() == before
    assert list(tmp_path.iterdir()) == []
    assert not device.hears()


@pytest.mark.parametrize("options", [{"on_event": 5}, {"path": 5}], ids=str)
def test_wrong_calls_of_a_port(device: Device, tmp_path: Path, options: Any) -> None:
    with (
        canser.open(device.url, "seeed") as port,
        pytest.raises(TypeError, match=f"{next(iter(options))} is 5; it must be a"),
    ):
        port.record(**({"path": tmp_path / "run.pcapng"} | options))


def test_paths_that_will_not_do(device: Device, tmp_path: Path) -> None:
    there = tmp_path / "run.pcapng"
    there.write_text("old")
    wrong: list[tuple[Path, type[Exception]]] = [
        (there, canser.OutputExistsError),
        (tmp_path / "run.bin", ValueError),
        (tmp_path / "nowhere" / "run.pcapng", FileNotFoundError),
    ]
    with canser.open(device.url, "seeed") as port:
        for path, kind in wrong:
            with pytest.raises(kind):
                port.record(path)
        assert not port._reader._more_rings
    for path, kind in wrong:
        with pytest.raises(kind):
            canser.record("/dev/no-such-port", "seeed", path)  # before the port is opened
    assert [path.name for path in tmp_path.iterdir()] == ["run.pcapng"]
    assert there.read_text() == "old"


def test_a_port_that_cannot_be_opened(device: Device, tmp_path: Path) -> None:
    with pytest.raises(canser.PortNotFoundError):
        canser.record("/dev/no-such-port", "seeed", tmp_path / "run.pcapng")
    with canser.open(device.url, "seeed"), pytest.raises(canser.PortBusyError):
        canser.record(device.url, "seeed", tmp_path / "run.pcapng")
    assert list(tmp_path.iterdir()) == []


# The job


def test_it_ends_when_stop_says_so(device: Device, tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    job = Job(device, path, bus_bitrate=500_000)
    until(lambda: job.statuses)
    device.write(RAW)
    job.taken(len(RAW))
    status = job.end()
    assert recorded(path) == RAW
    assert content(canser.read(path)) == content(FRAMES)
    assert status == job.statuses[-1]
    assert status.bytes_recorded == status.bytes_in == len(RAW)
    assert status.files_kept == (str(path),)
    assert job.kinds == ["opened", "closed"]
    assert status.rates.load is not None
    with Recording(path) as recording:
        assert recording.info.bitrate == 500_000
        assert recording.info.device == device.url


def test_it_ends_after_its_duration(device: Device, tmp_path: Path) -> None:
    begin = time.monotonic()
    status = canser.record(device.url, "seeed", tmp_path / "run.pcapng", duration=0.3)
    assert time.monotonic() - begin >= 0.3
    assert status.elapsed_s >= 0.3
    assert (status.bytes_in, status.files, status.rates.load) == (0, 1, None)
    assert recorded(tmp_path / "run.pcapng") == b""
    status = canser.record(device.url, "seeed", tmp_path / "two.pcapng", duration=0)
    assert status.files_kept == (str(tmp_path / "two.pcapng"),)


def test_a_configured_adapter_has_its_bitrate_in_the_file(device: Device, tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    canser.record(device.url, "seeed", path, duration=0, bitrate=250_000, bus_bitrate=500_000)
    assert device.hears()
    with Recording(path) as recording:
        assert recording.info.bitrate == 250_000


def test_a_line_that_is_never_quiet_ends_all_the_same(device: Device, tmp_path: Path) -> None:
    """And at the end all that was taken is in the file, and counted."""
    path, ended = tmp_path / "run.pcapng", threading.Event()

    def keep_sending() -> None:
        while not ended.is_set():
            device.write(RAW[:24_000], ended.is_set)

    job = Job(device, path)
    sender = Background(keep_sending)
    try:
        job.taken(24_000)
        status = job.end()
    finally:
        ended.set()
    sender.join()
    got = recorded(path)
    sent = RAW[:24_000] * (len(got) // 24_000 + 1)
    assert got == sent[: len(got)]
    assert len(got) == status.bytes_recorded == status.stats.bytes_in == status.bytes_in


def test_a_slow_disk_does_not_keep_it_from_its_end(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bytes come faster than they are recorded: still the end is one."""
    path, ended = tmp_path / "run.pcapng", threading.Event()

    def keep_sending() -> None:
        while not ended.is_set():
            device.write(RAW[:24_000], ended.is_set)

    step = RecordingJob.step

    def slow_step(job: RecordingJob, timeout: float) -> None:
        before = job._stream.ring._end
        if not ended.is_set() and sender.running:
            until(lambda: job._stream.ring._end >= before + 100_000)
        step(job, timeout)

    sender = Background(keep_sending)
    job = Job(device, path)
    try:
        job.taken(24_000)
        monkeypatch.setattr(RecordingJob, "step", slow_step)
        status = job.end()
    finally:
        ended.set()
    sender.join()
    assert len(recorded(path)) == status.bytes_recorded == status.stats.bytes_in


@pytest.mark.parametrize("name", ["stop", "on_event", "on_status"])
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(9, "no"), ValueError("no")], ids=repr)
def test_what_the_caller_raises_ends_it(
    device: Device, tmp_path: Path, name: str, error: Any
) -> None:
    path, calls = tmp_path / "run.pcapng", 0
    statuses: list[RecorderStatus] = []

    def fail(*_: object) -> None:
        nonlocal calls
        calls += 1
        until(lambda: not device.waiting())
        if name == "on_event" or calls == 2:
            raise error

    device.write(RAW[:2000])
    options: dict[str, Any] = {"on_status": statuses.append} | {name: fail}
    kind = error if isinstance(error, type) else type(error)
    with pytest.raises(kind) as raised:
        canser.record(device.url, "seeed", path, **options)
    assert isinstance(error, type) or raised.value is error
    assert RAW.startswith(recorded(path))
    if name != "on_status":
        assert statuses[-1].bytes_recorded == len(recorded(path))
    canser.open(device.url, "seeed").close()  # it is free


def test_a_signal_interrupts_it_at_any_time(device: Device, tmp_path: Path) -> None:
    main = threading.get_ident()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        for number in range(10):
            path = tmp_path / f"{number}.pcapng"
            sent = Background(lambda number=number: device.write(RAW[: 3000 * number]))  # type: ignore[misc]

            def interrupt(path: Path = path, wait: float = number * 0.003) -> None:
                # Not before there is a header: Python may be interrupted between the opening of a
                # file and the assignment that lets it be closed.
                until(lambda: path.exists() and path.stat().st_size > 0)
                threading.Event().wait(wait)
                signal.pthread_kill(main, signal.SIGINT)

            interrupter = Background(interrupt)
            with pytest.raises(KeyboardInterrupt):
                canser.record(device.url, "seeed", path, duration=PATIENCE)
            interrupter.join()
            if path.exists():  # not while it was made
                assert RAW.startswith(recorded(path))
            with canser.open(device.url, "seeed") as port:  # what is left
                sent.join()
                until(lambda: not device.waiting())
                port.read_batch(timeout=0.1)
    finally:
        signal.signal(signal.SIGINT, before)


def test_an_interrupt_in_the_middle_of_a_write_leaves_a_good_file(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, write, calls = tmp_path / "run.pcapng", os.write, []

    def interrupted(fd: int, data: Any) -> int:
        if path.exists() and os.path.samestat(os.fstat(fd), path.stat()):
            calls.append(fd)
            if len(calls) == 3:
                write(fd, bytes(data)[:20])
                raise KeyboardInterrupt
        return write(fd, data)

    monkeypatch.setattr(os, "write", interrupted)
    device.feed(RAW * 2)
    with pytest.raises(KeyboardInterrupt):
        canser.record(device.url, "seeed", path, duration=PATIENCE)
    monkeypatch.undo()
    with Recording(path) as recording:
        got = b"".join(bytes(piece.data) for piece in recording)
        assert recording.remarks == []
    assert got
    assert (RAW * 2).startswith(got)


def test_a_device_that_is_gone(device: Device, tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    job = Job(device, path, stop=None)
    until(lambda: job.statuses)
    device.write(RAW[:-3])
    job.taken(len(RAW) - 3)
    device.unplug()
    error = job.call.join().error
    assert isinstance(error, canser.PortGoneError)
    assert recorded(path) == RAW[:-3]
    assert job.kinds == ["opened", "closed"]
    assert job.statuses[-1].bytes_recorded == len(RAW) - 3
    assert job.statuses[-1].stats.pending == 0


def test_an_event_of_each_kind_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(canser.live.recording, "_SIZE_LEAST", 10_000)
    link = tmp_path / "dev"
    with Device(link) as device:
        job = Job(device, tmp_path / "run.pcapng", size=10_000, keep=2, reconnect=True)
        until(lambda: job.statuses)
        for count in range(1, 11):
            device.write(RAW[:5_000])
            job.taken(5_000 * count)
        Path(job.statuses[-1].file).unlink()
        until(lambda: "vanished" in job.kinds)
        device.unplug()
        until(lambda: "gap" in job.kinds)
        with Device(link) as again:
            again.write(RAW[:5_000])
            until(lambda: "back" in job.kinds)
            job.taken(55_000)
            status = job.end()
    assert {"opened", "closed", "deleted", "vanished", "gap", "back"} == set(job.kinds)
    vanished = next(event for event in job.events if event.kind == "vanished")
    assert vanished.lost == status.bytes_vanished > 0
    assert status.files_vanished == 1
    assert status.bytes_in == status.bytes_recorded + status.bytes_vanished == 55_000
    deleted = [event.path for event in job.events if event.kind == "deleted"]
    assert status.files == len(deleted) + 1 + len(status.files_kept)
    assert all(Path(path).exists() for path in status.files_kept)
    assert status.files_kept[-1] == status.last_file
    for event in job.events:
        assert event.text
        assert "\n" not in event.text


def test_an_old_file_comes_back_where_nothing_came(device: Device, tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    events: list[RecorderEvent] = []
    path.write_text("old")
    canser.record(device.url, "seeed", path, duration=0.1, force=True, on_event=events.append)
    assert path.read_text() == "old"
    assert [event.kind for event in events] == ["opened", "closed", "restored"]


def record_noise(device: Device, path: Path, **options: Any) -> Job:
    """Record what is no traffic."""
    job = Job(device, path, **options)
    until(lambda: job.statuses)
    device.write(bytes(10_000))
    job.taken(10_000)
    job.end()
    return job


def test_warnings_are_those_of_python_without_on_event(device: Device, tmp_path: Path) -> None:
    with pytest.warns(canser.CanserWarning, match=f"^{device.url}: 100% of the bytes are in no"):
        record_noise(device, tmp_path / "run.pcapng", on_event=None)


def test_warnings_are_events(device: Device, tmp_path: Path) -> None:
    job = record_noise(device, tmp_path / "run.pcapng")
    (warning,) = [event for event in job.events if event.kind == "warning"]
    assert warning.text.startswith(f"{device.url}: 100% of the bytes are in no seeed frame")
    assert abs(warning.ts - time.time_ns()) < PATIENCE * 1e9


def test_less_memory_than_a_trigger_asks_for_is_told(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(canser.recording.rotation, "MEMORY", 10_000)
    job = Job(device, tmp_path / "run.pcapng", triggers="7FF", before="1h")
    until(lambda: job.statuses)
    device.write(RAW)
    job.taken(len(RAW))
    job.end()
    (warning,) = [event for event in job.events if event.kind == "warning"]
    assert warning.text.startswith(f"{device.url}: 64 MiB are too little")
