"""`canser plot`: the file that it writes, and the calls that it refuses."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import canser
from calls import BAD_CALL, BAD_DATA, GOOD, assert_fails, names, run
from canser.simulation.traffic import vehicle

pytest.importorskip("matplotlib")

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    frames = vehicle(1, extended=False)
    canser.write(frames, tmp_path / "run.log")
    (tmp_path / "run.bin").write_bytes(canser.encode(frames, "serial"))
    shutil.copy(Path(__file__).parents[1] / "examples" / "car.dbc", tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "options",
    [
        "run.log -o x.png",
        "run.bin -p serial -b 500000 --window 200ms --kind load -o x.png --dark --width 800",
        "run.log --kind raster --start 100ms --end 200ms -o x.svg",
        "run.log --id 0A0 -o x.png",
        "run.bin -p serial --kind stream -o x.png",
        "run.log run.bin -p serial --kind compare -o x.pdf",
        "run.log --kind ids --start 5s -o x.png",
    ],
)
def test_a_picture_is_written(folder: Path, options: str) -> None:
    done = run(folder, "plot", *options.split())
    assert done.returncode == GOOD, done.stderr
    (made,) = folder.glob("x.*")
    head = made.read_bytes()[:400]
    assert head.startswith((PNG, b"%PDF")) or b"<svg" in head or b"<?xml" in head


def test_signals_of_a_database(folder: Path) -> None:
    pytest.importorskip("cantools")
    call = ("plot", "run.log", "--db", "car.dbc", "--signal", "RPM", "-o")
    assert run(folder, *call, "x.png").returncode == GOOD
    assert (folder / "x.png").read_bytes().startswith(PNG)
    done = run(folder, "plot", "run.log", "--db", "car.dbc", "--signal", "Nothing", "-o", "y.png")
    assert_fails(done, BAD_CALL, "Nothing")


def test_a_picture_goes_to_standard_output(folder: Path) -> None:
    done = run(folder, "plot", "run.log", "--kind", "load", "-o", "-")
    assert done.returncode == GOOD
    assert done.stdout.startswith(PNG)


def test_a_file_is_replaced_with_force_only(folder: Path) -> None:
    (folder / "x.png").write_bytes(b"mine")
    call = ("plot", "run.log", "--kind", "load", "-o", "x.png")
    assert_fails(run(folder, *call), BAD_CALL, "x.png is there already; --force replaces it")
    assert (folder / "x.png").read_bytes() == b"mine"
    assert run(folder, *call, "--force").returncode == GOOD
    assert (folder / "x.png").read_bytes().startswith(PNG)


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        ("run.log -o x.jpg", BAD_CALL, "end it with .png, .svg or .pdf"),
        ("run.log -o x", BAD_CALL, "x is no name of a picture"),
        ("run.log --kind payload -o x.png", BAD_CALL, "give --id"),
        ("run.log --kind signals -o x.png", BAD_CALL, "give --db"),
        ("run.log --kind compare -o x.png", BAD_CALL, "takes two files IN, not 1"),
        ("run.log --id 0A0 -b 5 -o x.png", BAD_CALL, "--bitrate goes with --kind overview or load"),
        ("run.log --id 12345 -o x.png", BAD_CALL, "'12345' is no id"),
        ("run.log --kind stream -o x.png", BAD_CALL, "run.log holds frames"),
        ("run.bin -p serial --kind stream --end 1s -o x.png", BAD_CALL, "shows all bytes"),
        ("none.log -o x.png", BAD_CALL, "none.log"),
        ("bad.log -o x.png", BAD_DATA, "bad.log"),
    ],
)
def test_wrong_calls_leave_no_file(folder: Path, options: str, code: int, words: str) -> None:
    (folder / "bad.log").write_text("(1.0) can0 123#00\n(what)\n")
    before = names(folder)
    assert_fails(run(folder, "plot", *options.split()), code, words)
    assert names(folder) == before


def test_several_channels_are_told(folder: Path) -> None:
    frames = vehicle(1)
    channels = np.arange(len(frames), dtype=np.uint8) % 2
    canser.write(frames, folder / "two.log", channels=channels)
    done = run(folder, "plot", "two.log", "--kind", "load", "-o", "x.png")
    assert b"the frames of 2 channels are drawn as one; choose one with --bus" in done.stderr
