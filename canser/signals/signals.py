"""Signals: what decoding with a database returns."""

import datetime as dt
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from canser.signals.report import DecodeReport
from canser.signals.resample import resample

__all__ = ["Group", "Resampled", "Signal", "Signals", "find_signal"]


class _Reports(Protocol):
    """Has a report."""

    @property
    def report(self) -> DecodeReport: ...


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Signal:
    """The samples of one signal, given by `Signals`.

    Attributes
    ----------
    name : str
        The name in the database.
    message : str
        The name of its message.
    group : str
        The name of its group: signals of a group share their times.
    ts : array of datetime64[ns], shape (n,)
        The times of the frames. They start in 1970 if the times of the frames are no dates.
    values : array of int64, uint64 or float64, shape (n,)
        Physical values. Whole numbers if scale and offset are whole and all values fit.
    unit : str
        The unit, "" if the database has none.
    choices : mapping of int to str, or None
        The texts of raw values.
    raw : array of int64, uint64 or float64, shape (n,), or None
        The values before scale and offset, if they were asked for.
    valid : array of bool, shape (n,), or None
        After `resample`: where there is a value. Otherwise None, as all samples have one.
    """

    name: str
    message: str
    group: str
    ts: npt.NDArray[np.datetime64]
    values: npt.NDArray[Any]
    unit: str = ""
    choices: Mapping[int, str] | None = None
    raw: npt.NDArray[Any] | None = None
    valid: npt.NDArray[np.bool_] | None = None

    @property
    def full_name(self) -> str:
        """The message and the name, with a point between."""
        return f"{self.message}.{self.name}"

    def __len__(self) -> int:
        return len(self.values)

    def __repr__(self) -> str:
        unit = f", {self.unit}" if self.unit else ""
        return f"<canser.Signal {self.full_name}{unit}: {len(self):,} samples>"


class Group(Mapping[str, Signal]):
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
        self.name, self.message, self.ts = name, message, ts
        self._signals = dict(signals)

    def __getitem__(self, name: str) -> Signal:
        return find_signal(self._signals, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._signals)

    def __len__(self) -> int:
        return len(self._signals)

    def __repr__(self) -> str:
        return f"<canser.Group {self.name}: {len(self)} signals, {len(self.ts):,} samples>"


class Signals(Mapping[str, Signal]):
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
        source: DecodeReport | _Reports,
        columns: Mapping[str, npt.NDArray[np.uint64]] = MappingProxyType({}),
    ) -> None:
        self.groups = dict(groups)
        self._source = source
        #: The columns of each group, to be used again: times, and values.
        self._columns = columns
        self._signals = {
            signal.full_name: signal for group in groups.values() for signal in group.values()
        }

    @property
    def report(self) -> DecodeReport:
        """What was decoded so far, and what was not, and why."""
        source = self._source
        return source if isinstance(source, DecodeReport) else source.report

    def __getitem__(self, name: str) -> Signal:
        return find_signal(self._signals, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._signals)

    def __len__(self) -> int:
        return len(self._signals)

    def __contains__(self, name: object) -> bool:
        try:
            self[name]  # type: ignore[index]
        except (KeyError, TypeError):
            return False
        return True

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
        >>> frames = canser.frames("123#401F01", "123#602001")
        >>> frames["ts"] = [0, 25_000_000]
        >>> signals = canser.Database("car.dbc").decode(frames)
        >>> signals.resample("10ms")["RPM"].values
        array([2000., 2000., 2000.])
        >>> signals.resample("10ms", how="linear")["RPM"].values
        array([2000. , 2028.8, 2057.6])
        >>> signals.resample("10ms", max_age="15ms")["RPM"].valid
        array([ True,  True, False])
        """
        return Resampled(*resample(self, self.groups, grid, how, max_age))

    def __repr__(self) -> str:
        return f"<canser.Signals: {len(self)} in {len(self.groups)} groups>"


class Resampled(Mapping[str, Signal]):
    """Signals on one time base, by their names: made by `Signals.resample`.

    Names are those of `Signals`. Each signal has `valid`, an array of bool, shape (n,): False where
    it has no value. There its value is NaN in float64, and 0 in whole numbers.

    Attributes
    ----------
    ts : array of datetime64[ns], shape (n,)
        The times, which all signals share.
    """

    def __init__(self, ts: npt.NDArray[np.datetime64], signals: Mapping[str, Signal]) -> None:
        self.ts = ts
        self._signals = dict(signals)

    def __getitem__(self, name: str) -> Signal:
        return find_signal(self._signals, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._signals)

    def __len__(self) -> int:
        return len(self._signals)

    def __contains__(self, name: object) -> bool:
        try:
            self[name]  # type: ignore[index]
        except (KeyError, TypeError):
            return False
        return True

    def __repr__(self) -> str:
        return f"<canser.Resampled: {len(self)} signals, {len(self.ts):,} times>"


def find_signal(signals: Mapping[str, Signal], name: str) -> Signal:
    """Return a signal by its full name, or by the end of it that only one has."""
    if name in signals:
        return signals[name]
    found = [each for each in signals if each.rpartition(".")[2] == name]
    if len(found) == 1:
        return signals[found[0]]
    if found:
        raise KeyError(f"{name!r} is in several messages: {', '.join(found)}")
    raise KeyError(f"no signal {name!r} was decoded")
