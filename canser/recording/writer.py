"""Write recordings: the raw bytes of a serial line with their times, append-only."""

import contextlib
import errno
import os
import struct
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final, Self, cast

from canser._guards import Uncopied
from canser._input import Source
from canser.recording import pcapng
from canser.recording._lock import lock
from canser.recording.header import RecordingInfo, make_header
from canser.recording.ids import make_base, skipped_by
from canser.timing.arrivals import count_back

__all__ = ["RecordingWriter"]

# The most bytes in a chunk, and the time after its first byte at which a chunk is closed.
CHUNK_MAX: Final = 1 << 16
CHUNK_NS: Final = 250_000_000

# The largest error of a time inside a chunk. A reader knows the arrival of a chunk's last byte, and
# counts back from there at the baud rate. A chunk ends before that would be wrong by more than
# this: about the error that a USB frame and the scheduler add to each arrival anyway.
# So the silence inside a chunk is at most this long, and besides full chunks there are at most 500
# chunks per second: 32 kB/s, at 64 bytes each. (2,000 frames per second, read one by one at
# 2,000,000 baud, make chunks of 5 frames: 26 kB/s for as many bytes of frames.)
# If bytes arrive faster than the nominal baud rate (a pseudo terminal), a chunk is split once
# counting back at that rate would be wrong by more than this.
TIME_ERROR_NS: Final = 2_000_000

# The time between two syncs to the disk.
_SYNC_NS: Final = 1_000_000_000

# Codes of options of the interface statistics, from the pcapng draft.
_START, _END, _RECEIVED, _DROPPED = 2, 3, 4, 5

_HEAD_LEN: Final = pcapng.ENHANCED_HEAD_LEN

# The most bytes in a note: the length of an option has 16 bits.
_NOTE_MAX: Final = (1 << 16) - 1

# Errors of fsync on a file that needs no sync: a pipe, a terminal.
_NO_SYNC: Final = {errno.EINVAL, errno.ENOTSUP, errno.EROFS}

# Errors for a name that does not exist any more, alone or with its folder.
_NO_FILE: Final = {errno.ENOENT, errno.ENOTDIR, errno.ESTALE}


