"""From raw bytes to every format and back, and what a conversion remarks."""

import io
import re
from pathlib import Path

import numpy as np
import pytest

import canser
from canser._frames import FrameArray
from canser.errors import FormatError
from canser.files.formats import RAW, find_format, format_of_name
from canser.files.reader import ReadOptions
from canser.files.reading import Blocks
from canser.files.writer import WriteOptions
from canser.files.writing import Converted, convert_opened
from canser.simulation.traffic import vehicle
from reference import NO_TIME, WIRE_FORMATS, Frame
from samples import EPOCH, MICROSECOND, MILLISECOND, SECOND, array, listed, timed

FORMATS = ["npy", "csv", "candump"]
SUFFIXES = {name: find_format(name).suffixes[0] for name in FORMATS}
PROTOCOLS = canser.protocols()


def traffic(protocol: str) -> FrameArray:
    return vehicle(1, extended=WIRE_FORMATS[protocol].has_ext)


def decoded(
    path: Path, raw: bytes, protocol: str, to: str, *, ts_unit: str = "ms"
) -> tuple[Path, Converted]:
    """Convert raw bytes into a file of frames beside `path`."""
    path.write_bytes(raw)
    target = path.with_name(f"frames{SUFFIXES[to]}")
    options = ReadOptions(protocol=protocol, ts_unit=ts_unit)
    with Blocks(path, options, format=RAW) as source, target.open("wb") as file:
        return target, convert_opened(source, file, to, WriteOptions())


def encoded(
    path: Path, protocol: str, *, ts_unit: str = "ms", strict: bool = False
) -> tuple[bytes, Converted]:
    """Convert a file of frames into raw bytes."""
    out = io.BytesIO()
    options = WriteOptions(protocol=protocol, ts_unit=ts_unit, strict=strict)
    with Blocks(path, ReadOptions()) as source:
        done = convert_opened(source, out, RAW, options)
    return out.getvalue(), done


def saved(path: Path, *blocks: FrameArray) -> Path:
    """Write a file of frames."""
    with path.open("wb") as file:
        writer = find_format(format_of_name(path.name) or "").write(file, WriteOptions())
        for frames in blocks:
            writer.write(frames)
        writer.finish()
    return path


@pytest.mark.parametrize("to", FORMATS)
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_raw_bytes_come_back_from_every_format(tmp_path: Path, protocol: str, to: str) -> None:
    raw = canser.encode(traffic(protocol), protocol)
    path, done = decoded(tmp_path / "run.bin", raw, protocol, to)
    assert done.frames == len(traffic(protocol))
    again, done = encoded(path, protocol)
    assert again == raw
    assert (done.frames, done.bytes_out) == (len(traffic(protocol)), len(raw))


@pytest.mark.parametrize("to", FORMATS)
@pytest.mark.parametrize("unit", ["s", "ms", "us"])
def test_a_clock_that_wraps_or_steps_back_comes_back(tmp_path: Path, to: str, unit: str) -> None:
    """Unwrapped, times go over 32 bits or under zero; what the device sent is the same."""
    ticks = [5, 2, 2**32 - 3, 2**31, 2**32 - 1, 0, 7, 6]
    raw = b"".join(
        b"\xaa" + tick.to_bytes(4, "little") + bytes.fromhex("00 23010000 BB") for tick in ticks
    )
    path, done = decoded(tmp_path / "run.bin", raw, "serial", to, ts_unit=unit)
    assert done.frames == len(ticks)
    assert encoded(path, "serial", ts_unit=unit)[0] == raw


@pytest.mark.parametrize("to", ["npy", "csv"])
def test_nanoseconds_come_back_where_the_format_holds_them(tmp_path: Path, to: str) -> None:
    raw = canser.encode(timed(1, 22, 333, 4_444_444_444), "serial", ts_unit="ns")
    path, done = decoded(tmp_path / "run.bin", raw, "serial", to, ts_unit="ns")
    assert done.remarks == []
    # The device's counter has 32 bits, and wraps at every 4.3 seconds.
    assert encoded(path, "serial", ts_unit="ns")[0] == raw


