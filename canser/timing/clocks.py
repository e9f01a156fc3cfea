"""Host times of frames, from the arrivals of their bytes and from the device's own clock.

Bytes come in pieces: a piece is one read of the port, with the host's time behind it. So a byte had
come by the time of its piece; and the line needs a byte time for each byte behind it in the piece.
Together they give the byte's arrival (arrivals.py). An arrival is never earlier than the truth, as
long as the line is no faster than `byte_ns` says. It is late by as long as the adapter, the driver
and the host held the piece back. It is never put before the arrival of the piece before, so that
arrivals never go backwards.

A format without a clock has these times only: a frame's time is the arrival of its last byte.

If the device puts its own time into each frame, the host only needs to find out how its clock and
the device's clock differ. For the arrival of a frame's first byte,

    arrival - device time = offset of the clocks + drift + delay,    delay >= 0

A delay is mostly some milliseconds. It is seconds if the host was busy and bytes queued up. But in
every second some frames come through at once. So the estimate is the lower envelope of the
differences, and late frames do not change it:

- Each piece gives one *sample*: its frame with the lowest difference, without false frames. On a
  line that is faster than `byte_ns` says, the first frames of a burst seem to come too early. As a
  burst is one piece, it is one sample.
- The samples of a second are a *bucket*. A bucket gives one *point*: its third lowest difference
  (of equal ones the first counts as the lowest). A false frame out of noise, or the first frame of
  a burst, may be lower than all others. Differences over a minute from the bucket's median are
  those of false frames, and are left out.
- Once the line is known well, samples below it are left out, too, if counting back alone has put
  them there: they are bursts.
- The *line* lies below the points of the last minutes. Its slope is the median over pairs of points
  a quarter window apart, so that one jump of the clock changes at most a third of the pairs. Until
  there is half a minute of points, and while the slopes do not agree, the slope is zero, or what it
  was before.
- The points start over if half a minute of them lies 20 ms above the line: the device's clock had
  stood still. They also start over at a *restart*: the device times of a bucket lie before those of
  the bucket before, or more than a minute off the line.
- After a silence of ten minutes the points start over, too: the line does not reach so far.
- The buckets of the first second have 4 samples, then as many as there have been, so that there is
  an estimate after a few frames. The same holds after a gap.

The device's time is a counter of 32 bits. The arrival tells which turn it is in. So neither a
silence nor false times put the clock a turn off.

A frame is mapped by the estimate of the buckets before its own. It keeps its arrival if the mapped
time is

- impossible: 10 ms after the arrival, or more;
- implausible: a minute before the arrival, or two seconds while the clock's rate is not known;
- before the device times of the last bucket.

These are false frames out of noise, and the first frames after a restart. No frame has a time after
its arrival. The times of mapped frames never go backwards when the estimate changes: a time is held
until the others have caught up. One case cannot be told: while bytes queue for seconds, a false
frame that is ahead by less than the delay is believed, and holds the frames behind it.

The rate of the device's clock is the median of the last buckets' rates. If it is far from the
host's, the caller gave a wrong unit of its ticks, or it is no clock. Then all frames keep their
arrivals, and `remark` says so.

C does the work for each frame in one pass (canser_timing_assign). It stops where a bucket is full
or a silence ends, and goes on with what was learned there.

All arithmetic on times is int64 modulo 2**64, like device times. Floats hold small differences
only: a float64 of epoch nanoseconds resolves 256 ns.
"""

from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from canser._core.buffers import FrameRoom, Times
from canser._core.timing import BUCKET, FrameTiming
from canser._protocols import TS_UNITS
from canser.timing.arrivals import Arrivals

__all__ = ["ClockEstimate", "FrameClock"]

_MS_NS: Final = 1_000_000
_S_NS: Final = 1_000 * _MS_NS

# The most that a mapped time may lie behind the arrival, or a device time before those of the last
# bucket. More is taken for wrong. The least delay differs by less from one second to the next: some
# frame of a second comes early in the latency timer's 16 ms. Bytes out of noise mostly give more.
_TOLERANCE_NS: Final = 10 * _MS_NS

