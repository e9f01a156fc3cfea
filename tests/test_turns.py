"""Which turn of its 32-bit counter a device's clock is in, by the host's clock.

A counter of microseconds turns once in 71.6 minutes, one of milliseconds once in 49.7 days, one of
nanoseconds once in 4.3 seconds.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import canser
from canser._core.buffers import Times
from canser._frames import FRAME_DTYPE
from canser.live import ports
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter
from canser.timing.loop import TimedDecoder
from long import LONG, longer
from readers import collect, plugged

US, MS, S = 1_000, 1_000_000, 1_000_000_000
MINUTE, HOUR, DAY = 60 * S, 3600 * S, 86_400 * S
TICK = {"s": S, "ms": MS, "us": US, "ns": 1}
EPOCH = 1_790_000_000 * S
BYTE_NS = 1e10 / 2_000_000
TURN = 2**32

# The whole way from bytes to times.


def counters(truth: Times, unit: str, zero: int, ppm: float = 0) -> Times:
    """Return what a device's counter says, unwrapped, that was 0 at `zero`."""
    elapsed = truth - zero
    return (elapsed + (elapsed * (ppm * 1e-6)).astype(np.int64)) // TICK[unit]


def decode(
    truth: Times, ticks: Times, unit: str, *, device_time: bool, stall: int = 0, batch: int = 64
) -> Times:
    """Decode frames of `serial`, each in a read of its own, late by up to 0.5 ms; return times.

    `stall`: so long the host is asleep after a minute.
    """
    frames = np.zeros(len(truth), FRAME_DTYPE)
    frames["dlc"] = 8
    # As on the wire: of the ticks 32 bits.
    frames["ts"] = (ticks % TURN) * TICK[unit]
    raw = canser.encode(frames, "serial", ts_unit=unit)
    size = len(raw) // len(frames)
    behind = (np.arange(len(frames)) + 1) * size
    arrivals = truth + round(size * BYTE_NS)
    arrivals += np.random.default_rng(1).integers(0, MS // 2, len(truth))
    asleep = (arrivals >= EPOCH + MINUTE) & (arrivals < EPOCH + MINUTE + stall)
    arrivals[asleep] = EPOCH + MINUTE + stall
    loop = TimedDecoder(canser.Decoder("serial", ts_unit=unit), BYTE_NS, device_time=device_time)
    room = np.empty(batch, FRAME_DTYPE)
    times = []
    for begin in range(0, len(frames), batch):
        part = slice(begin, begin + batch)
        loop.use(room)
        loop.clock.arrivals.extend(behind[part], arrivals[part])
        loop.feed(raw[begin * size : (begin + batch) * size], batch)
        loop.assign_times()
        times.append(room["ts"][: loop.count].copy())
    return np.concatenate(times)


def steady(seconds: float, rate: float, seed: int = 1) -> Times:
    """Return the times of frames on a bus."""
    rng = np.random.default_rng(seed)
    return EPOCH + np.cumsum(rng.exponential(S / rate, round(seconds * rate)).astype(np.int64) + 1)


def off(times: Times, truth: Times) -> npt.NDArray[np.float64]:
    """Return by how many milliseconds times are wrong."""
    milliseconds: npt.NDArray[np.float64] = np.abs(times - truth) / MS
    return milliseconds


@longer
@pytest.mark.parametrize("false_count", [4, 40])
def test_false_times_in_a_row_put_nothing_a_turn_off(false_count: int) -> None:
    # Behind a clock in line, and in other streams 2 before there is one.
    rng = np.random.default_rng(1)
    for seed in range(400 if LONG else 100):
        truth = steady(4, 50, seed)
        ticks = counters(truth, "us", EPOCH - int(rng.integers(0, 10 * HOUR)))
        at, count = (100, false_count) if seed % 2 else (int(rng.integers(1, 15)), 2)
        false = np.zeros(len(truth), bool)
        false[at : at + count] = True
        wire = np.where(false, rng.integers(0, TURN, len(truth)), ticks)
        device = decode(truth, wire, "us", device_time=True)
        # The first frame's turn is not known, and is none.
        want = (ticks - ticks[0] + ticks[0] % TURN) * US
        assert np.array_equal(device[~false], want[~false])
        host = decode(truth, wire, "us", device_time=False)
        assert off(host, truth)[~false].max() <= 1


@pytest.mark.parametrize("ppm", [-50, 0, 50])
@pytest.mark.parametrize(
    ("unit", "silence"),
    [
        ("us", MINUTE),
        ("us", 36 * MINUTE),
        ("us", 71 * MINUTE),
        ("us", 3 * HOUR),
        ("us", 40 * DAY),
        ("ms", 20 * DAY),
        ("ms", 60 * DAY),
        ("s", 60 * DAY),
    ],
)
def test_a_silence_of_any_length(unit: str, silence: int, ppm: float) -> None:
    truth = steady(120, 100)
    truth[6000:] += silence
    ticks = counters(truth, unit, EPOCH - 50 * MINUTE, ppm)
    device = decode(truth, ticks, unit, device_time=True)
    assert np.array_equal(device, (ticks - ticks[0] + ticks[0] % TURN) * TICK[unit])
    # Right at once: those behind it have arrival times until the clock is known anew.
    host = decode(truth, ticks, unit, device_time=False)
    assert off(host, truth).max() <= TICK[unit] / MS + 2


@pytest.mark.parametrize("unit", ["ms", "us"])
def test_a_restart_of_the_device(unit: str) -> None:
    truth = steady(120, 100)
    ticks = counters(truth, unit, EPOCH - 10 * MINUTE)
    ticks[6000:] = counters(truth, unit, int(truth[6000]) - S)[6000:]
    device = decode(truth, ticks, unit, device_time=True)
    assert np.array_equal(device, ticks * TICK[unit])
    host = decode(truth, ticks, unit, device_time=False)
    assert off(host, truth).max() <= 2 * TICK[unit] / MS + 1


@longer
@pytest.mark.parametrize("count", [1, 2, 15])
@pytest.mark.parametrize("unit", ["ms", "us"])
def test_the_first_times_are_false(unit: str, count: int) -> None:
    rng = np.random.default_rng(4)
    for seed in range(50 if LONG else 15):
        truth = steady(5, 50, seed)
        ticks = counters(truth, unit, EPOCH - 10 * MINUTE)
        wire = ticks.copy()
        wire[:count] = rng.integers(0, TURN, count)
        device = decode(truth, wire, unit, device_time=True)
        # They are the truth but for whole turns, the same for all.
        assert len(np.unique(device[count:] // TICK[unit] - ticks[count:])) == 1
        assert not ((device // TICK[unit] - wire) % TURN).any()
        host = decode(truth, wire, unit, device_time=False)
        assert off(host, truth)[count:].max() <= TICK[unit] / MS + 1


@longer
@pytest.mark.parametrize("unit", ["s", "ms", "us"])
def test_noise_for_long(unit: str) -> None:
    truth = steady(7200 if LONG else 1800, 20)
    ticks = counters(truth, unit, EPOCH - 65 * MINUTE)
    rng = np.random.default_rng(5)
    false = rng.random(len(truth)) < 1 / 25
    wire = np.where(false, rng.integers(0, TURN, len(truth)), ticks)
    false[0] = True
    device = decode(truth, wire, unit, device_time=True)
    assert len(np.unique((device // TICK[unit] - ticks)[~false])) == 1
    host = decode(truth, wire, unit, device_time=False)
    assert off(host, truth)[~false].max() <= TICK[unit] / MS + 1


@pytest.mark.parametrize(
    ("unit", "stall", "silence"),
    [("us", 20 * MINUTE, 0), ("us", 60 * S, 300 * DAY), ("ns", 2 * S, 0), ("ns", 0, 10 * HOUR)],
)
def test_what_half_a_turn_allows(unit: str, stall: int, silence: int) -> None:
    truth = steady(120, 100)
    truth[9000:] += silence + stall
    ticks = counters(truth, unit, EPOCH - S, 50)
    times = decode(truth, ticks, unit, device_time=True, stall=stall)
    assert np.array_equal(times, (ticks - ticks[0] + ticks[0] % TURN) * TICK[unit])


# From ports and from recordings.


def microseconds(truth: Times) -> tuple[Times, bytes]:
    """Return what a device's clock says, nanoseconds, and what goes over the line."""
    frames = np.zeros(len(truth), FRAME_DTYPE)
    frames["dlc"] = 8
    frames["ts"] = counters(truth, "us", EPOCH - 30 * MINUTE) * US
    return frames["ts"], canser.encode(frames, "serial", ts_unit="us")


@pytest.mark.parametrize("device_time", [False, True])
def test_a_port_after_a_silence(device_time: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    now = EPOCH
    monkeypatch.setattr(ports, "HostClock", lambda: lambda: now)
    monkeypatch.setattr("canser.timing.host.time.time_ns", lambda: now)  # it is not set
    truth = EPOCH + np.arange(60) * 10 * MS
    truth[40:] += 40 * MINUTE
    device, raw = microseconds(truth)
    size = len(raw) // len(truth)
    with plugged("serial", ts_unit="us", device_time=device_time) as (far, port):
        got = []
        for k, ns in enumerate(truth.tolist()):
            now = ns + MS
            far.feed(raw[k * size : (k + 1) * size])
            got.append(collect(port, 1))
        times = np.concatenate(got)["ts"]
        assert port.stats.ts_uncertain == 1
    assert np.array_equal(times, device) if device_time else off(times, truth).max() <= 3


@pytest.mark.parametrize("silence", [40 * MINUTE, 3 * HOUR, 40 * DAY])
def test_a_recording_with_a_silence(silence: int, tmp_path: Path) -> None:
    truth = steady(120, 100)
    truth[6000:] += silence
    _, raw = microseconds(truth)
    size = len(raw) // len(truth)
    path = tmp_path / "run.pcapng"
    info = RecordingInfo("serial", 2_000_000, None, "us", "")
    with RecordingWriter(path, info) as writer:
        for k, ns in enumerate(truth.tolist()):
            writer.write(raw[k * size : (k + 1) * size], ns + MS, 0)
    assert off(canser.read(path)["ts"], truth).max() <= 2
