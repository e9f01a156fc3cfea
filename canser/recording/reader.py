"""Read recordings: the valid blocks of a file, and what is left out between them."""

import re
import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple, Self

import numpy as np

from canser._core.blocks import BlockGatherer
from canser._input import Input, Source
from canser.errors import RecordingError
from canser.recording import pcapng
from canser.recording.header import MARK_MAX, RecordingInfo, interface_mark, read_interface
from canser.recording.ids import BlockIds, Place, is_id
from canser.recording.pcapng import Enhanced, Order
from canser.timing.arrivals import DataBlock, DataRun

__all__ = ["Recording", "Walk"]

# The most remarks on damage, and on notes. Otherwise a badly damaged file would have millions.
_REMARKS_KEPT: Final = 20

# Bytes that are searched at a time for the next valid block.
_SCAN_LEN: Final = 1 << 20

_SECTION_MIN: Final = 28  # the shortest section header, in bytes: one without options

_NOT_AS_WRITTEN: Final = "the block is not as canser writes it"


class Recording(Iterator[DataBlock]):
    """Iterator over the blocks of bytes of a recording, in order; a context manager.

    `info` describes the line. The data of a block is a view of the file. Memory is bounded.

    Parts that are cut off or damaged are left out and named in `remarks`. So are blocks that an
    older recording has left in the file, and blocks that are there a second time. The block behind
    such a part has a gap. Its length follows from the ids of the blocks; in older files, which have
    no ids, it is unknown. If bytes were lost and none followed, a block without bytes has the gap.
    Notes are remarks.

    Recordings of the same line may follow each other in the file; their times are not changed.
    Blocks of other kinds and interfaces are skipped.

    Parameters
    ----------
    source
        A path, or a file that is open for reading bytes, which is read from its current position.
        A pipe is read as its bytes arrive.

    Raises
    ------
    RecordingError
        The file has no interface that canser wrote.
    OSError
        The file cannot be read.
    """

    def __init__(self, source: Source | Input) -> None:
        self._input = source if isinstance(source, Input) else Input(source)
        try:
            self._walk = Walk(self._input)
            self.info = self._walk.find_interface()
        except BaseException:
            self.close()
            raise

    def __next__(self) -> DataBlock:
        for block in self._walk:
            if block.is_given:
                assert block.piece is not None
                return block.piece
        self.close()
        raise StopIteration

    def runs(self, room_bytes: int = 1 << 19) -> Iterator[DataRun]:
        """Yield runs: the bytes, times and gaps of many blocks at once.

        A block with a gap, or one that needs a closer check, is a run of its own, of any length.
        The data of a run, and of earlier blocks, is valid until the next run.

        Parameters
        ----------
        room_bytes
            The most bytes in a run of several blocks. A run does not wait for more bytes of a
            pipe.
        """
        gatherer = BlockGatherer(room_bytes)
        while True:
            run = self._walk.gather(gatherer)
            if run is None:
                block = next(self, None)
                if block is None:
                    return
                ends, times = np.array([[len(block.data)], [block.arrival_ns]], np.int64)
                run = DataRun(memoryview(block.data), ends, times, block.lost, block.gap)
            yield run

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file, if it was given by its path. This also happens at the end."""
        self._input.close()

    @property
    def remarks(self) -> list[str]:
        """What was left out so far and why, a line each."""
        return self._walk.remarks

    @property
    def bytes_done(self) -> int:
        """Bytes of the file that were read."""
        return self._walk.at

    @property
    def bytes_total(self) -> int | None:
        """The size of the file in bytes, None if it is not known."""
        return self._input.total


class WalkedBlock(NamedTuple):
    """A valid block of a pcapng file."""

    #: Type of the block, as the pcapng draft numbers it.
    kind: int
    #: All bytes of the block.
    whole: memoryview
    #: The bytes of the line in the block; None if it is no block of our interface with packets.
    piece: DataBlock | None = None
    #: The place that the block's id gives it; None if it has no id.
    place: Place | None = None
    #: The section's byte order if a copy of the block must say that an unknown number of bytes is
    #: lost before it, otherwise None.
    unsure_order: Order | None = None
    #: The notes of the block.
    notes: Sequence[bytes] = ()

    @property
    def is_given(self) -> bool:
        """Whether the piece has bytes or lost bytes, and not only a note."""
        return self.piece is not None and (len(self.piece.data) > 0 or self.piece.lost != 0)


def _line(note: bytes) -> str:
    """Return a note as part of a line of text."""
    text = note.decode("utf-8", "replace")
    return " ".join("".join(char if char.isprintable() else " " for char in text).split())


class Walk(Iterator[WalkedBlock]):
    """Iterator over the valid blocks of a file, in order; counts what is left out between them."""

    def __init__(self, source: Input) -> None:
        self._input = source
        self.at = 0  # the offset behind the last block
        self.info: RecordingInfo | None = None
        self.left_out = 0  # bytes
        self.remarks: list[str] = []
        self._order: Order | None = None  # byte order of the section; None before the first one
        self._interfaces = 0  # interfaces in the section so far
        self._ours = -1  # the number of our interface in the section, -1 if there is none
        self._damaged: tuple[int, str] | None = None  # start of the current damage, and its cause
        self._ended = False
        self._places = 0  # places where something was left out
        self._skipped = 0  # valid blocks that canser did not write
        self._ids = BlockIds()
        self._line_bytes = 0  # bytes of the line in the pieces so far
        self._notes = 0  # notes so far
        # What lies between the last piece and the next one.
        self._gap = False  # the end of another recording
        self._lost = False  # something that was left out
        self._torn = False  # something that was left out at the end of that recording
        self._blocks = self._run()

    def __next__(self) -> WalkedBlock:
        return next(self._blocks)

    def gather(self, gatherer: BlockGatherer) -> DataRun | None:
        """Return the next blocks that need no closer check as one run, None if there are none."""
        pending = self._gap or self._lost or self._torn or self._damaged is not None
        if pending or self._order != "<" or self._ours < 0 or self._ended:
            return None
        view = self._input.ahead(self.at)
        used, data, ends, times = gatherer.gather(view, self._ours, self._ids.next)
        if not used:
            return None
        self.at += used
        self._line_bytes += len(data)
        if self._ids.used:
            self._ids.advance(len(data))
        return DataRun(data, ends, times)

    def find_interface(self) -> RecordingInfo:
        """Read up to the first interface that canser wrote, and return its line."""
        for _ in self:
            if self.info is not None:
                return self.info
        raise RecordingError(self.nothing())

    def nothing(self) -> str:
        """Return the message for a file without an interface that canser wrote."""
        why = f"; {self.remarks[0]}" if self.remarks else ""
        return f"{self._input.name} is no recording: it describes no interface of canser's{why}"

    def _run(self) -> Iterator[WalkedBlock]:
        while self._input.at(self.at, 1):
            block = self._check(self.at)
            if isinstance(block, str):
                if self._damaged is None:
                    self._damaged = self.at, block
                self.at = self._resume(self.at)
                continue
            if self._damaged is not None:
                self._end_damage("left out")
            if block.piece is None:
                self._enter(block)
            else:
                self._enter_piece(block, block.piece)
            self.at += len(block.whole)
            yield block
        self._ended = True
        if self._damaged is not None:
            self._end_damage("torn tail, left out")
        if self._skipped:
            self.remarks.append(f"blocks that are none of canser's, skipped: {self._skipped:,}")

    def _end_damage(self, what: str) -> None:
        assert self._damaged is not None
        begin, why = self._damaged
        self._damaged = None
        self.left_out += self.at - begin
        self._lost = True
        self._places += 1
        if self._places <= _REMARKS_KEPT:
            size = self.at - begin
            self.remarks.append(f"{what}: {size:,} bytes at byte {begin:,}: {why}")
        elif self._places == _REMARKS_KEPT + 1:
            self.remarks.append("more is left out, and not named one by one")

    def _whole(self, at: int) -> memoryview | str:
        """Return the block at an offset if its two lengths agree, otherwise what is wrong."""
        head = self._input.at(at, pcapng.LENGTH_MIN)
        length = self._length(head)
        if length is None:
            return "no block starts there"
        whole = self._input.at(at, length)
        if len(whole) < length:
            return "the block is cut short"
        if whole[-4:] != whole[4:8]:
            return "the two lengths of the block differ"
        return whole

    def _length(self, head: memoryview) -> int | None:
        """Return the length in the first bytes of a block, None if no block can start there."""
        if len(head) < pcapng.LENGTH_MIN:
            return None
        order = pcapng.section_order(head) if head[:4] == pcapng.SECTION_MARK else self._order
        if order is None:
            return None
        length = pcapng.u32(head, 4, order)
        fits = pcapng.LENGTH_MIN <= length <= pcapng.LENGTH_MAX and length % 4 == 0
        return length if fits else None

    def _check(self, at: int) -> WalkedBlock | str:
        """Return the block at an offset if it is valid, else what is wrong; changes nothing."""
        whole = self._whole(at)
        if isinstance(whole, str):
            return whole
        if whole[:4] == pcapng.SECTION_MARK:
            order = pcapng.section_order(whole)
            if order is None or len(whole) < _SECTION_MIN or pcapng.u16(whole, 12, order) != 1:
                return "the section is of a version that is not known"
            return WalkedBlock(pcapng.SECTION, whole)
        assert self._order is not None
        kind = pcapng.u32(whole, 0, self._order)
        if kind == pcapng.ENHANCED:
            return self._check_enhanced(whole)
        # An unknown block is skipped. But if it is a valid packet in all but its type, the type is
        # damaged.
        meant = self._check_enhanced(whole)
        if isinstance(meant, WalkedBlock) and meant.piece is not None:
            return "the type of the block is damaged"
        return WalkedBlock(kind, whole)

    def _check_enhanced(self, whole: memoryview) -> WalkedBlock | str:
        assert self._order is not None
        packet = Enhanced.read(whole, self._order)
        if packet is None:
            return "what is inside the block does not fit into it"
        if packet.interface >= self._interfaces:
            return "the block's interface is not described"
        if packet.interface != self._ours:
            return WalkedBlock(pcapng.ENHANCED, whole)
        if packet.crc32 is None or packet.ts >> 63:
            return _NOT_AS_WRITTEN
        if zlib.crc32(packet.data) != packet.crc32:
            return "the CRC32 of the block does not hold"
        return self._check_place(whole, packet)

    def _check_place(self, whole: memoryview, packet: Enhanced) -> WalkedBlock | str:
        """Return a block of our interface with what is lost before it, or why it is misplaced."""
        if not is_id(packet.packet_id) and (self._ids.used or packet.dropped is None):
            return _NOT_AS_WRITTEN
        dropped = packet.dropped or 0  # in a block with an id, a drop count of 0 is not written
        # The current damage still counts: it ends at this block, if the block is valid.
        damaged = self._lost or self._damaged is not None
        place, size = None, len(packet.data)
        if self._ids.used:
            assert packet.packet_id is not None
            found = self._ids.find(packet.packet_id, dropped, size)
            if isinstance(found, str):
                return found
            # The ids do not show what is missing at the end of another recording.
            unsure = self._torn or (damaged and found.recording > 0)
            if unsure and isinstance(
                again := self._ids.find(packet.packet_id, pcapng.UNKNOWN, size), Place
            ):
                found = again
            place, lost = found, found.lost
        else:
            unsure = damaged
            lost = -1 if damaged or dropped == pcapng.UNKNOWN else dropped
        gap = lost != 0 or self._gap or (place is not None and place.recording > 0)
        piece = DataBlock(packet.data, packet.ts, lost, gap)
        unsure_order = self._order if unsure and lost else None
        return WalkedBlock(pcapng.ENHANCED, whole, piece, place, unsure_order, packet.comments)

    def _enter_piece(self, block: WalkedBlock, piece: DataBlock) -> None:
        """Take in a block with a piece."""
        if block.is_given:
            self._gap = self._lost = self._torn = False
        else:
            self._gap = piece.gap  # passed on to the next piece
        if block.place is not None:
            self._ids.take(block.place)
        for note in block.notes:
            self._notes += 1
            if self._notes <= _REMARKS_KEPT:
                self.remarks.append(f"note at byte {self._line_bytes:,} of the line: {_line(note)}")
            elif self._notes == _REMARKS_KEPT + 1:
                self.remarks.append("more notes are in the file, and not given one by one")
        self._line_bytes += len(piece.data)

    def _enter(self, block: WalkedBlock) -> None:
        """Take in a block without a piece."""
        if block.kind == pcapng.SECTION:
            self._gap = self._order is not None  # the section follows another recording
            self._order = pcapng.section_order(block.whole)
            self._torn = self._lost
            self._interfaces, self._ours = 0, -1
            self._ids.begin(None)
        elif block.kind == pcapng.INTERFACE:
            self._interfaces += 1
            self._enter_interface(block)
        elif block.kind != pcapng.STATISTICS:
            self._skipped += 1

    def _enter_interface(self, block: WalkedBlock) -> None:
        assert self._order is not None
        described = read_interface(block.whole, self._order)
        if described is None:
            return
        info, base = described
        first = self.info or info
        same = (info.protocol, info.baudrate, info.ts_unit) == (
            *(first.protocol, first.baudrate, first.ts_unit),
        )
        if same and self._ours < 0:
            self.info = first
            self._ours = self._interfaces - 1
            self._ids.begin(base)
        else:
            if same and base is not None:
                self._ids.add(base)
            self.remarks.append(
                f"the interface {info.device} at byte {self.at:,} is another line: left out"
            )

    def _resume(self, at: int) -> int:
        """Return the offset to continue at behind a block that is not valid."""
        whole = self._whole(at)
        if isinstance(whole, memoryview):
            # The lengths agree. If a block can start behind it, or the file ends there, only the
            # content is damaged.
            size = len(whole)
            behind = self._input.at(at, size + pcapng.LENGTH_MIN)[size:]
            if len(behind) < pcapng.LENGTH_MIN or self._length(behind) is not None:
                return at + size
        return self._scan(at + 1)

    def _scan(self, at: int) -> int:
        """Return the next offset of a section, an interface or a piece with a valid CRC32.

        Or the end. Every offset is tried, not only multiples of 4, because a file may have been
        appended to one that was cut off.
        """
        marks = [re.escape(pcapng.SECTION_MARK)]
        if self._order is not None:
            marks += [re.escape(struct.pack(f"{self._order}I", pcapng.ENHANCED))]
            marks += [interface_mark(self._order)]
        search = re.compile(b"|".join(marks), re.DOTALL)
        while True:
            view = self._input.at(at, _SCAN_LEN)
            for found in search.finditer(view):
                block = self._check(at + found.start())
                if isinstance(block, WalkedBlock) and (
                    block.kind != pcapng.ENHANCED or block.piece
                ):
                    return at + found.start()
            if len(view) < _SCAN_LEN:
                return at + len(view)
            at += len(view) - MARK_MAX + 1
