"""Periods and jitter: the range of the intervals of each id."""

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from canser._frames import FrameArray, check_frames
from canser.plots._raster import line_height, set_lines
from canser.plots._style import ROW_PT, Page, Style, dress, figure_of, new_axes, say, style_of
from canser.plots._table import IdTable
from canser.plots._text import count_text, duration_text, joined

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["FIGURES_IN", "describe", "draw_periods", "periods", "set_interval_ticks"]

# An id was silent if its longest interval is longer than this number of periods: see
# `canser.dropouts`.
_SILENT: Final = 5

# The inches of the figures at the right.
FIGURES_IN: Final = 1.75

# Intervals are drawn from here on, or from half a step of the times on: the scale is logarithmic,
# and some are 0.
_LEAST_MS: Final = 0.01


def periods(
    frames: FrameArray, *, ax: "Axes | None" = None, width: int = 1200, dark: bool = False
) -> "Figure":
    """Draw the intervals of each id: its period, how far they vary, and what is missing.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,)
        The frames in the order in which they came, contiguous or not.
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
        `frames` is no array of FRAME_DTYPE.
    ValueError
        The shape is not (n,), or `width` is not 400 to 20,000.
    ModuleNotFoundError
        matplotlib is not installed.

    Notes
    -----
    A thin line goes from the shortest interval to the longest one, a thick one from the 1st to the
    99th percentile, a tick is the median. A cross marks an id that was silent for over 5 of its
    periods. `canser.id_stats` tells what interval, period, jitter and missing frames are. The rows
    are those of `raster`.

    Examples
    --------
    >>> from canser import plots
    >>> frames = canser.concat([canser.frames("123#01", "124#")] * 20)
    >>> frames["ts"] = np.arange(40) * 5_000_000
    >>> plots.periods(frames).axes[0].get_title(loc="left")
    '2 of 2 ids are periodic; no frame is missing'
    """
    check_frames(frames, "frames")
    style, table = style_of(dark), IdTable(frames)
    page = Page(line_height(len(table)), table.label_width, right=FIGURES_IN)
    ax = new_axes(ax, width, page, describe(table), style)
    draw_periods(ax, table, style)
    return figure_of(ax)


def draw_periods(ax: "Axes", table: IdTable, style: Style, *, labels: bool = True) -> None:
    """Draw the intervals on an axes."""
    dress(ax, style, grid="x")
    set_lines(ax, table, style, labels=labels)
    ax.set_xlabel("interval between frames of an id")
    shown = table.stats[: table.shown]
    known = np.flatnonzero(~np.isnan(shown["interval_median_ns"]))
    if not len(known):
        ax.set_xticks([])
        say(ax, "no intervals", style)
        return
    least = max(_LEAST_MS, table.stats["time_step_ns"][0] / 2e6)
    ms = {
        name: np.maximum(values[known] / 1e6, least)
        for name, values in (
            ("least", shown["interval_min_ns"]),
            ("low", table.low_ns[: table.shown]),
            ("median", shown["interval_median_ns"]),
            ("high", shown["interval_p99_ns"]),
            ("most", shown["interval_max_ns"]),
        )
    }
    ax.set_xscale("log")
    ax.set_xlim(0.7 * ms["least"].min(), 1.4 * ms["most"].max())
    ax.hlines(known, ms["least"], ms["most"], color=style.ink, linewidth=1)
    ax.hlines(known, ms["low"], ms["high"], color=style.ink, linewidth=5)
    ax.plot(ms["median"], known, linestyle="", marker="|", ms=9, mew=2, color=style.text)
    silent = shown["interval_max_ns"][known] > _SILENT * shown["period_ns"][known]
    ax.plot(
        ms["most"][silent],
        known[silent],
        linestyle="",
        marker="x",
        markersize=6,
        markeredgewidth=1.6,
        color=style.wrong,
        zorder=4,
    )
    set_interval_ticks(ax)
    _write_figures(ax, table, style)


def set_interval_ticks(ax: "Axes") -> None:
    """Set ticks at 1, 2 and 5 of each power of ten; at the powers only if these are many."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator  # noqa: PLC0415

    least, most = ax.get_xlim()
    inches = ax.get_window_extent().width / figure_of(ax).dpi
    many = 3 * np.log10(most / least) > inches / 0.6
    ax.xaxis.set_major_locator(LogLocator(subs=(1,) if many else (1, 2, 5), numticks=99))
    ax.xaxis.set_minor_locator(NullLocator())

    def text(ms: float, _: Any) -> str:
        return duration_text(round(ms * 1e6, 3))

    ax.xaxis.set_major_formatter(FuncFormatter(text))


def _write_figures(ax: "Axes", table: IdTable, style: Style) -> None:
    """Write jitter and missing frames of each id at the right edge."""
    heads = f"{'jitter':>8} {'missing':>8}"
    transform = ax.get_yaxis_transform()
    options: dict[str, Any] = {
        "transform": transform,
        "family": "monospace",
        "fontsize": ROW_PT,
        "va": "center",
    }
    for number, row in enumerate(table.stats[: table.shown]):
        missing = row["missing"]
        jitter = (
            duration_text(row["jitter_ns"], even=True) if not np.isnan(row["jitter_ns"]) else ""
        )
        ax.text(1.0, number, f"{jitter:>9}", color=style.text, **options)
        if np.isnan(missing):
            continue
        is_wrong = missing > 0
        ax.text(
            1.0,
            number,
            f"{'':9} {missing:>7,.0f}" + (" x" if is_wrong else ""),
            color=style.wrong if is_wrong else style.faint,
            fontweight="bold" if is_wrong else "normal",
            **options,
        )
    ax.annotate(
        f"{heads}",
        (1.0, 1),
        (0, 3),
        xycoords="axes fraction",
        textcoords="offset points",
        va="bottom",
        family="monospace",
        fontsize=ROW_PT,
        color=style.faint,
    )


def describe(table: IdTable) -> tuple[str, str]:
    """Return the finding, and how it was found."""
    stats = table.stats
    if not len(stats):
        return "There are no frames", ""
    counts = {name: int((stats["pattern"] == name).sum()) for name in ("periodic", "bursts")}
    parts = [f"{counts['periodic']:,} of {count_text(len(stats), 'id is', 'ids are')} periodic"]
    if counts["bursts"]:
        parts[0] += f", {counts['bursts']:,} come in bursts"
    missing = float(np.nansum(stats["missing"]))
    if not np.isnan(stats["missing"]).all():
        parts.append(
            f"{count_text(round(missing), 'frame')} missing" if missing else "no frame is missing"
        )
    step = int(stats["time_step_ns"][0])
    note = "thin: shortest to longest interval; thick: 1 to 99 %; tick: median; x: over 5 periods"
    note += "; jitter: 1 to 99 % of the intervals near the period"
    if step:
        note += f", times in steps of {duration_text(step)}"
    return joined(*parts), joined(note, *(f"{text} not shown" for text, _ in table.folds))
