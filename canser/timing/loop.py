"""The loop from the bytes of a line, with arrivals and gaps, to frames with host times."""

from typing import Final

import numpy as np

from canser._core.buffers import BytesLike, FrameRoom, Offsets, Times, input_bytes
from canser._core.table import find_protocol
from canser._frames import FRAME_DTYPE, FrameArray
from canser._protocols import tick_ns
from canser.codec.decoder import Decoder
from canser.timing.clocks import FrameClock

__all__ = ["TimedDecoder"]

# Frames that are decoded before they get their times: few enough to be still in the cache.
_TIMED_AT_ONCE: Final = 16384


class TimedDecoder:
    """Decodes one stream of timed bytes into arrays that its owner gives.

    The owner notes in `clock.arrivals` when bytes have come, gives these bytes to `feed`, calls
    `flush` and `gap` where bytes are missing, and calls `assign_times` before it takes frames. The
    frames do not depend on how bytes are cut into calls, nor on the lengths of the arrays.

    `byte_ns` is the time of a byte on the line. With `device_time` frames keep the times of the
    device's clock. With `recorded` the bytes come in blocks of a recording. A decoder is used by
    one thread at a time.

    No exception loses a frame, not even one of Ctrl-C: `count` is always the number of frames in
    the array.
    """

    def __init__(
        self,
        decoder: Decoder,
        byte_ns: float,
        *,
        device_time: bool = False,
        recorded: bool = False,
    ) -> None:
        self.decoder = decoder
        self._counters = decoder.counters
        clocked = find_protocol(decoder.protocol).has_clock
        self.clock = FrameClock(
            tick_ns(decoder.ts_unit) if clocked else None,
            byte_ns,
            device_time=device_time,
            recorded=recorded,
        )
        self._scratch = np.empty(0, np.int64)
        self.use(np.empty(1, FRAME_DTYPE))

    def use(self, frames: FrameArray, offsets: Offsets | None = None, *, kept: int = 0) -> None:
        """Put the next frames into an array, behind `kept` frames that are finished.

        `offsets` is an array of int64 or uint64 as long as `frames`, for the stream offset of each
        frame.
        """
        begins = None if offsets is None else offsets.view(np.int64)
        ends = None
        # Room for the offset of the byte whose time is the frame's.
        if not self.clock.by_begin:
            ends = self._use_scratch(len(frames))
        elif begins is None:
            begins = self._use_scratch(len(frames))
        self._room = FrameRoom(frames, begins, ends)
        self.restart(kept)

    def _use_scratch(self, count: int) -> Times:
        if len(self._scratch) < count:
            self._scratch = np.empty(count, np.int64)
        return self._scratch[:count]

    def restart(self, kept: int = 0) -> None:
        """Put the next frames into the same array, behind `kept` frames that are finished."""
        self._begin = int(self._counters.frames) - kept  # the array's first frame in the stream
        self._room.timed = kept

    @property
    def timed(self) -> int:
        """How many frames of the array have their times; they are the first ones."""
        return self._room.timed

    @property
    def count(self) -> int:
        """The frames in the array."""
        return int(self._counters.frames) - self._begin

    @property
    def position(self) -> int:
        """The stream offset behind all bytes taken."""
        return int(self._counters.bytes_in)

    @property
    def border(self) -> int:
        """The stream offset behind the last packet that was decoded."""
        return self.position - self.decoder.pending

    def feed(self, data: BytesLike, most: int) -> int:
        """Decode bytes until the array has `most` frames; return how many bytes were used."""
        source, room = input_bytes(data), self._room
        size = len(source)
        feed_room, used = self.decoder.feed_room, 0
        while True:
            count = self.count
            limit = min(room.timed + _TIMED_AT_ONCE, most)
            used += feed_room(source + used, size - used, room, count, limit)
            if used == size or limit == most:
                return used
            self.assign_times()

    def flush(self, most: int) -> None:
        """End the held packet, and decode the rest of its bytes until there are `most` frames.

        Call again with more room while `decoder.pending` is not 0.
        """
        self.decoder.flush_room(self._room, self.count, most)

    def gap(self) -> None:
        """Go on behind a gap. The bytes held before it are flushed."""
        self.assign_times()
        self.clock.gap()

    def assign_times(self) -> None:
        """Set the times of the frames that have none yet."""
        self.clock.assign_times(self._room, self.count, self.border)
