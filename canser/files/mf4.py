"""The bus log of ASAM MDF 4, by asammdf.

Frames lie in channel groups that have a channel CAN_DataFrame, CAN_RemoteFrame or CAN_ErrorFrame,
with the fields of a frame as channels such as CAN_DataFrame.ID. A file has one group of each kind,
or one for each bus, direction and kind. Channels are read through their conversions, as a group may
state a field once for all its frames. Groups have no common order: frames are given in order of
time, and those of equal times in the order of the groups.

Times are seconds from the start in the header, as float64. They are exact to the nanosecond up to
48 days from the start. BusChannel counts from 1. python-can counts from 0: so does a file with a
BusChannel 0, unless canser wrote it, for which 0 is a channel that is not told. Source: the ASAM
standard's bus logging, files of CANedge devices, asammdf, python-can (`can.io.mf4`).

Data of a frame ends at DataLength. True CAN FD frames are counted, and left out, and so are frames
with an impossible id or length. An error frame may tell no id.

A reader holds all frames of a file, in up to 70 bytes each, as the last group may have the first
frame. From asammdf it takes pieces of `_PIECE` records. asammdf itself holds a block of the file at
a time, up to `BLOCK_MOST` bytes, and all data of variable length of a group. A file that was not
finalized is copied on disk, and never changed. A writer holds `_PIECE` frames. asammdf keeps those
before, packed, in a temporary file up to the end.
"""

import contextlib
import gc
import io
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

from canser._core.text import NO_CHANNEL, SENT, Codes
from canser._dates import date_ns, first_date
from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray, copy_records, put_records
from canser._input import Input
from canser.errors import FormatError
from canser.files.mdf_blocks import check_blocks, data_len
from canser.files.reader import Reader, ReadOptions
from canser.files.tagged import TaggedReader
from canser.files.tags import RECEIVED, Tagged, joined
from canser.files.writer import WriteOptions, give

about: Final = "an ASAM MF4 log"

cannot_hold: Final = (
    "whether a time is known",
    "the order of frames that are not in order of time",
)

_MAGICS: Final = (b"MDF     ", b"UnFinMF ")

# The kinds of frames, in the order of the groups that are written.
_DATA, _ERROR, _REMOTE = "CAN_DataFrame", "CAN_ErrorFrame", "CAN_RemoteFrame"
_KINDS: Final = (_DATA, _ERROR, _REMOTE)

# The fields of a frame, each a channel whose name begins with the kind.
_FIELDS: Final = (
    "BusChannel", "ID", "IDE", "RTR", "DLC", "DataLength", "DataBytes", "Dir", "EDL",
)  # fmt: skip

# The type of a channel of variable length, and the flag of a group of its data.
_VARIABLE: Final = 1
_FLAG_VARIABLE: Final = 1

# Frames that are written at a time, and records that are read at a time.
_PIECE: Final = 1 << 18

# The comment of the groups that canser writes: there BusChannel 0 is a channel that is not told.
_COMMENT: Final = "written by canser: BusChannel counts from 1, and is 0 if it is not told"

_SECOND_NS: Final = 1_000_000_000

# Flags of the header: its time is local time; its time is UTC, beside the offset of local time.
_LOCAL_TIME, OFFSET_VALID = 1, 2

# Deflated after transposition: the smallest files, and the fastest ones to write.
COMPRESSION: Final = 2

_DATA_LEN: Final = 8
_EXT_BIT: Final = 1 << 31
_STANDARD_MAX, _EXTENDED_MAX = 0x7FF, 0x1FFF_FFFF

Numbers = npt.NDArray[np.int64]


def sniff(head: bytes) -> bool:
    """Return whether a file starts as MDF files of version 4 do."""
    return head.startswith(_MAGICS) and head[8:9] == b"4"


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a log."""
    return _Mf4Reader(source, options)


def write(file: BinaryIO, options: WriteOptions) -> "Writer":
    """Begin a log."""
    return Writer(file, options.name or about)


def load_asammdf(name: str) -> Any:
    """Return the module asammdf; FormatError names the file if it is not installed."""
    try:
        import asammdf  # noqa: PLC0415 - an optional extra
    except ImportError:
        raise FormatError(
            f"{name} needs asammdf, which is not installed: pip install 'canser[mf4]'"
        ) from None
    return asammdf


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Let asammdf print and log nothing: what it cannot do is an exception besides."""
    import logging  # noqa: PLC0415 - slow, and needed with asammdf only

    logger = logging.getLogger("asammdf")
    before, logger.disabled = logger.disabled, True
    hook, sys.unraisablehook = sys.unraisablehook, _drop
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        logger.disabled, sys.unraisablehook = before, hook


