"""What frames amount to: counts, times, ids, gathered block by block."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from canser._frames import NO_TIME, FrameArray
from canser.timing.restarts import Clock

__all__ = ["IdTally", "Steps", "Tally"]

_EXT = 1 << 32  # above the bits of an id, in the keys below

# So many steps are kept as they are: 8 KiB of an id, and exact for most of the ids of a file
# of an hour and less. More are counted in bins.
_STEPS_KEPT: Final = 1 << 10

# The bins are the upper bits of a float64: its exponent and 7 of the 52 bits behind it. So
# each is at most 1/128 of its values wide.
_BIN_SHIFT: Final = 52 - 7

_StepArray = npt.NDArray[np.uint64]


class Steps:
    """Steps of time and their median, in memory that does not grow with them.

    The median is exact of up to 1,024 steps, and of any number if those in its bin are equal,
    as those of a clock of milliseconds are; else within 1/128.
    """

    def __init__(self) -> None:
        self._kept: _StepArray = np.zeros(0, np.uint64)
        # Bins of those that are not kept, the lowest first: how many, and their sums.
        self._lowest = 0
        self._counts = np.zeros(0, np.int64)
        self._sums = np.zeros(0, np.float64)

    def add(self, steps: _StepArray) -> None:
        """Go on with steps: nanoseconds, over 0."""
        self._kept = np.concatenate([self._kept, steps])
        if len(self._kept) > _STEPS_KEPT:
            self._fold()

    @property
    def median_ns(self) -> float | None:
        """The median; None where there are no steps."""
        if len(self._counts) and len(self._kept):
            self._fold()
        if not len(self._counts):
            return float(np.median(self._kept)) if len(self._kept) else None
        upto = np.cumsum(self._counts)
        # The two in the middle, which are one where the number of steps is odd.
        ranks = [(int(upto[-1]) - 1) // 2, int(upto[-1]) // 2]
        bins = np.searchsorted(upto, ranks, side="right")
        return float((self._sums[bins] / self._counts[bins]).mean())

    def _fold(self) -> None:
        """Count the kept steps in their bins."""
        steps = self._kept.astype(np.float64)
        bins = steps.view(np.int64) >> _BIN_SHIFT
        self._widen(int(bins.min()), int(bins.max()))
        bins -= self._lowest
        self._counts += np.bincount(bins, minlength=len(self._counts))
        self._sums += np.bincount(bins, steps, len(self._sums))
        self._kept = np.zeros(0, np.uint64)

    def _widen(self, lowest: int, highest: int) -> None:
        """Make room for bins."""
        if not len(self._counts):
            self._lowest = lowest
        below = max(self._lowest - lowest, 0)
        above = max(highest + 1 - self._lowest - len(self._counts), 0)
        if below or above:
            self._lowest -= below
            self._counts = np.pad(self._counts, (below, above))
            self._sums = np.pad(self._sums, (below, above))


@dataclass(slots=True)
class IdTally:
    """The frames of one arbitration id."""

    count: int = 0
    remote: int = 0
    dlc_least: int = 8
    dlc_most: int = 0
    last: int = 0  # the last known time
    stretch: int = 0  # what stretch of the clock that time is of; 0 for none
    steps: Steps = field(default_factory=Steps)  # forward, between frames of one stretch

    def add(self, count: int, remote: int, dlc_least: int, dlc_most: int) -> None:
        """Count frames: how many, how many are remote, the least and the most dlc."""
        self.count += count
        self.remote += remote
        self.dlc_least = min(self.dlc_least, dlc_least)
        self.dlc_most = max(self.dlc_most, dlc_most)

    def add_times(self, last: int, stretch: int, steps: _StepArray) -> None:
        """Count steps; the last time, and the stretch that it is of."""
        self.last, self.stretch = last, stretch
        if len(steps):
            self.steps.add(steps)

    @property
    def period_ns(self) -> float | None:
        """The median of the steps forward; None where there is none."""
        return self.steps.median_ns


@dataclass(slots=True)
class Tally:
    """The frames of a stream, and of each of its ids."""

    count: int = 0
    extended: int = 0
    remote: int = 0
    errors: int = 0
    clock: Clock = field(default_factory=Clock)
    dlc: list[int] = field(default_factory=lambda: [0] * 9)  # frames by their dlc
    ids: dict[tuple[int, bool], IdTally] = field(default_factory=dict)  # by id and ext

    def add(self, frames: FrameArray) -> None:
        """Count frames."""
        if not len(frames):
            return
        self.count += len(frames)
        self.extended += int(frames["ext"].sum())
        self.remote += int(frames["rtr"].sum())
        self.errors += int(frames["err"].sum())
        for dlc, count in enumerate(np.bincount(frames["dlc"], minlength=9)[:9]):
            self.dlc[dlc] += int(count)
        keys = frames["id"].astype(np.int64) + np.where(frames["ext"], _EXT, 0)
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        starts = _starts(keys)
        dlcs = frames["dlc"][order]
        totals = (
            np.diff(starts, append=len(order)),
            np.add.reduceat(frames["rtr"][order], starts, dtype=np.int64),
            np.minimum.reduceat(dlcs, starts),
            np.maximum.reduceat(dlcs, starts),
        )
        ids = self._find(keys[starts])
        for one, *total in zip(ids, *(each.tolist() for each in totals), strict=True):
            one.add(*total)
        self._add_times(frames["ts"], order, keys)

    def _find(self, keys: npt.NDArray[np.int64]) -> list[IdTally]:
        """Return what there is of each id, of new ones nothing yet."""
        names = [(key & (_EXT - 1), key >= _EXT) for key in keys.tolist()]
        for name in names:
            if name not in self.ids:
                self.ids[name] = IdTally()
        return [self.ids[name] for name in names]

    def _add_times(
        self, ts: npt.NDArray[np.int64], order: npt.NDArray[np.intp], keys: npt.NDArray[np.int64]
    ) -> None:
        """Count the steps between frames of one id; `order` sorts times by id, as `keys` are."""
        known = ts != NO_TIME
        stretches = np.zeros(len(ts), np.int64)
        stretches[known] = self.clock.add(ts[known])
        if not known.all():
            keys, order = keys[known[order]], order[known[order]]
            if not len(order):
                return
        ts, stretches = ts[order], stretches[order]
        starts = _starts(keys)
        ends = np.append(starts[1:], len(order)) - 1
        ids = self._find(keys[starts])
        before = _behind(ts, [one.last for one in ids], starts)
        good = stretches == _behind(stretches, [one.stretch for one in ids], starts)
        good &= ts > before
        # Unsigned: then the longest step is no overflow.
        steps = (ts - before).view(np.uint64)[good]
        upto = np.cumsum(np.add.reduceat(good, starts, dtype=np.int64))
        parts = np.split(steps, upto[:-1])
        lasts = ts[ends].tolist(), stretches[ends].tolist()
        for one, last, stretch, part in zip(ids, *lasts, parts, strict=True):
            one.add_times(last, stretch, part)


def _starts(keys: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
    """Return where the runs of equal keys start."""
    return np.flatnonzero(np.diff(keys, prepend=-1))


def _behind(
    values: npt.NDArray[np.int64], first: list[int], starts: npt.NDArray[np.intp]
) -> npt.NDArray[np.int64]:
    """Return for each value the one before it, `first` for those at `starts`."""
    before = np.empty_like(values)
    before[1:] = values[:-1]
    before[starts] = first
    return before
