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

# Of many frames so many are decoded before they get their times: few enough that they are still in
# the cache.
_TIMED_AT_ONCE: Final = 16384


class TimedDecoder:
    """Decodes one stream of timed bytes into arrays that its owner gives.

    The owner tells `clock.arrivals` when bytes have come, gives these bytes to `feed`, calls
    `flush` and `gap` where bytes are missing, and `assign_times` before it takes frames. What
    comes out does not depend on how bytes are cut into calls, nor on the size of the arrays.

    `byte_ns`: what a byte takes on the line. With `device_time` frames keep the times of the
    device's clock. `recorded`: the bytes come in blocks of a recording. For one thread at a time.

    No exception, of Ctrl-C either, loses a frame: `count` tells how many frames the array has.
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

        `offsets`: int64 or uint64, as long as `frames`: where each frame begins in the stream.
        """
        begins = None if offsets is None else offsets.view(np.int64)
        ends = None
        # Where the byte is whose time counts.
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
        """How many frames of the array have their times, the first ones."""
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
        """End the packet that is held, and decode the rest of its bytes until there are `most`.

        Again with more room while `decoder.pending` is not 0.
        """
        self.decoder.flush_room(self._room, self.count, most)

    def gap(self) -> None:
        """Go on behind a gap. What was held before it is flushed."""
        self.assign_times()
        self.clock.gap()

    def assign_times(self) -> None:
        """Give the frames that have none their times."""
        self.clock.assign_times(self._room, self.count, self.border)
