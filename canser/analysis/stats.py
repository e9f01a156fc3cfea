"""Statistics of a file as text and as values of JSON: what `canser stats` prints."""

from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canser._core.text import NO_CHANNEL
from canser.analysis.ids import IdStatsArray
from canser.analysis.names import id_text
from canser.analysis.plain import to_plain

__all__ = ["FileStats"]

_HEAD: Final = (
    "          id  pattern     frames    period ms    jitter ms   longest ms  missing    changes"
)

# A window with a higher load than this tells that the bit rate is wrong. Times of arrivals can
# bring a load of a little over 1 into a window, and so can the bits of a frame that begins in it.
_LOAD_MOST: Final = 1.05


class FileStats(NamedTuple):
    """Statistics of the frames of a file."""

    #: Rows of `canser.id_stats`.
    ids: IdStatsArray
    #: Rows of `canser.bus_load`.
    loads: npt.NDArray[np.void]
    #: Bit rate of the bus in bit/s, or None.
    bitrate: int | None
    #: Whether the figures of the ids are exact.
    exact: bool

    def lines(self, channel_names: Mapping[int, str]) -> Iterator[str]:
        """Yield the text line by line; channels are named if there are several."""
        ids, loads = self.ids, self.loads
        yield f"ids        {len(ids):,}"
        if not len(ids):
            return
        step = int(ids["time_step_ns"][0])
        if step:
            yield f"times      in steps of {_ms(step)} ms"
        if len(loads):
            yield f"bus load   {self._load()}"
        yield ""
        yield _HEAD
        several = len(np.unique(ids["channel"])) > 1
        for row in ids:
            channel = _channel(int(row["channel"]), channel_names) if several else ""
            yield f"{channel + id_text(row):>12}  {_figures(row)}"

    def _load(self) -> str:
        """Return the mean and the highest load, with the window that they are counted in."""
        window = f"in {self.loads['window_ns'][0] / 1e6:g} ms"
        if self.bitrate is None:
            mean = 1e6 * self.loads["bits"].sum() / self.loads["window_ns"].sum()
            return f"{mean:,.1f} kbit/s, at most {self.loads['kbit_s'].max():,.1f} {window}"
        mean = self.loads["load"].mean()
        most = self.loads["load"].max()
        return f"{mean:.1%} of {self.bitrate:,} bit/s, at most {most:.1%} {window}"

    def remarks(self) -> Iterator[str]:
        """Yield what may be wrong."""
        if self.bitrate is None or not len(self.loads):
            return
        channels = len(np.unique(self.ids["channel"]))
        if channels > 1:
            yield f"the bus load is that of {channels} channels together; choose one with --bus"
        most = self.loads["load"].max()
        if most > _LOAD_MOST and channels == 1:
            yield f"the bus load is up to {most:.0%}: the bit rate {self.bitrate:,} may be wrong"

    def as_dict(self) -> dict[str, Any]:
        """Return all as values that JSON has."""
        plain: dict[str, Any] = to_plain(self)
        return plain


def _figures(row: np.void) -> str:
    pattern = str(row["pattern"])
    if pattern == "bursts":
        pattern = f"{row['burst']:.3g} a burst"
    return (
        f"{pattern:10} {row['count']:10,} {_ms(row['period_ns']):>12} {_ms(row['jitter_ns']):>12} "
        f"{_ms(row['interval_max_ns']):>12} {_count(row['missing']):>8} {row['changes']:10,}"
    )


def _ms(value: float) -> str:
    """Return nanoseconds as milliseconds, "-" for NaN."""
    return "-" if np.isnan(value) else f"{value / 1e6:,.3f}"


def _count(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:,.0f}"


def _channel(channel: int, names: Mapping[int, str]) -> str:
    if channel == NO_CHANNEL:
        return ""
    return f"{names.get(channel, channel)} "