def _drop(_: object) -> None:
    """Drop an error of an object that is collected: asammdf's are incomplete after an error."""


def _record(kind: str) -> np.dtype[np.void]:
    """Return the record of a kind of frames, as asammdf and python-can write it."""
    fields: list[Any] = [
        ("BusChannel", "<u1"), ("ID", "<u4"), ("IDE", "<u1"), ("DLC", "<u1"), ("DataLength", "<u1"),
    ]  # fmt: skip
    if kind != _REMOTE:
        fields.append(("DataBytes", "<u1", (_DATA_LEN,)))
    fields.append(("Dir", "<u1"))
    if kind == _ERROR:
        fields.append(("RTR", "<u1"))
    return np.dtype([(f"{kind}.{name}", *of) for name, *of in fields])


class Writer:
    """Writes frames into three groups: data, error and remote frames."""

    takes_tags = True

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file = file
        self._asammdf = load_asammdf(name)
        self._mdf: Any = None
        self._start_ns: int | None = None  # None until a time is known
        self._held: list[Tagged] = []  # frames of the next piece
        self._held_count = 0
        self._last: tuple[int, int] = NO_TIME, 0  # the latest time, and the kind of its last frame
        self._unknown = self._early = self._swapped = 0

    def write(
        self, frames: FrameArray, channels: Codes | None = None, directions: Codes | None = None
    ) -> None:
        """Append frames."""
        for first in range(0, len(frames), _PIECE):
            rows = slice(first, first + _PIECE)
            # The arrays may be filled again before they are written.
            codes = [
                None if each is None else np.array(each[rows]) for each in (channels, directions)
            ]
            block = Tagged(copy_records(frames[rows]), *codes)
            self._held.append(block)
            self._held_count += len(block.frames)
            if self._held_count >= _PIECE:
                self._flush()

    def _flush(self) -> None:
        if self._held_count:
            self._put(joined(self._held))
        self._held, self._held_count = [], 0

    def _open(self) -> None:
        """Begin the groups."""
        asammdf = self._asammdf
        source = asammdf.Source(
            name="CAN",
            path="CAN",
            comment="",
            source_type=asammdf.Source.SOURCE_BUS,
            bus_type=asammdf.Source.BUS_TYPE_CAN,
        )
        self._mdf = asammdf.MDF(version="4.10")
        for kind in _KINDS:
            signal = asammdf.Signal(
                np.empty(0, _record(kind)), np.empty(0), name=kind, source=source
            )
            self._mdf.append(signal, acq_name="CAN", acq_source=source, comment=_COMMENT)

    def _put(self, block: Tagged) -> None:
        """Write frames into the groups."""
        frames, channels, directions = block
        if self._mdf is None:
            self._open()
        known = frames["ts"] != NO_TIME
        if self._start_ns is None and known.any():
            self._start_ns = first_date(frames, step_ns=1)
        self._unknown += len(frames) - int(np.count_nonzero(known))
        times = np.where(known, frames["ts"], self._start_ns or 0)
        kinds = np.where(frames["err"], 1, np.where(frames["rtr"], 2, 0))
        self._see_order(times, kinds)
        seconds = seconds_from(times, self._start_ns or 0)
        if channels is None:
            channels = np.full(len(frames), NO_CHANNEL, np.uint8)
        if directions is None:
            directions = np.full(len(frames), RECEIVED, np.uint8)
        for group, kind in enumerate(_KINDS):
            rows = np.flatnonzero(kinds == group)
            if len(rows):
                # Channel 255 is the one that is not told: its number is 0.
                records = _records(kind, frames, rows, channels + np.uint8(1), directions == SENT)
                self._mdf.extend(group, [(seconds[rows], None), (records, None)])

    def _see_order(self, times: Numbers, kinds: npt.NDArray[Any]) -> None:
        """Count frames that a reader puts at another place."""
        last_ns, last_kind = self._last
        times = np.concatenate([[last_ns], times])
        kinds = np.concatenate([[last_kind], kinds])
        latest = np.maximum.accumulate(times)
        self._early += int(np.count_nonzero(times < latest))
        same = (times[1:] == times[:-1]) & (times[1:] == latest[1:])
        self._swapped += int(np.count_nonzero(same & (kinds[1:] < kinds[:-1])))
        self._last = int(latest[-1]), int(kinds[np.flatnonzero(times == latest[-1])[-1]])

    def abandon(self) -> None:
        """Write nothing more: an error has ended the writing."""
        if self._mdf is not None:
            self._mdf.close()  # removes its temporary file

    def finish(self) -> list[str]:
        """Write the file; return what it could not hold."""
        self._flush()
        if self._mdf is None:
            self._open()
        header = self._mdf.header
        header.abs_time, header.time_flags = self._start_ns or 0, OFFSET_VALID
        header.tz_offset = header.daylight_save_time = 0
        with self._mdf, seekable_target(self._file) as made:
            self._mdf.save(made, compression=COMPRESSION)
        remarks = {
            "frames without a time, written as the start": self._unknown,
            "frames with a time before that of others, which readers put in order": self._early,
            "frames of equal times and another kind, which readers put in another order": (
                self._swapped
            ),
        }
        told = [f"{what}: {count:,}" for what, count in remarks.items() if count]
        if self._start_ns == 0:
            told.append("times count from no date; the start is written as 1970")
        return told


