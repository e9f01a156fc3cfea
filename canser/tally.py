"""What frames amount to: counts, times, ids, gathered block by block."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from canser.frames import NO_TIME, FrameArray

__all__ = ["Clock", "IdTally", "Tally"]

_EXT = 1 << 32  # above the bits of an id, in the keys below


# A longer step from one frame to the next is a jump of the clock where times are
# out of order, too: a device restarted, or a false frame came out of noise.
_JUMP = 3_600 * 10**9


@dataclass(slots=True)
class Clock:
    """Times in the order in which they came."""

    timed: int = 0  # frames whose time is known
    first: int = NO_TIME
    last: int = NO_TIME
    jumps: int = 0  # steps of more than an hour, forward or back
    backward: int = 0  # of these, steps back
    _steady: int = 0  # nanoseconds in all other steps, forward less back

    def add(self, ts: npt.NDArray[np.int64]) -> None:
        """Go on with the known ones of some times."""
        known = ts[ts != NO_TIME]
        if not len(known):
            return
        if self.first == NO_TIME:
            self.first = self.last = int(known[0])
        steps = np.diff(known, prepend=self.last)
        jumps = np.abs(steps) > _JUMP
        self.timed += len(known)
        self.last = int(known[-1])
        self.jumps += int(jumps.sum())
        self.backward += int((steps < -_JUMP).sum())
        self._steady += int(steps[~jumps].sum())

    @property
    def span_ns(self) -> int | None:
        """Time from first to last, less the jumps where any goes back; None for no times."""
        if self.first == NO_TIME:
            return None
        return self._steady if self.backward else self.last - self.first

    @property
    def period_ns(self) -> float | None:
        """Mean time from one frame to the next; None where there is none."""
        steps = self.timed - 1 - (self.jumps if self.backward else 0)
        return self.span_ns / steps if self.span_ns and steps > 0 and self.span_ns > 0 else None


@dataclass(slots=True)
class IdTally:
    """The frames of one arbitration id."""

    count: int = 0
    remote: int = 0
    dlc_least: int = 8
    dlc_most: int = 0
    clock: Clock = field(default_factory=Clock)


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
        self.clock.add(frames["ts"])
        for dlc, count in enumerate(np.bincount(frames["dlc"], minlength=9)[:9]):
            self.dlc[dlc] += int(count)
        keys = frames["id"].astype(np.int64) + np.where(frames["ext"], _EXT, 0)
        order = np.argsort(keys, kind="stable")
        runs = np.flatnonzero(np.diff(keys[order], prepend=-1))
        for rows in np.split(order, runs[1:]):
            key = int(keys[rows[0]])
            one = self.ids.setdefault((key & (_EXT - 1), key >= _EXT), IdTally())
            self._add_id(one, frames.take(rows))

    def _add_id(self, one: IdTally, frames: FrameArray) -> None:
        one.count += len(frames)
        one.remote += int(frames["rtr"].sum())
        one.dlc_least = min(one.dlc_least, int(frames["dlc"].min()))
        one.dlc_most = max(one.dlc_most, int(frames["dlc"].max()))
        one.clock.add(frames["ts"])
