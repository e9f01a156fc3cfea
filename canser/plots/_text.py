"""Numbers as texts of a picture: short, with their units, and without exponents."""

import re
import textwrap
from typing import Final

import numpy as np

__all__ = ["count_text", "duration_text", "joined", "percent", "plain", "wrapped"]

# Seconds. From here on the times at an axis are written as h:mm:ss.
LONG_S: Final = 7_200

# A number and its unit, which stay together.
_UNIT: Final = re.compile(r"(\d) (%|kbit|[mµn]?s\b|h\b)")

_UNITS: Final = ((1e9, "s"), (1e6, "ms"), (1e3, "µs"), (1, "ns"))


def plain(value: float, digits: int = 3, *, even: bool = False) -> str:
    """Return a number with `digits` significant ones, thousands separated, without an exponent.

    `even`: with zeros at the end, for a column of numbers.
    """
    if not np.isfinite(value):
        return "-"
    value = _rounded(value, digits)
    places = digits - 1 - int(np.floor(np.log10(abs(value)))) if value else 0
    text = f"{value:,.{max(places, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text and not even else text


def _rounded(value: float, digits: int) -> float:
    if not value:
        return 0.0
    return float(round(value, digits - 1 - int(np.floor(np.log10(abs(value))))))


def duration_text(ns: float, *, even: bool = False) -> str:
    """Return a length of time in ns to ms, in s up to ten minutes, then as h:mm:ss."""
    if not np.isfinite(ns):
        return "-"
    if ns >= 600e9:
        return f"{clock_text(ns / 1e9)} h"
    if not ns:
        return "0 ms"
    digits = 4 if ns >= 100e9 else 3
    size, unit = next(each for each in _UNITS if _rounded(ns, digits) >= each[0] or each[0] == 1)
    return f"{plain(ns / size, digits, even=even)} {unit}"


def clock_text(seconds: float) -> str:
    """Return seconds as h:mm:ss."""
    whole = round(abs(seconds))
    return f"{whole // 3600:,}:{whole // 60 % 60:02}:{whole % 60:02}"


def percent(share: float) -> str:
    """Return a share as percent."""
    return f"{100 * share:.1f} %"


def count_text(count: int, one: str, many: str = "") -> str:
    """Return a count with its noun."""
    return f"{count:,} {one if count == 1 else many or one + 's'}"


def wrapped(text: str, columns: int) -> str:
    """Return a text in lines of at most some columns."""
    kept = _UNIT.sub("\\1\u00a0\\2", text)
    return textwrap.fill(kept, max(columns, 20)).replace("\u00a0", " ")


def joined(*parts: str) -> str:
    """Return the parts that are not empty, with semicolons between them."""
    return "; ".join(part for part in parts if part)
