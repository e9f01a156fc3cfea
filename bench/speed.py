"""Print the speed of decoding and encoding as ratios to L, the speed of the memory.

L of decoding: numpy copies the input bytes and fills the output records. L of
encoding: numpy copies the input records and fills the output bytes. Both are warm
and preallocated, as is canser's output. The result is checked first; then rounds of
L and canser alternate, and the median of the rounds' ratios is printed.
"""

import argparse
import platform
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np

import canser
import data

SETS: dict[str, Callable[[int, str], canser.frames.FrameArray]] = {
    "mixed": data.mixed,
    "periodic": data.periodic,
}


def machine() -> str:
    """Name the CPU, its cores, the compiler and the versions."""
    cpu = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = cpuinfo.read_text().splitlines()
        cpu = next((x.split(":")[1].strip() for x in lines if x.startswith("model name")), cpu)
    try:
        run = subprocess.run(["cc", "--version"], capture_output=True, text=True, check=False)
        compiler = run.stdout.splitlines()[0]
    except (OSError, IndexError):
        compiler = "unknown compiler"
    return f"{cpu}; {compiler}; Python {platform.python_version()}, numpy {np.__version__}"


def paired(
    first: Callable[[], object], second: Callable[[], object], rounds: int
) -> tuple[float, float, float]:
    """Time two calls in turn; return the median time of each, and of the ratio first/second."""
    times: list[tuple[float, float]] = []
    for _ in range(rounds + 1):
        start = time.perf_counter()
        first()
        middle = time.perf_counter()
        second()
        times.append((middle - start, time.perf_counter() - middle))
    times = times[1:]  # the first round warms up
    return (
        median(a for a, _ in times),
        median(b for _, b in times),
        median(a / b for a, b in times),
    )


def copy_and_fill(source: np.ndarray, copy: np.ndarray, target: np.ndarray) -> None:
    """Do the work of L."""
    np.copyto(copy, source)
    target.fill(0)


def measure(name: str, protocol: str, count: int, rounds: int) -> None:
    """Check, measure and print one set of frames in one protocol."""
    frames = SETS[name](count, protocol)
    raw = np.frombuffer(canser.encode(frames, protocol), np.uint8)
    out = np.empty(count + 1, canser.FRAME_DTYPE)
    room = np.empty(count * 20, np.uint8)

    expected = frames.copy()
    if protocol != "serial":
        expected["ts"] = canser.NO_TIME
    expected["data"][expected["rtr"]] = 0
    assert np.array_equal(canser.decode(raw, protocol, out=out), expected), "decoding is wrong"
    assert np.array_equal(canser.encode(frames, protocol, out=room), raw), "encoding is wrong"

    decoder = canser.Decoder(protocol)
    raw_copy, records = np.empty_like(raw), out[:count].view(np.uint64)
    frames_copy, target = np.empty_like(frames), room[: len(raw)]
    works: list[tuple[str, Callable[[], object], Callable[[], object]]] = [
        (
            "decode",
            lambda: copy_and_fill(raw, raw_copy, records),
            lambda: decoder.feed_into(raw, out),
        ),
        (
            "encode",
            lambda: copy_and_fill(frames.view(np.uint64), frames_copy.view(np.uint64), target),
            lambda: canser.encode(frames, protocol, out=room),
        ),
    ]
    for work, limit, ours in works:
        limit_s, ours_s, ratio = paired(limit, ours, rounds)
        print(
            f"{work:7} {protocol:10} {name:9} {limit_s * 1e3:7.2f} ms {ours_s * 1e3:7.2f} ms "
            f"{ratio:6.2f} {count / ours_s / 1e6:9.0f} {len(raw) / ours_s / 1e9:7.2f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=4_000_000, help="frames of a set")
    parser.add_argument("--rounds", type=int, default=15, help="rounds of each pair")
    args = parser.parse_args()
    print(machine())
    print(f"{args.frames:,} frames a set, median of {args.rounds} interleaved rounds, one thread\n")
    print(
        f"{'work':7} {'protocol':10} {'traffic':9} {'L':>10} {'canser':>10} {'ratio':>6} "
        f"{'Mframes/s':>9} {'GB/s':>7}"
    )
    for name in SETS:
        for protocol in canser.protocols():
            measure(name, protocol, args.frames, args.rounds)


if __name__ == "__main__":
    main()
