"""Tables: what other programs see of them, and whose memory it is, to the interpreter's end."""

import gc
import subprocess
import sys
import threading
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser.simulation.traffic import vehicle
from canser.tables.table import COLUMNS
from reference import NO_TIME, Frame
from samples import EPOCH, FRAMES, SECOND, array, timed

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


def times_of(table: canser.Table) -> Any:
    """Return the type of the times as C tells it."""
    na = pytest.importorskip("nanoarrow")
    return na.c_schema(table).child(0).format


@pytest.mark.parametrize(
    ("times", "dated"),
    [
        ((), False),
        ((NO_TIME,), False),
        ((NO_TIME,) * 5000, False),
        ((946_684_800 * SECOND - 1, EPOCH), False),
        ((946_684_800 * SECOND, 0), True),
        ((NO_TIME, EPOCH), True),
        ((NO_TIME,) * 5000 + (EPOCH, 0), True),
        ((NO_TIME,) * 5000 + (0, EPOCH), False),
    ],
)
def test_times_are_dates_if_the_first_known_one_is(times: tuple[int, ...], dated: bool) -> None:
    table = canser.table(timed(*times))
    assert times_of(table) == ("tsn:UTC" if dated else "tDn")
    assert ("dates in UTC" if dated else "durations") in repr(table)
    assert f"{len(times):,} rows" in repr(table)


def test_dates_are_dates_for_other_programs() -> None:
    pl = pytest.importorskip("polars")
    pa = pytest.importorskip("pyarrow")
    table = canser.table(timed(EPOCH))
    assert pl.DataFrame(table).schema["ts"] == pl.Datetime("ns", "UTC")
    assert pl.DataFrame(table)["ts"][0].isoformat() == "2018-12-06T14:31:19.432583+00:00"
    assert pa.table(table).schema.field("ts").type == pa.timestamp("ns", tz="UTC")
    assert pl.DataFrame(canser.table(timed(0))).schema["ts"] == pl.Duration("ns")


@every_taker
def test_frames_are_copied_at_the_call(take: Any) -> None:
    frames = canser.frames((1, b"a"))
    channels = np.array([3], np.uint8)
    table = canser.table(frames, channels=channels)
    before = take(table)
    frames[:] = array(Frame(2, ext=True, rtr=True, ts=EPOCH))
    channels[:] = 4
    assert take(table) == before
    assert before["id"] == [1]


def misaligned(frames: canser.FrameArray) -> canser.FrameArray:
    room = np.zeros(frames.nbytes + 1, np.uint8)
    shifted = room[1:].view(canser.FRAME_DTYPE)
    shifted.view("V24")[:] = frames.view("V24")
    return shifted


@every_taker
def test_frames_may_lie_anywhere(take: Any) -> None:
    frames = vehicle(1)[:1001]
    channels = np.arange(1001).astype(np.uint8)
    for some, codes_ in (
        (frames[::2], channels[::2]),
        (frames[::-1], channels[::-1]),
        (misaligned(frames), channels),
    ):
        copied = np.frombuffer(some.tobytes(), canser.FRAME_DTYPE)
        expected = canser.table(copied, channels=codes_.copy(), directions=codes_.copy() % 2)
        got = canser.table(some, channels=codes_, directions=np.repeat(codes_ % 2, 3)[::3])
        assert take(got) == take(expected)
        assert take(got)["id"] == some["id"].tolist()


def test_arguments_are_checked() -> None:
    frames = vehicle(1)[:3]
    three, four = np.zeros(3, np.uint8), np.zeros(4, np.uint8)
    with pytest.raises(TypeError, match=r"records must be an array of .*, not list"):
        canser.table([1])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="records has 2 dimensions"):
        canser.table(frames[None])
    with pytest.raises(TypeError, match="channels must be an array of uint8, not list"):
        canser.table(frames, channels=[0, 1, 2])  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="directions must be an array of uint8"):
        canser.table(frames, directions=np.zeros(3, np.int64))
    with pytest.raises(ValueError, match=r"channels has the shape \(4,\), frames have \(3,\)"):
        canser.table(frames, channels=four)
    with pytest.raises(TypeError, match="directions is a masked array"):
        canser.table(frames, directions=np.ma.array(three))


@pytest.mark.skipif(sys.platform != "linux", reason="memory is limited by Linux")
def test_without_memory_the_error_says_how_many_frames() -> None:
    said = run(
        """
import canser, numpy as np, resource
frames = np.zeros(4_000_000, canser.FRAME_DTYPE)
canser.table(frames[:1])
with open("/proc/self/statm") as file:
    pages = int(file.read().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 2**26,) * 2)
try:
    canser.table(frames)
except MemoryError as error:
    print(error)
"""
    )
    assert said == "there is no memory for a table of 4,000,000 rows\n"


# ---- Whose memory it is.


def test_each_capsule_has_its_name_and_is_taken_once() -> None:
    pa = pytest.importorskip("pyarrow")
    table = canser.table(vehicle(1)[:10])
    schema, rows = table.__arrow_c_array__()
    assert '"arrow_schema"' in repr(schema)
    assert '"arrow_array"' in repr(rows)
    assert '"arrow_array_stream"' in repr(table.__arrow_c_stream__(table.__arrow_c_schema__()))
    # Each call gives new ones, and a taken one is not taken again.
    assert len(pa.RecordBatch._import_from_c_capsule(schema, rows)) == 10
    with pytest.raises(pa.ArrowInvalid, match="released"):
        pa.RecordBatch._import_from_c_capsule(*(table.__arrow_c_schema__(), rows))
    assert len(pa.record_batch(table)) == 10


