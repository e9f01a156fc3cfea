"""Rank the protocols by how many of some bytes each explains beyond chance."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from canser._core.buffers import BytesLike, as_bytes
from canser._core.table import find_protocol
from canser._frames import FRAME_DTYPE, FrameArray
from canser._protocols import protocols
from canser.codec.decoder import Decoder, Stats
from canser.codec.doubt import has_marks

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

# A protocol fits if it explains more than this share of the bytes, beyond chance.
_HALF: Final = 0.5

# Scores that differ by less do not separate two protocols. Then a protocol with marks wins: that
# bytes are frames of it is no accident. Otherwise a quiet bus, which repeats the same few bytes,
# could be taken for `cantalope`, in which nearly any bytes are a frame.
_CLOSE: Final = 0.05

# A protocol that explains this share of the bytes, and no less than the best one does, may be the
# right one, even if shuffled bytes are explained as well.
_ALL: Final = 0.99

# Frames of one length stay in step with any bus that repeats that many bytes, or a few times as
# many. Without marks this is an accident: it happens for `canet13` in one of ten such buses. The
# limit is a round of so many frames: in a longer one each of them would have to be an accident.
_ROUND_MOST: Final = 3

# A bus repeats itself if this share of the bytes is the same as a round before: in 13 bytes there
# may be two counters, and some noise.
_SAME: Final = 0.8


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
    #: Other protocols that the bytes may be of as well. If there are any, none fits.
    rivals: tuple[str, ...] = ()

    @property
    def fits(self) -> bool:
        """Whether the bytes are this protocol: `score` over 0.5, `luck` below 0.05, no rivals."""
        return self.score > _HALF and self.luck < _LUCK_MOST and not self.rivals


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
        noise and text fit no protocol. Among protocols that fit about equally well, one with
        marks is first. If none of them has marks, as may be on a quiet bus, they are each other's
        `rivals`, and none fits. The same bytes give the same result.

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
    marked = {fit.protocol for fit in fits if has_marks(fit.protocol)}
    return _rank(fits, marked, {fit.protocol for fit in fits if _repeats(sample, fit.protocol)})


def _repeats(sample: npt.NDArray[np.uint8], protocol: str) -> bool:
    """Return whether bytes repeat themselves by the one length of a protocol's frames."""
    row = find_protocol(protocol)
    if row.frame_min != row.frame_max:
        return False
    rounds = range(row.frame_min, _ROUND_MOST * row.frame_min + 1, row.frame_min)
    return any(
        len(sample) > length and float(np.mean(sample[length:] == sample[:-length])) > _SAME
        for length in rounds
    )


def _rank(fits: list[Fit], marked: set[str], repeated: set[str]) -> list[Fit]:
    """Return the fits, the best first, with rivals where others may be right as well.

    `marked`: the protocols whose packets have marks. A bus that repeats the same few bytes may
    give frames of any other protocol at each round, and of several. `repeated`: the protocols
    with one length of frames by which the bytes repeat themselves.
    """
    ranked = sorted(fits, key=lambda fit: (-fit.score, -fit.explained, fit.protocol))
    close = [fit for fit in ranked if fit.fits and fit.score >= ranked[0].score - _CLOSE]
    if not close:
        return ranked
    winner = min(close, key=lambda fit: (fit.protocol not in marked, fit.chance))
    if winner.protocol not in marked:
        winner = next((fit for fit in ranked if fit.fits and fit.protocol in marked), winner)
    others = [fit for fit in ranked if fit is not winner]
    rivals = []
    if winner.protocol not in marked:
        least = _HALF if winner.protocol in repeated else max(winner.explained, _ALL)
        rivals = [fit.protocol for fit in others if fit.fits or fit.explained >= least]
    if rivals:
        others = [replace(fit, rivals=(winner.protocol,)) if fit.fits else fit for fit in others]
    return [replace(winner, rivals=tuple(rivals)), *others]


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
