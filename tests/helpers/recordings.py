"""Recordings in memory: written, read, and cut into their blocks."""

import io
import os
import threading
from collections.abc import Iterable
from typing import BinaryIO, NamedTuple, cast

import hypothesis.strategies as st
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


def line(told: list[Written], *, aged: bool = False) -> Line:
    """Return a recording in which each of these is a block; `aged`: before blocks had ids."""
    raw = recorded(told, each=True)
    if aged:
        raw = plain_pcapng.without_ids(raw)
    _, interface, *_ = whole = plain_pcapng.read(raw)
    cut = [raw[block.offset : block.end] for block in packets(raw)]
    assert len(cut) == len(told)
    return Line(raw[: interface.end], cut, told, raw[whole[-1].offset :])


@st.composite
def damaged_files(draw: st.DrawFn) -> bytes:
    """Return files as crashes, copies and bad sectors leave them."""
    raw = b""
    for _ in range(draw(st.integers(1, 3))):
        raw += draw(one_file())
    for _ in range(draw(st.integers(0, 2))):
        hurt = bytearray(raw)
        at = draw(st.integers(0, len(raw) - 1))
        hurt[at] ^= 1 << draw(st.integers(0, 7))
        raw = bytes(hurt)
    return raw[: len(raw) - draw(st.sampled_from([0, 0, 0, 1, 40, 300]))]


@st.composite
def one_file(draw: st.DrawFn) -> bytes:
    """Return a recording, some blocks of which are missing, there twice, or not its own."""
    told: list[Written] = []
    for number in range(draw(st.integers(1, 12))):
        lost = draw(st.sampled_from([0, 0, 0, 1, 500, -1]))
        data = draw(st.binary(min_size=0 if lost else 1, max_size=30))
        told.append((data, EPOCH + number * 1000 * MS, lost))
    mine = line(told, aged=draw(st.sampled_from([False, False, True])))
    older = line(spread(3, seed=5))
    blocks = list(mine.blocks)
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, len(blocks)))
        strange = [older.header, draw(st.sampled_from([b"", bytes(12), b"\0" * 32]))]
        other = draw(st.sampled_from([*blocks, *older.blocks, *strange]))
        blocks[at : at + draw(st.integers(0, 2))] = [other]
    return b"".join([mine.header, *blocks, mine.end])
