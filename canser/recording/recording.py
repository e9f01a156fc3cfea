"""Recordings: the raw bytes of a line with their times, append-only, in pcapng files.

One interface, one enhanced packet block for each chunk of bytes. Its time is when the last
byte of the chunk came; the earlier ones came one after the other at the line's rate. Its
drop count is the bytes lost right before the chunk; its hash is the CRC32 of the bytes.

A file that ends anywhere is good up to its last whole block. What is damaged is left out,
and told. The standard's hash covers the bytes only: a flipped bit in a time, in a drop count
or in the interface's description is found where the value is impossible, and else is not.
"""

import contextlib
import errno
import os
import re
import struct
import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple, Self, cast

from canser._guards import Uncopied
from canser._input import Input, Source
from canser.errors import RecordingError
from canser.recording import pcapng
from canser.recording._lock import lock
from canser.recording.pcapng import Enhanced, Order
from canser.timing.arrivals import DataBlock, count_back

__all__ = [
    "Recording",
    "RecordingInfo",
    "RecordingWriter",
    "Recovered",
    "is_recording",
    "recover",
    "starts_recording",
]

# LINKTYPE_USER0: for private use, so no program takes the bytes for network packets.
_LINK_TYPE: Final = 147

# A chunk holds no more bytes, and is closed this long after its first byte came.
CHUNK_MAX: Final = 1 << 16
CHUNK_NS: Final = 250_000_000

# A reader knows the time of a chunk's last byte, and counts back at the line's rate. The
# chunk ends before a piece of it gets a time that is off by more than this: about what a
# USB frame and the scheduler put onto a time anyway. So a chunk spans this much silence at
# most, and there are no more than 500 chunks in a second besides the full ones: 64 bytes
# each, 32 kB/s. (2,000 frames a second read one by one at 2,000,000 baud: 5 in a chunk, 26 kB/s
# for as many bytes of frames.) On a line that is faster than it says, as a pseudo terminal
# is, pieces of twice this time of the line, together, are in two chunks at the least.
TIME_ERROR_NS: Final = 2_000_000

_SYNC_NS: Final = 1_000_000_000

# The drop count of a gap of unknown length.
_UNKNOWN: Final = (1 << 64) - 1

# Of a file that is all damage these many remarks are enough.
_REMARKS_KEPT: Final = 20

# Where to look for the next good block: this much at a time.
_SCAN: Final = 1 << 20

# Options of the blocks, as the standard numbers them.
_COMMENT, _OS, _APPLICATION = 1, 3, 4
_NAME, _DESCRIPTION, _SPEED, _RESOLUTION = 2, 3, 8, 9
_START, _END, _RECEIVED, _DROPPED = 2, 3, 4, 5

_NANOSECONDS: Final = b"\x09"  # a resolution: 10 to the power of -9 seconds

# The first word of an interface's description; `name=value` follow.
_SIGN: Final = "canser:"

_SECTION_MARK: Final = struct.pack("<I", pcapng.SECTION)
_SECTION_LENGTH: Final = slice(16, 24)  # where a section's header tells how long it is
_SECTION_MIN: Final = 28
_INTERFACE_OPTIONS: Final = 16  # where they begin
_INTERFACE_MIN: Final = 20

_HEAD_LEN: Final = len(pcapng.enhanced_head(0, 0))

# Where there is nothing to be written through: a pipe, a terminal.
_NO_SYNC: Final = {errno.EINVAL, errno.ENOTSUP, errno.EROFS}

# What the system says of a name that is gone, alone or with its folder.
_NO_FILE: Final = {errno.ENOENT, errno.ENOTDIR, errno.ESTALE}

_ABOUT: Final = (
    "The raw bytes of a serial line, not packets. The time of a block is when its last byte "
    "came; drop counts are the bytes lost right before a block; counts of the interface are bytes."
)


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """What a recording knows of its line."""

    protocol: str
    baudrate: int
    bitrate: int | None  # of the CAN bus; None if not known
    ts_unit: str  # of the device's timestamps
    device: str

    @property
    def byte_ns(self) -> float:
        """The time of a byte on the line: start bit, 8 bits, stop bit."""
        return 10e9 / self.baudrate


