"""Clocks that restart, times that noise makes false, and times a little out of order."""

import random
from itertools import chain, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import shared  # noqa: F401 - Hypothesis' settings
from canser.timing.restarts import Clock
from samples import MILLISECOND, SECOND

HOUR = 3_600 * SECOND
TEN_MS = 10 * MILLISECOND

RUN = range(0, 90 * SECOND, TEN_MS)
"""The times of one run of a device, 90 s of a frame each 10 ms, and the span of one."""
SPAN = RUN[-1]


def clock(*times: int) -> Clock:
    made = Clock()
    made.add(np.array(times, np.int64))
    return made


def facts(judged: Clock) -> tuple[int | None, int, int]:
    return judged.span_ns, judged.restarts, judged.false_times


def test_no_times_have_no_span() -> None:
    assert facts(clock()) == (None, 0, 0)
    assert (clock().first, clock().last) == (None, None)


def test_a_steady_clock_has_its_span() -> None:
    steady = clock(5 * SECOND, 6 * SECOND, 8 * SECOND)
    assert facts(steady) == (3 * SECOND, 0, 0)
    assert (steady.first, steady.last) == (5 * SECOND, 8 * SECOND)
    assert facts(clock(SECOND)) == (0, 0, 0)


def test_times_a_little_out_of_order_are_no_restart() -> None:
    assert facts(clock(0, 2 * SECOND, SECOND, 3 * SECOND)) == (3 * SECOND, 0, 0)


def test_a_step_back_of_a_second_is_disorder_and_of_more_a_restart() -> None:
    ahead = range(0, 20 * SECOND, TEN_MS)
    for back, restarts in ((SECOND, 0), (SECOND + 2 * TEN_MS, 1)):
        behind = range(ahead[-1] - back, 30 * SECOND, TEN_MS)
        assert facts(clock(*ahead, *behind))[1:] == (restarts, 0)


@pytest.mark.parametrize("runs", [2, 3, 7])
def test_runs_that_are_joined_add_up(runs: int) -> None:
    assert facts(clock(*chain(*[RUN] * runs))) == (runs * SPAN, runs - 1, 0)


@pytest.mark.parametrize("seconds", [3, 5, 10])
@pytest.mark.parametrize("pace", [MILLISECOND, 100 * MILLISECOND, SECOND])
def test_runs_of_a_few_seconds_add_up(seconds: int, pace: int) -> None:
    run = range(0, seconds * SECOND + 1, pace)
    assert facts(clock(*run, *run, *run)) == (3 * seconds * SECOND, 2, 0)


def test_a_late_run_in_front_of_an_early_one_adds_up() -> None:
    late = range(5 * HOUR, 5 * HOUR + SECOND, TEN_MS)
    assert facts(clock(*late, *RUN)) == (late[-1] - late[0] + SPAN, 1, 0)


def test_runs_of_which_one_starts_in_the_middle_of_the_other_add_up() -> None:
    half = range(45 * SECOND, 60 * SECOND, TEN_MS)
    assert facts(clock(*RUN, *half)) == (SPAN + half[-1] - half[0], 1, 0)


def test_a_step_forward_is_a_silence_whatever_its_length() -> None:
    """A bus that is silent for hours is no fault of the clock."""
    assert facts(clock(0, SECOND, 9 * HOUR, 9 * HOUR + SECOND)) == (9 * HOUR + SECOND, 0, 0)
    assert facts(clock(*range(0, 24 * HOUR, 2 * HOUR))) == (22 * HOUR, 0, 0)


def test_a_silence_counts_where_the_clock_restarts_too() -> None:
    silent = (0, SECOND, 9 * HOUR, 9 * HOUR + SECOND)
    assert facts(clock(*silent, *RUN)) == (9 * HOUR + SECOND + SPAN, 1, 0)


FALSE = [30_000 * HOUR, -30_000 * HOUR, 20 * 60 * SECOND, -20 * 60 * SECOND]


@pytest.mark.parametrize("place", [1, 2, 50, 98, 99])
@pytest.mark.parametrize("false", FALSE)
def test_a_false_time_is_left_out(place: int, false: int) -> None:
    times = list(RUN[:100])
    noisy = clock(*times[:place], times[place] + false, *times[place:])
    assert facts(noisy) == (99 * TEN_MS, 0, 1)
    assert (noisy.first, noisy.last) == (0, 99 * TEN_MS)


