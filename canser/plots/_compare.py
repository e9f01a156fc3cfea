"""Two captures side by side: which ids, periods and bits differ."""

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canser._frames import FrameArray, check_frames
from canser.analysis.compare import Comparison, compare_stats
from canser.analysis.ids import IdStats, IdStatsArray
from canser.analysis.names import id_text
from canser.plots._periods import set_interval_ticks
from canser.plots._raster import line_height
from canser.plots._style import (
    NOTE_PT,
    ROW_PT,
    Page,
    Style,
    dress,
    figure_of,
    new_axes,
    say,
    style_of,
)
from canser.plots._table import LINES_MOST, sort_key
from canser.plots._text import count_text, joined

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["compare"]

# The share of the page that the bits take.
_BITS_SHARE: Final = 0.5

# The most ids of less than 10 frames that have a line.
_FEW_MOST: Final = 10

# What a bit is: never moves, moves in both, in A only, in B only.
_STILL, _BOTH, _IN_A, _IN_B = range(4)


class _Line(NamedTuple):
    """An id of either capture."""

    name: str
    row: np.void
    in_a: bool
    in_b: bool
    period_a: float
    period_b: float
    bits: npt.NDArray[np.int64]
    retimed: bool
    differs: bool


def compare(
    a: FrameArray,
    b: FrameArray,
    *,
    names: tuple[str, str] = ("A", "B"),
    ax: "Axes | None" = None,
    width: int = 1200,
    dark: bool = False,
) -> "Figure":
    """Draw what differs between two captures: ids, periods, and bits that move.

    Parameters
    ----------
    a, b : array of FRAME_DTYPE, shape (n,)
        The frames of each capture in the order in which they came, contiguous or not.
    names : pair of str, default ("A", "B")
        What the captures are called in the picture.
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
        `a` or `b` is no array of FRAME_DTYPE.
    ValueError
        A shape is not (n,), or `width` is not 400 to 20,000.
    ModuleNotFoundError
        matplotlib is not installed.

    Notes
    -----
    At the left are the periods, at the right the bits of the payload. Of more than 60 ids those
    that differ come first; more than 10 ids of less than 10 frames have no rows. The title counts
    all. `canser.compare` gives the same as arrays.

    Examples
    --------
    >>> from canser import plots
    >>> a, b = canser.frames("123#00", "124#"), canser.frames("123#00", "123#04")
    >>> plots.compare(a, b).axes[0].get_title(loc="left")
    '1 id in both, 1 in A only, 0 in B only; 1 bit moves in one only; 0 periods differ'
    """
    check_frames(a, "a")
    check_frames(b, "b")
    style = style_of(dark)
    rows = _stats(a), _stats(b)
    found = compare_stats(*rows)
    lines = _lines(*rows, found)
    shown = _choose(lines)
    hidden = len(lines) - len(shown)
    note = joined(
        f"circle: {names[0]}; diamond: {names[1]}; x: differs",
        "bits 0.7 to 7.0 of bytes 0 to 7: grey never moves, pale moves in both",
        f"{count_text(hidden, 'more id')} not shown" if hidden else "",
    )
    left = 0.16 + ROW_PT / 72 * 0.61 * max((len(line.name) for line in shown), default=8)
    page = Page(line_height(len(shown)), left)
    ax = new_axes(ax, width, page, (_title(found, names), note), style)
    ax.set_axis_off()
    periods = ax.inset_axes((0, 0, 0.98 - _BITS_SHARE, 1))
    bits = ax.inset_axes((1 - _BITS_SHARE, 0, _BITS_SHARE, 1))
    for each in (periods, bits):
        dress(each, style)
        each.set_ylim(max(len(shown), 1) - 0.5, -0.5)
        each.set_yticks([])
        each.tick_params(axis="y", length=0, labelsize=ROW_PT, labelfontfamily="monospace")
    periods.set_yticks(range(len(shown)), [line.name for line in shown])
    if not shown:
        for each in (periods, bits):
            each.set_xticks([])
            say(each, "no frames", style)
        return figure_of(ax)
    _draw_periods(periods, shown, names, style)
    _draw_bits(bits, shown, names, style)
    return figure_of(ax)


def _stats(frames: FrameArray) -> IdStatsArray:
    stats = IdStats()
    stats.add(frames)
    return stats.rows()


def _lines(a: IdStatsArray, b: IdStatsArray, found: Comparison) -> list[_Line]:
    """Return the ids of both, in the order of all pictures."""
    rows_a, rows_b = ({id_text(row): row for row in rows} for rows in (a, b))
    retimed = {id_text(row) for row in found.retimed}
    moving = {id_text(row) for row in found.bits}
    names = [id_text(row) for row in found.ids]
    rows = np.array([rows_a.get(name, rows_b.get(name)) for name in names], a.dtype)
    lines = []
    for place in sort_key(rows):
        name = names[place]
        of_a, of_b = rows_a.get(name), rows_b.get(name)
        lines.append(
            _Line(
                name,
                rows[place],
                of_a is not None,
                of_b is not None,
                np.nan if of_a is None else float(of_a["period_ns"]),
                np.nan if of_b is None else float(of_b["period_ns"]),
                _bits(of_a, of_b),
                name in retimed,
                of_a is None or of_b is None or name in retimed or name in moving,
            )
        )
    return lines


