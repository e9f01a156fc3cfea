"""ASAM MF4: there and back, python-can and asammdf as peers, files that are cut and hostile."""

import contextlib
import datetime as dt
import gzip
import io
import random
import shutil
import struct
import sys
import tempfile
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import canser
from canser._core.text import NO_CHANNEL
from canser.errors import CanserWarning, FormatError
from canser.files import mdf_blocks, mf4
from canser.files.writer import WriteOptions
from canser.simulation.traffic import vehicle
from reference import NO_TIME, Frame
from samples import EPOCH, FRAMES, SECOND, array, listed
from shared import LOG_FILES, needs_logs

asammdf = pytest.importorskip("asammdf")
can = pytest.importorskip("can")

EDGE = [
    Frame(0x123, ext=True, dlc=8, data=bytes(range(1, 9)), ts=EPOCH + 789),
    Frame(0x456, rtr=True, dlc=8, ts=EPOCH + 1_000_789),
    Frame(0x457, rtr=True, dlc=0, ts=EPOCH + 2_000_789),
    Frame(0x18FEF100, ext=True, rtr=True, dlc=4, ts=EPOCH + 3_000_789),
    Frame(0x80, err=True, dlc=8, data=bytes(range(8)), ts=EPOCH + 4_000_789),
    Frame(0x7FF, dlc=3, data=b"\xaa\x55\xbb" + bytes(5), ts=EPOCH + 5_000_789),
    Frame(0, dlc=0, ts=EPOCH + 4_500_789),
    Frame(0x1FFFFFFF, ext=True, dlc=1, data=b"\xff" + bytes(7), ts=EPOCH + 6_000_790),
    Frame(0x7DF, dlc=8, data=b"\xff" * 8, ts=EPOCH + 3600 * SECOND + 789),
]
TRAFFIC = vehicle(1)
TRAFFIC["ts"] += EPOCH
CHANNELS = np.array([0, 0, 0, 0, 0, 1, 0, 0, 1], np.uint8)
DIRECTIONS = np.array([0, 0, 0, 0, 0, 1, 0, 0, 0], np.uint8)


def tagged(path: Path, **options: Any) -> tuple[list[Frame], list[int], list[int], list[str]]:
    """Return frames with dates, their channels and directions, and the remarks."""
    frames: list[Frame] = []
    channels: list[int] = []
    directions: list[int] = []
    with canser.blocks(path, **{"epoch": "file", "tz": dt.UTC, **options}) as blocks:
        for block in blocks:
            assert blocks.channels is not None
            assert blocks.directions is not None
            frames += listed(block)
            channels += blocks.channels.tolist()
            directions += blocks.directions.tolist()
    told = [each for each in blocks.notes.remarks if "become one" not in each]
    return frames, channels, directions, [each for each in told if "direction" not in each]


def test_the_nine_edge_frames_there_and_back(tmp_path: Path) -> None:
    path = tmp_path / "x.mf4"
    with pytest.warns(CanserWarning, match="before that of others, which readers put in order: 1"):
        done = canser.write(array(*EDGE), path, channels=CHANNELS, directions=DIRECTIONS)
    assert len(done.remarks) == 1
    order = sorted(range(9), key=lambda at: EDGE[at].ts)
    assert tagged(path) == (
        [EDGE[at] for at in order],
        CHANNELS[order].tolist(),
        DIRECTIONS[order].tolist(),
        [],
    )


