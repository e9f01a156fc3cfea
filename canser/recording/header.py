"""Recordings: the raw bytes of a serial line with their times, append-only, in pcapng files.

A recording has one interface, and an enhanced packet block for each chunk of bytes:

- time: the arrival of the chunk's last byte; the bytes before it came at the line's baud rate;
- drop count: the bytes that are lost right before the chunk;
- hash: the CRC32 of the bytes;
- packet id: the place of the chunk in the stream (see `canser.recording.ids`);
- comments: notes.

A chunk without bytes carries lost bytes at the end of a stream, or a note.

If a file is cut off, its blocks before the cut are valid. Damaged parts are left out and
reported. The hash of pcapng covers the bytes only: a flipped bit in a time, in a drop count or in
the interface's description is found only if the value becomes impossible.

Format: draft-ietf-opsawg-pcapng. This module writes and reads the blocks that start a recording.
They describe the line.
"""

import re
import struct
import zlib
from dataclasses import dataclass
from typing import Final

from canser._input import Input
from canser.recording import pcapng
from canser.recording.pcapng import Order

__all__ = [
    "MARK_MAX",
    "RecordingInfo",
    "interface_mark",
    "is_recording",
    "make_header",
    "read_interface",
    "starts_recording",
]

# LINKTYPE_USER0, for private use: no program takes the bytes for network packets.
_LINK_TYPE: Final = 147

# Codes of options, from the pcapng draft: of the section header, and of the interface.
_OS: Final = 3
_NAME, _DESCRIPTION, _SPEED, _RESOLUTION = 2, 3, 8, 9

_NANOSECONDS: Final = b"\x09"  # the resolution of times: 10 to the power of -9 seconds

# The first word of an interface's description; words `name=value` follow.
_SIGN: Final = "canser:"

_INTERFACE_OPTIONS: Final = 16  # offset of the options in an interface block, in bytes
_INTERFACE_MIN: Final = 20  # the shortest interface block, in bytes: one without options

_ABOUT: Final = (
    "The raw bytes of a serial line, not packets. The time of a block is when its last byte "
    "came; drop counts are the bytes lost right before a block; counts of the interface are bytes."
)


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """The serial line that a recording is of; given by `Blocks.recording` and `info`."""

    #: Name of the protocol, as in `protocols()`.
    protocol: str
    #: Rate of the serial line, in baud.
    baudrate: int
    #: Rate of the CAN bus, in bit/s; None if not known.
    bitrate: int | None
    #: Unit of the device's timestamps: "s", "ms", "us" or "ns".
    ts_unit: str
    #: Name of the device or port that the bytes came from.
    device: str

    @property
    def byte_ns(self) -> float:
        """Duration of a byte on the line, in nanoseconds: start bit, 8 data bits, stop bit."""
        return 10e9 / self.baudrate


def is_recording(head: bytes) -> bool:
    """Return whether a file starts with a pcapng section, as recordings do; 12 bytes are enough."""
    return pcapng.is_pcapng(head)


def starts_recording(source: Input) -> bool:
    """Return whether a file starts as a recording does: its first interface is one of canser's.

    So may do a file that is damaged before its first interface. Waits for as few bytes of a pipe
    as the answer needs.
    """
    likely = all(source.at(0, length) == pcapng.SECTION_MARK[:length] for length in (1, 4))
    return likely and is_recording(bytes(source.at(0, 12))) and not _is_of_others(source)


def _is_of_others(source: Input) -> bool:
    """Return whether the first interface of a pcapng file is plainly none of canser's."""
    at = 0
    order: Order | None = None
    while at < pcapng.LENGTH_MAX:
        head = source.at(0, at + pcapng.LENGTH_MIN)[at:]
        if head[:4] == pcapng.SECTION_MARK:
            order = pcapng.section_order(head)
        if len(head) < pcapng.LENGTH_MIN or order is None:
            return False
        kind, length = pcapng.u32(head, 0, order), pcapng.u32(head, 4, order)
        fits = pcapng.LENGTH_MIN <= length <= pcapng.LENGTH_MAX and length % 4 == 0
        if not fits or kind == pcapng.ENHANCED:
            return False
        if kind == pcapng.INTERFACE:
            whole = source.at(0, at + length)[at:]
            is_whole = _INTERFACE_MIN <= length == len(whole) and whole[-4:] == whole[4:8]
            sign = _SIGN.encode() in bytes(whole)
            return is_whole and pcapng.u16(whole, 8, order) != _LINK_TYPE and not sign
        at += length
    return False


