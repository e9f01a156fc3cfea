"""Signals as tables: their columns, and the methods by which other packages get them."""

import json
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, Final, NamedTuple, Protocol, cast

import numpy as np
import numpy.typing as npt

from canser._checks import flag
from canser._core.arrow import (
    DICTIONARY,
    NULLS_MASK,
    NULLS_NO_TIME,
    Capsule,
    Column,
    shared_empty,
)
from canser._dates import are_dates
from canser.tables.packages import UNIT, as_arrow, as_pandas, as_polars, load
from canser.tables.records import FORMATS
from canser.tables.table import Table

__all__ = ["ManyTables", "OneTable", "long_table", "signals_table"]

# Raw values are found by their distance from the least one if all are nearer than this to each
# other; else they are sorted.
_SPAN_MOST: Final = 1 << 16

# Up to this number float64 has all whole numbers.
_WHOLE_MOST: Final = 1 << 53

_Array = npt.NDArray[Any]
_Codes = npt.NDArray[np.int32]
_Mask = npt.NDArray[np.bool_]


class _Samples(Protocol):
    """What a table needs of a `Signal`."""

    @property
    def full_name(self) -> str:
        """The message and the name."""

    @property
    def message(self) -> str:
        """The name of the message."""

    @property
    def ts(self) -> npt.NDArray[np.datetime64]:
        """The times."""

    @property
    def values(self) -> _Array:
        """The physical values."""

    @property
    def unit(self) -> str:
        """The unit."""

    @property
    def choices(self) -> Mapping[int, str] | None:
        """The texts of raw values."""

    @property
    def raw(self) -> _Array | None:
        """The raw values; None: they are the physical ones."""

    @property
    def valid(self) -> _Mask | None:
        """Where there is a value; None: everywhere."""


class _Texts(NamedTuple):
    """Texts of samples: different ones, and for each sample the index of its text, or -1."""

    codes: _Codes
    texts: list[str]


def signals_table(ts: npt.NDArray[np.datetime64], signals: Mapping[str, _Samples]) -> Table:
    """Return a table of signals that share their times: `ts`, and a column for each signal.

    Arrays of `shared_empty` are not copied.
    """
    times = ts.view(np.int64)
    dated = are_dates(times)
    columns = [_times(times, dated)]
    columns += [_column(name, signal) for name, signal in _titled(signals)]
    return Table(columns, len(times), dated=dated)


def _titled(signals: Mapping[str, _Samples]) -> Iterator[tuple[str, _Samples]]:
    """Yield signals by the names of their columns: one called `ts` has its full name."""
    for name, signal in signals.items():
        yield (signal.full_name if name == "ts" else name), signal


def _times(times: npt.NDArray[np.int64], dated: bool) -> Column:
    return Column("ts", "tsn:UTC" if dated else "tDn", times, nulls=NULLS_NO_TIME)


def _column(name: str, signal: _Samples) -> Column:
    """Return the column of a signal: numbers, or texts if it has choices."""
    values = signal.values
    column = Column(name, FORMATS[f"{values.dtype.kind}{values.itemsize}"], values)
    if signal.choices:
        codes, texts = _code(signal, decimals=True)
        column = Column(name, "i", codes, DICTIONARY, texts=texts)
    if signal.valid is not None and not signal.valid.all():
        column = column._replace(nulls=NULLS_MASK, mask=signal.valid)
    metadata = {UNIT: signal.unit, "canser.message": signal.message}
    return column._replace(metadata=metadata)


def _code(signal: _Samples, *, decimals: bool) -> _Texts:
    """Return the texts of all choices, by their raw values, and the codes of a signal.

    A value without a text has its decimal text, behind those of the choices; without `decimals`,
    only one that float64 cannot hold. Where there is no value, the code is 0.
    """
    choices = signal.choices or {}
    texts: dict[str, int] = {}
    for number in sorted(choices):
        texts.setdefault(choices[number], len(texts))
    raw = signal.values if signal.raw is None else signal.raw
    codes: _Codes = shared_empty(len(raw), np.int32)
    valid: Any = ... if signal.valid is None or signal.valid.all() else signal.valid
    slots, numbers, values, at = _distinct(raw[valid], signal.values[valid])
    found = np.zeros(slots[-1] + 1 if len(slots) else 1, np.int32)
    for slot, number, value in zip(slots.tolist(), numbers, values, strict=True):
        text = choices.get(number)
        if text is None and (decimals or (isinstance(value, int) and float(value) != value)):
            text = str(value)
        found[slot] = -1 if text is None else texts.setdefault(text, len(texts))
    if valid is ...:
        np.take(found, at, out=codes, mode="clip")
    else:
        codes[:] = 0
        codes[valid] = found[at]
    return _Texts(codes, list(texts))


