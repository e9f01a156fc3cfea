"""Send frames to an adapter no faster than its bus carries them.

Otherwise frames get lost: an adapter throws away frames for which it has no room, and does not
report that. The line to an adapter is faster than the bus: a line of 2 Mbaud carries three to four
times as many frames as a bus of 500 kbit/s.
"""

import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import Final

from canser._frames import FrameArray

__all__ = ["AHEAD_FRAMES", "Pacer", "longest_bits"]

#: The most frames that are given to the adapter, and that the bus may not have sent yet.
AHEAD_FRAMES: Final = 16

# A sender waits until this many frames may go out. A thread that wakes for each frame would take
# more processor time; one that waits until all 16 may go out would leave the bus idle.
_BATCH_FRAMES: Final = AHEAD_FRAMES // 2


# Bits of a frame without its data, with the pause of three bits behind it (CAN 2.0, 3.1): start 1,
# identifier and control bits 18 or 38, CRC 16, acknowledgement 2, end 7, pause 3.
_STANDARD: Final = 47
_EXTENDED: Final = 67

# The most bits of an error frame: flags of several nodes that overlap, 12, their delimiter of 8,
# and the pause of 3 (CAN 2.0, 3.1.3).
_ERROR_LONGEST: Final = 23

# Bits of a frame without its data among which stuff bits may lie: from the start to the CRC. A
# stuff bit follows five equal bits, and counts as the first of the next five (CAN 2.0, 5). So the
# first stuff bit comes behind five bits at the earliest, each further one behind four more: among
# n bits there are at most (n - 1) // 4.
_STANDARD_STUFFED: Final = 34
_EXTENDED_STUFFED: Final = 54


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


class Pacer:
    """When frames may go out to a bus that takes a known time for each. Safe for threads."""

    def __init__(self) -> None:
        # For each of the last frames: when the bus has sent it, by time.monotonic().
        self._ends: deque[float] = deque(maxlen=AHEAD_FRAMES)
        self._lock = threading.Lock()

    def take(self, seconds: Sequence[float], deadline: float | None) -> int:
        """Wait until some of the next frames may go out; return how many, and count them as sent.

        `seconds`: the longest time on the bus of each frame, one or more. `deadline`: of
        time.monotonic(), None for never; after it the call returns 0 if no frame may go out.
        """
        wanted = min(len(seconds), _BATCH_FRAMES)
        while True:
            with self._lock:
                now = time.monotonic()
                waiting = [end for end in self._ends if end > now]
                room = AHEAD_FRAMES - len(waiting)
                is_over = deadline is not None and now >= deadline
                if room >= wanted or is_over:
                    return self._add(seconds[:room], now)
                pause = waiting[wanted - room - 1] - now
            time.sleep(pause if deadline is None else min(pause, deadline - now))

    def _add(self, seconds: Sequence[float], now: float) -> int:
        """Count frames that go out now, one after the other; return how many."""
        end = max(self._ends[-1], now) if self._ends else now
        for each in seconds:
            end += each
            self._ends.append(end)
        return len(seconds)
