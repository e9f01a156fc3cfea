"""Logs of other programs as a whole: there and back, channels, starts, python-can as the judge."""

import datetime as dt
import io
import re
import warnings
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser._core.text import NO_CHANNEL
from canser.commands.cli import main
from canser.errors import CanserWarning, FormatError
from canser.files.formats import find_format
from canser.files.writer import WriteOptions
from reference import NO_TIME, Frame
from samples import EPOCH, FRAMES, MICROSECOND, SECOND, array, listed
from shared import CAPTURES, LOG_FILES, needs_captures, needs_logs
from texts import read_text

NAMES = {"asc": "x.asc", "candump": "x.log", "csv": "x.csv", "gvret": "x.gvret.csv", "trc": "x.trc"}
TAGGED = ("asc", "candump", "gvret", "trc")
WITHOUT_ERRORS = ("asc", "trc")

every_format = pytest.mark.parametrize("file_format", NAMES)


def kept(frame: Frame, file_format: str) -> Frame:
    """Return what a format holds of a frame, but for its time."""
    if frame.err and file_format in WITHOUT_ERRORS:
        return Frame(0, err=True, dlc=5 if file_format == "trc" else 0)
    if frame.err and file_format == "candump":
        return frame._replace(ext=frame.id > 0x7FF)
    return frame


def micro(ts: int) -> int:
    """Return a time cut to the microsecond, towards zero."""
    return ts // MICROSECOND * MICROSECOND if ts >= 0 else -(-ts // MICROSECOND * MICROSECOND)


