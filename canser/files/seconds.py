"""Times in text, read exactly."""

import re
from typing import Final

from canser._frames import NO_TIME

__all__ = ["parse_seconds"]

_SECOND: Final = 1_000_000_000

# Blanks of ASCII. Without them, strip() would take the blanks of all scripts.
_BLANKS: Final = " \t\r\n\v\f"

_SECONDS: Final = re.compile(
    r"[ \t]*(?P<sign>[+-]?)(?P<whole>[0-9]+)(?:\.(?P<places>[0-9]*))?[ \t]*"
)
_ROUNDED: Final = re.compile(r"[ \t]*[+-]?(?:[0-9]+(?:\.[0-9]*)?[eE][+-]?[0-9]+|inf)[ \t]*")

# Digits of whole seconds in the largest time: 2**63 ns are 9,223,372,036 s.
_WHOLE_DIGITS: Final = 10


def parse_seconds(text: str) -> int:
    """Return the nanoseconds of a text in seconds, exactly; NO_TIME for nan and an empty text.

    Digits behind the ninth decimal place are cut. A number with an exponent, such as 1e9, is read
    as floating point. ValueError for a text that is no number, or is out of range.
    """
    found = _SECONDS.fullmatch(text)
    if found:
        sign, whole, places = found.groups(default="")
        if len(whole) > _WHOLE_DIGITS and len(whole.lstrip("0")) > _WHOLE_DIGITS:
            ts = 2**63
        else:
            # Seconds and fraction as one number: its last nine digits are the fraction.
            ts = int(whole[-_WHOLE_DIGITS:] + places[:9].ljust(9, "0"))
        ts = -ts if sign == "-" else ts
    elif text.strip(_BLANKS).lower() in ("", "nan", "nat"):
        return NO_TIME
    elif _ROUNDED.fullmatch(text):
        try:
            ts = round(float(text) * _SECOND)
        except OverflowError:  # inf
            ts = 2**63
    else:
        raise ValueError(f"{text.strip()[:60]!r} is no time in seconds")
    if not -(2**63) < ts < 2**63:
        raise ValueError(f"the time {text.strip()[:60]} does not fit 64 bits of nanoseconds")
    return ts
