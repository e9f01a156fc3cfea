import numpy as np
import pytest

import canser
from canser.live.meter import Meter, bus_bits


def frames(*rows: tuple[bool, bool, int, bool]) -> canser.FrameArray:
    made = np.zeros(len(rows), canser.FRAME_DTYPE)
    for place, row in enumerate(rows):
        made[place]["ext"], made[place]["rtr"], made[place]["dlc"], made[place]["err"] = row
    return made


@pytest.mark.parametrize(
    ("row", "bits"),
    [
        # ext, rtr, dlc, err; bits by adding up the fields of CAN 2.0.
        ((False, False, 0, False), 1 + 11 + 3 + 4 + 15 + 1 + 2 + 7 + 3),
        ((False, False, 8, False), 1 + 11 + 3 + 4 + 64 + 15 + 1 + 2 + 7 + 3),
        ((True, False, 8, False), 1 + 11 + 2 + 18 + 3 + 4 + 64 + 15 + 1 + 2 + 7 + 3),
        ((True, True, 8, False), 1 + 11 + 2 + 18 + 3 + 4 + 15 + 1 + 2 + 7 + 3),
        ((True, False, 8, True), 6 + 8 + 3),
    ],
)
def test_bits_on_the_bus(row: tuple[bool, bool, int, bool], bits: int) -> None:
    assert bus_bits(frames(row)) == bits
    assert bus_bits(frames(row, row, row)) == 3 * bits
    assert bus_bits(frames()) == 0


def test_rates_are_those_of_the_last_second() -> None:
    meter = Meter(11_100, 100.0)
    assert meter.rates() == (0, 0, 0)
    one = frames((False, False, 8, False))  # 111 bits
    for tick in range(1, 51):  # five seconds of ten frames a second
        meter.add(one, 13 * tick, 100 + tick / 10)
    assert meter.rates() == pytest.approx((10, 130, 0.1))
    for tick in range(51, 71):  # then silence
        meter.add(one[:0], 650, 100 + tick / 10)
    assert meter.rates() == pytest.approx((0, 0, 0))
    assert (meter.frames, meter.bits) == (50, 50 * 111)


def test_no_load_without_a_bit_rate() -> None:
    meter = Meter(None, 0.0)
    meter.add(frames((False, False, 8, False)), 13, 0.5)
    assert meter.rates() == (2, 26, None)
