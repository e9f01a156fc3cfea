"""What C does for each frame's time, against plain Python."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canser._core.buffers import FrameRoom
from canser._core.timing import BUCKET, SILENCE, FrameTiming, pieces_at
from canser._frames import FRAME_DTYPE

MS, S = 1_000_000, 1_000_000_000
EPOCH = 1_790_000_000 * S
TURN, SMALL, IN_LINE = 2**32, 2**24, 16
LEAST, MOST = -(2**63), 2**63 - 1
MINUTE = 60 * S

Pieces = list[tuple[int, int]]


def wrapped(value: int) -> int:
    value %= 2**64
    return value - 2**64 if value >> 63 else value


def room_of(at: list[int], times: list[int]) -> FrameRoom:
    """Return room with frames that begin at these offsets, and end there as well."""
    frames = np.zeros(max(len(at), 1), FRAME_DTYPE)
    frames["ts"][: len(at)] = times
    offsets = np.zeros(len(frames), np.int64)
    offsets[: len(at)] = at
    return FrameRoom(frames, offsets, offsets.copy())


def arrival_of(pieces: Pieces, at: int, byte_ns: float) -> int:
    """Return when a byte had come: with the first piece that reaches behind it."""
    piece = next((k for k, (end, _) in enumerate(pieces) if end > at), None)
    if piece is None:
        return pieces[-1][1]
    end, ns = pieces[piece]
    arrival = ns - int((end - at - 1) * byte_ns)
    return max(arrival, pieces[piece - 1][1]) if piece else arrival


class PlainTurns:
    """Which turn of its counter a device's clock is in, with integers of any size."""

    def __init__(self, tick_ns: int) -> None:
        self.tick_ns, self.turn_ns = tick_ns, TURN * tick_ns
        self.known: int | None = None  # arrival less device time
        self.last, self.run = 0, 0

    def near(self, counter: int, arrival: int, delay: int) -> tuple[int, bool]:
        """Return the turn's time nearest to where a clock should be, and whether it is near."""
        expected = arrival - delay
        below = expected - (expected - counter) % self.turn_ns
        time = below if expected - below <= self.turn_ns // 2 else below + self.turn_ns
        return time, abs(time - expected) <= SMALL * self.tick_ns

    def time(self, decoded: int, arrival: int) -> int:
        # A decoder's times are right but for whole turns, modulo 2**64.
        zeros = (self.tick_ns & -self.tick_ns).bit_length() - 1
        ticks = (decoded >> zeros) * pow(self.tick_ns >> zeros, -1, 2**64)
        counter: int = ticks % TURN * self.tick_ns
        if self.known is None:
            self.known = arrival - counter
            return counter
        time, is_near = self.near(counter, arrival, self.known)
        if is_near:
            self.known, self.run = arrival - time, 0
            return time
        next_time, goes_on = self.near(counter, arrival, self.last)
        goes_on &= self.run > 0
        time = next_time if goes_on else time
        self.run = self.run + 1 if goes_on else 1
        self.last = arrival - time
        if self.run == IN_LINE:
            self.known, self.run = self.last, 0
        return time


def line_at(line: tuple[int, int, float], device: int) -> int:
    run = wrapped(device - line[0])
    return wrapped(run + int(float(run) * line[2]) + line[1])


class PlainTiming:
    """Times, frame by frame, and where the caller is asked."""

    def __init__(self, tick_ns: int, bucket: tuple[int, int, int], silence_ns: int) -> None:
        self.turns = PlainTurns(tick_ns)
        self.bucket, self.silence_ns = bucket, silence_ns
        self.line: tuple[int, int, float] | None = None
        self.trust = (0, 0, 0)  # reached, early, late
        self.latest = self.arrived = LEAST
        self.piece = 0  # the end of the one at hand
        self.piece_frames: list[tuple[int, int]] = []
        self.samples: list[tuple[int, int, int]] = []

    def sample(self) -> tuple[int, int, int]:
        """Return the least late frame of the piece, but for two that are a minute lower."""
        lowest = sorted(self.piece_frames, key=lambda frame: wrapped(frame[1] - frame[0]))[:3]
        delays = [wrapped(arrival - device) for device, arrival in lowest]
        first = 0
        while first + 1 < len(lowest) and wrapped(delays[first + 1] - delays[first]) > MINUTE:
            first += 1
        chosen = lowest[first]
        return (*chosen, self.arrived - chosen[1])

    def stop(self, piece: int, arrival: int) -> int:
        """Tell why the caller is asked before a frame, if it is."""
        if self.turns.known is not None and piece != self.piece:
            if arrival - self.arrived > self.silence_ns:
                self.arrived = arrival
                return SILENCE
            if self.piece_frames:
                self.samples.append(self.sample())
                self.piece_frames = []
                bucket_ns, least, most = self.bucket
                is_long = self.samples[-1][1] - self.samples[0][1] >= bucket_ns
                if (is_long and len(self.samples) >= least) or len(self.samples) >= most:
                    return BUCKET
        return 0

    def time(self, piece: int, decoded: int, arrival: int) -> int:
        self.piece = piece
        device = wrapped(self.turns.time(decoded, arrival))
        self.piece_frames.append((device, arrival))
        self.arrived = arrival
        if self.line is None:
            self.latest = arrival
            return arrival
        reached, early, late = self.trust
        host = line_at(self.line, device)
        if not -early <= wrapped(arrival - host) <= late or wrapped(device - reached) < -early:
            return arrival
        self.latest = max(self.latest, min(host, arrival))
        return self.latest


