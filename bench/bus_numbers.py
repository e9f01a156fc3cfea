"""Statistics of frames, and tables: over numpy, over a plain C loop, over pyarrow.

Rows of `table.py`. The results are compared first.
"""

import ctypes
import os
import shlex
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

import canser
import data
from canser._frames import FrameArray
from measure import paired


class NumberRow(NamedTuple):
    """A line of the table."""

    what: str
    protocol: str
    reached: float
    required: float | None
    note: str = ""


HERE = Path(__file__).parent


def plain_bits(folder: Path) -> Callable[[FrameArray, npt.NDArray[np.uint8]], None]:
    """Return the plain C loop, which sets the length of each frame on the bus."""
    library = folder / "plain_bits.so"
    compiler = shlex.split(os.environ.get("CC") or "cc")
    options = ["-O3", "-std=c11", "-shared", "-fPIC", f"-I{HERE.parent / 'csrc'}"]
    command = [*compiler, *options, str(HERE / "plain_bits.c"), "-o", str(library)]
    subprocess.run(command, check=True)
    function = ctypes.CDLL(str(library)).plain_lengths

    def lengths(frames: FrameArray, bits: npt.NDArray[np.uint8]) -> None:
        function(
            ctypes.c_void_p(frames.ctypes.data),
            ctypes.c_size_t(len(frames)),
            ctypes.c_void_p(bits.ctypes.data),
        )

    return lengths


def keys_of(frames: FrameArray) -> npt.NDArray[np.uint32]:
    """Return what tells the rows apart: id, and the three flags above it."""
    keys: npt.NDArray[np.uint32] = frames["id"].copy()
    for bit, name in ((31, "err"), (30, "ext"), (29, "rtr")):
        keys |= frames[name].astype(np.uint32) << np.uint32(bit)
    return keys


def sorted_by_id(frames: FrameArray) -> tuple[Any, Any, Any]:
    """Return a stable order by id, the sorted keys, and where each id begins."""
    keys = keys_of(frames)
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    return order, keys, np.flatnonzero(np.r_[True, keys[1:] != keys[:-1]])


def changed(frames: FrameArray, order: Any, keys: Any) -> npt.NDArray[np.bool_]:
    """Return which of the sorted frames are the first of their id, or differ from the last."""
    payload = np.ascontiguousarray(frames["data"]).view(np.uint64)[:, 0][order]
    dlc = frames["dlc"][order]
    marks = np.ones(len(frames), np.bool_)
    marks[1:] = (keys[1:] != keys[:-1]) | (payload[1:] != payload[:-1]) | (dlc[1:] != dlc[:-1])
    return marks


def numpy_stats(frames: FrameArray) -> dict[str, Any]:
    """Return the statistics of each id as a user of numpy finds them."""
    order, keys, starts = sorted_by_id(frames)
    ts = frames["ts"][order]
    counts = np.diff(np.r_[starts, len(keys)])
    steps = np.diff(ts, prepend=ts[:1])
    inside = np.ones(len(ts), np.bool_)
    inside[starts] = False
    most = np.iinfo(np.int64).max
    return {
        "id": keys[starts],
        "count": counts,
        "first_ns": ts[starts],
        "last_ns": ts[starts + counts - 1],
        "changes": np.add.reduceat(changed(frames, order, keys), starts, dtype=np.int64) - 1,
        "interval_min_ns": np.minimum.reduceat(np.where(inside, steps, most), starts),
        "interval_max_ns": np.maximum.reduceat(np.where(inside, steps, -1), starts),
        "interval_mean_ns": (ts[starts + counts - 1] - ts[starts]) / np.maximum(counts - 1, 1),
    }


def numpy_quantiles(frames: FrameArray) -> dict[str, Any]:
    """Return the same, with the median and the 99th percentile of each id."""
    found = numpy_stats(frames)
    order, _, starts = sorted_by_id(frames)
    parts = np.split(frames["ts"][order], starts[1:])
    steps = [np.diff(part) for part in parts]
    found["interval_median_ns"] = [np.median(each) for each in steps]
    found["interval_p99_ns"] = [np.percentile(each, 99) for each in steps]
    return found


