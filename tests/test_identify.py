"""Which protocol fits: the right one, and none where there is none."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import canser
from canser._frames import FRAME_DTYPE, FrameArray
from canser.codec.refusals import carries
from canser.files import fits
from canser.files.judge import describe_fit, likely
from canser.simulation.traffic import line_noise, vehicle
from long import LONG, longer


@pytest.mark.parametrize("protocol", canser.protocols())
@pytest.mark.parametrize("rate", [0, 0.001, 0.01])
def test_the_right_protocol_is_first_and_fits(protocol: str, rate: float) -> None:
    frames = vehicle(5, extended=carries(protocol, ext=True))
    raw = line_noise(canser.encode(frames, protocol), rate=rate)
    fits = canser.identify(raw)
    assert [fit.protocol for fit in fits if fit.fits] == [protocol]
    assert fits[0].protocol == protocol
    assert fits[0].score > (0.95 if rate <= 0.001 else 0.75)
    assert sorted(fit.protocol for fit in fits) == list(canser.protocols())


@pytest.mark.parametrize(
    "data",
    [
        np.random.default_rng(1).integers(0, 256, 50_000, np.uint8).tobytes(),
        bytes(10_000),
        b"\xaa" * 10_000,
        b"The quick brown fox jumps over the lazy dog. " * 300,
        b"",
        b"\xaa",
    ],
    ids=["noise", "zeros", "markers", "text", "nothing", "one byte"],
)
def test_nothing_fits_what_is_none(data: bytes) -> None:
    fits = canser.identify(data)
    assert not any(fit.fits for fit in fits)


def test_a_single_frame_is_enough_where_marks_are_strong() -> None:
    raw = bytes.fromhex("AA C8 23 01 11 22 33 44 55 66 77 88 55")
    assert canser.identify(raw)[0].protocol == "seeed"


def test_evidence_is_that_of_the_bytes() -> None:
    raw = canser.encode(vehicle(2), "seeed")
    fit = canser.identify(raw + b"noise")[0]
    decoder = canser.Decoder("seeed")
    decoder.feed(raw + b"noise")
    decoder.flush()
    assert fit.stats == decoder.stats
    assert fit.explained == pytest.approx(len(raw) / (len(raw) + 5))
    assert fit.chance < 0.05
    assert fit.luck == 0


def test_large_data_is_looked_at_all_over_and_quickly() -> None:
    raw = canser.encode(vehicle(60), "serial")
    noise = np.random.default_rng(1).integers(0, 256, len(raw), np.uint8).tobytes()
    half = canser.identify(noise + raw)[0]
    assert half.protocol == "serial"
    assert half.stats.bytes_in <= 1 << 18
    assert half.explained == pytest.approx(0.5, abs=0.05)


def test_the_same_bytes_give_the_same_answer() -> None:
    raw = canser.encode(vehicle(1), "seeed")
    assert canser.identify(raw) == canser.identify(raw)


# Buses of each kind: each takes some milliseconds.
BUSES = 50 if LONG else 1


def quiet_buses(protocol: str, id_count: int, dlc: int, *, counter: bool) -> Iterator[bytes]:
    """Yield captures of 600 frames with constant data or a counter in their last byte."""
    number = np.arange(600)
    for seed in range(BUSES):
        rng = np.random.default_rng([id_count, dlc, counter, seed])
        which = number % id_count
        frames = np.zeros(600, FRAME_DTYPE)
        frames["id"] = rng.choice(0x800, id_count, replace=False)[which]
        frames["dlc"] = dlc
        frames["data"] = rng.integers(0, 256, (id_count, 8), np.uint8)[which]
        if counter and dlc:
            frames["data"][:, dlc - 1] = number // id_count
        frames["ts"] = rng.integers(1 << 32) * 1_000_000 + number * 10_000_000
        yield canser.encode(frames, protocol)


def holds_in_any_order(raw: bytes) -> bool:
    """Return whether these bytes are frames of cantalope in whatever order they stand."""
    return bool((np.frombuffer(raw, np.uint8) & 0xF <= 8).all())


@longer
@pytest.mark.parametrize("counter", [False, True], ids=["constant", "counter"])
@pytest.mark.parametrize("id_count", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("protocol", canser.protocols())
def test_a_quiet_bus_is_never_named_as_another(protocol: str, id_count: int, counter: bool) -> None:
    for dlc in range(9):
        for raw in quiet_buses(protocol, id_count, dlc, counter=counter):
            judge_quiet_bus(protocol, raw)


def judge_quiet_bus(protocol: str, raw: bytes, noise: float = 0) -> None:
    """Fail where the bytes are named as another protocol's, or need not be left unnamed."""
    best = canser.identify(raw)[0]
    if best.fits:
        assert best.protocol == protocol
    elif best.rivals:
        assert protocol in (best.protocol, *best.rivals)
    else:
        # Their order is all that tells such bytes from random ones.
        assert protocol == "cantalope"
        assert noise or holds_in_any_order(raw)


