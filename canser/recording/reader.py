"""Read recordings: the good blocks of a file, and what is left out between them."""

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

# Of a file that is all damage these many remarks are enough.
_REMARKS_KEPT: Final = 20

# Where to look for the next good block: this much at a time.
_SCAN: Final = 1 << 20

_SECTION_MIN: Final = 28

_NOT_AS_WRITTEN: Final = "the block is not as canser writes it"


class Recording(Iterator[DataBlock]):
    """The blocks of bytes of a recording in order: an iterator; a context manager.

    `source`: a path, or a file open for reading bytes, from where it stands; of any size,
    in bounded memory; a pipe is read as its bytes come. `.info` tells of the line. The data of
    a block is a view of the file, with the times of recordings behind one another as they are.

    What is torn or damaged is left out and named in `.remarks`, and so is what an older
    recording has left there, or what is there a second time. The block behind it has a gap: of
    as many bytes as the ids of the blocks tell, in older files of unknown length. A block has no
    bytes where bytes were lost that no others followed. Notes are remarks.

    Recordings of the same line may follow each other in the file; blocks of other kinds and
    interfaces are skipped. RecordingError if there is no interface of canser's; OSError for a
    file that cannot be read.
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
        """Yield the bytes of many blocks at once, of those that nothing is unusual about.

        All others are a run of their own, however long they are. The runs have the bytes, times
        and gaps of the blocks. Blocks and runs that were given before go bad: their data is good
        until the next run.

        Parameters
        ----------
        room_bytes
            The most bytes of several blocks in a run. Bytes of a pipe are not waited for to fill
            it.
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
        """Close the file, if it was given by its path. Done by itself at the end."""
        self._input.close()

    @property
    def remarks(self) -> list[str]:
        """What was left out so far and why, a line each."""
        return self._walk.remarks

    @property
    def bytes_done(self) -> int:
        """How far in the file it has come."""
        return self._walk.at

    @property
    def bytes_total(self) -> int | None:
        """The size of the file, None where it is not known."""
        return self._input.total


class WalkedBlock(NamedTuple):
    """A block that is good, and the piece in it if it is one of ours."""

    kind: int
    whole: memoryview
    piece: DataBlock | None = None
    place: Place | None = None  # by its id, if it has one
    # Its byte order where a copy must say that an unknown number of bytes is lost.
    unsure_order: Order | None = None
    notes: Sequence[bytes] = ()

    @property
    def is_given(self) -> bool:
        """Whether the piece tells of bytes, and not of a note alone."""
        return self.piece is not None and (len(self.piece.data) > 0 or self.piece.lost != 0)


def _line(note: bytes) -> str:
    """Return a note as part of a line of text."""
    text = note.decode("utf-8", "replace")
    return " ".join("".join(char if char.isprintable() else " " for char in text).split())


class Walk(Iterator[WalkedBlock]):
    """The good blocks of a file, in order, and what is left out between them."""

    def __init__(self, source: Input) -> None:
        self._input = source
        self.at = 0  # the offset behind the last block
        self.info: RecordingInfo | None = None
        self.left_out = 0
        self.remarks: list[str] = []
        self._order: Order | None = None  # of the section; None before the first
        self._interfaces = 0  # in the section so far
        self._ours = -1  # the number of our interface in the section
        self._damaged: tuple[int, str] | None = None  # since where, and why
        self._ended = False
        self._places = 0  # where something was left out
        self._skipped = 0  # blocks that are good and none of ours
        self._ids = BlockIds()
        self._line_bytes = 0  # in the pieces so far
        self._notes = 0
        # What the next piece tells of what lies before it.
        self._gap = False  # another recording ends there
        self._lost = False  # something was left out
        self._torn = False  # something was left out at that recording's end
        self._blocks = self._run()

    def __next__(self) -> WalkedBlock:
        return next(self._blocks)

    def gather(self, gatherer: BlockGatherer) -> DataRun | None:
        """Go on behind the next blocks that nothing is unusual about, if there are any."""
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
        """Go on behind the first interface of ours."""
        for _ in self:
            if self.info is not None:
                return self.info
        raise RecordingError(self.nothing())

    def nothing(self) -> str:
        """Return the message for a file without an interface of ours."""
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
        """Return a block whose two lengths agree, or what is wrong."""
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
        """Return the length that a block's first bytes tell, None if there can be no block."""
        if len(head) < pcapng.LENGTH_MIN:
            return None
        order = pcapng.section_order(head) if head[:4] == pcapng.SECTION_MARK else self._order
        if order is None:
            return None
        length = pcapng.u32(head, 4, order)
        fits = pcapng.LENGTH_MIN <= length <= pcapng.LENGTH_MAX and length % 4 == 0
        return length if fits else None

    def _check(self, at: int) -> WalkedBlock | str:
        """Return the block there if it is good, else what is wrong; nothing is changed."""
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
        # An unknown block is skipped; but what is one of ours in all but its type was one.
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
        """Return a block of ours with what is lost before it, or why it does not belong there."""
        if not is_id(packet.packet_id) and (self._ids.used or packet.dropped is None):
            return _NOT_AS_WRITTEN
        dropped = packet.dropped or 0  # beside an id 0 is not written
        # Asked before the damage is done with: a block tried here is the block taken.
        damaged = self._lost or self._damaged is not None
        place, size = None, len(packet.data)
        if self._ids.used:
            assert packet.packet_id is not None
            found = self._ids.find(packet.packet_id, dropped, size)
            if isinstance(found, str):
                return found
            # The ids do not tell what is missing at the end of another recording.
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
        """Go on behind a piece."""
        if block.is_given:
            self._gap = self._lost = self._torn = False
        else:
            self._gap = piece.gap  # of the next one
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
        """Take note of a block that is no piece."""
        if block.kind == pcapng.SECTION:
            self._gap = self._order is not None  # it goes on behind another recording
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
        told = read_interface(block.whole, self._order)
        if told is None:
            return
        info, base = told
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
        """Return where to go on behind a block that is not good."""
        whole = self._whole(at)
        if isinstance(whole, memoryview):
            # Its lengths agree, and if a block may follow, or nothing: what is wrong is inside.
            size = len(whole)
            behind = self._input.at(at, size + pcapng.LENGTH_MIN)[size:]
            if len(behind) < pcapng.LENGTH_MIN or self._length(behind) is not None:
                return at + size
        return self._scan(at + 1)

    def _scan(self, at: int) -> int:
        """Return the next place where a recording begins or a piece's CRC32 holds; or the end.

        Anywhere, not in steps of 4: a file may be put behind one that is torn.
        """
        marks = [re.escape(pcapng.SECTION_MARK)]
        if self._order is not None:
            marks += [re.escape(struct.pack(f"{self._order}I", pcapng.ENHANCED))]
            marks += [interface_mark(self._order)]
        search = re.compile(b"|".join(marks), re.DOTALL)
        while True:
            view = self._input.at(at, _SCAN)
            for found in search.finditer(view):
                block = self._check(at + found.start())
                if isinstance(block, WalkedBlock) and (
                    block.kind != pcapng.ENHANCED or block.piece
                ):
                    return at + found.start()
            if len(view) < _SCAN:
                return at + len(view)
            at += len(view) - MARK_MAX + 1
