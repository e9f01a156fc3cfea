"""Packets from frames, and control packets: an adapter's configuration and its reports."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canser._core._lib import ffi, lib
from canser._core.buffers import BytesLike, input_bytes, input_frames, output_bytes, raise_status
from canser._core.table import Protocol, packet_bytes, row_of, text
from canser._frames import FrameArray


class Config(NamedTuple):
    """How an adapter works on the bus: C's struct, field by field."""

    bitrate: int
    filter_id: int
    filter_mask: int
    mode: int  # index of MODE_NAMES
    ext_only: bool
    once: bool
    fixed: bool


class Explained(NamedTuple):
    """What a control packet says; a field that its kind does not have is zero."""

    kind: str
    receive_errors: int
    transmit_errors: int
    number: int
    config: Config


def encode_into(
    protocol: Protocol,
    tick_ns: int,
    frames: FrameArray,
    out: npt.NDArray[np.uint8],
    *,
    first: int = 0,
) -> int:
    """Encode all frames into `out`, and return the number of bytes written.

    `first` is the index of the first frame in error messages.
    """
    row, source, target = row_of(protocol), input_frames(frames), output_bytes(out)
    result = ffi.new("canser_encoded *")
    status = lib.canser_encode(row, tick_ns, source, len(frames), target, len(out), result)
    done = result.frame_count
    if status == lib.CANSER_REFUSED:
        frame = frames[done]
        why = text(lib.canser_refusal_text(result.refusal))
        raise ValueError(
            f"{protocol.name} cannot carry frame {first + done} (id {int(frame['id']):#x}, "
            f"ext {int(frame['ext'])}, dlc {frame['dlc']}): {why}"
        )
    if status:
        raise_status(status)
    if done < len(frames):
        raise ValueError(
            f"out has room for {len(out)} bytes, enough for {done} of {len(frames)} frames; "
            f"{len(frames) * protocol.frame_max} bytes are always enough"
        )
    return int(result.byte_count)


def refuse(protocol: Protocol, frames: FrameArray) -> npt.NDArray[np.uint8]:
    """Return each frame's reason for being refused: an index of REFUSAL_NAMES, 0 for none."""
    source = input_frames(frames)
    refusals = np.empty(len(frames), np.uint8)
    status = lib.canser_refuse(row_of(protocol), source, len(frames), output_bytes(refusals))
    if status:
        raise_status(status)
    return refusals


def configure(protocol: Protocol, config: Config) -> bytes:
    """Return the packet that configures an adapter; the values are checked already."""
    packet = ffi.new("canser_packet *")
    status = lib.canser_configure(
        row_of(protocol), ffi.new("canser_config *", config._asdict()), packet
    )
    if status:
        raise_status(status)
    return packet_bytes(packet)


def explain(protocol: Protocol, data: BytesLike) -> Explained | None:
    """Return what a control packet says; None for bytes that are not one."""
    source, report = input_bytes(data), ffi.new("canser_report *")
    status = lib.canser_explain(row_of(protocol), source, len(source), report)
    if status == lib.CANSER_NO_CONTROL:
        return None
    if status:
        raise_status(status)
    config = report.config
    return Explained(
        kind=text(lib.canser_control_name(report.kind)),
        receive_errors=report.receive_errors,
        transmit_errors=report.transmit_errors,
        number=report.number,
        config=Config(
            bitrate=config.bitrate,
            filter_id=config.filter_id,
            filter_mask=config.filter_mask,
            mode=config.mode,
            ext_only=bool(config.ext_only),
            once=bool(config.once),
            fixed=bool(config.fixed),
        ),
    )
