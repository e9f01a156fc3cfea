"""Decode and encode the byte streams of serial CAN adapters, into numpy arrays."""

from canser.codec import Control, Decoder, Stats, decode, encode, protocols
from canser.errors import CanserError, FormatError
from canser.frames import FRAME_DTYPE, match

__all__ = [
    "FRAME_DTYPE",
    "CanserError",
    "Control",
    "Decoder",
    "FormatError",
    "Stats",
    "decode",
    "encode",
    "match",
    "protocols",
]
