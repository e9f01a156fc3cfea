"""Signals as ASAM MDF 4, by asammdf: a group of channels for each group of signals."""

from collections.abc import Iterable
from typing import Any, BinaryIO

import numpy as np

from canser._dates import are_dates
from canser._frames import NO_TIME
from canser.errors import FormatError
from canser.files.mf4 import (
    COMPRESSION,
    OFFSET_VALID,
    load_asammdf,
    seconds_from,
    seekable_target,
)
from canser.signals.signal import Signal
from canser.signals.signals import Group, Resampled

__all__ = ["write"]


def write(file: BinaryIO, groups: Iterable[Group | Resampled], name: str) -> None:
    """Write groups of signals. Texts of value tables are those of the raw values.

    The start of the file is the first time, or 1970 where times are no dates. FormatError names the
    file if asammdf is not installed, or if a sample has no time.
    """
    asammdf = load_asammdf(name)
    filled = [group for group in groups if len(group.ts)]
    times = [group.ts.view(np.int64) for group in filled]
    unknown = sum(int((each == NO_TIME).sum()) for each in times)
    if unknown:
        raise FormatError(
            f"{name}: {unknown:,} samples have no time, which MF4 cannot hold; write .csv"
        )
    first = min((int(each.min()) for each in times), default=0)
    start_ns = first if times and are_dates(times[0]) else 0
    mdf = asammdf.MDF(version="4.10")
    header = mdf.header
    header.abs_time, header.time_flags = start_ns, OFFSET_VALID
    header.tz_offset = header.daylight_save_time = 0
    with mdf, seekable_target(file) as made:
        for group, ts in zip(filled, times, strict=True):
            seconds = seconds_from(ts, start_ns)
            title = group.name if isinstance(group, Group) else "one time base"
            signals = [_channel(asammdf, each, seconds) for each in group.values()]
            mdf.append(signals, acq_name=title, comment=title, common_timebase=True)
        mdf.save(made, compression=COMPRESSION)


def _channel(asammdf: Any, signal: Signal, seconds: Any) -> Any:
    """Return a signal of asammdf: raw values with their texts, or physical values."""
    conversion: dict[str, float | bytes] | None = None
    samples = signal.values
    if signal.choices and signal.raw is not None:
        samples = signal.raw
        conversion = {"default": b""}
        for number, (raw, text) in enumerate(signal.choices.items()):
            conversion[f"val_{number}"] = raw
            conversion[f"text_{number}"] = text.encode()
    return asammdf.Signal(
        samples=samples,
        timestamps=seconds,
        name=signal.full_name,
        unit=signal.unit,
        conversion=conversion,
        invalidation_bits=None if signal.valid is None else ~signal.valid,
    )
