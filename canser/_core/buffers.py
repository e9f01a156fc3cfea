"""The caller's memory as pointers for C, checked and never copied; C's statuses as exceptions."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, TypeAlias, cast

import numpy as np
import numpy.typing as npt

from canser._checks import type_name
from canser._core._lib import ffi, lib
from canser._frames import FRAME_DTYPE, FrameArray, refuse_mask

if TYPE_CHECKING:
    from typing_extensions import Buffer

# Any buffer of bytes. Below Python 3.12 type checkers do not know that an array is a buffer.
BytesLike: TypeAlias = "Buffer | npt.NDArray[Any]"

Pointer = Any
Offsets = npt.NDArray[np.int64] | npt.NDArray[np.uint64]
Times = npt.NDArray[np.int64]

# Python's record and C's struct must agree, field by field.
for _name, _field in ffi.typeof("canser_frame").fields:
    assert FRAME_DTYPE.fields is not None
    assert FRAME_DTYPE.fields[_name][1] == _field.offset
    assert FRAME_DTYPE.fields[_name][0].itemsize == ffi.sizeof(_field.type)
assert FRAME_DTYPE.itemsize == ffi.sizeof("canser_frame")


def _check_bytes(data: BytesLike) -> memoryview:
    """Return a view of the caller's bytes, or raise."""
    refuse_mask(data, "data")
    try:
        view = memoryview(cast("Buffer", data))
    except (TypeError, ValueError):  # ValueError: datetime64 arrays and the like
        hint = "; encode it first" if isinstance(data, str) else ""
        raise TypeError(
            f"data must be bytes or another buffer of bytes, not {type_name(data)}{hint}"
        ) from None
    if view.format.lstrip("@=<>!") not in ("B", "b", "c"):
        raise TypeError(
            f"data must hold single bytes, not {type_name(data)} with items of format "
            f"{view.format!r}; pass .view('u1') of an array, or its bytes"
        )
    if not view.c_contiguous:
        raise BufferError(
            "data is not contiguous; pass a contiguous buffer, such as np.ascontiguousarray(data)"
        )
    return view


NULL: Final[Pointer] = ffi.NULL


def input_bytes(data: BytesLike) -> Pointer:
    """Return a pointer to the caller's bytes, no copy; it holds the buffer."""
    # The common case, in which there is nothing to check.
    if type(data) is bytes:
        return ffi.from_buffer("uint8_t[]", data)
    view = _check_bytes(data)
    # The pointer must hold an array, not a memoryview. Before 3.12.7, Python's garbage collector
    # crashes on a pointer that holds a memoryview in a cycle, such as an exception and its frames.
    return ffi.from_buffer("uint8_t[]", np.frombuffer(view, np.uint8))


def as_bytes(data: BytesLike) -> npt.NDArray[np.uint8]:
    """Return the caller's bytes as an array, no copy."""
    return np.frombuffer(_check_bytes(data), np.uint8)


def check_array(array: Any, name: str, dtypes: tuple[Any, ...], make: str) -> None:
    """Raise unless `array` is one-dimensional, of a dtype, and contiguous."""
    if not isinstance(array, np.ndarray) or array.dtype not in dtypes:
        raise TypeError(f"{name} must be an array as {make} makes, not {type_name(array)}")
    refuse_mask(array, name)
    if array.ndim != 1:
        raise ValueError(f"{name} has {array.ndim} dimensions; it must have one")
    if not array.flags.c_contiguous:
        raise ValueError(f"{name} is not contiguous; pass np.ascontiguousarray({name})")


def _check_writeable(array: npt.NDArray[Any], name: str) -> None:
    if not array.flags.writeable:
        raise BufferError(f"{name} is read-only; pass an array that can be written")


def input_frames(frames: FrameArray) -> Pointer:
    """Return a pointer to frames to read, no copy; it holds the array."""
    check_array(frames, "frames", (FRAME_DTYPE,), "np.empty(n, canser.FRAME_DTYPE)")
    return ffi.from_buffer("canser_frame[]", frames)


