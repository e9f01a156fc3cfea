"""A slow decoder in plain Python: the second opinion on every byte.

Written from the documents (the python-can documentation, CAN over Serial; Seeed, Serial port
(USB) to CAN protocol definition; CANtalope Serial Protocol; the manuals of converters to Ethernet;
design: wire formats) and never from
the C. It knows one way only: read a packet field by field in the order of the wire, and step one
byte when that fails. It is not fast, holds no state between calls, and imports neither numpy nor
canser, so that it cannot share a mistake with what it judges.
"""

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

NO_TIME = -(2**63)
"""The time of a frame whose time is not known: the least int64, numpy's NaT."""

TICK_NS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}

REASONS = ("marker", "type", "dlc", "id", "end", "sum", "field", "command", "cut")
"""Why no packet starts at a byte. One skipped byte is one reject."""

DLC_MAX = 8
ID_MAX = 0x7FF
ID_EXT_MAX = 0x1FFF_FFFF


class Frame(NamedTuple):
    """One CAN frame. `data` is always 8 bytes, zero past the dlc and in a remote frame."""

    id: int
    ext: bool = False
    rtr: bool = False
    dlc: int = 0
    err: bool = False
    data: bytes = bytes(8)
    ts: int = NO_TIME


RECORD = struct.Struct("<I??B?8sq")
"""The record of the design, 24 bytes. It has no gaps, so the order alone puts each field right."""


def pack(frames: Iterable[Frame]) -> bytes:
    """Return the frames as records: byte for byte what an array of frames must hold."""
    return b"".join(RECORD.pack(*frame) for frame in frames)


def unpack(records: bytes) -> list[Frame]:
    """Return the frames in an array's bytes."""
    return [Frame(*values) for values in RECORD.iter_unpack(records)]


class Control(NamedTuple):
    """One packet that is valid but is no CAN frame, at its offset in the stream."""

    offset: int
    data: bytes


@dataclass
class Stats:
    """What became of every byte of a stream, and of its clock."""

    bytes_in: int = 0
    bytes_framed: int = 0
    bytes_control: int = 0
    bytes_skipped: int = 0
    frames: int = 0
    controls: int = 0
    resyncs: int = 0
    rejects: dict[str, int] = field(default_factory=lambda: dict.fromkeys(REASONS, 0))
    pending: int = 0
    ts_wraps: int = 0
    ts_backsteps: int = 0
    ts_uncertain: int = 0

    @classmethod
    def of(cls, snapshot: Any) -> "Stats":
        """Copy the numbers of any object with these attributes."""
        values = {name: getattr(snapshot, name) for name in cls.__dataclass_fields__}
        return cls(**(values | {"rejects": dict(values["rejects"])}))

    def check(self) -> None:
        """Assert what holds after every call: no byte is lost, none is counted twice."""
        accounted = self.bytes_framed + self.bytes_control + self.bytes_skipped + self.pending
        assert self.bytes_in == accounted, self
        assert sum(self.rejects.values()) == self.bytes_skipped, self


@dataclass
class Result:
    """All that a stream holds; `offsets` are those of the frames' first bytes.

    `ends` are those behind their last ones; only `decode` gives them.
    """

    frames: list[Frame] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)
    controls: list[Control] = field(default_factory=list)
    stats: Stats = field(default_factory=Stats)
    ends: list[int] = field(default_factory=list, compare=False)


class NeedMoreError(Exception):
    """The candidate's next byte is not there yet."""


class RejectError(Exception):
    """No packet starts here; the argument is the reason."""


class Candidate:
    """The bytes from one position on, read in the order in which they come over the wire.

    A check is made as soon as its own bytes are there and before the next byte is asked for: so
    the reason of a reject never depends on how much of the stream has arrived.
    """

    def __init__(self, stream: bytes, start: int) -> None:
        self.stream = stream
        self.start = start
        self.position = start

    def peek(self) -> int:
        if self.position >= len(self.stream):
            raise NeedMoreError
        return self.stream[self.position]

    def byte(self) -> int:
        value = self.peek()
        self.position += 1
        return value

    def take(self, length: int) -> bytes:
        if self.position + length > len(self.stream):
            raise NeedMoreError
        self.position += length
        return self.stream[self.position - length : self.position]

    def little(self, length: int) -> int:
        return int.from_bytes(self.take(length), "little")

    def expect(self, value: int, reason: str) -> None:
        self.require(self.byte() == value, reason)

    def require(self, condition: bool, reason: str) -> None:
        if not condition:
            raise RejectError(reason)

    def packet(self) -> bytes:
        """All that was read so far: the packet, once its probe is through."""
        return self.stream[self.start : self.position]


