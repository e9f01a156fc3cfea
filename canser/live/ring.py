"""A bounded ring of bytes between a port and its decoder, with the times of arrival."""

import os
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

__all__ = ["Gap", "Read", "Ring", "holds"]


class Gap(NamedTuple):
    """A place in a stream where bytes are missing; returned by `Port.take_gaps`."""

    #: Stream offset of the first byte behind it.
    offset: int
    #: Bytes that are missing; -1: their number is unknown.
    lost: int
    #: When it began, in epoch nanoseconds.
    ts: int
    #: "overflow", "reconnect" or "watchdog".
    reason: str


class Read(NamedTuple):
    """Where the bytes of one read of the port are in the stream, and when they had arrived."""

    begin: int  # stream offset of the first of them
    end: int  # stream offset behind the last
    ns: int  # epoch nanoseconds at which they had arrived


# Reads that are not handed out take up to 200 bytes each, more than their bytes of the line where
# they are tiny. Of more than this number those of the same slot of time become one, and slots get
# twice as long, from the first length on, until half the number is left. So times are exact while
# fewer reads wait, 16 s of 2,000 reads a second, and then they are late by a slot at most: by 0.3 s
# after an hour.
_READS_MOST: Final = 1 << 15
_SLOT_NS: Final = 1 << 20
_SLOT_MOST_NS: Final = 1 << 42

# A ring that was full takes bytes again when so much of it is free: one long gap
# instead of many short ones, each of which costs the frames at its edges.
_FREE_AGAIN: Final = 1 / 16


def holds(lock: threading.Condition) -> bool:
    """Return whether this thread holds the lock of a condition."""
    try:
        lock.notify(0)
    except RuntimeError:
        return False
    return True


