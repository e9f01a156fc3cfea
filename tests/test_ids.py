"""Frames by id, against the same in plain Python."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canser._frames import FrameArray
from canser.analysis.ids import ID_DTYPE, IdStatistics, find_runs
from canser.timing.restarts import Clock
from reference import NO_TIME, Frame
from samples import FRAMES, MILLISECOND, array

Key = tuple[bool, bool, int, bool]

# A few ids, so that they have several frames: in order or nearly so, now and then a restart.
FEW_IDS = st.lists(
    st.builds(
        Frame,
        st.sampled_from((0, 1, 0x7FF)),
        ext=st.booleans(),
        rtr=st.booleans(),
        err=st.booleans(),
        dlc=st.integers(0, 8),
        ts=st.one_of(
            st.integers(0, 50).map(lambda ms: ms * MILLISECOND),
            st.integers(10_000, 10_050).map(lambda ms: ms * MILLISECOND),
            st.just(NO_TIME),
        ),
    ),
    max_size=60,
)


def key_of(frame: Frame, remote_apart: bool) -> Key:
    return frame.err, frame.ext, frame.id, frame.rtr and remote_apart


def plain_rows(frames: list[Frame], remote_apart: bool) -> list[Any]:
    """Return what the rows should be."""
    rows = []
    for key in sorted({key_of(frame, remote_apart) for frame in frames}):
        own = [frame for frame in frames if key_of(frame, remote_apart) == key]
        times = [frame.ts for frame in own if frame.ts != NO_TIME] or [NO_TIME]
        dlcs = [frame.dlc for frame in own]
        err, ext, number, rtr = key
        remote = sum(frame.rtr for frame in own)
        counts = min(dlcs), max(dlcs), len(own), remote
        rows.append((number, ext, rtr, err, *counts, times[0], times[-1]))
    return rows


def plain_steps(frames: list[Frame], remote_apart: bool) -> dict[Key, list[int]]:
    """Return the steps of each row that has some."""
    clock, times = Clock(), dict[Key, list[tuple[int, int]]]()
    for frame in frames:
        if frame.ts != NO_TIME:
            (stretch,) = clock.add(np.array([frame.ts])).tolist()
            times.setdefault(key_of(frame, remote_apart), []).append((frame.ts, stretch))
    steps = {
        key: [b - a for (a, one), (b, other) in pairwise(own) if one == other and b > a]
        for key, own in times.items()
    }
    return {key: own for key, own in steps.items() if own}


@pytest.mark.parametrize("remote_apart", [False, True])
@given(st.one_of(FEW_IDS, FRAMES), st.lists(st.integers(0, 60)))
def test_it_says_what_plain_python_says(
    remote_apart: bool, frames: list[Frame], cuts: list[int]
) -> None:
    statistics = IdStatistics(remote_apart=remote_apart)
    keys, steps = dict[int, Key](), dict[Key, list[int]]()
    for batch in np.split(array(*frames), sorted(min(cut, len(frames)) for cut in cuts)):
        added = statistics.add(batch)
        for place, first, new in zip(added.places, added.starts, added.new, strict=True):
            row = added.frames[first]
            key = bool(row["err"]), bool(row["ext"]), int(row["id"]), bool(row["rtr"])
            assert (int(place) not in keys) == new
            keys[int(place)] = (*key[:3], key[3] and remote_apart)
        rows = np.repeat(added.places, added.step_counts)
        for place, step in zip(rows.tolist(), added.steps.tolist(), strict=True):
            steps.setdefault(keys[place], []).append(step)
    found = statistics.rows()
    assert found.dtype == ID_DTYPE
    assert found.tolist() == plain_rows(frames, remote_apart)
    assert [keys[place] for place in statistics.places.tolist()] == sorted(keys.values())
    assert statistics.counts.tolist() == found["count"].tolist()
    assert steps == plain_steps(frames, remote_apart)


def test_a_batch_is_sorted_by_row_and_each_row_by_arrival() -> None:
    frames = array(*(Frame(number, ts=ts) for ts, number in enumerate((5, 3, 5, 3, 4))))
    batch = IdStatistics(remote_apart=False).add(frames)
    assert batch.frames["id"].tolist() == [3, 3, 4, 5, 5]
    assert batch.frames["ts"].tolist() == [1, 3, 4, 0, 2]
    assert (batch.starts.tolist(), batch.counts.tolist()) == ([0, 2, 3], [2, 1, 2])
    assert (batch.steps.tolist(), batch.step_counts.tolist()) == ([2, 2], [1, 0, 1])


@pytest.mark.parametrize("ext", [False, True])
def test_many_ids_are_in_order(ext: bool) -> None:
    """Their keys are sorted in two parts of 16 bits."""
    rng = np.random.default_rng(1)
    frames = np.zeros(50_000, array().dtype)
    frames["id"] = rng.integers(0, 1 << (29 if ext else 11), len(frames))
    frames["ext"], frames["ts"] = ext, np.arange(len(frames))
    statistics = IdStatistics(remote_apart=False)
    batch = statistics.add(frames)
    order = np.lexsort((frames["ts"], frames["id"]))
    assert batch.frames["ts"].tolist() == order.tolist()
    assert statistics.rows()["id"].tolist() == np.unique(frames["id"]).tolist()


def test_frames_beyond_the_most_rows_are_counted_only() -> None:
    def sent(*numbers: int) -> FrameArray:
        return array(*(Frame(number, ts=0) for number in numbers))

    statistics = IdStatistics(remote_apart=False, rows_most=2)
    assert statistics.add(sent(9, 5, 9, 7)).frames["id"].tolist() == [5, 7]
    assert statistics.add(sent(1, 9)).frames["id"].tolist() == []
    assert statistics.add(sent(7, 1, 5)).places.tolist() == [0, 1]
    assert (len(statistics), statistics.frames, statistics.others) == (2, 9, 5)
    assert statistics.rows()["count"].tolist() == [2, 2]


def test_runs() -> None:
    starts, counts = find_runs(np.array([3, 3, 1, 3]))
    assert (starts.tolist(), counts.tolist()) == ([0, 2, 3], [2, 1, 1])
    assert [len(part) for part in find_runs(np.array([], np.int64))] == [0, 0]