PIECES = st.lists(
    st.tuples(st.integers(0, 40), st.integers(0, S) | st.integers(0, 2000 * S) | st.just(MS)),
    min_size=1,
    max_size=30,
)
GAPS = st.lists(st.integers(1, 25), min_size=1, max_size=60)
BYTE_NS = st.sampled_from([0.0, 0.1, 86805.55, 2e9]) | st.floats(0, 2e9)


def pieces_of(steps: list[tuple[int, int]]) -> Pieces:
    ends = np.cumsum([0] + [size for size, _ in steps]).tolist()
    times = (EPOCH + np.cumsum([0] + [ns for _, ns in steps])).tolist()
    return list(zip(ends, times, strict=True))


@given(PIECES, GAPS, BYTE_NS, st.lists(st.integers(0, 60), max_size=4))
def test_arrivals(
    steps: list[tuple[int, int]], sizes: list[int], byte_ns: float, cuts: list[int]
) -> None:
    pieces = pieces_of(steps)
    behind = np.cumsum(sizes).tolist()
    room = room_of(behind, [MOST] * len(behind))
    timing = FrameTiming(0, byte_ns)
    for cut in [*sorted(cut for cut in cuts if cut < len(behind)), len(behind)]:
        timing.assign(pieces_at(np.array(pieces)), len(pieces), room, cut)
        assert room.timed == cut
    # The last byte of each counts.
    expected = [arrival_of(pieces, end - 1, byte_ns) for end in behind]
    assert room.frames["ts"].tolist() == expected


