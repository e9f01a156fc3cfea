"""Frames by their times: those between two times, and arrays merged by time."""

import datetime as dt
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from reference import NO_TIME, Frame
from samples import EPOCH, FRAMES, SECOND, array, listed, timed


@given(FRAMES, st.none() | st.integers(-(10**9), 10**9), st.none() | st.integers(-(10**9), 10**9))
def test_frames_between_two_times(frames: list[Frame], start: int | None, end: int | None) -> None:
    kept = [
        frame
        for frame in frames
        if frame.ts != NO_TIME
        and (start is None or frame.ts >= start)
        and (end is None or frame.ts < end)
    ]
    assert listed(canser.between(array(*frames), start, end)) == kept


AT = dt.datetime(2018, 12, 6, 14, 31, 20, tzinfo=dt.UTC)


@pytest.mark.parametrize(
    "time",
    [
        int(AT.timestamp()) * SECOND,
        np.int64(int(AT.timestamp()) * SECOND),
        AT,
        AT.astimezone(dt.timezone(dt.timedelta(hours=5))),
        AT.astimezone().replace(tzinfo=None),
        np.datetime64("2018-12-06T14:31:20"),
        np.datetime64("2018-12-06T14:31:20.000000", "us"),
    ],
)
def test_a_time_is_given_in_many_ways(time: Any) -> None:
    frames = timed(EPOCH, EPOCH + SECOND, EPOCH + 2 * SECOND)
    assert EPOCH < int(AT.timestamp()) * SECOND < EPOCH + SECOND
    assert len(canser.between(frames, time)) == 2
    assert len(canser.between(frames, None, time)) == 1


@pytest.mark.parametrize("time", [np.timedelta64(1, "s"), dt.timedelta(seconds=1), SECOND])
def test_a_difference_is_a_time_of_a_capture_without_dates(time: Any) -> None:
    assert len(canser.between(timed(0, SECOND - 1, SECOND), time)) == 1


@pytest.mark.parametrize(
    ("time", "error"),
    [(1.5, TypeError), ("1s", TypeError), (True, TypeError), (np.datetime64("NaT"), ValueError)],
)
def test_what_is_no_time_is_refused(time: Any, error: type[Exception]) -> None:
    with pytest.raises(error, match="start"):
        canser.between(timed(0), time)
    with pytest.raises(error, match="end"):
        canser.between(timed(0), None, time)


@pytest.mark.parametrize(
    "time", [np.datetime64("3000-01-01"), np.datetime64("1500"), np.timedelta64(10**15, "h")]
)
def test_a_time_of_numpy_beyond_64_bits_is_refused(time: Any) -> None:
    with pytest.raises(ValueError, match=r"start is .*, which is not within 292 years of 1970"):
        canser.between(timed(0), time)


def test_a_time_of_numpy_in_fine_units_is_cut_to_nanoseconds() -> None:
    assert len(canser.between(timed(0, 1, 2), np.timedelta64(1_500, "ps"))) == 2


def test_times_of_pandas_have_nanoseconds_and_are_utc() -> None:
    pd = pytest.importorskip("pandas")
    frames = timed(EPOCH, EPOCH + 300, EPOCH + 500)
    for zone in (None, "UTC", "Asia/Tokyo"):
        time = pd.Timestamp(EPOCH + 500, tz="UTC").tz_convert(zone)
        assert listed(canser.between(frames, time)) == listed(frames[2:])
        assert listed(canser.between(frames, None, time)) == listed(frames[:2])
    assert len(canser.between(timed(0, 300, 500), pd.Timedelta(500, "ns"))) == 1
    with pytest.raises(ValueError, match="start is NaT, which is no time"):
        canser.between(frames, pd.NaT)
    with pytest.raises(ValueError, match="start is a date"):
        canser.between(timed(0), pd.Timestamp(EPOCH))


@given(st.lists(FRAMES, max_size=3))
def test_arrays_are_merged_by_time(parts: list[list[Frame]]) -> None:
    kept = [[frame for frame in part if NO_TIME < frame.ts < 10**17] for part in parts]
    arrays = [array(*part) for part in kept]
    whole = [frame for part in kept for frame in part]
    assert listed(canser.merge(*arrays)) == sorted(whole, key=lambda frame: frame.ts)


def test_nothing_merged_is_nothing() -> None:
    assert len(canser.merge()) == len(canser.merge(array(), array())) == 0
    assert listed(canser.merge(array(), timed(1))) == listed(timed(1))


def test_a_date_is_for_dates_and_a_difference_for_others() -> None:
    with pytest.raises(ValueError, match="start is a date, and the times of the frames count"):
        canser.between(timed(0), AT)
    with pytest.raises(ValueError, match="end is a difference, and the times of the frames are"):
        canser.between(timed(EPOCH), None, dt.timedelta(seconds=1))
    assert len(canser.between(timed(NO_TIME), AT)) == 0


def test_arrays_that_cannot_be_merged_are_refused() -> None:
    with pytest.raises(ValueError, match=r"1 frames of arrays\[1\] have no time"):
        canser.merge(timed(0), timed(1, NO_TIME))
    with pytest.raises(ValueError, match="some arrays are dates"):
        canser.merge(timed(0), timed(EPOCH))


@pytest.mark.parametrize("call", [canser.between, canser.merge])
def test_what_is_no_array_of_frames_is_refused(call: Callable[[Any], Any]) -> None:
    with pytest.raises(TypeError, match=r"must be an array of canser\.FRAME_DTYPE"):
        call(np.zeros(3))
