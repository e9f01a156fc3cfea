"""What the text formats share: seconds without rounding, and rows that are CAN frames."""

import io
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canser._rows import Row
from canser.errors import FormatError
from canser.files import _text
from canser.files._remarks import Unkept
from reference import NO_TIME
from samples import SECOND

TIMES = st.integers(NO_TIME + 1, 2**63 - 1)


def seconds(ts: int, places: int) -> str:
    """Return one time as the writers write it."""
    return _text.join(1, _text.seconds(np.array([ts], np.int64), places)).decode()


@pytest.mark.parametrize(
    ("ts", "text"),
    [
        (0, "0.000000000"),
        (1, "0.000000001"),
        (-1, "-0.000000001"),
        (-1_500_000_000, "-1.500000000"),
        (1_544_106_679_432_583_021, "1544106679.432583021"),
        (2**63 - 1, "9223372036.854775807"),
        (1 - 2**63, "-9223372036.854775807"),
    ],
)
def test_times_are_seconds_with_all_nanoseconds(ts: int, text: str) -> None:
    assert seconds(ts, 9) == text
    assert _text.parse_seconds(text) == ts


def test_places_that_are_not_asked_for_are_cut_and_not_rounded() -> None:
    assert seconds(1_999_999_999, 6) == "1.999999"
    assert seconds(-1_999_999_999, 6) == "-1.999999"


@given(TIMES)
def test_every_time_reads_back(ts: int) -> None:
    assert _text.parse_seconds(seconds(ts, 9)) == ts


@given(st.lists(TIMES))
def test_a_column_of_times_is_each_time_by_itself(times: list[int]) -> None:
    column = _text.seconds(np.array(times, np.int64), 9)
    assert _text.join(len(times), column, b"\n").decode().split() == [
        seconds(ts, 9) for ts in times
    ]


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
    assert _text.parse_seconds(text) == ts


@pytest.mark.parametrize(
    "text", ["9223372036.854775808", "-9223372036.854775808", "1e300", "inf", "1" * 60]
)
def test_a_time_that_does_not_fit_is_an_error_that_names_it(text: str) -> None:
    with pytest.raises(ValueError, match=f"the time {text} does not fit 64 bits of nanoseconds"):
        _text.parse_seconds(text)


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
        _text.parse_seconds(text)


def test_rows_come_in_blocks_that_together_are_all_rows() -> None:
    count = 2 * _text._BLOCK + 1

    def rows() -> Iterator[Row]:
        for number in range(count):
            yield (number % 0x800, False, False, 1, False, bytes([number % 256]), number)

    blocks = list(_text.in_blocks(rows()))
    assert [len(block) for block in blocks] == [_text._BLOCK, _text._BLOCK, 1]
    frames = np.concatenate(blocks)
    assert (frames["ts"] == np.arange(count)).all()
    assert (frames["data"][:, 0] == np.arange(count) % 256).all()


def test_lines_have_the_numbers_of_an_editor() -> None:
    file = io.BytesIO(b"\xef\xbb\xbffirst\r\n\n  \nfourth")
    assert list(_text.lines(file, "x", Unkept())) == [(1, "first"), (4, "fourth")]


def test_blanks_of_other_scripts_are_no_blanks() -> None:
    file = io.BytesIO("\u2003first\u2003\n\x1c\n".encode())
    assert list(_text.lines(file, "x", Unkept())) == [(1, "\u2003first\u2003"), (2, "\x1c")]


@pytest.mark.parametrize("count", [1, 64, 4096])
def test_nuls_at_the_end_are_counted(count: int) -> None:
    unkept = Unkept()
    file = io.BytesIO(b"first\n" + bytes(count))
    assert list(_text.lines(file, "x", unkept)) == [(1, "first")]
    assert unkept.remarks() == [
        f"ends in {count:,} NUL bytes; was the power cut? Frames may be missing"
    ]


@pytest.mark.parametrize("raw", [b"first\0\0", b"\0\0\nfirst\n", b"first\n\0\0\n"])
def test_nuls_elsewhere_are_text(raw: bytes) -> None:
    unkept = Unkept()
    texts = [text for _, text in _text.lines(io.BytesIO(raw), "x", unkept)]
    assert "\0\0" in "".join(texts)
    assert unkept.remarks() == []


def test_bytes_that_are_no_text_are_named_by_their_line() -> None:
    with pytest.raises(FormatError, match=r"^x\.log, line 2: .* is it raw bytes\?$"):
        list(_text.lines(io.BytesIO(b"good\n\xaa\x55\xff\n"), "x.log", Unkept()))
