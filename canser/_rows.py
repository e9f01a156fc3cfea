"""Single frames as tuples of their fields: checks, and arrays of them."""

import struct
from collections.abc import Iterable
from itertools import starmap
from typing import Final, TypeAlias

import numpy as np

from canser._frames import FRAME_DTYPE, FrameArray, reason_invalid

__all__ = ["Row", "check_row", "rows_to_frames"]

# The fields of a record, with data cut to its length: id ext rtr dlc err data ts.
Row: TypeAlias = tuple[int, bool, bool, int, bool, bytes, int]

_RECORD: Final = struct.Struct("=I??B?8sq")
assert _RECORD.size == FRAME_DTYPE.itemsize


def check_row(row: Row) -> Row:
    """Return a row if it is a CAN frame, or raise ValueError."""
    arbitration_id, ext, rtr, dlc, _, data, _ = row
    found = reason_invalid(arbitration_id, ext, dlc)
    if found is not None:
        raise ValueError(found)
    if rtr and data:
        raise ValueError(f"a remote frame has no data, but there are {len(data)} bytes")
    if not rtr and len(data) != dlc:
        raise ValueError(f"the dlc is {dlc}, but there are {len(data)} bytes of data")
    return row


def rows_to_frames(rows: Iterable[Row]) -> FrameArray:
    """Return an array of rows that are CAN frames; it can be written."""
    return np.frombuffer(bytearray().join(starmap(_RECORD.pack, rows)), FRAME_DTYPE)
