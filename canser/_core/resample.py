"""Values of signals at other times: C's work for each time of a grid."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser._core._lib import ffi, lib
from canser._core.buffers import NULL, raise_status

__all__ = ["Grid", "are_rising", "resample_linear", "resample_previous"]

_NO_LIMIT: Final = 2**64 - 1

Times = npt.NDArray[np.int64]
Values = npt.NDArray[Any]
Flags = npt.NDArray[np.bool_]

# Rising times, and as many values; both contiguous.
Samples = tuple[Times, Values]

# Values, and where there is one; both as long as the grid.
Found = tuple[Values, Flags]


@dataclass(frozen=True, eq=False)
class Grid:
    """The times for which values are asked: rising and contiguous, or first + i * step."""

    count: int
    first: int = 0
    step: int = 1
    times: Times | None = None


def are_rising(ts: Times) -> bool:
    """Return whether no time of a contiguous array is before the one in front of it."""
    rise = ffi.new("uint8_t *")
    status = lib.canser_times_rise(ffi.from_buffer("int64_t[]", ts), len(ts), rise)
    if status:
        raise_status(status)
    return bool(rise[0])


def resample_previous(samples: Samples, grid: Grid, max_age: int | None, out: Found) -> None:
    """Fill `out` with the last value at or before each time of the grid.

    Values are int64, uint64 or float64. Where there is none, it is 0, or NaN.
    """
    _resample(lib.canser_resample_previous, samples, grid, max_age, out)


def resample_linear(samples: Samples, grid: Grid, max_age: int | None, out: Found) -> None:
    """Fill `out` with the values on the lines between samples; all are float64."""
    _resample(lib.canser_resample_linear, samples, grid, max_age, out)


def _resample(function: Any, samples: Samples, grid: Grid, max_age: int | None, out: Found) -> None:
    (ts, values), (found, valid) = samples, out
    assert len(ts) == len(values)
    assert len(found) == len(valid) == grid.count
    assert found.dtype == values.dtype
    assert found.itemsize == 8
    ts_at, values_at = ffi.from_buffer("int64_t[]", ts), ffi.from_buffer(values)
    times_at = NULL if grid.times is None else ffi.from_buffer("int64_t[]", grid.times)
    missing = np.array(np.nan if found.dtype.kind == "f" else 0, found.dtype)
    status = function(
        ffi.new("canser_samples *", (ts_at, values_at, len(ts))),
        ffi.new("canser_grid *", (times_at, grid.first, grid.step, grid.count)),
        _NO_LIMIT if max_age is None else min(max_age, _NO_LIMIT),
        int(missing.view(np.uint64)),
        ffi.from_buffer(found),
        ffi.from_buffer("uint8_t[]", valid),
    )
    if status:
        raise_status(status)
