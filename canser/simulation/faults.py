"""What goes wrong on a simulated line, on purpose and reproducibly."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

from canser._checks import flag, real, whole

__all__ = ["Faults"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Faults:
    """Faults of a simulated adapter and its line; none by default.

    Attributes
    ----------
    noise, loss : float
        Shares of the bytes of the traffic, 0 to 1, that are hit or lost, as
        `canser.simulation.traffic.damage` does it. Answers are spared.
    stalls : sequence of (int, float)
        Pairs of a number of bytes sent, and the seconds of silence then.
    unplug_after : int or None
        Bytes after which the adapter unplugs itself, when the host has read them.
    mute : bool
        Whether the adapter answers no ping and no request for its status.
    deaf : float
        Seconds in which the adapter ignores all that it is sent, after a host has opened it and
        after it was plugged in again. An analyzer needs some 0.7 s.
    swallow : bool
        Whether the adapter ignores the first packet behind each configuration.
    seed : int
        The same seed gives the same noise and loss.

    Raises
    ------
    TypeError, ValueError
        For a value that is not possible, with its name.

    Examples
    --------
    >>> canser.Faults(noise=0.001, stalls=[(5000, 0.3)]).stalls
    [(5000, 0.3)]
    """

    noise: float = 0
    loss: float = 0
    stalls: Sequence[tuple[int, float]] = ()
    unplug_after: int | None = None
    mute: bool = False
    deaf: float = 0
    swallow: bool = False
    seed: int = 1

    def __post_init__(self) -> None:
        for name in ("noise", "loss"):
            share = getattr(self, name)
            if not 0 <= real(share, name, "0.001") <= 1:
                raise ValueError(f"{name} is {share}; it is a share of the bytes, from 0 to 1")
        if not _are_stalls(self.stalls):
            raise ValueError(
                f"stalls are {self.stalls!r}; give pairs of bytes and seconds, 0 or more"
            )
        cut = self.unplug_after
        if cut is not None and whole(cut, "unplug_after", "1000") < 0:
            raise ValueError(f"unplug_after is {cut}; it is a number of bytes")
        flag(self.mute, "mute")
        if not 0 <= real(self.deaf, "deaf", "0.7") < math.inf:
            raise ValueError(f"deaf is {self.deaf}; it is a number of seconds, 0 or more")
        flag(self.swallow, "swallow")
        whole(self.seed, "seed", "1", least=0)


def _are_stalls(stalls: object) -> bool:
    """Return whether these are pairs of a number of bytes and finite seconds, 0 or more."""
    try:
        return all(
            whole(at, "at", "5000") >= 0 and 0 <= real(seconds, "seconds", "2.0") < math.inf
            for at, seconds in cast(Any, stalls)
        )
    except (TypeError, ValueError):
        return False
