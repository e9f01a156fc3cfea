"""Print what canser reaches and what it must reach, side by side.

Each figure is a ratio of two times in one run: both calls are warm, their rounds alternate,
the median counts. What is measured is checked first. README.md, beside this file, explains
the figures and what bounds them.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

import bus_numbers
import canser
import data
import growth
import instructions
import log_files
import memory
import peers
import recording_files
import resampling
import signal_numbers
from canser._frames import FrameArray
from hostile import Bytes, hostile, noisy, tiled
from measure import copy_and_fill, machine, paired

MIB = 1 << 20
ONE = "serial"  # for what does not depend on the protocol
PIECE, SMALL, SMALL_CALLS = 4096, 100, 1000

SETS: dict[str, Callable[[int, str], FrameArray]] = {
    "mixed": data.mixed,
    "periodic": data.periodic,
}

# What must be reached, and why it is that: README.md, beside this file.
L_RATIO = 1.3
L_BOUNDS_NS = 4.0  # memory is the limit where L takes longer than this for a frame
PYTHON_CAN = {"serial": 750.0, "seeed": 1300.0}
PEERS = {"numpy": 10.0, "a numba loop": 2.0}
HOSTILE = 8.0  # clean frames
# Ten times what was reached on this machine when Python walked the blocks.
RECORDED_SMALL = {"serial": 0.023, "seeed": 0.043, "cantalope": 0.041}
RECORDED_FULL = {"serial": 0.13, "seeed": 0.27, "cantalope": 0.27}
PIECES, PIECES_OTHERS = {"serial": 0.45}, 0.55
NEW_ARRAY = {1 << 20: 0.65, 1 << 16: 0.45}  # by the bytes of the input


class Row(NamedTuple):
    """A line of the table."""

    what: str
    protocol: str
    reached: float
    required: float | None
    note: str = ""


class Stream:
    """Frames, their bytes, and room for both."""

    def __init__(self, name: str, protocol: str, count: int) -> None:
        self.name, self.protocol, self.count = name, protocol, count
        self.frames = SETS[name](count, protocol)
        self.raw: Bytes = np.frombuffer(canser.encode(self.frames, protocol), np.uint8)
        self.out = np.empty(count + 1, canser.FRAME_DTYPE)
        self.decoder = canser.Decoder(protocol)
        expected = self.frames.copy()
        if not canser.protocol(protocol).has_clock:
            expected["ts"] = canser.NO_TIME
        expected["data"][expected["rtr"]] = 0
        decoded = canser.decode(self.raw, protocol, out=self.out)
        assert np.array_equal(decoded, expected), f"decoding {protocol} is wrong"

    def feed(self) -> None:
        """Decode all in one call."""
        self.decoder.feed_into(self.raw, self.out)


def take(decoder: canser.Decoder, raw: Bytes, out: FrameArray) -> None:
    """Decode all into an array that may be too small, again and again."""
    used = 0
    while used < len(raw):
        more, _ = decoder.feed_into(raw[used:], out)
        used += more


def against_memory(stream: Stream, rounds: int) -> Iterator[Row]:
    """Compare with L: numpy copies what is read and fills what is written."""
    raw, frames, protocol = stream.raw, stream.frames, stream.protocol
    copy, records = np.empty_like(raw), stream.out[:-1].view(np.uint64)
    limit_s, ours_s, ratio = paired(lambda: copy_and_fill(raw, copy, records), stream.feed, rounds)
    required = L_RATIO if limit_s / stream.count * 1e9 > L_BOUNDS_NS else None
    note = f"{stream.count / ours_s / 1e6:.0f} Mframes/s, {len(raw) / ours_s / 1e9:.2f} GB/s, L "
    note += f"{limit_s / stream.count * 1e9:.2f} ns a frame"
    yield Row(f"decode over L, {stream.name}", protocol, ratio, required, note)

    room = np.empty(stream.count * 20, np.uint8)
    assert np.array_equal(canser.encode(frames, protocol, out=room), raw), "encoding is wrong"
    words, words_copy, target = frames.view(np.uint64), np.empty_like(frames), room[: len(raw)]
    limit_s, ours_s, ratio = paired(
        lambda: copy_and_fill(words, words_copy.view(np.uint64), target),
        lambda: canser.encode(frames, protocol, out=room),
        rounds,
    )
    required = L_RATIO if limit_s / stream.count * 1e9 > L_BOUNDS_NS else None
    note = f"{stream.count / ours_s / 1e6:.0f} Mframes/s, L {limit_s / stream.count * 1e9:.2f} ns"
    yield Row(f"encode over L, {stream.name}", protocol, ratio, required, f"{note} a frame")


def counted() -> Iterator[Row]:
    """Count instructions a frame: they are the same on every machine, and in every run."""
    if not shutil.which("valgrind"):
        print("valgrind is not installed: instructions are not counted")
        return
    now, recorded = instructions.measure(), json.loads(instructions.RECORD.read_text())
    comparable = instructions.origin(now) == instructions.origin(recorded)
    for name, figure in now["figures"].items():
        work, protocol, stream = name.split()
        if stream == "mixed":
            most = recorded["figures"][name] * (1 + instructions.TOLERANCE)
            required = most if comparable else None
            yield Row(f"{work}, instructions a frame, at most", protocol, figure, required)


def new_arrays(stream: Stream, rounds: int) -> Iterator[Row]:
    """Decode into a new array, over one that is used again."""
    protocol, decoder = stream.protocol, canser.Decoder(stream.protocol)
    for size, required in NEW_ARRAY.items():
        raw = canser.encode(stream.frames[: size * stream.count // len(stream.raw)], protocol)
        calls = range((16 << 20) // size)

        def reused() -> None:
            for _ in calls:  # noqa: B023
                decoder.feed_into(raw, stream.out)  # noqa: B023

        def new() -> FrameArray:
            for _ in calls:  # noqa: B023
                frames = canser.decode(raw, protocol)  # noqa: B023
            return frames

        def fed() -> FrameArray:
            for _ in calls:  # noqa: B023
                frames = decoder.feed(raw)  # noqa: B023
            return frames

        _, fed_s, fed_ratio = paired(reused, fed, rounds)
        reused_s, new_s, ratio = paired(reused, new, rounds)
        note = f"feed_into {reused_s / len(calls) * 1e6:.1f} us, decode "
        note += f"{new_s / len(calls) * 1e6:.1f} us; feed {fed_s / len(calls) * 1e6:.1f} us, "
        note += f"{fed_ratio:.2f}"
        yield Row(f"decode to a new array, {size >> 10} KiB", protocol, ratio, required, note)


def whole_records(stream: Stream, rounds: int) -> Iterator[Row]:
    """Join and choose frames, over numpy, which does so field by field."""
    frames = stream.frames[:100_000]
    parts = [frames[begin : begin + 4096] for begin in range(0, len(frames), 4096)]
    chosen = frames["id"] % 2 == 0
    assert np.array_equal(canser.concat(parts), frames)
    assert np.array_equal(frames.compress(chosen), frames[chosen])
    pairs: list[tuple[str, Callable[[], FrameArray], Callable[[], FrameArray]]] = [
        (
            "concat, over np.concatenate",
            lambda: np.concatenate(parts),
            lambda: canser.concat(parts),
        ),
        ("compress, over an index", lambda: frames[chosen], lambda: frames.compress(chosen)),
    ]
    for what, numpys, ours in pairs:
        numpy_s, ours_s, ratio = paired(numpys, ours, rounds)
        note = f"{numpy_s / len(frames) * 1e9:.1f} and {ours_s / len(frames) * 1e9:.2f} ns a frame"
        yield Row(what, stream.protocol, ratio, None, note)


def against_peers(stream: Stream, rounds: int) -> Iterator[Row]:
    """Give the same bytes from memory to other decoders."""
    protocol, raw, count = stream.protocol, stream.raw, stream.count
    expected = canser.decode(raw, protocol)
    for name, rival in peers.written(protocol).items():
        room = np.zeros(count + 1, canser.FRAME_DTYPE)
        assert np.array_equal(room[: rival(raw, room)], expected), f"{name} is wrong"
        rival_s, _, ratio = paired(lambda: rival(raw, room), stream.feed, rounds)  # noqa: B023
        note = f"{count / rival_s / 1e6:.0f} Mframes/s"
        yield Row(f"decode over {name}", protocol, ratio, PEERS[name], note)
    if protocol in peers.PYTHON_CAN:
        # Remote frames make python-can lose its place; there are none in this set.
        few = stream.frames[: min(count, 20_000)]
        few_raw = canser.encode(few, protocol)
        assert peers.python_can(protocol, few_raw) == len(few), "python-can loses frames"
        bus_s, _, ratio = paired(
            lambda: peers.python_can(protocol, few_raw), stream.feed, min(rounds, 5)
        )
        note = f"{len(few) / bus_s / 1e6:.2f} Mframes/s"
        required = PYTHON_CAN[protocol]
        yield Row(
            "decode over python-can's bus", protocol, ratio * count / len(few), required, note
        )


def noise(stream: Stream, rounds: int) -> Iterator[Row]:
    """Compare with the clean stream: bytes a second, and what a unit of hostile bytes takes.

    A unit is a frame or a skipped byte, the least that a decoder can be asked to do.
    """
    protocol, raw, out = stream.protocol, stream.raw, stream.out
    spoilt = noisy(raw, 1e-3, 1)
    decoder = canser.Decoder(protocol)
    _, _, ratio = paired(stream.feed, lambda: decoder.feed_into(spoilt, out), rounds)
    yield Row("1 byte in 1000 bad, over clean", protocol, ratio, 0.9)
    room = np.zeros(1 << 18, canser.FRAME_DTYPE)
    clean = tiled(raw, len(raw))
    units: dict[str, float] = {}
    streams = hostile(protocol, len(raw))
    for name, bad in streams.items():
        decoder.reset()
        take(decoder, bad, room)
        found = decoder.stats.frames + decoder.stats.bytes_skipped
        _, _, ratio = paired(
            lambda: take(decoder, bad, room),  # noqa: B023
            lambda: take(decoder, clean, room),
            max(rounds // 3, 1),
        )
        units[name] = ratio * stream.count / found
    note = ", ".join(f"{name} {unit:.2f}" for name, unit in units.items())
    yield Row("hostile, clean frames a unit, at most", protocol, max(units.values()), HOSTILE, note)
    worst = max(units, key=lambda name: units[name])
    sizes = [1 << bits for bits in range(20, 27, 2) if 1 << bits <= len(raw)]
    if len(sizes) < 2:
        return  # an exponent needs two sizes
    pieces = [streams[worst][:size] for size in sizes]
    seconds = growth.fastest(protocol, pieces, room, max(rounds // 3, 1))
    grown = growth.Growth(protocol, "hostile", worst, sizes, seconds)
    note = f"{worst}, 1 to {sizes[-1] >> 20} MiB"
    yield Row("hostile, exponent of time, at most", protocol, grown.exponent, growth.EXPONENT, note)


def pieces(stream: Stream, rounds: int) -> Iterator[Row]:
    """Decode a stream as it comes from a port, 4 KiB at a time."""
    raw, decoder = stream.raw.tobytes(), stream.decoder
    parts = [raw[begin:end] for begin, end in pairwise([*range(0, len(raw), PIECE), len(raw)])]
    room = np.zeros(PIECE, canser.FRAME_DTYPE)

    def feed_pieces() -> None:
        feed_into = decoder.feed_into
        for part in parts:
            feed_into(part, room)

    _, _, ratio = paired(stream.feed, feed_pieces, rounds)
    whole_s, empty_s, _ = paired(
        stream.feed, lambda: [decoder.feed_into(b"", room) for _ in parts], rounds
    )
    note = f"a call without bytes takes {empty_s / len(parts) * 1e6:.2f} us, "
    note += f"4 KiB in one call {whole_s / len(parts) * 1e6:.2f} us"
    required = PIECES.get(stream.protocol, PIECES_OTHERS)
    yield Row("feed_into in 4 KiB pieces, over one call", stream.protocol, ratio, required, note)


def small_calls(stream: Stream, rounds: int) -> Iterator[Row]:
    """Decode 100 bytes into a new array: the time of the call."""
    small, protocol, decoder = stream.raw[:SMALL].tobytes(), stream.protocol, stream.decoder
    assert len(canser.decode(small, protocol)) >= len(canser.Decoder(protocol).feed(small)) > 0

    def repeat_feed() -> None:
        for _ in range(SMALL_CALLS):
            decoder.feed(small)

    def repeat_decode() -> None:
        for _ in range(SMALL_CALLS):
            canser.decode(small, protocol)

    feed_s, decode_s, _ = paired(repeat_feed, repeat_decode, rounds)
    note = ""
    if protocol == "serial":
        assert len(peers.struct_serial(small)) == len(canser.decode(small, protocol))
        loop_s, _, _ = paired(
            lambda: [peers.struct_serial(small) for _ in range(SMALL_CALLS)], repeat_feed, rounds
        )
        note = f"a Python loop with struct {loop_s / SMALL_CALLS * 1e6:.2f} us"
    feed_us, decode_us = feed_s / SMALL_CALLS * 1e6, decode_s / SMALL_CALLS * 1e6
    yield Row("feed of 100 bytes, us, at most", protocol, feed_us, 2, note)
    yield Row("decode of 100 bytes, us, at most", protocol, decode_us, 2.5)


def files(stream: Stream, size: int, folder: Path, rounds: int) -> Iterator[Row]:
    """Decode a file in the page cache, over the same bytes in memory."""
    protocol = stream.protocol
    raw = tiled(stream.raw, size - size % len(stream.raw) or len(stream.raw))
    path = folder / f"{protocol}.bin"
    raw.tofile(path)
    room = np.zeros(1 << 16, canser.FRAME_DTYPE)

    def from_file(threads: int) -> int:
        return sum(len(block) for block in canser.blocks(path, protocol, out=room, threads=threads))

    decoder = canser.Decoder(protocol)
    assert from_file(1) == len(raw) // len(stream.raw) * stream.count, "frames of the file are lost"
    _, file_s, ratio = paired(lambda: take(decoder, raw, room), lambda: from_file(1), rounds)
    note = f"{len(raw) / MIB:.0f} MiB, {len(raw) / file_s / 1e9:.2f} GB/s"
    yield Row("blocks of a file, over memory", protocol, ratio, 0.9, note)
    _, _, ratio = paired(
        lambda: canser.decode(raw, protocol), lambda: canser.read(path, protocol), rounds
    )
    yield Row("read of a file, over memory", protocol, ratio, 0.9, "both into a new array")

    def count_blocks(threads: int) -> int:
        return sum(len(block) for block in canser.blocks(path, protocol, threads=threads))

    assert count_blocks(1) == count_blocks(2)
    _, _, ratio = paired(lambda: count_blocks(1), lambda: count_blocks(2), rounds)
    yield Row("2 threads over 1, blocks of a file", protocol, ratio, 1.7)
    path.unlink()


def recorded(protocol: str, size: int, folder: Path, rounds: int) -> Iterator[Row]:
    """Read recordings, over a file of the same bytes alone; frames get host times by it."""
    frames, raw = recording_files.busy(size // 16, protocol)
    bare = folder / f"{protocol}.bin"
    bare.write_bytes(raw)
    room = np.zeros(1 << 16, canser.FRAME_DTYPE)

    def count(path: Path) -> int:
        return sum(len(block) for block in canser.blocks(path, protocol, out=room))

    for name, piece in (("small", recording_files.SMALL), ("full", recording_files.LARGE)):
        path = folder / f"{name}.pcapng"
        recording_files.record(path, protocol, raw, piece)
        assert count(path) == count(bare) == len(frames), "frames of the recording are lost"
        _, seconds, ratio = paired(lambda: count(bare), lambda: count(path), rounds)  # noqa: B023
        required = (RECORDED_SMALL if name == "small" else RECORDED_FULL).get(protocol)
        note = f"{seconds / len(frames) * 1e9:.1f} ns a frame, "
        note += f"{len(raw) / seconds / 1e9:.2f} GB/s of the line"
        yield Row(f"a recording in {name} blocks, over raw", protocol, ratio, required, note)
        path.unlink()
    bare.unlink()


def threads(stream: Stream, rounds: int) -> Iterator[Row]:
    """Compare two threads with one, into one array."""
    protocol, out = stream.protocol, stream.out

    def decode(raw: Bytes, count: int) -> FrameArray:
        return canser.decode(raw, protocol, out=out, threads=count)

    assert np.array_equal(decode(stream.raw, 1).copy(), decode(stream.raw, 2))
    _, _, ratio = paired(lambda: decode(stream.raw, 1), lambda: decode(stream.raw, 2), rounds)
    yield Row("2 threads over 1, into one array", protocol, ratio, 1.5)
    if protocol == "cantalope":
        # A chain that starts anywhere else never meets the true one.
        never = np.full(len(stream.raw), 8, np.uint8)
        assert np.array_equal(decode(never, 1).copy(), decode(never, 2))
        _, _, ratio = paired(lambda: decode(never, 1), lambda: decode(never, 2), rounds)
        yield Row("2 threads over 1, where no guess holds", protocol, ratio, 0.9)


def convert(stream: Stream, size: int, folder: Path, rounds: int) -> Iterator[Row]:
    """Convert, a whole process, over `cp` of the bytes it reads and of those it writes."""
    protocol = stream.protocol
    source, made = folder / "run.bin", folder / "run.npy"
    tiled(stream.raw, size - size % len(stream.raw) or len(stream.raw)).tofile(source)
    command = [sys.executable, "-m", "canser", "convert", "-p", protocol, source, made, "--force"]

    def run() -> None:
        made.unlink(missing_ok=True)
        subprocess.run([str(x) for x in command], check=True, capture_output=True)

    def copy() -> None:
        for path in (source, reference):
            target = folder / "copy"
            target.unlink(missing_ok=True)
            subprocess.run(["cp", path, target], check=True)
            target.unlink()

    run()
    reference = folder / "reference.npy"
    shutil.copy(made, reference)
    copy_s, run_s, ratio = paired(copy, run, rounds)
    note = f"{source.stat().st_size / MIB:.0f} MiB in, {made.stat().st_size / MIB:.0f} MiB out, "
    yield Row(
        "convert to .npy, over cp", protocol, ratio, 0.7, f"{note}{run_s:.2f} s, cp {copy_s:.2f} s"
    )


def memory_rows(protocol: str, size: int) -> Iterator[Row]:
    """Tell what decoding takes besides the arrays it fills."""
    kept, peak = memory.feed_bytes(protocol)
    note = f"bytes a call; {peak} at once, gone at its end"
    yield Row("feed_into keeps, at most", protocol, kept, 0, note)
    grown = memory.blocks_bytes(protocol, size) / MIB
    yield Row("blocks takes besides out, MiB, at most", protocol, grown, 64)


def rows(count: int, size: int, rounds: int, folder: Path) -> Iterator[Row]:
    yield from counted()
    for protocol in canser.protocols():
        stream = Stream("mixed", protocol, count)
        yield from against_memory(stream, rounds)
        yield from against_memory(Stream("periodic", protocol, count), rounds)
        yield from new_arrays(stream, rounds)
        if protocol == ONE:
            yield from whole_records(stream, rounds)
        yield from against_peers(stream, rounds)
        yield from noise(stream, rounds)
        yield from pieces(stream, rounds)
        yield from small_calls(stream, rounds)
        yield from threads(stream, rounds)
        yield from files(stream, size, folder, max(rounds // 3, 1))
        yield from recorded(protocol, size // 32, folder, rounds)
        if protocol == ONE:
            yield from convert(stream, size, folder, max(rounds // 4, 1))
        yield from memory_rows(protocol, size // 2)
    for number in bus_numbers.rows(count, max(rounds // 2, 1), folder):
        yield Row(*number)
    for number in signal_numbers.rows(max(rounds // 2, 1), folder, max(count // 4, 50_000)):
        yield Row(*number)
    for number in resampling.rows(max(rounds // 2, 1)):
        yield Row(*number)
    for row in log_files.rows(max(rounds // 4, 1), folder, max(count // 4, 50_000)):
        yield Row(*row)


def verdict(row: Row) -> str:
    """Say whether a figure is what it must be."""
    if row.required is None:
        return ""
    at_most = "at most" in row.what
    return (
        "" if (row.reached <= row.required) == at_most or row.reached == row.required else "below"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=4_000_000, help="frames of a set")
    parser.add_argument("--rounds", type=int, default=11, help="rounds of each pair")
    parser.add_argument("--mib", type=int, default=1024, help="MiB of the files")
    args = parser.parse_args()
    print(machine())
    print(f"{args.frames:,} frames a set, {args.rounds} rounds, files of {args.mib} MiB\n")
    print(f"{'what':44} {'protocol':10} {'reached':>8} {'required':>8}")
    with tempfile.TemporaryDirectory() as folder:
        for row in rows(args.frames, args.mib * MIB, args.rounds, Path(folder)):
            required = "" if row.required is None else f"{row.required:.3g}"
            print(
                f"{row.what:44} {row.protocol:10} {row.reached:8.3g} {required:>8} "
                f"{verdict(row):5}  {row.note}".rstrip(),
                flush=True,
            )


if __name__ == "__main__":
    main()
