"""How much goes over a line just now: frames, bytes, and bits of the bus."""

from collections import deque
from typing import Final, NamedTuple

import numpy as np

from canser._frames import FrameArray

__all__ = ["Meter", "Rates", "bus_bits", "longest_bits"]

# Rates are those of this time until now.
_SPAN_S: Final = 1.0

# Bits of a frame without its data, with the pause of three bits behind it (CAN 2.0, 3.1): start 1,
# identifier and control bits 18 or 38, CRC 16, acknowledgement 2, end 7, pause 3.
_STANDARD: Final = 47
_EXTENDED: Final = 67
# An error flag of six bits, its delimiter of eight, and the pause; flags may overlap to more.
_ERROR: Final = 17
_ERROR_LONGEST: Final = 23  # flags that overlap are up to twelve bits (CAN 2.0, 3.1.3)

# Bits of a frame without its data, from the start to the CRC, among which stuff bits may lie. Five
# equal bits are followed by a stuff bit, which counts as the first of the next five (CAN 2.0, 5).
# So the first one stands behind five bits and each further one behind four more: among n bits
# there are (n - 1) // 4 at most.
_STANDARD_STUFFED: Final = 34
_EXTENDED_STUFFED: Final = 54


def bus_bits(frames: FrameArray) -> int:
    """Return the bits that frames take on the bus, without stuff bits.

    Stuff bits depend on the CRC, too, and are up to a fifth more: a load by these bits is a
    lower bound. Remote frames carry no data.
    """
    data = 8 * np.minimum(frames["dlc"], 8).sum(where=~(frames["rtr"] | frames["err"]), dtype=int)
    errors = int(frames["err"].sum())
    extended = int((frames["ext"] & ~frames["err"]).sum())
    standard = len(frames) - errors - extended
    return int(data) + _STANDARD * standard + _EXTENDED * extended + _ERROR * errors


def _longest(byte_count: int, bits: int, stuffed: int) -> int:
    data = 8 * byte_count
    return bits + data + (stuffed + data - 1) // 4


# By whether the frame is extended, and its bytes of data.
_LONGEST: Final = {
    ext: [_longest(byte_count, bits, stuffed) for byte_count in range(9)]
    for ext, bits, stuffed in (
        (False, _STANDARD, _STANDARD_STUFFED),
        (True, _EXTENDED, _EXTENDED_STUFFED),
    )
}


def longest_bits(frames: FrameArray) -> list[int]:
    """Return the bits that each frame takes on the bus at most, with stuff bits.

    Plain numbers: this is for a few frames at a time.
    """
    # Not `frames.tolist()`, which takes 1 microsecond a frame for the payloads.
    fields = [frames[name].tolist() for name in ("ext", "rtr", "err", "dlc")]
    return [
        _ERROR_LONGEST if err else _LONGEST[ext][0 if rtr else min(dlc, 8)]
        for ext, rtr, err, dlc in zip(*fields, strict=True)
    ]


class Rates(NamedTuple):
    """Of the last second."""

    frames: float  # per second
    bytes: float  # per second
    load: float | None  # of the bus, 0 to 1, without stuff bits; None: its bit rate is not known


class Meter:
    """Count what comes, and tell its rates over the last second.

    `bitrate`: of the CAN bus in bit/s, None if it is unknown. Times are seconds of any
    clock that does not step.
    """

    def __init__(self, bitrate: int | None, now: float) -> None:
        self.frames = 0
        self.bits = 0  # on the bus
        self._bitrate = bitrate
        self._samples = deque([(now, 0, 0, 0)])  # time; frames, bytes and bits until then

    def add(self, frames: FrameArray, bytes_in: int, now: float) -> None:
        """Count some frames; `bytes_in`: bytes of the line until now."""
        self.frames += len(frames)
        self.bits += bus_bits(frames)
        self._samples.append((now, self.frames, bytes_in, self.bits))
        while len(self._samples) > 2 and self._samples[1][0] <= now - _SPAN_S:
            self._samples.popleft()

    def rates(self) -> Rates:
        """Return the rates."""
        first, last = self._samples[0], self._samples[-1]
        span = last[0] - first[0]
        frames, held, bits = ((last[i] - first[i]) / span if span > 0 else 0.0 for i in range(1, 4))
        return Rates(frames, held, None if self._bitrate is None else bits / self._bitrate)
