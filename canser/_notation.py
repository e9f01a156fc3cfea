"""candump's notation of one frame: an id, #, and data or R.

    123#DEADBEEF                a standard frame: three digits
    18FEF100#                   extended: eight digits
    123#11.22                   bytes with dots
    123#R8                      remote, with its dlc
    20000080#00                 an error frame: bit 29 of eight digits
    123#0011223344556677_E      a raw dlc of 9 to 15

Source: can-utils, `candump` and its library's frame notation.

An error frame has eight digits because of its flag. So the text does not say whether an error frame
with an id up to 0x7FF is extended.
"""

import re
from collections.abc import Sequence
from typing import Any, Final

from canser._frames import NO_TIME
from canser._rows import Row, check_row

__all__ = ["ERR_FLAG", "PATTERN", "groups_to_row", "not_read", "parse_frame"]

# SocketCAN's flag of an error frame, above the 29 bits of an id.
ERR_FLAG: Final = 0x2000_0000

# Groups: the id, the R of a remote frame and its dlc, the data, a raw dlc.
PATTERN: Final = (
    r"([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"(?:([Rr])([0-8])?|((?:[0-9A-Fa-f]{2}(?:\.?[0-9A-Fa-f]{2})*)?))"
    r"(?:_([9A-Fa-f]))?"
)
_FRAME: Final = re.compile(PATTERN)


def parse_frame(text: str) -> Row:
    """Return the frame of a text such as 123#DEADBEEF, 18FEF100#, 123#R8 or 20000080#00.

    Its time is not known. ValueError for a text that is no frame of classic CAN, and for a raw
    dlc, for which a frame has no field.
    """
    found = _FRAME.fullmatch(text)
    if not found:
        raise ValueError(
            f"{text[:60]!r} is {not_read(text)}; write 123#DEADBEEF, 18FEF100#01 (extended: eight "
            "digits), 123#R8 (remote)"
        )
    *_, raw_dlc = groups = found.groups()
    try:
        if raw_dlc:
            raise ValueError("a frame has no raw dlc; leave _ and the digit behind it out")
        return groups_to_row(groups, NO_TIME)
    except ValueError as error:
        raise ValueError(f"{text[:60]!r}: {error}") from None


def not_read(text: str) -> str:
    """Return why a text is not read, for a message."""
    return "CAN FD or CAN XL" if text.count("#") > 1 else "no frame"


def groups_to_row(groups: Sequence[str | Any], ts: int) -> Row:
    """Return the frame of the groups of `PATTERN`; ValueError if it is no classic CAN frame."""
    digits, rtr, rtr_dlc, data_digits, raw_dlc = groups
    number_of_id = int(digits, 16)
    ext = len(digits) == 8
    err = ext and bool(number_of_id & ERR_FLAG)
    data = bytes.fromhex(data_digits.replace(".", "")) if data_digits else b""
    dlc = int(rtr_dlc or 0) if rtr else len(data)
    if raw_dlc and dlc != 8:
        raise ValueError(f"a raw dlc (_{raw_dlc}) needs 8 bytes, but the dlc is {dlc}")
    return check_row(
        (
            # Of an error frame's eight digits, the flags above 29 bits are not part of the id.
            number_of_id & 0x1FFFFFFF if err else number_of_id,
            # An error frame has eight digits because of its flag.
            ext and (not err or number_of_id & 0x1FFFFFFF > 0x7FF),
            bool(rtr),
            dlc,
            err,
            data,
            ts,
        )
    )
