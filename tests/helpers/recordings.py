"""Recordings in memory: written, read, and cut into their blocks."""

import io
import os
import threading
from collections.abc import Iterable
from typing import BinaryIO, NamedTuple, cast

import numpy as np

import plain_pcapng
from canser.recording.header import RecordingInfo
from canser.recording.reader import Recording
from canser.recording.writer import RecordingWriter

INFO = RecordingInfo("seeed", 2_000_000, 500_000, "us", "/dev/ttyUSB0")
EPOCH = 1_700_000_000_123_456_789
MS = 1_000_000
BYTE = 5_000  # nanoseconds on the line of INFO

# A piece as it is written: bytes, arrival, bytes lost before it.
Written = tuple[bytes, int, int]
# A piece as it is read: bytes, arrival, lost, gap.
Got = tuple[bytes, int, int, bool]


def recorded(
    pieces: Iterable[Written],
    info: RecordingInfo = INFO,
    *,
    close: bool = True,
    each: bool = False,
) -> bytes:
    """Return the file of these pieces; with `each` every one of them is a block."""
    reader, writer = os.pipe()
    parts: list[bytes] = []
    thread = threading.Thread(
        target=lambda: parts.extend(iter(lambda: os.read(reader, 1 << 16), b""))
    )
    thread.start()
    with open(writer, "wb", buffering=0) as file:  # noqa: PTH123
        target = RecordingWriter(cast(BinaryIO, file), info)
        for piece in pieces:
            target.write(*piece)
            if each:
                target.sync()
        if close:
            target.close()
        else:
            target.sync()
    thread.join()
    os.close(reader)
    return b"".join(parts)


def listed(raw: bytes) -> tuple[list[Got], list[str]]:
    """Return the pieces of a file, and what is remarked."""
    with Recording(cast(BinaryIO, io.BytesIO(raw))) as got:
        pieces = [(bytes(data), ts, lost, gap) for data, ts, lost, gap in got]
        return pieces, got.remarks


def spread(count: int, seed: int = 1) -> list[Written]:
    """Return pieces that are each a block: a second apart, of 1 to 39 bytes."""
    rng = np.random.default_rng(seed)
    return [
        (rng.bytes(int(rng.integers(1, 40))), EPOCH + second * 1000 * MS, 0)
        for second in range(count)
    ]


def packets(raw: bytes) -> list[plain_pcapng.Block]:
    return [block for block in plain_pcapng.read(raw) if block.kind == plain_pcapng.PACKET]


class Line(NamedTuple):
    """A recording, block by block, and what the blocks tell."""

    header: bytes
    blocks: list[bytes]
    told: list[Written]
    end: bytes


def line(told: list[Written]) -> Line:
    """Return a recording in which each of these is a block."""
    raw = recorded(told, each=True)
    _, interface, *_ = whole = plain_pcapng.read(raw)
    cut = [raw[block.offset : block.end] for block in packets(raw)]
    assert len(cut) == len(told)
    return Line(raw[: interface.end], cut, told, raw[whole[-1].offset :])
