"""When bytes are not what they are read as: too many of them lie in no packet."""

import functools
import random
from typing import Final

import numpy as np

from canser._core.buffers import input_bytes, output_room
from canser._core.stream import Stream
from canser._core.table import find_protocol
from canser._frames import FRAME_DTYPE

__all__ = ["LEAST_BYTES", "is_doubtful", "most_skipped"]

# Fewer bytes than these tell nothing: a capture may begin and end inside a packet, and one
# burst of noise is a large share of a short capture.
LEAST_BYTES: Final = 1000

# A line that damages 1 byte in 100 skips 10 % of the bytes where packets have marks, and 2 % in
# `cantalope`. Bytes of another protocol, or of a wrong baud rate, are skipped as random bytes
# are: nearly all of them where packets have marks, and a ninth in `cantalope`, where nearly any
# bytes are a frame. So half of the bytes is the limit, or this share of what random bytes give.
_HALF: Final = 0.5
_SHARE_OF_RANDOM: Final = 0.4

_RANDOM_LEN: Final = 1 << 15


@functools.cache
def most_skipped(protocol: str) -> float:
    """Return the share of skipped bytes over which bytes are not of a protocol."""
    stream = Stream(find_protocol(protocol), 1)
    data = input_bytes(random.Random(1).randbytes(_RANDOM_LEN))
    room = np.empty(_RANDOM_LEN, FRAME_DTYPE)  # for more frames than there can be
    used = 0
    while used < len(data):
        stream.aim_at(*output_room(room, 0, None))
        used += stream.feed(data + used, len(data) - used)[-1]
    by_chance = stream.skipped / len(data)
    return _HALF if by_chance > _HALF else _SHARE_OF_RANDOM * by_chance


def is_doubtful(protocol: str, bytes_in: int, bytes_skipped: int) -> bool:
    """Return whether so many of the bytes were skipped that they are not of a protocol."""
    if bytes_in < LEAST_BYTES or not bytes_skipped:
        return False
    return bytes_skipped > most_skipped(protocol) * bytes_in
