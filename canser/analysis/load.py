"""The load of the bus: `canser.bus_load`, and `canser.BusLoad` for a stream of frames."""

from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser._checks import type_name
from canser._core.ids import Runs
from canser._frames import FrameArray
from canser._quantities import parse_seconds
from canser.analysis.ids import contiguous
from canser.codec.bits import frame_bits

__all__ = ["BITRATE_MOST", "LOAD_DTYPE", "BusLoad", "bus_load"]

LOAD_DTYPE: Final[np.dtype[np.void]] = np.dtype(
    [
        ("start_ns", np.int64),
        ("window_ns", np.int64),
        ("frames", np.int64),
        ("errors", np.int64),
        ("bits", np.int64),
        ("kbit_s", np.float64),
        ("load", np.float64),
    ],
    align=True,
)

# Window by default. In shorter ones a load of 100 % is normal: times are those of arrivals, or
# steps of a millisecond.
_WINDOW_NS: Final = 100_000_000

# The most rows by default, as many as a wide screen has columns, four times over.
_ROWS_MOST: Final = 8_000

# The fewest steps of the times in a window. Otherwise frames fall into the wrong one.
_STEPS_LEAST: Final = 10

# The shortest window that can be asked for.
_SHORTEST_NS: Final = 1_000_000

# The highest bit rate of classic CAN.
BITRATE_MOST: Final = 1_000_000

_Counts = npt.NDArray[np.int64]


class _Stretch:
    """The frames of one run, counted by windows.

    `origin`: the time from which windows are counted. `last`: the time of the last frame.
    """

    def __init__(self, run: int, origin: int) -> None:
        self.run, self.origin, self.last = run, origin, origin
        self.first = 0  # the number of the first window
        self._counts = np.zeros((0, 3), np.int64)  # with room for more
        self._used = 0

    def add(self, windows: _Counts, values: npt.NDArray[np.float64]) -> None:
        """Count frames; `values`: a row for each field that is summed up."""
        first, end = int(windows.min()), int(windows.max()) + 1
        if not self._used:
            self.first = first
        self._make_room(max(self.first - first, 0), end - min(self.first, first))
        windows = windows - self.first
        for column, weights in enumerate(values):
            sums = np.bincount(windows, weights, self._used)
            self._counts[: self._used, column] += sums.astype(np.int64)

    @property
    def counts(self) -> _Counts:
        """Frames, errors and bits of each window, shape (n, 3)."""
        return self._counts[: self._used]

    def _make_room(self, before: int, count: int) -> None:
        """Make room for `before` windows in front of the first one, and for `count` from there."""
        count = max(count, self._used + before)
        if before or count > len(self._counts):
            counts = np.zeros((max(count, 2 * len(self._counts)), 3), np.int64)
            counts[before : before + self._used] = self.counts
            self._counts = counts
        self.first -= before
        self._used = count


