"""Statistics of each id: `canser.id_stats`, and `canser.IdStats` for a stream of frames."""

from collections.abc import Iterable
from itertools import repeat
from typing import Final

import numpy as np
import numpy.typing as npt

from canser._checks import type_name
from canser._core.ids import Rows, order_rows
from canser._core.text import Codes
from canser._frames import NO_TIME, FrameArray, check_codes, contiguous_frames
from canser.analysis.periods import Intervals, find_pattern

__all__ = ["ID_STATS_DTYPE", "IdStats", "IdStatsArray", "id_stats", "in_order", "kept_intervals"]

IdStatsArray = npt.NDArray[np.void]

ID_STATS_DTYPE: Final[np.dtype[np.void]] = np.dtype(
    [
        ("id", np.uint32),
        ("ext", np.bool_),
        ("rtr", np.bool_),
        ("err", np.bool_),
        ("channel", np.uint8),
        ("dlc_least", np.uint8),
        ("dlc_most", np.uint8),
        ("moving", np.uint8, (8,)),
        ("count", np.int64),
        ("changes", np.int64),
        ("first_ns", np.int64),
        ("last_ns", np.int64),
        ("interval_min_ns", np.float64),
        ("interval_mean_ns", np.float64),
        ("interval_median_ns", np.float64),
        ("interval_p99_ns", np.float64),
        ("interval_max_ns", np.float64),
        ("longest_from_ns", np.int64),
        ("pattern", "U8"),
        ("period_ns", np.float64),
        ("burst", np.float64),
        ("jitter_ns", np.float64),
        ("time_step_ns", np.int64),
        ("missing", np.float64),
    ],
    align=True,
)


class IdStats:
    """Statistics of each id, kind and channel of a stream of frames, in bounded memory.

    Parameters
    ----------
    patterns : bool
        Whether to find the median, the 99th percentile, and all from `pattern` on. True by default;
        otherwise they are NaN, and `pattern` is "".

    See Also
    --------
    id_stats : The same for an array, and what each field of a row means.

    Notes
    -----
    The result is the same wherever the stream is cut into arrays. Up to 8,704 intervals of an id
    are kept as they are. More are counted in a histogram, of 70 kB for each id. Then the median,
    the 99th percentile, and all that is found from the intervals' distribution are within 1 %.

    Examples
    --------
    >>> stats = canser.IdStats()
    >>> for block in (canser.frames("123#01"), canser.frames("123#02", "124#")):
    ...     stats.add(block)
    >>> stats.rows()[["id", "count", "changes"]].tolist()
    [(291, 2, 1), (292, 1, 0)]
    """

    def __init__(self, *, patterns: bool = True) -> None:
        self._patterns = patterns
        self._rows = Rows(remote_apart=True, keeps_steps=patterns)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._rows)

    def __repr__(self) -> str:
        return f"<canser.IdStats of {len(self):,} ids>"

    def add(self, frames: FrameArray, channels: Codes | None = None) -> None:
        """Add frames, in the order in which they came.

        Parameters
        ----------
        frames : array of FRAME_DTYPE, shape (n,)
            The frames, contiguous or not.
        channels : array of uint8, shape (n,), optional
            Their channels, from 0 on, and 255 for not told. By default none is told.

        Raises
        ------
        TypeError
            `frames` is no array of FRAME_DTYPE, or `channels` is no array of uint8.
        ValueError
            The shapes are not (n,).
        """
        self._rows.add(*contiguous(frames, channels))

    @property
    def exact(self) -> bool:
        """Whether all figures are exact: no id has more than 8,704 intervals."""
        return not self._rows.has_histograms

    def rows(self) -> IdStatsArray:
        """Return the rows of all ids so far.

        Returns
        -------
        array of ID_STATS_DTYPE, shape (m,)
            A new array: see `id_stats`.
        """
        return finish(self._rows) if self._patterns else _sorted(_counted(self._rows))


