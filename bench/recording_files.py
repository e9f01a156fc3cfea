"""Recordings to read: as adapters make them, in small blocks, and as a busy line does."""

from pathlib import Path

import numpy as np

import canser
import data
from canser._frames import FrameArray
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter

BAUDRATE = 2_000_000
BYTE_NS = 10_000_000_000 // BAUDRATE
EPOCH = 1_790_000_000_000_000_000

# What an adapter hands on each millisecond or few, in bytes; and what a reader takes at once from
# a line that is busy all the time. The writer puts these together, to blocks of 250 ms.
SMALL, LARGE = 93, 1 << 16


def busy(count: int, protocol: str) -> tuple[FrameArray, bytes]:
    """Return frames that fill a line of 2,000,000 baud, and their bytes."""
    frames = data.mixed(count, protocol)
    begins = np.empty(count, np.int64)
    canser.decode(canser.encode(frames, protocol), protocol, offsets=begins)
    frames["ts"] = begins * BYTE_NS // 1_000_000 * 1_000_000
    return frames, canser.encode(frames, protocol)


def record(path: Path, protocol: str, raw: bytes, piece: int) -> None:
    """Write the bytes of such a line as a recording, `piece` bytes at a time."""
    info = RecordingInfo(protocol, BAUDRATE, None, "ms", "bench")
    view = memoryview(raw)
    # Small pieces stay apart, as those of a bus that is not busy do.
    error_ns = -1 if piece == SMALL else 2_000_000
    with (
        path.open("wb", buffering=0) as file,
        RecordingWriter(file, info, syncs=False, time_error_ns=error_ns) as writer,
    ):
        for begin in range(0, len(raw), piece):
            part = view[begin : begin + piece]
            writer.write(part, EPOCH + (begin + len(part)) * BYTE_NS)
