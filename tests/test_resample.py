"""Signals on one time base, against a search through all samples in plain Python."""

import datetime as dt
import math
import threading
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser.signals.signal import Signal
from canser.signals.signals import Group, Resampled, Signals

FIRST, LAST = -(2**63) + 1, 2**63 - 1
NO_REPORT: Any = None  # resampling does not look at it


def as_times(ts: Any) -> npt.NDArray[np.datetime64]:
    return np.asarray(ts, np.int64).view("M8[ns]")


def signals_of(**groups: tuple[Any, Mapping[str, Any]]) -> Signals:
    """Return signals of the times and the values of each group."""
    made = {}
    for name, (ts, columns) in groups.items():
        times = as_times(ts)
        group = {
            column: Signal(
                name=column, message=name, group=name, ts=times, values=np.asarray(values)
            )
            for column, values in columns.items()
        }
        made[name] = Group(name, name, times, group)
    return Signals(made, NO_REPORT)


def one(ts: Any, values: Any, **fields: Any) -> Signals:
    """Return one signal, S of the message M."""
    signal = Signal(
        name="S", message="M", group="M", ts=as_times(ts), values=np.asarray(values), **fields
    )
    return Signals({"M": Group("M", "M", signal.ts, {"S": signal})}, NO_REPORT)


def plain(
    ts: list[int], values: list[Any], grid: list[int], how: str, max_age: int | None
) -> list[Any]:
    """Return the value at each time, or None, by a look at all samples."""
    found: list[Any] = []
    samples = sorted(zip(ts, values, strict=True), key=lambda sample: sample[0])  # stable
    for t in grid:
        before = [sample for sample in samples if sample[0] <= t]
        behind = [sample for sample in samples if sample[0] > t]
        if not before:
            found.append(None)
        elif how == "previous":
            age = t - before[-1][0]
            found.append(before[-1][1] if max_age is None or age <= max_age else None)
        elif before[-1][0] == t:
            found.append(float(before[-1][1]))
        elif not behind or (max_age is not None and behind[0][0] - before[-1][0] > max_age):
            found.append(None)
        else:
            (t0, a), (t1, b) = before[-1], behind[0]
            a, b = Fraction(float(a)), Fraction(float(b))
            found.append(float(a + (b - a) * Fraction(t - t0, t1 - t0)))
    return found


def values_of(signal: Signal) -> list[Any]:
    """Return the values, and None where there is none; there they are NaN or 0."""
    assert signal.valid is not None
    for value in signal.values[~signal.valid].tolist():
        assert value == 0 or math.isnan(value)
    return [
        value if there else None
        for value, there in zip(signal.values.tolist(), signal.valid.tolist(), strict=True)
    ]


near = st.integers(-60, 60)
far = st.one_of(near, st.integers(FIRST, LAST), st.sampled_from([FIRST, FIRST + 1, LAST - 1, LAST]))
ages = st.one_of(st.none(), st.integers(0, 70), st.integers(0, 8_640_000_000 * 10**9))
kinds = st.sampled_from([np.int64, np.uint64, np.float64])


@st.composite
def series(draw: st.DrawFn, times: st.SearchStrategy[int]) -> tuple[list[int], Any]:
    ts = draw(st.lists(times, max_size=12))
    kind = draw(kinds)
    if kind is np.float64:
        one_value = st.floats(-1e6, 1e6)
    else:
        low = 0 if kind is np.uint64 else -(2**63)
        one_value = st.integers(low, low + 2**64 - 1)
    return ts, np.array(draw(st.lists(one_value, min_size=len(ts), max_size=len(ts))), kind)


@given(series(far), st.lists(far, max_size=20), ages)
def test_the_last_value_before_a_time(
    samples: tuple[list[int], Any], times: list[int], max_age: int | None
) -> None:
    ts, values = samples
    grid = np.array(sorted(times), np.int64)
    found = one(ts, values).resample(grid, max_age=max_age)
    assert found["S"].values.dtype == values.dtype
    assert values_of(found["S"]) == plain(ts, values.tolist(), grid.tolist(), "previous", max_age)
    assert found.ts.view(np.int64).tolist() == grid.tolist()


