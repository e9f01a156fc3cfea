"""One page for a capture: the load, which ids came when, and their periods."""

from typing import TYPE_CHECKING, Final

from canser._frames import FrameArray, check_frames
from canser.plots._load import LoadOfTime, draw_load
from canser.plots._periods import FIGURES_IN, draw_periods
from canser.plots._periods import describe as describe_periods
from canser.plots._raster import describe as describe_raster
from canser.plots._raster import draw_raster, line_height
from canser.plots._style import ROW_PT, Page, figure_of, new_pages, page_width, put_title, style_of
from canser.plots._table import IdTable
from canser.plots._timeline import Timeline

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["overview"]

# From this width on, the periods stand beside the raster, in the same rows; otherwise below it.
_WIDE_IN: Final = 10.0

# Inches: the height of the load, the left border, and the scale of the colours.
_LOAD_IN: Final = 1.5
_LEFT_IN: Final = 0.75
_BAR_IN: Final = 0.95

# The share of the width that the periods take beside the raster.
_PERIODS_SHARE: Final = 0.36


def overview(
    frames: FrameArray,
    bitrate: int | None = None,
    *,
    window: str | int | None = None,
    width: int = 1200,
    dark: bool = False,
) -> "Figure":
    """Draw a capture on one page: the load of the bus, which ids came when, and their periods.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,)
        The frames in the order in which they came, contiguous or not.
    bitrate : int, optional
        Bit rate of the bus in bit/s. Without it, the load is in kbit/s.
    window : str or int, optional
        Length of a window of the load, as for `canser.bus_load`.
    width : int, default 1200
        Width of the figure in pixels.
    dark : bool, default False
        Whether the ground is dark.

    Returns
    -------
    matplotlib.figure.Figure
        A new figure.

    Raises
    ------
    TypeError
        As for `canser.bus_load`.
    ValueError
        As for `canser.bus_load`, or `width` is not 400 to 20,000.
    ModuleNotFoundError
        matplotlib is not installed.

    See Also
    --------
    bus_load, raster, periods : The three pictures.

    Examples
    --------
    >>> from canser import plots
    >>> frames = canser.concat([canser.frames("123#01", "124#")] * 20)
    >>> frames["ts"] = np.arange(40) * 5_000_000
    >>> figure = plots.overview(frames, 500_000)
    >>> figure.savefig("overview.png")
    """
    check_frames(frames, "frames")
    style, time, table = style_of(dark), Timeline(frames), IdTable(frames)
    load = LoadOfTime(frames, bitrate, window)
    height, left = line_height(len(table)), max(table.label_width, _LEFT_IN)
    texts = [(load.title, load.note), describe_raster(table, time), describe_periods(table)]
    across = page_width(width)
    is_wide = across >= _WIDE_IN
    beside = (across - left - _BAR_IN - FIGURES_IN) * _PERIODS_SHARE
    right = _BAR_IN + (beside + FIGURES_IN if is_wide else 0)
    pages = [Page(_LOAD_IN, left, right, free=right - _LEFT_IN / 2), Page(height, left, right)]
    if not is_wide:
        pages.append(Page(height, left, FIGURES_IN))
    axes = new_pages(width, pages, texts[: len(pages)], "", style)
    if is_wide:
        box = axes[1].get_position()
        place = (box.x1 + _BAR_IN / across, box.y0, beside / across, box.height)
        axes.append(figure_of(axes[0]).add_axes(place))
        put_title(axes[2], *texts[2], style, more=FIGURES_IN, lift=ROW_PT + 3)
    draw_load(axes[0], load, time, style, label=False)
    draw_raster(axes[1], time, table, style)
    draw_periods(axes[2], table, style, labels=not is_wide)
    return figure_of(axes[0])