@settings(max_examples=30, deadline=None)
@given(frames=FRAMES, data=st.data())
def test_any_frames_there_and_back(
    frames: list[Frame], data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("mf4") / "x.mf4"
    codes = st.lists(st.integers(0, 255), min_size=len(frames), max_size=len(frames))
    channels = np.array(data.draw(codes), np.uint8)
    directions = channels % 2
    plain = np.array(array(*frames))
    plain["ts"] = EPOCH + np.arange(len(frames)) * 1_234_567_891
    canser.write(plain, path, channels=channels, directions=directions)
    got, got_channels, got_directions, remarks = tagged(path)
    assert (got, remarks) == (listed(plain), [])
    assert (got_channels, got_directions) == (channels.tolist(), directions.tolist())


def test_frames_of_equal_times_and_pieces_of_any_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mf4, "_PIECE", 1000)
    frames = canser.concat([TRAFFIC] * 3)
    frames["ts"] = EPOCH + np.arange(len(frames)) // 2 * 1000
    out = np.empty(777, canser.FRAME_DTYPE)

    def blocks() -> Any:
        for first in range(0, len(frames), len(out)):
            block = out[: len(frames) - first]  # filled again and again
            block[:] = frames[first : first + len(block)]
            yield block

    path = tmp_path / "x.mf4"
    assert canser.write(blocks(), path).remarks == []
    assert listed(canser.read(path, epoch="file")) == listed(frames)
    with canser.blocks(path, out=out) as read:
        assert [len(block) for block in read][:-1] == [777] * (len(frames) // 777)


def test_what_cannot_be_held_is_told(tmp_path: Path) -> None:
    path = tmp_path / "x.mf4"
    frames = array(
        Frame(1, rtr=True, ts=5 * SECOND),
        Frame(2, ts=5 * SECOND),
        Frame(3, err=True, ts=5 * SECOND),
        Frame(4, ts=NO_TIME),
    )
    with pytest.warns(CanserWarning) as told:
        canser.write(frames, path)
    assert [str(each.message).partition(": ")[2] for each in told] == [
        "frames without a time, written as the start: 1",
        "frames with a time before that of others, which readers put in order: 1",
        "frames of equal times and another kind, which readers put in another order: 1",
        "times count from no date; the start is written as 1970",
    ]
    with canser.blocks(path) as blocks:
        got = listed(blocks)
        assert blocks.start_ns is None
    assert [(frame.id, frame.ts) for frame in got] == [
        (4, 0), (2, 5 * SECOND), (3, 5 * SECOND), (1, 5 * SECOND),
    ]  # fmt: skip


@pytest.mark.parametrize("days", [0, 30, 48])
def test_times_are_exact_for_48_days(days: int, tmp_path: Path) -> None:
    rest = np.random.default_rng(days).integers(0, SECOND, 1000)
    frames = np.zeros(1001, canser.FRAME_DTYPE)
    frames["ts"][1:] = np.sort(days * 86_400 * SECOND + rest)
    frames["ts"] += EPOCH + 789
    canser.write(frames, tmp_path / "x.mf4")
    assert canser.read(tmp_path / "x.mf4", epoch="file")["ts"].tolist() == frames["ts"].tolist()


def test_no_frames(tmp_path: Path) -> None:
    canser.write(array(), tmp_path / "x.mf4")
    assert len(canser.read(tmp_path / "x.mf4")) == 0


def test_any_target_is_written_and_no_temporary_file_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    canser.write(TRAFFIC, tmp_path / "x.mf4", force=True)
    canser.write(TRAFFIC, tmp_path / "y.mf4.gz")
    (tmp_path / "y.mf4").write_bytes(gzip.decompress((tmp_path / "y.mf4.gz").read_bytes()))
    memory = io.BytesIO(b"before")
    memory.seek(0, io.SEEK_END)
    writer = mf4.write(memory, WriteOptions())
    writer.write(TRAFFIC)
    writer.finish()
    (tmp_path / "z.mf4").write_bytes(memory.getvalue().removeprefix(b"before"))
    for name in ("x.mf4", "y.mf4", "z.mf4"):
        assert listed(canser.read(tmp_path / name, epoch="file")) == listed(TRAFFIC)

    def broken() -> Any:
        yield canser.concat([TRAFFIC] * 100)
        raise OSError("the disk is full")

    monkeypatch.setattr(mf4, "_PIECE", 1000)
    with pytest.raises(OSError, match="the disk is full"):
        canser.write(broken(), tmp_path / "broken.mf4")
    assert not (tmp_path / "broken.mf4").exists()
    assert list(folder.iterdir()) == []


# ---- Peers: python-can and asammdf.


def messages() -> list[Any]:
    return [
        can.Message(
            timestamp=frame.ts / 1e9,
            arbitration_id=frame.id,
            is_extended_id=frame.ext,
            is_remote_frame=frame.rtr,
            is_error_frame=frame.err,
            dlc=frame.dlc,
            data=None if frame.rtr else frame.data[: frame.dlc],
            channel=int(channel),
            is_rx=not direction,
        )
        for frame, channel, direction in zip(EDGE, CHANNELS, DIRECTIONS, strict=True)
    ]


def test_python_can_reads_what_is_written(tmp_path: Path) -> None:
    path = tmp_path / "x.mf4"
    with pytest.warns(CanserWarning, match="readers put in order"):
        canser.write(array(*EDGE), path, channels=CHANNELS, directions=DIRECTIONS)
    with can.LogReader(path) as reader:
        got = sorted(reader, key=lambda each: each.timestamp)
    wanted = sorted(messages(), key=lambda each: each.timestamp)
    assert len(got) == 9
    for have, want in zip(got, wanted, strict=True):
        want.channel += 1  # python-can gives BusChannel as it is
        if have.is_error_frame:
            have.dlc = want.dlc  # python-can reads their data, and no dlc
        assert have.equals(want, timestamp_delta=1e-6, check_direction=True)


def test_what_python_can_writes_is_read(tmp_path: Path) -> None:
    path = tmp_path / "x.mf4"
    with can.MF4Writer(path) as writer:
        for message in messages():
            writer.on_message_received(message)
    got, channels, directions, remarks = tagged(path, tz=None)
    order = sorted(range(9), key=lambda at: EDGE[at].ts)
    assert remarks == []
    # python-can counts channels from 0, and its times have steps of microseconds.
    assert channels == CHANNELS[order].tolist()
    assert directions == DIRECTIONS[order].tolist()
    assert [frame.__class__(**{**vars_of(frame), "ts": 0}) for frame in got] == [
        Frame(**{**vars_of(EDGE[at]), "ts": 0}) for at in order
    ]
    for frame, at in zip(got, order, strict=True):
        assert abs(frame.ts - EDGE[at].ts) < 1_000


def vars_of(frame: Frame) -> dict[str, Any]:
    return {name: getattr(frame, name) for name in ("id", "ext", "rtr", "err", "dlc", "data", "ts")}


DBC = """VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 291 Engine: 8 ECU
 SG_ Speed : 0|16@1+ (0.5,0) [0|100] "km/h" ECU
"""


def test_asammdf_finds_the_signals_of_the_frames(tmp_path: Path) -> None:
    pytest.importorskip("canmatrix")
    (tmp_path / "x.dbc").write_text(DBC)
    frames = np.zeros(100, canser.FRAME_DTYPE)
    frames["id"], frames["dlc"], frames["ts"] = 0x123, 8, EPOCH + np.arange(100) * 1000
    frames["data"][:, 0] = np.arange(100)
    canser.write(frames, tmp_path / "x.mf4", channels=np.full(100, 2, np.uint8))
    with contextlib.closing(asammdf.MDF(tmp_path / "x.mf4")) as mdf:
        found = mdf.extract_bus_logging({"CAN": [(tmp_path / "x.dbc", 3)]})
        assert found.get("Speed").samples.tolist() == (np.arange(100) / 2).tolist()
        found.close()


# ---- Files that asammdf makes, as other programs lay them out.


def made(path: Path, kind: str, times: Any, start: dt.datetime, **fields: Any) -> Path:
    """Write a group of a kind with these fields, and nothing else."""
    record = [(f"{kind}.{name}", each.dtype, each.shape[1:]) for name, each in fields.items()]
    samples = np.zeros(len(times), np.dtype(record))
    for name, each in fields.items():
        samples[f"{kind}.{name}"] = each
    source = asammdf.Source("CAN", "CAN", "", 2, 2)
    with contextlib.closing(asammdf.MDF(version="4.10")) as mdf:
        mdf.append(asammdf.Signal(samples, np.array(times), name=kind, source=source))
        mdf.header.start_time = start
        mdf.save(path, overwrite=True)
    return path


START = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)


