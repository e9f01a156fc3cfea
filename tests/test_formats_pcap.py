"""Captures of CAN frames: packets made here byte by byte, there and back, damage, other judges.

Written from draft-ietf-opsawg-pcap, draft-ietf-opsawg-pcapng and Linux's can.h.
"""

import io
import shutil
import struct
import subprocess
import tracemalloc
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser.errors import FormatError
from canser.files import pcap
from canser.files.reading import Blocks, checked_options
from canser.files.writer import WriteOptions
from reference import NO_TIME, Frame
from samples import EPOCH, FRAMES, MICROSECOND, SECOND, array, listed
from shared import LOG_FILES, needs_logs

ORDERS = ["<", ">"]
KINDS = ["x.pcap", "x.pcapng"]

CAN, COOKED, ETHERNET, PRIVATE, LIN = 227, 113, 1, 147, 212

ABC = Frame(0x123, dlc=3, data=b"abc".ljust(8, b"\0"), ts=EPOCH)


# ---- A capture as other programs write it.


def socketcan(frame: Frame, order: str = ">") -> bytes:
    """Return a frame as the kernel gives it, with 16 bytes."""
    word = frame.id | frame.ext << 31 | frame.rtr << 30 | frame.err << 29
    return struct.pack(f"{order}I", word) + bytes([frame.dlc, 0, 0, 0]) + frame.data


def cooked(packet: bytes, protocol: int = 0x0C, kind: int = 0) -> bytes:
    """Return a packet behind the header of link type 113."""
    return struct.pack(">HHH8sH", kind, 280, 0, bytes(8), protocol) + packet


def head(order: str = "<", link: int = CAN, magic: int = 0xA1B23C4D) -> bytes:
    return struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 65_535, link)


def record(packet: bytes, ts: int, order: str = "<", unit: int = 1) -> bytes:
    seconds, ns = divmod(ts, SECOND)
    size = len(packet)
    return struct.pack(f"{order}4I", seconds, ns // unit, size, size) + packet


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    length = struct.pack(f"{order}I", len(body) + 12)
    return struct.pack(f"{order}I", kind) + length + body + length


def options(order: str, **values: bytes) -> bytes:
    """Return options by `o` and their code."""
    parts = [
        struct.pack(f"{order}HH", int(code[1:]), len(value)) + value + bytes(-len(value) % 4)
        for code, value in values.items()
    ]
    return b"".join([*parts, bytes(4)]) if parts else b""


def section(order: str = "<", major: int = 1) -> bytes:
    return block(0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, major, 0, -1), order)


def interface(order: str = "<", link: int = CAN, snap_len: int = 0, **values: Any) -> bytes:
    fixed = struct.pack(f"{order}HHI", link, 0, snap_len)
    return block(1, fixed + options(order, **values), order)


def packet(data: bytes, ticks: int, order: str = "<", number: int = 0, **values: Any) -> bytes:
    size = len(data)
    fixed = struct.pack(f"{order}5I", number, ticks >> 32, ticks & 0xFFFF_FFFF, size, size)
    return block(6, fixed + data + bytes(-size % 4) + options(order, **values), order)


def flags(value: int, order: str = "<") -> dict[str, Any]:
    return {"o2": struct.pack(f"{order}I", value)}


NANO: dict[str, Any] = {"o9": b"\x09"}
START = section() + interface(o2=b"can0", **NANO)


class Got:
    """All that a capture gives."""

    def __init__(self, raw: bytes | io.RawIOBase, name: str = "x.pcap", **given: Any) -> None:
        file = io.BytesIO(raw) if isinstance(raw, bytes) else raw
        file.name = name  # type: ignore[union-attr]
        file_format = given.pop("format", "pcap")
        checked = checked_options(file_format, **given)
        self.frames: list[Frame] = []
        self.channels: list[str] = []
        self.sent: list[bool] = []
        with Blocks(file, checked, format=file_format) as blocks:  # type: ignore[arg-type]
            blocks.keep_tags()
            for frames in blocks:
                assert blocks.channels is not None
                assert blocks.directions is not None
                names = blocks.channel_names
                self.frames += listed(frames)
                self.channels += [names[code] for code in blocks.channels.tolist()]
                self.sent += [bool(each) for each in blocks.directions]
            self.format = blocks.format
            self.remarks = [each.removeprefix(f"{name}: ") for each in blocks.notes.remarks]


