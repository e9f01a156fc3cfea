"""Batches of Arrow as native columns, by pyarrow."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser._core.text import NO_CHANNEL
from canser._frames import NO_TIME
from canser.tables.names import RECEIVED_TITLE

__all__ = ["arrow_columns"]

# What a null of a column becomes. A direction that is not told is that of a received frame; in the
# other columns a null is an error.
_NULLS: Final = {"ts": NO_TIME, "channel": NO_CHANNEL}


def arrow_columns(pa: Any, batch: Any, titles: dict[str, str]) -> dict[str, npt.NDArray[Any]]:
    """Return columns of a RecordBatch by their native names.

    `titles`: the native name of each column that is read. ValueError for a null that has no
    meaning, and for data that are no 8 bytes; pyarrow's errors for a type that does not fit.
    """
    columns = {}
    for title, name in titles.items():
        column = batch[title]
        if name == "data":
            columns[name] = _data(pa, column)
            continue
        if name == "ts":
            column = _times(pa, column)
        if column.null_count:
            if name == "sent":
                column = column.fill_null(title == RECEIVED_TITLE)
            elif name in _NULLS:
                column = column.fill_null(_NULLS[name])
            else:
                raise ValueError(f"{title} is null")
        columns[name] = column.to_numpy(zero_copy_only=False)
        if title == RECEIVED_TITLE:
            columns[name] = ~columns[name]
    return columns


def _times(pa: Any, column: Any) -> Any:
    """Return times as whole nanoseconds, of any unit."""
    if pa.types.is_timestamp(column.type):
        column = column.cast(pa.timestamp("ns"))
    elif pa.types.is_duration(column.type):
        column = column.cast(pa.duration("ns"))
    return column.cast(pa.int64())


def _data(pa: Any, column: Any) -> npt.NDArray[np.uint8]:
    """Return a column of data as bytes, shape (n, 8)."""
    if column.null_count:
        raise ValueError("data is null")
    if pa.types.is_fixed_size_list(column.type):
        flat: npt.NDArray[np.uint8] = column.flatten().cast(pa.uint8()).to_numpy()
        return flat.reshape(len(column), column.type.list_size)
    column = column.cast(pa.binary(8))
    whole = np.frombuffer(column.buffers()[1], np.uint8)
    return whole[8 * column.offset : 8 * (column.offset + len(column))].reshape(-1, 8)