def column(*values: int, of: str = "<u1") -> Any:
    return np.array(values, of)


def test_fd_frames_and_impossible_ones_are_counted(tmp_path: Path) -> None:
    path = made(
        tmp_path / "x.mf4", "CAN_DataFrame", [0.0, 1.0, 2.0, 3.0, 4.0], START,
        ID=column(1, 2, 0x800, 4, 1 << 31 | 0x800, of="<u4"),
        DLC=column(15, 15, 1, 9, 1), DataLength=column(8, 64, 1, 12, 1),
        DataBytes=np.full((5, 64), 7, np.uint8), EDL=column(0, 1, 0, 0, 0),
    )  # fmt: skip
    frames, channels, directions, remarks = tagged(path)
    start_ns = int(START.timestamp()) * SECOND
    assert frames == [
        Frame(1, dlc=8, data=b"\7" * 8, ts=start_ns),
        Frame(0x800, ext=True, dlc=1, data=b"\7" + bytes(7), ts=start_ns + 4 * SECOND),
    ]
    assert (channels, directions) == ([NO_CHANNEL] * 2, [0, 0])
    assert [each.partition(": ")[2] for each in remarks] == [
        "CAN FD frames, left out: 1",
        "frames with an id or a length that classic CAN does not have, left out: 2",
    ]


