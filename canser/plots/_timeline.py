"""The time axis that all pictures share: without jumps of the clock, with holes of the bus marked.

A run is a stretch of time without a jump and without a hole; `canser.id_stats` tells what these
are. Runs stand side by side. Behind a jump of the clock back, time goes on without a pause. A long
hole is drawn short, and has its length as text: otherwise an hour in which the recorder was off
would leave no room for the frames.
"""

from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from canser._core.ids import runs_of
from canser._frames import YEAR_2000_NS, FrameArray
from canser.analysis.ids import contiguous
from canser.plots._style import NOTE_PT, Style, figure_of
from canser.plots._text import LONG_S, clock_text, count_text, duration_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["Hole", "Timeline", "steady_frames"]

_Number = TypeVar("_Number", bound=np.generic)

_Ints = npt.NDArray[np.int64]
_Floats = npt.NDArray[np.float64]

# A hole takes at most this share of the time with frames, and all holes together no more than the
# second one.
_HOLE_MOST: Final = 0.05
_HOLES_MOST: Final = 0.5

# Frames whose columns are found together.
_PART: Final = 1 << 17

# Holes that are drawn and named at most, the longest ones; and restarts of the clock.
_NAMED_MOST: Final = 12
_DRAWN_MOST: Final = 200

# Ticks of a time axis, in seconds, from an hour on.
_LONG_STEPS: Final = (600, 900, 1800, 3600, 7200, 10800, 14400, 21600, 43200, 86400)


class Hole(NamedTuple):
    """A hole of the bus on the axis."""

    #: Where it begins and ends, in seconds of the axis.
    begin: float
    end: float
    #: Its true length, in seconds.
    length: float


