"""candump's log format: exact lines, there and back, python-can as a peer, errors."""

import io
import re
import tracemalloc
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canser.errors import FormatError
from canser.files import candump
from reference import NO_TIME, Frame
from samples import EPOCH, FRAMES, MICROSECOND, SECOND, array, frames_or_error
from texts import read_text

EXACT = {
    "(1544106679.432583) can0 562#122DF953813CA2": Frame(
        0x562, dlc=7, data=bytes.fromhex("122DF953813CA200"), ts=EPOCH
    ),
    "(0.000000) can0 001#": Frame(0x001, ts=0),
    "(0.000001) can0 7FF#0011223344556677": Frame(
        0x7FF, dlc=8, data=bytes.fromhex("0011223344556677"), ts=1_000
    ),
    "(12.500000) can0 00000001#AB": Frame(
        0x1, ext=True, dlc=1, data=bytes.fromhex("AB00000000000000"), ts=12_500_000_000
    ),
    "(10.000000) can0 18FEF100#": Frame(0x18FEF100, ext=True, ts=10 * SECOND),
    "(10.000000) can0 123#R8": Frame(0x123, rtr=True, dlc=8, ts=10 * SECOND),
    "(10.000000) can0 1FFFFFFF#R0": Frame(0x1FFFFFFF, ext=True, rtr=True, ts=10 * SECOND),
    "(10.000000) can0 20000080#00": Frame(0x80, err=True, dlc=1, ts=10 * SECOND),
    "(-1.500000) can0 100#": Frame(0x100, ts=-1_500_000_000),
}


def written(*frames: Frame) -> bytes:
    file = io.BytesIO()
    writer = candump.Writer(file)
    writer.write(array(*frames))
    writer.finish()
    return file.getvalue()


def read(text: bytes) -> list[Frame]:
    """Return the frames; remarks are not looked at."""
    return read_text(text, "candump")[0]


def remarks(text: bytes) -> list[str]:
    return read_text(text, "candump")[1]


def kept(frame: Frame) -> Frame:
    """Return what a line can hold of a frame."""
    size = 0 if frame.ts == NO_TIME else abs(frame.ts) // MICROSECOND * MICROSECOND
    # The eight digits of an error frame are there for its flag and tell nothing else.
    ext = frame.id > 0x7FF if frame.err else frame.ext
    return frame._replace(ts=-size if frame.ts < 0 else size, ext=ext)


@pytest.mark.parametrize("line", EXACT)
def test_a_frame_is_written_as_candump_writes_it(line: str) -> None:
    assert written(EXACT[line]) == line.encode() + b"\n"


@pytest.mark.parametrize("line", EXACT)
def test_a_line_of_candump_is_read(line: str) -> None:
    assert read(line.encode()) == [EXACT[line]]


def test_many_frames_are_one_line_each_in_their_order() -> None:
    assert written(*EXACT.values()).decode().splitlines() == list(EXACT)


def test_no_frames_are_no_lines() -> None:
    assert written() == b""
    assert read(b"") == []


@given(FRAMES)
def test_frames_read_back_but_for_what_the_text_cannot_hold(frames: list[Frame]) -> None:
    assert read(written(*frames)) == [kept(frame) for frame in frames]


@given(FRAMES)
def test_times_that_are_lost_are_counted(frames: list[Frame]) -> None:
    writer = candump.Writer(io.BytesIO())
    for frame in frames:
        writer.write(array(frame))
    assert writer.ts_unknown == sum(frame.ts == NO_TIME for frame in frames)
    assert writer.ts_cut == sum(
        frame.ts != NO_TIME and frame.ts % MICROSECOND != 0 for frame in frames
    )


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        ("(1.0) vcan12 123#AB R", Frame(0x123, dlc=1, data=b"\xab" + bytes(7), ts=SECOND)),
        ("(1.0)  can0  123#AB T", Frame(0x123, dlc=1, data=b"\xab" + bytes(7), ts=SECOND)),
        ("(1.0) can0 1ab#cd", Frame(0x1AB, dlc=1, data=b"\xcd" + bytes(7), ts=SECOND)),
        ("(1.0) can0 123#AB.CD", Frame(0x123, dlc=2, data=b"\xab\xcd" + bytes(6), ts=SECOND)),
        ("(1.0) can0 123#R", Frame(0x123, rtr=True, ts=SECOND)),
        ("(1.0) can0 123#r3", Frame(0x123, rtr=True, dlc=3, ts=SECOND)),
        ("(1.0) can0 123#0011223344556677_9", Frame(0x123, False, False, 8, ts=SECOND)),
        ("(1.0)\tcan0\t123#r8_f", Frame(0x123, rtr=True, dlc=8, ts=SECOND)),
        ("(1.0) 0 123#AB", Frame(0x123, dlc=1, data=b"\xab" + bytes(7), ts=SECOND)),
        ("(1) vcan-long.name 123#R R", Frame(0x123, rtr=True, ts=SECOND)),
    ],
)
def test_what_other_programs_write_is_read(line: str, frame: Frame) -> None:
    if frame.dlc == 8 and not frame.rtr:
        frame = frame._replace(data=bytes.fromhex("0011223344556677"))
    assert read(line.encode()) == [frame]


