"""From a ring of raw bytes to frames with host times: gaps, control packets, the watchdog."""

import warnings
from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np

from canser import adapters
from canser._core.table import find_protocol
from canser._frames import FrameArray
from canser.adapters import AdapterReport
from canser.codec.decoder import Control, Decoder
from canser.codec.doubt import is_doubtful
from canser.errors import CanserWarning
from canser.live.ring import Gap, Read, Ring
from canser.live.setup import Setup
from canser.timing.clocks import FrameClock

__all__ = ["LiveStream", "OnBytes"]

# Called with the bytes of each read, the time at which they had arrived, and the number of bytes
# that are missing before them (-1: it is unknown).
OnBytes = Callable[[memoryview, int, int], None]

# A wrong baud rate or protocol is told from noise by this many bytes at a time.
_WRONG_BYTES: Final = 4096

# Control packets and gaps that are not taken: the newest ones are kept, this many of each.
_KEPT: Final = 1 << 16

# A lost ping is looked for in this many bytes at a time.
_SEARCH: Final = 1 << 16

# A ping that has not come back after this many periods is lost.
_PATIENCE_PERIODS: Final = 2.5


class LiveStream:
    """Decode what a ring holds. Not safe for two threads: its owner takes a lock.

    `ping_s`: seconds between the pings of the watchdog; 0 for none. With `device_time`
    frames keep the times that they come with.
    """

    def __init__(
        self,
        url: str,
        ring: Ring,
        decoder: Decoder,
        frame_clock: FrameClock,
        setup: Setup,
        *,
        on_bytes: OnBytes | None,
        ping_s: float,
        device_time: bool,
    ) -> None:
        self.decoder, self.frame_clock = decoder, frame_clock
        self.controls: deque[Control] = deque(maxlen=_KEPT)
        self.gaps: deque[Gap] = deque(maxlen=_KEPT)
        self.status: AdapterReport | None = None  # the last one that came
        self.filled = 0  # frames in the room that was given last
        self._timed = 0  # of these, those that have their times
        self._decoded = 0  # frames of the whole stream
        self._url, self._ring, self._on_bytes = url, ring, on_bytes
        self._setup = setup
        self._offsets = np.empty(0, np.int64)
        self._device_time = device_time
        self._untold: deque[Read] = deque()  # not given to `on_bytes` yet
        self._missing = 0  # bytes lost before the next read; -1: it is unknown how many
        self._ping = find_protocol(decoder.protocol).ping if ping_s else b""
        self._patience_ns = int(ping_s * _PATIENCE_PERIODS * 1e9)
        self._asked = 0  # when the ping went out that shall come back; 0 for none
        self._answered = 0  # when the last ping came back
        self._arrived = 0  # when the last read had arrived
        self._fresh = False  # reads have come of which no frame has its time yet
        self._searching = False  # the ping is lost: look for it among the bytes
        self._looked = (0, 0)  # bytes in and skipped when the share was last looked at
        self._warned: set[str] = set()

    def decode_into(self, room: FrameArray, count: int) -> int:
        """Decode into `room` behind its first `count` frames; return how many it has then.

        Takes what the ring holds, as far as there is room. No byte is lost by an exception,
        of `on_bytes` or by Ctrl-C: `filled` tells then how many frames `room` has.
        """
        if len(self._offsets) < len(room):
            self._offsets = np.empty(len(room), np.int64)
        self.filled = self._timed = count
        try:
            self._decode(room)
        except BaseException:
            # It may have come behind the decoder's work, and before that was counted.
            self._ring.release_to(self.decoder.position)
            self._count(self.decoder.stats.frames - self._decoded)
            self._keep_controls()
            self._assign_times(room)
            raise
        self._assign_times(room)
        self._look_at_share()
        return self.filled

    def end_into(self, room: FrameArray, count: int) -> int:
        """End the stream: decode what is held, too."""
        self.filled = self._timed = count
        self._flush(room)
        self._assign_times(room)
        return self.filled

    def watch(self, now: int, last_ping: int) -> None:
        """See whether the ping that went out comes back in time.

        `last_ping`: when the last one went out, epoch nanoseconds; 0: none on this line.
        """
        if self._answered >= self._asked:
            self._asked = last_ping if last_ping > self._answered else 0
        if not self._asked or not last_ping or self._searching:
            return
        # Up to when the bytes are known: those that wait may hold it.
        seen = self._arrived if len(self._ring) else now
        if seen - self._asked > self._patience_ns:
            self._searching = True
            self.gaps.append(Gap(self.decoder.position, -1, seen, "watchdog"))
            self._warn(
                "ping",
                f"{self._url}: the ping does not come back; looking for the place where frames "
                "start again. Is the adapter on, and the baud rate right?",
            )

    def _decode(self, room: FrameArray) -> None:
        """Decode what the ring holds into `room`, behind what it has."""
        while self.filled < len(room):
            data = self._peek()
            if not len(data):
                if self._ring.at_gap:
                    self._flush(room)  # it will never be whole
                if self.decoder.pending or (gap := self._ring.take_gap()) is None:
                    break
                self._assign_times(room)
                self._pass(gap)
                continue
            if self._searching and (at := bytes(data[:_SEARCH]).find(self._ping)) >= 0:
                if at == 0:
                    self._flush(room)
                    self._searching = bool(self.decoder.pending)
                    continue
                data = data[:at]
            elif self._searching:
                data = data[:_SEARCH]
            room_left = room[self.filled :], self._offsets[self.filled :]
            _, count = self.decoder.feed_into(data, *room_left)
            self._count(count)
            self._ring.release_to(self.decoder.position)
            self._keep_controls()

    def _count(self, count: int) -> None:
        """Take note of frames that were decoded into the room."""
        self.filled += count
        self._decoded += count

    def _peek(self) -> memoryview:
        """Return the next bytes of the ring, and tell of those that are new."""
        data, reads = self._ring.peek()
        begin = self.decoder.position
        self._untold.extend(reads)
        while self._untold:  # some may be left by an exception
            read = self._untold.popleft()
            self.frame_clock.add_arrival(read.end, read.ns)
            self._arrived = read.ns
            self._fresh = True
            if self._on_bytes is not None:
                self._on_bytes(data[read.begin - begin : read.end - begin], read.ns, self._missing)
                self._missing = 0
        return data

    def _flush(self, room: FrameArray) -> None:
        """End the packet that is held: decode the rest of its bytes, as far as there is room."""
        while self.decoder.pending and self.filled < len(room):
            room_left = room[self.filled :], self._offsets[self.filled :]
            self._count(self.decoder.flush_into(*room_left))
        self._keep_controls()

    def _pass(self, gap: Gap) -> None:
        """Go on behind a gap."""
        self.frame_clock.gap()
        self.gaps.append(gap)
        self._missing = -1 if -1 in (gap.lost, self._missing) else self._missing + gap.lost
        if gap.reason == "reconnect":
            self._asked, self._searching = 0, False

    def _assign_times(self, room: FrameArray) -> None:
        """Give the frames that are new in `room` their times."""
        new = slice(self._timed, self.filled)
        self._timed = self.filled
        if self._device_time:
            return
        if new.stop > new.start or self._fresh:
            self._fresh = False
            end = self.decoder.position - self.decoder.pending
            self.frame_clock.assign_times(room[new], self._offsets[new], end)
            if self.frame_clock.remark is not None:
                self._warn("clock", f"{self._url}: {self.frame_clock.remark}")

    def _keep_controls(self) -> None:
        for control in self.decoder.take_controls():
            if self._setup.take_answer(control.offset):
                continue
            self.controls.append(control)
            report = adapters.report(self.decoder.protocol, control.data)
            if report.kind == "ping":
                self._answered = self._arrived
                self._searching = False
            elif report.kind == "status":
                self.status = report

    def _look_at_share(self) -> None:
        position, (bytes_in, skipped) = self.decoder.position, self._looked
        if position - bytes_in < _WRONG_BYTES:
            return
        self._looked = position, self.decoder.skipped
        came, bad = position - bytes_in, self._looked[1] - skipped
        if is_doubtful(self.decoder.protocol, came, bad):
            share = bad / came
            self._warn(
                "share",
                f"{self._url}: {share:.0%} of the bytes are in no {self.decoder.protocol} frame; "
                "are the baud rate and the protocol right?",
            )

    def _warn(self, kind: str, text: str) -> None:
        """Warn, once of each kind."""
        if kind not in self._warned:
            self._warned.add(kind)
            warnings.warn(text, CanserWarning, stacklevel=6)
