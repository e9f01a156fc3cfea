"""Statistics of ids, against the same in plain Python."""

import statistics
import threading
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser._core.ids import STEP_LIST, Rows, runs_of
from canser._frames import FrameArray
from plain_ids import by_key, plain_runs, plain_steps, ranked
from reference import NO_TIME, Frame
from samples import FRAMES, MILLISECOND, SECOND, array, timed
from shared import CAPTURES, expected, needs_captures

TEN_MS = 10 * MILLISECOND

# A few ids, so that they have several frames: in order or nearly so, now and then a restart, a
# false time or a hole.
FEW_IDS = st.lists(
    st.builds(
        Frame,
        st.sampled_from((0, 1, 0x7FF)),
        ext=st.booleans(),
        rtr=st.booleans(),
        err=st.booleans(),
        dlc=st.integers(0, 8),
        data=st.sampled_from([bytes(8), b"\x01" + bytes(7)]),
        ts=st.one_of(
            st.integers(0, 50).map(lambda ms: ms * MILLISECOND),
            st.integers(10_000, 10_050).map(lambda ms: ms * MILLISECOND),
            st.integers(0, 10**9).map(lambda ms: ms * MILLISECOND),
            st.just(NO_TIME),
        ),
    ),
    max_size=60,
)


def cut(frames: FrameArray, cuts: list[int]) -> list[FrameArray]:
    return np.split(frames, sorted(min(each, len(frames)) for each in cuts))


def assert_same(one: npt.NDArray[np.void], other: npt.NDArray[np.void]) -> None:
    assert one.dtype == other.dtype
    for name in one.dtype.names or ():
        is_float = one.dtype[name].kind == "f"
        assert np.array_equal(one[name], other[name], equal_nan=is_float), name


# Runs of times


@given(
    st.lists(st.one_of(st.integers(0, 3_000), st.integers(0, 10**9), st.just(None)), max_size=80)
)
def test_runs_are_those_of_plain_python(times: list[int | None]) -> None:
    ts = [NO_TIME if time is None else time * MILLISECOND for time in times]
    rows, runs = Rows(remote_apart=True), plain_runs(ts)
    steps = np.zeros(len(ts), np.int64)
    rows.add(timed(*ts), None, np.zeros(len(ts), np.uint32), steps)
    expected = [
        a == b != 0 and one <= other
        for (a, one), (b, other) in pairwise([(0, 0), *zip(runs, ts, strict=True)])
    ]
    assert (steps >= 0).tolist() == expected


def test_a_hole_is_a_silence_of_more_than_a_second_on_a_fast_bus() -> None:
    fast = [number * TEN_MS for number in range(100)]
    for pause, runs in ((SECOND, 1), (SECOND + 1, 2)):
        times = [*fast, *(fast[-1] + pause + time for time in fast)]
        assert runs_of(timed(*times)).max() == runs


def test_a_slow_bus_has_no_hole_between_its_frames() -> None:
    slow = [number * 5 * SECOND for number in range(1_000)]
    assert (runs_of(timed(*slow)) == 1).all()
    (row,) = canser.id_stats(timed(*slow))
    assert row["period_ns"] == 5 * SECOND
    later = [time + slow[-1] + 200 * SECOND for time in slow]
    assert runs_of(timed(*slow, *later)).max() == 2


@pytest.mark.parametrize("false", [10 * SECOND, -10 * SECOND, 10**18])
@pytest.mark.parametrize("count", [1, 4])
def test_up_to_four_false_times_are_left_out(false: int, count: int) -> None:
    times = [100 * SECOND + number * TEN_MS for number in range(200)]
    times[100 : 100 + count] = [time + false for time in times[100 : 100 + count]]
    runs = runs_of(timed(*times))
    assert np.flatnonzero(runs == 0).tolist() == [*range(100, 100 + count)]
    assert set(runs.tolist()) == {0, 1}
    (row,) = canser.id_stats(timed(*times))
    assert (row["interval_max_ns"], row["missing"]) == (TEN_MS, 0)


def test_five_times_elsewhere_are_a_jump_of_the_clock() -> None:
    times = [100 * SECOND + number * TEN_MS for number in range(200)]
    times[100:105] = [time + 10 * SECOND for time in times[100:105]]
    assert runs_of(timed(*times)).tolist() == [1] * 100 + [2] * 5 + [3] * 95


# Rows


