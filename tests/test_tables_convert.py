"""Frames to pandas, polars, pyarrow, duckdb and xarray, and back: the same frames."""

import gc
import subprocess
import sys
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser.simulation.traffic import vehicle
from reference import NO_TIME, Frame
from samples import EPOCH, FRAMES, SECOND, array, listed, timed
from shared import CAPTURES, needs_captures

PACKAGES = {"arrow": "pyarrow", "polars": "polars", "pandas": "pandas", "xarray": "xarray"}
NAMES = ["native", "python-can", "asam"]

every_package = pytest.mark.parametrize("package", PACKAGES)


def there(package: str, frames: canser.FrameArray, **options: Any) -> Any:
    pytest.importorskip(PACKAGES[package])
    return getattr(canser, f"to_{package}")(frames, **options)


def back(package: str, source: Any, **options: Any) -> canser.FrameArray:
    if package == "polars":
        pytest.importorskip("pyarrow")
    found: canser.FrameArray = getattr(canser, f"from_{package}")(source, **options)
    return found


@every_package
@given(frames=FRAMES, data=st.data())
def test_there_and_back_are_the_same_frames(
    package: str, frames: list[Frame], data: st.DataObject
) -> None:
    made = array(*frames)
    options = {
        "names": data.draw(st.sampled_from(NAMES)),
        "data": data.draw(st.sampled_from(["binary", "list"])),
        "id_hex": data.draw(st.booleans()),
    }
    codes = st.lists(st.integers(0, 255), min_size=len(frames), max_size=len(frames))
    channels = np.array(data.draw(codes), np.uint8)
    directions = channels % 2
    for told in (None, channels):
        sent = None if told is None else directions
        source = there(package, made, channels=told, directions=sent, **options)
        assert len(back(package, source)) == len(frames)
        got = np.zeros(len(frames), np.uint8), np.zeros(len(frames), np.uint8)
        found = back(package, source, channels=got[0], directions=got[1])
        assert listed(found) == frames
        assert got[0].tolist() == ([255] * len(frames) if told is None else told.tolist())
        assert got[1].tolist() == ([0] * len(frames) if sent is None else sent.tolist())


@every_package
@pytest.mark.parametrize("times", [(0, 1, NO_TIME), (EPOCH, EPOCH + 1, NO_TIME)])
def test_times_are_exact_to_the_nanosecond(package: str, times: tuple[int, ...]) -> None:
    frames = timed(*times)
    assert back(package, there(package, frames))["ts"].tolist() == list(times)


@every_package
def test_many_frames_there_and_back(package: str) -> None:
    frames = vehicle(20)
    assert np.array_equal(back(package, there(package, frames)), frames)


@every_package
def test_relative_times_become_dates_by_an_epoch(package: str) -> None:
    frames = timed(0, 1, NO_TIME)
    start = datetime(2026, 11, 26, 8, tzinfo=UTC)
    found = back(package, there(package, frames, epoch=start))
    base = int(start.timestamp()) * SECOND
    assert found["ts"].tolist() == [base, base + 1, NO_TIME]
    with pytest.raises(ValueError, match="dates already"):
        there(package, timed(EPOCH), epoch=start)
    with pytest.raises(TypeError, match="epoch must be a datetime"):
        there(package, frames, epoch=5)


@every_package
def test_every_array_of_records_is_a_table(package: str) -> None:
    frames = vehicle(2)
    stats = canser.id_stats(frames)
    info = there(package, stats)
    assert len(info["id"]) == len(stats)
    assert list(np.asarray(info["count"])) == stats["count"].tolist()
    assert [str(each) for each in np.asarray(info["pattern"])] == stats["pattern"].tolist()
    for records in (
        canser.bus_load(frames, 500_000),
        canser.dropouts(frames),
        canser.compare(frames, frames).ids,
        canser.compare(frames, frames).timing,
    ):
        assert len(canser.table(records)) == len(records)
        there(package, records)


@pytest.mark.parametrize("package", ["pandas", "xarray"])
def test_what_was_made_may_be_written_to(package: str) -> None:
    frames = canser.frames("123#01", "124#02")
    source = there(package, frames)
    if package == "pandas":
        source.loc[0, "id"] = 0x321
        source.loc[1, "dlc"] = 0
    else:
        source["id"][0] = 0x321
        source["dlc"][1] = 0
    assert back(package, source)["id"].tolist() == [0x321, 0x124]
    assert frames["id"].tolist() == [0x123, 0x124]