def false_runs(rng: np.random.Generator, count: int, most: int) -> list[int | None]:
    """Return by how many ticks a clock is off: for runs of frames it is, or shows anything.

    `most`: ticks by which it is set. Set over and over, one of seconds would pass 2**63 ns.
    """
    off: list[int | None] = []
    while len(off) < count:
        length = int(rng.integers(1, 20))
        way = int(rng.integers(0, 6))
        if way < 3:
            off += [0] * length
        elif way == 3:
            off += [None] * int(rng.integers(1, 4))
        else:
            # As if the clock had been set, half a turn away as well, and near the limit.
            places = (TURN // 2, SMALL, int(rng.integers(0, TURN)))
            place = min(places[int(rng.integers(0, 3))], most)
            off += [place + int(rng.integers(-1, 2))] * length
    return off[:count]


def stream_of(
    seed: int, tick_ns: int, byte_ns: float
) -> tuple[Pieces, list[int], list[int], list[int]]:
    """Return pieces, and of each frame its offset, its arrival, and the time of its decoder."""
    rng = np.random.default_rng(seed)
    most = int(rng.choice([MS, S, 100 * S]))
    steps = [(int(rng.integers(0, 60)), int(rng.integers(0, most))) for _ in range(60)]
    pieces = pieces_of(steps)
    at = (np.cumsum(rng.integers(1, 25, int(rng.integers(0, 200)))) - 1).tolist()
    arrivals = [arrival_of(pieces, offset, byte_ns) for offset in at]
    decoded, turn = [], 0
    for arrival, off in zip(
        arrivals, false_runs(rng, len(at), SMALL if tick_ns == S else TURN), strict=True
    ):
        raw = int(rng.integers(0, TURN)) if off is None else arrival // tick_ns + 12345 + off
        # A decoder may be some turns off.
        turn += int(rng.integers(-2, 3)) if rng.random() < 0.05 else 0
        decoded.append(wrapped((raw % TURN + turn * TURN) * tick_ns))
    return pieces, at, arrivals, decoded


UNITS = [1, 1_000, MS, S]
SEEDS = st.integers(0, 2**32)


@settings(max_examples=300)
@given(st.sampled_from(UNITS), BYTE_NS, SEEDS)
def test_frames_of_a_device(tick_ns: int, byte_ns: float, seed: int) -> None:
    pieces, at, arrivals, decoded = stream_of(seed, tick_ns, byte_ns)
    rng = np.random.default_rng(seed)
    span = int(rng.choice([MS, S, 10 * S]))
    bucket = (int(rng.integers(0, span)), int(rng.integers(0, 8)), int(rng.integers(1, 20)))
    silence_ns, early = int(rng.integers(1, 5 * span)), int(rng.integers(0, MS))
    cuts = rng.integers(0, len(at) + 1, 4).tolist()
    room = room_of(at, decoded)
    timing = FrameTiming(
        tick_ns,
        byte_ns,
        silence_ns=silence_ns,
        bucket_ns=bucket[0],
        bucket_least=bucket[1],
        early_ns=early,
    )
    timing.stop_at(bucket[2])
    plain = PlainTiming(tick_ns, bucket, silence_ns)
    stops = [*sorted(cuts), len(at)]
    rows = pieces_at(np.array(pieces))
    expected = []
    for k in range(len(at)):
        piece = next((end for end, _ in pieces if end > at[k]), pieces[-1][0])
        while why := plain.stop(piece, arrivals[k]):
            # Up to here without a stop, wherever the calls are cut.
            for stop in [*(stop for stop in stops if room.timed < stop < k), len(at)]:
                stopped = timing.assign(rows, len(pieces), room, stop)
            assert (stopped, room.timed) == (why, k)
            if why == SILENCE:
                timing.drop_samples()
                plain.samples, plain.piece_frames = [], []
            else:
                assert timing.take_samples().tolist() == plain.samples
                plain.samples = []
            plain.line = None
            timing.forget_line()
            if rng.random() < 0.8:
                # The device's time of the next frame may be a true one.
                device = wrapped(arrivals[k] - (plain.turns.known or 0))
                host, late = arrivals[k] + int(rng.integers(-MS, MS)), int(rng.integers(0, span))
                plain.line = (device, host, float(rng.uniform(-0.02, 0.02)))
                plain.trust = (device + int(rng.integers(-MS, MS)), early, late)
                timing.set_line(*plain.line)
                timing.trust(plain.trust[0], late)
        expected.append(plain.time(piece, decoded[k], arrivals[k]))
    for stop in stops:
        if stop >= room.timed:
            assert timing.assign(rows, len(pieces), room, stop) == 0
    assert room.frames["ts"][: len(at)].tolist() == expected


@settings(max_examples=300)
@given(st.sampled_from(UNITS), SEEDS)
def test_device_times(tick_ns: int, seed: int) -> None:
    pieces, at, arrivals, decoded = stream_of(seed, tick_ns, 0)
    room, plain = room_of(at, decoded), PlainTurns(tick_ns)
    timing = FrameTiming(tick_ns, 0, keeps_device=True)
    assert timing.assign(pieces_at(np.array(pieces)), len(pieces), room, len(at)) == 0
    expected = [
        wrapped(plain.time(time, arrival)) for time, arrival in zip(decoded, arrivals, strict=True)
    ]
    assert room.frames["ts"][: len(at)].tolist() == expected


def test_no_time_lies_before_those_of_others() -> None:
    rows = np.array([(0, LEAST // 2), (9, 70), (99, 100)])
    room = room_of([1, 10, 11, 12], [60, 60, 80, 50])
    timing = FrameTiming(1, 0, silence_ns=MOST, bucket_ns=MOST, early_ns=99)
    assert timing.assign(pieces_at(rows), 3, room, 1) == 0
    timing.set_line(0, 0, 0.0)
    timing.trust(0, 99)
    assert timing.assign(pieces_at(rows), 3, room, 4) == 0
    assert room.frames["ts"].tolist() == [70, 70, 80, 80]


@pytest.mark.parametrize("count", [63, 64, 65, 1000])
def test_any_number_of_samples(count: int) -> None:
    at = np.arange(count + 1)
    rows = np.column_stack((at + 1, EPOCH + at))
    room = room_of(at.tolist(), at.tolist())
    timing = FrameTiming(1, 0, silence_ns=MOST, bucket_ns=MOST)
    for begin, end in pairwise([0, count // 2, count + 1]):
        assert timing.assign(pieces_at(rows), len(rows), room, end) == 0
        assert room.timed == end > begin
    samples = timing.take_samples()
    assert samples["device"].tolist() == at[:-1].tolist()
    assert samples["arrival"].tolist() == rows[:-1, 1].tolist()
    assert not timing.take_samples().size


def test_what_c_refuses() -> None:
    room = room_of([0], [0])
    rows = np.array([(1, 2)])
    with pytest.raises(AssertionError, match="status"):
        FrameTiming(2**31, 0).assign(pieces_at(rows), 1, room, 1)
    with pytest.raises(ValueError, match="multiple of 8 bytes"):
        FrameTiming(0, 0).assign(
            pieces_at(np.frombuffer(b"\0" * 25, np.uint8)[1:17].view(np.int64)), 1, room, 1
        )
    assert room.timed == 0
