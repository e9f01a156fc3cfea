"""Parquet and Arrow IPC: there and back, as other programs see them, damage."""

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser.errors import FormatError
from canser.files import tables
from canser.simulation.traffic import vehicle
from reference import NO_TIME, Frame
from samples import EPOCH, FRAMES, SECOND, array, listed

pa = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")

every_format = pytest.mark.parametrize("suffix", [".parquet", ".arrow"])


@every_format
@given(frames=FRAMES, data=st.data())
def test_everything_there_and_back(
    suffix: str, frames: list[Frame], data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("arrow") / f"x{suffix}"
    codes = st.lists(st.integers(0, 255), min_size=len(frames), max_size=len(frames))
    channels = np.array(data.draw(codes), np.uint8)
    directions = channels % 2
    done = canser.write(array(*frames), path, channels=channels, directions=directions)
    assert done.remarks == []
    got_channels, got_directions = np.zeros((2, len(frames)), np.uint8)
    got = canser.read(path, channels=got_channels, directions=got_directions)
    assert listed(got) == frames
    assert (got_channels.tolist(), got_directions.tolist()) == (
        channels.tolist(),
        directions.tolist(),
    )


@every_format
def test_blocks_of_any_size_become_batches(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "_PIECE", 250)
    monkeypatch.setattr(tables, "_BATCH", 1000)
    frames = canser.concat([vehicle(1)] * 6)
    sizes = [1, 999, 500, 250, 240, 1010, 3000, 7]
    ends = np.cumsum(sizes)
    out = np.empty(4000, canser.FRAME_DTYPE)

    def blocks() -> object:
        for size, end in zip(sizes, ends, strict=True):
            block = out[:size]  # filled again and again
            block[:] = frames[end - size : end]
            yield block

    canser.write(blocks(), tmp_path / f"x{suffix}")  # type: ignore[arg-type]
    assert listed(canser.read(tmp_path / f"x{suffix}")) == listed(frames[: ends[-1]])
    if suffix == ".parquet":
        groups = parquet.ParquetFile(tmp_path / "x.parquet").metadata
        sizes = [groups.row_group(index).num_rows for index in range(groups.num_row_groups)]
        assert sum(sizes) == ends[-1]
        assert max(sizes) == 1000
        assert min(sizes[:-1]) > 1000 - 250
    with canser.blocks(tmp_path / f"x{suffix}", out=out[:77]) as read:
        assert [len(block) for block in read][:-1] == [77] * (int(ends[-1]) // 77)


@every_format
def test_pyarrow_sees_columns_with_their_types(suffix: str, tmp_path: Path) -> None:
    from pyarrow import feather  # noqa: PLC0415

    frames = [
        Frame(0x123, dlc=2, data=b"\1\2" + bytes(6), ts=EPOCH),
        Frame(0x1, ext=True, rtr=True, dlc=8, ts=NO_TIME),
    ]
    path = tmp_path / f"x{suffix}"
    canser.write(array(*frames), path, channels=np.array([3, 255], np.uint8))
    table = parquet.read_table(path) if suffix == ".parquet" else feather.read_table(path)
    assert table.schema.field("ts").type == pa.timestamp("ns", tz="UTC")
    assert table.column("ts").cast(pa.int64()).to_pylist() == [EPOCH, None]
    assert table.column("channel").to_pylist() == [3, None]
    assert table.column("sent").to_pylist() == [None, None]
    assert table.column("id").to_pylist() == [0x123, 1]
    assert table.column("rtr").to_pylist() == [False, True]
    assert table.column("data").to_pylist() == [b"\1\2" + bytes(6), bytes(8)]
    canser.write(array(Frame(1, ts=SECOND)), path, force=True)
    table = parquet.read_table(path) if suffix == ".parquet" else feather.read_table(path)
    assert table.schema.field("ts").type == pa.duration("ns")


@every_format
def test_no_frames(suffix: str, tmp_path: Path) -> None:
    canser.write(array(), tmp_path / f"x{suffix}")
    assert len(canser.read(tmp_path / f"x{suffix}")) == 0


def test_what_other_programs_wrote_is_read_if_it_has_the_columns(tmp_path: Path) -> None:
    columns = {
        "data": [b"\1\2\3\4\5\6\7\x08"] * 2,
        "ts": pa.array([EPOCH // 1000, None], pa.timestamp("us")),
        "id": pa.array([0x7FF, 0x123], pa.int64()),
        "dlc": pa.array([8, 2], pa.int8()),
        **{name: [False, False] for name in ("ext", "rtr", "err")},
        "more": [1, 2],
    }
    parquet.write_table(pa.table(columns), tmp_path / "x.parquet")
    assert listed(canser.read(tmp_path / "x.parquet")) == [
        Frame(0x7FF, dlc=8, data=bytes(range(1, 9)), ts=EPOCH),
        Frame(0x123, dlc=2, data=b"\1\2" + bytes(6), ts=NO_TIME),
    ]
    wrong = {
        "no column id, dlc; canser reads the columns ts, channel": {"id": None, "dlc": None},
        "frame 1: the id 0x800 is over 0x7ff": {"id": pa.array([1, 0x800])},
        "frame 1: dlc is null": {"dlc": pa.array([1, None])},
        "a column is not as canser writes it: ": {"data": ["text", "more"]},
    }
    for message, change in wrong.items():
        changed = {name: each for name, each in {**columns, **change}.items() if each is not None}
        parquet.write_table(pa.table(changed), tmp_path / "y.parquet")
        with pytest.raises(FormatError, match=message) as error:
            canser.read(tmp_path / "y.parquet")
        assert "\n" not in str(error.value)


@every_format
def test_damage_is_one_line(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"x{suffix}"
    canser.write(vehicle(1), path)
    whole = path.read_bytes()
    for length in (9, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(FormatError, match="cannot be read: ") as error:
            canser.read(path)
        assert "\n" not in str(error.value)


@every_format
def test_a_pipe_is_refused(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"x{suffix}"
    canser.write(vehicle(1), path)
    packed = tmp_path / f"x{suffix}.gz"
    canser.write(vehicle(1), packed)
    with pytest.raises(FormatError, match="cannot be a pipe or packed; put it into a file"):
        canser.read(packed)


def test_without_pyarrow_the_package_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    canser.write(vehicle(1), tmp_path / "x.parquet")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    for call in (
        lambda: canser.read(tmp_path / "x.parquet"),
        lambda: canser.write(vehicle(1), tmp_path / "y.parquet"),
    ):
        with pytest.raises(FormatError, match=r"not installed: pip install 'canser\[arrow\]'"):
            call()
    assert [path.name for path in tmp_path.iterdir()] == ["x.parquet"]


def test_blocks_of_a_stream_are_not_taken_for_long_if_they_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    taken = []

    def stream() -> Iterator[canser.FrameArray]:
        for _ in range(1000):
            taken.append(True)
            yield vehicle(0.1)
            time.sleep(0.01)

    with pytest.raises(FormatError, match="not installed"):
        canser.write(stream(), tmp_path / "x.parquet")
    assert len(taken) < 1000