def numpy_changes(frames: FrameArray) -> FrameArray:
    """Return the frames that change."""
    order, keys, _ = sorted_by_id(frames)
    marks = np.zeros(len(frames), np.bool_)
    marks[order[changed(frames, order, keys)]] = True
    return frames.compress(marks)


def _compare_stats(frames: FrameArray) -> None:
    found, expected = canser.id_stats(frames), numpy_quantiles(frames)
    for name in expected.keys() - {"id", "interval_p99_ns"}:
        assert np.allclose(found[name], expected[name], rtol=1e-12), f"{name} is wrong"


def traffic(count: int) -> FrameArray:
    """Return periodic data frames without jumps of the clock."""
    frames = data.periodic(count * 11 // 10, "serial")
    return frames.compress(~(frames["rtr"] | frames["err"]))[:count]


def rows(count: int, rounds: int, folder: Path) -> Iterator[NumberRow]:
    """Yield the rows."""
    frames, plain = traffic(count), plain_bits(folder)
    _compare_stats(frames)
    groups, (order, _, starts) = canser.by_id(frames), sorted_by_id(frames)
    assert np.array_equal(groups.order, order), "the order by id is wrong"
    assert groups.offsets.tolist() == [*starts.tolist(), len(frames)]
    assert np.array_equal(canser.changes(frames), numpy_changes(frames)), "changes are wrong"
    bits = np.zeros(len(frames), np.uint8)
    plain(frames, bits)
    assert np.array_equal(canser.frame_bits(frames), bits), "bits are wrong"
    pairs: list[tuple[str, Callable[[], object], Callable[[], object], float]] = [
        (
            "id_stats without patterns, over numpy",
            lambda: numpy_stats(frames),
            lambda: canser.id_stats(frames, patterns=False),
            20,
        ),
        (
            "id_stats, over numpy",
            lambda: numpy_quantiles(frames),
            lambda: canser.id_stats(frames),
            5,
        ),
        ("changes, over numpy", lambda: numpy_changes(frames), lambda: canser.changes(frames), 20),
        ("by_id, over numpy", lambda: sorted_by_id(frames), lambda: canser.by_id(frames), 5),
        (
            "frame_bits, over a plain C loop",
            lambda: plain(frames, bits),
            lambda: canser.frame_bits(frames),
            5,
        ),
        *_table_pair(frames),
    ]
    for what, peer, ours, required in pairs:
        peer_s, our_s, ratio = paired(peer, ours, rounds)
        note = f"{count / our_s / 1e6:.1f} M frames/s, peer {count / peer_s / 1e6:.1f}"
        yield NumberRow(what, "", ratio, required, note)


def _table_pair(
    frames: FrameArray,
) -> Iterator[tuple[str, Callable[[], object], Callable[[], object], float]]:
    """Yield the row of tables, if pyarrow is there."""
    try:
        import pyarrow as pa  # noqa: PLC0415 - an optional extra
    except ImportError:
        return

    def by_pyarrow() -> Any:
        count = len(frames)
        data = pa.py_buffer(np.ascontiguousarray(frames["data"]))
        return pa.table(
            {
                "ts": np.ascontiguousarray(frames["ts"]).view("m8[ns]"),
                "channel": pa.nulls(count, pa.uint8()),
                "sent": pa.nulls(count, pa.bool_()),
                "id": np.ascontiguousarray(frames["id"]),
                **{name: np.ascontiguousarray(frames[name]) for name in ("ext", "rtr", "err")},
                "dlc": np.ascontiguousarray(frames["dlc"]),
                "data": pa.Array.from_buffers(pa.binary(8), count, [None, data]),
            }
        )

    assert canser.to_arrow(frames).equals(by_pyarrow()), "the table is wrong"
    yield "to_arrow, over pyarrow", by_pyarrow, lambda: canser.to_arrow(frames), 1


def main() -> None:
    """Print the rows alone."""
    import tempfile  # noqa: PLC0415

    with tempfile.TemporaryDirectory() as folder:
        for row in rows(4_000_000, 7, Path(folder)):
            print(f"{row.what:40} {row.reached:8.3g} {row.required:8.3g}  {row.note}", flush=True)


if __name__ == "__main__":
    main()