class Found(NamedTuple):
    """A valid packet: a frame, with the raw counter of its clock if it has one, or a control."""

    frame: Frame | None
    raw_time: int | None = None


def payload(data: bytes, rtr: bool) -> bytes:
    """Return a record's data: a remote frame has none, whatever it carried on the wire."""
    return bytes(8) if rtr else data.ljust(8, b"\0")


def remote_or_payload(candidate: Candidate, rtr: bool, dlc: int, end: int) -> bytes:
    """Read the payload and the end mark behind it, in the two formats that have an end mark.

    There are two dialects of remote frames, with and without filler bytes. The byte right behind
    the id tells them apart: an end mark there ends the frame.
    """
    if rtr and candidate.peek() == end:
        candidate.byte()
        return bytes(8)
    data = payload(candidate.take(dlc), rtr)
    candidate.expect(end, "end")
    return data


# serial: AA | timestamp u32 LE | dlc u8 | id u32 LE | payload | BB

SERIAL_EXT = 1 << 31
SERIAL_RTR = 1 << 30
SERIAL_ERR = 1 << 29


def probe_serial(candidate: Candidate) -> Found:
    candidate.expect(0xAA, "marker")
    raw_time = candidate.little(4)
    dlc = candidate.byte()
    candidate.require(dlc <= DLC_MAX, "dlc")
    word = candidate.little(4)
    id_ = word & ID_EXT_MAX
    ext = bool(word & SERIAL_EXT) or id_ > ID_MAX
    rtr = bool(word & SERIAL_RTR)
    err = bool(word & SERIAL_ERR)
    data = remote_or_payload(candidate, rtr, dlc, 0xBB)
    return Found(Frame(id_, ext, rtr, dlc, err, data), raw_time)


def encode_serial(frame: Frame, tick_ns: int) -> bytes:
    if frame.ts == NO_TIME:
        raise ValueError("the format needs a time")
    word = frame.id
    word |= SERIAL_EXT if frame.ext else 0
    word |= SERIAL_RTR if frame.rtr else 0
    word |= SERIAL_ERR if frame.err else 0
    raw_time = frame.ts // tick_ns % 2**32
    data = b"" if frame.rtr else frame.data[: frame.dlc]
    return struct.pack("<BIBI", 0xAA, raw_time, frame.dlc, word) + data + b"\xbb"


# seeed: AA | 1 1 ext rtr dlc[3..0] | id, 2 or 4 bytes LE | payload | 55
#        AA 55 | command | 16 bytes | sum


def probe_seeed(candidate: Candidate) -> Found:
    candidate.expect(0xAA, "marker")
    type_ = candidate.byte()
    if type_ == 0x55:
        return probe_seeed_fixed(candidate)
    candidate.require(type_ & 0xC0 == 0xC0, "type")
    ext = bool(type_ & 0x20)
    rtr = bool(type_ & 0x10)
    dlc = type_ & 0x0F
    candidate.require(dlc <= DLC_MAX, "dlc")
    id_ = candidate.little(4 if ext else 2)
    candidate.require(id_ <= (ID_EXT_MAX if ext else ID_MAX), "id")
    data = remote_or_payload(candidate, rtr, dlc, 0x55)
    return Found(Frame(id_, ext, rtr, dlc, data=data))


def probe_seeed_fixed(candidate: Candidate) -> Found:
    candidate.take(18)
    packet = candidate.packet()
    # The sum comes last on the wire and is judged first: until it holds nothing in the packet
    # is worth believing.
    candidate.require(sum(packet[2:19]) & 0xFF == packet[19], "sum")
    if packet[2] != 0x01:
        return Found(None)
    kind, form, dlc = packet[3], packet[4], packet[9]
    id_ = int.from_bytes(packet[5:9], "little")
    candidate.require(kind in (1, 2), "field")
    candidate.require(form in (1, 2), "field")
    candidate.require(id_ <= (ID_EXT_MAX if kind == 2 else ID_MAX), "field")
    candidate.require(dlc <= DLC_MAX, "field")
    ext, rtr = kind == 2, form == 2
    return Found(Frame(id_, ext, rtr, dlc, data=payload(packet[10 : 10 + dlc], rtr)))


