"""Ids as text."""

import numpy as np

__all__ = ["id_text"]


def id_text(row: np.void) -> str:
    """Return the id of a row with `id`, `ext` and `err`: three digits, or eight if it is extended.

    Error frames have eight digits, too. ` remote` follows if the row has `rtr`.
    """
    names = row.dtype.names or ()
    text = f"{row['id']:0{8 if row['ext'] or row['err'] else 3}X}"
    if row["err"]:
        text += " error"
    return f"{text} remote" if "rtr" in names and row["rtr"] else text
