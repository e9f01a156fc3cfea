"""Frames by id: who takes which part of the bus."""

from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from canser._frames import FrameArray, check_frames
from canser.plots._raster import line_height, set_lines
from canser.plots._style import ROW_PT, Page, Style, dress, figure_of, new_axes, say, style_of
from canser.plots._table import IdTable
from canser.plots._text import count_text, joined, percent
from canser.plots._timeline import Timeline

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["ids"]

# The inches of the figures at the right.
_FIGURES_IN: Final = 2.3


def ids(
    frames: FrameArray, *, ax: "Axes | None" = None, width: int = 1200, dark: bool = False
) -> "Figure":
    """Draw how many frames each id has, with its share of the bits on the bus.

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
    The rate is the number of frames in a second with frames: holes of the bus do not count. The
    rows are those of `raster`.

    Examples
    --------
    >>> from canser import plots
    >>> frames = canser.frames("123#01", "123#02", "124#")
    >>> plots.ids(frames).axes[0].get_title(loc="left")
    '3 frames of 2 ids; 123 has most of the bits: 70.6 %'
    """
    check_frames(frames, "frames")
    style, table = style_of(dark), IdTable(frames)
    page = Page(line_height(len(table)), table.label_width, right=_FIGURES_IN)
    ax = new_axes(ax, width, page, _describe(table), style)
    dress(ax, style, grid="x")
    set_lines(ax, table, style)
    ax.set_xlabel("frames")
    counts = table.sums(table.stats["count"])
    if not len(counts):
        ax.set_xticks([])
        say(ax, "no frames", style)
        return figure_of(ax)
    # A row for many ids has its figures only: a bar would make those of the ids short.
    own = counts[: table.shown]
    ax.barh(range(len(own)), own, height=0.7, color=style.ink)
    ax.set_xlim(0, 1.02 * own.max())
    from matplotlib.ticker import MaxNLocator, StrMethodFormatter  # noqa: PLC0415

    ax.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    ax.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    _write_figures(ax, table, counts, Timeline(frames).running, style)
    return figure_of(ax)


def _write_figures(
    ax: "Axes", table: IdTable, counts: npt.NDArray[np.int64], running: float, style: Style
) -> None:
    """Write the frames, the rate and the share of the bits at the right edge."""
    options: dict[str, Any] = {"family": "monospace", "fontsize": ROW_PT}
    bits = table.sums(table.bits)
    every = bits.sum()
    for number, count in enumerate(counts.tolist()):
        rate = f"{count / running:,.2f}" if running else ""
        share = percent(bits[number] / every) if every else ""
        ax.text(
            1,
            number,
            f"{count:>11,} {rate:>9} {share:>8}",
            transform=ax.get_yaxis_transform(),
            va="center",
            color=style.text,
            **options,
        )
    ax.annotate(
        f"{'frames':>11} {'a second':>9} {'of bits':>8}",
        (1, 1),
        (0, 3),
        xycoords="axes fraction",
        textcoords="offset points",
        va="bottom",
        color=style.faint,
        **options,
    )


def _describe(table: IdTable) -> tuple[str, str]:
    """Return the finding, and how it was found."""
    if not len(table.stats):
        return "There are no frames", ""
    frames = count_text(int(table.stats["count"].sum()), "frame")
    title = f"{frames} of {count_text(len(table.stats), 'id')}"
    if table.bits.any():
        first = int(table.bits[: table.shown].argmax())
        share = percent(table.bits[first] / table.bits.sum())
        title += f"; {table.names[first]} has most of the bits: {share}"
    note = joined(
        "ids by pattern, period and number", *(f"{text} in one row" for text, _ in table.folds)
    )
    return title, note
