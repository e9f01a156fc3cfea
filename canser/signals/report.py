"""What decoding with a database found, and what it did not, and why."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["UNKNOWN_ID_DTYPE", "DecodeReport"]

# An id that no message of the database has.
UNKNOWN_ID_DTYPE = np.dtype([("id", np.uint32), ("ext", np.bool_), ("count", np.int64)])


@dataclass(frozen=True, eq=False, kw_only=True)
class DecodeReport:
    """What decoding found, and what it did not, and why.

    Attributes
    ----------
    frame_count : int
        All frames.
    messages : mapping of str to int
        Frames by the name of their message.
    unknown_ids : array of UNKNOWN_ID_DTYPE, shape (k,)
        Ids that no message has, the most frequent first.
    never_seen : tuple of str
        Messages that no frame belongs to.
    short : mapping of str to int
        Frames that are too short for a signal, by their message. The signals that fit are decoded.
    unknown_pages : mapping of str to int
        Frames with a value of a multiplexer that the database does not know, by their message.
    remote_count, error_count : int
        Remote frames and error frames, which have no signals.
    """

    frame_count: int
    messages: Mapping[str, int]
    unknown_ids: npt.NDArray[np.void]
    never_seen: tuple[str, ...]
    short: Mapping[str, int]
    unknown_pages: Mapping[str, int]
    remote_count: int
    error_count: int
