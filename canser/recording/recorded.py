"""Decode the blocks of a recording into frames with times of the host's clock."""

from collections.abc import Callable, Iterator

import numpy as np

from canser._core.buffers import Offsets
from canser._frames import FRAME_DTYPE, FrameArray
from canser.codec.decoder import Decoder
from canser.errors import RecordingError
from canser.recording.header import RecordingInfo
from canser.recording.reader import Recording
from canser.timing.loop import TimedDecoder

__all__ = ["RecordedFrames"]

# Bytes kept from the start of the line: enough for `identify`.
_HEAD_LEN = 1 << 16


class RecordedFrames:
    """Decodes a recording into arrays that the caller makes.

    RecordingError if the recording's protocol is unknown.

    Parameters
    ----------
    recording
        The recording, at its start.
    protocol
        The protocol to decode in; None for the recording's own.
    ts_unit
        Unit of the device's timestamps; None for the recording's own.
    live
        Whether frames are returned as soon as their bytes arrive, and not in full arrays.
    """

    def __init__(
        self, recording: Recording, protocol: str | None, ts_unit: str | None, *, live: bool
    ) -> None:
        self.info: RecordingInfo = recording.info
        self._recording, self._live = recording, live
        self.head = bytearray()  # the first bytes of the line, for `identify`
        try:
            self.decoder = Decoder(
                self.info.protocol if protocol is None else protocol,
                ts_unit=self.info.ts_unit if ts_unit is None else ts_unit,
            )
        except ValueError as error:
            raise RecordingError(f"the recording says {error}") from None
        self._loop = TimedDecoder(self.decoder, self.info.byte_ns, recorded=True)
        self.gap_count = self._bytes_lost = self._unknown = 0
        self._out: FrameArray = np.empty(0, FRAME_DTYPE)  # the array that is being filled

    @property
    def bytes_done(self) -> int:
        """Bytes of the file that were read."""
        return self._recording.bytes_done

    @property
    def remarks(self) -> list[str]:
        """Remarks about the recording so far, a line each."""
        remarks = list(self._recording.remarks)
        if self.gap_count:
            lost = f"{self._bytes_lost:,}"
            if self._unknown:
                times = "once" if self._unknown == 1 else f"{self._unknown:,} times"
                lost += f" and {times} an unknown number"
            remarks.append(f"gaps in the recording: {self.gap_count:,}, bytes lost: {lost}")
        if self._loop.clock.remark is not None:
            remarks.append(self._loop.clock.remark)
        return remarks

    def release(self) -> None:
        """Release the memory that reading took; nothing more is read."""
        self.head = bytearray()
        self._release_arrays()

    def _release_arrays(self) -> None:
        """Drop the references to the caller's arrays."""
        self._out = np.empty(1, FRAME_DTYPE)
        self._loop.use(self._out)

    def line_bytes(self) -> Iterator[memoryview]:
        """Yield the bytes of the line as they were recorded, without decoding them.

        Each piece is valid until the next one.
        """
        for run in self._recording.runs():
            if run.gap:
                self._count_gap(run.lost)
            yield run.data

    def run(
        self, room: Callable[[], tuple[FrameArray, Offsets | None]]
    ) -> Iterator[tuple[FrameArray, int]]:
        """Yield arrays, and the number of frames in each.

        `room` returns a new array to fill, and another one for the stream offsets, or None.
        """
        loop = self._loop
        self._take(room)
        for run in self._recording.runs():
            if run.gap:
                self._count_gap(run.lost)
                # The pending bytes came before the gap. Their packet will not be completed.
                yield from self._flush(room)
                loop.gap()
            loop.clock.arrivals.extend(run.ends + self.decoder.position, run.times)
            if len(self.head) < _HEAD_LEN:
                self.head += run.data[: _HEAD_LEN - len(self.head)]
            done, size = 0, len(run.data)
            while done < size:
                done += loop.feed(run.data[done:] if done else run.data, len(self._out))
                if loop.count == len(self._out):
                    yield self._hand_over()
                    self._take(room)
            if self._live and loop.count:
                yield self._hand_over()
                self._take(room)
        yield from self._flush(room)
        if loop.count:
            yield self._hand_over()
        self._release_arrays()

    def _flush(
        self, room: Callable[[], tuple[FrameArray, Offsets | None]]
    ) -> Iterator[tuple[FrameArray, int]]:
        """Decode the pending bytes to their end."""
        while self.decoder.pending:
            self._loop.flush(len(self._out))
            if self._loop.count == len(self._out):
                yield self._hand_over()
                self._take(room)

    def _take(self, room: Callable[[], tuple[FrameArray, Offsets | None]]) -> None:
        self._out, offsets = room()
        self._loop.use(self._out, offsets)

    def _hand_over(self) -> tuple[FrameArray, int]:
        self._loop.assign_times()
        return self._out, self._loop.count

    def _count_gap(self, lost: int) -> None:
        self.gap_count += 1
        self._bytes_lost += max(lost, 0)
        self._unknown += lost < 0
