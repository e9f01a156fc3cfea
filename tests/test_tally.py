"""What frames amount to: counts, spans, periods, and clocks that restart."""

import tracemalloc
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
import shared
from canser._frames import FrameArray
from canser.analysis.tally import Steps, Tally
from canser.simulation.traffic import damage, vehicle
from reference import NO_TIME, Frame
from samples import FRAMES, MILLISECOND, SECOND, array, timed

HOUR = 3_600 * SECOND
TEN_MS = 10 * MILLISECOND


def tally(*blocks: FrameArray) -> Tally:
    total = Tally()
    for block in blocks:
        total.add(block)
    return total


def facts(total: Tally) -> Any:
    """Return all that a tally says."""
    ids = {
        key: (one.count, one.remote, one.dlc_least, one.dlc_most, one.period_ns)
        for key, one in total.ids.items()
    }
    kinds = total.count, total.extended, total.remote, total.errors, total.dlc
    return kinds, total.clock, ids


def period_ns(*ts: int) -> float | None:
    """Return the period of an id with these times."""
    return tally(timed(*ts)).ids[0x100, False].period_ns


def test_nothing_amounts_to_nothing() -> None:
    total = tally(array())
    assert facts(total) == facts(Tally())
    assert total.count == 0
    assert total.clock.span_ns is None


def test_kinds_are_counted() -> None:
    total = tally(
        array(
            Frame(1),
            Frame(2, ext=True),
            Frame(3, ext=True, rtr=True),
            Frame(4, rtr=True),
            Frame(5, rtr=True),
            Frame(6, err=True),
        )
    )
    assert (total.count, total.extended, total.remote, total.errors) == (6, 2, 3, 1)


def test_frames_are_counted_by_their_dlc() -> None:
    assert tally(array(Frame(1), Frame(1, dlc=8), Frame(2, dlc=8))).dlc == [1, *[0] * 7, 2]