@pytest.mark.parametrize("back", FORMATS)
@pytest.mark.parametrize("to", FORMATS)
def test_frames_come_back_from_every_format_by_way_of_every_other(
    tmp_path: Path, to: str, back: str
) -> None:
    frames = vehicle(1)
    first = saved(tmp_path / f"first{SUFFIXES[to]}", frames)
    second = tmp_path / f"second{SUFFIXES[back]}"
    assert canser.convert(first, second) == Converted(frames=len(frames))
    assert canser.read(second).tobytes() == frames.tobytes()


@pytest.mark.parametrize("to", FORMATS)
def test_no_frames_convert_to_none(tmp_path: Path, to: str) -> None:
    path = saved(tmp_path / f"x{SUFFIXES[to]}", array())
    assert encoded(path, "serial") == (b"", Converted())
    path, done = decoded(tmp_path / "run.bin", b"", "serial", to)
    assert done == Converted()
    assert listed(canser.blocks(path)) == []


def test_a_log_remarks_the_times_that_it_cannot_hold(tmp_path: Path) -> None:
    path = saved(tmp_path / "x.npy", timed(NO_TIME, NO_TIME, 1, MICROSECOND, SECOND + 999))
    with Blocks(path, ReadOptions()) as source:
        done = convert_opened(source, io.BytesIO(), "candump", WriteOptions())
    assert done.remarks == [
        "frames without a time, written as 0: 2",
        "times cut to the microsecond: 2",
    ]


@pytest.mark.parametrize("protocol", ["seeed", "cantalope"])
def test_a_protocol_without_a_clock_is_remarked(tmp_path: Path, protocol: str) -> None:
    path = saved(tmp_path / "x.npy", timed(EPOCH))
    assert encoded(path, protocol)[1].remarks == [f"{protocol} carries no times"]


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_times_of_day_go_out_from_the_first_frame_on(tmp_path: Path, unit: str) -> None:
    path = saved(tmp_path / "x.npy", timed(EPOCH, EPOCH + SECOND), timed(EPOCH + 2 * SECOND))
    raw, done = encoded(path, "serial", ts_unit=unit)
    assert canser.decode(raw, "serial", ts_unit=unit)["ts"].tolist() == [0, SECOND, 2 * SECOND]
    assert done.remarks == ["times are written relative to the first frame"]


def test_times_of_day_go_out_from_the_first_of_all_blocks_on(tmp_path: Path) -> None:
    count = 150_000
    path = saved(tmp_path / "x.npy", timed(EPOCH).repeat(count))
    stored = np.load(path, mmap_mode="r+")
    stored["ts"] += np.arange(count) * MILLISECOND
    stored.flush()
    raw, done = encoded(path, "serial")
    assert done.frames == count
    assert (canser.decode(raw, "serial")["ts"] == np.arange(count) * MILLISECOND).all()


@pytest.mark.parametrize("first", [0, 2**32 * MILLISECOND - 1])
def test_times_that_the_clock_can_count_go_out_as_they_are(tmp_path: Path, first: int) -> None:
    path = saved(tmp_path / "x.npy", timed(first, first + 2 * SECOND))
    raw, done = encoded(path, "serial")
    assert done.remarks == []
    assert raw == canser.encode(timed(first, first + 2 * SECOND), "serial")


@pytest.mark.parametrize("first", [-1, 2**32 * MILLISECOND])
def test_the_first_times_that_the_clock_cannot_count_are_moved(tmp_path: Path, first: int) -> None:
    path = saved(tmp_path / "x.npy", timed(first))
    raw, done = encoded(path, "serial")
    assert raw == canser.encode(timed(0), "serial")
    assert done.remarks == ["times are written relative to the first frame"]


