"""From a file of frames or raw bytes to another: decode, encode, or change the format."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

from canser._core.table import find_protocol
from canser._frames import NO_TIME, FrameArray, copy_records
from canser._protocols import TS_UNITS
from canser.codec.decoder import encode_blocks
from canser.codec.refusals import Refusals
from canser.errors import FormatError
from canser.files.formats import BY_SUFFIX
from canser.files.frame_file import RAW, FrameFile

__all__ = ["Converted", "convert"]

# A device's counter has this many ticks.
_TICKS = 1 << 32


@dataclass(slots=True)
class Converted:
    """What a conversion did: counts, and what the target could not hold."""

    frames: int = 0
    bytes_out: int = 0
    remarks: list[str] = field(default_factory=list)


def convert(
    source: FrameFile,
    target: BinaryIO,
    target_format: str,
    *,
    protocol: str | None = None,
    ts_unit: str = "ms",
    strict: bool = False,
) -> Converted:
    """Write all frames of `source` to `target` in one of the FORMATS.

    Raw bytes need the `protocol`. Where its clock cannot count up to the first
    frame's time, such as a date, times go out from the first frame on, and a remark
    says so. Frames that the protocol cannot carry are left out, and a remark counts them;
    with `strict` they are a ValueError. FormatError if it can carry none. Raises what reading,
    encoding and writing raise.
    """
    if target_format == RAW:
        assert protocol is not None
        return _encode(source, target, protocol, ts_unit, strict=strict)
    done = Converted()
    writer = BY_SUFFIX[f".{target_format}"].Writer(target)
    for frames in source:
        writer.write(frames)
        done.frames += len(frames)
    done.remarks += writer.finish()
    return done


def _encode(
    source: FrameFile, target: BinaryIO, protocol: str, ts_unit: str, *, strict: bool
) -> Converted:
    done = Converted()
    clocked = find_protocol(protocol).has_clock
    refusals = Refusals(protocol)
    blocks = source if strict else filter(len, map(refusals.keep, source))
    for raw in encode_blocks(
        _counted(blocks, done, ts_unit if clocked else None), protocol, ts_unit=ts_unit
    ):
        target.write(raw.data)
        done.bytes_out += len(raw)
    if refusals.left_out and not done.frames:
        raise FormatError(
            f"{source.name}: {protocol} can carry none of the {refusals.frames:,} frames: "
            f"{refusals.reasons}; convert to another protocol"
        )
    if refusals.left_out:
        done.remarks.append(str(refusals))
    if not clocked and done.frames:
        done.remarks.append(f"{protocol} carries no times")
    return done


def _counted(
    blocks: Iterable[FrameArray], done: Converted, ts_unit: str | None
) -> Iterator[FrameArray]:
    """Yield the frames, counted, in times that the clock can count if there is one."""
    start = 0
    for frames in blocks:
        if ts_unit is not None and not done.frames:
            first = int(frames["ts"][0])
            if first != NO_TIME and not 0 <= first // TS_UNITS[ts_unit] < _TICKS:
                start = first
                done.remarks.append("times go out from the first frame on")
        done.frames += len(frames)
        if start:
            shifted = copy_records(frames)
            shifted["ts"][frames["ts"] != NO_TIME] -= start
            yield shifted
        else:
            yield frames
