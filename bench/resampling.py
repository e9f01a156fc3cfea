"""Signals on one time base: the work in C over numpy, and whole calls over numpy and polars.

Rows of `table.py`. The results are compared first.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from bus_numbers import NumberRow
from canser._core.resample import Grid, resample_linear, resample_previous
from canser.signals.signal import Signal
from canser.signals.signals import Group, Signals
from measure import paired

STEP_NS, MAX_AGE_NS = 1_000_000, 1_000_000_000
POINTS = 1_090_000

Times = npt.NDArray[np.int64]
Values = npt.NDArray[np.float64]
Found = tuple[Values, npt.NDArray[np.bool_]]
Pair = tuple[str, Callable[[], object], Callable[[], object], float | None]


def samples(count: int) -> Signals:
    """Return a periodic signal, as long as the grid, with jitter and a few silences."""
    rng = np.random.default_rng(1)
    period = POINTS * STEP_NS // count
    ts = np.arange(count) * period + rng.integers(0, max(period // 10, 1), count)
    kept = rng.random(count // 1000 + 1).repeat(1000)[:count] > 0.01
    signal = Signal(
        name="S",
        message="M",
        group="M",
        ts=ts[kept].view("M8[ns]"),
        values=rng.random(int(kept.sum())),
    )
    no_report: Any = None  # resampling does not look at it
    return Signals({"M": Group("M", "M", signal.ts, {"S": signal})}, no_report)


def numpy_grid(ts: Times) -> Times:
    """Return the multiples of the step between the first sample and the last one."""
    first = -(-int(ts[0]) // STEP_NS) * STEP_NS
    return np.arange(first, int(ts[-1]) + 1, STEP_NS)


def numpy_previous(ts: Times, values: Values, grid: Times) -> Found:
    """Return the last values and where there are such."""
    at = np.searchsorted(ts, grid, "right") - 1
    valid = grid - ts.take(at) <= MAX_AGE_NS
    found = values.take(at)
    found[~valid] = np.nan
    return found, valid


def numpy_linear(ts: Times, values: Values, grid: Times) -> Found:
    """Return the values on lines and where there are such."""
    found = np.interp(grid, ts, values)
    at = np.searchsorted(ts, grid, "right") - 1
    valid = np.append(np.diff(ts) <= MAX_AGE_NS, False).take(at) | (ts.take(at) == grid)
    found[~valid] = np.nan
    return found, valid


def compare(found: Found, expected: Found) -> None:
    assert np.array_equal(found[1], expected[1]), "what is missing is wrong"
    assert np.allclose(found[0], expected[0], 1e-12, 1e-12, equal_nan=True), "values are wrong"


def pairs(signals: Signals) -> Iterator[Pair]:
    """Yield what is measured, and how."""
    ts, values = signals["S"].ts.view(np.int64), signals["S"].values
    grid = numpy_grid(ts)
    given = Grid(len(grid), times=grid)
    out = np.zeros(len(grid)), np.zeros(len(grid), np.bool_)
    for how, ours, numpys, required in (
        ("previous", resample_previous, numpy_previous, 10.0),
        ("linear", resample_linear, numpy_linear, None),
    ):
        ours((ts, values), given, MAX_AGE_NS, out)
        compare(out, numpys(ts, values, grid))
        yield (
            f"{how}, onto given times, over numpy",
            lambda numpys=numpys: numpys(ts, values, grid),  # type: ignore[misc]
            lambda ours=ours: ours((ts, values), given, MAX_AGE_NS, out),  # type: ignore[misc]
            required,
        )
    whole = signals.resample("1ms", max_age="1s")
    assert np.array_equal(whole.ts.view(np.int64), grid), "the grid is wrong"
    assert whole["S"].valid is not None
    compare((whole["S"].values, whole["S"].valid), numpy_previous(ts, values, grid))

    def by_numpy() -> Any:
        made = numpy_grid(ts)
        return made, numpy_previous(ts, values, made)

    yield "resample to a step, over numpy", by_numpy, lambda: resampled(signals), None
    try:
        import polars as pl  # noqa: PLC0415 - an optional extra
    except ImportError:
        return

    def by_polars() -> Any:
        left = pl.DataFrame({"ts": numpy_grid(ts)}).set_sorted("ts")
        right = pl.DataFrame({"ts": ts, "value": values}).set_sorted("ts")
        return left.join_asof(right, on="ts", tolerance=MAX_AGE_NS)

    found = by_polars()["value"].fill_null(np.nan).to_numpy()
    assert np.array_equal(found, whole["S"].values, equal_nan=True)
    yield "resample to a step, over polars", by_polars, lambda: resampled(signals), None


def resampled(signals: Signals) -> object:
    return signals.resample("1ms", max_age="1s")


def rows(rounds: int) -> Iterator[NumberRow]:
    """Yield the rows, of a signal of 10 ms and of one of 1 ms."""
    for period_ms in (10, 1):
        for what, peer, ours, required in pairs(samples(POINTS // period_ms)):
            peer_s, our_s, ratio = paired(peer, ours, rounds)
            note = f"a signal of {period_ms} ms to {POINTS / 1e6:.2f} M times, "
            note += f"{our_s * 1e3:.2f} ms, peer {peer_s * 1e3:.2f}"
            yield NumberRow(what, "", ratio, required, note)


def main() -> None:
    """Print the rows alone."""
    for row in rows(11):
        required = "" if row.required is None else f"{row.required:.3g}"
        print(f"{row.what:40} {row.reached:8.3g} {required:>8}  {row.note}", flush=True)


if __name__ == "__main__":
    main()
