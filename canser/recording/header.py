"""Recordings: the raw bytes of a line with their times, append-only, in pcapng files.

One interface, one enhanced packet block for each chunk of bytes. Its time is when the last
byte of the chunk came; the earlier ones came one after the other at the line's rate. Its
drop count is the bytes lost right before the chunk; its hash is the CRC32 of the bytes; its id
is its place in the stream. A chunk without bytes has only lost bytes, or a note, to tell.

A file that ends anywhere is good up to its last whole block. What is damaged is left out,
and told. The standard's hash covers the bytes only: a flipped bit in a time, in a drop count
or in the interface's description is found where the value is impossible, and else is not.

Here are the blocks that start a recording, written and read: what it says of its line.
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

# LINKTYPE_USER0: for private use, so no program takes the bytes for network packets.
_LINK_TYPE: Final = 147

# Options of the blocks, as the standard numbers them.
_OS, _APPLICATION = 3, 4
_NAME, _DESCRIPTION, _SPEED, _RESOLUTION = 2, 3, 8, 9

_NANOSECONDS: Final = b"\x09"  # a resolution: 10 to the power of -9 seconds

# The first word of an interface's description; `name=value` follow.
_SIGN: Final = "canser:"

_INTERFACE_OPTIONS: Final = 16  # where they begin
_INTERFACE_MIN: Final = 20

_ABOUT: Final = (
    "The raw bytes of a serial line, not packets. The time of a block is when its last byte "
    "came; drop counts are the bytes lost right before a block; counts of the interface are bytes."
)


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """What a recording knows of its line."""

    protocol: str
    baudrate: int
    bitrate: int | None  # of the CAN bus; None if not known
    ts_unit: str  # of the device's timestamps
    device: str

    @property
    def byte_ns(self) -> float:
        """The time of a byte on the line: start bit, 8 bits, stop bit."""
        return 10e9 / self.baudrate


def is_recording(head: bytes) -> bool:
    """Return whether these first bytes of a file, 12 are enough, are a recording's."""
    return pcapng.is_pcapng(head)


def starts_recording(source: Input) -> bool:
    """Return whether a file starts a recording.

    Of a pipe no more is waited for than it takes to tell.
    """
    likely = all(source.at(0, length) == pcapng.SECTION_MARK[:length] for length in (1, 4))
    return likely and is_recording(bytes(source.at(0, 12)))


def make_header(info: RecordingInfo, base: int) -> bytes:
    """Return the blocks that start a recording; `base`: of the ids of its blocks."""
    # Imported where they are used: they take 20 ms, and readers need neither.
    import platform  # noqa: PLC0415
    from importlib.metadata import version  # noqa: PLC0415

    section = pcapng.block(
        pcapng.SECTION,
        # Version 1.0; how long the section gets is not known.
        struct.pack("<IHHq", pcapng.MAGIC, 1, 0, -1),
        [
            (pcapng.COMMENT, _ABOUT.encode()),
            (_OS, f"{platform.system()} {platform.release()}".encode()),
            (_APPLICATION, f"canser {version('canser')}".encode()),
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
        struct.pack("<HHI", _LINK_TYPE, 0, 0),  # 0: packets are never cut short
        [
            (_NAME, info.device.encode("utf-8", "surrogateescape")),
            (_DESCRIPTION, " ".join([_SIGN, *words]).encode()),
            (_SPEED, struct.pack("<Q", info.baudrate)),
            (_RESOLUTION, _NANOSECONDS),
        ],
    )
    return section + interface


# The longest mark of a block by which a search finds it.
MARK_MAX: Final = 10


def interface_mark(order: Order) -> bytes:
    """Return the pattern of an interface's first bytes: the type, any length, the kind of link."""
    kind, link = struct.pack(f"{order}I", pcapng.INTERFACE), struct.pack(f"{order}H", _LINK_TYPE)
    return re.escape(kind) + b"...." + re.escape(link)


def _base_word(base: int) -> str:
    """Return a base as it is written, with the CRC32 of its digits: all ids depend on it."""
    digits = f"{base:016x}"
    return f"{digits}{zlib.crc32(digits.encode()):08x}"


def read_interface(whole: memoryview, order: Order) -> tuple[RecordingInfo, int | None] | None:
    """Return what an interface block tells of a line, None if it is none of ours.

    And the base of the blocks' ids, None if they have none or it is damaged.
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
