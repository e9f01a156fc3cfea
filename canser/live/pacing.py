"""Frames go to an adapter no faster than its bus carries them.

The line to an adapter carries more than its bus: 2 Mbaud three to four times what 500 kbit/s take.
What the adapter has no room for it throws away, and does not tell.
"""

import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import Final

__all__ = ["AHEAD_FRAMES", "Pacer"]

#: The most frames that were handed over and that the bus may not have sent yet.
AHEAD_FRAMES: Final = 16

# Many frames are handed over this many at a time: a thread that wakes for each one would take
# more of a processor, and one that waits for all 16 would leave the bus idle.
_AT_ONCE: Final = AHEAD_FRAMES // 2


class Pacer:
    """When frames may go out to a bus that takes a known time for each. Safe for threads."""

    def __init__(self) -> None:
        # When the bus has sent each of the last frames, by time.monotonic().
        self._ends: deque[float] = deque(maxlen=AHEAD_FRAMES)
        self._lock = threading.Lock()

    def take(self, seconds: Sequence[float], deadline: float | None) -> int:
        """Wait until the first of some frames may go out; return how many may, and count them.

        `seconds`: what each of the frames, one or more, takes on the bus at most. `deadline`: of
        time.monotonic(), None for never; behind it 0 is returned where none may go out.
        """
        wanted = min(len(seconds), _AT_ONCE)
        while True:
            with self._lock:
                now = time.monotonic()
                waiting = [end for end in self._ends if end > now]
                room = AHEAD_FRAMES - len(waiting)
                over = deadline is not None and now >= deadline
                if room >= wanted or over:
                    return self._add(seconds[:room], now)
                pause = waiting[wanted - room - 1] - now
            time.sleep(pause if deadline is None else min(pause, deadline - now))

    def _add(self, seconds: Sequence[float], now: float) -> int:
        """Count frames that go out now, the one behind the other."""
        end = max(self._ends[-1], now) if self._ends else now
        for each in seconds:
            end += each
            self._ends.append(end)
        return len(seconds)
