"""What an adapter understands besides frames: its line, its configuration, its reports."""

from dataclasses import dataclass
from typing import Final

from canser._checks import flag, whole
from canser._core.buffers import BytesLike
from canser._core.packets import Config, configure, explain
from canser._core.table import MODE_NAMES, find_protocol

__all__ = [
    "FRAME_TYPES",
    "MODE_NAMES",
    "AdapterReport",
    "configuration",
    "report",
]

# By whether extended frames are the only ones.
FRAME_TYPES: Final = ("all", "extended")

_ID_MAX: Final = 0x1FFF_FFFF


@dataclass(frozen=True, slots=True)
class AdapterReport:
    """What a control packet says. A field that its kind does not have is None.

    The same bytes mean the same in both directions: a request for the status reads as a
    status without errors.
    """

    kind: str  # "ping", "status", "error", "configuration"; "other": nobody knows
    # Of a status.
    receive_errors: int | None = None  # the adapter's error counters
    transmit_errors: int | None = None
    # Of an error.
    number: int | None = None  # what has happened, by the adapter's own numbers
    # Of a configuration, as `configuration` takes them.
    bitrate: int | None = None
    mode: str | None = None
    frame_type: str | None = None
    filter_id: int | None = None
    filter_mask: int | None = None
    once: bool | None = None
    fixed: bool | None = None


def configuration(
    protocol: str,
    *,
    bitrate: int = 500_000,
    mode: str = "normal",
    frame_type: str = "all",
    filter_id: int = 0,
    filter_mask: int = 0,
    once: bool = False,
    fixed: bool = False,
) -> bytes:
    """Return the packet that configures an adapter.

    `bitrate`: of the bus in bit/s, one of `bitrates`. `mode`: "normal"; "loopback", which
    hears what it sends itself; "silent", which listens only and acknowledges nothing;
    "loopback-silent", both. `frame_type`: the frames that are received, "all" or
    "extended". `filter_id`, `filter_mask`: the id of those that pass, in the bits that are
    1 in the mask; all pass with 0. `once`: a frame that nobody acknowledged is not sent
    again. `fixed`: the adapter reports frames in packets of one length.

    ValueError if the protocol has no configuration, or for a value that it does not know;
    TypeError for one of another type.
    """
    row = find_protocol(protocol)
    if not row.configures:
        raise ValueError(f"{row.name} adapters take no configuration; leave bitrate out")
    rate = whole(bitrate, "bitrate", "500000")
    if rate not in row.bitrates:
        have = ", ".join(map(str, row.bitrates))
        raise ValueError(f"bitrate {rate} is none of the adapter's: {have}")
    config = Config(
        bitrate=rate,
        filter_id=_id(filter_id, "filter_id"),
        filter_mask=_id(filter_mask, "filter_mask"),
        mode=_place(mode, "mode", MODE_NAMES),
        ext_only=bool(_place(frame_type, "frame_type", FRAME_TYPES)),
        once=flag(once, "once"),
        fixed=flag(fixed, "fixed"),
    )
    return configure(row, config)


def report(protocol: str, data: BytesLike) -> AdapterReport:
    """Return what a control packet says.

    `data`: the bytes of one, as `Decoder.take_controls` gives them. A configuration with
    a value that nobody knows is of kind "other". ValueError for bytes that are no control
    packet, or not one; TypeError, BufferError for data that is no contiguous buffer.
    """
    row = find_protocol(protocol)
    said = explain(row, data)
    if said is None:
        raise ValueError(
            f"data is not one control packet of {row.name}; pass one that "
            "Decoder.take_controls gave"
        )
    if said.kind == "status":
        return AdapterReport(
            said.kind, receive_errors=said.receive_errors, transmit_errors=said.transmit_errors
        )
    if said.kind == "error":
        return AdapterReport(said.kind, number=said.number)
    if said.kind == "configuration":
        config = said.config
        return AdapterReport(
            said.kind,
            bitrate=config.bitrate,
            mode=MODE_NAMES[config.mode],
            frame_type=FRAME_TYPES[config.ext_only],
            filter_id=config.filter_id,
            filter_mask=config.filter_mask,
            once=config.once,
            fixed=config.fixed,
        )
    return AdapterReport(said.kind)


def _place(name: str, what: str, names: tuple[str, ...]) -> int:
    """Return the place of a name among those there are, or raise."""
    try:
        return names.index(name)
    except ValueError:
        raise ValueError(f"unknown {what} {name!r}; have: {', '.join(names)}") from None


def _id(value: int, name: str) -> int:
    """Return an id or its mask, or raise."""
    number = whole(value, name, "0x123")
    if not 0 <= number <= _ID_MAX:
        raise ValueError(f"{name} is {number:#x}; it must be 0 to {_ID_MAX:#x}")
    return number
