"""The load of the bus: `canser.bus_load`, and `canser.BusLoad` for a stream of frames."""

from itertools import groupby
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser._checks import type_name
from canser._core.ids import Runs
from canser._frames import FrameArray, check_frames, contiguous_frames
from canser._quantities import LONGEST_S, parse_seconds
from canser.codec.bits import frame_bits

__all__ = ["BITRATE_MOST", "LOAD_DTYPE", "BusLoad", "bus_load", "load_of"]

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

# The most rows of a window that is asked for: 560 MB. Otherwise a bus that is silent for hours, and
# a window of milliseconds, would fill the memory with empty rows.
_ROWS_LIMIT: Final = 10_000_000

# The shortest and the longest window that can be asked for.
_SHORTEST_NS: Final = 1_000_000
_LONGEST_NS: Final = LONGEST_S * 10**9

# The highest bit rate of classic CAN.
BITRATE_MOST: Final = 1_000_000

# Frames of an array that are counted together: what is made of them stays in the cache, which takes
# a third of the time.
_PART: Final = 1 << 18

_Counts = npt.NDArray[np.int64]


class _Stretch:
    """The frames of one run, counted by windows; only windows that have frames take memory.

    `origin`: the time from which windows are counted. `chain`: the number of the stretches that
    are counted from there. `last`: the time of the last frame.
    """

    def __init__(self, run: int, chain: int, origin: int) -> None:
        self.run, self.chain, self.origin, self.last = run, chain, origin, origin
        self.frames = 0
        self._windows = np.zeros(0, np.int64)
        self._counts = np.zeros((0, 3), np.int64)
        self._parts: list[tuple[_Counts, _Counts]] = []  # counted since then
        self._parts_len = 0

    def add(self, ts: _Counts, values: npt.NDArray[np.float64], window_ns: int) -> None:
        """Count frames; `values`: a row for each field that is summed up."""
        # As (ts - origin) // window_ns, whose difference may not fit into 64 bits.
        windows = ts // window_ns - self.origin // window_ns
        windows -= ts % window_ns < self.origin % window_ns
        part = _sum_up(windows, values)
        self.frames += len(ts)
        self.last = int(ts[-1])
        self._parts.append(part)
        self._parts_len += len(part[0])
        # Otherwise each of many short arrays would cost a copy of all windows.
        if self._parts_len > len(self._windows):
            self.join()

    def join(self) -> tuple[_Counts, _Counts]:
        """Return the windows that have frames, rising, and their frames, errors and bits."""
        if self._parts:
            windows = np.concatenate([self._windows, *(part[0] for part in self._parts)])
            counts = np.concatenate([self._counts, *(part[1] for part in self._parts)])
            self._windows, self._counts = _sum_up(windows, counts.T)
            self._parts, self._parts_len = [], 0
        return self._windows, self._counts

    @property
    def span(self) -> int:
        """The number of windows from the first one to the last one."""
        windows, _ = self.join()
        return int(windows[-1]) - int(windows[0]) + 1


