"""Dates in files: local time, unless the caller names a zone."""

import datetime as dt
from typing import Final

import numpy as np
import numpy.typing as npt

from canser._frames import NO_TIME, YEAR_2000_NS, FrameArray

__all__ = ["are_dates", "date_ns", "date_text", "first_date", "is_dated", "local_date", "to_ns"]

_SECOND_NS: Final = 1_000_000_000
# Frames whose times are looked at together. Most often the first time of all is known.
_LOOKED_AT: Final = 1 << 10

_EPOCH: Final = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)


def to_ns(date: dt.date, time: str, tz: dt.tzinfo | None) -> int:
    """Return a date and a time such as 14:31:19.432583 as nanoseconds since 1970.

    ValueError for a text that is no time of day.
    """
    hours, minutes, seconds = time.split(":")
    whole, _, places = seconds.partition(".")
    moment = dt.datetime(date.year, date.month, date.day, int(hours), int(minutes), int(whole))
    return date_ns(moment, tz) + int(places[:9].ljust(9, "0"))


def date_ns(moment: dt.datetime, tz: dt.tzinfo | None) -> int:
    """Return a date as nanoseconds since 1970; without a zone it is of `tz`, or local time."""
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=tz) if tz is not None else moment.astimezone()
    since = moment - _EPOCH
    return (since.days * 86_400 + since.seconds) * _SECOND_NS + since.microseconds * 1_000


def local_date(ns: int, tz: dt.tzinfo | None) -> dt.datetime:
    """Return nanoseconds since 1970 as a date of a zone, or of local time, in microseconds."""
    moment = _EPOCH + dt.timedelta(microseconds=ns // 1000)
    return moment.astimezone(tz)


def date_text(ns: int, tz: dt.tzinfo | None) -> str:
    """Return nanoseconds since 1970 as a date, a time of day with milliseconds, and the zone."""
    date = local_date(ns, tz)
    zone = f"{date:%Z}" + (" (local time)" if tz is None else "")
    return f"{date:%Y-%m-%d %H:%M:%S}.{date.microsecond // 1000:03} {zone}"


def first_date(frames: FrameArray, step_ns: int) -> int:
    """Return the first time, rounded down to a step, if it is a date; else 0."""
    known = frames["ts"][frames["ts"] != NO_TIME]
    first = int(known[0]) if len(known) else 0
    return first - first % step_ns if first >= YEAR_2000_NS else 0


def is_dated(frames: FrameArray) -> bool:
    """Return whether the first known time is a date."""
    return are_dates(frames["ts"])


def are_dates(times: npt.NDArray[np.int64]) -> bool:
    """Return whether the first known time, of nanoseconds, is a date."""
    for first in range(0, len(times), _LOOKED_AT):
        part = times[first : first + _LOOKED_AT]
        known = part[part != NO_TIME]
        if len(known):
            return int(known[0]) >= YEAR_2000_NS
    return False
