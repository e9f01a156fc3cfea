"""Record the bytes of a live port: into one file, a rotation of files, or around triggers."""

import contextlib
import errno
import os
import re
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from canser._guards import Uncopied
from canser.errors import OutputExistsError
from canser.recording._lock import is_locked
from canser.recording._old import OldFile, check_replaceable
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter
from canser.timing.arrivals import DataBlock, count_back
from canser.timing.host import describe_step

__all__ = ["MEMORY", "SUFFIX", "FileEvent", "RecordingFiles"]

SUFFIX: Final = ".pcapng"

# The most memory for bytes that wait for a trigger, in bytes; and about the memory that a block
# takes besides its data, in Python objects.
MEMORY: Final = 1 << 26
_BLOCK_MEMORY: Final = 200

# The most bytes that the format adds at the start and the end of a file, and to each block.
_FILE_OVERHEAD: Final = 1024
_BLOCK_OVERHEAD: Final = 72


class FileEvent(NamedTuple):
    """What happened to a file, or the trigger that began it."""

    #: "opened", "closed", "deleted", "vanished" or "trigger"; for an old file that was set aside
    #: "restored", or "set_aside" if it keeps its new name.
    kind: str
    #: Path of the file; for a trigger that of the open file, "" if there is none.
    path: str
    #: Nanoseconds since 1970.
    ts: int
    #: Bytes of the line that are lost with a file that has vanished.
    lost: int = 0
    #: Whether a file that has vanished has another name. Then its bytes are not lost.
    renamed: bool = False


class _OwnFile(NamedTuple):
    """A file of this run, and the identity by which it is recognised."""

    path: str
    identity: os.stat_result | None  # None if the system cannot recognise a file
    closed: bool = False

    def is_there(self) -> bool:
        """Return whether the path is still the name of the file."""
        try:
            there = os.stat(self.path)  # noqa: PTH116
        except OSError:
            return False
        if self.identity is None:
            return True
        # Compare the size, too: the inode number of a deleted file is soon used again.
        same_size = not self.closed or there.st_size == self.identity.st_size
        return same_size and os.path.samestat(there, self.identity)


@dataclass(frozen=True, slots=True)
class _Segment:
    """Bytes between two borders of packets: no packet is partly inside."""

    blocks: list[DataBlock]
    begin_ns: int  # arrival of the first byte
    size: int  # bytes

    @property
    def end_ns(self) -> int:
        return self.blocks[-1].arrival_ns


