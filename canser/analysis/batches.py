"""Batches of frames sorted by their ids: what a live table shows of the latest ones."""

from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from canser._core.ids import NO_ROW, Rows, order_rows
from canser._frames import FrameArray, contiguous_frames
from canser.analysis.ids import in_order

__all__ = ["Batch", "IdBatches", "previous"]

_Places = npt.NDArray[np.intp]
_Scalar = TypeVar("_Scalar", bound=np.generic)


class Batch(NamedTuple):
    """Frames that were added, sorted by their rows; within a row in the order of arrival.

    Each row has a place, a number from 0 on in the order in which the rows appeared.
    """

    #: The frames that have a row, shape (n,).
    frames: FrameArray
    #: Index of the first frame of each row, shape (m,).
    starts: _Places
    #: Number of frames of each row, shape (m,).
    counts: _Places
    #: Place of each row, shape (m,).
    places: _Places
    #: Whether these are the first frames of the row, shape (m,).
    new: npt.NDArray[np.bool_]
    #: Intervals from a frame to the next one of its row, in nanoseconds, sorted by row. None leads
    #: across a jump of the clock or a hole of the bus.
    steps: npt.NDArray[np.int64]
    #: Number of intervals of each row, shape (m,).
    step_counts: _Places


class IdBatches:
    """A row for each id and kind of frames.

    Frames are added in batches, in the order of their arrival. The result does not depend on how
    they are divided into batches.

    Parameters
    ----------
    rows_most : int
        The most rows. Frames that would need another row are only counted, in `others`.

    Attributes
    ----------
    frames : int
        Frames that were added.
    """

    def __init__(self, rows_most: int) -> None:
        self.frames = 0
        self._rows = Rows(remote_apart=True, rows_most=rows_most)
        self._counts = np.zeros(0, np.int64)  # frames of each row before the batch

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._rows)

    @property
    def others(self) -> int:
        """Frames that were added and have no row."""
        return self._rows.others

    @property
    def places(self) -> _Places:
        """The places of all rows: standard ids first, then extended ones, then error frames."""
        return in_order(self._rows.rows)

    @property
    def counts(self) -> npt.NDArray[np.int64]:
        """The frames of all rows, in the order of `places`."""
        return self._count()[self.places]

    def add(self, frames: FrameArray) -> Batch:
        """Add frames: array of FRAME_DTYPE, shape (n,)."""
        frames = contiguous_frames(frames)
        self.frames += len(frames)
        row_of, steps = np.empty(len(frames), np.uint32), np.empty(len(frames), np.int64)
        before = self._count()
        self._rows.add(frames, None, row_of, steps)
        before = np.append(before, np.zeros(len(self) - len(before), np.int64))
        counts = self._count() - before
        places = np.flatnonzero(counts)
        order = order_rows(row_of, np.cumsum(counts) - counts, counts)
        step_counts = np.bincount(row_of[(row_of != NO_ROW) & (steps >= 0)], minlength=len(self))
        steps = order_rows(row_of, np.cumsum(step_counts) - step_counts, step_counts, steps)
        counts = counts[places]
        return Batch(
            frames.take(order),
            np.cumsum(counts) - counts,
            counts,
            places,
            before[places] == 0,
            steps,
            step_counts[places],
        )

    def _count(self) -> npt.NDArray[np.int64]:
        rows = self._rows.rows
        counts: npt.NDArray[np.int64] = rows["steps"] + rows["breaks"]
        return counts


def previous(
    values: npt.NDArray[_Scalar], first: npt.NDArray[_Scalar], starts: _Places
) -> npt.NDArray[_Scalar]:
    """Return for each value the value before it; for those at `starts` the value in `first`."""
    before = np.empty_like(values)
    before[1:] = values[:-1]
    before[starts] = first
    return before
