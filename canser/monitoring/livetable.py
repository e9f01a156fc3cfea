"""The live table: for each id the count, the period, the jitter, and the bytes that change."""

import re
import threading
from typing import Final

import numpy as np
import numpy.typing as npt

from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray, match, put_records_at, with_mask
from canser.analysis.batches import Batch, IdBatches, previous

__all__ = ["COLUMNS", "ROW_DTYPE", "LiveTable", "RowArray", "choose", "exact", "ordered", "terms"]

RowArray = npt.NDArray[np.void]

ROW_DTYPE: Final[np.dtype[np.void]] = np.dtype(
    [
        ("id", np.uint32),
        ("ext", np.bool_),
        ("rtr", np.bool_),
        ("err", np.bool_),
        ("dlc", np.uint8),  # dlc, data and ts are those of the last frame
        ("data", np.uint8, (8,)),
        ("ts", np.int64),
        ("count", np.int64),
        # For each byte the ts of the frame that last changed it, or NO_TIME.
        ("changed", np.int64, (8,)),
        ("period", np.float64),  # nanoseconds, NaN if unknown
        ("jitter", np.float64),  # nanoseconds, NaN if unknown
        ("rate", np.float64),  # frames a second, NaN if unknown
    ],
    align=True,
)

# The keys by which rows can be sorted.
COLUMNS: Final = ("id", "count", "period", "jitter", "dlc", "ts")

# Number of the last steps of an id (times from one frame to the next) that period, jitter and rate
# are computed from: enough for a steady figure, few enough to follow a change of the period.
_STEPS: Final = 32

# Jitter counts only steps between these numbers of periods. Otherwise a lost frame, which makes a
# step of two periods, would count as jitter.
_STEP_LEAST: Final = 0.5
_STEP_MOST: Final = 1.5

# Largest number of rows. Otherwise a wrong baud rate, which gives new false ids for ever, would
# fill the memory. Frames of further ids are counted, and have no row.
_IDS_MOST: Final = 1 << 14

_PREFIX = re.compile("(?:0[xX])?(?P<digits>[0-9A-Fa-f]{1,8})")


