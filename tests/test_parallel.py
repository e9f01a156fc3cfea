"""Threads: the same result for any number of them, and nothing is left behind.

The stretches are short here, the guesses made from little, and the threads unfair to each
other, so that every border falls where it hurts.
"""

import _thread
import contextlib
import gc
import mmap
import random
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import canser
import reference
from canser._core.buffers import Offsets, input_bytes, output_room
from canser._core.stream import ParallelChunk, Stream
from canser._core.table import find_protocol
from canser._frames import FRAME_DTYPE, FrameArray
from canser._input import Source
from canser.codec import decoder as codec
from canser.codec import parallel, sinks
from canser.codec.parallel import Ahead
from canser.files import raw as raw_format
from canser.simulation.traffic import line_noise, vehicle
from long import EXAMPLES, longer
from reference import ID_EXT_MAX, ID_MAX, TICK_NS, WIRE_FORMATS, Frame

# Threads must agree on noise, too: that most bytes are in no packet is not judged here.
pytestmark = pytest.mark.filterwarnings("ignore:.* bytes are in no .* packet")


PROTOCOLS = canser.protocols()

every_protocol = pytest.mark.parametrize("protocol", PROTOCOLS)


# --- streams ---

# Bytes that mean something to the protocol; the marks more often than the rest.


class Counting:
    """A device's counter, which runs, stands, leaps, wraps, goes back, or is broken."""

    def __init__(self, chance: random.Random) -> None:
        self._chance = chance
        self._raw = chance.choice([0, 0, 2**32 - 40, chance.getrandbits(32)])

    def run(self, size: int, *, leaps: bool) -> Iterator[int]:
        chance = self._chance
        left = 0
        for _ in range(size):
            if leaps and not left:
                # Lengths around what makes a clock run in line; steps around what is small.
                left = chance.choice([1, 1, 2, 3, 4, 5, 14, 15, 16, 17, 18, 19])
                step = chance.choice(
                    [chance.randrange(1, 8) << 29, 2**24, 2**24 + 1, -1, -(2**24), -(2**24) - 1]
                )
                self._raw += step
                if chance.random() < 0.3:
                    # One false time, and back to where it was, or near.
                    yield (self._raw + chance.choice([2**31, 2**30, 1 << 29])) % 2**32
                elif chance.random() < 0.1:
                    self._raw = chance.getrandbits(32)
            else:
                self._raw += chance.choice([0, 1, 7, 1000])
            left = max(left - 1, 0)
            self._raw %= 2**32
            yield self._raw


def packet(protocol: str, chance: random.Random, raw: int, *, odd: bool = False) -> bytes:
    ext = WIRE_FORMATS[protocol].has_ext and chance.random() < 0.4
    rtr = odd and chance.random() < 0.5
    dlc = chance.choice([0, 1, 2, 8, 8, 8])
    data = chance.randbytes(dlc) if chance.random() < 0.7 else bytes(dlc)
    frame = Frame(
        chance.randrange(ID_EXT_MAX if ext else ID_MAX),
        ext,
        rtr,
        dlc,
        odd and WIRE_FORMATS[protocol].has_err and chance.random() < 0.5,
        b"\0" * 8 if rtr else data.ljust(8, b"\0"),
        raw,
    )
    return reference.encode([frame], protocol, tick_ns=1)


def control(protocol: str, chance: random.Random) -> bytes:
    if protocol == "cantalope":
        return chance.choice([b"\xff\xff\x00", b"\xff\xff\x01\x07"])
    if protocol == "seeed":
        body = b"\x04" + chance.randbytes(16)
        return b"\xaa\x55" + body + bytes([sum(body) & 0xFF])
    return b""


KINDS = ("frames", "leaps", "odd", "controls", "noise", "significant", "one byte", "zeros", "cut")


def segment(protocol: str, kind: str, size: int, chance: random.Random, clock: Counting) -> bytes:
    raws = clock.run(size, leaps=kind == "leaps")
    match kind:
        case "frames" | "leaps":
            return b"".join(packet(protocol, chance, raw) for raw in raws)
        case "odd":
            return b"".join(packet(protocol, chance, raw, odd=True) for raw in raws)
        case "controls":
            return b"".join(control(protocol, chance) for _ in range(size))
        case "noise":
            return chance.randbytes(size)
        case "significant":
            significant = WIRE_FORMATS[protocol].significant
            return bytes(chance.choices(3 * significant[:2] + significant, k=4 * size))
        case "one byte":
            return chance.choice([b"\xaa", b"\xff", b"\x55", b"\xbb"]) * 4 * size
        case "zeros":
            # In `cantalope` these are frames of two bytes: scans that start at an odd and
            # at an even one never meet.
            return bytes(4 * size)
        case _:
            return b"".join(packet(protocol, chance, raw)[: chance.randrange(20)] for raw in raws)