def is_recording(head: bytes) -> bool:
    """Return whether these first bytes of a file, 12 are enough, are a recording's."""
    return pcapng.is_pcapng(head)


def starts_recording(source: Input) -> bool:
    """Return whether a file starts a recording.

    Of a pipe no more is waited for than it takes to tell.
    """
    likely = all(source.at(0, length) == _SECTION_MARK[:length] for length in (1, 4))
    return likely and is_recording(bytes(source.at(0, 12)))


class RecordingWriter(Uncopied):
    """Write a recording, block by block; a context manager.

    `target`: the path of a file that is not there yet, or an empty file open for writing,
    of which the descriptor is used. Each block is written by one call, whole, and written
    through once a second: after a crash at any moment all blocks are good but the last. For
    one thread at a time.

    OSError where the disk is full: the file then ends with its last whole block, the writer
    writes no more, and what was in the open chunk is lost. OSError, too, where the disk does
    not take what was written: what came behind `bytes_synced` may then be lost. An error names
    the path. FileExistsError for a path that is there. A path is locked until `close`.

    Without `syncs` the file is written through at its end only, for what can be made again.
    A chunk ends before counting back in it is off by more than `time_error_ns`.

    `vanished` tells, as of the last second and of `close`, that the path is no more the name of
    the file: it was removed, replaced or renamed. What is written goes into the file still.
    """

    def __init__(
        self,
        target: Source,
        info: RecordingInfo,
        *,
        syncs: bool = True,
        time_error_ns: int = TIME_ERROR_NS,
    ) -> None:
        self.info, self._syncs, self._time_error_ns = info, syncs, time_error_ns
        self.bytes_written = 0  # of the line, without the format's own
        self.bytes_synced = 0  # of these, those that are known to be on the disk
        self.blocks_written = 0
        self.vanished = False
        self.renamed = False  # it has vanished, and has another name
        self._room = bytearray()  # the open chunk: the block's head, and the bytes
        self._crc32 = 0
        self._first_ns = self._last_ns = 0  # of the pieces in the open chunk
        self._shift_min = self._shift_max = 0.0
        self._lost = self._lost_total = 0  # before the open chunk, and in all
        self._times: tuple[int, int] | None = None  # of the first block and the last
        self._synced_ns = 0
        self._dirty = False
        self._whole = 0  # the size of the file up to its last whole block
        self._usable = True
        self._opened: BinaryIO | None = None
        header = _header(info)  # a mistake shows before there is a file
        self._path: Path | None = None
        if isinstance(target, (str, os.PathLike)):
            self._path = Path(target)
            self._opened = file = cast(BinaryIO, self._path.open("xb", buffering=0))
            if not lock(file.fileno()):
                file.close()
                raise FileExistsError(errno.EEXIST, "another program records into it", str(target))
        else:
            file = target
        self._fd = file.fileno()
        self._new_chunk()
        # What the path is compared with; None where the system does not know a file again, as
        # on some network drives.
        self.identity: os.stat_result | None = None
        try:
            with self._naming():
                self._write_block(header)
                self._write_through()
                if self._path is not None:
                    _sync_folder(self._path.absolute().parent)
                    own = os.fstat(self._fd)
                    self.identity = own if _names_file(self._path, own) else None
        except BaseException:
            if self._path is not None:
                file.close()
                self._path.unlink(missing_ok=True)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, data: memoryview | bytes, arrival_ns: int, lost: int = 0) -> None:
        """Take bytes as they were read from the line; their last one came at `arrival_ns`.

        `lost`: bytes of the line that are lost right before these, -1 for an unknown number.
        The bytes are copied. While nothing comes call `poll` every 250 ms or so.
        """
        self._check_usable()
        if lost:
            self._close_chunk()
            self._lost = _sum_lost(self._lost, lost)
        # What is too large for a chunk, in parts: each came before the next on the line.
        for begin in range(0, len(data), CHUNK_MAX):
            part = data[begin : begin + CHUNK_MAX]
            behind = len(data) - begin - len(part)
            self._add(part, count_back(arrival_ns, behind, self.info.byte_ns, self._last_ns))
        self.poll(arrival_ns)

    def poll(self, now_ns: int) -> None:
        """Close a chunk that is 250 ms old, and write through once a second."""
        self._check_usable()
        # A clock that was set back counts as late, here and below.
        if not 0 <= now_ns - self._first_ns < CHUNK_NS:
            self._close_chunk()
        if self._syncs and not 0 <= now_ns - self._synced_ns < _SYNC_NS:
            self._write_through()
            self._synced_ns = now_ns
            self._look_at_name()

    def sync(self) -> None:
        """Close the chunk, and write everything through to the disk."""
        self._check_usable()
        self._close_chunk()
        self._write_through()

    def close(self) -> None:
        """Write what is open, the interface's statistics, and through to the disk."""
        try:
            if self._usable:
                self._close_chunk()
                self._write_block(self._statistics())
                self._write_through()
        finally:
            self._usable = False
            if self._opened is not None and not self._opened.closed:
                with contextlib.suppress(OSError):
                    self._look_at_name()
                self._opened.close()

    def _check_usable(self) -> None:
        if not self._usable:
            raise ValueError("the recording is closed, or its disk was full; start a new one")

    def _add(self, part: memoryview | bytes, arrival_ns: int) -> None:
        """Put a part into the open chunk, or into a new one if it does not fit."""
        held = len(self._room) - _HEAD_LEN
        # When a byte at the start of the chunk would have come for this part to come when it
        # did. Differences between parts are the errors that counting back makes.
        shift = arrival_ns - (held + len(part)) * self.info.byte_ns
        if held and (
            held + len(part) > CHUNK_MAX
            or not 0 <= arrival_ns - self._first_ns < CHUNK_NS
            or max(shift, self._shift_max) - min(shift, self._shift_min) > self._time_error_ns
        ):
            self._close_chunk()
            held = 0
            shift = arrival_ns - len(part) * self.info.byte_ns
        if not held:
            self._first_ns = arrival_ns
            self._shift_min = self._shift_max = shift
        self._shift_min = min(shift, self._shift_min)
        self._shift_max = max(shift, self._shift_max)
        self._last_ns = arrival_ns
        self._crc32 = zlib.crc32(part, self._crc32)
        self._room += part

    def _new_chunk(self) -> None:
        self._room = bytearray(_HEAD_LEN)
        self._crc32 = 0
        self._lost = 0

    def _close_chunk(self) -> None:
        """Write the open chunk, if there is anything in it."""
        count = len(self._room) - _HEAD_LEN
        if not count:
            return
        self._room[:_HEAD_LEN] = pcapng.enhanced_head(count, self._last_ns)
        dropped = _UNKNOWN if self._lost < 0 else self._lost
        self._room += pcapng.enhanced_tail(count, self._crc32, dropped)
        self._write_block(self._room)
        self.bytes_written += count
        self.blocks_written += 1
        self._lost_total += max(self._lost, 0)
        self._times = (self._times[0] if self._times else self._last_ns, self._last_ns)
        self._new_chunk()

    def _write_block(self, block: bytes | bytearray) -> None:
        """Write a block by one call, or leave the file as it was."""
        try:
            with self._naming():
                done = os.write(self._fd, block)
                # The system says why it took a part only when it is asked again.
                while done < len(block):
                    done += os.write(self._fd, memoryview(block)[done:])
        except BaseException:
            self._usable = False
            self._cut()
            with contextlib.suppress(OSError):
                self._write_through()  # the blocks before it
            raise
        self._whole += len(block)
        self._dirty = True

    def _cut(self) -> None:
        """Take the part of a block off the file's end."""
        try:
            os.ftruncate(self._fd, self._whole)
            os.lseek(self._fd, self._whole, os.SEEK_SET)
        except OSError:
            pass  # no regular file: a pipe, a device

    def _write_through(self) -> None:
        if not self._dirty:
            return
        self._dirty = False
        try:
            with self._naming():
                # Without the time of the last change, where the system knows the difference.
                getattr(os, "fdatasync", os.fsync)(self._fd)
        except OSError as error:
            if error.errno not in _NO_SYNC:
                # The system may have dropped what it could not write. It tells that once: a
                # second call would succeed.
                self._usable = False
                raise
        self.bytes_synced = self.bytes_written

    def _look_at_name(self) -> None:
        """See whether the path is still the name of the file."""
        if self.identity is not None and self._path is not None:
            self.vanished = self.vanished or not _names_file(self._path, self.identity)
            self.identity = os.fstat(self._fd)
            self.renamed = self.vanished and self.identity.st_nlink > 0

    @contextlib.contextmanager
    def _naming(self) -> Iterator[None]:
        """Let an error name the file."""
        try:
            yield
        except OSError as error:
            if error.filename is None and self._path is not None:
                error.filename = str(self._path)
            raise

    def _statistics(self) -> bytes:
        """Return the block that ends a recording that was closed."""
        times = () if self._times is None else zip((_START, _END), self._times, strict=True)
        options = [(code, _split_time(ts)) for code, ts in times]
        options.append((_RECEIVED, struct.pack("<Q", self.bytes_written)))
        lost = self._lost_total + max(self._lost, 0)
        options.append((_DROPPED, struct.pack("<Q", lost)))
        fixed = struct.pack("<I", 0) + _split_time(time.time_ns())
        return pcapng.block(pcapng.STATISTICS, fixed, options)


