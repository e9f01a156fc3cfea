"""The times of frames: what C does for each of them, and the memory for it."""

from typing import Final

import numpy as np
import numpy.typing as npt

from canser._core._lib import ffi, lib
from canser._core.buffers import FrameRoom, Pointer, Times, raise_status

BUCKET: Final[int] = lib.CANSER_TIMING_BUCKET
SILENCE: Final[int] = lib.CANSER_TIMING_SILENCE

_SAMPLE_DTYPE: Final = np.dtype([("device", "i8"), ("arrival", "i8"), ("counted", "i8")])
assert ffi.sizeof("canser_sample") == _SAMPLE_DTYPE.itemsize

_MOST: Final = 2 ** (8 * ffi.sizeof("size_t")) - 1


def pieces_at(rows: Times) -> Pointer:
    """Return a pointer to rows of stream offsets and times, as pieces; it holds the array."""
    return ffi.from_buffer("canser_piece[]", rows)


class FrameTiming:
    """Gives the frames of one stream their times; see canser_timing_assign.

    `tick_ns`: the unit of the device's times, 0 without them; with `keeps_device` frames keep
    these. `byte_ns`: what a byte takes on the line; 0: all bytes of a piece have the time of the
    last one. The others are those of `canser_timing` and `canser_trust`.

    Which turn of its 32-bit counter a device's clock is in is told by the arrivals. It is right as
    long as these are late by less than half a turn, what two clocks differ by after a silence
    included: by 35.8 minutes of microseconds, 24.9 days of milliseconds, 2.1 s of nanoseconds
    (50 ppm make that in 11.9 hours). Frames that are later may be whole turns off; and, if more
    than 15 come together, all behind them.
    """

    def __init__(
        self,
        tick_ns: int,
        byte_ns: float,
        *,
        keeps_device: bool = False,
        silence_ns: int = 0,
        bucket_ns: int = 0,
        bucket_least: int = 0,
        early_ns: int = 0,
    ) -> None:
        self._timing = ffi.new(
            "canser_timing *",
            {
                "tick_ns": tick_ns,
                "byte_ns": min(byte_ns, lib.CANSER_BYTE_NS_MAX),
                "keeps_device": keeps_device,
                "silence_ns": silence_ns,
                "bucket_ns": bucket_ns,
                "bucket_least": bucket_least,
                "bucket_most": _MOST,
            },
        )
        self._timing.trust.early = early_ns
        self._samples = np.empty(0, _SAMPLE_DTYPE)
        if tick_ns and not keeps_device:
            self._make_room()

    def assign(self, pieces: Pointer, piece_count: int, room: FrameRoom, count: int) -> int:
        """Give frames of the room their times, up to `count`; return BUCKET, SILENCE, or 0.

        `pieces`: as `pieces_at` returns it. With device times the offsets of the room count, else
        where its frames end.
        """
        timing = self._timing
        while True:
            at = room.ends_at if timing.tick_ns == 0 else room.offsets_at
            status = lib.canser_timing_assign(
                timing, pieces, piece_count, at, room.frames_at, count, room.timed_at
            )
            if status:
                raise_status(status)
            stopped: int = timing.stopped
            if stopped != lib.CANSER_TIMING_FULL:
                return stopped
            self._make_room()

    def set_byte_time(self, byte_ns: float) -> None:
        """Set what a byte takes on the line."""
        self._timing.byte_ns = byte_ns

    def set_line(self, device: int, host: int, drift: float) -> None:
        """Have the host's time be `host` when the device's is `device`."""
        line = self._timing.line
        line.device, line.host, line.drift = device, host, drift
        self._timing.has_line = 1

    def forget_line(self) -> None:
        """Have frames keep their arrivals."""
        self._timing.has_line = 0

    def trust(self, reached: int, late_ns: int) -> None:
        """Say which times of the line are believed.

        `reached`: a device time of the past. `late_ns`: how far a host time may lie before its
        arrival.
        """
        self._timing.trust.reached, self._timing.trust.late = reached, late_ns

    def stop_at(self, count: int | None) -> None:
        """Let so many samples be enough; None: as many as a bucket takes."""
        self._timing.bucket_most = _MOST if count is None else count

    def take_samples(self) -> npt.NDArray[np.void]:
        """Return the samples, good until the next `assign`: `device`, `arrival`, `counted`."""
        count = self._timing.sample_count
        self._timing.sample_count = 0
        return self._samples[:count]

    def drop_samples(self) -> None:
        """Forget the samples, and the frames of the piece at hand."""
        self._timing.sample_count = self._timing.least_late.count = 0

    def _make_room(self) -> None:
        samples = np.empty(max(64, 2 * len(self._samples)), _SAMPLE_DTYPE)
        samples[: len(self._samples)] = self._samples
        self._samples = samples
        self._timing.samples = ffi.from_buffer("canser_sample[]", samples)
        self._timing.sample_cap = len(samples)