@given(series(far), st.lists(far, max_size=20), ages)
def test_values_on_lines(
    samples: tuple[list[int], Any], times: list[int], max_age: int | None
) -> None:
    ts, values = samples
    grid = np.array(sorted([*times, *ts[:3]]), np.int64)
    found = one(ts, values).resample(grid, how="linear", max_age=max_age)["S"]
    assert found.values.dtype == np.float64
    expected = plain(ts, values.tolist(), grid.tolist(), "linear", max_age)
    largest = float(np.abs(values.astype(np.float64)).max()) if len(ts) else 0
    for t, value, right in zip(grid.tolist(), values_of(found), expected, strict=True):
        if right is None or t in ts:
            assert value == right
        else:
            assert value == pytest.approx(right, rel=1e-14, abs=1e-15 * largest)


@given(
    series(near), series(near), st.integers(1, 40), ages, st.sampled_from(["previous", "linear"])
)
def test_the_grid_of_a_step(
    first: tuple[list[int], Any],
    second: tuple[list[int], Any],
    step: int,
    max_age: int | None,
    how: str,
) -> None:
    signals = signals_of(A=(first[0], {"S": first[1]}), B=(second[0], {"T": second[1]}))
    found = signals.resample(step, how=how, max_age=max_age)
    every = first[0] + second[0]
    grid = [
        t for t in range(-100, 100) if t % step == 0 and every and min(every) <= t <= max(every)
    ]
    assert found.ts.view(np.int64).tolist() == grid
    by_times = signals.resample(as_times(grid), how=how, max_age=max_age)
    for name in signals:
        assert found[name].ts is found.ts
        assert values_of(found[name]) == values_of(by_times[name])


def test_a_line_stays_between_its_ends_and_ends_at_the_samples() -> None:
    rng = np.random.default_rng(1)
    ts = np.cumsum(rng.integers(1, 50, 500))
    values = rng.choice([0.1, 0.7, 1e300, -1e308, 1.7e308, -0.0, 5e-324], 500)
    grid = np.arange(int(ts[0]), int(ts[-1]) + 1)
    found = one(ts, values).resample(grid, how="linear")["S"].values
    assert found[ts - ts[0]].tobytes() == values.tobytes()
    place = np.searchsorted(ts, grid, "right") - 1
    after = np.minimum(place + 1, len(ts) - 1)
    assert (found >= np.minimum(values[place], values[after])).all()
    assert (found <= np.maximum(values[place], values[after])).all()


def test_values_that_are_not_finite() -> None:
    signals = one([0, 10, 20, 30], [1.0, np.inf, np.nan, 2.0])
    found = signals.resample(5, how="linear")["S"]
    assert found.valid is not None
    assert found.valid.all()
    assert np.array_equal(
        found.values, [1, np.inf, np.inf, np.nan, np.nan, np.nan, 2], equal_nan=True
    )
    assert values_of(one([0], [np.inf]).resample(5)["S"]) == [np.inf]


def test_whole_numbers_of_64_bits_stay_exact() -> None:
    large = [2**53 + 1, 2**64 - 1, 0]
    found = one([0, 10, 20], np.array(large, np.uint64)).resample(10)["S"]
    assert found.values.dtype == np.uint64
    assert found.values.tolist() == large


def test_the_last_of_several_samples_of_one_time() -> None:
    ts, values = [0, 0, 10, 10, 20], [1.0, 2.0, 4.0, 8.0, 16.0]
    assert values_of(one(ts, values).resample(5)["S"]) == [2, 2, 8, 8, 16]
    # The line ends at the first of them, and the next one begins at the last.
    assert values_of(one(ts, values).resample(5, how="linear")["S"]) == [2, 3, 8, 12, 16]


def test_times_that_go_back_are_sorted_and_stay_in_their_order() -> None:
    signals = one([20, 30, 0, 10, 20], [1, 2, 3, 4, 5])
    before = signals["S"].values.copy()
    assert values_of(signals.resample(10)["S"]) == [3, 4, 5, 2]
    assert np.array_equal(signals["S"].values, before)
    onto = signals.resample("S")
    assert onto.ts.view(np.int64).tolist() == [0, 10, 20, 20, 30]
    assert values_of(onto["S"]) == [3, 4, 5, 5, 2]