def _bits(a: np.void | None, b: np.void | None) -> npt.NDArray[np.int64]:
    """Return what each bit is, from the highest one of byte 0 on."""
    of_a, of_b = (
        np.zeros(64, np.int64) if row is None else np.unpackbits(row["moving"]).astype(np.int64)
        for row in (a, b)
    )
    if a is None or b is None:
        return np.where(of_a | of_b, _IN_B if a is None else _IN_A, _STILL)
    return np.select([of_a & of_b == 1, of_a == 1, of_b == 1], [_BOTH, _IN_A, _IN_B], _STILL)


def _choose(lines: list[_Line]) -> list[_Line]:
    """Return the ids that have a line: those that differ before the others.

    Ids with few frames have one only if there are few of them: noise makes many.
    """
    few = [line for line in lines if line.row["pattern"] == "few"]
    if len(lines) > len(few) > _FEW_MOST:
        lines = [line for line in lines if line.row["pattern"] != "few"]
    ranked = sorted(range(len(lines)), key=lambda place: not lines[place].differs)
    return [lines[place] for place in sorted(ranked[:LINES_MOST])]


def _title(found: Comparison, names: tuple[str, str]) -> str:
    of_a, of_b = len(found.only_a), len(found.only_b)
    both, bits, retimed = len(found.ids) - of_a - of_b, len(found.bits), len(found.retimed)
    return (
        f"{count_text(both, 'id')} in both, {of_a:,} in {names[0]} only, {of_b:,} in {names[1]} "
        f"only; {count_text(bits, 'bit moves', 'bits move')} in one only; "
        f"{count_text(retimed, 'period differs', 'periods differ')}"
    )


def _draw_periods(ax: "Axes", lines: list[_Line], names: tuple[str, str], style: Style) -> None:
    periods = np.array([(line.period_a, line.period_b) for line in lines]) / 1e6
    places = np.arange(len(lines))
    options: dict[str, Any] = {"linestyle": "", "zorder": 3}
    ax.set_xlabel("period")
    if np.isnan(periods).all():
        ax.set_xticks([])
        _name_lone(ax, lines, names, style)
        return
    ax.set_xscale("log")
    ax.grid(axis="x", color=style.grid, linewidth=0.8)
    ax.set_xlim(0.6 * np.nanmin(periods), 1.8 * np.nanmax(periods))
    set_interval_ticks(ax)
    ax.hlines(places, *periods.T, color=style.faint, linewidth=1.5)
    ax.plot(periods[:, 0], places, marker="o", ms=7, color=style.ink, **options)
    ax.plot(periods[:, 1], places, marker="D", ms=3.5, color=style.text, **options)
    _name_lone(ax, lines, names, style)
    wrong = [number for number, line in enumerate(lines) if line.retimed]
    ax.plot(
        np.full(len(wrong), 0.985),
        places[wrong],
        transform=ax.get_yaxis_transform(),
        marker="x",
        ms=6,
        mew=1.6,
        color=style.wrong,
        **options,
    )


def _name_lone(ax: "Axes", lines: list[_Line], names: tuple[str, str], style: Style) -> None:
    """Write beside its period that an id is in one capture only."""
    least, most = ax.get_xlim()
    for number, line in enumerate(lines):
        if line.in_a and line.in_b:
            continue
        only = names[0] if line.in_a else names[1]
        period = np.fmax(line.period_a, line.period_b) / 1e6
        is_left = not period > np.sqrt(least * most)
        ax.annotate(
            f"x only in {only}: {count_text(int(line.row['count']), 'frame')}",
            (0.01 if np.isnan(period) else period, number),
            (9 if is_left else -9, 0),
            xycoords=(ax.transAxes if np.isnan(period) else "data", "data"),
            textcoords="offset points",
            ha="left" if is_left else "right",
            va="center",
            fontsize=ROW_PT,
            fontweight="bold",
            color=style.wrong,
            bbox={"facecolor": style.ground, "edgecolor": "none", "pad": 0.5},
        )


def _draw_bits(ax: "Axes", lines: list[_Line], names: tuple[str, str], style: Style) -> None:
    """Draw the bits of each id; those that move in one only have its sign."""
    from matplotlib.colors import ListedColormap  # noqa: PLC0415

    bits = np.array([line.bits for line in lines])
    ax.imshow(
        bits,
        extent=(0, 64, len(lines) - 0.5, -0.5),
        aspect="auto",
        interpolation="nearest",
        cmap=ListedColormap([style.still, style.pale, style.ink, style.text]),
        vmin=0,
        vmax=3,
        zorder=1,
    )
    for border in range(8, 64, 8):
        ax.axvline(border, color=style.ground, linewidth=2)
    for border in range(1, len(lines)):
        ax.axhline(border - 0.5, color=style.ground, linewidth=1.5)
    ax.set_xticks(range(4, 64, 8), [f"byte {byte}" for byte in range(8)], fontsize=NOTE_PT)
    ax.tick_params(axis="x", length=0)
    ax.set_xlabel(f"bits: blue in {names[0]} only, {_dark(style)} in {names[1]} only")


def _dark(style: Style) -> str:
    return "black" if style.ground == "#FFFFFF" else "white"
