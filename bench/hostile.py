"""Streams that make a decoder work for nothing: noise, and bytes chosen against it."""

import numpy as np
import numpy.typing as npt

import canser
import data

Bytes = npt.NDArray[np.uint8]

# So many bytes are made at random; a longer stream repeats them. No cache that a
# decoder could profit from holds as many.
PATTERN = 1 << 22

# Every byte that means something in `seeed` or `serial`: marks and data length codes.
MARKS = np.array([0xAA, 0xBB, 0x55, *range(9)], np.uint8)

# Bytes chosen against one protocol, where there are worse ones than those against all: the
# patterns of a stream follow in any order.
PATTERNS: dict[str, dict[str, list[str]]] = {
    "cantalope": {
        # No byte is safe: the shortest frame, and a byte with which none starts.
        "shortest frames or one byte": ["01 00", "09"],
    },
    "seeed": {
        # At every other byte a packet of 20 bytes whose sum, the last byte, is wrong.
        "near-packets": ["AA 55"],
        # A packet whose sum holds, but whose third byte is out of range.
        "near-packets with a sum": [
            "AA 55 01 03 01 23 01 00 00 08 11 22 33 44 55 66 77 88 00 95",
        ],
        # At every other byte a frame whose id or end mark is wrong.
        "starts": ["AA E8 AA 55 55"],
        "shortest frames or one byte": ["AA C0 23 01 55", "01"],
    },
    "serial": {
        # Five candidates in a row, and five bytes that are a dlc to each.
        "starts": ["AA AA AA AA AA 08 08 08 08 08"],
        # ... and five end marks, all at the wrong place but the first one's.
        "starts and ends": ["AA AA AA AA AA 08 08 08 08 40 BB BB BB BB BB"],
        "shortest frames or one byte": ["AA 00 00 00 00 00 01 00 00 00 BB", "01"],
    },
}


def tiled(pattern: Bytes, size: int) -> Bytes:
    """Return `size` bytes of a pattern, again and again."""
    return np.resize(pattern, size)


def noisy(raw: Bytes, rate: float, seed: int) -> Bytes:
    """Return a copy with a share of the bytes, `rate`, replaced by other ones."""
    rng = np.random.default_rng(seed)
    copy = raw.copy()
    bad = rng.choice(len(copy), round(len(copy) * rate), replace=False)
    copy[bad] ^= rng.integers(1, 256, len(bad), dtype=np.uint8)
    return copy


def hostile(protocol: str, size: int) -> dict[str, Bytes]:
    """Return hostile streams of `size` bytes by their names, the same in every run."""
    rng = np.random.default_rng(5)
    length = min(size, PATTERN)
    streams = {
        "all AA": np.full(length, 0xAA, np.uint8),
        "random of AA BB 55 0..8": rng.choice(MARKS, length),
        "near-frames": near_frames(protocol, length, rng),
        "random bytes": rng.integers(0, 256, length, dtype=np.uint8),
    }
    for name, patterns in PATTERNS.get(protocol, {}).items():
        units = [np.frombuffer(bytes.fromhex(pattern), np.uint8) for pattern in patterns]
        if len(units) > 1:
            order = rng.integers(0, len(units), length)
            units = [np.concatenate([units[index] for index in order])]
        streams[name] = tiled(units[0], length)
    return {name: tiled(stream, size) for name, stream in streams.items()}


def near_frames(protocol: str, length: int, rng: np.random.Generator) -> Bytes:
    """Return candidates of which each is rejected as late as can be."""
    if protocol == "cantalope":
        # Its frames have no mark that could be wrong. In any order: bytes that no frame
        # starts with, their low half over 8; and an unknown command, whose last
        # two bytes start a frame.
        units = rng.integers(0, 16, (-(-length // 5), 5)) << 4 | rng.integers(9, 16, 5)
        units[rng.random(len(units)) < 0.5] = [0xFF, 0xFF, 0x02, 0x00, 0x00]
        return units.astype(np.uint8).ravel()[:length]
    # Good frames, but for the last byte of each, which is the end mark where there is one.
    frames = data.mixed(-(-length // 5), protocol)
    raw = np.frombuffer(canser.encode(frames, protocol), np.uint8).copy()
    offsets = np.empty(len(frames) + 1, np.int64)
    found = canser.decode(raw, protocol, offsets=offsets)
    assert len(found) == len(frames), "decoding is wrong"
    raw[offsets[1 : len(frames)] - 1] = 0
    return raw[:length]