@needs_captures
def test_statistics_of_the_car_are_those_of_pandas_polars_and_python_can() -> None:
    pytest.importorskip("pandas")
    pl = pytest.importorskip("polars")
    can = pytest.importorskip("can")
    frames = canser.read(CAPTURES / "car.candump.log")
    frames["ts"] -= frames["ts"][0]  # pandas takes the differences of groups as float64
    stats = canser.id_stats(frames)
    nanoseconds = canser.to_pandas(frames)
    nanoseconds["ts"] = nanoseconds["ts"].astype("int64")
    groups = nanoseconds.groupby("id")["ts"]
    steps = groups.diff().groupby(nanoseconds["id"])
    by_pandas = {
        "count": groups.count(),
        "first_ns": groups.first(),
        "last_ns": groups.last(),
        "interval_min_ns": steps.min(),
        "interval_mean_ns": steps.mean(),
        "interval_median_ns": steps.median(),
        "interval_max_ns": steps.max(),
    }
    assert groups.count().index.tolist() == stats["id"].tolist()
    for name, values in by_pandas.items():
        assert np.allclose(stats[name], values.to_numpy(), rtol=1e-13), name
    ts = pl.col("ts").cast(pl.Int64)
    by_polars = (
        canser.to_polars(frames)
        .group_by("id")
        .agg(
            count=pl.len(),
            interval_mean_ns=ts.diff().mean(),
            interval_median_ns=ts.diff().median(),
            interval_max_ns=ts.diff().max(),
        )
        .sort("id")
    )
    for name in by_polars.columns:
        assert np.allclose(stats[name], by_polars[name].to_numpy(), rtol=1e-13), name
    counts: dict[int, int] = {}
    for message in can.LogReader(CAPTURES / "car.candump.log"):
        counts[message.arbitration_id] = counts.get(message.arbitration_id, 0) + 1
    assert dict(zip(stats["id"].tolist(), stats["count"].tolist(), strict=True)) == counts


def test_what_is_not_known_is_null() -> None:
    pa = pytest.importorskip("pyarrow")
    stats = canser.id_stats(canser.frames("123#01"))
    made = pa.table(canser.table(stats))
    assert made["period_ns"].null_count == made["first_ns"].null_count == 1
    assert made["channel"].null_count == 1
    assert made["moving"].to_pylist() == [bytes(8)]
    dated = canser.table(canser.id_stats(timed(EPOCH, EPOCH + 7)))
    assert dated["first_ns"].dtype == np.dtype("M8[ns]")
    assert dated["last_ns"].view(np.int64).tolist() == [EPOCH + 7]


@pytest.mark.parametrize("times", [(0, 1, NO_TIME), (EPOCH, EPOCH + 1, NO_TIME)])
def test_columns_of_arrow_within_pandas_are_read(times: tuple[int, ...]) -> None:
    pd, pa = pytest.importorskip("pandas"), pytest.importorskip("pyarrow")
    frames = timed(*times)
    channels = np.array([0, 1, 255], np.uint8)
    source = pa.table(canser.table(frames, channels=channels)).to_pandas(types_mapper=pd.ArrowDtype)
    got = np.zeros(3, np.uint8)
    assert listed(canser.from_pandas(source, channels=got)) == listed(frames)
    assert got.tolist() == channels.tolist()


def test_duckdb_takes_a_table() -> None:
    duckdb = pytest.importorskip("duckdb")
    frames = vehicle(2)
    made = canser.table(frames, id_hex=True)  # noqa: F841 - duckdb finds it by its name
    rows = duckdb.sql("select id_hex, count(*) from made group by id_hex").fetchall()
    groups = canser.by_id(frames)
    assert dict(rows) == {name: len(own) for name, own in groups.items()}


def test_ids_are_text_on_request() -> None:
    frames = canser.frames("001#", "18FEF100#", "20000080#00", "123#R")
    made = canser.table(frames, id_hex=True)
    assert made["id_hex"].tolist() == ["001", "18FEF100", "00000080", "123"]
    assert made.names[-1] == "id_hex"
    assert made.format("id_hex") == "U"


# Views of numpy


def test_a_column_is_a_view_that_keeps_the_memory() -> None:
    frames = vehicle(2)
    made = canser.table(frames)
    views = {name: made[name] for name in ("ts", "id", "dlc", "data", "ext")}
    again = made["id"]
    assert again.ctypes.data == views["id"].ctypes.data
    assert views["id"].ctypes.data % 64 == 0
    del made, again
    gc.collect()
    for name in ("id", "dlc", "data", "ext"):
        assert np.array_equal(views[name], frames[name])
        assert name == "ext" or not views[name].flags.writeable
    assert np.array_equal(views["ts"].view(np.int64), frames["ts"])
    with pytest.raises(ValueError, match="read-only"):
        views["id"][0] = 1


