"""The raster: a row for each id, time from left to right, colour for the number of frames."""

from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from canser._frames import FrameArray, check_frames
from canser.plots._style import (
    ROW_PT,
    Page,
    Style,
    colour_bar,
    column_count,
    count_colours,
    dress,
    figure_of,
    new_axes,
    say,
    style_of,
)
from canser.plots._table import IdTable
from canser.plots._text import count_text, duration_text, joined, plain
from canser.plots._timeline import Timeline

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_raster", "line_height", "raster", "set_lines"]


# Frames that are counted together: what is made of them stays in the cache.
_PART: Final = 1 << 17


def raster(
    frames: FrameArray, *, ax: "Axes | None" = None, width: int = 1200, dark: bool = False
) -> "Figure":
    """Draw which ids came when: a row for each id, darker where more frames are.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,)
        The frames in the order in which they came, contiguous or not.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default there is a new figure.
    width : int, default 1200
        Width of a new figure in pixels.
    dark : bool, default False
        Whether the ground is dark: then more frames are brighter.

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
    Ids are sorted by their pattern, their period, and their number; `canser.id_stats` tells what
    pattern and period are. Ids of less than 10 frames share the last row. Of more than 60 ids, the
    60 with the most bits have rows, and the others share one.

    Examples
    --------
    >>> from canser import plots
    >>> frames = canser.concat([canser.frames("123#01", "124#")] * 20)
    >>> frames["ts"] = np.arange(40) * 5_000_000
    >>> plots.raster(frames).axes[0].get_title(loc="left")
    '40 frames of 2 ids in 195 ms'
    """
    check_frames(frames, "frames")
    style, time, table = style_of(dark), Timeline(frames), IdTable(frames)
    page = Page(line_height(len(table)), table.label_width, right=0.95, free=0.7)
    ax = new_axes(ax, width, page, describe(table, time), style)
    draw_raster(ax, time, table, style)
    return figure_of(ax)


def describe(table: IdTable, time: Timeline) -> tuple[str, str]:
    """Return the finding, and how it was found."""
    if not time.count:
        return "There are no frames", time.note()
    frames, ids = count_text(time.count, "frame"), count_text(len(table.stats), "id")
    folds = (f"{text} in one row" for text, _ in table.folds)
    note = joined("ids by pattern, period and number", *folds, time.note())
    span = "" if time.is_numbered else f" in {duration_text(1e9 * time.elapsed)}"
    return f"{frames} of {ids}{span}", note


def line_height(lines: int) -> float:
    """Return the height in inches that lines with a text each need."""
    return 0.155 * max(lines, 4)


def draw_raster(ax: "Axes", time: Timeline, table: IdTable, style: Style) -> None:
    """Draw the raster on an axes."""
    dress(ax, style)
    time.draw(ax, style)
    set_lines(ax, table, style)
    if not time.count:
        say(ax, "no frames", style)
        return
    columns = column_count(ax)
    counts = count_frames(table.line_of_frames(), time.columns(columns), len(table), columns)
    # A row for many ids may have more: otherwise all others would be pale.
    most = counts[: table.shown or None].max()
    colours, scale = count_colours(style, 1, int(most))
    image = ax.imshow(
        np.ma.masked_equal(counts, 0),
        extent=(0, time.shown, len(table) - 0.5, -0.5),
        aspect="auto",
        interpolation="nearest",
        cmap=colours,
        norm=scale,
        zorder=2.6,  # over the line at the left, which would hide a frame
    )
    width = time.length_text(time.shown / columns)
    colour_bar(ax, image, f"frames in {width}", style, ticks=plain)


def count_frames(
    lines: npt.NDArray[np.int32], columns: npt.NDArray[np.int32], height: int, width: int
) -> npt.NDArray[np.int64]:
    """Return how many frames lie in each line and column, shape (height, width)."""
    # Frames without a column are counted in one more at the left.
    counts = np.zeros(height * (width + 1), np.int64)
    for first in range(0, len(lines), _PART):
        part = slice(first, first + _PART)
        cells = lines[part] * np.int32(width + 1)
        cells += columns[part]
        cells += 1
        counts += np.bincount(cells, minlength=len(counts))
    return counts.reshape(height, width + 1)[:, 1:]


def set_lines(ax: "Axes", table: IdTable, style: Style, *, labels: bool = True) -> None:
    """Give an axes a line for each id, the first one on top."""
    count = len(table)
    ax.set_ylim(max(count, 1) - 0.5, -0.5)
    ax.set_yticks(range(count), table.labels if labels else [""] * count)
    ax.tick_params(axis="y", length=0, labelsize=ROW_PT, labelfontfamily="monospace")
    for number in range(table.shown, count):
        ax.axhline(number - 0.5, color=style.faint, linewidth=0.6)
