"""Print what bounds decoding: the times of its parts, in nanoseconds a frame.

The chain: where a frame ends, and so where the next one starts, is known when its length
byte is loaded and added. However much else is done beside, a frame takes at least that.
The memory: L, in which numpy copies the input and fills the records. What is above both
is the work of the processor on each frame.
"""

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import canser
import data
from measure import copy_and_fill, machine, seconds

HERE = Path(__file__).parent
CORE = HERE.parent / "csrc"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=4_000_000, help="frames of a set")
    args = parser.parse_args()
    compiler = shlex.split(os.environ.get("CC") or "cc")
    print(f"{machine()}\n\nns a frame; pieces are of 4 KiB, fed in C\n")
    print(
        f"{'protocol':10} {'chain':>6} {'from cache':>11} {'from memory':>12} {'in pieces':>10} "
        f"{'L':>6}   a cycle of the processor"
    )
    with tempfile.TemporaryDirectory() as folder:
        program, stream = Path(folder) / "limits", Path(folder) / "stream"
        sources = [*sorted(CORE.rglob("*.c")), HERE / "limits.c"]
        command = [*compiler, "-O3", "-std=c11", f"-I{CORE}", *map(str, sources)]
        if subprocess.run([*command, "-o", str(program)], check=False).returncode:
            sys.exit("limits.c does not compile")
        for protocol in canser.protocols():
            frames = data.mixed(args.frames, protocol)
            raw = np.frombuffer(canser.encode(frames, protocol), np.uint8)
            raw.tofile(stream)
            run = subprocess.run([program, protocol, stream], capture_output=True, check=True)
            walk, cached, whole, pieces, cycle = map(float, run.stdout.split())
            copy, records = np.empty_like(raw), np.empty_like(frames).view(np.uint64)
            limit = min(seconds(lambda: copy_and_fill(raw, copy, records)) for _ in range(15))  # noqa: B023
            print(
                f"{protocol:10} {walk:6.2f} {cached:11.2f} {whole:12.2f} {pieces:10.2f} "
                f"{limit / args.frames * 1e9:6.2f}   {cycle:.2f}"
            )


if __name__ == "__main__":
    main()