def make_header(info: RecordingInfo, base: int) -> bytes:
    """Return the blocks that start a recording. `base`: the base of the packet ids."""
    # Imported here: they take 20 ms to import, and readers need neither.
    import platform  # noqa: PLC0415
    from importlib.metadata import version  # noqa: PLC0415

    section = pcapng.block(
        pcapng.SECTION,
        # Version 1.0. The length of the section is not known yet: -1.
        struct.pack("<IHHq", pcapng.MAGIC, 1, 0, -1),
        [
            (pcapng.COMMENT, _ABOUT.encode()),
            (_OS, f"{platform.system()} {platform.release()}".encode()),
            (pcapng.APPLICATION, f"canser {version('canser')}".encode()),
        ],
    )
    facts = {
        "protocol": info.protocol,
        "baudrate": info.baudrate,
        "bitrate": info.bitrate,
        "ts_unit": info.ts_unit,
        "base": _base_word(base),
    }
    words = [f"{name}={value}" for name, value in facts.items() if value is not None]
    interface = pcapng.block(
        pcapng.INTERFACE,
        struct.pack("<HHI", _LINK_TYPE, 0, 0),  # snap length 0: packets are never cut short
        [
            (_NAME, info.device.encode("utf-8", "surrogateescape")),
            (_DESCRIPTION, " ".join([_SIGN, *words]).encode()),
            (_SPEED, struct.pack("<Q", info.baudrate)),
            (_RESOLUTION, _NANOSECONDS),
        ],
    )
    return section + interface


# The longest pattern that a search for blocks uses, in bytes: that of `interface_mark`.
MARK_MAX: Final = 10


def interface_mark(order: Order) -> bytes:
    """Return a regular expression for the start of an interface: type, any length, link type."""
    kind, link = struct.pack(f"{order}I", pcapng.INTERFACE), struct.pack(f"{order}H", _LINK_TYPE)
    return re.escape(kind) + b"...." + re.escape(link)


def _base_word(base: int) -> str:
    """Return a base as text, with the CRC32 of its digits, because all ids depend on the base."""
    digits = f"{base:016x}"
    return f"{digits}{zlib.crc32(digits.encode()):08x}"


def read_interface(whole: memoryview, order: Order) -> tuple[RecordingInfo, int | None] | None:
    """Return the line that an interface block describes, and the base of the packet ids.

    None if canser did not write the block. The base is None if the blocks have no ids, or if it
    is damaged.
    """
    if len(whole) < _INTERFACE_MIN or pcapng.u16(whole, 8, order) != _LINK_TYPE:
        return None
    values = {
        code: bytes(whole[at : at + length])
        for code, at, length in pcapng.options(whole, _INTERFACE_OPTIONS, order)
    }
    sign, *words = values.get(_DESCRIPTION, b"").decode("utf-8", "replace").split(" ")
    facts = dict(word.split("=", 1) for word in words if "=" in word)
    bitrate = facts.get("bitrate", "1")
    numbers = (facts.get("baudrate", ""), bitrate)
    if (
        sign != _SIGN
        or not {"protocol", "ts_unit"} <= facts.keys()
        or not all(re.fullmatch("[1-9][0-9]{0,17}", number) for number in numbers)
        or values.get(_RESOLUTION) != _NANOSECONDS
    ):
        return None
    info = RecordingInfo(
        protocol=facts["protocol"],
        baudrate=int(facts["baudrate"]),
        bitrate=int(bitrate) if "bitrate" in facts else None,
        ts_unit=facts["ts_unit"],
        device=values.get(_NAME, b"").decode("utf-8", "surrogateescape"),
    )
    word = facts.get("base", "")
    whole_base = re.fullmatch("[0-9a-f]{24}", word) and word == _base_word(int(word[:16], 16))
    return info, int(word[:16], 16) if whole_base else None
