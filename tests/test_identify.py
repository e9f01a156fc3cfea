"""Which protocol fits: the right one, and none where there is none."""

from collections.abc import Iterator

import numpy as np
import pytest

import canser
from canser._frames import FRAME_DTYPE
from canser.simulation.traffic import line_noise, vehicle
from long import LONG
from reference import WIRE_FORMATS


@pytest.mark.parametrize("protocol", canser.protocols())
@pytest.mark.parametrize("rate", [0, 0.001, 0.01])
def test_the_right_protocol_is_first_and_fits(protocol: str, rate: float) -> None:
    frames = vehicle(5, extended=WIRE_FORMATS[protocol].has_ext)
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


@pytest.mark.parametrize("counter", [False, True], ids=["constant", "counter"])
@pytest.mark.parametrize("id_count", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("protocol", canser.protocols())
def test_a_quiet_bus_is_never_named_as_another(protocol: str, id_count: int, counter: bool) -> None:
    for dlc in range(9):
        for raw in quiet_buses(protocol, id_count, dlc, counter=counter):
            best = canser.identify(raw)[0]
            if best.fits:
                assert best.protocol == protocol
            else:
                # Their order is all that tells such bytes from random ones.
                assert protocol == "cantalope"
                assert holds_in_any_order(raw)
