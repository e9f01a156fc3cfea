"""candump's log format, as `candump -L` writes and canplayer reads.

    (1544106679.432583) can0 562#122DF953813CA2
    (1544106679.432600) can0 18FEF100#            extended: eight digits
    (1544106679.432610) can0 123#R8               remote, with its dlc
    (1544106679.432620) can0 20000080#00          error: bit 29 of eight digits
    (1544106679.432630) can1 123#11.22 T          bytes with dots, the direction (R or T)
    (1544106679.432640) can1 123#0011223344556677_E   a raw dlc of 9 to 15 (F)
    # a comment

Source: can-utils, `candump` and its library's frame notation.

A frame has no place for its channel, its direction and its raw dlc: where lines differ in
these, the reader tells how many there were of each.

An error frame has eight digits because of its flag, so `ext` of one with an id up to
0x7FF is not told. Times have six places: a part under a microsecond is cut, and a time that is not
known is written as 0. `Writer` counts both.
"""

import re
from collections.abc import Iterator
from typing import BinaryIO, Final

import numpy as np
import numpy.typing as npt

from canser import _notation
from canser._frames import NO_TIME, FrameArray
from canser._input import Input
from canser._rows import Row
from canser.errors import FormatError
from canser.files import _text
from canser.files._remarks import Tell, Unkept, tell_all
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

# Groups: the time, the channel, those of a frame, the direction.
_LINE = re.compile(
    r"\((-?[0-9]+(?:\.[0-9]+)?)\)[ \t]+([^\s\0-\x1f\x7f]+)[ \t]+"
    rf"{_notation.PATTERN}(?:[ \t]+([RT]))?"
)


# The start of a line.
_BEGIN: Final = re.compile(rb"^\(\d+\.\d+\) +\S+ +[0-9A-Fa-f]+#", re.MULTILINE)


def sniff(head: bytes) -> bool:
    """Return whether these first bytes of a file have a line of a log."""
    return is_text(head, least=1) and bool(_BEGIN.search(head))


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a log."""
    return DecodedReader(source, options, parse)


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
            _text.seconds(ts, 6),
            b") can0 ",
            ids,
            b"#",
            remote,
            _text.payload(frames),
            b"\n",
        )

    def finish(self) -> list[str]:
        """Return what a log could not hold."""
        remarks = {
            "frames without a time, written as 0": self.ts_unknown,
            "times cut to the microsecond": self.ts_cut,
        }
        return [f"{what}: {count:,}" for what, count in remarks.items() if count]


def parse(file: BinaryIO, name: str, tell: Tell | None = None) -> Iterator[FrameArray]:
    """Yield the frames of a log, block by block.

    `file`: open for reading bytes; `name`: what messages call it. `tell` is called at the end
    with each remark on what the log says and the frames do not hold; without it a remark is a
    CanserWarning. FormatError names the first line that is no frame of classic CAN.
    """
    unkept = Unkept()
    yield from _text.in_blocks(_rows(file, name, unkept))
    tell_all(unkept.remarks(), name, tell)


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
        try:
            yield _notation.groups_to_row((*notation, raw_dlc), _text.parse_seconds(ts))
        except ValueError as error:
            raise FormatError(f"{name}, line {number}: {error}") from None
        unkept.add(channel, direction or "")
        if raw_dlc:
            unkept.raw_dlcs += 1
