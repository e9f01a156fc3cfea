"""Frames as the arguments of python-can's `Message`."""

from collections.abc import Iterator
from itertools import repeat
from operator import add, getitem
from typing import TypeAlias

from canser._frames import NO_TIME, FrameArray

__all__ = ["MessageRow", "to_rows"]

# The first arguments of `can.Message`, in its order: timestamp, arbitration_id,
# is_extended_id, is_remote_frame, is_error_frame, channel, dlc, data.
MessageRow: TypeAlias = tuple[float, int, bool, bool, bool, None, int, bytearray]


def to_rows(frames: FrameArray) -> Iterator[MessageRow]:
    """Return the arguments of a `Message` for each frame.

    A time is the nearest float, in seconds; a time that is not known is 0, as in a new `Message`.
    The channel is None, as in messages of python-can's own serial buses. Each row has a bytearray
    of its own, as `Message` does not copy it.
    """
    ts = frames["ts"] / 1e9
    ts[frames["ts"] == NO_TIME] = 0.0
    dlc = frames["dlc"].tolist()
    starts = range(0, 8 * len(frames), 8)
    # One copy of all data, cut by functions that are written in C. A loop in Python would take
    # longer than the messages do.
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
