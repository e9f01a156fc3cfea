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

__all__ = ["AHEAD_FRAMES", "Pacer"]

#: The most frames that are given to the adapter, and that the bus may not have sent yet.
AHEAD_FRAMES: Final = 16

# A sender waits until this many frames may go out. A thread that wakes for each frame would take
# more processor time; one that waits until all 16 may go out would leave the bus idle.
_BATCH_FRAMES: Final = AHEAD_FRAMES // 2


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
