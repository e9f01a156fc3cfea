"""Frames to test with: any that are valid, and arrays of those that a test spells out."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from canser._frames import FRAME_DTYPE, FrameArray
from canser.analysis.summary import FileInfo, summarise
from canser.codec.decoder import Decoder
from canser.errors import FormatError
from reference import DLC_MAX, ID_EXT_MAX, ID_MAX, NO_TIME, Frame, pack, unpack

MICROSECOND = 1_000
MILLISECOND = 1_000_000
SECOND = 1_000_000_000

EPOCH = 1_544_106_679_432_583_000
"""A time of day: 6 December 2018, with microseconds."""


def array(*frames: Frame) -> FrameArray:
    """Return frames as an array."""
    return np.frombuffer(pack(frames), FRAME_DTYPE)


def listed(frames: FrameArray | Iterable[FrameArray]) -> list[Frame]:
    """Return an array, or one block after the other, as a list that shows what differs."""
    if isinstance(frames, np.ndarray):
        return unpack(frames.tobytes())
    return [frame for block in frames for frame in listed(block)]


def timed(*ts: int) -> FrameArray:
    """Return frames of one id at these times."""
    return array(*(Frame(0x100, ts=time) for time in ts))


def info_of(*blocks: FrameArray, decoder: Decoder | None = None) -> FileInfo:
    """Return what `canser.info` tells of frames, with the counters of their decoder."""
    found = summarise(blocks)
    if decoder is None:
        return found
    controls = tuple(decoder.take_controls())
    return replace(found, protocol=decoder.protocol, stats=decoder.stats, controls=controls)


def frames_or_error(read: Callable[[bytes], list[Frame]], raw: bytes) -> list[Frame]:
    """Return what is read, nothing where it is a FormatError: of one line, as any message."""
    try:
        return read(raw)
    except FormatError as error:
        message = str(error)
    assert "\n" not in message
    return []


@st.composite
def _frame(draw: st.DrawFn) -> Frame:
    ext, rtr, err = draw(st.booleans()), draw(st.booleans()), draw(st.booleans())
    dlc = draw(st.integers(0, DLC_MAX))
    return Frame(
        draw(st.integers(0, ID_EXT_MAX if ext else ID_MAX)),
        ext,
        rtr,
        dlc,
        err,
        (b"" if rtr else draw(st.binary(min_size=dlc, max_size=dlc))).ljust(8, b"\0"),
        draw(_TIME),
    )


# Whole microseconds and milliseconds by themselves would be drawn next to never.
_TIME = st.one_of(
    st.just(NO_TIME),
    st.integers(NO_TIME + 1, 2**63 - 1),
    st.integers(-(10**6), 10**6),
    st.integers(-(10**6), 10**6).map(lambda ticks: ticks * MILLISECOND),
    st.integers(0, 10**15).map(lambda ticks: ticks * MICROSECOND),
)

FRAMES = st.lists(_frame(), max_size=20)
"""Any frames that a record can hold."""
