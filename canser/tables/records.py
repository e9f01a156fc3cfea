"""The columns of records that are no frames, such as rows of statistics."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser._core.arrow import (
    FLAGS,
    LIST,
    NULLS_NAN,
    NULLS_NO_CHANNEL,
    NULLS_NO_TIME,
    NULLS_NONE,
    TEXT,
    Column,
)
from canser._frames import NO_TIME, YEAR_2000_NS

__all__ = ["FORMATS", "record_columns"]

# Numbers of which some are null.
_NULLS: Final = {"f8": NULLS_NAN}

# Arrow's formats of numbers, by the kind and the size of numpy's.
FORMATS: Final = {
    "u1": "C", "u2": "S", "u4": "I", "u8": "L", "i1": "c", "i2": "s", "i4": "i", "i8": "l",
    "f4": "f", "f8": "g",
}  # fmt: skip


def record_columns(records: npt.NDArray[np.void], *, as_list: bool) -> list[Column]:
    """Return a column for each field; `as_list`: bytes are lists of numbers.

    TypeError for a field of a type that no array of canser has.
    """
    return [_column(name, records[name], as_list) for name in records.dtype.names or ()]


def _column(name: str, values: npt.NDArray[Any], as_list: bool) -> Column:
    if not values.dtype.isnative:
        values = values.astype(values.dtype.newbyteorder("="))
    kind = values.dtype.kind
    code = f"{kind}{values.itemsize}"
    column = None
    if values.ndim == 2 and code == "u1":
        of = f"w:{values.shape[1]}"
        column = Column(name, f"+{of}", values, LIST) if as_list else Column(name, of, values)
    elif values.ndim == 1 and kind == "b":
        column = Column(name, "b", values, FLAGS)
    elif values.ndim == 1 and kind in "US":
        texts = _utf8(name, values)
        column = Column(name, "U", texts if texts.itemsize else texts.astype("S1"), TEXT)
    elif values.ndim == 1 and code in FORMATS:
        column = Column(name, FORMATS[code], values, nulls=_NULLS.get(code, NULLS_NONE))
        if code == "i8" and name.endswith("_ns"):
            column = column._replace(format=_time_format(values), nulls=NULLS_NO_TIME)
        if code == "u1" and name == "channel":
            column = column._replace(nulls=NULLS_NO_CHANNEL)
    if column is None:
        dtype = values.dtype
        raise TypeError(f"the field {name} has the dtype {dtype}, for which there is no column")
    return column


def _utf8(name: str, values: npt.NDArray[Any]) -> npt.NDArray[np.bytes_]:
    """Return text as UTF-8, which the takers of a table rely on."""
    try:
        if values.dtype.kind == "U":
            return np.char.encode(values, "utf-8")
        np.char.decode(values, "utf-8")
    except UnicodeError as error:
        raise ValueError(f"the field {name} is no UTF-8: {error}; decode it first") from None
    return values


def _time_format(values: npt.NDArray[np.int64]) -> str:
    known = values[values != NO_TIME]
    return "tsn:UTC" if len(known) and known[0] >= YEAR_2000_NS else "tDn"
