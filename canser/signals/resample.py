"""Signals on one time base: what `Signals.resample` does.

Signals have their times in groups, and each group is brought into order once. All times are int64
nanoseconds, and no difference of them is made that may not fit.
"""

import dataclasses
import datetime as dt
from collections.abc import Mapping
from typing import Any, ClassVar, Final, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from canser._checks import choice, type_name
from canser._core.arrow import shared_empty
from canser._core.resample import Grid, are_rising, resample_linear, resample_previous
from canser._frames import NO_TIME, refuse_mask
from canser._quantities import LONGEST_S, is_duration, parse_ns

__all__ = ["resample"]

# The most memory of a grid that is made by a step. Otherwise one false time, years ahead, would
# fill all of it.
_BYTES_MOST: Final = 4 << 30

_LONGEST_NS: Final = LONGEST_S * 10**9
_HOW: Final = ("previous", "linear")

_DTYPES: Final = (np.dtype(np.int64), np.dtype(np.uint64), np.dtype(np.float64))

_Times = npt.NDArray[np.int64]


class Sampled(Protocol):
    """What is used of a signal. `Signal` is on a floor above this module."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]

    @property
    def ts(self) -> npt.NDArray[np.datetime64]:
        """Times."""

    @property
    def values(self) -> npt.NDArray[Any]:
        """Physical values."""

    @property
    def choices(self) -> Mapping[int, str] | None:
        """Texts of raw values."""

    @property
    def raw(self) -> npt.NDArray[Any] | None:
        """Raw values."""


_Signal = TypeVar("_Signal", bound=Sampled)


class _Ordered:
    """The times of a group, rising; and how the samples are brought into their order."""

    def __init__(self, ts: npt.NDArray[np.datetime64], name: str) -> None:
        times = _as_int(ts)
        self._order = None if are_rising(times) else np.argsort(times, kind="stable")
        self.times = self.bring(times)
        if len(times) and self.times[0] == NO_TIME:
            raise ValueError(
                f"{np.count_nonzero(times == NO_TIME):,} of {len(times):,} samples of {name} have "
                "no time; leave out frames without a time with canser.between(frames)"
            )

    def bring(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return values in the order of the times, contiguous."""
        return np.ascontiguousarray(values if self._order is None else values[self._order])


def resample(
    signals: Mapping[str, _Signal],
    groups: Mapping[str, Any],
    grid: Any,
    how: str,
    max_age: Any,
) -> tuple[npt.NDArray[np.datetime64], dict[str, _Signal]]:
    """Return the times of the grid, and all signals on it; see `Signals.resample`."""
    how = choice(how, "how", _HOW)
    max_age_ns = None if max_age is None else _duration_ns(max_age, "max_age", 0)
    ordered: dict[tuple[int, ...], _Ordered] = {}
    ordered_of = {}
    for name, signal in signals.items():
        _check(signal, name)
        # Signals of a group share the memory of their times.
        place = (signal.ts.__array_interface__["data"][0], len(signal.ts), *signal.ts.strides)
        if place not in ordered:
            ordered[place] = _Ordered(signal.ts, name)
        ordered_of[name] = ordered[place]
    lines = {name for name, signal in signals.items() if how == "linear" and not signal.choices}
    raw_count = sum(signals[name].raw is not None for name in signals.keys() - lines)
    made = _make_grid(grid, signals, groups, list(ordered.values()), 8 * raw_count)
    times = made.times
    if times is None:
        # np.arange(first, end, step) fails where the end is behind the last time of int64.
        times = shared_empty(made.count, np.int64)
        times[:] = np.arange(made.count)
        times *= made.step
        times += made.first
    ts = times.view("M8[ns]")
    # Signals with the same times have values at the same places.
    valid_of: dict[tuple[int, bool], npt.NDArray[np.bool_]] = {}
    found = {}
    for name, signal in signals.items():
        own, is_line, raw = ordered_of[name], name in lines, None
        if (key := (id(own), is_line)) not in valid_of:
            valid_of[key] = np.empty(made.count, np.bool_)
        valid = valid_of[key]
        whole = own.bring(signal.values.astype(np.float64) if is_line else signal.values)
        values = shared_empty(made.count, whole.dtype)
        work = resample_linear if is_line else resample_previous
        work((own.times, whole), made, max_age_ns, (values, valid))
        if signal.raw is not None and not is_line:
            raw = np.empty(made.count, signal.raw.dtype)
            resample_previous((own.times, own.bring(signal.raw)), made, max_age_ns, (raw, valid))
        found[name] = dataclasses.replace(signal, ts=ts, values=values, raw=raw, valid=valid)
    return ts, found


def _check(signal: Sampled, name: str) -> None:
    """Raise for a signal that the caller has made wrongly: C relies on the sizes of arrays."""
    for what, array in (("values", signal.values), ("raw values", signal.raw)):
        if array is not None and array.dtype not in _DTYPES:
            raise TypeError(
                f"{what} of {name} are {array.dtype}; they must be int64, uint64 or float64"
            )
        if array is not None and array.shape != (len(signal.ts),):
            raise ValueError(
                f"{name} has {len(signal.ts):,} times, and the shape of its {what} is "
                f"{array.shape}; give as many"
            )
    if signal.ts.dtype != "M8[ns]" or signal.ts.ndim != 1:
        raise TypeError(f"times of {name} are {type_name(signal.ts)}; they must be datetime64[ns]")


