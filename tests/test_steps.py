"""The steps of time of many ids: median and 99th percentile in bounded memory."""

import tracemalloc
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

import shared  # noqa: F401 - Hypothesis' settings
from canser.analysis.steps import StepStatistics
from samples import MILLISECOND, SECOND

HOUR = 3_600 * SECOND
TEN_MS = 10 * MILLISECOND


def add(steps: StepStatistics, piece: npt.ArrayLike, row: int = 0) -> None:
    """Add steps of one row."""
    values = np.asarray(piece, np.uint64)
    steps.add(np.full(len(values), row), values)


def figures(*pieces: npt.ArrayLike) -> tuple[float, float]:
    """Return median and 99th percentile of steps of one row, in pieces."""
    steps = StepStatistics()
    for piece in pieces:
        add(steps, piece)
    (median,), (p99,) = steps.median_and_p99(1)
    return float(median), float(p99)


def median_ns(*pieces: npt.ArrayLike) -> float:
    return figures(*pieces)[0]


def test_the_median_of_few_steps_is_exact() -> None:
    assert np.isnan(figures()).all()
    assert median_ns([7]) == 7
    assert median_ns([10, 1], [3]) == 3
    assert median_ns([10, 1, 4], [3]) == 3.5
    assert median_ns(np.arange(1, 1_025)) == 512.5


def test_the_median_of_many_steps_is_exact_where_they_are_whole_milliseconds() -> None:
    steps = np.random.default_rng(1).choice([9, 10, 11, 20, 5_000], 100_001) * MILLISECOND
    assert median_ns(steps) == np.median(steps)
    even = [9 * MILLISECOND] * 2_000 + [10 * MILLISECOND] * 2_000
    assert median_ns(even) == 9.5 * MILLISECOND


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("width", [0.001, 0.3, 5])
def test_the_median_of_many_steps_is_good_to_a_128th(seed: int, width: float) -> None:
    rng = np.random.default_rng(seed)
    steps = (np.exp(rng.normal(0, width, 20_000)) * TEN_MS).astype(np.uint64) + np.uint64(1)
    assert median_ns(*np.array_split(steps, 13)) == pytest.approx(np.median(steps), rel=1 / 128)


@given(
    st.lists(st.integers(1, 2**64 - 1), min_size=1, max_size=30),
    st.integers(1, 200),
    st.lists(st.integers(0, 6_000)),
)
def test_pieces_of_steps_have_the_median_of_all(
    steps: list[int], times: int, cuts: list[int]
) -> None:
    every = np.tile(np.array(steps, np.uint64), times)
    borders = [0, *sorted(min(cut, len(every)) for cut in cuts), len(every)]
    pieces = [every[a:b] for a, b in pairwise(borders)]
    found = median_ns(*pieces)
    assert found == pytest.approx(median_ns(every), rel=1e-9)
    assert found == pytest.approx(float(np.median(every.astype(np.float64))), rel=1 / 128)


def test_asking_for_the_median_changes_nothing() -> None:
    rng = np.random.default_rng(1)
    steps = rng.integers(1, HOUR, 5_000).astype(np.uint64)
    asked = StepStatistics()
    for piece in np.array_split(steps, 7):
        add(asked, piece)
        (median,), (p99,) = asked.median_and_p99(1)
    assert (median, p99) == pytest.approx(figures(steps), rel=1e-9)


def test_memory_does_not_grow_with_the_steps() -> None:
    rng = np.random.default_rng(1)
    steps = StepStatistics()
    many = np.exp2(rng.uniform(0, 64, 100_000)).astype(np.uint64)
    add(steps, many)
    tracemalloc.start()
    try:
        for _ in range(10):
            add(steps, many)
        grown, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # As many bins as a float64 has for these, 64 exponents of 128 each, of 16 bytes.
    assert grown <= 16 * 64 * 128 + 10_000


def test_the_99th_percentile_is_the_shortest_step_that_99_of_100_do_not_exceed() -> None:
    assert figures([5])[1] == 5
    assert figures(np.arange(100, 0, -1))[1] == 99
    assert figures(np.arange(1, 102))[1] == 100
    assert figures(np.arange(1, 1_025))[1] == 1_014


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("width", [0.001, 0.3, 5])
def test_the_99th_percentile_of_many_steps_is_good_to_a_128th(seed: int, width: float) -> None:
    rng = np.random.default_rng(seed)
    steps = (np.exp(rng.normal(0, width, 20_001)) * TEN_MS).astype(np.uint64) + np.uint64(1)
    expected = np.sort(steps)[int(np.ceil(0.99 * len(steps))) - 1]
    assert figures(*np.array_split(steps, 13))[1] == pytest.approx(expected, rel=1 / 128)


def test_a_frame_lost_of_50_shows_in_the_99th_percentile_and_of_200_does_not() -> None:
    steps = np.full(10_000, TEN_MS)
    steps[::200] = 2 * TEN_MS
    assert figures(steps) == (TEN_MS, TEN_MS)
    steps[::50] = 2 * TEN_MS
    assert figures(steps) == (TEN_MS, 2 * TEN_MS)


def test_each_row_has_its_own_figures_whether_few_or_many_steps() -> None:
    """Rows of a few steps stand between rows of so many that a histogram counts them."""
    rng = np.random.default_rng(1)
    sizes = [0, 1, 5_000, 2, 1_024, 1_025, 40_000, 0, 7]
    rows = rng.permutation(np.repeat(np.arange(len(sizes)), sizes))
    steps = ((rows + 1) * MILLISECOND + rng.integers(0, 3, len(rows))).astype(np.uint64)
    several = StepStatistics()
    for part in np.array_split(np.arange(len(rows)), 30):
        several.add(rows[part], steps[part])
    medians, p99s = several.median_and_p99(len(sizes) + 1)
    assert np.isnan(medians).tolist() == [size == 0 for size in [*sizes, 0]]
    for row, size in enumerate(sizes):
        assert (medians[row], p99s[row]) == pytest.approx(
            figures(steps[rows == row]), rel=1e-9, nan_ok=True
        )
        if 0 < size <= 1_024:
            assert medians[row] == np.median(steps[rows == row])


def test_many_rows_of_a_few_steps_keep_little() -> None:
    steps = StepStatistics()
    rows = np.arange(100_000)
    ones = np.ones(len(rows), np.uint64)
    tracemalloc.start()
    try:
        for _ in range(3):
            steps.add(rows, ones)
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept <= 3 * 16 * len(rows) + 1_000_000
    assert (steps.median_and_p99(len(rows))[1] == 1).all()