@pytest.mark.parametrize(("age", "there"), [(4, False), (5, True), (6, True), (None, True)])
def test_an_age_at_its_limit(age: int | None, there: bool) -> None:
    signals = one([0, 5, 10], [1, 2, 3])
    found = signals.resample([10, 15], max_age=age)["S"]
    assert found.valid is not None
    assert found.valid.tolist() == [True, there]
    line = signals.resample([0, 2], how="linear", max_age=age)["S"]
    assert line.valid is not None
    assert line.valid.tolist() == [True, there]


def test_no_age_but_that_of_the_time_itself() -> None:
    assert values_of(one([0, 5], [1, 2]).resample([0, 1, 5], max_age=0)["S"]) == [1, None, 2]


def test_the_farthest_times() -> None:
    signals = one([FIRST, LAST], [1, 3])
    found = signals.resample([FIRST, 0, LAST])
    assert values_of(found["S"]) == [1, 1, 3]
    assert values_of(signals.resample([FIRST, 0, LAST], how="linear")["S"]) == [1, 2, 3]
    long = "100000d"
    grid = signals.resample(long).ts.view(np.int64)
    assert grid.tolist() == [-8_640_000_000_000_000_000, 0, 8_640_000_000_000_000_000]
    near_end = one([LAST - 10, LAST], [1, 2]).resample(4)
    assert near_end.ts.view(np.int64).tolist() == [LAST - 7, LAST - 3]
    assert values_of(near_end["S"]) == [1, 1]


@pytest.mark.parametrize(
    "step",
    [
        *("10ms", "10000us", "0.01s", "10 ms", 10_000_000, np.int64(10_000_000)),
        *(dt.timedelta(milliseconds=10), np.timedelta64(10, "ms"), np.timedelta64(10_000, "us")),
    ],
)
def test_steps(step: Any) -> None:
    found = one([1, 25_000_000], [1, 2]).resample(step)
    assert found.ts.view(np.int64).tolist() == [10_000_000, 20_000_000]


def test_a_step_of_pandas() -> None:
    pd = pytest.importorskip("pandas")
    found = one([0, 20], [1, 2]).resample(pd.Timedelta(7, "ns"))
    assert found.ts.view(np.int64).tolist() == [0, 7, 14]
    times = pd.DatetimeIndex(as_times([0, 5, 20])).tz_localize(None)
    assert values_of(one([0, 20], [1, 2]).resample(times)["S"]) == [1, 1, 2]


def test_the_times_of_another_signal() -> None:
    signals = signals_of(A=([0, 10, 20], {"S": [1, 2, 3]}), B=([5, 5, 12], {"T": [7, 8, 9]}))
    expected = [1, 1, 2]
    for grid in ("T", "B.T", "B", signals["T"], signals.groups["B"], signals["T"].ts):
        found = signals.resample(grid)
        assert found.ts.view(np.int64).tolist() == [5, 5, 12]
        assert values_of(found["S"]) == expected
        assert values_of(found["T"]) == [8, 8, 9]
        assert not np.shares_memory(found.ts, signals["T"].ts)


@pytest.mark.parametrize("unit", ["us", "ms", "s", "ns"])
def test_dates_of_other_units(unit: str) -> None:
    times = np.array([0, 1, 1], f"M8[{unit}]")
    found = one([0], [1]).resample(times)
    assert np.array_equal(found.ts, times)
    assert found.ts.dtype == "M8[ns]"


def test_the_grid_is_a_copy() -> None:
    times = np.array([0, 10], np.int64)
    found = one([0], [1]).resample(times)
    times[:] = 7
    assert found.ts.view(np.int64).tolist() == [0, 10]


