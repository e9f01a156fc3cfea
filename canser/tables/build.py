"""Frames from columns, checked: the way back from tables of other programs."""

from collections.abc import Collection, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser._core.text import NO_CHANNEL, SENT
from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray, reason_invalid
from canser.tables.names import NATIVE, RECEIVED_TITLE

__all__ = ["RowError", "build_frames", "missing_columns", "plain_columns"]

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

    `ts` is nanoseconds, and `data` has the shape (n, 8). RowError, or ValueError for a value that
    does not fit.
    """
    frames = np.zeros(count, FRAME_DTYPE)
    for name in ("id", "ext", "rtr", "err", "dlc", "ts"):
        if name in columns:
            frames[name] = _fitted(columns[name], FRAME_DTYPE[name], name)
        elif name in _DEFAULTS:
            frames[name] = _DEFAULTS[name]
    data = np.asarray(columns["data"])
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
    return frames, channels, np.where(sent != 0, SENT, 0).astype(np.uint8)


def _fitted(values: Any, dtype: np.dtype[Any], name: str) -> npt.NDArray[Any]:
    """Return values as a dtype; RowError for one that it cannot hold."""
    values = np.asarray(values)
    fitted: npt.NDArray[Any]
    if values.dtype == dtype or dtype.kind == "b":
        fitted = values.astype(dtype, copy=False)
        return fitted
    if values.dtype.kind not in "biuf":
        raise ValueError(f"{name} has values of the type {values.dtype}, which are no numbers")
    limits = np.iinfo(dtype)
    fits = (values >= limits.min) & (values <= limits.max)
    if values.dtype.kind == "f":
        fits &= values == np.rint(values)
    for index in np.flatnonzero(~fits)[:1]:
        text = f"{name} is {values[index]}; it must be a whole number up to {limits.max:,}"
        raise RowError(int(index), text)
    fitted = values.astype(dtype)
    return fitted


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
    """Return numpy's columns as `build_frames` takes them: times as nanoseconds, data as bytes.

    `titles`: the native names by the names that the table has.
    """
    plain = {name: np.asarray(values) for name, values in columns.items()}
    if "ts" in plain and plain["ts"].dtype.kind in "mM":
        unit = f"{plain['ts'].dtype.kind}8[ns]"
        plain["ts"] = plain["ts"].astype(unit).view(np.int64)
    if RECEIVED_TITLE in titles:
        plain["sent"] = ~plain["sent"].astype(np.bool_)
    if plain["data"].dtype == object:
        plain["data"] = _joined(plain["data"])
    return plain


def _joined(rows: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Return bytes, or lists of numbers, as an array of shape (n, 8)."""
    parts = []
    for index, row in enumerate(rows):
        try:
            part = bytes(row)
        except (TypeError, ValueError):
            raise RowError(index, f"data is {row!r}, which is no bytes") from None
        if len(part) > _DATA_LEN:
            raise RowError(index, f"data has {len(part)} bytes; classic CAN has up to 8")
        parts.append(part.ljust(_DATA_LEN, b"\0"))
    return np.frombuffer(b"".join(parts), np.uint8).reshape(-1, _DATA_LEN)
