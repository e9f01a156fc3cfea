"""Values of signals to the data of a frame."""

import math
import struct
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from canser.signals.messages import Message, SignalInfo

__all__ = ["encode_message"]

_FLOATS: Final = {16: ">e", 32: ">f", 64: ">d"}


def encode_message(message: Message, values: Mapping[str, float | str], frame: Any) -> None:
    """Set a frame, which is all zero, to a message with these values; ValueError if it cannot."""
    for name in values:
        if name not in message.signals:
            have = ", ".join(message.signals)
            raise ValueError(f"message {message.name} has no signal {name!r}; it has: {have}")
    selected = _selected(message, values)
    idle = [name for name in values if name not in selected]
    if idle:
        raise ValueError(
            f"message {message.name}: {', '.join(idle)} is not selected by the value of its "
            "multiplexer; leave it out, or change the multiplexer"
        )
    number = 0  # the data, the first byte highest
    for signal in selected.values():
        number |= _placed(signal, _raw(message, signal, values[signal.name]))
    frame["id"], frame["ext"], frame["dlc"] = message.id, message.ext, message.length
    frame["data"] = np.frombuffer(number.to_bytes(8, "big"), np.uint8)


def _selected(message: Message, values: Mapping[str, float | str]) -> dict[str, SignalInfo]:
    """Return the signals that the message has with these values; ValueError if one is missing."""
    selected: dict[str, SignalInfo] = {}
    waiting = dict(message.signals)
    while waiting:
        chosen = {
            name: signal
            for name, signal in waiting.items()
            if _is_selected(signal, message, selected, values)
        }
        if not chosen:
            break
        missing = [name for name in chosen if name not in values]
        if missing:
            raise ValueError(f"message {message.name} needs a value of {', '.join(missing)}")
        selected |= chosen
        waiting = {name: signal for name, signal in waiting.items() if name not in chosen}
    return selected


def _is_selected(
    signal: SignalInfo,
    message: Message,
    selected: Mapping[str, SignalInfo],
    values: Mapping[str, float | str],
) -> bool:
    if not signal.pages or signal.multiplexer is None:
        return True
    mux = selected.get(signal.multiplexer)
    return mux is not None and _raw(message, mux, values[mux.name]) in signal.pages


def _raw(message: Message, signal: SignalInfo, value: float | str) -> Any:
    """Return the raw number of a value."""
    what = f"{message.name}.{signal.name}"
    if isinstance(value, str):
        for raw, text in (signal.choices or {}).items():
            if text == value:
                return raw
        have = ", ".join((signal.choices or {}).values()) or "none"
        raise ValueError(f"{what} has no text {value!r}; it has: {have}")
    if not signal.is_float and not math.isfinite(value):
        raise ValueError(f"{what} is {value}, which whole bits cannot hold")
    if signal.minimum is not None and value < signal.minimum:
        raise ValueError(f"{what} is {value}; the database tells a minimum of {signal.minimum}")
    if signal.maximum is not None and value > signal.maximum:
        raise ValueError(f"{what} is {value}; the database tells a maximum of {signal.maximum}")
    if signal.is_float:
        return (value - signal.offset) / signal.scale
    rest = value - signal.offset
    scaled: float = rest // signal.scale if rest % signal.scale == 0 else rest / signal.scale
    whole = round(scaled)
    low = -(1 << signal.bit_count - 1) if signal.is_signed else 0
    high = low + (1 << signal.bit_count) - 1
    if not low <= whole <= high:
        ends = sorted(each * signal.scale + signal.offset for each in (low, high))
        raise ValueError(
            f"{what} is {value}; its {signal.bit_count} bits hold {ends[0]} to {ends[1]}"
        )
    return whole


def _placed(signal: SignalInfo, raw: Any) -> int:
    """Return the bits of a signal in the 8 bytes of data, the first byte highest."""
    if signal.is_float:
        bits = int.from_bytes(struct.pack(_FLOATS[signal.bit_count], raw), "big")
    else:
        bits = raw & (1 << signal.bit_count) - 1
    if signal.is_big_endian:
        return bits << 64 - signal.last_bit
    return int.from_bytes((bits << signal.start).to_bytes(8, "little"), "big")
