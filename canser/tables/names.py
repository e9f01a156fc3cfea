"""Names of the columns of frames, as different programs have them."""

from collections.abc import Collection, Sequence
from typing import Final

__all__ = ["NATIVE", "RECEIVED_TITLE", "check_choice", "names_in", "names_of"]

NATIVE: Final = ("ts", "channel", "sent", "id", "ext", "rtr", "err", "dlc", "data")

# The name in which the column `sent` is turned round.
RECEIVED_TITLE: Final = "is_rx"

# Of can.Message. Its times are seconds; here they stay nanoseconds.
_PYTHON_CAN: Final = (
    "timestamp",
    "channel",
    RECEIVED_TITLE,
    "arbitration_id",
    "is_extended_id",
    "is_remote_frame",
    "is_error_frame",
    "dlc",
    "data",
)

# Of the bus events of ASAM MDF 4.
_ASAM: Final = ("Timestamp", "BusChannel", "Dir", "ID", "IDE", "RTR", "Err", "DLC", "DataBytes")

_NAMES: Final = {"native": NATIVE, "python-can": _PYTHON_CAN, "asam": _ASAM}


def names_of(names: str) -> dict[str, str]:
    """Return the name of each native column; ValueError for an unknown choice."""
    check_choice("names", names, tuple(_NAMES))
    return dict(zip(NATIVE, _NAMES[names], strict=True))


def check_choice(option: str, value: str, choices: Sequence[str]) -> None:
    """Raise ValueError if a value is none of the choices."""
    if value not in choices:
        raise ValueError(f"{option} is {value!r}; give {', '.join(map(repr, choices))}")


def names_in(have: Collection[str]) -> dict[str, str]:
    """Return the native name of each column of frames among those of a table."""
    native = dict(zip(NATIVE, NATIVE, strict=True))
    for names in _NAMES.values():
        if names[3] in have:  # the id, which each table has
            native = dict(zip(names, NATIVE, strict=True))
            break
    return {title: name for title, name in native.items() if title in have}