def _names_file(path: str | Path, file: os.stat_result) -> bool:
    """Return whether a path is the name of a file. Where that cannot be told it is."""
    try:
        return os.path.samestat(os.stat(path), file)  # noqa: PTH116
    except OSError as error:
        return error.errno not in _NO_FILE


def _sum_lost(before: int, more: int) -> int:
    """Return the sum of two numbers of lost bytes, -1 if one is not known."""
    return -1 if before < 0 or more < 0 else before + more


def _split_time(ts: int) -> bytes:
    return struct.pack("<II", ts >> 32, ts & 0xFFFF_FFFF)


def _header(info: RecordingInfo) -> bytes:
    """Return the blocks that start a recording."""
    # Imported where they are used: they take 20 ms, and readers need neither.
    import platform  # noqa: PLC0415
    from importlib.metadata import version  # noqa: PLC0415

    section = pcapng.block(
        pcapng.SECTION,
        # Version 1.0; how long the section gets is not known.
        struct.pack("<IHHq", pcapng.MAGIC, 1, 0, -1),
        [
            (_COMMENT, _ABOUT.encode()),
            (_OS, f"{platform.system()} {platform.release()}".encode()),
            (_APPLICATION, f"canser {version('canser')}".encode()),
        ],
    )
    facts = {
        "protocol": info.protocol,
        "baudrate": info.baudrate,
        "bitrate": info.bitrate,
        "ts_unit": info.ts_unit,
    }
    words = [f"{name}={value}" for name, value in facts.items() if value is not None]
    interface = pcapng.block(
        pcapng.INTERFACE,
        struct.pack("<HHI", _LINK_TYPE, 0, 0),  # 0: packets are never cut short
        [
            (_NAME, info.device.encode("utf-8", "surrogateescape")),
            (_DESCRIPTION, " ".join([_SIGN, *words]).encode()),
            (_SPEED, struct.pack("<Q", info.baudrate)),
            (_RESOLUTION, _NANOSECONDS),
        ],
    )
    return section + interface


