"""The host's clock is set while a port is open: told, and new files have the new time."""

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import canser
import canser.live.stream
import canser.timing.host
from canser.live.recorder import Recorder
from canser.live.recording import RecorderEvent
from canser.recording.header import RecordingInfo
from canser.recording.reader import Recording
from canser.recording.rotation import RecordingFiles
from canser.simulation.traffic import vehicle
from canser.timing.host import ClockSteps, HostClock
from device import PATIENCE, Device, until
from readers import collect, plugged
from reference import Frame
from samples import array

# Bytes come here faster than any line has them, and so the device's clock looks too slow.
pytestmark = pytest.mark.filterwarnings("ignore:.*the device clock:canser.CanserWarning")

FRAMES = vehicle(3)
RAW = canser.encode(FRAMES, "seeed")
SECOND = 1_000_000_000
HOUR_S = 3600.0


class SystemClock:
    """The system's clock, as canser sees it; the test sets it."""

    def __init__(self) -> None:
        self.ahead_ns = 0

    def set_forward(self, seconds: float) -> None:
        self.ahead_ns += int(seconds * 1e9)

    def time_ns(self) -> int:
        return time.time_ns() + self.ahead_ns


@pytest.fixture
def system(monkeypatch: pytest.MonkeyPatch) -> SystemClock:
    made = SystemClock()
    seen = SimpleNamespace(**{name: getattr(time, name) for name in dir(time)})
    seen.time_ns = made.time_ns
    monkeypatch.setattr(canser.timing.host, "time", seen)
    monkeypatch.setattr(canser.live.stream, "_CLOCK_S", 0.0)  # look at each round
    return made


def arrivals(path: Path) -> list[int]:
    """Return when the blocks of a recording came."""
    with Recording(path) as recording:
        return [piece.arrival_ns for piece in recording]


def remarks(path: Path) -> list[str]:
    """Return what a recording tells besides its bytes."""
    with Recording(path) as recording:
        for _ in recording:
            pass
        return recording.remarks


def taken(recorder: Recorder, count: int) -> None:
    """Wait until a recorder has taken so many bytes."""
    until(lambda: recorder.status.bytes_in >= count)


def test_a_step_is_found_once(system: SystemClock) -> None:
    clock = HostClock()
    steps = ClockSteps(clock)
    assert steps.look() == 0
    for seconds in (3600.0, -3600.0, 1.5, -100_000.0):
        before = clock()
        system.set_forward(seconds)
        assert abs(clock() - before) < PATIENCE * SECOND  # it goes on as before
        assert abs(steps.look() - seconds * 1e9) < 0.1 * SECOND
        assert steps.look() == 0


def test_small_steps_are_told_when_they_are_a_second_together(system: SystemClock) -> None:
    steps = ClockSteps(HostClock())
    found = []
    for _ in range(4):
        system.set_forward(0.4)
        found.append(round(steps.look() / 1e9, 1))
    assert found == [0, 0, 1.2, 0]


@pytest.mark.parametrize(
    ("seconds", "text"), [(HOUR_S, "forward by 3,600.0 s"), (-HOUR_S, "back by 3,600.0 s")]
)
def test_a_port_warns_once_and_its_times_go_on(
    system: SystemClock, seconds: float, text: str, recwarn: pytest.WarningsRecorder
) -> None:
    with plugged() as (device, port):
        device.write(RAW)
        before = collect(port, len(FRAMES))
        system.set_forward(seconds)
        device.write(RAW)
        after = collect(port, len(FRAMES), max_frames=100)
        port.read_batch(timeout=0)
        (warning,) = recwarn.list
        assert warning.category is canser.CanserWarning
        assert str(warning.message) == (
            f"{device.url}: the host's clock was set {text} while the port is open; times go on "
            "as before; open the port again for the new time"
        )
        assert warning.filename.endswith("readers.py")  # where the port is read
        recwarn.clear()
        system.set_forward(seconds)
        port.read_batch(timeout=0)
        assert len(recwarn.list) == 1
        recwarn.clear()
        system.set_forward(-2 * seconds)
        port.read_batch(timeout=0)
        assert len(recwarn.list) == 1
        recwarn.clear()
    assert 0 <= after["ts"][0] - before["ts"][-1] < PATIENCE * SECOND


