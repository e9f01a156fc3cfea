"""Frames and other records as columns of Arrow, which other programs take without a copy."""

from datetime import datetime
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser._checks import flag, type_name
from canser._core.arrow import (
    DICTIONARY,
    FLAGS,
    LIST,
    NULLS_ALL,
    NULLS_NO_CHANNEL,
    NULLS_NO_TIME,
    TEXT,
    Capsule,
    Column,
    Columns,
)
from canser._core.text import NO_CHANNEL, SENT, Codes
from canser._dates import date_ns, is_dated
from canser._frames import (
    FRAME_DTYPE,
    NO_TIME,
    FrameArray,
    check_codes,
    check_frames,
    refuse_mask,
)
from canser.tables.names import NATIVE, check_choice, names_of
from canser.tables.records import record_columns

__all__ = ["COLUMNS", "Table", "hex_ids", "make_table", "table"]

# The columns, in their order. Besides those of FRAME_DTYPE there are `channel` (from 0, null if it
# is not told) and `sent` (null if the direction is not told).
COLUMNS: Final = NATIVE


class Table:
    """Records as columns of Arrow, which never change; made by `table`.

    Any program takes it that knows Arrow's PyCapsule interface. The columns of frames are `ts`
    (null if it is not known), `channel` (null if it is not told), `sent` (null if it is not told),
    `id`, `ext`, `rtr`, `err`, `dlc` and `data` (always 8 bytes).

    `table["id"]` is a column as a numpy array, read-only and without a copy, which keeps the
    memory. A time is datetime64 or timedelta64, NaT if it is not known. Columns of bool and text
    are copies. Other nulls are in `valid`.
    """

    def __init__(self, columns: list[Column], count: int, *, dated: bool) -> None:
        self._columns = Columns(columns, count)
        self._names = [column.name for column in columns]
        self._formats = [column.format for column in columns]
        self._texts = {each.name: each.values for each in columns if each.kind == TEXT}
        self._words = {each.name: list(each.texts) for each in columns if each.kind == DICTIONARY}
        self._metadata = {each.name: dict(each.metadata or {}) for each in columns}
        self._dated = dated

    def __len__(self) -> int:
        return len(self._columns)

    @property
    def names(self) -> list[str]:
        """The names of the columns, in their order."""
        return list(self._names)

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        return self._view(name, writeable=False)

    def _view(self, name: str, *, writeable: bool) -> npt.NDArray[Any]:
        index = self._find(name)
        if name in self._texts:
            return self._texts[name].astype(str)
        values = self._columns.view(index, writeable=writeable)
        if name in self._words:
            texts: npt.NDArray[Any] = np.array(self._words[name] or [""])[values]
            return texts
        if self._formats[index] == "b":
            return np.unpackbits(values, count=len(self), bitorder="little").astype(np.bool_)
        if self._formats[index].startswith("ts"):
            return values.view("M8[ns]")
        return values.view("m8[ns]") if self._formats[index].startswith("tD") else values

    def own(self) -> dict[str, npt.NDArray[Any]]:
        """Return all columns as arrays that may be written to, without a further copy.

        For a table that is handed to no other program.

        Returns
        -------
        dict of str to array
            The columns, in their order.
        """
        return {name: self._view(name, writeable=True) for name in self._names}

    def valid(self, name: str) -> npt.NDArray[np.bool_]:
        """Return for each value of a column whether it is not null.

        Parameters
        ----------
        name : str
            The name of the column.

        Returns
        -------
        array of bool, shape (n,)
            A new array.

        Raises
        ------
        KeyError
            There is no such column.
        """
        return self._columns.valid(self._find(name))

    def format(self, name: str) -> str:
        """Return the type of a column as Arrow spells it, such as "I" for uint32.

        Parameters
        ----------
        name : str
            The name of the column.

        Returns
        -------
        str
            The format: see arrow.apache.org/docs/format/CDataInterface.html.

        Raises
        ------
        KeyError
            There is no such column.
        """
        return self._formats[self._find(name)]

    def codes(self, name: str) -> tuple[npt.NDArray[np.int32], list[str]] | None:
        """Return a column of texts as a view of indices, and the texts; None: it has others.

        For this package's own use, as `metadata`.
        """
        if name not in self._words:
            return None
        return self._columns.view(self._find(name)), self._words[name]

    def metadata(self, name: str) -> dict[str, str]:
        """Return the metadata of a column, for this package's own use."""
        return dict(self._metadata[name])

    def _find(self, name: str) -> int:
        try:
            return self._names.index(name)
        except ValueError:
            raise KeyError(f"no column {name!r}; there are {', '.join(self._names)}") from None

    def __repr__(self) -> str:
        times = "dates in UTC" if self._dated else "durations"
        return f"<canser.Table of {len(self):,} rows, times are {times}>"

    def __arrow_c_schema__(self) -> Capsule:
        return self._columns.schema()

    def __arrow_c_array__(
        self,
        requested_schema: Capsule | None = None,
    ) -> tuple[Capsule, Capsule]:
        return self._columns.schema(), self._columns.array()

    def __arrow_c_stream__(
        self,
        requested_schema: Capsule | None = None,
    ) -> Capsule:
        return self._columns.stream()


