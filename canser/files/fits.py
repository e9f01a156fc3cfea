"""Rank the protocols by how many of some bytes each explains beyond chance."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from canser._core.buffers import BytesLike, as_bytes
from canser._frames import FRAME_DTYPE, FrameArray
from canser._protocols import protocols
from canser.codec.decoder import Decoder, Stats

__all__ = ["Fit", "identify"]

# The sample of longer data: this many slices of this many bytes, evenly spread.
_SLICES: Final = 16
_SLICE_LEN: Final = 1 << 14

# A result counts as luck if at least 1 in 20 shuffles is explained as well.
_LUCK_MOST: Final = 0.05

# Shuffles of the sample: more than 20, as 1 in 20 is the limit.
_SHUFFLES: Final = 24

# Frames that are decoded at a time: 96 KiB of records, which fit a cache.
_ROOM: Final = 4096

# Scores that differ by less do not separate two protocols. Then the protocol wins that explains
# fewer of the shuffled bytes. Otherwise a quiet bus, which repeats the same few bytes, could be
# taken for `cantalope`, in which nearly any bytes are a frame.
_CLOSE: Final = 0.05


@dataclass(frozen=True, slots=True)
class Fit:
    """How well one protocol explains some bytes, and the evidence; returned by `identify`.

    The evidence is a comparison with the same bytes in random order. Shuffling keeps how often
    each value occurs, and destroys the order, which is what a protocol defines. What a protocol
    explains of the shuffled bytes is chance.
    """

    #: Name of the protocol, as in `protocols()`.
    protocol: str
    #: Share of the bytes explained beyond chance, `(explained - chance) / (1 - chance)`, but not
    #: below 0: 1 is all, 0 is no more than chance.
    score: float
    #: Share of the bytes that lie inside frames and control packets, 0 to 1.
    explained: float
    #: The same share in the shuffled bytes, 0 to 1: the mean of 24 shuffles.
    chance: float
    #: Share of the shuffles of which the protocol explains as much as of the bytes, 0 to 1.
    luck: float
    #: Counters of the decoder for the bytes that were examined.
    stats: Stats

    @property
    def fits(self) -> bool:
        """Whether the bytes are of this protocol: `score` over 0.5, and `luck` below 0.05."""
        return self.score > 0.5 and self.luck < _LUCK_MOST


def identify(data: BytesLike) -> list[Fit]:
    """Rank all protocols by how much of the bytes each explains beyond chance.

    Parameters
    ----------
    data : bytes-like
        Any contiguous buffer of bytes. Of more than 256 KiB a sample of 256 KiB is examined:
        16 slices, evenly spread.

    Returns
    -------
    list of Fit
        One for each protocol, the best first. `Fit.fits` says whether the best is good enough:
        noise and text fit no protocol. Among protocols that fit about equally well, the one that
        explains least of random bytes is first. The same bytes give the same result.

    Raises
    ------
    TypeError
        `data` is no buffer of single bytes.
    BufferError
        `data` is not contiguous.

    Notes
    -----
    The share of explained bytes alone says little: in `cantalope` nearly nine of ten random
    bytes lie inside a frame, in `seeed` nearly none. The score therefore counts only what is
    explained beyond chance.

    Examples
    --------
    >>> frames = canser.frames("123#01", "456#0203")
    >>> best = canser.identify(canser.encode(frames, "seeed") * 20)[0]
    >>> best.protocol, best.fits
    ('seeed', True)
    """
    sample = _sample(as_bytes(data)).copy()  # numpy does not shuffle a read-only array
    rng = np.random.default_rng(0)
    shuffles = [rng.permutation(sample) for _ in range(_SHUFFLES)]
    fits = [_fit(protocol, sample, shuffles) for protocol in protocols()]
    ranked = sorted(fits, key=lambda fit: (-fit.score, -fit.explained, fit.protocol))
    close = [fit for fit in ranked if fit.fits and fit.score >= ranked[0].score - _CLOSE]
    if close:
        winner = min(close, key=lambda fit: fit.chance)
        ranked.remove(winner)
        ranked.insert(0, winner)
    return ranked


def _sample(data: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    if len(data) <= _SLICES * _SLICE_LEN:
        return data
    starts = np.linspace(0, len(data) - _SLICE_LEN, _SLICES).astype(np.int64)
    return np.concatenate([data[start : start + _SLICE_LEN] for start in starts])


def _fit(
    protocol: str, sample: npt.NDArray[np.uint8], shuffles: list[npt.NDArray[np.uint8]]
) -> Fit:
    decoder, room = Decoder(protocol), np.empty(_ROOM, FRAME_DTYPE)
    explained = _explain(decoder, sample, room)
    stats = decoder.stats
    by_chance = [_explain(decoder, shuffled, room) for shuffled in shuffles]
    chance = sum(by_chance) / len(by_chance)
    beyond = (explained - chance) / (1 - chance) if chance < 1 else 0.0
    return Fit(
        protocol=protocol,
        score=max(beyond, 0.0),
        explained=explained,
        chance=chance,
        luck=sum(share >= explained for share in by_chance) / len(by_chance),
        stats=stats,
    )


def _explain(decoder: Decoder, data: npt.NDArray[np.uint8], room: FrameArray) -> float:
    """Reset the decoder; return the share of the bytes that lie inside packets."""
    decoder.reset()
    done = 0
    while done < len(data):
        used, _ = decoder.feed_into(data[done:], room)
        done += used
    while decoder.pending:
        decoder.flush_into(room)
    return 1 - decoder.skipped / len(data) if len(data) else 0.0
