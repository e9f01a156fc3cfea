"""What a line has sent for sure, whatever it does: slow, stuck, dead, gone in the middle."""

from typing import Any, cast

import numpy as np
import pytest

import canser
import canser.commands._sending
from canser._frames import FrameArray
from canser.commands._parser import DataError
from canser.commands._sending import Sender
from canser.errors import PortGoneError, SendError, SendTimeoutError
from canser.simulation.traffic import vehicle

FRAMES = vehicle(0.2)
LENGTHS = np.array([len(canser.encode(FRAMES[i : i + 1], "seeed")) for i in range(len(FRAMES))])


class Line:
    """A port whose system holds `room` bytes and sends `rate` bytes in each look at it.

    It is gone after `life` calls.
    """

    url, protocol = "/dev/line", "seeed"

    def __init__(self, room: int, rate: int, life: int = 10**9) -> None:
        self.room, self.rate, self.life = room, rate, life
        self.now = 100.0
        self.taken = self.sent = 0  # bytes

    def monotonic(self) -> float:
        return self.now

    def _pass(self, seconds: float) -> None:
        self.now += seconds
        self.life -= 1
        self.sent = min(self.sent + self.rate, self.taken)

    def send(self, frames: FrameArray, *, timeout: float, pace: bool) -> int:
        assert pace
        if self.life <= 0:
            raise SendError("dead", 0, "the device is gone")
        self._pass(0)
        ends = np.cumsum(
            [len(canser.encode(frames[i : i + 1], "seeed")) for i in range(len(frames))]
        )
        count = int(np.searchsorted(ends, self.room - (self.taken - self.sent), side="right"))
        self.taken += int(ends[count - 1]) if count else 0
        if count < len(frames):
            self._pass(timeout)
            raise SendTimeoutError("slow", count, "the line took no more")
        return count

    def drain(self, *, timeout: float) -> bool:
        if self.bytes_unsent:
            self._pass(timeout)
        return not self.bytes_unsent

    @property
    def bytes_unsent(self) -> int:
        if self.life <= 0:
            raise PortGoneError("/dev/line is gone")
        return self.taken - self.sent


def sender_to(line: Line, monkeypatch: pytest.MonkeyPatch, **options: Any) -> Sender:
    monkeypatch.setattr(canser.commands._sending, "time", line)
    return Sender(cast(canser.Port, line), **options)


def counts(error: pytest.ExceptionInfo[DataError]) -> tuple[int, int]:
    """Return the frames that were sent for sure, and those that the line only took."""
    before, _, after = str(error.value).rpartition(", taken by the line but not known to be sent: ")
    return int(before.split("sure: ")[1].replace(",", "")), int(after.replace(",", ""))


def test_a_line_that_takes_all(monkeypatch: pytest.MonkeyPatch) -> None:
    line = Line(room=10**9, rate=10**9)
    sender = sender_to(line, monkeypatch)
    sender.send(FRAMES)
    sender.drain()
    assert sender.sent == len(FRAMES)


def test_a_slow_line_is_waited_for_as_long_as_it_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame every second or so, in all longer than the patience."""
    line = Line(room=50, rate=1)
    sender = sender_to(line, monkeypatch)
    sender.send(FRAMES[:40])
    sender.drain()
    assert line.now > 100 + 2 * canser.commands._sending._PATIENCE_S
    assert sender.sent == 40


@pytest.mark.parametrize("waiting", [0, 1, 100, 101, 3000])
def test_a_line_that_is_stuck_tells_what_it_has_sent(
    monkeypatch: pytest.MonkeyPatch, waiting: int
) -> None:
    line = Line(room=4096, rate=0)
    line.sent = -waiting  # other bytes wait before the frames, such as a configuration
    sender = sender_to(line, monkeypatch)
    with pytest.raises(DataError, match=r"^/dev/line took nothing for 10 s; ") as error:
        sender.send(FRAMES)
    sure, maybe = counts(error)
    assert sure + maybe == np.searchsorted(np.cumsum(LENGTHS), 4096 - waiting, side="right")


def test_a_line_that_does_not_send_what_it_took(monkeypatch: pytest.MonkeyPatch) -> None:
    line = Line(room=10**6, rate=0)
    sender = sender_to(line, monkeypatch)
    for begin in range(0, len(FRAMES), 100):
        sender.send(FRAMES[begin : begin + 100])
    for sent in (0, int(LENGTHS[0]), int(LENGTHS[:150].sum()) - 1, int(LENGTHS[:300].sum())):
        line.sent = sent
        with pytest.raises(DataError, match=r"^/dev/line sent nothing for 10 s; ") as error:
            sender.drain()
        sure, maybe = counts(error)
        assert sure == np.searchsorted(np.cumsum(LENGTHS), sent, side="right")
        assert sure + maybe == len(FRAMES)
    line.rate = 10**6
    sender.drain()
    assert sender.sent == len(FRAMES)


@pytest.mark.parametrize("life", [1, 2, 3, 10])
def test_of_a_line_that_goes_away_counts_what_was_known_before(
    monkeypatch: pytest.MonkeyPatch, life: int
) -> None:
    line = Line(room=1000, rate=100, life=life)
    sender = sender_to(line, monkeypatch)
    with pytest.raises(DataError, match=r"^/dev/line: the device is gone; ") as error:
        sender.send(FRAMES)
    sure, maybe = counts(error)
    assert LENGTHS[:sure].sum() <= line.sent
    assert LENGTHS[: sure + maybe].sum() == line.taken


def test_gone_while_it_drains(monkeypatch: pytest.MonkeyPatch) -> None:
    line = Line(room=10**6, rate=100, life=5)
    sender = sender_to(line, monkeypatch)
    sender.send(FRAMES)
    with pytest.raises(DataError, match=r"^/dev/line is gone; ") as error:
        sender.drain()
    sure, maybe = counts(error)
    assert LENGTHS[:sure].sum() <= line.sent
    assert sure + maybe == len(FRAMES)


def test_a_wish_to_end_is_heeded_while_the_line_takes_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    line = Line(room=1000, rate=0)
    sender = sender_to(line, monkeypatch, wanted=lambda: line.now < 101)
    sender.send(FRAMES)
    assert 101 <= line.now < 102
