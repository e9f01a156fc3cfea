"""numpy's .npy: the array of frames, which np.load(mmap_mode="r") can open.

Source: numpy's `lib.format`. Its header has room for a longer first dimension, so the number of
frames is written at the end, when it is known.
"""

from collections.abc import Iterator
from typing import BinaryIO, Final

import numpy as np
from numpy.lib import format as npy

from canser._frames import FRAME_DTYPE, FrameArray, reason_invalid
from canser._input import Input
from canser.errors import FormatError
from canser.files.reader import DecodedReader, Reader, ReadOptions
from canser.files.remarks import AddRemark, report_remarks
from canser.files.writer import WriteOptions, give, patchable

about: Final = "a .npy file of numpy"

cannot_hold: Final = ("the channel", "the direction")

# Frames in a block: 1.5 MiB of records.
_BLOCK = 1 << 16


def sniff(head: bytes) -> bool:
    """Return whether a file starts as an array of numpy does."""
    return head.startswith(npy.MAGIC_PREFIX)


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a file."""
    return DecodedReader(source, options, parse)


def write(file: BinaryIO, options: WriteOptions) -> "Writer":  # noqa: ARG001 - as every format
    """Begin a file."""
    return Writer(file)


class Writer:
    """Writes frames behind a header that is completed at the end."""

    def __init__(self, file: BinaryIO) -> None:
        self._target = file
        self._file = patchable(file)
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
        """Write the number of frames; return no remarks, as the file holds everything."""
        end = self._file.tell()
        self._file.seek(self._start)
        self._write_header()
        self._file.seek(end)
        give(self._file, self._target)
        return []


def parse(file: BinaryIO, name: str, add_remark: AddRemark | None = None) -> Iterator[FrameArray]:
    """Yield the frames of a file, block by block.

    FormatError if the file holds no array of FRAME_DTYPE, or fewer frames than its header says.

    Parameters
    ----------
    file
        A file that is open for reading bytes.
    name
        Name of the file in messages.
    add_remark
        Called at the end with a remark if bytes follow the array. Without it, the remark is a
        CanserWarning.
    """
    try:
        version = npy.read_magic(file)
        read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = read_header(file)
    except Exception as error:  # noqa: BLE001 - numpy evaluates the header: any error may come
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
        remark = f"bytes behind the array, which are not read: {behind:,}"
        report_remarks([remark], name, add_remark)


def _check(frames: FrameArray, first: int, name: str) -> None:
    """Raise FormatError for the first record that is no CAN frame."""
    limit = np.where(frames["ext"], 0x1FFF_FFFF, 0x7FF)
    for index in np.flatnonzero((frames["id"] > limit) | (frames["dlc"] > 8))[:1]:
        row = frames[index]
        found = reason_invalid(int(row["id"]), bool(row["ext"]), int(row["dlc"]))
        raise FormatError(f"{name}, frame {first + index}: {found}")
