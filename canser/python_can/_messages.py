"""Frames as the arguments of python-can's `Message`, and back."""

import struct
from collections.abc import Iterable, Iterator
from itertools import repeat
from operator import add, getitem
from typing import Final, TypeAlias

import numpy as np

from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray

__all__ = ["Row", "frames_of", "rows"]

# The first arguments of `can.Message`, in its order: timestamp, arbitration_id,
# is_extended_id, is_remote_frame, is_error_frame, channel, dlc, data.
Row: TypeAlias = tuple[float, int, bool, bool, bool, None, int, bytearray]

_RECORD: Final = struct.Struct("=I??B?8sq")
assert _RECORD.size == FRAME_DTYPE.itemsize


def rows(frames: FrameArray) -> Iterator[Row]:
    """Return the arguments of a `Message` for each frame.

    A time in seconds is the float that is nearest; one that is not known is 0, as that of a
    new `Message`. The channel is None, as python-can's own serial buses leave it. Each has
    a bytearray of its own, which `Message` takes as it is.
    """
    ts = frames["ts"] / 1e9
    ts[frames["ts"] == NO_TIME] = 0.0
    dlc = frames["dlc"].tolist()
    starts = range(0, 8 * len(frames), 8)
    # One copy of all, cut by what is written in C: a loop in Python would cost more than
    # the messages do.
    data = bytearray(frames["data"].tobytes())
    return zip(
        ts.tolist(),
        frames["id"].tolist(),
        frames["ext"].tolist(),
        frames["rtr"].tolist(),
        frames["err"].tolist(),
        repeat(None),
        dlc,
        map(getitem, repeat(data), map(slice, starts, map(add, starts, dlc))),
        strict=False,
    )


def frames_of(contents: Iterable[tuple[int, int, bool, bool, bool, int, bytes]]) -> FrameArray:
    """Return frames, read-only, of what each has: ts, id, ext, rtr, err, dlc, data."""
    raw = b"".join(
        _RECORD.pack(arbitration_id, ext, rtr, dlc, err, data, ts)
        for ts, arbitration_id, ext, rtr, err, dlc, data in contents
    )
    return np.frombuffer(raw, FRAME_DTYPE)
