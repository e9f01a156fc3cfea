"""Samples over time, reduced to what the pixels of an axis can show: the least and the most."""

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canser.plots._style import Style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["Envelope", "Samples", "draw_samples", "reduce_samples"]

_Floats = npt.NDArray[np.float64]

# Up to this number of samples a column, the samples themselves are drawn.
_FEW: Final = 2

# From this number of samples a column on, the mean is drawn as a line besides. Otherwise hours of a
# signal become a block of one colour.
_DENSE: Final = 50

# Up to this number, each sample has a point.
_POINTS_MOST: Final = 100


class Samples(NamedTuple):
    """Samples on the time axis."""

    #: Rising places on the axis, shape (n,).
    at: _Floats
    #: Their values, shape (n,).
    values: npt.NDArray[Any]
    #: The samples that no line joins with the one before, the first one too.
    starts: npt.NDArray[np.intp]


class Envelope(NamedTuple):
    """The samples in each column that has some; NaN between stretches that no line may join."""

    at: _Floats
    low: _Floats
    high: _Floats
    mean: _Floats


def reduce_samples(samples: Samples, columns: int, span: float) -> Envelope:
    """Return the least, the most and the mean of the samples in each column of the axis."""
    at, values, starts = samples
    if not len(at):
        return Envelope(*np.zeros((4, 0)))
    edges = np.searchsorted(at, np.arange(1, columns) * (span / columns))
    first = np.unique(np.concatenate([[0], edges[edges < len(at)], starts]))
    counts = np.diff(first, append=len(at))
    reduced = (
        (at[first] + at[first + counts - 1]) / 2,
        np.minimum.reduceat(values, first).astype(np.float64),
        np.maximum.reduceat(values, first).astype(np.float64),
        np.add.reduceat(values, first, dtype=np.float64) / counts,
    )
    breaks = np.searchsorted(first, starts[starts > 0])
    return Envelope(*(np.insert(each, breaks, np.nan) for each in reduced))


def draw_samples(ax: "Axes", samples: Samples, columns: int, span: float, style: Style) -> None:
    """Draw samples as a line, or as the range of each column if there are many."""
    if len(samples.at) <= _FEW * columns:
        _draw_line(ax, samples, style)
        return
    shown = reduce_samples(samples, columns, span)
    is_dense = len(samples.at) > _DENSE * columns
    colour = style.pale if is_dense else style.ink
    ax.fill_between(shown.at, shown.low, shown.high, color=colour, edgecolor=colour, linewidth=0.8)
    if is_dense:
        ax.plot(shown.at, shown.mean, color=style.ink, linewidth=1.2)


def _draw_line(ax: "Axes", samples: Samples, style: Style) -> None:
    """Draw all samples; one that no line joins with another one has a point."""
    at, values, starts = samples
    breaks = starts[starts > 0]
    x = np.insert(at, breaks, np.nan)
    y = np.insert(values.astype(np.float64), breaks, np.nan)
    ax.plot(x, y, color=style.ink, linewidth=1)
    points = np.intersect1d(starts, np.append(starts[1:], len(at)) - 1)
    if len(at) <= _POINTS_MOST:
        points = np.arange(len(at))
    ax.plot(at[points], values[points], color=style.ink, linestyle="", marker=".", markersize=5)