class Ring:
    """Bytes that have come and are not decoded yet. One thread fills it, one empties it.

    What comes while it is full is thrown away, counted, and marked by a `Gap`. Offsets
    count the bytes that are kept, from 0.
    """

    def __init__(self, size: int) -> None:
        self._bytes = memoryview(bytearray(size))
        self._size = size
        self._begin = 0  # offset of the oldest byte
        self._end = 0  # offset behind the newest
        self._reads: deque[Read] = deque()  # not handed out yet
        self._slot_ns = 0  # reads of the same slot of time are one; 0: each is one by itself
        self._gaps: deque[Gap] = deque()  # not reached yet by the thread that empties it
        self._full = False
        self._error: Exception | None = None
        # Reentrant: a signal handler, or the end of a port without references, may come at any
        # place of any thread, and close it.
        self._lock = threading.RLock()
        self._came = threading.Condition(self._lock)
        self._wanted = 1  # unread bytes at which a waiting thread is woken
        self._listener: Callable[[], None] | None = None
        self._signal: tuple[int, int] | None = None  # a pipe that is readable while `_loud`
        self._loud = self._held = False
        self.lost = 0  # bytes thrown away

    # Of the thread that fills it.

    def room(self) -> memoryview | None:
        """Return where the next bytes may be put; None while the ring is full."""
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
        """Take notice of bytes that were put there, and had arrived by `ns`."""
        with self._lock:
            gap = self._gaps[-1].offset if self._gaps else -1
            self._add_read(self._reads, Read(self._end, self._end + count, ns), gap)
            self._end += count
            if len(self._reads) > _READS_MOST:
                self._merge_reads()
            self._set_signal()
            if self._end - self._begin >= self._wanted:
                self._tell()

    def append(self, data: memoryview, ns: int) -> None:
        """Put bytes that had arrived by `ns`; count those that there is no room for."""
        while data and (room := self.room()) is not None:
            count = min(len(data), len(room))
            room[:count] = data[:count]
            self.put(count, ns)
            data = data[count:]
        if data:
            self.lose(len(data), ns)

    def _add_read(self, reads: deque[Read], read: Read, gap: int) -> None:
        """Append a read, or make it one with the last of them; `gap`: where the last gap lies.

        What is one lies in one piece of memory, without a gap inside.
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
        """Have half as many reads, by longer slots of time."""
        gaps = {gap.offset for gap in self._gaps}
        while len(self._reads) > _READS_MOST // 2 and self._slot_ns < _SLOT_MOST_NS:
            self._slot_ns = 2 * self._slot_ns or _SLOT_NS
            merged: deque[Read] = deque()
            for read in self._reads:
                self._add_read(merged, read, read.begin if read.begin in gaps else -1)
            self._reads = merged

    def lose(self, count: int, ns: int) -> None:
        """Count bytes that came while the ring was full."""
        with self._lock:
            self.lost += count
            last = self._gaps[-1] if self._gaps else None
            if last is not None and last.offset == self._end and last.reason == "overflow":
                self._gaps[-1] = last._replace(lost=last.lost + count)
            else:
                self._gaps.append(Gap(self._end, count, ns, "overflow"))
                self._set_signal()
                self._tell()

    def interrupt(self, ns: int, reason: str) -> None:
        """Mark a gap of unknown length."""
        with self._lock:
            self._gaps.append(Gap(self._end, -1, ns, reason))
            self._set_signal()
            self._tell()

    def close(self, error: Exception) -> None:
        """End the stream: behind what is there comes nothing but `error`."""
        with self._lock:
            if self._error is None:
                self._error = error
            self._set_signal()
            self._tell()

    def _tell(self) -> None:
        self._came.notify_all()
        if self._listener is not None:
            listener, self._listener = self._listener, None
            listener()

    def _set_signal(self) -> None:
        """Make the descriptor readable if there is anything to take, and else not."""
        if self._signal is None:
            return
        loud = self._held or self._begin < self._end or bool(self._gaps or self._error)
        if loud and not self._loud:
            os.write(self._signal[1], b"\0")
        elif self._loud and not loud:
            os.read(self._signal[0], 1)
        self._loud = loud

    # Of the thread that empties it.

    def wait(self, wanted: int, deadline: float | None) -> bool:
        """Wait until `wanted` bytes or a gap are there, or the end; False after the deadline.

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
        """Have `listener` called once, by any thread, when `wait` would not wait."""
        with self._lock:
            self._wanted = min(wanted, self._size // 2)
            self._listener = listener
            if listener is not None and self._ready():
                self._tell()

    def _ready(self) -> bool:
        return (
            self._end - self._begin >= self._wanted or bool(self._gaps) or self._error is not None
        )

    @property
    def idle(self) -> bool:
        """Whether there is nothing to take."""
        return self._begin == self._end and not self._gaps

    def peek(self) -> tuple[memoryview, list[Read]]:
        """Return bytes in one piece of memory, up to a gap, and the reads not seen before."""
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
        """Release the bytes before this offset: new ones may take their place."""
        if offset == self._begin:
            return
        with self._lock:
            self._begin = offset
            self._set_signal()

    @property
    def at_gap(self) -> bool:
        """Whether a gap lies right here."""
        with self._lock:
            return bool(self._gaps) and self._gaps[0].offset == self._begin

    def take_gap(self) -> Gap | None:
        """Return the gap that lies right here, None if there is none."""
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
        """Keep that descriptor readable, for a caller that holds frames it took."""
        if held == self._held:
            return
        with self._lock:
            self._held = held
            self._set_signal()

    @property
    def locked_here(self) -> bool:
        """Whether this thread is in the middle of something here, which a signal interrupted."""
        return holds(self._came)

    def release(self) -> None:
        """Close that descriptor, if there is one."""
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
        """How full it is, 0 to 1."""
        return len(self) / self._size

    @property
    def error(self) -> Exception | None:
        """What has ended the stream, once all before it is taken."""
        with self._lock:
            return self._error if self._begin == self._end and not self._gaps else None
