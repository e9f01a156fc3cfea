"""Batches of Arrow as native columns, by pyarrow."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser._core.text import NO_CHANNEL
from canser._frames import NO_TIME
from canser.tables.build import RowError, inverted
from canser.tables.names import RECEIVED_TITLE

__all__ = ["arrow_columns"]

# What a null of a column becomes. A direction that is not told is that of a received frame; in the
# other columns a null is an error.
_NULLS: Final = {"ts": NO_TIME, "channel": NO_CHANNEL}

_DATA_LEN: Final = 8


def arrow_columns(pa: Any, batch: Any, titles: dict[str, str]) -> dict[str, npt.NDArray[Any]]:
    """Return columns of a RecordBatch by their native names.

    `titles`: the native name of each column that is read. RowError for a null that has no meaning,
    ValueError for times that may be of any unit; pyarrow's errors for a type that does not fit.
    """
    columns = {}
    for title, name in titles.items():
        column = batch[title]
        if name == "data":
            columns[name] = _data(pa, column, title)
            continue
        if name == "ts":
            column = _times(pa, column)
        if column.null_count:
            if name == "sent":
                column = _widened(pa, column)
                null = pa.scalar(int(title == RECEIVED_TITLE)).cast(column.type)
                column = column.fill_null(null)
            elif name in _NULLS:
                column = _widened(pa, column).fill_null(_NULLS[name])
            else:
                raise _null(column, title)
        columns[name] = column.to_numpy(zero_copy_only=False)
        if title == RECEIVED_TITLE:
            columns[name] = inverted(columns[name])
    return columns


def _null(column: Any, title: str) -> RowError:
    """Return the error for the first null of a column."""
    return RowError(column.is_valid().index(False).as_py(), f"{title} is null")


def _widened(pa: Any, column: Any) -> Any:
    """Return whole numbers as int64, which has room for the number that a null becomes."""
    return column.cast(pa.int64()) if pa.types.is_integer(column.type) else column


def _times(pa: Any, column: Any) -> Any:
    """Return times as whole nanoseconds, of any unit."""
    if pa.types.is_timestamp(column.type):
        column = column.cast(pa.timestamp("ns"))
    elif pa.types.is_duration(column.type):
        column = column.cast(pa.duration("ns"))
    elif column.type == pa.month_day_nano_interval():
        return pa.array(map(_of_interval, column.to_pylist()), pa.int64())
    elif not pa.types.is_integer(column.type):
        # Floats may be seconds.
        raise ValueError(f"times have the type {column.type}; give times or whole nanoseconds")
    return column.cast(pa.int64())


def _of_interval(interval: Any) -> int | None:
    """Return nanoseconds of an interval, as duckdb has them for durations."""
    if interval is None:
        return None
    if interval.months:
        raise ValueError("a time has months, which have no fixed length; give a duration")
    nanoseconds: int = interval.days * 86_400 * 10**9 + interval.nanoseconds
    return nanoseconds


def _data(pa: Any, column: Any, title: str) -> npt.NDArray[Any]:
    """Return a column of data as bytes, shape (n, 8), or as objects of any length."""
    if column.null_count:
        raise _null(column, title)
    kind = column.type
    if pa.types.is_list(kind) or pa.types.is_large_list(kind):
        return _objects(column)
    if pa.types.is_fixed_size_list(column.type):
        flat: npt.NDArray[np.uint8] = column.flatten().cast(pa.uint8()).to_numpy()
        return flat.reshape(len(column), column.type.list_size)
    try:
        column = column.cast(pa.binary(_DATA_LEN))
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        if "binary" not in str(kind):
            raise
        return _objects(column)  # of other lengths, or views, which old releases do not cast
    whole = np.frombuffer(column.buffers()[1], np.uint8)
    return whole[8 * column.offset : 8 * (column.offset + len(column))].reshape(-1, 8)


def _objects(column: Any) -> npt.NDArray[Any]:
    objects = np.empty(len(column), object)
    objects[:] = column.to_pylist()
    return objects
