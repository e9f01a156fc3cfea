"""numpy's .npy: the array of frames as it is, to be opened with np.load(mmap_mode="r").

Source: numpy's `lib.format`. Its header has room for a longer first dimension, so
the number of frames is written when it is known.
"""

import shutil
import tempfile
from collections.abc import Iterator
from typing import BinaryIO, Final, cast

import numpy as np
from numpy.lib import format as npy

from canser._frames import FRAME_DTYPE, FrameArray, reason_invalid
from canser._input import Input
from canser.errors import FormatError
from canser.files._remarks import Tell, tell_all
from canser.files.reader import DecodedReader, Reader, ReadOptions
from canser.files.writer import WriteOptions

about: Final = "a .npy file of numpy"

suffixes: Final = (".npy",)

cannot_hold: Final = ()

# Frames that are handed on at a time.
_BLOCK = 1 << 16


def sniff(head: bytes) -> bool:
    """Return whether these are the first bytes of an array in a file."""
    return head.startswith(npy.MAGIC_PREFIX)


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a file."""
    return DecodedReader(source, options, parse)


def write(file: BinaryIO, options: WriteOptions) -> "Writer":  # noqa: ARG001 - as every format
    """Begin a file."""
    return Writer(file)


def _temporary() -> BinaryIO:
    return cast(BinaryIO, tempfile.TemporaryFile())


class Writer:
    """Write frames behind a header that is completed at the end."""

    def __init__(self, file: BinaryIO) -> None:
        self._target = file
        # A pipe cannot go back to its header: the file is made elsewhere first.
        self._file = file if file.seekable() else _temporary()
        self._count = 0
        self._start = self._file.tell()
        self._write_header()

    def _write_header(self) -> None:
        npy.write_array_header_1_0(
            self._file,
            {
                "descr": npy.dtype_to_descr(FRAME_DTYPE),
                "fortran_order": False,
                "shape": (self._count,),
            },
        )

    def write(self, frames: FrameArray) -> None:
        """Append frames."""
        self._file.write(frames.view(np.uint8).data)
        self._count += len(frames)

    def finish(self) -> list[str]:
        """Write the number of frames; return what the file could not hold: nothing."""
        end = self._file.tell()
        self._file.seek(self._start)
        self._write_header()
        self._file.seek(end)
        if self._file is not self._target:
            self._file.seek(0)
            shutil.copyfileobj(self._file, self._target, 1 << 20)
            self._file.close()
        return []


def parse(file: BinaryIO, name: str, tell: Tell | None = None) -> Iterator[FrameArray]:
    """Yield the frames of a file, block by block.

    `file`: open for reading bytes; `name`: what messages call it. `tell` is called at the end
    with a remark where something lies behind the array; without it that is a CanserWarning.
    FormatError for what is no array of FRAME_DTYPE, or holds fewer frames than its header says.
    """
    try:
        version = npy.read_magic(file)
        read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = read_header(file)
    except Exception as error:  # noqa: BLE001 - numpy evaluates the header: anything may come
        reason = str(error).partition("\n")[0]
        raise FormatError(f"{name}: no .npy file: {reason}") from None
    if dtype != FRAME_DTYPE or len(shape) != 1 or shape[0] < 0:
        raise FormatError(
            f"{name}: holds {dtype} of shape {shape}; canser reads arrays of "
            "canser.FRAME_DTYPE in one dimension"
        )
    left = shape[0]
    while left:
        size = min(left, _BLOCK) * FRAME_DTYPE.itemsize
        raw = file.read(size)
        if len(raw) < size:
            have = shape[0] - left + len(raw) // FRAME_DTYPE.itemsize
            raise FormatError(f"{name}: ends after {have} of {shape[0]} frames; is it cut off?")
        frames = np.frombuffer(raw, FRAME_DTYPE)
        _check(frames, shape[0] - left, name)
        yield frames
        left -= len(frames)
    behind = 0
    while more := len(file.read(_BLOCK)):
        behind += more
    if behind:
        tell_all([f"bytes behind the array, which are not read: {behind:,}"], name, tell)


def _check(frames: FrameArray, first: int, name: str) -> None:
    """Raise FormatError for the first record that is no CAN frame."""
    limit = np.where(frames["ext"], 0x1FFF_FFFF, 0x7FF)
    for index in np.flatnonzero((frames["id"] > limit) | (frames["dlc"] > 8))[:1]:
        row = frames[index]
        found = reason_invalid(int(row["id"]), bool(row["ext"]), int(row["dlc"]))
        raise FormatError(f"{name}, frame {first + index}: {found}")
