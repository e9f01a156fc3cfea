"""What decoding with a database found, and what it did not, and why."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canser._core.signals import SignalTables
from canser.signals.messages import Message

__all__ = ["UNKNOWN_ID_DTYPE", "DecodeReport", "make_report"]

# An id that no message of the database has.
UNKNOWN_ID_DTYPE = np.dtype([("id", np.uint32), ("ext", np.bool_), ("count", np.int64)])


@dataclass(frozen=True, eq=False, kw_only=True)
class DecodeReport:
    """What decoding found, and what it did not, and why; returned by `Database.decode`.

    Attributes
    ----------
    frame_count : int
        All frames.
    messages : mapping of str to int
        Frames by the name of their message.
    unknown_ids : array of UNKNOWN_ID_DTYPE, shape (k,)
        Ids that no message has, the most frequent first. Noise makes many; frames whose ids are
        not kept after a million are in `other_count`.
    never_seen : tuple of str
        Messages that no frame belongs to.
    short : mapping of str to int
        Frames that are too short for a signal, by their message. The signals that fit are decoded.
    unknown_pages : mapping of str to int
        Frames with a value of a multiplexer that the database does not know, by their message.
        What does not depend on it is decoded.
    remote_count, error_count : int
        Remote frames and error frames, which have no signals.
    other_count : int
        Frames without a message whose ids are not in `unknown_ids`.
    """

    frame_count: int
    messages: Mapping[str, int]
    unknown_ids: npt.NDArray[np.void]
    never_seen: tuple[str, ...]
    short: Mapping[str, int]
    unknown_pages: Mapping[str, int]
    remote_count: int
    error_count: int
    other_count: int

    @property
    def decoded_count(self) -> int:
        """Frames that belong to a message."""
        return sum(self.messages.values())

    def __str__(self) -> str:
        lines = [f"{self.decoded_count:,} of {self.frame_count:,} frames belong to a message"]
        ids = self.unknown_ids
        count = int(ids["count"].sum()) + self.other_count
        if count:
            shown = [f"{row['id']:0{8 if row['ext'] else 3}X}" for row in ids[:5]]
            more = f" and {len(ids) - 5:,} more" if len(ids) > 5 else ""
            lines.append(f"{count:,} have an id that no message has: {', '.join(shown)}{more}")
        for name, what in (
            (self.short, "are too short"),
            (self.unknown_pages, "have an unknown page"),
        ):
            if name:
                lines.append(f"{sum(name.values()):,} {what}: {', '.join(name)}")
        if self.remote_count or self.error_count:
            lines.append(f"{self.remote_count:,} remote frames, {self.error_count:,} error frames")
        if self.never_seen:
            more = f" and {len(self.never_seen) - 5} more" if len(self.never_seen) > 5 else ""
            lines.append(
                f"{len(self.never_seen):,} messages were never seen: "
                f"{', '.join(self.never_seen[:5])}{more}"
            )
        return "\n".join(lines)


def make_report(
    messages: Sequence[Message], roots: Sequence[int], tables: SignalTables, frame_count: int
) -> DecodeReport:
    """Return what the tables have counted in so many frames; `roots`: the messages' first pages."""
    pages = tables.pages[roots]
    dlcs = tables.dlcs[roots]
    frames = _named(messages, dlcs.sum(axis=1))
    # Those with multiplexers are counted one by one, as their pages differ.
    short = np.where(np.arange(9) < pages["full_dlc"][:, None], dlcs, 0).sum(axis=1)
    short = np.where(pages["mux_count"] > 0, pages["short_count"], short)
    ids = tables.unknown_ids
    unknown = np.zeros(len(ids), UNKNOWN_ID_DTYPE)
    unknown["id"], unknown["ext"] = ids["key"] & 0x1FFF_FFFF, ids["key"] >> 31
    unknown["count"] = ids["count"]
    order = np.lexsort([unknown["id"], unknown["ext"], -unknown["count"]])
    return DecodeReport(
        frame_count=frame_count,
        messages=frames,
        unknown_ids=unknown[order],
        never_seen=tuple(each.name for each in messages if each.name not in frames),
        short=_named(messages, short),
        unknown_pages=_named(messages, pages["unknown_count"]),
        remote_count=tables.remote_count,
        error_count=tables.error_count,
        other_count=tables.other_count,
    )


def _named(messages: Sequence[Message], counts: npt.NDArray[np.uint64]) -> dict[str, int]:
    return {
        message.name: count
        for message, count in zip(messages, counts.tolist(), strict=True)
        if count
    }
