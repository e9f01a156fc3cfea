"""Facts that C knows without any data: the protocols, and the names of its numbers."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from typing import Any, Final

from canser._checks import type_name
from canser._core._lib import ffi, lib

Pointer = Any


@dataclass(frozen=True)
class Protocol:
    """What a protocol is and can; returned by `canser.protocol`.

    It is one row of the table of protocols in C.
    """

    #: The name, as `protocols` gives it.
    name: str
    #: Other spellings that are accepted.
    aliases: tuple[str, ...]
    #: Bytes of the shortest frame.
    frame_min: int
    #: Bytes of the longest frame as `encode` writes it.
    frame_max: int
    #: Whether frames carry a device timestamp.
    has_clock: bool
    #: Baud rate of the serial line as adapters are delivered, in bit/s.
    baudrate: int
    #: Bit rates of the bus that an adapter can be configured to, in bit/s; empty: to none.
    bitrates: tuple[int, ...]
    #: The packet to which an adapter in step answers; empty: there is none.
    ping: bytes
    #: The packet that asks for the adapter's status; empty: there is none.
    status_request: bytes

    @property
    def configures(self) -> bool:
        """Whether its adapters take a configuration."""
        return bool(self.bitrates)


def text(pointer: Pointer) -> str:
    """Return a C string as a string."""
    return str(ffi.string(pointer).decode("ascii"))


def packet_bytes(packet: Pointer) -> bytes:
    """Return the bytes of a `canser_packet`."""
    return bytes(packet.bytes)[: packet.len]


def _read_bitrates(row: Pointer) -> Iterator[int]:
    for index in count():
        if not row.bitrates or not row.bitrates[index]:
            return
        yield row.bitrates[index]


def _read_table() -> Iterator[tuple[Protocol, Pointer]]:
    for index in count():
        row = lib.canser_protocol_at(index)
        if not row:
            return
        protocol = Protocol(
            name=text(row.name),
            aliases=tuple(text(row.aliases).split()),
            frame_min=row.frame_min,
            frame_max=row.frame_max,
            has_clock=bool(row.has_clock),
            baudrate=row.baudrate,
            bitrates=tuple(_read_bitrates(row)),
            ping=packet_bytes(row.ping),
            status_request=packet_bytes(row.status_request),
        )
        yield protocol, row


_TABLE: Final = tuple(_read_table())
PROTOCOLS: Final = {protocol.name: protocol for protocol, _ in _TABLE}
_ROWS: Final = {protocol.name: row for protocol, row in _TABLE}
_SPELLINGS: Final = {
    spelling: protocol
    for protocol in PROTOCOLS.values()
    for spelling in (protocol.name, *protocol.aliases)
}
REJECT_NAMES: Final = tuple(
    text(lib.canser_reject_name(reason)) for reason in range(lib.CANSER_REJECT_COUNT)
)
MODE_NAMES: Final = tuple(text(lib.canser_mode_name(mode)) for mode in range(lib.CANSER_MODE_COUNT))


# The kinds of frames that a format cannot carry, by the numbers that `refuse` returns. The first
# name stands for frames that it can carry.
REFUSAL_NAMES: Final = tuple(
    text(lib.canser_refusal_name(refusal)) for refusal in range(lib.CANSER_REFUSAL_COUNT)
)
REFUSAL_TIME: Final = int(lib.CANSER_REFUSAL_TIME)


def find_protocol(name: str) -> Protocol:
    """Return the protocol of a name or accepted spelling, in any case, or raise."""
    try:
        return _SPELLINGS[name]
    except (KeyError, TypeError):  # no name as it is written in the table
        pass
    if not isinstance(name, str):
        raise TypeError(f"protocol must be a name such as 'serial', not {type_name(name)}")
    try:
        return _SPELLINGS[name.lower()]
    except KeyError:
        have = ", ".join(PROTOCOLS)
        raise ValueError(f"unknown protocol {name!r}; have: {have}") from None


def row_of(protocol: Protocol) -> Pointer:
    """Return the row of a protocol, as C's functions take it."""
    return _ROWS[protocol.name]
