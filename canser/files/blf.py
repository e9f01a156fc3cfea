"""The log of Vector's CANalyzer and CANoe, in binary.

A header of 144 bytes, with the start and the end as dates, is followed by objects. Most of them lie
in containers: stored or packed by zlib, each with a piece of one stream of objects. An object may
be cut by the end of a container, and may stand outside of them.

Channels count from 1. The dates are local time, without a zone, and times count from the start in
nanoseconds or in steps of 10 us. Source: files of Vector's programs; the headers of vector_blf;
python-can, `can.io.blf`.

An object of a channel of CAN FD holds a frame of classic CAN if its EDL bit is not set. True CAN FD
frames are counted, and left out, and so are objects with an impossible id or dlc. Objects that are
no frames, such as statistics and LIN, are passed over. The old error frame tells no id.
"""

import datetime as dt
import struct
from collections.abc import Iterable, Iterator
from typing import BinaryIO, Final

from canser._core.blf import OBJECT_MOST, BlfReader, BlfWriter
from canser._core.text import Codes, Taken
from canser._dates import date_ns, first_date, local_date
from canser._frames import NO_TIME, FrameArray
from canser._input import Input
from canser.errors import FormatError
from canser.files.containers import CONTAINER, OBJECT, Packer, Unpacker
from canser.files.reader import Reader, ReadOptions
from canser.files.tagged import TaggedReader
from canser.files.writer import WriteOptions, give, patchable

about: Final = "a BLF log of Vector"

cannot_hold: Final = (
    "times before the first one",
    "whether a time is known",
    "error frames that are remote frames",
)

_FILE: Final = b"LOGG"

# Signature, bytes of the header, version of Vector's interface, program, level of compression,
# version of the program (2), bytes of the file, bytes of it inflated, objects, build of the
# program, start and end. Zeros fill it up.
_HEADER: Final = struct.Struct("<4sII4BQQII8H8H")
_HEADER_LEN: Final = 144

# The longest header that is passed over. No program is known to write another one than 144 bytes.
_HEADER_MOST: Final = 1 << 16

# The version of Vector's interface, 4.7.1, which has all that is written.
_INTERFACE: Final = 4_070_100

# The inflated bytes of a container that is written, as in Vector's files.
_CONTAINER_SIZE: Final = 1 << 17

# Bytes that tell of the next object whether it is one, behind padding of up to 8 bytes.
_NEAR: Final = 24

# Bytes that are searched at a time. They are copied at each damaged place: so they are few.
_SEARCHED: Final = 1 << 12

# Times that fit 64 bits of nanoseconds, from 1970 on: no log is older.
_TIMES: Final = range(1 << 63)


