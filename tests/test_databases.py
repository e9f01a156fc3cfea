"""Databases: damaged files, encodings, several files, what is left out, names, and encoding."""

import random
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import canser
from canser.signals.messages import pgn_of
from databases import DATABASES, needs_databases, needs_refusal

HEAD = 'VERSION ""\n\nBU_: ECU\n\n'
ENGINE = """BO_ 291 EngineData: 8 ECU
 SG_ RPM : 0|16@1+ (0.25,0) [0|16000] "rpm" ECU
 SG_ Gear : 16|4@1- (1,0) [0|0] "" ECU

"""


def write(tmp_path: Path, text: str, name: str = "x.dbc", encoding: str = "utf-8") -> Path:
    path = tmp_path / name
    path.write_bytes((HEAD + text).encode(encoding))
    return path


def test_a_database_says_what_it_has(tmp_path: Path) -> None:
    text = ENGINE + 'CM_ SG_ 291 RPM "Engine speed";\nVAL_ 291 Gear -1 "reverse" 0 "neutral" ;\n'
    db = canser.Database(write(tmp_path, text))
    message = db.messages["EngineData"]
    assert (message.id, message.ext, message.length, message.pgn) == (291, False, 8, None)
    rpm, gear = message.signals["RPM"], message.signals["Gear"]
    assert (rpm.unit, rpm.comment, rpm.scale, rpm.maximum) == ("rpm", "Engine speed", 0.25, 16000)
    assert gear.choices == {-1: "reverse", 0: "neutral"}
    assert repr(db) == "<canser.Database: 1 messages, 2 signals>"
    assert not db.left_out


# ---- Files that cantools refuses.


@needs_databases
@needs_refusal
def test_entries_of_signals_that_are_not_there_are_skipped() -> None:
    path = DATABASES / "tesla-broken.dbc"
    with pytest.warns(canser.CanserWarning) as caught:
        db = canser.Database(path)
    line = (
        path.read_text("cp1252")
        .splitlines()
        .index(
            next(
                each
                for each in path.read_text("cp1252").splitlines()
                if each.startswith("VAL_ 568 UI_mapSpeedLimit")
            )
        )
    )
    text = str(caught[0].message)
    assert str(path) in text
    assert f"line {line + 1} (unused VAL_ entries in DBC: VAL_ 568 UI_mapSpeedLimit)" in text
    assert caught[0].filename == __file__
    assert db.messages.keys() == canser.Database(DATABASES / "tesla.dbc").messages.keys()


@pytest.mark.parametrize(
    ("bad", "line"),
    [
        (' SG_ Bad : 3|@1+ (1,0) [0|0] "" ECU', 8),
        (' SG_ Bad : 0|0@1+ (1,0) [0|0] "" ECU', 8),
    ],
)
def test_a_signal_that_cannot_be_read_is_skipped(tmp_path: Path, bad: str, line: int) -> None:
    path = write(tmp_path, ENGINE.rstrip("\n") + f"\n{bad}\n")
    with pytest.warns(canser.CanserWarning, match=f"line {line} "):
        db = canser.Database(path)
    assert list(db.messages["EngineData"].signals) == ["RPM", "Gear"]


