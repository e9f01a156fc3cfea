"""The formats of can-utils' candump: its log, as `candump -L` writes, and its screen.

    (1544106679.432583) can0 562#122DF953813CA2
    (1544106679.432600) can0 18FEF100#            extended: eight digits
    (1544106679.432610) can0 123#R8               remote, with its dlc
    (1544106679.432620) can0 20000080#00          error: bit 29 of eight digits
    (1544106679.432630) can1 123#11.22 T          bytes with dots, the direction (R or T)
    (1544106679.432640) can1 123#0011223344556677_E   a raw dlc of 9 to 15 (F)
    # a comment

     (2018-12-06 14:31:19.432583)  can0  123   [2]  11 22   '."'
    can0  RX - -  18FEF100   [8]  remote request
    <0x18eeff01> [8] 05 a0 be 1c 00 a0 a0 c0      before can-utils; no channel

Source: can-utils, `candump` and the frame notation of its `lib.c`.

FRAME_DTYPE has no field for a raw dlc: the reader counts such frames. Lines of CAN FD and CAN XL
are counted, and left out.

An error frame has eight digits because of its flag. So a log does not say whether an error frame
with an id up to 0x7FF is extended. Times have six decimal places: a part under a microsecond is
cut, and a time that is not known is written as 0. `Writer` counts both.
"""

import datetime as dt
import re
from collections.abc import Mapping
from typing import BinaryIO, Final

import numpy as np
import numpy.typing as npt

from canser import _notation
from canser._core.text import Codes, TextWriter
from canser._dates import to_ns
from canser._frames import NO_TIME, FrameArray, copy_records
from canser._input import Input
from canser._rows import check_row
from canser.files.foreign import is_text
from canser.files.lines import Line, LineReader
from canser.files.linewriter import LineWriter
from canser.files.reader import Reader, ReadOptions
from canser.files.seconds import parse_seconds
from canser.files.tags import printable
from canser.files.writer import WriteOptions

about: Final = "a candump log"

cannot_hold: Final = (
    "times under a microsecond",
    "whether a time is known",
    "whether an error frame is extended, where its id is up to 0x7FF",
)

# A line of a log. Groups: the time, the channel, the groups of the frame's notation, the direction.
_LINE: Final = re.compile(
    r"\((-?[0-9]+(?:\.[0-9]+)?)\)[ \t]+([^\s\0-\x1f\x7f]+)[ \t]+"
    rf"{_notation.PATTERN}(?:[ \t]+([RT]))?"
)

# A line of CAN FD; and of CAN XL, which has a priority of five digits before the first #.
_FD: Final = re.compile(
    r"\([-0-9.]+\)[ \t]+\S+[ \t]+[0-9A-Fa-f]{3,8}##[0-9A-Fa-f.]+(?:[ \t]+[RT])?"
)
_XL: Final = re.compile(
    r"\([-0-9.]+\)[ \t]+\S+[ \t]+[0-9A-Fa-f]{5}#[0-9A-Fa-f:.]+#[0-9A-Fa-f.]*(?:[ \t]+[RT])?"
)

# A line of the screen. Groups: date, time, channel, direction, id, length in brackets, the rest.
_SCREEN: Final = re.compile(
    r"(?:\((?:([0-9]{4}-[0-9]{2}-[0-9]{2})[ _T])?(-?[0-9:]+(?:\.[0-9]+)?)\)[ \t]+)?"
    r"(?:([^\s\0-\x1f\x7f]+)[ \t]+)?(?:([RT]X)[ \t]+\S+[ \t]+\S+[ \t]+)?"
    r"(?:<0x([0-9A-Fa-f]{3,8})>|([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}))[ \t]+"
    r"\[([0-9]{1,2})\](?:[ \t]+(.*))?"
)
_BYTE: Final = re.compile(r"(?<![^ \t])[0-9A-Fa-f]{2}(?![^ \t])")

# The start of a line of a log, up to the "#" of its frame, and a line of the screen, up to the
# length in brackets.
_BEGIN: Final = re.compile(rb"^\(\d+\.\d+\) +\S+ +[0-9A-Fa-f]+#", re.MULTILINE)
_BEGIN_SCREEN: Final = re.compile(
    rb"^ *(?:\([-0-9:. _T]+\) +)?(?:[\w.-]+ +)?(?:[RT]X +\S+ +\S+ +)?"
    rb"(?:<0x[0-9A-Fa-f]+>|[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}) +\[\d+\](?: |$)",
    re.MULTILINE,
)