def table(
    records: npt.NDArray[np.void],
    *,
    channels: Codes | None = None,
    directions: Codes | None = None,
    names: str = "native",
    data: str = "binary",
    id_hex: bool = False,
    epoch: datetime | None = None,
) -> Table:
    """Make a table that pyarrow, polars, duckdb and others take without a further copy.

    The records are copied: the array may be filled again afterwards.

    Parameters
    ----------
    records : array of FRAME_DTYPE or other records, shape (n,)
        Frames, or another structured array that canser returns, contiguous or not.
    channels, directions : array of uint8, shape (n,), optional
        Their channels, numbers from 0 and 255 for not told, and their directions, 1 for sent and 0
        for received. By default both are not told: null. For frames only, as all that follows.
    names : {"native", "python-can", "asam"}
        Names of the columns: those of FRAME_DTYPE, of `can.Message`, or of ASAM MDF. python-can's
        `is_rx` is the opposite of `sent`.
    data : {"binary", "list"}
        Type of the data: 8 bytes, or a list of 8 numbers.
    id_hex : bool
        Whether there is a column `id_hex`: the id as text, three hexadecimal digits, or eight of
        an extended one. False by default.
    epoch : datetime, optional
        Date of the time 0, for frames whose times are no dates. A datetime without a zone is local
        time.

    Returns
    -------
    Table
        Times are dates in UTC if the first known time is from 2000 on. Otherwise they are
        durations. So it is for each field of int64 of other records whose name ends in `_ns`. In
        fields of float64, NaN becomes null.

    Raises
    ------
    TypeError
        `records` is no structured array, or an argument is a masked array or of another dtype.
    ValueError
        The shapes are not (n,), a choice is unknown, an option is for frames only, or the times
        are dates already.
    MemoryError
        There is no memory for the table.

    Examples
    --------
    >>> frames = canser.frames("123#01", "18FEF100#0203")
    >>> frames["ts"] = [0, 1_000_000]
    >>> canser.table(frames)
    <canser.Table of 2 rows, times are durations>
    >>> canser.table(frames)["id"]
    array([      291, 419361024], dtype=uint32)

    >>> import pyarrow
    >>> pyarrow.table(canser.table(frames)).column("id").to_pylist()
    [291, 419361024]
    >>> pyarrow.table(canser.table(canser.id_stats(frames)))["count"].to_pylist()
    [1, 1]
    """
    check_choice("data", data, ("binary", "list"))
    flag(id_hex, "id_hex")
    titles = names_of(names)
    if getattr(records, "dtype", None) != FRAME_DTYPE:
        options = channels, directions, epoch, id_hex or None, None if names == "native" else names
        return _other_table(records, data, [each for each in options if each is not None])
    check_frames(records, "records")
    for name, codes in (("channels", channels), ("directions", directions)):
        if codes is not None:
            check_codes(codes, name, records)
    start = 0 if epoch is None else _start(records, epoch)
    dated = epoch is not None or is_dated(records)
    columns = _frame_columns(records, channels, directions, dated=dated, start=start)
    if names == "python-can" and directions is not None:
        columns[2] = columns[2]._replace(values=directions != SENT)
    if data == "list":
        columns[-1] = columns[-1]._replace(format="+w:8", kind=LIST)
    columns = [each._replace(name=titles[each.name]) for each in columns]
    if id_hex:
        columns.append(Column("id_hex", "U", hex_ids(records), TEXT))
    return Table(columns, len(records), dated=dated)