@contextlib.contextmanager
def seekable_target(file: BinaryIO) -> Iterator[BinaryIO]:
    """Give a file that asammdf can write from its first byte on: this one, or a temporary one."""
    if file.seekable() and not file.tell() and isinstance(getattr(file, "name", ""), str):
        yield file
        file.seek(0, io.SEEK_END)
        return
    import tempfile  # noqa: PLC0415 - slow, and seldom needed

    with tempfile.TemporaryDirectory() as folder, Path(folder, "x.mf4").open("w+b") as made:
        yield made
        give(made, file)


def seconds_from(times: Numbers, start_ns: int) -> npt.NDArray[np.float64]:
    """Return times as seconds from a start: whole seconds apart, as they are exact."""
    whole = times // _SECOND_NS - start_ns // _SECOND_NS
    rest = times % _SECOND_NS - start_ns % _SECOND_NS
    seconds: npt.NDArray[np.float64] = whole + rest / _SECOND_NS
    return seconds


def _records(
    kind: str, frames: FrameArray, rows: npt.NDArray[np.intp], numbers: Codes, sent: Any
) -> npt.NDArray[np.void]:
    """Return frames as records of a kind."""
    frames = frames.view(f"V{FRAME_DTYPE.itemsize}")[rows].view(FRAME_DTYPE)
    made = np.zeros(len(rows), _record(kind))
    made[f"{kind}.BusChannel"] = numbers[rows]
    made[f"{kind}.ID"] = frames["id"]
    made[f"{kind}.IDE"] = frames["ext"]
    made[f"{kind}.DLC"] = frames["dlc"]
    made[f"{kind}.Dir"] = sent[rows]
    if kind != _REMOTE:
        made[f"{kind}.DataLength"] = np.where(frames["rtr"], 0, frames["dlc"])
        made[f"{kind}.DataBytes"] = frames["data"]
    if kind == _ERROR:
        made[f"{kind}.RTR"] = frames["rtr"]
    return made