@pytest.mark.filterwarnings("ignore::canser.CanserWarning")
@every_format
@given(frames=FRAMES, data=st.data())
def test_frames_channels_and_directions_there_and_back(
    file_format: str, frames: list[Frame], data: st.DataObject, tmp_path_factory: Any
) -> None:
    if file_format == "gvret":
        frames = [frame for frame in frames if not frame.rtr and not frame.err]
    codes = st.lists(st.integers(0, 20), min_size=len(frames), max_size=len(frames))
    channels = np.array(data.draw(codes), np.uint8)
    directions = channels % 2
    # Times of a log count from its first frame if that is a date; those near it are of use here.
    frames = [frame._replace(ts=frame.ts % 10**15) for frame in frames]
    path = tmp_path_factory.mktemp("logs") / NAMES[file_format]
    tags: dict[str, Any] = (
        {"channels": channels, "directions": directions} if file_format in TAGGED else {}
    )
    canser.write(array(*frames), path, **tags)
    got_channels, got_directions = np.zeros((2, len(frames) + 1), np.uint8)
    got = canser.read(path, channels=got_channels, directions=got_directions)
    places = 1 if file_format == "csv" else MICROSECOND
    assert listed(got) == [
        kept(frame, file_format)._replace(ts=frame.ts // places * places) for frame in frames
    ]
    if file_format in TAGGED:
        assert got_channels[:-1].tolist() == channels.tolist()
        told = [not (frame.err and file_format == "asc") for frame in frames]
        assert got_directions[:-1].tolist() == (directions * told).tolist()
    else:
        assert set(got_channels[:-1].tolist()) <= {NO_CHANNEL}


EXACT = {
    "asc": [
        " 1.500000 1  123             Rx   d 2 AB CD",
        " 2.000000 1  18FEF100x       Rx   r 8",
        " 3.000000 1  ErrorFrame",
        " 4.000000 1  1x              Rx   d 0",
    ],
    "trc": [
        "      1      1500.000 DT 1     0123 Rx -  2    AB CD",
        "      2      2000.000 RR 1 18FEF100 Rx -  8",
        "      3      3000.000 ER 1        - Rx -  5    00 00 00 00 00",
        "      4      4000.000 DT 1 00000001 Rx -  0",
    ],
    "gvret": [
        "1500000,00000123,false,Rx,0,2,AB,CD,",
        "4000000,00000001,true,Rx,0,0,",
    ],
}  # fmt: skip
FOUR = [
    Frame(0x123, dlc=2, data=b"\xab\xcd" + bytes(6), ts=3 * SECOND // 2),
    Frame(0x18FEF100, ext=True, rtr=True, dlc=8, ts=2 * SECOND),
    Frame(0x80, err=True, dlc=1, ts=3 * SECOND),
    Frame(0x1, ext=True, ts=4 * SECOND),
]


@pytest.mark.parametrize("file_format", EXACT)
def test_lines_as_the_format_has_them(file_format: str, tmp_path: Path) -> None:
    path = tmp_path / NAMES[file_format]
    with pytest.warns(CanserWarning):
        canser.write(array(*FOUR), path)
    lines = [line.rstrip() for line in path.read_text().splitlines()]
    begin = lines.index(EXACT[file_format][0].rstrip())
    assert lines[begin : begin + len(EXACT[file_format])] == EXACT[file_format]


LOST = {
    "asc": ["error frames without their id, data and direction: 1",
            "frames without a time, written as 0: 1", "times cut to the microsecond: 1"],
    "trc": ["error frames without their id and data: 1", "frames without a time, written as 0: 1",
            "times cut to the microsecond: 1"],
    "gvret": ["remote frames, left out: 1", "error frames, left out: 1",
              "frames without a time, written as 0: 1", "times cut to the microsecond: 1"],
    "candump": ["frames without a time, written as 0: 1", "times cut to the microsecond: 1"],
    "csv": [],
}  # fmt: skip


@every_format
def test_what_a_format_cannot_hold_is_said_once(file_format: str, tmp_path: Path) -> None:
    frames = array(*FOUR, Frame(1, ts=NO_TIME), Frame(1, ts=1))
    channels, directions = np.arange(6, dtype=np.uint8), np.ones(6, np.uint8)
    if LOST[file_format] or file_format == "csv":
        with pytest.warns(CanserWarning):
            done = canser.write(
                frames, tmp_path / NAMES[file_format], channels=channels, directions=directions
            )
    tags = [
        "frames of 6 channels become one: 0 1, 1 1, 2 1, 3 1, 4 1, 5 1",
        "direction is not kept: sent 6",
    ]
    assert done.remarks == (LOST[file_format] if file_format in TAGGED else tags)


@every_format
def test_dates_are_kept(file_format: str, tmp_path: Path) -> None:
    path = tmp_path / NAMES[file_format]
    zone = dt.timezone(dt.timedelta(hours=5, minutes=45))
    frames = array(*(Frame(1, ts=EPOCH + step * 1_000_000) for step in (0, 5, 3, 3_600_000)))
    canser.write(frames, path, tz=zone)
    got = canser.read(path, epoch="file", tz=zone)
    assert got["ts"].tolist() == frames["ts"].tolist()


def test_the_start_is_added_by_convert_which_says_so(tmp_path: Path) -> None:
    frames = array(Frame(1, ts=EPOCH), Frame(2, ts=EPOCH + SECOND))
    canser.write(frames, tmp_path / "x.asc", tz=dt.UTC)
    assert canser.read(tmp_path / "x.asc")["ts"].tolist() == [583_000, SECOND + 583_000]
    with pytest.warns(
        CanserWarning, match="start was added to all times: 2018-12-06 14:31:19.432 UTC"
    ):
        canser.convert(tmp_path / "x.asc", tmp_path / "x.log", tz=dt.UTC)
    assert listed(canser.read(tmp_path / "x.log")) == listed(frames)
    canser.convert(tmp_path / "x.asc", tmp_path / "x.bin", "serial")
    assert canser.read(tmp_path / "x.bin", "serial")["ts"].tolist() == [0, SECOND]
    when = dt.datetime(2026, 11, 26, tzinfo=dt.UTC)
    canser.convert(tmp_path / "x.asc", tmp_path / "y.log", epoch=when)
    assert canser.read(tmp_path / "y.log")["ts"][0] == int(when.timestamp()) * SECOND + 583_000


@pytest.mark.parametrize("file_format", ["asc", "blf", "trc"])
def test_times_that_are_no_dates_have_no_start(file_format: str, tmp_path: Path) -> None:
    path = tmp_path / f"x.{file_format}"
    canser.write(array(Frame(1, ts=SECOND)), path, tz=dt.timezone(dt.timedelta(hours=-9)))
    with canser.blocks(path) as blocks:
        assert [frame.ts for block in blocks for frame in listed(block)] == [SECOND]
        assert blocks.start_ns is None
    canser.convert(path, tmp_path / "y.csv")  # a remark would be an error here


def test_an_epoch_that_does_not_fit_is_an_error(tmp_path: Path) -> None:
    canser.write(array(Frame(1, ts=5)), tmp_path / "x.csv")
    canser.write(array(Frame(1, ts=EPOCH)), tmp_path / "y.csv")
    with pytest.raises(FormatError, match=r"x\.csv names no start; give epoch a datetime"):
        canser.read(tmp_path / "x.csv", epoch="file")
    assert canser.read(tmp_path / "y.csv", epoch="file")["ts"][0] == EPOCH
    with pytest.raises(FormatError, match="count from 1970 already"):
        canser.read(tmp_path / "y.csv", epoch=dt.datetime(2026, 1, 1, tzinfo=dt.UTC))
    with pytest.raises(TypeError, match=r"epoch is 5; it must be a datetime\.datetime"):
        canser.read(tmp_path / "x.csv", epoch=5)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"tz is 'UTC'; it must be a datetime\.tzinfo"):
        canser.read(tmp_path / "x.csv", tz="UTC")  # type: ignore[arg-type]


TWO_BUSES = b"(1.0) can0 123#11 R\n(2.0) vcan7 124#22 T\n(3.0) can0 125#33\n"


def test_arrays_for_channels_and_directions_are_filled(tmp_path: Path) -> None:
    (tmp_path / "x.log").write_bytes(TWO_BUSES)
    channels, directions = np.full((2, 4), 99, np.uint8)
    canser.read(tmp_path / "x.log", channels=channels, directions=directions)
    assert (channels.tolist(), directions.tolist()) == ([0, 7, 0, 99], [0, 1, 0, 99])
    out = np.zeros(2, canser.FRAME_DTYPE)
    found = []
    with canser.blocks(
        tmp_path / "x.log", out=out, channels=channels, directions=directions
    ) as blocks:
        found += [
            (len(block), channels[: len(block)].tolist(), directions[: len(block)].tolist())
            for block in blocks
        ]
        assert blocks.channel_names == {0: "can0", 7: "vcan7"}
    assert found == [(2, [0, 7], [0, 1]), (1, [0], [0])]
    with pytest.raises(ValueError, match="channels or directions has room for 2 frames"):
        canser.read(tmp_path / "x.log", channels=channels[:2])
    with pytest.raises(ValueError, match="channels goes with out"):
        canser.blocks(tmp_path / "x.log", channels=channels)
    with pytest.raises(ValueError, match="directions has room for 1 frames; make it at least 2"):
        canser.blocks(tmp_path / "x.log", out=out, directions=directions[:1])
    with pytest.raises(TypeError, match="channels"):
        canser.read(tmp_path / "x.log", channels=np.zeros(4))  # type: ignore[arg-type]


def test_only_one_array_warns_of_the_other(tmp_path: Path) -> None:
    (tmp_path / "x.log").write_bytes(TWO_BUSES)
    codes = np.zeros(3, np.uint8)
    with pytest.warns(CanserWarning, match="channels become one"):
        canser.read(tmp_path / "x.log", directions=codes)


def test_sorted_frames_keep_their_channels(tmp_path: Path) -> None:
    (tmp_path / "x.log").write_bytes(b"(3.0) can2 123#\n(1.0) can1 124# T\n(2.0) can0 125#\n")
    channels, directions = np.zeros((2, 3), np.uint8)
    frames = canser.read(tmp_path / "x.log", channels=channels, directions=directions, sort=True)
    assert frames["id"].tolist() == [0x124, 0x125, 0x123]
    assert (channels.tolist(), directions.tolist()) == ([1, 0, 2], [1, 0, 0])


@pytest.mark.parametrize(
    ("arrays", "error"),
    [
        ({"channels": np.zeros(2, np.int64)}, "channels must be an array of uint8, not"),
        ({"directions": np.zeros(3, np.uint8)}, "directions has the shape"),
        ({"channels": [0, 1]}, "channels must be an array of uint8, not list"),
    ],
)
def test_wrong_arrays_to_write_are_an_error(
    tmp_path: Path, arrays: dict[str, Any], error: str
) -> None:
    with pytest.raises((TypeError, ValueError), match=error):
        canser.write(array(Frame(1, ts=0), Frame(2, ts=1)), tmp_path / "x.log", **arrays)
    assert not list(tmp_path.iterdir())


def test_names_of_channels_go_into_a_log(tmp_path: Path) -> None:
    names = [*(f"bus{number}" for number in range(15)), "a-name-of-more-than-15-bytes", "last"]
    text = "".join(f"({at}.000000) {name} 123#\n" for at, name in enumerate(names))
    (tmp_path / "x.log").write_text(text)
    with pytest.warns(CanserWarning, match="other names: a-name-of-more-than-15-bytes is can15"):
        canser.write(canser.blocks(tmp_path / "x.log"), tmp_path / "y.log")
    wanted = text.replace("a-name-of-more-than-15-bytes", "can15")
    assert (tmp_path / "y.log").read_text() == wanted


@pytest.mark.parametrize("file_format", ["asc", "gvret", "trc"])
@pytest.mark.parametrize("line", ["hello world", "1.0 1 123 Rx d 3 11 22", "1,2,3,4"])
def test_a_line_that_cannot_be_read_is_named(file_format: str, line: str, tmp_path: Path) -> None:
    path = tmp_path / NAMES[file_format]
    canser.write(array(Frame(1, ts=0)), path)
    whole = path.read_bytes()
    number = whole.count(b"\n") + 1
    with pytest.raises(FormatError, match=rf"^x\.log, line {number}: "):
        read_text(whole + line.encode() + b"\n", file_format)
    frames, told = read_text(whole + line.encode() + b"\n", file_format, skip_bad=True)
    assert len(frames) == 1
    assert told[0].startswith(f"lines that cannot be read, left out: 1; the first is line {number}")


@every_format
@given(raw=st.binary(max_size=60), cut=st.integers(0, 400))
def test_damage_is_frames_or_one_line(file_format: str, raw: bytes, cut: int) -> None:
    file = io.BytesIO()
    writer = find_format(file_format).write(file, WriteOptions())
    writer.write(array(*(Frame(at, dlc=1, ts=at * SECOND) for at in range(8))))
    text = file.getvalue()
    damaged = text[:cut] + raw + text[cut + len(raw) // 2 :]
    try:
        read_text(damaged, file_format)
    except FormatError as error:
        assert "\n" not in str(error)  # noqa: PT017 - any other exception fails


# --- python-can as the judge ---


def messages(frames: list[Frame]) -> list[Any]:
    can = pytest.importorskip("can")
    return [
        can.Message(
            timestamp=frame.ts / SECOND,
            arbitration_id=frame.id,
            is_extended_id=frame.ext,
            is_remote_frame=frame.rtr,
            is_error_frame=frame.err,
            dlc=frame.dlc,
            data=None if frame.rtr else frame.data[: frame.dlc],
            channel=at % 2,
            is_rx=at % 3 != 0,
        )
        for at, frame in enumerate(frames)
    ]


PLAIN = [
    Frame(0x123, dlc=8, data=bytes(range(8)), ts=EPOCH),
    Frame(0x7FF, dlc=0, ts=EPOCH + SECOND),
    Frame(0x18FEF100, ext=True, dlc=3, data=b"\1\2\3" + bytes(5), ts=EPOCH + 2 * SECOND),
    Frame(0x1, ext=True, dlc=1, data=b"\xff" + bytes(7), ts=EPOCH + 3 * SECOND),
]
REMOTE = [*PLAIN, Frame(0x123, rtr=True, dlc=4, ts=EPOCH + 4 * SECOND)]


@pytest.mark.parametrize(
    ("file_format", "frames"), [("asc", REMOTE), ("trc", PLAIN), ("csv", REMOTE)]
)
def test_python_can_reads_what_is_written(
    file_format: str, frames: list[Frame], tmp_path: Path
) -> None:
    can = pytest.importorskip("can")
    path = tmp_path / NAMES[file_format]
    channels = np.arange(len(frames), dtype=np.uint8) % 2
    tags: dict[str, Any] = (
        {"channels": channels, "directions": channels} if file_format != "csv" else {}
    )
    canser.write(array(*frames), path, **tags)
    with can.LogReader(path) as reader:
        found = list(reader)
    assert [
        (m.arbitration_id, m.is_extended_id, m.is_remote_frame, m.dlc, bytes(m.data)) for m in found
    ] == [(f.id, f.ext, f.rtr, f.dlc, b"" if f.rtr else f.data[: f.dlc]) for f in frames]
    steps = [(m.timestamp - found[0].timestamp) for m in found]
    assert steps == pytest.approx([(f.ts - EPOCH) / SECOND for f in frames], abs=2e-6)
    if tags:
        assert [m.is_rx for m in found] == [not sent for sent in channels]
        first = found[0].channel
        assert [m.channel - first for m in found] == channels.tolist()


@pytest.mark.parametrize(("file_format", "frames"), [("asc", REMOTE), ("trc", PLAIN)])
def test_what_python_can_writes_is_read(
    file_format: str, frames: list[Frame], tmp_path: Path
) -> None:
    can = pytest.importorskip("can")
    path = tmp_path / NAMES[file_format]
    with can.Logger(path) as logger:
        for message in messages(frames):
            logger(message)
    channels, directions = np.zeros((2, len(frames)), np.uint8)
    got = listed(canser.read(path, channels=channels, directions=directions))
    assert [frame._replace(ts=0) for frame in got] == [frame._replace(ts=0) for frame in frames]
    assert channels.tolist() == [at % 2 for at in range(len(frames))]
    assert directions.tolist() == [at % 3 == 0 for at in range(len(frames))]


# --- the nine edge frames ---


@needs_logs
@pytest.mark.filterwarnings("ignore::canser.CanserWarning")
@every_format
def test_the_edge_frames_there_and_back(file_format: str, tmp_path: Path) -> None:
    """Extended with a small id, remote frames, an error frame, a step back, a gap of an hour."""
    before = canser.read(LOG_FILES / "edge.log")
    path = tmp_path / NAMES[file_format]
    canser.convert(LOG_FILES / "edge.log", path)
    canser.convert(path, tmp_path / "back.log")
    after = canser.read(tmp_path / "back.log")
    if file_format == "gvret":
        before = before.compress(~(before["rtr"] | before["err"]))
    assert listed(after) == [
        kept(frame, file_format)._replace(ts=frame.ts) for frame in listed(before)
    ]
    if file_format in TAGGED:
        text = (tmp_path / "back.log").read_text()
        assert text.count(" can1 ") == 2
        assert text.count(" T\n") == 1


# --- a real capture ---

CAN_HOLD = {
    "x.asc": MICROSECOND, "x.blf": 1, "x.log": MICROSECOND, "x.csv": 1, "x.gvret.csv": MICROSECOND,
    "x.npy": 1, "x.parquet": 1, "x.arrow": 1, "x.pcap": 1, "x.trc": MICROSECOND,
}  # fmt: skip


@needs_captures
@pytest.mark.filterwarnings("ignore::canser.CanserWarning")
@pytest.mark.parametrize("name", CAN_HOLD)
def test_a_capture_to_each_format_and_back(name: str, tmp_path: Path) -> None:
    if name in ("x.parquet", "x.arrow"):
        pytest.importorskip("pyarrow")
    before = canser.read(CAPTURES / "car.serial.bin", "serial")
    canser.convert(CAPTURES / "car.serial.bin", tmp_path / name, "serial")
    after = canser.read(tmp_path / name)
    before["ts"] -= before["ts"] % CAN_HOLD[name]
    assert len(after) == len(before) > 80_000
    assert after.tobytes() == before.tobytes()
    canser.convert(tmp_path / name, tmp_path / "back.bin", "serial", ts_unit="ms")
    again = canser.read(tmp_path / "back.bin", "serial")
    assert (again["data"] == before["data"]).all()
    assert (again["id"] == before["id"]).all()


@pytest.mark.parametrize("name", ["x.asc", "x.log.gz", "x.blf", "x.pcap", "x.trc"])
def test_commands_take_every_format(name: str, tmp_path: Path) -> None:
    frames = array(*PLAIN)
    canser.write(frames, tmp_path / name)
    for call in (["info"], ["dump"], ["convert", "-o", str(tmp_path / "y.npy"), "--force"]):
        assert main([*call[:1], str(tmp_path / name), *call[1:]]) == 0
    call = ["play", str(tmp_path / name), "-c", "loop://", "-p", "serial", "--gap", "0"]
    assert main(call) == 0


FAR = "9223372036.000000"  # seconds, nearly 64 bits of nanoseconds


def test_relative_times_that_add_up_to_too_much_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "x.asc"
    line = f" {FAR} 1  123             Rx   d 1 00\n"
    path.write_text(f"date Thu Jan 01 00:00:00.000 2026\nbase hex timestamps relative\n{line * 2}")
    with pytest.raises(FormatError, match="line 4: the relative times add up to over 64 bits"):
        canser.read(path)


def test_differences_that_add_up_to_too_much_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_text(f"({FAR}) can0 123#00\n" * 2)
    with pytest.raises(FormatError, match="add up to over 64 bits of nanoseconds; they are no dif"):
        canser.read(path, times="delta")


def test_a_gvret_table_without_its_header_is_an_error_also_if_lines_may_be_bad(
    tmp_path: Path,
) -> None:
    path = tmp_path / "x.gvret.csv"
    path.write_text("# a comment\n5,00000123,false,Rx,0,2,1,2,\n")
    with pytest.raises(FormatError, match="no column time stamp, id, extended"):
        canser.read(path, format="gvret", skip_bad=True)


@pytest.mark.parametrize(
    ("base", "rest", "why"),
    [
        ("dec", "7C", "line 3: '7C' is no decimal number; is the line 'base' right?"),
        ("hex", "1_2", "line 3: '1_2' is no hexadecimal number; is the line 'base' right?"),
        ("hex", "\u0661", "line 3: '\u0661' is no hexadecimal number; is the line 'base' right?"),
        ("dec", "256", "line 3: '256' is no byte: it is over 255"),
    ],
)
def test_numbers_of_another_base_are_named(base: str, rest: str, why: str, tmp_path: Path) -> None:
    path = tmp_path / "x.asc"
    head = f"date Thu Jan 01 00:00:00.000 2026\nbase {base} timestamps absolute\n"
    path.write_text(f"{head} 0.5 1  123             Rx   d 1 {rest}\n")
    with pytest.raises(FormatError, match=re.escape(why)):
        canser.read(path)


# The places of times that follow each other in one second, mostly six as Vector's programs write.
PLACES = st.lists(
    st.from_regex(r"[0-9]{6}", fullmatch=True) | st.from_regex(r"[0-9]{1,9}", fullmatch=True),
    min_size=1,
    max_size=4,
)


@given(
    seconds=st.lists(
        st.tuples(
            st.integers(0, 9),
            st.sampled_from(["0", "7", "9", "10", "99", "100", "123456", "1234567", "-0", "-7"]),
            PLACES,
        ),
        max_size=10,
    )
)
def test_asc_times_of_any_width_are_exact(
    seconds: list[tuple[int, str, list[str]]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("asc") / "x.asc"
    times = [(blanks, f"{whole}.{each}") for blanks, whole, places in seconds for each in places]
    lines = "".join(
        f"{' ' * blanks}{time} 1  123             Rx   d 1 00\n" for blanks, time in times
    )
    path.write_text(f"date Thu Jan 01 00:00:00.000 2026\nbase hex timestamps absolute\n{lines}")
    wanted = [int(Decimal(time) * SECOND) for _, time in times]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # times go back
        assert canser.read(path)["ts"].tolist() == wanted
