"""The commands with a database: `canser signals`, and `canser dump --db`."""

import csv
import dataclasses
import gzip
import io
import json
import subprocess
import sys
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import canser
from calls import BAD_CALL, BAD_DATA, GOOD, assert_fails, names
from canser.commands import cli
from canser.commands._signal_lines import SignalLines
from canser.signals.csv import SampleWriter
from canser.signals.messages import SignalInfo
from canser.signals.parquet import ParquetWriter
from canser.signals.texts import number_text, value_text

pytest.importorskip("cantools")

SECOND = 1_000_000_000
START = 1_631_416_514 * SECOND

DBC = """BU_: ECU
BO_ 291 EngineData: 8 ECU
 SG_ RPM : 0|16@1+ (0.25,0) [0|16000] "rpm" ECU
 SG_ Gear : 16|4@1+ (1,0) [0|0] "" ECU
 SG_ Temp : 24|8@1- (0.1,0) [0|0] "C, oil" ECU
BO_ 292 Pages: 8 ECU
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" ECU
 SG_ Left m0 : 8|8@1+ (1,0) [0|0] "" ECU
 SG_ Right m1 : 8|56@1- (1,0) [0|0] "" ECU
BO_ 293 Floats: 8 ECU
 SG_ Level : 0|64@1- (1,0) [0|0] "" ECU
VAL_ 291 Gear 0 "neutral" 1 "first, \\"slow\\"" ;
SIG_VALTYPE_ 293 Level : 2 ;
"""


def doubles(*values: float) -> list[str]:
    return [f"125#{np.float64(value).tobytes().hex()}" for value in values]


Run = Callable[..., "subprocess.CompletedProcess[bytes]"]


