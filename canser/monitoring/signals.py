"""The signals under the rows of a live table: decoded for the rows on the screen only."""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canser._frames import FRAME_DTYPE
from canser.monitoring.livetable import RowArray, choose, terms
from canser.signals.database import Database
from canser.signals.decoder import SignalDecoder
from canser.signals.messages import Message, SignalInfo
from canser.signals.texts import value_text

__all__ = ["Cell", "RowSignals"]

# Blanks before the name of the message, so that it stands right of the id.
INDENT: Final = 11

# Widths in characters: between two signals, and of values until a longer one comes.
_GAP: Final = 3
_VALUE_LEAST: Final = 6


class Cell(NamedTuple):
    """A signal as it is shown."""

    name: str
    value: str
    #: Whether the last frame has it. Otherwise it is on another page, and was seen before.
    is_new: bool


class _Layout(NamedTuple):
    """Where signals begin, the lines above them, and how many a line has, of which width."""

    begin: int
    above: int
    in_line: int
    width: int


class _Row:
    """The signals of a row."""

    def __init__(self, message: Message, infos: Sequence[SignalInfo]) -> None:
        self.message, self._infos = message, infos
        self._names = [message.name.lower(), *(info.name.lower() for info in infos)]
        self._values: dict[str, str] = {}
        self._new: set[str] = set()
        # The widest signal so far: so the others stay where they are when a value gets shorter.
        self._width = max((len(info.name) for info in infos), default=0) + _VALUE_LEAST

    def has(self, text: str) -> bool:
        """Return whether the name of the message or of a signal has a text in it."""
        return any(text in name for name in self._names)

    def set(self, values: dict[str, str]) -> None:
        """Set the values that the last frame has."""
        self._values |= values
        self._new = set(values)
        for name, value in values.items():
            self._width = max(self._width, len(name) + 1 + len(value))

    def cells(self) -> list[Cell]:
        """Return the signals; those of pages only after they have come."""
        return [
            Cell(info.name, self._values.get(info.name, "-"), info.name in self._new)
            for info in self._infos
            if not info.pages or info.name in self._values
        ]

    def _count(self) -> int:
        return sum(not info.pages or info.name in self._values for info in self._infos)

    def layout(self, room: int) -> _Layout:
        """Return the layout of the fewest lines in this width: beside the message, or below it."""
        count, width = self._count(), self._width + _GAP
        layouts = []
        for begin, above in ((INDENT + len(self.message.name) + _GAP, 0), (INDENT + 2, 1)):
            in_line = max((room - begin + _GAP) // width, 1)
            layouts.append((above + -(-count // in_line), _Layout(begin, above, in_line, width)))
        return min(layouts, key=lambda each: each[0])[1]

    def line_count(self, room: int) -> int:
        """Return the number of lines."""
        layout = self.layout(room)
        return layout.above + -(-self._count() // layout.in_line)


class Line(NamedTuple):
    """A line of signals: the place of the first one, the width of each, and a title before it."""

    title: str
    begin: int
    cell: int
    cells: list[Cell]


class RowSignals:
    """Finds the messages of rows, and decodes their last frames.

    Signals of pages are kept when they were seen, so that lines do not come and go.
    """

    def __init__(self, database: Database, decoder: SignalDecoder) -> None:
        self._messages, self._decoder = database.messages, decoder
        self._finder = database.decoder()
        # Selected signals are always there, also without a sample.
        self._selected = set(decoder.feed(np.zeros(0, FRAME_DTYPE)))
        names = (name for message in self._messages.values() for name in message.signals)
        self._names = {name.lower() for name in (*self._messages, *names)}
        self._rows: dict[tuple[int, bool], _Row | None] = {}

    def clear(self) -> None:
        """Forget the values."""
        self._rows.clear()

    def line_counts(self, rows: RowArray, width: int) -> npt.NDArray[np.int64]:
        """Return the number of lines under each row."""
        counts = [0 if row is None else row.line_count(width) for row in self._found(rows)]
        return np.array(counts, np.int64)

    def choose(self, rows: RowArray, text: str) -> npt.NDArray[np.bool_]:
        """Mark the rows that match a filter: as `livetable.choose`, or by a part of a name.

        The name is that of the message, or of one of its signals. ValueError for a filter that is
        neither.
        """
        passed = np.full(len(rows), not terms(text))
        for term in terms(text):
            passed |= self._named(rows, term.lower())
            try:
                passed |= choose(rows, term)
            except ValueError:
                if not any(term.lower() in name for name in self._names):
                    raise
        return passed

    def _named(self, rows: RowArray, text: str) -> npt.NDArray[np.bool_]:
        found = [row is not None and row.has(text) for row in self._found(rows)]
        return np.array(found, np.bool_)

    def lines(self, rows: RowArray, width: int) -> Iterator[list[Line]]:
        """Decode the frames of some rows; yield the lines of each."""
        found = self._found(rows)
        values: list[dict[str, str]] = [{} for _ in found]
        for signal in self._decoder.feed(_numbered(rows)).values():
            info = self._messages[signal.message].signals[signal.name]
            raw = signal.values if signal.raw is None else signal.raw
            for at, value, code in zip(
                signal.ts.view(np.int64).tolist(), signal.values.tolist(), raw.tolist(), strict=True
            ):
                values[at][signal.name] = value_text(value, code, info)
        for row, new in zip(found, values, strict=True):
            if row is None:
                yield []
                continue
            row.set(new)
            yield list(_lines(row, width))

    def _found(self, rows: RowArray) -> list[_Row | None]:
        """Return the signals of each row, None for a row of no message."""
        keys = list(zip(rows["id"].tolist(), rows["ext"].tolist(), strict=True))
        new = [at for at, key in enumerate(keys) if key not in self._rows]
        if new:
            self._find(rows.take(new), [keys[at] for at in new])
        is_data = ~(rows["rtr"] | rows["err"])
        return [
            self._rows[key] if has_data else None
            for key, has_data in zip(keys, is_data.tolist(), strict=True)
        ]

    def _find(self, rows: RowArray, keys: list[tuple[int, bool]]) -> None:
        frames = _numbered(rows)
        # As long as can be, so that a signal is found.
        frames["rtr"] = frames["err"] = False
        frames["dlc"], frames["data"] = 8, 0
        self._rows |= dict.fromkeys(keys)
        for group in self._finder.feed(frames).groups.values():
            message = self._messages[group.message]
            infos = [
                info
                for info in message.signals.values()
                if not self._selected or f"{message.name}.{info.name}" in self._selected
            ]
            for at in group.ts.view(np.int64).tolist() if infos else []:
                self._rows[keys[at]] = _Row(message, infos)


def _numbered(rows: RowArray) -> npt.NDArray[np.void]:
    """Return the last frames of rows, whose times are their numbers."""
    frames = np.zeros(len(rows), FRAME_DTYPE)
    for name in FRAME_DTYPE.names or ():
        frames[name] = rows[name]
    frames["ts"] = np.arange(len(rows))
    return frames


def _lines(row: _Row, room: int) -> Iterator[Line]:
    layout, cells, name = row.layout(room), row.cells(), row.message.name
    if layout.above:
        yield Line(name, layout.begin, layout.width, [])
    for at in range(0, len(cells), layout.in_line):
        title = name if at == 0 and not layout.above else ""
        yield Line(title, layout.begin, layout.width, cells[at : at + layout.in_line])
