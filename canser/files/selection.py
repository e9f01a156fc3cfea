"""Select frames of a stream by filter, time and number, and move their times to an epoch."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from canser._frames import NO_TIME, YEAR_2000_NS, copy_records, match
from canser.errors import FormatError
from canser.files.tags import Tagged

__all__ = ["Moment", "Selection"]


class Moment(NamedTuple):
    """A time in a stream."""

    #: Nanoseconds.
    ns: int
    #: Whether `ns` counts from the first frame that has a time, and not from 1970.
    from_first: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Selection:
    """The frames to select; all by default."""

    #: Filters of `canser.match`. A frame is selected if it passes any of them.
    filters: tuple[str, ...] = ()
    #: Select frames from this time on. A frame without a time is not selected.
    start: Moment | None = None
    #: Select frames before this time. A frame without a time is not selected.
    end: Moment | None = None
    #: The most frames to select, of those that pass the other conditions.
    count: int | None = None
    #: Time of the first frame in nanoseconds since 1970. All times are moved by the same amount.
    epoch_ns: int | None = None

    @property
    def is_all(self) -> bool:
        """Whether all frames are selected, and no times are moved."""
        return self == Selection()

    def apply(self, blocks: Iterable[Tagged]) -> Iterator[Tagged]:
        """Yield the selected frames; FormatError if times to move already count from 1970."""
        left, first_ns = self.count, None
        for block, channels, directions in blocks:
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
            kept = Tagged(frames, channels, directions)
            if not wanted.all():
                kept = kept.map(lambda array: array.compress(wanted))  # noqa: B023 - called here
            if left is not None:
                kept = kept.map(lambda array: array[:left])  # noqa: B023 - called here
                left -= len(kept.frames)
            if len(kept.frames):
                yield kept
            if left == 0:
                return
