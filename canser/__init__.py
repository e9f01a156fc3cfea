"""Decode and encode the byte streams of serial CAN adapters, into numpy arrays."""

from canser.captures import Blocks, blocks, read
from canser.codec import Control, Decoder, Stats, decode, encode, protocols
from canser.errors import CanserError, FormatError
from canser.frames import FRAME_DTYPE, NO_TIME, match
from canser.identify import Fit, identify

__all__ = [
    "FRAME_DTYPE",
    "NO_TIME",
    "Blocks",
    "CanserError",
    "Control",
    "Decoder",
    "Fit",
    "FormatError",
    "Stats",
    "blocks",
    "decode",
    "encode",
    "identify",
    "match",
    "protocols",
    "read",
]
