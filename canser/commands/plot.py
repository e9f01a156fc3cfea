"""`canser plot`: pictures of a file."""

import argparse
from typing import Any, Final

import numpy as np

from canser._frames import FRAME_DTYPE, FrameArray, concat, copy_records
from canser._output import check_apart, whole_file
from canser._progress import Progress
from canser.analysis.load import BITRATE_MOST
from canser.commands._numbers import duration, whole
from canser.commands._parser import CallError, Commands, GOOD, add_command, write_line
from canser.commands._source import (
    check_found,
    open_source,
    selection,
    selection_arguments,
    source_arguments,
    write_remarks,
)

__all__ = ["add"]

# The pictures, and the option that each one needs.
_NEEDS: Final = {
    "overview": "",
    "load": "",
    "ids": "",
    "periods": "",
    "raster": "",
    "payload": "id",
    "signals": "db",
    "stream": "",
    "compare": "with",
}

# The formats of a picture, by the suffix of its file.
_SUFFIXES: Final = ("png", "svg", "pdf")
