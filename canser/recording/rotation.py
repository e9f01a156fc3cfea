"""Where the bytes of a live port go: into one file, a rotation of files, or around triggers."""

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

# What waits for a trigger takes no more memory, in bytes. A block takes so many besides its own.
MEMORY: Final = 1 << 26
_BLOCK: Final = 200

# What the format adds, at most: at the start and the end of a file, and to each block of it.
_FILE_OVERHEAD: Final = 1024
_BLOCK_OVERHEAD: Final = 72


class FileEvent(NamedTuple):
    """What has become of a file, or why it was begun."""

    kind: str  # "opened", "closed", "deleted", "vanished", "trigger", and of a file that was set
    # aside: "restored", "set_aside" where it stays so
    path: str  # of the file; of a trigger the one that was open, or ""
    ts: int  # epoch nanoseconds
    lost: int = 0  # bytes of the line that are gone with a file that has vanished
    renamed: bool = False  # it has vanished, and has another name: its bytes are there


class _Own(NamedTuple):
    """A file of this run, and what it is known by."""

    path: str
    identity: os.stat_result | None
    closed: bool = False

    def is_there(self) -> bool:
        """Return whether the path is still the name of the file."""
        try:
            there = os.stat(self.path)  # noqa: PTH116
        except OSError:
            return False
        if self.identity is None:
            return True
        # The number of a file that is gone is soon that of another one: see the size, too.
        same_size = not self.closed or there.st_size == self.identity.st_size
        return same_size and os.path.samestat(there, self.identity)


@dataclass(frozen=True, slots=True)
class _Segment:
    """Bytes between two ends of packets: nothing in it belongs to a packet outside."""

    blocks: list[DataBlock]
    begin_ns: int  # when its first byte came
    size: int  # bytes in it

    @property
    def end_ns(self) -> int:
        return self.blocks[-1].arrival_ns


