"""Two drives compared, and silences: each difference is found, and nothing else."""

import json
from pathlib import Path

import numpy as np
import pytest

import canser
from calls import BAD_CALL, GOOD, assert_fails, run
from canser._frames import FrameArray
from canser.simulation.traffic import vehicle
from reference import Frame
from samples import MILLISECOND, SECOND, array, timed
from shared import CAPTURES, needs_captures

TEN_MS = 10 * MILLISECOND


def every(period: int, count: int, number: int = 0x123, data: bytes = bytes(8)) -> FrameArray:
    return array(*(Frame(number, dlc=8, data=data, ts=i * period) for i in range(count)))


def by_time(*parts: FrameArray) -> FrameArray:
    whole = canser.concat(parts)
    return whole.take(np.argsort(whole["ts"], kind="stable"))


# compare


def test_a_drive_is_as_itself() -> None:
    frames = vehicle(5)
    found = canser.compare(frames, np.array_split(frames, 7))
    assert len(found.ids) == len(canser.id_stats(frames))
    assert (found.ids["found_in"] == "both").all()
    for difference in (found.only_a, found.only_b, found.bits, found.retimed):
        assert not len(difference)


def test_ids_of_one_drive_are_found() -> None:
    a = canser.frames("123#01", "18FEF100#", "20000080#00")
    b = canser.frames("123#01", "123#R2", "124#", "124#")
    found = canser.compare(a, b)
    names = ["id", "ext", "rtr", "err", "found_in", "count_a", "count_b"]
    assert found.ids[names].tolist() == [
        (0x123, False, False, False, "both", 1, 1),
        (0x123, False, True, False, "b", 0, 1),
        (0x124, False, False, False, "b", 0, 2),
        (0x18FEF100, True, False, False, "a", 1, 0),
        (0x80, False, False, True, "a", 1, 0),
    ]
    assert found.only_a["id"].tolist() == [0x18FEF100, 0x80]
    assert found.only_b["id"].tolist() == [0x123, 0x124]
    text = str(found)
    assert "18FEF100 in A only, 1 frames" in text
    assert "00000080 error in A only" in text
    assert "123 remote in B only" in text


def test_bits_that_move_in_one_drive_only_are_found() -> None:
    a = canser.frames("123#0000", "123#0100", "124#00")
    b = canser.frames("123#0000", "123#0180", "124#0F")
    found = canser.compare(a, b)
    assert found.bits[["id", "byte", "bit", "moves_in"]].tolist() == [(0x123, 1, 7, "b")]
    swapped = canser.compare(b, a)
    assert swapped.bits[["byte", "bit", "moves_in"]].tolist() == [(1, 7, "a")]


@pytest.mark.parametrize(
    ("period", "differs"), [(TEN_MS, 0), (10.1 * MILLISECOND, 0), (20 * MILLISECOND, 1)]
)
def test_a_period_that_differs_is_found(period: float, differs: int) -> None:
    found = canser.compare(every(TEN_MS, 100), every(int(period), 100))
    assert found.timing[["id", "pattern_a", "pattern_b"]].tolist() == [
        (0x123, "periodic", "periodic")
    ]
    assert found.timing["period_b_ns"] == int(period)
    assert len(found.retimed) == differs


def test_a_pattern_that_differs_is_found() -> None:
    found = canser.compare(every(TEN_MS, 100), every(TEN_MS, 3))
    assert found.retimed[["pattern_a", "pattern_b"]].tolist() == [("periodic", "few")]
    assert str(found).endswith("123 periodic 10.00 ms in A, few in B")


def test_a_comparison_does_not_change() -> None:
    found = canser.compare(every(TEN_MS, 9), every(TEN_MS, 9))
    with pytest.raises(AttributeError):
        found.ids = found.bits  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        found.ids["count_a"] = 1


@needs_captures
def test_the_car_on_a_noisy_line_differs_by_what_noise_made() -> None:
    clean = canser.read(CAPTURES / "car.serial.bin", "serial")
    noisy = canser.read(CAPTURES / "car-noisy.serial.bin", "serial")
    found = canser.compare(clean, noisy)
    assert not len(found.only_a)
    assert (found.only_b["count_b"] < 10).all()
    assert not len(found.retimed)


# dropouts


def test_an_id_that_is_silent_for_more_than_five_periods_is_found() -> None:
    others = every(TEN_MS, 300, 0x200)
    for periods, found in ((5, 0), (6, 1)):
        times = [i * TEN_MS for i in range(100)]
        times += [times[-1] + (periods + i) * TEN_MS for i in range(100)]
        rows = canser.dropouts(by_time(timed(*times), others))
        assert len(rows) == found
        for row in rows:
            assert not row["bus"]
            assert (row["id"], row["from_ns"], row["to_ns"]) == (0x100, times[99], times[100])
            assert (row["length_ns"], row["missing"]) == (6 * TEN_MS, 5)


def test_a_silence_of_the_bus_is_one_row_and_none_of_its_ids() -> None:
    def run(start: int) -> FrameArray:
        frames = by_time(every(TEN_MS, 200), every(TEN_MS, 200, 0x124))
        frames["ts"] += start
        return frames

    first, second = run(0), run(5 * SECOND)
    (row,) = canser.dropouts(canser.concat([first, second]))
    assert row["bus"]
    assert (row["from_ns"], row["to_ns"]) == (first["ts"][-1], second["ts"][0])
    assert np.isnan(row["missing"])
    back = run(-50 * SECOND)
    assert not len(canser.dropouts(canser.concat([first, back])))