def sniff(head: bytes) -> bool:
    """Return whether a file starts as a BLF log does."""
    return head.startswith(_FILE)


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a log."""
    return _BlfReader(source, options)


def write(file: BinaryIO, options: WriteOptions) -> "Writer":
    """Begin a log."""
    return Writer(file, options.tz)


class Writer:
    """Writes frames in containers, behind a header that is completed at the end."""

    takes_tags = True

    def __init__(self, file: BinaryIO, tz: dt.tzinfo | None = None) -> None:
        self._target, self._tz = file, tz
        self._file = patchable(file)
        self._begin = self._file.tell()
        self._objects = BlfWriter(_CONTAINER_SIZE)
        self._packer = Packer()
        self._begun = False
        self._inflated = _HEADER_LEN
        self._file.write(bytes(_HEADER_LEN))

    def write(
        self, frames: FrameArray, channels: Codes | None = None, directions: Codes | None = None
    ) -> None:
        """Append frames."""
        if not self._begun and (frames["ts"] != NO_TIME).any():
            self._begun = True
            self._objects.state.start_ns = first_date(frames, step_ns=1_000_000)
        for content in self._objects.containers(frames, channels, directions):
            self._inflated += CONTAINER.size + len(content)
            self._put(self._packer.put(content))

    def _put(self, containers: Iterable[bytes]) -> None:
        """Write containers."""
        for each in containers:
            self._file.write(each)

    def abandon(self) -> None:
        """Write nothing more: an error has ended the writing."""
        self._packer.close()

    def finish(self) -> list[str]:
        """Write what completes the log; return what it could not hold."""
        content = self._objects.rest()
        if content:
            self._inflated += CONTAINER.size + len(content)
            self._put(self._packer.put(content))
        self._put(self._packer.rest())
        self._packer.close()
        end = self._file.tell()
        self._file.seek(self._begin)
        self._file.write(self._header(end - self._begin))
        self._file.seek(end)
        give(self._file, self._target)
        state = self._objects.state
        remarks = {
            "frames without a time, written as 0": state.unknown_times,
            "times before the first one, written as 0": state.early_times,
            "error frames that are no longer remote frames": state.remote_errors,
        }
        return [f"{what}: {count:,}" for what, count in remarks.items() if count]

    def _header(self, size: int) -> bytes:
        state, dates = self._objects.state, [0] * 16
        if state.start_ns:
            dates = [
                part
                for ns in (state.start_ns, state.last_ns)
                for part in _to_system_time(local_date(ns, self._tz))
            ]
        return _HEADER.pack(
            _FILE, _HEADER_LEN, _INTERFACE, 0, 1, 0, 0, size, self._inflated, self._objects.frames,
            0, *dates,
        ).ljust(_HEADER_LEN, b"\0")  # fmt: skip


def _to_system_time(date: dt.datetime) -> tuple[int, ...]:
    """Return a date as Windows has it: year, month, day of the week from Sunday, day and so on."""
    return (
        date.year, date.month, date.isoweekday() % 7, date.day,
        date.hour, date.minute, date.second, date.microsecond // 1000,
    )  # fmt: skip


class _BlfReader(TaggedReader):
    first_channel = 1

    def __init__(self, source: Input, options: ReadOptions) -> None:
        self._c = BlfReader()
        super().__init__(source, options)
        self._unpacker = Unpacker(options.threads)
        self._offset = 0  # bytes of the file so far
        self._size = 0  # bytes of the file as its header says
        self._parts: list[bytes] = []  # the inflated bytes of the object that is not whole yet
        self._held = 0  # the number of these bytes
        self._wanted = 0  # bytes that it needs at least
        self._inflated = 0  # inflated bytes before them
        self._searches = False  # whether the object to read next has to be searched
        self._bad: list[tuple[str, str]] = []  # the first damage: where and what
        self._bad_count = self._nuls = 0
        self._is_cut = self._date_wrong = False
        self.bytes_done = 0

    def _new_rows(self) -> None:
        super()._new_rows()
        self._c.use(self._frames, self._channels, self._directions)

    def _fill(self) -> Iterator[None]:
        try:
            self._take_header()
            yield from self._take_objects()
        except FormatError:
            yield  # the frames before it
            raise
        finally:
            self._unpacker.close()
        yield

    def _advance(self, count: int) -> None:
        self._offset += count
        self.bytes_done = self._offset

    def _take_header(self) -> None:
        name = self._source.name
        head = bytes(self._source.at(0, _HEADER.size))
        if not head.startswith(_FILE):
            raise FormatError(f"{name}: begins with {head[:4]!r}, and a BLF log with {_FILE!r}")
        if len(head) < _HEADER.size:
            raise FormatError(f"{name}: is cut off in its header, after {len(head)} bytes")
        _, length, _, _, _, _, _, self._size, _, _, _, *dates = _HEADER.unpack(head)
        if not _HEADER.size <= length <= _HEADER_MOST:
            raise FormatError(
                f"{name}: says that its header has {length:,} bytes; it must have {_HEADER.size} "
                f"to {_HEADER_MOST:,}"
            )
        self._take_date(dates[:8])
        self._advance(len(self._source.at(0, length)))

    def _take_date(self, date: list[int]) -> None:
        if not any(date):
            return
        year, month, _, day, hour, minute, second, millisecond = date
        try:
            moment = dt.datetime(year, month, day, hour, minute, second, millisecond * 1000)
            start_ns = date_ns(moment, self._options.tz)
        except (ValueError, OverflowError, OSError):  # the last two for local time
            start_ns = -1
        if start_ns in _TIMES:
            self.start_ns = start_ns
        else:
            self._date_wrong = True

    def _take_objects(self) -> Iterator[None]:
        """Take the objects of the file: containers, and others outside of them."""
        source = self._source
        while data := source.ahead(self._offset):
            taken = self._read(data)
            self._advance(taken.used)
            left = len(data) - taken.used
            if self._c.is_full:
                yield
            elif self._c.no_object or self._c.wrong_size:
                offset, near = self._offset, bytes(source.at(self._offset, _NEAR))
                nuls = 0 if near.strip(b"\0") else self._skip_nuls()
                if nuls and not source.at(self._offset, 1):
                    self._nuls = nuls
                    break
                self._damaged(f"byte {offset:,}", self._why(near))
                self._search(0 if nuls else 1)
            else:  # a container, or an object that is not whole
                size = self._c.next_size or left + 1
                is_container = self._c.at_container
                if left < size and source.size is None:
                    yield  # a pipe is waited for: frames go on before
                if is_container:
                    self._unpacker.look_ahead(data[taken.used :], self._offset)
                raw = source.at(self._offset, size)
                if is_container:
                    yield from self._take_container(raw, size)
                elif len(raw) < size:
                    self._is_cut |= bool(bytes(raw).strip(b"\0"))  # NULs are padding
                    self._advance(len(raw))
        self._is_cut |= self._offset < self._size or any(each.strip(b"\0") for each in self._parts)

    def _read(self, data: bytes | memoryview) -> Taken:
        """Read objects into the rows."""
        taken = self._c.read(data, self._count)
        self._count += taken.frames
        return taken

    def _why(self, raw: memoryview | bytes) -> str:
        """Return why there is no object at the start of these bytes."""
        if self._c.no_object:
            return f"no object begins here: {bytes(raw[:8])!r} is not {OBJECT!r}"
        size, kind = struct.unpack_from("<II", raw, 8)
        return (
            f"an object of type {kind} has {size:,} bytes: too few for its type, or over "
            f"{OBJECT_MOST:,}"
        )

    def _damaged(self, where: str, why: str) -> None:
        """Raise FormatError for a part that cannot be read, or count it."""
        if not self._options.skip_bad:
            raise FormatError(f"{self._source.name}, {where}: {why}; skip_bad=True leaves it out")
        if not self._bad_count:
            self._bad.append((where, why))
        self._bad_count += 1

    def _search(self, behind: int) -> None:
        """Go to the next object from a number of bytes behind this place on, or to the end."""
        self._advance(behind)
        while len(data := self._source.at(self._offset, _SEARCHED)) >= len(OBJECT):
            found = bytes(data[:_SEARCHED]).find(OBJECT)
            self._advance(found if found >= 0 else len(data) - len(OBJECT) + 1)
            if found >= 0:
                return
        self._advance(len(data))

    def _skip_nuls(self) -> int:
        """Skip pieces of NULs, which a power cut leaves; return the number of bytes."""
        begin = self._offset
        while data := bytes(self._source.ahead(self._offset)[:_SEARCHED]):
            if data.strip(b"\0"):
                break
            self._advance(len(data))
        return self._offset - begin

    def _take_container(self, raw: memoryview, size: int) -> Iterator[None]:
        """Take a container of `size` bytes; fewer are there if the file is cut off."""
        offset = self._offset
        if len(raw) < CONTAINER.size:
            self._is_cut = True
            self._advance(len(raw))
            return
        self._is_cut |= len(raw) < size
        try:
            content = self._unpacker.content(raw, size, offset)
        except ValueError as error:
            self._damaged(f"byte {offset:,}", f"a container {error}")
            self._inflated += self._held
            self._parts, self._held, self._wanted = [], 0, 0
            self._searches = True
            content = b""
        self._advance(len(raw))
        self._parts.append(content)
        self._held += len(content)
        if self._held >= self._wanted:
            yield from self._take_content(f"the container at byte {offset:,}")

    def _take_content(self, where: str) -> Iterator[None]:
        """Take the objects of the inflated bytes; keep those of the last one if it is cut."""
        data = b"".join(self._parts)
        view, used = memoryview(data), 0
        if self._searches:
            used = self._find(data, 0)
            self._searches = used == len(data)
        while True:
            used += self._read(view[used:]).used
            if self._c.is_full:
                yield
            elif self._c.no_object or self._c.wrong_size or self._c.at_container:
                place = f"{where}, byte {self._inflated + used:,} of all inflated bytes"
                if self._c.at_container:
                    self._damaged(place, "a container within a container")
                else:
                    self._damaged(place, self._why(view[used:]))
                used = self._find(data, used + 1)
                self._searches = used == len(data)
            else:
                break
        self._parts = [data[used:]] if used < len(data) else []  # joining two is a copy
        self._held, self._wanted = len(data) - used, self._c.next_size
        self._inflated += used

    @staticmethod
    def _find(data: bytes, begin: int) -> int:
        """Return the place of the next object, the end of the data if there is none."""
        found = data.find(OBJECT, begin)
        return found if found >= 0 else len(data)

    @property
    def remarks(self) -> list[str]:
        """Remarks on the file: what the frames do not hold."""
        remarks, state = super().remarks, self._c.state
        counts = {
            "CAN FD frames, left out": state.fd_count,
            "frames with an id or a dlc that classic CAN does not have, left out": state.odd_frames,
            "error frames with such an id or dlc, cut to the limit": state.odd_errors,
            "frames of channels over 255, without their channel": state.lost_channels,
            "frames with a time over 64 bits of nanoseconds, without it": state.lost_times,
        }
        remarks += [f"{what}: {count:,}" for what, count in counts.items() if count]
        if self._bad_count:
            where, why = self._bad[0]
            remarks.append(
                f"damaged parts, left out: {self._bad_count:,}; the first is {where}: {why}"
            )
        if self._is_cut:
            remarks.append("the file is cut off; frames may be missing")
        if self._nuls:
            remarks.append(
                f"ends in {self._nuls:,} NUL bytes; was the power cut? Frames may be missing"
            )
        if self._date_wrong:
            remarks.append("its date cannot be read")
        return remarks
