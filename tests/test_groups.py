"""Frames by their ids, and the frames that change, against the same in plain Python."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from reference import Frame
from samples import FRAMES, array, listed
from shared import expected, needs_captures
from test_ids import FEW_IDS


def name_of(frame: Frame) -> str:
    if frame.err:
        return f"{frame.id | 0x2000_0000:08X}"
    return f"{frame.id:08X}" if frame.ext else f"{frame.id:03X}"


def order_of(frame: Frame) -> tuple[int, int]:
    return 2 if frame.err else frame.ext, frame.id


@given(st.one_of(FEW_IDS, FRAMES))
def test_groups_have_the_frames_of_each_id(frames: list[Frame]) -> None:
    groups = canser.by_id(array(*frames))
    names = dict.fromkeys(map(name_of, sorted(frames, key=order_of)))
    assert list(groups) == list(names)
    for name, own in groups.items():
        kept = [frame for frame in frames if name_of(frame) == name]
        assert sorted(map(repr, listed(own))) == sorted(map(repr, kept))
        # Of error frames, standard ids stand before extended ones.
        assert listed(own) == sorted(kept, key=lambda frame: frame.ext)
    starts = groups.offsets.tolist()
    assert len(starts) == len(groups) + 1
    for start, end, name in zip(starts, starts[1:], groups, strict=False):
        assert {name_of(frames[i]) for i in groups.order[start:end].tolist()} == {name}
    assert sorted(groups.order.tolist()) == list(range(len(frames)))


def test_a_group_that_is_not_there_is_a_key_error() -> None:
    groups = canser.by_id(canser.frames("123#01"))
    assert "123" in groups
    assert "124" not in groups
    with pytest.raises(KeyError, match="three hexadecimal digits"):
        groups["00000123"]
    with pytest.raises(KeyError, match="is no id of these frames"):
        groups[0x123]  # type: ignore[index]


@given(st.one_of(FEW_IDS, FRAMES), st.booleans())
def test_changes_are_those_of_plain_python(frames: list[Frame], told: bool) -> None:
    channels = np.arange(len(frames), dtype=np.uint8) % 2 if told else None
    last = dict[tuple[int, bool, bool, bool, int], tuple[int, bytes]]()
    changed = []
    for i, frame in enumerate(frames):
        key = frame.id, frame.ext, frame.rtr, frame.err, i % 2 if told else 0
        if last.get(key) != (frame.dlc, frame.data):
            changed.append(frame)
        last[key] = frame.dlc, frame.data
    assert listed(canser.changes(array(*frames), channels=channels)) == changed


def test_many_ids_are_found() -> None:
    frames = np.zeros(50_000, canser.FRAME_DTYPE)
    frames["id"], frames["ext"] = np.random.default_rng(1).permutation(len(frames)), True
    assert len(canser.changes(frames)) == len(canser.by_id(frames)) == len(frames)


def test_frames_that_are_not_contiguous_are_taken() -> None:
    frames = canser.frames("123#01", "124#01", "123#02", "124#01", "123#02")
    assert len(canser.changes(frames[::2])) == 2
    assert len(canser.by_id(frames[::2])["123"]) == 3


def test_no_frames_have_no_groups_and_no_changes() -> None:
    none = array()
    assert (len(canser.by_id(none)), len(canser.changes(none))) == (0, 0)
    assert canser.by_id(none).offsets.tolist() == [0]


def test_what_is_no_array_of_frames_is_refused() -> None:
    for call in (canser.changes, canser.by_id):
        with pytest.raises(TypeError, match=r"frames must be an array of canser\.FRAME_DTYPE"):
            call(np.zeros(3))  # type: ignore[arg-type]


@needs_captures
def test_the_changes_of_the_car_are_those_that_numpy_finds() -> None:
    frames = expected("car")
    order = np.argsort(frames["id"], kind="stable")
    data = frames["data"].copy().view(np.uint64)[order, 0]
    changed = np.ones(len(frames), bool)
    changed[1:] = (np.diff(frames["id"][order].astype(int)) != 0) | (data[1:] != data[:-1])
    marks = np.zeros(len(frames), bool)
    marks[order[changed]] = True
    assert np.array_equal(canser.changes(frames), frames[marks])
