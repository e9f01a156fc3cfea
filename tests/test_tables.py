"""Tables: what other programs see of them, and whose memory it is, to the interpreter's end."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser.tables.table import COLUMNS
from reference import NO_TIME, Frame
from samples import FRAMES, array

Codes = list[int] | None


def plain(frames: list[Frame], channels: Codes, directions: Codes) -> dict[str, list[Any]]:
    """Return the values of a table by columns, from frames one by one."""
    unknown = [None] * len(frames)
    return {
        "ts": [None if frame.ts == NO_TIME else frame.ts for frame in frames],
        "channel": unknown if channels is None else [None if c == 255 else c for c in channels],
        "sent": unknown if directions is None else [each == 1 for each in directions],
        **{name: [getattr(each, name) for each in frames] for name in COLUMNS[3:]},
    }


def by_pyarrow(table: canser.Table) -> dict[str, list[Any]]:
    pa = pytest.importorskip("pyarrow")
    batch = pa.record_batch(table)
    batch.validate(full=True)
    assert batch.schema.equals(pa.schema(table))
    assert pa.table(table).equals(pa.Table.from_batches([batch]))
    columns: dict[str, list[Any]] = {name: batch[name].to_pylist() for name in COLUMNS[1:]}
    columns["ts"] = batch["ts"].cast(pa.int64()).to_pylist()
    for name in COLUMNS:
        assert batch[name].null_count == columns[name].count(None)
    return columns


def by_polars(table: canser.Table) -> dict[str, list[Any]]:
    pl = pytest.importorskip("polars")
    whole = pl.DataFrame(table)
    columns: dict[str, list[Any]] = whole.with_columns(ts=pl.col("ts").cast(pl.Int64)).to_dict(
        as_series=False
    )
    return columns


def by_nanoarrow(table: canser.Table) -> dict[str, list[Any]]:
    na = pytest.importorskip("nanoarrow")
    whole = na.c_array(table)
    columns = {name: na.Array(whole.child(at)).to_pylist() for at, name in enumerate(COLUMNS) if at}
    # nanoarrow makes datetimes of times, in microseconds: so the column's buffers are read.
    times, count = whole.child(0).view(), len(table)
    values = np.frombuffer(times.buffer(1), np.int64, count).tolist()
    bits = np.ones(count, np.uint8)
    if times.null_count:
        bits = np.unpackbits(np.frombuffer(times.buffer(0), np.uint8), bitorder="little")
    columns["ts"] = [ts if bit else None for ts, bit in zip(values, bits[:count], strict=True)]
    return columns


every_taker = pytest.mark.parametrize("take", [by_pyarrow, by_polars, by_nanoarrow])


def codes(most: int, count: int) -> st.SearchStrategy[Codes]:
    return st.none() | st.lists(st.integers(0, most), min_size=count, max_size=count)


@every_taker
@given(frames=FRAMES, data=st.data())
def test_every_program_sees_the_same_values(
    take: Any, frames: list[Frame], data: st.DataObject
) -> None:
    channels = data.draw(codes(255, len(frames)))
    directions = data.draw(codes(1, len(frames)))
    table = canser.table(
        array(*frames),
        channels=None if channels is None else np.array(channels, np.uint8),
        directions=None if directions is None else np.array(directions, np.uint8),
    )
    assert len(table) == len(frames)
    assert take(table) == plain(frames, channels, directions)


@every_taker
@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 63, 64, 65, 511, 512, 513])
def test_tables_of_any_length(take: Any, count: int) -> None:
    frames = [
        Frame(at % 0x7FF, ts=NO_TIME if at % 3 else at, err=at % 5 == 0) for at in range(count)
    ]
    assert take(canser.table(array(*frames))) == plain(frames, None, None)
