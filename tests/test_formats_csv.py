"""Comma-separated values: exact rows, there and back, python-can as a peer, errors."""

import io
import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canser.errors import FormatError
from canser.files import csv
from reference import NO_TIME, Frame
from samples import EPOCH, FRAMES, SECOND, array, frames_or_error
from texts import read_text

HEADER = b"timestamp,arbitration_id,extended,remote,error,dlc,data\n"

EXACT = {
    "1544106679.432583,0xd2,0,0,0,8,AAD//xAAAAA=": Frame(
        0xD2, dlc=8, data=bytes.fromhex("0000FFFF10000000"), ts=EPOCH
    ),
    "1544106679.432583021,0x7ff,0,0,0,1,qw==": Frame(
        0x7FF, dlc=1, data=b"\xab" + bytes(7), ts=EPOCH + 21
    ),
    "0.000000,0x0,0,0,0,0,": Frame(0, ts=0),
    "0.000000001,0x1,1,0,0,2,AAE=": Frame(1, ext=True, dlc=2, data=b"\0\1" + bytes(6), ts=1),
    "-1.500000,0x18fef100,1,0,0,3,////": Frame(
        0x18FEF100, ext=True, dlc=3, data=b"\xff\xff\xff" + bytes(5), ts=-1_500_000_000
    ),
    "-0.000000001,0x123,0,1,0,8,": Frame(0x123, rtr=True, dlc=8, ts=-1),
    "nan,0x80,0,0,1,4,AQIDBA==": Frame(
        0x80, err=True, dlc=4, data=b"\1\2\3\4" + bytes(4), ts=NO_TIME
    ),
}


def written(*frames: Frame) -> bytes:
    file = io.BytesIO()
    writer = csv.Writer(file)
    writer.write(array(*frames))
    writer.finish()
    return file.getvalue()


def read(text: bytes) -> list[Frame]:
    """Return the frames; remarks are not looked at."""
    return read_text(text, "csv", "x.csv")[0]


def remarks(text: bytes) -> list[str]:
    return read_text(text, "csv", "x.csv")[1]


@pytest.mark.parametrize("row", EXACT)
def test_a_frame_is_written_as_python_can_names_its_columns(row: str) -> None:
    assert written(EXACT[row]) == HEADER + row.encode() + b"\n"


@pytest.mark.parametrize("row", EXACT)
def test_a_row_is_read(row: str) -> None:
    assert read(HEADER + row.encode()) == [EXACT[row]]


def test_many_frames_are_one_row_each_in_their_order() -> None:
    assert written(*EXACT.values()).decode().splitlines()[1:] == list(EXACT)


def test_the_header_comes_once_however_many_blocks_there_are() -> None:
    file = io.BytesIO()
    writer = csv.Writer(file)
    for frame in EXACT.values():
        writer.write(array(frame))
    assert file.getvalue() == written(*EXACT.values())


def test_no_frames_are_the_header_alone() -> None:
    assert written() == HEADER
    assert read(HEADER) == []


@given(FRAMES)
def test_frames_read_back_exactly(frames: list[Frame]) -> None:
    assert read(written(*frames)) == frames


def test_columns_may_be_in_any_order_among_others() -> None:
    text = b"bus,data,dlc,error,remote,extended,arbitration_id,timestamp\n7,qw==,1,0,0,1,0x5,2.5\n"
    assert read(text) == [Frame(5, ext=True, dlc=1, data=b"\xab" + bytes(7), ts=2_500_000_000)]


def test_columns_that_are_not_read_are_named() -> None:
    text = b"bus,Channel,,data,dlc,error,remote,extended,arbitration_id,timestamp\n"
    assert remarks(text) == ["columns that are not read: bus, Channel, ''"]
    many = b",".join(b"c%d" % number for number in range(1_000))
    (told,) = remarks(HEADER.rstrip() + b"," + many + b"\n")
    assert told.startswith("columns that are not read: c0, c1, ")
    assert told.endswith(", c15, and more")


def test_channels_and_directions_are_counted() -> None:
    text = b"channel,direction," + HEADER + b"can0,Rx,0,0x1,0,0,0,0,\ncan1,Tx,1,0x1,0,0,0,0,\n"
    assert remarks(text) == [
        "frames of 2 channels become one: can0 1, can1 1",
        "direction is not kept: received 1, sent 1",
    ]
    assert remarks(text.replace(b"can1,Tx", b"can0,")) == []


def test_the_header_of_python_can_2_is_read() -> None:
    """As its versions 2.0 and 2.1 wrote it: see can/io/csv.py there."""
    text = (
        b"timestamp, arbitration id, extended, remote, error, dlc, data\n"
        b"1483389946.197,0xdadada,1,0,0,6,WzQyLCA5\n"
        b"0.0,0x7ff,0,1,0,8,\n"
    )
    assert remarks(text) == []
    assert read(text) == [
        Frame(0xDADADA, ext=True, dlc=6, data=b"[42, 9\0\0", ts=1_483_389_946_197_000_000),
        Frame(0x7FF, rtr=True, dlc=8, ts=0),
    ]