def _sync_folder(folder: Path) -> None:
    """Sync the directory, or a crash may leave the data without a name."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise
    finally:
        os.close(descriptor)


class Recording(Iterator[DataBlock]):
    """The blocks of bytes of a recording in order: an iterator; a context manager.

    `source`: a path, or a file open for reading bytes, from where it stands; of any size,
    in bounded memory; a pipe is read as its bytes come. `.info` tells of the line. The data of
    a block is a view of the file, with the times of recordings behind one another as they are.

    What is torn or damaged is left out and named in `.remarks`; the block behind it has a
    gap of unknown length. Recordings of the same line may follow each other in the file;
    blocks of other kinds and interfaces are skipped. RecordingError if there is no interface
    of canser's; OSError for a file that cannot be read.
    """

    def __init__(self, source: Source | Input) -> None:
        self._input = source if isinstance(source, Input) else Input(source)
        try:
            self._walk = _Walk(self._input)
            self.info = self._walk.find_interface()
        except BaseException:
            self.close()
            raise

    def __next__(self) -> DataBlock:
        for block in self._walk:
            if block.piece is not None:
                return block.piece
        self.close()
        raise StopIteration

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

    What comes behind something that is left out gets the drop count of a gap of unknown
    length, so that reading the copy gives what reading the damaged file gives.
    RecordingError if there is no interface of canser's.
    """
    walk = _Walk(Input(source))
    blocks = bytes_kept = 0
    for block in walk:
        whole: memoryview | bytearray = block.whole
        if block.kind == pcapng.SECTION:
            # Its length may not hold any more; "unknown" always does.
            whole = bytearray(whole)
            whole[_SECTION_LENGTH] = b"\xff" * 8
        elif block.piece is not None:
            blocks += 1
            bytes_kept += len(block.piece.data)
            if block.piece.lost < 0:
                whole = bytearray(whole)
                whole[block.dropped_at : block.dropped_at + 8] = _UNKNOWN.to_bytes(8)
        target.write(whole)
    if walk.info is None:
        raise RecordingError(walk.nothing())
    return Recovered(walk.info, blocks, bytes_kept, walk.left_out, walk.remarks)