def test_events_have_no_silences() -> None:
    times = np.cumsum(np.random.default_rng(1).exponential(50 * MILLISECOND, 500)).astype(int)
    frames = by_time(timed(*times.tolist()), every(TEN_MS, 3_000, 0x200))
    assert not len(canser.dropouts(frames))


@needs_captures
def test_silences_of_the_noisy_car_are_short_and_of_ids() -> None:
    rows = canser.dropouts(canser.read(CAPTURES / "car-noisy.serial.bin", "serial"))
    assert len(rows) == 8
    assert not rows["bus"].any()
    assert rows["length_ns"].max() < SECOND


# The commands


@pytest.fixture
def logs(tmp_path: Path) -> list[str]:
    a = by_time(every(TEN_MS, 50), every(TEN_MS, 50, 0x124))
    b = by_time(every(2 * TEN_MS, 50), every(TEN_MS, 50, 0x125))
    canser.write(a, tmp_path / "a.log")
    (tmp_path / "b.bin").write_bytes(canser.encode(b, "serial"))
    return [str(tmp_path / "a.log"), str(tmp_path / "b.bin")]


def test_compare_shows_what_differs(tmp_path: Path, logs: list[str]) -> None:
    done = run(tmp_path, "compare", *logs, "-p", "serial")
    lines = done.stdout.decode().splitlines()
    assert done.returncode == GOOD
    assert lines[0] == "ids        1 in both, 1 in A only, 1 in B only"
    assert " ".join(lines[-1].split()) == "123 periodic 10.00 ms in A, periodic 20.00 ms in B"
    found = json.loads(run(tmp_path, "compare", *logs, "-p", "serial", "--json").stdout)
    assert found.keys() == {"ids", "bits", "timing"}
    assert [row["found_in"] for row in found["ids"]] == ["both", "a", "b"]


def test_stats_show_each_id(tmp_path: Path, logs: list[str]) -> None:
    done = run(tmp_path, "stats", logs[0])
    lines = done.stdout.decode().splitlines()
    assert done.returncode == GOOD
    assert lines[:3] == [
        "ids        2",
        "times      in steps of 10.000 ms",
        "bus load   25.0 kbit/s, at most 25.0 in 100 ms",
    ]
    assert lines[5].split() == ["123", "periodic", "50", "10.000", "0.000", "10.000", "0", "0"]
    found = json.loads(run(tmp_path, "stats", logs[0], "--json").stdout)
    assert found["exact"] is True
    assert [row["period_ns"] for row in found["ids"]] == [TEN_MS, TEN_MS]
    assert found["ids"][0].keys() == {*(canser.ID_STATS_DTYPE.names or ())}


def test_stats_tell_the_load_of_the_bus(tmp_path: Path, logs: list[str]) -> None:
    done = run(tmp_path, "stats", logs[0], "-b", "100000", "--window", "50ms")
    assert "bus load   25.0% of 100,000 bit/s, at most 25.0% in 50 ms" in done.stdout.decode()
    assert done.stderr == b""
    wrong = run(tmp_path, "stats", logs[0], "-b", "10000")
    assert (wrong.returncode, wrong.stderr.decode()) == (
        GOOD,
        "the bus load is up to 250%: the bit rate 10,000 may be wrong\n",
    )
    found = json.loads(run(tmp_path, "stats", logs[0], "-b", "100000", "--json").stdout)
    assert found["bitrate"] == 100_000
    assert found["loads"][0].keys() == {*(canser.LOAD_DTYPE.names or ())}
    (tmp_path / "two.log").write_text("(0.000000) can0 123#\n(0.010000) can1 123#\n")
    two = run(tmp_path, "stats", "two.log", "-b", "100000")
    assert b"that of 2 channels together; choose one with --bus" in two.stderr


@pytest.mark.parametrize("options", [["-b", "0"], ["--window", "1"], ["--window", "0s"]])
def test_a_wrong_option_is_one_line(tmp_path: Path, logs: list[str], options: list[str]) -> None:
    done = run(tmp_path, "stats", logs[0], *options)
    if options == ["--window", "1"]:
        assert done.returncode == GOOD
    else:
        assert_fails(done, BAD_CALL, options[0].strip("-")[-1])


def test_stats_name_the_channel_if_there_are_several(tmp_path: Path) -> None:
    (tmp_path / "two.log").write_text("(0.000000) can0 123#\n(0.010000) vcan1 123#\n")
    lines = run(tmp_path, "stats", "two.log").stdout.decode().splitlines()
    assert [line.split()[:2] for line in lines[5:]] == [["can0", "123"], ["vcan1", "123"]]


def test_statistics_of_a_file_are_those_of_its_frames(tmp_path: Path) -> None:
    """Also in a pipe, and of an empty file."""
    frames = vehicle(20)
    canser.write(frames, tmp_path / "run.log")
    done = run(tmp_path, "stats", "-", "--json", stdin=(tmp_path / "run.log").read_bytes())
    rows = json.loads(done.stdout)["ids"]
    expected = canser.id_stats(canser.read(tmp_path / "run.log"))
    assert [row["count"] for row in rows] == expected["count"].tolist()
    assert [row["missing"] for row in rows] == expected["missing"].tolist()
    (tmp_path / "none.log").write_bytes(b"")
    empty = run(tmp_path, "stats", "none.log", "--from", "candump")
    assert (empty.returncode, empty.stdout.decode()) == (GOOD, "ids        0\n")


@pytest.mark.parametrize("command", ["stats", "compare"])
def test_a_file_that_is_not_there_is_one_line(tmp_path: Path, command: str) -> None:
    done = run(tmp_path, command, *["x.log"] * (1 + (command == "compare")))
    assert done.returncode == BAD_CALL
    assert done.stderr.decode().splitlines() == ["canser: x.log: No such file or directory"]
