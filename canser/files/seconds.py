"""Text columns of many frames at once, built as arrays of characters.

A column is an array of uint8, shape (n, width), one row for each frame. A 0 stands for a character
that a row does not have; `join` leaves it out. This writes some millions of lines per second;
one format() call for each frame writes half a million.
"""

import re
from collections.abc import Iterator
from itertools import count
from typing import BinaryIO, Final

import numpy as np
import numpy.typing as npt

from canser._frames import NO_TIME, FrameArray
from canser._rows import Row, rows_to_frames
from canser.errors import FormatError
from canser.files._remarks import Unkept

Column = npt.NDArray[np.uint8]

_HEX: Final = np.frombuffer(b"0123456789ABCDEF", np.uint8)
_SECOND: Final = 1_000_000_000

# Blanks of ASCII. Without them, strip() would take the blanks of all scripts.
BLANKS: Final = " \t\r\n\v\f"

# Limit for a line of text, in bytes. A line of a frame has under 100; a longer one is no text.
_LINE_MAX = 1 << 16

# Frames in a block.
_BLOCK = 1 << 14


def join(row_count: int, *parts: bytes | Column) -> bytes:
    """Return the lines, each made of the parts in a row: constant text, or columns."""
    columns = [
        np.broadcast_to(np.frombuffer(part, np.uint8), (row_count, len(part)))
        if isinstance(part, bytes)
        else part
        for part in parts
    ]
    table = np.concatenate(columns, axis=1)
    return bytes(table[table != 0].data)


def hexadecimal(values: npt.NDArray[np.integer], digits: int) -> Column:
    """Return numbers in upper-case hexadecimal, with leading zeros."""
    shifts = np.arange(4 * (digits - 1), -1, -4, dtype=np.uint32)
    digits_of: Column = _HEX[(values[:, None].astype(np.uint32) >> shifts) & 0xF]
    return digits_of


def payload(frames: FrameArray) -> Column:
    """Return the data up to the dlc in hexadecimal, nothing for remote frames."""
    data = frames["data"]
    text = np.empty((len(frames), 8, 2), np.uint8)
    text[:, :, 0] = _HEX[data >> 4]
    text[:, :, 1] = _HEX[data & 0xF]
    text[np.arange(8) >= payload_len(frames)[:, None]] = 0
    return text.reshape(-1, 16)


def payload_len(frames: FrameArray) -> npt.NDArray[np.uint8]:
    """Return the number of data bytes of each frame; a remote frame has none."""
    return np.where(frames["rtr"], 0, np.minimum(frames["dlc"], 8)).astype(np.uint8)


def decimal(values: npt.NDArray[np.integer], least: int = 1) -> Column:
    """Return decimal numbers, 0 or more, padded with zeros to `least` digits."""
    digits = max(least, len(str(int(values.max(initial=0)))))
    powers = 10 ** np.arange(digits - 1, -1, -1, dtype=np.uint64)
    wide = values[:, None].astype(np.uint64)
    text = (wide // powers % 10 + ord("0")).astype(np.uint8)
    leading = wide < powers
    leading[:, digits - least :] = False
    text[leading] = 0
    return text


def seconds(ts: npt.NDArray[np.int64], places: int) -> Column:
    """Return nanoseconds as seconds with a number of decimal places; further places are cut."""
    negative = ts < 0
    # Callers have replaced NO_TIME: the least int64 has no absolute value.
    size = np.abs(ts)
    sign = np.where(negative, ord("-"), 0).astype(np.uint8)[:, None]
    fraction = decimal(size % _SECOND // 10 ** (9 - places), least=places)
    point = np.full((len(ts), 1), ord("."), np.uint8)
    return np.concatenate([sign, decimal(size // _SECOND), point, fraction], axis=1)


_SECONDS: Final = re.compile(
    r"[ \t]*(?P<sign>[+-]?)(?P<whole>[0-9]+)(?:\.(?P<places>[0-9]*))?[ \t]*"
)
_ROUNDED: Final = re.compile(r"[ \t]*[+-]?(?:[0-9]+(?:\.[0-9]*)?[eE][+-]?[0-9]+|inf)[ \t]*")

# Digits of whole seconds in the largest time: 2**63 ns are 9,223,372,036 s.
_WHOLE_DIGITS: Final = 10


def parse_seconds(text: str) -> int:
    """Return the nanoseconds of a text in seconds, exactly; NO_TIME for nan and an empty text.

    Digits behind the ninth decimal place are cut. A number with an exponent, such as 1e9, is read
    as floating point. ValueError for a text that is no number, or is out of range.
    """
    found = _SECONDS.fullmatch(text)
    if found:
        sign, whole, places = found.groups(default="")
        if len(whole) > _WHOLE_DIGITS and len(whole.lstrip("0")) > _WHOLE_DIGITS:
            ts = 2**63
        else:
            # Seconds and fraction as one number: its last nine digits are the fraction.
            ts = int(whole[-_WHOLE_DIGITS:] + places[:9].ljust(9, "0"))
        ts = -ts if sign == "-" else ts
    elif text.strip(BLANKS).lower() in ("", "nan", "nat"):
        return NO_TIME
    elif _ROUNDED.fullmatch(text):
        try:
            ts = round(float(text) * _SECOND)
        except OverflowError:  # inf
            ts = 2**63
    else:
        raise ValueError(f"{text.strip()[:60]!r} is no time in seconds")
    if not -(2**63) < ts < 2**63:
        raise ValueError(f"the time {text.strip()[:60]} does not fit 64 bits of nanoseconds")
    return ts


def in_blocks(rows: Iterator[Row]) -> Iterator[FrameArray]:
    """Yield rows as arrays of frames, `_BLOCK` frames each."""
    block: list[Row] = []
    for row in rows:
        block.append(row)
        if len(block) == _BLOCK:
            yield rows_to_frames(block)
            block.clear()
    if block:
        yield rows_to_frames(block)


def lines(file: BinaryIO, name: str, unkept: Unkept) -> Iterator[tuple[int, str]]:
    """Yield the number and the text (ASCII or UTF-8) of each line that is not empty.

    NUL bytes at the end of the file, which a power cut may leave, are counted in `unkept`.
    """
    for number in count(1):
        raw = file.readline(_LINE_MAX)
        if not raw:
            return
        if len(raw) == _LINE_MAX:
            raise FormatError(f"{name}, line {number}: has no end; is it raw bytes?")
        if not raw[0] and not raw.strip(b"\0"):  # NULs without a line end: the end of the file
            unkept.nuls = len(raw)
            return
        try:
            text = raw.decode("utf-8-sig" if number == 1 else "utf-8").strip(BLANKS)
        except UnicodeDecodeError:
            raise FormatError(f"{name}, line {number}: this is no text; is it raw bytes?") from None
        if text:
            yield number, text
