"""When bytes came: bytes with their arrival, and the rule that dates the earlier ones of them."""

from typing import Final, NamedTuple

import numpy as np

from canser._core.buffers import Pointer, Times
from canser._core.timing import pieces_at

__all__ = ["Arrivals", "DataBlock", "DataRun", "count_back"]

# Before all arrivals: the time of the read before the first.
NEVER_NS: Final = -(2**62)

# A line has no bit rate of its own if since some read more bytes came than it says, by as much in
# time of the line. That read may have been stamped too late by that: the time that this process
# waited between a read and the look at the clock, mostly for Python's lock.
_EXCESS_NS: Final = 100_000_000

# A read that holds less than could have come since the one before has emptied what the system
# held. Others may take what was there before: since when is not known at the start and behind a
# gap, but 64 KiB, as much as a system holds, take 6 s at 115,200 baud.
_HELD_NS: Final = 10_000_000_000

# Bit rates are off by some percent: 2.1 where a clock of 16 MHz makes 115,200 baud.
_RATE_SLACK: Final = 0.97

# Up to so many reads are looked at one by one.
_FEW: Final = 8


class DataBlock(NamedTuple):
    """Some bytes of a line, and when they came."""

    #: The bytes; none where bytes were lost that no others followed.
    data: memoryview | bytes
    #: When the last of them had come, in epoch nanoseconds.
    arrival_ns: int
    #: Bytes of the line that are lost right before; -1: their number is unknown.
    lost: int = 0
    #: Whether bytes are missing right before, or may be.
    gap: bool = False


class DataRun(NamedTuple):
    """The bytes of some blocks, one behind the other, with nothing missing between them."""

    #: The bytes, good until the next run; none where bytes were lost that no others followed.
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
    """Return when a byte came that so many bytes came behind, the last of them at `arrival_ns`.

    Bytes come one behind the other, each after `byte_ns` nanoseconds of the line. But what was
    read later than something else did not come before it, even where the line is faster than
    its bit rate says: `earliest_ns` is when the bytes before had come.
    """
    return max(arrival_ns - int(byte_count * byte_ns), min(earliest_ns, arrival_ns))


class Arrivals:
    """When the bytes of a stream had come, by the reads of a port or the blocks of a recording.

    `byte_ns`: the time of a byte on the line. Terminals over USB without a line behind them,
    pseudo terminals and sockets name a bit rate, too, and keep to none. Where reads hold more
    bytes than can have come since those before, the rate is disproved: from the first such read
    on nothing is counted back. With `keeps_rate` it is never.
    """

    def __init__(self, byte_ns: float, *, keeps_rate: bool = False) -> None:
        self._keeps_rate = keeps_rate
        self._least_ns = byte_ns * _RATE_SLACK
        # The offset behind each read, and its time. The first one holds no byte that is still
        # asked for: it tells when the next one began.
        self._use(np.empty((64, 2), np.int64))
        self._begin, self._end = 0, 1
        self._rows[0] = 0, NEVER_NS
        #: The offset behind all that has arrived, and when the last of it had.
        self.end, self.last_ns = 0, NEVER_NS
        # By how much more time bytes took than there was, since the read for which that is most;
        # less than zero where more may have been held.
        self._excess_ns = -_HELD_NS
        self.unrated_from: int | None = None  # the offset from which on nothing is counted back

    def add(self, end: int, ns: int) -> None:
        """Take note that the bytes up to offset `end` had come by `ns`, epoch nanoseconds.

        In order; a time before that of the last read counts as that.
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
        """Take note of several reads, as `add` does of one."""
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
        # What `add` does one by one: a sum that is raised to zero before each step down.
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
        """Take note that the stream was interrupted: the next read may hold bytes of any age."""
        self._excess_ns = -_HELD_NS

    @property
    def pieces(self) -> Times:
        """The offset behind each read that is kept and its time, shape (n, 2)."""
        return self._rows[self._begin : self._end]

    @property
    def kept(self) -> tuple[Pointer, int]:
        """Where these begin in memory, and how many there are; good until reads are added."""
        return self._at + self._begin, self._end - self._begin

    def forget_before(self, offset: int) -> None:
        """Forget the reads that hold no byte from this offset on, all but the last of them."""
        at, begin = self._at, self._begin
        # Mostly one or two: a search would take longer.
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