def test_ids_are_told_apart_by_their_kind() -> None:
    total = tally(array(Frame(0x123), Frame(0x123, ext=True), Frame(0x123)))
    assert {key: one.count for key, one in total.ids.items()} == {
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
    one, two = tally(frames).ids[1, False], tally(frames).ids[2, False]
    assert (one.count, one.remote, one.dlc_least, one.dlc_most) == (3, 1, 2, 4)
    assert (two.count, two.remote, two.dlc_least, two.dlc_most) == (2, 0, 8, 8)


def test_an_id_has_its_own_period() -> None:
    fast = [Frame(1, ts=number * TEN_MS) for number in range(100)]
    slow = [Frame(2, ts=number * 10 * TEN_MS) for number in range(10)]
    total = tally(array(*sorted(fast + slow, key=lambda frame: frame.ts)))
    assert total.ids[1, False].period_ns == TEN_MS
    assert total.ids[2, False].period_ns == 10 * TEN_MS


@given(FRAMES, st.lists(st.integers(0, 20)))
def test_blocks_amount_to_what_all_do_at_once(frames: list[Frame], cuts: list[int]) -> None:
    whole = array(*frames)
    blocks = np.split(whole, sorted(min(cut, len(frames)) for cut in cuts))
    assert facts(tally(*blocks)) == facts(tally(whole))


# Spans and periods


def test_the_period_is_the_median_of_the_steps() -> None:
    assert period_ns(0, 2 * SECOND, 5 * SECOND, 6 * SECOND) == 2 * SECOND
    assert period_ns(0, 2 * SECOND, 3 * SECOND) == 1.5 * SECOND


def test_a_lost_frame_does_not_change_the_period() -> None:
    times = [number * TEN_MS for number in range(100) if number % 9]
    assert period_ns(*times) == TEN_MS


def test_only_steps_forward_make_a_period() -> None:
    assert period_ns(SECOND) is None
    assert period_ns(SECOND, SECOND) is None
    assert period_ns(SECOND, SECOND - 1) is None
    assert period_ns(0, TEN_MS, TEN_MS, 0, TEN_MS) == TEN_MS


def test_unknown_times_take_no_part() -> None:
    unknown = tally(timed(NO_TIME, NO_TIME))
    assert unknown.clock.span_ns is None
    assert unknown.ids[0x100, False].period_ns is None
    mixed = tally(timed(NO_TIME, 0, NO_TIME, SECOND, NO_TIME))
    assert mixed.clock.span_ns == SECOND
    assert mixed.ids[0x100, False].period_ns == SECOND


def test_no_step_leads_across_a_restart() -> None:
    """The second id comes later behind the restart than in front of it."""
    run = [Frame(1, ts=number * TEN_MS) for number in range(1_000)]
    total = tally(
        array(Frame(2, ts=0), *run, Frame(2, ts=run[-1].ts), *run, Frame(2, ts=run[-1].ts + SECOND))
    )
    assert total.clock.restarts == 1
    assert total.ids[1, False].period_ns == TEN_MS
    assert total.ids[2, False].period_ns == run[-1].ts
    total.add(array(Frame(2, ts=run[-1].ts + 3 * SECOND)))
    assert total.ids[2, False].period_ns == (run[-1].ts + 2 * SECOND) / 2


@pytest.mark.parametrize("place", [1, 50, 99])
@pytest.mark.parametrize("false", [30_000 * HOUR, -30_000 * HOUR])
def test_a_false_time_out_of_noise_does_not_spoil_span_and_period(place: int, false: int) -> None:
    times = [number * TEN_MS for number in range(100)]
    noisy = tally(timed(*times[:place], times[place] + false, *times[place:]))
    assert noisy.clock.span_ns == 99 * TEN_MS
    assert noisy.ids[0x100, False].period_ns == TEN_MS


def test_a_restart_of_the_device_counts_both_runs() -> None:
    before = range(5 * HOUR, 5 * HOUR + 100 * TEN_MS, TEN_MS)
    after = range(0, 50 * TEN_MS, TEN_MS)
    restarted = tally(timed(*before, *after))
    assert restarted.clock.restarts == 1
    assert restarted.clock.span_ns == (99 + 49) * TEN_MS
    assert restarted.ids[0x100, False].period_ns == TEN_MS


# Captures that are joined


def periods(total: Tally) -> dict[tuple[int, bool], float | None]:
    """Return the periods of the ids that are no noise."""
    return {key: one.period_ns for key, one in total.ids.items() if one.count >= 10}


def decoded(raw: bytes) -> Tally:
    """Return what a capture of `serial` amounts to, read block by block."""
    frames = canser.decode(raw, "serial")
    return tally(*np.array_split(frames, len(frames) // 5_000 + 1))


VEHICLE = canser.encode(vehicle(20), "serial")


@pytest.mark.parametrize("times", [1, 2, 3])
def test_a_capture_joined_to_itself_has_the_same_rates_and_periods(times: int) -> None:
    one, joined = decoded(VEHICLE), decoded(VEHICLE * times)
    assert one.clock.span_ns is not None
    assert (joined.count, joined.clock.span_ns) == (times * one.count, times * one.clock.span_ns)
    assert (joined.clock.restarts, joined.clock.false_times) == (times - 1, 0)
    assert periods(joined) == periods(one)


def test_noise_and_a_restart_change_neither_rates_nor_periods() -> None:
    one = decoded(VEHICLE)
    noisy = decoded(damage(VEHICLE * 2, noise=1e-3).data)
    assert one.clock.span_ns is not None
    assert noisy.clock.restarts == 1
    assert noisy.clock.false_times > 10
    assert noisy.clock.span_ns == pytest.approx(2 * one.clock.span_ns, rel=0.001)
    found = periods(noisy)
    assert periods(one).keys() <= found.keys()
    for key, period in periods(one).items():
        assert found[key] == pytest.approx(period, abs=MILLISECOND)


def test_captures_joined_the_wrong_way_round_add_up() -> None:
    frames = vehicle(20)
    early, late = frames[: len(frames) // 2], frames[len(frames) // 2 :]
    spans = [int(part["ts"][-1] - part["ts"][0]) for part in (early, late)]
    total = tally(late, early)
    assert (total.clock.restarts, total.clock.span_ns) == (1, sum(spans))


def test_a_wrap_of_the_device_clock_is_no_restart() -> None:
    late = vehicle(20)
    late["ts"] += (2**32 - 10_000) * MILLISECOND  # it wraps after 10 s
    raw = canser.encode(late, "serial")
    total = decoded(raw)
    assert facts(total)[2] == facts(decoded(VEHICLE))[2]
    assert (total.clock.restarts, total.clock.span_ns) == (0, int(late["ts"][-1] - late["ts"][0]))
    assert decoded(raw * 2).clock.span_ns == 2 * (total.clock.span_ns or 0)


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
    assert total.clock.restarts == times - 1
    assert total.clock.span_ns == times * int(stamps[-1] - stamps[0])
    assert total.ids[arbitration_id, ext].period_ns == pytest.approx(
        period_ms * MILLISECOND, abs=MILLISECOND / 2
    )


# The median in bounded memory


def median_ns(*pieces: npt.ArrayLike) -> float | None:
    steps = Steps()
    for piece in pieces:
        steps.add(np.asarray(piece, np.uint64))
    return steps.median_ns


def test_the_median_of_few_steps_is_exact() -> None:
    assert median_ns() is None
    assert median_ns([7]) == 7
    assert median_ns([10, 1], [3]) == 3
    assert median_ns([10, 1, 4], [3]) == 3.5
    assert median_ns(np.arange(1, 1_025)) == 512.5


def test_the_median_of_many_steps_is_exact_where_they_are_whole_milliseconds() -> None:
    steps = np.random.default_rng(1).choice([9, 10, 11, 20, 5_000], 100_001) * MILLISECOND
    assert median_ns(steps) == np.median(steps)
    even = [9 * MILLISECOND] * 2_000 + [10 * MILLISECOND] * 2_000
    assert median_ns(even) == 9.5 * MILLISECOND


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("width", [0.001, 0.3, 5])
def test_the_median_of_many_steps_is_good_to_a_128th(seed: int, width: float) -> None:
    rng = np.random.default_rng(seed)
    steps = (np.exp(rng.normal(0, width, 20_000)) * TEN_MS).astype(np.uint64) + np.uint64(1)
    assert median_ns(*np.array_split(steps, 13)) == pytest.approx(np.median(steps), rel=1 / 128)


@given(
    st.lists(st.integers(1, 2**64 - 1), min_size=1, max_size=30),
    st.integers(1, 200),
    st.lists(st.integers(0, 6_000)),
)
def test_pieces_of_steps_have_the_median_of_all(
    steps: list[int], times: int, cuts: list[int]
) -> None:
    every = np.tile(np.array(steps, np.uint64), times)
    borders = [0, *sorted(min(cut, len(every)) for cut in cuts), len(every)]
    pieces = [every[a:b] for a, b in pairwise(borders)]
    found = median_ns(*pieces)
    assert found == pytest.approx(median_ns(every), rel=1e-9)
    assert found == pytest.approx(float(np.median(every.astype(np.float64))), rel=1 / 128)


def test_asking_for_the_median_changes_nothing() -> None:
    rng = np.random.default_rng(1)
    steps = rng.integers(1, HOUR, 5_000).astype(np.uint64)
    asked = Steps()
    for piece in np.array_split(steps, 7):
        asked.add(piece)
        assert asked.median_ns is not None
    assert asked.median_ns == pytest.approx(median_ns(steps), rel=1e-9)


def test_memory_does_not_grow_with_the_steps() -> None:
    rng = np.random.default_rng(1)
    steps = Steps()
    many = np.exp2(rng.uniform(0, 64, 100_000)).astype(np.uint64)
    steps.add(many)
    tracemalloc.start()
    try:
        for _ in range(10):
            steps.add(many)
        grown, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # As many bins as a float64 has for these, 64 exponents of 128 each, of 16 bytes.
    assert grown <= 16 * 64 * 128 + 10_000


def test_an_id_out_of_noise_keeps_little() -> None:
    ids = np.arange(20_000)
    frames = np.zeros(len(ids), canser.FRAME_DTYPE)
    frames["id"], frames["ext"], frames["ts"] = ids, True, ids
    total = Tally()
    tracemalloc.start()
    try:
        total.add(frames)
        total.add(frames)
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(total.ids) == len(ids)
    assert kept <= 1_000 * len(ids)
