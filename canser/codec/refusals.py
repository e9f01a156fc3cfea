"""Frames that a protocol cannot carry: they are left out, and counted by reason."""

import numpy as np

from canser._core.packets import refuse
from canser._core.table import REFUSAL_NAMES, REFUSAL_TIME, find_protocol
from canser._frames import FRAME_DTYPE, FrameArray

__all__ = ["Refusals", "carries"]


def carries(protocol: str, *, ext: bool = False, err: bool = False) -> bool:
    """Return whether a protocol has the frames that are asked for: extended, or error frames."""
    frame = np.zeros(1, FRAME_DTYPE)
    frame["ext"], frame["err"] = ext, err
    return not refuse(find_protocol(protocol), frame).any()


class Refusals:
    """Leave out the frames that a protocol cannot carry, and count them.

    `encode` refuses the same frames. With `times_given` the frames get other times before they are
    encoded, so that an unknown time is no reason.
    """

    def __init__(self, protocol: str, *, times_given: bool = False) -> None:
        self._row = find_protocol(protocol)
        self._times_given = times_given
        self._counts = np.zeros(len(REFUSAL_NAMES), np.int64)

    def keep(self, frames: FrameArray) -> FrameArray:
        """Return the frames that the protocol can carry: `frames` itself, or a new array."""
        reasons = refuse(self._row, frames)
        if self._times_given:
            reasons[reasons == REFUSAL_TIME] = 0
        self._counts += np.bincount(reasons, minlength=len(self._counts))
        return frames.compress(reasons == 0) if reasons.any() else frames

    @property
    def frames(self) -> int:
        """All frames so far, including those that were left out."""
        return int(self._counts.sum())

    @property
    def left_out(self) -> int:
        """The frames that were left out so far."""
        return int(self._counts[1:].sum())

    @property
    def reasons(self) -> str:
        """The reasons and their counts, the largest first: `error frames 2, extended ids 1`."""
        order = np.argsort(-self._counts[1:], kind="stable") + 1
        return ", ".join(
            f"{REFUSAL_NAMES[reason]} {self._counts[reason]:,}"
            for reason in order
            if self._counts[reason]
        )

    def __str__(self) -> str:
        count = self.left_out
        return f"{count:,} frame{'s' * (count != 1)} left out: {self.reasons}"
