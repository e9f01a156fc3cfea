"""Frames as columns of Arrow, which other programs take without a copy and without pyarrow."""

from typing import Final

import numpy as np

from canser._core.arrow import Capsule, Columns
from canser._core.text import Codes
from canser._frames import (
    NO_TIME,
    YEAR_2000_NS,
    FrameArray,
    check_codes,
    check_frames,
    copy_records,
)

__all__ = ["COLUMNS", "Table", "is_dated", "make_table", "table"]

# The columns, in their order. Besides those of FRAME_DTYPE there are `channel` (from 0, null if it
# is not told) and `sent` (null if the direction is not told).
COLUMNS: Final = ("ts", "channel", "sent", "id", "ext", "rtr", "err", "dlc", "data")

# Frames whose times are looked at together. Most often the first time of all is known.
_LOOKED_AT: Final = 1 << 10


class Table:
    """Frames as columns of Arrow, which never change; made by `table`.

    Any program takes it that knows Arrow's PyCapsule interface. The columns are `ts` (null if it
    is not known), `channel` (null if it is not told), `sent` (null if it is not told), `id`, `ext`,
    `rtr`, `err`, `dlc` and `data` (always 8 bytes).
    """

    def __init__(self, columns: Columns, *, dated: bool) -> None:
        self._columns = columns
        self._dated = dated

    def __len__(self) -> int:
        return len(self._columns)

    def __repr__(self) -> str:
        times = "dates in UTC" if self._dated else "durations"
        return f"<canser.Table of {len(self):,} frames, times are {times}>"

    def __arrow_c_schema__(self) -> Capsule:
        return self._columns.schema()

    def __arrow_c_array__(
        self,
        requested_schema: Capsule | None = None,
    ) -> tuple[Capsule, Capsule]:
        return self._columns.schema(), self._columns.array()

    def __arrow_c_stream__(
        self,
        requested_schema: Capsule | None = None,
    ) -> Capsule:
        return self._columns.stream()


def table(
    frames: FrameArray, *, channels: Codes | None = None, directions: Codes | None = None
) -> Table:
    """Make a table that pyarrow, polars and others take without a further copy.

    The frames are copied: the array may be filled again afterwards.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,)
        The frames, contiguous or not.
    channels, directions : array of uint8, shape (n,), optional
        Their channels, numbers from 0 and 255 for not told, and their directions, 1 for sent and 0
        for received. By default both are not told: null.

    Returns
    -------
    Table
        Times are dates in UTC if the first known time is from 2000 on. Otherwise they are
        durations.

    Raises
    ------
    TypeError
        `frames` is no array of FRAME_DTYPE, or an argument is a masked array or of another dtype.
    ValueError
        The shapes are not (n,).
    MemoryError
        There is no memory for the table.

    Examples
    --------
    >>> frames = canser.frames("123#01", "18FEF100#0203")
    >>> frames["ts"] = [0, 1_000_000]
    >>> canser.table(frames)
    <canser.Table of 2 frames, times are durations>

    >>> import pyarrow
    >>> pyarrow.table(canser.table(frames)).column("id").to_pylist()
    [291, 419361024]
    """
    check_frames(frames, "frames")
    for name, codes in (("channels", channels), ("directions", directions)):
        if codes is not None:
            check_codes(codes, name, frames)
    return make_table(frames, channels, directions, dated=is_dated(frames))


def make_table(
    frames: FrameArray, channels: Codes | None, directions: Codes | None, *, dated: bool
) -> Table:
    """Return a table of arrays that are checked: times are dates in UTC if `dated`."""
    if not (frames.flags.c_contiguous and frames.flags.aligned):
        frames = copy_records(frames)
    channels, directions = (
        None if codes is None else np.ascontiguousarray(codes) for codes in (channels, directions)
    )
    return Table(Columns(frames, channels, directions, dated=dated), dated=dated)


def is_dated(frames: FrameArray) -> bool:
    """Return whether the first known time is a date."""
    times = frames["ts"]
    for first in range(0, len(times), _LOOKED_AT):
        part = times[first : first + _LOOKED_AT]
        known = part[part != NO_TIME]
        if len(known):
            return int(known[0]) >= YEAR_2000_NS
    return False
