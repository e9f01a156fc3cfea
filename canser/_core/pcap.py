"""Packets of captures as frames, and frames as packets: C's work for each, and its memory."""

from typing import Final, NamedTuple

from canser._core._lib import ffi, lib
from canser._core.buffers import input_bytes, raise_status
from canser._core.text import Codes, FrameWriter
from canser._frames import FrameArray

__all__ = [
    "BLOCK_MAX",
    "LINK_CAN",
    "LINK_COOKED",
    "RECORD_MAX",
    "PacketReader",
    "PacketWriter",
    "Packets",
]

# Link types of CAN: frames of SocketCAN, and the same behind a header of 16 bytes.
LINK_CAN: Final = int(lib.CANSER_LINK_CAN)
LINK_COOKED: Final = int(lib.CANSER_LINK_COOKED)

# The longest block of pcapng and the longest packet of pcap that are read, in bytes.
BLOCK_MAX: Final = int(lib.CANSER_BLOCK_MAX)
RECORD_MAX: Final = int(lib.CANSER_RECORD_MAX)

# Bytes that are always enough for a packet; see canser_capture_write.
_PACKET_MOST: Final = int(lib.CANSER_CAPTURED_MAX)

# Interfaces that there is room for at first.
_INTERFACES: Final = 8


class Packets(NamedTuple):
    """What a call has read: the results of canser_rows."""

    used: int  # bytes
    packets: int
    frames: int
    is_unusual: bool  # whether the next block or record is for the caller to look at


class PacketReader:
    """Reads usual packets of a file into rows; see canser_capture_read."""

    def __init__(self) -> None:
        self.state = ffi.new("canser_capture *")
        self._rows = ffi.new("canser_rows *")
        self.begin(is_blocks=False, is_big=False)

    def begin(self, *, is_blocks: bool, is_big: bool) -> None:
        """Begin a section of pcapng, or a file of pcap: without interfaces."""
        self.state.is_blocks, self.state.is_big = is_blocks, is_big
        self._interfaces = ffi.new("canser_interface[]", _INTERFACES)
        self.state.interfaces, self.state.interface_count = self._interfaces, 0

    def add_interface(
        self, link_type: int, channel: int, resolution: int, offset_ns: int = 0
    ) -> None:
        """Add an interface; see canser_interface_init."""
        count = self.state.interface_count
        if count == len(self._interfaces):
            grown = ffi.new("canser_interface[]", 2 * count)
            ffi.memmove(grown, self._interfaces, ffi.sizeof(self._interfaces))
            self._interfaces = self.state.interfaces = grown
        lib.canser_interface_init(
            self._interfaces + count, link_type, channel, resolution, offset_ns
        )
        self.state.interface_count = count + 1

    def use(self, frames: FrameArray, channels: Codes, directions: Codes) -> None:
        """Read into arrays of one length from now on."""
        self._cap = len(frames)
        # These keep the arrays alive. The pointers in C's struct do not.
        self._frames = ffi.from_buffer("canser_frame[]", frames, require_writable=True)
        self._channels = ffi.from_buffer("uint8_t[]", channels, require_writable=True)
        self._directions = ffi.from_buffer("uint8_t[]", directions, require_writable=True)

    def read(self, data: bytes | memoryview, first: int) -> Packets:
        """Read packets from the start of `data`, up to one that is unusual or not whole.

        `first` is the row of the first frame.
        """
        rows = self._rows
        rows.frames, rows.frame_cap = self._frames + first, self._cap - first
        rows.channels, rows.directions = self._channels + first, self._directions + first
        status = lib.canser_capture_read(self.state, input_bytes(data), len(data), rows)
        if status:
            raise_status(status)
        return Packets(rows.used, rows.line_count, rows.frame_count, bool(rows.is_unusual))


class PacketWriter:
    """Writes frames as packets of a file; see canser_capture_write."""

    def __init__(self, *, is_blocks: bool) -> None:
        self.state = ffi.new("canser_capture *", {"is_blocks": is_blocks})
        self.packets = FrameWriter(lib.canser_capture_write, self.state, _PACKET_MOST).parts
