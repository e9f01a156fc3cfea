"""Which protocol are these bytes? Ranked by how much each explains beyond chance."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from canser._core.buffers import BytesLike, as_bytes
from canser._frames import FRAME_DTYPE, FrameArray
from canser._protocols import protocols
from canser.codec.decoder import Decoder, Stats

__all__ = ["Fit", "identify"]

# Of longer data this many slices of this many bytes are looked at, evenly spread.
_SLICES: Final = 16
_SLICE: Final = 1 << 14

# Enough that one in twenty is told from none.
_SHUFFLES: Final = 24

# Frames that are decoded at a time: as many as fit a cache.
_ROOM: Final = 4096

# Two scores this close do not tell two protocols apart. Then the one wins of which shuffled bytes
# hold less: a quiet bus repeats the same few bytes, and those are frames of `cantalope`, too, as
# nearly any bytes are; that they are frames of a protocol with marks is no accident.
_CLOSE: Final = 0.05


@dataclass(frozen=True, slots=True)
class Fit:
    """How well one protocol explains some bytes, and the evidence.

    The same bytes in random order keep how often each value comes, and lose what a
    protocol is: their order. So what a protocol finds there is chance.
    """

    protocol: str
    score: float  # share of the bytes explained beyond chance: 1 all, 0 no more than chance
    explained: float  # share of the bytes inside frames and control packets
    chance: float  # the same in the shuffled bytes, mean of 24 shuffles
    luck: float  # share of the shuffles that explain as much as the bytes themselves
    stats: Stats  # of the bytes looked at

    @property
    def fits(self) -> bool:
        """Whether these bytes are this protocol: over half explained, and not by luck."""
        return self.score > 0.5 and self.luck < 0.05


def identify(data: BytesLike) -> list[Fit]:
    """Rank all protocols by how much of the bytes each explains beyond chance.

    `data`: any contiguous buffer of bytes. Returns one `Fit` for each protocol, the
    best first; whether the best is good enough its `fits` tells: noise and text fit
    nothing. Of protocols that fit about equally well the one that is rarer in random bytes
    comes first. Looks at 256 KiB at most, in slices from all over; the same bytes give
    the same answer. Errors as for `Decoder.feed`.

    Needed because a share alone says little: in `cantalope` nearly nine of ten
    random bytes lie inside some frame, in `seeed` nearly none.
    """
    sample = _sample(as_bytes(data)).copy()  # numpy will not shuffle what is read-only
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
    if len(data) <= _SLICES * _SLICE:
        return data
    starts = np.linspace(0, len(data) - _SLICE, _SLICES).astype(np.int64)
    return np.concatenate([data[start : start + _SLICE] for start in starts])


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
    """Return the share of some bytes that lies inside packets; the decoder starts anew."""
    decoder.reset()
    done = 0
    while done < len(data):
        used, _ = decoder.feed_into(data[done:], room)
        done += used
    while decoder.pending:
        decoder.flush_into(room)
    return 1 - decoder.skipped / len(data) if len(data) else 0.0