def _make_grid(
    grid: Any,
    signals: Mapping[str, Any],
    groups: Mapping[str, Any],
    ordered: list[_Ordered],
    raw_bytes: int,
) -> Grid:
    """Return the grid that a step, a name, a signal or an array asks for."""
    if isinstance(grid, str) and not is_duration(grid):
        grid = _named(grid, signals, groups)
    if _is_duration(grid):
        row_bytes = 8 + 9 * len(signals) + raw_bytes
        return _regular(_duration_ns(grid, "grid", 1), ordered, _BYTES_MOST // row_bytes)
    ts = getattr(grid, "ts", None)
    times = _Ordered(ts, "the grid").times.copy() if isinstance(ts, np.ndarray) else _given(grid)
    return Grid(len(times), times=times)


def _named(name: str, signals: Mapping[str, Any], groups: Mapping[str, Any]) -> Any:
    """Return the signal or the group of a name."""
    try:
        return signals[name]
    except KeyError as error:
        if name in groups:
            return groups[name]
        raise KeyError(f"{error.args[0]}; a step is a text such as 10ms") from None


def _regular(step: int, ordered: list[_Ordered], rows_most: int) -> Grid:
    """Return all multiples of the step from the first sample to the last one."""
    spans = [(int(own.times[0]), int(own.times[-1])) for own in ordered if len(own.times)]
    if not spans:
        return Grid(0)
    earliest, latest = min(first for first, _ in spans), max(last for _, last in spans)
    first = -(-earliest // step) * step
    count = max(latest // step * step - first + step, 0) // step
    if not count:
        return Grid(0)
    if count > rows_most:
        begin, end = np.datetime64(earliest, "ns"), np.datetime64(latest, "ns")
        raise ValueError(
            f"a step of {step / 1e6:g} ms makes {count:,} rows from {begin} to {end}, and "
            f"{rows_most:,} rows are the most, which take {_BYTES_MOST >> 30} GiB; give a longer "
            "step, leave out frames of false times with canser.between, or give an array of times"
        )
    return Grid(count, first, step)


def _given(times: Any) -> _Times:
    """Return times that the caller gives as an array, checked."""
    refuse_mask(times, "grid")
    array = np.asarray(times)
    if array.dtype.kind not in "Miu" or array.ndim == 0:
        what = type_name(array) if array.ndim else type_name(times)
        raise TypeError(
            "grid must be a step such as 10ms, the name of a signal, a signal, or an array of "
            f"datetime64 or of whole nanoseconds, not {what}"
        )
    if array.ndim != 1:
        raise ValueError(f"the grid has {array.ndim} dimensions; it must have one")
    made = _as_int(_exact(array))
    unknown = np.count_nonzero(made == NO_TIME)
    if unknown:
        raise ValueError(f"{unknown:,} of {len(made):,} times of the grid are NaT; leave them out")
    if not are_rising(made):
        index = int(np.flatnonzero(made[1:] < made[:-1])[0]) + 1
        raise ValueError(
            f"time {index} of the grid is before the one in front of it; give np.sort(times)"
        )
    return made


def _exact(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a copy of times as int64 or datetime64[ns], or raise where they do not fit."""
    if array.dtype.kind == "M":
        exact = array.astype("M8[ns]")
        # numpy cuts what does not fit, in silence.
        fits = np.array_equal(exact.astype(array.dtype), array, equal_nan=True)
    else:
        exact = array.astype(np.int64)
        fits = array.dtype.kind == "i" or not (array > np.iinfo(np.int64).max).any()
    if not fits:
        raise ValueError(
            "times of the grid are not whole nanoseconds within 292 years of 1970; give others"
        )
    return exact


def _as_int(ts: npt.NDArray[Any]) -> _Times:
    """Return times in nanoseconds as contiguous int64."""
    return np.ascontiguousarray(ts).view(np.int64)


def _is_duration(value: Any) -> bool:
    if isinstance(value, bool | np.bool_):
        return False
    return isinstance(value, str | int | np.integer | dt.timedelta | np.timedelta64)


def _duration_ns(value: Any, name: str, least: int) -> int:
    """Return a length of time in nanoseconds, of at least so many."""
    if not _is_duration(value):
        raise TypeError(
            f"{name} must be a text such as 10ms, whole nanoseconds or a timedelta, "
            f"not {type_name(value)}"
        )
    shown = value
    if isinstance(value, dt.timedelta):
        # That of pandas has nanoseconds, which Python's arithmetic cuts off.
        to_numpy = getattr(value, "to_timedelta64", None)
        value = value // dt.timedelta(microseconds=1) * 1_000 if to_numpy is None else to_numpy()
    if isinstance(value, np.timedelta64):
        exact = value.astype("m8[ns]")
        if np.isnat(value) or exact.astype(value.dtype) != value:
            raise ValueError(f"{name} is {shown}; give at most 292 years in whole nanoseconds")
        value = int(exact.astype(np.int64))
    length = parse_ns(value) if isinstance(value, str) else int(value)
    if length < least:
        raise ValueError(f"{name} is {shown}; give {least} ns or more, such as 10ms")
    if length > _LONGEST_NS:
        raise ValueError(f"{name} is {shown}; give {_LONGEST_NS} ns or less, such as 10ms")
    return length
