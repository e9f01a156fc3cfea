"""The look of all pictures: colours, sizes, titles, and the only way to matplotlib.

Colours are those of Okabe and Ito, which all readers can tell apart. One ink draws what was
measured. `wrong` is for what is wrong only, and always has a second sign: a cross, hatching, text.
"""

import io
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from canser._checks import flag, whole
from canser.plots._text import wrapped

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "DARK",
    "LIGHT",
    "Page",
    "Style",
    "check_matplotlib",
    "colour_bar",
    "column_count",
    "count_colours",
    "dress",
    "figure_of",
    "new_axes",
    "new_figure",
    "new_pages",
    "page_width",
    "put_title",
    "say",
    "style_of",
]


@dataclass(frozen=True)
class Style:
    """The colours of a picture.

    `counts`: the map of colours for counts, and the part of it that is told from the ground.
    """

    ground: str
    text: str
    faint: str
    grid: str
    still: str
    quiet: str
    ink: str
    pale: str
    wrong: str
    counts: tuple[str, float, float]


LIGHT: Final = Style(
    ground="#FFFFFF",
    text="#1A1A1A",
    faint="#5F5F5F",
    grid="#E4E4E4",
    still="#D2D2D2",
    quiet="#F4F4F4",
    ink="#0072B2",
    pale="#A9CFE6",
    wrong="#D55E00",
    counts=("viridis_r", 0.18, 1.0),
)
DARK: Final = Style(
    ground="#15181B",
    text="#EDEDED",
    faint="#A6A6A6",
    grid="#2E3338",
    still="#474E55",
    quiet="#202529",
    ink="#56B4E9",
    pale="#275A78",
    wrong="#E69F00",
    counts=("viridis", 0.35, 1.0),
)

# Points. A page of 12 inches that is printed on 11 has letters of 7 points at least.
TITLE_PT: Final = 11
NOTE_PT: Final = 8.5
LABEL_PT: Final = 9
ROW_PT: Final = 8

# The widest page in inches; a wider picture has more pixels an inch. The narrowest has as many
# letters in a line as a title needs.
_WIDEST_IN: Final = 12.0
_PIXELS_IN: Final = 100
_WIDTH_LEAST, _WIDTH_MOST = 400, 20_000

# The most columns in which frames are counted: an axis that is wider shows no more.
_COLUMNS_LEAST, _COLUMNS_MOST = 50, 4_000


def style_of(dark: bool) -> Style:
    """Return the style."""
    return DARK if flag(dark, "dark") else LIGHT


class Page(NamedTuple):
    """The size of a new picture: the inches of the axes, and of what is around them."""

    height: float
    left: float = 0.75
    right: float = 0.25
    bottom: float = 0.6
    #: Inches at the right of the axes where its texts may go on.
    free: float = 0.0


def new_figure(width: int, height: float, style: Style) -> "Figure":
    """Return an empty figure of a width in pixels and a height in inches. pyplot knows nothing."""
    check_matplotlib()
    from matplotlib.figure import Figure  # noqa: PLC0415 - an optional extra

    inches = page_width(width)
    figure = Figure(figsize=(inches, height), dpi=width / inches, facecolor=style.ground)
    # So a notebook shows it; otherwise it does that only where pyplot was imported.
    figure._repr_png_ = partial(_as_png, figure)  # type: ignore[attr-defined]
    return figure


def _as_png(figure: "Figure") -> bytes:
    image = io.BytesIO()
    figure.savefig(image, format="png")
    return image.getvalue()


def check_matplotlib() -> None:
    """Raise ModuleNotFoundError with the remedy if matplotlib is not installed."""
    try:
        import matplotlib  # noqa: F401, ICN001, PLC0415 - an optional extra
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            "pictures need matplotlib, which is not installed: pip install 'canser[plot]'",
            name="matplotlib",
        ) from None


def page_width(width: int) -> float:
    """Return the inches of a picture of a width in pixels; ValueError if it is out of range."""
    if not _WIDTH_LEAST <= whole(width, "width", "1200") <= _WIDTH_MOST:
        raise ValueError(f"width is {width}; give {_WIDTH_LEAST} to {_WIDTH_MOST:,} pixels")
    return min(width / _PIXELS_IN, _WIDEST_IN)


def new_axes(
    ax: "Axes | None", width: int, page: Page, texts: tuple[str, str], style: Style
) -> "Axes":
    """Return an axes with its texts: a new one on a page of its own, or the one that is given.

    `texts`: the finding, which is the title, and under it how it was found.
    """
    if ax is not None:
        put_title(ax, *texts, style)
        return ax
    across = page_width(width) - page.left - page.right
    title, note = _wrap(*texts, across + page.free)
    height = page.height + page.bottom + _title_height(title, note)
    figure = new_figure(width, height, style)
    whole_width = page_width(width)
    made = figure.add_axes(
        (
            page.left / whole_width,
            page.bottom / height,
            across / whole_width,
            page.height / height,
        )
    )
    _write_title(made, title, note, style)
    return made


