"""The live table: what came of each id, how often and how evenly, and which bytes change."""

import re
import threading
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray, match, with_mask
from canser.timing.restarts import Clock

__all__ = ["COLUMNS", "ROW_DTYPE", "LiveTable", "RowArray", "choose", "exact", "ordered"]

RowArray = npt.NDArray[np.void]

ROW_DTYPE: Final[np.dtype[np.void]] = np.dtype(
    [
        ("id", np.uint32),
        ("ext", np.bool_),
        ("rtr", np.bool_),
        ("err", np.bool_),
        ("dlc", np.uint8),  # of the last frame, as are data and ts
        ("data", np.uint8, (8,)),
        ("ts", np.int64),
        ("count", np.int64),
        ("changed", np.int64, (8,)),  # the time of the frame that last changed a byte, or NO_TIME
        ("period", np.float64),  # nanoseconds, NaN for not known
        ("jitter", np.float64),  # nanoseconds, NaN for not known
        ("rate", np.float64),  # frames a second, NaN for not known
    ],
    align=True,
)

# What rows can be sorted by.
COLUMNS: Final = ("id", "count", "period", "jitter", "dlc", "ts")

# Period and jitter are those of the last steps of an id, of so many: enough for a steady
# figure, few enough to follow an id that changes its pace.
_STEPS: Final = 32

# Jitter is that of steps between so many periods: where a frame is lost a step is of two.
_STEP_LEAST: Final = 0.5
_STEP_MOST: Final = 1.5

# A wrong baud rate makes up new ids without end. Frames of more ids than these are counted,
# and have no row.
_IDS_MOST: Final = 1 << 14

_PREFIX = re.compile("(?:0[xX])?(?P<digits>[0-9A-Fa-f]{1,8})")

_Places = npt.NDArray[np.intp]
_Scalar = TypeVar("_Scalar", bound=np.generic)


