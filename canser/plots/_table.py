"""The ids of frames in the order in which all pictures show them.

Ids are sorted by their pattern, then by their period, then by the id itself: so equal periods stand
together, and a row that is broken shows at once. Ids of less than 10 frames, of which noise makes
many, share the last row. Of more than 60 ids the busiest 60 are shown, and the others share a row.
What a row hides is always counted.
"""

from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from canser._core.ids import Rows
from canser._frames import FrameArray
from canser.analysis.ids import IdStatsArray, contiguous, finish, in_order, kept_intervals
from canser.analysis.names import id_text
from canser.analysis.periods import FEW
from canser.codec.bits import frame_bits
from canser.plots._style import ROW_PT
from canser.plots._text import duration_text

__all__ = ["PATTERNS", "IdTable", "sort_key"]

# The patterns in the order of the rows.
PATTERNS: Final = ("periodic", "bursts", "event", "few")

# The most ids that have a row of their own.
LINES_MOST: Final = 60

# Frames that are counted together: what is made of them stays in the cache.
_PART: Final = 1 << 17


class IdTable:
    """Statistics of the ids of frames, and the lines in which a picture shows them.

    Attributes
    ----------
    stats : array of ID_STATS_DTYPE, shape (m,)
        The rows of `canser.IdStats`, in the order of pictures.
    low_ns : array of float64, shape (m,)
        The 1st percentile of the intervals, NaN if there is none.
    shown : int
        How many of `stats` have a line of their own: the first ones.
    folds : list of (str, slice)
        The lines behind them: a text, and the part of `stats` that they stand for.
    """

    def __init__(self, frames: FrameArray) -> None:
        frames, _ = contiguous(frames, None)
        rows = Rows(remote_apart=True, keeps_steps=True)
        row_of = np.empty(len(frames), np.uint32)
        rows.add(frames, None, row_of)
        order = in_order(rows.rows)
        stats, low = finish(rows), np.full(len(rows), np.nan)
        for place, row in enumerate(order):
            intervals = kept_intervals(rows, int(row))
            if intervals.count:
                low[place] = intervals.at(0.01)
        self._frames, self._row_of = frames, row_of
        judged = int((stats["pattern"] != "few").sum())
        self._place_of = np.empty(len(rows), np.int32)
        busy = self._row_bits[order] if max(judged, len(stats) - judged) > LINES_MOST else None
        best = _choose(stats, busy)
        self.stats: IdStatsArray = stats.take(best)
        self.low_ns, self._order = low[best], order[best]
        self._place_of[self._order] = np.arange(len(rows))
        self.shown, self.folds = _fold(self.stats)

    @property
    def bits(self) -> npt.NDArray[np.int64]:
        """Bits of the frames on the bus, of each id of `stats`."""
        return self._row_bits[self._order]

    @cached_property
    def _row_bits(self) -> npt.NDArray[np.int64]:
        """The bits of the frames of each row."""
        bits = np.zeros(len(self._place_of))
        for first in range(0, len(self._frames), _PART):
            part = slice(first, first + _PART)
            bits += np.bincount(self._row_of[part], frame_bits(self._frames[part]), len(bits))
        return bits.astype(np.int64)

    def __len__(self) -> int:
        """Return the number of lines."""
        return self.shown + len(self.folds)

    @property
    def labels(self) -> list[str]:
        """The text of each line: the id, and its period."""
        own = []
        for row in self.stats[: self.shown]:
            period = row["period_ns"]
            pace = str(row["pattern"]) if np.isnan(period) else duration_text(float(period))
            own.append(f"{id_text(row)}  {pace:>7}")
        return own + [text for text, _ in self.folds]

    @property
    def label_width(self) -> float:
        """The inches that the texts need."""
        return 0.16 + ROW_PT / 72 * 0.61 * max(map(len, self.labels), default=8)

    def line_of_frames(self) -> npt.NDArray[np.int32]:
        """Return the line of each frame, shape (n,)."""
        lines = np.arange(len(self.stats), dtype=np.int32)
        for number, (_, part) in enumerate(self.folds):
            lines[part] = self.shown + number
        found: npt.NDArray[np.int32] = lines[self._place_of][self._row_of]
        return found

    def sums(self, values: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Return the values of the ids by line: those of a fold are added up."""
        folded = [int(values[part].sum()) for _, part in self.folds]
        return np.concatenate([values[: self.shown], np.array(folded, np.int64)])

    @property
    def names(self) -> list[str]:
        """The ids that have a line of their own, as text."""
        return [id_text(row) for row in self.stats[: self.shown]]


def sort_key(stats: IdStatsArray) -> npt.NDArray[np.intp]:
    """Return the order of ids: pattern, period, and the order that they have."""
    pattern = np.array([PATTERNS.index(name) for name in stats["pattern"].tolist()], np.int64)
    # Periods of one rate differ by the steps of the clock: 9.99 ms and 10.01 ms stand together.
    with np.errstate(divide="ignore", invalid="ignore"):
        period = np.round(np.log(np.nan_to_num(stats["period_ns"], nan=np.inf)) / np.log(1.05))
    return np.lexsort([np.arange(len(stats)), period, pattern])


def _choose(stats: IdStatsArray, bits: npt.NDArray[np.int64] | None) -> npt.NDArray[np.intp]:
    """Return the order of the ids: those with a line, the other ones, those with few frames.

    `bits`: of each id, None if all of them have a line.
    """
    order = sort_key(stats)
    few = (stats["pattern"] == "few")[order]
    if few.all() or few.sum() < 2:
        few[:] = False
    judged = order[~few]
    if bits is not None and len(judged) > LINES_MOST:
        busy = np.zeros(len(stats), np.bool_)
        busy[judged[np.argsort(-bits[judged], kind="stable")[:LINES_MOST]]] = True
        judged = np.concatenate([judged[busy[judged]], judged[~busy[judged]]])
    return np.concatenate([judged, order[few]])


def _fold(stats: IdStatsArray) -> tuple[int, list[tuple[str, slice]]]:
    """Return how many ids have a line, and the lines that stand for the others."""
    few = stats["pattern"] == "few"
    few_count = int(few.sum())
    if few.all() or few_count < 2:
        few_count = 0
    judged = len(stats) - few_count
    shown = min(judged, LINES_MOST)
    folds = []
    if judged > shown:
        folds.append((f"{judged - shown:,} more ids", slice(shown, judged)))
    if few_count:
        folds.append((f"{few_count:,} ids < {FEW} frames", slice(judged, len(stats))))
    return shown, folds
