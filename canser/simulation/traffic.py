"""Simulated bus traffic, and the damage that a bad line does to its bytes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canser._core.buffers import as_bytes
from canser._frames import FRAME_DTYPE, FrameArray, concat

__all__ = ["Damaged", "damage", "line_noise", "vehicle"]

_MS = 1_000_000  # nanoseconds

# Pairs of a period in ms and the number of ids, of 64, that are sent at this period. The spread
# is an assumption, after a car: a few fast frames of the drive train, and slower ones.
_PERIODS = ((10, 8), (20, 12), (50, 12), (100, 16), (200, 6), (500, 6), (1000, 4))


def vehicle(seconds: float, *, seed: int = 1, extended: bool = True) -> FrameArray:
    """Make the traffic of a vehicle's bus: 64 ids, each with its period.

    Parameters
    ----------
    seconds : float
        Length of the traffic.
    seed : int, default 1
        Seed of the random numbers. The same arguments give the same frames.
    extended : bool, default True
        Whether a quarter of the ids is extended; otherwise all are standard.

    Returns
    -------
    numpy.ndarray
        Frames in the order of their times, FRAME_DTYPE, shape (n,), about 2,000 a second. `ts` is
        in nanoseconds from 0, in whole milliseconds.

    Notes
    -----
    All frames of an id have the same dlc, for most ids 8. The last byte is a counter, bytes 0 to
    3 are two slow signals, the bytes between are constant. Every two seconds a tester sends a
    remote frame.

    Examples
    --------
    >>> from canser.simulation.traffic import vehicle
    >>> frames = vehicle(1.0)
    >>> len(set(frames["id"].tolist()))
    64
    """
    rng = np.random.default_rng(seed)
    periods = np.repeat([p for p, _ in _PERIODS], [n for _, n in _PERIODS]) * _MS
    ids = np.sort(rng.choice(np.arange(0x080, 0x700), len(periods), replace=False))
    span = int(seconds * 1e9)
    streams = []
    for number, (arbitration_id, period) in enumerate(zip(ids, periods, strict=True)):
        start = int(rng.integers(period))
        due = np.arange(start, span, period, dtype=np.int64)
        frames = np.zeros(len(due), FRAME_DTYPE)
        frames["id"] = arbitration_id
        if extended and number % 4 == 3:  # an id in the form of SAE J1939
            frames["id"] = 0x18F00000 | int(arbitration_id) << 8 | number
            frames["ext"] = True
        # Arbitration and the control unit's own loop delay a frame, by up to 2 ms.
        frames["ts"] = due + rng.integers(0, 2 * _MS, len(due))
        dlc = 8 if rng.random() < 0.7 else int(rng.integers(1, 8))
        frames["dlc"] = dlc
        frames["data"] = _payload(rng, frames["ts"], dlc)
        streams.append(frames)
    remote = np.zeros(int(seconds / 2), FRAME_DTYPE)  # from a tester, every two seconds
    remote["id"], remote["rtr"], remote["dlc"] = 0x7E0, True, 2
    remote["ts"] = np.arange(len(remote), dtype=np.int64) * 2_000 * _MS + 700 * _MS
    frames = concat([*streams, remote])
    frames["ts"] -= frames["ts"] % _MS
    return frames.take(np.argsort(frames["ts"], kind="stable"))


def _payload(
    rng: np.random.Generator, ts: npt.NDArray[np.int64], dlc: int
) -> npt.NDArray[np.uint8]:
    """Make the payloads of one id: two signals, constants, a counter."""
    data = np.zeros((len(ts), 8), np.uint8)
    data[:] = rng.integers(0, 256, 8)
    for byte in (0, 2):  # two signals of 16 bits, low byte first
        turn = 2 * np.pi * ts / 1e9 / rng.uniform(3, 30) + rng.uniform(0, 2 * np.pi)
        signal = (20_000 + 15_000 * np.sin(turn) + rng.normal(0, 20, len(ts))).astype("<u2")
        data[:, byte : byte + 2] = signal.view(np.uint8).reshape(-1, 2)
    data[:, dlc - 1] = np.arange(len(ts)) % 16
    data[:, dlc:] = 0
    return data


def line_noise(data: bytes | npt.NDArray[np.uint8], *, rate: float = 1e-3, seed: int = 1) -> bytes:
    """Return bytes as they come out of a bad line.

    Parameters
    ----------
    data : bytes-like
        The bytes that go in.
    rate : float, default 0.001
        Share of the bytes, 0 to 1, that is hit: of these a third is lost, a third gets a random
        byte in front, a third has one bit flipped.
    seed : int, default 1
        Seed of the random numbers. The same arguments give the same bytes.

    Returns
    -------
    bytes
        The bytes that come out.

    Raises
    ------
    ValueError
        For a `rate` out of range.

    Examples
    --------
    >>> from canser.simulation.traffic import line_noise
    >>> line_noise(b"canser") == b"canser"
    True
    """
    return damage(data, noise=rate, seed=seed).data


@dataclass(frozen=True, slots=True)
class Damaged:
    """Bytes after a bad line, and the offsets of the clean bytes that were hit; made by `damage`.

    The offsets are ascending arrays, int64, shape (n,).
    """

    #: The bytes that come out of the line.
    data: bytes
    #: Offsets of the clean bytes that are lost.
    lost: npt.NDArray[np.int64]
    #: Offsets of the clean bytes that have a random byte in front of them.
    inserted: npt.NDArray[np.int64]
    #: Offsets of the clean bytes of which one bit is flipped.
    flipped: npt.NDArray[np.int64]


def damage(
    data: bytes | npt.NDArray[np.uint8],
    *,
    noise: float = 0,
    loss: float = 0,
    seed: int | Sequence[int] = 1,
) -> Damaged:
    """Damage bytes as a bad line does, and return where.

    Parameters
    ----------
    data : bytes-like
        The clean bytes.
    noise : float, default 0
        Share of the bytes, 0 to 1, that is hit, as the rate of `line_noise`.
    loss : float, default 0
        Share of the bytes, 0 to 1, that is lost besides in runs of 1 to 63 bytes, as a buffer
        loses bytes when it overflows.
    seed : int or sequence of int, default 1
        Seed of the random numbers. The same arguments give the same bytes, and the same noise
        with any loss.

    Returns
    -------
    Damaged
        The damaged bytes, and the offsets of the clean bytes that were hit.

    Raises
    ------
    ValueError
        For a share out of range.

    Examples
    --------
    >>> from canser.simulation.traffic import damage
    >>> damage(bytes(1000), noise=0.1).inserted.dtype
    dtype('int64')
    """
    for name, share in (("noise", noise), ("loss", loss)):
        if not 0 <= share <= 1:
            raise ValueError(f"{name} is {share}; it must be a share of the bytes, from 0 to 1")
    rng = np.random.default_rng(seed)
    clean = as_bytes(data)
    hits = np.flatnonzero(rng.random(len(clean)) < noise)
    kinds = rng.integers(0, 3, len(hits))
    noisy = clean.copy()
    flipped = hits[kinds == 2]
    noisy[flipped] ^= np.left_shift(1, rng.integers(0, 8, len(flipped))).astype(np.uint8)
    inserted = hits[kinds == 1]
    spurious = rng.integers(0, 256, len(inserted), dtype=np.uint8)
    kept = np.ones(len(clean), np.bool_)
    kept[hits[kinds == 0]] = False
    if loss:
        kept &= ~_runs(rng, len(clean), loss)
    # A lost byte is not counted as flipped, and has no byte in front of it.
    flipped = flipped[kept[flipped]]
    spurious, inserted = spurious[kept[inserted]], inserted[kept[inserted]]
    # Offsets in the kept bytes.
    before: npt.NDArray[np.int64] = np.cumsum(kept) - kept
    hit = np.insert(noisy[kept], before[inserted], spurious).tobytes()
    return Damaged(hit, np.flatnonzero(~kept), inserted, flipped)


def _runs(rng: np.random.Generator, length: int, share: float) -> npt.NDArray[np.bool_]:
    """Mark bytes in runs of 1 to 63, 32 on average, that cover a share of all bytes."""
    # Runs may overlap. With s starts per byte, the share of bytes in no run is exp(-32 s).
    starts = -math.log1p(-share) / 32 if share < 1 else 1.0
    first = np.flatnonzero(rng.random(length) < starts)
    edges = np.zeros(length + 1, np.int64)
    np.add.at(edges, first, 1)
    np.add.at(edges, np.minimum(first + rng.integers(1, 64, len(first)), length), -1)
    return np.cumsum(edges[:-1]) > 0
