"""When a simulated adapter sends: its schedule, by a clock that the tests set."""

import time
from collections.abc import Iterable, Iterator

import numpy as np
import pytest

import canser
from canser import adapters
from canser._frames import FrameArray
from canser.simulation._outgoing import Outgoing
from canser.simulation.traffic import damage, vehicle
from reference import NO_TIME
from samples import MILLISECOND, SECOND, timed

ROOM = 1 << 18

# A frame may go out by so much later than it is due, in nanoseconds.
LATE_MAX = MILLISECOND


def outgoing(
    traffic: FrameArray | Iterable[FrameArray],
    *,
    protocol: str = "serial",
    loop: bool = False,
    noise: float = 0,
) -> Outgoing:
    return Outgoing(
        protocol, traffic, ts_unit="ms", loop=loop, timed=True, noise=noise, loss=0, seed=1
    )


def sent(out: Outgoing, now: int) -> bytes:
    """Take all that goes out at a time."""
    data = b""
    while piece := out.next(ROOM, now):
        data += piece
        out.wrote(len(piece))
    return data


def run(out: Outgoing, until: int) -> Iterator[tuple[int, bytes]]:
    """Send as the simulator does, by a clock that is never late; yield what goes out when."""
    now = 0
    while out.ready() and now <= until:
        data = sent(out, now)
        while out.starved:  # a thread takes the parts of an iterable
            time.sleep(0.001)
            out.ready()
            data += sent(out, now)
        yield now, data
        now += out.wait_ns(now)


def arrivals(out: Outgoing, until: int = 3600 * SECOND) -> list[int]:
    """Return when each frame goes out."""
    return [now for now, data in run(out, until) for _ in canser.decode(data, "serial")]


def test_each_frame_goes_out_when_it_is_due() -> None:
    frames = vehicle(3)
    out = outgoing(frames)
    due = frames["ts"] - frames["ts"][0]
    whole = b""
    for now, data in run(out, 3600 * SECOND):
        assert data, "a wake for nothing"
        whole += data
        # All that is due by now, and no byte more.
        count = int((due <= now).sum())
        assert whole == canser.encode(frames[:count], "serial")
    late = np.array(arrivals(outgoing(frames))) - due
    assert late.min() >= 0
    assert late.max() < LATE_MAX


def test_damaged_frames_keep_their_times() -> None:
    frames = vehicle(2)
    hit = damage(canser.encode(frames, "serial"), noise=0.02, seed=(1, 1))
    whole = b""
    for now, data in run(outgoing(frames, noise=0.02), 3600 * SECOND):
        whole += data
        count = int((frames["ts"] - frames["ts"][0] <= now).sum())
        end = len(canser.encode(frames[:count], "serial"))
        assert len(whole) == end - sum(hit.lost < end) + sum(hit.inserted < end)
    assert whole == hit.data


def test_the_next_frame_sets_how_long_to_wait() -> None:
    out = outgoing(timed(7 * SECOND, 7 * SECOND + 1_500_000, 9 * SECOND))
    assert out.next(ROOM, 0)
    sent(out, 0)
    assert out.wait_ns(0) == 1_500_000
    assert out.wait_ns(1_000_000) == 500_000
    assert sent(out, 1_499_999) == b""
    assert sent(out, 1_500_000)
    assert out.wait_ns(1_500_000) == 2 * SECOND - 1_500_000


def test_a_frame_that_is_cut_off_goes_on_at_once() -> None:
    frames = timed(0, SECOND)
    out = outgoing(frames)
    first = out.next(5, 0)
    out.wrote(len(first))
    assert bytes(first) + sent(out, 0) == canser.encode(frames[:1], "serial")
    assert out.wait_ns(0) == SECOND


def test_frames_that_are_due_together_cost_one_wake() -> None:
    frames = timed(*range(0, 20 * MILLISECOND, 10_000))  # one each 10 microseconds
    out = outgoing(frames)
    wakes = list(run(out, SECOND))
    assert len(wakes) <= 101
    late = np.array([now for now, data in wakes for _ in canser.decode(data, "serial")])
    assert (late - frames["ts"]).max() <= 200_000


def test_the_times_of_a_round_go_on_in_the_next() -> None:
    out = outgoing(timed(SECOND, SECOND + 10 * MILLISECOND, SECOND + 30 * MILLISECOND), loop=True)
    went = np.array(arrivals(out, 100 * MILLISECOND)) // MILLISECOND
    assert went[:8].tolist() == [0, 10, 30, 45, 55, 75, 90, 100]


@pytest.mark.parametrize("loop", [False, True])
def test_a_clock_that_starts_anew_goes_on(loop: bool) -> None:
    before = [SECOND * n for n in range(100, 110)]
    anew = [SECOND * n for n in range(5)]
    out = outgoing(timed(*before, *anew), loop=loop)
    went = np.array(arrivals(out, 30 * SECOND)) / SECOND
    # The step back takes no time; where it stands nothing piles up, and nothing pauses.
    expected = [*range(10), *range(9, 14)]
    if not loop:
        assert went.tolist() == pytest.approx(expected)
    else:
        again = [13 + 13 / 14 + second for second in expected]
        assert went[:30].tolist() == pytest.approx([*expected, *again], abs=0.001)


def test_a_false_time_is_no_pause() -> None:
    out = outgoing(timed(0, 10 * MILLISECOND, 30 * 86_400 * SECOND, 30 * 86_400 * SECOND + 1))
    assert max(arrivals(out)) < 11 * MILLISECOND


def test_a_frame_without_a_time_or_out_of_order_is_due_with_the_one_before_it() -> None:
    times = NO_TIME, SECOND, NO_TIME, 3 * SECOND, NO_TIME, 3 * SECOND - MILLISECOND
    out = outgoing(timed(*times), protocol="seeed")  # the others carry no unknown time
    went = [now for now, data in run(out, 3 * SECOND) for _ in canser.decode(data, "seeed")]
    assert went == [0, 0, 0, 2 * SECOND, 2 * SECOND, 2 * SECOND]


def test_parts_are_one_stream() -> None:
    frames = vehicle(3)
    parts = [frames[:1], frames[1:1], frames[1:3000], frames[3000:]]
    assert arrivals(outgoing(iter(parts))) == arrivals(outgoing(frames))


def test_what_a_filter_leaves_keeps_its_times() -> None:
    frames = timed(*(n * 100 * MILLISECOND for n in range(10))).copy()
    frames["ext"][::2] = True
    out = outgoing(frames, protocol="seeed")
    assert out.next(ROOM, 0)
    sent(out, 0)
    packet = adapters.configuration(
        "seeed", adapters.AdapterConfig(bitrate=500_000, frame_type="extended")
    )
    out.configure(adapters.report("seeed", packet))
    went = [now for now, data in run(out, SECOND) for _ in canser.decode(data, "seeed")]
    assert went == [n * 100 * MILLISECOND for n in (2, 4, 6, 8)]