def id_stats(
    frames: FrameArray | Iterable[FrameArray],
    *,
    channels: Codes | None = None,
    patterns: bool = True,
) -> IdStatsArray:
    """Return statistics of each id, kind and channel: who sends, how often, and what changes.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,), or iterable of such arrays
        The frames in the order in which they came; or arrays of them, such as `canser.blocks(...)`
        or `port.batches()`. Of arrays, memory is bounded: see `IdStats`.
    channels : array of uint8, shape (n,), optional
        The channels of an array's frames, from 0 on, and 255 for not told. By default none is told.
    patterns : bool
        Whether to find the median, the 99th percentile, and all from `pattern` on: they take five
        times the time of the rest. True by default; otherwise they are NaN, and `pattern` is "".

    Returns
    -------
    array of records, shape (m,)
        A row for each id, kind (data, remote, error) and channel. Standard ids come first, then
        extended ones, then error frames. Fields that end in `_ns` are nanoseconds. What is not
        known, or does not apply, is NaN in a field of floats, and `canser.NO_TIME` in `first_ns`,
        `last_ns` and `longest_from_ns`. The fields are listed in the notes.

    Raises
    ------
    TypeError
        `frames` is no array of FRAME_DTYPE and no iterable of them, or `channels` is no array of
        uint8.
    ValueError
        The shapes are not (n,).

    Notes
    -----
    An **interval** is the time from one frame of a row to the next one. Intervals with a jump of
    the clock or a hole of the bus in them do not count. A jump is a step back of all times by more
    than a second. A hole is a time without any frame of more than a second, and of more than 20
    times the interval that 99.9 % of all frames before it keep. A single false time, as noise makes
    it, is a jump as well.

    - `id` (uint32), `ext`, `rtr`, `err` (bool), `channel` (uint8, 255 for not told): the row;
    - `dlc_least`, `dlc_most` (uint8): the smallest and the largest dlc;
    - `moving` (uint8, shape (8,)): the bits of the data that were not the same in all frames;
    - `count` (int64): frames;
    - `changes` (int64): frames whose data or dlc differ from those of the frame before;
    - `first_ns`, `last_ns` (int64): the first and the last known time;
    - `interval_min_ns`, `interval_mean_ns`, `interval_median_ns`, `interval_p99_ns`,
      `interval_max_ns` (float64): of the intervals. The 99th percentile is the shortest interval
      that at least 99 % of them do not exceed;
    - `longest_from_ns` (int64): the time at which the longest interval began;
    - `pattern` (str): "periodic", "bursts", "event", or "few" for less than 10 frames;
    - `period_ns` (float64): of a periodic id the median of the intervals, of bursts the median time
      from one burst to the next;
    - `burst` (float64): frames in a burst, 1 for a periodic id;
    - `jitter_ns` (float64): the 99th less the 1st percentile of the intervals between 0.5 and 1.5
      periods;
    - `time_step_ns` (int64): the step of the times: no jitter can be told below it;
    - `missing` (float64): frames that are missing by the period: round(interval / period) - 1 of
      each interval.

    An id is **periodic** if at least 80 % of its intervals lie between 0.5 and 1.5 times their
    median, and at most 1 % (or one) are longer than 5 times. Frames come in **bursts** if the long
    intervals are at least 5 times the short ones, a burst has 1.5 frames or more, and the times
    from burst to burst are periodic. All else is an **event**.

    Source: the definitions are canser's own.

    Examples
    --------
    >>> frames = canser.concat([canser.frames("123#01", "124#")] * 20)
    >>> frames["ts"] = np.arange(40) * 5_000_000
    >>> stats = canser.id_stats(frames)
    >>> stats[["id", "count", "pattern"]].tolist()
    [(291, 20, 'periodic'), (292, 20, 'periodic')]
    >>> stats["period_ns"] / 1e6
    array([10., 10.])
    """
    if not isinstance(frames, np.ndarray):
        if channels is not None:
            raise TypeError("channels are those of one array of frames; use canser.IdStats")
        if isinstance(frames, str | bytes) or not isinstance(frames, Iterable):
            raise TypeError(
                "frames must be an array of canser.FRAME_DTYPE, or arrays of them, "
                f"not {type_name(frames)}"
            )
        stats = IdStats(patterns=patterns)
        for block in frames:
            stats.add(block)
        return stats.rows()
    frames, channels = contiguous(frames, channels)
    if not patterns:
        rows = Rows(remote_apart=True)
        rows.add(frames, channels)
        return _sorted(_counted(rows))
    return _sorted(stats_and_steps(frames, channels)[0])


