"""Signals of payloads, bit by bit: by the rules of DBC files, from a database of cantools.

Of cantools only what it read of the file is used: where the bits of a signal are, what they
mean, and which multiplexer values select it. `short` and `unknown_page` tell of a frame what
`DecodeReport` counts.
"""

import struct
from dataclasses import dataclass, field
from typing import Any

Number = int | float

INT64, UINT64 = range(-(2**63), 2**63), range(2**64)

_FLOATS = {16: ">e", 32: ">f", 64: ">d"}


@dataclass
class Found:
    """What a frame has."""

    message: str
    values: dict[str, Number] = field(default_factory=dict)
    raw: dict[str, Number] = field(default_factory=dict)
    short: bool = False
    unknown_page: bool = False


def bits_of(signal: Any) -> list[int]:
    """Return the bits of a signal, the highest first: 8 times the byte, and 0 to 7 in it."""
    if signal.byte_order == "little_endian":
        return list(reversed(range(signal.start, signal.start + signal.length)))
    bits, bit = [], signal.start
    for _ in range(signal.length):
        bits.append(bit)
        bit = bit - 1 if bit % 8 else bit + 15
    return bits


def raw_of(signal: Any, data: bytes) -> Number | None:
    """Return the value before scale and offset, or None if a bit is past the data."""
    number = 0
    for bit in bits_of(signal):
        if bit // 8 >= len(data):
            return None
        number = number << 1 | data[bit // 8] >> bit % 8 & 1
    if signal.conversion.is_float:
        whole = number.to_bytes(signal.length // 8, "big")
        return float(struct.unpack(_FLOATS[signal.length], whole)[0])
    if signal.is_signed and number >> signal.length - 1:
        number -= 1 << signal.length
    return number


def is_whole(signal: Any) -> bool:
    """Return whether all values are whole numbers that fit into 64 bits."""
    scale, offset = signal.conversion.scale, signal.conversion.offset
    if signal.conversion.is_float or scale != int(scale) or offset != int(offset):
        return False
    count = 1 << signal.length
    raws = (-count // 2, count // 2 - 1) if signal.is_signed else (0, count - 1)
    ends = [raw * int(scale) + int(offset) for raw in raws]
    return all(end in INT64 for end in ends) or all(end in UINT64 for end in ends)


def value_of(signal: Any, raw: Number) -> Number:
    """Return the physical value: whole numbers stay so where they fit, others are float64."""
    scale, offset = signal.conversion.scale, signal.conversion.offset
    if is_whole(signal):
        return int(raw) * int(scale) + int(offset)
    if scale == 1 and offset == 0:
        return float(raw)  # and -0.0 stays so
    return float(raw) * float(scale) + float(offset)


def pgn_of(arbitration_id: int) -> int:
    """Return the parameter group: the destination of PDU1 is no part of it."""
    pgn = arbitration_id >> 8 & 0x3FFFF
    return pgn & 0x3FF00 if arbitration_id >> 16 & 0xFF < 240 else pgn


def is_j1939(message: Any) -> bool:
    """Return whether other sources than that of the database are meant too."""
    from_any = message.frame_id & 0xFF == 0xFE
    return bool(message.is_extended_frame and (message.protocol == "j1939" or from_any))


def find_message(database: Any, arbitration_id: int, ext: bool, match: str = "auto") -> Any:
    """Return the message of a frame, or None."""
    messages = [message for message in database.messages if message.length <= 8]
    for message in messages:
        by_pgn = match == "pgn" and message.is_extended_frame
        if not by_pgn and (message.frame_id, message.is_extended_frame) == (arbitration_id, ext):
            return message
    if ext and match != "id":
        for message in messages:
            wanted = message.is_extended_frame if match == "pgn" else is_j1939(message)
            if wanted and pgn_of(message.frame_id) == pgn_of(arbitration_id):
                return message
    return None


def known_pages(message: Any, multiplexer: Any) -> set[int]:
    """Return the values of a multiplexer that select a signal, or have a name."""
    pages = set(multiplexer.conversion.choices or ())
    for signal in message.signals:
        if signal.multiplexer_signal == multiplexer.name:
            pages.update(signal.multiplexer_ids or ())
    return pages


def decode_signals(message: Any, data: bytes) -> Found:
    """Return what the data of a frame say, `dlc` bytes of them."""
    found = Found(message.name)

    def descend(parent: str | None, page: int | None) -> None:
        for signal in message.signals:
            if signal.multiplexer_signal != parent:
                continue
            if parent is not None and page not in (signal.multiplexer_ids or ()):
                continue
            raw = raw_of(signal, data)
            if raw is None:
                found.short = True
                continue
            found.raw[signal.name], found.values[signal.name] = raw, value_of(signal, raw)
            if signal.is_multiplexer:
                pages = known_pages(message, signal)
                found.unknown_page |= bool(pages) and raw not in pages
                descend(signal.name, int(raw))

    descend(None, None)
    return found


def decode_plainly(
    database: Any, arbitration_id: int, ext: bool, data: bytes, match: str = "auto"
) -> Found | None:
    """Return what a data frame says, or None if no message has its id."""
    message = find_message(database, arbitration_id, ext, match)
    return None if message is None else decode_signals(message, data)
