"""Ids of blocks: what is missing before a block, and which blocks are not where they belong.

A block's id is the base of its recording, a random number, plus the offset in the line's stream
of the block's first byte. That offset counts what was recorded, the bytes that were lost, and
4 GiB for each gap of unknown length. So the id of the next block is known but for its drop
count. A block ahead of that comes behind others that are missing, with their drop counts. A
block behind that is there a second time. A block that is far off is of another recording: an
older file had the same sectors of the disk, and they were never written again.

The id has no checksum, as the drop count has none. A flipped bit in one costs that block at
most: it is left out, or what is lost before it is told wrong.
"""

import secrets
from typing import Final, NamedTuple

from canser.recording import pcapng

__all__ = ["BlockIds", "Place", "is_id", "make_base", "skipped_by"]

_WORD: Final = 1 << 64  # ids are counted modulo this

_BASE_BITS: Final = 62

# What a gap of unknown length adds to an id: a block that is missing may have had one, and then
# it is not known either how many bytes are missing. At 2 Mbaud a line has so many in 6 hours.
_UNKNOWN_GAP: Final = 1 << 32

# A block that is farther ahead is of another recording. One in four million of these is not so
# far ahead, as bases have 62 bits.
_AHEAD_MAX: Final = 1 << 40


def make_base() -> int:
    """Return the base of a new recording's ids."""
    return _AHEAD_MAX + secrets.randbelow((1 << _BASE_BITS) - _AHEAD_MAX)


def skipped_by(lost: int) -> int:
    """Return what so many lost bytes, -1 for an unknown number, add to the next block's id."""
    return _UNKNOWN_GAP if lost < 0 else lost


def is_id(number: int | None) -> bool:
    """Return whether this is an id, and no drop count that a flipped bit made an id."""
    return number is not None and _AHEAD_MAX <= number < pcapng.UNKNOWN


class Place(NamedTuple):
    """Where in the file's recordings a block belongs."""

    lost: int  # bytes that are lost right before it, -1 for an unknown number
    recording: int  # 0: that of the block before
    next_id: int  # of the block behind it
    spare_id: int  # of the block behind it if this one's id is damaged


class BlockIds:
    """The ids that the next block of a file may have.

    They are those of the recording that the last block was of, and of the others in the file:
    sectors of an older recording may hold its start, and then the file's own blocks go on.
    """

    def __init__(self) -> None:
        #: Whether blocks have ids in this section.
        self.used = False
        self._next: list[int] = []  # of the recording that is read first
        self._spare: int | None = None

    @property
    def next(self) -> int | None:
        """The id of the next block if nothing is missing, None where blocks have none."""
        return self._next[0] if self.used else None

    def begin(self, base: int | None) -> None:
        """Begin a recording, with this base or without ids."""
        self.used, self._spare = base is not None, None
        if base is not None:
            self._next.insert(0, base)

    def add(self, base: int) -> None:
        """Take note of a recording that begins without a section of its own: it is damaged."""
        self._next.append(base)

    def find(self, block_id: int, dropped: int, size: int) -> Place | str:
        """Return where a block of so many bytes belongs, or why nowhere; nothing is changed."""
        unknown = dropped == pcapng.UNKNOWN
        told = _UNKNOWN_GAP if unknown else dropped
        next_id = (block_id + size) % _WORD
        for recording, expected in enumerate(self._next):
            jump = (block_id - expected) % _WORD
            spare_id = (expected + told + size) % _WORD
            if spare_id == block_id:
                spare_id = next_id  # otherwise it could be there a second time
            if jump == told:
                return Place(-1 if unknown else told, recording, next_id, spare_id)
            # A block without bytes tells of a gap: here it is one that was told.
            if jump < _AHEAD_MAX and (jump or size):
                lost = -1 if told > jump or jump >= _UNKNOWN_GAP else jump
                return Place(lost, recording, next_id, spare_id)
        if self._spare is not None and (block_id - self._spare) % _WORD == told:
            return Place(-1 if unknown else told, 0, next_id, next_id)
        behind = min((expected - block_id) % _WORD for expected in self._next)
        known = behind < _AHEAD_MAX
        return f"the block is {'there a second time' if known else 'of another recording'}"

    def take(self, place: Place) -> None:
        """Go on behind a block that was found."""
        if place.recording:
            self._next.insert(0, self._next.pop(place.recording))
        self._next[0], self._spare = place.next_id, place.spare_id

    def advance(self, size: int) -> None:
        """Go on behind blocks of so many bytes, none of which came after a gap."""
        self._next[0], self._spare = (self._next[0] + size) % _WORD, None
