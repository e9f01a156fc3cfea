"""Tables: records as columns of Arrow in memory of C, and the capsules that hand them on.

Arrays of `shared_empty` become columns without a copy: the array and the table own the memory.
"""

import ctypes
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canser._core._lib import ffi, lib
from canser._core.buffers import NULL, Pointer, raise_status

__all__ = [
    "DICTIONARY",
    "FLAGS",
    "LIST",
    "NULLS_ALL",
    "NULLS_MASK",
    "NULLS_NAN",
    "NULLS_NONE",
    "NULLS_NO_CHANNEL",
    "NULLS_NO_TIME",
    "TEXT",
    "VALUES",
    "Capsule",
    "Column",
    "Columns",
    "is_shared",
    "shared_empty",
]

# How values are copied, and which ones are null: see canser.h.
VALUES: Final[int] = lib.CANSER_COLUMN_VALUES
FLAGS: Final[int] = lib.CANSER_COLUMN_FLAGS
LIST: Final[int] = lib.CANSER_COLUMN_LIST
TEXT: Final[int] = lib.CANSER_COLUMN_TEXT
DICTIONARY: Final[int] = lib.CANSER_COLUMN_DICTIONARY
NULLS_NONE: Final[int] = lib.CANSER_NULLS_NONE
NULLS_ALL: Final[int] = lib.CANSER_NULLS_ALL
NULLS_NO_TIME: Final[int] = lib.CANSER_NULLS_NO_TIME
NULLS_NO_CHANNEL: Final[int] = lib.CANSER_NULLS_NO_CHANNEL
NULLS_NAN: Final[int] = lib.CANSER_NULLS_NAN
NULLS_MASK: Final[int] = lib.CANSER_NULLS_MASK

# Texts of a dictionary end at numbers of 32 bits.
_TEXTS_MOST: Final = 2**31 - 1

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


