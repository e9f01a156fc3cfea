"""What a reader gives, whatever the format: blocks of frames, and what is known of the file."""

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import BinaryIO, cast

from canser._core.buffers import Offsets
from canser._frames import FrameArray, put_records
from canser._input import Input
from canser.codec.decoder import Decoder
from canser.files._remarks import Tell
from canser.recording.header import RecordingInfo

__all__ = ["DecodedReader", "Parse", "ReadOptions", "Reader", "refill"]

# Yields the frames of a file; the name is what messages call it, and `Tell` takes remarks.
Parse = Callable[[BinaryIO, str, Tell], Iterator[FrameArray]]


@dataclass(frozen=True, kw_only=True, slots=True)
class ReadOptions:
    """How files are to be read; for what the arguments of `canser.blocks` mean see there."""

    protocol: str | None = None
    ts_unit: str | None = None
    out: FrameArray | None = None
    offsets: Offsets | None = None
    threads: int = 1
    as_is: bool = False
    #: Of a log of several buses the channel that is read, such as "can0"; None for all.
    bus: str | None = None
    #: `protocol` and `ts_unit` are those of raw bytes; a recording has its own.
    raw_only: bool = False


class Reader:
    """A file that is open for reading.

    Attributes
    ----------
    decoder : Decoder or None
        The decoder of its bytes; None for a format that holds frames.
    recording : RecordingInfo or None
        What a recording knows of its line; None for any other format.
    found : str
        Which protocol "auto" has found, "" if it was given.
    bytes_done : int
        How far in the file the reading has come.
    has_buses : bool
        Whether the format names the bus of each frame.
    """

    decoder: Decoder | None = None
    recording: RecordingInfo | None = None
    found = ""
    bytes_done = 0
    has_buses = False

    def blocks(self, ends: Callable[[], bool]) -> Iterator[FrameArray]:
        """Yield the frames, block by block.

        `ends` is asked at the end of the file: whether the stream ends there.
        """
        raise NotImplementedError

    def read_all(self, offsets: Offsets | None) -> FrameArray:
        """Return all frames in one array; of a reader with a decoder."""
        raise NotImplementedError

    @property
    def remarks(self) -> list[str]:
        """What to know of the file so far: what is damaged, lost, or is no frame."""
        return []

    @property
    def doubt(self) -> str:
        """Why the bytes so far are not of the protocol they are read in; "" if they may be."""
        return ""

    def close(self) -> None:
        """Take it that nothing more of the file is read."""

    def carry_on(self, last: "Reader") -> bool:  # noqa: ARG002 - a reader of raw bytes does
        """Go on with the stream of the file before this one; False where that cannot be."""
        return False


class DecodedReader(Reader):
    """Reads a format that holds frames, by a function that parses it."""

    def __init__(
        self, source: Input, options: ReadOptions, parse: Parse, *, has_buses: bool = False
    ) -> None:
        self.has_buses = has_buses
        self._source, self._out, self._parse = source, options.out, parse
        self._remarks: list[str] = []

    def blocks(self, ends: Callable[[], bool]) -> Iterator[FrameArray]:  # noqa: ARG002
        """Yield the frames, block by block; no packet goes on in the next file."""
        frames = self._run()
        yield from frames if self._out is None else refill(frames, self._out)

    def _run(self) -> Iterator[FrameArray]:
        stream = self._source.stream()
        file = cast(BinaryIO, io.BufferedReader(stream, 1 << 16))
        for frames in self._parse(file, self._source.name, self._remarks.append):
            self.bytes_done = stream.bytes_done
            yield frames
        self.bytes_done = stream.bytes_done

    @property
    def remarks(self) -> list[str]:
        """What to know of the file, known at its end."""
        return list(self._remarks)


def refill(blocks: Iterator[FrameArray], out: FrameArray) -> Iterator[FrameArray]:
    """Yield frames in the array of the caller, full but for the last time."""
    count = 0
    for frames in blocks:
        at = 0
        while at < len(frames):
            fits = min(len(out) - count, len(frames) - at)
            put_records(out[count : count + fits], frames[at : at + fits])
            count, at = count + fits, at + fits
            if count == len(out):
                yield out
                count = 0
    if count:
        yield out[:count]
