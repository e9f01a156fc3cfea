"""The samples of a block in the order of its frames."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from canser._frames import FrameArray, copy_records
from canser.signals.decoder import SignalDecoder
from canser.signals.signal import Signal

__all__ = ["Samples", "numbered_samples", "sample_texts"]

_Places = npt.NDArray[np.int64]


class Samples(NamedTuple):
    """The samples of a block of frames, those of a frame one after the other.

    The samples of frame number i have the places from `ends[i - 1]` to `ends[i]`.
    """

    #: Signals, with the place of each of their samples.
    signals: list[tuple[Signal, _Places]]
    #: For each frame the end of its samples.
    ends: _Places

    @property
    def total(self) -> int:
        """All samples."""
        return int(self.ends[-1]) if len(self.ends) else 0

    def texts(self, make: Callable[[Signal], Callable[[Any, Any], Any]]) -> npt.NDArray[np.object_]:
        """Return for each place what the function of its signal makes of value and raw value."""
        found = np.empty(self.total, object)
        for signal, places in self.signals:
            found[places] = sample_texts(signal, make(signal))
        return found


def numbered_samples(decoder: SignalDecoder, frames: FrameArray) -> Samples:
    """Decode a block; the times of the signals are the numbers of their frames."""
    numbered = copy_records(frames)
    numbered["ts"] = np.arange(len(frames))
    groups = decoder.feed(numbered).groups.values()
    counts = np.zeros(len(frames), np.int64)
    # A group has one sample of a frame at most.
    for group in groups:
        counts[group.ts.view(np.int64)] += len(group)
    ends = np.cumsum(counts)
    free = ends - counts
    signals = []
    for group in groups:
        numbers = group.ts.view(np.int64)
        first = free[numbers]
        free[numbers] += len(group)
        signals += [(signal, first + at) for at, signal in enumerate(group.values())]
    return Samples(signals, ends)


def sample_texts(signal: Signal, make: Callable[[Any, Any], Any]) -> npt.NDArray[np.object_]:
    """Return what `make` makes of each value and raw value; equal ones are made once."""
    raw = signal.values if signal.raw is None else signal.raw
    keys = raw.view(np.uint64)  # the bits: NaN equals NaN, and 0.0 does not equal -0.0
    # Values of a bus mostly stay as they were.
    is_new = np.ones(len(keys), np.bool_)
    np.not_equal(keys[1:], keys[:-1], out=is_new[1:])
    heads = np.flatnonzero(is_new)
    _, first, different = np.unique(keys[heads], return_index=True, return_inverse=True)
    at = heads[first]
    made = np.empty(len(at), object)
    made[:] = list(map(make, signal.values[at].tolist(), raw[at].tolist()))
    texts: npt.NDArray[np.object_] = made[different][np.cumsum(is_new) - 1]
    return texts
