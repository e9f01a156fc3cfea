"""Rates of a line: frames and bytes per second, and the load of the bus."""

from collections import deque
from typing import Final, NamedTuple

import numpy as np

from canser._frames import FrameArray

__all__ = ["Meter", "Rates", "bus_bits", "longest_bits"]

# Rates are means over this time until now.
_SPAN_S: Final = 1.0

# Bits of a frame without its data, with the pause of three bits behind it (CAN 2.0, 3.1): start 1,
# identifier and control bits 18 or 38, CRC 16, acknowledgement 2, end 7, pause 3.
_STANDARD: Final = 47
_EXTENDED: Final = 67

# Bits of an error frame: a flag of 6 bits, its delimiter of 8, and the pause of 3. The flags of
# several nodes may overlap, to 12 bits at most (CAN 2.0, 3.1.3).
_ERROR: Final = 17
_ERROR_LONGEST: Final = 23

# Bits of a frame without its data among which stuff bits may lie: from the start to the CRC. A
# stuff bit follows five equal bits, and counts as the first of the next five (CAN 2.0, 5). So the
# first stuff bit comes behind five bits at the earliest, each further one behind four more: among
# n bits there are at most (n - 1) // 4.
_STANDARD_STUFFED: Final = 34
_EXTENDED_STUFFED: Final = 54


def bus_bits(frames: FrameArray) -> int:
    """Return the number of bits that frames take on the bus, without stuff bits.

    So the load of the bus by these bits is a lower bound. Stuff bits depend on the CRC, too, and
    add up to a fifth. Remote frames carry no data.
    """
    data = 8 * np.minimum(frames["dlc"], 8).sum(where=~(frames["rtr"] | frames["err"]), dtype=int)
    errors = int(frames["err"].sum())
    extended = int((frames["ext"] & ~frames["err"]).sum())
    standard = len(frames) - errors - extended
    return int(data) + _STANDARD * standard + _EXTENDED * extended + _ERROR * errors


def _longest(byte_count: int, bits: int, stuffed: int) -> int:
    data = 8 * byte_count
    return bits + data + (stuffed + data - 1) // 4


# The most bits of a frame, by whether it is extended, and its number of data bytes.
_LONGEST: Final = {
    ext: [_longest(byte_count, bits, stuffed) for byte_count in range(9)]
    for ext, bits, stuffed in (
        (False, _STANDARD, _STANDARD_STUFFED),
        (True, _EXTENDED, _EXTENDED_STUFFED),
    )
}


def longest_bits(frames: FrameArray) -> list[int]:
    """Return the most bits that each frame can take on the bus, with stuff bits.

    A list, as this is for a few frames at a time.
    """
    # `frames.tolist()` would take 1 microsecond for the data of each frame.
    fields = [frames[name].tolist() for name in ("ext", "rtr", "err", "dlc")]
    return [
        _ERROR_LONGEST if err else _LONGEST[ext][0 if rtr else min(dlc, 8)]
        for ext, rtr, err, dlc in zip(*fields, strict=True)
    ]


class Rates(NamedTuple):
    """Rates over the last second."""

    #: Frames per second.
    frames: float
    #: Bytes of the line per second.
    bytes: float
    #: Load of the CAN bus, 0 to 1, without stuff bits; None if the bit rate is not known.
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
        self.bits += bus_bits(frames)
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
