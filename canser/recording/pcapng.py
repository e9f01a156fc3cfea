"""Build and read the blocks of a pcapng file; their meaning for recordings is not known here.

    type u32 | total length u32 | body, padded to 4 bytes | total length u32

A body may end in options, each `code u16 | length u16 | value, padded to 4 bytes`; the last has
the code 0. All numbers are in the byte order of the section, which its header shows.

Source: draft-ietf-opsawg-pcapng, "PCAP Next Generation (pcapng) Capture File Format".
"""

import struct
from collections.abc import Iterable
from typing import Final, Literal, NamedTuple

__all__ = [
    "APPLICATION",
    "COMMENT",
    "ENHANCED",
    "ENHANCED_HEAD_LEN",
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
    "enhanced",
    "is_pcapng",
    "options",
    "section_order",
    "u16",
    "u32",
    "with_dropcount",
]

# The byte order of a section, as the first character of struct's formats.
Order = Literal["<", ">"]

# Block types. That of a section reads the same in both byte orders.
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

# The length of a block without a body, and the longest block that is read, in bytes. Wireshark has
# the same limit.
LENGTH_MIN: Final = 12
LENGTH_MAX: Final = 1 << 24

# Codes of options: of any block, of a section, and of an enhanced packet block.
COMMENT: Final = 1
APPLICATION: Final = 4
_HASH, _DROPCOUNT, _PACKET_ID = 3, 4, 5
_CRC32: Final = 2  # the algorithm of a hash, in its first byte

# The drop count for a gap of unknown length. This is canser's own rule.
UNKNOWN: Final = (1 << 64) - 1

# Fields: type, length, interface, time (high, low), captured length, original length.
_ENHANCED_HEAD: Final = {order: struct.Struct(f"{order}7I") for order in ("<", ">")}
_OPTION: Final = {order: struct.Struct(f"{order}HH") for order in ("<", ">")}
_U16: Final = {order: struct.Struct(f"{order}H") for order in ("<", ">")}
_U32: Final = {order: struct.Struct(f"{order}I") for order in ("<", ">")}
_U64: Final = {order: struct.Struct(f"{order}Q") for order in ("<", ">")}

# Fields of options: code, length, algorithm, CRC32, padding; and code, length, number.
_HASH_OPTION: Final = struct.Struct("<HHBI3x")
_NUMBER_OPTION: Final = struct.Struct("<HHQ")

#: Bytes before the data of an enhanced packet block.
ENHANCED_HEAD_LEN: Final = 28


def is_pcapng(head: bytes) -> bool:
    """Return whether bytes start a section of pcapng; 12 bytes are enough."""
    return head[:4] == SECTION_MARK and bytes(head[8:12]) in _MAGICS


def section_order(head: bytes | memoryview) -> Order | None:
    """Return the byte order of a section from its first 12 bytes, None if there is no section."""
    return _MAGICS.get(bytes(head[8:12])) if head[:4] == SECTION_MARK else None


def u16(data: memoryview, at: int, order: Order) -> int:
    """Return the number of 16 bits at an offset."""
    return _U16[order].unpack_from(data, at)[0]  # type: ignore[no-any-return]


def u32(data: memoryview, at: int, order: Order) -> int:
    """Return the number of 32 bits at an offset."""
    return _U32[order].unpack_from(data, at)[0]  # type: ignore[no-any-return]


def _options(options: Iterable[tuple[int, bytes]], order: Order = "<") -> bytes:
    """Return options, with the one that ends them."""
    parts = []
    for code, value in options:
        parts += [_OPTION[order].pack(code, len(value)), value, bytes(-len(value) % 4)]
    return b"".join([*parts, _OPTION[order].pack(0, 0)])


def block(kind: int, fixed: bytes, options: Iterable[tuple[int, bytes]]) -> bytes:
    """Return a block of fixed fields, a multiple of 4 bytes, and options."""
    body = fixed + _options(options)
    length = struct.pack("<I", len(body) + LENGTH_MIN)
    return struct.pack("<I", kind) + length + body + length


def enhanced(
    data_len: int,
    ts: int,
    *,
    crc32: int,
    dropped: int,
    packet_id: int,
    comments: Iterable[bytes],
) -> tuple[bytes, bytes]:
    """Return what stands before and behind the data of a packet of interface 0.

    A drop count of 0 is not written.
    """
    tail = bytes(-data_len % 4) + _HASH_OPTION.pack(_HASH, 5, _CRC32, crc32)
    if dropped:
        tail += _NUMBER_OPTION.pack(_DROPCOUNT, 8, dropped)
    tail += _NUMBER_OPTION.pack(_PACKET_ID, 8, packet_id)
    tail += _options((COMMENT, comment) for comment in comments)
    length = ENHANCED_HEAD_LEN + data_len + len(tail) + 4
    head = _ENHANCED_HEAD["<"].pack(
        ENHANCED, length, 0, ts >> 32, ts & 0xFFFF_FFFF, data_len, data_len
    )
    return head, tail + struct.pack("<I", length)


def with_dropcount(whole: memoryview, order: Order, dropped: int) -> bytes:
    """Return an enhanced packet block with another drop count."""
    data_len = u32(whole, 20, order)
    begin = ENHANCED_HEAD_LEN + data_len + -data_len % 4
    kept = [
        (code, bytes(whole[at : at + length]))
        for code, at, length in options(whole, begin, order)
        if code != _DROPCOUNT
    ]
    written = _options([*kept, (_DROPCOUNT, _U64[order].pack(dropped))], order)
    length = _U32[order].pack(begin + len(written) + 4)
    return bytes(whole[:4]) + length + bytes(whole[8:begin]) + written + length


class Enhanced(NamedTuple):
    """The content of an enhanced packet block."""

    interface: int
    ts: int
    data: memoryview
    crc32: int | None
    dropped: int | None
    packet_id: int | None
    comments: list[bytes]

    @classmethod
    def read(cls, whole: memoryview, order: Order) -> "Enhanced | None":
        """Read a block whose two lengths agree; None if its content does not fit into it."""
        end = len(whole) - 4
        if end < ENHANCED_HEAD_LEN:
            return None
        _, _, interface, high, low, data_len, _ = _ENHANCED_HEAD[order].unpack_from(whole)
        begin = ENHANCED_HEAD_LEN
        at = begin + data_len + -data_len % 4
        if at > end:
            return None
        crc32 = dropped = packet_id = None
        comments = []
        for code, value_at, length in options(whole, at, order):
            if code == _HASH and length == 5 and whole[value_at] == _CRC32:
                # The pcapng draft does not say the byte order of the CRC32. canser uses that of
                # the section.
                (crc32,) = _U32[order].unpack_from(whole, value_at + 1)
            elif code == _DROPCOUNT and length == 8:
                (dropped,) = _U64[order].unpack_from(whole, value_at)
            elif code == _PACKET_ID and length == 8:
                (packet_id,) = _U64[order].unpack_from(whole, value_at)
            elif code == COMMENT:
                comments.append(bytes(whole[value_at : value_at + length]))
        data, ts = whole[begin : begin + data_len], high << 32 | low
        return cls(interface, ts, data, crc32, dropped, packet_id, comments)


def options(whole: memoryview, at: int, order: Order) -> list[tuple[int, int, int]]:
    """Return the options of a block from `at` on: code, offset and length of the value.

    The code 0 and the end of the block end the options. So does an option that does not fit.
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