@pytest.fixture
def run(capfdbinary: pytest.CaptureFixture[bytes], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Return a function that runs the command in a folder; here, as it takes long to load."""

    def call(folder: Path, *arguments: str) -> "subprocess.CompletedProcess[bytes]":
        monkeypatch.chdir(folder)
        try:
            code = cli.main(arguments)
        except SystemExit as error:
            code = int(str(error))
        return subprocess.CompletedProcess(arguments, code, *capfdbinary.readouterr())

    return call


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log and a database; nothing writes into it."""
    made = tmp_path_factory.mktemp("signals")
    (made / "car.dbc").write_text(DBC)
    frames = canser.frames(
        "123#401F0103",
        "124#0007",
        "7FF#00",
        "123#602003FD",
        "123#60",
        "124#01",
        *doubles(0.1, np.nan, -np.inf),
        "123#R",
        "124#0008",
    )
    frames["ts"] = START + 10_000_000 * np.arange(len(frames))
    frames["ts"][1] += 1
    canser.write(frames, made / "run.npy")
    (made / "run.bin").write_bytes(canser.encode(frames[:4], "serial"))
    return made


def rows_of(text: bytes) -> list[list[str]]:
    return list(csv.reader(io.StringIO(text.decode(), newline="")))


def test_the_summary_has_the_report_and_a_row_for_each_signal(folder: Path, run: Run) -> None:
    done = run(folder, "signals", "run.npy", "car.dbc")
    assert (done.returncode, done.stderr) == (GOOD, b"")
    assert done.stdout.decode().splitlines() == [
        "9 of 11 frames belong to a message",
        "1 have an id that no message has: 7FF",
        "2 are too short: EngineData, Pages",
        "1 remote frames, 0 error frames",
        "",
        "signal           unit    samples          first            min   max  last",
        "EngineData.RPM   rpm           2           2000           2000  2072  2072",
        'EngineData.Gear                2  first, "slow"  first, "slow"     3     3',
        "EngineData.Temp  C, oil        2            0.3           -0.3   0.3  -0.3",
        "Pages.Page                     3              0              0     1     0",
        "Pages.Left                     2              7              7     8     8",
        "Floats.Level                   3            0.1           -inf   0.1  -inf",
    ]


def test_a_name_chooses_signals_with_or_without_samples(folder: Path, run: Run) -> None:
    done = run(folder, "signals", "run.npy", "car.dbc", "--signal", "*.R*", "--signal", "Gear")
    assert done.returncode == GOOD
    lines = [line.split()[0] for line in done.stdout.decode().splitlines()[6:]]
    assert lines == ["EngineData.RPM", "EngineData.Gear", "Pages.Right"]
    assert done.stdout.decode().splitlines()[-1].split() == ["Pages.Right", "0", *"----"]


def test_the_summary_as_json(folder: Path, run: Run) -> None:
    done = run(folder, "signals", "run.npy", "car.dbc", "--json", "--signal", "Gear,Level")
    assert_fails(done, BAD_CALL, "'Gear,Level'")
    names_of = ("--signal", "Gear", "--signal", "Level", "--signal", "Right")
    done = run(folder, "signals", "run.npy", "car.dbc", "--json", *names_of)
    found = json.loads(done.stdout)
    assert found["report"]["messages"] == {"EngineData": 3, "Pages": 3, "Floats": 3}
    assert found["report"]["unknown_ids"] == [{"id": 0x7FF, "ext": False, "count": 1}]
    gear, right, level = found["signals"]
    assert gear == {
        "message": "EngineData",
        "signal": "Gear",
        "unit": "",
        "samples": 2,
        "first": 1,
        "first_text": 'first, "slow"',
        "min": 1,
        "min_text": 'first, "slow"',
        "max": 3,
        "max_text": None,
        "last": 3,
        "last_text": None,
    }
    assert (right["samples"], right["first"], right["max"]) == (0, None, None)
    # JSON has no infinity.
    assert (level["first"], level["min"], level["max"], level["last"]) == (0.1, None, 0.1, None)


ROWS = [
    ["1631416514.000000", "EngineData", "RPM", "2000.0", "rpm", ""],
    ["1631416514.000000", "EngineData", "Gear", "1", "", 'first, "slow"'],
    ["1631416514.000000", "EngineData", "Temp", "0.30000000000000004", "C, oil", ""],
    ["1631416514.010000001", "Pages", "Page", "0", "", ""],
    ["1631416514.010000001", "Pages", "Left", "7", "", ""],
    ["1631416514.030000", "EngineData", "RPM", "2072.0", "rpm", ""],
    ["1631416514.030000", "EngineData", "Gear", "3", "", ""],
    ["1631416514.030000", "EngineData", "Temp", "-0.30000000000000004", "C, oil", ""],
    ["1631416514.050000", "Pages", "Page", "1", "", ""],
    ["1631416514.060000", "Floats", "Level", "0.1", "", ""],
    ["1631416514.070000", "Floats", "Level", "nan", "", ""],
    ["1631416514.080000", "Floats", "Level", "-inf", "", ""],
    ["1631416514.100000", "Pages", "Page", "0", "", ""],
    ["1631416514.100000", "Pages", "Left", "8", "", ""],
]


@pytest.mark.parametrize("out", ["out.csv", "out.csv.gz", "-"])
def test_a_row_for_each_sample(folder: Path, tmp_path: Path, out: str, run: Run) -> None:
    source, db = str(folder / "run.npy"), str(folder / "car.dbc")
    done = run(tmp_path, "signals", source, db, "-o", out)
    assert done.returncode == GOOD
    assert done.stderr.decode().splitlines()[:2] == [
        f"{source} -> {out}: 14 samples",
        "9 of 11 frames belong to a message",
    ]
    text = done.stdout if out == "-" else (tmp_path / out).read_bytes()
    text = gzip.decompress(text) if out.endswith(".gz") else text
    header, *rows = rows_of(text)
    assert header == ["ts", "message", "signal", "value", "unit", "text"]
    assert rows == ROWS


def test_blocks_do_not_matter(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = canser.read(folder / "run.npy")
    database = canser.Database(folder / "car.dbc")
    monkeypatch.setattr("canser.signals.csv._FRAMES_AT_ONCE", 2)
    file = io.BytesIO()
    writer = SampleWriter(file, database.decoder())
    for at in range(0, len(frames), 3):
        writer.write(frames[at : at + 3])
    assert rows_of(file.getvalue())[1:] == ROWS
    assert writer.count == len(ROWS)


def test_samples_are_those_that_cantools_finds(folder: Path) -> None:
    import cantools  # noqa: PLC0415 - an optional extra

    judge: Any = cantools.database.load_file(folder / "car.dbc")
    random = np.random.default_rng(1)
    frames = np.zeros(500, canser.FRAME_DTYPE)
    frames["id"] = random.choice([0x123, 0x124, 0x125, 0x126], 500)
    frames["dlc"] = 8
    frames["data"] = random.integers(0, 256, (500, 8))
    frames["data"][frames["id"] == 0x124, 0] &= 1
    frames["ts"] = np.arange(500) - 250
    frames["ts"][7] = canser.NO_TIME
    file = io.BytesIO()
    SampleWriter(file, canser.Database(folder / "car.dbc").decoder()).write(frames)
    rows = iter(rows_of(file.getvalue())[1:])
    for frame in frames.compress(frames["id"] != 0x126):
        message = judge.get_message_by_frame_id(int(frame["id"]))
        data = frame["data"].tobytes()
        texts, values = (message.decode(data, decode_choices=each) for each in (True, False))
        for name, value in values.items():
            ts, *row, text = next(rows)
            assert row[:2] == [message.name, name]
            assert np.array_equal(float(row[2]), value, equal_nan=True)
            assert text == (str(texts[name]) if texts[name] is not value and text else "")
            assert ts == "nan" if frame["ts"] == canser.NO_TIME else ns(ts) == frame["ts"]
    assert next(rows, None) is None


def ns(seconds: str) -> int:
    return int(Decimal(seconds).scaleb(9))


def test_values_are_the_shortest_that_are_read_back(folder: Path) -> None:
    values = [0.1, 1e300, 5e-324, 123456789.123, -0.0, 0.0, 1 / 3]
    frames = canser.frames(*doubles(*values, *values))
    file = io.BytesIO()
    SampleWriter(file, canser.Database(folder / "car.dbc").decoder()).write(frames)
    assert [row[3] for row in rows_of(file.getvalue())[1:]] == 2 * list(map(repr, values))
    assert {row[0] for row in rows_of(file.getvalue())[1:]} == {"nan"}


def test_a_row_for_each_time_of_a_grid(
    folder: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("canser.signals.csv._FRAMES_AT_ONCE", 2)
    chosen = ("--signal", "RPM", "--signal", "Gear", "--signal", "Page")
    files = str(folder / "run.npy"), str(folder / "car.dbc"), "-o", str(tmp_path / "out.csv")
    done = run(tmp_path, "signals", *files, *chosen, "--resample", "20ms", "--max-age", "30ms")
    assert done.stderr.decode().splitlines()[0].endswith("out.csv: 3 signals at 6 times")
    header, *rows = rows_of((tmp_path / "out.csv").read_bytes())
    assert header == ["ts", "EngineData.RPM", "EngineData.Gear", "Pages.Page"]
    assert rows == [
        ["1631416514.000000", "2000.0", 'first, "slow"', ""],
        ["1631416514.020000", "2000.0", 'first, "slow"', "0"],
        ["1631416514.040000", "2072.0", "3", "0"],
        ["1631416514.060000", "2072.0", "3", "1"],
        ["1631416514.080000", "", "", "1"],
        ["1631416514.100000", "", "", "0"],
    ]
    done = run(tmp_path, "signals", *files, "--force", "--resample", "10ms", "--how", "linear")
    rows = rows_of((tmp_path / "out.csv").read_bytes())
    assert [row[1] for row in rows[:4]] == ["EngineData.RPM", "2000.0", "2024.0", "2048.0"]


def test_parquet_has_a_row_for_each_sample(folder: Path, tmp_path: Path, run: Run) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    files = str(folder / "run.npy"), str(folder / "car.dbc"), "-o", str(tmp_path / "out.parquet")
    done = run(tmp_path, "signals", *files)
    assert done.stderr.decode().splitlines()[0].endswith("out.parquet: 14 samples")
    table = parquet.read_table(tmp_path / "out.parquet")
    assert table.column_names == ["ts", "signal", "value", "text"]
    rows = table.drop_columns("ts").to_pylist()  # without pandas it has no nanoseconds
    assert [row["signal"] for row in rows] == [f"{row[1]}.{row[2]}" for row in ROWS]
    assert [repr(row["value"]) for row in rows] == [repr(float(row[3])) for row in ROWS]
    assert [row["text"] or "" for row in rows] == [row[5] for row in ROWS]
    assert table["ts"].cast("int64").to_pylist() == [ns(row[0]) for row in ROWS]
    assert table.schema.field("value").metadata[b"canser.unit.EngineData.Temp"] == b"C, oil"


def test_parquet_of_a_grid(folder: Path, tmp_path: Path, run: Run) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    files = str(folder / "run.npy"), str(folder / "car.dbc"), "-o", str(tmp_path / "out.parquet")
    run(tmp_path, "signals", *files, "--signal", "RPM", "--signal", "Page", "--resample", "50ms")
    rows = parquet.read_table(tmp_path / "out.parquet").drop_columns("ts").to_pylist()
    found = [(row["EngineData.RPM"], row["Pages.Page"]) for row in rows]
    assert found == [(2000.0, None), (2072.0, 1), (2072.0, 0)]


def test_blocks_of_parquet_have_one_schema(folder: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    frames = canser.read(folder / "run.npy")
    decoder = canser.Database(folder / "car.dbc").decoder("*")
    with (tmp_path / "out.parquet").open("wb") as file:
        writer = ParquetWriter(file, decoder, "out.parquet")
        writer.write(frames[:4])
        unknown = frames[4:9].copy()
        unknown["ts"] = canser.NO_TIME
        writer.write(unknown)
        writer.write(frames[9:])
        writer.finish()
    table = parquet.read_table(tmp_path / "out.parquet")
    assert table["ts"].null_count == 4
    assert [repr(row) for row in table["value"].to_pylist()] == [repr(float(r[3])) for r in ROWS]
    with (tmp_path / "empty.parquet").open("wb") as file:
        ParquetWriter(file, decoder, "empty.parquet").finish()
    assert parquet.read_table(tmp_path / "empty.parquet").num_rows == 0


@pytest.mark.filterwarnings("ignore")  # asammdf's own
def test_mf4_has_a_group_for_each_group(folder: Path, tmp_path: Path, run: Run) -> None:
    asammdf = pytest.importorskip("asammdf")
    out = tmp_path / "out.mf4"
    files = str(folder / "run.npy"), str(folder / "car.dbc"), "-o", str(out)
    done = run(tmp_path, "signals", *files)
    assert done.stderr.decode().splitlines()[0].endswith("out.mf4: 14 samples")
    signals = canser.Database(folder / "car.dbc").decode(canser.read(folder / "run.npy"))
    start_ns = min(int(signal.ts.view(np.int64).min()) for signal in signals.values())
    with asammdf.MDF(out) as mdf:
        assert mdf.header.abs_time == start_ns
        for signal in signals.values():
            found = mdf.get(signal.full_name, raw=True)
            wanted = signal.values if signal.raw is None else signal.raw
            assert doubles(*found.samples.tolist()) == doubles(*wanted.tolist())
            assert found.unit == signal.unit
            times = (signal.ts.view(np.int64) - start_ns) / 1e9
            assert np.allclose(found.timestamps, times, rtol=0, atol=1e-9)
        texts = {each.full_name: each.choices for each in signals.values() if each.choices}
        for name, choices in texts.items():
            raw = mdf.get(name, raw=True).samples.tolist()
            shown = mdf.get(name).samples.tolist()
            assert [each.decode() for each in shown if each] == [
                choices[each] for each in raw if each in choices
            ]
        assert texts
    grid = tmp_path / "grid.mf4"
    run(tmp_path, "signals", *files[:2], "-o", str(grid), "--resample", "50ms")
    with asammdf.MDF(grid) as mdf:
        rows = signals.resample("50ms")
        found = mdf.get("EngineData.RPM")
        assert found.samples.tolist() == rows["RPM"].values[rows["RPM"].valid].tolist()


def test_mf4_refuses_samples_without_a_time(folder: Path, tmp_path: Path, run: Run) -> None:
    pytest.importorskip("asammdf")
    frames = canser.read(folder / "run.npy")
    frames["ts"] = canser.NO_TIME
    np.save(tmp_path / "untimed.npy", frames)
    files = str(tmp_path / "untimed.npy"), str(folder / "car.dbc")
    done = run(tmp_path, "signals", *files, "-o", str(tmp_path / "out.mf4"))
    assert_fails(done, BAD_DATA, "samples have no time, which MF4 cannot hold; write .csv")
    assert not (tmp_path / "out.mf4").exists()


@pytest.mark.parametrize("name", ["out.csv", "out.parquet"])
@pytest.mark.parametrize("more", [(), ("--resample", "10ms")], ids=str)
def test_a_file_without_samples(
    folder: Path, tmp_path: Path, run: Run, name: str, more: tuple[str, ...]
) -> None:
    if name.endswith("parquet"):
        pytest.importorskip("pyarrow")
    files = str(folder / "run.npy"), str(folder / "car.dbc"), "-o", str(tmp_path / name)
    done = run(tmp_path, "signals", *files, *more, "--signal", "Level", "--filter", "7FF")
    assert done.returncode == GOOD, done.stderr
    done = run(tmp_path, "signals", *files, *more, "--filter", "001", "--force")
    assert done.returncode == GOOD, done.stderr


def test_files_and_databases_in_any_order(folder: Path, run: Run) -> None:
    wanted = run(folder, "signals", "run.npy", "car.dbc").stdout
    for arguments in (("car.dbc", "run.npy"), ("run.npy", "--db", "car.dbc")):
        assert run(folder, "signals", *arguments).stdout == wanted
    done = run(folder, "signals", "run.bin", "-p", "serial", "car.dbc", "--start", "5ms")
    assert done.stdout.decode().splitlines()[0] == "2 of 3 frames belong to a message"
    done = run(folder, "signals", "run.bin", "run.bin", "car.dbc", "-p", "serial")
    assert done.stdout.decode().splitlines()[0] == "6 of 8 frames belong to a message"


def test_a_database_may_have_any_name(folder: Path, tmp_path: Path, run: Run) -> None:
    (tmp_path / "car.txt").write_text(DBC)
    source = str(folder / "run.npy")
    done = run(tmp_path, "signals", source, "car.txt")
    assert (done.returncode, done.stderr) == (GOOD, b"")
    assert done.stdout.startswith(b"9 of 11")


def test_what_a_database_lacks_is_told(folder: Path, tmp_path: Path, run: Run) -> None:
    wide = DBC.replace("8|56@1-", "8|64@1-")
    (tmp_path / "car.dbc").write_text(wide)
    (tmp_path / "b.dbc").write_text(DBC + 'VAL_ 291 Nothing 0 "a" ;\n')
    done = run(tmp_path, "signals", str(folder / "run.npy"), "car.dbc", "b.dbc", "-o", "-")
    assert done.returncode == GOOD
    lines = done.stderr.decode().splitlines()
    assert lines[0].startswith("b.dbc: skipped what cantools refuses: line 14")
    assert lines[1:3] == [
        "b.dbc: message Pages is left out, as car.dbc has Pages with the id 124",
        "Pages.Right is left out: it has bits past the 8 bytes of a frame",
    ]
    assert lines[3].startswith(f"{folder / 'run.npy'} -> -: ")


WRONG = [
    (["run.npy"], BAD_CALL, "required: DB"),
    (["car.dbc", "car.dbc"], BAD_CALL, "no file of frames is given"),
    (["run.npy", "no.dbc"], BAD_CALL, "no.dbc: No such file"),
    (["no.npy", "car.dbc"], BAD_CALL, "no.npy: No such file"),
    (["run.npy", "car.dbc", "--signal", "RPN"], BAD_CALL, "did you mean RPM?"),
    (["run.npy", "car.dbc", "--encoding", "klingon"], BAD_CALL, "unknown encoding: klingon"),
    (["run.npy", "car.dbc", "-o", "out.txt"], BAD_CALL, "out.txt tells no format"),
    (["run.npy", "car.dbc", "--resample", "10ms"], BAD_CALL, "name it with -o"),
    (["run.npy", "car.dbc", "-o", "-", "--max-age", "1s"], BAD_CALL, "--resample 10ms"),
    (["run.npy", "car.dbc", "-o", "-", "--resample", "x"], BAD_CALL, "cannot read the time 'x'"),
    (["run.npy", "car.dbc", "-o", "-", "--json"], BAD_CALL, "--json is for the summary"),
    (["run.npy", "car.dbc", "-o", "there.csv"], BAD_CALL, "--force replaces it"),
    (["run.npy", "db.csv", "-o", "db.csv", "--force"], BAD_CALL, "are one file"),
    (["run.bin", "car.dbc"], BAD_CALL, "give -p"),
    (["run.npy", "broken.dbc"], BAD_DATA, "broken.dbc: line 2"),
    (["run.npy", "run.npy"], BAD_CALL, "no file of frames"),
]


@pytest.mark.parametrize(("arguments", "code", "words"), WRONG, ids=lambda each: str(each)[:40])
def test_errors_are_one_line(
    folder: Path, tmp_path: Path, arguments: list[str], code: int, words: str, run: Run
) -> None:
    for each in folder.iterdir():
        (tmp_path / each.name).symlink_to(each)
    (tmp_path / "there.csv").write_text("old")
    (tmp_path / "broken.dbc").write_text('VERSION ""\nBO_ A: 8 X\n')
    (tmp_path / "db.csv").write_text(DBC)
    before = names(tmp_path)
    assert_fails(run(tmp_path, "signals", *arguments), code, words)
    assert names(tmp_path) == before
    assert (tmp_path / "there.csv").read_text() == "old"


def test_without_cantools_the_command_says_how_to_get_it(folder: Path) -> None:
    code = "import sys; sys.modules['cantools'] = None; from canser.commands import cli"
    for name in (["signals", "run.npy", "car.dbc"], ["dump", "run.npy", "--db", "car.dbc"]):
        done = subprocess.run(
            [sys.executable, "-c", f"{code}; sys.exit(cli.main({name}))"],
            cwd=folder,
            capture_output=True,
            check=False,
        )
        assert_fails(done, BAD_CALL, "car.dbc needs cantools", "pip install 'canser[dbc]'")


# ---- canser dump --db.

DUMP = """(1631416514.000000) can0 123#401F0103
    # EngineData: RPM 2000 rpm, Gear first, "slow", Temp 0.3 C, oil
(1631416514.010000) can0 124#0007
    # Pages: Page 0, Left 7
(1631416514.020000) can0 7FF#00
(1631416514.030000) can0 123#602003FD
    # EngineData: RPM 2072 rpm, Gear 3, Temp -0.3 C, oil
(1631416514.040000) can0 123#60
(1631416514.050000) can0 124#01
    # Pages: Page 1
(1631416514.060000) can0 125#9A9999999999B93F
    # Floats: Level 0.1
(1631416514.070000) can0 125#000000000000F87F
    # Floats: Level nan
(1631416514.080000) can0 125#000000000000F0FF
    # Floats: Level -inf
(1631416514.090000) can0 123#R0
(1631416514.100000) can0 124#0008
    # Pages: Page 0, Left 8
"""


def test_dump_has_the_signals_of_each_frame_under_it(folder: Path, run: Run) -> None:
    done = run(folder, "dump", "run.npy", "--db", "car.dbc")
    assert (done.returncode, done.stderr) == (GOOD, b"")
    assert done.stdout.decode() == DUMP


def test_dump_with_signals_is_a_log_of_candump(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "run.log").write_text(DUMP)
    frames = canser.read(folder / "run.npy")
    frames["ts"] -= frames["ts"] % 1_000
    assert np.array_equal(canser.read(tmp_path / "run.log"), frames)


def test_dump_shows_chosen_signals_and_all_frames(folder: Path, run: Run) -> None:
    more = ("--signal", "Gear", "--signal", "Left", "--filter", "123", "--filter", "7FF", "-t", "z")
    done = run(folder, "dump", "run.npy", "--db", "car.dbc", *more)
    assert done.stdout.decode().splitlines() == [
        "(0.000000) can0 123#401F0103",
        '    # EngineData: Gear first, "slow"',
        "(0.020000) can0 7FF#00",
        "(0.030000) can0 123#602003FD",
        "    # EngineData: Gear 3",
        "(0.040000) can0 123#60",
        "(0.090000) can0 123#R0",
    ]
    assert_fails(run(folder, "dump", "run.npy", "--signal", "RPM"), BAD_CALL, "--db car.dbc")


def test_lines_of_signals_fit_into_a_terminal(folder: Path) -> None:
    database = canser.Database(folder / "car.dbc")
    frames = canser.frames("123#602003FD", "124#0007")
    shown = SignalLines(database, database.decoder(), 40).under(b"a\nb\n", frames)
    assert shown.decode().splitlines() == [
        "a",
        "    # EngineData: RPM 2072 rpm, Gear 3,",
        "    #   Temp -0.3 C, oil",
        "b",
        "    # Pages: Page 0, Left 7",
    ]


# ---- Texts of values.


@pytest.mark.parametrize(
    ("scale", "value", "text"),
    [
        (0.1, 3 * 0.1, "0.3"),
        (0.25, 2000.0, "2000"),
        (0.0155168902, 35.2698914246, "35.2699"),
        (1 / 255 * 100, 7.8431372549, "7.843"),
        (0.125, 0.125, "0.125"),
        (100.5, 100.5, "100.5"),
        (1e-7, 179.1234567, "179.1234567"),
        (0.1, -1e-20, "0"),
        (1e30, 3e32, "3e+32"),
    ],
)
def test_numbers_have_the_places_of_their_step(scale: float, value: float, text: str) -> None:
    assert number_text(value, signal_info(scale=scale)) == text


def test_numbers_of_floats_have_their_digits() -> None:
    value = float(np.float32(0.1))
    assert number_text(value, signal_info(is_float=True, bit_count=32)) == "0.1"
    assert number_text(value, signal_info(is_float=True, bit_count=64)) == "0.100000001490116"


def test_texts_of_a_terminal_have_no_control_codes() -> None:
    info = signal_info(choices={1: "\x1b[2J"}, unit="\x07")
    assert value_text(1, 1, info) == r"'\x1b[2J'"
    assert value_text(2, 2, info) == r"2 '\x07'"


def signal_info(**fields: Any) -> SignalInfo:
    plain: dict[str, Any] = {field.name: None for field in dataclasses.fields(SignalInfo)}
    plain |= {"name": "S", "bit_count": 16, "scale": 1, "offset": 0, "unit": "", "is_float": False}
    return SignalInfo(**plain | fields)