def _distinct(raw: _Array, values: _Array) -> tuple[_Array, list[Any], list[Any], _Array]:
    """Return slots, one for each raw value that occurs; the raw and the physical value of each.

    The last array has the slot of each sample.
    """
    if len(raw) and raw.dtype.kind in "iu" and int(raw.max()) - int(raw.min()) < _SPAN_MOST:
        least = raw.min()
        at = (raw - least).astype(np.intp)
        there = np.zeros(int(at.max()) + 1, np.bool_)
        there[at] = True
        by_slot = np.empty(len(there), values.dtype)
        by_slot[at] = values
        slots = np.flatnonzero(there)
        numbers = (slots.astype(raw.dtype) + least).tolist()
        return slots, numbers, by_slot[slots].tolist(), at
    different, first, at = np.unique(raw, return_index=True, return_inverse=True)
    return np.arange(len(different)), different.tolist(), values[first].tolist(), at


def long_table(signals: Collection[_Samples]) -> Table:
    """Return a table with a row for each sample: `ts`, `signal`, `value` and `text`.

    Rows are sorted by time; those of one time are in the order of the signals.
    """
    names: dict[str, int] = {}
    texts: dict[str, int] = {}
    parts = []
    for signal in signals:
        name = names.setdefault(signal.full_name, len(names))
        coded = _long_texts(signal)
        # The last one is for the code -1.
        found = [*(texts.setdefault(text, len(texts)) for text in coded.texts), -1]
        codes = np.array(found, np.int32)[coded.codes]
        part = signal.ts, np.full(len(codes), name, np.int32), signal.values, codes
        parts.append(part if signal.valid is None else [each[signal.valid] for each in part])
    dtypes = np.dtype("M8[ns]"), np.dtype(np.int32), np.dtype(np.float64), np.dtype(np.int32)
    joined = [_joined([part[at] for part in parts], dtype) for at, dtype in enumerate(dtypes)]
    order = np.argsort(joined[0], kind="stable")
    ts, name_codes, values, text_codes = (_taken(each, order) for each in joined)
    times = ts.view(np.int64)
    dated = are_dates(times)
    units = {f"{UNIT}.{signal.full_name}": signal.unit for signal in signals}
    columns = [
        _times(times, dated),
        Column("signal", "i", name_codes, DICTIONARY, texts=list(names)),
        Column("value", "g", values, metadata=units),
        Column("text", "i", text_codes, DICTIONARY, NULLS_MASK, text_codes >= 0, list(texts)),
    ]
    return Table(columns, len(order), dated=dated)


def _long_texts(signal: _Samples) -> _Texts:
    """Return the texts of choices, and of whole numbers that float64 would change."""
    if signal.choices:
        return _code(signal, decimals=False)
    values = signal.values
    codes = np.full(len(values), -1, np.int32)
    changed = np.flatnonzero(_changed(values))
    different, at = np.unique(values[changed], return_inverse=True)
    codes[changed] = at
    return _Texts(codes, [str(number) for number in different.tolist()])


def _changed(values: _Array) -> _Mask:
    """Return which whole numbers are others in float64."""
    changed = np.zeros(len(values), np.bool_)
    if values.dtype.kind not in "iu" or not len(values):
        return changed
    if max(abs(int(values.min())), abs(int(values.max()))) <= _WHOLE_MOST:
        return changed
    floats = values.astype(np.float64)
    inside = floats < float(np.iinfo(values.dtype).max)  # which is a power of 2 in float64
    changed[inside] = floats[inside].astype(values.dtype) != values[inside]
    return changed | ~inside


def _joined(parts: list[_Array], dtype: np.dtype[Any]) -> _Array:
    return np.concatenate([np.empty(0, dtype), *parts], dtype=dtype, casting="unsafe")


def _taken(values: _Array, order: npt.NDArray[np.intp]) -> _Array:
    """Return values in an order, in an array of `shared_empty`."""
    taken = shared_empty(len(order), values.dtype)
    return np.take(values, order, out=taken, mode="clip")


def _dataset(ts: npt.NDArray[np.datetime64], signals: Mapping[str, _Samples]) -> Any:
    """Return a Dataset of xarray: a variable for each signal along the times."""
    xr = load("xarray")
    variables = {}
    for name, signal in _titled(signals):
        attrs = {"units": signal.unit, "message": signal.message}
        if signal.choices:
            attrs["choices"] = json.dumps(dict(signal.choices), ensure_ascii=False)
        variables[name] = ("ts", _with_nan(name, signal), attrs)
    times = np.array(ts) if are_dates(ts.view(np.int64)) else np.array(ts).view("m8[ns]")
    return xr.Dataset(variables, coords={"ts": times})


def _with_nan(name: str, signal: _Samples) -> _Array:
    """Return a copy of the values, NaN where there is none."""
    values, valid = signal.values, signal.valid
    if valid is None or valid.all():
        return np.array(values)
    for index in np.flatnonzero(_changed(values) & valid)[:1]:
        raise ValueError(
            f"{name} has samples without a value, for which xarray has NaN only, and the value "
            f"{values[index]}, which float64 cannot hold; leave the signal out, or use to_arrow"
        )
    return np.where(valid, values, np.nan)


def _long_dataset(made: Table) -> Any:
    """Return a long table as a Dataset of xarray."""
    xr = load("xarray")
    columns = {name: made[name] for name in made.names}
    columns["text"] = np.where(made.valid("text"), columns["text"], "")
    return xr.Dataset({name: ("row", np.array(values)) for name, values in columns.items()})


