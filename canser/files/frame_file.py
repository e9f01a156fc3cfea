"""A file of frames, whatever its format: opened by its suffix, read block by block."""

import contextlib
import sys
from collections.abc import Callable, Iterator
from pathlib import PurePath
from typing import BinaryIO, Final, Self

from canser._frames import FrameArray
from canser._named import named
from canser.codec.decoder import Decoder
from canser.errors import StreamClosedError
from canser.files.captures import Blocks
from canser.files.formats import BY_SUFFIX
from canser.files.judge import check_protocol
from canser.recording.recording import RecordingInfo

__all__ = ["FORMATS", "RAW", "FrameFile", "format_of"]

RAW: Final = "raw"

# Formats by the names that options have: the bytes of an adapter, and frames.
FORMATS: Final = (RAW, *(suffix[1:] for suffix in BY_SUFFIX))


def format_of(path: str, given: str | None = None) -> str:
    """Return the format of a file: the given one, or the one of its suffix, else raw."""
    if given is not None:
        return given
    suffix = PurePath(path).suffix.lower()
    return suffix[1:] if suffix in BY_SUFFIX else RAW


class FrameFile(Iterator[FrameArray]):
    """The frames of a file, "-" for the standard input: an iterator of blocks.

    `file_format`: one of FORMATS. Raw bytes need their `protocol`, else NoProtocolError; a
    recording among them knows it. Both keep their decoder in `.decoder`, for the stats and
    the control packets, and a recording what it tells in `.recording`. `.remarks` has what is
    to be known of a recording so far, and of other formats at their end.
    `protocol`, `as_is`: as for `canser.blocks`, and `raw_only` as for `Blocks`; `.doubt` tells
    why the bytes so far are not of the protocol they are read in, "" if they may be.
    `progress` is called with the bytes done and in all. A context manager.
    """

    def __init__(
        self,
        path: str,
        file_format: str,
        *,
        protocol: str | None = None,
        ts_unit: str | None = None,
        as_is: bool = False,
        raw_only: bool = False,
        progress: Callable[[int, int | None], None] | None = None,
    ) -> None:
        self.name = "standard input" if path == "-" else path
        self.decoder: Decoder | None = None
        self.recording: RecordingInfo | None = None
        self._remarks: list[str] = []
        self._blocks: Iterator[FrameArray]
        with contextlib.ExitStack() as opening:
            file = _standard_input() if path == "-" else opening.enter_context(open(path, "rb"))  # noqa: PTH123
            if file_format == RAW:
                check_protocol(protocol, ts_unit)
                raw = Blocks(
                    file,
                    protocol,
                    ts_unit,
                    None,
                    None,
                    threads=1,
                    progress=progress,
                    as_is=as_is,
                    warns=False,
                    raw_only=raw_only,
                )
                self.decoder, self.recording, self._blocks = raw.decoder, raw.recording, raw
            else:
                self._blocks = BY_SUFFIX[f".{file_format}"].read(
                    file, self.name, self._remarks.append
                )
            self._stack = opening.pop_all()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> FrameArray:
        with named(self.name):
            return next(self._blocks)

    def __enter__(self) -> Self:
        return self

    @property
    def remarks(self) -> list[str]:
        """What to know so far: the protocol found, what is damaged or lost, or is no frame."""
        if not isinstance(self._blocks, Blocks):
            return self._remarks
        found = [self._blocks.found] if self._blocks.found else []
        return [*found, *self._blocks.remarks]

    def sample(self) -> memoryview:
        """Return some of the raw bytes of the file, as `Blocks.sample` does."""
        assert isinstance(self._blocks, Blocks)
        return self._blocks.sample()

    @property
    def doubt(self) -> str:
        """Why the bytes so far are not of the protocol they are read in, "" if they may be."""
        return self._blocks.doubt if isinstance(self._blocks, Blocks) else ""

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def _standard_input() -> BinaryIO:
    if sys.stdin is None:
        raise StreamClosedError("the standard input is closed; open it, or name a file")
    return sys.stdin.buffer
