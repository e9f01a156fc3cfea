"""The log of Vector's CANalyzer and CANoe, in text.

    date Thu Jan 01 00:00:00.123 2026
    base hex  timestamps absolute
    internal events logged
    Begin Triggerblock Thu Jan 01 00:00:00.123 2026
       0.000000 Start of measurement
       0.001000 1  123x            Rx   d 8 01 02 03 04 05 06 07 08
       0.002000 2  7FF             Tx   r 8
       0.003000 1  ErrorFrame
       0.004000 CANFD   1 Rx        456    0 0 3  3 AA 55 BB   130000  130        0 0 0 0 0 0
    End TriggerBlock

Channels count from 1. An id with an x is extended. Times count from the Begin Triggerblock, or from
the date if there is none. Both are local time, without a zone. With "timestamps relative" a time
counts from the line before, whatever event that was. Source: files of Vector's programs, and
python-can, `can.io.asc`.

A CANFD line holds a frame of classic CAN if bit 0x1000 of its flags is not set. True CAN FD frames
are counted, and left out. So are `d` lines with more than 8 bytes. An error frame tells no id. The
writer cuts times to the microsecond, and counts what it cannot hold.
"""

import datetime as dt
import re
from typing import BinaryIO, Final

import numpy as np

from canser._core.text import Codes, TextWriter
from canser._dates import date_ns, first_date, local_date
from canser._frames import NO_TIME, FrameArray
from canser._input import Input
from canser._rows import check_row
from canser.files.foreign import is_text
from canser.files.lines import Line, LineReader
from canser.files.linewriter import LineWriter
from canser.files.reader import Reader, ReadOptions
from canser.files.seconds import parse_seconds
from canser.files.writer import WriteOptions

about: Final = "an ASC log of Vector"

cannot_hold: Final = (
    "times under a microsecond",
    "whether a time is known",
    "ids, data and directions of error frames",
)

# Groups: month, day, hours, minutes, seconds, places, am or pm, year.
_DATE: Final = re.compile(
    r"(?:\S+\s+)?([^\W\d_]+)\.?\s+(\d{1,2})\s+(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d+))?\s*"
    r"(am|pm)?\s+(\d{4})",
    re.IGNORECASE,
)

# Months as programs write them in English, German, French, Spanish and Italian.
_MONTHS: Final = [
    ("jan", "gen", "ene"), ("feb", "fév", "fev"), ("mar", "mrz", "mär"), ("apr", "avr", "abr"),
    ("may", "mai", "mag"), ("jun", "juin", "giu"), ("jul", "juil", "lug"), ("aug", "aoû", "ago"),
    ("sep", "set"), ("oct", "okt", "ott"), ("nov",), ("dec", "dez", "dic", "déc"),
]  # fmt: skip

# A data or a remote frame. Groups: time, channel, id, x, direction, d or r, the rest.
_FRAME: Final = re.compile(
    r"(-?\d+(?:\.\d+)?)\s+(\d+)\s+([0-9A-Fa-f]+)(x?)\s+(Rx|TxRq|Tx)\s+([dr])(?:\s+(.*))?"
)
_ERROR: Final = re.compile(r"(-?\d+(?:\.\d+)?)\s+(\d+)\s+ErrorFrame\b.*")
_FD: Final = re.compile(r"(-?\d+(?:\.\d+)?)\s+CANFD\s+(\d+)\s+(Rx|TxRq|Tx)\s+(.*)")

# Any other line with a time, and those of them that are no traffic.
_EVENT: Final = re.compile(r"(-?\d+(?:\.\d+)?)\s+(.*)")
_QUIET: Final = re.compile(
    r"Start of measurement|.*\b(?:Statistic|Status):|.*\bJ1939TP\b|.*log trigger|.*//",
    re.IGNORECASE,
)

# The date 1970-01-01, in any time zone, is none: the writer gives it for times that are no dates.
_NO_DATE_NS: Final = 86_400 * 10**9

# Bits of the flags of a CANFD line.
_FLAG_FD, _FLAG_REMOTE = 0x1000, 0x10

