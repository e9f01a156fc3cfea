"""Comma-separated values with the columns of python-can's CSVWriter.

    timestamp,arbitration_id,extended,remote,error,dlc,data
    1631416514.717133,0xd2,0,0,0,8,AAD//xAAAAA=

timestamp in seconds (nan if it is not known), arbitration_id in hexadecimal, flags 0 or 1, data in
base64. Source: python-can, `can.io.csv`.

Times are exact: they have six decimal places, or nine if a frame's time has nanoseconds. The
reader finds columns by their names, so they may be in any order. There may be more columns; the
reader reports which it does not read. python-can 2.0 and 2.1 wrote the header as
`timestamp, arbitration id, extended, remote, error, dlc, data`.
"""

import base64
import csv
import re
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, BinaryIO, Final

import numpy as np

from canser._frames import NO_TIME, FrameArray
from canser._input import Input
from canser._rows import Row, check_row
from canser.errors import FormatError
from canser.files import _text
from canser.files._remarks import AddRemark, Unkept, report_remarks
from canser.files.foreign import is_text
from canser.files.reader import DecodedReader, Reader, ReadOptions
from canser.files.writer import WriteOptions

about: Final = "a CSV file of python-can"

suffixes: Final = (".csv",)

cannot_hold: Final = ()

COLUMNS: Final = ("timestamp", "arbitration_id", "extended", "remote", "error", "dlc", "data")

# Columns that FRAME_DTYPE has no field for. The frames of each value are counted.
_COUNTED: Final = ("channel", "direction")

# More digits than an id or a dlc has, so that a number too large is reported as such; and few
# enough for a message.
_HEXADECIMAL: Final = re.compile("(?:0[xX])?[0-9A-Fa-f]{1,16}")
_WHOLE: Final = re.compile("-?[0-9]{1,16}")

_FLAGS: Final = {"0": False, "1": True, "false": False, "true": True}

_BASE64: Final = np.frombuffer(
    b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/", np.uint8
)


def sniff(head: bytes) -> bool:
    """Return whether a file starts with the header that python-can writes."""
    return is_text(head) and bool(re.match(rb"(?:\xef\xbb\xbf)?timestamp, ?arbitration.id,", head))


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a file."""
    return DecodedReader(source, options, partial(parse, bus=options.bus), has_buses=True)


def write(file: BinaryIO, options: WriteOptions) -> "Writer":  # noqa: ARG001 - as every format
    """Begin a file."""
    return Writer(file)


class Writer:
    """Write frames as rows under a header."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._file.write(",".join(COLUMNS).encode() + b"\n")

    def write(self, frames: FrameArray) -> None:
        """Append frames."""
        unknown = frames["ts"] == NO_TIME
        ts = np.where(unknown, 0, frames["ts"])
        time = _text.seconds(ts, 9)
        time[ts % 1000 == 0, -3:] = 0
        time[unknown] = 0
        time[unknown, :3] = np.frombuffer(b"nan", np.uint8)
        flags = [(frames[name] + ord("0"))[:, None] for name in ("ext", "rtr", "err", "dlc")]
        ext, rtr, err, dlc = (flag.astype(np.uint8) for flag in flags)
        digits = _text.hexadecimal(frames["id"], 8)
        digits += (digits > ord("9")).astype(np.uint8) * 32  # lower case, as hex() writes
        leading = np.cumsum(digits != ord("0"), axis=1) == 0
        leading[:, -1] = False
        digits[leading] = 0
        line = _text.join(
            len(frames),
            time,
            b",0x",
            digits,
            b",",
            ext,
            b",",
            rtr,
            b",",
            err,
            b",",
            dlc,
            b",",
            _base64(frames),
            b"\n",
        )
        self._file.write(line)

    def finish(self) -> list[str]:
        """Return no remarks: the file holds everything."""
        return []


