"""Frames go out as the bus carries them, by a clock that the tests make and by the real one."""

import sys
import time
from collections.abc import Iterator
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
import canser.live.pacing
import shared  # noqa: F401 - Hypothesis' settings
from canser._frames import FrameArray
from canser.live.pacing import AHEAD_FRAMES, Pacer, longest_bits
from canser.simulation.simulator import Simulator
from canser.simulation.traffic import vehicle
from plain_bits import length_on_the_bus
from reference import Frame
from samples import array

posix = pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are POSIX")

if sys.platform != "win32":
    from device import until
    from readers import Background, content, plugged, traffic

BITRATE = 500_000


class Clock:
    """A clock that runs in `sleep` only."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.sleeps: list[float] = []

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.sleeps.append(seconds)
        self.now += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(canser.live.pacing, "time", made)
    return made


# The longest length of a frame


@pytest.mark.parametrize("count", range(9))
def test_the_longest_length_is_that_of_the_literature(count: int) -> None:
    """Davis, Burns, Bril, Lukkien: Controller Area Network schedulability analysis (2007)."""
    frames = array(Frame(1, dlc=count), Frame(1, ext=True, dlc=count))
    assert longest_bits(frames) == [55 + 10 * count, 80 + 10 * count]


def test_frames_that_carry_no_data() -> None:
    rows = [Frame(1, rtr=True, dlc=8), Frame(1, ext=True, rtr=True, dlc=8), Frame(1, err=True)]
    assert longest_bits(array(*rows)) == [55, 80, 23]
    assert longest_bits(array()) == []


@given(
    st.booleans(),
    st.sampled_from([0, 0x7FF, 0x555, 0x78F, 0x1FFFFFFF, 0x1E1E1E1E]) | st.integers(0, 0x7FF),
    st.binary(max_size=8) | st.sampled_from([b"\0" * 8, b"\xff" * 8, b"\x0f" * 8, b"\xc3" * 8]),
)
def test_no_frame_is_longer(ext: bool, number: int, data: bytes) -> None:
    number &= 0x1FFFFFFF if ext else 0x7FF
    frame = Frame(number, ext=ext, dlc=len(data), data=data.ljust(8, b"\0"))
    (longest,) = longest_bits(array(frame))
    assert length_on_the_bus(frame) <= longest


# The pacer


def paced(pacer: Pacer, seconds: list[float], clock: Clock) -> Iterator[float]:
    """Yield when each frame goes out."""
    sent = 0
    while sent < len(seconds):
        count = pacer.take(seconds[sent : sent + AHEAD_FRAMES], None)
        assert count
        yield from [clock.now] * count
        sent += count


@given(st.lists(st.sampled_from([0.000_01, 0.000_27, 0.03]), min_size=1, max_size=80))
def test_never_more_than_sixteen_frames_are_ahead(seconds: list[float]) -> None:
    clock = Clock()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(canser.live.pacing, "time", clock)
        times = list(paced(Pacer(), seconds, clock))
    ends: list[float] = []
    for at, each in zip(times, seconds, strict=True):
        ends.append(max(at, ends[-1] if ends else at) + each)
    for place in range(AHEAD_FRAMES, len(times)):
        assert times[place] >= ends[place - AHEAD_FRAMES] - 1e-9
    # The bus is never idle meanwhile.
    assert ends[-1] == pytest.approx(1000 + sum(seconds))


def test_few_frames_wait_for_nothing(clock: Clock) -> None:
    pacer = Pacer()
    assert pacer.take([1.0] * 10, None) == 10
    assert pacer.take([1.0] * 6, None) == 6
    assert clock.sleeps == []
    assert pacer.take([1.0], None) == 1  # when the bus has sent the first
    assert clock.now == 1001
    clock.now += 1000
    assert pacer.take([1.0] * 16, None) == 16
    assert clock.now == 2001


def test_many_frames_go_in_halves(clock: Clock) -> None:
    pacer = Pacer()
    times = list(paced(pacer, [1.0] * 64, clock))
    assert [len(list(group)) for _, group in groupby(times)] == [16, *[8] * 6]
    assert len(clock.sleeps) == 6


def test_at_the_end_of_the_time_goes_what_may(clock: Clock) -> None:
    pacer = Pacer()
    pacer.take([1.0] * 16, None)
    assert pacer.take([1.0] * 16, clock.now) == 0
    assert pacer.take([1.0] * 16, clock.now + 3.5) == 3
    assert clock.now == 1003.5
    assert pacer.take([1.0] * 16, clock.now - 5) == 0
    assert clock.sleeps == [3.5]


# A port


FRAMES = vehicle(2)[:2000]
BUS_S = [bits / BITRATE for bits in longest_bits(FRAMES)]


@posix
def test_frames_arrive_as_the_bus_carries_them() -> None:
    with (
        Simulator("seeed") as device,
        canser.open(device.url, "seeed", bitrate=BITRATE) as port,
    ):
        port.send([])  # until it listens
        begin = time.monotonic()
        assert port.send(FRAMES) == len(FRAMES) == 2000
        until(lambda: device.report().frames_received == len(FRAMES))
        assert time.monotonic() - begin >= sum(BUS_S[:-AHEAD_FRAMES])
        assert content(device.received) == content(FRAMES)


@posix
@pytest.mark.parametrize("pace", [True, False])
def test_pacing_can_be_switched_off(clock: Clock, pace: bool) -> None:
    with (
        Simulator("seeed") as device,
        canser.open(device.url, "seeed", bitrate=BITRATE) as port,
    ):
        port.send(FRAMES, pace=pace)
        until(lambda: device.report().frames_received == len(FRAMES))
        assert content(device.received) == content(FRAMES)
    waited = sum(clock.sleeps)
    assert waited == (pytest.approx(sum(BUS_S[:-AHEAD_FRAMES]), abs=0.01) if pace else 0)


@posix
def test_without_a_bit_rate_nothing_is_paced(clock: Clock) -> None:
    with Simulator("seeed") as device, canser.open(device.url, "seeed") as port:
        port.send(FRAMES)
        assert clock.sleeps == []
        port.configure(bitrate=125_000)
        port.send(FRAMES[:100])
        wanted = sum(BUS_S[: 100 - AHEAD_FRAMES]) * BITRATE / 125_000
        assert sum(clock.sleeps) == pytest.approx(wanted, abs=0.01)


@posix
@pytest.mark.parametrize("timeout", [0, 0.02, 0.1])
def test_what_the_bus_takes_not_in_time_is_counted(timeout: float) -> None:
    with (
        Simulator("seeed") as device,
        canser.open(device.url, "seeed", bitrate=10_000) as port,
    ):
        port.send([])
        rest, sent = FRAMES[:100], 0
        reasons = set()
        begin = time.monotonic()
        while len(rest):
            try:
                count = port.send(rest, timeout=timeout)
            except canser.SendTimeoutError as error:
                reasons.add(error.reason)
                count = error.sent
            sent += count
            assert sent >= AHEAD_FRAMES
            passed = time.monotonic() - begin
            assert sum(BUS_S[: max(sent - AHEAD_FRAMES, 0)]) * 50 <= passed
            rest = rest[count:]
        assert reasons == {"the bus can have sent no more within the time-out"}
        until(lambda: device.report().frames_received == 100)
        assert content(device.received) == content(FRAMES[:100])


@posix
def test_a_line_that_takes_no_more_is_counted_behind_what_was_paced() -> None:
    """The parts that the line took before count, too, and the next packet is whole."""
    frames = traffic(20)
    raw = canser.encode(frames, "seeed")
    with plugged() as (device, port):
        port.bitrate = 10**9  # the line is slower
        with pytest.raises(canser.SendTimeoutError, match="took no more within the") as caught:
            port.send(frames, timeout=0.2)
        sent = caught.value.sent
        assert AHEAD_FRAMES < sent < len(frames)
        sender = Background(lambda: port.send(frames[sent:]))
        assert device.read(len(raw)) == raw
        assert sender.join().result == len(frames) - sent


@posix
def test_two_threads_share_the_bus() -> None:
    with (
        Simulator("seeed") as device,
        canser.open(device.url, "seeed", bitrate=BITRATE) as port,
    ):
        port.send([])
        begin = time.monotonic()
        senders = [Background(lambda: port.send(FRAMES[:500])) for _ in range(2)]
        assert [sender.join().result for sender in senders] == [500, 500]
        assert time.monotonic() - begin >= 2 * sum(BUS_S[:500]) - AHEAD_FRAMES * max(BUS_S)
        until(lambda: device.report().frames_received == 1000)
        assert device.report().bytes_skipped == 0


@posix
def test_a_port_that_is_closed_ends_a_send_that_waits_for_the_bus() -> None:
    with (
        Simulator("seeed") as device,
        canser.open(device.url, "seeed", bitrate=5_000) as port,
    ):
        port.send([])
        sender = Background(lambda: port.send(FRAMES))
        until(lambda: device.report().frames_received)
        port.close()
        error = sender.join().error
        assert isinstance(error, canser.SendError)
        assert "the port is closed" in str(error)
        assert AHEAD_FRAMES <= error.sent < len(FRAMES)


def test_frames_are_sent_as_they_were(clock: Clock) -> None:
    """In parts of 16 and 8, and all of each."""
    frames: FrameArray = np.tile(FRAMES, 2)
    with canser.open("loop://", "seeed") as port:
        port.bitrate = BITRATE
        port.send(frames)
        got = port.read_batch(max_frames=len(frames), min_frames=len(frames), timeout=60)
        assert content(got) == content(frames)
    assert clock.sleeps