class _Block(NamedTuple):
    """A block that is good, and the piece in it if it is one of ours."""

    kind: int
    whole: memoryview
    piece: DataBlock | None = None
    dropped_at: int = 0


class _Walk(Iterator[_Block]):
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
        self._skipped = 0  # blocks that are good and none of ours
        # What the next piece tells of what lies before it.
        self._gap = self._lost = False
        self._blocks = self._run()

    def __next__(self) -> _Block:
        return next(self._blocks)

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

    def _run(self) -> Iterator[_Block]:
        while self._input.at(self.at, 1):
            block = self._check(self.at)
            if isinstance(block, str):
                if self._damaged is None:
                    self._damaged = self.at, block
                self.at = self._resume(self.at)
                continue
            if self._damaged is not None:
                self._end_damage("left out")
            if block.piece is not None:
                self._gap = self._lost = False
            else:
                self._enter(block)
            self.at += len(block.whole)
            yield block
        if self._damaged is not None:
            self._end_damage("torn tail, left out")
        if self._skipped:
            self.remarks.append(f"blocks that are none of canser's, skipped: {self._skipped:,}")

    def _end_damage(self, what: str) -> None:
        assert self._damaged is not None
        begin, why = self._damaged
        self._damaged = None
        self.left_out += self.at - begin
        self._gap = self._lost = True
        if len(self.remarks) < _REMARKS_KEPT:
            size = self.at - begin
            self.remarks.append(f"{what}: {size:,} bytes at byte {begin:,}: {why}")
        elif len(self.remarks) == _REMARKS_KEPT:
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
        order = pcapng.section_order(head) if head[:4] == _SECTION_MARK else self._order
        if order is None:
            return None
        length = pcapng.u32(head, 4, order)
        fits = pcapng.LENGTH_MIN <= length <= pcapng.LENGTH_MAX and length % 4 == 0
        return length if fits else None

    def _check(self, at: int) -> _Block | str:
        """Return the block there if it is good, else what is wrong; nothing is changed."""
        whole = self._whole(at)
        if isinstance(whole, str):
            return whole
        if whole[:4] == _SECTION_MARK:
            order = pcapng.section_order(whole)
            if order is None or len(whole) < _SECTION_MIN or pcapng.u16(whole, 12, order) != 1:
                return "the section is of a version that is not known"
            return _Block(pcapng.SECTION, whole)
        assert self._order is not None
        kind = pcapng.u32(whole, 0, self._order)
        if kind == pcapng.ENHANCED:
            return self._check_enhanced(whole)
        # An unknown block is skipped; but what is one of ours in all but its type was one.
        meant = self._check_enhanced(whole)
        if isinstance(meant, _Block) and meant.piece is not None:
            return "the type of the block is damaged"
        return _Block(kind, whole)

    def _check_enhanced(self, whole: memoryview) -> _Block | str:
        assert self._order is not None
        packet = Enhanced.read(whole, self._order)
        if packet is None:
            return "what is inside the block does not fit into it"
        if packet.interface >= self._interfaces:
            return "the block's interface is not described"
        if packet.interface != self._ours:
            return _Block(pcapng.ENHANCED, whole)
        if packet.crc32 is None or packet.dropped is None or packet.ts >> 63:
            return "the block is not as canser writes it"
        if zlib.crc32(packet.data) != packet.crc32:
            return "the CRC32 of the block does not hold"
        # Asked before the damage is done with, so that a block tried here is the block taken.
        damaged = self._lost or self._damaged is not None
        lost = -1 if damaged or packet.dropped == _UNKNOWN else packet.dropped
        piece = DataBlock(packet.data, packet.ts, lost, lost != 0 or self._gap)
        return _Block(pcapng.ENHANCED, whole, piece, packet.dropped_at)

    def _enter(self, block: _Block) -> None:
        """Take note of a block that is no piece."""
        if block.kind == pcapng.SECTION:
            self._gap = self._order is not None  # it goes on behind another recording
            self._order = pcapng.section_order(block.whole)
            self._interfaces, self._ours = 0, -1
        elif block.kind == pcapng.INTERFACE:
            self._interfaces += 1
            self._enter_interface(block)
        elif block.kind != pcapng.STATISTICS:
            self._skipped += 1

    def _enter_interface(self, block: _Block) -> None:
        assert self._order is not None
        info = _read_interface(block.whole, self._order)
        if info is None:
            return
        first = self.info or info
        same = (info.protocol, info.baudrate, info.ts_unit) == (
            *(first.protocol, first.baudrate, first.ts_unit),
        )
        if same and self._ours < 0:
            self.info = first
            self._ours = self._interfaces - 1
        else:
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
        """Return the next place of a section, or of a piece whose CRC32 holds; or the end.

        Anywhere, not in steps of 4: a file may be put behind one that is torn.
        """
        marks = [_SECTION_MARK]
        if self._order is not None:
            marks.append(struct.pack(f"{self._order}I", pcapng.ENHANCED))
        search = re.compile(b"|".join(map(re.escape, marks)))
        while True:
            view = self._input.at(at, _SCAN)
            for found in search.finditer(view):
                block = self._check(at + found.start())
                if isinstance(block, _Block) and (block.kind == pcapng.SECTION or block.piece):
                    return at + found.start()
            if len(view) < _SCAN:
                return at + len(view)
            at += len(view) - len(_SECTION_MARK) + 1


