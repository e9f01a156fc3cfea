"""One loop from timed bytes to frames: cuts, the size of arrays and threads change nothing."""

import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import canser
import vectors
from canser._frames import FRAME_DTYPE
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter
from canser.simulation.traffic import vehicle
from canser.timing.loop import TimedDecoder
from long import LONG
from reference import WIRE_FORMATS

US, MS, S = 1_000, 1_000_000, 1_000_000_000
EPOCH = 1_790_000_000 * S
BAUDRATE = 115_200
BYTE_NS = 1e10 / BAUDRATE

PROTOCOLS = canser.protocols()
CONTROLS = {
    name: [control.data for vector in vectors.load(name) for control in vector.controls] or [b""]
    for name in PROTOCOLS
}
every_protocol = pytest.mark.parametrize("protocol", PROTOCOLS)


@dataclass
class Timed:
    """Bytes between two gaps, and the reads by which they came."""

    data: bytes
    ends: list[int]  # of the reads, in the data
    times: list[int]


def make_stream(protocol: str, seed: int, packet_count: int, gap_count: int) -> list[Timed]:
    """Return frames, noise and control packets that come in reads of any size at any time."""
    rng = np.random.default_rng(seed)
    frames = vehicle(0.2, seed=seed % 7 + 1, extended=WIRE_FORMATS[protocol].has_ext)[:packet_count]
    noisy, burst = rng.random(2) < 0.5
    now, parts = EPOCH, []
    for frames_of_part in np.array_split(frames, gap_count + 1):
        data = b""
        for frame in np.split(frames_of_part, len(frames_of_part)) if len(frames_of_part) else []:
            packet = canser.encode(frame, protocol)
            kind = rng.integers(0, 10)
            if kind == 0:
                packet += CONTROLS[protocol][rng.integers(len(CONTROLS[protocol]))]
            elif kind == 1 and noisy:
                packet += rng.bytes(int(rng.integers(1, 40)))
            elif kind == 2 and noisy:
                packet = packet[: int(rng.integers(1, len(packet)))]
            data += packet
        ends = np.unique(np.append(rng.integers(0, len(data) + 1, len(data) // 20), len(data)))
        # Mostly as fast as the line is, or much faster; now and then nothing comes for long.
        steps = np.diff(ends, prepend=0) * (BYTE_NS / 50 if burst else BYTE_NS)
        steps += rng.exponential(MS, len(ends)) * (rng.random(len(ends)) < 0.3)
        steps += 1000 * S * (rng.random(len(ends)) < 0.01)
        times = now + np.cumsum(steps.astype(np.int64))
        now = int(times[-1])
        parts.append(Timed(data, ends.tolist(), times.tolist()))
    return parts


class Taker:
    """Takes frames and offsets of a loop out of arrays of any size."""

    def __init__(self, protocol: str, device_time: bool, rooms: Iterator[int]) -> None:
        decoder = canser.Decoder(protocol, ts_unit="ms")
        self.loop = TimedDecoder(decoder, BYTE_NS, device_time=device_time)
        self._rooms = rooms
        self.frames, self.offsets = bytearray(), bytearray()
        self._use()

    def _use(self) -> None:
        self._size = next(self._rooms)
        self._room = np.empty(self._size, FRAME_DTYPE)
        self._at = np.empty(self._size, np.int64)
        self.loop.use(self._room, self._at)

    def _take(self) -> None:
        self.loop.assign_times()
        self.frames += self._room[: self.loop.count].tobytes()
        self.offsets += self._at[: self.loop.count].tobytes()
        self._use()

    def feed(self, data: bytes) -> None:
        while data:
            data = data[self.loop.feed(data, self._size) :]
            if self.loop.count == self._size:
                self._take()

    def gap(self) -> None:
        while self.loop.decoder.pending:
            self.loop.flush(self._size)
            if self.loop.count == self._size:
                self._take()
        self.loop.gap()

    def result(self) -> tuple[bytes, bytes]:
        self.gap()
        self._take()
        return bytes(self.frames), bytes(self.offsets)


def decode_whole(protocol: str, parts: list[Timed], device_time: bool) -> tuple[bytes, bytes]:
    """Decode with room for all, and all that is known told at first."""
    taker, begin = Taker(protocol, device_time, iter([4096, 4096])), 0
    for number, part in enumerate(parts):
        if number:
            taker.gap()
        taker.loop.clock.arrivals.extend(np.array(part.ends) + begin, np.array(part.times))
        taker.feed(part.data)
        begin += len(part.data)
    return taker.result()


def decode_in_pieces(
    protocol: str, parts: list[Timed], device_time: bool, seed: int, largest: int
) -> tuple[bytes, bytes]:
    """Decode with little room, in any calls, each part of the reads told when it must be."""
    rng = np.random.default_rng(seed)
    rooms = iter(lambda: int(rng.integers(1, largest + 1)), 0)
    taker, begin = Taker(protocol, device_time, rooms), 0
    for number, part in enumerate(parts):
        if number:
            taker.gap()
        told = done = 0
        while done < len(part.data):
            end = min(done + int(rng.integers(1, 80)), len(part.data))
            # At least the reads that hold these bytes.
            least = int(np.searchsorted(part.ends, end)) + 1
            most = int(rng.integers(least, len(part.ends) + 1))
            ends, times = np.array(part.ends[told:most]) + begin, np.array(part.times[told:most])
            if rng.random() < 0.5:
                taker.loop.clock.arrivals.extend(ends, times)
            else:
                for read in zip(ends.tolist(), times.tolist(), strict=True):
                    taker.loop.clock.arrivals.add(*read)
            told = max(told, most)
            taker.feed(part.data[done:end])
            done = end
            if rng.random() < 0.3:
                taker.loop.assign_times()
        begin += len(part.data)
    return taker.result()


@every_protocol
@settings(max_examples=100 if LONG else 30)
@given(
    seed=st.integers(0, 2**32),
    packet_count=st.integers(0, 200),
    gap_count=st.integers(0, 3),
    device_time=st.booleans(),
    largest=st.sampled_from([1, 2, 7, 100, 1000]),
)
def test_frames_and_times_do_not_depend_on_calls(
    protocol: str, seed: int, packet_count: int, gap_count: int, device_time: bool, largest: int
) -> None:
    device_time = device_time and protocol == "serial"
    parts = make_stream(protocol, seed, packet_count, gap_count)
    want = decode_whole(protocol, parts, device_time)
    got = decode_in_pieces(protocol, parts, device_time, seed, largest)
    assert got == want


@every_protocol
def test_noise_behind_a_frame_does_not_make_it_later(protocol: str) -> None:
    frame = canser.encode(vehicle(1, extended=False)[:1], protocol)
    # What no packet starts with, and 17 bytes of it take 1.5 ms.
    noise = b"\x0f" * 17
    parts = [Timed(frame + noise + frame, [2 * len(frame) + 17], [EPOCH])]
    times = np.frombuffer(decode_whole(protocol, parts, False)[0], FRAME_DTYPE)["ts"]
    # The first byte's time where frames carry a time of their own, else the last one's.
    behind = 2 * len(frame) + 16 if protocol == "serial" else len(frame) + 17
    assert times[0] == EPOCH - int(behind * BYTE_NS)


# Recordings.


def record(path: Path, protocol: str, parts: list[Timed]) -> Path:
    info = RecordingInfo(protocol, BAUDRATE, None, "ms", "/dev/ttyUSB0")
    with RecordingWriter(path, info) as writer:
        for number, part in enumerate(parts):
            for (begin, end), ns in zip(pairwise([0, *part.ends]), part.times, strict=True):
                writer.write(part.data[begin:end], ns, 5 if number and not begin else 0)
    return path


def read(source: Path | BinaryIO, room: int, threads: int) -> bytes:
    """Read block by block."""
    out = np.empty(room, FRAME_DTYPE)
    with canser.blocks(source, out=out, threads=threads, as_is=True) as blocks:
        return b"".join(block.tobytes() for block in blocks)


def read_pipe(path: Path, room: int) -> bytes:
    """Read a file that comes through a pipe."""
    out, into = os.pipe()

    def write() -> None:
        with os.fdopen(into, "wb") as pipe:
            pipe.write(path.read_bytes())

    writer = threading.Thread(target=write)
    writer.start()
    with os.fdopen(out, "rb") as pipe:
        frames = read(pipe, room, 1)
    writer.join()
    return frames


@pytest.mark.filterwarnings("ignore:.*(gaps in the recording|device clock):canser.CanserWarning")
@every_protocol
@settings(max_examples=25 if LONG else 10)
@given(
    seed=st.integers(0, 2**32),
    gap_count=st.integers(0, 2),
    rooms=st.lists(st.integers(1, 200), min_size=3, max_size=3),
)
def test_blocks_of_a_recording_do_not_depend_on_their_size(
    protocol: str,
    seed: int,
    gap_count: int,
    rooms: list[int],
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    parts = make_stream(protocol, seed, 400, gap_count)
    path = record(tmp_path_factory.mktemp("loop") / "run.pcapng", protocol, parts)
    want = canser.read(path, as_is=True).tobytes()
    for room, threads in zip(rooms, (1, 2, 3), strict=True):
        assert read(path, room, threads) == want
        assert read_pipe(path, room) == want
