"""The lengths of frames on the bus, beside plain C that goes bit by bit, and the bus load.

Rows of `table.py`.
"""

import ctypes
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

import canser
import data
from canser._frames import FrameArray
from log_files import LogRow
from measure import paired

HERE = Path(__file__).parent
CORE = HERE.parent / "csrc"

# Frames of a set. Plain C takes half a second for them.
COUNT = 500_000

# Required over plain C.
REQUIRED = 5.0


def rows(rounds: int, folder: Path, count: int = COUNT) -> Iterator[LogRow]:
    """Yield all rows."""
    library = folder / "bus_bits.so"
    compiler = shlex.split(os.environ.get("CC") or "cc")
    command = [*compiler, "-O3", "-std=c11", "-shared", "-fPIC", f"-I{CORE}", HERE / "bus_bits.c"]
    if subprocess.run([*map(str, command), "-o", str(library)], check=False).returncode:
        sys.exit("bus_bits.c does not compile")
    plain_bits = ctypes.CDLL(str(library)).plain_bits
    plain_bits.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p]
    plain_bits.restype = None

    def plain(frames: FrameArray) -> npt.NDArray[np.uint8]:
        bits = np.empty(len(frames), np.uint8)
        plain_bits(frames.ctypes.data, len(frames), bits.ctypes.data)
        return bits

    for name, make in (("mixed", data.mixed), ("periodic", data.periodic)):
        frames = make(count, "cantalope")
        assert np.array_equal(plain(frames), canser.frame_bits(frames)), "lengths are wrong"
        plain_s, ours_s, ratio = paired(
            lambda: plain(frames),  # noqa: B023
            lambda: canser.frame_bits(frames),  # noqa: B023
            rounds,
        )
        note = f"{count / ours_s / 1e6:.1f} and {count / plain_s / 1e6:.2f} Mframes/s"
        yield LogRow(f"frame_bits over plain C, {name}", "", ratio, REQUIRED, note)
    loads = canser.bus_load(frames, 500_000)
    assert loads["bits"].sum() == canser.frame_bits(frames).sum(), "bits are lost"
    _, ours_s, ratio = paired(
        lambda: canser.frame_bits(frames), lambda: canser.bus_load(frames, 500_000), rounds
    )
    note = f"{count / ours_s / 1e6:.1f} Mframes/s"
    yield LogRow("bus_load over frame_bits, periodic", "", ratio, None, note)


def main() -> None:
    """Print the rows alone."""
    with tempfile.TemporaryDirectory() as folder:
        for row in rows(5, Path(folder)):
            required = "" if row.required is None else f"{row.required:.3g}"
            print(f"{row.what:40} {row.reached:8.3g} {required:>8}  {row.note}", flush=True)


if __name__ == "__main__":
    main()
