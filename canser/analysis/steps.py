"""Median and 99th percentile of the steps of time of many ids, in bounded memory."""

from typing import Final

import numpy as np
import numpy.typing as npt

from canser.analysis.ids import find_runs

__all__ = ["StepStatistics"]

# The most steps of a row that are kept as they are: 16 KiB for each row. A row with more steps is
# counted in a histogram. Most ids of a file of up to an hour have fewer, and their results are
# exact.
_KEPT_MOST: Final = 1 << 10

# Steps that are collected before all rows are sorted: half a megabyte. With a smaller number the
# rows would be sorted more often than needed.
_NEW_MOST: Final = 1 << 15

# The number of a bin is the upper bits of a float64: its exponent and the upper 7 of its 52
# fraction bits. So the width of a bin is at most 1/128 of its values, and steps of 64 bits need at
# most 64 * 128 bins.
_BIN_SHIFT: Final = 52 - 7

_Rows = npt.NDArray[np.intp]
_Steps = npt.NDArray[np.uint64]
_Floats = npt.NDArray[np.float64]


class StepStatistics:
    """Median and 99th percentile of the steps of many rows. A row is a number from 0 on.

    Both are exact for a row with up to 1,024 steps. For a row with more, they are exact if all
    steps in a bin are equal, as with a clock of milliseconds; otherwise within 1/128.

    A row without steps needs no memory. A row with up to 1,024 steps needs 16 bytes for each step.
    A row with more needs at most 144 KiB: 1,024 steps, and a histogram of up to 8,192 bins of 16
    bytes.
    """

    def __init__(self) -> None:
        # Steps that are not in a histogram: sorted by row, and newer ones that are not sorted.
        self._rows, self._steps = np.zeros(0, np.intp), np.zeros(0, np.uint64)
        self._new: list[tuple[_Rows, _Steps]] = []
        self._new_count = 0
        self._histograms: dict[int, _Histogram] = {}

    def add(self, rows: npt.ArrayLike, steps: _Steps) -> None:
        """Add steps of rows.

        Parameters
        ----------
        rows : array_like of int
            The row of each step, shape (n,).
        steps : ndarray of uint64
            Nanoseconds, greater than 0, shape (n,). The caller must not change the array later.
        """
        if not len(steps):
            return
        self._new.append((np.asarray(rows, np.intp), steps))
        self._new_count += len(steps)
        # Sort only when as many are new as are sorted, so that each step is sorted a few times.
        if self._new_count > max(len(self._steps), _NEW_MOST):
            self._sort()

    def median_and_p99(self, row_count: int) -> tuple[_Floats, _Floats]:
        """Return the median and the 99th percentile of the rows from 0 to `row_count` - 1.

        Returns
        -------
        median, p99 : ndarray of float64
            Nanoseconds, shape (row_count,), NaN for a row without steps. The 99th percentile is
            the shortest step for which at least 99 % of the steps are not longer.
        """
        self._sort()
        self._fold(np.isin(self._rows, [*self._histograms]))
        median, p99 = np.full(row_count, np.nan), np.full(row_count, np.nan)
        order = np.lexsort((self._steps, self._rows))
        rows, steps = self._rows[order], self._steps[order].astype(np.float64)
        starts, counts = find_runs(rows)
        lower, upper, high = (starts + rank for rank in _ranks(counts))
        median[rows[starts]] = (steps[lower] + steps[upper]) / 2
        p99[rows[starts]] = steps[high]
        for row, histogram in self._histograms.items():
            median[row], p99[row] = histogram.median_and_p99()
        return median, p99

    def _sort(self) -> None:
        """Sort the kept steps by row; move those of rows with too many into histograms."""
        rows, steps = zip((self._rows, self._steps), *self._new, strict=True)
        self._rows, self._steps = np.concatenate(rows), np.concatenate(steps)
        self._new, self._new_count = [], 0
        order = np.argsort(self._rows, kind="stable")
        self._rows, self._steps = self._rows[order], self._steps[order]
        counts = find_runs(self._rows)[1]
        self._fold(np.repeat(counts > _KEPT_MOST, counts))

    def _fold(self, chosen: npt.NDArray[np.bool_]) -> None:
        """Move the chosen ones of the sorted steps into the histograms of their rows."""
        if not chosen.any():
            return
        rows, steps = self._rows[chosen], self._steps[chosen].astype(np.float64)
        starts, counts = find_runs(rows)
        for row, start, count in zip(
            rows[starts].tolist(), starts.tolist(), counts.tolist(), strict=True
        ):
            self._histograms.setdefault(row, _Histogram()).add(steps[start : start + count])
        self._rows, self._steps = self._rows[~chosen], self._steps[~chosen]


class _Histogram:
    """The steps of one row, counted in bins whose width is at most 1/128 of their values."""

    def __init__(self) -> None:
        self._lowest = 0  # the number of the first bin
        self._counts = np.zeros(0, np.int64)
        self._sums = np.zeros(0, np.float64)

    def add(self, steps: _Floats) -> None:
        """Count steps: nanoseconds, greater than 0."""
        bins = steps.view(np.int64) >> _BIN_SHIFT
        self._widen(int(bins.min()), int(bins.max()))
        bins -= self._lowest
        self._counts += np.bincount(bins, minlength=len(self._counts))
        self._sums += np.bincount(bins, steps, len(self._sums))

    def median_and_p99(self) -> tuple[float, float]:
        """Return both: each is the mean of the steps in its bin."""
        upto = np.cumsum(self._counts)
        bins = np.searchsorted(upto, np.array(_ranks(upto[-1])), side="right")
        lower, upper, high = (self._sums[bins] / self._counts[bins]).tolist()
        return (lower + upper) / 2, high

    def _widen(self, lowest: int, highest: int) -> None:
        """Make room for the bins from `lowest` to `highest`."""
        if not len(self._counts):
            self._lowest = lowest
        below = max(self._lowest - lowest, 0)
        above = max(highest + 1 - self._lowest - len(self._counts), 0)
        if below or above:
            self._lowest -= below
            self._counts = np.pad(self._counts, (below, above))
            self._sums = np.pad(self._sums, (below, above))


def _ranks(counts: npt.NDArray[np.int64]) -> tuple[_Rows, _Rows, _Rows]:
    """Return the indexes of the two middle steps (the same if odd) and of the 99th percentile.

    `counts`: the numbers of sorted steps.
    """
    return (counts - 1) // 2, counts // 2, (99 * counts + 99) // 100 - 1
