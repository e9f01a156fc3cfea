"""The options of a port, as value objects."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, TypedDict

from canser._checks import choice, flag, instance, real, whole
from canser.adapters import AdapterConfig

__all__ = ["LEVELS", "LineConfig", "PortOptions", "adapter_config", "flat_config"]

# How a modem line may be set when a port is opened.
LEVELS: Final = ("leave", "on", "off")

# Bytes. The thread that reads the line takes up to 64 KiB at once. A smaller ring would lose bytes
# however fast the program reads.
_RING_SIZE_LEAST: Final = 1 << 16


@dataclass(frozen=True, kw_only=True, slots=True)
class LineConfig:
    """How the serial line between host and adapter is opened and kept.

    All fields are keywords with a default, and are checked when the object is made.

    Raises
    ------
    TypeError
        For a value of another type.
    ValueError
        For an unknown name, or a number out of range.

    Notes
    -----
    Some boards reset, or do not send, by the levels of DTR and RTS. These modem lines are set
    before the port is opened; Linux itself still switches them on for some milliseconds then.
    Pseudo terminals and `socket://` have no modem lines.

    Examples
    --------
    >>> line = canser.LineConfig(baudrate=115_200, rts="off")
    >>> with canser.open("loop://", "seeed", line=line) as port:
    ...     port.baudrate
    115200
    """

    #: Of the line, in bit/s. None: the rate that adapters of the protocol come with.
    baudrate: int | None = None
    #: Level of the modem line DTR at opening: "on", "off", or "leave", as the system sets it,
    #: which is on.
    dtr: str = "leave"
    #: Level of the modem line RTS at opening, as `dtr`.
    rts: str = "leave"
    #: Whether bytes that wait in the system at opening are thrown away.
    flush: bool = False
    #: Bytes that are kept for a slow reader, 65,536 or more. The default, 8 MiB, lasts 40 s at
    #: 2 Mbaud.
    ring_size: int = 8 << 20
    #: Seconds between the pings of the watchdog, more than 0, for protocols that know a ping.
    #: None: no watchdog.
    ping: float | None = None

    def __post_init__(self) -> None:
        # Integers and bools of numpy, for example, become Python's own.
        put = partial(object.__setattr__, self)
        if self.baudrate is not None:
            put("baudrate", whole(self.baudrate, "baudrate", "115200", least=1))
        choice(self.dtr, "dtr", LEVELS)
        choice(self.rts, "rts", LEVELS)
        put("flush", flag(self.flush, "flush"))
        put("ring_size", whole(self.ring_size, "ring_size", "8 << 20", least=_RING_SIZE_LEAST))
        if self.ping is not None:
            put("ping", real(self.ping, "ping", "1.0"))
            if not 0 < self.ping < math.inf:
                raise ValueError(
                    f"ping is {self.ping:g}; it must be more than 0 seconds, and not infinite"
                )


class PortOptions(TypedDict, total=False):
    """The keywords of `canser.open` that `canser.record` takes, too."""

    bitrate: int | None
    config: AdapterConfig | None
    line: LineConfig | None
    ts_unit: str
    reconnect: bool


def adapter_config(bitrate: int | None, config: AdapterConfig | None) -> AdapterConfig | None:
    """Return the configuration by `bitrate` or `config`; None if both are None."""
    if config is None:
        return None if bitrate is None else AdapterConfig(bitrate=bitrate)
    instance(config, "config", AdapterConfig)
    if bitrate is not None:
        raise ValueError(
            f"bitrate is {bitrate}, but config has the bitrate {config.bitrate}; give one of both"
        )
    return config


def flat_config(options: Mapping[str, Any]) -> AdapterConfig | None:
    """Return the configuration with these fields, None for no field.

    `options`: keywords of a function or of the command line. A bitrate of None counts as not given.
    """
    given = {name: value for name, value in options.items() if (name, value) != ("bitrate", None)}
    if not given:
        return None
    if "bitrate" not in given:
        raise ValueError("the adapter is configured as a whole: give its bitrate, too")
    return AdapterConfig(**given)
