"""Arithmetic on the times of frames: arrivals, and the line from a device's clock to the host's."""

from typing import Final

import numpy as np

from canser._core._lib import ffi, lib
from canser._core.buffers import Times, raise_status


def find_arrivals(pieces: Times, byte_ns: float, at: Times, arrivals: Times) -> None:
    """Set `arrivals` to when the bytes at these offsets had come.

    `pieces`: the offset behind each and its time, in turn. See canser_times_arrivals.
    """
    status = lib.canser_times_arrivals(
        ffi.from_buffer("canser_piece[]", pieces),
        len(pieces) // 2,
        byte_ns,
        ffi.from_buffer("int64_t[]", at),
        len(at),
        ffi.from_buffer("int64_t[]", arrivals),
    )
    if status:
        raise_status(status)


class ClockTurns:
    """Which turn of its 32-bit counter a device's clock is in, by the host's clock.

    `tick_ns`: the unit of the device's times. The turn is right as long as arrivals are late by
    less than half a turn, what two clocks differ by after a silence included: by 35.8 minutes of
    microseconds, 24.9 days of milliseconds, 2.1 s of nanoseconds (50 ppm make that in 11.9 hours).
    Frames that are later may be whole turns off; and, if more than 15 come together, all behind
    them. See canser_times_turns.
    """

    def __init__(self, tick_ns: int) -> None:
        self._tick_ns = tick_ns
        self._turns = ffi.new("canser_turns *")

    def assign(self, times: Times, arrivals: Times) -> None:
        """Set device times to the turn that is nearest to the host's clock, in place."""
        status = lib.canser_times_turns(
            self._turns,
            self._tick_ns,
            ffi.from_buffer("int64_t[]", arrivals),
            len(times),
            ffi.from_buffer("int64_t[]", times),
        )
        if status:
            raise_status(status)


def find_ranked(values: Times, rank: int) -> tuple[int, int, int]:
    """Return the value that has this many below it, the lowest and the highest one."""
    ranked = ffi.new("canser_ranked *")
    status = lib.canser_times_rank(ffi.from_buffer("int64_t[]", values), len(values), rank, ranked)
    if status:
        raise_status(status)
    return ranked.value, ranked.low, ranked.high


def find_lowest(values: Times, rank: int) -> int:
    """Return where the value stands that has this many below it, a few; the first of equal ones."""
    index = ffi.new("size_t *")
    status = lib.canser_times_lowest(ffi.from_buffer("int64_t[]", values), len(values), rank, index)
    if status:
        raise_status(status)
    return int(index[0])


class ClockLine:
    """The line from device times to host times: what a device's clock stands at.

    `early`: how far a device time may lie before those of the past, and a host time behind
    its arrival. `latest`: no host time lies before this one. See canser_times_map.
    """

    def __init__(self, early: int, latest: int) -> None:
        self._line = ffi.new("canser_line *")
        self._trust = ffi.new("canser_trust *", {"early": early})
        self._latest = ffi.new("int64_t *", latest)

    def set(self, device: int, host: int, drift: float) -> None:
        """Have the host's time be `host` when the device's is `device`."""
        self._line.device, self._line.host, self._line.drift = device, host, drift

    def floor_at(self, latest: int) -> None:
        """Let no host time come before this one."""
        self._latest[0] = latest

    def find_residuals(self, device: Times, arrivals: Times, residuals: Times) -> None:
        """Set `residuals` to how far arrivals lie above the line, in nanoseconds."""
        status = lib.canser_times_heights(
            self._line,
            ffi.from_buffer("int64_t[]", device),
            ffi.from_buffer("int64_t[]", arrivals),
            len(residuals),
            ffi.from_buffer("int64_t[]", residuals),
        )
        if status:
            raise_status(status)

    def map(self, device: Times, times: Times, reached: int, late: int) -> None:
        """Turn arrivals into host times, in place.

        `reached`: a device time of the past. `late`: how far a host time may lie before its
        arrival.
        """
        self._trust.reached, self._trust.late = reached, late
        status = lib.canser_times_map(
            self._line,
            self._trust,
            ffi.from_buffer("int64_t[]", device),
            len(times),
            ffi.from_buffer("int64_t[]", times),
            self._latest,
        )
        if status:
            raise_status(status)


_SAMPLE_DTYPE: Final = np.dtype(
    [("device", "i8"), ("arrival", "i8"), ("counted", "i8"), ("index", "i8")]
)
assert ffi.sizeof("canser_sample") == _SAMPLE_DTYPE.itemsize


class Sampler:
    """The least late frame of each piece, of which a clock learns: gathered until they are taken.

    See canser_times_sample.
    """

    def __init__(self) -> None:
        self.count = 0  # samples
        self._sampler = ffi.new("canser_sampler *")
        self._found = ffi.new("size_t *")
        self._samples = np.empty(0, _SAMPLE_DTYPE)
        self._make_room(256)

    def add(self, pieces: Times, at: Times, device: Times, arrivals: Times) -> None:
        """Take the samples of some frames; `pieces`, `at` and `arrivals` as of `find_arrivals`."""
        if len(self._samples) - self.count < len(at):
            # In large steps: pages that are not written to take no memory, and copies do.
            self._make_room(4 * (self.count + len(at)))
        status = lib.canser_times_sample(
            self._sampler,
            ffi.from_buffer("canser_piece[]", pieces),
            len(pieces) // 2,
            ffi.from_buffer("int64_t[]", at),
            len(at),
            ffi.from_buffer("int64_t[]", device),
            ffi.from_buffer("int64_t[]", arrivals),
            self._samples_at + self.count,
            self._found,
        )
        if status:
            raise_status(status)
        self.count += self._found[0]

    def arrival(self, number: int) -> int:
        """Return when a sample had arrived."""
        return int(self._samples_at[number].arrival)

    def index(self, number: int) -> int:
        """Return which frame of the last `add` was the first one behind the sample's piece."""
        return int(self._samples_at[number].index)

    def count_before(self, ns: int) -> int:
        """Return how many samples had arrived before a time; they are in that order."""
        return int(self._samples["arrival"][: self.count].searchsorted(ns))

    def take(self, count: int) -> Times:
        """Remove the first samples; return rows of them.

        Device times, arrivals, how far these were counted back, and arrivals less device times.
        """
        taken, rest = self._samples[:count], self._samples[count : self.count]
        rows = np.empty((4, count), np.int64)
        rows[:3] = taken["device"], taken["arrival"], taken["counted"]
        np.subtract(rows[1], rows[0], out=rows[3])
        self.count = len(rest)
        self._samples[: self.count] = rest.copy()
        return rows

    def reset(self) -> None:
        """Forget the samples, and the piece that the last frame was in."""
        self._sampler.count = 0
        self.count = 0

    def _make_room(self, cap: int) -> None:
        samples = np.empty(cap, _SAMPLE_DTYPE)
        samples[: self.count] = self._samples[: self.count]
        self._samples = samples
        self._samples_at = ffi.from_buffer("canser_sample[]", samples)
