"""candump's log format, as `candump -L` writes and canplayer reads.

    (1544106679.432583) can0 562#122DF953813CA2
    (1544106679.432600) can0 18FEF100#            extended: eight digits
    (1544106679.432610) can0 123#R8               remote, with its dlc
    (1544106679.432620) can0 20000080#00          error: bit 29 of eight digits

Source: can-utils, `candump` and its library's frame notation.

An error frame has eight digits because of its flag, so `ext` of one with an id up to
0x7FF is not told. Times have six places: a part under a microsecond is cut, and a time that is not
known is written as 0. `Writer` counts both.
"""

import re
from collections.abc import Iterable, Iterator
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from canser.errors import FormatError
from canser.formats import _text
from canser.frames import NO_TIME, FrameArray

_ERR = 0x2000_0000

_FRAME_PATTERN = (
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"(?:(?P<rtr>[Rr])(?P<dlc>[0-8])?|(?P<data>(?:[0-9A-Fa-f]{2}\.?)*))"
    r"(?:_[0-9A-Fa-f])?"
)
_FRAME = re.compile(_FRAME_PATTERN)
_LINE = re.compile(rf"\((?P<ts>[^)]*)\)\s+(?P<channel>\S+)\s+{_FRAME_PATTERN}(?:\s+[RT])?")


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
        flagged: npt.NDArray[np.uint32] = frames["id"] | err * np.uint32(_ERR)
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


def read(file: BinaryIO, name: str) -> Iterator[FrameArray]:
    """Yield the frames of a log, block by block.

    `file`: open for reading bytes; `name`: what messages call it. FormatError names
    the first line that is no frame of classic CAN.
    """
    return _text.in_blocks(_rows(file, name))


def _rows(file: BinaryIO, name: str) -> Iterator[_text.Row]:
    for number, text in _text.lines(file, name):
        found = _LINE.fullmatch(text)
        if not found:
            raise FormatError(
                f"{name}, line {number}: {text[:60]!r} is {_kind(text)}; "
                "canser reads lines such as (1544106679.432583) can0 562#122DF953"
            )
        try:
            yield (*_check_frame(found)[:6], _text.parse_seconds(found["ts"]))
        except ValueError as error:
            raise FormatError(f"{name}, line {number}: {error}") from None


def frames_of(texts: Iterable[str]) -> FrameArray:
    """Return the frames of texts such as 123#DEADBEEF, 18FEF100#, 123#R8 or 20000080#00.

    Their times are not known. ValueError names the first text that is no frame of classic CAN.
    """
    rows = []
    for text in texts:
        found = _FRAME.fullmatch(text)
        if not found:
            raise ValueError(
                f"{text!r} is {_kind(text)}; write 123#DEADBEEF, 18FEF100#01 (extended: eight "
                "digits), 123#R8 (remote)"
            )
        try:
            rows.append(_check_frame(found))
        except ValueError as error:
            raise ValueError(f"{text!r}: {error}") from None
    return _text.rows_to_frames(rows)


def _kind(text: str) -> str:
    """Say what a text is that is not read."""
    return "CAN FD or CAN XL" if "##" in text else "no frame"


def _check_frame(found: re.Match[str]) -> _text.Row:
    """Return the frame of a match, without a time; ValueError if it is none of classic CAN."""
    number_of_id = int(found["id"], 16)
    ext = len(found["id"]) == 8
    err = ext and bool(number_of_id & _ERR)
    data = bytes.fromhex((found["data"] or "").replace(".", ""))
    return _text.check_row(
        (
            # Above 29 bits only the flags stand that an id of eight digits may have.
            number_of_id & 0x1FFFFFFF if err else number_of_id,
            # An error frame has eight digits because of its flag.
            ext and (not err or number_of_id & 0x1FFFFFFF > 0x7FF),
            bool(found["rtr"]),
            int(found["dlc"] or 0) if found["rtr"] else len(data),
            err,
            data,
            NO_TIME,
        )
    )