class RecordingFiles(Uncopied):
    """Put the bytes of a port into recordings.

    `path` ends in SUFFIX. Without anything else it is the one file. With `size` (bytes of a
    file at most), `period_ns` (time in a file at most) or `window_ns` the files are
    `NAME-000001.pcapng` and so on, behind those that are there already; the newest `keep` of
    those made here stay.

    With `window_ns`, nanoseconds before and after, only what surrounds a trigger is recorded:
    a file for each, but triggers whose surroundings touch share one, without a gap inside.
    What came before waits in memory, MEMORY bytes at most.

    `write` takes the bytes, as the `on_bytes` of a port; `advance` then tells how far packets are
    decoded, and moves the bytes on. Files begin and end between two packets, so that each
    can be decoded by itself.

    `force`: files of these names are replaced, numbers begin with 1. The old file is NAME.old
    until the first bytes of the line are on the disk; it gets its name back if none ever are.

    A file that is removed, replaced or renamed while it is open has `vanished`, and what comes
    goes into a new one: of the same name, or a numbered one where files are numbered or the
    name is another file's; a folder that is gone is made again. The bytes of one that was
    renamed are recorded, the others are `bytes_vanished`. OSError where another recorder has
    the name.

    Law: `bytes_in == bytes_recorded + bytes_passed + bytes_vanished` after `close`, if the
    disk was never full.

    FileExistsError, FileNotFoundError, PermissionError for a path that will not do: by the
    constructor, which makes no file. OSError of the disk from `start`, `advance` and `close`:
    nothing more is written then, `bytes_recorded` are on the disk, and `bytes_unsure` may be.
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
        self.bytes_passed = 0  # not recorded on purpose: no trigger was near
        self.bytes_vanished = 0  # in files that were removed while they were open
        self.vanished = 0  # files that were removed, replaced or renamed while they were open
        self.bytes_unsure = 0  # written, but not known to be on the disk
        self.triggers = 0
        self.files = 0  # that were opened
        self.out_of_memory = False  # MEMORY was too small for all that came before a trigger
        self.events: deque[FileEvent] = deque()  # for the caller to take
        # What has stopped it: an error of the disk; or an interrupt, perhaps within a block.
        self.error: BaseException | None = None
        self._recorded = 0  # in files that are closed
        self._fresh: deque[DataBlock] = deque()  # not known to be decoded
        self._settled = 0  # the stream offset of the first byte in there
        self._settled_ns = 0  # when the byte before it came
        self._waiting: deque[_Segment] = deque()  # for a trigger
        self._waiting_size = 0
        self._until_ns = 0  # what comes by then is recorded
        self._writer: RecordingWriter | None = None
        self._file = ""
        self.last_file = ""  # the path of the file that was opened last
        self._file_ns = self._file_bytes = 0
        self._last_ns = 0  # of what was recorded last
        # What the system's clock is ahead of the one that times are from, and how far it was when
        # the open file began.
        self._ahead_ns = self._file_ahead_ns = 0
        self._old: OldFile | None = None  # what `force` set aside for the open file
        self._own: deque[_Own] = deque()  # files of this run that are there

    @property
    def bytes_recorded(self) -> int:
        """Bytes of the line in files, after an error those that are on the disk for sure."""
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
        """Bytes of the line that went into the open file."""
        return self._file_bytes

    @property
    def recording(self) -> bool:
        """Whether what comes is recorded, and does not wait for a trigger."""
        return self._writer is not None and not self._waiting

    @property
    def files_kept(self) -> list[str]:
        """The paths of the files of this run that are there, oldest first."""
        return [own.path for own in self._own if own.is_there()]

    @property
    def files_made(self) -> list[str]:
        """The paths of the files of this run that it has not deleted; the disk is not asked."""
        return [own.path for own in self._own]

    def start(self, now_ns: int) -> None:
        """Open the first file, where none waits for a trigger."""
        if self._window_ns is None:
            self._open(now_ns)

    def write(self, data: memoryview | bytes, arrival_ns: int, lost: int = 0) -> None:
        """Take bytes as they came; the arguments are those of a port's `on_bytes`.

        Without bytes at the end: `lost` ones that none have followed.
        """
        self._fresh.append(DataBlock(bytes(data), arrival_ns, lost))
        self.bytes_in += len(data)

    def advance(self, border: int, now_ns: int, triggers: Iterable[int] = ()) -> None:
        """Move on what lies before the stream offset `border`, where a packet has ended.

        `triggers`: epoch nanoseconds, ascending, of what has happened in the bytes that this
        moves on; they are recorded in any case.
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
                self._sift(self._waiting[-1].end_ns - self._window_ns[0])
            while self._waiting_size > MEMORY:
                self.out_of_memory = True
                self._pass_oldest()

    def clock_was_set(self, step_ns: int, now_ns: int) -> None:
        """Take note that the system's clock was set: the next files have its time.

        The open one goes on in the time that it began with, and has a note of it.
        """
        self._ahead_ns += step_ns
        if self._writer is not None and self.error is None:
            with self._breaking():
                self._writer.note(
                    f"{describe_step(step_ns)}; this recording goes on as before",
                    now_ns + self._file_ahead_ns,
                )

    def arrival_of(self, offset: int) -> int:
        """Return when the byte at a stream offset came that no `advance` has passed by."""
        at = self._settled
        for block in self._fresh:
            at += len(block.data)
            if offset < at:
                return block.arrival_ns
        return self._last_ns

    def close(self) -> None:
        """Record what is held, and close the file. May be called again."""
        try:
            if self._window_ns is not None or self._writer is not None:
                self._move_on(self.bytes_in)
            while self._waiting and self.error is None:
                self._pass_oldest()
        finally:
            self._close_file()

    # Inside

    def _settle(self, border: int) -> _Segment | None:
        """Take the bytes before a stream offset."""
        blocks: list[DataBlock] = []
        begin, byte_ns = self._settled, self._info.byte_ns
        # At the end there may be a block without bytes: others were lost that none followed.
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
        # No trigger needs what is too old for this one.
        self._sift(ns - before)
        if ns > self._until_ns:
            self.events.append(FileEvent("trigger", self._file, ns))
        self._until_ns = max(self._until_ns, ns + after)
        if self._waiting:
            # What has triggered is in there, whenever its clock says that it was.
            self._until_ns = max(self._until_ns, self._waiting[-1].begin_ns)

    def _sift(self, oldest_ns: int) -> None:
        """Record what waits for no trigger any more, and pass by what came before a time."""
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
        # Noise without an end: a file must end somewhere.
        for block in segment.blocks:
            self._write([block], block.arrival_ns, len(block.data))

    def _write(self, blocks: list[DataBlock], begin_ns: int, size: int) -> None:
        if self._writer is None or self._is_full(blocks, size):
            self._close_file()
            self._open(begin_ns)
        assert self._writer is not None
        if not self._file_bytes:
            self._file_ns = begin_ns  # the first one may have been open for long
        for block in blocks:
            with self._breaking():
                self._writer.write(block.data, block.arrival_ns + self._file_ahead_ns, block.lost)
        self._file_bytes += size
        self._last_ns = blocks[-1].arrival_ns

    def _is_full(self, more: list[DataBlock], size: int) -> bool:
        """Return whether bytes, and blocks of which they are, are too many for the open file."""
        assert self._writer is not None
        if not self._file_bytes:
            return False
        if self._period_ns is not None and more[-1].arrival_ns - self._file_ns > self._period_ns:
            return True
        # The open chunk is one block more, and each read that is to come may be one.
        blocks = self._writer.blocks_written + 1 + len(more)
        overhead = _FILE_OVERHEAD + blocks * _BLOCK_OVERHEAD
        return self._size is not None and self._file_bytes + size + overhead > self._size

    def _replace(self, now_ns: int) -> None:
        """Go on in a new file: the open one has vanished."""
        file = self._file
        self._close_file()
        with contextlib.suppress(PermissionError):  # not even that can be told
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
                    self._numbered = True  # the file that has the name now stays
                if not self._numbered:
                    raise
                # Another program counts here, too: its file stays, and the next number is taken.
        self._file, self._file_ns, self._file_bytes = str(path), ns, 0
        self._file_ahead_ns = self._ahead_ns
        self.files += 1
        self.last_file = self._file
        self._own.append(_Own(self._file, self._writer.identity))
        self.events.append(FileEvent("opened", self._file, ns))
        if self._keep is not None and len(self._own) > self._keep:
            oldest = self._own.popleft()
            # It may have been taken away, and another file may have its name.
            if oldest.is_there():
                Path(oldest.path).unlink(missing_ok=True)
                self.events.append(FileEvent("deleted", oldest.path, ns))

    def _create(self, path: Path) -> RecordingWriter:
        """Return a new file; a file that is there is set aside if it may be replaced."""
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
        """Delete the file that was set aside, or put it back, as soon as it is known which."""
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
        """Count what is in a file that was closed, and tell of it."""
        if writer.vanished:
            self._own.pop()
            self.vanished += 1
            # What has come to its name since is none of the files that may be replaced.
            self._force = self._force and self._numbered
            lost = 0 if writer.renamed else writer.bytes_written
            self.events.append(FileEvent("vanished", file, self._last_ns, lost, writer.renamed))
            self.bytes_vanished += lost
        else:
            self._own[-1] = _Own(file, writer.identity, closed=True)
            self.events.append(FileEvent("closed", file, self._last_ns))
        if not writer.vanished or writer.renamed:
            self._recorded += writer.bytes_synced
            self.bytes_unsure += writer.bytes_written - writer.bytes_synced

    @contextlib.contextmanager
    def _breaking(self) -> Iterator[None]:
        """Let nothing more be recorded after an error of the disk, or an interrupt."""
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
        """Return the highest number of a file that is there; see that one can be made."""
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
    return segment.size + _BLOCK * len(segment.blocks)
