"""What frames amount to: counts, spans, periods, and clocks that jump."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canser.frames import FrameArray
from canser.tally import Clock, Tally
from reference import NO_TIME, Frame
from samples import FRAMES, MILLISECOND, SECOND, array, timed

HOUR = 3_600 * SECOND
TEN_MS = 10 * MILLISECOND


def tally(*blocks: FrameArray) -> Tally:
    total = Tally()
    for block in blocks:
        total.add(block)
    return total


def clock(*ts: int) -> Clock:
    return tally(timed(*ts)).clock


def test_nothing_amounts_to_nothing() -> None:
    total = tally(array())
    assert total == Tally()
    assert total.clock.span_ns is None
    assert total.clock.period_ns is None


def test_kinds_are_counted() -> None:
    total = tally(
        array(
            Frame(1),
            Frame(2, ext=True),
            Frame(3, ext=True, rtr=True),
            Frame(4, rtr=True),
            Frame(5, rtr=True),
            Frame(6, err=True),
        )
    )
    assert (total.count, total.extended, total.remote, total.errors) == (6, 2, 3, 1)


def test_frames_are_counted_by_their_dlc() -> None:
    assert tally(array(Frame(1), Frame(1, dlc=8), Frame(2, dlc=8))).dlc == [1, *[0] * 7, 2]


def test_ids_are_told_apart_by_their_kind() -> None:
    total = tally(array(Frame(0x123), Frame(0x123, ext=True), Frame(0x123)))
    assert {key: one.count for key, one in total.ids.items()} == {
        (0x123, False): 2,
        (0x123, True): 1,
    }


def test_an_id_has_its_own_remote_frames_and_dlcs() -> None:
    frames = array(
        Frame(1, dlc=4),
        Frame(2, dlc=8),
        Frame(1, dlc=2),
        Frame(1, rtr=True, dlc=3),
        Frame(2, dlc=8),
    )
    one, two = tally(frames).ids[1, False], tally(frames).ids[2, False]
    assert (one.count, one.remote, one.dlc_least, one.dlc_most) == (3, 1, 2, 4)
    assert (two.count, two.remote, two.dlc_least, two.dlc_most) == (2, 0, 8, 8)


def test_an_id_has_its_own_period() -> None:
    fast = [Frame(1, ts=number * TEN_MS) for number in range(100)]
    slow = [Frame(2, ts=number * 10 * TEN_MS) for number in range(10)]
    total = tally(array(*sorted(fast + slow, key=lambda frame: frame.ts)))
    assert total.ids[1, False].clock.period_ns == TEN_MS
    assert total.ids[2, False].clock.period_ns == 10 * TEN_MS


@given(FRAMES, st.lists(st.integers(0, 20)))
def test_blocks_amount_to_what_all_do_at_once(frames: list[Frame], cuts: list[int]) -> None:
    whole = array(*frames)
    assert tally(*np.split(whole, sorted(min(cut, len(frames)) for cut in cuts))) == tally(whole)


def test_span_and_period_are_those_of_steady_times() -> None:
    steady = clock(5 * SECOND, 6 * SECOND, 8 * SECOND)
    assert (steady.first, steady.last, steady.timed) == (5 * SECOND, 8 * SECOND, 3)
    assert steady.span_ns == 3 * SECOND
    assert steady.period_ns == 1.5 * SECOND


def test_one_time_has_a_span_of_zero_and_no_period() -> None:
    assert clock(SECOND).span_ns == 0
    assert clock(SECOND).period_ns is None
    assert clock(SECOND, SECOND).period_ns is None


def test_unknown_times_take_no_part() -> None:
    assert clock(NO_TIME, NO_TIME).span_ns is None
    assert clock(NO_TIME, NO_TIME).period_ns is None
    mixed = clock(NO_TIME, 0, NO_TIME, SECOND, NO_TIME)
    assert (mixed.timed, mixed.span_ns, mixed.period_ns) == (2, SECOND, SECOND)


def test_times_a_little_out_of_order_are_no_jump() -> None:
    swapped = clock(0, 2 * SECOND, SECOND, 3 * SECOND)
    assert (swapped.jumps, swapped.span_ns) == (0, 3 * SECOND)


def test_a_pause_is_part_of_the_span() -> None:
    """A bus that is silent for hours is no fault of the clock."""
    paused = clock(0, SECOND, 9 * HOUR, 9 * HOUR + SECOND)
    assert paused.span_ns == 9 * HOUR + SECOND


def test_a_day_of_steady_times_has_a_day_of_span() -> None:
    assert clock(*range(0, 24 * HOUR, HOUR // 2)).jumps == 0


@pytest.mark.parametrize("place", [1, 50, 99])
@pytest.mark.parametrize("false", [30_000 * HOUR, -30_000 * HOUR])
def test_a_false_time_out_of_noise_does_not_spoil_the_span(place: int, false: int) -> None:
    times = [number * TEN_MS for number in range(100)]
    noisy = clock(*times[:place], times[place] + false, *times[place:])
    # The step from before it to behind it is lost with it.
    assert noisy.span_ns == 98 * TEN_MS
    assert noisy.period_ns == TEN_MS


# The two others, a step forward once, are what a pause looks like.
@pytest.mark.parametrize(("place", "false"), [(0, 30_000 * HOUR), (100, -30_000 * HOUR)])
def test_a_false_time_at_an_end_that_steps_back_does_not_spoil_the_span(
    place: int, false: int
) -> None:
    times = [number * TEN_MS for number in range(100)]
    times.insert(place, false)
    noisy = clock(*times)
    assert noisy.span_ns == 99 * TEN_MS
    assert noisy.period_ns == TEN_MS


def test_a_restart_of_the_device_counts_both_runs() -> None:
    before = range(5 * HOUR, 5 * HOUR + 100 * TEN_MS, TEN_MS)
    after = range(0, 50 * TEN_MS, TEN_MS)
    restarted = clock(*before, *after)
    assert (restarted.jumps, restarted.backward) == (1, 1)
    assert restarted.span_ns == (99 + 49) * TEN_MS
    assert restarted.period_ns == TEN_MS
