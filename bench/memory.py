"""Print the memory that decoding takes besides the arrays it fills, and what it may take.

`feed_into` with an array that is used again: what Python has allocated after 1000 calls
and not freed; and the most that there was at once, the views and numbers of one call,
which are gone when it returns. `blocks` with such an array over a large file: by how
much the process grows at its peak, with the part of the file that is mapped.
"""

import argparse
import platform
import resource
import subprocess
import sys
import tempfile
import tracemalloc
from itertools import repeat
from pathlib import Path

import numpy as np

import canser
import data

CALLS = 1000
FRAMES = 1 << 16
MIB = 1 << 20

# What is required, in bytes.
KEPT, PEAK, GROWTH = 0, 4096, 64 * MIB


def stream(protocol: str) -> bytes:
    return canser.encode(data.mixed(FRAMES, protocol), protocol)


def feed_bytes(protocol: str, calls: int = CALLS) -> tuple[float, int]:
    """Return the bytes per call that `feed_into` leaves allocated, and the peak in bytes."""
    decoder = canser.Decoder(protocol)
    raw = stream(protocol)[:4096]
    out = np.zeros(FRAMES, canser.FRAME_DTYPE)
    for _ in range(3):
        decoder.feed_into(raw, out)
    rounds = repeat(None, calls)
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        for _ in rounds:
            decoder.feed_into(raw, out)
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    return (after - before) / calls, peak - before


def peak_rss() -> int:
    """Return the most bytes of memory that this process has had at once."""
    # On Linux, getrusage begins with the peak of the process that started this one:
    # growth that stays below that would not show.
    status = Path("/proc/self/status")
    if status.exists():
        lines = status.read_text(encoding="ascii").splitlines()
        return next(int(x.split()[1]) << 10 for x in lines if x.startswith("VmHWM:"))
    unit = 1 if platform.system() == "Darwin" else 1 << 10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def grow_here(path: str, protocol: str) -> int:
    """Decode a file in blocks; return the bytes by which the peak of this process grows."""
    # The array is written and the code has run before: neither counts as growth.
    out = np.full(FRAMES, 0, canser.FRAME_DTYPE)
    canser.Decoder(protocol).feed_into(b"\0" * 100, out)
    before = peak_rss()
    frames = sum(len(block) for block in canser.blocks(path, protocol, out=out))
    assert frames, "decoding is wrong"
    return peak_rss() - before


def blocks_bytes(protocol: str, size: int) -> int:
    """Return the bytes by which a fresh process grows over a file of about `size` bytes."""
    raw = stream(protocol)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "capture.bin"
        with path.open("wb") as file:
            for _ in range(-(-size // len(raw))):
                file.write(raw)
        command = [sys.executable, __file__, "--child", str(path), protocol]
        return int(subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=512, metavar="MIB", help="size of the file")
    parser.add_argument("--child", nargs=2, metavar=("FILE", "PROTOCOL"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.child:
        print(grow_here(*args.child))
        return 0
    good = True
    print(f"{'what':38} {'protocol':10} {'reached':>11} {'required':>11}")
    for protocol in canser.protocols():
        kept, peak = feed_bytes(protocol)
        growth = blocks_bytes(protocol, args.size * MIB)
        rows = [
            ("feed_into: kept per call", kept, KEPT, 1, "B"),
            ("feed_into: peak, freed at its return", peak, PEAK, 1, "B"),
            (f"blocks: growth over {args.size} MiB", growth, GROWTH, MIB, "MiB"),
        ]
        for what, reached, required, unit, name in rows:
            good &= reached <= required
            print(
                f"{what:38} {protocol:10} {reached / unit:7.1f} {name:3} "
                f"{required / unit:7.0f} {name:3}"
            )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