class RecordingFiles(Uncopied):
    """Puts the bytes of a port into recordings.

    `write` takes the bytes, as the `on_bytes` of a port does. `advance` then takes the end of the
    decoded packets, and records the bytes before it. Files begin and end between two packets, so
    each can be decoded by itself.

    With `size`, `period_ns` or `window_ns` the files are numbered: `NAME-000001.pcapng` and so on.
    The numbers continue those of files that exist already.

    With `window_ns` only the bytes around a trigger are recorded, a file for each trigger. Triggers
    whose windows touch share a file, without a gap inside. Bytes that may be needed for a trigger
    wait in memory, MEMORY bytes at most.

    A file that is removed, replaced or renamed while it is open has vanished. The next bytes go
    into a new file: of the same name, or a numbered one if files are numbered or another file has
    that name. A folder that is gone is made again. The bytes of a renamed file count as recorded,
    those of other files that have vanished are `bytes_vanished`. OSError if another recorder has
    the name.

    After `close`, `bytes_in == bytes_recorded + bytes_passed + bytes_vanished`, if the disk was
    never full.

    OSError of the disk from `start`, `advance` and `close`: nothing more is written after it.
    `bytes_recorded` are on the disk, and `bytes_unsure` may be.

    Parameters
    ----------
    path
        The file; its name ends in SUFFIX.
    info
        The line that is recorded.
    size
        The most bytes of a file, 1 or more.
    period_ns
        The longest time in a file, in nanoseconds, 1 or more.
    window_ns
        The times to record before and after a trigger, in nanoseconds.
    keep
        The number of files made here that are kept, the newest ones; all by default.
    force
        Replace files of these names; numbers begin with 1. The old file is NAME.old until the first
        bytes of the line are on the disk. If none ever are, it gets its name back.

    Raises
    ------
    FileExistsError, FileNotFoundError, PermissionError
        No recording can be made at `path`. The constructor makes no file.
    """

    def __init__(
        self,
        path: str,
        info: RecordingInfo,
        *,
        size: int | None = None,
        period_ns: int | None = None,
        window_ns: tuple[int, int] | None = None,
        keep: int | None = None,
        force: bool = False,
    ) -> None:
        self._path = Path(os.path.realpath(path))
        self._info, self._force = info, force
        self._size, self._period_ns, self._window_ns = size, period_ns, window_ns
        self._keep = keep
        self._numbered = not (size is None and period_ns is None and window_ns is None)
        if not path.lower().endswith(SUFFIX):
            raise ValueError(f"{path} is no name of a recording; it must end in {SUFFIX}")
        for name, value in (("size", size), ("period_ns", period_ns), ("keep", keep)):
            if value is not None and value < 1:
                raise ValueError(f"{name} is {value}; it must be 1 or more")
        if window_ns is not None and min(window_ns) < 0:
            raise ValueError(f"window_ns is {window_ns}; times before and after are 0 or more")
        if keep is not None and not self._numbered:
            raise ValueError("keep is about rotation; to rotate files give their size or time, too")
        self._number = self._last_number(path)

        self.bytes_in = 0
        self.bytes_passed = 0  # bytes not recorded because no trigger was near
        self.bytes_vanished = 0  # bytes in files that were removed while they were open
        self.vanished = 0  # files that were removed, replaced or renamed while they were open
        self.bytes_unsure = 0  # bytes that were written, but are not known to be on the disk
        self.triggers = 0
        self.files = 0  # files that were opened
        self.out_of_memory = False  # whether MEMORY was too small for the bytes before a trigger
        self.events: deque[FileEvent] = deque()  # the caller removes them
        # Why nothing more is recorded: an error of the disk, or an interrupt, perhaps inside a
        # block.
        self.error: BaseException | None = None
        self._recorded = 0  # bytes in files that are closed
        self._fresh: deque[DataBlock] = deque()  # blocks that are not known to be decoded
        self._settled = 0  # stream offset of the first byte in `_fresh`
        self._settled_ns = 0  # arrival of the byte before it
        self._waiting: deque[_Segment] = deque()  # segments that wait for a trigger
        self._waiting_size = 0  # their memory, in bytes
        self._until_ns = 0  # the end of the window: bytes that arrive until then are recorded
        self._writer: RecordingWriter | None = None
        self._file = ""
        self.last_file = ""  # path of the file that was opened last
        self._file_ns = self._file_bytes = 0
        self._last_ns = 0  # arrival of the bytes that were recorded last
        # How far the system's clock is ahead of the clock that arrivals are from: now, and at the
        # start of the open file.
        self._ahead_ns = self._file_ahead_ns = 0
        self._old: OldFile | None = None  # the file that `force` set aside for the open file
        self._own: deque[_OwnFile] = deque()  # files of this run that were not deleted

    @property
    def bytes_recorded(self) -> int:
        """Bytes of the line in files; after an error, those that are known to be on the disk."""
        if self._writer is None:
            return self._recorded
        writer = self._writer
        written = writer.bytes_written if self.error is None else writer.bytes_synced
        return self._recorded + written

    @property
    def file(self) -> str:
        """The path of the open file, "" if there is none."""
        return self._file

    @property
    def file_bytes(self) -> int:
        """Bytes of the line that were written into the open file."""
        return self._file_bytes

    @property
    def recording(self) -> bool:
        """Whether the next bytes are recorded, and do not wait for a trigger."""
        return self._writer is not None and not self._waiting

    @property
    def files_kept(self) -> list[str]:
        """The paths of the files of this run that exist, oldest first."""
        return [own.path for own in self._own if own.is_there()]

    @property
    def files_made(self) -> list[str]:
        """The paths of the files of this run that it has not deleted; the disk is not read."""
        return [own.path for own in self._own]

    def start(self, now_ns: int) -> None:
        """Open the first file, unless files wait for triggers."""
        if self._window_ns is None:
            self._open(now_ns)

    def write(self, data: memoryview | bytes, arrival_ns: int, lost: int = 0) -> None:
        """Take bytes as they arrived. The arguments are those of a port's `on_bytes`.

        A call without bytes at the end reports `lost` bytes that no others have followed.
        """
        self._fresh.append(DataBlock(bytes(data), arrival_ns, lost))
        self.bytes_in += len(data)

    def advance(self, border: int, now_ns: int, triggers: Iterable[int] = ()) -> None:
        """Record the bytes before the stream offset `border`, at which a packet has ended.

        `triggers`: times of triggers in these bytes, in nanoseconds since 1970, ascending. The
        bytes are recorded in any case, even if a trigger's time is not in their arrivals.
        """
        self._move_on(border, triggers)
        if self._writer is not None and self.error is None:
            with self._breaking():
                self._writer.poll(now_ns + self._file_ahead_ns)
            self._settle_old(self._writer, closed=False)
            if self._writer.vanished:
                self._replace(now_ns)

    def _move_on(self, border: int, triggers: Iterable[int] = ()) -> None:
        if self.error is not None:
            return
        segment = self._settle(border)
        if self._window_ns is None:
            if segment is not None:
                self._record(segment)
        else:
            if segment is not None:
                self._waiting.append(segment)
                self._waiting_size += _memory(segment)
            for ns in triggers:
                self._trigger(ns)
            if self._waiting:
                self._record_or_pass(self._waiting[-1].end_ns - self._window_ns[0])
            while self._waiting_size > MEMORY:
                self.out_of_memory = True
                self._pass_oldest()

    def clock_was_set(self, step_ns: int, now_ns: int) -> None:
        """Use the new time of the system's clock, which was set, in the next files.

        The open file continues with the time that it began with, and gets a note.
        """
        self._ahead_ns += step_ns
        if self._writer is not None and self.error is None:
            with self._breaking():
                self._writer.note(
                    f"{describe_step(step_ns)}; this recording goes on as before",
                    now_ns + self._file_ahead_ns,
                )

    def arrival_of(self, offset: int) -> int:
        """Return the arrival of the byte at a stream offset that `advance` has not reached."""
        at = self._settled
        for block in self._fresh:
            at += len(block.data)
            if offset < at:
                return block.arrival_ns
        return self._last_ns

    def close(self) -> None:
        """Record the remaining bytes, and close the file. May be called again."""
        try:
            if self._window_ns is not None or self._writer is not None:
                self._move_on(self.bytes_in)
            while self._waiting and self.error is None:
                self._pass_oldest()
        finally:
            self._close_file()

    def _settle(self, border: int) -> _Segment | None:
        """Remove the bytes before a stream offset from `_fresh`, and return them."""
        blocks: list[DataBlock] = []
        begin, byte_ns = self._settled, self._info.byte_ns
        # A block without bytes may be at the end: it reports lost bytes that none have followed.
        while self._fresh and (self._settled < border or not self._fresh[0].data):
            block = self._fresh.popleft()
            fits, behind = border - self._settled, 0
            if fits < len(block.data):
                behind = len(block.data) - fits
                self._fresh.appendleft(block._replace(data=block.data[fits:], lost=0))
                came = count_back(block.arrival_ns, behind, byte_ns, self._settled_ns)
                block = block._replace(data=block.data[:fits], arrival_ns=came)
            if not blocks:
                begin_ns = count_back(block.arrival_ns, len(block.data), byte_ns, self._settled_ns)
            self._settled += len(block.data)
            self._settled_ns = block.arrival_ns
            blocks.append(block)
        if not blocks:
            return None
        return _Segment(blocks, begin_ns, self._settled - begin)

    def _trigger(self, ns: int) -> None:
        assert self._window_ns is not None
        before, after = self._window_ns
        self.triggers += 1
        # Bytes that are too old for this trigger are too old for later ones.
        self._record_or_pass(ns - before)
        if ns > self._until_ns:
            self.events.append(FileEvent("trigger", self._file, ns))
        self._until_ns = max(self._until_ns, ns + after)
        if self._waiting:
            # The frame that triggered is in the last segment, whatever its own time says.
            self._until_ns = max(self._until_ns, self._waiting[-1].begin_ns)

    def _record_or_pass(self, oldest_ns: int) -> None:
        """Record the waiting bytes that are inside a window, and pass over those before a time."""
        while self._waiting:
            segment = self._waiting[0]
            if segment.begin_ns <= self._until_ns:
                self._waiting.popleft()
                self._waiting_size -= _memory(segment)
                self._record(segment)
            elif segment.end_ns < oldest_ns and len(self._waiting) > 1:
                self._pass_oldest()
            else:
                break

    def _pass_oldest(self) -> None:
        segment = self._waiting.popleft()
        self._waiting_size -= _memory(segment)
        self.bytes_passed += segment.size
        # Close the file: otherwise later bytes would look contiguous with earlier ones.
        self._close_file()

    def _record(self, segment: _Segment) -> None:
        if self._size is None or segment.size <= self._size:
            self._write(segment.blocks, segment.begin_ns, segment.size)
            return
        # Otherwise noise, in which no packet ends, would make a file larger than `size`.
        for block in segment.blocks:
            self._write([block], block.arrival_ns, len(block.data))

    def _write(self, blocks: list[DataBlock], begin_ns: int, size: int) -> None:
        if self._writer is None or self._is_full(blocks, size):
            self._close_file()
            self._open(begin_ns)
        assert self._writer is not None
        if not self._file_bytes:
            self._file_ns = begin_ns  # not the opening: the first file may be open for long before
        for block in blocks:
            with self._breaking():
                self._writer.write(block.data, block.arrival_ns + self._file_ahead_ns, block.lost)
        self._file_bytes += size
        self._last_ns = blocks[-1].arrival_ns

    def _is_full(self, more: list[DataBlock], size: int) -> bool:
        """Return whether blocks, with `size` bytes in all, are too much for the open file."""
        assert self._writer is not None
        if not self._file_bytes:
            return False
        if self._period_ns is not None and more[-1].arrival_ns - self._file_ns > self._period_ns:
            return True
        # The open chunk makes one more block, and each of the new blocks may make one.
        blocks = self._writer.blocks_written + 1 + len(more)
        overhead = _FILE_OVERHEAD + blocks * _BLOCK_OVERHEAD
        return self._size is not None and self._file_bytes + size + overhead > self._size

    def _replace(self, now_ns: int) -> None:
        """Continue in a new file, because the open one has vanished."""
        file = self._file
        self._close_file()
        with contextlib.suppress(PermissionError):  # whether the name is locked is not known
            if is_locked(Path(file)):
                self.error = OSError(errno.EBUSY, "another program records into it now", file)
                raise self.error
        if self._window_ns is None:
            self._open(now_ns)

    def _open(self, ns: int) -> None:
        if self.vanished:
            with self._breaking():
                self._path.parent.mkdir(parents=True, exist_ok=True)
        while True:
            self._number += self._numbered
            path = self._name(self._number)
            try:
                with self._breaking():
                    self._writer = self._create(path)
                break
            except FileExistsError:
                if self.vanished:
                    self._numbered = True  # do not replace the file that has the name now
                if not self._numbered:
                    raise
                # Another program makes numbered files here, too. Try the next number.
        self._file, self._file_ns, self._file_bytes = str(path), ns, 0
        self._file_ahead_ns = self._ahead_ns
        self.files += 1
        self.last_file = self._file
        self._own.append(_OwnFile(self._file, self._writer.identity))
        self.events.append(FileEvent("opened", self._file, ns))
        if self._keep is not None and len(self._own) > self._keep:
            oldest = self._own.popleft()
            # Delete only our own file: another one may have its name now.
            if oldest.is_there():
                Path(oldest.path).unlink(missing_ok=True)
                self.events.append(FileEvent("deleted", oldest.path, ns))

    def _create(self, path: Path) -> RecordingWriter:
        """Return the writer of a new file. An old file is set aside if it may be replaced."""
        old = OldFile(path) if self._force and os.path.lexists(path) else None
        try:
            writer = RecordingWriter(path, self._info)
        except BaseException:
            if old is not None:
                old.put_back()
            raise
        self._old = old
        return writer

    def _settle_old(self, writer: RecordingWriter, *, closed: bool) -> None:
        """Delete the file that was set aside, or put it back, once one of them is certain."""
        old = self._old
        if old is None:
            return
        gone = writer.vanished and not writer.renamed
        try:
            if writer.bytes_synced and not gone:
                old.delete()
            elif not closed:
                return
            elif not writer.bytes_written and not writer.vanished:
                old.put_back()
                self._own.pop()
                self.events.append(FileEvent("restored", str(old.name), self._last_ns))
            else:
                self.events.append(FileEvent("set_aside", str(old.path), self._last_ns))
        except OSError:  # the recording goes on
            self.events.append(FileEvent("set_aside", str(old.path), self._last_ns))
        self._old = None

    def _close_file(self) -> None:
        if self._writer is None:
            return
        writer, file = self._writer, self._file
        try:
            with self._breaking():
                writer.close()
        finally:
            self._writer, self._file = None, ""
            self._account(writer, file)
            self._settle_old(writer, closed=True)

    def _account(self, writer: RecordingWriter, file: str) -> None:
        """Count the bytes of a file that was closed, and add its event."""
        if writer.vanished:
            self._own.pop()
            self.vanished += 1
            # A file that has taken its name since must not be replaced.
            self._force = self._force and self._numbered
            lost = 0 if writer.renamed else writer.bytes_written
            self.events.append(FileEvent("vanished", file, self._last_ns, lost, writer.renamed))
            self.bytes_vanished += lost
        else:
            self._own[-1] = _OwnFile(file, writer.identity, closed=True)
            self.events.append(FileEvent("closed", file, self._last_ns))
        if not writer.vanished or writer.renamed:
            self._recorded += writer.bytes_synced
            self.bytes_unsure += writer.bytes_written - writer.bytes_synced

    @contextlib.contextmanager
    def _breaking(self) -> Iterator[None]:
        """Keep an error of the disk, or an interrupt, in `error`: then nothing more is recorded."""
        try:
            yield
        except FileExistsError:
            raise
        except BaseException as error:
            self.error = error
            raise

    def _name(self, number: int) -> Path:
        if not self._numbered:
            return self._path
        return self._path.with_name(f"{self._path.stem}-{number:06}{self._path.suffix}")

    def _last_number(self, path: str) -> int:
        """Return the highest number of an existing file; raise if no file can be made."""
        folder = self._path.parent
        name = re.compile(
            f"{re.escape(self._path.stem)}-([0-9]{{6,}}){re.escape(self._path.suffix)}"
        )
        found = [int(hit[1]) for entry in os.listdir(folder) if (hit := name.fullmatch(entry))]  # noqa: PTH208
        if not os.access(folder, os.W_OK):
            raise PermissionError(errno.EACCES, "no file can be made here", str(folder))
        if self._numbered and not self._force:
            return max(found, default=0)
        first = self._name(1)
        if os.path.lexists(first):
            if not self._force:
                raise OutputExistsError(f"{path} is there already; --force replaces it")
            check_replaceable(first)
        return 0


def _memory(segment: _Segment) -> int:
    return segment.size + _BLOCK_MEMORY * len(segment.blocks)