def test_small_steps_are_not_told(system: SystemClock) -> None:
    with plugged() as (device, port):
        for step in (0.5, -0.9, 0.8):
            system.set_forward(step)
            device.write(RAW)
            collect(port, len(FRAMES))


@pytest.mark.filterwarnings("error::canser.CanserWarning")
def test_where_warnings_are_errors_no_frame_is_lost(system: SystemClock) -> None:
    with plugged() as (device, port):
        device.write(RAW)
        system.set_forward(HOUR_S)
        with pytest.raises(canser.CanserWarning, match="clock was set forward"):
            collect(port, len(FRAMES))
        assert len(collect(port, len(FRAMES))) == len(FRAMES)


def test_the_clock_is_looked_at_once_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    with plugged() as (_, port):
        looks: list[int] = []

        def look() -> int:
            looks.append(1)
            return 0

        monkeypatch.setattr(port._stream.steps, "look", look)
        begin = time.monotonic()
        for _ in range(1000):
            port.read_batch(timeout=0)
        assert len(looks) <= time.monotonic() - begin + 1
        assert looks


def test_a_recording_tells_of_it(system: SystemClock, tmp_path: Path) -> None:
    """By an event and in the file; its times go on, and so do those of the port."""
    events: list[RecorderEvent] = []
    path = tmp_path / "run.pcapng"
    with plugged() as (device, port):
        recorder = port.record(path, on_event=events.append)
        device.write(RAW)
        taken(recorder, len(RAW))
        system.set_forward(HOUR_S)
        until(lambda: len(events) == 2)
        device.write(RAW)
        taken(recorder, 2 * len(RAW))
        recorder.close()
    assert [event.kind for event in events] == ["opened", "clock_set", "closed"]
    assert abs(events[1].step_ns - HOUR_S * 1e9) < SECOND
    assert events[1].text == (
        f"{device.url}: the host's clock was set forward by 3,600.0 s; times in the open file go "
        "on as before; a file that is opened later has the new time"
    )
    # Events have the time that the clock shows.
    assert abs(events[0].ts - time.time_ns()) < PATIENCE * SECOND
    assert abs(events[1].ts - system.time_ns()) < PATIENCE * SECOND
    assert abs(events[2].ts - system.time_ns()) < PATIENCE * SECOND
    times = arrivals(path)
    assert times == sorted(times)
    assert times[-1] - times[0] < PATIENCE * SECOND
    (remark,) = remarks(path)
    text = "the host's clock was set forward by 3,600.0 s; this recording goes on as before"
    assert text in remark
    with pytest.warns(canser.CanserWarning, match=text):
        frames = canser.read(path)
    assert len(frames) == 2 * len(FRAMES)


def test_without_on_event_it_is_a_warning(system: SystemClock, tmp_path: Path) -> None:
    with plugged() as (device, port):
        recorder = port.record(tmp_path / "run.pcapng")

        def set_back() -> None:
            system.set_forward(-HOUR_S)
            until(lambda: recorder._job._stream.steps.ahead_ns)
            recorder.close()

        with pytest.warns(canser.CanserWarning, match=rf"{device.url}: .* set back by 3,600\.0 s"):
            set_back()


def test_files_that_begin_later_have_the_new_time(system: SystemClock, tmp_path: Path) -> None:
    events: list[RecorderEvent] = []
    with plugged() as (device, port):
        recorder = port.record(tmp_path / "run.pcapng", size="100k", on_event=events.append)
        sent = sets = 0
        for step in (0, HOUR_S, -3 * HOUR_S):
            system.set_forward(step)
            sets += step != 0
            for _ in range(3):
                device.write(RAW)
                sent += len(RAW)
                taken(recorder, sent)
            until(lambda: [event.kind for event in events].count("clock_set") == sets)  # noqa: B023
        recorder.close()
    raw = b""
    files = [event.path for event in events if event.kind == "opened"]
    ahead, begun = 0, {}
    for event in events:
        if event.kind == "clock_set":
            ahead += event.step_ns
        elif event.kind == "opened":
            begun[event.path] = ahead
    assert len(files) > 5
    assert len(set(begun.values())) == 3
    for path in files:
        with Recording(path) as recording:
            pieces = list(recording)
            raw += b"".join(bytes(piece.data) for piece in pieces)
        times = [piece.arrival_ns for piece in pieces]
        assert times == sorted(times)
        assert abs(times[-1] - time.time_ns() - begun[path]) < PATIENCE * SECOND
        frames = canser.read(path) if not remarks(Path(path)) else None
        if frames is not None:
            assert abs(int(frames["ts"][-1]) - times[-1]) < SECOND
    assert raw == RAW * 9
    assert sum(bool(remarks(Path(path))) for path in files) == 2


