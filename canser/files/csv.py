"""Comma-separated values with the columns of python-can's CSVWriter.

    timestamp,arbitration_id,extended,remote,error,dlc,data
    1631416514.717133,0xd2,0,0,0,8,AAD//xAAAAA=

timestamp in seconds (nan if it is not known), arbitration_id in hexadecimal, flags 0 or 1, data in
base64. Source: python-can, `can.io.csv`.

Times are exact: they have six decimal places, or nine if a frame's time has nanoseconds. The
reader finds columns by their names, so they may be in any order. There may be more columns; the
reader reports which it does not read. A dlc over 8 is the only mark of a CAN FD frame: such rows
are counted, and left out. python-can 2.0 and 2.1 wrote the header as
`timestamp, arbitration id, extended, remote, error, dlc, data`.
"""

import base64
import csv
import re
from collections.abc import Callable
from typing import Any, BinaryIO, Final

from canser._core.text import TextWriter
from canser._frames import FrameArray
from canser._input import Input
from canser._rows import Row, check_row
from canser.errors import FormatError
from canser.files.foreign import is_text
from canser.files.lines import BLANKS, Line, LineReader
from canser.files.linewriter import LineWriter
from canser.files.reader import Reader, ReadOptions
from canser.files.seconds import parse_seconds
from canser.files.tags import printable
from canser.files.writer import WriteOptions

about: Final = "a CSV file of python-can"

cannot_hold: Final = ("the channel", "the direction")

COLUMNS: Final = ("timestamp", "arbitration_id", "extended", "remote", "error", "dlc", "data")

# Columns that FRAME_DTYPE has no field for.
_TAGS: Final = ("channel", "direction")

# Columns without a meaning that a remark names.
_NAMED_MOST: Final = 16

# More digits than an id or a dlc has, so that a number too large is reported as such; and few
# enough for a message.
_HEXADECIMAL: Final = re.compile("(?:0[xX])?[0-9A-Fa-f]{1,16}")
_WHOLE: Final = re.compile("-?[0-9]{1,16}")

_FLAGS: Final = {"0": False, "1": True, "false": False, "true": True}


def sniff(head: bytes) -> bool:
    """Return whether a file starts with the header that python-can writes."""
    return is_text(head) and bool(re.match(rb"(?:\xef\xbb\xbf)?timestamp, ?arbitration.id,", head))


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a file."""
    return _CsvReader(source, options)


def write(file: BinaryIO, options: WriteOptions) -> "Writer":  # noqa: ARG001 - as every format
    """Begin a file."""
    return Writer(file)


class Writer(LineWriter):
    """Write frames as rows under a header."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, TextWriter("csv"))
        self._file.write(",".join(COLUMNS).encode() + b"\n")

    def write(self, frames: FrameArray) -> None:
        """Append frames."""
        self._put(frames)

    def finish(self) -> list[str]:
        """Write the rest; return no remarks: the file holds everything."""
        self._end()
        return []


class _CsvReader(LineReader):
    format = "csv"

    def __init__(self, source: Input, options: ReadOptions) -> None:
        super().__init__(source, options)
        self._names: list[str] = []  # of the columns; empty before the header

    def _parse(self, text: str) -> Line | None:
        try:
            if not self._names:
                self._read_header(text)
                return None
            return self._read_fields(next(csv.reader([text], strict=True, skipinitialspace=True)))
        except csv.Error as error:
            raise ValueError(error) from None

    def _read_header(self, text: str) -> None:
        self._names = _names(text)
        missing = [column for column in COLUMNS if column not in self._names]
        name = self._source.name
        if missing:
            raise FormatError(
                f"{name}: no column {', '.join(missing)}; the first line must name "
                f"{','.join(COLUMNS)}"
            )
        if self._options.bus is not None and "channel" not in self._names:
            raise FormatError(f"{name}: no column channel names the bus; leave the bus out")
        self._in_c = tuple(self._names) == COLUMNS

    def _read_fields(self, fields: list[str]) -> Line | None:
        if len(fields) != len(self._names):
            raise ValueError(f"{len(fields)} fields where the header has {len(self._names)}")
        by_name = dict(zip(self._names, fields, strict=True))
        if _WHOLE.fullmatch(by_name["dlc"]) and 8 < int(by_name["dlc"]) <= 64:
            self._c.state.fd_count += 1
            return None
        row = check_row(_row([by_name[column] for column in COLUMNS]))
        return Line(row, by_name.get("channel"), by_name.get("direction"))

    @property
    def remarks(self) -> list[str]:
        remarks = super().remarks
        others = [name for name in self._names if name not in COLUMNS and name not in _TAGS]
        if others:
            shown = [printable(name) for name in others[:_NAMED_MOST]]
            more = ["and more"] if len(others) > _NAMED_MOST else []
            remarks.append(f"columns that are not read: {', '.join([*shown, *more])}")
        return remarks


def _names(header: str) -> list[str]:
    """Return the names of the columns."""
    written = next(csv.reader([header], strict=True, skipinitialspace=True))
    # python-can 2.0 and 2.1 wrote "arbitration id", and a blank behind each comma.
    names = [each.strip(BLANKS).replace(" ", "_") for each in written]
    for each in (*COLUMNS, *_TAGS):
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
    (parse_seconds, "a time in seconds"),
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