class _Mf4Reader(TaggedReader):
    first_channel = 1

    def __init__(self, source: Input, options: ReadOptions) -> None:
        super().__init__(source, options)
        self._asammdf = load_asammdf(source.name)
        if source.size is None:
            raise FormatError(
                f"{source.name} is read from its end on, and cannot be a pipe or packed; put it "
                "into a file"
            )
        self._fd = self._odd = self._odd_errors = self._lost_channels = self._lost_times = 0
        self._missing = 0  # records that the file says it has, and has not
        self._unsorted = 0  # bytes of groups that share their data, that are in no group
        self._gone = 0  # frames whose data are not there

    def _fill(self) -> Iterator[None]:
        block = self._load()
        order = None
        times = block.frames["ts"]
        if (times[1:] < times[:-1]).any():
            order = np.argsort(times, kind="stable")
        if block.channels is None or block.directions is None:
            return  # no frames
        at, total = 0, len(block.frames)
        whole = block.frames.view(f"V{FRAME_DTYPE.itemsize}")
        while at < total:
            room = min(len(self._frames) - self._count, total - at)
            rows = slice(self._count, self._count + room)
            taken: Any = slice(at, at + room)
            if order is not None:
                taken = order[taken]
            put_records(self._frames[rows], whole[taken].view(FRAME_DTYPE))
            self._channels[rows] = block.channels[taken]
            self._directions[rows] = block.directions[taken]
            self._count += room
            at += room
            if self._count == len(self._frames):
                yield
        self.bytes_done = self._source.total or 0
        yield

    def _load(self) -> Tagged:
        """Return all frames, one group after the other."""
        import tempfile  # noqa: PLC0415 - slow, and needed with asammdf only

        reason = ""
        with tempfile.TemporaryDirectory() as folder, _quiet():
            try:
                with self._stream(folder) as file:
                    return self._load_from(file, folder)
            except FormatError:
                raise
            except Exception as error:  # noqa: BLE001 - of damaged files asammdf raises anything
                reason = str(error).strip().partition("\n")[0] or type(error).__name__
            gc.collect()  # asammdf's temporary file is in use until then
        raise FormatError(f"{self._source.name} cannot be read: {reason}") from None

    def _load_from(self, file: BinaryIO, folder: str) -> Tagged:
        size = file.seek(0, io.SEEK_END)
        file.seek(0)
        is_final = file.read(8) == _MAGICS[0]
        check_blocks(file, size, is_final=is_final)
        mdf = self._asammdf.MDF(file, temporary_folder=folder, process_bus_logging=False)
        with contextlib.closing(mdf):
            self._take_start(mdf.header)
            self._unsorted = sum(_unsorted(mdf, file))
            return self._take_groups(mdf)

    @contextlib.contextmanager
    def _stream(self, folder: str) -> Iterator[BinaryIO]:
        """Give the file for asammdf; it changes one that was not finalized: that is a copy."""
        start = self._source.start
        with open(os.dup(self._source.file.fileno()), "rb") as file:  # noqa: PTH123
            file.seek(start)
            if not start and file.read(8) == _MAGICS[0]:
                yield file
                return
            file.seek(start)
            with Path(folder, "x.mf4").open("w+b") as copy:
                shutil.copyfileobj(file, copy, 1 << 20)
                yield copy

    def _take_start(self, header: Any) -> None:
        start_ns = int(header.abs_time)
        if header.time_flags & _LOCAL_TIME:
            whole, rest = divmod(start_ns, _SECOND_NS)
            moment = np.datetime64(whole, "s").item()
            start_ns = date_ns(moment, self._options.tz) + rest
        self.start_ns = start_ns or None

    def _take_groups(self, mdf: Any) -> Tagged:
        numbers: list[tuple[Numbers, bool]] = []
        blocks: list[Tagged] = []
        has_frames = False
        for group, each in enumerate(mdf.groups):
            names = [channel.name for channel in each.channels]
            for kind in _KINDS:
                if kind in names:
                    has_frames = True
                    own = (each.channel_group.comment or "").startswith(_COMMENT)
                    for columns, times in self._pieces(mdf, group, names, kind):
                        block, number = self._frames_of(columns, times, kind)
                        blocks.append(block)
                        numbers.append((number, own))
        if not has_frames:
            raise FormatError(
                f"{self._source.name} has no frames of a CAN bus: no channel {', '.join(_KINDS)}; "
                "asammdf reads its signals"
            )
        if any(not own and (number == 0).any() for number, own in numbers):
            self.first_channel = 0
        codes = [self._codes_of(number) for number, _ in numbers]
        return joined(
            [
                Tagged(frames, code, directions)
                for (frames, _, directions), code in zip(blocks, codes, strict=True)
            ]
        )

    def _codes_of(self, numbers: Numbers) -> Codes:
        codes = numbers - (self.first_channel or 0)
        self._lost_channels += int(np.count_nonzero(codes >= NO_CHANNEL))
        return np.where((codes < 0) | (codes >= NO_CHANNEL), NO_CHANNEL, codes).astype(np.uint8)

    def _pieces(
        self, mdf: Any, group: int, names: list[str], kind: str
    ) -> Iterator[tuple[dict[str, Any], npt.NDArray[np.float64]]]:
        """Yield the records of a group, a piece at a time: the columns by their names, and times.

        "is_there" tells of data of variable length whether the file has them.
        """
        each = mdf.groups[group]
        of = each.channel_group
        record_len = of.samples_byte_nr + of.invalidation_bytes_nr
        # asammdf would fill up records that are not there with what is in the memory.
        total = 0
        if record_len:
            total = sum(block.original_size for block in each.get_data_blocks()) // record_len
        self._missing += max(of.cycles_nr - total, 0)
        total = min(total, of.cycles_nr)
        places = {
            name: names.index(f"{kind}.{name}") for name in _FIELDS if f"{kind}.{name}" in names
        }
        if not places:
            raise FormatError(f"{self._source.name}: a group {kind} has no fields of a frame")
        variable = self._variable_data(mdf, each, places.get("DataBytes"))
        wanted = [(None, group, place) for place in places.values()]
        for at in range(0, total, _PIECE):
            count = min(_PIECE, total - at)
            signals = mdf.select(wanted, record_offset=at, record_count=count, copy_master=False)
            columns = {name: signal.samples for name, signal in zip(places, signals, strict=True)}
            if variable is not None:
                columns["DataBytes"], columns["is_there"] = _cut_out(variable, columns["DataBytes"])
            yield columns, signals[0].timestamps

    @staticmethod
    def _variable_data(mdf: Any, group: Any, place: int | None) -> Any:
        """Return the bytes of all data if they have variable lengths; records hold offsets then.

        asammdf's own function for them, in C, does not check the offsets.
        """
        if place is None or group.channels[place].channel_type != _VARIABLE:
            return None
        data = mdf._mdf._load_signal_data(group=group, index=place)
        channel = group.channels[place]
        channel.channel_type = channel.data_type = 0  # an unsigned number
        channel.dtype_fmt = np.dtype("<u8")
        group.record = None  # made again
        return np.frombuffer(data + bytes(_DATA_LEN + 4), np.uint8)

    def _frames_of(
        self, columns: dict[str, Any], times: npt.NDArray[np.float64], kind: str
    ) -> tuple[Tagged, Numbers]:
        """Return records as frames, without the channels, and these as numbers of the file."""
        count = len(times)

        def number(name: str, missing: int = 0) -> Numbers:
            if name not in columns:
                return np.full(count, missing, np.int64)
            return _whole(columns[name], f"{self._source.name}: {kind}.{name}")

        ids = number("ID")
        ext = (number("IDE") != 0) | (ids & _EXT_BIT != 0)
        ids &= ~np.int64(_EXT_BIT)
        rtr = np.full(count, kind == _REMOTE) | (number("RTR") != 0)
        size = np.minimum(number("DLC"), _DATA_LEN)
        length = number("DataLength") if "DataLength" in columns else size
        dlc = np.where(rtr & ("DLC" in columns), size, length)
        is_fd = number("EDL") != 0
        odd = (ids < 0) | (ids > np.where(ext, _EXTENDED_MAX, _STANDARD_MAX))
        odd |= (dlc < 0) | (dlc > _DATA_LEN)
        gone = np.zeros(count, np.bool_)
        if "is_there" in columns:
            gone = ~columns["is_there"] & ~rtr & (dlc > 0)
        self._fd += int(np.count_nonzero(is_fd))
        self._gone += int(np.count_nonzero(gone & ~is_fd))
        if kind == _ERROR:
            self._odd_errors += int(np.count_nonzero(odd & ~is_fd & ~gone))
            ids = np.where(ext, ids & _EXTENDED_MAX, ids & _STANDARD_MAX)
            dlc = np.clip(dlc, 0, _DATA_LEN)
            odd[:] = False
        self._odd += int(np.count_nonzero(odd & ~is_fd & ~gone))
        frames = np.zeros(count, FRAME_DTYPE)
        frames["id"], frames["ext"], frames["rtr"], frames["dlc"] = ids, ext, rtr, dlc
        frames["err"] = kind == _ERROR
        frames["ts"] = self._nanoseconds(times)
        if "DataBytes" in columns:
            data = _bytes(columns["DataBytes"], count)[:, :_DATA_LEN]
            frames["data"][:, : data.shape[1]] = data
            has_data = np.where(rtr, 0, dlc)
            frames["data"][np.arange(_DATA_LEN) >= has_data[:, None]] = 0
        elif kind == _DATA and dlc.any():
            raise FormatError(f"{self._source.name} has no channel {kind}.DataBytes")
        is_sent = _is_sent(columns["Dir"]) if "Dir" in columns else np.zeros(count, np.bool_)
        sent = np.where(is_sent, SENT, RECEIVED).astype(np.uint8)
        numbers = number("BusChannel", -1)
        kept = ~(is_fd | odd | gone)
        if not kept.all():
            frames, sent, numbers = (each.compress(kept) for each in (frames, sent, numbers))
        return Tagged(frames, None, sent), numbers

    def _nanoseconds(self, times: npt.NDArray[np.float64]) -> Numbers:
        good = np.abs(times) < np.iinfo(np.int64).max / _SECOND_NS - 1  # not for NaN
        self._lost_times += len(times) - int(np.count_nonzero(good))
        ns = np.rint(np.where(good, times, 0) * _SECOND_NS).astype(np.int64)
        return np.where(good, ns, NO_TIME)

    @property
    def remarks(self) -> list[str]:
        """Remarks on the file: what the frames do not hold."""
        remarks = super().remarks
        counts = {
            "CAN FD frames, left out": self._fd,
            "frames with an id or a length that classic CAN does not have, left out": self._odd,
            "error frames with such an id or length, cut to the limit": self._odd_errors,
            "frames of channels over 255, without their channel": self._lost_channels,
            "frames with a time over 64 bits of nanoseconds, without it": self._lost_times,
            "records that are missing; is the file cut off?": self._missing,
            "bytes of records behind a damaged one, left out": self._unsorted,
            "frames whose data are missing, left out; is the file cut off?": self._gone,
        }
        return remarks + [f"{what}: {count:,}" for what, count in counts.items() if count]


