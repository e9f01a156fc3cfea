"""When bytes came: bytes with their arrival, and the rule that dates the earlier ones of them."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["DataBlock", "DataRun", "count_back"]


class DataBlock(NamedTuple):
    """Some bytes of a line, and when they came."""

    #: The bytes; none where bytes were lost that no others followed.
    data: memoryview | bytes
    #: When the last of them had come, in epoch nanoseconds.
    arrival_ns: int
    #: Bytes of the line that are lost right before; -1: their number is unknown.
    lost: int = 0
    #: Whether bytes are missing right before, or may be.
    gap: bool = False


class DataRun(NamedTuple):
    """The bytes of some blocks, one behind the other, with nothing missing between them."""

    #: The bytes, good until the next run; none where bytes were lost that no others followed.
    data: memoryview
    #: Where in `data` each block ends: ascending, the last one at its end.
    ends: npt.NDArray[np.int64]
    #: When the last byte of each block had come, in epoch nanoseconds.
    times: npt.NDArray[np.int64]
    #: Bytes of the line that are lost right before `data`; -1: their number is unknown.
    lost: int = 0
    #: Whether bytes are missing right before `data`, or may be.
    gap: bool = False


def count_back(arrival_ns: int, byte_count: int, byte_ns: float, earliest_ns: int) -> int:
    """Return when a byte came that so many bytes came behind, the last of them at `arrival_ns`.

    Bytes come one behind the other, each after `byte_ns` nanoseconds of the line. But what was
    read later than something else did not come before it, even where the line is faster than
    its bit rate says: `earliest_ns` is when the bytes before had come.
    """
    return max(arrival_ns - int(byte_count * byte_ns), min(earliest_ns, arrival_ns))