@pytest.mark.parametrize("first", [0, EPOCH])
def test_strict_names_a_frame_that_cannot_be_encoded_by_its_index_in_the_file(
    tmp_path: Path, first: int
) -> None:
    # In the second block, whose own index of it is 34,464.
    frames = timed(first).repeat(100_001)
    frames["ts"][100_000] = NO_TIME
    path = saved(tmp_path / "x.npy", frames)
    with pytest.raises(ValueError, match=r"\b100000\b"):
        encoded(path, "serial", strict=True)


@pytest.mark.parametrize(
    ("frame", "protocol"),
    [
        (Frame(0x800, ext=True, ts=0), "cantalope"),
        (Frame(0x1, err=True, ts=0), "cantalope"),
        (Frame(0x1, err=True, ts=0), "seeed"),
        (Frame(0x1), "serial"),
    ],
)
def test_strict_refuses_what_a_protocol_cannot_carry(
    tmp_path: Path, frame: Frame, protocol: str
) -> None:
    path = saved(tmp_path / "x.npy", array(Frame(0x1, ts=0), frame))
    with pytest.raises(ValueError, match=r"\b1\b"):
        encoded(path, protocol, strict=True)


def test_what_a_protocol_cannot_carry_is_left_out_and_counted(tmp_path: Path) -> None:
    good = timed(0, 1, 2, 3)
    error, extended = Frame(0x1, err=True, ts=0), Frame(0x800, ext=True, ts=0)
    # Of the first block, which has 65,536 frames, none can be carried.
    first = array(error).repeat(70_000)
    path = saved(tmp_path / "x.npy", first, good[:1], array(error, extended), good[1:])
    raw, done = encoded(path, "cantalope")
    assert raw == canser.encode(good, "cantalope")
    assert (done.frames, done.bytes_out) == (4, len(raw))
    assert done.remarks == [
        "70,002 frames left out: error frames 70,001, extended ids 1",
        "cantalope carries no times",
    ]


@pytest.mark.parametrize("first", [0, EPOCH])
def test_frames_without_a_time_are_left_out_where_the_protocol_has_one(
    tmp_path: Path, first: int
) -> None:
    good = timed(first, first + SECOND)
    path = saved(tmp_path / "x.npy", timed(NO_TIME), good[:1], timed(NO_TIME), good[1:])
    raw, done = encoded(path, "serial")
    assert raw == canser.encode(timed(0, SECOND), "serial")
    assert done.remarks[-1] == "2 frames left out: unknown times 2"


def test_a_file_of_which_nothing_can_be_carried_is_an_error(tmp_path: Path) -> None:
    path = saved(tmp_path / "x.npy", array(Frame(0x1), Frame(0x2)))
    with pytest.raises(FormatError, match=r"x\.npy: serial can carry none of the 2 frames"):
        encoded(path, "serial")


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("run.log", "candump"),
        ("run.NPY", "npy"),
        ("folder.csv/run", None),
        ("run.bin", "raw"),
        ("run.pcapng", "pcapng"),
        ("-", None),
    ],
)
def test_the_format_of_a_name(path: str, expected: str | None) -> None:
    assert format_of_name(path) == expected


def test_a_file_of_raw_bytes_keeps_its_decoder(tmp_path: Path) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(b"\0" + canser.encode(traffic("seeed"), "seeed"))
    with canser.blocks(path, "seeed") as source:
        assert listed(source) == listed(canser.read(path, "seeed"))
        assert source.stats is not None
        assert source.stats.bytes_skipped == source.decoder.stats.bytes_skipped == 1


@pytest.mark.parametrize("protocol", [None, "seed"])
def test_a_call_that_is_wrong_leaves_no_file_open(tmp_path: Path, protocol: str | None) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(b"")
    # A file that is left open is a warning, and warnings are errors here.
    with pytest.raises(ValueError, match="protocol"):
        canser.blocks(path, protocol)


def test_an_error_of_a_format_has_the_name_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes(b"nothing")
    with (
        canser.blocks(path) as source,
        pytest.raises(FormatError, match=re.escape(str(path))),
    ):
        next(source)