class LiveTable:
    """A row for each kind of frame: id, ext, rtr and err. Safe for several threads.

    A remote frame or an error frame is not of the same kind as the data frame with its id: it
    has a period of its own, and no data that could change.

    `period` is the median of the last 32 steps forward from one frame of a row to the next,
    known from the second frame on. `jitter` is the standard deviation of those between 0.5 and
    1.5 periods, known of two or more. `rate` is the number of the last 32 steps over their sum:
    not 1 / `period` where frames come in bursts. Times that are not known, steps back and
    those across a restart of the clock count for none of them.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._empty()

    def _empty(self) -> None:
        self._frames = self._others = 0
        self._rows = np.zeros(0, ROW_DTYPE)
        self._clock = Clock()
        # The last known time of a row, and which stretch of the clock it is of: 0 for none.
        self._times = np.zeros((2, 0), np.int64)
        # The last steps of a row, nanoseconds, 0 for none; and how many there have been.
        self._steps = np.zeros((0, _STEPS))
        self._counts = np.zeros(0, np.int64)
        self._keys = np.zeros(0, np.uint32)  # in order
        self._places = np.zeros(0, np.intp)  # of these keys among the rows

    @property
    def frames(self) -> int:
        """How many frames were added since the last `clear`."""
        return self._frames

    @property
    def others(self) -> int:
        """How many of them have no row, as there are 16,384 already."""
        return self._others

    def clear(self) -> None:
        """Forget all."""
        with self._lock:
            self._empty()

    def rows(self) -> RowArray:
        """Return a copy of all rows: ROW_DTYPE, shape (n,), standard ids first, then by id."""
        with self._lock:
            rows = self._rows[self._places]
            steps = self._steps[self._places]
        _set_pace(rows, steps)
        return rows

    def add(self, frames: FrameArray) -> None:
        """Take frames, in the order in which they came: FRAME_DTYPE, shape (n,)."""
        if not len(frames):
            return
        with self._lock:
            self._frames += len(frames)
            known = frames["ts"] != NO_TIME
            stretches = np.zeros(len(frames), np.int64)
            stretches[known] = self._clock.add(frames["ts"][known])
            keys = _keys(frames)
            order = np.argsort(keys, kind="stable")
            starts = _starts(keys[order])
            places = self._find(keys[order[starts]])
            unknown = np.repeat(places < 0, np.diff(starts, append=len(order)))
            if unknown.any():
                self._others += int(unknown.sum())
                order, places = order[~unknown], places[places >= 0]
                starts = _starts(keys[order])
            if len(order):
                self._add(frames.take(order), starts, places)
                self._add_steps(frames["ts"][order], stretches[order], starts, places)

    def _add(self, frames: FrameArray, starts: npt.NDArray[np.intp], places: _Places) -> None:
        """Take frames in the order of their rows; `starts`: where those of each place start."""
        counts = np.diff(starts, append=len(frames))
        old = self._rows[places]
        new = starts[old["count"] == 0]

        dlc = _behind(frames["dlc"], old["dlc"], starts)
        changed = frames["data"] != _behind(frames["data"], old["data"], starts)
        at = np.arange(8)
        # A byte that appears or goes away has changed, too.
        changed |= (at < frames["dlc"][:, None]) != (at < dlc[:, None])
        changed[new] = False
        times = np.where(changed, frames["ts"][:, None], NO_TIME)
        newest = np.maximum(np.maximum.reduceat(times, starts), old["changed"])

        last = frames.take(starts + counts - 1)
        for name in FRAME_DTYPE.names or ():
            old[name] = last[name]
        old["count"] += counts
        old["changed"] = newest
        self._rows[places] = old

    def _add_steps(
        self,
        ts: npt.NDArray[np.int64],
        stretches: npt.NDArray[np.int64],
        starts: npt.NDArray[np.intp],
        places: _Places,
    ) -> None:
        """Take times in the order of their rows, and the stretch of each."""
        known = stretches > 0
        ts, stretches = ts[known], stretches[known]
        counts = np.add.reduceat(known, starts, dtype=np.intp)
        ends = np.cumsum(counts)[counts > 0]
        places, counts = places[counts > 0], counts[counts > 0]
        old_ts, old_stretches = self._times[:, places]
        before = _behind(ts, old_ts, ends - counts)
        good = stretches == _behind(stretches, old_stretches, ends - counts)
        good &= ts > before
        self._times[:, places] = ts[ends - 1], stretches[ends - 1]

        # Unsigned: then the longest step is no overflow.
        steps = (ts - before).view(np.uint64)[good]
        group = np.repeat(np.arange(len(places)), counts)[good]
        counts = np.bincount(group, minlength=len(places))
        later = np.cumsum(counts)[group] - 1 - np.arange(len(group))
        kept = later < _STEPS
        self._counts[places] += counts
        at = self._counts[places[group]] - 1 - later
        self._steps[places[group][kept], at[kept] % _STEPS] = steps[kept]

    def _find(self, keys: npt.NDArray[np.uint32]) -> _Places:
        """Return the rows of distinct keys in order, new ones too; -1 where there is no room."""
        at = np.searchsorted(self._keys, keys)
        found = at < len(self._keys)
        found[found] = self._keys[at[found]] == keys[found]
        if not found.all():
            room = _IDS_MOST - len(self._keys)
            new = np.flatnonzero(~found)[:room]
            end = len(self._keys) + len(new)
            places = np.arange(len(self._keys), end)
            self._keys = np.insert(self._keys, at[new], keys[new])
            self._places = np.insert(self._places, at[new], places)
            if end > len(self._rows):
                self._grow(2 * end)
            at = np.searchsorted(self._keys, keys)
            found[new] = True
        result = np.full(len(keys), -1, np.intp)
        result[found] = self._places[at[found]]
        return result

    def _grow(self, size: int) -> None:
        more = np.zeros(size - len(self._rows), ROW_DTYPE)
        more["changed"] = NO_TIME
        self._rows = np.concatenate([self._rows, more])
        self._times = np.hstack([self._times, np.zeros((2, len(more)), np.int64)])
        self._steps = np.vstack([self._steps, np.zeros((len(more), _STEPS))])
        self._counts = np.append(self._counts, np.zeros(len(more), np.int64))


def _set_pace(rows: RowArray, steps: npt.NDArray[np.float64]) -> None:
    """Set period, jitter and rate of rows by their last steps: shape (n, 32), 0 for none."""
    counts = np.count_nonzero(steps, axis=1)
    steps = np.sort(steps, axis=1)  # those that are none come first
    first = _STEPS - np.maximum(counts, 1)
    middle = first + (counts - 1) // 2, first + counts // 2  # one where the count is odd
    row = np.arange(len(rows))
    with np.errstate(invalid="ignore", divide="ignore"):
        period = np.where(counts > 0, (steps[row, middle[0]] + steps[row, middle[1]]) / 2, np.nan)
        least, most = (share * period[:, None] for share in (_STEP_LEAST, _STEP_MOST))
        near = (steps >= least) & (steps <= most)
        of = near.sum(axis=1)
        off = np.where(near, steps - period[:, None], 0)
        off -= np.where(near, (off.sum(axis=1) / of)[:, None], 0)
        jitter = np.sqrt((off * off).sum(axis=1) / of)
        rows["rate"] = np.where(counts > 0, 1e9 * counts / steps.sum(axis=1), np.nan)
    rows["period"] = period
    rows["jitter"] = np.where(of > 1, jitter, np.nan)


def _keys(frames: FrameArray) -> npt.NDArray[np.uint32]:
    """Return a number for the kind of each frame; their order is that of the rows."""
    keys: npt.NDArray[np.uint32] = frames["id"] << np.uint32(1)
    for bit, name in ((31, "err"), (30, "ext"), (0, "rtr")):
        keys |= frames[name].astype(np.uint32) << np.uint32(bit)
    return keys


def _starts(keys: npt.NDArray[np.uint32]) -> npt.NDArray[np.intp]:
    """Return where the runs of equal keys start."""
    return np.flatnonzero(np.append(True, keys[1:] != keys[:-1])[: len(keys)])


def _behind(
    values: npt.NDArray[_Scalar], first: npt.NDArray[_Scalar], starts: npt.NDArray[np.intp]
) -> npt.NDArray[_Scalar]:
    """Return for each value the one before it, `first` for those at `starts`."""
    before = np.empty_like(values)
    before[1:] = values[:-1]
    before[starts] = first
    return before


def ordered(rows: RowArray, by: str, *, descending: bool = False) -> RowArray:
    """Return rows sorted by one of `COLUMNS`; equal ones stay, what is not known comes last."""
    if by == "id":
        return rows[::-1] if descending else rows
    values = rows[by]
    if descending:
        # Of an integer the complement: unlike the negative it never overflows.
        values = ~values if values.dtype.kind in "iu" else -values
    return rows.take(np.argsort(values, kind="stable"))


def _terms(text: str) -> list[str]:
    return text.replace(",", " ").split()


def exact(text: str) -> str:
    """Return filters as `match` reads them, spelled so that `choose` reads them the same.

    An id alone, which is the first digits of ids to `choose`, gets its mask: `123` becomes
    `123:800007FF`. ValueError for a filter that cannot be read.
    """
    filters = [with_mask(term) for term in _terms(text)]
    match(np.empty(0, FRAME_DTYPE), *filters)
    return " ".join(filters)


def choose(rows: RowArray, text: str) -> npt.NDArray[np.bool_]:
    """Mark the rows that pass a filter: the notation of `match`, or the first digits of an id.

    Several, with blanks or commas between: those that pass any. Digits alone are the first of
    an id, and not the whole id as in `match`, for they are typed one by one: `18F` passes the
    standard id 0x18F and all extended ids from 0x18F00000 to 0x18FFFFFF; those of error frames
    have eight digits, too. No filter passes all. ValueError for one that cannot be read.
    """
    prefixes, filters = list[str](), list[str]()
    for term in _terms(text):
        found = _PREFIX.fullmatch(term)
        if found:
            prefixes.append(found["digits"])
        else:
            filters.append(term)
    passed = np.full(len(rows), not prefixes and not filters)
    if filters:
        frames = np.zeros(len(rows), FRAME_DTYPE)
        for name in ("id", "ext", "rtr", "err"):
            frames[name] = rows[name]
        passed |= match(frames, *filters)
    digits = np.where(rows["ext"] | rows["err"], 8, 3)
    for prefix in prefixes:
        left = 4 * (digits - len(prefix))
        head = rows["id"] >> np.maximum(left, 0).astype(np.uint32)
        passed |= (left >= 0) & (head == int(prefix, 16))
    return passed
