"""Logs of text that threads read ahead: the same as by one thread, whatever is in them."""

import threading
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser.codec import parallel
from canser.errors import FormatError
from canser.files import ahead, lines
from canser.simulation.traffic import vehicle
from reference import Frame
from samples import FRAMES, MILLISECOND, array, listed
from shared import LOG_FILES, needs_logs

FORMATS = (".log", ".csv", ".gvret.csv", ".asc", ".trc")

every_format = pytest.mark.parametrize("suffix", FORMATS)

# What a line of a log may be besides a usual one: for all formats, and for each.
ODD = ["", "# a comment", "no line of any log", "\ufffd", "7" * 5000, "123#01"]
ODD_OF = {
    ".log": [
        "(1.5) vcan7 123#0102", "(0.000001) can0 123#R8", "(2.0) can0 123##1AABB", "(3) new 1F#",
        "(1544106679.432583) can1 123#1122 T", "(4.0) can0 80#0D0A.11",
    ],
    ".csv": ["0.5,0x1,0,0,0,12,AA==", "nan,0x123,0,0,0,1,AQ==", "0.25,0x9,0,0,0,1,AQ==\r"],
    ".gvret.csv": ["5,00000123,false,Rx,0,2,1,2,", "5,00000123,false,Rx,0,12,1,2,"],
    ".asc": [
        "base hex timestamps absolute", "0.5 1 ErrorFrame", "base hex timestamps relative",
        "base dec timestamps absolute", "base hex timestamps absolute",
        "0.001 CANFD 1 Rx 123 0 0 8 8 01 02 03 04 05 06 07 08",
    ],
    ".trc": ["; a comment", "      1      0.5 FD 1 0123 Rx - 12 01", ";$COLUMNS=N,O,T,I,d,L,D"],
}  # fmt: skip


@pytest.fixture
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make stretches of about two lines, of any file."""
    monkeypatch.setattr(ahead, "STRETCH", 100)
    monkeypatch.setattr(ahead, "_LEAST", 1)
    monkeypatch.setattr(ahead, "_REST", 0)
    monkeypatch.setattr(lines, "_FIRST", 100)
    monkeypatch.setattr(parallel, "count_cores", lambda: 8)


small = pytest.mark.usefixtures("_small")


def outcome(path: Path, threads: int, **options: Any) -> tuple[Any, ...]:
    """Return all that reading a file gives, or the error that has ended it."""
    seen: list[Frame] = []
    tags: list[int] = []
    out = np.empty(77, canser.FRAME_DTYPE)
    blocks = canser.blocks(path, out=out, threads=threads, **options)
    try:
        for block in blocks:
            seen += listed(block)
            assert blocks.channels is not None
            assert blocks.directions is not None
            tags += [*blocks.channels, *blocks.directions]
    except FormatError as error:
        return seen, tags, str(error)
    return seen, tags, blocks.channel_names, blocks.start_ns, blocks.notes.all_lines


@small
@every_format
@given(frames=FRAMES, data=st.data())
def test_any_text_is_read_as_by_one_thread(
    suffix: str, frames: list[Frame], data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("ahead") / f"x{suffix}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        canser.write(array(*frames), path)
    text = path.read_text("utf-8").split("\n")
    for odd in data.draw(st.lists(st.sampled_from(ODD + ODD_OF[suffix]), max_size=4)):
        text.insert(data.draw(st.integers(0, len(text))), odd)
    end = data.draw(st.sampled_from(["", "\n", "\0\0\0", "(1.0) can0 12"]))
    path.write_text("\n".join(text) + end, "utf-8", newline="")
    options = {
        "skip_bad": data.draw(st.booleans()),
        "times": data.draw(st.sampled_from([None, "delta"])),
        "format": suffix.strip(".").replace("log", "candump").removesuffix(".csv"),
    }
    assert outcome(path, 3, **options) == outcome(path, 1, **options)


@small
@pytest.mark.filterwarnings("ignore::canser.CanserWarning")
@every_format
def test_threads_do_read_ahead(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    joined = []
    join = lines.LineReader._join

    def count(self: Any, stretch: ahead.Stretch) -> Any:
        assert stretch.taken is not None
        joined.append(stretch.taken.frames)
        return join(self, stretch)

    monkeypatch.setattr(lines.LineReader, "_join", count)
    frames = vehicle(2)
    path = tmp_path / f"x{suffix}"
    canser.write(frames, path)
    assert outcome(path, 4)[:2] == outcome(path, 1)[:2]
    assert sum(joined) > 0.9 * len(frames)


@small
@needs_logs
@pytest.mark.parametrize(
    "path",
    [each for each in sorted(LOG_FILES.glob("*.*")) if each.suffix in (".log", ".txt", *FORMATS)],
    ids=lambda path: path.name,
)
def test_logs_by_many_tools_are_read_as_by_one_thread(path: Path) -> None:
    try:
        alone = outcome(path, 1, skip_bad=True)
    except canser.CanserError:
        pytest.skip("it is no log that canser reads")
    assert outcome(path, 3, skip_bad=True) == alone


@small
def test_reading_may_stop_anywhere(tmp_path: Path) -> None:
    canser.write(vehicle(2), tmp_path / "x.log")
    for count in range(3):
        with canser.blocks(tmp_path / "x.log", threads=3) as blocks:
            for _ in zip(range(count), blocks, strict=False):
                pass


@small
def test_a_file_that_gets_shorter_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    canser.write(vehicle(20), path)
    out = np.empty(10, canser.FRAME_DTYPE)
    with canser.blocks(path, out=out, threads=3) as blocks:
        next(blocks)
        with path.open("r+b") as file:
            file.truncate(5000)
        with pytest.raises(OSError, match="it got shorter while it was read"):
            list(blocks)


@small
def test_a_thread_that_cannot_start_is_done_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    canser.write(vehicle(2), tmp_path / "x.log")
    alone = outcome(tmp_path / "x.log", 1)

    def start(_: Any) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", start)
    assert outcome(tmp_path / "x.log", 3) == alone


@small
@every_format
@pytest.mark.parametrize("back", [False, True])
def test_what_is_counted_and_what_changes_midway(suffix: str, back: bool, tmp_path: Path) -> None:
    frames = vehicle(1)
    frames = frames.compress(~(frames["rtr"] | frames["err"]))[:600]
    frames["ts"] = np.arange(len(frames)) * MILLISECOND
    if back:  # also from one stretch to the next one
        frames["ts"] = frames["ts"].reshape(-1, 2)[:, ::-1].reshape(-1)
    path = tmp_path / f"x{suffix}"
    canser.write(frames, path)
    text = path.read_text("utf-8").splitlines()
    for number, odd in enumerate(ODD_OF[suffix]):
        for at in range(50 + 61 * number, len(text), 97):
            text.insert(at, odd)
    path.write_text("\n".join(text), "utf-8", newline="")
    alone = outcome(path, 1, skip_bad=True)
    assert len(alone[0]) > 150
    assert outcome(path, 3, skip_bad=True) == alone
    # Of an error the number of its line is told.
    text.insert(500, "no line of any log")
    path.write_text("\n".join(text), "utf-8", newline="")
    alone = outcome(path, 1)
    assert ", line " in alone[-1]
    assert outcome(path, 3) == alone


def test_a_large_log_is_read_as_by_one_thread(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    frames = np.tile(vehicle(10), 8)
    canser.write(frames, path)
    assert path.stat().st_size > ahead._LEAST
    for threads in (None, 1, 2, 3):
        assert (canser.read(path, threads=threads) == frames).all()
