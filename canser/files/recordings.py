"""Recordings of an adapter's line: raw bytes with their arrival times, in pcapng files.

A recording names its protocol and the unit of the device's clock. Its frames have times of the
host's clock, in nanoseconds since 1970.
"""

from collections.abc import Callable, Iterator
from typing import BinaryIO, Final

import numpy as np

from canser._core.buffers import Offsets
from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray, copy_records
from canser._input import Input
from canser._protocols import protocol as find_protocol
from canser.codec.decoder import Decoder, Encoder, decode
from canser.codec.growing import GrowingFrames
from canser.codec.refusals import Refusals
from canser.errors import FormatError, WrongProtocolError
from canser.files.judge import describe_doubt, is_auto
from canser.files.raw import BLOCK_FRAMES
from canser.files.reader import Reader, ReadOptions
from canser.files.writer import WriteOptions
from canser.recording.header import RecordingInfo, is_recording
from canser.recording.reader import Recording
from canser.recording.recorded import RecordedFrames
from canser.recording.writer import RecordingWriter

__all__ = ["RecordingFile", "RecordingReader", "open_writer"]

about: Final = "a recording"

cannot_hold: Final = ("what the protocol has no place for", "times to less than 2 ms")

# The largest error of a known time in a recording that is written from frames. Frames that come
# more irregularly than this start a new block, which adds 72 bytes to the file. The clock of
# `serial` adds an error of one tick.
_TIME_ERROR_NS: Final = 500_000


def sniff(head: bytes) -> bool:
    """Return whether a file starts as a pcapng file does."""
    return is_recording(head)


def read(source: Input, options: ReadOptions) -> "RecordingReader":
    """Open a recording.

    Raises
    ------
    RecordingError
        The pcapng file was not written by canser.
    WrongProtocolError
        The recording has another protocol than the one given.
    """
    return RecordingReader(source, options)


class RecordingReader(Reader):
    """Reads a recording in its own protocol; with `as_is` in the one given."""

    decoder: Decoder
    recording: RecordingInfo

    def __init__(self, source: Input, options: ReadOptions) -> None:
        self._source, self._out, self._offsets = source, options.out, options.offsets
        recording = Recording(source)
        own = recording.info.protocol
        protocol = None if options.raw_only else options.protocol
        if protocol is None or is_auto(protocol):
            protocol = own
        elif not options.as_is and (given := find_protocol(protocol).name) != own:
            raise WrongProtocolError(f"{source.name} is a recording in {own}, not in {given}")
        self._recorded = RecordedFrames(
            recording,
            protocol,
            None if options.raw_only else options.ts_unit,
            live=source.size is None,
        )
        self._ended_doubt: str | None = None  # None before the end
        self.decoder, self.recording = self._recorded.decoder, self._recorded.info

    def blocks(self, ends: Callable[[], bool]) -> Iterator[FrameArray]:  # noqa: ARG002
        """Yield the frames, block by block. A packet that the end cuts off is not completed."""
        for out, count in self._recorded.run(self._room):
            self.bytes_done = self._recorded.bytes_done
            self.gap_count = self._recorded.gap_count
            yield out[:count]
        self.bytes_done = self._recorded.bytes_done
        self.gap_count = self._recorded.gap_count

    def line_bytes(self) -> Iterator[memoryview]:
        """Yield the bytes of the line as they were recorded, without decoding them."""
        return self._recorded.line_bytes()

    @property
    def remarks(self) -> list[str]:
        """Remarks on what is damaged and what is lost."""
        return self._recorded.remarks

    @property
    def doubt(self) -> str:
        """Why the bytes so far are not of the protocol that they are read in; "" if they may be."""
        if self._ended_doubt is not None:
            return self._ended_doubt
        decoder, head = self.decoder, self._recorded.head
        return describe_doubt(
            self._source.name, decoder.protocol, decoder.position, decoder.skipped, head
        )

    def close(self) -> None:
        """End the reading: keep the `doubt`, and release the memory that reading took."""
        if self._ended_doubt is None:
            self._ended_doubt = self.doubt
            self._recorded.release()

    def _room(self) -> tuple[FrameArray, Offsets | None]:
        if self._out is None:
            return np.empty(BLOCK_FRAMES, FRAME_DTYPE), None
        return self._out, self._offsets

    def read_all(self, offsets: Offsets | None) -> FrameArray:
        """Return all frames in one array."""
        source, recorded = self._source, self._recorded
        array = GrowingFrames(BLOCK_FRAMES)
        at = np.empty(BLOCK_FRAMES, np.int64)

        def room() -> tuple[FrameArray, Offsets]:
            if array.room < BLOCK_FRAMES:
                # Estimate the number of frames from those so far. This happens again if the size
                # of the file is not known, or if later bytes have more frames.
                done = recorded.decoder.position
                expected = int(array.count * (source.total or 2 * done) / done * 1.02)
                array.grow(max(expected, array.count) + BLOCK_FRAMES)
            return array.frames[array.count : array.count + BLOCK_FRAMES], at

        for _, more in recorded.run(room):
            if offsets is not None:
                fits = max(min(more, len(offsets) - array.count), 0)
                offsets[array.count : array.count + fits] = at[:fits]
            array.count += more
        if offsets is not None and array.count > len(offsets):
            raise ValueError(
                f"offsets has room for {len(offsets)} frames, but the data holds {array.count}; "
                f"make room for at least {array.count}"
            )
        return array.result()


