"""Parquet, by pyarrow, in columns: see `tables.table.COLUMNS`.

Columns are compressed by zstd. Times are stored as differences, and ids, dlcs and data as places in
a dictionary: so a frame takes about 4 bytes.
"""

from collections.abc import Iterator
from typing import Any, BinaryIO, Final

from canser._input import Input
from canser.files.reader import Reader, ReadOptions
from canser.files.tables import BatchReader, BatchWriter
from canser.files.writer import WriteOptions

about: Final = "a Parquet file"

cannot_hold: Final = ("names of channels",)

# Rows that are read at a time.
_ROWS: Final = 1 << 16


def sniff(head: bytes) -> bool:
    """Return whether a file starts as Parquet files do."""
    return head.startswith(b"PAR1")


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a file."""
    return _ParquetReader(source, options)


def write(file: BinaryIO, options: WriteOptions) -> "Writer":  # noqa: ARG001 - as every format
    """Begin a file."""
    return Writer(file, "Parquet")


class Writer(BatchWriter):
    """Writes frames as row groups."""

    def _load(self) -> None:
        super()._load()
        from pyarrow import parquet  # noqa: F401, PLC0415 - an optional extra

    def _open(self, schema: Any) -> Any:
        from pyarrow import parquet  # noqa: PLC0415 - an optional extra

        return parquet.ParquetWriter(
            self._file,
            schema,
            compression="zstd",
            compression_level=3,
            use_dictionary=["id", "dlc", "data", "channel"],
            column_encoding={"ts": "DELTA_BINARY_PACKED"},
        )


class _ParquetReader(BatchReader):
    def _batches(self, file: BinaryIO) -> Iterator[Any]:
        from pyarrow import parquet  # noqa: PLC0415 - an optional extra

        yield from parquet.ParquetFile(file).iter_batches(batch_size=_ROWS)