class RecordingWriter(Uncopied):
    """Writes a recording, block by block; a context manager. For one thread at a time.

    Each block is written whole, by one call of the system, and synced to the disk once per second.
    After a crash at any moment all blocks are valid, except the last one. A path is locked until
    `close`.

    Parameters
    ----------
    target
        The path of a file that does not exist, or an empty file that is open for writing. The
        descriptor of such a file is used.
    info
        The line that is recorded.
    syncs
        Whether to sync once per second. Otherwise the file is synced at its end only; this is for
        data that can be made again.
    time_error_ns
        The largest error of a time inside a chunk. A chunk ends before counting back at the baud
        rate would be wrong by more than this.

    Attributes
    ----------
    vanished : bool
        Whether the path is no longer the name of the file, which was removed, replaced or renamed.
        Checked once per second and by `close`. Bytes are still written into that file.

    Raises
    ------
    FileExistsError
        The path exists already.
    OSError
        The disk is full: the file then ends with its last whole block, the open chunk is lost, and
        the writer cannot be used any more. Or a sync has failed: bytes behind `bytes_synced` may
        be lost. The error names the path.
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
        self.bytes_written = 0  # bytes of the line, without those of the format
        self.bytes_synced = 0  # bytes of the line that are known to be on the disk
        self.blocks_written = 0
        self.vanished = False
        self.renamed = False  # the file has vanished, and has another name
        self._room = bytearray()  # the open chunk: the head of its block, and its bytes
        self._crc32 = 0
        self._first_ns = self._last_ns = 0  # arrivals of the pieces in the open chunk
        self._shift_min = self._shift_max = 0.0
        self._lost = self._lost_total = 0  # lost bytes before the open chunk, and in all
        self._notes: list[bytes] = []  # notes for the open chunk
        base = make_base()
        self._next_id = base  # id of the open chunk if no bytes are lost before it
        self._times: tuple[int, int] | None = None  # times of the first block and the last
        self._synced_ns = 0
        self._dirty = False
        self._whole = 0  # bytes of the file up to the end of its last whole block
        self._usable = True
        self._opened: BinaryIO | None = None
        header = make_header(info, base)  # first, so that an error leaves no file
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
        # What the path is compared with. None if the system cannot recognise a file, as on some
        # network drives.
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
        """Write bytes as they were read from the line. The bytes are copied.

        While no bytes arrive, call `poll` about every 250 ms.

        Parameters
        ----------
        data
            The bytes; may be empty.
        arrival_ns
            Arrival of the last byte, in nanoseconds since 1970.
        lost
            Bytes of the line that are lost right before these, -1 for an unknown number. They are
            recorded even if no bytes follow.
        """
        self._check_usable()
        if lost:
            self._close_chunk()
            self._lost = _sum_lost(self._lost, lost)
            self._last_ns = arrival_ns
        # Bytes that do not fit one chunk are split. The arrival of each part is counted back.
        for begin in range(0, len(data), CHUNK_MAX):
            part = data[begin : begin + CHUNK_MAX]
            behind = len(data) - begin - len(part)
            self._add(part, count_back(arrival_ns, behind, self.info.byte_ns, self._last_ns))
        self.poll(arrival_ns)

    def note(self, text: str, now_ns: int) -> None:
        """Put a note between the bytes so far and those to come, such as that a clock was set."""
        self._check_usable()
        note = text.encode("utf-8", "surrogateescape")
        if len(note) > _NOTE_MAX:
            raise ValueError(f"the note has {len(note):,} bytes; {_NOTE_MAX:,} are possible")
        self._close_chunk()
        self._notes.append(note)
        self._last_ns = now_ns

    def poll(self, now_ns: int) -> None:
        """Close the chunk if it is 250 ms old, and sync if the last sync is a second ago."""
        self._check_usable()
        # Here and below: if the clock was set back, the time is over, too.
        if not 0 <= now_ns - self._first_ns < CHUNK_NS:
            self._close_chunk()
        if self._syncs and not 0 <= now_ns - self._synced_ns < _SYNC_NS:
            self._write_through()
            self._synced_ns = now_ns
            self._look_at_name()

    def sync(self) -> None:
        """Write the open chunk, and sync everything to the disk."""
        self._check_usable()
        self._close_all()
        self._write_through()

    def close(self) -> None:
        """Write the open chunk and the interface's statistics, sync, and close the file."""
        try:
            if self._usable:
                self._close_all()
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
        # The start of the chunk, counted back from the arrival of this part. Where two parts
        # differ in it, counting back is wrong by the difference.
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
        self._notes = []

    def _close_chunk(self) -> None:
        """Write the open chunk if it has bytes."""
        if len(self._room) > _HEAD_LEN:
            self._write_chunk()

    def _close_all(self) -> None:
        """Write the open chunk if it has bytes, lost bytes or notes."""
        if len(self._room) > _HEAD_LEN or self._lost or self._notes:
            self._write_chunk()

    def _write_chunk(self) -> None:
        count = len(self._room) - _HEAD_LEN
        dropped = pcapng.UNKNOWN if self._lost < 0 else self._lost
        packet_id = (self._next_id + skipped_by(self._lost)) % (1 << 64)
        self._room[:_HEAD_LEN], tail = pcapng.enhanced(
            count,
            self._last_ns,
            crc32=self._crc32,
            dropped=dropped,
            packet_id=packet_id,
            comments=self._notes,
        )
        self._room += tail
        self._write_block(self._room)
        self._next_id = packet_id + count
        self.bytes_written += count
        self.blocks_written += 1
        self._lost_total += max(self._lost, 0)
        self._times = (self._times[0] if self._times else self._last_ns, self._last_ns)
        self._new_chunk()

    def _write_block(self, block: bytes | bytearray) -> None:
        """Write a block by one call of the system. After an error the file is as it was before."""
        try:
            with self._naming():
                done = os.write(self._fd, block)
                # If only a part was written, the next call gets the error that is the reason.
                while done < len(block):
                    done += os.write(self._fd, memoryview(block)[done:])
        except BaseException:
            self._usable = False
            self._cut()
            with contextlib.suppress(OSError):
                self._write_through()  # for the blocks before this one
            raise
        self._whole += len(block)
        self._dirty = True

    def _cut(self) -> None:
        """Remove a part of a block from the end of the file."""
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
                # fdatasync, if the system has it, does not wait for the file's times.
                getattr(os, "fdatasync", os.fsync)(self._fd)
        except OSError as error:
            if error.errno not in _NO_SYNC:
                # The system may have dropped what it could not write. It reports that only once:
                # a second call would succeed, without the data on the disk.
                self._usable = False
                raise
        self.bytes_synced = self.bytes_written

    def _look_at_name(self) -> None:
        """Check whether the path is still the name of the file."""
        if self.identity is not None and self._path is not None:
            self.vanished = self.vanished or not _names_file(self._path, self.identity)
            self.identity = os.fstat(self._fd)
            self.renamed = self.vanished and self.identity.st_nlink > 0

    @contextlib.contextmanager
    def _naming(self) -> Iterator[None]:
        """Put the path into an OSError that has none."""
        try:
            yield
        except OSError as error:
            if error.filename is None and self._path is not None:
                error.filename = str(self._path)
            raise

    def _statistics(self) -> bytes:
        """Return the interface statistics, the last block of a recording that was closed."""
        times = () if self._times is None else zip((_START, _END), self._times, strict=True)
        options = [(code, _split_time(ts)) for code, ts in times]
        options.append((_RECEIVED, struct.pack("<Q", self.bytes_written)))
        options.append((_DROPPED, struct.pack("<Q", self._lost_total)))
        fixed = struct.pack("<I", 0) + _split_time(time.time_ns())
        return pcapng.block(pcapng.STATISTICS, fixed, options)


def _names_file(path: str | Path, file: os.stat_result) -> bool:
    """Return whether a path is the name of a file; True if that cannot be found out."""
    try:
        return os.path.samestat(os.stat(path), file)  # noqa: PTH116
    except OSError as error:
        return error.errno not in _NO_FILE


def _sum_lost(before: int, more: int) -> int:
    """Return the sum of two numbers of lost bytes, -1 if one of them is not known."""
    return -1 if before < 0 or more < 0 else before + more


def _split_time(ts: int) -> bytes:
    return struct.pack("<II", ts >> 32, ts & 0xFFFF_FFFF)


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
