"""Signals as tables: the values that other programs see, whose memory it is, and no copy."""

import dataclasses
import gc
import json
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser._core.arrow import is_shared, shared_empty
from canser.signals.named import Named
from canser.signals.signal import Signal
from canser.signals.signals import Group, Signals
from reference import NO_TIME
from samples import EPOCH

REPORT: Any = None  # what was decoded does not matter here

GEARS = {0: "Park", 1: "Drive", 2: "Drive", -1: "Öff", 254: "error"}


def shared(values: Any, dtype: Any) -> Any:
    """Return an array of `shared_empty` with these values."""
    array = shared_empty(len(values), dtype)
    array[:] = np.array(values, dtype)
    return array


def times(*ts: int) -> Any:
    return shared(ts, np.int64).view("M8[ns]")


def signal(name: str, ts: Any, values: Any, dtype: Any = np.float64, **more: Any) -> Signal:
    message = more.pop("message", "Engine")
    values = shared(values, dtype)
    return Signal(name=name, message=message, group=message, ts=ts, values=values, **more)


def group(*signals: Signal, name: str = "Engine") -> Group:
    return Group(name, "Engine", signals[0].ts, {each.name: each for each in signals})


def engine(first: int = EPOCH) -> Group:
    """Return a group with all that a signal may be."""
    ts = times(first, first + 5, first + 5, NO_TIME)
    return group(
        signal("RPM", ts, [1.5, 2.0, float("nan"), -0.0], unit="1/min"),
        signal("Count", ts, [1, 2**60 + 1, -3, 2**62], np.int64),
        signal("Big", ts, [0, 2**64 - 1, 1, 2], np.uint64, unit="µs"),
        signal("Gear", ts, [1, 2, 7, -1], np.int64, choices=GEARS),
        signal("Load", ts, [0.5, 1.0, 127.0, 1.5], choices=GEARS, raw=shared([1, 2, 254, 3], "i8")),
    )


def with_valid(signals: Group, *masks: tuple[int, ...]) -> Group:
    """Return signals that have values at some times only, as `resample` makes them."""
    changed = [
        dataclasses.replace(each, valid=np.array(mask, np.bool_))
        for each, mask in zip(signals.values(), masks, strict=True)
    ]
    return group(*changed)


def holes() -> Group:
    return with_valid(
        engine(), (1, 0, 1, 0), (0, 1, 1, 1), (1, 1, 1, 1), (0, 0, 1, 1), (1, 0, 0, 0)
    )


def nowhere() -> Group:
    return with_valid(engine(), *[(0, 0, 0, 0)] * 5)


def empty() -> Group:
    ts = times()
    return group(signal("RPM", ts, []), signal("Gear", ts, [], np.int64, choices=GEARS))


def text_of(each: Signal, index: int) -> str:
    """Return the text of a sample, looked up by itself."""
    number = (each.values if each.raw is None else each.raw)[index].item()
    return (each.choices or {}).get(number, str(each.values[index].item()))


def plain(signals: Named, ts: Any) -> dict[str, list[Any]]:
    """Return the values of a table by columns, sample by sample."""
    columns = {"ts": [None if each == NO_TIME else each for each in ts.view(np.int64).tolist()]}
    for name, each in signals.items():
        valid = np.ones(len(ts), np.bool_) if each.valid is None else each.valid
        columns[name] = [
            None if not valid[at] else text_of(each, at) if each.choices else number
            for at, number in enumerate(each.values.tolist())
        ]
    return columns


def same(some: Mapping[str, list[Any]], others: Mapping[str, list[Any]]) -> bool:
    """Return whether columns are equal, with NaN, and their order."""
    return repr(dict(some)) == repr(dict(others))


def by_pyarrow(source: Any) -> dict[str, list[Any]]:
    pa = pytest.importorskip("pyarrow")
    batch = pa.record_batch(source)
    batch.validate(full=True)
    assert batch.schema.equals(pa.schema(source), check_metadata=True)
    assert batch.schema.equals(pa.table(source).schema, check_metadata=True)
    columns = {}
    for name in batch.schema.names:
        column = batch[name].cast(pa.int64()) if name == "ts" else batch[name]
        columns[name] = column.to_pylist()
        if name != "ts":
            assert repr(pa.table(source)[name].to_pylist()) == repr(columns[name])
    return columns