def test_a_blank_behind_a_comma_is_no_part_of_a_field() -> None:
    text = HEADER.replace(b",", b", ") + b"2.5, 0x5, 1, 0, 0, 1, qw=="
    assert read(text) == [Frame(5, ext=True, dlc=1, data=b"\xab" + bytes(7), ts=2_500_000_000)]


def test_a_column_that_is_there_twice_is_an_error() -> None:
    with pytest.raises(FormatError, match=r"^x\.csv, line 1: the column dlc is there 2 times"):
        read(b"dlc," + HEADER)


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(
            b"\xef\xbb\xbf" + HEADER.replace(b"\n", b"\r\n") + b"2.5,0x5,1,0,0,1,qw==\r\n",
            id="windows",
        ),
        pytest.param(HEADER + b"\n2.5,0x5,1,0,0,1,qw==\n\n", id="empty lines"),
        pytest.param(HEADER + b"2.5,0x00000005,True,False,false,1,qw==", id="words"),
        pytest.param(HEADER + b'"2.5","5","1","0","0","1","qw=="', id="quoted row"),
        pytest.param(
            b'"timestamp","arbitration_id","extended","remote","error","dlc","data"\n'
            b"2.5,0x5,1,0,0,1,qw==",
            id="quoted header",
        ),
    ],
)
def test_what_other_programs_write_is_read(text: bytes) -> None:
    assert read(text) == [Frame(5, ext=True, dlc=1, data=b"\xab" + bytes(7), ts=2_500_000_000)]


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ("2.5,0x5,1,0,0,1", "6 fields where the header has 7"),
        ("2.5", "1 fields where the header has 7"),
        ("2.5,0x800,0,0,0,1,qw==", "the id 0x800 is over 0x7ff"),
        ("2.5,0x20000000,1,0,0,1,qw==", "the id 0x20000000 is over 0x1fffffff"),
        ("2.5,0x5,1,0,0,2,qw==", "the dlc is 2, but there are 1 bytes of data"),
        ("2.5,0x5,1,0,0,65,AAAAAAAAAAAA", "the dlc 65 is not 0 to 8"),
        ("2.5,0x5,1,0,0,-1,", "the dlc -1 is not 0 to 8"),
        ("2.5,0x5,2,0,0,1,qw==", "extended is '2'; it must be 0 or 1"),
        ("2.5,0x5,1,no,0,1,qw==", "remote is 'no'; it must be 0 or 1"),
        ("99999999999,0x5,1,0,0,1,qw==", "99999999999"),
        ("noon,0x5,1,0,0,1,qw==", "timestamp is 'noon'"),
        ("2.5,0xyz,1,0,0,1,qw==", "arbitration_id is '0xyz'"),
        ("2.5,0x5,1,0,0,one,qw==", "dlc is 'one'"),
        ("2.5,0x5,1,0,0,1,q?==", "data is 'q?=='"),
        ("2.5,0x5,1,0,0,1,qw", "data is 'qw'"),
        ("2.5,0x5,1,0,0,1,qx==", "data is 'qx=='; it must be base64"),
        ("2.5,0x5,1,0,0,1,qw==,", "8 fields where the header has 7"),
        ("2.5,0x1_23,1,0,0,1,qw==", "arbitration_id is '0x1_23'"),
        ("2.5,+5,1,0,0,1,qw==", "arbitration_id is '+5'"),
        ("2.5,-0x5,1,0,0,1,qw==", "arbitration_id is '-0x5'"),
        ("2.5,\u0661,1,0,0,1,qw==", "arbitration_id is '\u0661'"),
        ("2.5,0x" + "f" * 5_000 + ",1,0,0,1,qw==", "arbitration_id is '0xfffff"),
        ("2.5,0x5,1,0,0,0_1,qw==", "dlc is '0_1'; it must be a number"),
        ("2.5,0x5,1,0,0,+1,qw==", "dlc is '+1'"),
        ("2.5,0x5,1,0,0,\u0661,qw==", "dlc is '\u0661'"),
        ("2.5,0x5,1,0,0,0x1,qw==", "dlc is '0x1'"),
        ("2.5,0x5,\uff11,0,0,1,qw==", "extended is '\uff11'; it must be 0 or 1"),
        ("2.5,0x5,1,0,0,1,\uff11w==", "data is '\uff11w=='"),
        ("1_0.5,0x5,1,0,0,1,qw==", "timestamp is '1_0.5'"),
        ("1e1_0,0x5,1,0,0,1,qw==", "timestamp is '1e1_0'"),
        ("\u0661.5,0x5,1,0,0,1,qw==", "timestamp is '\u0661.5'"),
        ("inf,0x5,1,0,0,1,qw==", "timestamp is 'inf'"),
        ("1e300,0x5,1,0,0,1,qw==", "timestamp is '1e300'"),
        ("2.5\u2003,0x5,1,0,0,1,qw==", "timestamp is '2.5"),
    ],
)
def test_a_bad_row_is_an_error_that_names_file_line_and_value(row: str, reason: str) -> None:
    text = HEADER + b"2.5,0x5,1,0,0,1,qw==\n\n" + row.encode() + b"\n"
    with pytest.raises(FormatError, match=rf"^x\.csv, line 4: .*{re.escape(reason)}"):
        read(text)


