"""The ring against a plain list of bytes: no byte lost uncounted, and every offset exact."""

import os
import random
import select
import threading
import time
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from canser.errors import PortGoneError
from canser.live.ring import Gap, Read, Ring
from device import until

SIZE = 64


def put(ring: Ring, data: bytes, ns: int = 0) -> int:
    """Put as much as fits in one piece; return how much."""
    room = ring.room()
    if room is None:
        return 0
    count = min(len(room), len(data))
    room[:count] = data[:count]
    ring.put(count, ns)
    return count


def fill(ring: Ring) -> bytes:
    """Put bytes until it is full; return them."""
    data = b""
    while (room := ring.room()) is not None:
        data += bytes(i % 251 for i in range(len(data), len(data) + len(room)))
        room[:] = data[-len(room) :]
        ring.put(len(room), 0)
    return data


def readable(fd: int) -> bool:
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    return bool(poll.poll(0))


class RingMachine(RuleBasedStateMachine):
    """Any order of operations of the two threads, one at a time."""

    @initialize(size=st.integers(2, 100), watched=st.booleans())
    def start(self, size: int, watched: bool) -> None:
        self.size = size
        self.ring = Ring(size)
        self.fd = self.ring.fileno() if watched else None
        self.held: list[int] = []  # the bytes that must be there
        self.begin = 0  # the offset of the first of them
        self.ns = 0
        self.next = 0
        self.lost = 0
        self.gaps: list[Gap] = []
        self.reads: list[Read] = []
        self.full = False
        self.ended = False

    def teardown(self) -> None:
        if hasattr(self, "ring"):
            self.ring.release()

    @property
    def end(self) -> int:
        return self.begin + len(self.held)

    @rule(wanted=st.integers(1, 40))
    def bytes_come(self, wanted: int) -> None:
        self.ns += 1
        data = bytes((self.next + i) % 256 for i in range(wanted))
        room = self.ring.room()
        free = self.size - len(self.held)
        if self.full and free < self.size / 16:
            assert room is None
        else:
            self.full = not free
        if room is None:
            assert self.full
            self.ring.lose(wanted, self.ns)
            self.next += wanted
            self.lost += wanted
            last = self.gaps[-1] if self.gaps else None
            if last is not None and (last.offset, last.reason) == (self.end, "overflow"):
                self.gaps[-1] = last._replace(lost=last.lost + wanted)
            else:
                self.gaps.append(Gap(self.end, wanted, self.ns, "overflow"))
            return
        assert 1 <= len(room) <= free
        count = min(wanted, len(room))
        room[:count] = data[:count]
        self.ring.put(count, self.ns)
        self.reads.append(Read(self.end, self.end + count, self.ns))
        self.held += data[:count]
        self.next += count

    @rule()
    def the_line_breaks(self) -> None:
        self.ns += 1
        self.ring.interrupt(self.ns, "reconnect")
        self.gaps.append(Gap(self.end, -1, self.ns, "reconnect"))

    @rule(share=st.floats(0, 1))
    def bytes_go(self, share: float) -> None:
        data, reads = self.ring.peek()
        stop = self.gaps[0].offset if self.gaps else self.end
        expected = self.held[: stop - self.begin]
        # All of it in one piece of memory, or what lies before the memory's end.
        assert data.tobytes() == bytes(expected[: len(data)])
        assert len(data) in (len(expected), self.size - self.begin % self.size)
        shown = [read for read in self.reads if read.end <= self.begin + len(data)]
        assert reads == shown
        self.reads = self.reads[len(shown) :]
        count = int(share * len(data))
        self.begin += count
        del self.held[:count]
        self.ring.release_to(self.begin)

    @rule()
    def the_gap_goes(self) -> None:
        here = bool(self.gaps) and self.gaps[0].offset == self.begin
        assert self.ring.at_gap == here
        assert self.ring.take_gap() == (self.gaps.pop(0) if here else None)

    @precondition(lambda self: not self.ended)
    @rule()
    def the_stream_ends(self) -> None:
        self.ring.close(PortGoneError("gone"))
        self.ring.close(PortGoneError("the first one stays"))
        self.ended = True

    @rule(wanted=st.integers(1, 200))
    def nobody_waits_long(self, wanted: int) -> None:
        enough = len(self.held) >= max(min(wanted, self.size // 2), 1)
        ready = enough or bool(self.gaps) or self.ended
        told: list[None] = []
        self.ring.listen(wanted, lambda: told.append(None))
        assert bool(told) == ready
        assert self.ring.wait(wanted, time.monotonic()) == ready
        self.ring.listen(1, None)

    @invariant()
    def the_books_are_right(self) -> None:
        if not hasattr(self, "ring"):
            return
        assert len(self.ring) == len(self.held)
        assert self.ring.fill == len(self.held) / self.size
        assert self.ring.lost == self.lost
        assert self.next == self.end + self.lost
        error = self.ring.error
        assert (str(error) if error else None) == (
            "gone" if self.ended and not self.held and not self.gaps else None
        )
        if self.fd is not None:
            assert readable(self.fd) == bool(self.held or self.gaps or self.ended)


TestRing = RingMachine.TestCase


def test_two_threads_lose_nothing_uncounted() -> None:
    """A writer that never waits, a reader that stalls: every byte is there, or in a gap."""
    total = 400_000
    ring = Ring(4096)
    random_writer, random_reader = random.Random(1), random.Random(2)

    def write() -> None:
        sent = 0
        while sent < total:
            data = bytes((sent + i) % 251 for i in range(random_writer.randint(1, 600)))
            data = data[: total - sent]
            count = put(ring, data)
            if not count:
                count = len(data)
                ring.lose(count, 0)
            sent += count
        ring.close(PortGoneError("all sent"))

    writer = threading.Thread(target=write)
    writer.start()
    until(lambda: ring.lost)
    position = 0  # in what was sent
    offset = 0  # in what was kept
    lost = 0
    while ring.error is None:
        assert ring.wait(random_reader.randint(1, 3000), time.monotonic() + 60)
        data, reads = ring.peek()
        for read in reads:
            assert offset <= read.begin < read.end <= offset + len(data)
        count = random_reader.randint(0, len(data))
        assert data[:count].tobytes() == bytes((position + i) % 251 for i in range(count))
        position += count
        offset += count
        ring.release_to(offset)
        if count == len(data) and (gap := ring.take_gap()) is not None:
            assert gap.offset == offset
            position += gap.lost
            lost += gap.lost
    writer.join()
    assert lost == ring.lost
    assert position == total == offset + lost


def test_a_full_ring_stays_full_until_a_sixteenth_is_free() -> None:
    ring = Ring(SIZE)
    assert len(fill(ring)) == SIZE
    ring.release_to(SIZE // 16 - 1)
    assert ring.room() is None
    ring.release_to(SIZE // 16)
    assert ring.room() is not None


def test_a_read_waits_for_no_more_than_half_the_ring() -> None:
    ring = Ring(SIZE)
    put(ring, bytes(SIZE // 2))
    assert ring.wait(10 * SIZE, time.monotonic() + 60)


# Reads that become one where there are many


class Drained:
    """All that a ring gives up from offset 0, whenever it is emptied."""

    def __init__(self, ring: Ring) -> None:
        self.ring = ring
        self.raw = b""
        self.reads: list[Read] = []
        self.gaps: list[Gap] = []

    def empty(self) -> None:
        while True:
            begin = len(self.raw)
            data, more = self.ring.peek()
            for read in more:  # it lies in what is shown: in one piece of memory, without a gap
                assert begin <= read.begin < read.end <= begin + len(data)
            self.raw += bytes(data)
            self.reads += more
            self.ring.release_to(len(self.raw))
            if (gap := self.ring.take_gap()) is not None:
                self.gaps.append(gap)
            elif not len(data):
                return


@given(
    size=st.integers(20, 300),
    most=st.integers(1, 12),
    steps=st.lists(
        st.tuples(
            st.sampled_from(["put"] * 8 + ["interrupt", "empty"]),
            st.integers(1, 9),  # bytes
            st.integers(0, 5_000_000),  # nanoseconds since the step before
        ),
        max_size=120,
    ),
)
def test_merged_reads_are_the_same_bytes_between_the_same_gaps(
    size: int, most: int, steps: list[tuple[str, int, int]]
) -> None:
    """All is as without merging, but the times: a byte is dated no earlier, and in its slot."""
    plain, merging = Drained(Ring(size)), Drained(Ring(size))
    ns = sent = 0
    for what, count, wait_ns in steps:
        ns += wait_ns
        data = memoryview(bytes((sent + i) % 251 for i in range(count)))
        sent += count * (what == "put")
        for each in (plain, merging):
            with pytest.MonkeyPatch.context() as patch:
                if each is merging:
                    patch.setattr("canser.live.ring._READS_MOST", most)
                if what == "put":
                    each.ring.append(data, ns)
                elif what == "interrupt":
                    each.ring.interrupt(ns, "reconnect")
                else:
                    each.empty()
        assert merging.ring.fill == plain.ring.fill
        # Reads that a gap or the end of the memory keeps apart are not one.
        assert len(merging.ring._reads) <= most + len(merging.ring._gaps) + 1
    plain.empty()
    merging.empty()
    assert merging.raw == plain.raw
    assert merging.gaps == plain.gaps
    assert merging.ring.lost == plain.ring.lost
    begins, ends = {read.begin for read in plain.reads}, {read.end: read for read in plain.reads}
    assert [read.end for read in merging.reads[:-1]] == [read.begin for read in merging.reads[1:]]
    for read in merging.reads:
        assert read.begin in begins
        assert ends[read.end].ns == read.ns
        assert read.begin // size == (read.end - 1) // size


def test_reads_become_one_only_where_there_are_many() -> None:
    ring = Ring(1000)
    for ns in range(300):
        put(ring, b"x", ns)
    assert ring.peek()[1] == [Read(ns, ns + 1, ns) for ns in range(300)]


def fill_by_bytes(ring: Ring, count: int, period_ns: int) -> None:
    for number in range(count):
        room = ring.room()
        assert room is not None
        room[0] = number & 255
        ring.put(1, number * period_ns)


def test_many_tiny_reads_take_little_more_memory_than_the_ring() -> None:
    """As a slow reader leaves them where bytes come one by one."""
    size = 1 << 17
    tracemalloc.start()
    try:
        ring = Ring(size)
        fill_by_bytes(ring, size, 1_000_000)
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < size + (7 << 20)
    data, reads = ring.peek()
    assert bytes(data) == bytes(i & 255 for i in range(size))
    assert [read.end for read in reads[:-1]] == [read.begin for read in reads[1:]]
    assert (reads[0].begin, reads[-1].end) == (0, size)
    # 131 s in slots of 2^23 ns, the first ones that are not more than 2^15: times are within 9 ms.
    assert 1 << 13 <= len(reads) <= 1 << 15
    assert all(read.ns == (read.end - 1) * 1_000_000 for read in reads)
    assert max(read.end - read.begin for read in reads) == 9


def test_times_are_exact_again_once_the_ring_was_emptied(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canser.live.ring._READS_MOST", 10)
    ring = Ring(1000)
    fill_by_bytes(ring, 100, 1000)
    assert len(ring.peek()[1]) <= 10
    ring.release_to(100)
    for ns in range(5):
        put(ring, b"x", ns)
    assert [read.ns for read in ring.peek()[1]] == list(range(5))


@pytest.mark.parametrize("what", ["put", "interrupt", "close"])
def test_who_waits_is_woken(what: str) -> None:
    ring = Ring(SIZE)
    answers: list[bool] = []
    waiter = threading.Thread(target=lambda: answers.append(ring.wait(2, None)), daemon=True)
    waiter.start()
    put(ring, b"1")  # not enough
    if what == "put":
        put(ring, b"2")
    elif what == "interrupt":
        ring.interrupt(0, "reconnect")
    else:
        ring.close(PortGoneError("gone"))
    waiter.join(60)
    assert answers == [True]


def test_a_gap_wakes_who_came_too_late_for_the_bytes_before_it() -> None:
    ring = Ring(SIZE)
    fd = ring.fileno()
    fill(ring)
    ring.release_to(SIZE)  # just before the next bytes are counted
    assert not readable(fd)
    told: list[None] = []
    ring.listen(1, lambda: told.append(None))
    ring.lose(3, 0)
    assert told
    assert readable(fd)
    ring.release()


def test_an_interrupt_may_close_the_ring_in_the_middle_of_anything() -> None:
    ring = Ring(SIZE)
    done = threading.Event()

    def handler_in_the_middle() -> None:
        with ring._lock:
            ring.close(PortGoneError("gone"))
        done.set()

    threading.Thread(target=handler_in_the_middle, daemon=True).start()
    assert done.wait(60)


def test_the_descriptor_is_readable_while_frames_are_held() -> None:
    ring = Ring(SIZE)
    fd = ring.fileno()
    assert fd == ring.fileno()
    assert not readable(fd)
    ring.hold_ready(True)
    assert readable(fd)
    put(ring, b"1")
    ring.release_to(1)
    assert readable(fd)
    ring.hold_ready(False)
    assert not readable(fd)
    ring.release()
    ring.release()
    with pytest.raises(OSError, match="Bad file"):
        os.fstat(fd)
    ring.hold_ready(True)  # of no use any more, and no harm
