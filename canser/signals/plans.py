"""How the bits of a signal become a column: its type, and its record for C."""

from typing import Any, Final, NamedTuple

import numpy as np

from canser._core.signals import FLOATS, SCALED, WHOLE
from canser.signals.messages import SignalInfo

__all__ = ["Field", "Plan", "Record", "field_of", "plan_of"]

_INT64: Final = range(-(2**63), 2**63)
_UINT64: Final = range(2**64)

# The fields of canser_field, and of canser_signal in their order.
Field = tuple[bool, int, int, bool]
Record = tuple[float, float, int, int, int, Field, int, bool]


class Plan(NamedTuple):
    """How a signal is decoded.

    It has one or two columns: for the values, and for the raw numbers if they are kept apart.
    `raw_at` is the place of the raw numbers among them, or None. `first` is the number of its first
    record among those of all signals.
    """

    info: SignalInfo
    least_dlc: int
    dtypes: tuple[np.dtype[Any], ...]
    records: tuple[Record, ...]
    raw_at: int | None
    first: int


def field_of(signal: SignalInfo) -> Field:
    """Return where the bits of a signal lie."""
    shift = 64 - signal.last_bit if signal.is_big_endian else signal.start
    return signal.is_big_endian, shift, signal.bit_count, signal.is_signed


def plan_of(signal: SignalInfo, first: int, *, keeps_raw: bool) -> Plan:
    """Return how a signal is decoded, with its raw numbers if it has texts, or `keeps_raw`."""
    dtype: np.dtype[Any] = np.dtype(np.float64)
    raw_dtype = dtype
    if signal.is_float:
        kind = raw_kind = FLOATS[signal.bit_count]
    else:
        low, high = _raw_range(signal)
        raw_dtype = np.dtype(np.int64 if high in _INT64 else np.uint64)
        raw_kind = WHOLE
        kind, dtype = _column(signal, low, high)
    values = _record(signal, kind, is_raw=False)
    plan = Plan(signal, -(-signal.last_bit // 8), (dtype,), (values,), None, first)
    if not keeps_raw and not signal.choices:
        return plan
    if signal.scale == 1 and signal.offset == 0:
        return plan._replace(raw_at=0)
    raw = _record(signal, raw_kind, is_raw=True)
    return plan._replace(dtypes=(dtype, raw_dtype), records=(values, raw), raw_at=1)


def _record(signal: SignalInfo, kind: int, *, is_raw: bool) -> Record:
    scale, offset = (int(signal.scale), int(signal.offset)) if kind == WHOLE else (1, 0)
    return (
        float(signal.scale),
        float(signal.offset),
        1 if is_raw else _wrapped(scale),
        0 if is_raw else _wrapped(offset),
        0,
        field_of(signal),
        kind,
        is_raw,
    )


def _wrapped(number: int) -> int:
    """Return a number of 64 bits as a signed one."""
    return (number + 2**63) % 2**64 - 2**63


def _raw_range(signal: SignalInfo) -> tuple[int, int]:
    if signal.is_signed:
        return -(2 ** (signal.bit_count - 1)), 2 ** (signal.bit_count - 1) - 1
    return 0, 2**signal.bit_count - 1


def _column(signal: SignalInfo, low: int, high: int) -> tuple[int, np.dtype[Any]]:
    """Return the kind of a signal of whole bits, and the type of its column."""
    if float(signal.scale).is_integer() and float(signal.offset).is_integer():
        ends = [raw * int(signal.scale) + int(signal.offset) for raw in (low, high)]
        for numbers, dtype in ((_INT64, np.int64), (_UINT64, np.uint64)):
            if all(end in numbers for end in ends):
                return WHOLE, np.dtype(dtype)
    return SCALED, np.dtype(np.float64)
