"""The load of the bus: each frame is in its window, wherever the stream is cut."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser._frames import FrameArray
from plain_ids import plain_runs
from reference import NO_TIME, Frame
from samples import FRAMES, MILLISECOND, SECOND, array, timed
from shared import CAPTURES, expected, needs_captures
from test_ids import FEW_IDS, assert_same, cut

MS = MILLISECOND


def loaded(frames: FrameArray, *cuts: int, **options: int | str) -> canser.BusLoad:
    load = canser.BusLoad(500_000, **options)
    for part in cut(frames, sorted(cuts)):
        load.add(part)
    return load


@given(st.one_of(FEW_IDS, FRAMES), st.lists(st.integers(0, 60)))
def test_it_is_the_same_wherever_the_stream_is_cut(frames: list[Frame], cuts: list[int]) -> None:
    kept = array(*frames)
    whole, parts = loaded(kept), loaded(kept, *cuts)
    assert_same(whole.rows(), parts.rows())
    assert whole.untimed == parts.untimed
    rows = whole.rows()
    assert rows["frames"].sum() + whole.untimed == len(kept)
    assert (rows["window_ns"] > 0).all()
    # A row more for each run that begins or ends in the middle of one.
    assert len(rows) <= 8_000 + 2 * len(kept)


@given(FEW_IDS)
def test_a_window_has_the_bits_of_its_frames(frames: list[Frame]) -> None:
    """Of times without jumps."""
    whole = array(*frames).copy()
    whole["ts"] = np.sort(np.where(whole["ts"] == NO_TIME, 0, whole["ts"] % SECOND))
    rows, bits = canser.bus_load(whole, 500_000, window=10 * MS), canser.frame_bits(whole)
    windows = (whole["ts"] - whole["ts"][:1]) // (10 * MS)
    assert rows["bits"].tolist() == np.bincount(windows, bits).astype(int).tolist()
    assert rows["frames"].tolist() == np.bincount(windows).tolist()
    assert rows["errors"].tolist() == np.bincount(windows, whole["err"]).astype(int).tolist()
    assert rows["load"] == pytest.approx(rows["bits"] / 5_000)
    assert rows["kbit_s"] == pytest.approx(rows["bits"] / 10)
    assert np.isnan(canser.bus_load(whole)["load"]).all()


def test_a_hole_has_no_rows() -> None:
    run = [number * 10 * MS for number in range(100)]
    later = [time + 100 * SECOND for time in run]
    rows = canser.bus_load(timed(*run, *later))
    assert rows["start_ns"].tolist() == [
        *range(0, SECOND, 100 * MS),
        *range(100 * SECOND, 101 * SECOND, 100 * MS),
    ]
    assert (rows["frames"] == 10).all()


@pytest.mark.parametrize("place", [1, 50, 197])
def test_false_times_have_no_rows_and_are_counted(place: int) -> None:
    times = [number * 10 * MS for number in range(200)]
    times[place : place + 3] = [10**17, 2 * 10**17, -(10**17)]
    for cuts in ((), (place + 1,), (place, place + 1, place + 2, place + 3)):
        load = loaded(timed(*times), *cuts)
        if place == 197:  # No time behind them tells that they are false.
            assert load.rows()["frames"].sum() == 200
        else:
            assert load.untimed == 3
            assert load.rows()["start_ns"].max() < 2 * SECOND


def test_windows_are_counted_anew_behind_a_jump_back() -> None:
    run = [number * 10 * MS + 7 for number in range(100)]
    first, second = [time + 50 * SECOND for time in run], run
    rows = canser.bus_load(timed(*first, *second))
    assert rows["start_ns"].tolist() == [
        *range(first[0], first[0] + SECOND, 100 * MS),
        *range(7, SECOND, 100 * MS),
    ]


def test_times_that_came_already_are_counted_anew() -> None:
    """As in a capture that is played twice."""
    run = [number * 10 * MS for number in range(1_000)]
    rows = canser.bus_load(timed(*run, *run))
    assert rows["start_ns"].tolist() == 2 * [*range(0, 10 * SECOND, 100 * MS)]
    assert (rows["frames"] == 10).all()


def test_a_window_has_one_row_if_the_clock_comes_back_to_it() -> None:
    """Steps back of up to a second are disorder; a hole behind them leads to windows that were."""
    run = [number * 10 * MS for number in range(10_000)]
    back = [run[-1] - number * 900 * MS for number in range(1, 50)]
    slow = [back[-1] + number * 10 * MS for number in range(100)]
    later = [slow[-1] + 20 * SECOND + number * 10 * MS for number in range(3_000)]
    times = [*run, *back, *slow, *later]
    rows = canser.bus_load(timed(*times))
    windows, counts = np.unique(np.array(times) // (100 * MS), return_counts=True)
    assert rows["start_ns"].tolist() == (windows * 100 * MS).tolist()
    assert rows["frames"].tolist() == counts.tolist()


def test_there_are_at_most_8000_rows() -> None:
    times = np.arange(0, 3_600 * SECOND, 500 * MS)
    times[1] += 1
    frames = np.zeros(len(times), canser.FRAME_DTYPE)
    frames["ts"] = times
    rows = canser.bus_load(frames)
    assert set(rows["window_ns"].tolist()) == {500 * MS}
    assert len(rows) == 7_200
    assert len(canser.bus_load(frames, window="100ms")) == 5 * 7_200 - 4


HOUR = 3_600 * SECOND


@pytest.mark.parametrize(
    "times",
    [
        [number * HOUR for number in range(24 * 365)],
        [0, *(SECOND << bits for bits in range(33))],
        [0, HOUR, 20 * HOUR, 400 * HOUR],
    ],
    ids=["a frame an hour", "longer and longer silences", "some silences"],
)
def test_a_bus_that_is_silent_for_hours_takes_little_memory(times: list[int]) -> None:
    frames = np.zeros(len(times), canser.FRAME_DTYPE)
    frames["ts"] = times
    load = canser.BusLoad()
    tracemalloc.start()
    load.add(frames)
    rows = load.rows()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(rows) <= 8_001 + len(times)
    assert rows["frames"].sum() == len(times)
    assert peak < 8 << 20


def test_too_many_rows_of_a_window_are_refused() -> None:
    frames = timed(*(number * HOUR for number in range(24)))
    with pytest.raises(
        ValueError,
        match=r"a window of 0\.001 s makes 82,800,001 rows, and 10,000,000 are the most; "
        r"give 0\.009 s or more",
    ):
        canser.bus_load(frames, window="1ms")
    assert canser.bus_load(frames, window="1s")["frames"].sum() == 24


@given(st.lists(st.integers(-(2**62), 2**62 - 1), min_size=1), st.integers(2**50, 2**62))
def test_a_window_begins_at_or_before_its_frames(times: list[int], window: int) -> None:
    """Also where the span of the times does not fit into 64 bits."""
    rows = canser.bus_load(timed(*sorted(times)), window=window)
    starts = [int(start) for start in rows["start_ns"]]
    assert starts == sorted(set(starts))
    for start, count in zip(starts, rows["frames"].tolist(), strict=True):
        assert sum(start <= time < start + window for time in times) == count


def test_a_window_has_ten_steps_of_the_times() -> None:
    frames = timed(*(number * 20 * MS for number in range(100)))
    assert set(canser.bus_load(frames)["window_ns"].tolist()) == {200 * MS}
    assert set(canser.bus_load(frames, window=100 * MS)["window_ns"].tolist()) == {100 * MS}


@pytest.mark.parametrize("window", ["100ms", 100 * MS])
def test_a_window_is_given_as_text_or_nanoseconds(window: str | int) -> None:
    assert canser.bus_load(timed(0), window=window)["window_ns"] == 100 * MS


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"bitrate": 0}, ValueError, "bitrate is 0; give 1 to 1,000,000"),
        ({"bitrate": 5e5}, TypeError, "bitrate must be an int in bit/s, not float"),
        ({"window": 0.1}, TypeError, "window must be a text"),
        ({"window": 1_000}, ValueError, "window is 1000; give 1ms or more"),
        ({"window": 10**30}, ValueError, "window is 10{30}; give 8640000000000000000 ns or less"),
        ({"window": "1 week"}, ValueError, "cannot read the time '1 week'"),
    ],
)
def test_a_wrong_option_is_refused(
    options: dict[str, int], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        canser.bus_load(timed(0), **options)


def test_runs_of_the_reference_are_those_that_windows_follow() -> None:
    times = [0, 10 * MS, 5 * SECOND, 20 * MS, 30 * MS]
    assert plain_runs(times) == [1, 1, 1, 2, 2]  # the first steps allow a silence of an hour
    assert loaded(timed(*times)).untimed == 0


@needs_captures
def test_the_car_loads_its_bus_to_a_fifth() -> None:
    rows = canser.bus_load(expected("car"), 500_000)
    mean = rows["bits"].sum() / rows["window_ns"].sum() * 1e9 / 500_000
    assert mean == pytest.approx(0.212, abs=0.0005)
    assert rows["load"].max() < 0.25


@needs_captures
@pytest.mark.parametrize(
    ("log", "bitrate", "mean", "most"),
    [
        ("car", 500_000, 0.212, 0.230),
        ("boat", 250_000, 0.089, 0.487),
        ("tesla", 500_000, 0.334, 0.382),
    ],
)
def test_loads_of_captures(log: str, bitrate: int, mean: float, most: float) -> None:
    rows = canser.bus_load(expected(log), bitrate)
    loads = rows["bits"].sum() / rows["window_ns"].sum() * 1e9 / bitrate, rows["load"].max()
    assert loads == pytest.approx((mean, most), abs=0.0006)


@needs_captures
@pytest.mark.parametrize("name", ["car-noisy.serial.bin", "boat.serial.bin", "tesla.serial.bin"])
def test_captures_have_bits_for_all_frames(name: str) -> None:
    frames = canser.read(CAPTURES / name, "serial")
    load = loaded(frames, *range(0, len(frames), 1_000))
    rows = load.rows()
    assert rows["frames"].sum() + load.untimed == len(frames)
    assert load.untimed <= 75 * (name == "car-noisy.serial.bin")
    assert len(rows) < 1_000
