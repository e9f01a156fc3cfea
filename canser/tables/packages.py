"""Tables in the packages of others: pyarrow, polars and pandas."""

from collections.abc import Iterator
from importlib import import_module
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser.tables.table import Table

__all__ = ["UNIT", "as_arrow", "as_pandas", "as_polars", "load"]

# The unit of a field, in its metadata. With a point and a name: of one signal in the field.
UNIT: Final = "canser.unit"


def load(name: str) -> Any:
    """Return a package, or raise ModuleNotFoundError with the command that installs it."""
    try:
        return import_module(name)
    except ModuleNotFoundError:
        text = f"{name} is not installed: pip install {name}"
        raise ModuleNotFoundError(text, name=name) from None


def as_arrow(made: Table) -> Any:
    """Return a table of pyarrow, without a copy."""
    return load("pyarrow").table(made)


def as_polars(made: Table) -> Any:
    """Return a DataFrame of polars."""
    return load("polars").DataFrame(made)


def as_pandas(made: Table, *, copy: bool) -> Any:
    """Return a DataFrame of pandas; without a copy the table is handed to no other program."""
    pd = load("pandas")
    arrays = {name: made[name] for name in made.names} if copy else made.own()
    columns = {name: _series(pd, made, name, values) for name, values in arrays.items()}
    frame = pd.DataFrame(columns, copy=copy)
    units = dict(_units(made))
    if units:
        frame.attrs["units"] = units
    return frame


def _units(made: Table) -> Iterator[tuple[str, str]]:
    """Yield the units of columns, or of the signals in a column, by their names."""
    for name in made.names:
        for key, unit in made.metadata(name).items():
            if key == UNIT:
                yield name, unit
            elif key.startswith(f"{UNIT}."):
                yield key.removeprefix(f"{UNIT}."), unit


def _series(pd: Any, made: Table, name: str, values: npt.NDArray[Any]) -> Any:
    """Return a column as pandas takes it."""
    if values.dtype.kind == "M":
        return pd.DatetimeIndex(values).tz_localize("UTC")
    if values.ndim == 2:
        is_binary = made.format(name).startswith("w:")
        return values.view(f"V{values.shape[1]}")[:, 0].tolist() if is_binary else values.tolist()
    null, coded = ~made.valid(name), made.codes(name)
    if coded is not None:
        return pd.Categorical.from_codes(np.where(null, -1, coded[0]), coded[1])
    if not null.any() or values.dtype.kind == "m":
        return values
    if values.dtype.kind == "f":
        return np.where(null, np.nan, values)
    arrays = pd.arrays
    return (arrays.BooleanArray if values.dtype.kind == "b" else arrays.IntegerArray)(values, null)