# The longest time that bytes queue: the kernel's 64 KiB are 6 s of a busy line at 115,200 baud, and
# ten times that of a quiet line. While the clock's rate is not known, a clock that is too slow
# looks like a queue that grows. So the limit is lower then: a tick of the coarsest clock, and a
# second.
_LONGEST_QUEUE_NS: Final = 60 * _S_NS
_LONGEST_QUEUE_UNPROVEN_NS: Final = 2 * _S_NS

_BUCKET_NS: Final = _S_NS
_BUCKET_SAMPLES: Final = 8  # at least: of fewer samples, the third lowest is no low one
_FIRST_SAMPLES: Final = 4

# A silence this long starts the points over. An error of the slope of 5 ppm, as ticks of a
# millisecond give, makes 3 ms over it.
_SILENCE_NS: Final = 600 * _S_NS

_WINDOW_POINTS: Final = 300  # five minutes of a busy bus; crystals are steady that long
_STUCK_POINTS: Final = 30  # in a row above the line: no queue lasts half a minute
_STUCK_NS: Final = 20 * _MS_NS

# With this many points the line is known well. What lies further below it than _BURST_NS is a
# burst. On a quiet line the least delays of two seconds may differ by more, but there hardly any
# byte is counted back.
_KNOWN_POINTS: Final = 10
_BURST_NS: Final = 2 * _MS_NS

# A slope needs a span: over 30 s, minima that differ by 1 ms give 30 to 50 ppm, as much as crystals
# are off. A slope is believed if half of the slopes are within 200 ppm of it; with ticks of a
# second they are not. The limit is over what CAN itself tolerates between two nodes, 1.58 %.
_DRIFT_SPAN_NS: Final = 30 * _S_NS
_DRIFT_POINTS: Final = 10
_DRIFT_SPREAD: Final = 200e-6
_DRIFT_MOST: Final = 20_000e-6

_RATES: Final = 8
_RATES_LEAST: Final = 3  # a median of three is right in spite of one jump
# A rate between these limits is jitter over a second; beyond them the unit is wrong.
_RATE_LEAST: Final = 0.8
_RATE_MOST: Final = 1.25


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """The device's clock compared with the host's; returned by `Port.clock`."""

    #: Host time minus device time, now, in nanoseconds.
    offset_ns: int
    #: How much faster the device's clock is than the host's, in millionths; 0 if not known.
    drift_ppm: float
    #: Median of how late the last frames were, compared with the quickest ones, in nanoseconds.
    jitter_ns: int
    #: Number of frames that the estimate rests on: one of each read.
    frames: int
    #: How often the device's clock jumped.
    restarts: int