def test_a_recording_that_begins_after_it_has_the_new_time(
    system: SystemClock, tmp_path: Path
) -> None:
    events: list[RecorderEvent] = []
    with plugged() as (device, port):
        system.set_forward(HOUR_S)
        with port.record(tmp_path / "run.pcapng", on_event=events.append) as recorder:
            device.write(RAW)
            taken(recorder, len(RAW))
    assert [event.kind for event in events] == ["opened", "closed"]
    assert remarks(tmp_path / "run.pcapng") == []
    for ts in (*arrivals(tmp_path / "run.pcapng"), *(event.ts for event in events)):
        assert abs(ts - system.time_ns()) < PATIENCE * SECOND


def test_triggers_and_gaps_go_on(system: SystemClock, tmp_path: Path) -> None:
    events: list[RecorderEvent] = []
    link = tmp_path / "dev"
    wanted = canser.encode(array(Frame(0x7AB, dlc=8, data=bytes(8))), "seeed")
    with Device(link) as device, canser.open(str(link), "seeed", reconnect=True) as port:
        options: Any = {"triggers": "7AB", "before": "1h", "after": 0, "on_event": events.append}
        recorder = port.record(tmp_path / "e.pcapng", **options)
        device.write(RAW)
        taken(recorder, len(RAW))
        system.set_forward(-HOUR_S)
        until(lambda: events)
        device.unplug()
        until(lambda: recorder.status.away)
        with Device(link) as again:
            again.write(wanted)
            taken(recorder, len(RAW + wanted))
            recorder.close()
    assert [event.kind for event in events] == [
        "clock_set", "gap", "back", "trigger", "opened", "closed",
    ]  # fmt: skip
    for event in events:
        assert abs(event.ts - system.time_ns()) < PATIENCE * SECOND
    shown = time.strftime("%H:%M:%S", time.localtime(events[3].ts / 1e9))
    assert events[3].text.startswith(f"trigger at {shown}")
    path = tmp_path / "e-000001.pcapng"
    with Recording(path) as recording:
        pieces = list(recording)
    assert b"".join(bytes(piece.data) for piece in pieces) == RAW + wanted
    assert [piece.lost for piece in pieces if piece.gap] == [-1]
    assert abs(pieces[-1].arrival_ns - system.time_ns()) < PATIENCE * SECOND


INFO = RecordingInfo("seeed", 2_000_000, 500_000, "ms", "/dev/test")
START = 1_700_000_000 * SECOND
EDGE = len(canser.encode(FRAMES[:100], "seeed"))


def test_the_base_of_files_without_a_port(tmp_path: Path) -> None:
    """The time of a file is that of when it began, whatever was set how often before."""
    files = RecordingFiles(str(tmp_path / "run.pcapng"), INFO, period_ns=SECOND)
    files.start(START)
    ahead, expected = 0, []
    for number in range(6):
        now = START + number * 2 * SECOND
        files.write(RAW[:EDGE], now)
        files.advance(files.bytes_in, now)  # in a file of its own: the last one is too old
        expected.append(now + ahead)
        step = (HOUR_S, -0.5, 0, -7200)[number % 4]
        ahead += int(step * SECOND)
        files.clock_was_set(int(step * SECOND), now)
    files.close()
    paths = sorted(tmp_path.iterdir())
    assert [arrivals(path)[-1] for path in paths] == expected
