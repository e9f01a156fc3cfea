"""The payload of one id: which bits move, and when."""

import re
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from canser._checks import text as check_text
from canser._frames import FrameArray, check_frames, match
from canser.plots._style import (
    NOTE_PT,
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
from canser.plots._text import count_text, joined, plain
from canser.plots._timeline import Timeline

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["count_flips", "payload"]

_Ints = npt.NDArray[np.int64]

# An id as text: three digits of a standard id, or fewer, eight of an extended one.
_ID: Final = re.compile(r"(0[xX])?([0-9a-fA-F]{1,3}|[0-9a-fA-F]{8})")

# Each byte with its bits in eight bytes of their own, so that up to 255 of them can be added up in
# one go.
_LANES: Final = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1).view(np.uint64)[:, 0]
_ADDED_MOST: Final = 255

# Frames that are counted together: what is made of them stays in the cache.
_PART: Final = 1 << 16

# The inches of a row, and of the sums at the right.
_ROW_IN: Final = 0.105
_SUM_IN: Final = 0.9


def payload(
    frames: FrameArray,
    id: str,  # noqa: A002 - as users call it
    *,
    ax: "Axes | None" = None,
    width: int = 1200,
    dark: bool = False,
) -> "Figure":
    """Draw which bits of an id move: a row for each bit, darker where it flips more often.

    Parameters
    ----------
    frames : array of FRAME_DTYPE, shape (n,)
        The frames in the order in which they came, contiguous or not: all of a capture.
    id : str
        The id in hexadecimal: one to three digits of a standard id ("123"), eight of an extended
        one ("18FEF100").
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default there is a new figure.
    width : int, default 1200
        Width of a new figure in pixels.
    dark : bool, default False
        Whether the ground is dark: then more flips are brighter.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, new or that of `ax`.

    Raises
    ------
    TypeError
        `frames` is no array of FRAME_DTYPE, or `id` is no text.
    ValueError
        The shape is not (n,), `id` is no id, or `width` is not 400 to 20,000.
    ModuleNotFoundError
        matplotlib is not installed.

    Notes
    -----
    A bit flips in a frame if it differs from the same bit of the frame before. The most significant
    bit of each byte is on top. Bits that never move are grey. Remote frames have no data, and are
    left out. Bytes that no frame has are not shown.

    Examples
    --------
    >>> from canser import plots
    >>> frames = canser.frames("123#01FF", "123#02FF", "123#03FF", "124#")
    >>> frames["ts"] = np.arange(4) * 10_000_000
    >>> plots.payload(frames, "123").axes[0].get_title(loc="left")
    'Id 123: 2 of 16 bits move in 3 frames'
    """
    check_frames(frames, "frames")
    if not _ID.fullmatch(check_text(id, "id", '"123"')):
        raise ValueError(
            f"{id!r} is no id; write one to three hexadecimal digits for a standard id, eight for "
            "an extended one"
        )
    style, time = style_of(dark), Timeline(frames)
    chosen = match(frames, id) & ~frames["rtr"] & time.is_timed()
    own = frames.compress(chosen)
    flips, byte_count = _flips(own), int(own["dlc"].max(initial=0))
    # The axes is not there yet: its title has the number of bits that move.
    moving = (
        np.bitwise_or.reduce(flips.view(np.uint64)).reshape(1).view(np.uint8)
        if len(own)
        else np.zeros(8, np.uint8)
    )
    bit_count = int(np.unpackbits(moving).sum())
    title = (
        f"Id {id.upper().removeprefix('0X')}: {bit_count} of {8 * byte_count} bits "
        f"move in {count_text(len(own), 'frame')}"
    )
    note = joined(
        "grey: never moves; byte and bit at the left, the highest bit on top", time.note()
    )
    page = Page(_ROW_IN * max(8 * byte_count, 8), 0.75, right=0.95 + _SUM_IN, free=1.5)
    ax = new_axes(ax, width, page, (title, note), style)
    dress(ax, style)
    time.draw(ax, style)
    if not len(own) or not byte_count:
        ax.set_yticks([])
        say(ax, f"no data frame of {id}" if not len(own) else "no data", style)
        return figure_of(ax)
    # Of frames that come slower than a pixel is wide, each column has two.
    columns = min(column_count(ax), max(len(own) // 2, 1))
    counts, by_column = count_flips(flips, time.columns(columns)[chosen], columns)
    _draw_bits(ax, by_column[:, :byte_count].reshape(columns, -1).T, counts, time, style)
    sums = by_column[:, :byte_count].sum(axis=0).ravel()
    _draw_sums(ax, sums / max(len(own) - 1, 1), style)
    return figure_of(ax)


def _flips(frames: FrameArray) -> npt.NDArray[np.uint8]:
    """Return the bits of each frame that differ from the frame before, shape (n, 8)."""
    data = np.ascontiguousarray(frames["data"])
    flips = np.zeros_like(data)
    np.bitwise_xor(data[1:], data[:-1], out=flips[1:])
    return flips


def count_flips(
    flips: npt.NDArray[np.uint8], columns: npt.NDArray[np.int32], count: int
) -> tuple[_Ints, _Ints]:
    """Return the frames of each column, and how often each bit flips in it.

    Shapes (count,) and (count, 8, 8): bytes, and their bits, the highest one first.
    """
    if (columns[1:] < columns[:-1]).any():
        order = np.argsort(columns, kind="stable")
        columns, flips = columns[order], flips[order]
    counts = np.bincount(columns, minlength=count)
    sums = np.zeros((count, 8, 8), np.int64)
    for first in range(0, len(flips), _PART):
        part = columns[first : first + _PART]
        starts = np.flatnonzero(np.append(True, part[1:] != part[:-1]))
        sums[part[starts]] += _add_up(flips[first : first + _PART], starts)
    return counts, sums


def _add_up(flips: npt.NDArray[np.uint8], starts: _Ints) -> _Ints:
    """Return how often each bit flips in the parts that begin at `starts`, shape (m, 8, 8)."""
    pieces = np.union1d(starts, np.arange(0, len(flips), _ADDED_MOST))
    sums = np.empty((len(starts), 8, 8), np.int64)
    for byte in range(8):
        lanes = np.add.reduceat(_LANES[flips[:, byte]], pieces)
        bits = lanes.view(np.uint8).reshape(-1, 8)
        sums[:, byte] = np.add.reduceat(bits, np.searchsorted(pieces, starts), dtype=np.int64)
    return sums


def _draw_bits(ax: "Axes", flips: _Ints, counts: _Ints, time: Timeline, style: Style) -> None:
    """Draw the bits; `flips`: shape (rows, columns). Columns without frames stay empty."""
    from matplotlib.colors import ListedColormap  # noqa: PLC0415

    rows = len(flips)
    options: dict[str, Any] = {
        "extent": (0, time.shown, rows - 0.5, -0.5),
        "aspect": "auto",
        "interpolation": "nearest",
    }
    moves = np.repeat((flips.sum(axis=1) > 0)[:, None], len(counts), axis=1)
    ground = np.ma.array(moves, mask=np.repeat((counts == 0)[None], rows, axis=0))
    quiet = ListedColormap([style.still, style.quiet])
    ax.imshow(ground, cmap=quiet, vmin=0, vmax=1, zorder=1, **options)
    rates = np.ma.masked_equal(flips / np.maximum(counts, 1), 0)
    colours, scale = count_colours(style, float(rates.min() if rates.count() else 1), 1)
    image = ax.imshow(rates, cmap=colours, norm=scale, zorder=2, **options)
    if rates.count():
        colour_bar(ax, image, "flips a frame", style, ticks=plain, away=_SUM_IN)
    for border in range(8, rows, 8):
        ax.axhline(border - 0.5, color=style.text, linewidth=0.8, zorder=3)
    places = [row for row in range(rows) if row % 8 in (0, 4)]
    ax.set_yticks(places, [f"{row // 8}.{7 - row % 8}" for row in places])
    ax.tick_params(axis="y", length=0, labelsize=NOTE_PT, labelfontfamily="monospace")
    ax.set_ylabel("byte.bit")


def _draw_sums(ax: "Axes", rates: npt.NDArray[np.float64], style: Style) -> None:
    """Draw the flips a frame of each bit over all at the right."""
    inches = ax.get_window_extent().width / figure_of(ax).dpi
    beside = ax.inset_axes((1 + 0.08 / inches, 0, (_SUM_IN - 0.2) / inches, 1))
    dress(beside, style, grid="x")
    beside.set_ylim(ax.get_ylim())
    beside.set_yticks([])
    beside.set_xscale("log")
    some = np.flatnonzero(rates)
    least = min(0.01, float(rates[some].min(initial=1)) / 2)
    beside.set_xlim(least, 1)
    beside.barh(some, rates[some] - least, left=least, height=0.8, color=style.ink)
    beside.set_xlabel("flips a frame", fontsize=NOTE_PT)
    from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator  # noqa: PLC0415

    low = 10.0 ** np.ceil(np.log10(least))
    beside.xaxis.set_major_locator(FixedLocator([low, 1]))
    beside.xaxis.set_minor_locator(NullLocator())
    beside.xaxis.set_major_formatter(FixedFormatter([plain(low), "1"]))
    beside.tick_params(labelsize=NOTE_PT)
