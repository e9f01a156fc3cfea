"""Values of signals as people read them: a number with its unit, or the text that stands for it."""

from collections.abc import Mapping
from typing import Any, Final

from canser.signals.messages import SignalInfo

__all__ = ["number_text", "value_text"]

# Digits that are shown of floating-point numbers by their bits, and of scaled whole numbers: all
# that the values have, without what rounding to 53 bits adds, as in 0.30000000000000004.
_FLOAT_DIGITS: Final = {16: 4, 32: 7, 64: 15}
_SCALED_DIGITS: Final = 12


def number_text(value: float, info: SignalInfo) -> str:
    """Return a number without digits that say nothing: `2000` for 2000.0."""
    if isinstance(value, int):
        return str(value)
    return f"{value:.{_FLOAT_DIGITS.get(info.bit_count, 12) if info.is_float else _SCALED_DIGITS}g}"


def value_text(value: float, raw: Any, info: SignalInfo) -> str:
    """Return the text of a raw value, or the number with its unit."""
    found = choice_text(info.choices, raw)
    if found is not None:
        return found
    return f"{number_text(value, info)} {info.unit}".rstrip()


def choice_text(choices: Mapping[int, str] | None, raw: Any) -> str | None:
    """Return the text of a raw value, or None."""
    return choices.get(raw) if choices and raw is not None else None
