"""Lines, hosts and device clocks of which the truth is known, and host times made of them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canser._core.buffers import FrameRoom
from canser._frames import FRAME_DTYPE, FrameArray
from canser.timing.clocks import FrameClock

Times = npt.NDArray[np.int64]

US, MS, S = 1_000, 1_000_000, 1_000_000_000
TICK = {"s": S, "ms": MS, "us": US}
EPOCH = 1_790_000_000 * S  # a float64 could not tell apart nanoseconds here
BYTE_NS = 1e10 / 115_200
FRAME_MAX = 19


@dataclass
class Stream:
    """What an adapter sent and what came of it."""

    truth: Times  # when each frame was on the bus
    offsets: Times  # where it begins in the stream
    lasts: Times  # where its last byte is
    end: int
    done: Times  # when its last byte had come over the line
    read: Times  # when the host had read that byte
    pieces: list[tuple[int, int]]

    def without(self, gone: npt.NDArray[np.bool_]) -> "Stream":
        """Return the stream as if these frames were noise."""
        rows = (self.truth, self.offsets, self.lasts, self.done, self.read)
        truth, offsets, lasts, done, read = (row[~gone] for row in rows)
        return Stream(truth, offsets, lasts, self.end, done, read, self.pieces)


def bus(seed: int, seconds: float, rate: float) -> Times:
    """Return random times of frames on a bus."""
    steps = np.random.default_rng(seed).exponential(S / rate, round(seconds * rate))
    return EPOCH + np.cumsum(steps.astype(np.int64) + 1)


def send(
    truth: Times,
    *,
    seed: int = 1,
    byte_ns: float = BYTE_NS,
    latency: int = 16 * MS,
    stalls: tuple[tuple[int, int], ...] = (),
) -> Stream:
    """Send frames of 13 to 19 bytes over a line, a USB chip and a busy host.

    The chip passes bytes on every `latency`; the host reads at most 4095 of them, 0.2 ms late
    on average, now and then 100 ms, and not at all in `stalls` (from, for how long).
    """
    rng = np.random.default_rng(seed)
    sizes = rng.integers(11, FRAME_MAX + 1, len(truth))
    offsets = np.cumsum(sizes) - sizes
    # A frame goes out when it was received and the one before is out.
    busy = (offsets * byte_ns).astype(np.int64)
    begun = np.maximum.accumulate(truth - busy) + busy
    within = np.arange(sizes.sum()) - np.repeat(offsets, sizes)
    came = np.repeat(begun, sizes) + ((within + 1) * byte_ns).astype(np.int64)
    passed = -(-came // latency) * latency

    reads = np.unique(passed)
    late = rng.exponential(MS / 5, len(reads)) + 100 * MS * (rng.random(len(reads)) < 1e-3)
    reads += late.astype(np.int64)
    for start, length in stalls:
        asleep = (reads >= EPOCH + start) & (reads < EPOCH + start + length)
        reads[asleep] = EPOCH + start + length
    reads = np.maximum.accumulate(reads)
    ends = np.searchsorted(passed, reads, side="right")
    pieces: list[tuple[int, int]] = []
    for end, ns in zip(ends.tolist(), reads.tolist(), strict=True):
        begin = pieces[-1][0] if pieces else 0
        pieces += [(part, ns) for part in (*range(begin + 4095, end, 4095), end) if part > begin]

    last = offsets + sizes - 1
    piece = np.searchsorted([end for end, _ in pieces], last + 1)
    read = np.array([ns for _, ns in pieces])[piece]
    return Stream(truth, offsets, last, int(sizes.sum()), came[last], read, pieces)


def ticks(truth: Times, unit: str = "ms", ppm: float = 0, zero: int = EPOCH - 77 * S) -> Times:
    """Return what a device's clock says that is `ppm` fast and was 0 at `zero`."""
    elapsed = truth - zero
    elapsed = elapsed + (elapsed * (ppm * 1e-6)).astype(np.int64)
    return elapsed // TICK[unit] * TICK[unit]


def room_of(at: Times | list[int]) -> FrameRoom:
    """Return room with frames whose bytes that count are at these offsets."""
    offsets = np.array(at, np.int64)
    return FrameRoom(np.zeros(len(offsets), FRAME_DTYPE), offsets, offsets + 1)


def feed(
    clock: FrameClock, stream: Stream, device: Times | None = None, batch: int = 4096
) -> Iterator[FrameArray]:
    """Give a stream its times, each batch as soon as its bytes have arrived."""
    pieces = iter(stream.pieces)
    arrived = 0
    places = stream.offsets if clock.by_begin else stream.lasts
    for start in range(0, len(places), batch):
        part = places[start : start + batch]
        end = int(stream.lasts[start : start + batch][-1]) + 1
        while arrived < end:
            arrived, ns = next(pieces)
            clock.arrivals.add(arrived, ns)
        room = room_of(part)
        if device is not None:
            room.frames["ts"] = device[start : start + batch]
        clock.assign_times(room, len(part), end)
        yield room.frames


def unit_of(device: Times) -> int:
    """Return the ticks in which a device's clock counts."""
    return next(ns for ns in (S, MS, US) if not (device % ns).any())


def timed(
    stream: Stream, device: Times | None = None, batch: int = 4096, byte_ns: float = BYTE_NS
) -> tuple[Times, FrameClock]:
    clock = FrameClock(None if device is None else unit_of(device), byte_ns)
    times = [frames["ts"] for frames in feed(clock, stream, device, batch)]
    return np.concatenate(times), clock
