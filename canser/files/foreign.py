"""Recognise formats that canser does not read by their first bytes, and name what reads them."""

import re
from typing import Final, NamedTuple

__all__ = ["HEAD_LEN", "TEXT", "Foreign", "is_text", "recognise"]

# Bytes at the start of a file that are examined.
HEAD_LEN: Final = 4096

# Shorter than this, in bytes, a file is not taken for text. 95 of 256 byte values are printable,
# so 32 bytes of an adapter are all printable by chance with a probability of 2e-14.
_TEXT_LEAST: Final = 32

# The largest share of bytes outside ASCII in a text: names and months in many languages have some.
_NOT_ASCII_MOST: Final = 0.1

# Bytes that are no ASCII; and bytes that no text has: controls but for tab, line feed and return.
_NOT_ASCII: Final = bytes(range(0x80, 0x100))
_CONTROLS: Final = bytes({*range(0x20), 0x7F} - set(b"\t\n\r"))


class Foreign(NamedTuple):
    """A format that canser does not read."""

    about: str
    remedy: str  # how the file can be read


_OLD_MDF: Final = Foreign("an MDF file of a version before 4", "asammdf saves it as MF4")
_UNPACK: Final = "unpack it first"

TEXT: Final = Foreign("a text", "canser does not know what it holds")

# Formats by the first bytes of a file.
_MAGICS: Final = (
    (b"BZh", Foreign("packed by bzip2", f"{_UNPACK}: bunzip2 FILE")),
    (b"\xfd7zXZ\0", Foreign("packed by xz", f"{_UNPACK}: unxz FILE")),
    (b"PK\x03\x04", Foreign("a zip archive", f"{_UNPACK}: unzip FILE")),
    (b"MDF     ", _OLD_MDF),
    (b"UnFinMF ", _OLD_MDF),
    (
        b"Generic File",
        Foreign("a packed or encrypted log of the CANedge", "CSS Electronics' converters read it"),
    ),
    (b"SQLite format 3\0", Foreign("a SQLite database", "python-can reads those it wrote")),
    (b"\x89HDF\r\n\x1a\n", Foreign("an HDF5 file", "h5py reads it")),
)

# Formats of text by a pattern at the start of a line.
_TEXTS: Final = tuple(
    (re.compile(pattern, re.MULTILINE), found)
    for pattern, found in (
        (rb"\A@ TEXT @", Foreign("a CANHacker log", "CANHacker reads it")),
        (rb"\A\*\*\*BUSMASTER", Foreign("a BUSMASTER log", "BUSMASTER converts it to ASC")),
        (
            rb"Microchip Technology Inc\.[\s\S]*CAN BUS Analyzer",
            Foreign("a log of Microchip's CAN BUS Analyzer", "SavvyCAN saves it as candump"),
        ),
        (
            rb"\ATimestamp(Epoch)?[;,]Bus",
            Foreign("a CSV file of the CANedge", "pandas.read_csv reads it"),
        ),
        (
            rb"\Aversion https://git-lfs",
            Foreign("a pointer of Git LFS", "'git lfs pull' fetches the file itself"),
        ),
    )
)


def recognise(head: bytes) -> Foreign | None:
    """Return the format of a file by its first bytes, None if it is not known.

    HEAD_LEN bytes are enough. The result is TEXT for a text of an unknown format.
    """
    for magic, found in _MAGICS:
        if head.startswith(magic):
            return found
    head = head[:HEAD_LEN].removeprefix(b"\xef\xbb\xbf")
    if not is_text(head):
        return None
    return next((found for pattern, found in _TEXTS if pattern.search(head)), TEXT)


def is_text(head: bytes, least: int = _TEXT_LEAST) -> bool:
    """Return whether these bytes are lines of text, and at least `least` bytes long."""
    head = head.rstrip(b"\0")  # after a power cut some systems leave zeros at the end of a file
    if len(head) < least or not re.search(rb"[\r\n]", head):
        return False
    ascii_only = head.translate(None, _NOT_ASCII)
    if len(ascii_only.translate(None, _CONTROLS)) < len(ascii_only):
        return False
    return len(head) - len(ascii_only) <= _NOT_ASCII_MOST * len(head)
