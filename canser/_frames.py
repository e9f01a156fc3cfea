"""The record of a frame, and the selection of frames by can-utils' filters."""

import re
import sys
from collections.abc import Iterable
from typing import Final

import numpy as np
import numpy.typing as npt

from canser._checks import type_name

__all__ = [
    "FRAME_DTYPE",
    "NO_TIME",
    "FrameArray",
    "check_codes",
    "check_frames",
    "concat",
    "contiguous_frames",
    "copy_records",
    "match",
    "put_records",
    "put_records_at",
    "reason_invalid",
    "refuse_mask",
]

FrameArray = npt.NDArray[np.void]

FRAME_DTYPE: Final[np.dtype[np.void]] = np.dtype(
    [
        ("id", np.uint32),  # arbitration id, 11 or 29 bits, no flag bits
        ("ext", np.bool_),  # extended (29-bit) frame
        ("rtr", np.bool_),  # remote frame
        ("dlc", np.uint8),  # data length code, 0..8
        ("err", np.bool_),  # error frame
        ("data", np.uint8, (8,)),  # zero past the dlc; all zero in a remote frame
        ("ts", np.int64),  # nanoseconds, or NO_TIME
    ],
    align=True,
)

# `ts` of a frame whose time is not known; as datetime64 or timedelta64 it is NaT.
NO_TIME: Final = int(np.iinfo(np.int64).min)

# Nanoseconds from 1970 to 2000. Assumption: a time this late is a date, not a device's clock.
YEAR_2000_NS: Final = 946_684_800 * 10**9

# SocketCAN's flags above the 29 bits of an id, as filters write them.
_EXT, _RTR, _ERR = 0x8000_0000, 0x4000_0000, 0x2000_0000

# The largest ids, of 11 and of 29 bits.
_STANDARD_MAX, _EXTENDED_MAX = 0x7FF, 0x1FFF_FFFF

_NUMBER = "(?:0[xX])?(?P<{}>[0-9A-Fa-f]{{1,8}})"
_ID_ALONE = re.compile(_NUMBER.format("id"))
_FILTER = re.compile(f"(?:{_NUMBER.format('id')})?(?P<kind>[:~#]){_NUMBER.format('mask')}")


def match(frames: FrameArray, *filters: str) -> npt.NDArray[np.bool_]:
    """Mark the frames that pass any of the filters: ids, or can-utils' notation.

    Parameters
    ----------
    frames : FrameArray
        Array of FRAME_DTYPE, any shape.
    *filters : str
        Each in hexadecimal, with or without 0x. Without a filter all frames pass.

        - ``ID``: data and remote frames with exactly that id; standard if ID has one to three
          digits (`123`), extended if it has eight (`18FEF100`). Four to seven digits are an error.
        - ``ID:MASK``: frames with (id & MASK) == (ID & MASK)
        - ``ID~MASK``: the inverse
        - ``#MASK``: error frames with (id & MASK) != 0. No other filter passes error frames.

    Returns
    -------
    numpy array of bool
        Of the shape of `frames`, for `frames.compress(canser.match(frames, "123"))`.

    Raises
    ------
    TypeError
        `frames` is no array of FRAME_DTYPE.
    ValueError
        A filter cannot be read.

    Notes
    -----
    Bits 31 and 30 of ID and MASK stand for extended and remote frames: `123:7FF` passes 0x123 of
    every kind, `123:C00007FF` standard data frames only. An ID of eight digits means extended. So
    `123` is `123:800007FF`, and `18FEF100` is `18FEF100:9FFFFFFF`.

    Source: candump's manual page, and the kernel's `can_rcv_filter`. An ID alone is canser's own.

    Examples
    --------
    >>> canser.match(canser.frames("123#01", "124#02", "18FEF100#"), "123", "18FEF100")
    array([ True, False,  True])
    """
    if getattr(frames, "dtype", None) != FRAME_DTYPE:
        raise TypeError(
            f"frames must be an array of canser.FRAME_DTYPE, not {type_name(frames)}; "
            "decode() makes one"
        )
    refuse_mask(frames, "frames")
    rules = [_parse_filter(text) for text in filters]
    if not rules:
        return np.ones(frames.shape, np.bool_)
    flagged = (
        frames["id"]
        | np.where(frames["ext"], np.uint32(_EXT), np.uint32(0))
        | np.where(frames["rtr"], np.uint32(_RTR), np.uint32(0))
    )
    error = frames["err"]
    passed = np.zeros(frames.shape, np.bool_)
    for kind, wanted, mask in rules:
        if kind == "#":
            passed |= error & ((frames["id"] & mask) != 0)
        else:
            same = (flagged & mask) == (wanted & mask)
            passed |= ~error & (same if kind == ":" else ~same)
    return passed


def with_mask(text: str) -> str:
    """Return a filter with the mask that an ID alone stands for; any other as it is.

    ValueError for digits that are no id.
    """
    found = _ID_ALONE.fullmatch(text)
    if not found:
        return text
    digits, value = found["id"], int(found["id"], 16)
    if len(digits) <= 3:
        if value > _STANDARD_MAX:
            raise ValueError(
                f"the filter {text!r} is over {_STANDARD_MAX:X}, the largest standard id; "
                f"write {digits:0>8} for the extended id"
            )
        return f"{digits}:{_EXT | _STANDARD_MAX:08X}"
    if len(digits) < 8:
        raise ValueError(
            f"the filter {text!r} has {len(digits)} digits; a standard id has up to three, an "
            f"extended id eight: write {digits:0>8}, or ID:MASK"
        )
    if value > _EXTENDED_MAX:
        raise ValueError(
            f"the filter {text!r} is over {_EXTENDED_MAX:X}, the largest extended id; "
            "write ID:MASK for an id with flags, #MASK for error frames"
        )
    return f"{digits}:{_EXT | _EXTENDED_MAX:08X}"


