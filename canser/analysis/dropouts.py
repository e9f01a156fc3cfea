"""Silences: of ids that send no more, and of the whole bus; `canser.dropouts`."""

from typing import Final

import numpy as np
import numpy.typing as npt

from canser._core.ids import runs_of
from canser._core.text import Codes
from canser._frames import FrameArray
from canser.analysis.ids import contiguous, stats_and_steps

__all__ = ["DROPOUT_DTYPE", "dropouts"]

DROPOUT_DTYPE: Final[np.dtype[np.void]] = np.dtype(
    [
        ("bus", np.bool_),
        ("id", np.uint32),
        ("ext", np.bool_),
        ("rtr", np.bool_),
        ("err", np.bool_),
        ("channel", np.uint8),
        ("from_ns", np.int64),
        ("to_ns", np.int64),
        ("length_ns", np.int64),
        ("missing", np.float64),
    ],
    align=True,
)

# An id is silent if it is longer than this number of its periods: noise seldom takes four frames
# of an id in a row.
_PERIODS: Final = 5


def dropouts(frames: FrameArray, *, channels: Codes | None = None) -> npt.NDArray[np.void]:
    """Return the silences: of the whole bus, and of each id with a period.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,)
        The frames in the order in which they came, contiguous or not.
    channels : array of uint8, shape (n,), optional
        Their channels, from 0 on, and 255 for not told. By default none is told.

    Returns
    -------
    array of DROPOUT_DTYPE, shape (m,)
        A row for each silence, by the time at which it begins. The fields:

        - `bus` (bool): whether the whole bus was silent. Then `id` is 0, and `channel` 255;
        - `id` (uint32), `ext`, `rtr`, `err` (bool), `channel` (uint8): the id that was silent;
        - `from_ns`, `to_ns`, `length_ns` (int64): times of the frames before and behind it, and
          its length, in nanoseconds;
        - `missing` (float64): frames that are missing by the period, NaN for the whole bus.

    Raises
    ------
    TypeError
        `frames` is no array of FRAME_DTYPE, or `channels` is no array of uint8.
    ValueError
        The shapes are not (n,).

    Notes
    -----
    An id is silent for more than 5 of its periods. The bus is silent at a hole: `canser.id_stats`
    tells what a hole and a period are. While the bus is silent, no id is: it is not known whether
    the bus was silent, or the recorder was off. Bytes that a recorder has lost are told by
    `canser.Gap`, not here.

    Examples
    --------
    >>> frames = canser.concat([canser.frames("123#01", "124#")] * 100)
    >>> frames["ts"] = np.arange(200) * 5_000_000
    >>> kept = (frames["id"] != 0x123) | (frames["ts"] < 300_000_000) | (frames["ts"] > 400_000_000)
    >>> found = canser.dropouts(frames.compress(kept))
    >>> found[["id", "from_ns", "length_ns", "missing"]].tolist()
    [(291, 290000000, 120000000, 11.0)]
    """
    frames, channels = contiguous(frames, channels)
    stats, row_of, steps = stats_and_steps(frames, channels)
    period = stats["period_ns"][row_of]
    at = np.flatnonzero(steps > _PERIODS * period)  # no step is -1, and no period is NaN
    rows = stats[row_of[at]]
    silent = np.zeros(len(at), DROPOUT_DTYPE)
    for name in ("id", "ext", "rtr", "err", "channel"):
        silent[name] = rows[name]
    silent["to_ns"], silent["length_ns"] = frames["ts"][at], steps[at]
    silent["missing"] = np.rint(steps[at] / rows["period_ns"] * rows["burst"] - rows["burst"])
    every = np.concatenate([_holes(frames), silent])
    every["from_ns"] = every["to_ns"] - every["length_ns"]
    return every.take(np.argsort(every["from_ns"], kind="stable"))


def _holes(frames: FrameArray) -> npt.NDArray[np.void]:
    """Return the silences of the whole bus."""
    runs = runs_of(frames)
    known = np.flatnonzero(runs)
    ts, runs = frames["ts"][known], runs[known]
    at = np.flatnonzero((runs[1:] != runs[:-1]) & (ts[1:] > ts[:-1])) + 1
    holes = np.zeros(len(at), DROPOUT_DTYPE)
    holes["bus"], holes["channel"], holes["missing"] = True, 255, np.nan
    holes["to_ns"], holes["length_ns"] = ts[at], ts[at] - ts[at - 1]
    return holes