class LiveTable:
    """A row for each combination of id, ext, rtr and err. Safe for several threads.

    A remote frame or an error frame has a row of its own, not that of the data frame with the
    same id: its period differs, and it has no data that could change.

    A step is the time from one frame of a row to the next, as in `canser.id_stats`: none leads
    across a jump of the clock or a hole of the bus. `period` is the median of the last 32 steps,
    known from the second frame on. `jitter` is the 99th less the 1st percentile of those between
    0.5 and 1.5 periods, which of 32 is the longest less the shortest; it is known from two such
    steps on. `rate` is the number of the last 32 steps divided by their sum; it differs from
    1 / `period` if frames come in bursts.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._empty()

    def _empty(self) -> None:
        self._ids = IdBatches(_IDS_MOST)
        # One element for each row, with room for more rows.
        self._rows = np.zeros(0, ROW_DTYPE)
        # The last steps of each row in nanoseconds, NaN for none, and the number of all its steps.
        self._steps = np.zeros((0, _STEPS))
        self._step_counts = np.zeros(0, np.int64)

    @property
    def frames(self) -> int:
        """The number of frames added since the last `clear`."""
        return self._ids.frames

    @property
    def others(self) -> int:
        """The number of those frames without a row, because there are 16,384 rows already."""
        return self._ids.others

    def clear(self) -> None:
        """Remove all rows."""
        with self._lock:
            self._empty()

    def rows(self) -> RowArray:
        """Return a copy of all rows: ROW_DTYPE, shape (n,), standard ids first, then by id."""
        with self._lock:
            places = self._ids.places
            rows, steps = self._rows.take(places), self._steps[places]
            rows["count"] = self._ids.counts
        _set_pace(rows, steps)
        return rows

    def add(self, frames: FrameArray) -> None:
        """Add frames in the order in which they came: FRAME_DTYPE, shape (n,)."""
        if not len(frames):
            return
        with self._lock:
            batch = self._ids.add(frames)
            if len(self._ids) > len(self._rows):
                self._grow(2 * len(self._ids))
            if len(batch.frames):
                self._add_bytes(batch)
                self._add_steps(batch)

    def _add_bytes(self, batch: Batch) -> None:
        """Store the last frame of each row, and the times at which its bytes have changed."""
        frames, starts = batch.frames, batch.starts
        old = self._rows.take(batch.places)
        dlc = previous(frames["dlc"], old["dlc"], starts)
        changed = frames["data"] != previous(frames["data"], old["data"], starts)
        at = np.arange(8)
        # A byte that a new dlc adds or removes has changed, too.
        changed |= (at < frames["dlc"][:, None]) != (at < dlc[:, None])
        changed[starts[batch.new]] = False
        times = np.where(changed, frames["ts"][:, None], NO_TIME)
        old["changed"] = np.maximum(np.maximum.reduceat(times, starts), old["changed"])
        last = frames.take(starts + batch.counts - 1)
        for name in FRAME_DTYPE.names or ():
            old[name] = last[name]
        put_records_at(self._rows, batch.places, old)

    def _add_steps(self, batch: Batch) -> None:
        """Store the last steps of each row."""
        counts = batch.step_counts
        places = np.repeat(batch.places, counts)
        # For each step the number of later steps of its row.
        later = np.repeat(np.cumsum(counts), counts) - 1 - np.arange(len(places))
        self._step_counts[batch.places] += counts
        kept = later < _STEPS
        at = self._step_counts[places] - 1 - later
        self._steps[places[kept], at[kept] % _STEPS] = batch.steps[kept]

    def _grow(self, size: int) -> None:
        more = np.zeros(size - len(self._rows), ROW_DTYPE)
        more["changed"] = NO_TIME
        self._rows = np.concatenate([self._rows, more])
        self._steps = np.vstack([self._steps, np.full((len(more), _STEPS), np.nan)])
        self._step_counts = np.append(self._step_counts, np.zeros(len(more), np.int64))


def _set_pace(rows: RowArray, steps: npt.NDArray[np.float64]) -> None:
    """Set period, jitter and rate of rows from their last steps, shape (n, 32), NaN for none."""
    counts = np.count_nonzero(~np.isnan(steps), axis=1)
    steps = np.sort(steps, axis=1)  # NaN comes last
    middle = np.maximum(counts - 1, 0) // 2, counts // 2  # both are the same if the count is odd
    row = np.arange(len(rows))
    period = (steps[row, middle[0]] + steps[row, np.minimum(middle[1], _STEPS - 1)]) / 2
    least, most = (share * period[:, None] for share in (_STEP_LEAST, _STEP_MOST))
    near = (steps >= least) & (steps <= most)
    # 1 % of 32 is less than one: the percentiles are the shortest and the longest.
    longest = np.where(near, steps, -np.inf).max(axis=1)
    shortest = np.where(near, steps, np.inf).min(axis=1)
    spans = np.nansum(steps, axis=1)
    rows["rate"] = np.where(spans > 0, 1e9 * counts / np.where(spans > 0, spans, 1), np.nan)
    rows["period"] = period
    rows["jitter"] = np.where(near.sum(axis=1) > 1, longest - shortest, np.nan)


def ordered(rows: RowArray, by: str, *, descending: bool = False) -> RowArray:
    """Return rows sorted by one of `COLUMNS`; stable, with unknown values last."""
    if by == "id":
        return rows[::-1] if descending else rows
    values = rows[by]
    if descending:
        # The complement reverses the order of integers; unlike the negative it never overflows.
        values = ~values if values.dtype.kind in "iu" else -values
    return rows.take(np.argsort(values, kind="stable"))


def terms(text: str) -> list[str]:
    """Return the filters of a text, which blanks or commas separate."""
    return text.replace(",", " ").split()


def exact(text: str) -> str:
    """Return filters of `match`, written so that `choose` understands them in the same way.

    An id alone gets its mask, because `choose` would take it as the first digits of ids: `123`
    becomes `123:800007FF`. ValueError for a filter that cannot be read.
    """
    filters = [with_mask(term) for term in terms(text)]
    match(np.empty(0, FRAME_DTYPE), *filters)
    return " ".join(filters)


def choose(rows: RowArray, text: str) -> npt.NDArray[np.bool_]:
    """Mark the rows that match a filter: in the notation of `match`, or the first digits of an id.

    Blanks or commas separate filters; a row must match one of them. Without a filter all rows
    match. Digits alone are the first digits of an id, not the whole id as in `match`, because
    they are typed one by one: `18F` matches the standard id 0x18F and all extended ids from
    0x18F00000 to 0x18FFFFFF. Ids of error frames have eight digits, too. ValueError for a filter
    that cannot be read.
    """
    prefixes, filters = list[str](), list[str]()
    for term in terms(text):
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
