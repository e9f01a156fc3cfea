"""The groups of a batch: signals that have the same samples, and their tables for C."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canser._core.signals import GROUP_DTYPE
from canser.signals.plans import Plan

__all__ = ["Columns", "Part", "Parts", "places_of"]

# The times of a group, and its values: a row for each column.
Columns = npt.NDArray[np.uint64]

_Records = npt.NDArray[np.void]


class Part(NamedTuple):
    """A group: signals of a page that have the same samples.

    `plans`: how each signal is decoded, and its first column; column 0 is that of the times.
    """

    name: str
    message: str
    plans: dict[str, tuple[Plan, int]]
    least_dlc: int
    column_count: int

    @classmethod
    def of(cls, name: str, message: str, plans: Sequence[Plan]) -> "Part":
        """Return a group of these plans."""
        places, column_count = {}, 1
        for plan in plans:
            places[plan.info.name] = plan, column_count
            column_count += len(plan.records)
        least_dlc = max(plan.least_dlc for plan in plans)
        return cls(name, message, places, least_dlc, column_count)


def places_of(groups: Mapping[str, tuple[str, Iterable[str]]]) -> dict[str, tuple[str, str]]:
    """Return the group of each signal by its full name, and its name there.

    `groups`: the message and the signals of each group.
    """
    return {
        f"{message}.{signal}": (name, signal)
        for name, (message, signals) in groups.items()
        for signal in signals
    }


class Parts:
    """The groups of all batches in which the same signals have the same samples.

    `records` are those of all signals, of SIGNAL_DTYPE. `first_group` and `group_count` tell the
    groups of each page. `places` is that of `places_of`.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        records: _Records,
        first_group: npt.NDArray[np.uint32],
        group_count: npt.NDArray[np.uint32],
    ) -> None:
        self.parts = parts
        self.first_group, self.group_count = first_group, group_count
        self.places = places_of({part.name: (part.message, part.plans) for part in parts})
        plans = [plan for part in parts for plan, _ in part.plans.values()]
        numbers = [plan.first + i for plan in plans for i in range(len(plan.records))]
        self._signals = records.take(np.array(numbers, np.intp))
        counts = np.array([part.column_count - 1 for part in parts], np.intp)
        self._groups = np.zeros(len(parts), GROUP_DTYPE)
        self._groups["signal_count"] = counts
        self._groups["first_signal"] = np.cumsum(counts) - counts
        self._groups["least_dlc"] = [part.least_dlc for part in parts]
        self._group_of = np.repeat(np.arange(len(parts)), counts)
        rows = np.arange(len(numbers)) - self._groups["first_signal"][self._group_of] + 1
        self._row_of = rows.astype(np.uint64)

    def tables(
        self, columns: Sequence[Columns], samples: npt.NDArray[np.uint64]
    ) -> tuple[_Records, _Records]:
        """Return the groups and signals of a batch for C, with their columns and samples."""
        groups, signals = self._groups.copy(), self._signals.copy()
        groups["ts"] = [rows.__array_interface__["data"][0] for rows in columns]
        groups["cap"] = samples
        steps = np.array([rows.strides[0] for rows in columns], np.uint64)
        signals["values"] = groups["ts"][self._group_of] + self._row_of * steps[self._group_of]
        return groups, signals
