"""Signals: what decoding with a database returns."""

import datetime as dt
from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol

import numpy as np
import numpy.typing as npt

from canser.signals.named import Made, Named
from canser.signals.parts import places_of
from canser.signals.report import DecodeReport
from canser.signals.resample import resample
from canser.signals.signal import Signal
from canser.tables.signals import ManyTables, OneTable

__all__ = ["Group", "Resampled", "Signals"]


class _Source(Protocol):
    """What has decoded signals."""

    @property
    def report(self) -> DecodeReport: ...

    def why_absent(self, name: str) -> str: ...


class Group(OneTable, Named):
    """Signals that share their times, by their names; given by `Signals.groups`.

    They are those of a message that are always there, or those of one page of it.

    Attributes
    ----------
    name : str
        The name of the message, and what tells the group apart, such as "M[Page=1]".
    message : str
        The name of the message.
    ts : array of datetime64[ns], shape (n,)
        The times.
    """

    def __init__(
        self,
        name: str,
        message: str,
        ts: npt.NDArray[np.datetime64],
        signals: Mapping[str, Signal],
    ) -> None:
        super().__init__(signals)
        self.name, self.message, self.ts = name, message, ts

    def __repr__(self) -> str:
        return f"<canser.Group {self.name}: {len(self)} signals, {len(self.ts):,} samples>"


class Signals(ManyTables, Named, Mapping[str, Signal]):
    """Signals by their names, returned by `Database.decode`.

    A name is "Message.Signal", or "Signal" where only one message has it.

    Attributes
    ----------
    groups : mapping of str to Group
        The same signals by the groups that share their times.
    """

    def __init__(
        self,
        groups: Mapping[str, Group],
        source: DecodeReport | _Source,
        columns: Mapping[str, npt.NDArray[np.uint64]] = MappingProxyType({}),
        places: Mapping[str, tuple[str, str]] | None = None,
    ) -> None:
        if places is None:
            places = places_of({name: (group.message, group) for name, group in groups.items()})
        # It has no reference to this object: that would be a cycle, which holds the memory on.
        super().__init__(Made(places, lambda place: groups[place[0]][place[1]]))
        self.groups = dict(groups)
        self._source = source
        #: The columns of each group, to be used again: times, and values.
        self._columns = columns

    @property
    def report(self) -> DecodeReport:
        """What was decoded so far, and what was not, and why."""
        source = self._source
        return source if isinstance(source, DecodeReport) else source.report

    def _absent(self, name: str) -> str:
        why_absent = getattr(self._source, "why_absent", None)  # a report does not tell it
        return (why_absent and why_absent(name)) or super()._absent(name)

    def resample(
        self,
        grid: "str | int | dt.timedelta | np.timedelta64 | Signal | Group | npt.ArrayLike",
        *,
        how: str = "previous",
        max_age: str | int | dt.timedelta | np.timedelta64 | None = None,
    ) -> "Resampled":
        """Return all signals on one time base.

        Parameters
        ----------
        grid : str, int, timedelta, timedelta64, Signal, Group or array
            The times at which values are wanted:

            - a step: a text such as "10ms", "100us" or "1s", whole nanoseconds, or a timedelta.
              The times are the multiples of the step since 1970, from the earliest sample of all
              signals to the latest one;
            - a signal or a group, or the name of one of these signals or groups: its own times;
            - an array of datetime64, or of int64 in nanoseconds, shape (n,), which rises. Equal
              times are allowed.
        how : {"previous", "linear"}, optional
            "previous": the value of the last sample at or before a time. "linear": the value on the
            line from that sample to the next one, as float64; there is none behind the last sample.
            Signals with choices keep "previous": between two texts there is none.
        max_age : str, int, timedelta or timedelta64, optional
            A length of time, as for a step. "previous": the oldest sample that counts. "linear":
            between two samples that are further apart, there is no value. By default, there is no
            limit.

        Returns
        -------
        Resampled
            The signals by the same names, in new arrays. Where a signal has no value, `valid` is
            False, and its value is NaN in float64, and 0 in whole numbers. `raw` is left out where
            values are on lines.

        Raises
        ------
        TypeError
            `grid` or `max_age` is of another type.
        ValueError
            A sample or a time of the grid is NaT, an array does not rise or is not one-dimensional,
            a length of time cannot be read, a step is less than 1 ns or makes a table of more than
            4 GiB, or `how` is unknown.
        KeyError
            `grid` is a text that is neither a length of time nor the name of a signal or a group.

        Notes
        -----
        Times are exact int64 nanoseconds. Of several samples of one time, the last one counts; a
        line that leads to them ends at the first one. If times of a signal go back, such as at a
        restart of the clock, its samples are sorted by time first, and those of one time stay in
        their order. The values of "previous" are those of the samples, bit by bit, also whole
        numbers of 64 bits; lines are computed in float64.

        Examples
        --------
        >>> frames = canser.frames("0A0#1027983A00000003", "0A0#7427983A00000004")
        >>> frames["ts"] = [0, 25_000_000]
        >>> signals = canser.Database("car.dbc").decode(frames)
        >>> signals.resample("10ms")["RPM"].values
        array([2000., 2000., 2000.])
        >>> signals.resample("10ms", how="linear")["RPM"].values
        array([2000., 2008., 2016.])
        >>> signals.resample("10ms", max_age="15ms")["RPM"].valid
        array([ True,  True, False])
        """
        return Resampled(*resample(self, self.groups, grid, how, max_age))

    def __repr__(self) -> str:
        return f"<canser.Signals: {len(self)} in {len(self.groups)} groups>"


class Resampled(OneTable, Named):
    """Signals on one time base, by their names: made by `Signals.resample`.

    Names are those of `Signals`. Each signal has `valid`, an array of bool, shape (n,): False where
    it has no value. There its value is NaN in float64, and 0 in whole numbers.

    Attributes
    ----------
    ts : array of datetime64[ns], shape (n,)
        The times, which all signals share.
    """

    def __init__(self, ts: npt.NDArray[np.datetime64], signals: Mapping[str, Signal]) -> None:
        super().__init__(signals)
        self.ts = ts

    def __repr__(self) -> str:
        return f"<canser.Resampled: {len(self)} signals, {len(self.ts):,} times>"
