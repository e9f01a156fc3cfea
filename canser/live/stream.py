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

# Called with the bytes of each read, the time at which they had arrived, and the number of bytes
# that are missing before them (-1: it is unknown). At the end of a stream without bytes, where
# the last ones are missing.
OnBytes = Callable[[memoryview, int, int], None]

# Frames that are decoded at once, where a caller has not asked for more.
_ROOM: Final = 4096

# A wrong baud rate or protocol is told from noise by this many bytes at a time.
_WRONG_BYTES: Final = 4096

# Control packets and gaps that are not taken: the newest ones are kept, this many of each.
_KEPT: Final = 1 << 16

# A lost ping is looked for in this many bytes at a time.
_SEARCH: Final = 1 << 16

# A ping that has not come back after this many periods is lost.
_PATIENCE_PERIODS: Final = 2.5

# While an adapter is set up, a wait looks this often whether the adapter has answered.
_LOOK_EVERY_S: Final = 0.1

# The time between two looks at whether the host's clock was set.
_CLOCK_S: Final = 1.0

# Frames come soon if they are due within this time, at the rate of those before.
_SOON_S: Final = 0.02


class Watchdog:
    """What a stream knows of the pings that go out.

    `ping_s`: seconds between them. `now` and `last_ping` give epoch nanoseconds: the time, and
    when the last ping went out on this line, 0 for none.
    """

    def __init__(self, ping_s: float, now: Callable[[], int], last_ping: Callable[[], int]) -> None:
        self.ping_s, self.now, self.last_ping = ping_s, now, last_ping


