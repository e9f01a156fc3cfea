"""Tables: frames as columns of Arrow in memory of C, and the capsules that hand them on."""

import ctypes
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from canser._core._lib import ffi, lib
from canser._core.buffers import NULL, Pointer, input_frames, raise_status
from canser._core.text import Codes
from canser._frames import FrameArray

__all__ = ["Capsule", "Columns"]

# A PyCapsule with a struct of Arrow, which one consumer takes.
Capsule = object

# Made by Python's own function: the calls of cffi run without Python's lock. A prototype of its
# own, as other packages may change that of ctypes.pythonapi.PyCapsule_New.
_new_capsule: Final[Callable[[int, int, int], Capsule]] = ctypes.PYFUNCTYPE(
    ctypes.py_object, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p
)(("PyCapsule_New", ctypes.pythonapi))


class _Kind(NamedTuple):
    """A kind of capsules."""

    type: Pointer
    export: Callable[[Pointer, Pointer], int]
    free: Callable[[Pointer], None]
    name: int  # the addresses of the name and of the destructor
    end: int


def _kind(type_name: str, export: Any, free: Any, kind: int) -> _Kind:
    name, end = lib.capsule_name(kind), lib.capsule_end(kind)
    return _Kind(ffi.typeof(type_name), export, free, name, end)


_SCHEMA: Final = _kind(
    "struct ArrowSchema **", lib.canser_table_schema, lib.canser_schema_free, lib.CAPSULE_SCHEMA
)
_ARRAY: Final = _kind(
    "struct ArrowArray **", lib.canser_table_array, lib.canser_array_free, lib.CAPSULE_ARRAY
)
_STREAM: Final = _kind(
    "struct ArrowArrayStream **",
    lib.canser_table_stream,
    lib.canser_array_stream_free,
    lib.CAPSULE_STREAM,
)


class Columns:
    """Frames as columns; see canser_table_new. The arrays are copied."""

    def __init__(
        self, frames: FrameArray, channels: Codes | None, directions: Codes | None, *, dated: bool
    ) -> None:
        self._count = len(frames)
        made = ffi.new("canser_table **")
        codes = [
            NULL if each is None else ffi.from_buffer("uint8_t[]", each)
            for each in (channels, directions)
        ]
        self._check(lib.canser_table_new(input_frames(frames), *codes, self._count, dated, made))
        self._table = ffi.gc(made[0], lib.canser_table_release)

    def __len__(self) -> int:
        return self._count

    def schema(self) -> Capsule:
        """Return a capsule with the schema."""
        return self._capsule(_SCHEMA)

    def array(self) -> Capsule:
        """Return a capsule with the rows as one struct array."""
        return self._capsule(_ARRAY)

    def stream(self) -> Capsule:
        """Return a capsule with a stream of one batch."""
        return self._capsule(_STREAM)

    def _capsule(self, kind: _Kind) -> Capsule:
        made = ffi.new(kind.type)
        self._check(kind.export(self._table, made))
        try:
            return _new_capsule(int(ffi.cast("uintptr_t", made[0])), kind.name, kind.end)
        except BaseException:
            kind.free(made[0])
            raise

    def _check(self, status: int) -> None:
        if status == lib.CANSER_NO_MEMORY:
            raise MemoryError(f"there is no memory for a table of {self._count:,} frames")
        if status:
            raise_status(status)
