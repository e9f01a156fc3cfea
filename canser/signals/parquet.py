"""Signals as Parquet, by pyarrow: the tables of `Signals.to_arrow`, in row groups."""

from typing import Any, BinaryIO, Final

import numpy as np

from canser._frames import FRAME_DTYPE, FrameArray
from canser.files.columns import load_pyarrow
from canser.signals.decoder import SignalDecoder
from canser.signals.signals import Resampled

__all__ = ["ParquetWriter", "write_grid"]

# Rows of a grid that are written at a time.
_ROWS: Final = 1 << 16


class ParquetWriter:
    """Write the signals of frames, a row for each sample, sorted by time within each block.

    The decoder must be one of selected signals, so that all blocks have the same ones. FormatError
    names the file if pyarrow is not installed.
    """

    def __init__(self, file: BinaryIO, decoder: SignalDecoder, name: str) -> None:
        self._pa = load_pyarrow(name)
        self._file, self._decoder = file, decoder
        self._writer: Any = None
        self.count = 0  # samples so far

    def write(self, frames: FrameArray) -> None:
        """Append the samples of a block."""
        table = self._decoder.feed(frames).to_arrow(long=True)
        if self._writer is None:
            self._writer = _open(self._file, table.schema, ["signal", "value", "text"])
        elif table.schema.field("ts") != self._writer.schema.field("ts"):
            # Times that are not known tell not whether they are dates.
            field = self._writer.schema.field("ts")
            ts = table.column("ts").cast(self._pa.int64()).cast(field.type)
            table = table.set_column(0, field, ts)
        self._writer.write_table(table)
        self.count += table.num_rows

    def finish(self) -> None:
        """End the file."""
        if self._writer is None:
            self.write(np.zeros(0, FRAME_DTYPE))
        self._writer.close()


def write_grid(file: BinaryIO, grid: Resampled, name: str) -> None:
    """Write signals on one time base, a column for each; FormatError if pyarrow is missing."""
    load_pyarrow(name)
    table = grid.to_arrow()
    titles = [each for each in table.schema.names if each != "ts"]
    writer = _open(file, table.schema, titles)
    writer.write_table(table, row_group_size=_ROWS)
    writer.close()


def _open(file: BinaryIO, schema: Any, repeating: list[str]) -> Any:
    """Begin a file; `repeating` are columns whose values come again."""
    from pyarrow import parquet  # noqa: PLC0415 - an optional extra

    return parquet.ParquetWriter(
        file,
        schema,
        compression="zstd",
        compression_level=3,
        use_dictionary=repeating,
        column_encoding={"ts": "DELTA_BINARY_PACKED"},
    )