def by_polars(source: Any) -> dict[str, list[Any]]:
    pl = pytest.importorskip("polars")
    whole = source.to_polars().with_columns(ts=pl.col("ts").cast(pl.Int64))
    columns: dict[str, list[Any]] = whole.to_dict(as_series=False)
    return columns


def by_duckdb(source: Any) -> dict[str, list[Any]]:
    duckdb = pytest.importorskip("duckdb")
    duckdb.register("signals", source)
    whole = duckdb.sql("from signals")
    names, rows = whole.columns, whole.fetchall()
    duckdb.unregister("signals")
    # Python's own times have microseconds: those of others are tested to the nanosecond.
    return {name: [row[at] for row in rows] for at, name in enumerate(names) if name != "ts"}


def by_nanoarrow(source: Any) -> dict[str, list[Any]]:
    na = pytest.importorskip("nanoarrow")
    whole = na.c_array(source)
    columns = {}
    for at in range(whole.n_children):
        child = whole.child(at)
        name = whole.schema.child(at).name
        if name == "ts":
            continue
        dictionary = child.dictionary
        if dictionary is None:
            columns[name] = na.Array(child).to_pylist()
            continue
        # nanoarrow shows indices of a dictionary where it is told their type.
        view = child.view()
        codes = np.frombuffer(view.buffer(1), np.int32, len(child)).tolist()
        bits = np.ones(len(child), np.uint8)
        if view.null_count:
            bits = np.unpackbits(np.frombuffer(view.buffer(0), np.uint8), bitorder="little")
        texts = na.Array(dictionary).to_pylist()
        columns[name] = [
            texts[code] if bit else None
            for code, bit in zip(codes, bits[: len(codes)], strict=True)
        ]
    return columns


def by_pandas(source: Any) -> dict[str, list[Any]]:
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    if not hasattr(pd.DataFrame, "from_arrow"):
        pytest.skip("pandas takes capsules from 3.0 on")
    whole = pd.DataFrame.from_arrow(source)
    return {name: whole[name].tolist() for name in whole.columns if name != "ts"}


TAKERS = [by_pyarrow, by_polars, by_duckdb, by_nanoarrow]


@pytest.mark.parametrize("take", TAKERS)
@pytest.mark.parametrize("make", [engine, holes, nowhere, empty])
def test_every_program_sees_the_same_values(
    take: Callable[[Any], dict[str, list[Any]]], make: Callable[[], Group]
) -> None:
    signals = make()
    found, expected = take(signals), plain(signals, signals.ts)
    if "ts" not in found:
        del expected["ts"]
    assert same(found, expected)


@pytest.mark.parametrize("make", [engine, empty])
def test_pandas_takes_a_group(make: Callable[[], Group]) -> None:
    signals = make()
    found, expected = by_pandas(signals), plain(signals, signals.ts)
    del expected["ts"]
    assert same(found, expected)


@pytest.mark.parametrize(("first", "kind"), [(0, "duration[ns]"), (EPOCH, "timestamp[ns, tz=UTC]")])
def test_times_are_dates_from_2000_on(first: int, kind: str) -> None:
    pa = pytest.importorskip("pyarrow")
    assert str(pa.schema(engine(first)).field("ts").type) == kind


def test_units_and_messages_are_in_the_metadata_of_every_field() -> None:
    pa = pytest.importorskip("pyarrow")
    na = pytest.importorskip("nanoarrow")
    signals = engine()
    for name, each in signals.items():
        expected = {"canser.unit": each.unit, "canser.message": "Engine"}
        encoded = {key.encode(): text.encode() for key, text in expected.items()}
        assert pa.schema(signals).field(name).metadata == encoded
    schema = na.c_schema(signals)
    assert dict(schema.child(1).metadata.items())[b"canser.unit"] == b"1/min"
    assert dict(schema.child(3).metadata.items())[b"canser.unit"] == "µs".encode()
    assert pa.schema(signals).field("ts").metadata is None


def test_a_signal_named_ts_has_its_full_name() -> None:
    pa = pytest.importorskip("pyarrow")
    ts = times(1, 2)
    assert pa.schema(group(signal("ts", ts, [1, 2]))).names == ["ts", "Engine.ts"]


def test_a_table_may_have_thousands_of_signals() -> None:
    pytest.importorskip("polars")
    ts = times(1)
    signals = group(*(signal(f"S{at}", ts, [at]) for at in range(5000)))
    assert signals.to_polars()["S4999"].to_list() == [4999.0]