def _read_interface(whole: memoryview, order: Order) -> RecordingInfo | None:
    """Return what an interface block tells of a line, None if it is none of ours."""
    if len(whole) < _INTERFACE_MIN or pcapng.u16(whole, 8, order) != _LINK_TYPE:
        return None
    values = {
        code: bytes(whole[at : at + length])
        for code, at, length in pcapng.options(whole, _INTERFACE_OPTIONS, order)
    }
    sign, *words = values.get(_DESCRIPTION, b"").decode("utf-8", "replace").split(" ")
    facts = dict(word.split("=", 1) for word in words if "=" in word)
    bitrate = facts.get("bitrate", "1")
    numbers = (facts.get("baudrate", ""), bitrate)
    if (
        sign != _SIGN
        or not {"protocol", "ts_unit"} <= facts.keys()
        or not all(re.fullmatch("[1-9][0-9]{0,17}", number) for number in numbers)
        or values.get(_RESOLUTION) != _NANOSECONDS
    ):
        return None
    return RecordingInfo(
        protocol=facts["protocol"],
        baudrate=int(facts["baudrate"]),
        bitrate=int(bitrate) if "bitrate" in facts else None,
        ts_unit=facts["ts_unit"],
        device=values.get(_NAME, b"").decode("utf-8", "surrogateescape"),
    )
