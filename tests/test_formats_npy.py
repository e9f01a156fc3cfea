"""numpy's .npy: there and back, np.load as the peer, pipes, and files that are none."""

import io
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import canser
from canser._frames import FRAME_DTYPE
from canser.errors import CanserWarning, FormatError
from canser.files import npy
from canser.simulation.traffic import vehicle
from reference import Frame
from samples import FRAMES, array, frames_or_error, listed

TRAFFIC = vehicle(0.1)


class Pipe(io.BytesIO):
    """A stream that only goes forward."""

    def seekable(self) -> bool:
        return False

    def seek(self, *_: int) -> int:
        raise io.UnsupportedOperation("seek")

    def tell(self) -> int:
        raise io.UnsupportedOperation("tell")


def written(*blocks: canser.FrameArray) -> bytes:
    file = io.BytesIO()
    writer = npy.Writer(file)
    for block in blocks:
        writer.write(block)
    writer.finish()
    return file.getvalue()


def read(raw: bytes) -> list[Frame]:
    # A reader that never ends shows as a failure and not as a test that hangs.
    blocks = list(islice(npy.parse(io.BytesIO(raw), "x.npy", lambda _: None), 10))
    assert len(blocks) < 10, "the reader does not end"
    return listed(blocks)


@given(FRAMES)
def test_frames_read_back_exactly(frames: list[Frame]) -> None:
    assert read(written(array(*frames))) == frames


def test_blocks_are_one_array() -> None:
    assert written(TRAFFIC[:50], TRAFFIC[50:]) == written(TRAFFIC)


def test_more_frames_than_a_block_are_read() -> None:
    frames = np.tile(TRAFFIC, 65_536 // len(TRAFFIC) + 1)
    blocks = list(npy.parse(io.BytesIO(written(frames)), "x.npy"))
    assert len(blocks) == 2
    assert np.concatenate(blocks).tobytes() == frames.tobytes()


@pytest.mark.parametrize("count", [0, 1, len(TRAFFIC)])
def test_numpy_loads_what_is_written(tmp_path: Path, count: int) -> None:
    path = tmp_path / "x.npy"
    path.write_bytes(written(TRAFFIC[:count]))
    loaded = np.load(path)
    assert loaded.dtype == FRAME_DTYPE
    assert loaded.tobytes() == TRAFFIC[:count].tobytes()


def test_numpy_maps_what_is_written_and_it_can_be_encoded(tmp_path: Path) -> None:
    path = tmp_path / "x.npy"
    path.write_bytes(written(TRAFFIC))
    mapped = np.load(path, mmap_mode="r")
    assert isinstance(mapped, np.memmap)
    assert canser.encode(mapped, "serial") == canser.encode(TRAFFIC, "serial")


def test_what_numpy_saves_is_read() -> None:
    file = io.BytesIO()
    np.save(file, TRAFFIC)
    assert read(file.getvalue()) == listed(TRAFFIC)


def test_a_pipe_gets_the_same_bytes_as_a_file() -> None:
    pipe = Pipe()
    writer = npy.Writer(pipe)
    writer.write(TRAFFIC[:50])
    writer.write(TRAFFIC[50:])
    writer.finish()
    assert pipe.getvalue() == written(TRAFFIC)


def test_a_file_is_written_from_where_it_stands_and_left_at_its_end() -> None:
    file = io.BytesIO(b"before")
    file.seek(0, io.SEEK_END)
    writer = npy.Writer(file)
    writer.write(TRAFFIC)
    writer.finish()
    file.write(b"behind")
    assert file.getvalue() == b"before" + written(TRAFFIC) + b"behind"


@pytest.mark.parametrize("missing", [1, 23, 24, 25, 24 * 7])
def test_a_file_that_is_cut_off_says_after_how_many_frames(missing: int) -> None:
    have = (24 * len(TRAFFIC) - missing) // 24
    with pytest.raises(
        FormatError, match=f"^x.npy: ends after {have} of {len(TRAFFIC)} frames; is it cut off"
    ):
        read(written(TRAFFIC)[:-missing])


@pytest.mark.parametrize("raw", [b"", b"\x93NUM", b"(1.0) can0 123#00\n", b"\xaa\xc8" * 100])
def test_what_is_no_npy_file_is_named_so(raw: bytes) -> None:
    with pytest.raises(FormatError, match=r"^x\.npy: no \.npy file: "):
        read(raw)


@pytest.mark.parametrize(
    "other",
    [np.zeros(3), np.zeros((2, 2), FRAME_DTYPE), np.array(TRAFFIC[0]), np.array([{}, None])],
    ids=["floats", "two dimensions", "no dimension", "objects"],
)
def test_other_arrays_are_refused_with_what_would_be_read(other: np.ndarray) -> None:
    file = io.BytesIO()
    np.save(file, other)
    with pytest.raises(FormatError, match=r"^x\.npy: holds .* canser reads arrays of canser\.FRAM"):
        read(file.getvalue())


@pytest.mark.parametrize(
    ("field", "value"),
    [("id", 0x800), ("id", 0x2000_0000), ("dlc", 9)],
)
def test_a_record_that_is_no_can_frame_is_named_by_its_number(field: str, value: int) -> None:
    """Written as text it would become another frame without a word: 0x12345 would be 345."""
    frames = TRAFFIC.copy()
    frames["ext"] = value > 0x800
    frames["id"] &= 0x7FF
    frames[field][7] = value
    with pytest.raises(FormatError, match=rf"^x\.npy, frame 7: the {field} "):
        read(written(frames))


HEADER_LEN = len(written(TRAFFIC)) - TRAFFIC.nbytes


@given(
    st.lists(
        st.tuples(
            st.integers(0, HEADER_LEN - 1),
            st.sampled_from(list(b"'(){}[],:-+0123456789L\\\n\0\xff #\" ")),
        ),
        max_size=3,
    )
)
@example([(9, 0xFF)])
@example([(201, ord("-"))])
@example([(10, ord("("))])
def test_a_damaged_header_is_frames_or_a_format_error(changes: list[tuple[int, int]]) -> None:
    raw = bytearray(written(TRAFFIC))
    for place, value in changes:
        raw[place] = value
    frames_or_error(read, bytes(raw))


def test_bytes_behind_the_array_are_told() -> None:
    """As of two files that were joined: np.load passes over the second one without a word."""
    told: list[str] = []
    whole = written(TRAFFIC)
    frames = listed(npy.parse(io.BytesIO(whole * 2), "x.npy", told.append))
    assert frames == listed(TRAFFIC)
    assert told == [f"bytes behind the array, which are not read: {len(whole):,}"]
    with pytest.warns(CanserWarning, match=r"^x\.npy: bytes behind the array"):
        list(npy.parse(io.BytesIO(whole + b"1"), "x.npy"))


def test_a_negative_count_of_frames_is_a_format_error() -> None:
    raw = written(TRAFFIC)
    count = f"({len(TRAFFIC)},)".encode()
    assert count in raw
    with pytest.raises(FormatError):
        read(raw.replace(count, b"(-5,)".ljust(len(count))))


def test_a_header_that_is_too_long_is_an_error_of_one_line() -> None:
    raw = b"\x93NUMPY\x01\x00\xff\xff" + b" " * 0xFFFF
    with pytest.raises(FormatError) as error:
        read(raw)
    assert "\n" not in str(error.value)


@given(st.binary() | st.binary().map(b"\x93NUMPY\x01\x00".__add__))
def test_any_bytes_are_frames_or_a_format_error(raw: bytes) -> None:
    frames_or_error(read, raw)
