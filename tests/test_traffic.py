"""Simulated traffic: what its docstring promises, and a line's noise at its rate."""

import numpy as np
import pytest

from canser._frames import FRAME_DTYPE, FrameArray
from canser.simulation.traffic import damage, line_noise, vehicle
from reference import ID_EXT_MAX, ID_MAX
from samples import MILLISECOND, SECOND

SECONDS = 10
TRAFFIC = vehicle(SECONDS)
TESTER = 0x7E0


def by_id(frames: FrameArray) -> list[FrameArray]:
    """Return the frames of each control unit's id."""
    return [frames[frames["id"] == one] for one in np.unique(frames["id"]) if one != TESTER]


def test_the_same_seed_gives_the_same_frames() -> None:
    assert vehicle(SECONDS).tobytes() == TRAFFIC.tobytes()
    assert vehicle(SECONDS, seed=2).tobytes() != TRAFFIC.tobytes()


def test_frames_are_valid_records_in_the_order_of_time() -> None:
    assert TRAFFIC.dtype == FRAME_DTYPE
    assert (np.diff(TRAFFIC["ts"]) >= 0).all()
    assert (TRAFFIC["id"] <= np.where(TRAFFIC["ext"], ID_EXT_MAX, ID_MAX)).all()
    assert not TRAFFIC["err"].any()
    past_dlc = np.arange(8) >= np.where(TRAFFIC["rtr"], 0, TRAFFIC["dlc"])[:, None]
    assert not TRAFFIC["data"][past_dlc].any()


def test_times_are_whole_milliseconds_from_the_start_on() -> None:
    assert not (TRAFFIC["ts"] % MILLISECOND).any()
    assert 0 <= TRAFFIC["ts"][0] < 10 * MILLISECOND
    assert TRAFFIC["ts"][-1] < SECONDS * SECOND + 2 * MILLISECOND


def test_64_ids_make_about_2000_frames_a_second() -> None:
    assert len(by_id(TRAFFIC)) == 64
    assert len(TRAFFIC) / SECONDS == pytest.approx(2_000, rel=0.1)


def test_every_id_keeps_its_period() -> None:
    periods = set()
    for frames in by_id(TRAFFIC):
        steps = np.diff(frames["ts"]) / MILLISECOND
        period = round(float(np.median(steps)), -1)
        # Each of two frames may be 2 ms late, and cut to the millisecond.
        assert (abs(steps - period) <= 2).all()
        periods.add(period)
    assert periods == {10, 20, 50, 100, 200, 500, 1000}


def test_every_id_has_one_dlc_and_most_have_eight() -> None:
    dlcs = [set(frames["dlc"].tolist()) for frames in by_id(TRAFFIC)]
    assert all(len(one) == 1 for one in dlcs)
    assert sum(one == {8} for one in dlcs) > 32


def test_the_last_byte_counts() -> None:
    for frames in by_id(TRAFFIC):
        counter = frames["data"][:, frames["dlc"][0] - 1]
        assert (counter == np.arange(len(frames)) % 16).all()


def test_a_quarter_of_the_ids_is_extended() -> None:
    assert sum(bool(frames["ext"].all()) for frames in by_id(TRAFFIC)) == 16


def test_none_is_extended_where_that_is_asked_for() -> None:
    frames = vehicle(SECONDS, extended=False)
    assert not frames["ext"].any()
    assert (frames["id"] <= ID_MAX).all()
    assert len(frames) == len(TRAFFIC)


def test_a_tester_asks_every_two_seconds() -> None:
    remote = TRAFFIC[TRAFFIC["rtr"]]
    assert len(remote) == SECONDS // 2
    assert (remote["id"] == TESTER).all()
    assert (np.diff(remote["ts"]) == 2 * SECOND).all()


def test_no_time_is_no_frames() -> None:
    assert len(vehicle(0)) == 0


CLEAN = bytes(1_000_000)


def test_a_clean_line_changes_nothing() -> None:
    data = bytes(range(256)) * 16
    assert line_noise(data, rate=0) == data


def test_the_same_seed_gives_the_same_noise() -> None:
    assert line_noise(CLEAN) == line_noise(CLEAN)
    assert line_noise(CLEAN) != line_noise(CLEAN, seed=2)


def test_bytes_and_arrays_get_the_same_noise() -> None:
    assert line_noise(np.frombuffer(CLEAN, np.uint8)) == line_noise(CLEAN)


@pytest.mark.parametrize("rate", [1e-3, 1e-2, 0.1])
def test_the_rate_holds(rate: float) -> None:
    noisy = np.frombuffer(line_noise(CLEAN, rate=rate), np.uint8)
    hits = rate * len(CLEAN)
    # Of zeros, two thirds of the hits leave a byte that is not: with one bit set, or any.
    assert np.count_nonzero(noisy) == pytest.approx(hits * 2 / 3, rel=0.1)
    one_bit = np.count_nonzero(np.isin(noisy, 1 << np.arange(8)))
    assert one_bit == pytest.approx(hits / 3, rel=0.15)
    # As many are lost as are added, within the luck of the draw.
    assert abs(len(noisy) - len(CLEAN)) < 5 * (hits * 2 / 3) ** 0.5


def test_a_hit_loses_a_byte_or_adds_one_in_front_or_flips_a_bit() -> None:
    kinds = set()
    for seed in range(50):
        noisy = line_noise(b"\0", rate=1, seed=seed)
        kinds.add(len(noisy))
        if len(noisy) == 1:
            assert noisy[0].bit_count() == 1
        else:
            assert noisy[1:] == b"\0"[: len(noisy) - 1]
    assert kinds == {0, 1, 2}


def test_no_bytes_stay_no_bytes() -> None:
    assert line_noise(b"", rate=1) == b""


NOISE = np.random.default_rng(2).integers(0, 256, 100_000, dtype=np.uint8).tobytes()


def test_damage_tells_what_became_of_every_byte() -> None:
    hit = damage(NOISE, noise=0.1, loss=0.1, seed=5)
    lost, inserted, flipped = (
        set(places.tolist()) for places in (hit.lost, hit.inserted, hit.flipped)
    )
    assert lost
    assert inserted
    assert flipped
    place = 0
    for at, byte in enumerate(NOISE):
        if at in lost:
            assert at not in inserted | flipped
            continue
        place += at in inserted
        assert (hit.data[place] ^ byte).bit_count() == (at in flipped)
        place += 1
    assert place == len(hit.data)


def test_noise_is_the_same_with_any_loss() -> None:
    noisy, both = damage(NOISE, noise=0.05), damage(NOISE, noise=0.05, loss=0.2)
    kept = np.setdiff1d(noisy.flipped, both.lost)
    assert both.flipped.tolist() == kept.tolist()
    assert set(noisy.lost.tolist()) < set(both.lost.tolist())


@pytest.mark.parametrize("share", [0.01, 0.1, 0.5, 1])
def test_the_share_that_is_lost_holds(share: float) -> None:
    assert len(damage(CLEAN, loss=share).lost) / len(CLEAN) == pytest.approx(share, rel=0.05)


def test_bytes_are_lost_in_runs() -> None:
    lost = damage(CLEAN, loss=0.001).lost
    runs = 1 + np.count_nonzero(np.diff(lost) > 1)
    assert len(lost) / runs == pytest.approx(32, rel=0.2)


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_a_share_is_from_0_to_1(share: float) -> None:
    with pytest.raises(ValueError, match=f"noise is {share}; it must be a share"):
        damage(CLEAN, noise=share)
    with pytest.raises(ValueError, match=f"loss is {share}; it must be a share"):
        damage(CLEAN, loss=share)
