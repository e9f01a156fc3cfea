"""Convert values to those of JSON: a value that is not known is null, times are nanoseconds."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from canser._frames import NO_TIME

__all__ = ["to_plain"]


def to_plain(value: object) -> Any:
    """Return a value as dicts, lists, str, bool, int, float and None.

    Dataclasses and named tuples become dicts of their fields, arrays of records become lists of
    dicts, and bytes become hexadecimal digits. NaN becomes None, and so does NO_TIME in a field
    whose name ends in `_ns`; other values of such a field become int.
    """
    if dataclasses.is_dataclass(value):
        fields = dataclasses.fields(value)
        return {field.name: to_plain(getattr(value, field.name)) for field in fields}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return to_plain(value._asdict())
    if isinstance(value, Mapping):
        return {name: to_plain(each) for name, each in value.items()}
    if isinstance(value, np.ndarray):
        names = value.dtype.names or ()
        return [
            {name: _field(name, each) for name, each in zip(names, row, strict=True)}
            for row in value.tolist()
        ]
    if isinstance(value, list | tuple):
        return [to_plain(each) for each in value]
    return value.hex().upper() if isinstance(value, bytes) else value


def _field(name: str, value: Any) -> Any:
    """Return the value of a field of a record."""
    if isinstance(value, np.ndarray):
        return value.tobytes().hex().upper()
    if isinstance(value, float) and math.isnan(value):
        return None
    if name.endswith("_ns"):
        return None if value == NO_TIME else round(value)
    return value
