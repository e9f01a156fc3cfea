"""Ids as text."""

import numpy as np

__all__ = ["id_digits", "id_text"]


def id_digits(number: int, *, long: bool) -> str:
    """Return an id as three hexadecimal digits, or as eight: of an extended or error frame."""
    return f"{number:0{8 if long else 3}X}"


def id_text(row: np.void) -> str:
    """Return the id of a row with `id`, `ext` and `err`, and with what kind of frames it is of."""
    text = id_digits(int(row["id"]), long=bool(row["ext"] or row["err"]))
    if row["err"]:
        text += " error"
    return f"{text} remote" if "rtr" in (row.dtype.names or ()) and row["rtr"] else text