def facts(frames: list[Frame], own: list[int]) -> dict[str, Any]:
    """Return what the row of these frames counts."""
    times = [frames[i].ts for i in own if frames[i].ts != NO_TIME] or [NO_TIME]
    payloads = [(frames[i].dlc, frames[i].data) for i in own]
    moving = bytes(
        np.bitwise_or.reduce([payloads[0][1][k] ^ data[k] for _, data in payloads])
        for k in range(8)
    )
    return {
        "dlc_least": min(dlc for dlc, _ in payloads),
        "dlc_most": max(dlc for dlc, _ in payloads),
        "moving": [*moving],
        "count": len(own),
        "changes": sum(a != b for a, b in pairwise(payloads)),
        "first_ns": times[0],
        "last_ns": times[-1],
    }


def of_steps(steps: list[int]) -> dict[str, float]:
    if not steps:
        return {}
    return {
        "interval_min_ns": min(steps),
        "interval_mean_ns": sum(steps) / len(steps),
        "interval_median_ns": statistics.median(map(float, steps)),
        "interval_p99_ns": ranked(steps, 0.99),
        "interval_max_ns": max(steps),
    }


@given(st.one_of(FEW_IDS, FRAMES), st.lists(st.integers(0, 60)))
def test_the_rows_say_what_plain_python_says(frames: list[Frame], cuts: list[int]) -> None:
    found = canser.id_stats(array(*frames))
    expected, steps = by_key(frames, True), plain_steps(frames, True)
    keys = [(bool(r["err"]), bool(r["ext"]), int(r["id"]), bool(r["rtr"])) for r in found]
    assert keys == [*expected]
    for row, (key, own) in zip(found, expected.items(), strict=True):
        for name, value in facts(frames, own).items():
            assert row[name].tolist() == value, name
        for name in canser.ID_STATS_DTYPE.names or ():
            if name.startswith("interval"):
                wanted = of_steps(steps[key]).get(name, np.nan)
                assert row[name] == pytest.approx(wanted, rel=1e-15, nan_ok=True), name
    assert (found["channel"] == 255).all()
    blocks = cut(array(*frames), cuts)
    assert_same(canser.id_stats(blocks), found)
    stats = canser.IdStats()
    for block in blocks:
        stats.add(block)
    assert stats.exact
    assert_same(stats.rows(), found)
    counted = canser.id_stats(array(*frames), patterns=False)
    for name in (*facts([Frame(1)], [0]), "interval_min_ns", "interval_mean_ns", "interval_max_ns"):
        assert np.array_equal(counted[name], found[name], equal_nan=counted[name].dtype == float)
    assert (counted["pattern"] == "").all()


def test_channels_have_rows_of_their_own() -> None:
    frames = timed(*(number * TEN_MS for number in range(30)))
    channels = np.array([0, 1, 255] * 10, np.uint8)
    found = canser.id_stats(frames, channels=channels)
    assert found["channel"].tolist() == [0, 1, 255]
    assert (found["period_ns"] == 3 * TEN_MS).all()
    stats = canser.IdStats()
    for part, told in zip(np.split(frames, 4 * [7]), np.split(channels, 4 * [7]), strict=True):
        stats.add(part, told)
    assert_same(stats.rows(), found)


def test_the_longest_interval_tells_when_it_began() -> None:
    times = [0, 10, 30, 40, 60]
    (row,) = canser.id_stats(timed(*times))
    assert (row["longest_from_ns"], row["interval_max_ns"]) == (10, 20)
    (alone,) = canser.id_stats(timed(7))
    assert alone["longest_from_ns"] == NO_TIME


@pytest.mark.parametrize("unit", [1, 1_000, 250_000, MILLISECOND])
def test_the_step_of_the_times_is_found(unit: int) -> None:
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.integers(0, 1_000, 3_000)) * unit + 12_345
    (row,) = canser.id_stats(timed(*times.tolist()))
    assert row["time_step_ns"] == unit


def test_frames_that_are_not_contiguous_are_taken() -> None:
    frames = timed(*range(0, 1_000, 10))
    assert_same(canser.id_stats(frames[::2]), canser.id_stats(frames[::2].copy()))


def test_what_is_no_array_of_frames_is_refused() -> None:
    with pytest.raises(TypeError, match=r"frames must be an array of canser\.FRAME_DTYPE"):
        canser.id_stats(np.zeros(3))
    with pytest.raises(TypeError, match="or arrays of them, not str"):
        canser.id_stats("run.log")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"use canser\.IdStats"):
        canser.id_stats([timed(1)], channels=np.zeros(1, np.uint8))
    with pytest.raises(ValueError, match="they must be the same"):
        canser.id_stats(timed(1, 2), channels=np.zeros(1, np.uint8))


def test_no_frames_have_no_rows() -> None:
    assert len(canser.id_stats(timed())) == len(canser.id_stats([])) == 0
    assert len(canser.IdStats().rows()) == 0