class Recipe(NamedTuple):
    kinds: list[tuple[str, int]]
    seed: int

    def stream(self, protocol: str) -> bytes:
        chance = random.Random(self.seed)
        clock = Counting(chance)
        return b"".join(segment(protocol, kind, size, chance, clock) for kind, size in self.kinds)


recipes = st.builds(
    Recipe,
    st.lists(st.tuples(st.sampled_from(KINDS), st.integers(1, 60)), min_size=1, max_size=12),
    st.integers(0, 2**32),
)


# --- threads that do their worst ---


class Worst(NamedTuple):
    """How the work is cut up."""

    stretch: int  # bytes in a stretch
    least: int  # and towards the end
    lead: int  # stretches between the caller and a helper
    rest: int  # stretches to rest after many wrong guesses
    run_up: int  # bytes that a guess may read before its stretch
    small: int  # frames that fit the result before it grows
    seed: int  # of the threads' naps
    grid: int = 1  # guesses begin at multiples of this


worsts = st.builds(
    Worst,
    st.integers(24, 400),
    st.integers(1, 120),
    st.integers(0, 3),
    st.sampled_from([0, 0, 2]),
    st.sampled_from([0, 1, 5, 20, 60, 4096]),
    st.sampled_from([1, 7, 100, 1 << 15]),
    st.integers(0, 2**32),
    st.just(1),
)


@contextlib.contextmanager
def worst_case(worst: Worst) -> Iterator[Counter[str]]:
    """Cut up the work like this; yields the number of chunks that were joined, and were not."""
    joins: Counter[str] = Counter()
    chance = random.Random(worst.seed)

    def nap() -> None:
        time.sleep(chance.choice((0, 0, 0, 1e-4, 3e-4)))

    def short_sighted(
        chunk: ParallelChunk, data: Any, data_len: int, first: int, stop: int, offset: int
    ) -> None:
        nap()
        unseen = max(first - worst.run_up, 0)
        unseen -= (offset + unseen) % worst.grid
        real_decode(
            chunk, data + unseen, data_len - unseen, first - unseen, stop - unseen, offset + unseen
        )

    def join(stream: Stream, chunk: ParallelChunk) -> bool:
        joined = real_join(stream, chunk)
        joins["joined" if joined else "apart"] += 1
        joins["frames"] += chunk.count if joined else 0
        return joined

    def napping(call: Callable[..., Any]) -> Callable[..., Any]:
        def wrapper(*arguments: Any, **keywords: Any) -> Any:
            nap()
            return call(*arguments, **keywords)

        return wrapper

    real_join, real_decode = Stream.join, ParallelChunk.decode
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parallel, "STRETCH", worst.stretch)
        patch.setattr(codec, "STRETCH", worst.stretch)
        patch.setattr(parallel, "_STRETCH_LEAST", min(worst.least, worst.stretch))
        patch.setattr(parallel, "_LEAD", worst.lead)
        patch.setattr(parallel, "_REST_MOST", worst.rest)
        patch.setattr(sinks, "AT_ONCE", 0)
        patch.setattr(sinks, "SMALL", worst.small)
        patch.setattr(Stream, "join", join)
        patch.setattr(Stream, "advance", napping(Stream.advance))
        patch.setattr(ParallelChunk, "decode", short_sighted)
        patch.setattr(ParallelChunk, "deliver", napping(ParallelChunk.deliver))
        yield joins


class Outcome(NamedTuple):
    """All that a decoding leaves."""

    found: tuple[int, int]
    rows: bytes  # of all of `out`: what lies past the frames too
    offsets: list[int]
    stats: canser.Stats
    controls: list[canser.Control]
    dropped: int


def fill(protocol: str, unit: str, stream: bytes, room: int, threads: int) -> Outcome:
    decoder = canser.Decoder(protocol, ts_unit=unit)
    out = np.frombuffer(bytearray(b"\xee" * FRAME_DTYPE.itemsize * room), FRAME_DTYPE)
    offsets = np.full(room, -1, np.int64)
    found = decoder._fill(input_bytes(stream), out, offsets, threads)
    return Outcome(
        found,
        out.tobytes(),
        offsets.tolist(),
        decoder.stats,
        decoder.take_controls(),
        decoder.controls_dropped,
    )


