"""Packets of an adapter besides frames: its configuration, and its reports."""

from dataclasses import dataclass
from functools import partial
from typing import Final

from canser._checks import choice, flag, instance, whole
from canser._core.buffers import BytesLike
from canser._core.packets import Config, configure, explain
from canser._core.table import MODE_NAMES, find_protocol

__all__ = [
    "FRAME_TYPES",
    "MODE_NAMES",
    "AdapterConfig",
    "AdapterReport",
    "configuration",
    "report",
]

# The types by the value of "only extended frames": False, True.
FRAME_TYPES: Final = ("all", "extended")

_ID_MAX: Final = 0x1FFF_FFFF


@dataclass(frozen=True, kw_only=True, slots=True)
class AdapterConfig:
    """How an adapter works on the CAN bus. A configuration is always set as a whole.

    Values that depend on no protocol are checked here. `configuration`, `canser.open` and
    `canser.Port.configure` check the bitrate against those of the protocol.

    Attributes
    ----------
    bitrate : int
        Bit rate of the CAN bus, in bit/s.
    mode : str, default "normal"
        "normal"; "loopback": the adapter receives what it sends itself; "silent": it listens
        only, and acknowledges nothing; "loopback-silent": both.
    frame_type : str, default "all"
        The frames that the adapter passes on: "all" or "extended".
    filter_id, filter_mask : int, default 0
        The adapter passes on frames whose id equals `filter_id` in the bits that are 1 in
        `filter_mask`. Both are 0 to 0x1fffffff; with a mask of 0 all frames pass.
    once : bool, default False
        Whether a frame without an acknowledgement is sent once, and not again.

    Raises
    ------
    TypeError
        For a value of another type.
    ValueError
        For an unknown name, or a number out of range.

    Examples
    --------
    >>> canser.AdapterConfig(bitrate=500_000, mode="silent").mode
    'silent'
    """

    bitrate: int
    mode: str = "normal"
    frame_type: str = "all"
    filter_id: int = 0
    filter_mask: int = 0
    once: bool = False

    def __post_init__(self) -> None:
        # Plain int and bool, for any kind of integer given.
        put = partial(object.__setattr__, self)
        put("bitrate", whole(self.bitrate, "bitrate", "500000", least=1))
        choice(self.mode, "mode", MODE_NAMES)
        choice(self.frame_type, "frame_type", FRAME_TYPES)
        put("filter_id", _id(self.filter_id, "filter_id"))
        put("filter_mask", _id(self.filter_mask, "filter_mask"))
        put("once", flag(self.once, "once"))


@dataclass(frozen=True, slots=True)
class AdapterReport:
    """What a control packet says; returned by `report` and `Port.request_status`.

    A field that a packet of this kind does not have is None.

    The same bytes mean the same in both directions: a request for the status reads as a status
    without errors.

    Attributes
    ----------
    kind : str
        "ping", "status", "error", "configuration", or "other" for an unknown packet.
    receive_errors, transmit_errors : int or None
        Of a status: the adapter's error counters.
    number : int or None
        Of an error: what has happened, by the adapter's own numbers.
    bitrate, mode, frame_type, filter_id, filter_mask, once
        Of a configuration: as in `AdapterConfig`.
    fixed : bool or None
        Of a configuration: as `configuration` takes it.
    """

    kind: str
    receive_errors: int | None = None
    transmit_errors: int | None = None
    number: int | None = None
    bitrate: int | None = None
    mode: str | None = None
    frame_type: str | None = None
    filter_id: int | None = None
    filter_mask: int | None = None
    once: bool | None = None
    fixed: bool | None = None


def configuration(protocol: str, config: AdapterConfig, *, fixed: bool = False) -> bytes:
    """Return the packet that configures an adapter.

    Parameters
    ----------
    protocol : str
        A name of `canser.protocols()` or an accepted spelling.
    config : AdapterConfig
        How the adapter is to work.
    fixed : bool, default False
        Whether the adapter reports frames in packets of one length.

    Returns
    -------
    bytes
        The packet, to be written to the adapter as it is.

    Raises
    ------
    TypeError
        For an argument of another type.
    ValueError
        If adapters of the protocol take no configuration, or not this bitrate.

    Examples
    --------
    >>> adapters.configuration("seeed", AdapterConfig(bitrate=500_000)).hex(" ")
    'aa 55 12 03 01 00 00 00 00 00 00 00 00 00 00 00 00 00 00 16'
    """
    row = find_protocol(protocol)
    instance(config, "config", AdapterConfig)
    if not row.configures:
        raise ValueError(f"{row.name} adapters take no configuration; leave bitrate out")
    if config.bitrate not in row.bitrates:
        have = ", ".join(map(str, row.bitrates))
        raise ValueError(f"bitrate {config.bitrate} is none of the adapter's: {have}")
    packed = Config(
        bitrate=config.bitrate,
        filter_id=config.filter_id,
        filter_mask=config.filter_mask,
        mode=MODE_NAMES.index(config.mode),
        ext_only=bool(FRAME_TYPES.index(config.frame_type)),
        once=config.once,
        fixed=flag(fixed, "fixed"),
    )
    return configure(row, packed)


def report(protocol: str, data: BytesLike) -> AdapterReport:
    """Return the meaning of a control packet.

    Parameters
    ----------
    protocol : str
        A name of `canser.protocols()` or an accepted spelling.
    data : bytes-like
        One control packet, as `Decoder.take_controls` gives it.

    Returns
    -------
    AdapterReport
        Its kind and its values. A configuration with an unknown value is of kind "other".

    Raises
    ------
    TypeError, BufferError
        For data that is no contiguous buffer.
    ValueError
        For an unknown protocol, or bytes that are not one control packet.
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


def _id(value: int, name: str) -> int:
    """Return the id or the mask of a filter, or raise."""
    number = whole(value, name, "0x123")
    if not 0 <= number <= _ID_MAX:
        raise ValueError(f"{name} is {number:#x}; it must be 0 to {_ID_MAX:#x}")
    return number