@pytest.mark.parametrize("data", ["qw==", "AAAAAAAAAAA=", "AAAAAAAAAAAAAAA=", "A" * 64])
def test_data_in_a_remote_frame_is_an_error(data: str) -> None:
    with pytest.raises(FormatError, match=r"^x\.csv, line 2: .*remote"):
        read(HEADER + f"2.5,0x5,1,1,0,8,{data}".encode())


def test_missing_columns_are_named_with_those_that_must_be_there() -> None:
    with pytest.raises(
        FormatError,
        match=r"^x\.csv: no column arbitration_id, dlc; the first line must name timestamp,arb",
    ):
        read(b"timestamp,id,extended,remote,error,data\n")


def test_raw_bytes_are_called_raw_bytes() -> None:
    with pytest.raises(FormatError, match=r"^x\.csv, line 1: .* is it raw bytes\?$"):
        read(b"\xaa\xc8\x23\x01\xff\x55" * 8)


@given(
    st.binary()
    | st.binary().map(HEADER.__add__)
    | st.lists(st.sampled_from(["", "0", "1", "8", "0x5", "nan", "-", '"', "AAAAAAAAAAA="]))
    .map(",".join)
    .map(lambda row: HEADER + row.encode())
)
@example(HEADER + b'"1')
@example(HEADER + b'1"2",\r3')
@example(HEADER + b"inf,0x5,1,0,0,1,qw==")
@example(HEADER + b"0,0x5,1,0,0," + b"1" * 5_000 + b",qw==")
@example(HEADER + b"0," + b"1" * 200_000)
@example(HEADER + b"0,0x5,1,1,0,8,AAAAAAAAAAAAAAA=")
@example(HEADER + "0,0x5,1,0,0,1,é".encode())
def test_any_bytes_are_frames_or_a_format_error(raw: bytes) -> None:
    frames = frames_or_error(read, raw)
    assert read(written(*frames)) == frames


def test_python_can_reads_what_is_written() -> None:
    can = pytest.importorskip("can")
    frames = [frame for frame in EXACT.values() if frame.ts != NO_TIME]
    frames.append(Frame(0x80, err=True, dlc=1, ts=SECOND))
    messages = list(can.CSVReader(io.StringIO(written(*frames).decode())))
    assert [
        (
            message.arbitration_id,
            message.is_extended_id,
            message.is_remote_frame,
            message.is_error_frame,
            message.dlc,
            bytes(message.data),
        )
        for message in messages
    ] == [(f.id, f.ext, f.rtr, f.err, f.dlc, b"" if f.rtr else f.data[: f.dlc]) for f in frames]
    # A float holds a time of day to a quarter of a microsecond.
    assert [message.timestamp for message in messages] == pytest.approx(
        [frame.ts / SECOND for frame in frames], rel=0, abs=1e-6
    )


def test_what_python_can_writes_is_read() -> None:
    can = pytest.importorskip("can")
    file = io.StringIO()
    writer = can.CSVWriter(file)
    for message in (
        can.Message(1e-06, 0x123, is_extended_id=False, data=b"\x01\x02"),
        can.Message(1.5, 0x18FEF100, is_extended_id=True, data=bytes(range(8))),
        can.Message(2.5, 0x7E0, is_extended_id=False, is_remote_frame=True, dlc=4),
        can.Message(1.0, 0x80, is_extended_id=False, is_error_frame=True, dlc=0),
        can.Message(1544106679.432583, 0x7FF, is_extended_id=False),
    ):
        writer.on_message_received(message)
    assert read(file.getvalue().encode()) == [
        Frame(0x123, dlc=2, data=b"\x01\x02" + bytes(6), ts=1_000),
        Frame(0x18FEF100, ext=True, dlc=8, data=bytes(range(8)), ts=1_500_000_000),
        Frame(0x7E0, rtr=True, dlc=4, ts=2_500_000_000),
        Frame(0x80, err=True, ts=SECOND),
        Frame(0x7FF, ts=EPOCH),
    ]
