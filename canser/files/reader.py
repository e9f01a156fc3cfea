"""Readers: the frames of a file in blocks, and what is known of the file, for any format."""

import io
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass
from datetime import datetime, tzinfo
from typing import BinaryIO, cast

from canser._core.buffers import Offsets
from canser._core.text import Codes
from canser._frames import FrameArray, put_records
from canser._input import Input
from canser.codec.decoder import Decoder
from canser.files.remarks import AddRemark
from canser.files.tags import Tagged
from canser.recording.header import RecordingInfo

__all__ = ["DecodedReader", "Parse", "ReadOptions", "Reader", "refill"]

# Yields the frames of a file. Takes the file, its name in messages, and what takes remarks.
Parse = Callable[[BinaryIO, str, AddRemark], Iterator[FrameArray]]


@dataclass(frozen=True, kw_only=True, slots=True)
class ReadOptions:
    """How files are to be read. The fields without a comment are arguments of `canser.blocks`."""

    protocol: str | None = None
    ts_unit: str | None = None
    out: FrameArray | None = None
    offsets: Offsets | None = None
    #: None for 1 of raw bytes, and for up to 4 of BLF and of a log of text.
    threads: int | None = None
    as_is: bool = False
    #: Channel to read from a log of several buses, such as "can0"; None for all.
    bus: str | None = None
    #: Whether what cannot be read in a log is left out and counted; otherwise it is an error.
    skip_bad: bool = False
    channels: Codes | None = None
    directions: Codes | None = None
    #: Time to add to all times: "file" for the file's own start.
    epoch: str | datetime | None = None
    #: "delta" if times are differences, to be added up; None if they are times.
    times: str | None = None
    #: Time zone of dates without one; None for local time.
    tz: tzinfo | None = None
    #: Whether `protocol` and `ts_unit` are for raw bytes only, and a recording keeps its own.
    raw_only: bool = False


class Reader:
    """A file that is open for reading.

    Attributes
    ----------
    decoder : Decoder or None
        The decoder of its bytes; None for a format that holds frames.
    recording : RecordingInfo or None
        The line that a recording is of; None for any other format.
    found : str
        A remark with the protocol that "auto" has found, "" if the protocol was given.
    bytes_done : int
        Bytes of the file that were read.
    gap_count : int
        Gaps of a recording so far: places where bytes of the line are missing.
    has_buses : bool
        Whether the format names the bus of each frame.
    tags : Tagged
        The current block, with the channels and directions of its frames.
    channel_names : dict
        The names of channels by their codes, as the file has them.
    start_ns : int or None
        The time from which the times of frames count, in nanoseconds since 1970; None if it is not
        known, and for times that count from 1970.
    """

    decoder: Decoder | None = None
    recording: RecordingInfo | None = None
    found = ""
    bytes_done = 0
    gap_count = 0
    has_buses = False
    tags: Tagged | None = None
    channel_names: dict[int, str] = {}  # noqa: RUF012 - never changed here
    start_ns: int | None = None

    def blocks(self, ends: Callable[[], bool]) -> Iterator[FrameArray]:
        """Yield the frames, block by block.

        `ends` is called at the end of the file, and returns whether the stream ends there.
        """
        raise NotImplementedError

    def read_all(self, offsets: Offsets | None) -> FrameArray:
        """Return all frames in one array. Only readers with a decoder have this."""
        raise NotImplementedError

    @property
    def remarks(self) -> list[str]:
        """Remarks about the file so far: what is damaged, lost, or no frame."""
        return []

    def name_of(self, code: int) -> str:
        """Return the name of a channel as the file has it."""
        return self.channel_names.get(code, "not told")

    @property
    def channels(self) -> list[int]:
        """The codes of the channels so far."""
        return []

    def tag_remarks(self, kept: Container[str]) -> list[str]:  # noqa: ARG002 - for all formats
        """Return remarks on "channels" and "directions", but for those that are kept."""
        return []

    @property
    def doubt(self) -> str:
        """Why the bytes so far are not of the protocol that they are read in; "" if they may be."""
        return ""

    def close(self) -> None:
        """End the reading: nothing more of the file is read."""

    def carry_on(self, last: "Reader") -> bool:  # noqa: ARG002 - used for raw bytes
        """Continue the stream of the file before this one; return False if that is impossible."""
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
        """Yield the frames, block by block. No packet continues in the next file."""
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
        """Remarks about the file; complete at its end."""
        return list(self._remarks)


def refill(blocks: Iterator[FrameArray], out: FrameArray) -> Iterator[FrameArray]:
    """Yield frames in the caller's array, which is full each time but the last."""
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
