"""The record and the filters."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest

import canser
from canser._frames import (
    FRAME_DTYPE,
    NO_TIME,
    FrameArray,
    contiguous_frames,
    copy_records,
    put_records,
)


def frames_of(*rows: tuple[int, bool, bool, bool]) -> canser.FrameArray:
    frames = np.zeros(len(rows), FRAME_DTYPE)
    for frame, (arbitration_id, ext, rtr, err) in zip(frames, rows, strict=True):
        frame["id"], frame["ext"], frame["rtr"], frame["err"] = arbitration_id, ext, rtr, err
    return frames


def test_record_is_laid_out_as_documented() -> None:
    assert FRAME_DTYPE.itemsize == 24
    assert FRAME_DTYPE.alignment == 8
    assert FRAME_DTYPE.fields is not None
    layout = {name: (field[1], str(field[0])) for name, field in FRAME_DTYPE.fields.items()}
    assert layout == {
        "id": (0, "uint32"),
        "ext": (4, "bool"),
        "rtr": (5, "bool"),
        "dlc": (6, "uint8"),
        "err": (7, "bool"),
        "data": (8, "('u1', (8,))"),
        "ts": (16, "int64"),
    }


def test_times_are_datetime64_without_a_copy() -> None:
    frames = np.zeros(2, FRAME_DTYPE)
    frames["ts"] = [NO_TIME, 1_500_000_000]
    for kind in ("M8[ns]", "m8[ns]"):
        times = frames["ts"].view(kind)
        assert np.shares_memory(times, frames)
        assert np.isnat(times[0])
    assert frames["ts"].view("m8[ns]")[1] == np.timedelta64(1500, "ms")


STD, EXT, RTR, ERR, OTHER = range(5)
SOME = frames_of(
    (0x123, False, False, False),
    (0x00000123, True, False, False),
    (0x123, False, True, False),
    (0x020, False, False, True),
    (0x456, False, False, False),
)


@pytest.mark.parametrize(
    ("filters", "expected"),
    [
        ((), {STD, EXT, RTR, ERR, OTHER}),
        # The examples of candump's manual page.
        (("123:7FF",), {STD, EXT, RTR}),
        (("123:C00007FF",), {STD}),
        (("123~7FF",), {OTHER}),
        (("0:0",), {STD, EXT, RTR, OTHER}),
        (("#FFFFFFFF",), {ERR}),
        (("#00000010",), set()),
        # Eight digits mean extended, where the mask asks for it.
        (("00000123:DFFFFFFF",), {EXT}),
        (("00000123:1FFFFFFF",), {STD, EXT, RTR}),
        (("00000123~9FFFFFFF",), {STD, RTR, OTHER}),
        # Several: any of them.
        (("456:7FF", "#1FFFFFFF"), {OTHER, ERR}),
        (("123:7ff", "456:7ff"), {STD, EXT, RTR, OTHER}),
        # 0x is allowed, and adds no digits.
        (("0x123:0X7FF",), {STD, EXT, RTR}),
        (("0x00000123:0xDFFFFFFF",), {EXT}),
        (("0x123~0x7ff",), {OTHER}),
        (("#0xFF",), {ERR}),
    ],
)
def test_match_is_can_utils_notation(filters: tuple[str, ...], expected: set[int]) -> None:
    assert set(np.flatnonzero(canser.match(SOME, *filters))) == expected


@pytest.mark.parametrize(
    ("text", "same", "expected"),
    [
        ("123", "123:800007FF", {STD, RTR}),
        ("0x123", "123:800007FF", {STD, RTR}),
        ("00000123", "00000123:9FFFFFFF", {EXT}),
        ("0X00000123", "00000123:9FFFFFFF", {EXT}),
        # Neither the error frame 020 nor an id that ends so: three digits are never a suffix.
        ("020", "020:800007FF", set()),
        ("20", "020:800007FF", set()),
        ("6", "006:800007FF", set()),
    ],
)
def test_digits_alone_are_exactly_that_id(text: str, same: str, expected: set[int]) -> None:
    assert set(np.flatnonzero(canser.match(SOME, text))) == expected
    assert set(np.flatnonzero(canser.match(SOME, same))) == expected


def test_every_standard_id_alone_passes_itself_only() -> None:
    every = np.zeros(0x1000, FRAME_DTYPE)
    every["id"] = np.arange(0x1000) % 0x800
    every["ext"][0x800:] = True
    for number in range(0x800):
        for text in {f"{number:X}", f"{number:03x}"}:
            assert np.flatnonzero(canser.match(every, text)).tolist() == [number]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1234", "has 4 digits; a standard id has up to three, an extended id eight: "),
        ("0x1234", "write 00001234, or ID:MASK"),
        ("18FEF1", "has 6 digits"),
        ("0000123", "write 00000123"),
        ("800", "is over 7FF, the largest standard id; write 00000800 for the extended id"),
        ("20000080", "is over 1FFFFFFF, the largest extended id; .* #MASK for error frames"),
    ],
)
def test_digits_that_are_no_id_are_an_error_with_the_remedy(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=f"^the filter '{text}' .*{reason}"):
        canser.match(SOME, "123:7FF", text)


def test_match_keeps_the_shape() -> None:
    assert canser.match(SOME[:4].reshape(2, 2), "123:7FF").shape == (2, 2)
    assert canser.match(SOME[:0], "123:7FF").shape == (0,)


@pytest.mark.parametrize(
    "text",
    [
        *("", "12G", "123:", ":7FF", "123:7FG", "123#7FF", "~7FF", "123456789:7FF", " 1:2", "#"),
        *("123456789", "0x", "0x:7FF", "0x#FF", "00x123", "1_2", "+12", "12 ", "12\n"),
        *("1_2:7FF", "123:0x", "\u0661\u0662\u0663", "\u0661:7FF", "0x0x12:7FF"),
    ],
)
def test_a_filter_that_cannot_be_read_is_an_error_with_the_remedy(text: str) -> None:
    with pytest.raises(ValueError, match=r"cannot read the filter .*ID:MASK"):
        canser.match(SOME, text)


def test_match_of_no_frames_is_an_error() -> None:
    with pytest.raises(TypeError, match=r"frames must be an array of canser\.FRAME_DTYPE"):
        canser.match(np.zeros(3))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="not list"):
        canser.match([1, 2], "1:1")  # type: ignore[arg-type]


def counted(count: int) -> FrameArray:
    """Return frames of which each byte is another one than that of its neighbours."""
    size = count * FRAME_DTYPE.itemsize
    return np.frombuffer((np.arange(size) * 37 % 251).astype(np.uint8).tobytes(), FRAME_DTYPE)


def misaligned(frames: FrameArray) -> FrameArray:
    return np.frombuffer(b"x" + frames.tobytes(), FRAME_DTYPE, offset=1)


# Arrays as users have them, each made of some frames.
KINDS: dict[str, Callable[[FrameArray], FrameArray]] = {
    "whole": lambda frames: frames,
    "none": lambda frames: frames[:0],
    "every other one": lambda frames: frames[::2],
    "backwards": lambda frames: frames[::-1],
    "at an odd address": misaligned,
    "every other one at an odd address": lambda frames: misaligned(frames)[1::2],
    "one, over and over": lambda frames: np.broadcast_to(frames[3], 9),
    "a table": lambda frames: frames[:8].reshape(2, 4),
    "a table across": lambda frames: frames[:8].reshape(2, 4).T,
    "recarray": lambda frames: frames.view(np.recarray),
}


@pytest.mark.parametrize("kind", KINDS)
def test_records_are_copied_as_numpy_copies_them(kind: str) -> None:
    frames = KINDS[kind](counted(20))
    copy = copy_records(frames)
    assert copy.tobytes() == frames.tobytes()
    assert copy.shape == frames.shape
    assert copy.dtype == FRAME_DTYPE
    assert copy.flags.c_contiguous
    assert copy.flags.owndata
    assert copy.flags.writeable
    assert copy.flags.aligned


@pytest.mark.parametrize("kind", ["every other one", "backwards", "at an odd address"])
def test_records_are_put_where_an_array_may_be(kind: str) -> None:
    room = bytearray(b"\xee" * (FRAME_DTYPE.itemsize * 20 + 1))
    offset = kind == "at an odd address"
    whole = np.frombuffer(room, FRAME_DTYPE, count=20, offset=offset)
    target = {"every other one": whole[::2], "backwards": whole[::-1]}.get(kind, whole)
    put_records(target, counted(20)[: len(target)])
    assert target.tobytes() == counted(20)[: len(target)].tobytes()
    assert room.count(b"\xee" * 24) >= (10 if kind == "every other one" else 0)


def test_records_that_overlap_are_moved() -> None:
    frames = counted(20).copy()
    put_records(frames[1:], frames[:-1])
    assert frames[1:].tobytes() == counted(20)[:-1].tobytes()


@pytest.mark.parametrize("kind", ["every other one", "backwards", "at an odd address", "recarray"])
def test_frames_are_copied_for_c_where_need_be(kind: str) -> None:
    frames = KINDS[kind](counted(20))
    plain = contiguous_frames(frames)
    assert plain.flags.c_contiguous
    assert plain.flags.aligned
    assert plain.tobytes() == frames.tobytes()
    assert (plain is frames) == (kind == "recarray")


def test_other_records_are_copied_too() -> None:
    rows = np.array([(1, 2.5, b"abc"), (3, 4.5, b"de")], [("a", "i2"), ("b", "f8"), ("c", "S3")])
    assert copy_records(rows).tolist() == rows.tolist()
    assert copy_records(rows).dtype == rows.dtype


def test_concat_joins_arrays_in_their_order() -> None:
    frames = counted(60)
    parts = [frames[:7], frames[7:7], misaligned(frames[7:30]), frames[::-1][:30][::-1]]
    joined = canser.concat(parts)
    assert joined.tobytes() == frames.tobytes()
    assert joined.dtype == FRAME_DTYPE
    assert joined.base is None
    assert joined.flags.owndata
    assert joined.flags.writeable
    assert canser.concat(part for part in parts).tobytes() == frames.tobytes()
    assert canser.concat([frames[::3].view(np.recarray)]).tobytes() == frames[::3].tobytes()


def test_concat_of_one_array_is_a_copy() -> None:
    frames = counted(3)
    joined = canser.concat([frames])
    assert not np.shares_memory(joined, frames)
    assert joined.tobytes() == frames.tobytes()


@pytest.mark.parametrize("arrays", [[], (), iter([]), [counted(0)], [counted(0)] * 3])
def test_concat_of_nothing_is_empty(arrays: Iterable[FrameArray]) -> None:
    joined = canser.concat(arrays)
    assert joined.shape == (0,)
    assert joined.dtype == FRAME_DTYPE


@pytest.mark.parametrize(
    ("arrays", "error", "text"),
    [
        (counted(2), TypeError, "arrays must be a list of arrays of frames, not one array"),
        ([counted(2), np.zeros(2)], TypeError, r"arrays\[1\] must be .* not an array of float64"),
        ([[1, 2]], TypeError, r"arrays\[0\] must be .* not list"),
        ([counted(2)[0]], TypeError, r"arrays\[0\] must be"),
        ([counted(2).reshape(1, 2)], ValueError, r"arrays\[0\] has 2 dimensions; it must have one"),
        ([counted(2).astype(FRAME_DTYPE.newbyteorder())], TypeError, r"arrays\[0\] must be"),
        (3, TypeError, "not iterable"),
        ([np.ma.masked_array(counted(2))], TypeError, r"arrays\[0\] is a masked array"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_concat_of_anything_else_is_an_error(
    arrays: Any, error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        canser.concat(arrays)