def encode_seeed(frame: Frame, _tick_ns: int) -> bytes:
    if frame.err:
        raise ValueError("the format has no error frames")
    type_ = 0xC0 | frame.ext << 5 | frame.rtr << 4 | frame.dlc
    id_ = frame.id.to_bytes(4 if frame.ext else 2, "little")
    # The device expects the filler bytes of a remote frame.
    data = bytes(frame.dlc) if frame.rtr else frame.data[: frame.dlc]
    return bytes([0xAA, type_]) + id_ + data + b"\x55"


# cantalope: id[10..3] | id[2..0] rtr dlc[3..0] | payload
#            FF FF | command | ...

CANTALOPE_PING = 0x00
CANTALOPE_ERROR = 0x01


def probe_cantalope(candidate: Candidate) -> Found:
    header = int.from_bytes(candidate.take(2), "big")
    if header == 0xFFFF:
        command = candidate.byte()
        candidate.require(command in (CANTALOPE_PING, CANTALOPE_ERROR), "command")
        if command == CANTALOPE_ERROR:
            candidate.byte()
        return Found(None)
    id_, rtr, dlc = header >> 5, bool(header & 0x10), header & 0x0F
    candidate.require(dlc <= DLC_MAX, "dlc")
    # Remote frames too: the dlc tells where the next packet starts.
    return Found(Frame(id_, False, rtr, dlc, data=payload(candidate.take(dlc), rtr)))


def encode_cantalope(frame: Frame, _tick_ns: int) -> bytes:
    if frame.err:
        raise ValueError("the format has no error frames")
    if frame.ext:
        raise ValueError("the format has no extended frames")
    header = frame.id << 5 | frame.rtr << 4 | frame.dlc
    data = bytes(frame.dlc) if frame.rtr else frame.data[: frame.dlc]
    return header.to_bytes(2, "big") + data


# canet13: info | id u32 BE | 8 bytes
#          info: bit 7 extended, bit 6 remote, bits 5 and 4 zero, bits 3..0 dlc


def probe_canet13(candidate: Candidate) -> Found:
    info = candidate.byte()
    candidate.require(info & 0x30 == 0, "type")
    ext, rtr, dlc = bool(info & 0x80), bool(info & 0x40), info & 0x0F
    candidate.require(dlc <= DLC_MAX, "dlc")
    id_ = int.from_bytes(candidate.take(4), "big")
    candidate.require(id_ <= (ID_EXT_MAX if ext else ID_MAX), "id")
    data = candidate.take(8)  # whatever the dlc says, and in remote frames, too
    return Found(Frame(id_, ext, rtr, dlc, data=payload(data[:dlc], rtr)))


def encode_canet13(frame: Frame, _tick_ns: int) -> bytes:
    if frame.err:
        raise ValueError("the format has no error frames")
    info = frame.ext << 7 | frame.rtr << 6 | frame.dlc
    data = b"" if frame.rtr else frame.data[: frame.dlc]
    return bytes([info]) + frame.id.to_bytes(4, "big") + data.ljust(8, b"\0")


class Format(NamedTuple):
    """One wire format, and what tests must know of it."""

    probe: Callable[[Candidate], Found]
    encode: Callable[[Frame, int], bytes]
    reasons: set[str]  # what the wire can do wrong
    significant: bytes  # bytes that mean something, or lie next to a bound; marks first
    has_clock: bool = False
    has_ext: bool = True
    has_err: bool = False


WIRE_FORMATS = {
    "canet13": Format(
        probe_canet13,
        encode_canet13,
        {"type", "dlc", "id", "cut"},
        bytes.fromhex("85 08 00 01 07 09 0F 10 1F 20 30 40 80 88 C0 C8 FF"),
    ),
    "cantalope": Format(
        probe_cantalope,
        encode_cantalope,
        {"dlc", "command", "cut"},
        bytes.fromhex("FF 00 01 02 08 09 0F 10 18 1F E0 E8 EF F0 FE 20"),
        has_ext=False,
    ),
    "seeed": Format(
        probe_seeed,
        encode_seeed,
        {"marker", "type", "dlc", "id", "end", "sum", "field", "cut"},
        bytes.fromhex("AA 55 C0 C1 C2 C8 C9 D0 D2 E0 E1 F0 F1 00 01 02 04 07 08 1F 20 BF FF"),
    ),
    "serial": Format(
        probe_serial,
        encode_serial,
        {"marker", "dlc", "end", "cut"},
        bytes.fromhex("AA BB 00 01 07 08 09 1F 20 40 60 80 C0 FF"),
        has_clock=True,
        has_err=True,
    ),
}


