"""Host times of frames, against simulated lines, hosts and device clocks whose truth is known."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from canser._frames import FRAME_DTYPE
from canser.timing.clocks import ClockEstimate, FrameClock
from lines import (
    BYTE_NS,
    EPOCH,
    MS,
    TICK,
    US,
    S,
    Stream,
    Times,
    bus,
    feed,
    room_of,
    send,
    ticks,
    timed,
)
from long import LONG, longer


def known(clock: FrameClock) -> ClockEstimate:
    assert clock.remark is None
    assert clock.estimate is not None
    return clock.estimate


def after(stream: Stream, seconds: float) -> npt.NDArray[np.bool_]:
    return stream.truth >= EPOCH + round(seconds * S)


# Without a clock.


@pytest.mark.parametrize("latency", [MS, 4 * MS, 16 * MS])
def test_unclocked_times_are_between_the_line_and_the_read(latency: int) -> None:
    stream = send(bus(1, 60, 400), latency=latency)
    times, clock = timed(stream)
    assert (times >= stream.done - 2).all()  # the simulation rounds, too
    assert (times <= stream.read).all()
    assert (np.diff(times) >= 0).all()
    assert np.median(times - stream.done) < latency
    assert clock.estimate is None
    assert clock.remark is None


def test_a_busy_line_is_known_to_the_byte() -> None:
    # Back to back frames: every byte but those behind a late read is where the byte time puts it.
    stream = send(EPOCH + np.arange(5000) * 100 * US, latency=MS)
    times, _ = timed(stream)
    assert np.percentile(np.abs(times - stream.done), 90) < 2 * MS


def test_the_last_byte_counts_and_noise_behind_it_does_not() -> None:
    clock = FrameClock(None, 100)
    clock.arrivals.add(5, 1000)
    clock.arrivals.add(100, 50_000)
    room = room_of([5, 15, 98])
    clock.assign_times(room, 3, 99)
    # The first one straddles two reads; behind the last byte of the third there is one more.
    assert room.frames["ts"].tolist() == [50_000 - 9400, 50_000 - 8400, 50_000 - 100]


def test_no_byte_came_before_the_piece_before() -> None:
    clock = FrameClock(None, 100)
    clock.arrivals.add(10, 1000)
    clock.arrivals.add(30, 1500)
    room = room_of([9, 19, 29])
    clock.assign_times(room, 3, 30)
    assert room.frames["ts"].tolist() == [1000, 1000, 1500]


def test_arrivals_never_go_back() -> None:
    clock = FrameClock(None, 100)
    clock.arrivals.add(10, 5000)
    clock.arrivals.add(20, 4000)
    clock.arrivals.add(30, 4500)
    room = room_of([9, 19, 29])
    clock.assign_times(room, 3, 30)
    assert room.frames["ts"].tolist() == [5000, 5000, 5000]


def test_frames_need_arrivals() -> None:
    clock = FrameClock(None, 100)
    clock.arrivals.add(10, 1000)
    with pytest.raises(
        ValueError, match=r"offset 11, .* up to 10 only; tell of the arrivals first"
    ):
        clock.assign_times(room_of([0]), 1, 11)


def test_pieces_are_forgotten_when_all_is_decoded() -> None:
    clock = FrameClock(None, 100)
    for piece in range(1, 1000):
        clock.arrivals.add(piece * 10, piece)
        clock.assign_times(room_of([0]), 0, piece * 10 - 3)
        assert len(clock.arrivals.pieces) <= 3


# With a clock.


@pytest.mark.parametrize("unit", ["ms", "us"])
@pytest.mark.parametrize("latency", [MS, 16 * MS])
@pytest.mark.parametrize("rate", [5, 100, 450])
def test_clocked_times_are_the_truth(unit: str, latency: int, rate: float) -> None:
    stream = send(bus(2, 300, rate), latency=latency)
    times, clock = timed(stream, ticks(stream.truth, unit))
    error = times - stream.truth
    assert (np.diff(times) >= 0).all()
    assert (times <= stream.read).all()
    good = after(stream, 20)
    # The fewer frames, the longer it takes until some come through at once.
    slack = MS if latency == MS or rate > 5 else 6 * MS
    assert error[good].min() >= -TICK[unit] - slack
    assert error[good].max() <= slack
    assert known(clock).restarts == 0
    # One frame of each read is learned from.
    reads = np.searchsorted([end for end, _ in stream.pieces], stream.offsets, "right")
    assert known(clock).frames == pytest.approx(len(np.unique(reads)), rel=0.05)


@longer
@pytest.mark.parametrize("ppm", [-50, 50])
def test_drift_is_followed_for_long(ppm: int) -> None:
    stream = send(bus(3, 3600 if LONG else 1200, 100))
    times, clock = timed(stream, ticks(stream.truth, "ms", ppm))
    error = (times - stream.truth)[after(stream, 5)]
    assert error.min() > -4 * MS
    assert error.max() < 4 * MS
    assert known(clock).drift_ppm == pytest.approx(ppm, abs=3)
    assert known(clock).restarts == 0
    assert 0 < known(clock).jitter_ns < 20 * MS
    now = int(stream.truth[-1]) - int(ticks(stream.truth[-1:], "ms", ppm)[0])
    assert known(clock).offset_ns == pytest.approx(now, abs=4 * MS)


@pytest.mark.parametrize("ppm", [-10_000, 10_000])
def test_a_clock_without_a_crystal(ppm: int) -> None:
    stream = send(bus(5, 400, 200))
    times, clock = timed(stream, ticks(stream.truth, "ms", ppm))
    assert np.abs((times - stream.truth)[after(stream, 200)]).max() < 30 * MS
    assert known(clock).restarts == 0


def test_ticks_of_a_second() -> None:
    stream = send(bus(18, 240, 30))
    times, clock = timed(stream, ticks(stream.truth, "s"))
    error = (times - stream.truth)[after(stream, 20)]
    assert error.min() >= -S - 10 * MS
    assert error.max() <= 50 * MS
    assert known(clock).restarts == 0
    assert abs(known(clock).drift_ppm) < 500


def test_the_estimate_is_good_from_the_start() -> None:
    stream = send(bus(4, 5, 200), latency=4 * MS)
    times, _ = timed(stream, ticks(stream.truth, "us"))
    error = times - stream.truth
    assert error.min() >= 0
    assert error[:8].max() <= 6 * MS
    assert error[after(stream, 1)].max() <= 2 * MS


@pytest.mark.parametrize("seconds", [0.3, 5, 40])
def test_after_a_stall_of_the_host_device_times_are_still_right(seconds: float) -> None:
    length = round(seconds * S)
    stream = send(bus(5, 120, 200), stalls=((60 * S, length),))
    late = stream.read - stream.done
    times, clock = timed(stream, ticks(stream.truth))
    error = (times - stream.truth)[after(stream, 10)]
    assert late.max() > 0.9 * length
    assert np.abs(error).max() <= 4 * MS
    assert (np.diff(times) >= 0).all()
    assert known(clock).restarts == 0


def test_bytes_that_were_old_when_the_port_was_opened() -> None:
    stream = send(bus(6, 60, 200), stalls=((0, 8 * S),))
    times, clock = timed(stream, ticks(stream.truth))
    assert (times <= stream.read).all()
    assert (np.diff(times) >= 0).all()
    assert np.abs((times - stream.truth)[after(stream, 10)]).max() <= 4 * MS
    assert known(clock).restarts == 0


@pytest.mark.parametrize("unit", ["ms", "us"])
def test_a_false_frame_keeps_its_arrival_and_moves_nothing(unit: str) -> None:
    stream = send(bus(7, 120, 300), stalls=((50 * S, 5 * S),))
    device = ticks(stream.truth, unit)
    rng = np.random.default_rng(7)
    false = rng.random(len(device)) < 1e-3
    # Seconds to hours off, both ways.
    wild = (10 ** rng.uniform(9.8, 13, false.sum())).astype(np.int64)
    device[false] += wild * rng.choice([-1, 1], false.sum()) // TICK[unit] * TICK[unit]
    times, clock = timed(stream, device)
    error = times - stream.truth
    good = after(stream, 10) & ~false
    assert false.sum() > 20
    assert -TICK[unit] - MS <= error[good].min()
    assert error[good].max() <= 3 * MS
    assert (np.diff(times[~false]) >= 0).all()
    # The first byte's arrival, and that is not before the frame was on the bus.
    assert (error[false] >= 0).all()
    assert (times[false] <= stream.read[false]).all()
    assert known(clock).restarts == 0


@pytest.mark.parametrize("rate", [2, 200])
@pytest.mark.parametrize("zero", [EPOCH + 59 * S, EPOCH - 40 * S, EPOCH - 10**6 * S])
def test_a_restart_of_the_device_starts_a_new_estimate(rate: float, zero: int) -> None:
    # Its clock starts at zero, is set back a little, or jumps forward.
    stream = send(bus(8, 120, rate))
    device = ticks(stream.truth)
    again = after(stream, 60)
    device[again] = ticks(stream.truth, zero=zero)[again]
    times, clock = timed(stream, device)
    error = times - stream.truth
    assert np.abs(error[after(stream, 15) & ~again]).max() < 12 * MS
    # Until it is noticed they have arrival times.
    assert error[again].max() < 130 * MS
    assert error[again].min() >= -12 * MS
    assert np.abs(error[after(stream, 75)]).max() < 12 * MS
    assert (times <= stream.read).all()
    assert known(clock).restarts == 1


def test_a_clock_that_stood_still_for_a_while() -> None:
    stream = send(bus(9, 150, 200))
    device = ticks(stream.truth)
    device[after(stream, 60)] -= 400 * MS
    times, _ = timed(stream, device)
    error = times - stream.truth
    assert np.abs(error[after(stream, 95)]).max() < 5 * MS


@pytest.mark.parametrize("zero", [EPOCH - 77 * S, EPOCH - 60 * S, EPOCH + 10 * S])
def test_behind_a_gap_the_clock_proves_itself_again(zero: int) -> None:
    # The same device, one that is later by 17 s only, one that was just switched on.
    before, behind = send(bus(10, 60, 200)), send(bus(10, 60, 200))
    device = np.append(ticks(before.truth), ticks(before.truth + 100 * S, zero=zero))
    clock = FrameClock(MS, BYTE_NS)
    times = [f["ts"] for f in feed(clock, before, device[: len(before.truth)])]
    clock.gap()
    behind.offsets += before.end
    behind.lasts += before.end
    behind.end += before.end
    behind.pieces = [(end + before.end, ns + 100 * S) for end, ns in behind.pieces]
    times += [f["ts"] for f in feed(clock, behind, device[len(before.truth) :])]
    error = np.concatenate(times) - np.append(before.truth, behind.truth + 100 * S)
    settled = error[len(before.truth) + 200 :]  # a second
    assert settled.min() >= -3 * MS
    assert settled.max() <= 3 * MS
    assert known(clock).restarts == (zero != EPOCH - 77 * S)


@pytest.mark.parametrize(
    ("unit", "taken_for", "said"),
    [
        ("us", "ms", "1000 times as fast as the host's; is ts_unit 'us'?"),
        ("ms", "s", "1000 times as fast as the host's; is ts_unit 'ms'?"),
        ("us", "s", "1000000 times as fast as the host's; is ts_unit 'us'?"),
        ("ms", "us", "1000 times as slowly as the host's; is ts_unit 'ms'?"),
        ("s", "us", "1000000 times as slowly as the host's; is ts_unit 's'?"),
    ],
)
def test_a_wrong_unit_is_told_and_frames_have_arrival_times(
    unit: str, taken_for: str, said: str
) -> None:
    stream = send(bus(11, 60, 200))
    device = ticks(stream.truth, unit) // TICK[unit] * TICK[taken_for]
    times, clock = timed(stream, device)
    assert clock.remark == f"the device clock runs {said}"
    assert clock.estimate is None
    error = times - stream.truth
    assert error[after(stream, 10)].min() >= 0
    assert error.min() >= -2 * S
    assert (times <= stream.read).all()


def test_a_clock_that_stands_still() -> None:
    stream = send(bus(12, 30, 200))
    times, clock = timed(stream, np.zeros(len(stream.truth), np.int64))
    assert clock.remark == (
        "the device clock stands still or runs backwards; frames have arrival times"
    )
    assert ((times - stream.truth)[after(stream, 10)] >= 0).all()


def test_a_clock_that_is_no_multiple_of_a_thousand_off() -> None:
    stream = send(bus(12, 30, 200))
    _, clock = timed(stream, 5 * ticks(stream.truth))
    assert clock.remark == (
        "the device clock runs 5 times as fast as the host's; frames have arrival times"
    )


def test_a_remark_is_withdrawn_when_the_clock_runs_well() -> None:
    stream = send(bus(13, 60, 200))
    device = ticks(stream.truth)
    stood = ~after(stream, 20)
    device[stood] = device[0]
    times, clock = timed(stream, device)
    assert np.abs((times - stream.truth)[after(stream, 40)]).max() < 4 * MS
    assert known(clock).frames > 1000


def test_noise_only_has_arrival_times_and_no_estimate() -> None:
    stream = send(bus(14, 60, 200))
    device = np.random.default_rng(14).integers(0, 2**32, len(stream.truth)) * MS
    times, clock = timed(stream, device)
    assert ((times >= stream.truth) & (times <= stream.read)).all()
    assert (clock.estimate, clock.remark) == (None, None)


@pytest.mark.parametrize("unit", ["ms", "us"])
def test_a_counter_that_wraps(unit: str) -> None:
    # The decoder unwraps; what the wire cannot say it leaves to the estimate.
    stream = send(bus(15, 60, 200))
    zero = EPOCH + 30 * S - 2**32 * TICK[unit]
    frames = np.zeros(len(stream.truth), FRAME_DTYPE)
    frames["dlc"] = 8
    frames["ts"] = ticks(stream.truth, unit, zero=zero)
    decoder = canser.Decoder("serial", ts_unit=unit)
    decoded = decoder.feed(canser.encode(frames, "serial", ts_unit=unit))
    assert decoder.stats.ts_wraps == 1
    times, clock = timed(stream, decoded["ts"])
    assert np.abs((times - stream.truth)[after(stream, 5)]).max() < 4 * MS
    assert known(clock).restarts == 0


@pytest.mark.parametrize("clocked", [False, True])
@pytest.mark.parametrize("batch", [1, 7, 100_000])
def test_it_does_not_matter_how_calls_are_cut(clocked: bool, batch: int) -> None:
    stream = send(bus(16, 40, 200), stalls=((20 * S, 3 * S),))
    device = ticks(stream.truth)
    device[::97] += 1000 * S
    device[after(stream, 30)] -= 50 * S
    wanted, _ = timed(stream, device if clocked else None)
    times, _ = timed(stream, device if clocked else None, batch=batch)
    assert np.array_equal(times, wanted)


# A line that has no bit rate of its own: bytes come at once, and byte_ns says something else.


def send_at_once(truth: Times, reads: Times) -> Stream:
    """Send frames of 16 bytes that are there at once; those of equal `reads` come in one read.

    The host reads them 0.2 ms after the last of them.
    """
    size = 16
    offsets = np.arange(len(truth)) * size
    last = np.flatnonzero(np.diff(reads, append=reads[-1] + 1))
    read_at = truth[last] + MS // 5
    read = read_at[np.searchsorted(last, np.arange(len(truth)))]
    pieces = list(zip(((last + 1) * size).tolist(), read_at.tolist(), strict=True))
    lasts = offsets + size - 1
    return Stream(truth, offsets, lasts, len(truth) * size, truth + MS // 5, read, pieces)


def with_bursts(at: list[float], silence: float) -> tuple[Stream, npt.NDArray[np.bool_]]:
    """Send a frame each 10 ms, and at some seconds a burst of 30 that come in one read.

    Before each burst nothing is sent for `silence` seconds. Returns also which frames are a
    burst's.
    """
    bursts = [EPOCH + round(second * S) + k * US * 250 for second in at for k in range(30)]
    single = EPOCH + np.arange(0, 300 * S, 10 * MS)
    for second in at:
        from_burst = single - EPOCH - round(second * S)
        single = single[(from_burst < -silence * S) | (from_burst > 8 * MS)]
    times = np.append(single, np.array(bursts, np.int64))
    order = np.argsort(times, kind="stable")
    reads = np.append(np.arange(len(single)), len(single) + np.arange(len(bursts)) // 30)[order]
    return send_at_once(times[order], reads), order >= len(single)


@pytest.mark.parametrize("unit", ["ms", "us"])
@pytest.mark.parametrize("silence", [0, 1])
@pytest.mark.parametrize(
    "at",
    [
        [0.3],
        [60],
        [60.5, 61.5],
        [60 * minute + k / 3 for minute in range(1, 5) for k in range(3)],
        [60 + 0.4 * k for k in range(100)],
    ],
    ids=["at the start", "one", "in two seconds", "three a minute", "again and again"],
)
def test_a_burst_spoils_its_own_frames_only(at: list[float], silence: float, unit: str) -> None:
    stream, own = with_bursts(at, min(silence, 1 if len(at) < 3 else 0.25))
    times, clock = timed(stream, ticks(stream.truth, unit))
    assert np.abs((times - stream.truth)[~own]).max() <= 2 * MS
    assert known(clock).restarts == 0
    # As without a clock.
    times, _ = timed(stream)
    assert np.abs((times - stream.done)[~own]).max() <= 2 * MS


@pytest.mark.parametrize("clocked", [False, True])
@pytest.mark.parametrize("rate", [20_000, 100_000])
def test_a_line_that_is_faster_than_its_rate(rate: int, clocked: bool) -> None:
    # 16 bytes a frame, evenly, for five minutes; the host reads every millisecond.
    truth = EPOCH + np.arange(300 * rate // 16) * (16 * S // rate)
    stream = send_at_once(truth, truth // MS)
    times, clock = timed(stream, ticks(truth, "us") if clocked else None)
    assert np.abs((times - truth)[after(stream, 1)]).max() <= 2 * MS
    assert clock.arrivals.unrated_from is not None


STEPS = st.integers(0, 10**11) | st.sampled_from([0, MS, S])


@given(
    st.booleans(),
    st.floats(0, 1e6),
    st.lists(st.tuples(st.integers(1, 40), STEPS, st.sampled_from("...g")), min_size=1),
    st.data(),
)
def test_whatever_comes_has_a_time_between_its_arrivals(
    clocked: bool, byte_ns: float, reads: list[tuple[int, int, str]], data: st.DataObject
) -> None:
    clock = FrameClock(US if clocked else None, byte_ns)
    ends = np.cumsum([0] + [size for size, _, _ in reads])
    times = EPOCH + np.cumsum([0] + [step for _, step, _ in reads])
    starts = sorted(data.draw(st.sets(st.integers(0, int(ends[-1]) - 1))))
    clocks = data.draw(st.lists(st.integers(-(2**63), 2**63 - 2), min_size=1, max_size=5))
    cuts = sorted(data.draw(st.sets(st.integers(0, len(reads)), max_size=5)) | {0, len(reads)})
    got: list[int] = []
    for first, last in pairwise(cuts):
        for (_, _, gap), end, ns in zip(
            reads[first:last], ends[first + 1 :], times[first + 1 :], strict=False
        ):
            if gap == "g":
                clock.gap()
            clock.arrivals.add(int(end), int(ns))
        offsets = [s for s in starts if ends[first] <= s < ends[last]]
        room = room_of([*offsets, 0])  # some room there must be
        room.frames["ts"][:-1] = [clocks[at % len(clocks)] + at % 2 for at in offsets]
        clock.assign_times(room, len(offsets), int(ends[last]))
        got += room.frames["ts"][:-1].tolist()
    assert len(got) == len(starts)
    if not clocked:
        assert got == sorted(got)
    for start, time in zip(starts, got, strict=True):
        # No later than the read that holds the byte, and without a clock no earlier than the read
        # before.
        latest = np.searchsorted(ends, start + 1)
        assert time <= times[latest]
        earliest = latest - 1
        if not clocked and earliest > 0:
            assert time >= times[earliest]
