"""Frames in pyarrow, polars, pandas and xarray, and back."""

from typing import Any

import numpy as np
import numpy.typing as npt

from canser._checks import type_name
from canser._core.text import NO_CHANNEL, Codes
from canser._frames import FrameArray
from canser.tables.arrow import arrow_columns
from canser.tables.build import (
    RowError,
    build_frames,
    inverted,
    missing_columns,
    plain_columns,
)
from canser.tables.names import NATIVE, RECEIVED_TITLE, names_in
from canser.tables.packages import as_arrow, as_pandas, as_polars, load
from canser.tables.table import table

__all__ = [
    "from_arrow",
    "from_pandas",
    "from_polars",
    "from_xarray",
    "to_arrow",
    "to_pandas",
    "to_polars",
    "to_xarray",
]

_Records = npt.NDArray[np.void]


def to_arrow(records: _Records, **options: Any) -> Any:
    """Return frames, or other records, as a table of pyarrow.

    Parameters
    ----------
    records : array of FRAME_DTYPE or other records, shape (n,)
        Frames, or another structured array that canser returns.
    **options
        The options of `canser.table`: `channels`, `directions`, `names`, `data`, `id_hex`, `epoch`.

    Returns
    -------
    pyarrow.Table
        The columns of `canser.table`, without a further copy.

    Raises
    ------
    ModuleNotFoundError
        pyarrow is not installed.
    TypeError
        As for `canser.table`; so is ValueError.

    Examples
    --------
    >>> canser.to_arrow(canser.frames("123#01", "124#"))["id"].to_pylist()
    [291, 292]
    """
    return as_arrow(table(records, **options))


def to_polars(records: _Records, **options: Any) -> Any:
    """Return frames, or other records, as a DataFrame of polars.

    Parameters
    ----------
    records : array of FRAME_DTYPE or other records, shape (n,)
        Frames, or another structured array that canser returns.
    **options
        The options of `canser.table`: `channels`, `directions`, `names`, `data`, `id_hex`, `epoch`.

    Returns
    -------
    polars.DataFrame
        The columns of `canser.table`. polars needs no pyarrow for it.

    Raises
    ------
    ModuleNotFoundError
        polars is not installed.
    TypeError
        As for `canser.table`; so is ValueError.

    Examples
    --------
    >>> canser.to_polars(canser.frames("123#01", "124#"))["id"].to_list()
    [291, 292]
    """
    return as_polars(table(records, **options))


def to_pandas(records: _Records, **options: Any) -> Any:
    """Return frames, or other records, as a DataFrame of pandas.

    Parameters
    ----------
    records : array of FRAME_DTYPE or other records, shape (n,)
        Frames, or another structured array that canser returns.
    **options
        The options of `canser.table`: `channels`, `directions`, `names`, `data`, `id_hex`, `epoch`.

    Returns
    -------
    pandas.DataFrame
        The columns of `canser.table`: times as datetime64 in UTC or timedelta64, bytes as objects,
        and columns of uint8 and bool with nulls as pandas' own types with them. It needs no
        pyarrow.

    Raises
    ------
    ModuleNotFoundError
        pandas is not installed.
    TypeError
        As for `canser.table`; so is ValueError.

    Examples
    --------
    >>> canser.to_pandas(canser.frames("123#01", "124#"))["id"].tolist()
    [291, 292]
    """
    return as_pandas(table(records, **options), copy=False)


def to_xarray(records: _Records, **options: Any) -> Any:
    """Return frames, or other records, as a Dataset of xarray.

    Parameters
    ----------
    records : array of FRAME_DTYPE or other records, shape (n,)
        Frames, or another structured array that canser returns.
    **options
        The options of `canser.table`: `channels`, `directions`, `names`, `data`, `id_hex`, `epoch`.

    Returns
    -------
    xarray.Dataset
        A variable for each column of `canser.table`, along the dimension `row`; data along `byte`,
        too. Times are datetime64 or timedelta64. xarray has no nulls: a channel that is not told is
        255, and a direction that is not told is left out.

    Raises
    ------
    ModuleNotFoundError
        xarray is not installed.
    TypeError
        As for `canser.table`; so is ValueError.

    Examples
    --------
    >>> canser.to_xarray(canser.frames("123#01", "124#"))["id"].values
    array([291, 292], dtype=uint32)
    """
    xr = load("xarray")
    made = table(records, **options)
    variables = {}
    for name, values in made.own().items():
        if values.dtype.kind == "b" and not made.valid(name).all():
            continue
        byte = "byte" if values.shape[1:] == (8,) else f"{name}_byte"
        variables[name] = (("row", byte)[: values.ndim], values)
    return xr.Dataset(variables)


