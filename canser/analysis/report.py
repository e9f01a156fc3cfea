"""Format what is known of a stream of frames as text: lines and tables."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
import numpy.typing as npt

from canser._frames import YEAR_2000_NS
from canser.analysis.names import id_digits
from canser.codec.decoder import Control, Stats
from canser.files.fits import Fit
from canser.recording.header import RecordingInfo

__all__ = [
    "conservation",
    "fit_lines",
    "id_lines",
    "recording_lines",
    "reject_text",
    "stats_lines",
    "time_text",
]


def conservation(stats: Stats) -> str:
    """Return the sum of all bytes of a stream: every byte is counted exactly once."""
    return (
        f"{stats.bytes_in:,} bytes = {stats.bytes_framed:,} framed + "
        f"{stats.bytes_control:,} control + {stats.bytes_skipped:,} skipped + "
        f"{stats.pending:,} pending"
    )


def reject_text(stats: Stats) -> str:
    """Return the skipped bytes by reason, the most frequent reason first."""
    reasons = sorted(stats.rejects.items(), key=lambda item: -item[1])
    return ", ".join(f"{name} {count:,}" for name, count in reasons if count)


def fit_lines(fits: Sequence[Fit], size: int) -> Iterator[str]:
    """Yield the ranking of the protocols for a file of `size` bytes, with the evidence."""
    yield "protocol    score  explained  by chance   frames  resyncs"
    for fit in fits:
        yield (
            f"{fit.protocol:10} {fit.score:6.1%} {fit.explained:10.1%} {fit.chance:10.1%} "
            f"{fit.stats.frames:8,} {fit.stats.resyncs:8,}"
        )
    sample = fits[0].stats.bytes_in
    if sample < size:
        yield f"counted in a sample of {sample:,} of {size:,} bytes"


def recording_lines(info: RecordingInfo) -> Iterator[str]:
    """Yield the description of a recording's line."""
    yield f"recording  {info.protocol} from {info.device}, {info.baudrate:,} baud"
    if info.bitrate is not None:
        yield f"bus        {info.bitrate:,} bit/s"


def time_text(
    first_ns: int | None, last_ns: int | None, span_ns: int | None, restarts: int, false_times: int
) -> str:
    """Return the duration of a stream, and its first and last time."""
    if first_ns is None or last_ns is None or span_ns is None:
        return "not known: there are no times in it"
    text = f"{span_ns / 1e9:,.3f} s"
    if restarts:
        text += f" without the jumps of the clock ({restarts:,})"
    else:
        text += f", from {_seconds(first_ns)} to {_seconds(last_ns)}"
    return text + (f"; false times left out: {false_times:,}" if false_times else "")


def _seconds(ts: int) -> str:
    """Return a time in seconds; from the year 2000 on, with its date."""
    text = f"{ts / 1e9:.3f}"
    if ts < YEAR_2000_NS:
        return text
    return f"{text} ({datetime.fromtimestamp(ts / 1e9, UTC):%Y-%m-%d %H:%M:%S} UTC)"


def stats_lines(stats: Stats, controls: Sequence[Control]) -> Iterator[str]:
    """Yield the counters of a decoder, and the first control packets."""
    yield f"bytes      {conservation(stats)}"
    yield f"resyncs    {stats.resyncs:,}"
    if stats.bytes_skipped:
        yield f"skipped    {reject_text(stats)}"
    if stats.ts_wraps or stats.ts_backsteps:
        text = f"clock      wraps {stats.ts_wraps:,}, steps back {stats.ts_backsteps:,}"
        yield text + (f", of these uncertain {stats.ts_uncertain:,}" if stats.ts_uncertain else "")
    yield f"controls   {stats.controls:,}"
    for control in controls[:4]:
        yield f"           at {control.offset:,}: {control.data.hex(' ').upper()}"
    if len(controls) > 4:
        yield f"           and {stats.controls - 4:,} more"


def id_lines(ids: npt.NDArray[np.void]) -> Iterator[str]:
    """Yield the table of ids, rows of `FileInfo.ids`."""
    yield "      id     frames   share     rate/s   period ms  dlc"
    for values in ids.tolist():
        row: dict[str, Any] = dict(zip(ids.dtype.names or (), values, strict=True))
        name = id_digits(row["id"], long=row["ext"] or row["err"])
        # NaN, for a number that is not known, is not equal to itself.
        rate = f"{row['rate']:10,.2f}" if row["rate"] == row["rate"] else f"{'-':>10}"
        period = (
            f"{row['period_ns'] / 1e6:11,.2f}"
            if row["period_ns"] == row["period_ns"]
            else f"{'-':>11}"
        )
        dlc = str(row["dlc_least"])
        if row["dlc_most"] > row["dlc_least"]:
            dlc += f"..{row['dlc_most']}"
        if row["err"]:
            dlc += "  error"
        if row["remote"]:
            remote = row["remote"]
            dlc += "  remote" if remote == row["count"] else f"  {remote:,} remote"
        yield f"{name:>8} {row['count']:10,} {row['share']:7.2%} {rate} {period}  {dlc}"
