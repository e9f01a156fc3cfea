"""Packet ids of blocks: they show what is missing before a block, and blocks in a wrong place.

The id of a block is the base of its recording, a random number, plus the offset of the block's
first byte in the line's stream. The offset counts the bytes that were recorded, the bytes that
were lost, and 4 GiB for each gap of unknown length. So the id of the next block is known, except
for its drop count:

- A larger id: blocks are missing before this one.
- A smaller id: the block is in the file a second time.
- An id that is far off: the block is of another recording. An older file had the same sectors of
  the disk, and the newer one never wrote them.

Neither the id nor the drop count has a checksum. A flipped bit in one costs at most that block:
the block is left out, or the number of bytes lost before it is wrong.
"""

from typing import Final, NamedTuple

from canser.recording import pcapng

__all__ = ["BlockIds", "Place", "is_id", "make_base", "skipped_by"]

_WORD: Final = 1 << 64  # ids wrap at 64 bits

_BASE_BITS: Final = 62

# What a gap of unknown length adds to an id, in bytes. A jump of an id by at least this much shows
# that a missing block may have had such a gap. Then the number of missing bytes is not known. A
# line of 2 Mbaud needs 6 hours for as many bytes.
_UNKNOWN_GAP: Final = 1 << 32

# A block that is farther ahead than this is of another recording. As bases have 62 bits, one block
# of another recording in four million is not that far ahead.
_AHEAD_MAX: Final = 1 << 40


def make_base() -> int:
    """Return the base of a new recording's ids."""
    import secrets  # noqa: PLC0415 - slow, and needed for new recordings only

    return _AHEAD_MAX + secrets.randbelow((1 << _BASE_BITS) - _AHEAD_MAX)


def skipped_by(lost: int) -> int:
    """Return what lost bytes, -1 for an unknown number, add to the id of the next block."""
    return _UNKNOWN_GAP if lost < 0 else lost


def is_id(number: int | None) -> bool:
    """Return whether a number can be an id; a drop count read as one (a flipped bit) cannot."""
    return number is not None and _AHEAD_MAX <= number < pcapng.UNKNOWN


class Place(NamedTuple):
    """Where in the recordings of a file a block belongs."""

    lost: int  # bytes that are lost right before the block, -1 for an unknown number
    recording: int  # index of its recording; 0 is the recording of the block before
    next_id: int  # id of the block behind it
    spare_id: int  # id of the block behind it if the id of this block is damaged


class BlockIds:
    """The ids that the next block of a file may have.

    There is one for the recording of the last block, and one for each other recording in the file:
    the file may start with sectors of an older recording, and then its own blocks follow.
    """

    def __init__(self) -> None:
        #: Whether blocks have ids in this section.
        self.used = False
        self._next: list[int] = []  # an id for each recording, the current one first
        self._spare: int | None = None  # `Place.spare_id` of the last block

    @property
    def next(self) -> int | None:
        """The id of the next block if nothing is missing, None if blocks have no ids."""
        return self._next[0] if self.used else None

    def begin(self, base: int | None) -> None:
        """Begin a recording. `base`: the base of its ids, None if it has no ids."""
        self.used, self._spare = base is not None, None
        if base is not None:
            self._next.insert(0, base)

    def add(self, base: int) -> None:
        """Add a recording whose section is missing because of damage."""
        self._next.append(base)

    def find(self, block_id: int, dropped: int, size: int) -> Place | str:
        """Return the place of a block of `size` bytes, or why it has none; changes nothing."""
        unknown = dropped == pcapng.UNKNOWN
        counted = _UNKNOWN_GAP if unknown else dropped
        next_id = (block_id + size) % _WORD
        for recording, expected in enumerate(self._next):
            jump = (block_id - expected) % _WORD
            spare_id = (expected + counted + size) % _WORD
            if spare_id == block_id:
                spare_id = next_id  # otherwise this block would be accepted a second time
            if jump == counted:
                return Place(-1 if unknown else counted, recording, next_id, spare_id)
            # A block without bytes only reports a gap. Without a jump, that gap is known already.
            if jump < _AHEAD_MAX and (jump or size):
                lost = -1 if counted > jump or jump >= _UNKNOWN_GAP else jump
                return Place(lost, recording, next_id, spare_id)
        if self._spare is not None and (block_id - self._spare) % _WORD == counted:
            return Place(-1 if unknown else counted, 0, next_id, next_id)
        behind = min((expected - block_id) % _WORD for expected in self._next)
        known = behind < _AHEAD_MAX
        return f"the block is {'there a second time' if known else 'of another recording'}"

    def take(self, place: Place) -> None:
        """Continue behind a block that was found at a place."""
        if place.recording:
            self._next.insert(0, self._next.pop(place.recording))
        self._next[0], self._spare = place.next_id, place.spare_id

    def advance(self, size: int) -> None:
        """Continue behind blocks of `size` bytes in all, without a gap before any of them."""
        self._next[0], self._spare = (self._next[0] + size) % _WORD, None
