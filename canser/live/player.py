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

# Frames that are due this soon go out with those that are due: a write for each would cost more
# than it gains, and what brings them to the bus puts in as much.
_AHEAD_NS: Final = 1 * _MS_NS

# The most frames that are sent at once. Those behind them are sent after a look at the clock.
_BATCH_FRAMES: Final = 256

# A wish to end is heeded within this time.
_LOOK_S: Final = 0.1

# Steps of the recorded time that are no disorder among frames: back, the clock of a device that
# has started anew, or the next of several recordings; forward, a false time out of noise.
_BACK_NS: Final = 1_000 * _MS_NS
_FORWARD_NS: Final = 3_600_000 * _MS_NS

# Bins of 10 microseconds, up to a second and what is beyond.
_BIN_NS: Final = 10_000
_BINS: Final = 100_001


@dataclass(slots=True)
class Lateness:
    """By how much frames were sent too late or too early, in nanoseconds."""

    count: int = 0
    total: int = 0
    most: int = 0
    _bins: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(_BINS, np.int64))

    def add(self, errors: _Times) -> None:
        """Count some frames, by when they went out less when they were due."""
        sizes = np.abs(errors)
        self.count += len(sizes)
        self.total += int(sizes.sum())
        self.most = max(self.most, int(sizes.max(initial=0)))
        self._bins += np.bincount(np.minimum(sizes // _BIN_NS, _BINS - 1), minlength=_BINS)

    @property
    def mean(self) -> float:
        """The mean; 0 without any frame."""
        return self.total / self.count if self.count else 0.0

    def share(self, share: float) -> int:
        """Return what this share of the frames stays below, to 10 microseconds."""
        if not self.count:
            return 0
        place = int(np.searchsorted(np.cumsum(self._bins), share * self.count))
        return min((place + 1) * _BIN_NS, self.most) if place < _BINS - 1 else self.most


@dataclass(slots=True)
class Played:
    """What was sent, and how well its times were kept."""

    frames: int = 0
    rounds: int = 0  # that were sent to the end
    untimed: int = 0  # frames without a time, sent right behind those before them
    jumps: int = 0  # of the recorded clock, passed over without a pause
    lateness: Lateness = field(default_factory=Lateness)


class _Schedule:
    """When frames are due, nanoseconds from the start of playing."""

    def __init__(self, *, speed: float, gap_ns: int | None) -> None:
        self._speed, self._gap_ns = speed, gap_ns
        self._before: int | None = None  # the recorded time of the frame before, in this round
        self._elapsed = 0  # recorded time from the first frame to that one, without jumps
        self._last = 0 if gap_ns is None else -gap_ns  # when that one is due

    def start_round(self) -> None:
        """Let the next frame follow the last one, whatever its recorded time is."""
        self._before = None

    def due(self, ts: _Times, played: Played) -> _Times:
        """Return when the next frames are due, one or more."""
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
            # Times that are 292 years apart overflow, to any step.
            jumps = (steps < -_BACK_NS) | (steps > _FORWARD_NS)
            played.jumps += int(jumps.sum())
            steps[jumps] = 0
            elapsed = self._elapsed + np.cumsum(steps)
            self._before, self._elapsed = int(times[-1]), int(elapsed[-1])
            due[known] = (elapsed / self._speed).astype(np.int64)
        # A frame without a time is due with the one before it, and so is one out of order.
        return np.maximum.accumulate(np.maximum(due, self._last))


def play(
    rounds: Iterable[Iterable[FrameArray]],
    send: Callable[[FrameArray], object],
    *,
    speed: float = 1.0,
    gap_ns: int | None = None,
    wanted: Callable[[], bool] = lambda: True,
) -> Played:
    """Send frames by their times.

    `rounds`: each an iterable of arrays of FRAME_DTYPE; a round follows the one before it at
    once, and one without a frame is the last.
    `send` gets the frames that are due, or within a millisecond, in order; their `ts` is when they
    are due, nanoseconds from the start. `speed`: 2 plays twice as fast. `gap_ns`: this time
    between two frames, instead of the recorded times. `wanted`: asked ten times a second
    whether to go on.

    Deadlines are absolute: a frame that is late makes none behind it late. A frame without a
    time is due with the one before it. Where the recorded time steps back by more than a second,
    or forward by more than an hour, it goes on from there without a pause.
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
    """Yield frames when they are due; none of them now and then while waiting."""
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
        time.sleep(min(max(left, 0), _LOOK_S))
