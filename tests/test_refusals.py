"""What a protocol cannot carry is what `encode` refuses, frame by frame."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
import conftest  # noqa: F401 - Hypothesis' settings
from canser._frames import FrameArray
from canser.codec.refusals import Refusals, carries
from reference import NO_TIME, Frame
from samples import FRAMES, array, listed

PROTOCOLS = canser.protocols()

GOOD = Frame(0x100, ts=0)
ERROR = Frame(0x20, err=True, ts=0)
EXTENDED = Frame(0x800, ext=True, ts=0)
UNTIMED = Frame(0x100, ts=NO_TIME)
TOO_LONG = Frame(0x100, dlc=9, ts=0)
TOO_HIGH = Frame(0x800, ts=0)
TOO_HIGH_EXT = Frame(0x2000_0000, ext=True, ts=0)


def can_be_encoded(frame: FrameArray, protocol: str) -> bool:
    try:
        canser.encode(frame, protocol)
    except ValueError:
        return False
    return True


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_which_kinds_a_protocol_carries(protocol: str) -> None:
    for ext, err in ((False, False), (True, False), (False, True), (True, True)):
        frame = array(Frame(0x100, ext, err=err, ts=0))
        assert carries(protocol, ext=ext, err=err) == can_be_encoded(frame, protocol)


@given(FRAMES, st.sampled_from(PROTOCOLS), st.data())
def test_they_are_the_frames_that_encode_refuses(
    drawn: list[Frame], protocol: str, data: st.DataObject
) -> None:
    frames = array(*drawn).copy()
    for place in data.draw(st.sets(st.sampled_from(range(len(frames))))) if len(frames) else ():
        frames["dlc"][place] = data.draw(st.integers(0, 255))
        frames["id"][place] = data.draw(st.integers(0, 2**32 - 1))
    refusals = Refusals(protocol)
    kept = refusals.keep(frames)
    good = [can_be_encoded(frames[i : i + 1], protocol) for i in range(len(frames))]
    assert kept.tobytes() == frames[np.array(good, np.bool_)].tobytes()
    assert refusals.frames == len(frames)
    assert refusals.left_out == len(frames) - len(kept)
    canser.encode(kept, protocol)


@pytest.mark.parametrize(
    ("protocol", "frames", "text"),
    [
        ("seeed", [ERROR, EXTENDED], "1 frame left out: error frames 1"),
        ("cantalope", [ERROR, EXTENDED, ERROR], "3 frames left out: error frames 2, "
         "extended ids 1"),
        ("serial", [ERROR, UNTIMED], "1 frame left out: unknown times 1"),
        ("seeed", [TOO_LONG, TOO_HIGH], "2 frames left out: dlcs over 8 1, "
         "standard ids over 0x7FF 1"),
        ("serial", [TOO_HIGH_EXT], "1 frame left out: ids over 0x1FFFFFFF 1"),
    ],
)  # fmt: skip
def test_the_reasons_are_counted(protocol: str, frames: list[Frame], text: str) -> None:
    refusals = Refusals(protocol)
    refusals.keep(array(GOOD, *frames, GOOD))
    assert str(refusals) == text


def test_counts_add_up_over_arrays() -> None:
    refusals = Refusals("cantalope")
    for frames in ([EXTENDED], [GOOD], [], [ERROR] * 1000):
        refusals.keep(array(*frames))
    assert (refusals.frames, refusals.left_out) == (1002, 1001)
    assert refusals.reasons == "error frames 1,000, extended ids 1"


def test_where_times_are_given_an_unknown_one_is_no_reason() -> None:
    refusals = Refusals("serial", times_given=True)
    assert listed(refusals.keep(array(UNTIMED, GOOD))) == [UNTIMED, GOOD]
    assert refusals.left_out == 0


def test_nothing_is_copied_where_nothing_is_left_out() -> None:
    frames = array(GOOD, EXTENDED)
    assert Refusals("seeed").keep(frames) is frames