def test_takers_share_the_memory_of_the_table() -> None:
    pa = pytest.importorskip("pyarrow")
    table = canser.table(vehicle(1))
    one, other = pa.record_batch(table), pa.table(table)
    for name in COLUMNS:
        shared = [column.buffers()[1].address for column in (one[name], other[name].chunk(0))]
        assert shared[0] == shared[1]
        assert shared[0] % 64 == 0


def resident_kib() -> int:
    """Return the memory of this process, in KiB."""
    with open("/proc/self/status", encoding="ascii") as status:  # noqa: PTH123 - no file
        return next(int(line.split()[1]) for line in status if line.startswith("VmRSS"))


def leave_capsules(table: canser.Table) -> None:
    table.__arrow_c_schema__()
    table.__arrow_c_array__()
    table.__arrow_c_stream__()


def take_some(table: canser.Table) -> None:
    pa = pytest.importorskip("pyarrow")
    pa.schema(table)
    rows = pa.record_batch(table)
    del table
    assert len(rows["id"]) == len(rows)


@pytest.mark.skipif(sys.platform != "linux", reason="memory is read from /proc")
@pytest.mark.parametrize("use", [leave_capsules, take_some])
def test_nothing_is_left_of_tables(use: Any) -> None:
    frames, few = canser.concat([vehicle(1)] * 5), vehicle(1)[:1]
    for _ in range(10):
        use(canser.table(frames))
    gc.collect()
    before = resident_kib()
    for _ in range(100):
        use(canser.table(frames))
    small = canser.table(few)
    for _ in range(20_000 if use is leave_capsules else 2_000):
        use(small)
    gc.collect()
    # One table, or a hundred bytes lost in each small one, would be more.
    assert resident_kib() - before < 1024 < len(frames) * 23 * 100 // 1024


def test_a_column_outlives_its_table_and_ends_in_another_thread() -> None:
    pa = pytest.importorskip("pyarrow")
    frames = vehicle(1)
    held = [pa.record_batch(canser.table(frames))["id"]]
    held += pa.table(canser.table(frames))["dlc"].chunks
    held += [canser.table(frames).__arrow_c_array__(), canser.table(frames)]
    gc.collect()
    assert held[0].to_pylist() == frames["id"].tolist()
    thread = threading.Thread(target=held.clear)
    thread.start()
    thread.join()
    assert not held


def test_threads_share_a_table() -> None:
    pa = pytest.importorskip("pyarrow")
    frames = vehicle(1)
    table, found = canser.table(frames), []

    def work() -> None:
        for _ in range(200):
            leave_capsules(table)
            found.append(pa.record_batch(table)["id"][-1].as_py() == int(frames["id"][-1]))

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [True] * 800


def run(code: str) -> str:
    """Run a program to its end; return what it prints."""
    done = subprocess.run(
        [sys.executable, "-X", "dev", "-c", code], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


FRAMES_THERE = """
import canser, sys
frames = canser.frames("123#01", "18FEF100#0203")
table = canser.table(frames)
"""


def test_polars_needs_no_pyarrow() -> None:
    pytest.importorskip("polars")
    said = run(
        FRAMES_THERE
        + """
sys.modules["pyarrow"] = None
import polars
found = polars.DataFrame(table)
print(found["id"].to_list(), found["data"].to_list()[0][:2], found["ts"].null_count())
"""
    )
    assert said == "[291, 419361024] b'\\x01\\x00' 2\n"


def test_consumers_may_outlive_the_interpreter() -> None:
    pytest.importorskip("pyarrow")
    said = run(
        FRAMES_THERE
        + """
import atexit, ctypes, pyarrow
kept = pyarrow.record_batch(table)["id"]
capsules = table.__arrow_c_array__(), table.__arrow_c_stream__()
# One reference more: they are alive when the interpreter has ended, and pyarrow releases the
# columns, if at all, when Python is no more.
for each in (kept, table, *capsules[0], capsules[1]):
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(each))
sys.kept = kept, table, capsules
print(kept.to_pylist())
"""
    )
    assert said == "[291, 419361024]\n"


@pytest.mark.skipif(sys.platform == "win32", reason="its C library has no __cxa_atexit")
def test_release_callbacks_run_when_python_has_ended() -> None:
    said = run(
        """
import canser, ctypes
frames = canser.frames((1, b"alive\\0"))
rows = canser.table(frames).__arrow_c_array__()[1]
c = ctypes.CDLL(None)
pointer = ctypes.POINTER(ctypes.c_void_p)
get = ctypes.pythonapi.PyCapsule_GetPointer
get.restype, get.argtypes = ctypes.c_void_p, (ctypes.py_object, ctypes.c_char_p)
ctypes.pythonapi.Py_IncRef(ctypes.py_object(rows))  # its destructor never runs
# struct ArrowArray in words: buffers 5, children 6, release 8. The last column is data.
at = get(rows, b"arrow_array")
whole = ctypes.cast(at, pointer)
column = ctypes.cast(ctypes.cast(whole[6], pointer)[8], pointer)
text = ctypes.cast(column[5], pointer)[1]

def at_end(function, argument):
    c.__cxa_atexit(ctypes.c_void_p(function), ctypes.c_void_p(argument), None)

# The C library calls these behind Python's end, the last one first.
puts = ctypes.cast(c.puts, ctypes.c_void_p).value
at_end(puts, at + 8 * 8)  # release is NULL: an empty line
at_end(whole[8], at)
at_end(puts, text)
print("Python ends", flush=True)
"""
    )
    assert said == "Python ends\nalive\n\n"