# ---- No copy, and whose memory it is.


def address(array: Any) -> int:
    place: int = array.__array_interface__["data"][0]
    return place


def test_nothing_is_copied() -> None:
    pa = pytest.importorskip("pyarrow")
    pytest.importorskip("polars")
    signals = engine()
    batch, frame = pa.record_batch(signals), signals.to_polars()
    arrays = {"ts": signals.ts, **{n: signals[n].values for n in ("RPM", "Count", "Big")}}
    for name, array in arrays.items():
        assert batch[name].buffers()[1].address == address(array)
        assert address(array) % 64 == 0
    for name in ("RPM", "Big"):
        assert address(frame[name].to_numpy()) == address(signals[name].values)


def test_slices_are_shared_and_other_arrays_are_copied() -> None:
    pa = pytest.importorskip("pyarrow")
    whole = shared(range(20), np.int64)
    ts = times(*range(10))
    for part, is_there in (
        (whole[3:13], True),
        (whole.view("M8[ns]").view(np.int64)[10:], True),
        (whole[::2], False),
        (whole[9::-1], False),
        (np.arange(10), False),
        (np.frombuffer(whole.tobytes(), np.int64)[:10], False),
        (whole.view(np.uint8)[4:84].view(np.int64), False),  # its address is no multiple of 8
    ):
        made = Signal(name="N", message="M", group="M", ts=ts, values=part)
        column = pa.record_batch(group(made))["N"]
        assert column.to_pylist() == part.tolist()
        assert (column.buffers()[1].address == address(part)) is is_there
        assert is_shared(whole) is is_there
        del column
        assert not is_shared(whole)


def test_who_has_the_memory_is_known() -> None:
    pa = pytest.importorskip("pyarrow")
    signals = engine()
    values = signals["RPM"].values
    view = values[1:]
    assert not is_shared(values)
    batch = pa.record_batch(signals)
    assert is_shared(values)
    assert is_shared(view)
    column = batch["RPM"]
    del batch
    assert is_shared(values)
    del column
    assert not is_shared(values)
    capsule = signals.__arrow_c_stream__()
    assert is_shared(values)
    del capsule
    assert not is_shared(values)
    assert not is_shared(np.zeros(3))


def test_arrays_and_tables_outlive_each_other() -> None:
    pa = pytest.importorskip("pyarrow")
    array = shared(range(1000), np.float64)
    ts = shared(range(1000), "M8[ns]")
    made = Signal(name="N", message="M", group="M", ts=ts, values=array)
    batch = pa.record_batch(group(made))
    part = array[500:]
    del made, array, ts
    gc.collect()
    assert batch["N"].to_pylist() == list(range(1000))
    held = [batch["N"]]
    del batch
    gc.collect()
    assert held[0].to_pylist() == list(range(1000))
    thread = threading.Thread(target=held.clear)
    thread.start()
    thread.join()
    assert not is_shared(part)
    assert part.tolist() == list(range(500, 1000))
    part[:] = 1


def test_threads_make_and_drop_tables_of_one_group() -> None:
    pa = pytest.importorskip("pyarrow")
    signals, right = engine(), []
    expected = signals["Count"].values.tolist()

    def work() -> None:
        for _ in range(50):
            batch = pa.record_batch(signals)
            signals.__arrow_c_array__()
            right.append(batch["Count"].to_pylist() == expected)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert right == [True] * 200
    assert not is_shared(signals["Count"].values)


def test_arrays_are_like_those_of_numpy() -> None:
    for dtype in (np.uint8, np.int32, np.float64, "M8[ns]", np.bool_):
        for count in (0, 1, 1000, 600_000):
            array = shared_empty(count, dtype)
            assert array.dtype == dtype
            assert array.shape == (count,)
            assert array.flags.writeable
            assert array.flags.c_contiguous
            assert address(array) % 64 == 0
            array[:] = np.ones(count, array.dtype)
            assert (array.view(f"u{array.itemsize}") == array.view(f"u{array.itemsize}")[:1]).all()


def run(code: str) -> str:
    """Run a program to its end; return what it prints."""
    done = subprocess.run(
        [sys.executable, "-X", "dev", "-c", code], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="memory is limited by Linux")
