"""Rates of a line: frames and bytes per second, and the load of the bus."""

from collections import deque
from typing import Final, NamedTuple

from canser._frames import FrameArray
from canser.codec.bits import frame_bits

__all__ = ["Meter", "Rates"]

# Rates are means over this time until now.
_SPAN_S: Final = 1.0


class Rates(NamedTuple):
    """Rates over the last second."""

    #: Frames per second.
    frames: float
    #: Bytes of the line per second.
    bytes: float
    #: Load of the CAN bus by the exact bits of its frames, 0 to 1; None if the bit rate is not
    #: known. Error frames, whose lengths are not known, are left out.
    load: float | None


class Meter:
    """Count frames and bytes, and return their rates over the last second.

    `bitrate`: of the CAN bus in bit/s, None if it is not known. Times are seconds of any clock
    that does not step.
    """

    def __init__(self, bitrate: int | None, now: float) -> None:
        self.frames = 0
        self.bits = 0  # on the bus
        self._bitrate = bitrate
        self._samples = deque([(now, 0, 0, 0)])  # time, and frames, bytes and bits until then

    def add(self, frames: FrameArray, bytes_in: int, now: float) -> None:
        """Count frames; `bytes_in`: all bytes of the line until `now`."""
        self.frames += len(frames)
        self.bits += int(frame_bits(frames).sum())
        self._samples.append((now, self.frames, bytes_in, self.bits))
        while len(self._samples) > 2 and self._samples[1][0] <= now - _SPAN_S:
            self._samples.popleft()

    def rates(self) -> Rates:
        """Return the rates over the last second."""
        first, last = self._samples[0], self._samples[-1]
        span_s = last[0] - first[0]
        frames, byte_rate, bits = (
            (last[i] - first[i]) / span_s if span_s > 0 else 0.0 for i in range(1, 4)
        )
        return Rates(frames, byte_rate, None if self._bitrate is None else bits / self._bitrate)
