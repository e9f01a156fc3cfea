"""The trace of PEAK's PCAN programs: versions 1.0 to 2.1 are read, 2.1 is written.

    ;$FILEVERSION=2.1
    ;$STARTTIME=46023.0000014289
    ;$COLUMNS=N,O,T,B,I,d,R,L,D
          1         0.000 DT 1     0123 Rx -  2    01 02
          2         1.000 RR 2 18FEF100 Tx -  4
          3         4.000 ER 1        - Rx -  5    08 00 19 00 00

Times are milliseconds since the start, which is given in days since 1899-12-30, local time without
a zone. Ids of four digits are standard, longer ones extended. Buses count from 1. Source:
PEAK-System, "PCAN trace file format".

CAN FD frames are counted, and left out. Lines of status, counters and events are no frames. An
error frame tells no id; its data are PEAK's error bytes. The writer cuts times to the microsecond,
and counts what it cannot hold.
"""

import datetime as dt
import re
from typing import BinaryIO, Final

import numpy as np

from canser._core.text import Codes, TextWriter
from canser._dates import date_ns, first_date, local_date
from canser._frames import FrameArray
from canser._input import Input
from canser._rows import check_row
from canser.files.foreign import is_text
from canser.files.lines import Line, LineReader
from canser.files.linewriter import LineWriter
from canser.files.reader import Reader, ReadOptions
from canser.files.writer import WriteOptions

about: Final = "a PCAN trace"

cannot_hold: Final = (
    "times under a microsecond",
    "whether a time is known",
    "ids and data of error frames",
)

# Columns of the versions without $COLUMNS; "t" is a type Rx or Tx, see csrc/text/trc.c.
_COLUMNS: Final = {"1.0": "NOILD", "1.1": "NOtILD", "1.2": "NOBtILD", "1.3": "NOBtIRLD"}

# Types of lines that are no frames: status, counters, events, warnings. And those of CAN FD.
_OTHER: Final = ("ST", "EC", "EV", "Warng", "Stat", "Statu", "Event")
_FD: Final = ("FD", "FB", "FE", "BI")

_DAY_ONE: Final = dt.datetime(1899, 12, 30)
_DAY_NS: Final = 86_400 * 10**9

# A start has ten places of a day, 8.64 us each. 25 of them are whole microseconds: a start that is
# written is a multiple of these, so that it reads back exactly.
_START_STEP_NS: Final = 216_000

_HEADER: Final = re.compile(rb"(?:\xef\xbb\xbf)?;\$FILEVERSION=", re.IGNORECASE)
_OLD_HEADER: Final = re.compile(rb"^;[^\r\n]*(?:PCAN|PEAK|CAN activities)", re.MULTILINE)
_OLD_LINE: Final = re.compile(rb"^ *\d+\) +\d+(?:\.\d+)? ", re.MULTILINE)
_OLD_START: Final = re.compile(
    r"Start time:\s+(\d{1,2})\.(\d{1,2})\.(\d{4})\s+(\d{1,2}):(\d{2}):(\d{2})(?:\.(\d{3}))?"
)


