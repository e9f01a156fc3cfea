"""What the intervals of an id tell: whether it is periodic, its period, and what is missing."""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["FEW", "Intervals", "Pattern", "find_pattern"]

# An id with fewer frames is not judged.
FEW: Final = 10

# An id is periodic if this share of its intervals lies between these numbers of their median, and
# if few are longer than `_SILENCE` of it: otherwise the frames of a burst would make a period.
_SHARE: Final = 0.8
_NEAR: Final = 0.5, 1.5
_SILENCE: Final = 5
_SILENT_MOST: Final = 0.01

# Frames come in bursts if the longer intervals are at least this many times as long as the shorter
# ones, and if a burst has this many frames on average. The longer ones are those that only 3 of 100
# exceed: the longest message of several frames in common use, NMEA 2000's, has 32.
_RATIO_LEAST: Final = 5
_SHORT, _LONG = 0.1, 0.97
_BURST_LEAST: Final = 1.5

_Floats = npt.NDArray[np.float64]


class Intervals:
    """Intervals of one id in ascending order, each counted: a list, or the bins of a histogram.

    `values`: nanoseconds, ascending, shape (n,). `counts`: how often each occurs, shape (n,).
    """

    def __init__(self, values: _Floats, counts: npt.NDArray[np.int64] | None = None) -> None:
        self._values, self._counts = values, counts
        self._upto = None if counts is None else np.cumsum(counts)
        if self._upto is None or not len(values):
            self.count = len(values)
        else:
            self.count = int(self._upto[-1])

    def at(self, share: float) -> float:
        """Return the shortest interval that at least a `share` of all do not exceed."""
        return self._ranked(max(int(np.ceil(share * self.count)), 1) - 1)

    @property
    def sum(self) -> float:
        """The sum of all."""
        return self._total(self._values)

    def missing(self, period: float) -> float:
        """Return how many intervals of a period are left out."""
        return self._total(np.maximum(np.rint(self._values / period) - 1, 0))

    @property
    def median(self) -> float:
        """The median: the mean of the two in the middle if the number is even."""
        return (self._ranked((self.count - 1) // 2) + self._ranked(self.count // 2)) / 2

    def between(self, least: float, most: float) -> "Intervals":
        """Return those that are not shorter than `least` and not longer than `most`."""
        return self._part(int(np.searchsorted(self._values, least)), self._end(most))

    def above(self, limit: float) -> "Intervals":
        """Return those that are longer than `limit`."""
        return self._part(self._end(limit), len(self._values))

    def longer_by(self, time: float) -> "Intervals":
        """Return intervals that are all longer by a time."""
        return Intervals(self._values + time, self._counts)

    def _end(self, most: float) -> int:
        return int(np.searchsorted(self._values, most, "right"))

    def _part(self, first: int, end: int) -> "Intervals":
        counts = None if self._counts is None else self._counts[first:end]
        return Intervals(self._values[first:end], counts)

    def _total(self, values: _Floats) -> float:
        return float(values.sum() if self._counts is None else values @ self._counts)

    def _ranked(self, rank: int) -> float:
        if self._upto is not None:
            rank = int(np.searchsorted(self._upto, rank, "right"))
        return float(self._values[rank])


class Pattern(NamedTuple):
    """How the frames of an id come. What does not apply is NaN."""

    #: "periodic", "bursts", "event", or "few" for less than 10 frames.
    name: str
    #: Nanoseconds from one frame, or from one burst, to the next.
    period_ns: float = np.nan
    #: Frames in a burst.
    burst: float = np.nan
    #: P99 - P1 of the intervals between 0.5 and 1.5 periods, in nanoseconds.
    jitter_ns: float = np.nan
    #: Frames that are missing, by the period.
    missing: float = np.nan


def find_pattern(intervals: Intervals, frame_count: int, unit_ns: int) -> Pattern:
    """Return how the frames of an id come.

    `unit_ns`: the step of the times.
    """
    if frame_count < FEW or not intervals.count:
        return Pattern("few")
    median = intervals.median
    if _is_periodic(intervals, median):
        return Pattern("periodic", median, 1.0, *_regularity(intervals, median))
    short, long = max(intervals.at(_SHORT), unit_ns), intervals.at(_LONG)
    if long < _RATIO_LEAST * short:
        return Pattern("event")
    pauses = intervals.above(float(np.sqrt(short * long)))
    within_ns = intervals.sum - pauses.sum
    burst_count = pauses.count + 1
    # From the start of a burst to that of the next one.
    starts = pauses.longer_by(within_ns / burst_count)
    burst = frame_count / burst_count
    if burst < _BURST_LEAST or not starts.count or not _is_periodic(starts, starts.median):
        return Pattern("event")
    jitter, missing = _regularity(starts, starts.median)
    return Pattern("bursts", starts.median, burst, jitter, float(round(missing * burst)))


def _is_periodic(intervals: Intervals, median: float) -> bool:
    near = intervals.between(*(times * median for times in _NEAR))
    silent = intervals.above(_SILENCE * median)
    most = max(_SILENT_MOST * intervals.count, 1)
    return median > 0 and near.count >= _SHARE * intervals.count and silent.count <= most


def _regularity(intervals: Intervals, period: float) -> tuple[float, float]:
    """Return jitter and missing frames, or bursts, of a period."""
    near = intervals.between(*(times * period for times in _NEAR))
    return near.at(0.99) - near.at(0.01), intervals.missing(period)