# Where one protocol's frames have one length, a bus that repeats so many bytes, or a multiple, may
# give them at each round.
@longer
@pytest.mark.parametrize("noise", [0, 0.001, 0.01])
@pytest.mark.parametrize("length", [11, 13, 24, 26, 39])
@pytest.mark.parametrize("protocol", canser.protocols())
def test_a_bus_that_repeats_a_few_bytes_is_never_named_as_another(
    protocol: str, length: int, noise: float
) -> None:
    for seed in range(BUSES + 3):
        rng = np.random.default_rng([length, seed])
        one_round = frames_of_length(protocol, length, rng)
        frames = np.tile(one_round, 600 // len(one_round))
        frames["ts"] = rng.integers(1 << 32) * 1_000_000 + np.arange(len(frames)) * 10_000_000
        raw = canser.encode(frames, protocol)
        judge_quiet_bus(protocol, line_noise(raw, rate=noise, seed=seed), noise)


def frames_of_length(protocol: str, length: int, rng: np.random.Generator) -> FrameArray:
    """Return frames of about so many bytes together; most of their payload is zeros."""
    frames = np.zeros(length, FRAME_DTYPE)
    frames["id"] = rng.choice(0x800, length, replace=False)
    frames["dlc"] = rng.integers(0, 9, length)
    frames["data"] = rng.integers(0, 256, (length, 8)) * (rng.random((length, 8)) < 0.2)
    for count in range(1, length):
        more = length - len(canser.encode(frames[:count], protocol))
        if more <= 0:
            # The last frame takes what is missing, or gives what is too much.
            frames["dlc"][count - 1] = max(int(frames["dlc"][count - 1]) + more, 0)
            return frames[:count]
    return frames


def fit(protocol: str, score: float, chance: float, luck: float = 0.0) -> canser.Fit:
    """Return a fit that explains what this score and this chance make of it."""
    explained = chance + score * (1 - chance)
    return canser.Fit(protocol, score, explained, chance, luck, canser.Decoder("serial").stats)


@pytest.mark.parametrize(
    ("given", "best", "rivals"),
    [
        ([fit("a", 1, 0.9)], "a", ()),
        ([fit("a", 0.4, 0.9), fit("b", 0.2, 0.9)], "a", ()),
        # A and B have marks, and so are no accident.
        ([fit("a", 1, 0.9), fit("B", 0.97, 0.04)], "B", ()),
        ([fit("a", 1, 0.9), fit("B", 0.7, 0.04), fit("c", 0.98, 0.03)], "B", ()),
        ([fit("A", 1, 0.04), fit("b", 1, 0.01)], "A", ()),
        ([fit("A", 1, 0.01), fit("b", 0.7, 0.4)], "A", ()),
        ([fit("A", 1, 0.02), fit("B", 0.97, 0.01)], "B", ()),
        # Of these the rarer one comes first where both fit about equally well.
        ([fit("a", 1, 0.9), fit("b", 0.97, 0.4)], "b", ("a",)),
        ([fit("a", 1, 0.9), fit("b", 0.7, 0.03)], "a", ("b",)),
        # All bytes, as shuffled bytes are, too.
        ([fit("a", 0.98, 0.6), fit("b", 1, 0.99, luck=0.4)], "a", ("b",)),
        ([fit("a", 1, 0.6), fit("b", 0, 0.95, luck=1)], "a", ()),
        ([fit("a", 1, 0.6), fit("B", 0.3, 0.01), fit("c", 0.9, 0.9)], "a", ("c",)),
        # Frames of one length in bytes that repeat themselves by it.
        ([fit("r", 1, 0.5), fit("a", 0, 0.9, luck=1), fit("B", 0.1, 0.01)], "r", ("a",)),
        ([fit("r", 1, 0.5), fit("B", 0.1, 0.01)], "r", ()),
        ([fit("r", 1, 0.5), fit("B", 0.6, 0.01)], "B", ()),
        ([fit("a", 1, 0.5), fit("r", 0, 0.4)], "a", ()),
    ],
)
def test_the_best_has_rivals_where_chance_cannot_tell(
    given: list[canser.Fit], best: str, rivals: tuple[str, ...]
) -> None:
    for order in (given, given[::-1]):
        ranked = fits._rank(order, {"A", "B"}, {"r"})
        assert (ranked[0].protocol, ranked[0].rivals) == (best, rivals)
        assert sorted(fit.protocol for fit in ranked) == sorted(fit.protocol for fit in given)
        if rivals:
            assert not any(fit.fits for fit in ranked)


def test_bytes_that_repeat_themselves_by_the_length_of_frames(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(1)
    one = replace(canser.protocol("seeed"), frame_min=13, frame_max=13)
    monkeypatch.setattr(fits, "find_protocol", lambda _: one)

    def repeats(length: int, *counters: int) -> bool:
        rows = np.tile(rng.integers(0, 256, length, np.uint8), (60, 1))
        for at in counters:
            rows[:, at] = np.arange(60)
        return fits._repeats(rows.ravel(), "seeed")

    assert [length for length in range(12, 53) if repeats(length)] == [13, 26, 39]
    assert repeats(13, 4, 12)
    assert not repeats(13, 4, 8, 12)
    assert not fits._repeats(rng.integers(0, 256, 5000, np.uint8), "seeed")
    assert not fits._repeats(np.zeros(13, np.uint8), "seeed")
    monkeypatch.setattr(fits, "find_protocol", canser.protocol)
    assert not repeats(13)


def test_what_bytes_may_be_is_told() -> None:
    several = replace(fit("a", 1, 0.4), rivals=("b", "c"))
    assert (likely(several), describe_fit(several)) == (("a", "b", "c"), "a or b or c")
    one = fit("a", 1, 0.01)
    assert (likely(one), describe_fit(one)) == (("a",), "a (100%)")
    none = fit("a", 0.3, 0.01)
    assert (likely(none), describe_fit(none)) == ((), "no protocol that canser knows")