def written(
    name: str,
    frames: list[Frame],
    channels: list[int] | None = None,
    sent: list[int] | None = None,
    names: dict[int, str] | None = None,
) -> tuple[bytes, list[str]]:
    """Return a capture by canser, and its remarks."""
    file = io.BytesIO()
    writer: Any = pcap.write(file, WriteOptions(name=name, channel_names=names or {}))
    codes = [None if each is None else np.array(each, np.uint8) for each in (channels, sent)]
    if name.endswith("ng"):
        writer.write(array(*frames), *codes)
    else:
        writer.write(array(*frames))
    return file.getvalue(), writer.finish() if not name.endswith("ng") or frames else []


def kept(frame: Frame, name: str) -> Frame:
    """Return what a capture can hold of a frame."""
    most = 2**63 if name.endswith("ng") else 2**32 * SECOND
    # The classes of an error have 29 bits.
    ext = frame.ext or (frame.err and frame.id > 0x7FF)
    return frame._replace(ts=frame.ts if 0 <= frame.ts < most else 0, ext=ext)


# ---- There and back.


@pytest.mark.parametrize("name", KINDS)
@given(frames=FRAMES)
def test_frames_read_back_but_for_times_that_it_cannot_hold(name: str, frames: list[Frame]) -> None:
    raw, remarks = written(name, frames) if frames else (START if "ng" in name else head(), [])
    assert Got(raw).frames == [kept(frame, name) for frame in frames]
    unknown = sum(frame.ts == NO_TIME for frame in frames)
    outside = sum(frame.ts != kept(frame, name).ts for frame in frames) - unknown
    assert remarks == [
        *([f"frames without a time, written as 0: {unknown}"] if unknown else []),
        *(
            [f"frames with a time that the format cannot hold, written as 0: {outside}"]
            if outside
            else []
        ),
    ]


@given(
    st.lists(st.tuples(st.integers(0, 254), st.booleans()), min_size=1, max_size=40),
    st.dictionaries(st.integers(0, 254), st.text(min_size=1, max_size=9), max_size=5),
)
def test_channels_and_directions_read_back_from_pcapng(
    tags: list[tuple[int, bool]], names: dict[int, str]
) -> None:
    names = {code: name for code, name in names.items() if name.encode("utf-8", "replace")}
    names = {code: name.replace("\0", "_") + f"/{code}" for code, name in names.items()}
    frames = [ABC._replace(ts=ABC.ts + at) for at in range(len(tags))]
    channels, sent = [code for code, _ in tags], [each for _, each in tags]
    raw, _ = written("x.pcapng", frames, channels, [int(each) for each in sent], names)
    got = Got(raw)
    assert got.frames == frames
    assert got.sent == sent
    want = [names.get(code, f"can{code}") for code in channels]
    assert got.channels == [
        name.encode("utf-8", "replace").decode("utf-8", "replace") for name in want
    ]


@needs_logs
@pytest.mark.filterwarnings("ignore::canser.CanserWarning")
@pytest.mark.parametrize("name", KINDS)
def test_the_nine_frames_are_written_as_they_were(name: str, tmp_path: Path) -> None:
    with canser.blocks(LOG_FILES / "edge.pcapng") as source:
        frames = next(source)
        assert source.channels is not None
        assert source.directions is not None
        channels, directions = source.channels.copy(), source.directions.copy()
    done = canser.convert(LOG_FILES / "edge.pcapng", tmp_path / name, to="pcap")
    assert done.frames == 9
    got = canser.blocks(tmp_path / name)
    assert listed(next(got)) == listed(frames)
    if name == "x.pcapng":
        assert done.remarks == []
        assert got.channels is not None
        assert got.directions is not None
        assert got.channels.tolist() == channels.tolist()
        assert got.directions.tolist() == directions.tolist()
        assert got.channel_names == {0: "can0", 1: "can1"}
    got.close()


@pytest.mark.filterwarnings("ignore::canser.CanserWarning")
def test_pcap_loses_channels_and_directions_and_says_so(tmp_path: Path) -> None:
    codes = np.array([0, 1], np.uint8)
    frames = array(ABC, ABC)
    done = canser.write(frames, tmp_path / "x.pcap", channels=codes, directions=codes)
    assert done.remarks == [
        "frames of 2 channels become one: 0 1, 1 1",
        "direction is not kept: received 1, sent 1",
    ]
    done = canser.write(
        frames, tmp_path / "x.pcapng", format="pcap", channels=codes, directions=codes
    )
    assert done.remarks == []
    with canser.blocks(tmp_path / "x.pcap") as blocks, pytest.raises(ValueError, match="no buses"):
        canser.read(tmp_path / "x.pcap", bus="0")
    assert len(canser.read(tmp_path / "x.pcapng", bus="can1")) == 1
    assert blocks.format == "pcap"


