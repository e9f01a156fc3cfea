"""The numbers that options take: ASCII digits within limits. Each function is an argparse type.

int() and float() also accept `1_000`, ` 5 `, `nan` and the digits of other scripts. In an option
these are typing errors.
"""

import math
import re
from argparse import ArgumentTypeError
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from typing import Final

from canser._quantities import is_duration, parse_bytes, parse_seconds
from canser.files.selection import Moment

__all__ = [
    "FILE",
    "byte_count",
    "date",
    "duration",
    "epoch",
    "moment",
    "real",
    "time_zone",
    "whole",
]

# The epoch that is the start which a file names.
FILE: Final = "file"

# No count needs more digits. int() refuses more than 4,300 digits, with an error of its own.
_DIGITS_MOST: Final = 30

_WHOLE: Final = re.compile(f"-?[0-9]{{1,{_DIGITS_MOST}}}")
_REAL: Final = re.compile(r"-?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")

# A date and a time of day; seconds, their fraction and the offset from UTC are optional.
_DATE: Final = re.compile(
    r"(?P<seconds>[0-9]{4}-[0-9]{2}-[0-9]{2}[T ][0-9]{2}:[0-9]{2}(?::[0-9]{2})?)"
    r"(?:\.(?P<fraction>[0-9]{1,9}))?(?P<offset>Z|[+-][0-9]{2}:[0-9]{2})?"
)

_OFFSET: Final = re.compile(r"(?P<sign>[+-])(?P<hours>[01][0-9]|2[0-3]):(?P<minutes>[0-5][0-9])")


def whole(*, least: int = 0, most: int | None = None) -> Callable[[str], int]:
    """Return a type for whole numbers from `least` to `most`."""

    def parse(text: str) -> int:
        if not _WHOLE.fullmatch(text):
            raise _no_number(text, "a whole number such as 10")
        value = int(text)
        if value < least:
            raise ArgumentTypeError(f"{text} must be {least} or more")
        if most is not None and value > most:
            raise ArgumentTypeError(f"{text} must be {least} to {most}")
        return value

    return parse


def real(
    *, least: float = 0, most: float = math.inf, above: bool = False
) -> Callable[[str], float]:
    """Return a type for numbers from `least` to `most`; with `above`, more than `least`."""

    def parse(text: str) -> float:
        if not _REAL.fullmatch(text):
            raise _no_number(text, "a number such as 10 or 0.5")
        value = float(text)
        if value == math.inf:
            raise ArgumentTypeError(f"{text} is too large")
        if above and not value > least:
            raise ArgumentTypeError(f"{text} is too small; it must be more than {least:g}")
        if value < least:
            raise ArgumentTypeError(f"{text} must be {least:g} or more")
        if value > most:
            raise ArgumentTypeError(f"{text} must be {least:g} to {most:.15g}")
        return value

    return parse


def duration(text: str) -> float:
    """Return the seconds of a time such as 500ms, 5s, 10m, 1h or 2d."""
    try:
        return parse_seconds(text)
    except ValueError as error:
        raise ArgumentTypeError(str(error)) from None


def byte_count(text: str) -> int:
    """Return the bytes of a size such as 500k, 100M or 1.5Gi."""
    try:
        return parse_bytes(text)
    except ValueError as error:
        raise ArgumentTypeError(str(error)) from None


def _no_number(text: str, wanted: str) -> ArgumentTypeError:
    return ArgumentTypeError(f"{text!r} is no number; write {wanted}")


def date(text: str) -> int:
    """Return the nanoseconds since 1970 of a date and time, in UTC unless it has an offset."""
    found = _DATE.fullmatch(text)
    try:
        if found is None:
            raise ValueError
        moment = datetime.fromisoformat(found["seconds"] + (found["offset"] or "+00:00"))
    except ValueError:
        raise ArgumentTypeError(
            f"cannot read the date {text!r}; write 2026-11-26T08:00:00, with an offset such as "
            "+01:00 at its end if it is not UTC"
        ) from None
    fraction = int((found["fraction"] or "").ljust(9, "0"))
    return int(moment.timestamp()) * 10**9 + fraction


def epoch(text: str) -> int | str:
    """Return the nanoseconds since 1970 of a date, or FILE for the start that a file names."""
    return FILE if text == FILE else date(text)


def time_zone(text: str) -> tzinfo:
    """Return a time zone: UTC, an offset such as +01:00, or a name such as Europe/Berlin."""
    found = _OFFSET.fullmatch(text)
    if found:
        minutes = int(found["hours"]) * 60 + int(found["minutes"])
        return timezone(timedelta(minutes=-minutes if found["sign"] == "-" else minutes))
    from zoneinfo import ZoneInfo  # noqa: PLC0415 - slow, and seldom needed

    try:
        return UTC if text.upper() == "UTC" else ZoneInfo(text)
    except (KeyError, ValueError, OSError):
        raise ArgumentTypeError(
            f"unknown time zone {text!r}; write UTC, +01:00 or Europe/Berlin"
        ) from None


def moment(text: str) -> Moment:
    """Return a time in a stream: a date, or a time after the first frame."""
    if is_duration(text):
        return Moment(round(duration(text) * 1e9), from_first=True)
    try:
        return Moment(date(text), from_first=False)
    except ArgumentTypeError:
        raise ArgumentTypeError(
            f"cannot read the time {text!r}; write 500ms, 90s, 1h, or 2026-11-26T08:00:00"
        ) from None
