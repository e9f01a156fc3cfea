"""What `canser.info` tells of frames: counts, spans, periods, and clocks that restart."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
import shared
from canser.analysis.plain import to_plain
from canser.analysis.summary import FileInfo
from canser.simulation.traffic import damage, vehicle
from reference import NO_TIME, Frame
from samples import FRAMES, MILLISECOND, SECOND, array, info_of, timed

HOUR = 3_600 * SECOND
TEN_MS = 10 * MILLISECOND


def ids(found: FileInfo) -> dict[tuple[int, bool], Any]:
    """Return the rows of all ids by id and ext: those of error frames left out."""
    return {(int(row["id"]), bool(row["ext"])): row for row in found.ids if not row["err"]}


def facts(found: FileInfo) -> Any:
    """Return all that is told, so that it can be compared."""
    return {**dataclasses.asdict(found), "ids": to_plain(found.ids)}


def median_ns(*ts: int) -> float | None:
    """Return the median interval of an id with these times, None if it has none."""
    median = float(ids(info_of(timed(*ts)))[0x100, False]["interval_median_ns"])
    return None if np.isnan(median) else median


def test_nothing_amounts_to_nothing() -> None:
    total = info_of(array())
    assert facts(total) == facts(info_of())
    assert total.frames == 0
    assert total.span_ns is None


def test_kinds_are_counted() -> None:
    total = info_of(
        array(
            Frame(1),
            Frame(2, ext=True),
            Frame(3, ext=True, rtr=True),
            Frame(4, rtr=True),
            Frame(5, rtr=True),
            Frame(6, err=True),
        )
    )
    assert (total.frames, total.extended, total.remote, total.errors) == (6, 2, 3, 1)


def test_frames_are_counted_by_their_dlc() -> None:
    assert info_of(array(Frame(1), Frame(1, dlc=8), Frame(2, dlc=8))).dlc == (1, *[0] * 7, 2)


def test_ids_are_told_apart_by_their_kind() -> None:
    total = info_of(array(Frame(0x123), Frame(0x123, ext=True), Frame(0x123)))
    assert {key: row["count"] for key, row in ids(total).items()} == {
        (0x123, False): 2,
        (0x123, True): 1,
    }


def test_an_id_has_its_own_remote_frames_and_dlcs() -> None:
    frames = array(
        Frame(1, dlc=4),
        Frame(2, dlc=8),
        Frame(1, dlc=2),
        Frame(1, rtr=True, dlc=3),
        Frame(2, dlc=8),
    )
    one, two = ids(info_of(frames))[1, False], ids(info_of(frames))[2, False]
    names = ["count", "remote", "dlc_least", "dlc_most"]
    assert one[names].item() == (3, 1, 2, 4)
    assert two[names].item() == (2, 0, 8, 8)


def test_an_id_has_its_own_period() -> None:
    fast = [Frame(1, ts=number * TEN_MS) for number in range(100)]
    slow = [Frame(2, ts=number * 10 * TEN_MS) for number in range(10)]
    total = info_of(array(*sorted(fast + slow, key=lambda frame: frame.ts)))
    assert ids(total)[1, False]["period_ns"] == TEN_MS
    assert ids(total)[2, False]["period_ns"] == 10 * TEN_MS


@given(FRAMES, st.lists(st.integers(0, 20)))
def test_blocks_amount_to_what_all_do_at_once(frames: list[Frame], cuts: list[int]) -> None:
    whole = array(*frames)
    blocks = np.split(whole, sorted(min(cut, len(frames)) for cut in cuts))
    assert facts(info_of(*blocks)) == facts(info_of(whole))


# Spans and periods


def test_the_median_is_that_of_the_steps() -> None:
    assert median_ns(0, 2 * SECOND, 5 * SECOND, 6 * SECOND) == 2 * SECOND
    assert median_ns(0, 2 * SECOND, 3 * SECOND) == 1.5 * SECOND


def test_a_lost_frame_does_not_change_the_period() -> None:
    times = [number * TEN_MS for number in range(100) if number % 9]
    assert median_ns(*times) == TEN_MS


def test_no_step_back_counts() -> None:
    assert median_ns(SECOND) is None
    assert median_ns(SECOND, SECOND) == 0
    assert median_ns(SECOND, SECOND - 1) is None
    assert median_ns(0, TEN_MS, TEN_MS, 0, TEN_MS) == TEN_MS


def test_unknown_times_take_no_part() -> None:
    unknown = info_of(timed(NO_TIME, NO_TIME))
    assert unknown.span_ns is None
    assert median_ns(NO_TIME, NO_TIME) is None
    mixed = info_of(timed(NO_TIME, 0, NO_TIME, SECOND, 3 * SECOND, NO_TIME))
    assert mixed.span_ns == 3 * SECOND
    # Between 0 and 1 s there was a frame.
    assert ids(mixed)[0x100, False]["interval_median_ns"] == 2 * SECOND


def test_no_step_leads_across_a_restart() -> None:
    """The second id comes later behind the restart than in front of it."""
    run = [Frame(1, ts=number * TEN_MS) for number in range(1_000)]
    late = [Frame(2, ts=run[-1].ts + SECOND), Frame(2, ts=run[-1].ts + 2 * SECOND)]
    frames = [Frame(2, ts=0), *run, Frame(2, ts=run[-1].ts), *run, *late]
    total = info_of(array(*frames[:-1]))
    assert total.restarts == 1
    assert ids(total)[1, False]["interval_median_ns"] == TEN_MS
    assert ids(total)[2, False]["interval_median_ns"] == run[-1].ts
    total = info_of(array(*frames))
    assert ids(total)[2, False]["interval_median_ns"] == (run[-1].ts + SECOND) / 2


@pytest.mark.parametrize("place", [1, 50, 99])
@pytest.mark.parametrize("false", [30_000 * HOUR, -30_000 * HOUR])
def test_a_false_time_out_of_noise_does_not_spoil_span_and_period(place: int, false: int) -> None:
    times = [number * TEN_MS for number in range(100)]
    noisy = info_of(timed(*times[:place], times[place] + false, *times[place:]))
    assert noisy.span_ns == 99 * TEN_MS
    assert ids(noisy)[0x100, False]["period_ns"] == TEN_MS


def test_a_restart_of_the_device_counts_both_runs() -> None:
    before = range(5 * HOUR, 5 * HOUR + 100 * TEN_MS, TEN_MS)
    after = range(0, 50 * TEN_MS, TEN_MS)
    restarted = info_of(timed(*before, *after))
    assert restarted.restarts == 1
    assert restarted.span_ns == (99 + 49) * TEN_MS
    assert ids(restarted)[0x100, False]["period_ns"] == TEN_MS


# Captures that are joined


def periods(total: FileInfo) -> dict[tuple[int, bool], float | None]:
    """Return the periods of the ids that are no noise."""
    return {key: row["period_ns"] for key, row in ids(total).items() if row["count"] >= 10}


def decoded(raw: bytes) -> FileInfo:
    """Return what a capture of `serial` amounts to, read block by block."""
    frames = canser.decode(raw, "serial")
    return info_of(*np.array_split(frames, len(frames) // 5_000 + 1))


VEHICLE = canser.encode(vehicle(20), "serial")


@pytest.mark.parametrize("times", [1, 2, 3])
def test_a_capture_joined_to_itself_has_the_same_rates_and_periods(times: int) -> None:
    one, joined = decoded(VEHICLE), decoded(VEHICLE * times)
    assert one.span_ns is not None
    assert (joined.frames, joined.span_ns) == (times * one.frames, times * one.span_ns)
    assert (joined.restarts, joined.false_times) == (times - 1, 0)
    assert periods(joined) == periods(one)


def test_noise_and_a_restart_change_neither_rates_nor_periods() -> None:
    one = decoded(VEHICLE)
    noisy = decoded(damage(VEHICLE * 2, noise=1e-3).data)
    assert one.span_ns is not None
    assert noisy.restarts == 1
    assert noisy.false_times > 10
    assert noisy.span_ns == pytest.approx(2 * one.span_ns, rel=0.001)
    found = periods(noisy)
    assert periods(one).keys() <= found.keys()
    for key, period in periods(one).items():
        assert found[key] == pytest.approx(period, abs=MILLISECOND)


def test_captures_joined_the_wrong_way_round_add_up() -> None:
    frames = vehicle(20)
    early, late = frames[: len(frames) // 2], frames[len(frames) // 2 :]
    spans = [int(part["ts"][-1] - part["ts"][0]) for part in (early, late)]
    total = info_of(late, early)
    assert (total.restarts, total.span_ns) == (1, sum(spans))


def test_a_wrap_of_the_device_clock_is_no_restart() -> None:
    late = vehicle(20)
    late["ts"] += (2**32 - 10_000) * MILLISECOND  # it wraps after 10 s
    raw = canser.encode(late, "serial")
    total = decoded(raw)
    names = [
        "id",
        "ext",
        "err",
        "count",
        "remote",
        "dlc_least",
        "dlc_most",
        "period_ns",
        "interval_p99_ns",
    ]
    assert total.ids[names].tolist() == decoded(VEHICLE).ids[names].tolist()
    assert (total.restarts, total.span_ns) == (0, int(late["ts"][-1] - late["ts"][0]))
    assert decoded(raw * 2).span_ns == 2 * (total.span_ns or 0)


@shared.needs_captures
@pytest.mark.parametrize("times", [1, 2, 3])
@pytest.mark.parametrize(
    ("name", "arbitration_id", "ext", "period_ms"),
    [
        ("car", 0x140, False, 10),
        ("car-noisy", 0x140, False, 10),
        ("tesla", 0x102, False, 10),
        ("boat", 0x09F21406, True, 100),
    ],
)
def test_real_captures_joined_have_the_same_rates_and_periods(
    name: str, arbitration_id: int, ext: bool, period_ms: int, times: int
) -> None:
    raw = (shared.CAPTURES / f"{name}.serial.bin").read_bytes()
    stamps = canser.decode(
        (shared.CAPTURES / f"{name.removesuffix('-noisy')}.serial.bin").read_bytes(), "serial"
    )["ts"]
    total = decoded(raw * times)
    assert total.restarts == times - 1
    assert total.span_ns == times * int(stamps[-1] - stamps[0])
    assert ids(total)[arbitration_id, ext]["period_ns"] == pytest.approx(
        period_ms * MILLISECOND, abs=MILLISECOND / 2
    )
