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
