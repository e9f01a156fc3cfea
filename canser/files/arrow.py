"""Arrow IPC files, also named Feather, by pyarrow, in columns: see `tables.table.COLUMNS`."""

from collections.abc import Iterator
from typing import Any, BinaryIO, Final

from canser._input import Input
from canser.files.reader import Reader, ReadOptions
from canser.files.tables import BatchReader, BatchWriter
from canser.files.writer import WriteOptions

about: Final = "an Arrow IPC file"

cannot_hold: Final = ("names of channels",)


def sniff(head: bytes) -> bool:
    """Return whether a file starts as Arrow IPC files do."""
    return head.startswith(b"ARROW1\0\0")


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a file."""
    return _ArrowReader(source, options)


def write(file: BinaryIO, options: WriteOptions) -> "Writer":  # noqa: ARG001 - as every format
    """Begin a file."""
    return Writer(file, "Arrow IPC")


class Writer(BatchWriter):
    """Writes frames as record batches."""

    def _open(self, schema: Any) -> Any:
        return self._pa.ipc.new_file(self._file, schema)


class _ArrowReader(BatchReader):
    def _batches(self, file: BinaryIO) -> Iterator[Any]:
        with self._pa.ipc.open_file(file) as batches:
            for number in range(batches.num_record_batches):
                yield batches.get_batch(number)
