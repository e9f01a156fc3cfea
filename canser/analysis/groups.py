"""Frames by their ids, and the frames that change: `canser.by_id` and `canser.changes`."""

from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt

from canser._core.arrow import shared_empty
from canser._core.changes import copy_changes
from canser._core.ids import Rows, order_rows
from canser._core.text import Codes
from canser._frames import FRAME_DTYPE, FrameArray, contiguous_frames, copy_records
from canser._notation import ERR_FLAG
from canser.analysis.ids import contiguous
from canser.analysis.names import id_digits

__all__ = ["IdGroups", "by_id", "changes"]


class IdGroups(Mapping[str, FrameArray]):
    """The frames of each id, in the order in which they came; returned by `by_id`.

    A mapping from an id, as text, to a new array of its frames: three hexadecimal digits for a
    standard id, eight for an extended one. Remote frames are among the frames of their id. Error
    frames have groups of their own: eight digits with bit 29 set, as candump writes them.

    Examples
    --------
    >>> groups = canser.by_id(canser.frames("124#01", "123#02", "124#03"))
    >>> {name: len(frames) for name, frames in groups.items()}
    {'123': 1, '124': 2}
    >>> groups["124"]["data"][:, 0]
    array([1, 3], dtype=uint8)
    """

    def __init__(self, frames: FrameArray) -> None:
        self._frames = frames
        rows = Rows(remote_apart=False)
        row_of = rows.group(frames)
        found = rows.rows
        counts = found["breaks"]
        sorted_rows = np.lexsort([found[name] for name in ("ext", "id")])
        # Standard ids, extended ones, error frames. Those of error frames do not tell whether they
        # are extended, so both kinds stand side by side.
        kinds = np.where(found["err"], 2, found["ext"])[sorted_rows]
        sorted_rows = sorted_rows[np.argsort(kinds, kind="stable")]
        ends = np.cumsum(counts[sorted_rows])
        starts = np.empty_like(ends)
        starts[sorted_rows] = ends - counts[sorted_rows]
        self._order = order_rows(row_of, starts, counts)
        self._places: dict[str, tuple[int, int]] = {}
        for row, end in zip(found[sorted_rows], ends.tolist(), strict=True):
            name = _name(int(row["id"]), bool(row["ext"]), bool(row["err"]))
            start = end - int(row["breaks"])
            self._places[name] = self._places.get(name, (start, 0))[0], end

    @property
    def order(self) -> npt.NDArray[np.int64]:
        """The numbers of all frames, group by group: int64, shape (n,)."""
        return self._order

    @property
    def offsets(self) -> npt.NDArray[np.int64]:
        """Where each group starts in `order`, and the end: int64, shape (groups + 1,)."""
        starts = [start for start, _ in self._places.values()]
        return np.array([*starts, len(self._order)], np.int64)

    def __getitem__(self, name: str) -> FrameArray:
        try:
            start, end = self._places[name]
        except (KeyError, TypeError):
            raise KeyError(
                f"{name!r} is no id of these frames; write three hexadecimal digits for a standard "
                "id, eight for an extended one, upper case"
            ) from None
        return self._frames.take(self._order[start:end])

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __repr__(self) -> str:
        return f"<canser.IdGroups of {len(self):,} ids, {len(self._order):,} frames>"


def _name(number: int, ext: bool, err: bool) -> str:
    return id_digits(number | (ERR_FLAG if err else 0), long=ext or err)


def by_id(frames: FrameArray) -> IdGroups:
    """Return the frames of each id, by the id as text.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,)
        The frames, contiguous or not. They are not copied: they must not be changed while the
        groups are in use.

    Returns
    -------
    IdGroups
        A mapping: `groups["123"]` is an array of the frames with the standard id 0x123, in their
        order. `order` and `offsets` are the whole as indexes.

    Raises
    ------
    TypeError
        `frames` is no array of FRAME_DTYPE.
    ValueError
        The shape is not (n,).

    Examples
    --------
    >>> groups = canser.by_id(canser.frames("124#01", "18FEF100#02", "124#03"))
    >>> list(groups)
    ['124', '18FEF100']
    >>> groups.order, groups.offsets
    (array([0, 2, 1]), array([0, 2, 3]))
    """
    return IdGroups(contiguous_frames(frames))


def changes(frames: FrameArray, *, channels: Codes | None = None) -> FrameArray:
    """Return the first frame of each id, and all frames whose payload differs from the one before.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,)
        The frames in the order in which they came, contiguous or not.
    channels : array of uint8, shape (n,), optional
        Their channels: the same id on another channel is another one. By default all are one.

    Returns
    -------
    array of FRAME_DTYPE, shape (m,)
        A new array, in the order of `frames`. Remote frames and error frames of an id are compared
        among each other, apart from its data frames. A payload is the dlc and the data.

    Raises
    ------
    TypeError
        `frames` is no array of FRAME_DTYPE, or `channels` is no array of uint8.
    ValueError
        The shapes are not (n,).

    Examples
    --------
    >>> frames = canser.frames("123#01", "123#01", "124#01", "123#02")
    >>> canser.changes(frames)["id"]
    array([291, 292, 291], dtype=uint32)
    """
    frames, channels = contiguous(frames, channels)
    if not len(frames):
        return np.empty(0, FRAME_DTYPE)
    out = shared_empty(3 * len(frames), np.uint64).view(FRAME_DTYPE)
    found = out[: copy_changes(frames, channels, out)]
    # Few frames do not hold the memory of all.
    return found if 2 * len(found) >= len(out) else copy_records(found)