class BusLoad:
    """The load of the bus of a stream of frames.

    Parameters
    ----------
    bitrate : int, optional
        Bit rate of the bus in bit/s. Without it, there is no load, only kbit/s.
    window : str or int, optional
        Length of a window: a text such as "100ms" or "1s", or nanoseconds. By default as for
        `bus_load`.

    Raises
    ------
    TypeError
        `bitrate` is no int, or `window` is neither text nor int.
    ValueError
        `bitrate` is not 1 to 1,000,000, or `window` is shorter than 1 ms or cannot be read.

    See Also
    --------
    bus_load : The same for an array, and what each field of a row means.

    Notes
    -----
    The result is the same wherever the stream is cut into arrays. Memory grows by 24 bytes for
    each 100 ms, or each window, of the stream.

    Examples
    --------
    >>> load = canser.BusLoad(500_000)
    >>> load.add(canser.frames("123#01", "123#0203"))
    >>> load.rows()["bits"]
    array([], dtype=int64)
    """

    def __init__(self, bitrate: int | None = None, window: str | int | None = None) -> None:
        #: Bit rate of the bus in bit/s, or None.
        self.bitrate = _check_bitrate(bitrate)
        self._asked_ns = None if window is None else _check_window(window)
        self._window_ns = self._asked_ns or _WINDOW_NS
        self._runs = Runs()
        self._stretches: list[_Stretch] = []
        #: Frames that are left out, because their times are not known or false.
        self.untimed = 0

    def __repr__(self) -> str:
        return f"<canser.BusLoad of {self._window_ns / 1e6:g} ms>"

    def add(self, frames: FrameArray) -> None:
        """Add frames, in the order in which they came.

        Parameters
        ----------
        frames : array of FRAME_DTYPE, shape (n,)
            The frames, contiguous or not.

        Raises
        ------
        TypeError
            `frames` is no array of FRAME_DTYPE.
        ValueError
            The shape is not (n,).
        """
        frames, _ = contiguous(frames, None)
        runs = self._runs.add(frames)
        known = np.flatnonzero(runs)
        self.untimed += len(frames) - len(known)
        if not len(known):
            return
        ts = frames["ts"][known]
        values = np.stack([np.ones(len(known)), frames["err"][known], frame_bits(frames)[known]])
        borders = np.flatnonzero(np.diff(runs[known])) + 1
        for first, end in zip([0, *borders], [*borders, len(known)], strict=True):
            run = int(runs[known[first]])
            self._count(run, ts[first:end], values[:, first:end])

    def _count(self, run: int, ts: npt.NDArray[np.int64], values: npt.NDArray[np.float64]) -> None:
        """Count frames of one run."""
        stretches = self._stretches
        while stretches and stretches[-1].run > run:
            # That run goes on, so the ones since then were false times.
            self.untimed += int(stretches.pop().counts[:, 0].sum())
        if not stretches or stretches[-1].run != run:
            # At a jump of the clock back, windows are counted anew.
            goes_on = stretches and ts[0] >= stretches[-1].last
            stretches.append(_Stretch(run, stretches[-1].origin if goes_on else int(ts[0])))
        stretch = stretches[-1]
        stretch.add((ts - stretch.origin) // self._window_ns, values)
        stretch.last = int(ts[-1])

    def rows(self) -> npt.NDArray[np.void]:
        """Return the rows of all windows so far.

        Returns
        -------
        array of LOAD_DTYPE, shape (m,)
            A new array: see `bus_load`.
        """
        count = sum(len(stretch.counts) for stretch in self._stretches)
        steps = -(-_STEPS_LEAST * self._runs.unit_ns // self._window_ns)
        times = max(-(-count // _ROWS_MOST), steps, 1) if self._asked_ns is None else 1
        made = [self._rows_of(stretch, times) for stretch in self._stretches]
        return _join(made) if made else np.zeros(0, LOAD_DTYPE)

    def _rows_of(self, stretch: _Stretch, times: int) -> npt.NDArray[np.void]:
        """Return the rows of a stretch; `times`: how many windows become one row."""
        windows = stretch.first + np.arange(len(stretch.counts))
        first = int(windows[0]) // times
        counts = np.zeros((int(windows[-1]) // times - first + 1, 3), np.int64)
        np.add.at(counts, windows // times - first, stretch.counts)
        rows = np.zeros(len(counts), LOAD_DTYPE)
        rows["window_ns"] = times * self._window_ns
        rows["start_ns"] = stretch.origin + (first + np.arange(len(rows))) * rows["window_ns"]
        rows["frames"], rows["errors"], rows["bits"] = counts.T
        rows["kbit_s"] = 1e6 * rows["bits"] / rows["window_ns"]
        rows["load"] = np.nan
        if self.bitrate is not None:
            rows["load"] = 1_000 * rows["kbit_s"] / self.bitrate
        return rows


def _join(made: list[npt.NDArray[np.void]]) -> npt.NDArray[np.void]:
    """Join the rows of runs; one that a run ends in and the next one begins in becomes one."""
    for before, after in pairwise(made):
        if before["start_ns"][-1] == after["start_ns"][0]:
            for name in ("frames", "errors", "bits", "kbit_s", "load"):
                after[name][0] += before[name][-1]
            before["window_ns"][-1] = 0
    joined = np.concatenate(made)
    return joined.compress(joined["window_ns"] > 0)


def bus_load(
    frames: FrameArray, bitrate: int | None = None, *, window: str | int | None = None
) -> npt.NDArray[np.void]:
    """Return the load of the bus over time, from the exact bits of the frames.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,)
        The frames in the order in which they came, contiguous or not.
    bitrate : int, optional
        Bit rate of the bus in bit/s. Without it, there is no load, only kbit/s.
    window : str or int, optional
        Length of a window: a text such as "100ms" or "1s", or nanoseconds. By default 100 ms, and
        longer if there would be more than 8,000 rows, or fewer than 10 steps of the times in a
        window. In a short window, a load of 100 % and more is normal: times are those of arrivals.

    Returns
    -------
    array of LOAD_DTYPE, shape (m,)
        A row for each window, from the first frame on. The fields:

        - `start_ns`, `window_ns` (int64): its beginning and its length, in nanoseconds;
        - `frames`, `errors` (int64): frames, and error frames among them;
        - `bits` (int64): bits of the frames on the bus: see `frame_bits`. Error frames have none;
        - `kbit_s` (float64): bits in a millisecond;
        - `load` (float64): share of the bit rate, 1 for all of it; NaN without a bit rate.

    Raises
    ------
    TypeError
        `frames` is no array of FRAME_DTYPE, `bitrate` is no int, or `window` is neither text nor
        int.
    ValueError
        `bitrate` is not 1 to 1,000,000, `window` is shorter than 1 ms or cannot be read, or the
        shape is not (n,).

    Notes
    -----
    There are no rows for a hole of the bus, of which it is not known whether the bus was silent or
    the recorder was off: `id_stats` tells what a hole is. Frames whose time is not known or false
    are in no row; `BusLoad.untimed` counts them. After a jump of the clock back, windows are
    counted from the first time behind it. The last window of a stretch is seldom full.

    The mean load is `rows["bits"].sum() / rows["window_ns"].sum() * 1e9 / bitrate`.

    Examples
    --------
    >>> frames = canser.concat([canser.frames("123#0102030405060708")] * 1_000)
    >>> frames["ts"] = np.arange(1_000) * 1_000_000
    >>> rows = canser.bus_load(frames, 500_000)
    >>> len(rows), round(rows["load"].max().item(), 3)
    (10, 0.238)
    """
    load = BusLoad(bitrate, window)
    load.add(frames)
    return load.rows()


def _check_bitrate(bitrate: Any) -> int | None:
    if bitrate is None:
        return None
    if isinstance(bitrate, bool) or not isinstance(bitrate, int | np.integer):
        raise TypeError(f"bitrate must be an int in bit/s, not {type_name(bitrate)}")
    if not 1 <= bitrate <= BITRATE_MOST:
        raise ValueError(f"bitrate is {bitrate}; give 1 to {BITRATE_MOST:,} bit/s, such as 500000")
    return int(bitrate)


def _check_window(window: Any) -> int:
    if isinstance(window, bool) or not isinstance(window, int | np.integer | str):
        raise TypeError(
            f'window must be a text such as "100ms", or nanoseconds, not {type_name(window)}'
        )
    length = round(parse_seconds(window) * 1e9) if isinstance(window, str) else int(window)
    if length < _SHORTEST_NS:
        raise ValueError(f"window is {window}; give 1ms or more, such as 100ms")
    return length
