"""The doubt whether bytes are of a protocol: too many of them lie in no packet."""

import functools
from typing import Final

import numpy as np

from canser._core.buffers import input_bytes, output_room
from canser._core.stream import Stream
from canser._core.table import find_protocol
from canser._frames import FRAME_DTYPE

__all__ = ["LEAST_BYTES", "has_marks", "is_doubtful", "most_skipped"]

# Fewer bytes than this prove nothing. A capture may begin and end inside a packet, and one burst of
# noise is a large share of a short capture.
LEAST_BYTES: Final = 1000

# The shares of skipped bytes that tell a wrong protocol from a noisy line. Measured:
# - A line that damages 1 byte in 100 skips 10 % of the bytes where packets have marks, and 2 % in
#   `cantalope`, which has none.
# - Bytes of a wrong baud rate are skipped like random bytes: nearly all of them where packets have
#   marks, and a ninth in `cantalope`, where nearly any bytes are a frame.
# - Of bytes of another protocol fewer may be skipped where packets have no marks: they have more
#   zeros, which look like packets. The captures of real traffic give at least 0.31 of the share
#   that random bytes give. A `cantalope` line that damages 1 byte in 20 gives 0.28 of it.
_HALF: Final = 0.5
_MARKED: Final = 0.99
_SHARE_OF_RANDOM: Final = 0.3

_RANDOM_LEN: Final = 1 << 15


def most_skipped(protocol: str) -> float:
    """Return the share of skipped bytes above which bytes are not of a protocol."""
    return _HALF if has_marks(protocol) else _SHARE_OF_RANDOM * _skipped_of_random(protocol)


def has_marks(protocol: str) -> bool:
    """Return whether packets have marks, so that random bytes hold hardly any packet."""
    return _skipped_of_random(protocol) > _MARKED


@functools.cache
def _skipped_of_random(protocol: str) -> float:
    """Return the share of random bytes that lies in no packet."""
    import random  # noqa: PLC0415 - slow, and often not needed

    stream = Stream(find_protocol(protocol), 1)
    data = input_bytes(random.Random(1).randbytes(_RANDOM_LEN))
    room = np.empty(_RANDOM_LEN, FRAME_DTYPE)  # for more frames than there can be
    used = 0
    while used < len(data):
        stream.aim_at(*output_room(room, 0, None))
        used += stream.feed(data + used, len(data) - used)[-1]
    return stream.skipped / len(data)


def is_doubtful(protocol: str, bytes_in: int, bytes_skipped: int) -> bool:
    """Return whether too many bytes were skipped for the bytes to be of a protocol."""
    if bytes_in < LEAST_BYTES or not bytes_skipped:
        return False
    return bytes_skipped > most_skipped(protocol) * bytes_in
