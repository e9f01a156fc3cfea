"""What C does for each frame's time, against plain Python."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canser._core.buffers import Times
from canser._core.clock import ClockLine, find_arrivals, find_lowest, find_ranked

S = 1_000_000_000
EPOCH = 1_790_000_000 * S
LEAST, MOST = -(2**63), 2**63 - 1

# As they come, a few different ones, or any.
TIMES = (
    st.integers(EPOCH, EPOCH + S)
    | st.integers(0, 3)
    | st.integers(LEAST, MOST)
    | st.sampled_from([LEAST, LEAST + 1, -1, MOST])
)


def wrapped(value: int) -> int:
    return (value + 2**63) % 2**64 - 2**63


def array(values: list[int]) -> Times:
    return np.array(values, np.int64)


def above(device: int, line: tuple[int, int, float]) -> int:
    """Return the host's time by a line."""
    run = wrapped(device - line[0])
    return wrapped(run + int(float(run) * line[2]) + line[1])


@given(
    st.lists(st.tuples(st.integers(0, 40), st.integers(0, S)), min_size=1, max_size=30),
    st.lists(st.integers(1, 25), min_size=1, max_size=60),
    st.sampled_from([0.0, 0.1, 86805.55, 1e9, 1e18]) | st.floats(0, 1e12),
)
def test_arrivals(steps: list[tuple[int, int]], sizes: list[int], byte_ns: float) -> None:
    ends = np.cumsum([0] + [size for size, _ in steps]).tolist()
    times = (EPOCH + np.cumsum([0] + [ns for _, ns in steps])).tolist()
    offsets = (np.cumsum(sizes) - 1).tolist()
    arrivals = np.empty(len(offsets), np.int64)
    pieces = array([number for piece in zip(ends, times, strict=True) for number in piece])
    find_arrivals(pieces, byte_ns, array(offsets), arrivals)
    for at, arrival in zip(offsets, arrivals.tolist(), strict=True):
        # The byte came with the first piece that reaches behind it.
        piece = next((k for k, stop in enumerate(ends) if stop > at), len(ends) - 1)
        early = min(int(max(ends[piece] - at - 1, 0) * byte_ns), MOST)
        assert arrival == max(times[piece] - early, times[piece - 1])


@given(
    st.tuples(TIMES, TIMES, st.floats(-0.02, 0.02) | st.just(0.0)),
    st.lists(st.tuples(TIMES, st.integers(-S, S) | TIMES), max_size=40),
    TIMES,
    st.integers(0, S),
    st.integers(0, S),
    TIMES,
    st.integers(0, 40),
)
def test_the_line_and_what_is_believed(
    lay: tuple[int, int, float],
    frames: list[tuple[int, int]],
    reached: int,
    early: int,
    late: int,
    latest: int,
    cut: int,
) -> None:
    line = ClockLine(early, latest)
    line.set(*lay)
    device = array([clock for clock, _ in frames])
    arrivals = array([wrapped(above(clock, lay) + delay) for clock, delay in frames])
    residuals = np.empty_like(arrivals)
    line.find_residuals(device, arrivals, residuals)
    times = arrivals.copy()
    line.map(device[:cut], times[:cut], reached, late)
    line.map(device[cut:], times[cut:], reached, late)
    for (clock, _), arrival, height, time in zip(
        frames, arrivals.tolist(), residuals.tolist(), times.tolist(), strict=True
    ):
        host = above(clock, lay)
        assert height == wrapped(arrival - host)
        if -early <= height <= late and wrapped(clock - reached) >= -early:
            latest = max(latest, min(host, arrival))
            assert time == latest
        else:
            assert time == arrival


def test_no_time_lies_before_those_of_others() -> None:
    line = ClockLine(0, LEAST)
    line.set(0, 0, 0.0)
    line.floor_at(70)
    times = array([100, 100, 100])
    line.map(array([60, 80, 50]), times, 0, 100)
    assert times.tolist() == [70, 80, 80]


def check_ranks(values: list[int], rank: int) -> None:
    ordered = sorted(values)
    assert find_ranked(array(values), rank) == (ordered[rank], ordered[0], ordered[-1])
    few = min(rank, 2)
    assert find_lowest(array(values), few) == np.argsort(values, kind="stable")[few]


@given(st.lists(TIMES, min_size=1, max_size=60), st.integers(0))
def test_ranks(values: list[int], rank: int) -> None:
    check_ranks(values, rank % len(values))
    check_ranks(sorted(values), rank % len(values))


@pytest.mark.parametrize("spread", [1, 5_000, 2**24, 2**62])
def test_ranks_among_many(spread: int) -> None:
    rng = np.random.default_rng(1)
    for count in (1023, 1024, 1025, 50_000):
        values = rng.integers(-spread, spread, count)
        values[:: count // 7] = MOST  # what a false frame makes of them
        for rank in (0, 1, count // 2, count - 2, count - 1):
            check_ranks(values.tolist(), rank)
