"""What the benchmarks work on: made here, the same in every run."""

import numpy as np

import canser
from canser._frames import FRAME_DTYPE, FrameArray
from canser.simulation.traffic import vehicle


def has_extended(protocol: str) -> bool:
    """Return whether a protocol carries extended frames."""
    frame = np.zeros(1, FRAME_DTYPE)
    frame["ext"] = True
    try:
        canser.encode(frame, protocol)
    except ValueError:
        return False
    return True


def mixed(count: int, protocol: str) -> FrameArray:
    """Return traffic without any order: 70 % dlc 8, the rest 0 to 7, 30 % extended ids."""
    rng = np.random.default_rng(4)
    frames = np.zeros(count, FRAME_DTYPE)
    frames["dlc"] = np.where(rng.random(count) < 0.7, 8, rng.integers(0, 8, count))
    frames["ext"] = (rng.random(count) < 0.3) & has_extended(protocol)
    wide = rng.integers(0, 1 << 29, count, dtype=np.uint32)
    frames["id"] = np.where(frames["ext"], wide, wide & 0x7FF)
    frames["data"] = rng.integers(0, 256, (count, 8), dtype=np.uint8)
    frames["data"][np.arange(8) >= frames["dlc"][:, None]] = 0
    frames["ts"] = np.cumsum(rng.integers(0, 3, count)) * 1_000_000
    return frames


def periodic(count: int, protocol: str) -> FrameArray:
    """Return traffic as on a real bus: 64 ids, each with its period and its dlc."""
    one = vehicle(60, extended=has_extended(protocol))
    rounds = -(-count // len(one))
    frames = np.tile(one, rounds)[:count]
    frames["ts"] += np.repeat(np.arange(rounds), len(one))[:count] * 60_000_000_000
    return frames