def _whole(values: Any, name: str) -> Numbers:
    """Return a column as whole numbers, -1 for what is none; FormatError if it is no number."""
    if values.dtype.kind in "biu" and values.ndim == 1:
        return values.astype(np.int64)  # type: ignore[no-any-return]
    if values.dtype.kind != "f" or values.ndim != 1:
        raise FormatError(f"{name} is no number, but {values.dtype}")
    good = np.abs(values) < 1 << 53
    return np.where(good, values, -1).astype(np.int64)


def _bytes(values: Any, count: int) -> npt.NDArray[np.uint8]:
    """Return a column of bytes as an array of a row for each record."""
    plain = np.ascontiguousarray(values)
    return plain.view(np.uint8).reshape(count, -1) if count else np.empty((0, 0), np.uint8)


def _unsorted(mdf: Any, file: BinaryIO) -> Iterator[int]:
    """Yield the bytes of data of several groups that asammdf has put into none of them.

    It sorts such data by the ids of groups before the records, and ends at an id that is unknown.
    The part of a record at the end of a file that is cut off is not counted.
    """
    shared: dict[int, list[Any]] = {}
    for group in mdf.groups:
        if group.data_group.record_id_len and group.data_group.data_block_addr:
            shared.setdefault(group.data_group.data_block_addr, []).append(group)
    for at, groups in shared.items():
        left, longest = data_len(file, at), 0
        for group in groups:
            of, id_len = group.channel_group, group.data_group.record_id_len
            if of.flags & _FLAG_VARIABLE or not of.samples_byte_nr:
                continue
            record_len = of.samples_byte_nr + of.invalidation_bytes_nr
            longest = max(longest, record_len + id_len)
            records = sum(block.original_size for block in group.get_data_blocks()) // record_len
            left -= records * (record_len + id_len)
            for place, channel in enumerate(group.channels):
                if channel.channel_type == _VARIABLE:
                    data = sum(each.original_size for each in group.get_signal_data_blocks(place))
                    left -= data + (records * id_len if data else 0)
                    longest = max(longest, data // max(records, 1) + _DATA_LEN)
        if left > longest:
            yield left


def _cut_out(data: npt.NDArray[np.uint8], offsets: Any) -> tuple[Any, Any]:
    """Return the first bytes of data of variable length at offsets, and whether they are there.

    The length stands before the bytes, in 4 bytes. `data` has more bytes at its end than are cut.
    """
    end = len(data) - _DATA_LEN - 4
    is_there = offsets <= max(end - 4, 0)
    at = np.where(is_there, offsets, 0).astype(np.int64)
    lengths = np.zeros(len(at), np.int64)
    for place in range(4):
        lengths |= data[at + place].astype(np.int64) << (8 * place)
    is_there &= at + 4 + lengths <= end
    cut = data[at[:, None] + np.arange(4, 4 + _DATA_LEN)]
    cut[np.arange(_DATA_LEN) >= lengths[:, None]] = 0
    return cut, is_there


def _is_sent(values: Any) -> Any:
    """Return whether frames were sent: Dir is 1, or the text Tx."""
    if values.dtype.kind in "SUO":
        return np.char.upper(values.astype("S8")) == b"TX"
    return values == 1
