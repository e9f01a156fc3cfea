"""Send recorded frames at the times at which they were recorded."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from canser._frames import NO_TIME, FrameArray, copy_records

__all__ = ["Lateness", "Played", "play"]

_Times = npt.NDArray[np.int64]

_MS_NS: Final = 1_000_000

# Frames that are due within this time go out with those that are due now. A write for each frame
# would cost more than the exact time is worth: the way to the bus adds delays of this size.
_AHEAD_NS: Final = 1 * _MS_NS

# The most frames of one write. The clock is read again before the next write.
_BATCH_FRAMES: Final = 256

# The longest sleep, and so the interval at which `wanted` is called.
_LOOK_EVERY_S: Final = 0.1

# Larger steps of the recorded time are jumps, and are passed over. A jump back: the device has
# started anew, or the next of several recordings begins. A jump forward: a false time by noise.
# Smaller steps back are frames out of order.
_BACK_NS: Final = 1_000 * _MS_NS
_FORWARD_NS: Final = 3_600_000 * _MS_NS

# A histogram: bins of 10 microseconds up to one second, and a last one for all beyond.
_BIN_NS: Final = 10_000
_BINS: Final = 100_001


@dataclass(slots=True)
class Lateness:
    """By how much frames were sent too late or too early, in nanoseconds."""

    #: Frames that were counted.
    count: int = 0
    #: The sum of all errors.
    total: int = 0
    #: The largest error.
    most: int = 0
    _bins: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(_BINS, np.int64))

    def add(self, errors: _Times) -> None:
        """Count frames by their errors: when each went out, minus when it was due."""
        sizes = np.abs(errors)
        self.count += len(sizes)
        self.total += int(sizes.sum())
        self.most = max(self.most, int(sizes.max(initial=0)))
        self._bins += np.bincount(np.minimum(sizes // _BIN_NS, _BINS - 1), minlength=_BINS)

    @property
    def mean(self) -> float:
        """The mean error; 0 without a frame."""
        return self.total / self.count if self.count else 0.0

    def share(self, share: float) -> int:
        """Return the error below which this share of the frames is, to 10 microseconds."""
        if not self.count:
            return 0
        place = int(np.searchsorted(np.cumsum(self._bins), share * self.count))
        return min((place + 1) * _BIN_NS, self.most) if place < _BINS - 1 else self.most


@dataclass(slots=True)
class Played:
    """What was sent, and how well its times were kept."""

    #: Frames that were sent.
    frames: int = 0
    #: Rounds that were sent to the end.
    rounds: int = 0
    #: Frames without a time, which were sent together with the frame before.
    untimed: int = 0
    #: Jumps of the recorded time, which were passed over without a pause.
    jumps: int = 0
    #: By how much the frames were late or early.
    lateness: Lateness = field(default_factory=Lateness)


class _Schedule:
    """When frames are due, in nanoseconds from the start of playing."""

    def __init__(self, *, speed: float, gap_ns: int | None) -> None:
        self._speed, self._gap_ns = speed, gap_ns
        # Of the frame before.
        self._before: int | None = None  # its recorded time; None: it was in another round
        self._elapsed = 0  # recorded time from the first frame to it, without jumps
        self._last = 0 if gap_ns is None else -gap_ns  # when it is due

    def start_round(self) -> None:
        """Start a round: the next frame is due with the last one, at any recorded time."""
        self._before = None

    def due(self, ts: _Times, played: Played) -> _Times:
        """Return when the next frames are due; `ts`: their recorded times, one or more."""
        if self._gap_ns is None:
            due = self._by_times(ts, played)
        else:
            due = self._last + np.arange(1, len(ts) + 1, dtype=np.int64) * self._gap_ns
        self._last = int(due[-1])
        return due

    def _by_times(self, ts: _Times, played: Played) -> _Times:
        known = ts != NO_TIME
        due = np.full(len(ts), self._last, np.int64)
        times = ts[known]
        played.untimed += len(ts) - len(times)
        if len(times):
            before = int(times[0]) if self._before is None else self._before
            steps = np.diff(times, prepend=before)
            # The step between times 292 years apart overflows, and may have any value.
            jumps = (steps < -_BACK_NS) | (steps > _FORWARD_NS)
            played.jumps += int(jumps.sum())
            steps[jumps] = 0
            elapsed = self._elapsed + np.cumsum(steps)
            self._before, self._elapsed = int(times[-1]), int(elapsed[-1])
            due[known] = (elapsed / self._speed).astype(np.int64)
        # A frame without a time, or out of order, is due with the frame before it.
        return np.maximum.accumulate(np.maximum(due, self._last))


def play(
    rounds: Iterable[Iterable[FrameArray]],
    send: Callable[[FrameArray], object],
    *,
    speed: float = 1.0,
    gap_ns: int | None = None,
    wanted: Callable[[], bool] = lambda: True,
) -> Played:
    """Send frames at their recorded times.

    Deadlines are absolute: a frame that is late does not make later frames late. A frame without a
    time is due with the frame before it. If the recorded time steps back by more than a second, or
    forward by more than an hour, the next frame is due without a pause.

    Parameters
    ----------
    rounds : iterable of iterables of FrameArray
        The frames of each round. A round follows the round before it at once. A round without a
        frame is the last one.
    send : callable
        Gets the frames that are due, or due within a millisecond, in order. Their `ts` is when
        they are due, in nanoseconds from the start.
    speed : float
        2 plays twice as fast.
    gap_ns : int or None
        The time between two frames, instead of the recorded times.
    wanted : callable
        Is called ten times a second, and returns whether to go on.
    """
    if not speed > 0:
        raise ValueError(f"speed is {speed}; it must be more than 0")
    if gap_ns is not None and gap_ns < 0:
        raise ValueError(f"gap_ns is {gap_ns}; it must be 0 or more")
    played = Played()
    schedule = _Schedule(speed=speed, gap_ns=gap_ns)
    begin: int | None = None
    for blocks in rounds:
        before = played.frames
        schedule.start_round()
        for frames in blocks:
            if not len(frames):
                continue
            due = schedule.due(frames["ts"], played)
            if begin is None:
                begin = time.monotonic_ns()
            timed = copy_records(frames)
            timed["ts"] = due
            for batch in _batches(timed, begin):
                if not wanted():
                    return played
                if len(batch):
                    sent_at = time.monotonic_ns() - begin
                    send(batch)
                    played.frames += len(batch)
                    played.lateness.add(sent_at - batch["ts"])
        if played.frames == before:
            break
        played.rounds += 1
    return played


def _batches(frames: FrameArray, begin: int) -> Iterator[FrameArray]:
    """Yield frames when they are due, and an empty array at least every 0.1 s while none is."""
    at = 0
    while at < len(frames):
        now = time.monotonic_ns() - begin
        ready = int(np.searchsorted(frames["ts"], now + _AHEAD_NS, side="right"))
        if ready > at:
            stop = min(ready, at + _BATCH_FRAMES)
            yield frames[at:stop]
            at = stop
            continue
        yield frames[:0]
        left = (int(frames["ts"][at]) - (time.monotonic_ns() - begin)) / 1e9
        time.sleep(min(max(left, 0), _LOOK_EVERY_S))
