"""What is asked of a port, as value objects."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, TypedDict

from canser._checks import choice, flag, instance, real, whole
from canser.adapters import AdapterConfig

__all__ = ["LEVELS", "LineConfig", "PortOptions", "adapter_config", "flat_config"]

# What a modem line may be at opening.
LEVELS: Final = ("leave", "on", "off")

# A terminal gives up to 4 KiB a read, and the reader of the line asks for 64 KiB at once. A
# smaller ring would lose bytes of any reader.
_RING_SIZE_LEAST: Final = 1 << 16


@dataclass(frozen=True, kw_only=True, slots=True)
class LineConfig:
    """How the serial line between host and adapter is opened and kept.

    Attributes
    ----------
    baudrate : int, optional
        Of the line, in bit/s; None: the rate that adapters of the protocol come with.
    dtr, rts : str, default "leave"
        What the modem lines DTR and RTS are at opening: "leave", as the system sets them, which
        is on; "on"; "off". Some boards reset, or do not send, by the level of these lines. They
        are set before the port is opened; Linux itself still switches them on for some
        milliseconds then. Pseudo terminals and `socket://` have none.
    flush : bool, default False
        Whether bytes that wait in the system at opening are thrown away.
    ring_size : int, default 8388608
        Bytes that are kept for a slow reader, 65536 or more. At 2 Mbaud the default lasts 40 s.
    ping : float, optional
        Seconds between the pings of the watchdog, for protocols that know a ping; None: no
        watchdog.

    Raises
    ------
    TypeError
        For a value of another type.
    ValueError
        For an unknown name, or a number out of range.

    Examples
    --------
    >>> canser.LineConfig(baudrate=115_200).baudrate
    115200
    """

    baudrate: int | None = None
    dtr: str = "leave"
    rts: str = "leave"
    flush: bool = False
    ring_size: int = 8 << 20
    ping: float | None = None

    def __post_init__(self) -> None:
        # Plain numbers and bools, whatever kind was given.
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
    """The keywords of `canser.open` that a recording takes, too."""

    bitrate: int | None
    config: AdapterConfig | None
    line: LineConfig | None
    ts_unit: str
    reconnect: bool


def adapter_config(bitrate: int | None, config: AdapterConfig | None) -> AdapterConfig | None:
    """Return the configuration that a bitrate or a config asks for; None if both are None."""
    if config is None:
        return None if bitrate is None else AdapterConfig(bitrate=bitrate)
    instance(config, "config", AdapterConfig)
    if bitrate is not None:
        raise ValueError(
            f"bitrate is {bitrate}, but config has the bitrate {config.bitrate}; give one of both"
        )
    return config


def flat_config(options: Mapping[str, Any]) -> AdapterConfig | None:
    """Return the configuration whose fields are given as flat options, None for no option.

    A bitrate of None counts as not given.
    """
    given = {name: value for name, value in options.items() if (name, value) != ("bitrate", None)}
    if not given:
        return None
    if "bitrate" not in given:
        raise ValueError("the adapter is configured as a whole: give its bitrate, too")
    return AdapterConfig(**given)