def _sum_up(windows: _Counts, values: npt.NDArray[Any]) -> tuple[_Counts, _Counts]:
    """Return the windows that are there, rising, and the sums of each, shape (n, 3)."""
    first = int(windows.min())
    span = int(windows.max()) - first + 1
    if span <= 4 * len(windows):
        places = windows - first
        there = np.flatnonzero(np.bincount(places, minlength=span))
        found = there + first
    else:
        found, places = np.unique(windows, return_inverse=True)
        there = np.arange(len(found))
        span = len(found)
    # Sums of bits are exact: float64 holds whole numbers up to 2^53.
    sums = [np.bincount(places, row, span)[there] for row in values]
    return found, np.stack(sums, axis=1).astype(np.int64)


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
        `bitrate` is not 1 to 1,000,000, or `window` is not 1 ms to 100,000 days or cannot be read.

    See Also
    --------
    bus_load : The same for an array, and what each field of a row means.

    Notes
    -----
    The result is the same wherever the stream is cut into arrays. Memory grows by 32 to 64 bytes
    for each 100 ms, or each window, that has frames; while they are summed up, it is 160 bytes.

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
        frames = contiguous_frames(frames)
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
            self.untimed += stretches.pop().frames
        if not stretches or stretches[-1].run != run:
            # At a jump of the clock back, windows are counted anew.
            before = stretches[-1] if stretches else None
            if before is not None and ts[0] >= before.last:
                stretches.append(_Stretch(run, before.chain, before.origin))
            else:
                chain = 0 if before is None else before.chain + 1
                stretches.append(_Stretch(run, chain, int(ts[0])))
        stretches[-1].add(ts, values, self._window_ns)

    def rows(self) -> npt.NDArray[np.void]:
        """Return the rows of all windows so far.

        Returns
        -------
        array of LOAD_DTYPE, shape (m,)
            A new array: see `bus_load`.

        Raises
        ------
        ValueError
            `window` would make over 10,000,000 rows.
        """
        made = self.chains()
        return np.concatenate(made) if made else np.zeros(0, LOAD_DTYPE)

    def chains(self) -> list[npt.NDArray[np.void]]:
        """Return the rows, apart for each jump of the clock back, for this package's own use."""
        count = sum(stretch.span for stretch in self._stretches)
        times = 1
        if self._asked_ns is None:
            steps = -(-_STEPS_LEAST * self._runs.unit_ns // self._window_ns)
            times = max(-(-count // _ROWS_MOST), steps, 1)
        elif count > _ROWS_LIMIT:
            least_s = -(-count // _ROWS_LIMIT) * self._window_ns / 1e9
            raise ValueError(
                f"a window of {self._window_ns / 1e9:g} s makes {count:,} rows, and "
                f"{_ROWS_LIMIT:,} are the most; give {least_s:g} s or more, or no window"
            )
        chains = groupby(self._stretches, lambda stretch: stretch.chain)
        return [self._rows_of(list(stretches), times) for _, stretches in chains]

    def _rows_of(self, stretches: list[_Stretch], times: int) -> npt.NDArray[np.void]:
        """Return the rows of a chain of stretches; `times`: how many windows become one row.

        A row may have frames of several stretches: a hole may be short, and a clock that steps back
        again and again comes to windows that were there.
        """
        parts = [(windows // times, counts) for windows, counts in map(_Stretch.join, stretches)]
        numbers = np.concatenate([np.arange(part[0][0], part[0][-1] + 1) for part in parts])
        if len(parts) > 1:
            numbers = np.unique(numbers)
        counts = np.zeros((len(numbers), 3), np.int64)
        for windows, values in parts:
            np.add.at(counts, np.searchsorted(numbers, windows), values)
        rows = np.zeros(len(counts), LOAD_DTYPE)
        rows["window_ns"] = times * self._window_ns
        rows["start_ns"] = stretches[0].origin + numbers * rows["window_ns"]
        rows["frames"], rows["errors"], rows["bits"] = counts.T
        rows["kbit_s"] = 1e6 * rows["bits"] / rows["window_ns"]
        rows["load"] = np.nan
        if self.bitrate is not None:
            rows["load"] = 1_000 * rows["kbit_s"] / self.bitrate
        return rows


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
        `bitrate` is not 1 to 1,000,000, `window` is not 1 ms to 100,000 days, cannot be read, or
        would make over 10,000,000 rows, or the shape is not (n,).

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
    return load_of(frames, bitrate, window).rows()


def load_of(frames: FrameArray, bitrate: int | None, window: str | int | None) -> BusLoad:
    """Return the load of the bus of an array."""
    load = BusLoad(bitrate, window)
    check_frames(frames, "frames")
    for first in range(0, len(frames), _PART):
        load.add(frames[first : first + _PART])
    return load


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
    if length > _LONGEST_NS:
        raise ValueError(f"window is {window}; give {_LONGEST_NS} ns or less, such as 100ms")
    return length
