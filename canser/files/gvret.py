"""The table of SavvyCAN and of GVRET devices.

    Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
    1767225600123456,00000123,true,Rx,0,3,01,02,03,

Time in whole microseconds, id and bytes in hexadecimal with or without zeros before them, the bus
from 0. Files of old devices have no column Dir. A LEN over 8 is CAN FD: such rows are counted, and
left out. Source: SavvyCAN, `framefileio.cpp`.

The format has no remote frames and no error frames: the writer leaves them out, and counts them.
"""

import re
from typing import BinaryIO, Final

from canser._core.text import Codes, TextWriter
from canser._frames import FrameArray
from canser._input import Input
from canser._rows import check_row
from canser.errors import FormatError
from canser.files.foreign import is_text
from canser.files.lines import Line, LineReader
from canser.files.linewriter import LineWriter
from canser.files.reader import Reader, ReadOptions
from canser.files.writer import WriteOptions

about: Final = "a GVRET table"

cannot_hold: Final = (
    "times under a microsecond",
    "whether a time is known",
    "remote frames",
    "error frames",
)

_COLUMNS: Final = ("Time Stamp", "ID", "Extended", "Dir", "Bus", "LEN")
_DATA: Final = tuple(f"D{number}" for number in range(1, 9))
_HEADER: Final = ",".join([*_COLUMNS, *_DATA]).encode() + b"\n"

# The columns that C knows: all of them, and without Dir.
_IN_C: Final = {
    (*_COLUMNS, *_DATA): b"d",
    (*(name for name in _COLUMNS if name != "Dir"), *_DATA): b"",
}

_HEXADECIMAL: Final = re.compile("[0-9A-Fa-f]{1,8}")
_WHOLE: Final = re.compile("-?[0-9]{1,16}")


def sniff(head: bytes) -> bool:
    """Return whether a file starts with the header that SavvyCAN writes."""
    return is_text(head) and bool(
        re.match(rb"(?:\xef\xbb\xbf)?\s*Time Stamp *, *ID *, *Extended *,", head, re.IGNORECASE)
    )


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a table."""
    return _TableReader(source, options)


def write(file: BinaryIO, options: WriteOptions) -> "Writer":  # noqa: ARG001 - as every format
    """Begin a table."""
    return Writer(file)


class Writer(LineWriter):
    """Writes frames as rows under a header."""

    takes_tags = True

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, TextWriter("gvret"))
        self._remote = self._error = 0  # frames left out
        self._file.write(_HEADER)

    def write(
        self, frames: FrameArray, channels: Codes | None = None, directions: Codes | None = None
    ) -> None:
        """Append frames."""
        wrong = frames["rtr"] | frames["err"]
        if wrong.any():
            self._error += int(frames["err"].sum())
            self._remote += int((frames["rtr"] & ~frames["err"]).sum())
            frames = frames.compress(~wrong)
            channels = None if channels is None else channels.compress(~wrong)
            directions = None if directions is None else directions.compress(~wrong)
        self._put(frames, channels, directions)

    def finish(self) -> list[str]:
        """Write the rest; return what the table could not hold."""
        self._end()
        remarks = {
            "remote frames, left out": self._remote,
            "error frames, left out": self._error,
            "frames without a time, written as 0": self._lines.state.unknown_times,
            "times cut to the microsecond": self._lines.state.cut_times,
        }
        return [f"{what}: {count:,}" for what, count in remarks.items() if count]


class _TableReader(LineReader):
    format = "gvret"
    first_channel = 0

    def __init__(self, source: Input, options: ReadOptions) -> None:
        super().__init__(source, options)
        self._places: dict[str, int] = {}  # of the columns by their names; empty before the header

    def _parse(self, text: str) -> Line | None:
        fields = [field.strip() for field in text.rstrip(",").split(",")]
        if not self._places:
            self._read_header(fields)
            return None
        last = self._places["len"]
        if len(fields) <= last:
            raise ValueError(f"{len(fields)} fields where the header has {len(self._places)}")
        time, number = fields[self._places["time stamp"]], fields[self._places["id"]]
        if not _WHOLE.fullmatch(time) or not _HEXADECIMAL.fullmatch(number):
            raise ValueError(f"{text[:60]!r} is no frame")
        ext = {"true": True, "false": False}.get(fields[self._places["extended"]].lower())
        size = fields[last]
        if ext is None or not _WHOLE.fullmatch(size):
            raise ValueError(f"{text[:60]!r} is no frame")
        dlc = int(size)
        if 8 < dlc <= 64:
            self._c.state.fd_count += 1
            return None
        first = self._places["d1"]
        digits = fields[first : first + dlc]
        if len(digits) < dlc or not all(re.fullmatch("[0-9A-Fa-f]{1,2}", each) for each in digits):
            raise ValueError(f"LEN is {dlc}, but the bytes are {' '.join(digits)[:40]!r}")
        data = bytes(int(each, 16) for each in digits)
        row = check_row((int(number, 16), ext, False, dlc, False, data, int(time) * 1000))
        place = self._places.get("dir")
        return Line(row, fields[self._places["bus"]], None if place is None else fields[place])

    def _read_header(self, fields: list[str]) -> None:
        self._places = {name.lower(): place for place, name in enumerate(fields)}
        wanted = ["time stamp", "id", "extended", "bus", "len", "d1"]
        missing = [name for name in wanted if name not in self._places]
        if missing:  # also with skip_bad: without a header no line can be read
            raise FormatError(
                f"{self._source.name}: no column {', '.join(missing)}; the first line must name "
                "them"
            )
        columns = _IN_C.get(tuple(fields))
        self._in_c = columns is not None
        if columns is not None:
            self._c.state.columns = columns