def write(file: BinaryIO, options: WriteOptions) -> "RecordingFile":
    """Begin a recording."""
    return RecordingFile(file, options)


class RecordingFile:
    """Writes frames as a recording of a line on which each frame arrived at its time.

    Frames that the protocol cannot carry are left out; with `strict` they raise ValueError. A
    frame without a time gets the time of the frame before it.
    """

    def __init__(self, file: BinaryIO, options: WriteOptions) -> None:
        assert options.protocol is not None
        self._protocol = find_protocol(options.protocol)
        self._encoder = Encoder(options.protocol, ts_unit=options.ts_unit)
        self._strict = options.strict
        self._refusals = Refusals(options.protocol, times_given=True)
        self._writer = open_writer(file, options)
        self._last_ns = 0
        self._untimed = self._early = 0  # frames
        self.frames = self.bytes_out = 0

    def write(self, frames: FrameArray) -> None:
        """Append the frames that the protocol can carry."""
        kept = frames if self._strict else self._refusals.keep(frames)
        if not len(kept):
            return
        times = kept["ts"]
        unknown = times == NO_TIME
        if unknown.any():
            self._untimed += int(unknown.sum())
            kept = copy_records(kept)
            times = kept["ts"]
            # For each frame the index of the last known time up to it, -1 if there is none.
            known = np.maximum.accumulate(np.where(unknown, -1, np.arange(len(times))))
            times[unknown] = np.where(known < 0, self._last_ns, times[known])[unknown]
        early = int((times < 0).sum())
        if early:
            self._early += early
            times = np.maximum(times, 0)
        raw = self._encoder.encode(kept)
        begins = np.empty(len(kept), np.int64)
        decode(raw, self._protocol.name, offsets=begins, as_is=True)
        ends = [*begins[1:].tolist(), len(raw)]
        data = memoryview(raw.data)
        for begin, end, ns in zip(begins.tolist(), ends, times.tolist(), strict=True):
            self._writer.write(data[begin:end], ns)
        self._last_ns = int(times[-1])
        self.frames += len(kept)
        self.bytes_out += len(raw)

    def finish(self) -> list[str]:
        """Write the end; return remarks on what the recording does not hold."""
        self._writer.close()
        name, refusals = self._protocol.name, self._refusals
        if refusals.left_out and not self.frames:
            raise FormatError(
                f"{name} can carry none of the {refusals.frames:,} frames: {refusals.reasons}; "
                "convert to another protocol"
            )
        remarks = [str(refusals)] if refusals.left_out else []
        if self._untimed:
            remarks.append(
                f"frames without a time, which get that of the frame before: {self._untimed:,}"
            )
        if self._early:
            remarks.append(f"frames with a time before 1970, written as 0: {self._early:,}")
        return remarks


def open_writer(file: BinaryIO, options: WriteOptions) -> RecordingWriter:
    """Return a recording's writer, for bytes that do not come from a port."""
    assert options.protocol is not None
    protocol = find_protocol(options.protocol)
    info = RecordingInfo(protocol.name, protocol.baudrate, None, options.ts_unit, "a file")
    return RecordingWriter(file, info, syncs=False, time_error_ns=_TIME_ERROR_NS)
