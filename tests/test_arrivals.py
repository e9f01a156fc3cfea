"""When bytes came, and what disproves a line's bit rate."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canser._core.buffers import FrameRoom, Times
from canser._frames import FRAME_DTYPE
from canser.timing.arrivals import NEVER_NS, Arrivals, count_back
from canser.timing.clocks import FrameClock

US, MS, S = 1_000, 1_000_000, 1_000_000_000
EPOCH = 1_790_000_000 * S
BYTE_NS = 1e10 / 115_200


def read_rows(reads: list[tuple[int, int]]) -> Times:
    """Return where reads end and when, by their sizes and the times between them."""
    rows: Times = np.cumsum(np.array(reads), axis=0)
    rows[:, 1] += EPOCH
    return rows


def arrivals_of(reads: list[tuple[int, int]], byte_ns: float = BYTE_NS) -> Arrivals:
    """Return arrivals by the sizes of reads and the times between them."""
    arrivals = Arrivals(byte_ns)
    arrivals.extend(*read_rows(reads).T)
    return arrivals


def times_of(rows: Times, stops: list[int]) -> tuple[Times, Arrivals]:
    """Return when each byte had come, asked for behind some of the reads, and the arrivals."""
    clock, size = FrameClock(None, BYTE_NS), int(rows[-1, 0])
    ends = np.arange(size) + 1
    room = FrameRoom(np.zeros(size, FRAME_DTYPE), None, ends)
    for k, row in enumerate(rows.tolist(), start=1):
        clock.arrivals.add(*row)
        if k in stops or k == len(rows):
            clock.assign_times(room, row[0], row[0])
    return room.frames["ts"], clock.arrivals


def line_reads(
    byte_count: int,
    *,
    waits: Times | None = None,
    stall: int = 0,
    most: int = 4095,
    between: int = MS,
    byte_ns: float = BYTE_NS,
) -> list[tuple[int, int]]:
    """Return reads of a line that sends all the time: their sizes and the times between them.

    Each comes `between` after the one before, or when it has waited for that one's stamp: the time
    of `waits`. Behind the first half of the bytes the host stands still for `stall`.
    """
    reads, done, now, stamp, k = [], 0, 0, 0, 0
    while done < byte_count:
        now = max(now + between, stamp)
        if stall and done >= byte_count // 2:
            now, stall = now + stall, 0
        count = min(int(now / byte_ns) - done, most, byte_count - done)
        if count <= 0:
            continue
        last, stamp = stamp, now + (0 if waits is None else int(waits[k % len(waits)]))
        reads.append((count, stamp - last))
        done, k = done + count, k + 1
    return reads


@given(
    st.lists(st.tuples(st.integers(0, 5000), st.integers(0, 10**11)), min_size=1, max_size=80),
    st.lists(st.integers(0, 80), max_size=6),
    st.lists(st.integers(0, 80), max_size=3),
    st.sampled_from([0.0, 5000.0, BYTE_NS, 1e7]),
)
def test_reads_told_together_are_those_told_one_by_one(
    reads: list[tuple[int, int]], cuts: list[int], gaps: list[int], byte_ns: float
) -> None:
    one, together = Arrivals(byte_ns), Arrivals(byte_ns)
    rows = np.cumsum(np.array(reads), axis=0)
    rows[:, 1] += EPOCH
    borders = sorted({0, len(rows), *(cut for cut in [*cuts, *gaps] if cut < len(rows))})
    for begin, end in pairwise(borders):
        for arrivals in (one, together):
            if begin in gaps:
                arrivals.gap()
        for row in rows[begin:end].tolist():
            one.add(*row)
        together.extend(*rows[begin:end].T)
        assert one.end == together.end == rows[end - 1, 0]
        assert one.last_ns == together.last_ns == rows[end - 1, 1]
        assert one.unrated_from == together.unrated_from
    assert np.array_equal(one.pieces, together.pieces)


@given(
    st.lists(st.tuples(st.integers(1, 90), st.integers(0, S)), min_size=1, max_size=300),
    st.lists(st.integers(0, 300), max_size=20),
)
def test_bytes_have_their_times_whatever_is_forgotten(
    reads: list[tuple[int, int]], stops: list[int]
) -> None:
    rows = read_rows(reads)
    want, whole = times_of(rows, [len(rows)])
    got, _ = times_of(rows, stops)
    if whole.unrated_from is None:
        assert np.array_equal(got, want)
    assert (np.diff(want) >= 0).all()
    # The rule in one line, for each byte by itself.
    unrated = whole.end if whole.unrated_from is None else whole.unrated_from
    for (begin, before), (end, ns) in pairwise([(0, NEVER_NS), *rows.tolist()]):
        for byte in range(begin, end):
            byte_ns = BYTE_NS if byte < unrated else 0
            assert want[byte] == count_back(ns, end - byte - 1, byte_ns, before)


def test_times_never_go_back() -> None:
    for tell in ("add", "extend"):
        arrivals = Arrivals(BYTE_NS)
        for end, ns in ((10, 5000), (20, 4000), (30, 6000)):
            if tell == "add":
                arrivals.add(end, ns)
            else:
                arrivals.extend(np.array([end]), np.array([ns]))
        assert arrivals.pieces[1:].tolist() == [[10, 5000], [20, 5000], [30, 6000]]


@pytest.mark.parametrize("rate", [13_000, 20_000, 100_000])
def test_more_bytes_than_the_rate_allows_disprove_it(rate: int) -> None:
    # What the system may have held at the start is forgiven: 10 s.
    a_millisecond = (rate // 1000, MS)
    arrivals = arrivals_of([a_millisecond] * 200_000)
    assert arrivals.unrated_from is not None
    allowed = 10.1 / (rate * BYTE_NS * 0.97 / S - 1)
    assert arrivals.unrated_from / rate == pytest.approx(allowed, rel=0.15)
    # Behind a silence it takes as long as the silence.
    arrivals = arrivals_of([(10, 0), (10, S // 2), *[a_millisecond] * 60_000])
    assert arrivals.unrated_from is not None
    assert arrivals.unrated_from / rate == pytest.approx(0.6 * allowed / 10.1, rel=0.2)
    # From there on nothing is counted back.
    rows = read_rows([(10, 0), (10, S // 2), *[a_millisecond] * 8000])
    times, arrivals = times_of(rows, [])
    assert arrivals.unrated_from is not None
    behind = rows[rows[:, 0] > arrivals.unrated_from]
    assert np.array_equal(np.unique(times[arrivals.unrated_from :]), behind[:, 1])


def test_a_line_that_keeps_its_rate_is_believed() -> None:
    assert arrivals_of(line_reads(200_000)).unrated_from is None


def test_a_clock_of_16_mhz_makes_a_line_2_percent_faster() -> None:
    assert arrivals_of(line_reads(2_000_000, byte_ns=BYTE_NS * 0.979)).unrated_from is None


@pytest.mark.parametrize("share", [0.003, 0.05, 0.5, 1])
def test_stamps_that_are_late_disprove_nothing(share: float) -> None:
    rng = np.random.default_rng(3)
    waits = np.where(rng.random(9973) < share, rng.integers(5 * MS, 90 * MS, 9973), 0)
    assert arrivals_of(line_reads(2_000_000, waits=waits)).unrated_from is None


@pytest.mark.parametrize("between", [50 * US, 5 * MS, 100 * MS])
def test_a_stall_of_the_host_disproves_nothing(between: int) -> None:
    # Then what the system holds is read as fast as this process can, 4 KB at a time.
    reads = line_reads(200_000, stall=5 * S, between=between)
    assert sum(size == 4095 for size, _ in reads) > 5
    assert arrivals_of(reads).unrated_from is None


@pytest.mark.parametrize("held", [4095, 1 << 16])
def test_what_was_held_at_the_start_and_behind_a_gap_disproves_nothing(held: int) -> None:
    arrivals = Arrivals(BYTE_NS)
    end, ns = 0, EPOCH
    for start in range(3):
        if start:
            arrivals.gap()
        for size in [4095] * (held // 4095) + [100] * 50:
            end, ns = end + size, ns + (50 * US if size > 100 else 20 * MS)
            arrivals.add(end, ns)
    assert arrivals.unrated_from is None