def assert_is_what_the_reference_says(
    outcome: Outcome, stream: bytes, protocol: str, unit: str
) -> None:
    want = reference.decode(stream, protocol, TICK_NS[unit])
    count = len(want.frames)
    assert outcome.found == (count, count)
    assert outcome.rows[: count * FRAME_DTYPE.itemsize] == reference.pack(want.frames)
    assert outcome.offsets[:count] == want.offsets
    assert [tuple(packet) for packet in outcome.controls] == [tuple(p) for p in want.controls]
    assert reference.Stats.of(outcome.stats) == want.stats


@longer
@every_protocol
def test_any_number_of_threads_and_any_borders(protocol: str) -> None:
    tally: Counter[str] = Counter()

    @settings(max_examples=2 * EXAMPLES)
    @given(recipes, worsts, st.integers(2, 16), st.sampled_from(sorted(TICK_NS)), st.data())
    def judge(recipe: Recipe, worst: Worst, threads: int, unit: str, data: st.DataObject) -> None:
        stream = recipe.stream(protocol)
        room = len(stream) // 2 + 2
        want = fill(protocol, unit, stream, room, 1)
        with worst_case(worst) as joins:
            assert fill(protocol, unit, stream, room, threads) == want
            # Too little room: what fits is there, and the rest is counted.
            count = want.found[1]
            less = data.draw(st.integers(1, max(count, 1)), "room")
            got = fill(protocol, unit, stream, less, threads)
            whole = canser.decode(stream, protocol, ts_unit=unit, threads=threads)
        assert got == fill(protocol, unit, stream, less, 1)
        assert whole.tobytes() == want.rows[: count * FRAME_DTYPE.itemsize]
        tally.update(joins)
        if len(stream) < 2000:
            assert_is_what_the_reference_says(want, stream, protocol, unit)

    judge()
    # Else nothing was tested.
    assert tally["joined"] > 100, tally
    assert tally["apart"] > 20, tally
    assert tally["frames"] > 500, tally


def steps(chance: random.Random) -> Iterator[int]:
    """Yield the steps of a counter that is at a bound of the clock's rules all the time."""
    away = [chance.choice([k << 29 for k in range(1, 8)]) for _ in range(chance.randrange(6))]
    near = chance.choice([1, 0, -1, 2**24, 2**24 + 1, -(2**24), -(2**24) - 1])
    yield from [chance.randrange(10)] * chance.choice([0, 1, 3, 14, 15, 16, 17, 18, 40])
    yield from away
    yield near - sum(away)


@pytest.mark.parametrize("seed", range(30))
def test_a_clock_that_leaps_at_every_border(seed: int) -> None:
    chance = random.Random(seed)
    raws = [chance.getrandbits(32)]
    while len(raws) < 400:
        raws += [(raws[-1] + sum_) % 2**32 for sum_ in np.cumsum([*steps(chance)]).tolist()]
    stream = b"".join(b"\xaa" + raw.to_bytes(4, "little") + bytes(5) + b"\xbb" for raw in raws)
    want = fill("serial", "ns", stream, len(raws) + 1, 1)
    assert_is_what_the_reference_says(want, stream, "serial", "ns")
    joined = 0
    for frames in (3, 15, 16, 17, 18, 19, 35):
        worst = Worst(11 * frames, 11 * frames, 1, 0, 4096, 8, seed)
        with worst_case(worst) as joins:
            assert fill("serial", "ns", stream, len(raws) + 1, 3) == want
        joined += joins["joined"]
    assert joined  # how often depends on who comes when