def test_comments_are_passed_over() -> None:
    assert len(read(b"# a log\n#\n(1.0) can0 123#\n  # its end")) == 1


def test_nuls_behind_the_last_line_are_told() -> None:
    text = b"(1.0) can0 123#\n" + bytes(64)
    assert len(read(text)) == 1
    assert remarks(text) == ["ends in 64 NUL bytes; was the power cut? Frames may be missing"]


def test_windows_line_ends_and_empty_lines_are_read() -> None:
    assert len(read(b"\xef\xbb\xbf(1.0) can0 123#\r\n\r\n(2.0) can0 123#\r\n")) == 2


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("hello", r"'hello' is no frame; canser reads lines such as \("),
        ("(1.0) can0 123#ABC", "'(1.0) can0 123#ABC' is no frame"),
        ("(1.0) can0 12#AB", "is no frame"),
        ("(1.0) can0 123#R9", "is no frame"),
        ("(1.0) can0 123##", "'(1.0) can0 123##' is CAN FD"),
        ("(1.0) can0 4512#81:00:12345678#11223344", "is CAN FD or CAN XL"),
        ("(1_0.0) can0 123#11", "is no frame"),
        ("(1.0_0) can0 123#11", "is no frame"),
        ("(\u0661.0) can0 123#11", "is no frame"),
        ("(1.0) can0 \u0661\u0662\u0663#11", "is no frame"),
        ("(1.0) can0 123#\uff11\uff11", "is no frame"),
        ("(1.0) can0 123#R\u0661", "is no frame"),
        ("(1.0) can0 0x123#11", "is no frame"),
        ("(+1.0) can0 123#11", "is no frame"),
        ("( 1.0) can0 123#11", "is no frame"),
        ("(1e9) can0 123#11", "is no frame"),
        ("(nan) can0 123#11", "is no frame"),
        ("() can0 123#11", "is no frame"),
        ("(.5) can0 123#11", "is no frame"),
        ("(1.0)\u2003can0 123#11", "is no frame"),
        ("(1.0) ca\u2003n0 123#11", "is no frame"),
        ("(1.0) ca\x1bn0 123#11", "is no frame"),
        ("(1.0) can0 123#11 22", "is no frame"),
        ("(1.0) can0 123#11.", "is no frame"),
        ("(1.0) can0 123#.11", "is no frame"),
        ("(1.0) can0 123#11..22", "is no frame"),
        ("(1.0) can0 123#11 X", "is no frame"),
        ("(1.0) can0 123#1122334455667788_8", "is no frame"),
        ("(1.0) can0 123#11_E", "a raw dlc (_E) needs 8 bytes, but the dlc is 1"),
        ("(1.0) can0 123#R4_E", "a raw dlc (_E) needs 8 bytes, but the dlc is 4"),
        ("(1.0) can0 800#", "the id 0x800 is over 0x7ff"),
        ("(1.0) can0 80000123#", "the id 0x80000123 is over 0x1fffffff"),
        ("(1.0) can0 123#001122334455667788", "the dlc 9 is not 0 to 8"),
        ("(noon) can0 123#", "noon"),
        ("(99999999999.0) can0 123#", "the time 99999999999.0 does not fit"),
    ],
)
def test_a_bad_line_is_an_error_that_names_file_line_and_reason(line: str, reason: str) -> None:
    text = f"(1.0) can0 123#\n\n{line}\n".encode()
    pattern = reason if "\\" in reason else re.escape(reason)
    with pytest.raises(FormatError, match=rf"^x\.log, line 3: .*{pattern}"):
        read(text)


def test_an_error_shows_the_start_only_of_a_line_that_is_long() -> None:
    with pytest.raises(FormatError) as error:
        read(b"x" * 100_000)
    assert len(str(error.value)) < 200


def test_frames_before_a_bad_line_do_not_hide_it() -> None:
    with pytest.raises(FormatError, match=r"^x\.log, line 20001: "):
        read(b"(1.0) can0 123#\n" * 20_000 + b"bad\n")


@given(st.binary() | st.text("(). can0#R123456789ABCDEF_\n").map(str.encode))
@example(b"(1.0) can0 123#" + b"\0" * 3)
@example("(\u0661.\u0660) can0 123#".encode())
@example(b"(inf) can0 123#")
@example(b"(" + b"1" * 5_000 + b") can0 123#")
def test_any_bytes_are_frames_or_a_format_error(raw: bytes) -> None:
    frames = frames_or_error(read, raw)
    assert read(written(*frames)) == [kept(frame) for frame in frames]


