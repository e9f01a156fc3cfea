"""Remarks on files: passed on, or warned of."""

import warnings
from collections.abc import Callable, Iterable

from canser.errors import CanserWarning

__all__ = ["AddRemark", "report_remarks"]

# Takes a remark about a file: a line of text without the file's name.
AddRemark = Callable[[str], object]


def report_remarks(remarks: Iterable[str], name: str, add_remark: AddRemark | None) -> None:
    """Pass the remarks about a file to `add_remark`; without one, warn of each."""
    for remark in remarks:
        if add_remark is None:
            # The warning points to the code that asks the calling generator for its next block.
            warnings.warn(f"{name}: {remark}", CanserWarning, stacklevel=3)
        else:
            add_remark(remark)
