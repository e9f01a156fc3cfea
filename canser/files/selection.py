"""Which frames of a stream are wanted: by time, by filter, by number; and from when they count."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from canser._frames import NO_TIME, YEAR_2000_NS, FrameArray, copy_records, match
from canser.errors import FormatError

__all__ = ["Moment", "Selection"]


class Moment(NamedTuple):
    """A time in a stream."""

    ns: int
    #: Whether it counts from the first frame that has a time, and not from 1970.
    from_first: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Selection:
    """The frames that are wanted; all by default.

    Attributes
    ----------
    filters : tuple of str
        As `canser.match` takes them: frames that pass any of them.
    start, end : Moment or None
        Frames from `start` on, and before `end`. A frame without a time passes neither.
    count : int or None
        The first frames that pass the rest, so many at most.
    epoch_ns : int or None
        When the first frame came, in nanoseconds since 1970. All times are moved by as much.
    """

    filters: tuple[str, ...] = ()
    start: Moment | None = None
    end: Moment | None = None
    count: int | None = None
    epoch_ns: int | None = None

    @property
    def is_all(self) -> bool:
        """Whether all frames are wanted as they are."""
        return self == Selection()

    def apply(self, blocks: Iterable[FrameArray]) -> Iterator[FrameArray]:
        """Yield the frames that are wanted; FormatError for an epoch where times have one."""
        left, first_ns = self.count, None
        for block in blocks:
            frames, ts = block, block["ts"]
            if first_ns is None:
                timed = ts[ts != NO_TIME]
                first_ns = int(timed[0]) if len(timed) else None
            if self.epoch_ns is not None and first_ns is not None:
                if first_ns >= YEAR_2000_NS:
                    raise FormatError("times count from 1970 already; leave the epoch out")
                frames = copy_records(block)
                frames["ts"][ts != NO_TIME] += self.epoch_ns - first_ns
            wanted = match(frames, *self.filters)
            begin_ns = first_ns if self.epoch_ns is None else self.epoch_ns
            for moment, early in ((self.start, False), (self.end, True)):
                if moment is not None:
                    limit = moment.ns + ((begin_ns or 0) if moment.from_first else 0)
                    known = frames["ts"] != NO_TIME
                    wanted &= known & ((frames["ts"] < limit) == early)
            kept = frames if wanted.all() else frames.compress(wanted)
            if left is not None:
                kept = kept[:left]
                left -= len(kept)
            if len(kept):
                yield kept
            if left == 0:
                return