def shared_empty(count: int, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Return a new array of any values whose memory becomes a column without a copy.

    For numbers and times. A table of such an array, or of a slice of it, sees what is written
    later: write only while `is_shared` is False.
    """
    made, dtype = ffi.new("canser_block **"), np.dtype(dtype)
    status = lib.canser_block_new(count * dtype.itemsize, made)
    if status == lib.CANSER_NO_MEMORY:
        raise MemoryError(f"there is no memory for {count:,} values of {dtype}")
    if status:
        raise_status(status)
    return np.asarray(_Block(made[0], dtype, count))


def is_shared(array: npt.NDArray[Any]) -> bool:
    """Return whether a table, or a program that took one, has the memory of an array.

    Views of numpy are not counted. False of an array that `shared_empty` did not make.
    """
    block = _block_of(array)
    return block is not None and bool(lib.canser_block_owners(block.pointer) > 1)


class _Block:
    """Owns memory of `shared_empty` as long as arrays are in use."""

    def __init__(self, block: Pointer, dtype: np.dtype[Any], count: int) -> None:
        self.pointer = ffi.gc(block, lib.canser_block_release)
        self.__array_interface__ = {
            "version": 3,
            "typestr": dtype.str,
            "shape": (count,),
            "data": (int(ffi.cast("uintptr_t", lib.canser_block_values(block))), False),
        }


def _block_of(array: Any) -> _Block | None:
    """Return what owns the memory of an array, also of a view, if `shared_empty` made it."""
    while isinstance(array, np.ndarray):
        array = array.base
    return array if isinstance(array, _Block) else None


class Column(NamedTuple):
    """A column of records: see canser_column.

    `values` has one dimension, or two for bytes and lists; it need not be contiguous or aligned.
    `mask` (of bool, for NULLS_MASK) is true where a value is not null. `texts`, all different, are
    those of a DICTIONARY, whose values are int32. `metadata` is of the field.
    """

    name: str
    format: str
    values: npt.NDArray[Any]
    kind: int = VALUES
    nulls: int = NULLS_NONE
    mask: npt.NDArray[np.bool_] | None = None
    texts: Sequence[str] = ()
    metadata: Mapping[str, str] | None = None


def _encoded(metadata: Mapping[str, str]) -> bytes:
    """Return pairs of texts as Arrow has them: their number, then each text with its length."""
    parts = [struct.pack("=i", len(metadata))]
    for pair in metadata.items():
        for text in pair:
            encoded = text.encode()
            parts += [struct.pack("=i", len(encoded)), encoded]
    return b"".join(parts)


class Columns:
    """Columns in memory of C; see canser_table_new.

    They are copied. Values of `shared_empty` that lie one behind the other are shared instead.
    """

    def __init__(self, columns: Sequence[Column], count: int) -> None:
        self._count = count
        # What tells the type of a view, but not the caller's arrays.
        self._types = [(each.kind, each.values.dtype, each.values.shape[1:]) for each in columns]
        given = ffi.new("canser_column[]", len(columns))
        kept: list[Any] = []
        for to, column in zip(given, columns, strict=True):
            kept += [ffi.new("char[]", text.encode()) for text in (column.name, column.format)]
            to.name, to.format = kept[-2:]
            values = column.values
            to.values = ffi.cast("void *", values.ctypes.data)
            to.stride = values.strides[0] if count else 0
            to.size = values.itemsize * math.prod(values.shape[1:])
            to.kind, to.nulls = column.kind, column.nulls
            if column.kind in (VALUES, DICTIONARY) and count and _is_plain(values):
                block = _block_of(values)
                if block is not None:
                    to.block = block.pointer
            if column.mask is not None:
                mask = np.ascontiguousarray(column.mask, np.bool_).view(np.uint8)
                to.mask = ffi.from_buffer("uint8_t[]", mask)
                kept.append(mask)
            if column.kind == DICTIONARY:
                kept.append(_texts(column.texts))
                to.texts = kept[-1][0]
            if column.metadata:
                metadata = _encoded(column.metadata)
                kept.append(ffi.from_buffer(metadata))
                to.metadata, to.metadata_len = kept[-1], len(metadata)
        made = ffi.new("canser_table **")
        self._check(lib.canser_table_new(given, len(columns), count, made))
        self._table = ffi.gc(made[0], lib.canser_table_release)

    def __len__(self) -> int:
        return self._count

    def view(self, index: int, *, writeable: bool = False) -> npt.NDArray[Any]:
        """Return the values of a column without a copy; flags as bits, 8 to a byte.

        The array keeps the memory. A null is any value. `writeable` is for a table that is handed
        to no other program.
        """
        kind, dtype, shape = self._types[index]
        values = self._pointers(index)[0]
        full = (self._count, *shape)
        if kind == FLAGS:
            dtype, full = np.dtype(np.uint8), ((self._count + 7) // 8,)
        return np.asarray(_View(self._table, values, dtype.str, full, writeable))

    def valid(self, index: int) -> npt.NDArray[np.bool_]:
        """Return for each value of a column whether it is not null, a copy."""
        bits = self._pointers(index)[1]
        if bits == NULL:
            return np.ones(self._count, np.bool_)
        packed = np.frombuffer(ffi.buffer(bits, (self._count + 7) // 8), np.uint8)
        unpacked = np.unpackbits(packed, count=self._count, bitorder="little")
        return unpacked.astype(np.bool_)

    def schema(self) -> Capsule:
        """Return a capsule with the schema."""
        return self._capsule(_SCHEMA)

    def array(self) -> Capsule:
        """Return a capsule with the rows as one struct array."""
        return self._capsule(_ARRAY)

    def stream(self) -> Capsule:
        """Return a capsule with a stream of one batch."""
        return self._capsule(_STREAM)

    def _pointers(self, index: int) -> tuple[Pointer, Pointer]:
        values, valid = ffi.new("uint8_t **"), ffi.new("uint8_t **")
        self._check(
            lib.canser_table_column(
                self._table,
                index,
                ffi.cast("const uint8_t **", values),
                ffi.cast("const uint8_t **", valid),
            )
        )
        return values[0], valid[0]

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
            raise MemoryError(f"there is no memory for a table of {self._count:,} rows")
        if status:
            raise_status(status)


def _is_plain(values: npt.NDArray[Any]) -> bool:
    """Return whether values lie as Arrow has them, at an address that all its takers read."""
    return values.ndim == 1 and values.flags.c_contiguous and values.flags.aligned


def _texts(texts: Sequence[str]) -> tuple[Pointer, ...]:
    """Return a canser_texts, and what it points to."""
    encoded = [text.encode() for text in texts]
    size = sum(map(len, encoded))
    if size > _TEXTS_MOST:
        raise ValueError(
            f"the texts of a column are {size:,} bytes; Arrow has up to {_TEXTS_MOST:,} in one"
        )
    ends = ffi.new("int32_t[]", [0, *np.cumsum([len(text) for text in encoded]).tolist()])
    joined = ffi.from_buffer(b"".join(encoded) + b"\0")
    return ffi.new("canser_texts *", (joined, ends, len(encoded))), joined, ends


class _View:
    """Owns a table as long as an array of its values is in use."""

    def __init__(
        self,
        table: Pointer,
        values: Pointer,
        dtype: str,
        shape: tuple[int, ...],
        writeable: bool,
    ) -> None:
        lib.canser_table_share(table)
        self._table = ffi.gc(ffi.cast("canser_table *", table), lib.canser_table_release)
        self.__array_interface__ = {
            "version": 3,
            "typestr": dtype,
            "shape": shape,
            "data": (int(ffi.cast("uintptr_t", values)), not writeable),
        }
