"""What signals are in frames: the samples of each, its first and last value, and its range."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from canser._frames import FrameArray
from canser.analysis.plain import to_plain
from canser.files.tags import printable
from canser.signals.database import Database
from canser.signals.decoder import SignalDecoder
from canser.signals.messages import SignalInfo
from canser.signals.signal import Signal
from canser.signals.signals import Signals
from canser.signals.texts import choice_text, number_text

__all__ = ["Summary"]

_HEAD: Final = ("signal", "unit", "samples", "first", "min", "max", "last")

# The columns of numbers, which are aligned at the right.
_RIGHT: Final = _HEAD[2:]
# The longest text of a value in a table.
_TEXT_MOST: Final = 16


class _Range:
    """The samples of a signal: their number, and some, as pairs of the value and the raw value."""

    def __init__(self, signal: Signal, info: SignalInfo) -> None:
        self.name, self.message, self.info = signal.name, signal.message, info
        self.count = 0
        self.picked: dict[str, tuple[Any, Any]] = {}

    def add(self, signal: Signal) -> None:
        """Add the samples of a block."""
        values = signal.values
        if not len(values):
            return
        self.count += len(values)
        raw = values if signal.raw is None else signal.raw
        self.picked.setdefault("first", (values[0].item(), raw[0].item()))
        self.picked["last"] = values[-1].item(), raw[-1].item()
        if values.dtype.kind == "f":
            is_number = ~np.isnan(values)
            values, raw = values[is_number], raw[is_number]
        if not len(values):
            return
        for name, at in (("min", values.argmin()), ("max", values.argmax())):
            found, before = values[at].item(), self.picked.get(name)
            if before is None or (found < before[0] if name == "min" else found > before[0]):
                self.picked[name] = found, raw[at].item()

    def cells(self) -> list[str]:
        """Return the row of a table."""
        texts = []
        for name in _HEAD[3:]:
            value, raw = self.picked.get(name, (None, None))
            text = choice_text(self.info.choices, raw)
            number = "-" if value is None else number_text(value, self.info)
            texts.append(number if text is None else _cut(printable(text)))
        unit = printable(self.info.unit) if self.info.unit else ""
        return [f"{self.message}.{self.name}", unit, f"{self.count:,}", *texts]

    def as_dict(self) -> dict[str, Any]:
        """Return all as values that JSON has."""
        found = {"message": self.message, "signal": self.name, "unit": self.info.unit}
        plain: dict[str, Any] = found | {"samples": self.count}
        for name in _HEAD[3:]:
            value, raw = self.picked.get(name, (None, None))
            # JSON has no NaN, and no infinity.
            plain[name] = value if value is None or np.isfinite(value) else None
            plain[f"{name}_text"] = choice_text(self.info.choices, raw)
        return plain


def _cut(text: str) -> str:
    return text if len(text) <= _TEXT_MOST else f"{text[: _TEXT_MOST - 3]}..."


class Summary:
    """The signals of the frames that were added."""

    def __init__(self, database: Database, decoder: SignalDecoder) -> None:
        self._messages, self._decoder = database.messages, decoder
        self._ranges: dict[str, _Range] = {}
        self._room: Signals | None = None  # arrays that are used again

    def add(self, frames: FrameArray) -> None:
        """Add a block of frames."""
        self._room = self._decoder.feed(frames, out=self._room)
        for name, signal in self._room.items():
            if name not in self._ranges:
                info = self._messages[signal.message].signals[signal.name]
                self._ranges[name] = _Range(signal, info)
            self._ranges[name].add(signal)

    def lines(self) -> Iterator[str]:
        """Yield the text line by line."""
        yield from str(self._decoder.report).splitlines()
        if not self._ranges:
            return
        rows = [list(_HEAD), *(each.cells() for each in self._sorted())]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        yield ""
        for row in rows:
            cells = (
                cell.rjust(width) if name in _RIGHT else cell.ljust(width)
                for name, cell, width in zip(_HEAD, row, widths, strict=True)
            )
            yield "  ".join(cells).rstrip()

    def _sorted(self) -> list[_Range]:
        """Return the signals as the database has them: by their messages."""
        places = {name: at for at, name in enumerate(self._messages)}
        return sorted(self._ranges.values(), key=lambda each: places[each.message])

    def as_dict(self) -> dict[str, Any]:
        """Return all as values that JSON has."""
        report = to_plain(self._decoder.report)
        return {"report": report, "signals": [each.as_dict() for each in self._sorted()]}