def stats_and_steps(
    frames: FrameArray, channels: Codes | None
) -> tuple[IdStatsArray, npt.NDArray[np.uint32], npt.NDArray[np.int64]]:
    """Return statistics of checked frames, and the row and the interval of each frame.

    The rows are in the order in which they appeared. An interval is that from the frame before in
    the row, -1 if there is none.
    """
    rows = Rows(remote_apart=True)
    row_of, steps = np.empty(len(frames), np.uint32), np.empty(len(frames), np.int64)
    rows.add(frames, channels, row_of, steps)
    counts = rows.rows["steps"]
    ends = np.cumsum(counts)
    starts = ends - counts
    ordered = order_rows(row_of, starts, counts, steps)
    places = zip(starts.tolist(), ends.tolist(), strict=True)
    stats = _counted(rows)
    _add_patterns(stats, [_as_intervals(ordered[start:end]) for start, end in places], rows.unit_ns)
    return stats, row_of, steps


def contiguous(frames: FrameArray, channels: Codes | None) -> tuple[FrameArray, Codes | None]:
    """Return checked frames and channels as C takes them."""
    frames = contiguous_frames(frames)
    if channels is not None:
        check_codes(channels, "channels", frames)
        channels = np.ascontiguousarray(channels)
    return frames, channels


def _as_intervals(steps: npt.NDArray[np.int64] | npt.NDArray[np.uint64]) -> Intervals:
    """Return steps as intervals: a list, or the bins of a histogram."""
    if steps.ndim == 1:
        return Intervals(np.sort(steps).astype(np.float64))
    counts, sums = steps[steps[:, 0] > 0].T
    return Intervals(sums / counts, counts.astype(np.int64))


def kept_intervals(rows: Rows, index: int) -> Intervals:
    """Return the intervals of a row that keeps them."""
    return _as_intervals(rows.steps(index))


def in_order(rows: npt.NDArray[np.void]) -> npt.NDArray[np.intp]:
    """Return the order of rows: standard ids, extended ones, error frames, each by their id."""
    return np.lexsort([rows[name] for name in ("channel", "rtr", "id", "ext", "err")])


def finish(rows: Rows) -> IdStatsArray:
    """Return the rows in their order, with what their kept steps tell."""
    made = _counted(rows)
    _add_patterns(made, [kept_intervals(rows, i) for i in range(len(rows))], rows.unit_ns)
    return _sorted(made)


def _sorted(made: IdStatsArray) -> IdStatsArray:
    return made.take(in_order(made))


def _counted(rows: Rows) -> IdStatsArray:
    counted = rows.rows
    made = np.zeros(len(counted), ID_STATS_DTYPE)
    for name in ("id", "ext", "rtr", "err", "channel", "moving", "changes"):
        made[name] = counted[name]
    bits = counted["dlcs"][:, None] >> np.arange(32, dtype=np.uint32) & np.uint32(1)
    made["dlc_least"], made["dlc_most"] = bits.argmax(1), 31 - bits[:, ::-1].argmax(1)
    made["count"] = counted["steps"] + counted["breaks"]
    made["first_ns"], made["last_ns"] = counted["first"], counted["last"]
    made["time_step_ns"] = rows.unit_ns
    for name in ID_STATS_DTYPE.names or ():
        if ID_STATS_DTYPE[name] == np.float64:
            made[name] = np.nan
    steps = counted["steps"]
    some = steps > 0
    sums = counted["sum"] + (counted["last"] - counted["base"]).view(np.uint64)
    made["interval_min_ns"][some] = counted["least"][some]
    made["interval_max_ns"][some] = (counted["least"] + counted["spread"])[some]
    made["interval_mean_ns"][some] = sums[some] / steps[some]
    made["longest_from_ns"] = np.where(some, counted["longest_at"], NO_TIME)
    return made


def _add_patterns(made: IdStatsArray, intervals: list[Intervals], unit_ns: int) -> None:
    some = [i for i, each in enumerate(intervals) if each.count]
    made["interval_median_ns"][some] = [intervals[i].median for i in some]
    made["interval_p99_ns"][some] = [intervals[i].at(0.99) for i in some]
    patterns = map(find_pattern, intervals, made["count"].tolist(), repeat(unit_ns))
    names = ("pattern", "period_ns", "burst", "jitter_ns", "missing")
    for name, values in zip(names, zip(*patterns, strict=True), strict=False):
        made[name] = values
