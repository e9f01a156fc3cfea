"""Values of signals as people read them: a number with its unit, or the text that stands for it."""

import math
from collections.abc import Mapping
from decimal import Decimal
from functools import lru_cache
from typing import Any, Final

from canser.files.tags import printable
from canser.signals.messages import SignalInfo

__all__ = ["choice_text", "number_text", "value_text"]

# Digits of floating-point numbers by their bits: fewer than they have, so that 0.1 is 0.1.
_FLOAT_DIGITS: Final = {16: 3, 32: 7, 64: 15}

# Decimal places beyond the step of a signal, such as 0.0157; and places that are always shown if
# the step has them.
_PLACES_MORE: Final = 2
_PLACES_LEAST: Final = 3

# From here on numbers have an exponent.
_LARGE: Final = 1e15


def number_text(value: float, info: SignalInfo) -> str:
    """Return a number without digits that say nothing: `2000` for 2000.0."""
    if isinstance(value, int):
        return str(value)
    if info.is_float or not abs(value) < _LARGE:
        return f"{value:.{_FLOAT_DIGITS[info.bit_count] if info.is_float else 15}g}"
    text = f"{value:.{_places(info.scale, info.offset)}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


@lru_cache(maxsize=1 << 12)
def _places(scale: float, offset: float) -> int:
    """Return the decimal places of raw * scale + offset: all, unless the step has many."""
    exact = max(-int(Decimal(repr(float(each))).as_tuple().exponent) for each in (scale, offset))
    step = math.ceil(-math.log10(abs(scale))) if scale else 0
    return max(min(exact, max(step + _PLACES_MORE, _PLACES_LEAST)), 0)


def value_text(value: float, raw: Any, info: SignalInfo) -> str:
    """Return the text of a raw value, or the number with its unit."""
    found = choice_text(info.choices, raw)
    if found is not None:
        return printable(found)
    number = number_text(value, info)
    return f"{number} {printable(info.unit)}" if info.unit else number


def choice_text(choices: Mapping[int, str] | None, raw: Any) -> str | None:
    """Return the text of a raw value, or None."""
    return choices.get(raw) if choices and raw is not None else None
