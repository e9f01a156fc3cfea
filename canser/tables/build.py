"""Frames from columns, checked: the way back from tables of other programs."""

from collections.abc import Collection, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser._core.text import NO_CHANNEL, SENT
from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray, reason_invalid
from canser.tables.names import NATIVE, RECEIVED_TITLE

__all__ = ["RowError", "build_frames", "inverted", "missing_columns", "plain_columns"]

# Columns that a table need not have, with their values then.
_DEFAULTS: Final = {"ts": NO_TIME, "channel": NO_CHANNEL, "sent": 0, "rtr": 0, "err": 0}

_DATA_LEN: Final = 8

# Frames with their data as one number, and what stays of it by the number of bytes.
_WORDS: Final = np.dtype([("head", np.uint64), ("data", np.uint64), ("ts", np.int64)])
_KEPT: Final = np.frombuffer(
    b"".join(bytes([255] * kept).ljust(_DATA_LEN, b"\0") for kept in range(_DATA_LEN + 1)),
    np.uint64,
)

_Codes = npt.NDArray[np.uint8]


class RowError(ValueError):
    """A row that is no frame of classic CAN."""

    def __init__(self, index: int, reason: str) -> None:
        super().__init__(f"row {index}: {reason}")
        self.index, self.reason = index, reason


def missing_columns(have: Collection[str]) -> list[str]:
    """Return the native columns that a table must have and has not."""
    return [name for name in NATIVE if name not in have and name not in _DEFAULTS]


def build_frames(columns: Mapping[str, Any], count: int) -> tuple[FrameArray, _Codes, _Codes]:
    """Return frames, channels and directions from native columns, as arrays of `count` values.

    `ts` is nanoseconds. `data` has the shape (n, 8), or is n objects, bytes or lists. RowError, or
    ValueError for a value that does not fit.
    """
    frames = np.zeros(count, FRAME_DTYPE)
    for name in ("id", "ext", "rtr", "err", "dlc", "ts"):
        if name in columns:
            frames[name] = _fitted(columns[name], FRAME_DTYPE[name], name)
        elif name in _DEFAULTS:
            frames[name] = _DEFAULTS[name]
    data = np.asarray(columns["data"])
    if data.dtype == object:
        data = _joined(data, np.where(frames["rtr"], 0, frames["dlc"]))
    data = _fitted(data, np.dtype(np.uint8), "data")
    if data.shape[1:] != (_DATA_LEN,) and count:
        raise ValueError(f"data has the shape {data.shape}; it must be ({count}, {_DATA_LEN})")
    whole = np.ascontiguousarray(data.reshape(count, _DATA_LEN), np.uint8)
    frames.view(_WORDS)["data"] = whole.view(np.uint64)[:, 0]
    _check(frames)
    channels, sent = (
        _fitted(columns[name], np.dtype(np.uint8), name)
        if name in columns
        else np.full(count, _DEFAULTS[name], np.uint8)
        for name in ("channel", "sent")
    )
    _refuse(sent > 1, sent, "sent", "it must be 0 or 1")
    return frames, channels, np.where(sent != 0, SENT, 0).astype(np.uint8)


def _fitted(values: Any, dtype: np.dtype[Any], name: str) -> npt.NDArray[Any]:
    """Return values as a dtype; RowError for one that it cannot hold."""
    values = np.asarray(values)
    fitted: npt.NDArray[Any]
    if values.dtype == dtype:
        fitted = values
        return fitted
    kind = values.dtype.kind
    # Floats of times may be seconds, and bool of an id or a dlc is another column.
    if kind not in ("iu" if name == "ts" else "biuf" if name == "sent" else "iuf"):
        raise ValueError(f"{name} has values of the type {values.dtype}, which do not fit")
    if dtype.kind == "b":
        _refuse((values != 0) & (values != 1), values, name, "it must be 0 or 1")
    elif kind != "b":
        limits = np.iinfo(dtype)
        fits = (values >= limits.min) & (values <= limits.max)
        if kind == "f":
            fits &= values == np.rint(values)
        _refuse(~fits, values, name, f"it must be a whole number up to {limits.max:,}")
    fitted = values.astype(dtype)
    return fitted


def _refuse(wrong: npt.NDArray[np.bool_], values: npt.NDArray[Any], name: str, why: str) -> None:
    """Raise RowError for the first value that is wrong; `values` may have several in a row."""
    for place in np.argwhere(wrong)[:1]:
        raise RowError(int(place[0]), f"{name} is {values[tuple(place)]}; {why}")


def inverted(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return bool, or the numbers 0 and 1, turned round; other numbers stay, to be refused."""
    if values.dtype == np.bool_:
        return ~values
    return np.where(values == 0, 1, np.where(values == 1, 0, values))


def _check(frames: FrameArray) -> None:
    """Raise RowError for the first record that is no CAN frame; blank bytes past the dlc."""
    limit = np.where(frames["ext"], 0x1FFF_FFFF, 0x7FF)
    for index in np.flatnonzero((frames["id"] > limit) | (frames["dlc"] > _DATA_LEN))[:1]:
        row = frames[index]
        reason = reason_invalid(int(row["id"]), bool(row["ext"]), int(row["dlc"]))
        raise RowError(int(index), reason or "")
    lengths = np.where(frames["rtr"], 0, frames["dlc"])
    frames.view(_WORDS)["data"] &= _KEPT[lengths]


def plain_columns(
    columns: Mapping[str, Any], titles: Mapping[str, str]
) -> dict[str, npt.NDArray[Any]]:
    """Return numpy's columns as `build_frames` takes them: times as nanoseconds.

    `titles`: the native names by the names that the table has.
    """
    plain = {name: np.asarray(values) for name, values in columns.items()}
    if "ts" in plain and plain["ts"].dtype.kind in "mM":
        plain["ts"] = _nanoseconds(plain["ts"])
    if RECEIVED_TITLE in titles:
        plain["sent"] = inverted(plain["sent"])
    return plain


def _nanoseconds(times: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """Return times of any unit in nanoseconds; numpy would let those that do not fit wrap."""
    whole = times.astype(f"{times.dtype.kind}8[ns]")
    same = whole.astype(times.dtype) == times
    _refuse(~(np.isnat(times) | same), times, "ts", "it is more than 64 bits of ns")
    return whole.view(np.int64)


def _joined(rows: npt.NDArray[Any], lengths: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Return bytes, or lists of numbers, as an array of shape (n, 8).

    RowError for one that is shorter than the length that its frame has.
    """
    objects = rows.tolist()
    if all(type(row) is bytes and len(row) == _DATA_LEN for row in objects):
        return np.frombuffer(b"".join(objects), np.uint8).reshape(-1, _DATA_LEN)
    parts = []
    for index, (row, length) in enumerate(zip(objects, lengths.tolist(), strict=True)):
        try:
            if isinstance(row, (int, np.integer)):
                raise TypeError  # bytes(5) are five zeros
            part = bytes(row)
        except (TypeError, ValueError):
            raise RowError(index, f"data is {row!r}, which is no bytes") from None
        if len(part) > _DATA_LEN:
            raise RowError(index, f"data has {len(part)} bytes; classic CAN has up to 8")
        if len(part) < length:
            raise RowError(
                index, f"data has {len(part)} bytes, fewer than its dlc; correct the dlc"
            )
        parts.append(part.ljust(_DATA_LEN, b"\0"))
    return np.frombuffer(b"".join(parts), np.uint8).reshape(-1, _DATA_LEN)
