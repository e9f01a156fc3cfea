"""A bounded ring of bytes between a port and its decoder, with the times of arrival."""

import os
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

__all__ = ["Gap", "Read", "Ring", "holds"]


class Gap(NamedTuple):
    """A place in the stream of a port where bytes are missing, returned by `Port.take_gaps`."""

    #: Stream offset of the first byte behind the gap.
    offset: int
    #: Number of bytes that are missing; -1: it is unknown.
    lost: int
    #: When the gap began, in epoch nanoseconds.
    ts: int
    #: "overflow": the ring of raw bytes was full, as the program read too slowly. "reconnect":
    #: the device was gone. "watchdog": the ping did not come back.
    reason: str


class Read(NamedTuple):
    """Where the bytes of one read of the port are in the stream, and when they had arrived."""

    begin: int  # stream offset of the first byte
    end: int  # stream offset behind the last byte
    ns: int  # epoch nanoseconds at which the last byte had arrived


# A `Read` that waits takes up to 200 bytes of memory, more than the bytes of a small read. If more
# than _READS_MOST wait, the reads of one time slot are merged. Slots of _SLOT_NS (1 ms) are tried
# first, then twice as long ones, until half of _READS_MOST are left. So times are exact for 16 s of
# 2,000 reads a second that wait. After that they are late by a slot at most: 0.3 s after an hour.
# _SLOT_MOST_NS (73 minutes) ends the doubling, as reads at gaps are never merged.
_READS_MOST: Final = 1 << 15
_SLOT_NS: Final = 1 << 20
_SLOT_MOST_NS: Final = 1 << 42

# A ring that was full takes bytes again when this share of it is free. Otherwise there would be
# many short gaps instead of a long one, and each gap costs the frames at its edges.
_FREE_AGAIN: Final = 1 / 16


def holds(lock: threading.Condition) -> bool:
    """Return whether this thread holds the lock of a condition."""
    try:
        lock.notify(0)
    except RuntimeError:
        return False
    return True


