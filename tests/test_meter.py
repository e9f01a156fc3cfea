import numpy as np
import pytest

import canser
from canser.live.meter import Meter


def frames(*rows: tuple[bool, bool, int, bool]) -> canser.FrameArray:
    made = np.zeros(len(rows), canser.FRAME_DTYPE)
    for place, row in enumerate(rows):
        made[place]["ext"], made[place]["rtr"], made[place]["dlc"], made[place]["err"] = row
    return made


def test_rates_are_those_of_the_last_second() -> None:
    one = frames((False, False, 8, False))
    (bits,) = canser.frame_bits(one).tolist()
    meter = Meter(100 * bits, 100.0)
    assert meter.rates() == (0, 0, 0)
    for tick in range(1, 51):  # five seconds of ten frames a second
        meter.add(one, 13 * tick, 100 + tick / 10)
    assert meter.rates() == pytest.approx((10, 130, 0.1))
    for tick in range(51, 71):  # then silence
        meter.add(one[:0], 650, 100 + tick / 10)
    assert meter.rates() == pytest.approx((0, 0, 0))
    assert (meter.frames, meter.bits) == (50, 50 * bits)


def test_no_load_without_a_bit_rate() -> None:
    meter = Meter(None, 0.0)
    meter.add(frames((False, False, 8, False)), 13, 0.5)
    assert meter.rates() == (2, 26, None)