def test_python_can_reads_what_is_written() -> None:
    can = pytest.importorskip("can")
    # Error frames apart: python-can drops their id.
    frames = [frame for frame in EXACT.values() if not frame.err]
    messages = list(can.CanutilsLogReader(io.StringIO(written(*frames).decode())))
    assert [
        (
            message.arbitration_id,
            message.is_extended_id,
            message.is_remote_frame,
            message.dlc,
            bytes(message.data),
            message.channel,
        )
        for message in messages
    ] == [(f.id, f.ext, f.rtr, f.dlc, b"" if f.rtr else f.data[: f.dlc], "can0") for f in frames]
    # A float holds a time of day to a quarter of a microsecond.
    assert [message.timestamp for message in messages] == pytest.approx(
        [frame.ts / SECOND for frame in frames], rel=0, abs=1e-6
    )


def test_what_python_can_writes_is_read() -> None:
    can = pytest.importorskip("can")
    file = io.StringIO()
    writer = can.CanutilsLogWriter(file)
    for message in (
        can.Message(1.25, 0x123, is_extended_id=False, data=b"\x01\x02"),
        can.Message(1.5, 0x18FEF100, is_extended_id=True, data=bytes(range(8))),
        can.Message(2.0, 0x1, is_extended_id=True, is_rx=False),
        can.Message(2.5, 0x7E0, is_extended_id=False, is_remote_frame=True, dlc=4),
        can.Message(3.0, is_error_frame=True),
        can.Message(1544106679.432583, 0x7FF, is_extended_id=False),
    ):
        writer.on_message_received(message)
    assert read(file.getvalue().encode()) == [
        Frame(0x123, dlc=2, data=b"\x01\x02" + bytes(6), ts=1_250_000_000),
        Frame(0x18FEF100, ext=True, dlc=8, data=bytes(range(8)), ts=1_500_000_000),
        Frame(0x1, ext=True, ts=2 * SECOND),
        # It writes no dlc of a remote frame, and of an error frame the flag only.
        Frame(0x7E0, rtr=True, dlc=0, ts=2_500_000_000),
        Frame(0x80, err=True, ts=3 * SECOND),
        Frame(0x7FF, ts=EPOCH),
    ]


def test_a_line_without_an_end_is_an_error_and_not_all_of_memory() -> None:
    with pytest.raises(FormatError, match=r"line 2: has no end; is it raw bytes\?"):
        read(b"(0.0) can0 123#\n" + b"x" * (1 << 20))


TWO = (
    b"(1.0) can0 123#11 R\n(1.0) can1 123#22 T\n(1.0) can0 123#33 R\n(1.0) can0 123#44\n"
    b"(1.0) can0 123#0011223344556677_E\n(1.0) can1 123#R8_9 T\n"
)
TWO_TOLD = [
    "frames of 2 channels become one: can0 4, can1 2",
    "direction is not kept: received 4, sent 2",
    "raw dlcs of 9 to 15 become 8: 2",
]


def test_what_frames_do_not_hold_is_told_with_its_counts() -> None:
    assert remarks(TWO) == TWO_TOLD
    assert remarks(TWO * 10_000)[0] == "frames of 2 channels become one: can0 40,000, can1 20,000"


@pytest.mark.parametrize(
    "text",
    [b"", b"(1.0) can0 123#11\n" * 3, b"(1.0) can7 123#11 R\n(1.0) can7 123#11\n"],
    ids=["nothing", "plain", "received"],
)
def test_nothing_is_told_of_one_channel_that_only_receives(text: bytes) -> None:
    assert remarks(text) == []


def test_channels_without_end_are_counted_together() -> None:
    text = "".join(f"(1.0) x{number} 123# T\n" for number in range(1_000)).encode()
    channels, direction = remarks(text)
    assert channels.startswith("frames of more than 16 channels become one: x0 1, x1 1, x2 1, ")
    assert channels.endswith(", x15 1, and more 984")
    assert direction == "direction is not kept: sent 1,000"


def test_channels_without_end_take_no_memory() -> None:
    class Endless(io.RawIOBase):
        left = iter(range(6_000))

        def readable(self) -> bool:
            return True

        def readinto(self, room: Any) -> int:
            number = next(self.left, None)
            if number is None:
                return 0
            line = b"(1.0) %s%d 123#\n" % (b"x" * 1_000, number)
            room[: len(line)] = line
            return len(line)

    tracemalloc.start()
    try:
        _, told = read_text(Endless(), "candump")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # A block of rows and the frames take some of it, 6 MB of names would be above.
    assert peak < 5e6
    assert len(told[0]) < 1_000


def test_a_name_of_a_channel_is_shown_as_a_terminal_may_show_it() -> None:
    text = "(1.0) a\u202eb 123#\n(1.0) can0 123#\n".encode()
    assert remarks(text) == [r"frames of 2 channels become one: 'a\u202eb' 1, can0 1"]