def test_without_memory_the_error_says_how_many_values() -> None:
    said = run(
        """
import resource, numpy as np
from canser._core.arrow import shared_empty
shared_empty(1, np.float64)
with open("/proc/self/statm") as file:
    pages = int(file.read().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 2**24,) * 2)
try:
    shared_empty(4_000_000, np.float64)
except MemoryError as error:
    print(error)
"""
    )
    assert said == "there is no memory for 4,000,000 values of float64\n"


def resident_kib() -> int:
    """Return the memory of this process, in KiB."""
    with open("/proc/self/status", encoding="ascii") as status:  # noqa: PTH123 - no file
        return next(int(line.split()[1]) for line in status if line.startswith("VmRSS"))


@pytest.mark.skipif(sys.platform != "linux", reason="memory is read from /proc")
def test_nothing_is_left_of_arrays_and_tables() -> None:
    def use(count: int) -> None:
        values, ts = shared_empty(count, np.float64), shared_empty(count, "M8[ns]")
        values[:], ts[:] = 1, 0
        made = group(Signal(name="N", message="M", group="M", ts=ts, values=values))
        made.__arrow_c_array__()
        made.__arrow_c_stream__()

    for _ in range(20):
        use(200_000)
    gc.collect()
    before = resident_kib()
    for _ in range(100):
        use(200_000)
    for _ in range(3000):
        use(10)
    gc.collect()
    assert resident_kib() - before < 1024  # one table is 3 MiB


MADE = """
import atexit, ctypes, sys
import numpy as np
from canser._core.arrow import shared_empty
from canser.signals.named import Named
from canser.signals.signal import Signal
from canser.signals.signals import Group
values, ts = shared_empty(3, np.float64), shared_empty(3, "M8[ns]")
values[:], ts[:] = [1, 2, 3], 0
made = Signal(name="N", message="M", group="M", ts=ts, values=values, choices={1: "one"})
other = Signal(name="O", message="M", group="M", ts=ts, values=values)
group = Group("M", "M", ts, {"N": made, "O": other})
"""


def test_consumers_and_arrays_may_outlive_the_interpreter() -> None:
    pytest.importorskip("pyarrow")
    said = run(
        MADE
        + """
import pyarrow
kept = pyarrow.record_batch(group)["O"]
capsules = group.__arrow_c_array__(), group.__arrow_c_stream__()
for each in (kept, values, ts, *capsules[0], capsules[1]):
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(each))
sys.kept = kept, values, capsules
print(kept.to_pylist())
"""
    )
    assert said == "[1.0, 2.0, 3.0]\n"


@pytest.mark.skipif(sys.platform == "win32", reason="its C library has no __cxa_atexit")
def test_release_callbacks_run_when_python_has_ended() -> None:
    said = run(
        MADE
        + """
letters = shared_empty(8, np.uint64)
letters[:] = np.frombuffer(b"alive\\0".ljust(64, b"\\0"), np.uint64)
other = Signal(name="O", message="M", group="M", ts=ts[:0], values=letters[:0])
text = Signal(name="T", message="M", group="M", ts=letters.view("M8[ns]"), values=letters)
rows = Group("M", "M", letters.view("M8[ns]"), {"T": text}).__arrow_c_array__()[1]
c = ctypes.CDLL(None)
pointer = ctypes.POINTER(ctypes.c_void_p)
get = ctypes.pythonapi.PyCapsule_GetPointer
get.restype, get.argtypes = ctypes.c_void_p, (ctypes.py_object, ctypes.c_char_p)
ctypes.pythonapi.Py_IncRef(ctypes.py_object(rows))  # its destructor never runs
# struct ArrowArray in words: buffers 5, children 6, release 8.
at = get(rows, b"arrow_array")
whole = ctypes.cast(at, pointer)
column = ctypes.cast(ctypes.cast(whole[6], pointer)[1], pointer)
place = ctypes.cast(column[5], pointer)[1]
assert place == letters.ctypes.data
del letters, text  # the table has the memory alone

def at_end(function, argument):
    c.__cxa_atexit(ctypes.c_void_p(function), ctypes.c_void_p(argument), None)

# The C library calls these behind Python's end, the last one first.
puts = ctypes.cast(c.puts, ctypes.c_void_p).value
at_end(puts, at + 8 * 8)  # release is NULL: an empty line
at_end(whole[8], at)
at_end(puts, place)
print("Python ends", flush=True)
"""
    )
    assert said == "Python ends\nalive\n\n"


