"""`canser.info` and the command: one object, one text."""

import dataclasses
import doctest
from pathlib import Path

import numpy as np
import pytest

import canser
import shared
from canser.commands.cli import main
from canser.recording.recording import RecordingInfo, RecordingWriter
from canser.simulation.traffic import vehicle
from reference import Frame
from samples import MILLISECOND, SECOND, array, info_of

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
    assert [f"{name}: {remark}" for remark in found.remarks] == printed.err.splitlines()
    assert str(found).splitlines() == [
        *printed.out.splitlines(),
        *([""] if printed.err else []),
        *printed.err.splitlines(),
    ]


def test_the_example_runs(folder: Path) -> None:
    names = {"canser": canser, "np": np, "Path": Path}
    (example,) = doctest.DocTestFinder().find(canser.info, "info", globs=names)
    assert doctest.DocTestRunner().run(example).failed == 0
    assert (folder / "run.bin").stat().st_size == 33


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
    assert found.remarks == ("frames of 2 channels become one: can0 1, can1 1",)
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
    with pytest.raises(ValueError, match=r"unknown format 'blg'; have: raw, .*log"):
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
    assert (one["period_ns"], one["period_p99_ns"]) == (10 * MILLISECOND, 20 * MILLISECOND)
    assert (one["first_ns"], one["last_ns"], one["rate"]) == (0, SECOND, 100)
    assert two["share"] == 1 / 201
    assert np.isnan(two["period_ns"])
    assert np.isnan(two["period_p99_ns"])


def test_error_frames_have_a_row_of_their_own() -> None:
    frames = array(
        Frame(4, ts=0), Frame(4, err=True, ts=3), Frame(4, err=True, ts=5), Frame(4, ts=7)
    )
    found = info_of(frames)
    assert found.ids[["id", "err", "count", "period_ns"]].tolist() == [
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
def test_the_example_of_the_help_is_what_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["info", "--help"])
    shown = capfd.readouterr().out
    assert (
        main(["info", str(shared.CAPTURES / "car.serial.bin"), "-p", "serial", "--top", "2"]) == 0
    )
    printed = capfd.readouterr().out.splitlines()[-4:]
    assert "".join(f"  {line}\n" for line in printed) in shown
