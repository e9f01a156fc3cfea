"""The base of the formats Parquet and Arrow IPC, whose batches pyarrow reads and writes."""

import io
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, BinaryIO, Final

import numpy as np

from canser._core.text import NO_CHANNEL, Codes
from canser._dates import is_dated
from canser._frames import FRAME_DTYPE, FrameArray, put_records
from canser._input import Input
from canser.errors import FormatError
from canser.files.columns import from_batch, load_pyarrow, to_batch
from canser.files.reader import ReadOptions
from canser.files.tagged import TaggedReader
from canser.files.tags import RECEIVED, Tagged, joined

if TYPE_CHECKING:
    from concurrent.futures import Future

__all__ = ["BatchReader", "BatchWriter"]

# Frames in a batch, and in a row group of Parquet: a reader skips whole groups by their least and
# most values.
_BATCH: Final = 1 << 20


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
    """Writes frames as batches of `_BATCH` rows. A subclass defines `_open`.

    pyarrow packs a batch in a thread of its own, and meanwhile the next one is made ready.
    """

    takes_tags = True

    def __init__(self, file: BinaryIO, name: str) -> None:
        from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415 - slow, seldom used

        self._pa = load_pyarrow(name)
        self._file = _Sink(file)
        self._writer: Any = None
        self._thread = ThreadPoolExecutor(1, "canser-batches")
        # Of the batch before; at first, the import that takes long, while the first batch is made.
        self._packing: Future[None] | None = self._thread.submit(self._load)
        self._dated = False
        self._held: list[Tagged] = []  # blocks of the next batch
        self._held_count = 0
        self._room: FrameArray = np.empty(0, FRAME_DTYPE)  # in which their frames lie

    def _load(self) -> None:
        """Import what `_open` needs."""

    def _open(self, schema: Any) -> Any:
        """Begin the file; return what has `write_batch` and `close`."""
        raise NotImplementedError

    def write(
        self, frames: FrameArray, channels: Codes | None = None, directions: Codes | None = None
    ) -> None:
        """Append frames."""
        block = Tagged(frames, channels, directions)
        if self._held_count + len(frames) > _BATCH:
            self._flush()
        if len(frames) >= _BATCH:
            self._write(block)
            return
        # The arrays may be filled again before the batch is written.
        if not len(self._room):
            self._room = np.empty(_BATCH, FRAME_DTYPE)
        held = self._room[self._held_count :][: len(frames)]
        put_records(held, frames)
        self._held.append(Tagged(held, _copy(channels), _copy(directions)))
        self._held_count += len(frames)
        if self._held_count == _BATCH:
            self._flush()

    def _flush(self) -> None:
        if self._held_count:
            self._write(joined(self._held, self._room[: self._held_count]))
        self._held, self._held_count = [], 0

    def _write(self, block: Tagged) -> None:
        if self._writer is None:
            self._dated = is_dated(block.frames)
        batch = to_batch(self._pa, *block, dated=self._dated)
        if self._writer is None:
            self._writer = self._open(batch.schema)
        self._wait()
        self._packing = self._thread.submit(self._writer.write_batch, batch)

    def _wait(self) -> None:
        """Wait for the batch before; raise the error that has stopped it."""
        packing, self._packing = self._packing, None
        if packing is not None:
            packing.result()

    def abandon(self) -> None:
        """Write nothing more: an error has ended the writing."""
        self._file.leave()  # pyarrow's writers complete the file when they are collected
        self._thread.shutdown()

    def finish(self) -> list[str]:
        """Write the end; return no remarks: the file holds everything."""
        self._flush()
        if self._writer is None:
            self._write(Tagged(np.empty(0, FRAME_DTYPE)))
        self._wait()
        self._thread.shutdown()
        self._writer.close()
        return []


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