def test_polars_needs_no_pyarrow() -> None:
    pytest.importorskip("polars")
    said = run(
        MADE
        + """
sys.modules["pyarrow"] = None
import polars
made = group.to_polars()
print(made["N"].to_list(), made["O"].to_list())
"""
    )
    assert said == "['one', '2.0', '3.0'] [1.0, 2.0, 3.0]\n"


# ---- Texts of values.


RAWS = st.one_of(
    st.lists(st.integers(-5, 300), max_size=40),
    st.lists(st.integers(-(2**63), 2**63 - 1), max_size=40),
    st.lists(st.sampled_from([0, 2**16 - 1, 2**16, 2**16 + 1, -1]), max_size=40),
)
CHOICES = st.dictionaries(
    st.integers(-5, 300) | st.sampled_from([2**16, 2**62]),
    st.sampled_from(["", "a", "b", "7", "ä", "error"]),
    min_size=1,
)


@given(raws=RAWS, choices=CHOICES, data=st.data())
def test_texts_are_those_of_each_sample(
    raws: list[int], choices: dict[int, str], data: st.DataObject
) -> None:
    pa = pytest.importorskip("pyarrow")
    ts = times(*range(len(raws)))
    raw = shared(raws, np.int64)
    values = raw * data.draw(st.sampled_from([0.5, 1.0])) + 1
    signals: Any = [
        Signal(name="X", message="M", group="M", ts=ts, values=values, raw=raw, choices=choices),
        Signal(name="Y", message="M", group="M", ts=ts, values=raw, choices=choices),
        Signal(name="Z", message="M", group="M", ts=ts, values=raw * 1.0, choices=choices),
    ]
    mask = data.draw(st.none() | st.lists(st.booleans(), min_size=len(raws), max_size=len(raws)))
    if mask is not None:
        signals = [dataclasses.replace(each, valid=np.array(mask, np.bool_)) for each in signals]
    made = group(*signals)
    assert same(by_pyarrow(made), plain(made, ts))
    column = pa.record_batch(made)["Y"]
    texts = column.dictionary.to_pylist()
    assert len(texts) == len(set(texts))
    # Those of the choices come first, so that two tables have the same ones.
    own = dict.fromkeys(choices[number] for number in sorted(choices))
    assert texts[: len(own)] == list(own)


def test_texts_of_floats_that_are_no_numbers() -> None:
    ts = times(1, 2, 3)
    made = group(signal("X", ts, [float("nan"), 2.0, 2.5], choices={2: "two"}))
    assert by_pyarrow(made)["X"] == ["nan", "two", "2.5"]


# ---- The long table.


def many(*, valid: bool = False) -> Signals:
    one, ts = engine(), times(EPOCH + 5, EPOCH - 1)
    other = group(
        signal("Speed", ts, [1, 2], unit="km/h", message="Body"),
        signal("ts", ts, [2**53 + 1, 2**53], np.int64, message="Body"),
        name="Body",
    )
    if valid:
        one = holes()
    return Signals({"Engine": one, "Body": other}, REPORT)


def plain_long(signals: Signals) -> list[tuple[Any, ...]]:
    """Return the rows of a long table, sample by sample."""
    rows = []
    for part in signals.groups.values():
        for each in part.values():
            valid = np.ones(len(each), np.bool_) if each.valid is None else each.valid
            for at, number in enumerate(each.values.tolist()):
                if not valid[at]:
                    continue
                raw = (each.values if each.raw is None else each.raw)[at].item()
                text = each.choices.get(raw) if each.choices else None
                if text is None and isinstance(number, int) and float(number) != number:
                    text = str(number)
                ts = each.ts.view(np.int64)[at].item()
                rows.append((ts, each.full_name, float(number), text))
    rows.sort(key=lambda row: row[0] if row[0] != NO_TIME else 2**63)
    return [(None if row[0] == NO_TIME else row[0], *row[1:]) for row in rows]


@pytest.mark.parametrize("valid", [False, True])
def test_a_long_table_has_a_row_for_each_sample(valid: bool) -> None:
    pa = pytest.importorskip("pyarrow")
    signals = many(valid=valid)
    made = signals.to_arrow(long=True)
    made.validate(full=True)
    columns = made.set_column(0, "ts", made["ts"].cast(pa.int64())).to_pydict()
    assert list(columns) == ["ts", "signal", "value", "text"]
    assert repr(list(zip(*columns.values(), strict=True))) == repr(plain_long(signals))
    units = made.schema.field("value").metadata
    assert units[b"canser.unit.Engine.RPM"] == b"1/min"
    assert units[b"canser.unit.Body.Speed"] == b"km/h"