def from_arrow(
    source: Any, *, channels: Codes | None = None, directions: Codes | None = None
) -> FrameArray:
    """Return the frames of a table of Arrow, such as one of pyarrow, polars or duckdb.

    Parameters
    ----------
    source : object with __arrow_c_stream__
        A table with the columns of `canser.table`, in any order and by any of its names. `id`,
        `ext`, `dlc` and `data` must be there. Numbers may have any type that holds them.
    channels, directions : array of uint8, shape (n,), optional
        Arrays that are filled: channels, 255 for not told, and directions, 1 for sent.

    Returns
    -------
    array of FRAME_DTYPE, shape (n,)
        A new array.

    Raises
    ------
    ModuleNotFoundError
        pyarrow is not installed.
    TypeError
        `source` is no table of Arrow.
    ValueError
        A column is missing, a row is no frame of classic CAN, or an array to fill has another
        length. The message names the row.

    Examples
    --------
    >>> frames = canser.frames("123#01", "18FEF100#0203")
    >>> (canser.from_arrow(canser.to_arrow(frames)) == frames).all()
    np.True_
    """
    pa = load("pyarrow")
    if not hasattr(source, "__arrow_c_stream__"):
        raise TypeError(f"source must be a table of Arrow, not {type_name(source)}")
    try:
        whole = pa.table(source)
    except pa.ArrowInvalid as error:
        reason = str(error).partition("\n")[0]
        raise TypeError(f"source must be a table of Arrow: {reason}") from None
    titles = _titles(whole.schema.names)
    parts = whole.combine_chunks().to_batches()
    batch = parts[0] if parts else pa.RecordBatch.from_pylist([], whole.schema)
    try:
        columns = arrow_columns(pa, batch, titles)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, pa.ArrowTypeError) as error:
        reason = str(error).partition("\n")[0]
        raise ValueError(f"a column has values of another type: {reason}") from None
    return _built(columns, len(whole), channels, directions)


def from_polars(
    source: Any, *, channels: Codes | None = None, directions: Codes | None = None
) -> FrameArray:
    """Return the frames of a DataFrame of polars; pyarrow is needed for it.

    Parameters
    ----------
    source : polars.DataFrame
        A table with the columns of `canser.table`: see `from_arrow`.
    channels, directions : array of uint8, shape (n,), optional
        Arrays that are filled, as for `from_arrow`.

    Returns
    -------
    array of FRAME_DTYPE, shape (n,)
        A new array.

    Raises
    ------
    ModuleNotFoundError
        pyarrow is not installed.
    TypeError
        `source` is no table.
    ValueError
        As for `from_arrow`.

    Examples
    --------
    >>> frames = canser.frames("123#01", "18FEF100#0203")
    >>> (canser.from_polars(canser.to_polars(frames)) == frames).all()
    np.True_
    """
    return from_arrow(source, channels=channels, directions=directions)


