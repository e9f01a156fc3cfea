"""The bytes of an adapter's line: where bytes were skipped, and where the time jumps."""

from typing import TYPE_CHECKING, Final

import numpy as np

from canser._frames import FRAME_DTYPE, FrameArray, concat, copy_records
from canser.codec.decoder import Stats
from canser.files.reading import Blocks, Sources, blocks
from canser.plots._style import (
    NOTE_PT,
    Page,
    Style,
    dress,
    figure_of,
    new_pages,
    put_title,
    say,
    style_of,
)
from canser.plots._text import count_text, joined, percent, plain
from canser.plots._timeline import Timeline

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Parts", "part_frames", "stream"]

# Parts of the stream that are told apart, about.
_PARTS: Final = 1_000

# Bytes of a frame on a line, about.
_FRAME_LEN: Final = 16

# Reasons of skipped bytes that have a line of their own.
_REASONS_MOST: Final = 3

# Holes and restarts of the clock that are named, the first ones.
_JUMPS_MOST: Final = 12

_UNITS: Final = ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"), (1, "bytes"))


def stream(
    source: Sources | Blocks,
    protocol: str | None = None,
    *,
    ax: "tuple[Axes, Axes] | None" = None,
    width: int = 1200,
    dark: bool = False,
) -> "Figure":
    """Draw where in a stream bytes were skipped, and how the times run along it.

    Parameters
    ----------
    source : str, path-like, binary file, list of these, or Blocks
        Raw bytes or recordings, as for `canser.blocks`; or what that returns, whose blocks are the
        parts of the picture.
    protocol : str, optional
        Protocol of raw bytes, as for `canser.blocks`.
    ax : pair of matplotlib.axes.Axes, optional
        Axes for the bytes, and for the times. By default there is a new figure.
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
    ValueError
        The file holds frames, and no bytes of a line; or `width` is not 400 to 20,000; and as for
        `canser.blocks`.
    FormatError
        As for `canser.blocks`; so are TypeError and OSError.
    ModuleNotFoundError
        matplotlib is not installed.

    Notes
    -----
    The stream is cut into some 1,000 parts with as many frames each. The upper axes shows the share
    of the bytes of each part that lie in no packet, the lower one the time of the frames.

    Examples
    --------
    >>> from pathlib import Path
    >>> from canser import plots
    >>> frames = canser.concat([canser.frames("123#01")] * 100)
    >>> frames["ts"] = np.arange(100) * 10_000_000
    >>> raw = canser.encode(frames, "serial")
    >>> _ = Path("run.bin").write_bytes(raw[:500] + b"noise" + raw[500:])
    >>> plots.stream("run.bin", "serial").axes[0].get_title(loc="left")
    '17 of 1,205 bytes are skipped (1.4 %)'
    """
    style = style_of(dark)
    if isinstance(source, Blocks):
        return draw_stream(Parts(source), ax, width, style)
    with blocks(source, protocol, out=np.empty(1, FRAME_DTYPE)) as whole:
        room = part_frames(whole.bytes_total)
    out = np.empty(room, FRAME_DTYPE)
    with blocks(source, protocol, out=out) as file:
        return draw_stream(Parts(file), ax, width, style)


