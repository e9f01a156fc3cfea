"""Signals over time: lines of values, and bands of the texts of a value table."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canser._checks import type_name
from canser._frames import FRAME_DTYPE, FrameArray
from canser.analysis.ids import IdStats
from canser.plots._samples import Samples, draw_samples
from canser.plots._style import (
    LABEL_PT,
    NOTE_PT,
    Page,
    Style,
    column_count,
    dress,
    figure_of,
    new_pages,
    say,
    style_of,
)
from canser.plots._text import count_text, joined, plain
from canser.plots._timeline import Timeline
from canser.signals.signal import Signal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["signals"]

_Ints = npt.NDArray[np.int64]
_Floats = npt.NDArray[np.float64]

# A line joins samples that are at most this number of periods apart.
_JOINED: Final = 3

# The most signals in one picture, and the inches of an axes with a line, and with a band.
_SIGNALS_MOST: Final = 40
_LINE_IN: Final = 1.15
_BAND_IN: Final = 0.32

# The code of a column that has several values of a table.
_SEVERAL: Final = -1


def signals(
    signals: Mapping[str, Signal],
    names: str | Sequence[str] | None = None,
    *,
    ax: "Axes | Sequence[Axes] | None" = None,
    width: int = 1200,
    dark: bool = False,
) -> "Figure":
    """Draw signals over time, one above the other.

    Parameters
    ----------
    signals : mapping of str to Signal
        What `Database.decode` returns.
    names : str or sequence of str, optional
        The signals to draw, in this order. By default all, up to 40.
    ax : matplotlib.axes.Axes or sequence of them, optional
        One for each signal. By default there is a new figure.
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
    KeyError
        There is no signal of a name, or several messages have one.
    TypeError
        `signals` is no mapping.
    ValueError
        There are over 40 signals, not as many axes as signals, or samples without times; or
        `width` is not 400 to 20,000. Or the clock restarts, and not all of these signals have
        samples in each part.
    ModuleNotFoundError
        matplotlib is not installed.

    Notes
    -----
    Where there are more samples than pixels, the least and the most of each pixel are filled, and
    from 50 samples a pixel on the mean is a line besides. A line joins samples that are at most
    three periods apart. A signal with a value table is drawn as bands, from the first value of the
    table (light) to the last one (dark); values that are not in the table are hatched.

    A hole of the bus is a time in which none of these signals has a sample.

    Examples
    --------
    >>> from canser import plots
    >>> ts = (np.arange(100) * 10_000_000).view("M8[ns]")
    >>> rpm = canser.Signal(
    ...     name="RPM", message="Engine", group="Engine", ts=ts, values=np.arange(100), unit="rpm"
    ... )
    >>> plots.signals({"RPM": rpm}).axes[0].get_title(loc="left")
    'Engine.RPM: 0 to 99 rpm, mean 49.5'
    """
    chosen = _choose(signals, names)
    style = style_of(dark)
    time, placed = _lay_out(chosen)
    pages = [Page(_BAND_IN if each.choices else _LINE_IN, 0.85) for each in chosen]
    texts = [_describe(each, of.values) for each, of in zip(chosen, placed, strict=True)]
    note = joined(time.note(), _count_note(placed))
    if ax is None:
        axes = new_pages(width, pages, [(text, "") for text in texts], note, style)
    else:
        axes = list(ax) if isinstance(ax, Sequence | np.ndarray) else [ax]
        if len(axes) != len(chosen):
            raise ValueError(
                f"ax has {len(axes)} axes for {len(chosen)} signals; give one for each"
            )
        for each, text in zip(axes, texts, strict=True):
            each.set_title(text, loc="left", fontsize=LABEL_PT, color=style.text)
    for number, (each, signal, samples) in enumerate(zip(axes, chosen, placed, strict=True)):
        is_last = number == len(axes) - 1
        dress(each, style, grid="" if signal.choices else "y")
        time.draw(each, style, label=is_last, names=not signal.choices)
        if not is_last:
            each.tick_params(axis="x", labelbottom=False)
        if not len(samples.at):
            each.set_yticks([])
            say(each, "no samples", style)
        elif signal.choices:
            _draw_bands(each, signal.choices, samples, time, style)
        else:
            _draw_line(each, signal, samples, time, style)
    return figure_of(axes[0])


def _choose(signals: Any, names: str | Sequence[str] | None) -> list[Signal]:
    if not isinstance(signals, Mapping):
        raise TypeError(f"signals must be what Database.decode returns, not {type_name(signals)}")
    names = [*signals] if names is None else [names] if isinstance(names, str) else list(names)
    if not 1 <= len(names) <= _SIGNALS_MOST:
        raise ValueError(f"there are {len(names):,} signals; name 1 to {_SIGNALS_MOST} of them")
    return [signals[name] for name in names]


class _Part(NamedTuple):
    """The samples of a signal between two restarts of the clock."""

    #: Which samples, in the order of their times.
    places: npt.NDArray[np.intp]
    #: Their times.
    ns: _Ints
    #: The most nanoseconds that a line may join.
    most: float


def _lay_out(signals: Sequence[Signal]) -> tuple[Timeline, list[Samples]]:
    """Return the common time axis, and where the samples are on it."""
    times: dict[int, tuple[Timeline, list[_Part]]] = {}
    for signal in signals:
        if id(signal.ts) not in times:
            times[id(signal.ts)] = _parts(signal.ts)
    time = _join([each for each in times.values() if each[1]])
    return time, [_placed(signal, times[id(signal.ts)][1], time) for signal in signals]


def _join(times: list[tuple[Timeline, list[_Part]]]) -> Timeline:
    """Return the time axis of signals; a group of them has its own one already."""
    if len(times) == 1:
        return times[0][0]
    if len({len(parts) for _, parts in times}) > 1:
        raise ValueError(
            "the clock restarts, and not all of these signals have samples in each part; draw "
            "them one by one, or a part that canser.between chooses"
        )
    chains = zip(*(parts for _, parts in times), strict=True)
    every = [np.sort(np.concatenate([part.ns for part in chain])) for chain in chains]
    return Timeline(_frames_at(np.concatenate([np.zeros(0, np.int64), *every])))


def _frames_at(ns: _Ints) -> FrameArray:
    frames = np.zeros(len(ns), FRAME_DTYPE)
    frames["ts"] = ns
    return frames


def _parts(ts: npt.NDArray[np.datetime64]) -> tuple[Timeline, list[_Part]]:
    """Return the time axis of some samples, and the samples between restarts of the clock.

    Those of false times are left out.
    """
    ns = ts.astype("M8[ns]").view(np.int64)
    frames = _frames_at(ns)
    stats = IdStats()
    stats.add(frames)
    parts = []
    time = Timeline(frames)
    if time.is_numbered:
        raise ValueError("the frames have no times, so there is no axis for signals over time")
    for index in time.chains():
        row = stats.rows()[0]
        period = (
            row["period_ns"] if row["period_ns"] == row["period_ns"] else row["interval_p99_ns"]
        )
        order = index[np.argsort(ns[index], kind="stable")]
        parts.append(_Part(order, ns[order], np.nan_to_num(_JOINED * period, nan=np.inf)))
    return time, parts


def _placed(signal: Signal, parts: list[_Part], time: Timeline) -> Samples:
    values = signal.values
    if signal.choices and signal.raw is not None:
        values = signal.raw
    at, found, starts, count = [np.zeros(0)], [values[:0]], [np.zeros(0, np.intp)], 0
    for chain, part in enumerate(parts):
        places, ns = part.places, part.ns
        if signal.valid is not None:
            valid = signal.valid[places]
            places, ns = places[valid], ns[valid]
        if not len(ns):
            continue
        at.append(time.place(chain, ns))
        found.append(values[places])
        starts.append(count + np.flatnonzero(np.append(True, np.diff(ns) > part.most)))
        count += len(ns)
    return Samples(np.concatenate(at), np.concatenate(found), np.concatenate(starts))


def _describe(signal: Signal, values: npt.NDArray[Any]) -> str:
    """Return the finding."""
    if not len(values):
        return f"{signal.full_name}: no samples"
    unit = f" {signal.unit}" if signal.unit else ""
    if not signal.choices:
        least, most, mean = (plain(float(f(values)), 4) for f in (np.min, np.max, np.mean))
        return f"{signal.full_name}: {least} to {most}{unit}, mean {mean}"
    changes = int((values[1:] != values[:-1]).sum())
    found = np.unique(values)
    known = [signal.choices[int(each)] for each in found if int(each) in signal.choices]
    text = f"{signal.full_name}: {', '.join(known[:6])}"
    if len(known) > 6:
        text += f" and {len(known) - 6} more"
    unknown = len(found) - len(known)
    if unknown:
        text += f"{', ' if known else ''}{count_text(unknown, 'value')} not in the table"
    return f"{text}; {count_text(changes, 'change')}"


def _count_note(placed: list[Samples]) -> str:
    total = sum(len(each.at) for each in placed)
    return f"{count_text(total, 'sample')}; where there are more than pixels: least to most of each"


def _draw_line(ax: "Axes", signal: Signal, samples: Samples, time: Timeline, style: Style) -> None:
    draw_samples(ax, samples, column_count(ax), time.shown, style)
    ax.set_ylabel(signal.unit)
    ax.margins(y=0.08)
    from matplotlib.ticker import MaxNLocator, StrMethodFormatter  # noqa: PLC0415

    ax.yaxis.set_major_locator(MaxNLocator(4))
    ax.yaxis.set_major_formatter(StrMethodFormatter("{x:,.6g}"))


class _Bands(NamedTuple):
    """Stretches of the axis with one value each."""

    begin: _Floats
    end: _Floats
    codes: _Ints


def _find_bands(samples: Samples, columns: int, time: Timeline) -> _Bands:
    """Return the stretches; those shorter than a column become one of several values."""
    at, values, starts = samples
    codes = values.astype(np.int64)
    first = np.union1d(starts, np.flatnonzero(codes[1:] != codes[:-1]) + 1)
    # A value holds up to the next sample, but not beyond where a line would end.
    last = np.append(first[1:], len(at)) - 1
    follows = np.append(~np.isin(first[1:], starts), False)
    end = np.where(follows, at[np.minimum(last + 1, len(at) - 1)], at[last])
    bands = _Bands(at[first], end, codes[first])
    if len(first) <= columns:
        return bands
    wide = time.shown / columns
    column = np.minimum((bands.begin / wide).astype(np.int64), columns - 1)
    place = np.flatnonzero(np.append(True, column[1:] != column[:-1]))
    several = np.diff(place, append=len(column)) > 1
    codes = np.where(several, _SEVERAL, bands.codes[place])
    ends = np.maximum.reduceat(bands.end, place)
    keep = np.append(True, (codes[1:] != codes[:-1]) | (bands.begin[place][1:] > ends[:-1]))
    groups = np.flatnonzero(keep)
    return _Bands(bands.begin[place][groups], np.maximum.reduceat(ends, groups), codes[groups])


def _draw_bands(
    ax: "Axes", choices: Mapping[int, str], samples: Samples, time: Timeline, style: Style
) -> None:
    """Draw a band for each value; its text stands inside if it fits."""
    from matplotlib import colormaps  # noqa: PLC0415
    from matplotlib.colors import to_rgba  # noqa: PLC0415

    ax.set_ylim(0, 1)
    ax.set_yticks([])
    ax.axvspan(0, time.shown, facecolor="none", edgecolor=style.grid, hatch="///", linewidth=0)
    bands = _find_bands(samples, column_count(ax), time)
    table = {code: place for place, code in enumerate(sorted(choices))}
    shades = colormaps["Blues"](np.linspace(0.2, 0.9, max(len(table), 2)))
    lengths = np.maximum(bands.end - bands.begin, time.shown / column_count(ax))
    border = 0.5 if len(bands.codes) < column_count(ax) / 10 else 0
    for code in np.unique(bands.codes).tolist():
        where = bands.codes == code
        options: dict[str, Any] = {"facecolors": style.wrong, "hatch": "xx"}
        if code in table:
            options = {"facecolors": [shades[table[code]]]}
        elif code == _SEVERAL:
            options = {"facecolors": style.still}
        spans = list(zip(bands.begin[where], lengths[where], strict=True))
        ax.broken_barh(
            spans, (0.04, 0.92), edgecolor=style.ground, linewidth=border, zorder=2, **options
        )
    for begin, length, code, text in _texts(ax, bands, lengths, choices, time):
        shade = shades[table[code]] if code in table else to_rgba(style.wrong)
        if code == _SEVERAL:
            shade = to_rgba(style.still)
        ax.text(
            begin + length / 2,
            0.5,
            text,
            ha="center",
            va="center",
            fontsize=NOTE_PT,
            color="#FFFFFF" if np.dot(shade[:3], (0.299, 0.587, 0.114)) < 0.55 else "#000000",
            clip_on=True,
            zorder=4,
        )


def _texts(
    ax: "Axes", bands: _Bands, lengths: _Floats, choices: Mapping[int, str], time: Timeline
) -> Iterator[tuple[float, float, int, str]]:
    """Yield place, length, value and text of the bands that are wide enough for their text."""
    inches = ax.get_window_extent().width / figure_of(ax).dpi
    letters = inches * 72 / (NOTE_PT * 0.65) / time.shown
    for begin, length, code in zip(bands.begin, lengths, bands.codes.tolist(), strict=True):
        text = choices.get(code, "several values" if code == _SEVERAL else str(code))
        if len(text) + 1 <= length * letters:
            yield begin, length, code, text