@pytest.mark.parametrize("name", KINDS)
def test_a_capture_without_frames_is_one_of_can(name: str, tmp_path: Path) -> None:
    canser.write(array(), tmp_path / name, format="pcap")
    with canser.blocks(tmp_path / name) as blocks:
        assert blocks.format == "pcap"
        assert list(blocks) == []


def test_a_frame_that_is_none_of_classic_can_is_an_error() -> None:
    for name in KINDS:
        with pytest.raises(ValueError, match="frame 1 is none of classic CAN"):
            written(name, [ABC, ABC._replace(id=0x800)])


@pytest.mark.parametrize("name", KINDS)
def test_many_frames(name: str, tmp_path: Path) -> None:
    count = 150_001
    frames = np.zeros(count, canser.FRAME_DTYPE)
    frames["id"], frames["ts"] = np.arange(count) % 0x800, EPOCH + np.arange(count)
    codes = (np.arange(count) % 3).astype(np.uint8)
    path = tmp_path / name
    with pytest.warns(canser.CanserWarning) if name == "x.pcap" else _quiet():
        canser.write(frames, path, format="pcap", channels=codes, directions=codes % 2)
    channels, sent = np.empty(count, np.uint8), np.empty(count, np.uint8)
    got = canser.read(path, channels=channels, directions=sent)
    assert (got == frames).all()
    room = np.empty(1000, canser.FRAME_DTYPE)
    assert sum(len(block) for block in canser.blocks(path, out=room)) == count
    if name == "x.pcapng":
        assert (channels == codes).all()
        assert (sent == codes % 2).all()


def _quiet() -> Any:
    return io.BytesIO()  # a context manager that does nothing


# ---- What other programs write.


@pytest.mark.parametrize("order", ORDERS)
@given(frames=FRAMES)
def test_both_byte_orders_are_read(order: str, frames: list[Frame]) -> None:
    frames = [kept(frame, "x.pcap") for frame in frames]
    raw = head(order) + b"".join(record(socketcan(each), each.ts, order) for each in frames)
    assert Got(raw).frames == frames
    raw = head(order, COOKED) + b"".join(
        record(cooked(socketcan(each, order)), each.ts, order) for each in frames
    )
    assert Got(raw).frames == frames
    raw = section(order) + interface(order, o2=b"a", **NANO) + interface(order, COOKED, o9=b"\x09")
    for each in frames:
        raw += packet(socketcan(each), each.ts, order, 0, **flags(2, order))
        raw += packet(cooked(socketcan(each, order)), each.ts, order, 1, **flags(1, order))
    got = Got(raw)
    assert got.frames == [each for each in frames for _ in range(2)]
    assert got.channels == ["a", "1"] * len(frames)
    assert got.sent == [True, False] * len(frames)


@pytest.mark.parametrize("order", ORDERS)
def test_pcap_of_microseconds(order: str) -> None:
    raw = head(order, magic=0xA1B2C3D4) + record(socketcan(ABC), EPOCH, order, unit=MICROSECOND)
    assert Got(raw).frames == [ABC]
    # The time goes to the year 2106.
    raw = head(order) + record(socketcan(ABC), (2**32 - 1) * SECOND + 1, order)
    assert Got(raw).frames[0].ts == (2**32 - 1) * SECOND + 1


