"""Statistics of a file as text and as values of JSON: what `canser stats` prints."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np

from canser._core.text import NO_CHANNEL
from canser.analysis.ids import IdStatsArray
from canser.analysis.names import id_text
from canser.analysis.plain import to_plain

__all__ = ["stats_as_dict", "stats_lines"]

_HEAD: Final = (
    "          id  pattern     frames    period ms    jitter ms   longest ms  missing    changes"
)


def stats_lines(
    rows: IdStatsArray, channel_names: Mapping[int, str] | None = None
) -> Iterator[str]:
    """Yield the table of ids as text; the channels are named if there are several."""
    yield f"ids        {len(rows):,}"
    if not len(rows):
        return
    step = int(rows["time_step_ns"][0])
    yield f"times      in steps of {_ms(step)} ms" if step else "times      none differ"
    yield ""
    yield _HEAD
    several = len(np.unique(rows["channel"])) > 1
    for row in rows:
        channel = _channel(int(row["channel"]), channel_names or {}) if several else ""
        pattern = str(row["pattern"])
        if pattern == "bursts":
            pattern = f"{row['burst']:.3g} a burst"
        yield (
            f"{channel + id_text(row):>12}  {pattern:10} {row['count']:10,} "
            f"{_ms(row['period_ns']):>12} {_ms(row['jitter_ns']):>12} "
            f"{_ms(row['interval_max_ns']):>12} {_count(row['missing']):>8} {row['changes']:10,}"
        )


def stats_as_dict(rows: IdStatsArray, *, exact: bool) -> dict[str, Any]:
    """Return all as values that JSON has."""
    return {"exact": exact, "ids": to_plain(rows)}


def _channel(channel: int, names: Mapping[int, str]) -> str:
    if channel == NO_CHANNEL:
        return ""
    return f"{names.get(channel, channel)} "


def _ms(value: float) -> str:
    """Return nanoseconds as milliseconds, "-" for NaN."""
    return "-" if value != value else f"{value / 1e6:,.3f}"  # noqa: PLR0124 - NaN


def _count(value: float) -> str:
    return "-" if value != value else f"{value:,.0f}"  # noqa: PLR0124
