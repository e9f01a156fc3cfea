"""The exact lengths of frames on the bus: `canser.frame_bits`."""

import numpy as np
import numpy.typing as npt

from canser._core.bits import count_bits
from canser._frames import FrameArray, contiguous_frames

__all__ = ["frame_bits"]


def frame_bits(frames: FrameArray) -> npt.NDArray[np.uint8]:
    """Return the number of bits that each frame takes on the bus.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,)
        The frames, contiguous or not.

    Returns
    -------
    array of uint8, shape (n,)
        Bits from the start of a frame to the end of the pause behind it, 47 to 160; 0 for an error
        frame, whose length is not known.

    Raises
    ------
    TypeError
        `frames` is no array of FRAME_DTYPE.
    ValueError
        The shape is not (n,).

    Notes
    -----
    The bits are those of classic CAN: start of frame, identifier, control bits, data and CRC with
    their stuff bits, then CRC delimiter, ACK, its delimiter, end of frame (7), and the pause of 3
    bits. The stuff bits depend on the data and on the CRC, which is computed. A remote frame has
    no data, whatever its dlc.

    Source: CAN 2.0 (Bosch, 1991), 3.1 and 5.

    Examples
    --------
    >>> canser.frame_bits(canser.frames("123#", "123#0102030405060708", "123#R8"))
    array([ 48, 119,  48], dtype=uint8)
    """
    return count_bits(contiguous_frames(frames))