@pytest.mark.parametrize("resolution", [*range(31), 100, 127, *range(128, 200), 220, 255])
def test_any_unit_of_time(resolution: int) -> None:
    unit = Fraction(1, 2 ** (resolution - 128) if resolution >= 128 else 10**resolution)
    limit = min(int(Fraction(2**63 - 1, SECOND) / unit), 2**64 - 1)
    chance = np.random.default_rng(resolution)
    ticks = [
        0,
        1,
        limit // 2,
        limit - 1,
        limit,
        *map(int, chance.integers(0, limit, 40, np.uint64)),
    ]
    ticks += [min(int(each), limit) for each in np.geomspace(1, limit, 20)]
    for offset in (0, -1, 1):
        fits = [each for each in ticks if each * unit + offset < Fraction(2**63 - 1, SECOND)]
        seconds = struct.pack("<q", offset)
        raw = section() + interface(o9=bytes([resolution]), o14=seconds)
        raw += b"".join(packet(socketcan(ABC), each) for each in fits)
        assert [each.ts for each in Got(raw).frames] == [
            int(each * unit * SECOND // 1) + offset * SECOND for each in fits
        ]


@pytest.mark.parametrize(
    ("resolution", "ticks", "offset"),
    [
        (9, 2**63, 0),
        (6, 2**63 // 1000 + 1, 0),
        (0x80, 2**34, 0),
        (0x81, 2**35, 0),
        (9, 2**62, 2**33),
    ],
)
def test_a_time_that_does_not_fit_is_an_error(resolution: int, ticks: int, offset: int) -> None:
    raw = section() + interface(o9=bytes([resolution]), o14=struct.pack("<q", offset))
    with pytest.raises(FormatError, match=r"^x\.pcap, byte \d+: a time that does not fit 64 bits"):
        Got(raw + packet(socketcan(ABC), ticks))


def test_a_start_that_does_not_fit_is_an_error() -> None:
    raw = section() + interface(o14=struct.pack("<q", 2**62))
    with pytest.raises(FormatError, match="times begin at 4611686018427387904 s"):
        Got(raw)


def test_an_interface_without_options_counts_microseconds() -> None:
    got = Got(section() + interface() + packet(socketcan(ABC), EPOCH // 1000))
    assert got.frames == [ABC]
    assert got.channels == ["0"]


def test_interfaces_are_numbered_in_their_section() -> None:
    raw = section() + interface(o2=b"can0", **NANO) + interface(o2=b"can7", **NANO)
    raw += packet(socketcan(ABC), EPOCH, number=1)
    raw += section(">") + interface(">", ETHERNET) + interface(">", o2=b"can0", **NANO)
    raw += packet(socketcan(ABC), EPOCH, ">", number=1) + packet(bytes(60), 5, ">")
    got = Got(raw)
    assert got.frames == [ABC, ABC]
    assert got.channels == ["can7", "can0"]
    assert got.remarks == ["packets of Ethernet, left out: 1"]
    for extra in (packet(socketcan(ABC), 0, number=2), section() + packet(socketcan(ABC), 0)):
        with pytest.raises(
            FormatError, match=r"a packet of the interface \d, but \d are described"
        ):
            Got(START + interface() + extra)


def test_many_interfaces() -> None:
    raw = section() + b"".join(interface(o2=b"x%d" % at, **NANO) for at in range(300))
    got = Got(raw + b"".join(packet(socketcan(ABC), EPOCH, number=at) for at in (0, 254, 255, 299)))
    # There are codes for 255 channels.
    assert got.channels == ["x0", "x254", "not told", "not told"]
    with pytest.raises(FormatError, match="more than 4,096 interfaces"):
        Got(section() + interface() * 4_097)


@pytest.mark.parametrize("value", [0, 1, 2, 3, 0xFFFF_FFFE])
def test_the_direction(value: int) -> None:
    comment: dict[str, Any] = {"o1": b"a comment", "o4": struct.pack("<Q", 5)}
    got = Got(START + packet(socketcan(ABC), EPOCH, **comment, **flags(value)))
    assert got.sent == [value & 3 == 2]
    assert got.remarks == [
        "packets that the capture lost, as it tells: 5",
        "comments on packets, left out: 1",
    ]


def test_the_direction_of_cooked_packets() -> None:
    raw = section() + interface(link=COOKED, **NANO)
    for kind in (0, 1, 4):
        raw += packet(cooked(socketcan(ABC, "<"), kind=kind), EPOCH)
    raw += packet(cooked(socketcan(ABC, "<"), kind=4), EPOCH, **flags(1))
    assert Got(raw).sent == [False, False, True, False]
    assert Got(head(link=COOKED) + record(cooked(socketcan(ABC, "<"), kind=4), 0)).sent == [True]


def can(word: int, rest: bytes) -> bytes:
    return struct.pack(">I", word) + rest


DATA = bytes(range(1, 9))

PACKETS = {
    # Frames of classic CAN.
    "three bytes": (can(0x123, b"\x03\0\0\0abc"), "frame"),
    "padded": (can(0x123, b"\x03\0\0\0abc" + DATA * 3), "frame"),
    "rubbish with the FD bit": (can(0x123, b"\x03\x0c\0\0abc"), "frame"),
    "rubbish behind the FD bit": (can(0x123, b"\x03\x04\x20\0abc"), "frame"),
    "rubbish": (can(0x123, b"\x03\x77\x38\x31abc"), "frame"),
    # Others.
    "FD by its bit": (can(0x123, b"\x03\x04\0\0abc"), "CAN FD frames, left out"),
    "FD with a faster rate": (can(0x123, b"\x03\x07\0\0abc"), "CAN FD frames, left out"),
    "FD by its size": (can(0x123, b"\x03\0\0\0" + bytes(64)), "CAN FD frames, left out"),
    "FD by its length": (can(0x123, b"\x0c\0\0\0" + bytes(12)), "CAN FD frames, left out"),
    "XL": (can(0x123, b"\x80\0\x08\0" + bytes(12)), "CAN XL frames, left out"),
    "too long": (can(0x123, b"\x41\0\0\0abc"), "packets that are no frame of CAN, left out"),
    "too large": (can(0x800, b"\x03\0\0\0abc"), "packets that are no frame of CAN, left out"),
    "no head": (can(0x123, b"\x03\0\0"), "packets cut short, left out"),
    "cut data": (can(0x123, b"\x08\0\0\0abcdefg"), "packets cut short, left out"),
}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("what", PACKETS)
def test_what_a_packet_holds(what: str, order: str) -> None:
    data, found = PACKETS[what]
    want = [ABC] if found == "frame" else []
    for raw in (
        head(order) + record(data, EPOCH, order),
        section(order) + interface(order, **NANO) + packet(data, EPOCH, order),
    ):
        got = Got(raw)
        assert got.frames == want
        assert got.remarks == ([] if want else [f"{found}: 1"])


@pytest.mark.parametrize(
    ("data", "found"),
    [
        (cooked(b""), "packets cut short, left out"),
        (cooked(b"")[:15], "packets cut short, left out"),
        (cooked(can(0x23010000, b"\x03\0\0\0abc"), 0x0D), "CAN FD frames, left out"),
        (cooked(can(0x23010000, b"\x10\0\0\0" + bytes(16))), "CAN FD frames, left out"),
        (cooked(bytes(40), 0x0E), "CAN XL frames, left out"),
        (cooked(bytes(40), 0x0800), "packets of other networks, left out"),
    ],
)
def test_what_a_cooked_packet_holds(data: bytes, found: str) -> None:
    assert Got(head(link=COOKED) + record(data, EPOCH)).remarks == [f"{found}: 1"]


def test_frames_of_every_kind() -> None:
    frames = {
        can(0x1FFFFFFF | 1 << 31, b"\x02\0\0\0ab"): Frame(
            0x1FFFFFFF, True, dlc=2, data=b"ab" + bytes(6), ts=EPOCH
        ),
        can(0x7FF | 1 << 30, b"\x08\0\0\0"): Frame(0x7FF, rtr=True, dlc=8, ts=EPOCH),
        can(1 | 1 << 30, b"\x08\0\0\0" + DATA): Frame(1, rtr=True, dlc=8, ts=EPOCH),
        can(0x80 | 1 << 29, b"\x08\0\0\0" + DATA): Frame(
            0x80, dlc=8, err=True, data=DATA, ts=EPOCH
        ),
        can(0x1000 | 1 << 29, b"\0\0\0\0"): Frame(0x1000, True, err=True, ts=EPOCH),
    }
    raw = head() + b"".join(record(each, EPOCH) for each in frames)
    assert Got(raw).frames == list(frames.values())


@pytest.mark.parametrize("order", ORDERS)
def test_packets_of_old_and_simple_blocks(order: str) -> None:
    start = section(order) + interface(order, snap_len=12, **NANO)
    data = socketcan(ABC)
    old = struct.pack(
        f"{order}HHIIII", 0, 7, EPOCH >> 32, EPOCH & 0xFFFF_FFFF, len(data), len(data)
    )
    old += data + options(order, **flags(2, order))
    simple = struct.pack(f"{order}I", 16) + data[:12]
    got = Got(start + block(2, old, order) + block(3, simple, order))
    assert got.frames == [ABC, ABC._replace(ts=NO_TIME)]
    assert got.sent == [True, False]
    for damaged in (
        block(2, old[:20], order),
        block(3, b"", order),
        block(2, b"\1" + old[1:], order),
    ):
        with pytest.raises(FormatError, match="a packet"):
            Got(start + damaged)


def test_blocks_that_hold_no_packet() -> None:
    lost = struct.pack("<III", 0, 0, 0) + options("<", o4=bytes(8), o5=struct.pack("<Q", 3))
    raw = START + block(4, bytes(8)) + block(10, bytes(8)) + block(0xBAD, b"what")
    raw += packet(socketcan(ABC), EPOCH) + block(5, lost) + START + block(5, lost)
    got = Got(raw)
    assert got.frames == [ABC]
    assert got.remarks == [
        "packets that the capture lost, as it tells: 6",
        "blocks of types that are not known, skipped: 1",
    ]


# ---- Which format it is.


def test_the_content_tells_the_format(tmp_path: Path) -> None:
    for raw in (head(), head(">"), START, section(">") + interface(">")):
        for name in ("x.pcap", "x.pcapng", "x.bin"):
            assert Got(raw, name, format=None).format == "pcap"
            (tmp_path / name).write_bytes(raw)
            with canser.blocks(tmp_path / name) as blocks:
                assert blocks.format == "pcap"
            with pytest.raises(canser.ForeignFormatError, match=r"capture of CAN frames.*protocol"):
                canser.read(tmp_path / name, "seeed")


def test_a_recording_stays_one(tmp_path: Path) -> None:
    path = tmp_path / "run.pcap"
    canser.write(array(ABC), path, "seeed", format="pcapng")
    with canser.blocks(path) as blocks:
        assert blocks.format == "pcapng"
    assert len(canser.read(path)) == 1
    with pytest.raises(FormatError, match="of raw bytes, not of CAN; if it is a recording"):
        canser.read(path, format="pcap")
    # Blocks of names may stand before the interface.
    raw = path.read_bytes()
    at = struct.unpack_from("<I", raw, 4)[0]
    path.write_bytes(raw[:at] + block(4, bytes(8)) + raw[at:])
    with canser.blocks(path) as blocks:
        assert blocks.format == "pcapng"
        assert len(next(blocks)) == 1


@pytest.mark.parametrize(
    ("links", "names"),
    [
        ([1], "Ethernet"),
        ([1, 212, 1], "Ethernet and LIN"),
        ([300], "link type 300"),
        (range(400, 500), " and ".join(f"link type {link}" for link in range(400, 408))),
    ],
)
def test_a_capture_of_another_network_is_named(links: list[int], names: str) -> None:
    raw = section() + b"".join(interface(link=link) for link in links) + packet(bytes(60), 0)
    with pytest.raises(canser.ForeignFormatError) as error:
        Got(raw, "x.pcapng", format=None)
    assert str(error.value) == f"x.pcapng is a capture of {names}, not of CAN; Wireshark reads it"
    with pytest.raises(canser.ForeignFormatError, match="is a capture of"):
        Got(head(link=links[0]))


def test_what_is_no_capture_is_named() -> None:
    for raw in (b"", b"\xaa\x55", bytes(100), section()):
        with pytest.raises(FormatError, match=r"^x\.pcap is no capture: it"):
            Got(raw)


# ---- Damage.


def small(name: str) -> bytes:
    """Return a capture of five frames, with directions."""
    frames = [ABC._replace(ts=EPOCH + at) for at in range(5)]
    return written(name, frames, [0, 1, 0, 1, 0], [0, 1, 1, 0, 0])[0]


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("is_file", [False, True])
def test_a_capture_cut_at_every_byte(name: str, is_file: bool, tmp_path: Path) -> None:
    raw = small(name)
    whole = Got(raw)
    size = 60 if name.endswith("ng") else 32
    for length in range(len(raw)):
        (tmp_path / name).write_bytes(raw[:length])
        path = tmp_path / name
        cut: Any = path.open("rb", buffering=0) if is_file else io.BytesIO(raw[:length])
        # The headers of the file and of both channels stand before the frames.
        left = len(raw) - 5 * size
        if length < left:
            try:
                with cut:
                    got = Got(cut)
            except FormatError as error:
                assert "\n" not in str(error)  # noqa: PT017 - most cuts of the head raise
                continue
            assert got.frames == []
            is_whole = length == left - 40
            assert got.remarks == (
                []
                if is_whole
                else [f"the last packet is cut off, and left out: {length - left + 40} bytes"]
            )
            continue
        with cut:
            got = Got(cut)
        count, behind = divmod(length - left, size)
        assert got.frames == whole.frames[:count]
        assert got.sent == whole.sent[:count]
        assert got.remarks == (
            [f"the last packet is cut off, and left out: {behind} bytes"] if behind else []
        )


@pytest.mark.parametrize("name", KINDS)
@given(data=st.data())
def test_damage_is_an_error_of_one_line_or_other_frames(name: str, data: st.DataObject) -> None:
    raw = bytearray(small(name))
    for at in data.draw(st.lists(st.integers(12, len(raw) - 1), min_size=1, max_size=4)):
        raw[at] = data.draw(st.integers(0, 255))
    frames = []
    for skip_bad in (True, False):
        try:
            frames = Got(bytes(raw), skip_bad=skip_bad).frames
        except FormatError as error:
            assert "\n" not in str(error)  # noqa: PT017 - most damage raises
    for frame in frames:
        assert frame.dlc <= 8
        assert frame.id <= (0x1FFF_FFFF if frame.ext else 0x7FF)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("length", [0, 4, 8, 11, 13, 28, 61, 2**24 + 4, 2**31, 2**32 - 4])
def test_a_length_that_no_block_has(length: int, order: str) -> None:
    good = section(order) + interface(order, **NANO) + packet(socketcan(ABC), EPOCH, order)
    raw = bytearray(good + packet(socketcan(ABC), EPOCH, order) * 2)
    struct.pack_into(f"{order}I", raw, len(good) + 4, length)
    with pytest.raises(FormatError, match=rf"^x\.pcap, byte {len(good)}: .*skip_bad=True reads"):
        Got(bytes(raw))
    got = Got(bytes(raw), skip_bad=True)
    assert got.frames == [ABC]
    assert got.remarks[0].startswith(f"cannot be read to its end: x.pcap, byte {len(good)}: ")


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("length", [2**18 + 1, 2**31, 2**32 - 1])
def test_a_length_that_no_record_has(length: int, order: str) -> None:
    good = head(order) + record(socketcan(ABC), EPOCH, order)
    bad = struct.pack(f"{order}4I", 1, 2, length, length) + bytes(100)
    with pytest.raises(FormatError, match=f"byte {len(good)}: a packet of {length:,} bytes, over"):
        Got(good + bad)
    assert Got(good + bad, skip_bad=True).frames == [ABC]


def test_lengths_within_a_block_that_do_not_fit() -> None:
    whole = packet(socketcan(ABC), EPOCH)
    for at, value, why in (
        (20, 17, "a packet of 17 bytes, which do not fit into its block"),
        (20, 2**32 - 1, "a packet of 4,294,967,295 bytes, which do not fit"),
        (len(whole) - 4, 44, "the two lengths of the block differ"),
    ):
        raw = bytearray(START + whole)
        struct.pack_into("<I", raw, len(START) + at, value)
        with pytest.raises(FormatError, match=why):
            Got(bytes(raw))
    # Options that do not fit end the options.
    odd = packet(socketcan(ABC) + struct.pack("<HHI", 1, 500, 2), EPOCH)
    raw = bytearray(START + odd)
    struct.pack_into("<I", raw, len(START) + 20, 16)
    got = Got(bytes(raw))
    assert got.frames == [ABC]
    assert got.remarks == []


def test_a_record_without_bytes_is_cut_short() -> None:
    got = Got(head() + record(b"", EPOCH) + record(socketcan(ABC), EPOCH))
    assert got.frames == [ABC]
    assert got.remarks == ["packets cut short, left out: 1"]


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("count", [1, 12, 16, 4096, 300_000])
def test_nuls_at_the_end_are_counted(name: str, count: int) -> None:
    got = Got(small(name) + bytes(count))
    assert len(got.frames) == 5
    assert got.remarks == [f"ends in {count:,} NUL bytes; was the power cut? Frames may be missing"]
    with pytest.raises(FormatError, match=f"byte {len(small(name))}"):
        Got(small(name) + bytes(count + 16) + b"x" * 20)


def test_a_version_that_is_not_known() -> None:
    with pytest.raises(FormatError, match="the section is of a version that is not known"):
        Got(section(major=2) + interface())


# ---- Pipes and memory.


class Slow(io.RawIOBase):
    """A file of which each read gives some bytes."""

    def __init__(self, raw: bytes, step: int) -> None:
        super().__init__()
        self._raw, self._step, self._at = raw, step, 0

    def readable(self) -> bool:
        return True

    def readinto(self, room: Any) -> int:
        data = self._raw[self._at : self._at + min(self._step, len(room))]
        room[: len(data)] = data
        self._at += len(data)
        return len(data)


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("step", [1, 7, 100])
def test_a_pipe_gives_the_same(name: str, step: int) -> None:
    raw = small(name)
    got, want = Got(Slow(raw, step), format=None), Got(raw)
    assert (got.frames, got.channels, got.sent) == (want.frames, want.channels, want.sent)


@pytest.mark.parametrize("name", KINDS)
def test_frames_of_a_pipe_come_as_they_arrive(name: str) -> None:
    raw = small(name)

    class Live(Slow):
        def readinto(self, room: Any) -> int:
            assert self._at < len(raw), "a reader waits for more than there is"
            return super().readinto(room)

    with Blocks(Live(raw, 50), checked_options(None)) as blocks:  # type: ignore[arg-type]
        seen = 0
        while seen < 5:
            seen += len(next(blocks))


class Endless(io.RawIOBase):
    """A capture of many blocks, of which none is kept."""

    def __init__(self, start: bytes, parts: Iterator[bytes]) -> None:
        super().__init__()
        self._parts, self._left = parts, start

    def readable(self) -> bool:
        return True

    def readinto(self, room: Any) -> int:
        if not self._left:
            self._left = next(self._parts, b"")
        data, self._left = self._left[: len(room)], self._left[len(room) :]
        room[: len(data)] = data
        return len(data)


@pytest.mark.parametrize(
    ("start", "part", "count"),
    [
        (head(), record(socketcan(ABC), EPOCH) * 2048, 400),
        (START, packet(socketcan(ABC), EPOCH, **flags(2)) * 1024, 400),
        (START, block(0xBAD, bytes(1 << 16)), 400),
        (START, packet(bytes(1 << 16), EPOCH), 400),
        (START, (section() + interface(o2=b"can0") * 100) * 4, 40),
    ],
)
def test_memory_is_bounded(start: bytes, part: bytes, count: int) -> None:
    file = Endless(start, (part for _ in range(count)))
    room = np.empty(4096, canser.FRAME_DTYPE)
    options = checked_options("pcap", out=room)
    tracemalloc.start()
    try:
        with Blocks(file, options, format="pcap") as blocks:  # type: ignore[arg-type]
            for _ in blocks:
                pass
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 3e6


def test_a_block_takes_no_memory_for_bytes_that_are_not_there(tmp_path: Path) -> None:
    path = tmp_path / "x.pcapng"
    path.write_bytes(START + struct.pack("<II", 6, 2**24) + bytes(40))
    tracemalloc.start()
    try:
        with pytest.warns(canser.CanserWarning, match="cut off"):
            canser.read(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 5e6


# ---- Wireshark's tools.


def run(*command: str | Path) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.skipif(not shutil.which("editcap"), reason="editcap of Wireshark is not installed")
@pytest.mark.parametrize("name", KINDS)
def test_wireshark_copies_what_canser_writes(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(small(name))
    want = Got(small(name))
    run("editcap", "-F", "pcapng", tmp_path / name, tmp_path / "copy.pcapng")
    got = Got((tmp_path / "copy.pcapng").read_bytes(), format=None)
    assert (got.frames, got.sent) == (want.frames, want.sent)
    assert got.channels == (want.channels if name == "x.pcapng" else ["0"] * 5)
    if name == "x.pcap":
        run("editcap", "-F", "nsecpcap", tmp_path / name, tmp_path / "copy.pcap")
        assert Got((tmp_path / "copy.pcap").read_bytes()).frames == want.frames


@pytest.mark.skipif(not shutil.which("tshark"), reason="tshark is not installed")
@pytest.mark.parametrize("name", KINDS)
def test_tshark_reads_what_canser_writes(name: str, tmp_path: Path) -> None:
    frames = [
        ABC,
        Frame(0x1FFF_FFFF, True, dlc=8, data=DATA, ts=EPOCH + 1),
        Frame(0x7, True, ts=EPOCH + 2),
        Frame(0x7FF, rtr=True, dlc=8, ts=EPOCH + 3),
    ]
    raw, _ = written(name, frames, [0, 1, 0, 1], [0, 1, 0, 1])
    (tmp_path / name).write_bytes(raw)
    fields = ["frame.time_epoch", "can.id", "can.flags.xtd", "can.flags.rtr", "can.len"]
    fields += ["frame.packet_flags_direction"] if name == "x.pcapng" else []
    wanted = [part for field in fields for part in ("-e", field)]
    lines = run("tshark", "-r", tmp_path / name, "-T", "fields", *wanted).splitlines()
    rows = []
    for at, line in enumerate(lines):
        time, number, ext, rtr, dlc, *direction = line.split("\t")
        seconds, places = time.split(".")
        flag = [value in ("1", "True") for value in (ext, rtr)]
        ts = int(seconds) * SECOND + int(places)
        rows.append(Frame(int(number, 0), flag[0], flag[1], int(dlc), False, frames[at].data, ts))
        assert [int(each, 0) for each in direction] == [[1], [2]][at % 2][: len(direction)]
    assert rows == frames