class FrameClock:
    """Sets the times of one stream's frames to host times, in epoch nanoseconds.

    `tick_ns` is the unit of the times that come with the frames, a counter of 32 bits; None for a
    format without a clock. `byte_ns` is the time of a byte on the line, 10 bits at the baud rate; 0
    if the line has no rate. With `device_time` frames keep the times of the device's clock, and the
    host's clock only tells the turn of the counter. With `recorded` the bytes come in blocks of a
    recording. A block may hold several reads if counting back gives their times. So without a
    device's clock, bytes are counted back there on any line.

    The same reads and frames give the same times, however calls of `assign_times` are cut.
    """

    def __init__(
        self,
        tick_ns: int | None,
        byte_ns: float,
        *,
        device_time: bool = False,
        recorded: bool = False,
    ) -> None:
        self.arrivals = Arrivals(byte_ns, keeps_rate=recorded and tick_ns is None)
        #: Whether a frame's time is that of its first byte, not of its last one.
        self.by_begin = tick_ns is not None
        self._timing = FrameTiming(
            tick_ns or 0,
            byte_ns,
            keeps_device=device_time,
            silence_ns=_SILENCE_NS,
            bucket_ns=_BUCKET_NS,
            bucket_least=_BUCKET_SAMPLES,
            early_ns=_TOLERANCE_NS,
        )
        self._clock = None if tick_ns is None or device_time else _DeviceClock(self._timing)
        self._rated = True  # until it is known that the line has no bit rate of its own

    def gap(self) -> None:
        """Note that the stream was interrupted behind all that has arrived.

        All frames before it have their times. The device may be another one now: its clock has to
        prove itself again.
        """
        self.arrivals.gap()
        if self._clock is not None:
            self._clock.gap()

    def assign_times(self, room: FrameRoom, count: int, end: int) -> None:
        """Set the times of the first `count` frames in a room, for those that have none yet.

        The frames have the times of the decoder, if the format has any. `end` is the offset behind
        the last packet decoded; arrivals before it are forgotten. ValueError if `end` lies behind
        all that has arrived.
        """
        arrivals = self.arrivals
        if end > arrivals.end:
            raise ValueError(
                f"frames end at offset {end}, but bytes have arrived up to {arrivals.end} only; "
                "tell of the arrivals first"
            )
        if room.timed < count:
            if self._rated and arrivals.unrated_from is not None:
                self._pass_border(room, count, arrivals.unrated_from)
            self._assign(room, count)
        arrivals.forget_before(end)

    @property
    def estimate(self) -> ClockEstimate | None:
        """The estimate of the device's clock; None if there is no clock, or nothing is known."""
        return None if self._clock is None else self._clock.estimate

    @property
    def remark(self) -> str | None:
        """What is wrong with the device's clock, so that frames keep arrivals; None if nothing."""
        return None if self._clock is None else self._clock.remark

    def _assign(self, room: FrameRoom, count: int) -> None:
        pieces, piece_count = self.arrivals.kept
        while stopped := self._timing.assign(pieces, piece_count, room, count):
            assert self._clock is not None
            if stopped == BUCKET:
                self._clock.learn()
            else:
                self._clock.relearn()

    def _pass_border(self, room: FrameRoom, count: int, unrated_from: int) -> None:
        """Stop counting back at this offset, if there is a frame behind it."""
        first = room.timed
        if self.by_begin:
            assert room.offsets is not None
            border = int(room.offsets[first:count].searchsorted(unrated_from))
        else:
            assert room.ends is not None
            border = int(room.ends[first:count].searchsorted(unrated_from, "right"))
        self._assign(room, first + border)
        if first + border == count:
            return
        self._rated = False
        self._timing.set_byte_time(0)
        if self._clock is not None:
            # Arrivals that were counted back may be too early, and so what was learned from them.
            self._clock.relearn()


