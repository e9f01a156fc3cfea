"""The times of frames: C's work for each frame, and its memory."""

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
    """Return a pointer to rows of stream offsets and times, for C; it keeps the array alive."""
    return ffi.from_buffer("canser_piece[]", rows)


class FrameTiming:
    """Gives the frames of one stream their times; see canser_timing_assign.

    `tick_ns` is the unit of the device's times, 0 if there are none. With `keeps_device` frames
    keep these times. `byte_ns` is the time of a byte on the line; with 0 all bytes of a piece have
    the time of its last byte. The other parameters are those of `canser_timing` and `canser_trust`.

    The device's clock is a 32-bit counter, and the arrivals tell which turn it is in. That is right
    as long as arrivals are late by less than half a turn: by 35.8 minutes of microseconds, 24.9
    days of milliseconds, 2.1 s of nanoseconds. What two clocks differ by after a silence counts,
    too: at 50 ppm the 2.1 s are reached in 11.9 hours. Frames that are later may be whole turns
    off. If more than 15 of them come together, all frames behind them may be, too.
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
        """Give the room's frames up to `count` their times; return BUCKET, SILENCE, or 0.

        `pieces` is a pointer from `pieces_at`. The time of a frame is that of the room's `offsets`
        with device times, else that of its `ends`.
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
        """Set the time of a byte on the line."""
        self._timing.byte_ns = byte_ns

    def set_line(self, device: int, host: int, drift: float) -> None:
        """Set the line: the host's time is `host` when the device's time is `device`."""
        line = self._timing.line
        line.device, line.host, line.drift = device, host, drift
        self._timing.has_line = 1

    def forget_line(self) -> None:
        """Forget the line, so that frames keep their arrivals."""
        self._timing.has_line = 0

    def trust(self, reached: int, late_ns: int) -> None:
        """Set which times of the line are believed.

        `reached` is a device time of the past. `late_ns` is how far a host time may lie before its
        arrival.
        """
        self._timing.trust.reached, self._timing.trust.late = reached, late_ns

    def stop_at(self, count: int | None) -> None:
        """Stop at `count` samples; None: at as many as a bucket takes."""
        self._timing.bucket_most = _MOST if count is None else count

    def take_samples(self) -> npt.NDArray[np.void]:
        """Return the samples, good until the next `assign`: `device`, `arrival`, `counted`."""
        count = self._timing.sample_count
        self._timing.sample_count = 0
        return self._samples[:count]

    def drop_samples(self) -> None:
        """Forget the samples, and the frames of the current piece."""
        self._timing.sample_count = self._timing.least_late.count = 0

    def _make_room(self) -> None:
        samples = np.empty(max(64, 2 * len(self._samples)), _SAMPLE_DTYPE)
        samples[: len(self._samples)] = self._samples
        self._samples = samples
        self._timing.samples = ffi.from_buffer("canser_sample[]", samples)
        self._timing.sample_cap = len(samples)
