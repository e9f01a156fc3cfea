"""Decode and encode the byte streams of serial CAN adapters, into numpy arrays."""

from canser.captures import Blocks, blocks, read
from canser.codec import Control, Decoder, Stats, decode, encode, protocols
from canser.errors import (
    CanserError,
    CanserWarning,
    FormatError,
    PortBusyError,
    PortClosedError,
    PortDeniedError,
    PortError,
    PortGoneError,
    PortNotFoundError,
    RecordingError,
    SendError,
    SendTimeoutError,
)
from canser.frames import FRAME_DTYPE, NO_TIME, concat, match
from canser.identify import Fit, identify
from canser.live.ports import Gap, Port, PortInfo, list_ports, open  # noqa: A004 - as in gzip.open

__all__ = [
    "FRAME_DTYPE",
    "NO_TIME",
    "Blocks",
    "CanserError",
    "CanserWarning",
    "Control",
    "Decoder",
    "Fit",
    "FormatError",
    "Gap",
    "Port",
    "PortBusyError",
    "PortClosedError",
    "PortDeniedError",
    "PortError",
    "PortGoneError",
    "PortInfo",
    "PortNotFoundError",
    "RecordingError",
    "SendError",
    "SendTimeoutError",
    "Stats",
    "blocks",
    "concat",
    "decode",
    "encode",
    "identify",
    "list_ports",
    "match",
    "open",
    "protocols",
    "read",
]