def part_frames(size: int | None) -> int:
    """Return how many frames a part has, for a stream of a size in bytes."""
    return 1 << 12 if size is None else max(size // _FRAME_LEN // _PARTS, 4)


class Parts:
    """The parts of a stream: each block with the counters up to its end.

    Attributes
    ----------
    ends : array of int64, shape (n,)
        The stream offset behind each part.
    skipped : array of int64, shape (n,)
        Skipped bytes in each part.
    gaps : array of int64, shape (n,)
        Gaps of a recording in each part.
    stats : Stats
        The counters of all.
    frames : array of FRAME_DTYPE, shape (m,)
        The frames.
    counts : array of int64, shape (n,)
        The number of frames up to the end of each part.
    """

    def __init__(self, file: Blocks) -> None:
        if file.stats is None:
            raise ValueError(
                f"{file.name} holds frames, and no bytes of an adapter's line: there is no stream"
            )
        ends, skipped, counts, gaps, found = [0], [0], [0], [0], []
        for block in file:
            stats = file.stats
            ends.append(stats.bytes_in - stats.pending)
            skipped.append(stats.bytes_skipped)
            counts.append(counts[-1] + len(block))
            gaps.append(file.gap_count)
            found.append(copy_records(block))
        self.stats: Stats = file.stats
        if ends[-1] < self.stats.bytes_in:
            ends.append(self.stats.bytes_in)
            skipped.append(self.stats.bytes_skipped)
            counts.append(counts[-1])
            gaps.append(file.gap_count)
        self.gaps = np.diff(gaps)
        self.ends, self.counts = np.array(ends), np.array(counts)
        self.skipped = np.diff(skipped)
        self.frames: FrameArray = concat(found) if found else np.zeros(0, FRAME_DTYPE)


def draw_stream(parts: Parts, ax: "tuple[Axes, Axes] | None", width: int, style: Style) -> "Figure":
    """Draw both axes."""
    stats, time = parts.stats, Timeline(parts.frames)
    texts = [_describe(parts), _describe_times(time)]
    if ax is None:
        above, below = new_pages(width, [Page(1.6, 0.85), Page(1.6, 0.85)], texts, "", style)
    else:
        above, below = ax
        for each, text in zip(ax, texts, strict=True):
            put_title(each, *text, style)
    total = max(stats.bytes_in, 1)
    size, unit = next(each for each in _UNITS if total >= each[0] or each[0] == 1)
    for each in (above, below):
        dress(each, style, grid="y")
        each.set_xlim(0, total / size)
    above.tick_params(axis="x", labelbottom=False)
    above.set_ylabel("skipped, %")
    below.set_xlabel(f"offset in the stream, {unit}")
    if not stats.bytes_in:
        for each in (above, below):
            each.set_yticks([])
            say(each, "no bytes", style)
        return figure_of(above)
    _draw_skipped(above, parts, size, style)
    _draw_times(below, parts, time, size, style)
    return figure_of(above)


def _draw_skipped(ax: "Axes", parts: Parts, size: float, style: Style) -> None:
    lengths = np.maximum(np.diff(parts.ends), 1)
    shares = 100 * np.minimum(parts.skipped / lengths, 1)
    ax.stairs(shares, parts.ends / size, fill=True, color=style.wrong, linewidth=0.6)
    ax.set_ylim(0, 1.15 * max(float(shares.max()), 0.5))
    lost = np.flatnonzero(parts.gaps)
    ax.plot(
        parts.ends[1:][lost] / size,
        np.full(len(lost), 0.94),
        transform=ax.get_xaxis_transform(),
        linestyle="",
        marker="x",
        markersize=6,
        color=style.wrong,
    )
    if not parts.stats.bytes_skipped and not len(lost):
        say(ax, "no byte is skipped", style)


def _draw_times(ax: "Axes", parts: Parts, time: Timeline, size: float, style: Style) -> None:
    """Draw the time along the stream: a step is a hole, a flat part has many frames."""
    if time.is_numbered or not time.count:
        ax.set_yticks([])
        say(ax, "no frame has a time" if len(parts.frames) else "no frames", style)
        return
    places = np.full(len(parts.frames), np.nan)
    places[time.is_timed()] = time.running_places()
    last = parts.counts[1:] - 1
    known = np.flatnonzero((last >= 0) & (np.diff(parts.counts) > 0))
    ax.plot(parts.ends[1:][known] / size, places[last[known]], color=style.ink, linewidth=1.4)
    ax.set_ylabel("time, s")
    ax.set_ylim(0, 1.08 * (time.running or 1))
    offsets = np.interp(np.arange(len(places)), parts.counts, parts.ends) / size
    false = np.flatnonzero(np.isnan(places))
    ax.plot(
        offsets[false],
        np.full(len(false), 0.06),
        transform=ax.get_xaxis_transform(),
        linestyle="",
        marker="x",
        markersize=5,
        color=style.wrong,
    )
    jumps = time.jumps()
    for frame, text in jumps[:_JUMPS_MOST]:
        ax.axvline(offsets[frame], color=style.text, linewidth=1, linestyle="--")
        ax.annotate(
            text,
            (offsets[frame], 0.5),
            (-3, 0),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            rotation=90,
            ha="right",
            va="center",
            fontsize=NOTE_PT,
            color=style.text,
        )


def _describe(parts: Parts) -> tuple[str, str]:
    stats = parts.stats
    if not stats.bytes_in:
        return "There are no bytes", ""
    share = percent(stats.bytes_skipped / stats.bytes_in)
    title = f"{stats.bytes_skipped:,} of {count_text(stats.bytes_in, 'byte')} are skipped ({share})"
    reasons = sorted(stats.rejects.items(), key=lambda item: -item[1])
    shown = [f"{name} {count:,}" for name, count in reasons if count]
    if len(shown) > _REASONS_MOST:
        shown[_REASONS_MOST:] = [f"{len(shown) - _REASONS_MOST} more reasons"]
    note = f"in {count_text(stats.resyncs, 'place')}" if stats.bytes_skipped else ""
    gaps = int(parts.gaps.sum())
    if gaps:
        title += f"; the recording has {count_text(gaps, 'gap')}"
    marks = "x: a gap of the recording" if gaps else ""
    return title, joined(note, ", ".join(shown), "share of the bytes of each part", marks)


def _describe_times(time: Timeline) -> tuple[str, str]:
    frames = count_text(time.count, "frame")
    if time.is_numbered:
        return f"{frames} without a time", ""
    notes = ["time of the frames, without holes"]
    jumps = len(time.jumps())
    if jumps:
        notes.append(f"dashed: {count_text(jumps, 'jump')} of the time")
        if jumps > _JUMPS_MOST:
            notes[-1] += f", the first {_JUMPS_MOST} shown"
    if time.untimed:
        notes.append(f"x: {count_text(time.untimed, 'frame')} without a time, or with a false one")
    return f"{frames} in {plain(time.running, 4)} s", joined(*notes)
