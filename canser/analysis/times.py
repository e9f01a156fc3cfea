"""Frames by their times: `canser.between` and `canser.merge`."""

import datetime as dt
from typing import Any, Final

import numpy as np

from canser._checks import type_name
from canser._dates import date_ns, is_dated
from canser._frames import NO_TIME, FrameArray, check_frames, concat

__all__ = ["between", "merge"]

# Units of numpy's times that are finer than those of frames.
_FINER: Final = ("ps", "fs", "as")

Time = int | np.datetime64 | np.timedelta64 | dt.datetime | dt.timedelta


def between(frames: FrameArray, start: Time | None = None, end: Time | None = None) -> FrameArray:
    """Return the frames from one time on and before another one.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,)
        The frames in any order, contiguous or not.
    start : int, datetime64, timedelta64, datetime or timedelta, optional
        The first time that is taken: nanoseconds, or a date of numpy, Python or pandas. A datetime
        without a zone is local time, one of pandas is UTC as all of numpy are. A time of numpy is
        cut to nanoseconds. By default there is no first one.
    end : int, datetime64, timedelta64, datetime or timedelta, optional
        The first time that is no longer taken. By default there is none.

    Returns
    -------
    array of FRAME_DTYPE, shape (m,)
        A new array, in the order of `frames`. Frames without a time are left out.

    Raises
    ------
    TypeError
        `frames` is no array of FRAME_DTYPE, or a time is of another type.
    ValueError
        The shape is not (n,), a time is a date and those of the frames are not, or the other way
        round, or a time is NaT, or a time of numpy is not within 292 years of 1970.

    Examples
    --------
    >>> frames = canser.frames("123#01", "123#02", "123#03")
    >>> frames["ts"] = [0, 1_000_000_000, 2_000_000_000]
    >>> canser.between(frames, np.timedelta64(1, "s"))["data"][:, 0]
    array([2, 3], dtype=uint8)
    """
    check_frames(frames, "frames")
    ts = frames["ts"]
    chosen = ts != NO_TIME
    for name, time in (("start", start), ("end", end)):
        if time is None:
            continue
        border = _to_ns(time, name)
        _check_kind(time, name, frames)
        chosen &= ts >= border if name == "start" else ts < border
    return frames.compress(chosen)


def merge(*arrays: FrameArray) -> FrameArray:
    """Join arrays of frames into one in the order of their times, such as those of two buses.

    Parameters
    ----------
    *arrays : array of FRAME_DTYPE, shape (n,)
        The arrays, contiguous or not, in any order of times.

    Returns
    -------
    array of FRAME_DTYPE, shape (m,)
        A new array of all frames, by time. Frames of equal times are in the order of the arrays,
        and in that of an array.

    Raises
    ------
    TypeError
        An item is no array of FRAME_DTYPE.
    ValueError
        A frame has no time; or the times of one array are dates, and those of another one are not.

    See Also
    --------
    concat : Joins arrays without a change of their order.

    Examples
    --------
    >>> a, b = canser.frames("123#", "124#"), canser.frames("200#")
    >>> a["ts"], b["ts"] = [0, 2_000_000], 1_000_000
    >>> canser.merge(a, b)["id"]
    array([291, 512, 292], dtype=uint32)
    """
    for index, frames in enumerate(arrays):
        check_frames(frames, f"arrays[{index}]")
        untimed = int((frames["ts"] == NO_TIME).sum())
        if untimed:
            raise ValueError(
                f"{untimed:,} frames of arrays[{index}] have no time; leave them out with "
                "canser.between(frames), or join the arrays with canser.concat"
            )
    kinds = [is_dated(frames) for frames in arrays if len(frames)]
    if len(set(kinds)) > 1:
        raise ValueError(
            "the times of some arrays are dates, and those of others count from a start; read the "
            'latter with epoch="file", or with the date of their start'
        )
    whole = concat(arrays)
    return whole.take(np.argsort(whole["ts"], kind="stable"))


def _check_kind(time: Any, name: str, frames: FrameArray) -> None:
    """Raise ValueError for a date among times that are none, or a difference among dates."""
    if not (frames["ts"] != NO_TIME).any():
        return
    dated = is_dated(frames)
    if isinstance(time, dt.datetime | np.datetime64) and not dated:
        raise ValueError(
            f"{name} is a date, and the times of the frames count from a start; give a timedelta"
        )
    if isinstance(time, dt.timedelta | np.timedelta64) and dated:
        raise ValueError(f"{name} is a difference, and the times of the frames are dates")


def _to_ns(time: Any, name: str) -> int:
    """Return a time in nanoseconds."""
    if isinstance(time, dt.datetime | dt.timedelta):
        # Those of pandas are subclasses with nanoseconds, which Python's arithmetic cuts off.
        to_numpy = getattr(time, "to_datetime64", getattr(time, "to_timedelta64", None))
        time = time if to_numpy is None else to_numpy()
    if isinstance(time, np.datetime64 | np.timedelta64):
        if np.isnat(time):
            raise ValueError(f"{name} is NaT, which is no time; leave it out")
        unit = "datetime64[ns]" if isinstance(time, np.datetime64) else "timedelta64[ns]"
        exact = time.astype(unit)
        # numpy cuts a time that does not fit into 64 bits of nanoseconds, in silence.
        if np.datetime_data(time.dtype)[0] not in _FINER and exact.astype(time.dtype) != time:
            raise ValueError(
                f"{name} is {time}, which is not within 292 years of 1970; leave it out"
            )
        return int(exact.astype(np.int64))
    if isinstance(time, dt.datetime):
        return date_ns(time, None)
    if isinstance(time, dt.timedelta):
        return time // dt.timedelta(microseconds=1) * 1_000
    if isinstance(time, bool) or not isinstance(time, int | np.integer):
        raise TypeError(
            f"{name} must be nanoseconds, a datetime or a timedelta, not {type_name(time)}"
        )
    return int(time)
