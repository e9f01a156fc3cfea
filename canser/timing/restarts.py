"""Restarts of a clock, and false times, found from the times alone."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

__all__ = ["Clock"]

# A step back of up to this is disorder. An adapter with several mailboxes reports frames out of
# order by milliseconds, and a log of several lines by the time of a read. A longer step back is a
# restart, or a false time. Assumption: each run of a device lasts longer than this, and so does
# each capture that others are joined to. A shorter one adds no time.
_DISORDER_NS: Final = 1_000_000_000

# The most false times in a row, as in the rule of the decoder (csrc/clock.h). On a line that
# damages 1 byte in 100, 1 frame in 25 has a false time, and 5 in a row 1 in 10 million.
_FALSE_MOST: Final = 4

# A single time that is further than this from all others of its stretch, at the stretch's beginning
# or end, is false. A step of this length elsewhere is a silence: there are times on both sides that
# confirm each other.
_SILENCE_NS: Final = 3_600 * 10**9


@dataclass(slots=True)
class _Stretch:
    """Believed times from one restart to the next, each at most `_DISORDER_NS` before the last."""

    number: int  # different for each stretch of the clock
    first: int
    count: int = 1
    recent: list[int] = field(default_factory=list)  # the last times, at most `_FALSE_MOST` + 1

    def fits(self, time: int) -> bool:
        """Whether a time continues from the last one."""
        return time >= self.recent[-1] - _DISORDER_NS

    def add(self, times: list[int], count: int) -> None:
        """Add `count` times, of which `times` are the last."""
        self.count += count
        self.recent = [*self.recent, *times][-_FALSE_MOST - 1 :]

    def drop_last(self, time: int) -> int:
        """Drop the fewest last times from before which `time` continues; return their number.

        Each of them must be far from the one before it, and at least half of all times stay.
        """
        for count in range(1, min(len(self.recent) - 1, max(self.count // 2, 1)) + 1):
            if self.recent[-count] - self.recent[-count - 1] <= _DISORDER_NS:
                return 0
            if time >= self.recent[-count - 1] - _DISORDER_NS:
                del self.recent[-count:]
                self.count -= count
                return count
        return 0

    def drop_first(self) -> int:
        """Drop the first of three times if it is far from the others; return the number dropped."""
        before, after = (b - a for a, b in pairwise(self.recent))
        if before <= _SILENCE_NS or after > _SILENCE_NS:
            return 0
        del self.recent[0]
        self.first, self.count = self.recent[0], 2
        return 1

    @property
    def false_end(self) -> bool:
        """Whether the last time is far from all others."""
        steps = [b - a for a, b in pairwise(self.recent[-3:])]
        return len(steps) == 2 and steps[0] <= _SILENCE_NS < steps[1]

    @property
    def last(self) -> int:
        return self.recent[-2 if self.false_end else -1]


@dataclass(slots=True)
class Clock:
    """Times in the order in which they came, as stretches between restarts.

    At a step back of more than a second, the times right before it or right behind it are false if
    times go on forward without them: the fewest that do, at most 4. If there are none, the clock
    has restarted there. A time alone between two restarts is false. A step forward of any length is
    a silence: a clock that restarts at a later time looks the same.

    Times are judged one after the other, so the result does not depend on how they are cut.
    """

    _closed: int = 0  # stretches that are over
    _closed_first: int = 0  # the first time of the first of them
    _closed_last: int = 0  # the last time of the last of them
    _closed_ns: int = 0  # their sum
    _closed_false: int = 0  # false times so far
    _numbers: int = 0  # numbers given to stretches
    _now: _Stretch | None = None
    # The stretch before the last step back, as long as times may return to it, and how many
    # came since.
    _before: _Stretch | None = None
    _since: int = 0

    @property
    def restarts(self) -> int:
        """How often the clock restarted."""
        return max(self._closed + len(self._open()) - 1, 0)

    @property
    def false_times(self) -> int:
        """How many times are false. All other results leave them out."""
        real = self._open()
        every = [one for one in (self._before, self._now) if one is not None]
        others = sum(one.count for one in every) - sum(one.count for one in real)
        return self._closed_false + others + sum(one.false_end for one in real)

    @property
    def first(self) -> int | None:
        """The first time; None for no times."""
        if self._closed:
            return self._closed_first
        return next((one.first for one in self._open()), None)

    @property
    def last(self) -> int | None:
        """The last time; None for no times."""
        real = self._open()
        if real:
            return real[-1].last
        return self._closed_last if self._closed else None

    @property
    def span_ns(self) -> int | None:
        """The sum of the stretches, each from its first time to its last; None for no times."""
        if self._now is None:
            return None
        return self._closed_ns + sum(one.last - one.first for one in self._open())

    def add(self, times: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Add times; return the number of its stretch for each.

        There is no restart between two times of one number.
        """
        numbers = np.empty(len(times), np.int64)
        turns = iter([*_steps_back(times), len(times)])
        turn = next(turns)
        at = 0
        while at < len(times):
            while turn < at:
                turn = next(turns)
            now = self._now
            # One by one where there is more to judge than whether a time fits.
            if now is None or self._before is not None or now.count < 3 or at in (0, turn):
                numbers[at] = self._add_one(int(times[at]))
                at += 1
                continue
            now.add(times[max(at, turn - _FALSE_MOST - 1) : turn].tolist(), turn - at)
            numbers[at:turn] = now.number
            at = turn
        return numbers

    def _add_one(self, time: int) -> int:
        """Add one time; return the number of its stretch."""
        if self._now is None:
            return self._begin(time)
        now = self._now
        if self._before is not None:
            now = self._return_or_stay(self._before, now, time)
        dropped = 0
        if now.fits(time) or (dropped := now.drop_last(time)):
            self._closed_false += dropped
            now.add([time], 1)
            if now.count == len(now.recent) == 3:
                self._closed_false += now.drop_first()
            return now.number
        if self._before is not None and now.count == 1:
            now.first, now.recent = time, [time]
            self._closed_false += 1
            return now.number
        if self._before is not None:
            self._close(self._before)
        self._before, self._since = now, 1
        return self._begin(time)

    def _return_or_stay(self, before: _Stretch, now: _Stretch, time: int) -> _Stretch:
        """Return the stretch that a time continues, of the two at the last step back."""
        if now.count <= max(before.count // 2, 1):
            if not before.fits(time):
                self._closed_false += before.drop_last(time)
            if before.fits(time) and time - before.recent[-1] <= _SILENCE_NS:
                self._closed_false += now.count
                self._now, self._before = before, None
                return before
        near = now.fits(time) and time - now.recent[-1] <= _DISORDER_NS
        if near or self._since == _FALSE_MOST:
            self._close(before)
            self._before = None
        self._since += 1
        return now

    def _begin(self, time: int) -> int:
        self._numbers += 1
        self._now = _Stretch(self._numbers, time, recent=[time])
        return self._numbers

    def _close(self, stretch: _Stretch) -> None:
        """Count a stretch that is over."""
        if stretch.count == 1:
            self._closed_false += 1
            return
        if not self._closed:
            self._closed_first = stretch.first
        self._closed += 1
        self._closed_last = stretch.last
        self._closed_ns += stretch.last - stretch.first
        self._closed_false += stretch.false_end

    def _open(self) -> list[_Stretch]:
        """Return the stretches that are not over, without those of a single time."""
        every = [one for one in (self._before, self._now) if one is not None]
        real = [one for one in every if one.count > 1]
        return real if real or self._closed else every[:1]


def _steps_back(times: npt.NDArray[np.int64]) -> list[int]:
    """Return where times are before the one in front of them by more than disorder."""
    before, after = times[:-1], times[1:]
    back = np.flatnonzero(after < before)
    if len(back):
        # As unsigned numbers, so that the longest step does not overflow.
        steps = before[back].view(np.uint64) - after[back].view(np.uint64)
        back = back[steps > _DISORDER_NS]
    return (back + 1).tolist()