class _DeviceClock:
    """The estimate of a device's clock, and host times by it; see the module's docstring."""

    def __init__(self, timing: FrameTiming) -> None:
        self.estimate: ClockEstimate | None = None
        self.remark: str | None = None
        self._timing = timing
        # Buckets are short for the first second, and for the first second after a gap.
        self._since: int | None = None
        self._tried = 0  # samples since then
        timing.stop_at(_FIRST_SAMPLES)
        # For the frame that was a bucket's minimum: device time, arrival, and their difference.
        self._points = np.empty((3, 0), np.int64)
        self._frames = 0  # in the buckets of these points, and in those before
        # The line: the host's time at a device time, and the slope.
        self._device = 0
        self._host: int | None = None
        self._drift = 0.0
        # For buckets that are at least a second apart: the medians of device times and of arrivals.
        self._middles: deque[tuple[int, int]] = deque(maxlen=_RATES + 1)
        self._reached = 0  # the median device time of the last bucket
        self._longest_queue = _LONGEST_QUEUE_UNPROVEN_NS
        self._restarts = 0

    def relearn(self) -> None:
        """Start the estimate over."""
        self.gap()
        self._forget()

    def gap(self) -> None:
        """Doubt the line: it stays if the next frames agree with it."""
        self._timing.drop_samples()  # they may be too few to tell anything
        self._timing.stop_at(_FIRST_SAMPLES)
        self._middles.clear()
        self._longest_queue = _LONGEST_QUEUE_UNPROVEN_NS
        self._timing.trust(self._reached, self._longest_queue)
        self._since = None
        self._tried = 0

    def _forget(self) -> None:
        self._points = self._points[:, :0]
        self._frames = 0
        self._host = None
        self._timing.forget_line()
        self.estimate = None

    def learn(self) -> None:
        """Learn from a bucket."""
        bucket = self._timing.take_samples()
        total = len(bucket)
        rows = np.empty((4, total), np.int64)
        rows[:3] = bucket["device"], bucket["arrival"], bucket["counted"]
        np.subtract(rows[1], rows[0], out=rows[3])
        self._tried += total
        if self._since is None:
            self._since = int(rows[1, 0])
        settled = int(rows[1, -1]) - self._since >= _BUCKET_NS
        self._timing.stop_at(None if settled else max(_FIRST_SAMPLES, self._tried))
        self._learn(rows)
        # Also if no line was learned: the rate may have been.
        self._timing.trust(self._reached, self._longest_queue)

    def _learn(self, samples: Times) -> None:
        """Learn from samples.

        `samples` has the rows device times, arrivals, how far these were counted back, and
        arrivals minus device times.
        """
        total = samples.shape[1]
        low, usual, high = np.sort(samples[3])[[0, total // 2, -1]].tolist()
        if max(usual - low, high - usual) > _LONGEST_QUEUE_NS:
            near = np.abs(samples[3] - usual) <= _LONGEST_QUEUE_NS
            samples = np.compress(near, samples, axis=1)
        device, arrivals, _, _ = samples
        count = len(device)
        middle = int(np.sort(device)[count // 2])
        self._check_rate(device, middle, int(arrivals[count // 2]))
        if self.remark is not None:
            self._forget()
            return
        if count * 2 < total:
            return  # noise
        device, arrivals, _, delays = self._leave_out_bursts(samples)

        lowest = delays.argsort(kind="stable")[min(2, total // 4)]
        if self._jumped(device[lowest : lowest + 1], arrivals[lowest : lowest + 1], middle):
            # The bucket is not used: frames from before the jump may be in it.
            self._restarts += 1
            self._forget()
            return
        point = [[device[lowest]], [arrivals[lowest]], [delays[lowest]]]
        self._points = np.concatenate((self._points, point), axis=1)[:, -_WINDOW_POINTS:]
        self._frames += len(device)
        self._reached = middle
        host = self._host = self._fit()
        self._timing.set_line(self._device, host, self._drift)
        residuals = np.sort(self._find_residuals(device, arrivals))
        self.estimate = ClockEstimate(
            offset_ns=host - self._device,
            drift_ppm=-self._drift * 1e6,
            jitter_ns=max(0, int(residuals[len(residuals) // 2])),
            frames=self._frames,
            restarts=self._restarts,
        )

    def _find_residuals(self, device: Times, arrivals: Times) -> Times:
        """Return how far arrivals lie above the line, in nanoseconds."""
        assert self._host is not None
        run = device - self._device
        host: Times = run + (run * self._drift).astype(np.int64) + self._host
        return arrivals - host

    def _leave_out_bursts(self, samples: Times) -> Times:
        """Return the samples without those that counting back alone has put below the line."""
        if self._points.shape[1] < _KNOWN_POINTS:
            return samples
        device, arrivals, counted, _ = samples
        residuals = self._find_residuals(device, arrivals)
        bursts = (residuals < -_BURST_NS) & (residuals + counted >= -_BURST_NS)
        # If these are most of the samples, the line is too late.
        few = 0 < np.count_nonzero(bursts) * 2 < len(bursts)
        return np.compress(~bursts, samples, axis=1) if few else samples

    def _check_rate(self, device: Times, middle: int, arrival: int) -> None:
        """Find the rate of the device's clock; set the remark if it is not a second a second."""
        if not self._middles or arrival - self._middles[-1][1] >= _BUCKET_NS:
            self._middles.append((middle, arrival))
        if len(self._middles) <= _RATES_LEAST:
            return
        from statistics import median  # noqa: PLC0415 - slow, and seldom needed

        rates = [_wrapped(d - c) / (b - a) for (c, a), (d, b) in pairwise(self._middles)]
        rate = median(rates)
        agree = [other for other in rates if abs(other - rate) <= 0.25 * abs(rate) + 0.01]
        if len(agree) * 2 <= len(rates):
            return  # noise, or the device restarts all the time
        if _RATE_LEAST <= rate <= _RATE_MOST:
            self._longest_queue = _LONGEST_QUEUE_NS
            self.remark = None
        else:
            self._longest_queue = _LONGEST_QUEUE_UNPROVEN_NS
            self.remark = _describe_rate(float(np.mean(agree)), device)

    def _jumped(self, device: Times, arrival: Times, middle: int) -> bool:
        """Return whether the clock jumped, by a bucket's minimum (arrays of one) and its middle."""
        if self._host is None:
            return False
        residual = self._find_residuals(device, arrival)[0]
        back = _wrapped(middle - self._reached) < -_TOLERANCE_NS
        return back or not -_LONGEST_QUEUE_NS <= residual <= self._longest_queue

    def _fit(self) -> int:
        """Put the line below the points; return the host's time at the last one."""
        points, count = self._points, self._points.shape[1]
        device, arrivals, delays = (points - points[:, -1:]).astype(np.float64)
        if count >= _DRIFT_POINTS and -arrivals[0] >= _DRIFT_SPAN_NS:
            lag = count // 4
            # The points of short buckets lie closer together.
            apart = np.maximum(arrivals[lag:] - arrivals[:-lag], _BUCKET_NS)
            slopes = (delays[lag:] - delays[:-lag]) / apart
            drift = _middle(slopes)
            if _middle(np.abs(slopes - drift)) <= _DRIFT_SPREAD:
                self._drift = min(max(drift, -_DRIFT_MOST), _DRIFT_MOST)
        residuals = delays - self._drift * device
        lowest = residuals.min()
        if count > _STUCK_POINTS and residuals[-_STUCK_POINTS:].min() > lowest + _STUCK_NS:
            lowest = residuals[-_STUCK_POINTS:].min()
            self._points = points[:, -_STUCK_POINTS:]
        self._device = int(points[0, -1])
        return int(points[1, -1]) + int(lowest)


def _wrapped(difference: int) -> int:
    """Return a difference of device times, which may be any, modulo 2**64."""
    return (difference + 2**63) % 2**64 - 2**63


def _middle(values: npt.NDArray[np.float64]) -> float:
    """Return the median as np.median does, in a fifth of its time for some hundred values."""
    values = np.sort(values)
    half = len(values) // 2
    return float(values[half] if len(values) % 2 else (values[half - 1] + values[half]) / 2)


def _describe_rate(rate: float, device: Times) -> str:
    """Return a text on a clock with a wrong rate, with the unit that would explain it."""
    if rate < 1e-8:  # slower than seconds that are taken for nanoseconds, and no noise
        return "the device clock stands still or runs backwards; frames have arrival times"
    fast = max(rate, 1 / rate)
    thousands = round(np.log10(fast) / 3)
    plain = thousands > 0 and 0.7 < fast / 1000**thousands < 1.4
    factor = float(1000**thousands) if plain else fast
    speed = "as fast as" if rate > 1 else "as slowly as"
    text = f"the device clock runs {factor:{'.0f' if factor >= 100 else '.2g'}} times {speed} the"
    given = next((ns for ns in TS_UNITS.values() if not (device % ns).any()), 0)
    true = given / factor if rate > 1 else given * factor
    fits = [unit for unit, ns in TS_UNITS.items() if plain and true == ns]
    return f"{text} host's; " + (
        f"is ts_unit {fits[0]!r}?" if fits else "frames have arrival times"
    )
