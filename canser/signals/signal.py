"""The samples of a signal."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Signal"]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Signal:
    """The samples of one signal, given by `Signals`.

    Attributes
    ----------
    name : str
        The name in the database.
    message : str
        The name of its message.
    group : str
        The name of its group: signals of a group share their times.
    ts : array of datetime64[ns], shape (n,)
        The times of the frames. They start in 1970 if the times of the frames are no dates.
    values : array of int64, uint64 or float64, shape (n,)
        Physical values. Whole numbers if scale and offset are whole and all values fit.
    unit : str
        The unit, "" if the database has none.
    choices : mapping of int to str, or None
        The texts of raw values.
    raw : array of int64, uint64 or float64, shape (n,), or None
        The values before scale and offset, if they were asked for.
    valid : array of bool, shape (n,), or None
        After `resample`: where there is a value. Otherwise None, as all samples have one.
    """

    name: str
    message: str
    group: str
    ts: npt.NDArray[np.datetime64]
    values: npt.NDArray[Any]
    unit: str = ""
    choices: Mapping[int, str] | None = None
    raw: npt.NDArray[Any] | None = None
    valid: npt.NDArray[np.bool_] | None = None

    @property
    def full_name(self) -> str:
        """The message and the name, with a point between."""
        return f"{self.message}.{self.name}"

    def __len__(self) -> int:
        return len(self.values)

    def __repr__(self) -> str:
        unit = f", {self.unit}" if self.unit else ""
        return f"<canser.Signal {self.full_name}{unit}: {len(self):,} samples>"
