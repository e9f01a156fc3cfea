"""Frames as columns of Arrow, and back, by pyarrow."""

from typing import Any, Final

import numpy as np

from canser._core.text import NO_CHANNEL, SENT, Codes
from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray, reason_invalid
from canser.errors import FormatError
from canser.files.tags import RECEIVED, Tagged
from canser.tables.table import COLUMNS, make_table

__all__ = ["from_batch", "load_pyarrow", "to_batch"]

# Columns that a file need not have.
_OPTIONAL: Final = ("channel", "sent")

_DATA_LEN: Final = 8


def load_pyarrow(name: str) -> Any:
    """Return the module pyarrow; FormatError names the file if it is not installed."""
    try:
        import pyarrow as pa  # noqa: PLC0415 - an optional extra
    except ImportError:
        raise FormatError(
            f"{name} needs pyarrow, which is not installed: pip install 'canser[arrow]'"
        ) from None
    return pa


def to_batch(
    pa: Any, frames: FrameArray, channels: Codes | None, directions: Codes | None, *, dated: bool
) -> Any:
    """Return frames as a RecordBatch: `ts` is a timestamp in UTC if `dated`, else a duration."""
    return pa.record_batch(make_table(frames, channels, directions, dated=dated))


def from_batch(pa: Any, batch: Any, name: str, first: int) -> Tagged:
    """Return the frames of a RecordBatch; FormatError if it has other columns, or no CAN frames.

    `first` is the number of frames before it.
    """
    have = batch.schema.names
    missing = [each for each in COLUMNS if each not in have and each not in _OPTIONAL]
    if missing:
        raise FormatError(
            f"{name}: no column {', '.join(missing)}; canser reads the columns {', '.join(COLUMNS)}"
        )
    frames = np.zeros(batch.num_rows, FRAME_DTYPE)
    try:
        for field in ("id", "ext", "rtr", "err", "dlc"):
            of = pa.bool_() if field in ("ext", "rtr", "err") else getattr(pa, _TYPES[field])()
            frames[field] = _plain(batch[field].cast(of))
        frames["ts"] = _plain(_times(pa, batch["ts"]), NO_TIME)
        data = batch["data"].cast(pa.binary(_DATA_LEN))
        if data.null_count:
            raise ValueError("data is null")
        frames["data"] = np.frombuffer(data.buffers()[1], np.uint8).reshape(-1, _DATA_LEN)[
            data.offset : data.offset + len(data)
        ]
        channels = directions = None
        if "channel" in have:
            channels = _plain(batch["channel"].cast(pa.uint8()), NO_CHANNEL).astype(np.uint8)
        if "sent" in have:
            sent = _plain(batch["sent"].cast(pa.bool_()), False)
            directions = np.where(sent, SENT, RECEIVED).astype(np.uint8)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise FormatError(f"{name}: a column is not as canser writes it: {reason}") from None
    _check(frames, name, first)
    return Tagged(frames, channels, directions)


_TYPES: Final = {"id": "uint32", "dlc": "uint8"}


def _times(pa: Any, column: Any) -> Any:
    """Return times as whole nanoseconds, of any unit."""
    if pa.types.is_timestamp(column.type):
        column = column.cast(pa.timestamp("ns"))
    elif pa.types.is_duration(column.type):
        column = column.cast(pa.duration("ns"))
    return column.cast(pa.int64())


def _plain(column: Any, null: Any = None) -> Any:
    """Return a column as a numpy array; nulls become `null`, and are an error if that is None."""
    if column.null_count:
        if null is None:
            raise ValueError("a value is null")
        column = column.fill_null(null)
    return column.to_numpy(zero_copy_only=False)


def _check(frames: FrameArray, name: str, first: int) -> None:
    """Raise FormatError for the first record that is no CAN frame; blank bytes past the dlc."""
    limit = np.where(frames["ext"], 0x1FFF_FFFF, 0x7FF)
    for index in np.flatnonzero((frames["id"] > limit) | (frames["dlc"] > _DATA_LEN))[:1]:
        row = frames[index]
        found = reason_invalid(int(row["id"]), bool(row["ext"]), int(row["dlc"]))
        raise FormatError(f"{name}, frame {first + index}: {found}")
    length = np.where(frames["rtr"], 0, frames["dlc"])
    frames["data"][np.arange(_DATA_LEN) >= length[:, None]] = 0
