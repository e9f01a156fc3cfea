"""What the text formats share: seconds without rounding, lines and their numbers, last lines."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser import _input
from canser._core.text import TextWriter
from canser.errors import FormatError
from canser.files.seconds import parse_seconds
from reference import NO_TIME, Frame
from samples import SECOND, array
from texts import read_text

TIMES = st.integers(NO_TIME + 1, 2**63 - 1)
LINE = b"(1.0) can0 123#\n"


def seconds(ts: int) -> str:
    """Return one time as C writes it: csv has nine places where they are of use, else six."""
    writer = TextWriter("csv")
    return (
        b"".join(map(bytes, writer.lines(array(Frame(0, ts=ts)), None, None)))
        .split(b",")[0]
        .decode()
    )


@pytest.mark.parametrize(
    ("ts", "text"),
    [
        (0, "0.000000"),
        (1, "0.000000001"),
        (-1, "-0.000000001"),
        (-1_500_000_000, "-1.500000"),
        (1_544_106_679_432_583_021, "1544106679.432583021"),
        (2**63 - 1, "9223372036.854775807"),
        (1 - 2**63, "-9223372036.854775807"),
    ],
)
def test_times_are_seconds_with_all_nanoseconds(ts: int, text: str) -> None:
    assert seconds(ts) == text
    assert parse_seconds(text) == ts


@given(TIMES)
def test_every_time_reads_back(ts: int) -> None:
    assert parse_seconds(seconds(ts)) == ts


@given(st.lists(st.one_of(TIMES, st.integers(-3 * SECOND, 3 * SECOND))))
def test_a_time_does_not_depend_on_the_one_before(times: list[int]) -> None:
    frames = array(*(Frame(0, ts=ts) for ts in times))
    text = b"".join(map(bytes, TextWriter("csv").lines(frames, None, None))).decode()
    assert [line.split(",")[0] for line in text.splitlines()] == [seconds(ts) for ts in times]


@given(st.one_of(TIMES, st.integers(-(10**15), 10**15).map(lambda days: days * 1000)))
def test_a_date_is_the_one_of_numpy(ts: int) -> None:
    writer = TextWriter("candump")
    writer.state.is_dated = True
    line = b"".join(map(bytes, writer.lines(array(Frame(0, ts=ts)), None, None))).decode()
    assert line[1:27].replace(" ", "T") == str(np.datetime64(ts, "ns"))[:26]


@pytest.mark.parametrize(
    ("text", "ts"),
    [
        ("7", 7 * SECOND),
        ("0" * 5_000 + "7", 7 * SECOND),
        ("+7.", 7 * SECOND),
        (" 0.5 ", SECOND // 2),
        ("0.1234567899", 123_456_789),
        ("1e-06", 1_000),
        ("1.5e3", 1_500 * SECOND),
        ("nan", NO_TIME),
        ("NaT", NO_TIME),
        ("", NO_TIME),
    ],
)
def test_other_spellings_of_a_time_are_read(text: str, ts: int) -> None:
    assert parse_seconds(text) == ts


@pytest.mark.parametrize(
    "text", ["9223372036.854775808", "-9223372036.854775808", "1e300", "inf", "1" * 60]
)
def test_a_time_that_does_not_fit_is_an_error_that_names_it(text: str) -> None:
    with pytest.raises(ValueError, match=f"the time {text} does not fit 64 bits of nanoseconds"):
        parse_seconds(text)


@pytest.mark.parametrize(
    "text",
    [
        *("x", "1,5", "12:30", "--1", "1e", ".", ".5", "e5", "0x10", "infinity", "nan1"),
        # What int() and float() take.
        *("1_0.0", "1.0_0", "1e1_0", "\u0661.0", "1.\u0660", "\uff11", "1\u2003", "1\n"),
    ],
)
def test_what_is_no_number_is_an_error(text: str) -> None:
    with pytest.raises(ValueError, match="is no time in seconds"):
        parse_seconds(text)


def test_lines_have_the_numbers_of_an_editor() -> None:
    with pytest.raises(FormatError, match=r"^x\.log, line 5: 'fourth'"):
        read_text(b"\xef\xbb\xbf" + LINE.strip() + b"\r\n\n  \n" + LINE + b"fourth\n", "candump")


def test_a_file_is_read_into_one_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    class Memory(bytearray):
        """Counts the pieces of memory that are not empty."""

        def __init__(self, size: int = 0) -> None:
            super().__init__(size)
            made.extend([size] * bool(size))

    path = tmp_path / "run.log"
    line = b"(1.0) can0 123#01\n"
    path.write_bytes(line * 200_000)
    assert path.stat().st_size > 3 * _input.READ
    assert _input.READ % len(line) != 0  # the end of a piece cuts a line
    monkeypatch.setattr(_input, "bytearray", Memory, raising=False)
    frames = canser.read(path)
    assert len(frames) == 200_000
    assert (frames["id"] == 0x123).all()
    assert made == [_input.READ + _input.AHEAD]


def test_blanks_of_other_scripts_are_no_blanks() -> None:
    with pytest.raises(FormatError, match="line 1: "):
        read_text("\u2003(1.0) can0 123#\n".encode(), "candump")


@pytest.mark.parametrize("count", [1, 64, 4096])
def test_nuls_at_the_end_are_counted(count: int) -> None:
    frames, told = read_text(LINE + bytes(count), "candump")
    assert len(frames) == 1
    assert told == [f"ends in {count:,} NUL bytes; was the power cut? Frames may be missing"]


@pytest.mark.parametrize("raw", [b"\0\0\n" + LINE, LINE + b"\0\0\n" + LINE])
def test_nuls_elsewhere_are_text(raw: bytes) -> None:
    with pytest.raises(FormatError):
        read_text(raw, "candump")


def test_bytes_that_are_no_text_are_named_by_their_line() -> None:
    with pytest.raises(FormatError, match=r"^x\.log, line 2: .* is it raw bytes\?$"):
        read_text(LINE + b"\xaa\x55\xff\n", "candump")


def test_a_last_line_that_is_cut_is_left_out_and_told() -> None:
    frames, told = read_text(LINE * 3 + b"(1.0) can0 12", "candump")
    assert len(frames) == 3
    assert told == ["the last line is cut off, and left out"]
    # A file of this line alone is of another format.
    with pytest.raises(FormatError, match="line 1: "):
        read_text(b"(1.0) can0 12", "candump")


def test_bad_lines_are_counted_on_request() -> None:
    raw = LINE + b"bad\n" + LINE * 2 + b"worse\n"
    frames, told = read_text(raw, "candump", skip_bad=True)
    assert len(frames) == 3
    assert told[0].startswith("lines that cannot be read, left out: 2; the first is line 2: 'bad'")


def test_differences_are_added_up_on_request() -> None:
    raw = b"".join(b"(%d.5) can0 123#\n" % (number % 3) for number in range(30))
    assert read_text(raw, "candump")[1] == []  # too few to tell
    _, told = read_text(raw * 2, "candump")
    assert told[0].startswith("times go back 19 times; if they are differences, times='delta'")
    frames, told = read_text(raw, "candump", times="delta")
    assert [frame.ts for frame in frames[:4]] == [
        SECOND // 2,
        2 * SECOND,
        9 * SECOND // 2,
        5 * SECOND,
    ]
    assert told == []