def new_pages(
    width: int, pages: list[Page], texts: list[tuple[str, str]], note: str, style: Style
) -> list["Axes"]:
    """Return axes one below the other, and a note above all of them.

    Below the first ones there is no room for the name of an axis, unless the next one has another
    width.
    """
    across = page_width(width)
    inches = [across - page.left - page.right for page in pages]
    wrapped_texts = [
        _wrap(*text, each + page.free)
        for text, each, page in zip(texts, inches, pages, strict=True)
    ]
    note = _wrap("", note, inches[0])[1]
    below = [
        page.bottom if page is pages[-1] or page.right != after.right else 0.0
        for page, after in zip(pages, [*pages[1:], pages[-1]], strict=True)
    ]
    heads = [_title_height(*text) for text in wrapped_texts]
    top = (_height(note, NOTE_PT) + 8) / 72
    height = top + sum(heads) + sum(below) + sum(page.height for page in pages)
    figure = new_figure(width, height, style)
    axes, down = [], height - top
    for page, each, head, under, text in zip(
        pages, inches, heads, below, wrapped_texts, strict=True
    ):
        down -= head + page.height
        box = page.left / across, down / height, each / across, page.height / height
        axes.append(figure.add_axes(box))
        _write_title(axes[-1], *text, style)
        down -= under
    figure.text(
        pages[0].left / across,
        1 - 6 / 72 / height,
        note,
        va="top",
        fontsize=NOTE_PT,
        color=style.faint,
        linespacing=1.1,
    )
    return axes


def figure_of(ax: "Axes") -> "Figure":
    """Return the whole figure that an axes is in."""
    # Of a subfigure too: `get_figure(root=True)` is matplotlib's from 3.10 on.
    return ax.figure.figure


def put_title(
    ax: "Axes", title: str, note: str, style: Style, *, more: float = 0, lift: float = 0
) -> None:
    """Put the title and the note above an axes.

    `more`: inches at its right that are free. `lift`: points to leave free above the axes.
    """
    inches = more + ax.get_window_extent().width / figure_of(ax).dpi
    _write_title(ax, *_wrap(title, note, inches), style, lift)


def _wrap(title: str, note: str, inches: float) -> tuple[str, str]:
    """Return a title and a note in lines that are no longer than these inches."""
    return (
        wrapped(title, int(inches * 72 / (TITLE_PT * 0.6))),
        wrapped(note, int(inches * 72 / (NOTE_PT * 0.55))),
    )


def _title_height(title: str, note: str) -> float:
    """Return the inches that a wrapped title and a wrapped note need."""
    return (_height(note, NOTE_PT) + _height(title, TITLE_PT) + 20) / 72


def _height(text: str, size: float) -> float:
    return 1.25 * size * (text.count("\n") + 1) if text else 0


def _write_title(ax: "Axes", title: str, note: str, style: Style, lift: float = 0) -> None:
    options: dict[str, Any] = {
        "xycoords": "axes fraction",
        "textcoords": "offset points",
        "va": "bottom",
        "annotation_clip": False,
        "linespacing": 1.1,
    }
    ax.set_title(
        title,
        loc="left",
        fontsize=TITLE_PT,
        fontweight="bold",
        color=style.text,
        pad=8 + lift + _height(note, NOTE_PT),
        linespacing=1.1,
    )
    ax.annotate(note, (0, 1), (0, 6 + lift), fontsize=NOTE_PT, color=style.faint, **options)


def dress(ax: "Axes", style: Style, *, grid: str = "") -> None:
    """Give an axes its colours and sizes; `grid`: the axis whose ticks have lines, x, y or both."""
    ax.set_facecolor(style.ground)
    for side, spine in ax.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(style.faint)
    ax.tick_params(colors=style.text, labelsize=LABEL_PT, which="both")
    for axis in (ax.xaxis, ax.yaxis):
        axis.label.set_color(style.text)
        axis.label.set_fontsize(LABEL_PT)
    ax.set_axisbelow(True)
    if grid:
        ax.grid(axis=grid, color=style.grid, linewidth=0.8)  # type: ignore[arg-type]


def say(ax: "Axes", text: str, style: Style) -> None:
    """Say in the middle of an axes why it is empty."""
    ax.text(
        0.5,
        0.5,
        text,
        transform=ax.transAxes,
        ha="center",
        va="center",
        color=style.faint,
        fontsize=TITLE_PT,
    )


def column_count(ax: "Axes") -> int:
    """Return the number of pixels along the time axis."""
    return int(np.clip(ax.get_window_extent().width, _COLUMNS_LEAST, _COLUMNS_MOST))


def count_colours(style: Style, low: float, high: float) -> tuple[Any, Any]:
    """Return the map of colours for counts, and the logarithmic scale from `low` to `high`."""
    from matplotlib import colormaps  # noqa: PLC0415
    from matplotlib.colors import ListedColormap, LogNorm  # noqa: PLC0415

    name, first, last = style.counts
    colours = ListedColormap(colormaps[name](np.linspace(first, last, 256)))
    return colours, LogNorm(low, max(high, low * 1.0001))


def colour_bar(
    ax: "Axes", image: Any, label: str, style: Style, *, ticks: Any, away: float = 0
) -> None:
    """Draw the scale of the colours at the right of an axes.

    `ticks`: makes a text of a value. `away`: inches between the axes and the scale.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator  # noqa: PLC0415

    inches = ax.get_window_extent().width / figure_of(ax).dpi
    beside = ax.inset_axes((1 + (0.1 + away) / inches, 0, 0.14 / inches, 1))
    bar = ax.figure.colorbar(image, cax=beside)
    bar.set_label(label, color=style.text, fontsize=NOTE_PT)
    beside.tick_params(colors=style.text, labelsize=NOTE_PT)
    bar.outline.set_visible(False)
    few = image.norm.vmax / image.norm.vmin < 100
    beside.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if few else (1,)))
    beside.yaxis.set_minor_locator(NullLocator())
    beside.yaxis.set_major_formatter(FuncFormatter(lambda value, _: ticks(value)))