def test_what_a_signal_says_of_itself_is_kept() -> None:
    texts = {1: "on"}
    raw = np.array([1, 2], np.uint64)
    fields: dict[str, Any] = {"unit": "km/h", "raw": raw}
    signals = one([0, 10], [0.5, 1.0], **fields)
    previous = signals.resample(5)["M.S"]
    assert (previous.unit, previous.message, previous.group) == ("km/h", "M", "M")
    assert previous.raw is not None
    assert previous.raw.tolist() == [1, 1, 2]
    assert previous.raw.dtype == np.uint64
    assert signals.resample(5, how="linear")["S"].raw is None
    with_texts = one([0, 10], [1, 2], choices=texts, raw=raw).resample(5, how="linear")["S"]
    assert with_texts.choices == texts
    assert with_texts.values.dtype == np.int64
    assert values_of(with_texts) == [1, 1, 2]
    assert with_texts.raw is not None
    assert with_texts.raw.tolist() == [1, 1, 2]


def test_signals_without_samples() -> None:
    signals = signals_of(A=([], {"S": np.zeros(0)}), B=([0, 10], {"T": [1, 2]}))
    for how in ("previous", "linear"):
        found = signals.resample(5, how=how)
        assert values_of(found["S"]) == [None] * 3
        assert np.isnan(found["S"].values).all()
    empty = signals_of(A=([], {"S": np.zeros(0)}))
    assert len(empty.resample("10ms").ts) == 0
    assert values_of(empty.resample([1, 2])["S"]) == [None, None]
    nothing = Signals({}, NO_REPORT).resample("10ms")
    assert len(nothing) == len(nothing.ts) == 0
    # No multiple of the step lies between the samples.
    assert len(one([5], [1]).resample(10).ts) == 0


def test_a_mapping() -> None:
    found = signals_of(A=([0], {"S": [1], "T": [2]}), B=([0], {"T": [3]})).resample(1)
    assert isinstance(found, Resampled)
    assert list(found) == ["A.S", "A.T", "B.T"]
    assert "S" in found
    assert "T" not in found
    assert found.get("Q") is None
    with pytest.raises(KeyError, match="in several messages"):
        found["T"]
    assert repr(found) == "<canser.Resampled: 3 signals, 1 times>"


def test_samples_that_do_not_lie_one_behind_the_other() -> None:
    ts = np.arange(20, dtype=np.int64)[::2]
    values = np.arange(30, dtype=np.int64)[::-3]
    found = one(ts, values).resample(1)["S"]
    assert values_of(found) == plain(
        ts.tolist(), values.tolist(), list(range(19)), "previous", None
    )


def test_times_that_are_not_known_are_counted() -> None:
    signals = one([0, canser.NO_TIME, 5, canser.NO_TIME], [1, 2, 3, 4])
    with pytest.raises(ValueError, match=r"2 of 4 samples of M\.S have no time; leave out"):
        signals.resample(5)
    with pytest.raises(ValueError, match="1 of 2 times of the grid are NaT"):
        one([0], [1]).resample([canser.NO_TIME, 5])


def test_a_false_time_does_not_fill_the_memory() -> None:
    late = 1_767_225_600 * 10**9
    with pytest.raises(
        ValueError, match=r"a step of 10 ms makes 176,722,560,001 rows from 1970-"
    ) as e:
        one([0, late], [1, 2]).resample("10ms")
    assert "2026-01-01" in str(e.value)
    assert "252,645,135 rows are the most, which take 4 GiB; give a longer step" in str(e.value)
    with pytest.raises(ValueError, match="18,446,744,073,709,551,615 rows"):
        one([FIRST, LAST], [1, 2]).resample(1)


