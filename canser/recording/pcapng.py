"""The blocks of a pcapng file, built and read; what they mean to canser is not known here.

    type u32 | total length u32 | body, padded to 4 | total length u32

A body may end in options, each `code u16 | length u16 | value, padded to 4`, the last of
code 0. All numbers are in the byte order that the section header tells.

Source: draft-ietf-opsawg-pcapng, "PCAP Next Generation (pcapng) Capture File Format".
"""

import struct
from collections.abc import Iterable
from typing import Final, Literal, NamedTuple

__all__ = [
    "ENHANCED",
    "INTERFACE",
    "LENGTH_MAX",
    "LENGTH_MIN",
    "MAGIC",
    "SECTION",
    "SECTION_MARK",
    "STATISTICS",
    "UNKNOWN",
    "Enhanced",
    "Order",
    "block",
    "enhanced_head",
    "enhanced_tail",
    "is_pcapng",
    "options",
    "section_order",
    "u16",
    "u32",
]

# struct's signs of the byte order of a section.
Order = Literal["<", ">"]

# Block types. The first reads the same in both byte orders.
SECTION: Final = 0x0A0D0D0A
INTERFACE: Final = 1
STATISTICS: Final = 5
ENHANCED: Final = 6

MAGIC: Final = 0x1A2B3C4D
SECTION_MARK: Final = struct.pack("<I", SECTION)
_MAGICS: Final[dict[bytes, Order]] = {
    struct.pack("<I", MAGIC): "<",
    struct.pack(">I", MAGIC): ">",
}

# A block without a body; and the most that readers put up with, as Wireshark's do.
LENGTH_MIN: Final = 12
LENGTH_MAX: Final = 1 << 24

# Options of an enhanced packet block.
_HASH, _DROPCOUNT = 3, 4
_CRC32: Final = 2  # the hash's algorithm, its first byte

# The drop count of a gap of unknown length.
UNKNOWN: Final = (1 << 64) - 1

# Type, length, interface, time high and low, captured and original length.
_ENHANCED_HEAD: Final = {order: struct.Struct(f"{order}7I") for order in ("<", ">")}
_OPTION: Final = {order: struct.Struct(f"{order}HH") for order in ("<", ">")}
_U16: Final = {order: struct.Struct(f"{order}H") for order in ("<", ">")}
_U32: Final = {order: struct.Struct(f"{order}I") for order in ("<", ">")}
_U64: Final = {order: struct.Struct(f"{order}Q") for order in ("<", ">")}

# Padding not counted: the hash (code, length, algorithm, CRC32), the drop count, the end
# of the options, the total length.
_ENHANCED_TAIL: Final = struct.Struct("<HHBI3xHHQHHI")


def is_pcapng(head: bytes) -> bool:
    """Return whether bytes, 12 are enough, start a section of pcapng."""
    return head[:4] == SECTION_MARK and bytes(head[8:12]) in _MAGICS


def section_order(head: bytes | memoryview) -> Order | None:
    """Return the byte order of a section by its first 12 bytes, None if it is none."""
    return _MAGICS.get(bytes(head[8:12])) if head[:4] == SECTION_MARK else None


def u16(data: memoryview, at: int, order: Order) -> int:
    """Return the number there."""
    return _U16[order].unpack_from(data, at)[0]  # type: ignore[no-any-return]


def u32(data: memoryview, at: int, order: Order) -> int:
    """Return the number there."""
    return _U32[order].unpack_from(data, at)[0]  # type: ignore[no-any-return]


def block(kind: int, fixed: bytes, options: Iterable[tuple[int, bytes]]) -> bytes:
    """Return a block: its fixed fields, a multiple of 4 bytes, and its options."""
    parts = [fixed]
    for code, value in options:
        parts += [struct.pack("<HH", code, len(value)), value, bytes(-len(value) % 4)]
    parts.append(struct.pack("<HH", 0, 0))
    body = b"".join(parts)
    length = struct.pack("<I", len(body) + LENGTH_MIN)
    return struct.pack("<I", kind) + length + body + length


def enhanced_head(data_len: int, ts: int) -> bytes:
    """Return what stands before the data of a packet of interface 0."""
    length = _ENHANCED_HEAD["<"].size + data_len + -data_len % 4 + _ENHANCED_TAIL.size
    return _ENHANCED_HEAD["<"].pack(
        ENHANCED, length, 0, ts >> 32, ts & 0xFFFF_FFFF, data_len, data_len
    )


def enhanced_tail(data_len: int, crc32: int, dropped: int) -> bytes:
    """Return what stands behind the data of a packet."""
    pad = -data_len % 4
    length = _ENHANCED_HEAD["<"].size + data_len + pad + _ENHANCED_TAIL.size
    return bytes(pad) + _ENHANCED_TAIL.pack(
        *(_HASH, 5, _CRC32, crc32), *(_DROPCOUNT, 8, dropped), *(0, 0), length
    )


class Enhanced(NamedTuple):
    """An enhanced packet block, read."""

    interface: int
    ts: int
    data: memoryview
    crc32: int | None
    dropped: int | None
    dropped_at: int  # where the drop count stands in the block

    @classmethod
    def read(cls, whole: memoryview, order: Order) -> "Enhanced | None":
        """Read a block whose lengths agree; None if what is inside does not fit."""
        end = len(whole) - 4
        if end < _ENHANCED_HEAD[order].size:
            return None
        _, _, interface, high, low, data_len, _ = _ENHANCED_HEAD[order].unpack_from(whole)
        begin = _ENHANCED_HEAD[order].size
        at = begin + data_len + -data_len % 4
        if at > end:
            return None
        crc32 = dropped = None
        dropped_at = 0
        for code, value_at, length in options(whole, at, order):
            if code == _HASH and length == 5 and whole[value_at] == _CRC32:
                # In the byte order of the section: the standard is silent.
                (crc32,) = _U32[order].unpack_from(whole, value_at + 1)
            elif code == _DROPCOUNT and length == 8:
                (dropped,) = _U64[order].unpack_from(whole, value_at)
                dropped_at = value_at
        data = whole[begin : begin + data_len]
        return cls(interface, high << 32 | low, data, crc32, dropped, dropped_at)


def options(whole: memoryview, at: int, order: Order) -> list[tuple[int, int, int]]:
    """Return the options of a block from `at` on: code, where the value is, its length.

    They end with the code 0 or with the block; one that does not fit ends them, too.
    """
    found = []
    unpack, end = _OPTION[order].unpack_from, len(whole) - 4
    while at + 4 <= end:
        code, length = unpack(whole, at)
        at += 4
        if code == 0 or at + length > end:
            break
        found.append((code, at, length))
        at += length + -length % 4
    return found
