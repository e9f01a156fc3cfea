"""The texts that the command prints: summaries and tables, from numbers."""

from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Final

from canser.analysis.tally import Tally
from canser.codec.decoder import Control, Stats
from canser.files.fits import Fit
from canser.recording.recording import RecordingInfo
from canser.timing.restarts import Clock

__all__ = ["conservation", "fit_lines", "info_lines", "recording_lines", "reject_text"]


# Nanoseconds since 1970: a time this late is no device's counter.
_YEAR_2000: Final = 946_684_800 * 10**9


def conservation(stats: Stats) -> str:
    """Return the law of conservation with the numbers of a stream."""
    return (
        f"{stats.bytes_in:,} bytes = {stats.bytes_framed:,} framed + "
        f"{stats.bytes_control:,} control + {stats.bytes_skipped:,} skipped + "
        f"{stats.pending:,} pending"
    )


def reject_text(stats: Stats) -> str:
    """Return the skipped bytes by reason, most first."""
    reasons = sorted(stats.rejects.items(), key=lambda item: -item[1])
    return ", ".join(f"{name} {count:,}" for name, count in reasons if count)


def fit_lines(fits: list[Fit], size: int) -> Iterator[str]:
    """Yield the ranking of the protocols for a file of `size` bytes, with its evidence."""
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
    """Yield what a recording tells of its line."""
    yield f"recording  {info.protocol} from {info.device}, {info.baudrate:,} baud"
    if info.bitrate is not None:
        yield f"bus        {info.bitrate:,} bit/s"


def info_lines(tally: Tally, stats: Stats | None, controls: list[Control]) -> Iterator[str]:
    """Yield what there is to say of a file: its frames, its bytes, its ids."""
    span = tally.clock.span_ns
    per_second = f", {tally.count / span * 1e9:,.1f}/s" if span and span > 0 else ""
    yield f"frames     {tally.count:,}{per_second}"
    kinds = [
        f"{count:,} {name}"
        for name, count in (
            ("standard", tally.count - tally.extended),
            ("extended", tally.extended),
            ("remote", tally.remote),
            ("error", tally.errors),
        )
        if count
    ]
    if kinds:
        yield f"kinds      {', '.join(kinds)}"
    yield f"ids        {len(tally.ids):,}"
    yield f"time       {_time_text(tally.clock)}"
    dlc = ", ".join(f"{dlc}: {count:,}" for dlc, count in enumerate(tally.dlc) if count)
    yield f"dlc        {dlc or '-'}"
    if stats is not None:
        yield from _stats_lines(stats, controls)
    if tally.ids:
        yield ""
        yield from _id_lines(tally)


def _time_text(clock: Clock) -> str:
    if clock.span_ns is None or clock.first is None or clock.last is None:
        return "not known: there are no times in it"
    text = f"{clock.span_ns / 1e9:,.3f} s"
    if clock.restarts:
        text += f" without the jumps of the clock ({clock.restarts:,})"
    else:
        text += f", from {_seconds(clock.first)} to {_seconds(clock.last)}"
    return text + (f"; false times left out: {clock.false_times:,}" if clock.false_times else "")


def _seconds(ts: int) -> str:
    """Return a time in seconds, with its date where it can only be one."""
    text = f"{ts / 1e9:.3f}"
    if ts < _YEAR_2000:
        return text
    return f"{text} ({datetime.fromtimestamp(ts / 1e9, UTC):%Y-%m-%d %H:%M:%S} UTC)"


def _stats_lines(stats: Stats, controls: list[Control]) -> Iterator[str]:
    yield f"bytes      {conservation(stats)}"
    yield f"resyncs    {stats.resyncs:,}"
    if stats.bytes_skipped:
        yield f"skipped    {reject_text(stats)}"
    if stats.ts_wraps or stats.ts_backsteps:
        yield f"clock      wraps {stats.ts_wraps:,}, steps back {stats.ts_backsteps:,}"
    yield f"controls   {stats.controls:,}"
    for control in controls[:4]:
        yield f"           at {control.offset:,}: {control.data.hex(' ').upper()}"
    if len(controls) > 4:
        yield f"           and {stats.controls - 4:,} more"


def _id_lines(tally: Tally) -> Iterator[str]:
    span = tally.clock.span_ns
    yield "      id     frames   share     rate/s   period ms  dlc"
    # Most frequent first: what noise makes up stands at the end.
    most_first = sorted(tally.ids.items(), key=lambda item: (-item[1].count, item[0][::-1]))
    for (arbitration_id, ext), one in most_first:
        name = f"{arbitration_id:08X}" if ext else f"{arbitration_id:03X}"
        rate = f"{one.count / span * 1e9:10,.2f}" if span and span > 0 else f"{'-':>10}"
        period = one.period_ns
        every = f"{period / 1e6:11,.2f}" if period else f"{'-':>11}"
        dlc = str(one.dlc_least)
        if one.dlc_most > one.dlc_least:
            dlc += f"..{one.dlc_most}"
        if one.remote:
            dlc += "  remote" if one.remote == one.count else f"  {one.remote:,} remote"
        share = one.count / tally.count
        yield f"{name:>8} {one.count:10,} {share:7.2%} {rate} {every}  {dlc}"
