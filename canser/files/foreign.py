"""Formats that canser does not read: named by their first bytes, with what reads them."""

import re
from typing import Final, NamedTuple

__all__ = ["HEAD_LEN", "TEXT", "Foreign", "is_text", "recognise"]

# So many first bytes of a file are looked at.
HEAD_LEN: Final = 4096

# A text is at least this long, in bytes. The bytes of an adapter that look like text for as
# long do not come about by chance: 95 of 256 values are printable.
_TEXT_LEAST: Final = 32

# At most this share of a text's bytes lies outside ASCII: names and months of many languages.
_NOT_ASCII: Final = 0.1


class Foreign(NamedTuple):
    """A format that canser does not read."""

    about: str
    remedy: str  # what reads it


_PYTHON_CAN: Final = "python-can converts it: can_logconvert FILE run.log"
_UNPACK: Final = "unpack it first"

TEXT: Final = Foreign("a text", "canser does not know what it holds")

# Formats by how a file begins.
_MAGICS: Final = (
    (b"\x1f\x8b\x08", Foreign("packed by gzip", f"{_UNPACK}: gunzip FILE")),
    (b"BZh", Foreign("packed by bzip2", f"{_UNPACK}: bunzip2 FILE")),
    (b"\xfd7zXZ\0", Foreign("packed by xz", f"{_UNPACK}: unxz FILE")),
    (b"\x28\xb5\x2f\xfd", Foreign("packed by zstd", f"{_UNPACK}: unzstd FILE")),
    (b"PK\x03\x04", Foreign("a zip archive", f"{_UNPACK}: unzip FILE")),
    (b"LOGG", Foreign("a Vector BLF log", _PYTHON_CAN)),
    (b"MDF     ", Foreign("an ASAM MF4 log", _PYTHON_CAN)),
    (b"UnFinMF ", Foreign("an ASAM MF4 log", _PYTHON_CAN)),
    (b"\xd4\xc3\xb2\xa1", Foreign("a pcap file", "Wireshark reads it")),
    (b"\xa1\xb2\xc3\xd4", Foreign("a pcap file", "Wireshark reads it")),
    (b"\x4d\x3c\xb2\xa1", Foreign("a pcap file", "Wireshark reads it")),
    (b"\xa1\xb2\x3c\x4d", Foreign("a pcap file", "Wireshark reads it")),
    (b"SQLite format 3\0", Foreign("a SQLite database", "python-can reads those it wrote")),
    (b"PAR1", Foreign("a Parquet file", "pandas or polars reads it")),
    (b"\x89HDF\r\n\x1a\n", Foreign("an HDF5 file", "h5py reads it")),
)

# Formats of text by a pattern at the start of a line.
_TEXTS: Final = tuple(
    (re.compile(pattern, re.MULTILINE), found)
    for pattern, found in (
        (rb"^date .*\r?\n\s*base\s+(hex|dec)", Foreign("a Vector ASC log", _PYTHON_CAN)),
        (rb"\A\s*;(\$FILEVERSION|##|---)", Foreign("a PCAN TRC log", _PYTHON_CAN)),
        (rb"\A@ TEXT @", Foreign("a CANHacker log", "CANHacker reads it")),
        (rb"\A\*\*\*BUSMASTER", Foreign("a BUSMASTER log", "BUSMASTER reads it")),
        (rb"\ATime Stamp,ID,", Foreign("a GVRET log of SavvyCAN", "SavvyCAN saves it as candump")),
        (
            rb"\ATimestamp(Epoch)?[;,]Bus",
            Foreign("a CSV file of the CANedge", "pandas.read_csv reads it"),
        ),
        (
            rb"\Aversion https://git-lfs",
            Foreign("a pointer of Git LFS", "'git lfs pull' fetches the file itself"),
        ),
        (
            rb"^ *(\([^)]*\))? *\S+ +([RT]X +\S+ +\S+ +)?[0-9A-F]{3,8} +\[\d+\] ",
            Foreign("what candump prints on a screen", "record it with 'candump -L'"),
        ),
    )
)


def recognise(head: bytes) -> Foreign | None:
    """Return the format of a file by its first bytes, None where they do not tell.

    HEAD_LEN bytes are enough. TEXT is any text of which no more is known.
    """
    for magic, found in _MAGICS:
        if head.startswith(magic):
            return found
    head = head[:HEAD_LEN].removeprefix(b"\xef\xbb\xbf")
    if not is_text(head):
        return None
    return next((found for pattern, found in _TEXTS if pattern.search(head)), TEXT)


def is_text(head: bytes, least: int = _TEXT_LEAST) -> bool:
    """Return whether these bytes, `least` of them or more, are lines of text."""
    head = head.rstrip(b"\0")  # some systems leave zeros behind a text when the power goes
    if len(head) < least or not re.search(rb"[\r\n]", head):
        return False
    if re.search(rb"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]", head):
        return False
    return len(re.findall(rb"[\x80-\xff]", head)) <= _NOT_ASCII * len(head)
