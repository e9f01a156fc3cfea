"""Recover what is good of a damaged recording."""

from dataclasses import dataclass
from typing import BinaryIO, Final

from canser._input import Input
from canser.errors import RecordingError
from canser.recording import pcapng
from canser.recording.header import RecordingInfo
from canser.recording.reader import Walk

__all__ = ["Recovered", "recover"]

_SECTION_LENGTH: Final = slice(16, 24)  # where a section's header tells how long it is


@dataclass(frozen=True, slots=True)
class Recovered:
    """What became of a damaged recording."""

    info: RecordingInfo
    blocks: int  # of bytes of the line, that were kept
    bytes_kept: int  # in them
    bytes_left_out: int  # of the damaged file, with the format's own
    remarks: list[str]


def recover(source: BinaryIO, target: BinaryIO) -> Recovered:
    """Copy the good blocks of a recording; nothing is made up.

    Blocks keep their ids. Where these do not tell what was left out, the next block gets the drop
    count of a gap of unknown length, so that reading the copy gives what reading the damaged file
    gives.
    RecordingError if there is no interface of canser's.
    """
    walk = Walk(Input(source))
    blocks = bytes_kept = 0
    for block in walk:
        whole: memoryview | bytearray | bytes = block.whole
        if block.kind == pcapng.SECTION:
            # Its length may not hold any more; "unknown" always does.
            whole = bytearray(whole)
            whole[_SECTION_LENGTH] = b"\xff" * 8
        elif block.piece is not None:
            blocks += block.is_given
            bytes_kept += len(block.piece.data)
            if block.unsure_order is not None:
                whole = pcapng.with_dropcount(block.whole, block.unsure_order, pcapng.UNKNOWN)
        target.write(whole)
    if walk.info is None:
        raise RecordingError(walk.nothing())
    return Recovered(walk.info, blocks, bytes_kept, walk.left_out, walk.remarks)