def _base64(frames: FrameArray) -> _text.Column:
    """Return the data up to the dlc in base64: 12 characters, padded by `=`, then by zeros."""
    length = _text.payload_len(frames)[:, None]
    data = np.zeros((len(frames), 9), np.uint8)
    data[:, :8] = np.where(np.arange(8) < length, frames["data"], 0)
    groups = data.reshape(-1, 3, 3).astype(np.uint32)
    bits = groups[:, :, 0] << 16 | groups[:, :, 1] << 8 | groups[:, :, 2]
    text: _text.Column = _BASE64[bits[:, :, None] >> np.array([18, 12, 6, 0]) & 63].reshape(-1, 12)
    place = np.arange(12)
    text[place >= (length * 4 + 2) // 3] = ord("=")
    text[place >= (length + 2) // 3 * 4] = 0
    return text


def parse(
    file: BinaryIO, name: str, add_remark: AddRemark | None = None, bus: str | None = None
) -> Iterator[FrameArray]:
    """Yield the frames of a file, block by block.

    FormatError names the first line that is no frame, or the columns that are missing.

    Parameters
    ----------
    file
        A file that is open for reading bytes.
    name
        Name of the file in messages.
    add_remark
        Called at the end with each remark on what the file says and the frames do not hold.
        Without it, each remark is a CanserWarning.
    bus
        Channel to read, None for all.
    """
    unkept = Unkept(bus)
    yield from _text.in_blocks(_rows(file, name, unkept))
    unkept.check_bus(name)
    report_remarks(unkept.remarks(), name, add_remark)


def _rows(file: BinaryIO, name: str, unkept: Unkept) -> Iterator[Row]:
    numbered = _text.lines(file, name, unkept)
    try:
        first, header = next(numbered)
    except StopIteration:
        return
    try:
        names = _names(header)
    except (ValueError, csv.Error) as error:
        raise FormatError(f"{name}, line {first}: {error}") from None
    missing = [column for column in COLUMNS if column not in names]
    if missing:
        raise FormatError(
            f"{name}: no column {', '.join(missing)}; the first line must name {','.join(COLUMNS)}"
        )
    if unkept.bus is not None and "channel" not in names:
        raise FormatError(f"{name}: no column channel names the bus; leave the bus out")
    places = [names.index(column) for column in COLUMNS]
    channel, direction = (names.index(each) if each in names else None for each in _COUNTED)
    unkept.columns = [each for each in names if each not in COLUMNS and each not in _COUNTED]
    for number, text in numbered:
        try:
            fields = next(csv.reader([text], strict=True, skipinitialspace=True))
            if len(fields) != len(names):
                raise ValueError(f"{len(fields)} fields where the header has {len(names)}")
            if unkept.is_other_bus(None if channel is None else fields[channel]):
                continue
            yield check_row(_row([fields[place] for place in places]))
        except (ValueError, csv.Error) as error:
            raise FormatError(f"{name}, line {number}: {error}") from None
        unkept.add(
            None if channel is None else fields[channel],
            None if direction is None else fields[direction],
        )


def _names(header: str) -> list[str]:
    """Return the names of the columns."""
    written = next(csv.reader([header], strict=True, skipinitialspace=True))
    # python-can 2.0 and 2.1 wrote "arbitration id", and a blank behind each comma.
    names = [each.strip(_text.BLANKS).replace(" ", "_") for each in written]
    for each in (*COLUMNS, *_COUNTED):
        if names.count(each) > 1:
            raise ValueError(f"the column {each} is there {names.count(each)} times")
    return names


def _hexadecimal(text: str) -> int:
    if not _HEXADECIMAL.fullmatch(text):
        raise ValueError
    return int(text, 16)


def _whole(text: str) -> int:
    if not _WHOLE.fullmatch(text):
        raise ValueError
    return int(text)


def _flag(text: str) -> bool:
    return _FLAGS[text.lower()]


def _bytes(text: str) -> bytes:
    data = base64.b64decode(text, validate=True)
    # Otherwise a text whose last character has unused bits would pass: it decodes to the same
    # bytes as another text.
    if base64.b64encode(data).decode() != text:
        raise ValueError
    return data


# For each column the function that reads it, and what a message says its text must be.
_COLUMNS: Final[tuple[tuple[Callable[[str], Any], str], ...]] = (
    (_text.parse_seconds, "a time in seconds"),
    (_hexadecimal, "a hexadecimal number"),
    (_flag, "0 or 1"),
    (_flag, "0 or 1"),
    (_flag, "0 or 1"),
    (_whole, "a number"),
    (_bytes, "base64"),
)


def _row(fields: list[str]) -> Row:
    values = []
    for name, text, (parse, kind) in zip(COLUMNS, fields, _COLUMNS, strict=True):
        try:
            values.append(parse(text))
        except (ValueError, KeyError):
            raise ValueError(f"{name} is {text[:60]!r}; it must be {kind}") from None
    ts, arbitration_id, ext, rtr, err, dlc, data = values
    return arbitration_id, ext, rtr, dlc, err, data, ts