def test_a_message_that_cannot_be_is_skipped_with_its_signals(tmp_path: Path) -> None:
    bad = 'BO_ 4096 Far: 8 ECU\n SG_ Lost : 0|8@1+ (1,0) [0|0] "" ECU\n\n'
    with pytest.warns(canser.CanserWarning, match="line 5 .*0x1000 is more than 11 bits"):
        db = canser.Database(write(tmp_path, bad + ENGINE))
    assert list(db.messages) == ["EngineData"]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("BO_ 5 = 8 ECU\n", r"line 5: Invalid syntax"),
        ("BO_ xx\n", r"line 5: Invalid syntax"),
        # Without its types of floats the values of others would be wrong.
        (ENGINE + "SIG_VALTYPE_ 291 RPM : x;\n", r"line 9: Invalid syntax"),
    ],
)
def test_other_damage_is_an_error_with_the_line(tmp_path: Path, text: str, reason: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(canser.FormatError, match=reason) as caught:
        canser.Database(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_random_bytes_are_no_database(tmp_path: Path) -> None:
    path = tmp_path / "x.dbc"
    path.write_bytes(random.Random(1).randbytes(5000))
    with pytest.raises(canser.FormatError):
        canser.Database(path)
    with pytest.raises(FileNotFoundError, match="absent"):
        canser.Database(tmp_path / "absent.dbc")
    with pytest.raises(TypeError, match="no file is given"):
        canser.Database()


def test_no_cantools_names_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cantools.database", None)
    with pytest.raises(ImportError, match=r"pip install 'canser\[dbc\]'"):
        canser.Database(write(tmp_path, ENGINE))


def test_cantools_is_loaded_only_for_a_database() -> None:
    code = "import canser, sys; canser.Database; sys.exit('cantools' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


# ---- What is left out, and several files.


def test_what_cannot_be_decoded_is_left_out_with_the_reason(tmp_path: Path) -> None:
    text = (
        ENGINE
        + "BO_ 292 Long: 64 ECU\n\n"
        + 'BO_ 293 Odd: 8 ECU\n SG_ Past : 60|10@1+ (1,0) [0|0] "" ECU\n'
        + ' SG_ Same : 0|8@1+ (1,0) [0|0] "" ECU\n SG_ Same : 8|8@1+ (1,0) [0|0] "" ECU\n'
        + "\n"
        + "BO_ 291 Twice: 8 ECU\n\nBO_ 300 EngineData: 8 ECU\n\n"
    )
    db = canser.Database(write(tmp_path, text))
    assert list(db.messages) == ["EngineData", "Odd"]
    assert list(db.messages["Odd"].signals) == ["Same"]
    assert db.left_out == {
        "Long": "it has 64 bytes, which is no frame of classic CAN",
        "Odd.Past": "it has bits past the 8 bytes of a frame",
        "Odd.Same": "another signal of the message has the same name",
        "Twice": "another message of the file has the id 123, too",
        "EngineData": "another message of the file has the same name",
    }


def test_the_first_of_several_files_counts(tmp_path: Path) -> None:
    first = write(tmp_path, ENGINE)
    other = ENGINE.replace("291 EngineData", "291 Other") + "BO_ 292 More: 8 ECU\n\n"
    second = write(tmp_path, other, "y.dbc")
    with pytest.warns(
        canser.CanserWarning, match=r"y\.dbc: message Other is left out, as .*x\.dbc"
    ):
        db = canser.Database(first, second)
    assert list(db.messages) == ["EngineData", "More"]
    assert list(db.left_out) == ["Other"]


def test_a_file_given_twice_is_no_other_database(tmp_path: Path) -> None:
    path = write(tmp_path, ENGINE)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        db = canser.Database(path, path)
    assert list(db.messages) == ["EngineData"]
    assert not db.left_out


# ---- Encodings.


@pytest.mark.parametrize(
    ("encoding", "given"), [("utf-8", None), ("cp1252", None), ("cp437", "cp437")]
)
def test_units_are_read_in_their_encoding(tmp_path: Path, encoding: str, given: str | None) -> None:
    text = ENGINE.replace('"rpm"', '"°C"')
    db = canser.Database(write(tmp_path, text, encoding=encoding), encoding=given)
    assert db.messages["EngineData"].signals["RPM"].unit == "°C"


def test_a_wrong_encoding_is_an_error(tmp_path: Path) -> None:
    path = write(tmp_path, ENGINE.replace('"rpm"', '"°C"'), encoding="cp1252")
    with pytest.raises(canser.FormatError, match="is not utf-8; give another encoding="):
        canser.Database(path, encoding="utf-8")


@pytest.mark.parametrize("suffix", ["kcd", "sym"])
def test_other_formats_are_read(tmp_path: Path, suffix: str) -> None:
    database = pytest.importorskip("cantools.database")
    source = database.load_string(HEAD + ENGINE, "dbc")
    path = tmp_path / f"x.{suffix}"
    path.write_text(getattr(source, f"as_{suffix}_string")(), encoding="utf-8")
    db = canser.Database(path)
    rpm = db.decode(canser.frames("123#401F00"))["RPM"]
    assert rpm.values.tolist() == [2000.0]


def test_arxml_is_read() -> None:
    db = canser.Database(Path(__file__).parent / "databases" / "engine.arxml")
    assert [(message.name, message.id, message.length) for message in db.messages.values()] == [
        ("EngineData", 0x123, 3)
    ]
    rpm = db.decode(canser.frames("123#401F00"))["RPM"]
    assert (rpm.values.tolist(), rpm.unit) == ([2000.0], "rpm")


# ---- How messages are found.


GROUPS = """BO_ 2566834942 Any: 8 ECU
 SG_ Direction : 0|8@1+ (1,0) [0|0] "" ECU

BO_ 2566834688 One: 8 ECU
 SG_ Direction : 0|8@1+ (1,0) [0|0] "" ECU

BO_ 2364540159 Plain: 8 ECU
 SG_ Direction : 0|8@1+ (1,0) [0|0] "" ECU

"""


@pytest.mark.parametrize(
    ("match", "found"),
    [
        ("auto", {"Any": 2, "One": 1, "Plain": 1}),
        ("id", {"Any": 1, "One": 1, "Plain": 1}),
        ("pgn", {"Any": 2, "One": 1, "Plain": 2}),
    ],
)
def test_messages_are_found_by_id_or_by_parameter_group(
    tmp_path: Path, match: str, found: dict[str, int]
) -> None:
    db = canser.Database(write(tmp_path, GROUPS), match=match)
    any_id, one_id, plain_id = (message.id for message in db.messages.values())
    assert (any_id & 0xFF, one_id & 0xFF, plain_id & 0xFF) == (0xFE, 0x00, 0xFF)
    ids = [any_id, one_id, any_id ^ 0x0400_0055, plain_id, plain_id ^ 0x0400_0055]
    frames = canser.frames(*(f"{each:08X}#01" for each in ids), "7FE#01")
    report = db.decode(frames).report
    assert report.messages == found
    assert report.decoded_count + int(report.unknown_ids["count"].sum()) == 6


def test_the_destination_is_part_of_the_number_only_from_240_on() -> None:
    assert pgn_of(0x18EA01FE) == pgn_of(0x18EAFF00) == 0xEA00
    assert pgn_of(0x18F00401) != pgn_of(0x18F00501)
    assert pgn_of(0x19F00401) == pgn_of(0x18F00401) + 0x10000


def test_many_ids_without_a_message_are_counted(tmp_path: Path) -> None:
    db = canser.Database(write(tmp_path, ENGINE))
    frames = np.zeros(200_000, canser.FRAME_DTYPE)
    frames["id"], frames["ext"] = np.arange(200_000) // 2, True
    decoder = db.decoder()
    decoder.feed(frames)
    decoder.feed(frames[:1000])
    ids = decoder.report.unknown_ids
    assert len(ids) == 100_000
    assert ids["count"].sum() == 201_000
    assert ids[:500]["count"].tolist() == [4] * 500
    assert ids[:3]["id"].tolist() == [0, 1, 2]


# ---- Names.


def test_names_select_signals(tmp_path: Path) -> None:
    other = ENGINE.replace("291 EngineData", "292 Other")
    db = canser.Database(write(tmp_path, ENGINE + other))
    frames = canser.frames("123#401F01", "124#401F01")
    for names, count in [
        ("RPM", 2),
        ("EngineData.RPM", 1),
        (["RPM", "Other.*"], 3),
        ("EngineData", 2),
        ("*.G?ar", 2),
        ([], 0),
    ]:
        assert len(db.decode(frames, names)) == count, names
    with pytest.raises(ValueError, match=r"no signal 'RPN'; did you mean RPM"):
        db.decode(frames, ["RPM", "RPN"])
    with pytest.raises(TypeError, match="name is 5"):
        db.decode(frames, [5])  # type: ignore[list-item]
    with pytest.raises(KeyError, match=r"several messages: EngineData\.RPM, Other\.RPM"):
        db.decode(frames)["RPM"]


# ---- Encoding.


def encoded(db: canser.Database, values: dict[str, Any]) -> bytes:
    [frame] = db.encode({"EngineData": values})
    return bytes(frame["data"])


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"RPM": 1}, "EngineData needs a value of Gear"),
        ({"RPM": 1, "Gear": 0, "Other": 1}, "has no signal 'Other'; it has: RPM, Gear"),
        ({"RPM": 16001, "Gear": 0}, r"RPM is 16001; the database tells a maximum of 16000"),
        ({"RPM": -1, "Gear": 0}, r"RPM is -1; the database tells a minimum of 0"),
        ({"RPM": 1, "Gear": 8}, r"Gear is 8; its 4 bits hold -8 to 7"),
        ({"RPM": 1, "Gear": "x"}, "Gear has no text 'x'; it has: none"),
        ({"RPM": float("nan"), "Gear": 1}, "RPM is nan"),
    ],
)
def test_values_that_do_not_fit_are_told(
    tmp_path: Path, values: dict[str, Any], reason: str
) -> None:
    db = canser.Database(write(tmp_path, ENGINE))
    with pytest.raises(ValueError, match=reason):
        encoded(db, values)
    with pytest.raises(ValueError, match=r"no message 'Engine'; did you mean EngineData\?"):
        db.encode({"Engine": {}})


@needs_databases
@pytest.mark.parametrize(
    "name", ["abs", "car", "floating_point", "motohawk", "multiplex_2", "signed"]
)
def test_encoding_equals_cantools(name: str) -> None:
    database = pytest.importorskip("cantools.database")
    path = DATABASES / f"{name}.dbc"
    judge, db = database.load_file(path, strict=False), canser.Database(path)
    chance = random.Random(name)
    done = 0
    for message in judge.messages:
        for _ in range(5):
            data = chance.randbytes(message.length)
            try:
                values = message.decode(data, decode_choices=False)
                wanted = message.encode(values)
            except Exception:  # noqa: BLE001 - cantools refuses its own values, or the page
                continue
            [frame] = db.encode({message.name: values})
            assert (frame["id"], frame["ext"]) == (message.frame_id, message.is_extended_frame)
            assert bytes(frame["data"])[: frame["dlc"]] == wanted
            done += 1
    assert done > 0
