"""From a ring of raw bytes to frames with host times: gaps, control packets, the watchdog."""

import math
import time
import warnings
from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np

from canser import adapters
from canser._core.table import find_protocol
from canser._frames import FRAME_DTYPE, FrameArray, put_records
from canser.adapters import AdapterReport
from canser.codec.decoder import Control
from canser.codec.doubt import is_doubtful
from canser.errors import CanserWarning, PortError
from canser.live.ring import Gap, Read, Ring
from canser.live.setup import SILENCE_S, Setup
from canser.timing.host import ClockSteps, describe_step
from canser.timing.loop import TimedDecoder

__all__ = ["LiveStream", "OnBytes", "Watchdog"]

# `on_bytes(data, arrival_ns, lost)`: the bytes of a read, when they had arrived in epoch
# nanoseconds, and the number of bytes that are missing before them (-1: it is unknown). If the last
# bytes of a stream are missing, a call without bytes reports that.
OnBytes = Callable[[memoryview, int, int], None]

# Room for frames, unless a caller asks for more.
_ROOM_FRAMES: Final = 4096

# The share of skipped bytes is checked each time that this many bytes have come. A large share
# means a wrong baud rate or protocol.
_WRONG_BYTES: Final = 4096

# The most control packets, and the most gaps, that are kept for a caller: the newest ones.
_KEPT: Final = 1 << 16

# Bytes in which a ping is looked for at a time.
_SEARCH_BYTES: Final = 1 << 16

# A ping that has not come back after this many periods is lost.
_PATIENCE_PERIODS: Final = 2.5

# While an adapter is set up, a wait checks at this interval whether the adapter has answered.
_LOOK_EVERY_S: Final = 0.1

# The interval of checks whether the host's clock was set.
_CLOCK_S: Final = 1.0

# Frames come soon if they are due within this time, at the rate of the frames before.
_SOON_S: Final = 0.02


class Watchdog:
    """The pings that go out, as a stream has to know them.

    `ping_s`: seconds between two pings. `now` returns the time, and `last_ping` when the last ping
    went out on this line, 0 for none; both in epoch nanoseconds.
    """

    def __init__(self, ping_s: float, now: Callable[[], int], last_ping: Callable[[], int]) -> None:
        self.ping_s, self.now, self.last_ping = ping_s, now, last_ping