def test_a_view_and_another_program_share_the_memory() -> None:
    pa = pytest.importorskip("pyarrow")
    made = canser.table(vehicle(1))
    assert pa.table(made)["id"].chunk(0).buffers()[1].address == made["id"].ctypes.data


def test_frames_that_are_written_over_do_not_change_a_table() -> None:
    frames = canser.frames("123#01", "124#02")
    made = canser.table(frames)
    view = made["data"]
    frames["data"] = 255
    assert view[:, 0].tolist() == [1, 2]


def test_nulls_of_a_column_are_told() -> None:
    made = canser.table(timed(0, NO_TIME, 2), channels=np.array([0, 1, 255], np.uint8))
    assert made.valid("ts").tolist() == [True, False, True]
    assert made.valid("channel").tolist() == [True, True, False]
    assert made.valid("sent").tolist() == [False] * 3
    assert np.isnat(made["ts"]).tolist() == [False, True, False]
    with pytest.raises(KeyError, match="no column 'time'; there are ts, channel"):
        made["time"]


def test_views_end_after_the_interpreter_began_to() -> None:
    code = "import canser; kept = canser.table(canser.frames('123#01'))['id']; kept.sum()"
    done = subprocess.run(
        [sys.executable, "-X", "dev", "-c", code], capture_output=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")


# Refused


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"names": "can"}, "names is 'can'; give 'native', 'python-can', 'asam'"),
        ({"data": "text"}, "data is 'text'; give 'binary', 'list'"),
    ],
)
def test_an_unknown_choice_is_refused(options: dict[str, str], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        canser.table(timed(0), **options)  # type: ignore[arg-type]


def test_options_of_frames_are_for_frames() -> None:
    with pytest.raises(ValueError, match="are for frames; leave them out"):
        canser.table(canser.id_stats(timed(0)), id_hex=True)
    with pytest.raises(TypeError, match="the field a has the dtype complex128"):
        canser.table(np.zeros(1, [("a", complex)]))


@every_package
def test_a_package_that_is_missing_is_named(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    name = PACKAGES[package]
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ModuleNotFoundError, match=f"pip install {name}"):
        getattr(canser, f"to_{package}")(timed(0))


def test_a_row_that_is_no_frame_is_named() -> None:
    pa = pytest.importorskip("pyarrow")
    good = canser.to_arrow(canser.frames("123#01", "124#02"))

    def with_column(name: str, values: Any) -> Any:
        return good.set_column(good.schema.get_field_index(name), name, values)

    with pytest.raises(ValueError, match="row 1: the id 0x800 is over 0x7ff"):
        canser.from_arrow(with_column("id", pa.array([1, 0x800])))
    with pytest.raises(ValueError, match="row 0: id is -1; it must be a whole number up to"):
        canser.from_arrow(with_column("id", pa.array([-1, 1])))
    with pytest.raises(ValueError, match=r"row 1: dlc is 1\.5"):
        canser.from_arrow(with_column("dlc", pa.array([1.0, 1.5])))
    with pytest.raises(ValueError, match="row 1: id is null"):
        canser.from_arrow(with_column("id", pa.array([1, None])))
    with pytest.raises(ValueError, match="no column dlc, data"):
        canser.from_arrow(good.select(["id", "ext"]))
    with pytest.raises(ValueError, match="values of another type"):
        canser.from_arrow(with_column("data", pa.array(["a", "b"])))
    wide = with_column("id", pa.array([1.0, 2.0])).select(["data", "dlc", "ext", "id"])
    assert canser.from_arrow(wide)["id"].tolist() == [1, 2]
    assert canser.from_arrow(wide)["ts"].tolist() == [NO_TIME] * 2
    with pytest.raises(ValueError, match=r"channels has the shape \(1,\); it must be \(2,\)"):
        canser.from_arrow(good, channels=np.zeros(1, np.uint8))


@every_package
def test_what_is_no_table_is_refused(package: str) -> None:
    pytest.importorskip(PACKAGES[package])
    pytest.importorskip("pyarrow")
    with pytest.raises(TypeError, match="source must be a"):
        back(package, 5)


def test_an_empty_table_has_no_frames() -> None:
    for package, name in PACKAGES.items():
        pytest.importorskip(name)
        assert len(back(package, there(package, array()))) == 0


# ---- Tables that other programs made: nothing becomes another value in silence.


def of_others(**columns: Any) -> dict[str, Any]:
    """Return the columns of three frames, but for these."""
    right = {"id": [1, 2, 3], "ext": [False] * 3, "dlc": [1] * 3, "data": [b"\1"] * 3}
    return right | columns


def read_by(package: str, **columns: Any) -> tuple[canser.FrameArray, list[int], list[int]]:
    """Return frames, channels and directions of a table of pyarrow or pandas."""
    module = pytest.importorskip(PACKAGES[package])
    make = module.table if package == "arrow" else module.DataFrame
    channels, directions = np.zeros(3, np.uint8), np.zeros(3, np.uint8)
    frames = back(package, make(of_others(**columns)), channels=channels, directions=directions)
    return frames, channels.tolist(), directions.tolist()


by_both = pytest.mark.parametrize("package", ["arrow", "pandas"])


@by_both
@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"ext": [0, 2, 1]}, "row 1: ext is 2; it must be 0 or 1"),
        ({"rtr": [0.0, 0.5, 1.0]}, "row 1: rtr is 0.5; it must be 0 or 1"),
        ({"ext": ["false"] * 3}, "ext has values of the type|invalid literal"),
        ({"sent": [0, 3, 0]}, "row 1: sent is 3; it must be 0 or 1"),
        ({"id": [True] * 3}, "id has values of the type bool, which do not fit"),
        ({"dlc": [1, 2, 1]}, "row 1: data has 1 bytes, fewer than its dlc; correct the dlc"),
        ({"data": [b"\1" * 9] * 3}, "row 0: data has 9 bytes; classic CAN has up to 8"),
        ({"data": [b"\1", None, b"\1"]}, "row 1: data is null"),
        ({"err": [True, None, False]}, "row 1: err is null"),
        ({"ts": [1.0, 2.0, 3.0]}, "times have the type double|ts has values of the type float64"),
        ({"data": [[300]] * 3}, "data is .300., which is no bytes"),
    ],
)
def test_what_would_be_another_value_is_refused(
    package: str, columns: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        read_by(package, **columns)


@by_both
def test_a_time_that_does_not_fit_is_refused(package: str) -> None:
    far = np.array(["2500-01-01"] * 3, "M8[s]")
    with pytest.raises(ValueError, match=r"out of bounds|row 0: ts is 2500"):
        read_by(package, ts=far)
    ok = np.array(["2262-01-01", "NaT", "1700-01-01"], "M8[s]")
    assert read_by(package, ts=ok)[0]["ts"].tolist() == ok.astype("M8[ns]").view(np.int64).tolist()


@pytest.mark.filterwarnings("ignore:Converting non-nanosecond")  # by old releases
def test_variables_of_xarray_are_checked() -> None:
    xr = pytest.importorskip("xarray")
    right = {"id": ("row", [1]), "ext": ("row", [False]), "dlc": ("row", [8])}
    data = ("row", "byte"), np.full((1, 8), 300)
    with pytest.raises(ValueError, match="row 0: data is 300; it must be a whole number up to 255"):
        canser.from_xarray(xr.Dataset({**right, "data": data}))
    data = ("row", "byte"), np.zeros((1, 8), np.uint8)
    far = "row", np.array(["2500-01-01"], "M8[s]")
    # Old releases of xarray have nanoseconds only, and refuse the date by themselves.
    with pytest.raises(ValueError, match=r"row 0: ts is 2500|Could not convert"):
        canser.from_xarray(xr.Dataset({**right, "data": data, "ts": far}))
    rows = np.zeros(2, [("a", "u1", (3,)), ("b", "u1", (8,))])
    assert dict(canser.to_xarray(rows).sizes) == {"row": 2, "a_byte": 3, "byte": 8}


@by_both
def test_numbers_stand_for_flags_and_integers_for_times(package: str) -> None:
    frames, channels, directions = read_by(
        package,
        ts=[1, 2, 3],
        ext=[1, 0, 1],
        rtr=[0.0, 1.0, 0.0],
        channel=[0, 7, 254],
        sent=[1, 0, 1],
    )
    assert frames["ts"].tolist() == [1, 2, 3]
    assert frames["ext"].tolist() == [True, False, True]
    assert frames["rtr"].tolist() == [False, True, False]
    assert frames["data"][:, 0].tolist() == [1, 0, 1]
    assert (channels, directions) == ([0, 7, 254], [1, 0, 1])


def test_nulls_of_narrow_integers_and_numbers_turned_round() -> None:
    pa = pytest.importorskip("pyarrow")
    narrow = pa.array([1, None, 2], pa.int8())
    assert read_by("arrow", channel=narrow, sent=pa.array([1, None, 0], pa.uint8()))[1:] == (
        [1, 255, 2],
        [1, 0, 0],
    )
    by_python_can = pa.table(
        {
            "arbitration_id": [1, 2, 3],
            "is_extended_id": [False] * 3,
            "dlc": [0] * 3,
            "data": [b""] * 3,
            "is_rx": [0, 1, None],
        }
    )
    directions = np.zeros(3, np.uint8)
    canser.from_arrow(by_python_can, directions=directions)
    assert directions.tolist() == [1, 0, 0]


@pytest.mark.parametrize("kind", ["binary", "large_binary", "binary_view", "list_", "large_list"])
def test_data_may_be_as_long_as_the_dlc(kind: str) -> None:
    pa = pytest.importorskip("pyarrow")
    values = [b"\1\2", b"", b"12345678"]
    if "list" in kind:
        data = pa.array([list(each) for each in values], getattr(pa, kind)(pa.uint8()))
    else:
        data = pa.array(values, getattr(pa, kind)())
    frames = read_by("arrow", data=data, dlc=[2, 0, 8])[0]
    assert [bytes(each) for each in frames["data"]] == [each.ljust(8, b"\0") for each in values]


def test_polars_tables_of_others() -> None:
    pl = pytest.importorskip("polars")
    frames = back("polars", pl.DataFrame(of_others()))
    assert frames["data"][:, :2].tolist() == [[1, 0]] * 3


def test_pandas_tables_of_arrow() -> None:
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    frames = vehicle(1)[:100]
    frames["ts"][3] = NO_TIME
    for names in NAMES:
        table = canser.to_arrow(
            frames, names=names, channels=np.full(100, 2, np.uint8), directions=frames["dlc"] % 2
        )
        directions = np.zeros(100, np.uint8)
        held = table.to_pandas(types_mapper=pd.ArrowDtype)
        assert np.array_equal(canser.from_pandas(held, directions=directions), frames)
        assert np.array_equal(directions, frames["dlc"] % 2)


def test_durations_come_back_from_duckdb() -> None:
    duckdb = pytest.importorskip("duckdb")
    pytest.importorskip("pyarrow")
    frames = vehicle(1)
    frames["ts"] //= 1000
    frames["ts"] *= 1000  # duckdb has no more than microseconds
    frames["ts"][7] = NO_TIME
    named = canser.table(frames)
    assert len(named) == len(frames)
    assert np.array_equal(canser.from_arrow(duckdb.sql("select * from named")), frames)
    months = duckdb.sql("select * replace (to_months(1) as ts) from named")
    with pytest.raises(ValueError, match="a time has months, which have no fixed length"):
        canser.from_arrow(months)


def test_columns_are_there_once_and_streams_hold_tables() -> None:
    pa = pytest.importorskip("pyarrow")
    twice = pa.table(of_others()).append_column("id", pa.array([9, 9, 9]))
    with pytest.raises(ValueError, match="there are 2 columns id; leave one"):
        canser.from_arrow(twice)
    with pytest.raises(TypeError, match="source must be a table of Arrow: "):
        canser.from_arrow(pa.chunked_array([[1, 2]]))


# ---- Tables of rows and times that are seldom.


def test_an_epoch_is_never_ignored_and_never_wraps() -> None:
    start = datetime(1970, 1, 1, tzinfo=UTC)
    assert canser.table(timed(0, 5), epoch=start)["ts"].dtype == "M8[ns]"
    late, early = 2**63 - 1, NO_TIME + 1
    with pytest.raises(ValueError, match=rf"the time {late} ns and the epoch 2026.* more than 64"):
        canser.table(timed(0, late), epoch=datetime(2026, 1, 1, tzinfo=UTC))
    with pytest.raises(ValueError, match=rf"the time {early} ns and the epoch 1900.* more than 64"):
        canser.table(timed(0, early), epoch=datetime(1900, 1, 1, tzinfo=UTC))


def test_an_id_over_three_digits_is_not_cut() -> None:
    frames = array(Frame(0x123))
    frames = canser.concat([frames])
    frames["id"] = 0x1234
    assert canser.table(frames, id_hex=True)["id_hex"].tolist() == ["00001234"]
    with pytest.raises(TypeError, match="id_hex is 'no'; it must be True or False"):
        canser.table(frames, id_hex="no")  # type: ignore[arg-type]


def test_numbers_of_other_machines_and_text_are_what_they_were() -> None:
    pa = pytest.importorskip("pyarrow")
    swapped = np.array([(5,), (-5,)], [("n", ">i4")])
    assert pa.table(canser.table(swapped))["n"].to_pylist() == [5, -5]
    with pytest.raises(ValueError, match="the field x is no UTF-8"):
        canser.table(np.array([(b"\xff",)], [("x", "S2")]))
