"""candump's log format, as `candump -L` writes and canplayer reads.

    (1544106679.432583) can0 562#122DF953813CA2
    (1544106679.432600) can0 18FEF100#            extended: eight digits
    (1544106679.432610) can0 123#R8               remote, with its dlc
    (1544106679.432620) can0 20000080#00          error: bit 29 of eight digits
    (1544106679.432630) can1 123#11.22 T          bytes with dots, the direction (R or T)
    (1544106679.432640) can1 123#0011223344556677_E   a raw dlc of 9 to 15 (F)
    # a comment

Source: can-utils, `candump` and the frame notation of its `lib.c`.

FRAME_DTYPE has no field for the channel, the direction and the raw dlc. If lines differ in them,
the reader reports how many frames there were of each.

An error frame has eight digits because of its flag. So a log does not say whether an error frame
with an id up to 0x7FF is extended. Times have six decimal places: a part under a microsecond is
cut, and a time that is not known is written as 0. `Writer` counts both.
"""

import re
from collections.abc import Iterator
from functools import partial
from typing import BinaryIO, Final

import numpy as np
import numpy.typing as npt

from canser import _notation
from canser._frames import NO_TIME, FrameArray
from canser._input import Input
from canser._rows import Row
from canser.errors import FormatError
from canser.files import _text
from canser.files._remarks import AddRemark, Unkept, report_remarks
from canser.files.foreign import is_text
from canser.files.reader import DecodedReader, Reader, ReadOptions
from canser.files.writer import WriteOptions

about: Final = "a candump log"

suffixes: Final = (".log",)

cannot_hold: Final = (
    "times under a microsecond",
    "whether a time is known",
    "whether an error frame is extended, where its id is up to 0x7FF",
)

# Groups: the time, the channel, the groups of the frame's notation, the direction.
_LINE = re.compile(
    r"\((-?[0-9]+(?:\.[0-9]+)?)\)[ \t]+([^\s\0-\x1f\x7f]+)[ \t]+"
    rf"{_notation.PATTERN}(?:[ \t]+([RT]))?"
)


# The start of a line, up to the "#" of its frame.
_BEGIN: Final = re.compile(rb"^\(\d+\.\d+\) +\S+ +[0-9A-Fa-f]+#", re.MULTILINE)


def sniff(head: bytes) -> bool:
    """Return whether the first bytes of a file have the start of a log's line."""
    return is_text(head, least=1) and bool(_BEGIN.search(head))


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a log."""
    return DecodedReader(source, options, partial(parse, bus=options.bus), has_buses=True)


def write(file: BinaryIO, options: WriteOptions) -> "Writer":  # noqa: ARG001 - as every format
    """Begin a log."""
    return Writer(file)


class Writer:
    """Write frames as lines of a log."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.ts_cut = 0  # frames whose time lost a part under a microsecond
        self.ts_unknown = 0  # frames whose time is not known, written as 0

    def write(self, frames: FrameArray) -> None:
        """Append frames."""
        self._file.write(self.text(frames))

    def text(self, frames: FrameArray) -> bytes:
        """Return frames as lines."""
        unknown = frames["ts"] == NO_TIME
        ts = np.where(unknown, 0, frames["ts"])
        self.ts_unknown += int(unknown.sum())
        self.ts_cut += int((ts % 1000 != 0).sum())
        return _lines(frames, _text.seconds(ts, 6))

    def finish(self) -> list[str]:
        """Return what a log could not hold."""
        remarks = {
            "frames without a time, written as 0": self.ts_unknown,
            "times cut to the microsecond": self.ts_cut,
        }
        return [f"{what}: {count:,}" for what, count in remarks.items() if count]


def _lines(frames: FrameArray, times: _text.Column) -> bytes:
    """Return frames as lines, with these times."""
    err = frames["err"]
    long = frames["ext"] | err
    flagged: npt.NDArray[np.uint32] = frames["id"] | err * np.uint32(_notation.ERR_FLAG)
    ids = _text.hexadecimal(flagged, 8)
    ids[:, :5][~long] = 0
    remote = np.zeros((len(frames), 2), np.uint8)
    remote[frames["rtr"], 0] = ord("R")
    remote[:, 1] = np.where(frames["rtr"], frames["dlc"] + ord("0"), 0)
    return _text.join(
        len(frames),
        b"(",
        times,
        b") can0 ",
        ids,
        b"#",
        remote,
        _text.payload(frames),
        b"\n",
    )


# How a time is shown, as the letters of `candump -t`: seconds, date and time of day, seconds since
# the frame before, seconds since the first frame.
STAMPS: Final = ("a", "A", "d", "z")


class Dump:
    """Shows frames as lines, with times as `candump -t` has them."""

    def __init__(self, stamps: str) -> None:
        self._stamps = stamps
        self._last_ns = NO_TIME  # time of the frame before; with "z" of the first frame

    def text(self, frames: FrameArray) -> bytes:
        """Return frames as lines; a time that is not known is shown as 0."""
        unknown = frames["ts"] == NO_TIME
        ts = np.where(unknown, 0, frames["ts"])
        if self._stamps == "A":
            return _lines(frames, _dates(ts))
        if self._stamps != "a":
            ts = self._since(ts, unknown)
        return _lines(frames, _text.seconds(ts, 6))

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


def _dates(ts: npt.NDArray[np.int64]) -> _text.Column:
    """Return times as dates and times of day, UTC, with six decimal places."""
    texts = np.datetime_as_string(ts.view("M8[ns]"), unit="us").astype("S")
    width = texts.dtype.itemsize
    column = np.frombuffer(texts.tobytes(), np.uint8).reshape(len(ts), width).copy()
    column[column == ord("T")] = ord(" ")
    return column


def parse(
    file: BinaryIO, name: str, add_remark: AddRemark | None = None, bus: str | None = None
) -> Iterator[FrameArray]:
    """Yield the frames of a log, block by block.

    FormatError names the first line that is no frame of classic CAN.

    Parameters
    ----------
    file
        A file that is open for reading bytes.
    name
        Name of the file in messages.
    add_remark
        Called at the end with each remark on what the log says and the frames do not hold. Without
        it, each remark is a CanserWarning.
    bus
        Channel to read, None for all.
    """
    unkept = Unkept(bus)
    yield from _text.in_blocks(_rows(file, name, unkept))
    unkept.check_bus(name)
    report_remarks(unkept.remarks(), name, add_remark)


def _rows(file: BinaryIO, name: str, unkept: Unkept) -> Iterator[Row]:
    for number, text in _text.lines(file, name, unkept):
        found = _LINE.fullmatch(text)
        if not found:
            if text.startswith("#"):
                continue
            raise FormatError(
                f"{name}, line {number}: {text[:60]!r} is {_notation.not_read(text)}; "
                "canser reads lines such as (1544106679.432583) can0 562#122DF953"
            )
        ts, channel, *notation, raw_dlc, direction = found.groups()
        if unkept.is_other_bus(channel):
            continue
        try:
            yield _notation.groups_to_row((*notation, raw_dlc), _text.parse_seconds(ts))
        except ValueError as error:
            raise FormatError(f"{name}, line {number}: {error}") from None
        unkept.add(channel, direction or "")
        if raw_dlc:
            unkept.raw_dlcs += 1