@given(
    ints=st.lists(
        st.integers(-(2**63), 2**63 - 1) | st.integers(2**53 - 3, 2**53 + 3), max_size=30
    ),
    dtype=st.sampled_from([np.int64, np.uint64]),
    choices=st.sampled_from([None, {2**62: "most"}]),
)
def test_no_whole_number_changes_in_silence(ints: list[int], dtype: Any, choices: Any) -> None:
    numbers = [abs(each) * 2 if dtype is np.uint64 else each for each in ints]
    numbers = [min(each, 2**64 - 1) for each in numbers]
    each = signal("N", times(*range(len(ints))), numbers, dtype, choices=choices)
    made = group(each).to_arrow(long=True)
    for number, value, text in zip(
        numbers, made["value"].to_pylist(), made["text"].to_pylist(), strict=True
    ):
        own = "most" if choices and number == 2**62 else None
        assert text == (own if int(value) == number else str(number))


def test_a_long_table_of_nothing() -> None:
    pa = pytest.importorskip("pyarrow")
    none = Signals({}, REPORT)
    assert none.to_arrow() == {}
    for made in (none.to_arrow(long=True), empty().to_arrow(long=True)):
        made.validate(full=True)
        assert made.num_rows == 0
        assert made.schema.field("ts").type == pa.duration("ns")
    pytest.importorskip("polars")
    assert none.to_polars(long=True).columns == ["ts", "signal", "value", "text"]
    assert list(none.to_xarray(long=True)) == ["ts", "signal", "value", "text"]
    assert list(none.to_pandas(long=True).columns) == ["ts", "signal", "value", "text"]


# ---- After `resample`: one table.


CAR = """BO_ 291 Engine: 3 X
 SG_ RPM : 0|16@1+ (1,0) [0|0] "rpm" X
 SG_ Gear : 16|8@1+ (1,0) [0|0] "" X
BO_ 292 Body: 1 X
 SG_ Speed : 0|8@1+ (0.5,0) [0|0] "km/h" X
VAL_ 291 Gear 1 "one" 2 "two" ;
"""


def resampled(tmp_path: Path) -> Any:
    (tmp_path / "car.dbc").write_text(CAR)
    frames = canser.frames("123#E80301", "124#05", "123#B80B05")
    frames["ts"] = [0, 15_000_000, 25_000_000]
    database = canser.Database(tmp_path / "car.dbc")
    return database.decode(frames).resample("10ms", max_age="12ms")


