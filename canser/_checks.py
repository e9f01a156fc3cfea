"""Checks of arguments: an error names the argument, its value and what it may be."""

import math
import numbers
import operator
import reprlib
import sys
import threading
from typing import Any, TypeVar

__all__ = ["callback", "choice", "flag", "instance", "real", "text", "timeout", "whole"]

_T = TypeVar("_T")


def whole(value: Any, name: str, such_as: str, *, least: int | None = None) -> int:
    """Return an integer: TypeError for anything else, ValueError if it is less than `least`.

    True and False are refused, and so is 500.0: otherwise 500.5 would be cut.
    """
    try:
        if isinstance(value, bool):
            raise TypeError
        number = operator.index(value)
    except TypeError:
        raise _wrong_type(value, name, f"an integer, such as {such_as}") from None
    if least is not None and number < least:
        raise ValueError(f"{name} is {number}; it must be {least} or more")
    return number


def real(value: Any, name: str, such_as: str) -> float:
    """Return a number, NaN and infinity too; TypeError for anything else."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise _wrong_type(value, name, f"a number, such as {such_as}")
    return float(value)


def timeout(value: Any, name: str = "timeout") -> float | None:
    """Return a timeout in seconds, None if it has no end; below 0 it is over at once."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise _wrong_type(value, name, "a number of seconds, or None to wait for ever")
    number = float(value)
    if math.isnan(number):
        raise ValueError(f"{name} is nan; it must be a number of seconds, or None")
    # The system counts up to 292 years.
    return None if number >= threading.TIMEOUT_MAX else number


def flag(value: Any, name: str) -> bool:
    """Return True or False; TypeError for anything else: "no" would count as True."""
    # This module does not import numpy. If numpy is not loaded, the value is not one of its bools.
    numpy = sys.modules.get("numpy")
    if not isinstance(value, bool) and not (numpy and isinstance(value, numpy.bool_)):
        raise _wrong_type(value, name, "True or False")
    return bool(value)


def text(value: Any, name: str, such_as: str) -> str:
    """Return a string; TypeError for anything else."""
    if not isinstance(value, str):
        raise _wrong_type(value, name, f"a string, such as {such_as}")
    return value


def choice(value: Any, name: str, names: tuple[str, ...]) -> str:
    """Return one of these names; ValueError for anything else."""
    if not isinstance(value, str) or value not in names:
        raise ValueError(f"unknown {name} {value!r}; have: {', '.join(names)}")
    return value


def callback(value: _T, name: str, parameters: str) -> _T:
    """Return a function of these parameters, or None; TypeError for anything else."""
    if value is not None and not callable(value):
        raise _wrong_type(value, name, f"a function of {parameters}")
    return value


def instance(value: _T, name: str, kind: type[Any]) -> _T:
    """Return an object of this class; TypeError for anything else."""
    if not isinstance(value, kind):
        home = "canser" if kind.__module__.split(".")[0] == "canser" else kind.__module__
        raise _wrong_type(value, name, f"a {home}.{kind.__name__}")
    return value


def _wrong_type(value: Any, name: str, wanted: str) -> TypeError:
    shown = " ".join(reprlib.repr(value).split())
    return TypeError(f"{name} is {shown}; it must be {wanted}")


def type_name(value: object) -> str:
    """Name a value's type for an error message, with the dtype of an array."""
    dtype = getattr(value, "dtype", None)
    return type(value).__name__ if dtype is None else f"an array of {dtype}"