def sniff(head: bytes) -> bool:
    """Return whether a file starts as a PCAN trace."""
    if not is_text(head):
        return False
    old = head.startswith(b";") and _OLD_HEADER.search(head) and _OLD_LINE.search(head)
    return bool(_HEADER.match(head) or old)


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a trace."""
    return _TrcReader(source, options)


def write(file: BinaryIO, options: WriteOptions) -> "Writer":
    """Begin a trace."""
    return Writer(file, options.tz)


class Writer(LineWriter):
    """Writes frames as lines of version 2.1, behind a header with the time of the first frame."""

    takes_tags = True

    def __init__(self, file: BinaryIO, tz: dt.tzinfo | None = None) -> None:
        super().__init__(file, TextWriter("trc"))
        self._tz = tz
        self._begun = False

    def write(
        self, frames: FrameArray, channels: Codes | None = None, directions: Codes | None = None
    ) -> None:
        """Append frames."""
        if not self._begun:
            self._begin(frames)
        self._put(frames, channels, directions)

    def _begin(self, frames: FrameArray) -> None:
        self._begun = True
        start_ns, start = first_date(frames, step_ns=1_000_000), ""
        if start_ns:
            date = local_date(start_ns, self._tz).replace(tzinfo=None)
            since = date - _DAY_ONE
            of_day = (since.seconds * 1_000_000 + since.microseconds) * 1_000
            start_ns -= of_day % _START_STEP_NS
            places = of_day // _START_STEP_NS * (_START_STEP_NS * 10**10 // _DAY_NS)
            start = f";$STARTTIME={since.days}.{places:010}\n"
        self._lines.state.start_ns = start_ns
        self._file.write(
            f";$FILEVERSION=2.1\n{start};$COLUMNS=N,O,T,B,I,d,R,L,D\n;\n"
            ";   Number, time in ms, type, bus, id, direction, reserved, dlc, data\n"
            ";---+-- ------+------ +- +- --+----- +- +- +--- +- -- -- -- -- -- -- --\n".encode()
        )

    def finish(self) -> list[str]:
        """Write the rest; return what the trace could not hold."""
        if not self._begun:
            self._begin(np.empty(0, [("ts", np.int64)]))
        self._end()
        state = self._lines.state
        remarks = {
            "error frames without their id and data": state.error_frames,
            "frames without a time, written as 0": state.unknown_times,
            "times cut to the microsecond": state.cut_times,
        }
        return [f"{what}: {count:,}" for what, count in remarks.items() if count]


class _TrcReader(LineReader):
    format = "trc"
    first_channel = 1

    def __init__(self, source: Input, options: ReadOptions) -> None:
        super().__init__(source, options)
        self._use_columns(_COLUMNS["1.0"])

    def _use_columns(self, columns: str) -> None:
        self._columns = columns
        self._c.state.columns = columns.encode()[:15]

    def _parse(self, text: str) -> Line | None:
        if text.startswith(";"):
            self._take_header(text)
            return None
        tokens = text.split()
        columns = iter(self._columns)
        values: dict[str, str] = {}
        while tokens:
            column = next(columns, None)
            if column is None or column == "D":
                break
            token = tokens.pop(0)
            if column == "I" and token in ("Rx", "Tx"):  # an error frame of version 2.0
                tokens.insert(0, token)
                continue
            values[column] = token
        return self._line(values, tokens, text)

    def _take_header(self, text: str) -> None:
        key, _, value = text[1:].strip().partition("=")
        if key == "$FILEVERSION" and value in _COLUMNS:
            self._use_columns(_COLUMNS[value])
        elif key == "$COLUMNS":
            self._use_columns(value.replace(",", "").replace(" ", ""))
        elif key == "$STARTTIME" and re.fullmatch(r"[0-9]{1,7}(?:\.[0-9]+)?", value):
            days, _, places = value.partition(".")
            date = _DAY_ONE + dt.timedelta(days=int(days))
            of_day = int(places[:15].ljust(15, "0")) * _DAY_NS // 10**15
            # Rounded to microseconds: ten places tell no more.
            self.start_ns = date_ns(date, self._options.tz) + (of_day + 500) // 1000 * 1000
        elif self.start_ns is None and (found := _OLD_START.search(text)):
            day, month, year, hours, minutes, seconds, places = found.groups()
            moment = dt.datetime(
                int(year), int(month), int(day), int(hours), int(minutes), int(seconds)
            )
            self.start_ns = date_ns(moment, self._options.tz) + int(places or 0) * 1_000_000

    def _line(self, values: dict[str, str], rest: list[str], text: str) -> Line | None:
        kind = values.get("T", values.get("t", "DT"))
        if kind in _OTHER or values.get("I") == "FFFFFFFF":
            return None
        if kind in _FD:
            self._c.state.fd_count += 1
            return None
        try:
            ts = _milliseconds(values["O"])
            dlc = int(values.get("L", values.get("l", "")))
            err = kind in ("ER", "Error", "ERROR")
            rtr = kind == "RR" or rest[:1] == ["RTR"]
            digits = values.get("I", "-")
            data = b"" if rtr else bytes(int(each, 16) for each in rest[:8])
            number = 0 if err else int(digits, 16)
            ext = not err and len(digits) > 4
        except (KeyError, ValueError):
            raise ValueError(f"{text[:60]!r} is no line of a PCAN trace") from None
        if dlc > 8 and len(data) == 8:
            dlc = 8
        direction = values.get("d", kind if "t" in self._columns else None)
        row = check_row((number, ext, rtr, dlc, err, data, ts))
        return Line(row, values.get("B", "1"), direction)


def _milliseconds(text: str) -> int:
    """Return milliseconds, such as 4.5, as nanoseconds."""
    whole, _, places = text.partition(".")
    return int(whole) * 1_000_000 + int(places[:6].ljust(6, "0"))