def signed(value: int, bits: int) -> int:
    """Return the value modulo 2**bits, as two's complement reads it."""
    value %= 1 << bits
    return value - (1 << bits) if value >> (bits - 1) else value


class Clock:
    """The 32-bit counter of a device, unwrapped over the stream by signed differences.

    Signed, so that one false time out of the noise is undone by the next good one. But half
    a turn has no sign, and several false times may go round the circle. So a frame that
    comes behind 16 or more small steps forward stands in line; so does one of the next four
    that lies within a small step of the last in line, and that one is measured from there.
    """

    SMALL = 1 << 24

    def __init__(self, tick_ns: int, stats: Stats) -> None:
        self.tick_ns = tick_ns
        self.stats = stats
        self.previous: int | None = None
        self.ticks = 0
        self.small_steps = 0  # forward, in a row
        self.near = False  # ... which began at a frame near the line
        self.line: int | None = None  # ticks of the last frame in line
        self.behind = 0  # frames behind that one

    def time(self, raw: int) -> int:
        if self.previous is None:
            self.ticks = raw
        elif 0 <= raw - self.previous <= self.SMALL:
            self.ticks += raw - self.previous
            self.small_steps += 1
            self.behind += 1
        else:
            in_line = self.near or self.small_steps >= 16
            if in_line:
                self.line = self.ticks
                self.behind = 0
            self.behind += 1
            ticks = self.ticks + signed(raw - self.previous, 32)
            self.near = False
            self.small_steps = 0
            if self.line is not None and self.behind <= 4:
                from_line = signed(raw - self.line, 32)
                if abs(from_line) <= self.SMALL:
                    ticks = self.line + from_line
                    self.near = True
            if ticks < self.ticks:
                self.stats.ts_backsteps += 1
                self.stats.ts_uncertain += in_line and self.ticks - ticks > self.SMALL
            elif raw < self.previous:
                self.stats.ts_wraps += 1
            self.ticks = ticks
        self.previous = raw
        return signed(self.ticks * self.tick_ns, 64)


def decode(stream: bytes, protocol: str, tick_ns: int = 1_000_000, *, flush: bool = True) -> Result:
    """Find all packets of a stream: always the first valid one at the lowest offset.

    With flush=False the stream has not ended: a candidate that lacks bytes stays `pending`
    instead of being a reject of one byte with reason `cut`.
    """
    probe = WIRE_FORMATS[protocol].probe
    result = Result(stats=Stats(bytes_in=len(stream)))
    stats = result.stats
    clock = Clock(tick_ns, stats)
    skipping = False
    position = 0
    while position < len(stream):
        candidate = Candidate(stream, position)
        try:
            frame, raw_time = probe(candidate)
        except (NeedMoreError, RejectError) as problem:
            if isinstance(problem, NeedMoreError) and not flush:
                break
            reason = "cut" if isinstance(problem, NeedMoreError) else str(problem)
            stats.rejects[reason] += 1
            stats.bytes_skipped += 1
            stats.resyncs += not skipping
            skipping = True
            # One byte, not one packet: a good frame may start inside the failed candidate.
            position += 1
            continue
        packet = candidate.packet()
        if frame is None:
            stats.controls += 1
            stats.bytes_control += len(packet)
            result.controls.append(Control(position, packet))
        else:
            if raw_time is not None:
                frame = frame._replace(ts=clock.time(raw_time))
            stats.frames += 1
            stats.bytes_framed += len(packet)
            result.frames.append(frame)
            result.offsets.append(position)
            result.ends.append(position + len(packet))
        skipping = False
        position += len(packet)
    stats.pending = len(stream) - position
    return result


def encode(frames: Iterable[Frame], protocol: str, tick_ns: int = 1_000_000) -> bytes:
    """Return the packets of the frames, one behind the other.

    The payload past the dlc is not sent. The time goes out in whole ticks, rounded down, modulo
    2**32. A frame that the format cannot carry is a ValueError that starts with its index.
    """
    packets = []
    for index, frame in enumerate(frames):
        try:
            if frame.dlc > DLC_MAX:
                raise ValueError("the dlc is over 8")
            if frame.id > (ID_EXT_MAX if frame.ext else ID_MAX):
                raise ValueError("the id is out of range")
            packets.append(WIRE_FORMATS[protocol].encode(frame, tick_ns))
        except ValueError as problem:
            raise ValueError(f"frame {index}: {problem}") from None
    return b"".join(packets)