class LiveStream:
    """Decode the bytes of a ring. Not safe for two threads: the owner must take a lock.

    Frames are decoded into an array of the stream's own, and stay there until they are taken. So
    no exception, of `on_bytes` or by Ctrl-C, loses a byte or a frame.

    `steps`: the steps of the system's clock, compared to the clock of the times in the ring.
    """

    def __init__(
        self,
        url: str,
        ring: Ring,
        loop: TimedDecoder,
        *,
        steps: ClockSteps,
        on_bytes: OnBytes | None,
        watchdog: Watchdog | None,
        setup: Setup | None,
    ) -> None:
        self.loop, self.decoder, self.ring = loop, loop.decoder, ring
        self.controls: deque[Control] = deque(maxlen=_KEPT)
        self.gaps: deque[Gap] = deque(maxlen=_KEPT)
        self.status: AdapterReport | None = None  # the last one that came
        self.on_bytes = on_bytes
        self.url, self._watchdog, self._setup = url, watchdog, setup
        row = find_protocol(self.decoder.protocol)
        self._frame_min = row.frame_min
        self._frames = np.empty(_ROOM_FRAMES, FRAME_DTYPE)
        self._taken = 0  # frames of the array that are taken
        loop.use(self._frames)
        self._new_reads: deque[Read] = deque()  # not given to `on_bytes` yet
        self._missing = 0  # bytes lost before the next read; -1: it is unknown how many
        self._ping = b"" if watchdog is None else row.ping
        # Epoch nanoseconds.
        self._ping_sent = 0  # when the ping went out that shall come back; 0 for none
        self._ping_back = 0  # when the last ping came back
        self._arrived = 0  # when the last read had arrived
        self._fresh = False  # whether reads have come since frames got their times
        self._searching = False  # the ping is lost: look for it in the bytes
        self._checked = (0, 0)  # bytes in and bytes skipped at the last check of their share
        self._warned: set[str] = set()
        self.steps, self._steps_due = steps, 0.0
        # None: Python's warnings.
        self.on_warning: Callable[[str], None] | None = None
        self.on_clock_set: Callable[[int], None] | None = None  # of nanoseconds forward

    # Frames

    @property
    def ready(self) -> int:
        """The number of frames that are decoded and not taken."""
        return self.loop.count - self._taken

    def take_into(self, out: FrameArray) -> int:
        """Move frames that are ready into `out`; return how many."""
        count = min(self.ready, len(out))
        put_records(out[:count], self._frames[self._taken : self._taken + count])
        self._taken += count
        return count

    def read(self, most: int, least: int, deadline: float | None) -> int:
        """Decode the bytes of the ring until `most` frames are ready; return how many are.

        Waits until `least` are, or until the deadline (of time.monotonic(); None: for ever).
        Raises the error that has ended the stream, after all frames before it are taken.
        """
        begin, start, had = time.monotonic(), self.loop.position, self.ready
        while True:
            self._watch()
            self.warn_of_silence(5)
            count = self.decode(most)
            if count >= least:
                return count
            error = self.end_error()
            if error is not None:
                count = self._end(most)
                if count:
                    return count
                raise error
            missing, came = least - count, self.loop.position - start
            if came and count > had:
                # If the missing frames will come soon, wait for their mean number of bytes. To wait
                # for the smallest possible number would wake this thread many times in vain.
                now = time.monotonic()
                soon = now + (now - begin) * missing / (count - had)
                if (
                    soon < now + _SOON_S
                    and (deadline is None or soon < deadline)
                    and self._wait(max(missing * came // (count - had), 1), soon)
                ):
                    continue
            wanted = missing * self._frame_min - self.decoder.pending
            if not self._wait(max(wanted, 1), deadline):
                # The bytes that have come may hold some frames.
                return self.decode(most)

    def decode(self, most: int) -> int:
        """Decode the bytes of the ring until `most` frames are ready; return how many are.

        Does not wait.
        """
        limit = self._make_room(most)
        try:
            self._decode(limit)
        except BaseException:
            # The decoder may have taken bytes. Otherwise they would be decoded a second time.
            self.ring.release_to(self.loop.position)
            self._keep_controls()
            self._assign_times()
            raise
        self._assign_times()
        self._check_share()
        self._check_clock()
        return self.ready

    def _end(self, most: int) -> int:
        """End the stream: decode the bytes that are held, too, and report missing bytes."""
        limit = self._make_room(most)
        self.loop.flush(limit)
        self._keep_controls()
        self._assign_times()
        self.report_missing()
        return self.ready

    def report_missing(self) -> None:
        """Report missing bytes at the end of the stream to `on_bytes`."""
        if self._missing and self.on_bytes is not None:
            self.on_bytes(memoryview(b""), self._arrived, self._missing)
            self._missing = 0

    def _make_room(self, most: int) -> int:
        """Make room for `most` frames that are not taken, or for those that the ring can hold.

        Returns the place in the array where the room ends.
        """
        loop = self.loop
        count = loop.count
        ready = count - self._taken
        if loop.timed < count:
            loop.assign_times()  # an exception has prevented it before
        if self._taken and not ready:
            loop.restart()
            self._taken = 0
        most = min(most, ready + (len(self.ring) + self.decoder.pending) // self._frame_min + 1)
        if self._taken + most > len(self._frames):
            frames = np.empty(max(most, len(self._frames)), FRAME_DTYPE)
            put_records(frames[:ready], self._frames[self._taken : self._taken + ready])
            loop.use(frames, kept=ready)
            self._frames, self._taken = frames, 0
        return self._taken + most

    def _decode(self, limit: int) -> None:
        """Decode the bytes of the ring until the array has `limit` frames."""
        loop, ring = self.loop, self.ring
        while not ring.idle and loop.count < limit:
            data = self._peek()
            if not len(data):
                if ring.at_gap:
                    self._flush(limit)  # the packet that is held will never be whole
                if self.decoder.pending or (gap := ring.take_gap()) is None:
                    break
                self._pass(gap)
                continue
            if self._searching and (at := bytes(data[:_SEARCH_BYTES]).find(self._ping)) >= 0:
                if at == 0:
                    self._flush(limit)
                    self._searching = bool(self.decoder.pending)
                    continue
                data = data[:at]
            elif self._searching:
                data = data[:_SEARCH_BYTES]
            loop.feed(data, limit)
            ring.release_to(loop.position)
            self._keep_controls()

    def _peek(self) -> memoryview:
        """Return the next bytes of the ring; give new ones to `on_bytes` and to the clock."""
        data, reads = self.ring.peek()
        begin = self.loop.position
        self._new_reads.extend(reads)
        while self._new_reads:  # an exception may have left some
            read = self._new_reads.popleft()
            self.loop.clock.arrivals.add(read.end, read.ns)
            self._arrived = read.ns
            self._fresh = True
            if self.on_bytes is not None:
                self.on_bytes(data[read.begin - begin : read.end - begin], read.ns, self._missing)
                self._missing = 0
        return data

    def _flush(self, limit: int) -> None:
        self.loop.flush(limit)
        self._keep_controls()

    def _pass(self, gap: Gap) -> None:
        """Note a gap, and go on behind it."""
        self.loop.gap()
        self.gaps.append(gap)
        self._arrived = max(self._arrived, gap.ts)
        self._missing = -1 if -1 in (gap.lost, self._missing) else self._missing + gap.lost
        if gap.reason == "reconnect":
            self._ping_sent, self._searching = 0, False

    def _assign_times(self) -> None:
        """Give new frames their times."""
        if self._fresh or self.loop.timed < self.loop.count:
            self._fresh = False
            self.loop.assign_times()
            if self.loop.clock.remark is not None:
                self._warn("clock", f"{self.url}: {self.loop.clock.remark}")

    def _keep_controls(self) -> None:
        if not self.decoder.has_controls:
            return
        for control in self.decoder.take_controls():
            if self._setup is not None and self._setup.take_answer(control.offset):
                continue
            self.controls.append(control)
            report = adapters.report(self.decoder.protocol, control.data)
            if report.kind == "ping":
                self._ping_back = self._arrived
                self._searching = False
            elif report.kind == "status":
                self.status = report

    # Waiting

    def _wait(self, wanted: int, deadline: float | None) -> bool:
        """Wait for bytes; check meanwhile whether the adapter answers pings and requests."""
        while True:
            pause = math.inf if self._watchdog is None else self._watchdog.ping_s
            if self._setup is not None and self._setup.active:
                pause = min(pause, _LOOK_EVERY_S)
            soon = time.monotonic() + pause
            if pause == math.inf or (deadline is not None and soon >= deadline):
                return self.ring.wait(wanted, deadline)
            if self.ring.wait(wanted, soon):
                return True
            self._watch()
            self.warn_of_silence(6)

    def _watch(self) -> None:
        """Check whether the ping that went out comes back in time."""
        watchdog = self._watchdog
        if watchdog is None:
            return
        now, last_ping = watchdog.now(), watchdog.last_ping()
        if self._ping_back >= self._ping_sent:
            self._ping_sent = last_ping if last_ping > self._ping_back else 0
        if not self._ping_sent or not last_ping or self._searching:
            return
        # Bytes that wait in the ring may hold the ping: then only the time until the last read
        # counts.
        seen = self._arrived if len(self.ring) else now
        if seen - self._ping_sent > watchdog.ping_s * _PATIENCE_PERIODS * 1e9:
            self._searching = True
            self.gaps.append(Gap(self.decoder.position, -1, seen, "watchdog"))
            self._warn(
                "ping",
                f"{self.url}: the ping does not come back; looking for the place where frames "
                "start again. Is the adapter on, and the baud rate right?",
            )

    def end_error(self) -> Exception | None:
        """Return the error that has ended the stream; None until all before the end is taken."""
        error = self.ring.error
        if error is None:
            return None
        # A new object, as the error may be raised many times, in several threads.
        if isinstance(error, PortError):
            return type(error)(str(error))
        return PortError(f"{self.url}: {type(error).__name__} {error}".rstrip())

    # Warnings

    def warn_of_silence(self, stacklevel: int) -> None:
        """Warn, once, if the adapter did not answer when it was set up.

        `stacklevel`: of `warnings.warn`, so that the warning names the user's code.
        """
        if self._setup is not None and self._setup.take_silence():
            self._warn(
                "silence",
                f"{self.url} did not answer its status request within {SILENCE_S:g} s; frames "
                "are sent without an answer, and the first ones may be lost. Is the adapter on, "
                "and the baud rate right?",
                stacklevel=stacklevel,
            )

    def _check_share(self) -> None:
        """Warn if too large a share of the last bytes was skipped."""
        position, (bytes_in, skipped) = self.loop.position, self._checked
        if position - bytes_in < _WRONG_BYTES:
            return
        self._checked = position, self.decoder.skipped
        came, came_skipped = position - bytes_in, self._checked[1] - skipped
        if is_doubtful(self.decoder.protocol, came, came_skipped):
            share = came_skipped / came
            self._warn(
                "share",
                f"{self.url}: {share:.0%} of the bytes are in no {self.decoder.protocol} frame; "
                "are the baud rate and the protocol right?",
            )

    def _check_clock(self) -> None:
        """Check whether the host's clock was set; report each time that it was."""
        now = time.monotonic()
        if now < self._steps_due:
            return
        self._steps_due = now + _CLOCK_S
        step_ns = self.steps.look()
        if not step_ns:
            return
        if self.on_clock_set is not None:
            self.on_clock_set(step_ns)
            return
        self._warn(
            "",
            f"{self.url}: {describe_step(step_ns)} while the port is open; times go on as "
            "before; open the port again for the new time",
        )

    def _warn(self, kind: str, text: str, *, stacklevel: int = 6) -> None:
        """Warn: once of each kind, but every time of the kind ""."""
        if kind in self._warned:
            return
        if kind:
            self._warned.add(kind)
        if self.on_warning is not None:
            self.on_warning(text)
        else:
            warnings.warn(text, CanserWarning, stacklevel=stacklevel)