def make_table(
    frames: FrameArray, channels: Codes | None, directions: Codes | None, *, dated: bool
) -> Table:
    """Return a table of arrays that are checked: times are dates in UTC if `dated`."""
    return Table(
        _frame_columns(frames, channels, directions, dated=dated), len(frames), dated=dated
    )


def _frame_columns(
    frames: FrameArray,
    channels: Codes | None,
    directions: Codes | None,
    *,
    dated: bool,
    start: int = 0,
) -> list[Column]:
    """Return the columns of frames, in the order of COLUMNS; `start` is added to the times."""
    count, ts = len(frames), frames["ts"]
    if start:
        ts = np.where(ts == NO_TIME, NO_TIME, ts + start)
    untold = np.broadcast_to(np.uint8(NO_CHANNEL), (count,)), np.broadcast_to(np.uint8(0), (count,))
    of_channels = (untold[0], NULLS_ALL) if channels is None else (channels, NULLS_NO_CHANNEL)
    of_sent = (untold[1], FLAGS, NULLS_ALL) if directions is None else (directions, FLAGS)
    return [
        Column("ts", "tsn:UTC" if dated else "tDn", ts, nulls=NULLS_NO_TIME),
        Column("channel", "C", of_channels[0], nulls=of_channels[1]),
        Column("sent", "b", *of_sent),
        Column("id", "I", frames["id"]),
        *(Column(name, "b", frames[name], FLAGS) for name in ("ext", "rtr", "err")),
        Column("dlc", "C", frames["dlc"]),
        Column("data", "w:8", frames["data"]),
    ]


def _other_table(records: Any, data: str, options: list[Any]) -> Table:
    """Return a table of records that are no frames."""
    if not isinstance(records, np.ndarray) or records.dtype.names is None:
        raise TypeError(
            f"records must be an array of frames or of other records, not {type_name(records)}"
        )
    refuse_mask(records, "records")
    if records.ndim != 1:
        raise ValueError(f"records has {records.ndim} dimensions; it must have one")
    if options:
        raise ValueError(
            "channels, directions, names, id_hex and epoch are for frames; leave them out"
        )
    columns = record_columns(records, as_list=data == "list")
    return Table(columns, len(records), dated=any(each.format == "tsn:UTC" for each in columns))


def _start(frames: FrameArray, epoch: Any) -> int:
    """Return the nanoseconds of a date that times count from."""
    if not isinstance(epoch, datetime):
        raise TypeError(f"epoch must be a datetime, not {type_name(epoch)}")
    if is_dated(frames):
        raise ValueError("the times of the frames are dates already; leave epoch out")
    start = date_ns(epoch, None)
    known = frames["ts"][frames["ts"] != NO_TIME]
    for time in (int(known.min()), int(known.max())) if len(known) else ():
        if not NO_TIME < time + start <= np.iinfo(np.int64).max:
            raise ValueError(
                f"the time {time} ns and the epoch {epoch} are more than 64 bits; give an epoch "
                "nearer to 1970"
            )
    return start


def hex_ids(frames: FrameArray) -> npt.NDArray[np.bytes_]:
    """Return ids as hexadecimal digits: three of a standard id, eight of others."""
    digits = np.frombuffer(b"0123456789ABCDEF", np.uint8)
    shifts = np.arange(28, -1, -4, dtype=np.uint32)
    text = digits[frames["id"][:, None] >> shifts & np.uint32(15)]
    short = ~(frames["ext"] | frames["err"]) & (frames["id"] <= 0x7FF)
    text[short, :3] = text[short, 5:]
    text[short, 3:] = 0
    joined: npt.NDArray[np.bytes_] = text.view("S8")[:, 0]
    return joined