def output_frames(out: FrameArray) -> Pointer:
    """Return a pointer to room for frames; it holds the array."""
    check_array(out, "out", (FRAME_DTYPE,), "np.empty(n, canser.FRAME_DTYPE)")
    _check_writeable(out, "out")
    if not len(out):
        raise ValueError("out has room for 0 frames; it needs room for at least 1")
    return ffi.from_buffer("canser_frame[]", out)


OFFSET_DTYPES = (np.dtype(np.int64), np.dtype(np.uint64))


def output_offsets(offsets: Offsets | None, frame_cap: int) -> Pointer:
    """Return a pointer to room for stream offsets, or NULL; it holds the array."""
    if offsets is None:
        return ffi.NULL
    check_array(offsets, "offsets", OFFSET_DTYPES, "np.empty(n, np.int64)")
    _check_writeable(offsets, "offsets")
    if len(offsets) < frame_cap:
        raise ValueError(
            f"offsets has room for {len(offsets)}, out for {frame_cap} frames; "
            "make offsets as long as out"
        )
    return ffi.from_buffer("int64_t[]", offsets)


def output_room(
    out: FrameArray, count: int, offsets: Offsets | None
) -> tuple[Pointer, int, Pointer]:
    """Return pointers into checked arrays behind `count` frames, and the room there.

    The pointers do not keep the arrays alive: the caller does.
    """
    at = NULL if offsets is None else ffi.from_buffer("int64_t[]", offsets) + count
    return ffi.from_buffer("canser_frame[]", out) + count, len(out) - count, at


# Looked up once: cffi would look a type up by its name in each call.
_TARGET: Final = ffi.typeof("canser_target *")


def check_output(out: FrameArray, offsets: Offsets | None) -> Pointer:
    """Return a target made of these arrays, checked; it does not keep them alive."""
    return ffi.new(_TARGET, (output_frames(out), len(out), output_offsets(offsets, len(out))))


def is_same(
    offsets: Offsets | None, last: Callable[[], Offsets | None] | None, frame_cap: int
) -> bool:
    """Return whether these are the offsets that were checked last, still unchanged."""
    if offsets is None or last is None:
        return offsets is None and last is None
    return offsets is last() and len(offsets) >= frame_cap and offsets.flags.writeable


class FrameRoom:
    """Room for frames, and for where each begins and ends: checked once, with its pointers.

    `offsets` and `ends` are int64 arrays as long as `frames`, or None.
    """

    def __init__(self, frames: FrameArray, offsets: Times | None, ends: Times | None) -> None:
        self.frames, self.offsets, self.ends = frames, offsets, ends
        self.frames_at = output_frames(frames)
        self.offsets_at = output_offsets(offsets, len(frames))
        self.ends_at = output_offsets(ends, len(frames))
        self.timed_at = ffi.new("size_t *")
        self._target = ffi.new(_TARGET)

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def timed(self) -> int:
        """How many frames have their final times; they are the first ones."""
        return int(self.timed_at[0])

    @timed.setter
    def timed(self, count: int) -> None:
        self.timed_at[0] = count

    def between(self, count: int, most: int) -> Pointer:
        """Return the rows from `count` up to `most` as a target, good until the next call."""
        target = self._target
        target.frames, target.frame_cap = self.frames_at + count, most - count
        if self.offsets is not None:
            target.offsets = self.offsets_at + count
        if self.ends is not None:
            target.ends = self.ends_at + count
        return target


def output_bytes(out: npt.NDArray[np.uint8]) -> Pointer:
    """Return a pointer to room for bytes; it holds the array."""
    check_array(out, "out", (np.dtype(np.uint8),), "np.empty(n, np.uint8)")
    _check_writeable(out, "out")
    return ffi.from_buffer("uint8_t[]", out)


def raise_status(status: int) -> None:
    """Raise the exception for a status of C, which is about the caller's arrays."""
    if status == lib.CANSER_MISALIGNED:
        raise ValueError(
            "an array of frames or offsets does not begin at a multiple of 8 bytes; "
            "pass a fresh one, such as np.empty(n, canser.FRAME_DTYPE)"
        )
    if status == lib.CANSER_OVERLAP:
        raise ValueError("input and output share memory; pass arrays apart from each other")
    raise AssertionError(f"canser's C core returned the status {status}")
