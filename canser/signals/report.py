"""What decoding with a database found, and what it did not, and why."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from canser._core.signals import NO_MESSAGE, SignalTables
from canser.signals.messages import Message

__all__ = ["UNKNOWN_ID_DTYPE", "Counts", "DecodeReport"]

# An id that no message of the database has.
UNKNOWN_ID_DTYPE = np.dtype([("id", np.uint32), ("ext", np.bool_), ("count", np.int64)])

# Rows of unknown ids that are put together from batches before equal ids are added up.
_ROWS = 1 << 16


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


class Counts:
    """Counters of batches, which add up."""

    def __init__(self, messages: Sequence[Message]) -> None:
        self._messages = messages
        #: Frames, short ones, and those with an unknown page, by the number of the message.
        self._by_message = np.zeros((3, len(messages)), np.int64)
        self._unknown = [np.zeros(0, UNKNOWN_ID_DTYPE)]
        #: Frames, remote frames, error frames, frames of other ids.
        self._frames = np.zeros(4, np.int64)

    @classmethod
    def of(cls, messages: Sequence[Message], tables: SignalTables, frame_count: int) -> "Counts":
        """Return the counters of one batch."""
        self = cls(messages)
        ids = tables.ids
        ids = ids[ids["count"] > 0]
        is_known = ids["message"] != NO_MESSAGE
        known = ids[is_known]
        self._by_message[0] = tables.pages["dlcs"].sum(axis=1)[tables.messages["page"]]
        self._by_message[1] = tables.messages["short_count"]
        self._by_message[2] = tables.messages["unknown_count"]
        unknown = np.zeros(len(ids) - len(known), UNKNOWN_ID_DTYPE)
        for name in UNKNOWN_ID_DTYPE.names or ():
            unknown[name] = ids[name][~is_known]
        self._unknown = [unknown]
        self._frames[:] = (frame_count, tables.remote_count, tables.error_count, tables.other_count)
        return self

    def add(self, other: "Counts") -> None:
        """Add the counters of another one."""
        self._by_message += other._by_message
        self._frames += other._frames
        self._unknown += other._unknown
        if sum(map(len, self._unknown)) > _ROWS + 2 * len(self._unknown[0]):
            self._unknown = [self._unknown_ids()]

    def report(self) -> DecodeReport:
        """Return what was counted."""
        frames, short, unknown = (self._named(each) for each in self._by_message)
        frame_count, remote_count, error_count, other_count = self._frames.tolist()
        return DecodeReport(
            frame_count=frame_count,
            messages=frames,
            unknown_ids=self._unknown_ids(),
            never_seen=tuple(each.name for each in self._messages if each.name not in frames),
            short=short,
            unknown_pages=unknown,
            remote_count=remote_count,
            error_count=error_count,
            other_count=other_count,
        )

    def _named(self, counts: npt.NDArray[np.int64]) -> dict[str, int]:
        return {
            message.name: count
            for message, count in zip(self._messages, counts.tolist(), strict=True)
            if count
        }

    def _unknown_ids(self) -> npt.NDArray[Any]:
        """Return the ids, each once, the most frequent first."""
        rows = np.concatenate(self._unknown)
        keys = rows["id"] | rows["ext"].astype(np.uint32) << np.uint32(31)
        _, first, places = np.unique(keys, return_index=True, return_inverse=True)
        found = rows[first]
        found["count"] = 0
        np.add.at(found["count"], places, rows["count"])
        return found[np.argsort(-found["count"], kind="stable")]