def test_signals_on_one_time_base_are_one_table(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    grid = resampled(tmp_path)
    made = grid.to_arrow()
    assert made.equals(pa.table(grid), check_metadata=True)
    made.validate(full=True)
    assert made.set_column(0, "ts", made["ts"].cast(pa.int64())).to_pydict() == {
        "ts": [0, 10_000_000, 20_000_000],
        "Engine.RPM": [1000, 1000, None],
        "Engine.Gear": ["one", "one", None],
        "Body.Speed": [None, None, 2.5],
    }
    assert made.schema.field("Body.Speed").metadata[b"canser.unit"] == b"km/h"
    for name, array in (("ts", grid.ts), ("Body.Speed", grid["Speed"].values)):
        assert made[name].chunk(0).buffers()[1].address == address(array)
    assert grid.to_arrow(long=True).num_rows == 5


def test_one_table_of_every_package(tmp_path: Path) -> None:
    for package in ("polars", "pandas", "xarray"):
        pytest.importorskip(package)
    grid = resampled(tmp_path)
    assert grid.to_polars()["Engine.Gear"].to_list() == ["one", "one", None]
    assert grid.to_pandas()["Engine.RPM"].isna().tolist() == [False, False, True]
    assert repr(grid.to_xarray()["Engine.RPM"].values.tolist()) == "[1000.0, 1000.0, nan]"


# ---- pandas, polars, xarray.


def test_signals_are_a_table_for_each_group() -> None:
    for package in ("arrow", "polars", "pandas", "xarray"):
        pytest.importorskip({"arrow": "pyarrow"}.get(package, package))
        made = getattr(many(), f"to_{package}")()
        assert list(made) == ["Engine", "Body"]
        names = {"arrow": "column_names", "xarray": "variables"}.get(package, "columns")
        assert sorted(getattr(made["Body"], names)) == ["Body.ts", "Speed", "ts"]


def test_of_pandas() -> None:
    pd = pytest.importorskip("pandas")
    signals = engine()
    frame = signals.to_pandas()
    assert frame["ts"].dtype == "datetime64[ns, UTC]"
    assert frame["ts"].isna().tolist() == [False, False, False, True]
    assert frame["Gear"].dtype == pd.CategoricalDtype(["Öff", "Park", "Drive", "error", "7"])
    assert frame["Gear"].tolist() == ["Drive", "Drive", "7", "Öff"]
    assert frame["Count"].tolist() == [1, 2**60 + 1, -3, 2**62]
    assert frame.attrs["units"] == {
        "RPM": "1/min",
        "Count": "",
        "Big": "µs",
        "Gear": "",
        "Load": "",
    }
    # Copies, which may be written to.
    assert not is_shared(signals["Count"].values)
    frame.loc[0, "Count"] = 9
    frame.loc[0, "ts"] = pd.NaT
    assert signals["Count"].values[0] == 1
    assert not np.isnat(signals.ts[0])
    assert signals.to_pandas(long=True).attrs["units"]["Engine.RPM"] == "1/min"


def test_of_pandas_where_there_is_no_value() -> None:
    pytest.importorskip("pandas")
    signals = holes()
    frame = signals.to_pandas()
    assert frame["RPM"].dtype == np.float64
    assert frame["RPM"].isna().tolist() == [False, True, True, True]
    assert str(frame["Count"].dtype) == "Int64"
    assert frame["Count"].isna().tolist() == [True, False, False, False]
    assert frame["Count"].tolist()[1:] == [2**60 + 1, -3, 2**62]
    assert frame["Gear"].isna().tolist() == [True, True, False, False]
    assert frame["Gear"].tolist()[2:] == ["7", "Öff"]
    frame.loc[1, "Count"] = 9
    frame.loc[0, "RPM"] = 9
    assert signals["Count"].values[1] == 2**60 + 1
    assert signals["RPM"].values[0] == 1.5


def test_of_xarray() -> None:
    pytest.importorskip("xarray")
    signals = engine()
    made = signals.to_xarray()
    assert made["RPM"].dims == ("ts",)
    assert made["RPM"].attrs == {"units": "1/min", "message": "Engine"}
    assert made["ts"].dtype == "datetime64[ns]"
    assert engine(0).to_xarray()["ts"].dtype == "timedelta64[ns]"
    assert made["Gear"].values.tolist() == [1, 2, 7, -1]
    assert json.loads(made["Gear"].attrs["choices"])["0"] == "Park"
    made["Count"][0] = 9
    made["RPM"][0] = 9
    assert signals["Count"].values[0] == 1
    assert signals["RPM"].values[0] == 1.5
    with pytest.raises(
        ValueError, match=r"Count has samples without a value.* 1152921504606846977"
    ):
        holes().to_xarray()
    count = holes()["Count"]
    small = dataclasses.replace(count, values=np.array([2**53 + 1, 1, 2, 3]))
    found = group(small).to_xarray()["Count"].values
    assert repr(found.tolist()) == "[nan, 1.0, 2.0, 3.0]"


def test_of_xarray_in_a_long_dataset() -> None:
    pytest.importorskip("xarray")
    made = many().to_xarray(long=True)
    rows = plain_long(many())
    assert made["signal"].values.tolist() == [row[1] for row in rows]
    assert made["text"].values.tolist() == [row[3] or "" for row in rows]
    assert made["ts"].dtype == "datetime64[ns]"


def test_of_polars() -> None:
    pl = pytest.importorskip("polars")
    frame = holes().to_polars()
    assert frame.schema["ts"] == pl.Datetime("ns", "UTC")
    assert frame.schema["Gear"] == pl.Categorical
    assert frame["RPM"].null_count() == 2
    assert same(by_polars(holes()), plain(holes(), holes().ts))


@pytest.mark.parametrize("package", ["pyarrow", "polars", "pandas", "xarray"])
def test_without_a_package_the_error_names_the_command(
    package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    method = getattr(engine(), f"to_{package.removeprefix('py')}")
    with pytest.raises(ModuleNotFoundError, match=f"{package} is not installed: pip install"):
        method()


def test_long_is_true_or_false() -> None:
    with pytest.raises(TypeError, match="long is 'yes'; it must be True or False"):
        engine().to_arrow(long="yes")  # type: ignore[arg-type]
