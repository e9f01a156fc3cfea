"""The base of the formats Parquet and Arrow IPC, whose batches pyarrow reads and writes."""

import io
from collections.abc import Iterator
from functools import partial
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

from canser._core.text import NO_CHANNEL, Codes
from canser._dates import is_dated
from canser._frames import FRAME_DTYPE, FrameArray, put_records
from canser._input import Input
from canser._threads import Helpers
from canser.errors import FormatError
from canser.files.columns import from_batch, load_pyarrow
from canser.files.reader import ReadOptions
from canser.files.tagged import TaggedReader
from canser.files.tags import RECEIVED, Tagged, joined
from canser.tables.table import Table, make_table

__all__ = ["BatchReader", "BatchWriter"]

# Frames in a table, a row group of Parquet: a reader skips whole groups by their least and most
# values.
_BATCH: Final = 1 << 20

# Frames that become columns at a time, a batch of Arrow IPC: they are still in the processor's
# cache.
_PIECE: Final = 1 << 16


class BatchReader(TaggedReader):
    """Reads the batches of a file. A subclass defines `_batches`."""

    first_channel = 0

    def __init__(self, source: Input, options: ReadOptions) -> None:
        super().__init__(source, options)
        self._pa = load_pyarrow(source.name)
        if source.size is None:
            raise FormatError(
                f"{source.name} is read from its end on, and cannot be a pipe or packed; put it "
                "into a file"
            )

    def _batches(self, file: BinaryIO) -> Iterator[Any]:
        """Yield the batches of a file."""
        raise NotImplementedError

    def _fill(self) -> Iterator[None]:
        done, name = 0, self._source.name
        batches = self._batches(self._source.file)
        while True:
            try:
                batch = next(batches, None)
            except (self._pa.ArrowException, OSError, ValueError) as error:
                reason = str(error).partition("\n")[0]
                raise FormatError(f"{name} cannot be read: {reason}") from None
            if batch is None:
                break
            block = from_batch(self._pa, batch, name, done)
            at = 0
            while at < len(block.frames):
                room = min(len(self._frames) - self._count, len(block.frames) - at)
                rows = slice(self._count, self._count + room)
                put_records(self._frames[rows], block.frames[at : at + room])
                self._channels[rows] = (
                    NO_CHANNEL if block.channels is None else block.channels[at : at + room]
                )
                self._directions[rows] = (
                    RECEIVED if block.directions is None else block.directions[at : at + room]
                )
                self._count += room
                at += room
                if self._count == len(self._frames):
                    yield
            done += len(block.frames)
        self.bytes_done = self._source.total or 0
        yield


class BatchWriter:
    """Writes frames as tables of up to `_BATCH` rows. A subclass defines `_open`.

    The frames become columns here, a piece at a time. A thread of its own imports pyarrow, and then
    writes a table while the pieces of the next one are made.
    """

    takes_tags = True

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file, self._name = _Sink(file), name
        self._pa: Any = None
        self._writer: Any = None
        self._dated: bool | None = None
        self._held: list[Tagged] = []  # blocks of the next piece
        self._held_count = 0
        self._room: FrameArray = np.empty(0, FRAME_DTYPE)  # in which their frames lie
        self._pieces: list[Table] = []  # of the next table
        self._rows = 0
        self._helpers: Helpers[None] = Helpers(2, "tables")
        self._helpers.put(self._load)

    def _load(self) -> None:
        """Import what `_open` needs."""
        self._pa = load_pyarrow(self._name)

    def _open(self, schema: Any) -> Any:
        """Begin the file; return what has `write_table` and `close`."""
        raise NotImplementedError

    def write(
        self, frames: FrameArray, channels: Codes | None = None, directions: Codes | None = None
    ) -> None:
        """Append frames. Raises the error that has ended the writing of frames before."""
        self._helpers.check()
        block = Tagged(frames, channels, directions)
        for begin in range(0, len(frames), _PIECE):
            self._append(block.map(partial(_rows, begin)))

    def _append(self, block: Tagged) -> None:
        """Append up to `_PIECE` frames."""
        count = len(block.frames)
        if self._held_count + count > _PIECE:
            self._flush_held()
        if count == _PIECE:
            self._add(block)
            return
        # The arrays may be filled again before the piece is made.
        if not len(self._room):
            self._room = np.empty(_PIECE, FRAME_DTYPE)
        held = self._room[self._held_count :][:count]
        put_records(held, block.frames)
        self._held.append(Tagged(held, _copy(block.channels), _copy(block.directions)))
        self._held_count += count

    def _flush_held(self) -> None:
        if self._held_count:
            self._add(joined(self._held, self._room[: self._held_count]))
        self._held, self._held_count = [], 0

    def _add(self, piece: Tagged) -> None:
        """Add a piece, as columns, to the next table."""
        if self._rows + len(piece.frames) > _BATCH:
            self._flush()
        if self._dated is None:
            self._dated = is_dated(piece.frames)
        self._pieces.append(make_table(*piece, dated=self._dated))
        self._rows += len(piece.frames)

    def _flush(self) -> None:
        """Have the next table written."""
        self._wait()
        pieces, self._pieces, self._rows = self._pieces, [], 0
        self._helpers.put(partial(self._pack, pieces))

    def _pack(self, pieces: list[Table]) -> None:
        table = self._pa.Table.from_batches([self._pa.record_batch(each) for each in pieces])
        if self._writer is None:
            self._writer = self._open(table.schema)
        self._writer.write_table(table)

    def _wait(self) -> None:
        """Wait for the table before; raise the error that has ended its writing."""
        if self._helpers:
            self._helpers.take()

    def abandon(self) -> None:
        """Write nothing more: an error has ended the writing."""
        self._file.leave()  # pyarrow's writers complete the file when they are collected
        self._helpers.close()

    def finish(self) -> list[str]:
        """Write the end; return no remarks: the file holds everything."""
        self._flush_held()
        if self._dated is None:  # a file without frames has columns, too
            self._add(Tagged(np.empty(0, FRAME_DTYPE)))
        if self._pieces:
            self._flush()
        self._wait()
        self._helpers.close()
        self._writer.close()
        return []


def _rows(begin: int, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a piece of an array."""
    return array[begin : begin + _PIECE]


class _Sink(io.RawIOBase):
    """A file to write, until it is left: then nothing more goes into it."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__()
        self._file: BinaryIO | None = file

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        return len(memoryview(data)) if self._file is None else self._file.write(data)

    def leave(self) -> None:
        self._file = None


def _copy(codes: Codes | None) -> Codes | None:
    return None if codes is None else codes.copy()