class _Methods:
    """The methods that make tables of other packages."""

    def _tables(self, long: bool) -> Table | dict[str, Table]:
        """Return the table, or one for each group."""
        raise NotImplementedError

    def _datasets(self) -> Any:
        """Return the Dataset of xarray, or one for each group."""
        raise NotImplementedError

    def _each(self, make: Callable[[Table], Any], long: bool) -> Any:
        made = self._tables(flag(long, "long"))
        if isinstance(made, Table):
            return make(made)
        return {name: make(table) for name, table in made.items()}

    def to_arrow(self, *, long: bool = False) -> Any:
        """Return the signals as tables of pyarrow.

        Parameters
        ----------
        long : bool
            Whether there is one table with a row for each sample: `ts`, `signal`, `value` (float64)
            and `text`, sorted by time. `text` is that of the value's choice, and null if there is
            none. A whole number beyond 2**53 that float64 cannot hold is rounded in `value`, and
            its exact decimal text is in `text`. False by default.

        Returns
        -------
        pyarrow.Table, or dict of str to pyarrow.Table
            The column `ts`, and one for each signal, without a copy; of `Signals` a table for each
            group, by its name. Times are dates in UTC if the first known one is from 2000 on, else
            durations. A signal with choices is a dictionary of texts, in which a value without a
            text is its decimal text. The metadata of a field has `canser.unit` and
            `canser.message`; in a long table, those of `value` have `canser.unit.` and the full
            name of each signal.

        Raises
        ------
        ModuleNotFoundError
            pyarrow is not installed.
        """
        return self._each(as_arrow, long)

    def to_polars(self, *, long: bool = False) -> Any:
        """Return the signals as DataFrames of polars.

        Parameters
        ----------
        long : bool
            Whether there is one table with a row for each sample: see `to_arrow`.

        Returns
        -------
        polars.DataFrame, or dict of str to polars.DataFrame
            The columns of `to_arrow`, without a copy; texts are categories. polars has no place for
            units.

        Raises
        ------
        ModuleNotFoundError
            polars is not installed.
        """
        return self._each(as_polars, long)

    def to_pandas(self, *, long: bool = False) -> Any:
        """Return the signals as DataFrames of pandas.

        Parameters
        ----------
        long : bool
            Whether there is one table with a row for each sample: see `to_arrow`.

        Returns
        -------
        pandas.DataFrame, or dict of str to pandas.DataFrame
            The columns of `to_arrow`, as copies. Texts are categories. Where a signal has no value,
            float64 is NaN, and whole numbers are of pandas' own types with nulls. `attrs["units"]`
            has the units by the names of the columns; of a long table, by those of the signals.

        Raises
        ------
        ModuleNotFoundError
            pandas is not installed.
        """
        return self._each(lambda made: as_pandas(made, copy=True), long)

    def to_xarray(self, *, long: bool = False) -> Any:
        """Return the signals as Datasets of xarray.

        Parameters
        ----------
        long : bool
            Whether there is one Dataset with a row for each sample: see `to_arrow`. A text that
            would be null is empty.

        Returns
        -------
        xarray.Dataset, or dict of str to xarray.Dataset
            A variable for each signal along the coordinate `ts`, as copies. Values stay numbers,
            also those with choices. Where a signal has no value, the number is NaN in float64.
            `attrs` of a variable has `units`, `message`, and `choices` as JSON: the texts by raw
            values.

        Raises
        ------
        ModuleNotFoundError
            xarray is not installed.
        ValueError
            A signal without a value for some times has a whole number that float64 cannot hold.
        """
        return self._each(_long_dataset, long) if flag(long, "long") else self._datasets()


class OneTable(_Methods):
    """Signals that share their times: one table, which other programs take by Arrow's capsules."""

    ts: npt.NDArray[np.datetime64]

    def _mapping(self) -> Mapping[str, _Samples]:
        return cast("Mapping[str, _Samples]", self)  # it has the methods of one

    def _tables(self, long: bool) -> Table:
        signals = self._mapping()
        return long_table(signals.values()) if long else signals_table(self.ts, signals)

    def _datasets(self) -> Any:
        return _dataset(self.ts, self._mapping())

    def __arrow_c_schema__(self) -> Capsule:
        return self._tables(long=False).__arrow_c_schema__()

    def __arrow_c_array__(self, requested_schema: Capsule | None = None) -> tuple[Capsule, Capsule]:
        return self._tables(long=False).__arrow_c_array__(requested_schema)

    def __arrow_c_stream__(self, requested_schema: Capsule | None = None) -> Capsule:
        return self._tables(long=False).__arrow_c_stream__(requested_schema)


class ManyTables(_Methods):
    """Signals in groups, each of which is a table."""

    groups: Mapping[str, Any]

    def _tables(self, long: bool) -> Table | dict[str, Table]:
        if long:
            return long_table([each for group in self.groups.values() for each in group.values()])
        return {name: signals_table(group.ts, group) for name, group in self.groups.items()}

    def _datasets(self) -> Any:
        return {name: _dataset(group.ts, group) for name, group in self.groups.items()}
