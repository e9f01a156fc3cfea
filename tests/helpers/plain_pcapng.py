"""A slow reader of pcapng, written from the standard and from nothing of canser's.

draft-ietf-opsawg-pcapng: section 3.1 general block structure, 3.5 options, 4.1 section
header, 4.2 interface description, 4.3 enhanced packet, 4.6 interface statistics.
"""

from typing import Literal, NamedTuple

SECTION, INTERFACE, STATISTICS, PACKET = 0x0A0D0D0A, 1, 5, 6


class Block(NamedTuple):
    kind: int
    offset: int
    body: bytes  # without type and lengths
    little: bool

    @property
    def end(self) -> int:
        return self.offset + len(self.body) + 12

    def number(self, at: int, size: int) -> int:
        return int.from_bytes(self.body[at : at + size], "little" if self.little else "big")

    def options(self, at: int) -> dict[int, bytes]:
        found: dict[int, bytes] = {}
        while at < len(self.body):
            code, length = self.number(at, 2), self.number(at + 2, 2)
            if code == 0:
                assert length == 0
                assert at + 4 == len(self.body), "nothing stands behind the end of the options"
                return found
            found[code] = self.body[at + 4 : at + 4 + length]
            assert len(found[code]) == length
            at += 4 + length + -length % 4
        raise AssertionError("options without an end")

    @property
    def packet(self) -> bytes:
        assert self.kind == PACKET
        assert self.number(12, 4) == self.number(16, 4), "captured whole"
        return self.body[20 : 20 + self.number(12, 4)]

    @property
    def ts(self) -> int:
        return self.number(4, 4) << 32 | self.number(8, 4)

    @property
    def packet_options(self) -> dict[int, bytes]:
        return self.options(20 + len(self.packet) + -len(self.packet) % 4)


def without_ids(raw: bytes) -> bytes:
    """Return a recording as canser wrote it before blocks had ids; little endian."""
    out = b""
    for block in read(raw):
        body = block.body
        if block.kind == PACKET:
            told = block.packet_options
            number = b"\x04\0\x08\0" + told.get(4, bytes(8))
            at = 20 + len(block.packet) + -len(block.packet) % 4
            body = body[:at] + b"\x03\0\x05\0" + told[3] + bytes(3) + number + bytes(4)
        elif block.kind == INTERFACE:
            told = block.options(8)
            told[3] = told[3].partition(b" base=")[0]
            body = body[:8]
            for code, value in told.items():
                body += code.to_bytes(2, "little") + len(value).to_bytes(2, "little")
                body += value + bytes(-len(value) % 4)
            body += bytes(4)
        length = (len(body) + 12).to_bytes(4, "little")
        out += block.kind.to_bytes(4, "little") + length + body + length
    return out


def read(raw: bytes, *, torn: bool = False) -> list[Block]:
    """Return the blocks of a file; `torn`: the last may be cut short, and is left out."""
    found: list[Block] = []
    at, little = 0, True
    while at < len(raw):
        rest = len(raw) - at
        if rest >= 12 and raw[at : at + 4] == b"\x0a\x0d\x0d\x0a":
            little = {b"\x4d\x3c\x2b\x1a": True, b"\x1a\x2b\x3c\x4d": False}[raw[at + 8 : at + 12]]
        order: Literal["little", "big"] = "little" if little else "big"
        length = int.from_bytes(raw[at + 4 : at + 8], order)
        if torn and (rest < 12 or length > rest):
            return found
        assert length >= 12
        assert length % 4 == 0
        assert length <= rest
        assert int.from_bytes(raw[at + length - 4 : at + length], order) == length
        kind = int.from_bytes(raw[at : at + 4], order)
        found.append(Block(kind, at, raw[at + 8 : at + length - 4], little))
        at += length
    return found
