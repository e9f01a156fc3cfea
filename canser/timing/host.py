"""The host's clock, which does not step, and a watch for steps of the system's clock."""

import functools
import sys
import time
from collections.abc import Callable
from typing import Final

__all__ = ["ClockSteps", "HostClock", "describe_step"]

# The least step of the system's clock that is reported. Smaller ones are corrections by a network
# time service, which mostly changes the clock's rate instead.
_STEP_NS: Final = 1_000_000_000


class HostClock:
    """A clock of epoch nanoseconds that goes on evenly when the system's clock is set."""

    def __init__(self) -> None:
        self._steady: Callable[[], int] = time.monotonic_ns
        if sys.platform == "linux":
            # This clock goes on while the machine sleeps. Linux's monotonic clock does not.
            self._steady = functools.partial(time.clock_gettime_ns, time.CLOCK_BOOTTIME)
        self._base = time.time_ns() - self._steady()

    def __call__(self) -> int:
        """Return the time."""
        return self._base + self._steady()


class ClockSteps:
    """Notices when the system's clock is set while another one goes on evenly."""

    def __init__(self, clock: Callable[[], int]) -> None:
        self._clock = clock
        #: How far the system's clock was ahead of the other one at the last step, in nanoseconds.
        self.ahead_ns = 0

    def look(self) -> int:
        """Return by how many nanoseconds the system's clock was set since the last call; mostly 0.

        Steps of less than a second give 0.
        """
        ahead_ns = time.time_ns() - self._clock()
        step_ns = ahead_ns - self.ahead_ns
        if abs(step_ns) <= _STEP_NS:
            return 0
        self.ahead_ns = ahead_ns
        return step_ns


def describe_step(step_ns: int) -> str:
    """Return a text that says by how much the system's clock was set."""
    return (
        f"the host's clock was set {'forward' if step_ns > 0 else 'back'} by "
        f"{abs(step_ns) / 1e9:,.1f} s"
    )