_HEADER: Final = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?:date\s|base\s+(?:hex|dec)\b)", re.IGNORECASE)
_BASE: Final = re.compile(rb"^\s*base\s+(?:hex|dec)\b", re.IGNORECASE | re.MULTILINE)


def sniff(head: bytes) -> bool:
    """Return whether a file starts with the header of an ASC log."""
    return is_text(head) and bool(_HEADER.match(head) and _BASE.search(head))


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a log."""
    return _AscReader(source, options)


def write(file: BinaryIO, options: WriteOptions) -> "Writer":
    """Begin a log."""
    return Writer(file, options.tz)


class Writer(LineWriter):
    """Writes frames as lines, behind a header with the time of the first frame."""

    takes_tags = True

    def __init__(self, file: BinaryIO, tz: dt.tzinfo | None = None) -> None:
        super().__init__(file, TextWriter("asc"))
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
        start_ns = first_date(frames, step_ns=1_000_000)
        self._lines.state.start_ns = start_ns
        date = local_date(start_ns, self._tz)
        text = f"{date:%a %b %d %H:%M:%S}.{date.microsecond // 1000:03} {date:%Y}"
        self._file.write(
            f"date {text}\nbase hex  timestamps absolute\ninternal events logged\n"
            f"Begin Triggerblock {text}\n   0.000000 Start of measurement\n".encode()
        )

    def finish(self) -> list[str]:
        """Write the end; return what the log could not hold."""
        if not self._begun:
            self._begin(np.empty(0, [("ts", np.int64)]))
        self._file.write(b"End TriggerBlock\n")
        self._end()
        state = self._lines.state
        remarks = {
            "error frames without their id, data and direction": state.error_frames,
            "frames without a time, written as 0": state.unknown_times,
            "times cut to the microsecond": state.cut_times,
        }
        return [f"{what}: {count:,}" for what, count in remarks.items() if count]


def _number(text: str, base: int) -> int:
    """Return a number of digits only; ValueError for any other text."""
    try:
        if text.isascii() and text.isalnum():  # int() takes signs, underscores, other digits
            return int(text, base)
    except ValueError:
        pass
    kind = "decimal" if base == 10 else "hexadecimal"
    raise ValueError(f"{text[:60]!r} is no {kind} number; is the line 'base' right?")


class _AscReader(LineReader):
    format = "asc"
    first_channel = 1

    def __init__(self, source: Input, options: ReadOptions) -> None:
        super().__init__(source, options)
        self._base = 16
        self._events = 0  # lines of events that are not known
        self._dates_wrong = 0

    def _parse(self, text: str) -> Line | None:
        for pattern, take in (
            (_FRAME, self._frame),
            (_ERROR, self._error),
            (_FD, self._fd_frame),
        ):
            found = pattern.fullmatch(text)
            if found:
                return take(found)
        found = _EVENT.fullmatch(text)
        if found:
            self._time(found[1])
            self._events += not _QUIET.match(found[2])
        elif not self._take_header(text):
            raise ValueError(
                f"{text[:60]!r} is no line of an ASC log, such as 0.001 1  123  Rx  d 1 AB"
            )
        return None

    def _time(self, text: str) -> int:
        """Return a time; a relative one counts from the line before."""
        ts = parse_seconds(text)
        state = self._c.state
        if state.is_relative:
            ts += state.last_ns
            if not NO_TIME < ts < -NO_TIME:
                raise ValueError("the relative times add up to over 64 bits of nanoseconds")
            state.last_ns = ts
        return ts

    def _take_header(self, text: str) -> bool:
        lower = text.lower()
        if lower.startswith("base "):
            self._base = 10 if "base dec" in lower else 16
            self._c.state.is_decimal = self._base == 10
            self._c.state.is_relative = "relative" in lower
            if "internal events" in lower and self.start_ns is not None:
                # BUSMASTER writes both in a line, and counts times from midnight.
                self.start_ns = self._midnight(self.start_ns)
        elif lower.startswith(("date ", "begin triggerblock")):
            start_ns = self._date(text)
            if lower.startswith("begin") or self.start_ns is None:
                self.start_ns = start_ns if start_ns is not None else self.start_ns
        elif not lower.startswith(("//", "internal events", "no internal", "end trigger")):
            return False
        return True

    def _date(self, text: str) -> int | None:
        found = _DATE.search(text)
        if not found:
            self._dates_wrong += text.lower() != "begin triggerblock"
            return None
        month, day, hours, minutes, seconds, places, half, year = found.groups()
        number = next(
            (place for place, names in enumerate(_MONTHS, 1) if month.lower().startswith(names)), 0
        )
        hour = int(hours)
        if half:
            hour = hour % 12 + 12 * (half.lower() == "pm")
        try:
            moment = dt.datetime(int(year), number, int(day), hour, int(minutes), int(seconds))
        except ValueError:
            self._dates_wrong += 1
            return None
        start_ns = date_ns(moment, self._options.tz) + int((places or "")[:9].ljust(9, "0"))
        return start_ns if abs(start_ns) > _NO_DATE_NS else None

    def _midnight(self, start_ns: int) -> int:
        day = local_date(start_ns, self._options.tz).replace(
            hour=0, minute=0, second=0, microsecond=0, tzinfo=None
        )
        return date_ns(day, self._options.tz)

    def _frame(self, found: re.Match[str]) -> Line | None:
        time, channel, digits, x, direction, kind, rest = found.groups()
        tokens = (rest or "").partition("Length")[0].split()
        ts = self._time(time)
        rtr = kind == "r"
        if rtr:
            dlc, data = min(_number(tokens[0], 16), 8) if tokens else 0, b""
        else:
            if not tokens:
                raise ValueError("a data frame without a dlc")
            size = tokens.pop(0)
            if len(tokens) > 8:
                self._c.state.fd_count += 1
                return None
            data = bytes(map(self._byte, tokens))
            dlc = min(_number(size, 16 if len(size) == 1 else 10), 8)
        row = (self._whole(digits), bool(x), rtr, dlc, False, data, ts)
        return Line(check_row(row), channel, direction)

    def _whole(self, text: str) -> int:
        """Return a number in the base of the log."""
        return _number(text, self._base)

    def _byte(self, text: str) -> int:
        number = self._whole(text)
        if number > 0xFF:
            raise ValueError(f"{text[:60]!r} is no byte: it is over 255")
        return number

    def _error(self, found: re.Match[str]) -> Line:
        time, channel = found.groups()
        return Line((0, False, False, 0, True, b"", self._time(time)), channel)

    def _fd_frame(self, found: re.Match[str]) -> Line | None:
        time, channel, direction, rest = found.groups()
        ts = self._time(time)
        tokens = rest.split()
        digits = tokens.pop(0)
        if tokens[:2] and not (tokens[0] in "01" and tokens[1] in "01"):
            tokens.pop(0)  # the name of the message
        try:
            brs, _, size, length = tokens[:4]
            count = int(length)
            data = bytes(int(token, 16) for token in tokens[4 : 4 + count])
            flags = int(tokens[4 + count + 2], 16)
        except (ValueError, IndexError):
            if not digits.startswith("ErrorFrame"):
                raise ValueError(f"a CANFD line that cannot be read: {rest[:40]!r}") from None
            flags, brs = _FLAG_FD, "0"
        if flags & _FLAG_FD or brs == "1" or count > 8:
            self._c.state.fd_count += 1
            return None
        rtr = bool(flags & _FLAG_REMOTE)
        row = (int(digits.rstrip("x"), 16), digits.endswith("x"), rtr, min(int(size, 16), 8), False,
               b"" if rtr else data, ts)  # fmt: skip
        return Line(check_row(row), channel, direction)

    @property
    def remarks(self) -> list[str]:
        remarks = super().remarks
        if self._events:
            remarks.append(f"lines of other events, left out: {self._events:,}")
        if self._dates_wrong:
            remarks.append("its date cannot be read")
        return remarks