class Timeline:
    """Where the times of frames are on the axis, in seconds from the first frame.

    Attributes
    ----------
    span : float
        Length of the axis in seconds.
    running : float
        Seconds in which there were frames: without holes.
    holes : list of Hole
        The holes of the bus.
    restarts : list of float
        Where the clock stepped back, in seconds of the axis.
    count : int
        Frames that have a time.
    untimed : int
        Frames that are left out, as their times are not known or false.
    is_numbered : bool
        Whether no frame has a time. Then the axis shows the numbers of the frames.
    """

    def __init__(self, frames: FrameArray) -> None:
        frames, _ = contiguous(frames, None)
        run_of = runs_of(frames)
        self._ts: _Ints = np.ascontiguousarray(frames["ts"])
        self.is_numbered = len(frames) > 0 and not run_of.any()
        if self.is_numbered:
            run_of, self._ts = np.ones(len(frames), np.uint32), np.arange(len(frames)) * 10**9
        self._known = None if run_of.all() else np.flatnonzero(run_of)
        if self._known is not None:
            self._ts, run_of = self._ts[self._known], run_of[self._known]
        self._every, self.count = len(frames), len(self._ts)
        self.untimed = self._every - self.count
        self.holes: list[Hole] = []
        self.restarts: list[float] = []
        self.span = self.running = 0.0
        borders = np.flatnonzero(run_of[1:] != run_of[:-1]) + 1
        self._firsts = np.concatenate([[0], borders]) if len(self._ts) else np.zeros(0, np.int64)
        if len(self._firsts):
            self._lay_out()

    def _lay_out(self) -> None:
        """Put the runs side by side."""
        firsts, ts = self._firsts, self._ts
        begin, end = np.minimum.reduceat(ts, firsts), np.maximum.reduceat(ts, firsts)
        lasts = np.append(firsts[1:], len(ts)) - 1
        lengths = (end - begin) / 1e9
        self.running = float(lengths.sum())
        back = ts[firsts[1:]] < ts[lasts[:-1]]
        # As uint64: a clock that goes from one end of 64 bits to the other has such a hole.
        pauses = (begin[1:].view(np.uint64) - end[:-1].view(np.uint64)) / 1e9
        pauses = np.where(back | (begin[1:] < end[:-1]), 0, pauses)
        hole_count = int((pauses > 0).sum())
        most = min(_HOLE_MOST, _HOLES_MOST / max(hole_count, 1)) * (self.running or 1.0)
        drawn = np.minimum(pauses, most)
        self._begin, self._ends, self._back, self._pauses = begin, end, back, pauses
        self._chain = np.concatenate([[0], np.cumsum(back)])
        self._at = np.concatenate([[0], np.cumsum(lengths[:-1] + drawn)])
        self._elapsed = np.concatenate([[0], np.cumsum(lengths[:-1] + pauses)])
        self._lengths = lengths
        self.span = float(self._at[-1] + lengths[-1])
        ends = self._at[1:]
        for place in np.flatnonzero(pauses > 0):
            stop = float(ends[place])
            self.holes.append(Hole(stop - float(drawn[place]), stop, float(pauses[place])))
        self.restarts = ends[back].tolist()

    @property
    def elapsed(self) -> float:
        """Seconds from the first frame to the last one, with holes and without jumps."""
        return float(self._elapsed[-1] + self._lengths[-1]) if len(self._firsts) else 0.0

    @property
    def is_shortened(self) -> bool:
        """Whether a hole is drawn shorter than it was."""
        return any(hole.end - hole.begin < 0.999 * hole.length for hole in self.holes)

    @property
    def shown(self) -> float:
        """The length of the axis: one second if all frames have one time."""
        return self.span or 1.0

    def places(self) -> _Floats:
        """Return the seconds on the axis of all frames that have a time, shape (m,)."""
        begin, at = self._of_frames(self._begin), self._of_frames(self._at)
        found: _Floats = (self._ts - begin) / 1e9 + at
        return found

    def running_places(self) -> _Floats:
        """Return the seconds from the first frame, without holes, of all frames with a time."""
        before = np.concatenate([[0], np.cumsum(self._lengths[:-1])])
        since = (self._ts - self._of_frames(self._begin)) / 1e9
        found: _Floats = since + self._of_frames(before)
        return found

    def jumps(self) -> list[tuple[int, str]]:
        """Return the first frames behind holes and restarts, with what was before each."""
        found = []
        for run in np.flatnonzero((self._pauses > 0) | self._back):
            at = int(self._firsts[run + 1])
            length = duration_text(1e9 * float(self._pauses[run]))
            text = "the clock steps back" if self._back[run] else f"no frame for {length}"
            found.append((at if self._known is None else int(self._known[at]), text))
        return found

    def place(self, chain: int, ns: _Ints) -> _Floats:
        """Return the seconds on the axis of rising times; `chain`: how often the clock restarted.

        Times between runs are in the hole between them.
        """
        runs = np.flatnonzero(self._chain == chain)
        run = runs[np.clip(np.searchsorted(self._begin[runs], ns, "right") - 1, 0, None)]
        since = (ns - self._begin[run]) / 1e9
        limit = np.append(self._at[1:], np.inf)[run] - self._at[run]
        found: _Floats = np.minimum(since, limit) + self._at[run]
        return found

    def chains(self) -> list[npt.NDArray[np.intp]]:
        """Return which frames lie between two restarts of the clock, those with a time."""
        if not self.count:
            return []
        known = np.arange(self._every) if self._known is None else self._known
        return np.split(known, self._firsts[np.flatnonzero(np.diff(self._chain)) + 1])

    def shifts(self) -> _Ints:
        """Return what takes the restarts of the clock out of the times of frames, shape (m,)."""
        steps = np.where(self._back, self._ends[:-1] - self._begin[1:], 0)
        return self._of_frames(np.append(0, np.cumsum(steps)))

    def is_timed(self) -> npt.NDArray[np.bool_]:
        """Return which frames have a place on the axis, shape (n,)."""
        if self._known is None:
            return np.ones(self._every, np.bool_)
        marks = np.zeros(self._every, np.bool_)
        marks[self._known] = True
        return marks

    def length_text(self, length: float) -> str:
        """Return a length of the axis with its unit."""
        if self.is_numbered:
            return count_text(max(round(length), 1), "frame")
        return duration_text(1e9 * length)

    def covers(self, chain: int, begin: _Ints, end: _Ints) -> npt.NDArray[np.bool_]:
        """Return which stretches of time lie in one run; `chain`: as for `place`."""
        runs = np.flatnonzero(self._chain == chain)
        run = runs[np.clip(np.searchsorted(self._begin[runs], begin, "right") - 1, 0, None)]
        return (begin >= self._begin[run]) & (end <= self._ends[run])

    def columns(self, count: int) -> npt.NDArray[np.int32]:
        """Return the column of each frame, of `count` columns over the axis; -1 without a time."""
        scale = count / self.shown
        column = np.empty(len(self._ts), np.int32)
        # What is made of a part stays in the cache.
        for first in range(0, len(column), _PART):
            end = min(first + _PART, len(column))
            begin, at = self._of_part(first, end)
            found = np.multiply(self._ts[first:end] - begin, scale / 1e9)
            found += at * scale
            np.copyto(column[first:end], found, casting="unsafe")
        np.minimum(column, count - 1, out=column)
        if self._known is None:
            return column
        columns = np.full(self._every, -1, np.int32)
        columns[self._known] = column
        return columns

    def _of_part(self, first: int, end: int) -> tuple[Any, Any]:
        """Return where the runs of some frames begin, in time and on the axis."""
        run, last = np.searchsorted(self._firsts, [first, end - 1], "right") - 1
        if run == last:
            return self._begin[run], self._at[run]
        borders = np.clip(self._firsts[run : last + 2], first, end)
        lengths = np.diff(np.append(borders, end))[: last - run + 1]
        runs = np.repeat(np.arange(run, last + 1), lengths)
        return self._begin[runs], self._at[runs]

    def _of_frames(self, values: npt.NDArray[_Number]) -> npt.NDArray[_Number]:
        """Return the value of each frame's run."""
        if len(values) == 1:
            return values
        return np.repeat(values, np.diff(self._firsts, append=len(self._ts)))

    def note(self) -> str:
        """Return what is to be known of the axis, "" if there is nothing."""
        parts = ["no frame has a time: frames by their number"] if self.is_numbered else []
        if self.holes:
            total = sum(hole.length for hole in self.holes)
            holes = count_text(len(self.holes), "hole")
            parts.append(f"hatched: no frame at all ({holes}, {duration_text(1e9 * total)})")
        if self.restarts:
            parts.append(f"dashed: the clock steps back ({len(self.restarts):,})")
        if self.untimed:
            frames = count_text(self.untimed, "frame")
            parts.append(f"{frames} without a time, or with a false one, left out")
        return "; ".join(parts)

    def draw(self, ax: "Axes", style: Style, *, label: bool = True, names: bool = True) -> None:
        """Draw holes and restarts, and set the ticks; `names`: write how long holes are."""
        ax.set_xlim(0, self.shown)
        longest = sorted(self.holes, key=lambda hole: -hole.length)[:_DRAWN_MOST]
        for number, hole in enumerate(longest):
            ax.axvspan(
                hole.begin,
                hole.end,
                facecolor=style.ground,
                edgecolor=style.faint,
                hatch="////",
                linewidth=0,
                zorder=3,
            )
            if names and number < _NAMED_MOST:
                self._name(ax, hole, style)
        for place in self.restarts[:_DRAWN_MOST]:
            ax.axvline(place, color=style.wrong, linestyle="--", linewidth=1, zorder=4)
        self._set_ticks(ax)
        if label and self.is_numbered:
            ax.set_xlabel("number of the frame")
        elif label:
            unit = "h:mm:ss" if self.elapsed >= LONG_S else "s"
            ax.set_xlabel(f"time since {self._start()}, {unit}")

    def _start(self) -> str:
        first = int(self._ts[0]) if len(self._ts) else 0
        if first < YEAR_2000_NS:
            return "the first frame"
        return str(np.datetime64(first // 10**9, "s")).replace("T", " ") + " UTC"

    def _name(self, ax: "Axes", hole: Hole, style: Style) -> None:
        length = duration_text(1e9 * hole.length)
        inches = ax.get_window_extent().height / figure_of(ax).dpi
        ax.text(
            (hole.begin + hole.end) / 2,
            0.5,
            f"no frame for {length}" if inches > 1.6 else length,
            transform=ax.get_xaxis_transform(),
            rotation=90,
            ha="center",
            va="center",
            fontsize=NOTE_PT,
            color=style.text,
            clip_on=True,
            zorder=5,
            bbox={"facecolor": style.ground, "edgecolor": "none", "pad": 1.5},
        )

    def _set_ticks(self, ax: "Axes") -> None:
        """Write elapsed time under the axis, that of holes included."""
        from matplotlib.ticker import FixedFormatter, FixedLocator, StrMethodFormatter  # noqa: PLC0415

        if self.is_numbered or (not self.is_shortened and self.elapsed < LONG_S):
            ax.xaxis.set_major_formatter(StrMethodFormatter("{x:,g}"))
            return
        step = _step(self.shown)
        places: list[float] = []
        times: list[float] = []
        for at, begin, length in zip(self._at, self._elapsed, self._lengths, strict=True):
            first = np.ceil(begin / step - 1e-9) * step
            for time in np.arange(first, begin + length + 1e-9 * step, step):
                place = at + time - begin
                if not places or place - places[-1] > 0.6 * step:
                    places.append(place)
                    times.append(time)
        if self.elapsed >= LONG_S:
            texts = [clock_text(time) for time in times]
        else:
            decimals = max(0, -int(np.floor(np.log10(step))))
            texts = [f"{abs(time):,.{decimals}f}" for time in times]
        ax.xaxis.set_major_locator(FixedLocator(places))
        ax.xaxis.set_major_formatter(FixedFormatter(texts))


def steady_frames(frames: FrameArray) -> FrameArray:
    """Return frames without false times, and with times that go on where the clock restarts."""
    time = Timeline(frames)
    if time.is_numbered or not (time.restarts or time.untimed):
        return frames
    steady = frames.compress(time.is_timed())
    steady["ts"] += time.shifts()
    return steady


def _step(span: float) -> float:
    """Return the time between ticks, such that there are 5 to 12."""
    for step in _LONG_STEPS:
        if span >= LONG_S and span / step <= 12:
            return float(step)
    if span >= LONG_S:
        return 86400 * float(np.ceil(span / 86400 / 12))
    power = 10 ** np.floor(np.log10(span / 5))
    return float(next(power * times for times in (1, 2, 5, 10) if span / (power * times) <= 10))
