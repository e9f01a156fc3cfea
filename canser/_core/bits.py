"""The lengths of frames on the bus; see canser_frame_bits."""

import functools

import numpy as np
import numpy.typing as npt

from canser._core._lib import ffi, lib
from canser._core.buffers import Pointer, input_frames, raise_status
from canser._frames import FrameArray

__all__ = ["count_bits"]


@functools.cache
def _tables() -> Pointer:
    tables = ffi.new("canser_bits *")
    lib.canser_bits_init(tables)
    return tables


def count_bits(frames: FrameArray) -> npt.NDArray[np.uint8]:
    """Return the bits of each of contiguous frames."""
    bits = np.empty(len(frames), np.uint8)
    status = lib.canser_frame_bits(
        _tables(), input_frames(frames), len(frames), ffi.from_buffer("uint8_t[]", bits)
    )
    if status:
        raise_status(status)
    return bits
