"""The rows of a live table on the screen, as widgets of textual, an optional extra."""

import math
from collections.abc import Iterator
from itertools import groupby
from typing import ClassVar, Final, NamedTuple

import numpy as np
from rich.segment import Segment
from rich.style import Style
from rich.text import Text
from textual import events
from textual.geometry import Region, Size
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.widget import Widget

from canser._frames import NO_TIME
from canser.monitoring.livetable import ROW_DTYPE, RowArray
from canser.monitoring.signals import INDENT, Line, RowSignals

__all__ = ["DESCENDING", "Heading", "Table"]

# How long after its change a byte is marked strongly, and how long faintly.
_FRESH_NS: Final = 400_000_000
_FADING_NS: Final = 2_000_000_000

# Styles of a byte: never changed; last changed over 2 s, over 0.4 s, or less than 0.4 s ago.
_BYTES: Final = ("constant", "data", "fading", "fresh")

# A row is quiet when its last frame is older than this many periods, and older than a second.
_QUIET_PERIODS: Final = 3.0
_S_NS: Final = 1_000_000_000

# Width in characters from which on the wide columns are shown.
_WIDE: Final = 142


class _Column(NamedTuple):
    title: str
    width: int
    by: str = ""  # the key by which a click on the title sorts
    left: bool = False  # whether the title is aligned left


_ID = _Column("ID", 9, "id")
_KIND = _Column("", 2)
_COUNT = _Column("Count", 10, "count")
_PERIOD = _Column("Period ms", 11, "period")
_JITTER = _Column("Jitter ms", 11, "jitter")
_RATE = _Column("Frames/s", 10)
_DLC = _Column("DLC", 4, "dlc")
_DATA = _Column("  Data", 26, left=True)
_ASCII = _Column(" ASCII", 9, left=True)
_SEEN = _Column("Seen", 6, "ts")
_SHARE = _Column("   Share of the frames", 42, left=True)

_NARROW_COLUMNS: Final = (_ID, _KIND, _COUNT, _PERIOD, _JITTER, _DLC, _DATA, _SEEN)
_WIDE_COLUMNS: Final = (*_NARROW_COLUMNS[:5], _RATE, _DLC, _DATA, _ASCII, _SEEN, _SHARE)

# Keys that sort in descending order first: the most frames, the largest jitter, the newest.
DESCENDING: Final = {"count", "jitter", "ts"}


def _columns(width: int) -> tuple[_Column, ...]:
    return _WIDE_COLUMNS if width >= _WIDE else _NARROW_COLUMNS


class Heading(Widget):
    """The titles of the columns, with an arrow at the sort key; a click on a title sorts."""

    by, descending = "id", False

    def render(self) -> Text:
        text = Text(no_wrap=True)
        for column in _columns(self.size.width):
            chosen = column.by == self.by
            title = ("\u25bc" if self.descending else "\u25b2") * chosen + column.title
            space = " " * (column.width - len(title))
            text.append("" if column.left else space)
            text.append(title, "bold reverse" if chosen else "bold")
            text.append(space if column.left else "")
        return text

    async def on_click(self, event: events.Click) -> None:
        end = 0
        for column in _columns(self.size.width):
            end += column.width
            if event.x < end:
                if column.by:
                    await self.run_action(f"app.sort('{column.by}')")
                return


class Table(ScrollView, can_focus=True):
    """The rows. Only visible lines are made, and only changed lines are drawn."""

    COMPONENT_CLASSES: ClassVar[set[str]] = {*_BYTES, "id", "number", "quiet", "error", "bar"}

    def __init__(self, signals: RowSignals | None = None) -> None:
        super().__init__()
        self._signals = signals
        self._rows: RowArray = np.zeros(0, ROW_DTYPE)
        self._ends = np.zeros(0, np.int64)  # of the lines of each row
        self._now = self._frames = 0
        self._hint = ""  # the text to show if there are no rows
        self._view: tuple[int, Size] | None = None  # scroll offset and size of the lines
        self._lines: list[Strip] = []

    def show(self, rows: RowArray, now: int, frames: int, hint: str) -> None:
        """Show rows at the time `now`, nanoseconds; `frames`: the number of frames of all rows."""
        self._rows, self._now, self._frames, self._hint = rows, now, frames, hint
        width = self.scrollable_content_region.width
        counts = np.ones(len(rows), np.int64)
        if self._signals is not None:
            counts += self._signals.line_counts(rows, width)
        self._ends = np.cumsum(counts)
        self.virtual_size = Size(width, int(counts.sum()))
        old, view = self._lines, self._view
        self._view = None
        new = self._visible()
        if view != self._view or len(old) != len(new):
            self.refresh()
            return
        changed = [y for y, line in enumerate(new) if line != old[y]]
        if changed:
            self.refresh(Region(0, changed[0], self.size.width, changed[-1] + 1 - changed[0]))

    def render_line(self, y: int) -> Strip:
        lines = self._visible()
        return lines[y] if y < len(lines) else Strip.blank(self.size.width, self.rich_style)

    def _visible(self) -> list[Strip]:
        """Return the visible lines, made anew if the view has changed."""
        view = (self.scroll_offset.y, self.size)
        if view != self._view:
            self._view = view
            self._lines = self._make(view[0], view[0] + self.size.height)
        return self._lines

    def _make(self, top: int, bottom: int) -> list[Strip]:
        width, base = self.size.width, self.rich_style
        looks = {name: self.get_component_rich_style(name) for name in self.COMPONENT_CLASSES}
        if not len(self._rows):
            hint = [Segment("   ", base), Segment(self._hint, looks["quiet"])]
            return [Strip.blank(width, base), Strip(hint).adjust_cell_length(width, base)]
        painter = _Painter(
            looks, base, self._now, self._frames, int(self._rows["count"].max()), width >= _WIDE
        )
        first = int(np.searchsorted(self._ends, top, "right"))
        last = int(np.searchsorted(self._ends, bottom, "left")) + 1
        rows = self._rows[first:last]
        lines: list[list[Segment]] = []
        for line, under in zip(_values(rows, self._now), self._under(rows, width), strict=True):
            lines += [painter.segments(line), *map(painter.signals, under)]
        begin = top - (int(self._ends[first - 1]) if first else 0)
        return [
            Strip(line).adjust_cell_length(width, base)
            for line in lines[begin : begin + bottom - top]
        ]

    def _under(self, rows: RowArray, width: int) -> Iterator[list[Line]]:
        """Yield the lines of signals under rows."""
        if self._signals is None:
            yield from ([] for _ in rows)
        else:
            yield from self._signals.lines(rows, width)