@every_protocol
@pytest.mark.parametrize("seed", range(3))
def test_the_run_up_of_real_guesses(protocol: str, seed: int) -> None:
    chance = random.Random(seed)
    clock = Counting(chance)
    parts = [
        segment(protocol, chance.choice(KINDS), chance.randrange(1, 400), chance, clock)
        for _ in range(40)
    ]
    stream = b"".join(parts)
    want = fill(protocol, "us", stream, len(stream) // 2, 1)
    joined = 0
    for stretch in (900, 5000, 9999):
        worst = Worst(stretch, stretch // 3, 2, 64, 4096, 100, seed)
        for threads in (2, 5, 16):
            with worst_case(worst) as joins:
                assert fill(protocol, "us", stream, len(stream) // 2, threads) == want
            joined += joins["joined"]
    assert joined  # how often depends on who comes when


def test_scans_that_never_meet_cost_few_wrong_guesses() -> None:
    # Behind the ping the frames start at odd offsets, and all guesses at even ones.
    stream = b"\xff\xff\x00" + bytes(40_000)
    want = fill("cantalope", "ms", stream, 20_100, 1)
    for threads in (2, 4):
        with worst_case(Worst(40, 40, 2, 64, 20, 100, 1, grid=2)) as joins:
            assert fill("cantalope", "ms", stream, 20_100, threads) == want
        assert not joins["joined"]
        assert 0 < joins["apart"] < 1000 // 4


@pytest.mark.parametrize("threads", [2, 3, 8])
@pytest.mark.parametrize(
    ("protocol", "count", "seldom"),
    [("cantalope", 5000, 0), ("seeed", 5000, 7), ("cantalope", 150_000, 3)],
)
def test_more_control_packets_than_a_chunk_has_room_for(
    protocol: str, count: int, seldom: int, threads: int
) -> None:
    chance = random.Random(count)
    stream = b"".join(
        control(protocol, chance)
        + (packet(protocol, chance, 0) if seldom and not i % seldom else b"")
        for i in range(count)
    )
    room = len(stream) // 2
    want = fill(protocol, "ms", stream, room, 1)
    assert want.stats.controls >= count
    assert len(want.controls) + want.dropped == want.stats.controls
    stretch = 30_000 if protocol == "seeed" else 10_000
    with worst_case(Worst(stretch, 2000, 1, 2, 4096, 100, count)) as joins:
        assert fill(protocol, "ms", stream, room, threads) == want
    assert joins["joined"] > 0


def capture(protocol: str, seconds: float = 2) -> bytes:
    frames = vehicle(seconds, extended=WIRE_FORMATS[protocol].has_ext)
    return b"junk" + line_noise(canser.encode(frames, protocol)) + b"\xaa"


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Stretches of a page or so; returns the number of chunks joined, and not."""
    joins: Counter[str] = Counter()
    real_join = Stream.join

    def join(stream: Stream, chunk: ParallelChunk) -> bool:
        joined = real_join(stream, chunk)
        joins["joined" if joined else "apart"] += 1
        return joined

    for module in (parallel, codec):
        monkeypatch.setattr(module, "STRETCH", 3000)
    monkeypatch.setattr(parallel, "_STRETCH_LEAST", 1000)
    monkeypatch.setattr(Stream, "join", join)
    return joins


@every_protocol
@pytest.mark.usefixtures("short")
def test_decode_says_the_same_whatever_is_wrong(protocol: str) -> None:
    stream = capture(protocol)
    count = len(canser.decode(stream, protocol))
    at: list[Offsets] = [np.zeros(count, np.int64), np.zeros(count, np.int64)]
    at.append(np.zeros(count, np.uint64))
    for threads, offsets in zip((1, 4, 4), at, strict=True):
        canser.decode(stream, protocol, offsets=offsets, threads=threads)
        assert offsets.tolist() == at[0].tolist()
    for room in (1, count // 2, count - 1):
        for name in ("out", "offsets"):
            texts = set()
            for threads in (1, 2, 7):
                array = np.empty(room, FRAME_DTYPE if name == "out" else np.int64)
                with pytest.raises(ValueError, match=rf"^{name} has room for {room}") as raised:
                    canser.decode(stream, protocol, threads=threads, **{name: array})  # type: ignore[arg-type]
                texts.add(str(raised.value))
            assert len(texts) == 1


@every_protocol
def test_more_threads_than_there_is_work(protocol: str) -> None:
    stream = capture(protocol, 0.2)
    want = canser.decode(stream, protocol)
    for size in (0, 1, 19, 24, 25, 100, len(stream)):
        one = canser.decode(stream[:size], protocol)
        assert np.array_equal(canser.decode(stream[:size], protocol, threads=500), one)
    assert np.array_equal(canser.decode(stream, protocol, threads=10**9), want)


def test_helpers_are_as_many_as_asked_for(
    short: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: set[int] = set()
    real_decode = ParallelChunk.decode
    meet = threading.Barrier(3, timeout=30)

    def decode(*arguments: Any) -> None:
        if threading.get_ident() not in seen:
            seen.add(threading.get_ident())
            meet.wait()
        real_decode(*arguments)

    monkeypatch.setattr(ParallelChunk, "decode", decode)
    stream = capture("serial")
    want = canser.decode(stream, "serial")
    assert np.array_equal(canser.decode(stream, "serial", threads=4), want)
    assert len(seen) == 3
    assert threading.get_ident() not in seen
    assert short["joined"] > 0


def test_no_helper_takes_what_the_stream_has_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    # The helper is played by the test, and asks for work right behind a chunk that was
    # joined, when nothing else is taken.
    length = 1100
    monkeypatch.setattr(parallel, "STRETCH", length)
    monkeypatch.setattr(parallel, "_STRETCH_LEAST", length)
    raw = (b"\xaa" + bytes(9) + b"\xbb") * 1200
    data = input_bytes(raw)
    protocol = find_protocol("serial")
    stream = Stream(protocol, 1)
    out = np.empty(1000, FRAME_DTYPE)
    target, cap, at = output_room(out, 0, None)
    stream.aim_at(target, cap, at)
    ahead = Ahead(stream, data, len(raw), lambda: chunk, 2)
    chunk = ParallelChunk(protocol, 1, length, offsets=False)
    joined = 0
    claim = None
    for stretch in ahead:
        if isinstance(stretch, ParallelChunk):
            joined += 1
            claim = None
        else:
            position = stream.position
            stop = stretch - position
            stream.advance(data + position, len(raw) - position, stop)
        if claim is None and (claim := ahead._claim(chunk, wait=False)):
            assert claim.first >= stream.position
            chunk.decode(data, len(raw), claim.first, claim.stop, 0)
            claim.decoded = True
    assert joined > 2


@pytest.mark.parametrize("meddle", ["feed", "reset", "half"])
def test_a_decoder_that_others_feed_is_an_error(
    meddle: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(raw_format, "BLOCK_FRAMES", 100)
    path = tmp_path / "run.bin"
    path.write_bytes(canser.encode(vehicle(30, extended=False), "seeed"))
    with canser.blocks(path, "seeed", threads=2) as blocks:
        next(blocks)
        if meddle == "reset":
            blocks.decoder.reset()
        else:
            blocks.decoder.feed(b"\xaa" if meddle == "half" else bytes(10_000_000))
        with pytest.raises(RuntimeError, match="a Decoder of its own"):
            list(blocks)
    assert not helpers()


@pytest.mark.usefixtures("short")
def test_decode_in_several_threads_at_once() -> None:
    streams = {protocol: capture(protocol, 1) for protocol in PROTOCOLS}
    want = {protocol: canser.decode(streams[protocol], protocol) for protocol in PROTOCOLS}
    wrong: list[str] = []

    def work(protocol: str) -> None:
        for threads in (1, 2, 3, 6):
            got = canser.decode(streams[protocol], protocol, threads=threads)
            if not np.array_equal(got, want[protocol]):
                wrong.append(protocol)

    workers = [threading.Thread(target=work, args=(protocol,)) for protocol in 2 * PROTOCOLS]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert not wrong
    assert not helpers()


# --- files ---


def helpers() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "canser"]


def assert_let_go(path: Path) -> None:
    """Assert that no helper runs, and that nobody has the file open or mapped."""
    assert not helpers()
    gc.collect()
    held = []
    numbers = Path("/proc/self/fd")
    for number in numbers.iterdir() if numbers.is_dir() else ():
        with contextlib.suppress(OSError):  # the one that lists the folder
            held.append(str(number.readlink()))
    assert str(path.resolve()) not in held


def taken(blocks: canser.Blocks, offsets: Any = None) -> tuple[FrameArray, list[int]]:
    got, at = [np.empty(0, FRAME_DTYPE)], []
    for block in blocks:
        assert len(block) > 0
        got.append(block.copy())
        if offsets is not None:
            at += offsets[: len(block)].tolist()
    return np.concatenate(got), at


@every_protocol
@pytest.mark.parametrize("start", [0, 5, 5000, mmap.ALLOCATIONGRANULARITY + 7])
def test_blocks(protocol: str, start: int, short: Counter[str], tmp_path: Path) -> None:
    stream = capture(protocol)
    path = tmp_path / "run.bin"
    path.write_bytes(stream)
    count = len(canser.decode(stream[start:], protocol))
    want = fill(protocol, "ms", stream[start:], count, 1)
    for threads in (2, 3, 8):
        for room in (None, 1 if threads == 2 else 3, 100, 5000, count, count + 1):
            out = None if room is None else np.empty(room, FRAME_DTYPE)
            offsets = None if room is None or threads == 3 else np.empty(room, np.int64)
            with path.open("rb") as file:
                file.seek(start)
                blocks = canser.blocks(file, protocol, out=out, offsets=offsets, threads=threads)
                got, at = taken(blocks, offsets)
            assert got.tobytes() == want.rows
            assert offsets is None or at == want.offsets
            assert blocks.decoder.stats == want.stats
            assert blocks.decoder.take_controls() == want.controls
            assert blocks.bytes_done == blocks.bytes_total == len(stream) - start
    assert short["joined"] > 10
    assert_let_go(path)


@every_protocol
@pytest.mark.usefixtures("short")
def test_blocks_with_out_are_full_but_for_the_last(protocol: str, tmp_path: Path) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(capture(protocol))
    out = np.empty(100, FRAME_DTYPE)
    for threads in (1, 2, 5):
        sizes = [len(block) for block in canser.blocks(path, protocol, out=out, threads=threads)]
        assert set(sizes[:-1]) == {100}


@pytest.mark.usefixtures("short")
def test_blocks_without_out_are_the_callers(tmp_path: Path) -> None:
    # Nobody writes into a block that was handed out.
    path = tmp_path / "run.bin"
    path.write_bytes(capture("seeed"))
    kept, copies = [], []
    for block in canser.blocks(path, "seeed", threads=3):
        kept.append(block)
        copies.append(block.copy())
    assert np.array_equal(np.concatenate(kept), np.concatenate(copies))
    assert not any(np.shares_memory(a, b) for a, b in pairwise(kept))


@every_protocol
@pytest.mark.usefixtures("short")
def test_read(protocol: str, tmp_path: Path) -> None:
    stream = capture(protocol)
    path = tmp_path / "run.bin"
    path.write_bytes(stream)
    want = canser.decode(stream, protocol)
    at, offsets = np.empty(len(want), np.int64), np.empty(len(want), np.int64)
    canser.decode(stream, protocol, offsets=at)
    for threads in (2, 9):
        assert np.array_equal(canser.read(path, protocol, threads=threads), want)
        got = canser.read(path, protocol, offsets=offsets, threads=threads)
        assert np.array_equal(got, want)
        assert np.array_equal(at, offsets)
    assert_let_go(path)


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("room", [None, 50])
def test_progress_with_threads(room: int | None, tmp_path: Path) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(capture("serial"))
    size = path.stat().st_size
    for threads in (2, 4):
        seen: list[tuple[int, int | None]] = []
        blocks = canser.blocks(
            path,
            "serial",
            out=None if room is None else np.empty(room, FRAME_DTYPE),
            threads=threads,
            progress=lambda done, total, seen=seen: seen.append((done, total)),  # type: ignore[misc]
        )
        number = sum(1 for _ in blocks)
        done = [done for done, _ in seen]
        assert len(seen) == number > 2
        assert done == sorted(done)
        assert seen[-1] == (size, size)
        assert {total for _, total in seen} == {size}


@pytest.mark.parametrize("room", [None, 30])
@pytest.mark.parametrize("taken_before", [0, 1, 2, 20])
@pytest.mark.usefixtures("short")
def test_a_run_that_is_ended_early(
    room: int | None, taken_before: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(raw_format, "BLOCK_FRAMES", 30)
    path = tmp_path / "run.bin"
    path.write_bytes(capture("serial"))

    def begun(source: Source = path) -> canser.Blocks:
        out = None if room is None else np.empty(room, FRAME_DTYPE)
        blocks = canser.blocks(source, "serial", out=out, threads=4)
        for _ in range(taken_before):
            next(blocks)
        return blocks

    blocks = begun()
    blocks.close()
    assert_let_go(path)
    assert list(blocks) == []
    blocks.close()

    with begun():
        pass
    assert_let_go(path)

    with pytest.raises(KeyError), begun():
        raise KeyError("the caller's")
    assert_let_go(path)

    with path.open("rb") as file:
        blocks = begun(file)
        del blocks
        gc.collect()
    assert_let_go(path)


# --- what goes wrong in a helper ---


def finish(call: Callable[[], object]) -> BaseException | None:
    """Call, in a thread so that a call that hangs fails; return what was raised."""
    raised: list[BaseException | None] = []

    def run() -> None:
        try:
            call()
        except BaseException as error:  # noqa: BLE001 - handed on
            raised.append(error.with_traceback(None))
        else:
            raised.append(None)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(60)
    assert raised, "it hangs"
    return raised[0]


def nth_call_fails(nth: int, call: Callable[..., Any]) -> Callable[..., Any]:
    lock = threading.Lock()
    calls = 0

    def wrapper(*arguments: Any, **keywords: Any) -> Any:
        nonlocal calls
        with lock:
            calls += 1
            fails = calls == nth
        if fails:
            raise MemoryError("none left")
        return call(*arguments, **keywords)

    return wrapper


@pytest.mark.parametrize("nth", [1, 2, 3, 5])
@pytest.mark.parametrize("where", ["__init__", "decode", "deliver", "hand_over"])
@pytest.mark.parametrize("how", ["decode", "read", "blocks", "blocks with out"])
@pytest.mark.usefixtures("short")
def test_what_a_helper_raises_is_raised_to_the_caller(
    how: str, where: str, nth: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(stream := capture("serial"))
    monkeypatch.setattr(sinks, "AT_ONCE", 0)
    monkeypatch.setattr(sinks, "SMALL", 1)

    def run_blocks(out: FrameArray | None = None) -> None:
        with canser.blocks(path, "serial", out=out, threads=3) as blocks:
            taken(blocks)

    runs: dict[str, Callable[[], object]] = {
        "decode": lambda: canser.decode(stream, "serial", threads=3),
        "read": lambda: canser.read(path, "serial", threads=3),
        "blocks": run_blocks,
        "blocks with out": lambda: run_blocks(np.empty(99, FRAME_DTYPE)),
    }
    monkeypatch.setattr(ParallelChunk, where, nth_call_fails(nth, getattr(ParallelChunk, where)))
    raised = finish(runs[how])
    used = {"__init__", "decode", "deliver"}
    if how.startswith("blocks"):
        used |= {"hand_over"}
    if nth <= 2 and where in used:
        assert isinstance(raised, MemoryError)
    assert raised is None or str(raised) == "none left"
    assert not helpers()


def test_a_helper_that_fails_still_delivers_what_others_wait_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A result that must grow waits for all that is being copied into it. The helper's
    # first chunk is joined and not yet copied when its second one fails, and between the
    # two the caller needs more room than anybody could expect.
    length = 1100
    frame = b"\xaa" + bytes(9) + b"\xbb"
    stream = bytes(2 * length) + frame.ljust(length, b"\0") + frame * 1000
    for module in (parallel, codec):
        monkeypatch.setattr(module, "STRETCH", length)
    monkeypatch.setattr(parallel, "_STRETCH_LEAST", length)
    monkeypatch.setattr(sinks, "AT_ONCE", 0)
    monkeypatch.setattr(sinks, "SMALL", 1)
    passed = [threading.Event() for _ in range(5)]
    real_room, real_decode = sinks.GrowingArray.room, ParallelChunk.decode
    decoded: list[int] = []

    def room(sink: Any) -> tuple[Any, int, Any]:
        passed[min(sink._stream.position // length, 4)].set()
        return real_room(sink)

    def decode(
        chunk: ParallelChunk, data: Any, size: int, first: int, stop: int, offset: int
    ) -> None:
        decoded.append((first + offset) // length)
        if len(decoded) == 2:
            assert passed[3].wait(30)
            raise MemoryError("none left")
        real_decode(chunk, data, size, first, stop, offset)
        assert passed[1].wait(30)

    monkeypatch.setattr(sinks.GrowingArray, "room", room)
    monkeypatch.setattr(ParallelChunk, "decode", decode)
    raised = finish(lambda: canser.decode(stream, "serial", threads=2))
    assert decoded == [2, 4]
    assert isinstance(raised, MemoryError)
    assert not helpers()


@pytest.mark.parametrize("most", [0, 1, 2])
@pytest.mark.parametrize("how", ["decode", "read", "blocks"])
def test_threads_that_cannot_be_started_are_done_without(
    how: str, most: int, tmp_path: Path, short: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(stream := capture("serial"))
    want = canser.decode(stream, "serial")
    real_start = threading.Thread.start
    started: list[threading.Thread] = []

    def start(thread: threading.Thread) -> None:
        if thread.name == "canser":
            if len(started) == most:
                raise RuntimeError("can't start new thread")
            started.append(thread)
        real_start(thread)

    monkeypatch.setattr(threading.Thread, "start", start)
    if how == "decode":
        got = canser.decode(stream, "serial", threads=5)
    elif how == "read":
        got = canser.read(path, "serial", threads=5)
    else:
        with canser.blocks(path, "serial", threads=5) as blocks:
            got = canser.concat(blocks)
    assert np.array_equal(got, want)
    assert len(started) == most
    assert not helpers()
    assert most or not short["joined"]


@pytest.mark.parametrize(
    ("asked", "cores", "most"),
    [(1, 2, 1), (2, 2, 2), (3, 2, 2), (128, 2, 2), (10**6, 64, 16), (10**30, 64, 16), (4, 1, 1)],
)
@pytest.mark.parametrize("how", ["decode", "read", "blocks"])
def test_no_more_threads_than_cores_and_sixteen(
    how: str, asked: int, cores: int, most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(stream := bytes(4 << 20))
    monkeypatch.setattr(parallel, "count_cores", lambda: cores)
    started: list[threading.Thread] = []
    real_start = threading.Thread.start

    def start(thread: threading.Thread) -> None:
        started.append(thread)
        real_start(thread)

    monkeypatch.setattr(threading.Thread, "start", start)
    if how == "decode":
        canser.decode(stream, "serial", threads=asked)
    elif how == "read":
        canser.read(path, "serial", threads=asked)
    else:
        with canser.blocks(path, "serial", threads=asked) as blocks:
            assert not list(blocks)
    assert len(started) == most - 1


def test_the_cores_are_those_that_this_process_may_use() -> None:
    # In a process of its own: here it is replaced.
    code = """if True:
        import os, sys
        from canser.codec.parallel import count_cores
        print(count_cores(), os.cpu_count())
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
            print(count_cores(), 1)
    """
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    first, *restricted = [tuple(map(int, line.split())) for line in run.stdout.splitlines()]
    assert 1 <= first[0] <= first[1]
    assert all(cores == want for cores, want in restricted)


@pytest.mark.parametrize("where", ["advance", "join", "controls", "waiting", "progress"])
@pytest.mark.usefixtures("short")
def test_an_interrupt_in_the_caller(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(stream := capture("serial"))
    calls = 0

    def interrupted(call: Callable[..., Any] | None) -> Callable[..., Any]:
        def wrapper(*arguments: Any, **keywords: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == 3:
                raise KeyboardInterrupt
            return call(*arguments, **keywords) if call else None

        return wrapper

    if where == "waiting":
        # The caller waits for a chunk that is not decoded yet.
        real_decode = ParallelChunk.decode

        def decode(*arguments: Any) -> None:
            nonlocal calls
            calls += 1
            if calls == 3:
                time.sleep(0.2)
                _thread.interrupt_main()
                time.sleep(0.2)
            real_decode(*arguments)

        monkeypatch.setattr(ParallelChunk, "decode", decode)
    elif where != "progress":
        monkeypatch.setattr(Stream, where, interrupted(getattr(Stream, where)))
    progress = interrupted(None) if where == "progress" else None
    with (
        pytest.raises(KeyboardInterrupt),
        canser.blocks(path, "serial", threads=3, progress=progress) as blocks,
    ):
        taken(blocks)
    gc.collect()
    assert not helpers()
    if where != "progress":
        calls = 0
        with pytest.raises(KeyboardInterrupt):
            canser.decode(stream, "serial", threads=3)
        assert not helpers()


@pytest.mark.usefixtures("short")
def test_a_run_that_is_collected_by_a_helper(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(capture("serial"))
    dropped = threading.Event()
    real_decode = ParallelChunk.decode

    def decode(*arguments: Any) -> None:
        assert dropped.wait(30)
        gc.collect()
        real_decode(*arguments)

    monkeypatch.setattr(raw_format, "BLOCK_FRAMES", 10)
    monkeypatch.setattr(ParallelChunk, "decode", decode)
    with path.open("rb") as file:
        blocks = canser.blocks(file, "serial", threads=3)
        next(blocks)
        running = helpers()
        assert running
        gc.disable()
        try:
            del blocks
            dropped.set()
            for helper in running:
                helper.join(30)
        finally:
            gc.enable()
        assert not helpers()


@pytest.mark.parametrize("end", ["", "raise SystemExit(0)", "del blocks", "time.sleep(0.2)"])
def test_the_interpreter_ends_while_helpers_wait(end: str, tmp_path: Path) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(capture("serial", 20))
    code = (
        "import sys, time, canser\n"
        "from canser.codec import decoder, parallel\n"
        "from canser.files import raw\n"
        "raw.BLOCK_FRAMES = 100\n"
        "decoder.STRETCH = parallel.STRETCH = parallel._STRETCH_LEAST = 1 << 14\n"
        "parallel.count_cores = lambda: 4\n"
        "blocks = canser.blocks(sys.argv[1], 'serial', threads=4)\n"
        f"print(len(next(blocks)))\n{end}\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, str(path)],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert run.stdout == "100\n"
    assert run.stderr == ""
