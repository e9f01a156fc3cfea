"""Print time and peak memory of reading large log files, beside python-can.

Each format is a file of --mib MiB, read by `blocks` in a process of its own; python-can reads a
file of --peer-mib MiB, as it takes minutes for a large one. Memory is that of the whole process.
"""

import argparse
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import canser
from canser._frames import FrameArray
from canser.files.formats import find_format
from log_files import traffic
from measure import machine

FORMATS = ("candump", "csv", "gvret", "asc", "trc", "blf")
MIB = 1 << 20

OURS = """
import canser
count = sum(map(len, canser.blocks({path!r})))
"""
PEERS = """
import can
count = sum(1 for _ in can.LogReader({path!r}))
"""
RUN = """
import resource, time
start = time.perf_counter()
{code}
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(count, time.perf_counter() - start, peak)
"""


def blocks(part: FrameArray, count: int) -> Iterator[FrameArray]:
    """Yield the same frames `count` times, each time later."""
    span = int(part["ts"][-1] - part["ts"][0]) // 1000 * 1000 + 1000
    for _ in range(count):
        yield part
        part["ts"] += span


def make(name: str, folder: Path, size: int) -> Path:
    """Write a file of about this many bytes."""
    path = folder / f"run{find_format(name).suffixes[0]}"
    part = traffic(200_000)
    canser.write(part, path, force=True)
    count = max(size // path.stat().st_size, 1)
    canser.write(blocks(part, count), path, force=True)
    return path


def measured(code: str, path: Path) -> tuple[int, float, float]:
    """Return frames, seconds and MiB of a process that reads a file."""
    run = RUN.format(code=code.format(path=str(path)))
    done = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, check=True)
    count, seconds, peak = done.stdout.split()
    return int(count), float(seconds), float(peak)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mib", type=int, default=1024, help="MiB of a file for canser")
    parser.add_argument("--peer-mib", type=int, default=16, help="MiB of a file for python-can")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    print(machine(), "\n")
    print(
        "| format | MiB | frames | s | M frames/s | peak MiB | python-can, k frames/s | peak MiB |"
    )
    print("|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name in FORMATS:
            path = make(name, Path(folder), args.mib * MIB)
            size = path.stat().st_size / MIB
            count, seconds, peak = measured(OURS, path)
            peer = "- | -"
            if name != "gvret":
                path = make(name, Path(folder), args.peer_mib * MIB)
                peer_count, peer_seconds, peer_peak = measured(PEERS, path)
                peer = f"{peer_count / peer_seconds / 1e3:.0f} | {peer_peak:.0f}"
            path.unlink()
            print(
                f"| {name} | {size:.0f} | {count:,} | {seconds:.1f} "
                f"| {count / seconds / 1e6:.1f} | {peak:.0f} | {peer} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