def _parse_filter(text: str) -> tuple[str, np.uint32, np.uint32]:
    """Read one filter into its kind, id and mask, flags as SocketCAN has them."""
    found = _FILTER.fullmatch(with_mask(text)) if isinstance(text, str) else None
    if not found or (found["kind"] == "#") != (found["id"] is None):
        raise ValueError(
            f"cannot read the filter {text!r}; write ID:MASK, ID~MASK or #MASK in hexadecimal, "
            "such as 123:7FF, or an id of three or eight digits"
        )
    wanted = int(found["id"] or "0", 16)
    mask = int(found["mask"], 16)
    if found["kind"] != "#":
        # An id of eight digits is extended (can-utils). The error flag has no effect here: error
        # frames have a filter of their own.
        if len(found["id"]) == 8:
            wanted |= _EXT
        mask &= ~_ERR
    return found["kind"], np.uint32(wanted), np.uint32(mask)


def reason_invalid(arbitration_id: int, ext: bool, dlc: int) -> str | None:
    """Return the reason why these values are no frame of classic CAN, None if they are one."""
    limit = _EXTENDED_MAX if ext else _STANDARD_MAX
    if not 0 <= arbitration_id <= limit:
        return f"the id {arbitration_id:#x} is over {limit:#x}"
    if not 0 <= dlc <= 8:
        return f"the dlc {dlc} is not 0 to 8; canser knows classic CAN only"
    return None


def put_records(target: npt.NDArray[np.void], records: npt.NDArray[np.void]) -> None:
    """Copy records into an array of the same dtype and shape.

    numpy copies records field by field, in 15 to 50 ns a frame. As bytes without fields it copies
    them whole, in 1 ns a frame.
    """
    whole = f"V{records.dtype.itemsize}"
    target.view(whole)[...] = records.view(whole)


def put_records_at(
    target: npt.NDArray[np.void], places: npt.NDArray[np.intp], records: npt.NDArray[np.void]
) -> None:
    """Do `target[places] = records` for records of the same dtype; see `put_records`."""
    whole = f"V{records.dtype.itemsize}"
    target.view(whole)[places] = records.view(whole)


def copy_records(records: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
    """Return a copy of records, contiguous, that owns its memory; see `put_records`."""
    copy = np.empty(records.shape, records.dtype)
    put_records(copy, records)
    return copy


def concat(arrays: Iterable[FrameArray]) -> FrameArray:
    """Join arrays of frames into one, in their order.

    The same as `np.concatenate`, in a tenth of its time: numpy copies frames field by field.
    `canser.concat([frames])` is a copy as fast.

    Parameters
    ----------
    arrays : iterable of FrameArray
        Arrays of FRAME_DTYPE, each of shape (n,), contiguous or not. Arrays that were filled in the
        same `out` hold the same frames: copy each before the next call.

    Returns
    -------
    FrameArray
        New array of FRAME_DTYPE, with the frames of all arrays; empty for no arrays.

    Raises
    ------
    TypeError
        An item is no array of FRAME_DTYPE, or is a masked array.
    ValueError
        An array does not have one dimension.

    Examples
    --------
    >>> len(canser.concat([canser.frames("123#01"), canser.frames("124#", "125#")]))
    3
    """
    if isinstance(arrays, np.ndarray):
        raise TypeError("arrays must be a list of arrays of frames, not one array; pass [array]")
    parts = list(arrays)
    for index, part in enumerate(parts):
        check_frames(part, f"arrays[{index}]")
    joined = np.empty(sum(len(part) for part in parts), FRAME_DTYPE)
    whole = f"V{FRAME_DTYPE.itemsize}"
    if parts:
        np.concatenate([part.view(whole) for part in parts], out=joined.view(whole))
    return joined


def check_frames(array: object, name: str) -> None:
    """Raise unless this is an array of frames with one dimension; it need not be contiguous."""
    if not isinstance(array, np.ndarray) or array.dtype != FRAME_DTYPE:
        raise TypeError(f"{name} must be an array of canser.FRAME_DTYPE, not {type_name(array)}")
    refuse_mask(array, name)
    if array.ndim != 1:
        raise ValueError(f"{name} has {array.ndim} dimensions; it must have one")


def contiguous_frames(frames: FrameArray) -> FrameArray:
    """Return frames as C takes them, contiguous and aligned: checked, and a copy where need be."""
    check_frames(frames, "frames")
    if frames.flags.c_contiguous and frames.flags.aligned:
        return frames
    return copy_records(frames)


def check_codes(codes: object, name: str, frames: FrameArray) -> None:
    """Raise unless these are channels or directions of the frames: uint8, one for each."""
    if not isinstance(codes, np.ndarray) or codes.dtype != np.uint8:
        raise TypeError(f"{name} must be an array of uint8, not {type_name(codes)}")
    refuse_mask(codes, name)
    if codes.shape != frames.shape:
        raise ValueError(
            f"{name} has the shape {codes.shape}, frames have {frames.shape}; they must be the same"
        )


def refuse_mask(array: object, name: str) -> None:
    """Raise TypeError for a masked array: otherwise masked items would be taken like others."""
    # While numpy.ma is not imported, there are no masked arrays.
    ma = sys.modules.get("numpy.ma")
    if ma is not None and isinstance(array, ma.MaskedArray):
        raise TypeError(
            f"{name} is a masked array, and its mask would be lost; "
            f"pass {name}.data, or the part of it that is not masked"
        )
