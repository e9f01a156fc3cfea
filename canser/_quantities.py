"""Times and sizes as people write them, such as 500ms, 1h, 100M."""

import re
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from fractions import Fraction

__all__ = ["LONGEST_S", "is_duration", "parse_bytes", "parse_ns", "parse_seconds"]

_DURATION: Final = re.compile(
    r"(?P<number>[0-9]+(?:\.[0-9]+)?)(?: *(?P<unit>ns|us|ms|s|min|m|h|d))?"
)
_SECONDS: Final = {
    "ns": 1e-9, "us": 1e-6, "ms": 0.001, "s": 1,
    "min": 60, "m": 60, "h": 3600, "d": 86400, None: 1,
}  # fmt: skip

# The longest time in days. Its nanoseconds fit into 64 bits.
_DAYS_MOST: Final = 100_000
LONGEST_S: Final = _DAYS_MOST * 86_400

_BYTE_COUNT: Final = re.compile(r"(?P<number>[0-9]+(?:\.[0-9]+)?)(?: *(?:(?P<unit>[kKMG]i?)B?|B))?")
_UNITS: Final = {
    None: 1, "k": 10**3, "K": 10**3, "M": 10**6, "G": 10**9,
    "ki": 1 << 10, "Ki": 1 << 10, "Mi": 1 << 20, "Gi": 1 << 30,
}  # fmt: skip


def is_duration(text: str) -> bool:
    """Return whether a text is a time such as 90s."""
    return _DURATION.fullmatch(text) is not None


def parse_seconds(text: str) -> float:
    """Return the seconds of a time such as 500ms, 5s, 10m, 1h or 2d; or raise ValueError."""
    found = _DURATION.fullmatch(text)
    if found is None:
        raise ValueError(f"cannot read the time {text!r}; write 500ms, 5s, 10m, 1h")
    seconds = float(found["number"]) * _SECONDS[found["unit"]]
    if seconds > LONGEST_S:
        raise ValueError(f"the time {text} is too long; give {_DAYS_MOST}d or less")
    return seconds


def _exact(number: str) -> "Fraction":
    from fractions import Fraction  # noqa: PLC0415 - slow, and seldom needed

    return Fraction(number)


def parse_ns(text: str) -> int:
    """Return the nanoseconds of a time such as 100us, 10ms or 1s, exactly; or raise ValueError."""
    found = _DURATION.fullmatch(text)
    if found is None:
        raise ValueError(f"cannot read the time {text!r}; write 100us, 10ms, 1s")
    unit_ns = round(_SECONDS[found["unit"]] * 1_000_000_000)
    ns = _exact(found["number"]) * unit_ns
    if ns.denominator != 1:
        raise ValueError(f"the time {text} is no whole number of nanoseconds; give fewer digits")
    if ns > LONGEST_S * 1_000_000_000:
        raise ValueError(f"the time {text} is too long; give {_DAYS_MOST}d or less")
    return int(ns)


def parse_bytes(text: str) -> int:
    """Return the bytes of a size such as 500k, 100M or 1.5Gi; or raise ValueError."""
    found = _BYTE_COUNT.fullmatch(text)
    if found is None:
        raise ValueError(f"cannot read the size {text!r}; write 500k, 100M or 1G")
    return int(_exact(found["number"]) * _UNITS[found["unit"]])