def sniff(head: bytes) -> bool:
    """Return whether the first bytes of a file have the start of a line of a log or a screen."""
    return is_text(head, least=1) and bool(_BEGIN.search(head) or _BEGIN_SCREEN.search(head))


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a log."""
    return _LogReader(source, options)


def write(file: BinaryIO, options: WriteOptions) -> "Writer":
    """Begin a log."""
    return Writer(file, options.channel_names)


class _LogReader(LineReader):
    format = "candump"

    def __init__(self, source: Input, options: ReadOptions) -> None:
        super().__init__(source, options)
        self._raw_dlcs = 0  # frames with a raw dlc of 9 to 15, which is 8 bytes

    def _parse(self, text: str) -> Line | None:
        found = _LINE.fullmatch(text)
        if found:
            ts, channel, *notation, raw_dlc, direction = found.groups()
            row = _notation.groups_to_row((*notation, raw_dlc), parse_seconds(ts))
            self._raw_dlcs += bool(raw_dlc)
            return Line(row, channel, direction)
        if text.startswith(("#", "interface = ")):
            return None
        if _FD.fullmatch(text):
            self._c.state.fd_count += 1
            return None
        if _XL.fullmatch(text):
            self._xl_count += 1
            return None
        found = _SCREEN.fullmatch(text)
        if not found:
            raise ValueError(
                f"{text[:60]!r} is {_notation.not_read(text)}; canser reads lines such as "
                "(1544106679.432583) can0 562#122DF953"
            )
        return self._screen_line(found)

    def _screen_line(self, found: re.Match[str]) -> Line | None:
        date, time, channel, direction, old_digits, digits, length, rest = found.groups()
        if len(length) == 2:  # candump writes [08] for CAN FD, and [8] for classic CAN
            self._c.state.fd_count += 1
            return None
        number, dlc = int(old_digits or digits, 16), int(length)
        # An old line has as many digits as the id needs.
        ext = number > 0x7FF if old_digits else len(digits) == 8
        err = ext and bool(number & _notation.ERR_FLAG)
        if err:
            number &= 0x1FFF_FFFF
            ext = number > 0x7FF
        rtr = (rest or "").startswith("remote request")
        # Behind the bytes may stand their text, such as 'AB CD'.
        data = b"" if rtr else bytes.fromhex("".join(_BYTE.findall(rest or "")[:dlc]))
        if time is None:
            ts = NO_TIME
        elif date is None:
            ts = parse_seconds(time)
        else:
            ts = to_ns(dt.date.fromisoformat(date), time, self._options.tz)
        return Line(check_row((number, ext, rtr, dlc, err, data, ts)), channel, direction)

    @property
    def remarks(self) -> list[str]:
        remarks = super().remarks
        if self._raw_dlcs:
            remarks.append(f"raw dlcs of 9 to 15 become 8: {self._raw_dlcs:,}")
        return remarks


class _Lines(TextWriter):
    """Lines of a log, with the names of channels, to which more may be added."""

    def __init__(self, names: Mapping[int, str] | None) -> None:
        super().__init__("candump")
        self._names = {} if names is None else names
        self._named = 0  # names that C knows
        self.renamed: list[str] = []  # names that lines cannot have

    def add_names(self) -> None:
        """Take the names that were added since the last call."""
        for code, name in list(self._names.items())[self._named :]:
            self._named += 1
            if not self.add_name(name, code):
                self.renamed.append(f"{printable(name)} is can{code}")


class Writer(LineWriter):
    """Write frames as lines of a log."""

    takes_tags = True

    def __init__(self, file: BinaryIO, names: Mapping[int, str] | None = None) -> None:
        self._log = _Lines(names)
        super().__init__(file, self._log)

    def write(
        self, frames: FrameArray, channels: Codes | None = None, directions: Codes | None = None
    ) -> None:
        """Append frames."""
        self._log.add_names()
        self._put(frames, channels, directions)

    @property
    def ts_cut(self) -> int:
        """Frames whose time lost a part under a microsecond."""
        return int(self._lines.state.cut_times)

    @property
    def ts_unknown(self) -> int:
        """Frames whose time is not known, written as 0."""
        return int(self._lines.state.unknown_times)

    def finish(self) -> list[str]:
        """Write the rest; return what a log could not hold."""
        self._end()
        remarks = {
            "frames without a time, written as 0": self.ts_unknown,
            "times cut to the microsecond": self.ts_cut,
        }
        names = ", ".join(self._log.renamed[:16])
        renamed = [f"channels with other names: {names}"] if names else []
        return [*(f"{what}: {count:,}" for what, count in remarks.items() if count), *renamed]


# How a time is shown, as the letters of `candump -t`: seconds, date and time of day, seconds since
# the frame before, seconds since the first frame.
STAMPS: Final = ("a", "A", "d", "z")


class Dump:
    """Shows frames as lines, with times as `candump -t` has them."""

    def __init__(self, stamps: str, names: Mapping[int, str] | None = None) -> None:
        self._stamps = stamps
        self._last_ns = NO_TIME  # time of the frame before; with "z" of the first frame
        self._lines = _Lines(names)
        self._lines.state.is_dated = stamps == "A"

    def text(
        self, frames: FrameArray, channels: Codes | None = None, directions: Codes | None = None
    ) -> bytes:
        """Return frames as lines; a time that is not known is shown as 0."""
        if self._stamps in ("d", "z"):
            unknown = frames["ts"] == NO_TIME
            since = self._since(frames["ts"], unknown)
            frames = copy_records(frames)
            frames["ts"] = since
        self._lines.add_names()
        return b"".join(map(bytes, self._lines.lines(frames, channels, directions)))

    def _since(
        self, ts: npt.NDArray[np.int64], unknown: npt.NDArray[np.bool_]
    ) -> npt.NDArray[np.int64]:
        known = ts[~unknown]
        since = np.zeros_like(ts)
        if not len(known):
            return since
        if self._last_ns == NO_TIME:
            self._last_ns = int(known[0])
        if self._stamps == "z":
            since[~unknown] = known - self._last_ns
        else:
            since[~unknown] = np.diff(known, prepend=self._last_ns)
            self._last_ns = int(known[-1])
        return since