@pytest.mark.parametrize(
    ("grid", "kind", "message"),
    [
        ("0ms", ValueError, "grid is 0ms; give 1 ns or more"),
        (0, ValueError, "grid is 0; give 1 ns or more"),
        (-5, ValueError, "grid is -5; give 1 ns"),
        (dt.timedelta(-1), ValueError, "give 1 ns or more"),
        (2**63, ValueError, "give 8640000000000000000 ns or less"),
        ("0.5ns", ValueError, "the time 0.5ns is no whole number of nanoseconds"),
        ("200000d", ValueError, "the time 200000d is too long"),
        (np.timedelta64("NaT"), ValueError, "grid is NaT"),
        (np.timedelta64(10**18, "s"), ValueError, "give at most 292 years"),
        (np.timedelta64(1, "ps"), ValueError, "whole nanoseconds"),
        (True, TypeError, "not bool"),
        (0.01, TypeError, "not float"),
        (None, TypeError, "not NoneType"),
        ([0.5, 1.5], TypeError, "not an array of float64"),
        (np.ma.array([1, 2]), TypeError, "masked"),
        (np.zeros((2, 2), np.int64), ValueError, "2 dimensions"),
        ([0, 5, 4], ValueError, r"time 2 of the grid is before .*; give np.sort\(times\)"),
        (np.array([2**63], np.uint64), ValueError, "within 292 years"),
        (np.array(["2500"], "M8[s]"), ValueError, "within 292 years"),
        ("Q", KeyError, "there is no signal 'Q'; there are: M.S; a step is a text such as 10ms"),
    ],
)
def test_grids_that_are_refused(grid: Any, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message):
        one([0, 10], [1, 2]).resample(grid)


@pytest.mark.parametrize(
    ("fields", "kind", "message"),
    [
        ({"how": "next"}, ValueError, "unknown how 'next'; have: previous, linear"),
        ({"max_age": -1}, ValueError, "max_age is -1; give 0 ns or more"),
        ({"max_age": 0.5}, TypeError, "max_age must be a text such as 10ms"),
        ({"max_age": "S"}, ValueError, "cannot read the time 'S'"),
    ],
)
def test_options_that_are_refused(
    fields: dict[str, Any], kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=message):
        one([0, 10], [1, 2]).resample(5, **fields)


def test_a_signal_that_was_made_wrongly() -> None:
    with pytest.raises(ValueError, match=r"M\.S has 3 times, and the shape of its values is"):
        one([0, 1, 2], [1, 2]).resample(1)
    with pytest.raises(ValueError, match="shape of its raw values"):
        one([0, 1], [1, 2], raw=np.zeros(1)).resample(1)
    with pytest.raises(TypeError, match=r"values of M\.S are float32"):
        one([0], np.zeros(1, np.float32)).resample(1)
    wrong = Signal(
        name="S", message="M", group="M", ts=np.zeros(1, "M8[us]"), values=np.zeros(1, np.int64)
    )
    with pytest.raises(TypeError, match=r"times of M\.S are an array of datetime64"):
        Signals({"M": Group("M", "M", wrong.ts, {"S": wrong})}, NO_REPORT).resample(1)


@pytest.mark.parametrize("max_age", [None, 3_000])
def test_as_pandas_does_it(max_age: int | None) -> None:
    pd = pytest.importorskip("pandas")
    rng = np.random.default_rng(2)
    ts = np.sort(rng.integers(0, 1_000_000, 2_000))
    values = rng.random(2_000)
    grid = np.arange(0, 1_000_000, 100)
    tolerance = None if max_age is None else pd.Timedelta(max_age, "ns")
    expected = pd.merge_asof(
        pd.DataFrame({"ts": as_times(grid)}),
        pd.DataFrame({"ts": as_times(ts), "value": values}),
        on="ts",
        tolerance=tolerance,
    )["value"].to_numpy()
    found = one(ts, values).resample(grid, max_age=max_age)["S"].values
    assert np.array_equal(found, expected, equal_nan=True)


def test_as_numpy_draws_lines() -> None:
    rng = np.random.default_rng(3)
    ts = np.unique(rng.integers(0, 1_000_000, 2_000))
    values = rng.random(len(ts))
    grid = np.arange(int(ts[0]), int(ts[-1]), 100)
    found = one(ts, values).resample(grid, how="linear")["S"].values
    assert np.allclose(found, np.interp(grid, ts, values), rtol=1e-12, atol=1e-12)


def test_other_threads_run_meanwhile() -> None:
    """The samples are not changed, so several threads may resample the same ones."""
    signals = one(np.arange(0, 100_000, 3), np.arange(33_334))
    expected = signals.resample(7)["S"].values
    found: list[Any] = []
    threads = [
        threading.Thread(target=lambda: found.append(signals.resample(7)["S"].values))
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4
    assert all(np.array_equal(values, expected) for values in found)
