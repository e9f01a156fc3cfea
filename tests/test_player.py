"""Frames at their times, by a clock that the tests make."""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
import canser.live.player
import shared  # noqa: F401 - Hypothesis' settings
from canser._frames import FrameArray
from canser.live.player import Lateness, Played, play

MS = 1_000_000


class Clock:
    """A clock that runs while somebody sleeps or sends, and else stands still."""

    def __init__(self) -> None:
        self.now = 7_000_000_000
        self.sleeps: list[float] = []

    def monotonic_ns(self) -> int:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds >= 0
        self.sleeps.append(seconds)
        # Wakes late, as systems do.
        self.now += int(seconds * 1e9) + 50_000


class Line:
    """What was sent, and when."""

    def __init__(self, clock: Clock, cost: int = 0) -> None:
        self._clock, self._begin, self._cost = clock, clock.now, cost
        self.ids: list[int] = []
        self.due: list[int] = []
        self.times: list[int] = []

    def send(self, frames: FrameArray) -> None:
        assert len(frames)
        self.ids += frames["id"].tolist()
        self.due += frames["ts"].tolist()
        self.times += [self._clock.now - self._begin] * len(frames)
        self._clock.now += self._cost


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(canser.live.player, "time", made)
    return made


def frames(*ms: float | None) -> FrameArray:
    made = np.zeros(len(ms), canser.FRAME_DTYPE)
    made["id"] = np.arange(len(ms))
    made["ts"] = [canser.NO_TIME if one is None else round(one * MS) for one in ms]
    return made


def due_ms(line: Line) -> list[float]:
    return [due / MS for due in line.due]


def test_frames_go_when_they_are_due(clock: Clock) -> None:
    line = Line(clock)
    played = play([[frames(1000, 1010, 1500), frames(1500, 1700)]], line.send)
    assert line.ids == [0, 1, 2, 0, 1]
    assert due_ms(line) == [0, 10, 500, 500, 700]
    for due, sent in zip(line.due, line.times, strict=True):
        assert -MS <= sent - due <= 50_000
    assert (played.frames, played.rounds, played.untimed, played.jumps) == (5, 1, 0, 0)
    assert played.lateness.most <= MS
    assert max(clock.sleeps) <= 0.1  # a wish to end is heeded


def test_what_is_due_soon_goes_together(clock: Clock) -> None:
    sizes = []
    begin = clock.now
    play([[frames(*np.arange(0, 10, 0.1))]], lambda batch: sizes.append(len(batch)))
    assert clock.now - begin >= 8 * MS
    assert sum(sizes) == 100
    assert len(sizes) <= 11


def test_one_late_frame_makes_none_behind_it_late(clock: Clock) -> None:
    line = Line(clock)
    slow = iter([300 * MS])

    def send(batch: FrameArray) -> None:
        line.send(batch)
        clock.now += next(slow, 0)

    played = play([[frames(*range(0, 1000, 100))]], send)
    late = [sent - due for due, sent in zip(line.due, line.times, strict=True)]
    assert [round(ms / MS) for ms in late] == [0, 200, 100, 0, 0, 0, 0, 0, 0, 0]
    assert played.lateness.most == 200 * MS
    assert played.lateness.mean == pytest.approx(30 * MS, abs=MS)


@pytest.mark.parametrize(("speed", "due"), [(2.0, [0, 50, 500]), (0.5, [0, 200, 2000])])
def test_speed(clock: Clock, speed: float, due: list[float]) -> None:
    line = Line(clock)
    play([[frames(0, 100, 1000)]], line.send, speed=speed)
    assert due_ms(line) == due


def test_a_gap_instead_of_times(clock: Clock) -> None:
    line = Line(clock)
    rounds = [[frames(0, None, 1000), frames(7)], [frames(3)]]
    played = play(rounds, line.send, gap_ns=10 * MS)
    assert due_ms(line) == [0, 10, 20, 30, 40]
    assert played.untimed == 0


def test_without_times_and_gap_nothing_is_waited_for(clock: Clock) -> None:
    line = Line(clock)
    played = play([[frames(*[None] * 1000)]], line.send)
    assert played.untimed == played.frames == 1000
    assert clock.sleeps == []


def test_frames_without_a_time_go_with_those_before_them(clock: Clock) -> None:
    line = Line(clock)
    played = play([[frames(None, 100, None, 150, None), frames(None, 160)]], line.send)
    assert due_ms(line) == [0, 0, 0, 50, 50, 50, 60]
    assert played.untimed == 4


def test_out_of_order_and_jumps(clock: Clock) -> None:
    line = Line(clock)
    # A bit out of order; a device that starts anew; a false time an hour ahead, and back.
    played = play(
        [[frames(5000, 5010, 5005, 5020, 3, 13, 4e6, 23)]],
        line.send,
    )
    assert due_ms(line) == [0, 10, 10, 20, 20, 30, 30, 30]
    assert played.jumps == 3


def test_rounds_follow_one_another(clock: Clock) -> None:
    line = Line(clock)
    played = play([[frames(100, 110)], [frames(100, 110)], []], line.send)
    assert due_ms(line) == [0, 10, 10, 20]
    assert played.rounds == 2


def test_a_round_without_a_frame_is_the_last(clock: Clock) -> None:
    def endless() -> Iterator[list[FrameArray]]:
        while True:
            yield [frames()]

    assert play(endless(), Line(clock).send).rounds == 0


def test_a_wish_to_end_is_heeded_while_waiting(clock: Clock) -> None:
    line = Line(clock)
    end = clock.now + 5_000 * MS
    played = play([[frames(0, 3e6)]], line.send, wanted=lambda: clock.now < end)
    assert (line.ids, played.rounds) == ([0], 0)
    assert clock.now - end <= 101 * MS


@given(
    st.lists(st.none() | st.integers(-(2**63) + 1, 2**63 - 1), min_size=1, max_size=30),
    st.integers(1, 7),
)
def test_due_times_never_go_back_and_blocks_do_not_matter(
    times: list[int | None], block: int
) -> None:
    whole = np.zeros(len(times), canser.FRAME_DTYPE)
    whole["ts"] = [canser.NO_TIME if one is None else one for one in times]

    def schedule(size: int) -> list[int]:
        plan = canser.live.player._Schedule(speed=1.0, gap_ns=None)
        due: list[int] = []
        for begin in range(0, len(whole), size):
            due += plan.due(whole["ts"][begin : begin + size], Played()).tolist()
        return due

    due = schedule(len(whole))
    assert due == sorted(due)
    assert due[0] == 0
    assert schedule(block) == due


def test_lateness() -> None:
    late = Lateness()
    assert (late.mean, late.most, late.share(0.99)) == (0, 0, 0)
    late.add(np.array([*range(0, 100_000_000, 1_000_000)]))  # 0 to 99 ms
    late.add(-np.array([5_000_000_000]))
    assert late.most == 5_000_000_000
    assert late.mean == pytest.approx((99 * 50 * MS + 5_000 * MS) / 101)
    assert late.share(0.5) == pytest.approx(50 * MS, abs=MS)
    assert late.share(0.99) == pytest.approx(99 * MS, abs=MS)
    assert late.share(1) == 5_000_000_000


@pytest.mark.parametrize("wrong", [{"speed": 0}, {"speed": -1}, {"gap_ns": -1}], ids=str)
def test_values_that_make_no_sense(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=r"it must be"):
        play([], print, **wrong)  # type: ignore[arg-type]