@pytest.mark.parametrize("place", [0, 100])
@pytest.mark.parametrize("false", FALSE[:2])
def test_a_false_time_at_an_end_is_left_out(place: int, false: int) -> None:
    times = list(RUN[:100])
    times.insert(place, false)
    noisy = clock(*times)
    assert facts(noisy) == (99 * TEN_MS, 0, 1)
    assert (noisy.first, noisy.last) == (0, 99 * TEN_MS)


@pytest.mark.parametrize("place", [-1, 0, 1])
@pytest.mark.parametrize("false", FALSE[:2])
def test_a_false_time_beside_a_restart_is_left_out(place: int, false: int) -> None:
    times = [*RUN, *RUN]
    times[len(RUN) + place] = false
    span, restarts, false_times = facts(clock(*times))
    assert span == pytest.approx(2 * SPAN, abs=2 * TEN_MS)
    assert restarts == 1
    # Where a false time stands between two times that are alone, it takes one of them along.
    assert false_times in (1, 2)


@pytest.mark.parametrize("place", [10, 500])
@pytest.mark.parametrize("first", FALSE)
@pytest.mark.parametrize("second", FALSE)
def test_two_false_times_in_a_row_are_left_out(place: int, first: int, second: int) -> None:
    times = [*RUN[:place], first, 2 * second, *RUN[place:]]
    assert facts(clock(*times)) == (SPAN, 0, 2)


@given(st.integers(2, 5), st.integers(0, 2**32), st.sampled_from([1_000, 1_000_000]))
def test_noise_and_disorder_change_nothing(runs: int, seed: int, tick_ns: int) -> None:
    """A bit of the counter that flips makes a time false, by 2^22 of its ticks or more here."""
    rng = random.Random(seed)
    times, span, false = list[int](), 0, 0
    for _ in range(runs):
        run = [ts + rng.randrange(-3, 4) * MILLISECOND for ts in RUN[::5]]
        span += run[-1] - run[0]
        for at in range(6, len(run) - 6, 6):
            if rng.random() < 0.02:
                run[at] += rng.choice((1, -1)) * tick_ns << rng.randrange(22, 31)
                false += 1
        times += run
    assert facts(clock(*times)) == (span, runs - 1, false)


TIMES = st.lists(
    st.one_of(
        st.sampled_from((TEN_MS, -TEN_MS, 0, SECOND, -SECOND, -SECOND - 1, -20 * SECOND, HOUR)),
        st.integers(-(2**40), 2**40),
        st.integers(-(2**63), 2**63 - 1),
    ),
    max_size=30,
)


@given(TIMES, st.lists(st.integers(0, 200)), st.integers(1, 8))
def test_pieces_give_what_all_times_at_once_give(
    steps: list[int], cuts: list[int], between: int
) -> None:
    times, now = [], 0
    for step in steps:
        now = (now + step + 2**63) % 2**64 - 2**63
        times += [min(now + TEN_MS * number, 2**63 - 1) for number in range(between)]
    whole, pieces = Clock(), Clock()
    array = np.array(times, np.int64)
    numbers = whole.add(array)
    borders = [0, *sorted(min(cut, len(times)) for cut in cuts), len(times)]
    parts = [pieces.add(array[a:b]).tolist() for a, b in pairwise(borders)]
    assert [*chain(*parts)] == numbers.tolist()
    assert pieces == whole


def test_every_run_has_a_number_of_its_own() -> None:
    times = np.array([*RUN, *RUN, *RUN])
    numbers = Clock().add(times).reshape(3, -1)
    assert (numbers == numbers[:, :1]).all()
    assert len({*numbers[:, 0].tolist()}) == 3


def test_behind_a_false_time_the_number_is_as_before() -> None:
    for false in FALSE:
        numbers = Clock().add(np.array([*RUN[:50], false, *RUN[50:100]]))
        assert {*numbers[:50].tolist(), *numbers[51:].tolist()} == {int(numbers[0])}


def test_times_of_noise_alone_are_judged_in_linear_time() -> None:
    """Each of them steps to anywhere: none is near another."""
    times = np.random.default_rng(1).integers(-(2**62), 2**62, 20_000)
    noise = Clock()
    noise.add(times)
    assert noise.restarts + noise.false_times <= len(times)
