"""Vector's BLF: there and back, python-can as the peer, files that are cut, damaged and hostile."""

import datetime as dt
import functools
import gc
import io
import struct
import sys
import threading
import tracemalloc
import types
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser._core.text import NO_CHANNEL, Codes
from canser._frames import NO_TIME, YEAR_2000_NS, FrameArray
from canser.errors import CanserWarning, FormatError
from canser.files import blf
from canser.files.writer import WriteOptions
from canser.simulation.traffic import vehicle
from reference import Frame
from samples import EPOCH, FRAMES, MILLISECOND, SECOND, array, frames_or_error, listed
from shared import LOG_FILES, needs_logs
from test_formats_npy import Pipe
from texts import read_text

# Two containers and a part of a third one.
TRAFFIC = np.tile(vehicle(0.1), 5_000 // len(vehicle(0.1)) + 1)
TRAFFIC["ts"] = EPOCH + np.arange(len(TRAFFIC)) * MILLISECOND


def written(
    frames: FrameArray,
    channels: Codes | None = None,
    directions: Codes | None = None,
    *,
    file: io.BytesIO | None = None,
) -> tuple[bytes, list[str]]:
    """Return a file, and the remarks on what it could not hold."""
    file = file or io.BytesIO()
    writer = blf.Writer(file, dt.UTC)
    half = len(frames) // 2
    for part in (slice(half), slice(half, None)):
        codes = [None if each is None else each[part] for each in (channels, directions)]
        writer.write(frames[part], *codes)
    told = writer.finish()
    return file.getvalue(), told


def read(raw: bytes | io.BytesIO, **options: Any) -> tuple[list[Frame], list[str]]:
    return read_text(raw, "blf", "x.blf", tz=dt.UTC, **options)


def read_frames(raw: bytes) -> list[Frame]:
    return read(raw)[0]


def tagged(raw: bytes) -> tuple[list[Frame], list[int], list[int], int | None]:
    """Return frames with dates, their channels and directions, and the start."""
    frames: list[Frame] = []
    channels: list[int] = []
    directions: list[int] = []
    with canser.blocks(io.BytesIO(raw), tz=dt.UTC) as blocks:
        for block in blocks:
            assert blocks.channels is not None
            assert blocks.directions is not None
            channels += blocks.channels.tolist()
            directions += blocks.directions.tolist()
            block["ts"][block["ts"] != NO_TIME] += blocks.start_ns or 0
            frames += listed(block)
        return frames, channels, directions, blocks.start_ns


# ---- A file as bytes, made by hand.


def header(size: int = 0, start: tuple[int, ...] = (0,) * 8, length: int = 144) -> bytes:
    fields = struct.pack("<4sII4BQQII8H", b"LOGG", length, 0, 0, 0, 0, 0, size, 0, 0, 0, *start)
    return fields.ljust(length, b"\0")


def an_object(kind: int, body: bytes, time: int = 0, flags: int = 2, version: int = 1) -> bytes:
    more = bytes(8) if version == 2 else b""
    head = struct.pack("<4sHHII", b"LOBJ", 32 + len(more), version, 32 + len(more + body), kind)
    head += struct.pack("<IHHQ", flags, 0, 0, time)
    return head + more + body


def message(
    number: int = 0x123, data: bytes = b"\1\2", dlc: int | None = None, **more: Any
) -> bytes:
    length = len(data) if dlc is None else dlc
    body = struct.pack("<HBBI8s", more.pop("channel", 1), more.pop("mark", 0), length, number, data)
    return an_object(1, body, **more)


def container(content: bytes, size: int | None = None, method: int = 2) -> bytes:
    packed = zlib.compress(content) if method == 2 else content
    total = 32 + len(packed)
    inflated = len(content) if size is None else size
    head = struct.pack("<4sHHIIH6xI4x", b"LOBJ", 16, 1, total, 10, method, inflated)
    return head + packed + bytes(total % 4)


def fd(flags: int, data: bytes, *, dlc: int | None = None, mark: int = 0, room: int = 64) -> bytes:
    length = len(data) if dlc is None else dlc
    head = struct.pack("<HBBIIBBB5x", 1, mark, length, 0x123, 0, 0, flags, len(data))
    return an_object(100, head + data.ljust(room, b"\0"))


def fd_64(flags: int, data: bytes, *, dlc: int | None = None, sent: int = 0) -> bytes:
    length = len(data) if dlc is None else dlc
    head = struct.pack("<BBBBIII18xB5x", 1, length, len(data), 0, 0x123, 0, flags, sent)
    return an_object(101, head + data)


def error(number: int = 0x80, dlc: int = 2, flags: int = 0) -> bytes:
    return an_object(
        73, struct.pack("<HHIBBBxIIHH8s", 1, 0, 0, 0, 0, dlc, 0, number, flags, 0, b"\1\2")
    )


ONE = Frame(0x123, dlc=2, data=b"\1\2".ljust(8, b"\0"), ts=0)


# ---- There and back.


def kept(frame: Frame, start: int) -> Frame:
    """Return a frame as a file holds it that counts from a start."""
    ts = start if frame.ts == NO_TIME else max(frame.ts, start)
    return frame._replace(ts=ts, rtr=frame.rtr and not frame.err)


@given(FRAMES, st.data())
def test_frames_read_back_with_their_channels_and_directions(
    frames: list[Frame], data: st.DataObject
) -> None:
    def codes(most: int) -> Codes:
        numbers = st.lists(st.integers(0, most), min_size=len(frames), max_size=len(frames))
        return np.array(data.draw(numbers), np.uint8)

    channels, directions = codes(NO_CHANNEL - 1), codes(1)
    raw, told = written(array(*frames), channels, directions)
    first = next((frame.ts for frame in frames if frame.ts != NO_TIME), 0)
    start = first // MILLISECOND * MILLISECOND if first >= YEAR_2000_NS else 0
    got = tagged(raw)
    assert got == (
        [kept(frame, start) for frame in frames],
        channels.tolist(),
        directions.tolist(),
        start or None,
    )
    counts = {
        "frames without a time, written as 0": sum(frame.ts == NO_TIME for frame in frames),
        "times before the first one, written as 0": sum(
            NO_TIME < frame.ts < start for frame in frames
        ),
        "error frames that are no longer remote frames": sum(
            frame.err and frame.rtr for frame in frames
        ),
    }
    assert told == [f"{what}: {count}" for what, count in counts.items() if count]


def test_many_containers_read_back() -> None:
    channels = (np.arange(len(TRAFFIC)) % 3).astype(np.uint8)
    directions = (np.arange(len(TRAFFIC)) % 2).astype(np.uint8)
    raw, told = written(TRAFFIC, channels, directions)
    assert raw.count(b"LOBJ") >= 3
    assert not told
    assert tagged(raw)[:3] == (listed(TRAFFIC), channels.tolist(), directions.tolist())


@needs_logs
def test_the_edge_frames_read_back() -> None:
    with canser.blocks(LOG_FILES / "edge.blf", tz=dt.UTC) as blocks:
        frames = canser.concat(blocks)
        channels, directions = blocks.channels, blocks.directions
        frames["ts"] += blocks.start_ns
    want = listed(frames)
    assert len(want) == 9
    raw, told = written(frames, channels, directions)
    assert not told
    assert channels is not None
    assert directions is not None
    assert tagged(raw)[:3] == (want, channels.tolist(), directions.tolist())


def test_the_header_counts_what_is_there() -> None:
    raw, _ = written(TRAFFIC)
    fields = struct.unpack_from("<4sII4BQQII8H8H", raw)
    size, inflated, objects = fields[7:10]
    assert size == len(raw)
    assert objects == len(TRAFFIC)
    containers = 0
    place = 144
    while place < len(raw):
        _, _, _, length, kind, _, content = struct.unpack_from("<4sHHIIH6xI", raw, place)
        assert kind == 10
        assert content <= 1 << 17
        containers += 32 + content
        place += length + length % 4
    assert place == len(raw)
    assert inflated == 144 + containers
    # Thursday, as 6 December 2018 was.
    assert fields[11:19] == (2018, 12, 4, 6, 14, 31, 19, 432)
    last = (EPOCH + (len(TRAFFIC) - 1) * MILLISECOND) // MILLISECOND % 1000
    assert fields[26] == last


def test_a_start_is_of_the_zone_that_is_given(tmp_path: Path) -> None:
    path = tmp_path / "run.blf"
    zone = dt.timezone(dt.timedelta(hours=-5))
    canser.write(TRAFFIC, path, tz=zone)
    assert canser.read(path, epoch="file", tz=zone).tobytes() == TRAFFIC.tobytes()
    moved = canser.read(path, epoch="file", tz=dt.UTC)
    assert int(moved["ts"][0]) == EPOCH - 5 * 3600 * SECOND


def test_times_without_a_date_have_no_start() -> None:
    frames = array(Frame(1, ts=5), Frame(2, ts=7 * SECOND + 1))
    raw, told = written(frames)
    assert tagged(raw)[3] is None
    assert read_frames(raw) == listed(frames)
    assert not told


def test_a_log_without_frames_is_one() -> None:
    raw, told = written(TRAFFIC[:0])
    assert len(raw) == 144
    assert read(raw) == ([], [])
    assert not told


def test_a_pipe_gets_the_same_bytes_as_a_file() -> None:
    pipe = Pipe()
    assert written(TRAFFIC, file=pipe)[0] == written(TRAFFIC)[0]


def test_a_file_is_written_from_where_it_stands() -> None:
    file = io.BytesIO(b"before")
    file.seek(0, io.SEEK_END)
    assert written(TRAFFIC, file=file)[0] == b"before" + written(TRAFFIC)[0]


def test_a_frame_that_is_none_of_classic_can_is_named() -> None:
    frames = TRAFFIC.copy()
    frames["dlc"][4_000] = 9
    with pytest.raises(ValueError, match="frame 4000 is none of classic CAN: "):
        written(frames)


def test_the_array_of_the_caller_is_filled() -> None:
    raw, _ = written(TRAFFIC)
    out = np.empty(999, canser.FRAME_DTYPE)
    got = [canser.concat([block]) for block in canser.blocks(io.BytesIO(raw), out=out)]
    assert {len(block) for block in got[:-1]} == {999}
    assert canser.concat(got)["id"].tolist() == TRAFFIC["id"].tolist()


def test_one_bus_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "run.blf"
    channels = (np.arange(len(TRAFFIC)) % 3).astype(np.uint8)
    canser.write(TRAFFIC, path, channels=channels, tz=dt.UTC)
    with pytest.warns(CanserWarning, match="frames of other buses, left out: "):
        got = canser.read(path, bus="2")
    assert got["id"].tolist() == TRAFFIC["id"][1::3].tolist()


# ---- python-can as the peer.


def to_message(can: Any, frame: Frame, channel: int, sent: bool) -> Any:
    return can.Message(
        timestamp=frame.ts / 1e9,
        arbitration_id=frame.id,
        is_extended_id=frame.ext,
        is_remote_frame=frame.rtr,
        is_error_frame=frame.err,
        dlc=frame.dlc,
        data=b"" if frame.rtr else frame.data[: frame.dlc],
        channel=channel,
        is_rx=not sent,
    )


def peer_frames() -> tuple[list[Frame], list[int], list[bool]]:
    """Return frames of each kind, with times that a float64 of seconds holds to the microsecond."""
    kinds = [(ext, rtr, err) for ext in (0, 1) for rtr, err in ((0, 0), (1, 0), (0, 1))]
    frames = [
        Frame(
            0x7FF & ~at, bool(ext), bool(rtr), at % 9, bool(err),
            (b"" if rtr else bytes(range(1, 1 + at % 9))).ljust(8, b"\0"),
            EPOCH + at * MILLISECOND,
        )
        for at, (ext, rtr, err) in enumerate(kinds * 500)
    ]  # fmt: skip
    # python-can's file has no direction of error frames.
    sent = [at % 2 == 0 and not frame.err for at, frame in enumerate(frames)]
    return frames, [at % 4 for at in range(len(frames))], sent


class Kept(io.BytesIO):
    """A file whose bytes outlive its closing by python-can."""

    def close(self) -> None:
        pass


def test_python_can_reads_what_is_written() -> None:
    can = pytest.importorskip("can")
    frames, channels, sent = peer_frames()
    raw, _ = written(array(*frames), np.array(channels, np.uint8), np.array(sent, np.uint8))
    reader = can.BLFReader(io.BytesIO(raw))
    assert reader.object_count == len(frames)
    assert reader.file_size == len(raw)
    got = list(reader)
    assert len(got) == len(frames)
    for have, frame, channel, is_sent in zip(got, frames, channels, sent, strict=True):
        want = to_message(can, frame, channel, is_sent)
        if frame.err:  # python-can gives all eight bytes, and tells no direction
            have.data, have.is_rx = have.data[: frame.dlc], want.is_rx
        assert have.equals(want, timestamp_delta=1e-6), (have, want)


def test_what_python_can_writes_is_read() -> None:
    can = pytest.importorskip("can")
    frames, channels, sent = peer_frames()
    file = Kept()
    with can.BLFWriter(file) as writer:
        for frame, channel, is_sent in zip(frames, channels, sent, strict=True):
            writer.on_message_received(to_message(can, frame, channel, is_sent))
    got, got_channels, got_directions, start = tagged(file.getvalue())
    assert start == EPOCH // MILLISECOND * MILLISECOND
    assert [frame._replace(ts=0) for frame in got] == [frame._replace(ts=0) for frame in frames]
    assert got_channels == channels
    assert got_directions == sent
    off = [abs(have.ts - frame.ts) for have, frame in zip(got, frames, strict=True)]
    assert max(off) < 1_000


# ---- What objects say.


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("kind", [1, 86])
def test_messages(kind: int, version: int) -> None:
    body = struct.pack("<HBBI8s", 300, 0x81, 4, 0x8000_0123, b"junkjunk") + bytes(8)
    raw = header() + container(an_object(kind, body, 7, 1, version))
    frames, channels, directions, _ = tagged(raw)
    assert frames == [Frame(0x123, True, True, 4, ts=70_000)]
    assert channels == [NO_CHANNEL]
    assert directions == [1]
    assert read(raw)[1][-1] == "frames of channels over 255, without their channel: 1"


def test_data_is_zero_past_the_dlc() -> None:
    body = struct.pack("<HBBI8s", 1, 0, 2, 0x123, b"\1\2junkjk")
    assert read_frames(header() + an_object(1, body)) == [ONE]


@pytest.mark.parametrize("dlc", range(9, 16))
def test_a_raw_dlc_means_eight_bytes(dlc: int) -> None:
    (frame,) = read_frames(header() + message(data=b"12345678", dlc=dlc))
    assert frame.dlc == 8
    assert frame.data == b"12345678"


@pytest.mark.parametrize("odd", [message(dlc=16), message(0x800), message(0xA000_0000)])
def test_a_frame_that_cannot_be_is_counted(odd: bytes) -> None:
    frames, told = read(header() + odd + message())
    assert frames == [ONE]
    assert told == ["frames with an id or a dlc that classic CAN does not have, left out: 1"]


def test_error_frames() -> None:
    old = an_object(2, struct.pack("<HHI", 2, 0, 0), 5)
    frames, channels, directions, _ = tagged(
        header() + container(error() + error(0x1_0080, flags=0x4000) + old)
    )
    data = b"\1\2".ljust(8, b"\0")
    assert frames == [
        Frame(0x80, False, False, 2, True, data, 0),
        Frame(0x1_0080, True, False, 2, True, data, 0),
        Frame(0, False, False, 0, True, bytes(8), 5),
    ]
    assert channels == [0, 0, 1]
    assert directions == [0, 1, 0]
    frames, told = read(header() + error(0x4000_0080) + error(dlc=102))
    assert [(frame.id, frame.dlc) for frame in frames] == [(0x80, 2), (0x80, 8)]
    assert told == ["error frames with such an id or dlc, cut to the limit: 2"]


def test_classic_frames_of_channels_of_can_fd() -> None:
    eight = b"12345678"
    classic = [
        fd(0, b"\1\2"), fd(0, b"\1\2", room=2), fd(0, b"", dlc=3, mark=0x80), fd(0, eight, dlc=11),
        fd_64(0, b"\1\2"), fd_64(0x10, b"", dlc=3, sent=1), fd_64(0, eight, dlc=15),
    ]  # fmt: skip
    real = [fd(1, b"\1\2"), fd(1, bytes(64), dlc=15), fd_64(0x1000, bytes(12), dlc=9)]
    real.append(an_object(104, bytes(8)))
    frames, _, directions, _ = tagged(header() + container(b"".join(real + classic + real)))
    remote, full = Frame(0x123, False, True, 3, ts=0), Frame(0x123, dlc=8, data=eight, ts=0)
    assert frames == [ONE, ONE, remote, full, ONE, remote, full]
    assert directions == [0, 0, 0, 0, 0, 1, 0]
    odd = [fd(0, bytes(12), dlc=9), fd_64(0, bytes(12), dlc=9)]  # no EDL, and more than 8 bytes
    _, told = read(header() + container(b"".join(real + odd)))
    assert told == [
        "CAN FD frames, left out: 4",
        "frames with an id or a dlc that classic CAN does not have, left out: 2",
    ]


def test_other_objects_are_passed_over() -> None:
    others = [an_object(kind, bytes(24)) for kind in (3, 4, 11, 31, 44, 65, 74, 96, 115, 999)]
    short = struct.pack("<4sHHII", b"LOBJ", 16, 1, 16, 5)
    content = short.join([*others, message(), b""]) + message()
    assert read(header() + container(content)) == ([ONE, ONE], [])
    assert read(header() + content) == ([ONE, ONE], [])


@pytest.mark.parametrize(
    ("time", "flags", "ts"),
    [
        (2**63 - 1, 2, 2**63 - 1),
        (2**63, 2, NO_TIME),
        ((2**63 - 1) // 10_000, 1, (2**63 - 1) // 10_000 * 10_000),
        ((2**63 - 1) // 10_000 + 1, 1, NO_TIME),
    ],
)
def test_times_are_whole_numbers(time: int, flags: int, ts: int) -> None:
    frames, told = read(header() + message(time=time, flags=flags))
    assert frames == [ONE._replace(ts=ts)]
    lost = ["frames with a time over 64 bits of nanoseconds, without it: 1"]
    assert told == (lost if ts == NO_TIME else [])


def test_objects_are_joined_and_stand_anywhere() -> None:
    """Cut by containers at every byte, stored and packed, with others outside of them."""
    content = b"".join(message(0x100 + at, time=at) for at in range(4))
    want = [ONE._replace(id=0x100 + at, ts=at) for at in range(4)]
    for cut in range(len(content)):
        raw = (
            header()
            + container(content[:cut], method=cut % 2 * 2)
            + container(b"")
            + container(content[cut : cut + 1])
            + container(content[cut + 1 :], method=0)
        )
        assert read(raw) == (want, []), cut
    bare = header() + message() + container(content) + message()
    assert read_frames(bare) == [ONE, *want, ONE]


@pytest.mark.parametrize("padding", range(9))
def test_padding_of_any_kind(padding: int) -> None:
    content = (message() + bytes(padding)) * 3
    assert read(header() + container(content)) == ([ONE] * 3, [])
    assert read(header() + content) == ([ONE] * 3, [])


def test_a_longer_header_is_passed_over() -> None:
    assert read_frames(header(length=208) + message()) == [ONE]


@pytest.mark.parametrize(
    ("date", "told"),
    [
        ((0,) * 8, []),
        ((2026, 13, 0, 1, 0, 0, 0, 0), ["its date cannot be read"]),
        ((9999, 1, 0, 1, 0, 0, 0, 0), ["its date cannot be read"]),
        ((1601, 1, 0, 1, 0, 0, 0, 0), ["its date cannot be read"]),
        ((2026, 1, 0, 1, 0, 0, 0, 1000), ["its date cannot be read"]),
    ],
)
def test_a_start_that_is_no_date(date: tuple[int, ...], told: list[str]) -> None:
    raw = header(start=date) + message()
    assert read(raw) == ([ONE], told)
    assert tagged(raw)[3] is None


# ---- Files that are cut.

CUT = ["the file is cut off; frames may be missing"]


def test_a_file_that_is_cut_at_any_byte_gives_what_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "cut.blf"
    frames = array(*(Frame(0x100 + at, dlc=8, data=b"12345678", ts=EPOCH + at) for at in range(50)))
    raw, _ = written(frames)
    whole = listed(frames)
    counts = set()
    for size in range(len(raw)):
        path.write_bytes(raw[:size])
        for source in (raw[:size], path):
            if size < 144:
                if size >= 72:
                    assert read(raw[:size]) == ([], CUT)
                else:
                    with pytest.raises(FormatError):
                        read(raw[:size])
                continue
            with canser.blocks(
                io.BytesIO(source) if isinstance(source, bytes) else source, tz=dt.UTC
            ) as blocks:
                got = [
                    frame._replace(ts=frame.ts + (blocks.start_ns or 0)) for frame in listed(blocks)
                ]
                assert got == whole[: len(got)]
                assert [each.partition(": ")[2] for each in blocks.notes.remarks] == CUT
            counts.add(len(got))
    assert len(counts) > 10  # the last container is inflated as far as it goes


def test_a_stream_that_ends_within_an_object_is_cut() -> None:
    assert read(header() + container(message() + message()[:-1])) == ([ONE], CUT)
    assert read(header() + container(message() + b"LO")) == ([ONE], CUT)
    assert read(header() + message() + message()[:-1]) == ([ONE], CUT)
    assert read(header() + container(message() + bytes(11))) == ([ONE], [])


def test_a_header_that_says_more_bytes_is_of_a_file_that_is_cut() -> None:
    raw = message()
    assert read(header(144 + len(raw)) + raw) == ([ONE], [])
    assert read(header(144 + len(raw) + 1) + raw) == ([ONE], CUT)


def test_nuls_at_the_end_are_counted() -> None:
    raw = header() + message()
    told = ["ends in 4,096 NUL bytes; was the power cut? Frames may be missing"]
    assert read(raw + bytes(4096)) == ([ONE], told)
    with pytest.raises(FormatError, match="no object begins here"):
        read(raw + bytes(4096) + message())
    assert read(raw + bytes(4096) + message(), skip_bad=True)[0] == [ONE, ONE]


def test_many_nuls_within_a_file_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "x.blf"
    for count in (3 << 20, (3 << 20) + 4097):
        path.write_bytes(header() + message() + bytes(count) + message())
        with pytest.warns(CanserWarning, match="damaged parts, left out: 1; the first is byte 192"):
            assert listed(canser.read(path, skip_bad=True)) == [ONE, ONE]
        with pytest.raises(FormatError, match="byte 192: no object begins here"):
            canser.read(path)


# ---- Files that are damaged.

LONG = struct.pack("<4sHHII", b"LOBJ", 32, 1, 0xFFFF_FFF0, 1).ljust(48, b"\0")
BOMB = container(bytes(1 << 20), 1 << 10)

DAMAGED = {
    "no object": (b"junk" * 8, "no object begins here: b'junkjunk' is not b'LOBJ'"),
    "a small object": (
        struct.pack("<4sHHII", b"LOBJ", 16, 1, 15, 999).ljust(32, b"\0"),
        "an object of type 999 has 15 bytes: too few for its type, or over 16,777,216",
    ),
    "size 0": (struct.pack("<4sHHII", b"LOBJ", 16, 1, 0, 1).ljust(32, b"\0"), "has 0 bytes"),
    "a large object": (LONG, "has 4,294,967,280 bytes"),
    "a small message": (an_object(1, bytes(15)), "type 1 has 47 bytes"),
    "a small error frame": (an_object(73, bytes(31)), "type 73 has 63 bytes"),
    "an old one": (an_object(2, bytes(3)), "type 2 has 35 bytes"),
    "a small FD object": (an_object(100, bytes(19)), "type 100 has 51 bytes"),
    "FD data that is not there": (
        an_object(100, struct.pack("<HBBIIBBB5x", 1, 0, 7, 1, 0, 0, 0, 7) + bytes(6)),
        "type 100 has 58 bytes",
    ),
    "a small FD 64 object": (an_object(101, bytes(39)), "type 101 has 71 bytes"),
    "a small header": (
        struct.pack("<4sHHII", b"LOBJ", 16, 1, 48, 1).ljust(48, b"\0"),
        "type 1 has 48 bytes",
    ),
}

IN_FILE = {
    "a small container": (
        struct.pack("<4sHHII", b"LOBJ", 16, 1, 31, 10).ljust(32, b"\0"),
        "an object of type 10 has 31 bytes",
    ),
    "a method": (container(b"", method=7), "a container has the method 7; 0 and 2 are known"),
    "no zlib": (container(b"", 5, 2)[:32] + b"\0" * 8, "a container cannot be inflated"),
    "a bomb": (BOMB, "inflates to more than 1,024 bytes"),
    "a large one": (container(b"", 1 << 25), "has 33,554,432 bytes inflated"),
    "less than it says": (container(b"123", 4), "inflates to 3 bytes, and says it has 4"),
}


@pytest.mark.parametrize("name", DAMAGED)
@pytest.mark.parametrize("inside", [False, True])
def test_damage_is_an_error_with_its_place_behind_the_frames(name: str, inside: bool) -> None:
    part, words = DAMAGED[name]
    content = message() + part + message()
    raw = header() + (container(content) if inside else content)
    where = "x.blf, the container at byte 144, byte 48 of all" if inside else "x.blf, byte 192: "
    check_damage(raw, where, words)


@pytest.mark.parametrize("name", IN_FILE)
def test_a_damaged_container_is_an_error_with_its_place(name: str) -> None:
    part, words = IN_FILE[name]
    check_damage(header() + message() + part + container(message()), "x.blf, byte 192: ", words)


def test_a_container_in_a_container_is_damage() -> None:
    raw = header() + container(message() + container(b"") + message())
    check_damage(raw, "x.blf, the container at byte 144, byte 48 of", "container within a contain")


def check_damage(raw: bytes, where: str, words: str) -> None:
    """Assert that a frame, damage and a frame are read as they have to be."""
    file = io.BytesIO(raw)
    file.name = "x.blf"
    blocks = canser.blocks(file)
    assert listed(next(blocks)) == [ONE]
    with pytest.raises(FormatError) as error:
        next(blocks)
    assert str(error.value).startswith(where)
    assert words in str(error.value)
    assert "\n" not in str(error.value)
    frames, (told,) = read(raw, skip_bad=True)
    assert frames == [ONE, ONE]
    assert told.startswith(f"damaged parts, left out: 1; the first is {where[7:]}")
    assert words in told


def test_an_object_behind_a_damaged_container_is_searched() -> None:
    """Its own part of an object is lost, and so are the parts before and behind it."""
    content = b"".join(message(0x100 + at) for at in range(6))
    parts = [container(content[at : at + 72]) for at in range(0, len(content), 72)]
    parts[1] = parts[1][:-12] + b"\xff" * 12
    frames, told = read(header() + b"".join(parts), skip_bad=True)
    assert [frame.id for frame in frames] == [0x100, 0x103, 0x104, 0x105]
    assert told[0].startswith("damaged parts, left out: 1; the first is byte ")


@pytest.mark.parametrize("raw", [b"", b"LOG", b"LOGG", header()[:71], b"(1.0) can0 1#\n"])
def test_what_is_no_log_is_named_so(raw: bytes) -> None:
    with pytest.raises(FormatError, match=r"^x\.blf: (begins with|is cut off in its header)"):
        read(raw)


@pytest.mark.parametrize("length", [0, 71, 65_537, 2**32 - 1])
def test_the_length_of_the_header_is_bounded(length: int) -> None:
    raw = header()[:4] + struct.pack("<I", length) + header()[8:]
    with pytest.raises(FormatError, match=f"says that its header has {length:,} bytes"):
        read(raw)


SMALL = written(TRAFFIC[:200])[0] + message() + fd(0, b"1") + fd_64(0, b"1") + error()


@given(st.lists(st.tuples(st.integers(0, len(SMALL) - 1), st.integers(0, 255)), max_size=4))
def test_damage_is_frames_or_a_format_error(changes: list[tuple[int, int]]) -> None:
    raw = bytearray(SMALL)
    for place, value in changes:
        raw[place] = value
    got = frames_or_error(read_frames, bytes(raw))
    frames_or_error(lambda each: read(each, skip_bad=True)[0], bytes(raw))
    assert all(frame.dlc <= 8 for frame in got)


@given(st.binary() | st.binary().map(header().__add__))
def test_any_bytes_are_frames_or_a_format_error(raw: bytes) -> None:
    frames_or_error(read_frames, raw)


def peak(raw: bytes, **options: Any) -> int:
    """Return the most bytes that reading takes, beside the file itself."""
    file = io.BytesIO(raw)
    gc.collect()
    tracemalloc.start()
    try:
        with canser.blocks(file, tz=dt.UTC, **options) as blocks:
            for _ in blocks:
                pass
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_does_not_grow_with_the_file() -> None:
    part = written(TRAFFIC)[0][144:]
    few, many = (peak(header() + part * count) for count in (30, 120))
    assert many < few + (1 << 20)


def test_memory_is_bounded_for_hostile_sizes() -> None:
    # Containers of 16 MiB of zeros in 16 KiB, and one that does not say how much it has.
    bomb = container(an_object(999, bytes((1 << 24) - 32)))
    assert peak(header() + bomb * 4) < 100 << 20
    liar = container(bytes(1 << 26), 1 << 10)
    assert peak(header() + liar * 4, skip_bad=True) < 8 << 20


def test_an_object_in_many_small_containers_takes_no_time_that_grows_faster() -> None:
    """Each is joined once: otherwise this would copy 25 GB."""
    content = an_object(999, bytes(1 << 20)) + message()
    pieces = [content[at : at + 20] for at in range(0, len(content), 20)]
    raw = header() + b"".join(container(piece, method=0) for piece in pieces)
    assert read(raw) == ([ONE], [])


def test_many_damaged_places_take_no_time_that_grows_faster() -> None:
    """Of each a few bytes are searched: otherwise this would copy 10 GB."""
    places = 10_000
    for part in (b"LOBJ" * 7, b"LOBJ".ljust(28, b"\0"), b"LOBJ".rjust(28, b"\0")):
        frames, (told,) = read(header() + part * places + bytes(12) + message(), skip_bad=True)
        assert frames == [ONE]
        assert told.startswith("damaged parts, left out: ")


# ---- isal, which is not needed.


def test_isal_packs_and_unpacks_where_it_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    made, packed = [], []

    class Error(Exception):
        """Of isal's own, as there."""

    class Inflater:
        def __init__(self) -> None:
            self._own = zlib.decompressobj()
            made.append(self)

        def decompress(self, data: bytes, most: int) -> bytes:
            try:
                return self._own.decompress(data, most)
            except zlib.error as error:
                raise Error(error) from None

    def compress(data: bytes, level: int) -> bytes:
        packed.append(zlib.compress(data, level))
        return packed[-1]

    package, module = types.ModuleType("isal"), types.ModuleType("isal.isal_zlib")
    module.compress = compress  # type: ignore[attr-defined]
    module.decompressobj, module.error = Inflater, Error  # type: ignore[attr-defined]
    package.isal_zlib = module  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "isal", package)
    monkeypatch.setitem(sys.modules, "isal.isal_zlib", module)
    raw, _ = written(TRAFFIC)
    assert len(read_frames(raw)) == len(TRAFFIC)
    assert len(made) == len(packed) >= 2
    assert all(each in raw for each in packed)
    with pytest.raises(FormatError, match="cannot be inflated"):
        read(header() + IN_FILE["no zlib"][0])


@functools.cache
def many_containers() -> bytes:
    file = io.BytesIO()
    writer = blf.write(file, WriteOptions())
    writer.write(np.tile(vehicle(10), 4))
    writer.finish()
    return file.getvalue()


@given(
    changes=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), max_size=3),
    cut=st.one_of(st.none(), st.floats(0, 1)),
    skip_bad=st.booleans(),
)
def test_damage_is_the_same_for_any_number_of_threads(
    changes: list[tuple[float, int]],
    cut: float | None,
    skip_bad: bool,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    raw = bytearray(many_containers())
    assert raw.count(b"LOBJ") > 8
    for place, value in changes:
        raw[144 + int(place * (len(raw) - 144))] = value
    path = tmp_path_factory.mktemp("threads") / "x.blf"
    path.write_bytes(raw if cut is None else raw[: int(cut * len(raw))])

    def outcome(threads: int) -> tuple[list[bytes], object]:
        seen: list[bytes] = []
        try:
            blocks = canser.blocks(path, format="blf", skip_bad=skip_bad, threads=threads)
            seen.extend(block.tobytes() for block in blocks)
        except FormatError as error:
            return [b"".join(seen)], str(error)
        return [b"".join(seen)], blocks.notes.all_lines

    assert outcome(3) == outcome(1)
    assert not [each for each in threading.enumerate() if each.name == "canser unpacking"]