class Ring:
    """Bytes that have come and are not decoded yet. One thread fills the ring, one empties it.

    Bytes that come while the ring is full are thrown away, counted, and marked by a `Gap`. Offsets
    count the bytes that are kept, from 0.
    """

    def __init__(self, size: int) -> None:
        self._bytes = memoryview(bytearray(size))
        self._size = size
        self._begin = 0  # offset of the oldest byte
        self._end = 0  # offset behind the newest byte
        self._reads: deque[Read] = deque()  # not returned by `peek` yet
        self._slot_ns = 0  # reads of one time slot are merged; 0: no reads are
        self._gaps: deque[Gap] = deque()  # not taken yet
        self._full = False
        self._error: Exception | None = None
        # Reentrant: a signal handler, or the collection of a port without references, may
        # interrupt any thread at any place, and close the ring.
        self._lock = threading.RLock()
        self._came = threading.Condition(self._lock)
        self._wanted = 1  # unread bytes at which a waiting thread is woken
        self._listener: Callable[[], None] | None = None
        self._signal: tuple[int, int] | None = None  # a pipe; None: not asked for
        self._readable = False  # whether the pipe is
        self._held = False  # the argument of the last `hold_ready`
        self.lost = 0  # bytes thrown away

    # For the thread that fills the ring.

    def room(self) -> memoryview | None:
        """Return memory for the next bytes; None while the ring is full."""
        with self._lock:
            free = self._size - (self._end - self._begin)
            if self._full and free < self._size * _FREE_AGAIN:
                return None
            self._full = free == 0
            if self._full:
                return None
            at = self._end % self._size
            return self._bytes[at : at + min(free, self._size - at)]

    def put(self, count: int, ns: int) -> None:
        """Add `count` bytes that were put into `room`, and had arrived by `ns`."""
        with self._lock:
            gap = self._gaps[-1].offset if self._gaps else -1
            self._add_read(self._reads, Read(self._end, self._end + count, ns), gap)
            self._end += count
            if len(self._reads) > _READS_MOST:
                self._merge_reads()
            self._set_signal()
            if self._end - self._begin >= self._wanted:
                self._wake()

    def append(self, data: memoryview, ns: int) -> None:
        """Add bytes that had arrived by `ns`; throw away and count those without room."""
        while data and (room := self.room()) is not None:
            count = min(len(data), len(room))
            room[:count] = data[:count]
            self.put(count, ns)
            data = data[count:]
        if data:
            self.lose(len(data), ns)

    def _add_read(self, reads: deque[Read], read: Read, gap: int) -> None:
        """Append a read, or merge it with the last one; `gap`: the offset of the last gap.

        The bytes of a merged read lie in one piece of memory, without a gap inside.
        """
        slot_ns = self._slot_ns
        if (
            slot_ns
            and reads
            and reads[-1].ns // slot_ns == read.ns // slot_ns
            and read.begin % self._size
            and read.begin != gap
        ):
            read = Read(reads.pop().begin, read.end, read.ns)
        reads.append(read)

    def _merge_reads(self) -> None:
        """Halve the number of reads, by longer time slots."""
        gaps = {gap.offset for gap in self._gaps}
        while len(self._reads) > _READS_MOST // 2 and self._slot_ns < _SLOT_MOST_NS:
            self._slot_ns = 2 * self._slot_ns or _SLOT_NS
            merged: deque[Read] = deque()
            for read in self._reads:
                self._add_read(merged, read, read.begin if read.begin in gaps else -1)
            self._reads = merged

    def lose(self, count: int, ns: int) -> None:
        """Count bytes that came while the ring was full, and mark the gap."""
        with self._lock:
            self.lost += count
            last = self._gaps[-1] if self._gaps else None
            if last is not None and last.offset == self._end and last.reason == "overflow":
                self._gaps[-1] = last._replace(lost=last.lost + count)
            else:
                self._gaps.append(Gap(self._end, count, ns, "overflow"))
                self._set_signal()
                self._wake()

    def interrupt(self, ns: int, reason: str) -> None:
        """Mark a gap of unknown length."""
        with self._lock:
            self._gaps.append(Gap(self._end, -1, ns, reason))
            self._set_signal()
            self._wake()

    def close(self, error: Exception) -> None:
        """End the stream: `error` follows the bytes that are in the ring."""
        with self._lock:
            if self._error is None:
                self._error = error
            self._set_signal()
            self._wake()

    def _wake(self) -> None:
        """Wake the thread that waits, and call the listener."""
        self._came.notify_all()
        if self._listener is not None:
            listener, self._listener = self._listener, None
            listener()

    def _set_signal(self) -> None:
        """Make the descriptor readable if there is anything to take, otherwise unreadable."""
        if self._signal is None:
            return
        readable = self._held or self._begin < self._end or bool(self._gaps or self._error)
        if readable and not self._readable:
            os.write(self._signal[1], b"\0")
        elif self._readable and not readable:
            os.read(self._signal[0], 1)
        self._readable = readable

    # For the thread that empties the ring.

    def wait(self, wanted: int, deadline: float | None) -> bool:
        """Wait for `wanted` bytes, a gap, or the end of the stream; False after the deadline.

        `deadline`: of time.monotonic(), None for never.
        """
        with self._lock:
            self._wanted = min(wanted, self._size // 2)
            while not self._ready():
                left = None if deadline is None else deadline - time.monotonic()
                if left is not None and left <= 0:
                    return False
                self._came.wait(left)
            return True

    def listen(self, wanted: int, listener: Callable[[], None] | None) -> None:
        """Call `listener` once, in any thread, as soon as `wait` would return at once."""
        with self._lock:
            self._wanted = min(wanted, self._size // 2)
            self._listener = listener
            if listener is not None and self._ready():
                self._wake()

    def _ready(self) -> bool:
        return (
            self._end - self._begin >= self._wanted or bool(self._gaps) or self._error is not None
        )

    @property
    def idle(self) -> bool:
        """Whether there is nothing to take."""
        return self._begin == self._end and not self._gaps

    def peek(self) -> tuple[memoryview, list[Read]]:
        """Return bytes in one piece of memory, up to a gap, and the reads that are new."""
        with self._lock:
            end = self._gaps[0].offset if self._gaps else self._end
            at = self._begin % self._size
            count = min(end - self._begin, self._size - at)
            reads = []
            while self._reads and self._reads[0].end <= self._begin + count:
                reads.append(self._reads.popleft())
            if not self._reads:
                self._slot_ns = 0
            return self._bytes[at : at + count], reads

    def release_to(self, offset: int) -> None:
        """Release the bytes before this offset: new bytes may overwrite them."""
        if offset == self._begin:
            return
        with self._lock:
            self._begin = offset
            self._set_signal()

    @property
    def at_gap(self) -> bool:
        """Whether a gap lies right before the next byte."""
        with self._lock:
            return bool(self._gaps) and self._gaps[0].offset == self._begin

    def take_gap(self) -> Gap | None:
        """Return the gap right before the next byte, None if there is none."""
        with self._lock:
            if self._gaps and self._gaps[0].offset == self._begin:
                gap = self._gaps.popleft()
                self._set_signal()
                return gap
            return None

    def fileno(self) -> int:
        """Return a descriptor that is readable while there is anything to take."""
        with self._lock:
            if self._signal is None:
                self._signal = os.pipe()
                self._set_signal()
            return self._signal[0]

    def hold_ready(self, held: bool) -> None:
        """Keep the descriptor of `fileno` readable, for a caller that still holds frames."""
        if held == self._held:
            return
        with self._lock:
            self._held = held
            self._set_signal()

    @property
    def locked_here(self) -> bool:
        """Whether this thread holds the lock: a signal has interrupted a method here."""
        return holds(self._came)

    def release(self) -> None:
        """Close the descriptor of `fileno`, if there is one."""
        with self._lock:
            if self._signal is not None:
                os.close(self._signal[0])
                os.close(self._signal[1])
                self._signal = None

    @property
    def end(self) -> int:
        """The stream offset behind the newest byte."""
        return self._end

    def __len__(self) -> int:
        return self._end - self._begin

    @property
    def fill(self) -> float:
        """How full the ring is, 0 to 1."""
        return len(self) / self._size

    @property
    def error(self) -> Exception | None:
        """What has ended the stream; None until all bytes and gaps before the end are taken."""
        with self._lock:
            return self._error if self._begin == self._end and not self._gaps else None