# Many steps of an id, which a histogram counts


def streamed(steps: npt.ArrayLike) -> tuple[np.void, np.void]:
    """Return the row of a stream with these steps, and that of the array."""
    times = np.concatenate([[0], np.cumsum(np.asarray(steps, np.int64))])
    frames = np.zeros(len(times), canser.FRAME_DTYPE)
    frames["id"], frames["ts"] = 0x100, times
    (row,), (whole,) = canser.id_stats(np.array_split(frames, 13)), canser.id_stats(frames)
    return row, whole


def test_many_steps_are_exact_where_they_are_whole_milliseconds() -> None:
    steps = np.random.default_rng(1).choice([9, 10, 11, 20, 900], 100_001) * MILLISECOND
    row, whole = streamed(steps)
    for name in ("interval_median_ns", "interval_p99_ns", "period_ns", "jitter_ns", "missing"):
        assert row[name] == whole[name]
    assert whole["interval_median_ns"] == np.median(steps)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("width", [0.001, 0.3, 1])
def test_many_steps_are_good_to_one_percent(seed: int, width: float) -> None:
    rng = np.random.default_rng(seed)
    steps = np.minimum((np.exp(rng.normal(0, width, 20_000)) * MILLISECOND), SECOND // 2)
    row, whole = streamed(steps.astype(np.int64))
    for name in ("interval_median_ns", "interval_p99_ns"):
        assert row[name] == pytest.approx(whole[name], rel=0.01)
    for name in ("interval_min_ns", "interval_mean_ns", "interval_max_ns", "changes"):
        assert row[name] == whole[name]


def test_a_histogram_begins_behind_the_list() -> None:
    for count, exact in ((STEP_LIST, True), (STEP_LIST + 1, False)):
        stats = canser.IdStats()
        stats.add(timed(*range(0, 1_000 * (count + 1), 1_000)))
        assert stats.exact is exact
        assert stats.rows()["interval_median_ns"] == 1_000


def test_memory_does_not_grow_with_the_ids_out_of_noise() -> None:
    """An id with a few frames needs its row only, and no list."""
    frames = np.zeros(20_000, canser.FRAME_DTYPE)
    frames["id"], frames["ext"], frames["ts"] = np.arange(len(frames)), True, np.arange(len(frames))
    rows = Rows(remote_apart=True, keeps_steps=True)
    for _ in range(5):
        rows.add(frames)
        frames["ts"] += len(frames)
    assert len(rows) == len(frames)
    assert rows.bytes_kept <= 500 * len(rows) + 5_000_000


def test_two_threads_do_not_spoil_statistics() -> None:
    frames = timed(*(number * TEN_MS for number in range(1_000)))
    stats = [canser.IdStats() for _ in range(2)]

    def add(each: canser.IdStats) -> None:
        for _ in range(20):
            each.add(frames)

    threads = [threading.Thread(target=add, args=[each]) for each in stats]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert_same(stats[0].rows(), stats[1].rows())
    assert stats[0].rows()["count"] == 20_000


# Captures


@needs_captures
def test_the_car_on_a_noisy_line_misses_what_was_lost() -> None:
    """By intervals across false times, over a billion frames would be missing."""
    found = canser.id_stats(canser.read(CAPTURES / "car-noisy.serial.bin", "serial"))
    assert 1_000 < np.nansum(found["missing"]) < 1_500
    assert (found["pattern"][found["count"] >= 100] == "periodic").all()


@needs_captures
@pytest.mark.parametrize(
    ("log", "patterns"),
    [
        ("car", {"periodic": 35}),
        ("boat", {"periodic": 20, "bursts": 5, "event": 4, "few": 23}),
        ("tesla", {"periodic": 64, "bursts": 2, "event": 14, "few": 100}),
    ],
)
def test_ids_of_captures_have_their_patterns(log: str, patterns: dict[str, int]) -> None:
    found = canser.id_stats(expected(log))
    names, counts = np.unique(found["pattern"], return_counts=True)
    assert dict(zip(names.tolist(), counts.tolist(), strict=True)) == patterns


@needs_captures
def test_bursts_of_the_boat_are_its_messages_of_several_frames() -> None:
    """NMEA 2000 sends a position in 7 frames, a list of satellites in 20, once a second."""
    found = canser.id_stats(expected("boat"))
    for number, burst in ((0x0DF80503, 7), (0x19FA0403, 20)):
        (row,) = found[found["id"] == number]
        assert (row["pattern"], row["burst"], row["missing"]) == ("bursts", burst, 0)
        assert row["period_ns"] == pytest.approx(SECOND, rel=0.001)
