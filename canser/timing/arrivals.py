"""Times at which bytes had come: by reads of a port, or by blocks of a recording."""

from typing import Final, NamedTuple

import numpy as np

from canser._core.buffers import Pointer, Times
from canser._core.timing import pieces_at

__all__ = ["Arrivals", "DataBlock", "DataRun", "count_back"]

# A time before all arrivals: that of the read before the first one.
NEVER_NS: Final = -(2**62)

# The line has no bit rate of its own if reads bring more bytes than the rate allows, by this much
# time of the line since some earlier read. A smaller excess may be a late time of that earlier
# read: the process may wait between a read and its look at the clock, mostly for Python's lock.
_EXCESS_NS: Final = 100_000_000

# How long bytes may have been held when a read takes them. At the start, and behind a gap, the
# system may hold 64 KiB, which take 6 s at 115,200 baud. Later a read that is shorter than the line
# allows has emptied what the system held, and tells since when the next bytes can have come.
_HELD_NS: Final = 10_000_000_000

# Bit rates are off by up to some percent: 115,200 baud made from 16 MHz is off by 2.1 %.
_RATE_SLACK: Final = 0.97

# Up to this many reads are added one by one: for fewer, numpy takes longer.
_FEW: Final = 8


class DataBlock(NamedTuple):
    """Bytes of a line, and the time when they had come."""

    #: The bytes; none for a loss that no bytes followed.
    data: memoryview | bytes
    #: When the last of them had come, in epoch nanoseconds.
    arrival_ns: int
    #: Bytes of the line that are lost right before; -1: their number is unknown.
    lost: int = 0
    #: Whether bytes are missing right before, or may be.
    gap: bool = False


class DataRun(NamedTuple):
    """The bytes of some blocks, one behind the other, with nothing missing between them."""

    #: The bytes, good until the next run; none for a loss that no bytes followed.
    data: memoryview
    #: Where in `data` each block ends: ascending, the last one at its end.
    ends: Times
    #: When the last byte of each block had come, in epoch nanoseconds.
    times: Times
    #: Bytes of the line that are lost right before `data`; -1: their number is unknown.
    lost: int = 0
    #: Whether bytes are missing right before `data`, or may be.
    gap: bool = False


def count_back(arrival_ns: int, byte_count: int, byte_ns: float, earliest_ns: int) -> int:
    """Return when a byte had come: `byte_count` bytes before the one that came at `arrival_ns`.

    Bytes come one behind the other, each after `byte_ns` nanoseconds of the line. But a byte did
    not come before the bytes of the read before, even if the line is faster than its bit rate says.
    `earliest_ns` is the arrival of these.
    """
    return max(arrival_ns - int(byte_count * byte_ns), min(earliest_ns, arrival_ns))


class Arrivals:
    """Tells when the bytes of a stream had come, by reads of a port or blocks of a recording.

    `byte_ns` is the time of a byte on the line. Pseudo terminals, sockets and USB terminals without
    a line behind them name a bit rate, too, but do not keep to it. If reads bring more bytes than
    can have come since earlier reads, the rate is disproved: from the first such read on, no byte
    is counted back. With `keeps_rate` the rate is never disproved.
    """

    def __init__(self, byte_ns: float, *, keeps_rate: bool = False) -> None:
        self._keeps_rate = keeps_rate
        self._least_ns = byte_ns * _RATE_SLACK
        # The offset behind each read, and its time. The first row only tells when the second read
        # began: no byte of it is asked for any more.
        self._use(np.empty((64, 2), np.int64))
        self._begin, self._end = 0, 1
        self._rows[0] = 0, NEVER_NS
        #: The offset behind all that has arrived, and when the last of it had.
        self.end, self.last_ns = 0, NEVER_NS
        # By how much the bytes since some read took longer than the time since then, for the read
        # where that is most. It is negative where more bytes may have been held.
        self._excess_ns = -_HELD_NS
        self.unrated_from: int | None = None  # the offset from which on nothing is counted back

    def add(self, end: int, ns: int) -> None:
        """Note that the bytes up to offset `end` had come by `ns`, epoch nanoseconds.

        Calls are in order. A time before that of the last read counts as that of the last read.
        """
        if self._end == len(self._rows):
            self._make_room(1)
        before_end, before_ns = self.end, self.last_ns
        ns = max(ns, before_ns)
        piece = self._at[self._end]
        piece.end, piece.ns = end, ns
        self._end += 1
        self.end, self.last_ns = end, ns
        if self.unrated_from is not None or self._keeps_rate:
            return
        step = max(int((end - before_end) * self._least_ns) - (ns - before_ns), -_HELD_NS)
        if step < 0:
            self._excess_ns = max(self._excess_ns, 0)
        self._excess_ns += step
        if self._excess_ns > _EXCESS_NS:
            self.unrated_from = before_end

    def extend(self, ends: Times, times: Times) -> None:
        """Note several reads, as `add` does for one."""
        count = len(ends)
        if count <= _FEW:
            for end, ns in zip(ends.tolist(), times.tolist(), strict=True):
                self.add(end, ns)
            return
        if len(self._rows) - self._end < count:
            self._make_room(count)
        rows = self._rows[self._end - 1 : self._end + count]
        rows[1:, 0] = ends
        rows[1:, 1] = times
        np.maximum.accumulate(rows[:, 1], out=rows[:, 1])
        self._end += count
        self.end, self.last_ns = rows[-1].tolist()
        if self.unrated_from is not None or self._keeps_rate:
            return
        # The same as calls of `add` one by one: a sum, raised to zero before each step down.
        sizes, spans = np.diff(rows, axis=0).T
        steps = np.maximum((sizes * self._least_ns).astype(np.int64) - spans, -_HELD_NS)
        total = self._excess_ns + np.cumsum(steps)
        before = np.append(self._excess_ns, total[:-1])
        raised = np.where(steps < 0, np.minimum(before, 0), 0)
        excess = total - np.minimum.accumulate(raised)
        over = np.flatnonzero(excess > _EXCESS_NS)
        if len(over):
            self.unrated_from = int(rows[over[0], 0])
        self._excess_ns = int(excess[-1])

    def gap(self) -> None:
        """Note that the stream was interrupted: the next read may hold bytes of any age."""
        self._excess_ns = -_HELD_NS

    @property
    def pieces(self) -> Times:
        """The offset behind each read that is kept and its time, shape (n, 2)."""
        return self._rows[self._begin : self._end]

    @property
    def kept(self) -> tuple[Pointer, int]:
        """Where `pieces` begin in memory, and how many there are; good until reads are added."""
        return self._at + self._begin, self._end - self._begin

    def forget_before(self, offset: int) -> None:
        """Forget the reads before the one that holds this offset, all but the last of them."""
        at, begin = self._at, self._begin
        # One or two mostly: a binary search would take longer.
        while begin + 1 < self._end and at[begin + 1].end <= offset:
            begin += 1
            if begin == self._begin + _FEW:
                ends = self._rows[begin : self._end, 0]
                begin += max(int(ends.searchsorted(offset, "right")) - 1, 0)
        self._begin = begin

    def _make_room(self, count: int) -> None:
        kept = self._rows[self._begin : self._end]
        rows = self._rows
        if 2 * (len(kept) + count) > len(rows):
            rows = np.empty((4 * (len(kept) + count), 2), np.int64)
        rows[: len(kept)] = kept.copy()
        self._use(rows)
        self._begin, self._end = 0, len(kept)

    def _use(self, rows: Times) -> None:
        self._rows, self._at = rows, pieces_at(rows)