def test_an_error_group_may_tell_nothing_but_a_type(tmp_path: Path) -> None:
    path = made(
        tmp_path / "x.mf4", "CAN_ErrorFrame", [-1.0, 0.5], START,
        ErrorType=column(1, 2), BusChannel=column(2, 1), Dir=np.array([b"Rx", b"Tx"]),
    )  # fmt: skip
    start_ns = int(START.timestamp()) * SECOND
    frames, channels, directions, remarks = tagged(path)
    assert frames == [
        Frame(0, err=True, ts=start_ns - SECOND),
        Frame(0, err=True, ts=start_ns + SECOND // 2),
    ]
    assert (channels, directions, remarks) == ([1, 0], [0, 1], [])


@pytest.mark.parametrize(
    ("start", "start_ns"),
    [
        (dt.datetime(2026, 1, 1, tzinfo=dt.timezone(dt.timedelta(hours=2))), -2 * 3600 * SECOND),
        (dt.datetime(2026, 1, 1), -5 * 3600 * SECOND),  # local time: of `tz`
    ],
)
def test_the_start_has_an_offset_or_is_local_time(
    start: dt.datetime, start_ns: int, tmp_path: Path
) -> None:
    path = made(tmp_path / "x.mf4", "CAN_RemoteFrame", [0.0], start, ID=column(1, of="<u4"))
    zone = dt.timezone(dt.timedelta(hours=5))
    with canser.blocks(path, tz=zone) as blocks:
        assert listed(blocks) == [Frame(1, rtr=True, ts=0)]
        assert blocks.start_ns == int(START.timestamp()) * SECOND + start_ns


def test_times_and_channels_out_of_range_are_not_told(tmp_path: Path) -> None:
    path = made(
        tmp_path / "x.mf4", "CAN_RemoteFrame", [np.nan, np.inf, 1e12, 1.0], START,
        ID=column(1, 2, 3, 4, of="<u4"), BusChannel=column(1, 256, 300, 255, of="<u2"),
    )  # fmt: skip
    frames, channels, _, remarks = tagged(path)
    assert [frame.ts for frame in frames[:3]] == [NO_TIME] * 3
    assert channels == [0, NO_CHANNEL, NO_CHANNEL, 254]
    assert [each.partition(": ")[2] for each in remarks] == [
        "frames of channels over 255, without their channel: 2",
        "frames with a time over 64 bits of nanoseconds, without it: 3",
    ]


def test_other_files_are_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "x.mf4"
    with contextlib.closing(asammdf.MDF(version="4.10")) as mdf:
        mdf.append(asammdf.Signal(np.arange(3), np.arange(3.0), name="speed"))
        mdf.save(path)
    with pytest.raises(FormatError, match=r"has no frames of a CAN bus.*asammdf reads its signals"):
        canser.read(path)
    made(path, "CAN_DataFrame", [0.0], START, ID=column(1, of="<u4"), DataLength=column(1))
    with pytest.raises(FormatError, match=r"has no channel CAN_DataFrame\.DataBytes"):
        canser.read(path)
    made(path, "CAN_DataFrame", [0.0], START, ID=np.array([b"text"]))
    with pytest.raises(FormatError, match=r"CAN_DataFrame\.ID is no number"):
        canser.read(path)
    canser.write(TRAFFIC, tmp_path / "x.mf4.gz")
    with pytest.raises(FormatError, match="cannot be a pipe or packed; put it into a file"):
        canser.read(tmp_path / "x.mf4.gz")


def test_without_asammdf_the_package_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    canser.write(TRAFFIC, tmp_path / "x.mf4")
    monkeypatch.setitem(sys.modules, "asammdf", None)
    for call in (
        lambda: canser.read(tmp_path / "x.mf4"),
        lambda: canser.write(TRAFFIC, tmp_path / "y.mf4"),
    ):
        with pytest.raises(FormatError, match=r"not installed: pip install 'canser\[mf4\]'"):
            call()
    assert [path.name for path in tmp_path.iterdir()] == ["x.mf4"]


# ---- Cut, damaged and hostile files.


def frames_or_line(path: Path) -> list[Frame]:
    """Return the frames of a file, nothing where it is a FormatError: of one line."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CanserWarning)
            return listed(canser.read(path))
    except FormatError as error:
        message = str(error)
    assert "\n" not in message
    assert str(path) in message
    return []


@needs_logs
def test_a_log_that_was_never_finalized_is_read_and_not_changed(tmp_path: Path) -> None:
    path = tmp_path / "x.mf4"
    shutil.copy(LOG_FILES / "canedge_17BD1DB7.mf4", path)
    whole = path.read_bytes()
    frames = frames_or_line(path)
    assert len(frames) == 2010
    assert path.read_bytes() == whole
    # A power cut ends the file at any byte: the frames before it are there.
    for length in (len(whole) - 1, len(whole) - 9, len(whole) // 2, 20_000):
        path.write_bytes(whole[:length])
        got = frames_or_line(path)
        assert got == frames[: len(got)]
        assert len(got) >= (length - 8_000) // 36
    with path.open("wb") as file:
        file.write(b"before" + whole)
    with path.open("rb") as file:
        file.seek(6)
        assert listed(canser.read(file)) == frames


@needs_logs
@pytest.mark.parametrize("name", ["canedge_17BD1DB7.mf4", "canedge_concat2.mf4"])
def test_records_behind_a_damaged_one_are_counted(name: str, tmp_path: Path) -> None:
    whole = (LOG_FILES / name).read_bytes()
    path = tmp_path / "x.mf4"
    half = len(whole) * 3 // 4
    path.write_bytes(whole[:half] + b"\xff\xff" + whole[half:])
    frames, *_, remarks = tagged(path)
    every, *_ = tagged(LOG_FILES / name)
    assert 0 < len(frames) < len(every)
    assert len(set(frames) - set(every)) <= 1  # the damaged one
    (left,) = [each.rpartition(": ")[2] for each in remarks if "behind a damaged one" in each]
    assert abs(int(left.replace(",", "")) - (len(whole) - half)) < 100


def test_cut_and_changed_files_are_errors_of_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.mf4"
    canser.write(TRAFFIC[:50], path)
    whole = path.read_bytes()
    for length in (64, 100, 500, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(FormatError, match=r"x\.mf4 cannot be read: byte .*cut off\?"):
            canser.read(path)
    chance = random.Random(1)
    for _ in range(60):
        changed = bytearray(whole)
        place = chance.randrange(64, len(whole) - 8) // 8 * 8
        changed[place : place + 8] = chance.randbytes(chance.choice([1, 8])).ljust(8, b"\0")
        path.write_bytes(changed)
        frames_or_line(path)
    assert capfd.readouterr() == ("", "")


def block(kind: bytes, links: list[int], data: bytes = b"") -> bytes:
    head = struct.pack("<4s4xQQ", kind, 24 + 8 * len(links) + len(data), len(links))
    return head + struct.pack(f"<{len(links)}Q", *links) + data


def file_of(*blocks: bytes) -> io.BytesIO:
    return io.BytesIO(b"MDF     4.10    ".ljust(64, b"\0") + b"".join(blocks))


HOSTILE = {
    "links come back to the block at byte 136": [
        block(b"##HD", [136, 0, 0, 0, 0, 0]), block(b"##DG", [136, 0, 0, 0]),
    ],
    "links come back to the block at byte 64": [block(b"##HD", [64, 0, 0, 0, 0, 0])],
    "a record of 4,294,967,295 bytes": [
        block(b"##HD", [136, 0, 0, 0, 0, 0]),
        block(b"##CG", [0] * 6, struct.pack("<16xHHxxxxII", 0, 0, 2**32 - 1, 0)),
    ],
    "a channel ends at byte 12 of a record of 8": [
        block(b"##HD", [136, 0, 0, 0, 0, 0]),
        block(b"##CG", [0, 240, 0, 0, 0, 0], struct.pack("<16xHHxxxxII", 0, 0, 8, 0)),
        block(b"##CN", [0] * 8, struct.pack("<BxxBII", 0, 0, 4, 64)),
    ],
    "at most 268,435,456": [
        block(b"##HD", [136, 0, 0, 0, 0, 0]),
        block(b"##DZ", [], struct.pack("<2xBxxxxxQQ", 0, 1 << 40, 0)),
    ],
    "no block begins here": [block(b"##HD", [137, 0, 0, 0, 0, 0]), bytes(99)],
    "links, and the file ends at 88": [struct.pack("<4s4xQQ", b"##HD", 24, 1 << 60)],
}  # fmt: skip


@pytest.mark.parametrize("message", HOSTILE)
def test_hostile_blocks_are_found_before_asammdf_sees_them(message: str) -> None:
    file = file_of(*HOSTILE[message])
    with pytest.raises(ValueError, match=message):
        mdf_blocks.check_blocks(file, len(file.getvalue()), is_final=True)


def test_a_block_inflates_to_what_it_says() -> None:
    packed = zlib.compress(bytes(100))
    for inflated in (99, 101):
        body = struct.pack("<2xBxxxxxQQ", 0, inflated, len(packed)) + packed
        file = file_of(block(b"##HD", [136, 0, 0, 0, 0, 0]), block(b"##DZ", [], body))
        size = len(file.getvalue())
        with pytest.raises(ValueError, match="bytes has"):
            mdf_blocks.check_blocks(file, size, is_final=True)


def test_offsets_of_data_out_of_the_file_are_found() -> None:
    data = np.frombuffer(struct.pack("<I3sI", 3, b"abc", 99) + bytes(12), np.uint8)
    offsets = np.array([0, 7, 8, 2**64 - 1, 100], np.uint64)
    cut, is_there = mf4._cut_out(data, offsets)
    assert is_there.tolist() == [True, False, False, False, False]
    assert bytes(cut[0]) == b"abc" + bytes(5)
