"""`canser.info` and the command: one object, one text."""

import dataclasses
import doctest
import json
import re
from pathlib import Path

import numpy as np
import pytest

import canser
import shared
from canser.commands.cli import main
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter
from canser.simulation.traffic import vehicle
from reference import NO_TIME, Frame
from samples import MILLISECOND, SECOND, array, info_of, timed

RECORDED = RecordingInfo("seeed", 2_000_000, 500_000, "ms", "/dev/ttyUSB0")
STATUS = bytes.fromhex("AA55 04 01 02") + bytes(14) + b"\x07"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Go to a folder with two seconds of traffic: raw bytes, a recording, and a log."""
    monkeypatch.chdir(tmp_path)
    raw = canser.encode(vehicle(2), "seeed") + STATUS
    (tmp_path / "run.bin").write_bytes(raw)
    with RecordingWriter(tmp_path / "run.pcapng", RECORDED) as recording:
        recording.write(raw, 1_700_000_000 * SECOND)
    (tmp_path / "run.log").write_text("(1.0) can0 123#11\n(2.0) can1 123#22\n")
    return tmp_path


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("name", ["run.bin", "run.pcapng", "run.log"])
def test_the_text_is_what_the_command_prints(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["info", name]) == 0
    printed = capfd.readouterr()
    found = canser.info(Path(name))
    assert "\n".join(found.lines()) == printed.out.rstrip("\n")
    assert list(found.remarks) == printed.err.splitlines()
    assert str(found).splitlines() == [
        *printed.out.splitlines(),
        *([""] if printed.err else []),
        *printed.err.splitlines(),
    ]


def test_the_example_runs(folder: Path) -> None:
    names = {"canser": canser, "np": np, "Path": Path}
    (example,) = doctest.DocTestFinder().find(canser.info, "info", globs=names)
    assert doctest.DocTestRunner().run(example).failed == 0
    assert (folder / "run.bin").stat().st_size == 121


@pytest.mark.usefixtures("folder")
def test_a_protocol_that_is_not_given_is_found() -> None:
    found, given = canser.info("run.bin"), canser.info("run.bin", "seeed")
    assert found.protocol == given.protocol == "seeed"
    assert found.fits[0].protocol == "seeed"
    assert given.fits == ()
    assert found.stats == given.stats
    assert "\n".join(found.lines()).endswith("\n".join(given.lines()))
    assert (found.frames, found.controls[0].data) == (len(vehicle(2)), STATUS)


@pytest.mark.usefixtures("folder")
def test_a_recording_knows_its_line() -> None:
    found = canser.info("run.pcapng")
    assert (found.recording, found.protocol, found.fits) == (RECORDED, "seeed", ())
    assert found.first_ns is not None
    assert found.first_ns >= 1_699_999_990 * SECOND


@pytest.mark.usefixtures("folder")
def test_a_file_of_frames_has_no_bytes() -> None:
    found = canser.info("run.log")
    assert (found.protocol, found.stats, found.recording, found.controls) == (None, None, None, ())
    assert found.remarks == ("run.log: frames of 2 channels become one: can0 1, can1 1",)
    assert (found.first_ns, found.last_ns, found.span_ns, found.rate) == (
        SECOND,
        2 * SECOND,
        SECOND,
        2.0,
    )


def test_noise_fits_no_protocol(folder: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 256, 5_000, np.uint8).tobytes()
    (folder / "noise.bin").write_bytes(noise)
    with pytest.raises(
        canser.NoProtocolError, match=r"noise\.bin: these bytes look like no protocol"
    ):
        canser.info("noise.bin")
    found = canser.info("noise.bin", "seeed")
    assert found.doubt.startswith("noise.bin: ")
    assert str(found).splitlines()[-1] == found.doubt
    assert found.doubt not in list(found.lines())


@pytest.mark.usefixtures("folder")
def test_a_format_that_does_not_exist_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"unknown format 'blg'; have: raw, .*npy"):
        canser.info("run.bin", format="blg")


def test_nothing_of_it_can_be_changed() -> None:
    found = info_of(vehicle(1))
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.frames = 1  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        found.ids["count"] = 1


def test_an_id_has_share_rate_period_and_times() -> None:
    late = [*range(0, 990 * MILLISECOND, 10 * MILLISECOND), SECOND]
    frames = [Frame(2, ts=0), *[Frame(3, ts=0)] * 100, *(Frame(1, ts=ts) for ts in late)]
    (one, three, two) = info_of(array(*frames)).ids
    assert (one["id"], two["id"], three["id"]) == (1, 2, 3)
    assert (one["period_ns"], one["interval_p99_ns"]) == (10 * MILLISECOND, 20 * MILLISECOND)
    assert (one["first_ns"], one["last_ns"], one["rate"]) == (0, SECOND, 100)
    assert two["share"] == 1 / 201
    assert np.isnan(two["period_ns"])
    assert np.isnan(two["interval_p99_ns"])


def test_error_frames_have_a_row_of_their_own() -> None:
    frames = array(
        Frame(4, ts=0), Frame(4, err=True, ts=3), Frame(4, err=True, ts=5), Frame(4, ts=7)
    )
    found = info_of(frames)
    assert found.ids[["id", "err", "count", "interval_median_ns"]].tolist() == [
        (4, False, 2, 7.0),
        (4, True, 2, 2.0),
    ]
    assert [line.split()[0] for line in list(found.lines())[-2:]] == ["004", "00000004"]
    assert list(found.lines())[-1].endswith("  error")


def test_the_most_frequent_ids_alone_are_shown_and_the_others_counted() -> None:
    frames = array(*(Frame(number, ts=0) for number in (1, 2, 2, 3, 3, 3, 4)))
    found = info_of(frames)
    table = list(found.lines())[-5:]
    assert list(found.lines(2))[-4:] == [*table[:3], "ids left out: 2; frames of them: 2"]
    assert list(found.lines(3))[-1] == "ids left out: 1; frames of them: 1"
    assert list(found.lines(4)) == list(found.lines(5)) == list(found.lines())
    assert "ids        4" in list(found.lines(1))


@pytest.mark.usefixtures("folder")
def test_the_command_shows_the_most_frequent_ids(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "run.bin", "--top", "2"]) == 0
    found = canser.info("run.bin")
    assert capfd.readouterr().out.splitlines() == list(found.lines(2))
    with pytest.raises(SystemExit):
        main(["info", "run.bin", "--top", "0"])
    assert "0 must be 1 or more" in capfd.readouterr().err


@shared.needs_captures
def test_the_examples_of_the_help_are_what_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["info", "--help"])
    shown = capfd.readouterr().out
    car = ["info", str(shared.CAPTURES / "car.serial.bin"), "-p", "serial"]
    assert main([*car, "--top", "2"]) == 0
    printed = capfd.readouterr().out.splitlines()[-4:]
    assert "".join(f"  {line}\n" for line in printed) in shown
    assert main([*car, "--json"]) == 0
    first = json.loads(capfd.readouterr().out)["ids"][0]
    values = [first[name] for name in ("id", "count", "period_ns", "interval_p99_ns")]
    assert f"  {json.dumps(values, separators=(',', ':'))}\n" in shown


# As JSON


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("name", ["run.bin", "run.pcapng", "run.log"])
def test_json_is_one_line_with_all_attributes(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["info", name, "--json"]) == 0
    printed = capfd.readouterr()
    assert printed.out.count("\n") == 1
    found, told = canser.info(name), json.loads(printed.out)
    assert told == found.as_dict()
    fields = [field.name for field in dataclasses.fields(canser.FileInfo)]
    assert list(told) == [*fields, "ids_left_out"]
    for key in ("name", "frames", "standard", "first_ns", "span_ns", "protocol", "rate", "doubt"):
        assert told[key] == getattr(found, key)
    assert told["remarks"] == list(found.remarks)
    assert [list(row) for row in told["ids"]] == [list(found.ids.dtype.names or ())] * len(
        found.ids
    )
    assert [row["count"] for row in told["ids"]] == found.ids["count"].tolist()
    assert told["ids_left_out"] == 0


@pytest.mark.usefixtures("folder")
def test_json_tells_bytes_controls_fits_and_the_line() -> None:
    raw, recorded = canser.info("run.bin").as_dict(), canser.info("run.pcapng").as_dict()
    assert raw["controls"] == [
        {"offset": raw["stats"]["bytes_framed"], "data": STATUS.hex().upper()}
    ]
    assert raw["stats"]["rejects"]["marker"] == 0
    assert raw["fits"][0]["protocol"] == "seeed"
    assert recorded["recording"] == dataclasses.asdict(RECORDED)


def test_json_has_null_for_what_is_not_known_and_whole_nanoseconds() -> None:
    unknown = info_of(timed(NO_TIME, NO_TIME)).as_dict()
    assert [unknown[key] for key in ("first_ns", "last_ns", "span_ns", "rate")] == [None] * 4
    names = ("first_ns", "last_ns", "rate", "period_ns", "interval_p99_ns")
    assert [unknown["ids"][0][key] for key in names] == [None] * 5
    (row,) = info_of(timed(0, 3, 7)).as_dict()["ids"]
    assert (row["interval_median_ns"], type(row["interval_median_ns"])) == (4, int)
    json.dumps(row)


@pytest.mark.usefixtures("folder")
def test_json_of_the_most_frequent_ids(capfd: pytest.CaptureFixture[str]) -> None:
    found = canser.info("run.bin", "seeed")
    assert main(["info", "run.bin", "-p", "seeed", "--json", "--top", "2"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert told["ids"] == found.as_dict()["ids"][:2]
    assert told["ids_left_out"] == len(found.ids) - 2


def test_json_is_all_that_is_printed(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """No ranking of protocols in front of it, and nothing if there is no object."""
    (folder / "noise.bin").write_bytes(np.random.default_rng(1).bytes(5_000))
    assert main(["info", "noise.bin", "--json"]) == 1
    printed = capfd.readouterr()
    assert printed.out == ""
    assert "no protocol fits noise.bin" in printed.err
    assert main(["info", "noise.bin", "-p", "seeed", "--json"]) == 1
    printed = capfd.readouterr()
    assert json.loads(printed.out)["doubt"] in printed.err


def test_bytes_that_may_be_two_protocols_are_told(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A bus of one frame, whose bytes are frames of another protocol without marks, too."""
    path = tmp_path / "run.bin"
    path.write_bytes(bytes.fromhex("08 000001 23 11 22 33 44 55 66 77 88") * 600)
    either = r"canet13 or cantalope|cantalope or canet13"
    with pytest.raises(canser.NoProtocolError, match=f"look like ({either}); give protocol='can"):
        canser.read(path, "auto")
    assert main(["info", str(path)]) == 1
    said = rf"run\.bin may be ({either}); name the protocol with -p\n"
    assert re.search(said, capfd.readouterr().err)
    for protocol in ("canet13", "cantalope"):
        assert main(["info", str(path), "-p", protocol]) == 0