def _values(rows: RowArray, now: int) -> Iterator["_Row"]:
    """Yield rows as values of Python."""
    levels = np.zeros((len(rows), 8), np.int8)
    for since in (NO_TIME, now - _FADING_NS, now - _FRESH_NS):
        levels += rows["changed"] > since
    names = ("id", "ext", "rtr", "err", "dlc", "count", "ts", "period", "jitter", "rate", "data")
    columns = [rows[name].tolist() for name in names]
    for values in zip(*columns, levels.tolist(), strict=True):
        yield _Row(*values)


class _Row(NamedTuple):
    """A row of the table as values of Python."""

    id: int
    ext: bool
    rtr: bool
    err: bool
    dlc: int
    frames: int
    ts: int
    period: float
    jitter: float
    rate: float
    data: list[int]
    levels: list[int]  # for each byte the index of its style in _BYTES


class _Painter(NamedTuple):
    """Make rows into coloured text."""

    looks: dict[str, Style]
    base: Style
    now: int
    frames: int  # of all rows
    most: int  # frames of the row with the most frames
    wide: bool

    def segments(self, row: _Row) -> list[Segment]:
        """Return the text of a row, in few segments: the time to draw depends on their number."""
        age = self.now - row.ts if row.ts != NO_TIME else 0
        quiet = age > _S_NS and (math.isnan(row.period) or age > _QUIET_PERIODS * row.period)
        number = self.looks["quiet" if quiet else "number"]
        name = f"{row.id:08X}" if row.ext or row.err else f"{row.id:03X}"
        rate = "-" if math.isnan(row.rate) else f"{row.rate:,.1f}"
        figures = (
            (_KIND, "E" if row.err else "R" if row.rtr else ""),
            (_COUNT, _count(row.frames)),
            (_PERIOD, _milliseconds(row.period, 2)),
            (_JITTER, _milliseconds(row.jitter, 3)),
            *(((_RATE, rate),) if self.wide else ()),
            (_DLC, str(row.dlc)),
        )
        return [
            Segment(
                name.rjust(_ID.width),
                self.looks["error" if row.err else "quiet" if quiet else "id"],
            ),
            Segment("".join(text.rjust(column.width) for column, text in figures) + "  ", number),
            *self._data(row),
            Segment(f"{_ascii(row) if self.wide else ''}{_age(age):>{_SEEN.width}}", number),
            *(self._share(row, number) if self.wide else ()),
        ]

    def signals(self, line: Line) -> list[Segment]:
        """Return the text of a line of signals."""
        title = " " * INDENT + line.title
        found = [Segment(title.ljust(line.begin), self.looks["constant"])]
        for name, value, is_new in line.cells:
            width = line.cell - len(name) - 1
            found.append(Segment(f"{name} ", self.looks["constant"]))
            look = self.looks["data" if is_new else "quiet"]
            found.append(Segment(value.ljust(width), look))
        return found

    def _data(self, row: _Row) -> Iterator[Segment]:
        if row.rtr:
            yield Segment("remote request".ljust(24), self.looks["constant"])
            return
        # Neighbouring bytes of the same style make one segment.
        for level, places in groupby(range(row.dlc), row.levels.__getitem__):
            text = " ".join(f"{row.data[at]:02X}" for at in places)
            yield Segment(text, self.looks[_BYTES[level]])
            yield Segment(" ", self.base)
        yield Segment("   " * (8 - row.dlc), self.base)

    def _share(self, row: _Row, number: Style) -> Iterator[Segment]:
        share = f"{row.frames / self.frames:8.1%} "
        room = _SHARE.width - len(share)
        halves = round(2 * room * row.frames / self.most)
        bar = "\u2501" * (halves // 2) + "\u2578" * (halves % 2)
        yield Segment(share, number)
        yield Segment(bar.ljust(room), self.looks["bar"])


def _count(number: int) -> str:
    text = f"{number:,}"
    return text if len(text) < _COUNT.width else str(number)


def _milliseconds(ns: float, digits: int) -> str:
    """Return a time in milliseconds as text, "-" for NaN, which means unknown."""
    if math.isnan(ns):
        return "-"
    text = f"{ns / 1e6:,.{digits}f}"
    return text if len(text) <= 9 else f"{ns / 1e9:,.0f} s"


def _ascii(row: _Row) -> str:
    text = bytes(row.data[: 0 if row.rtr else row.dlc])
    text = bytes(byte if 32 <= byte < 127 else 0x2E for byte in text)
    return f" {text.decode():{_ASCII.width - 1}}"


def _age(ns: int) -> str:
    seconds = ns / 1e9
    if seconds < 1:
        return "now"
    for size, unit in ((60, "s"), (60, "min"), (24, "h")):
        if seconds < size:
            return f"{int(seconds)} {unit}"
        seconds /= size
    return f"{int(seconds)} d"