class LiveStream:
    """Decode what a ring holds. Not safe for two threads: its owner takes a lock.

    Frames are decoded into an array of the stream's own, and stay there until they are taken:
    no exception, of `on_bytes` or by Ctrl-C, loses a byte or a frame.

    `steps`: of the system's clock, against the one that times in the ring are of.
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
        self._frames = np.empty(_ROOM, FRAME_DTYPE)
        self._taken = 0  # of the frames in there
        loop.use(self._frames)
        self._untold: deque[Read] = deque()  # not given to `on_bytes` yet
        self._missing = 0  # bytes lost before the next read; -1: it is unknown how many
        self._ping = b"" if watchdog is None else row.ping
        self._asked = 0  # when the ping went out that shall come back; 0 for none
        self._answered = 0  # when the last ping came back
        self._arrived = 0  # when the last read had arrived
        self._fresh = False  # reads have come of which no frame has its time yet
        self._searching = False  # the ping is lost: look for it among the bytes
        self._looked = (0, 0)  # bytes in and skipped when the share was last looked at
        self._warned: set[str] = set()
        self.steps, self._steps_due = steps, 0.0
        # None: Python's warnings.
        self.on_warning: Callable[[str], None] | None = None
        self.on_clock_set: Callable[[int], None] | None = None  # given nanoseconds forward

    # Frames

    @property
    def ready(self) -> int:
        """Frames that are decoded and not taken."""
        return self.loop.count - self._taken

    def take_into(self, out: FrameArray) -> int:
        """Move frames that are ready to `out`; return how many."""
        count = min(self.ready, len(out))
        put_records(out[:count], self._frames[self._taken : self._taken + count])
        self._taken += count
        return count

    def read(self, most: int, least: int, deadline: float | None) -> int:
        """Decode what the ring holds, until `most` frames are ready; return how many are.

        Waits for `least`, until the deadline (of time.monotonic(); None: for ever). Raises
        what has ended the stream, after all that came before is taken.
        """
        begin, start, had = time.monotonic(), self.loop.position, self.ready
        while True:
            self._watch()
            self.tell_silence(5)
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
                # Where all will be there soon, wait for the bytes that they have on average:
                # waking for the fewest that may do would be many times for nothing.
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
                # Less than was hoped for may still be some.
                return self.decode(most)

    def decode(self, most: int) -> int:
        """Decode what the ring holds, until `most` frames are ready; return how many are."""
        limit = self._make_room(most)
        try:
            self._decode(limit)
        except BaseException:
            # It may have come behind the decoder's work, and before what is done for that.
            self.ring.release_to(self.loop.position)
            self._keep_controls()
            self._assign_times()
            raise
        self._assign_times()
        self._look_at_share()
        self._look_at_clock()
        return self.ready

    def _end(self, most: int) -> int:
        """End the stream: decode what is held, too, and tell of bytes that are missing."""
        limit = self._make_room(most)
        self.loop.flush(limit)
        self._keep_controls()
        self._assign_times()
        self.tell_missing()
        return self.ready

    def tell_missing(self) -> None:
        """Tell `on_bytes` of missing bytes that no others have followed."""
        if self._missing and self.on_bytes is not None:
            self.on_bytes(memoryview(b""), self._arrived, self._missing)
            self._missing = 0

    def _make_room(self, most: int) -> int:
        """Make room for `most` frames that are not taken, or for as many as the ring may hold.

        Returns where they end in the array.
        """
        loop = self.loop
        count = loop.count
        ready = count - self._taken
        if loop.timed < count:
            loop.assign_times()  # an exception came before that
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
        """Decode what the ring holds until the array has `limit` frames."""
        loop, ring = self.loop, self.ring
        while not ring.idle and loop.count < limit:
            data = self._peek()
            if not len(data):
                if ring.at_gap:
                    self._flush(limit)  # it will never be whole
                if self.decoder.pending or (gap := ring.take_gap()) is None:
                    break
                self._pass(gap)
                continue
            if self._searching and (at := bytes(data[:_SEARCH]).find(self._ping)) >= 0:
                if at == 0:
                    self._flush(limit)
                    self._searching = bool(self.decoder.pending)
                    continue
                data = data[:at]
            elif self._searching:
                data = data[:_SEARCH]
            loop.feed(data, limit)
            ring.release_to(loop.position)
            self._keep_controls()

    def _peek(self) -> memoryview:
        """Return the next bytes of the ring, and tell of those that are new."""
        data, reads = self.ring.peek()
        begin = self.loop.position
        self._untold.extend(reads)
        while self._untold:  # some may be left by an exception
            read = self._untold.popleft()
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
        """Go on behind a gap."""
        self.loop.gap()
        self.gaps.append(gap)
        self._arrived = max(self._arrived, gap.ts)
        self._missing = -1 if -1 in (gap.lost, self._missing) else self._missing + gap.lost
        if gap.reason == "reconnect":
            self._asked, self._searching = 0, False

    def _assign_times(self) -> None:
        """Give the frames that are new their times."""
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
                self._answered = self._arrived
                self._searching = False
            elif report.kind == "status":
                self.status = report

    # Waiting

    def _wait(self, wanted: int, deadline: float | None) -> bool:
        """Wait for bytes; see meanwhile whether the adapter answers what it is asked."""
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
            self.tell_silence(6)

    def _watch(self) -> None:
        """See whether the ping that went out comes back in time."""
        dog = self._watchdog
        if dog is None:
            return
        now, last_ping = dog.now(), dog.last_ping()
        if self._answered >= self._asked:
            self._asked = last_ping if last_ping > self._answered else 0
        if not self._asked or not last_ping or self._searching:
            return
        # Up to when the bytes are known: those that wait may hold it.
        seen = self._arrived if len(self.ring) else now
        if seen - self._asked > dog.ping_s * _PATIENCE_PERIODS * 1e9:
            self._searching = True
            self.gaps.append(Gap(self.decoder.position, -1, seen, "watchdog"))
            self._warn(
                "ping",
                f"{self.url}: the ping does not come back; looking for the place where frames "
                "start again. Is the adapter on, and the baud rate right?",
            )

    def end_error(self) -> Exception | None:
        """Return what has ended the stream, if all that came before is taken."""
        error = self.ring.error
        if error is None:
            return None
        # A new one: it may be raised again and again, in several threads.
        if isinstance(error, PortError):
            return type(error)(str(error))
        return PortError(f"{self.url}: {type(error).__name__} {error}".rstrip())

    # Warnings

    def tell_silence(self, stacklevel: int) -> None:
        """Warn, once, that the adapter did not answer when it was set up.

        `stacklevel`: how far the user's code is from `warnings.warn`.
        """
        if self._setup is not None and self._setup.take_silence():
            self._warn(
                "silence",
                f"{self.url} did not answer its status request within {SILENCE_S:g} s; frames "
                "are sent without an answer, and the first ones may be lost. Is the adapter on, "
                "and the baud rate right?",
                stacklevel=stacklevel,
            )

    def _look_at_share(self) -> None:
        position, (bytes_in, skipped) = self.loop.position, self._looked
        if position - bytes_in < _WRONG_BYTES:
            return
        self._looked = position, self.decoder.skipped
        came, bad = position - bytes_in, self._looked[1] - skipped
        if is_doubtful(self.decoder.protocol, came, bad):
            share = bad / came
            self._warn(
                "share",
                f"{self.url}: {share:.0%} of the bytes are in no {self.decoder.protocol} frame; "
                "are the baud rate and the protocol right?",
            )

    def _look_at_clock(self) -> None:
        """See whether the host's clock was set; tell each time that it was."""
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
        """Warn, once of each kind; of "" each time."""
        if kind in self._warned:
            return
        if kind:
            self._warned.add(kind)
        if self.on_warning is not None:
            self.on_warning(text)
        else:
            warnings.warn(text, CanserWarning, stacklevel=stacklevel)
