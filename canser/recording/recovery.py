"""Copy the valid blocks of a damaged recording."""

from dataclasses import dataclass
from typing import BinaryIO, Final

from canser._input import Input
from canser.errors import RecordingError
from canser.recording import pcapng
from canser.recording.header import RecordingInfo
from canser.recording.reader import Walk

__all__ = ["Recovered", "recover"]

_SECTION_LENGTH: Final = slice(16, 24)  # the field of a section header with the section's length


@dataclass(frozen=True, slots=True)
class Recovered:
    """The result of a recovery."""

    #: The line that the recording is of.
    info: RecordingInfo
    #: Blocks with bytes of the line that were copied.
    blocks: int
    #: Bytes of the line in these blocks.
    bytes_kept: int
    #: Bytes of the damaged file that were left out, including those of the format.
    bytes_left_out: int
    #: What was left out and why, a line each.
    remarks: list[str]


def recover(source: BinaryIO, target: BinaryIO) -> Recovered:
    """Copy the valid blocks of a recording; nothing is invented.

    Blocks keep their ids. If the ids do not show how much was left out, the next block gets the
    drop count of a gap of unknown length. So reading the copy gives the same result as reading the
    damaged file. RecordingError if the file has no interface that canser wrote.
    """
    walk = Walk(Input(source))
    blocks = bytes_kept = 0
    for block in walk:
        whole: memoryview | bytearray | bytes = block.whole
        if block.kind == pcapng.SECTION:
            # The length may be wrong now. All ones, "unknown", is always right.
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