def from_pandas(
    source: Any, *, channels: Codes | None = None, directions: Codes | None = None
) -> FrameArray:
    """Return the frames of a DataFrame of pandas.

    Parameters
    ----------
    source : pandas.DataFrame
        A table with the columns of `canser.table`: see `from_arrow`. Data are bytes or lists of
        numbers.
    channels, directions : array of uint8, shape (n,), optional
        Arrays that are filled, as for `from_arrow`.

    Returns
    -------
    array of FRAME_DTYPE, shape (n,)
        A new array.

    Raises
    ------
    TypeError
        `source` is no DataFrame.
    ValueError
        As for `from_arrow`.

    Examples
    --------
    >>> frames = canser.frames("123#01", "18FEF100#0203")
    >>> (canser.from_pandas(canser.to_pandas(frames)) == frames).all()
    np.True_
    """
    if not hasattr(source, "columns") or not hasattr(source, "to_numpy"):
        raise TypeError(f"source must be a DataFrame of pandas, not {type_name(source)}")
    titles = _titles(list(source.columns))
    columns = {name: _numpy(source[title], title, name) for title, name in titles.items()}
    return _built(plain_columns(columns, titles), len(source), channels, directions)


def _numpy(series: Any, title: str, name: str) -> npt.NDArray[Any]:
    """Return a column of pandas as numpy has it."""
    if hasattr(series.dtype, "pyarrow_dtype"):
        pa = load("pyarrow")
        batch = pa.table({title: series.array.__arrow_array__()}).combine_chunks().to_batches()
        found = arrow_columns(pa, batch[0], {title: name})[name] if batch else np.zeros(0)
        return inverted(found) if title == RECEIVED_TITLE else found
    if name == "ts":
        if getattr(series.dtype, "tz", None) is not None:
            series = series.dt.tz_convert("UTC").dt.tz_localize(None)
    elif series.isna().any():
        if name not in ("channel", "sent"):
            raise RowError(int(np.argmax(series.isna())), f"{title} is null")
        series = series.fillna(NO_CHANNEL if name == "channel" else title == RECEIVED_TITLE)
    values: npt.NDArray[Any] = series.to_numpy()
    if values.dtype == object and name != "data":
        values = values.astype(np.bool_ if name == "sent" else np.int64)
    return values


def from_xarray(
    source: Any, *, channels: Codes | None = None, directions: Codes | None = None
) -> FrameArray:
    """Return the frames of a Dataset of xarray.

    Parameters
    ----------
    source : xarray.Dataset
        Variables with the names of `canser.table`: see `from_arrow`; data of the shape (n, 8).
    channels, directions : array of uint8, shape (n,), optional
        Arrays that are filled, as for `from_arrow`.

    Returns
    -------
    array of FRAME_DTYPE, shape (n,)
        A new array.

    Raises
    ------
    TypeError
        `source` is no Dataset.
    ValueError
        As for `from_arrow`.

    Examples
    --------
    >>> frames = canser.frames("123#01", "18FEF100#0203")
    >>> (canser.from_xarray(canser.to_xarray(frames)) == frames).all()
    np.True_
    """
    if not hasattr(source, "variables"):
        raise TypeError(f"source must be a Dataset of xarray, not {type_name(source)}")
    titles = _titles([str(name) for name in source.variables])
    columns = {name: source[title].values for title, name in titles.items()}
    return _built(plain_columns(columns, titles), len(columns["id"]), channels, directions)


def _titles(have: list[str]) -> dict[str, str]:
    """Return the native names of the columns that are read; ValueError if one is missing."""
    titles = names_in(have)
    for title in titles:
        if have.count(title) > 1:
            raise ValueError(f"there are {have.count(title)} columns {title}; leave one")
    missing = missing_columns(titles.values())
    if missing:
        raise ValueError(
            f"there is no column {', '.join(missing)}; the columns are {', '.join(NATIVE)}, "
            "or those of another choice of names"
        )
    return titles


def _built(
    columns: dict[str, npt.NDArray[Any]],
    count: int,
    channels: Codes | None,
    directions: Codes | None,
) -> FrameArray:
    frames, told, sent = build_frames(columns, count)
    for name, codes, found in (("channels", channels, told), ("directions", directions, sent)):
        if codes is None:
            continue
        if not isinstance(codes, np.ndarray) or codes.dtype != np.uint8:
            raise TypeError(f"{name} must be an array of uint8, not {type_name(codes)}")
        if codes.shape != (count,):
            raise ValueError(f"{name} has the shape {codes.shape}; it must be ({count},)")
        codes[:] = found
    return frames
