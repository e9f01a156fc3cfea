"""The faults that a simulated adapter makes on purpose, the same in each run."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

from canser._checks import flag, real, whole

__all__ = ["Faults"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Faults:
    """Faults of a simulated adapter and its line; none by default.

    Raises
    ------
    TypeError
        For a value of another type.
    ValueError
        For a value out of range. The message names the field.

    Examples
    --------
    One byte in 1,000 is damaged, and after 5,000 bytes the adapter is silent for 0.3 s:

    >>> faults = canser.Faults(noise=0.001, stalls=[(5000, 0.3)])
    >>> simulator = canser.Simulator("seeed", faults=faults)
    """

    #: Share of the bytes of the traffic, 0 to 1, that noise damages: of these a third is lost, a
    #: third gets a random byte in front, a third has one bit flipped. Answers are not damaged.
    noise: float = 0
    #: Share of the bytes of the traffic, 0 to 1, that is lost in runs of 1 to 63 bytes. Answers
    #: are not damaged.
    loss: float = 0
    #: Pairs of a number of bytes sent, and the seconds of silence that follow.
    stalls: Sequence[tuple[int, float]] = ()
    #: Number of bytes sent after which the adapter unplugs itself, once the host has read them;
    #: None for never.
    unplug_after: int | None = None
    #: Whether the adapter answers no ping and no request for its status.
    mute: bool = False
    #: Seconds in which the adapter ignores all bytes from the host, after a host has opened the
    #: terminal and after `Simulator.replug`. An analyzer needs some 0.7 s.
    deaf: float = 0
    #: Whether the adapter ignores the first packet after each configuration.
    swallow: bool = False
    #: Seed of noise and loss: the same seed gives the same noise and the same loss.
    seed: int = 1

    def __post_init__(self) -> None:
        for name in ("noise", "loss"):
            share = getattr(self, name)
            if not 0 <= real(share, name, "0.001") <= 1:
                raise ValueError(f"{name} is {share}; it must be a share of the bytes, from 0 to 1")
        if not _are_stalls(self.stalls):
            raise ValueError(
                f"stalls is {self.stalls!r}; it must be pairs of bytes and seconds, 0 or more"
            )
        cut = self.unplug_after
        if cut is not None and whole(cut, "unplug_after", "1000") < 0:
            raise ValueError(f"unplug_after is {cut}; it must be a number of bytes, 0 or more")
        flag(self.mute, "mute")
        if not 0 <= real(self.deaf, "deaf", "0.7") < math.inf:
            raise ValueError(f"deaf is {self.deaf}; it must be a number of seconds, 0 or more")
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
