"""Protocols by name, and the units of a device's clock."""

from typing import Final

from canser._core.table import PROTOCOLS, Protocol, find_protocol

__all__ = ["TS_UNITS", "Protocol", "protocol", "protocols", "tick_ns"]

# Nanoseconds in one tick of a device's clock.
TS_UNITS: Final = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}


def protocols() -> tuple[str, ...]:
    """Return the names of the protocols, in alphabetical order.

    Returns
    -------
    tuple of str
        The names that `Decoder`, `open` and the others take.

    Examples
    --------
    >>> "seeed" in canser.protocols()
    True
    """
    return tuple(PROTOCOLS)


def protocol(name: str) -> Protocol:
    """Return the properties of a protocol.

    Parameters
    ----------
    name : str
        One of `protocols()`, or an accepted spelling, in any case.

    Returns
    -------
    Protocol
        The row of the protocol: lengths of frames, baud rate, bit rates and more.

    Raises
    ------
    TypeError
        `name` is no string.
    ValueError
        `name` is unknown; the message has the names that are known.

    Examples
    --------
    >>> canser.protocol("serial").has_clock
    True
    """
    return find_protocol(name)


def tick_ns(ts_unit: str) -> int:
    """Return the nanoseconds of a device clock's unit, or raise ValueError."""
    try:
        return TS_UNITS[ts_unit]
    except (KeyError, TypeError):
        raise ValueError(f"unknown ts_unit {ts_unit!r}; have: {', '.join(TS_UNITS)}") from None
