"""The load of the bus over time."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from canser._frames import FrameArray, check_frames
from canser.analysis.load import load_of
from canser.plots._samples import Samples, draw_samples
from canser.plots._style import (
    NOTE_PT,
    Page,
    Style,
    column_count,
    dress,
    figure_of,
    new_axes,
    say,
    style_of,
)
from canser.plots._text import count_text, duration_text, joined, percent, plain
from canser.plots._timeline import Timeline

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["LoadOfTime", "bus_load", "draw_load"]

# A window with a higher load tells that the bit rate is wrong: see `canser stats`.
_LOAD_MOST: Final = 1.05

_Rows = npt.NDArray[np.void]
_Floats = npt.NDArray[np.float64]


def bus_load(
    frames: FrameArray,
    bitrate: int | None = None,
    *,
    window: str | int | None = None,
    ax: "Axes | None" = None,
    width: int = 1200,
    dark: bool = False,
) -> "Figure":
    """Draw the load of the bus over time.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,)
        The frames in the order in which they came, contiguous or not.
    bitrate : int, optional
        Bit rate of the bus in bit/s. Without it, the picture shows kbit/s.
    window : str or int, optional
        Length of a window, as for `canser.bus_load`. By default 100 ms, and longer for a capture of
        over 13 minutes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default there is a new figure.
    width : int, default 1200
        Width of a new figure in pixels.
    dark : bool, default False
        Whether the ground is dark.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, new or that of `ax`.

    Raises
    ------
    TypeError
        As for `canser.bus_load`.
    ValueError
        As for `canser.bus_load`, or `width` is not 400 to 20,000.
    ModuleNotFoundError
        matplotlib is not installed.

    Examples
    --------
    >>> from canser import plots
    >>> frames = canser.concat([canser.frames("123#0102030405060708")] * 1_000)
    >>> frames["ts"] = np.arange(1_000) * 1_000_000
    >>> plots.bus_load(frames, 500_000).axes[0].get_title(loc="left")
    'Bus load at 500 kbit/s in windows of 100 ms: mean 23.8 %, highest 23.8 %'
    """
    check_frames(frames, "frames")
    style, time = style_of(dark), Timeline(frames)
    load = LoadOfTime(frames, bitrate, window)
    texts = load.title, joined(load.note, time.note())
    ax = new_axes(ax, width, Page(2.4), texts, style)
    draw_load(ax, load, time, style)
    return figure_of(ax)


class LoadOfTime:
    """The windows of the load, and what is said of them."""

    def __init__(self, frames: FrameArray, bitrate: int | None, window: str | int | None) -> None:
        self.bitrate = bitrate
        self.chains = load_of(frames, bitrate, window).chains()
        self.title, notes = "Bus load: there is no frame with a time", []
        if self.chains:
            self.rows = np.concatenate(self.chains)
            self.title, *notes = _describe(self.rows, bitrate)
        self.note = joined(*notes)


def draw_load(
    ax: "Axes", load: LoadOfTime, time: Timeline, style: Style, *, label: bool = True
) -> None:
    """Draw the load on an axes; `label`: name the time axis."""
    bitrate = load.bitrate
    dress(ax, style, grid="y")
    time.draw(ax, style, label=label)
    ax.tick_params(axis="x", labelbottom=label)
    ax.set_ylabel(f"bus load, {'kbit/s' if bitrate is None else '%'}")
    if not load.chains:
        ax.set_yticks([])
        say(ax, "no frame has a time", style)
        return
    rows = load.rows
    values = rows["kbit_s"] if bitrate is None else 100 * rows["load"]
    highest = float(values.max())
    at, full, starts = _place(load.chains, time)
    # A window at a border of a hole was not measured as a whole: its load looks like a dip.
    drawn = np.flatnonzero(full if full.any() else np.ones(len(at), np.bool_))
    starts[drawn[1:][np.diff(drawn) > 1]] = True
    samples = Samples(at[drawn].mean(axis=1), values[drawn], np.flatnonzero(starts[drawn]))
    _draw_rows(ax, at[drawn], samples, time, style)
    is_near = bitrate is not None and highest > 60
    ax.set_ylim(0, 1.15 * max(highest, 100 if is_near else 0) or 1)
    if is_near:
        ax.axhline(100, color=style.text, linewidth=1, linestyle=":")
    _mark_errors(ax, at, rows, style)
    if bitrate is not None and highest > 100 * _LOAD_MOST:
        ax.annotate(
            f"x over 100 %: is the bit rate {plain(bitrate / 1e3, 4)} kbit/s right?",
            (1, 1),
            (-4, -2),
            xycoords="axes fraction",
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=NOTE_PT,
            fontweight="bold",
            color=style.wrong,
        )


def _place(
    chains: list[_Rows], time: Timeline
) -> tuple[_Floats, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Return where windows begin and end, which ones are full, and which follow on no other one."""
    edges, full, starts = [], [], []
    for chain, rows in enumerate(chains):
        begin = rows["start_ns"]
        end = begin + rows["window_ns"]
        edges.append(np.stack([time.place(chain, begin), time.place(chain, end)], axis=1))
        full.append(time.covers(chain, begin, end))
        starts.append(np.append(True, begin[1:] != end[:-1]))
    return np.concatenate(edges), np.concatenate(full), np.concatenate(starts)


def _draw_rows(ax: "Axes", at: _Floats, samples: Samples, time: Timeline, style: Style) -> None:
    """Draw windows as steps, or as ranges where there are more than an axes can show."""
    columns = column_count(ax)
    if len(at) > 2 * columns:
        draw_samples(ax, samples, columns, time.shown, style)
        return
    breaks = 2 * samples.starts[samples.starts > 0]
    x = np.insert(at.ravel(), breaks, np.nan)
    y = np.insert(np.repeat(samples.values, 2), breaks, np.nan)
    ax.fill_between(x, 0, y, color=style.pale, linewidth=0, alpha=0.6)
    ax.plot(x, y, color=style.ink, linewidth=1.2)


def _mark_errors(ax: "Axes", at: _Floats, rows: _Rows, style: Style) -> None:
    """Mark the windows with error frames, which have no bits."""
    where = np.flatnonzero(rows["errors"])
    if len(where):
        ax.plot(
            at[where].mean(axis=1),
            np.full(len(where), 0.97),
            transform=ax.get_xaxis_transform(),
            linestyle="",
            marker="x",
            markersize=5,
            color=style.wrong,
        )


def _describe(rows: _Rows, bitrate: int | None) -> Iterator[str]:
    """Yield the finding, and how it was found."""
    window = duration_text(int(rows["window_ns"][0]))
    kbit_s = 1e6 * float(rows["bits"].sum()) / float(rows["window_ns"].sum())
    if bitrate is None:
        yield (
            f"Bus load in windows of {window}: mean {plain(kbit_s)} kbit/s, "
            f"highest {plain(float(rows['kbit_s'].max()))} kbit/s"
        )
    else:
        yield (
            f"Bus load at {plain(bitrate / 1e3, 4)} kbit/s in windows of {window}: "
            f"mean {percent(1e3 * kbit_s / bitrate)}, highest {percent(rows['load'].max())}"
        )
    yield "exact bits of all frames, with stuff bits and pauses"
    errors = int(rows["errors"].sum())
    if errors:
        yield f"x: {count_text(errors, 'error frame')}, which have no length"
