"""Captures that python-can reads, and the messages they must give."""

from pathlib import Path
from typing import Any

import can

import canser
from canser._frames import NO_TIME, FrameArray
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter
from canser.simulation.traffic import vehicle
from reference import WIRE_FORMATS
from samples import EPOCH

MS = 1_000_000


def traffic(protocol: str) -> FrameArray:
    return vehicle(2, extended=WIRE_FORMATS[protocol].has_ext)


def raw(path: Path, protocol: str) -> Path:
    path.write_bytes(canser.encode(traffic(protocol), protocol))
    return path


def recording(path: Path, protocol: str) -> Path:
    """Write a recording whose bytes came 20 ms after the other, some of a frame at a time."""
    bytes_ = canser.encode(traffic(protocol), protocol)
    with RecordingWriter(path, RecordingInfo(protocol, 2_000_000, None, "ms", "x")) as writer:
        for turn, at in enumerate(range(0, len(bytes_), 401)):
            writer.write(bytes_[at : at + 401], EPOCH + turn * 20 * MS)
    return path


def assert_equal(messages: list[Any], frames: FrameArray) -> None:
    """Assert that the messages are these frames, their times too."""
    assert len(messages) == len(frames)
    for message, frame in zip(messages, frames, strict=True):
        data = b"" if frame["rtr"] else frame["data"][: frame["dlc"]].tobytes()
        want = can.Message(
            timestamp=0.0 if frame["ts"] == NO_TIME else int(frame["ts"]) / 1e9,
            arbitration_id=int(frame["id"]),
            is_extended_id=bool(frame["ext"]),
            is_remote_frame=bool(frame["rtr"]),
            is_error_frame=bool(frame["err"]),
            dlc=int(frame["dlc"]),
            data=data,
        )
        assert message.equals(want, timestamp_delta=0)
