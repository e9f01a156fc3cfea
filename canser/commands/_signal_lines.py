"""Frames as lines of candump, with the signals of each frame under it."""

import os
import sys
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np

from canser._frames import FrameArray
from canser.signals.database import Database
from canser.signals.decoder import SignalDecoder
from canser.signals.samples import numbered_samples
from canser.signals.signal import Signal
from canser.signals.texts import value_text

__all__ = ["SignalLines", "terminal_columns"]

# Before the signals of a frame: with the # of a comment, the lines still are a log of candump.
_INDENT: Final = "    # "


class SignalLines:
    """Puts the signals of frames under their lines: `    # EngineData: RPM 2000 rpm, Gear first`.

    `columns`: the width in which lines are broken, None for lines of any length.
    """

    def __init__(self, database: Database, decoder: SignalDecoder, columns: int | None) -> None:
        self._messages, self._decoder = database.messages, decoder
        self._columns = columns

    def under(self, lines: bytes, frames: FrameArray) -> bytes:
        """Return the lines of frames, one for each, and under each one its signals."""
        samples = numbered_samples(self._decoder, frames)
        texts = samples.texts(self._text_of).tolist()
        messages = np.empty(samples.total, object)
        for signal, places in samples.signals:
            messages[places] = signal.message
        found = []
        begin = 0
        for line, end in zip(lines.splitlines(), samples.ends.tolist(), strict=True):
            found.append(line)
            if end > begin:
                found += self._lines(messages[begin], texts[begin:end])
            begin = end
        return b"".join(each + b"\n" for each in found)

    def _text_of(self, signal: Signal) -> Callable[[Any, Any], str]:
        info = self._messages[signal.message].signals[signal.name]
        return lambda value, raw: f"{info.name} {value_text(value, raw, info)}"

    def _lines(self, message: str, texts: list[str]) -> Iterator[bytes]:
        """Yield the lines of the signals of a frame."""
        line = f"{_INDENT}{message}: {texts[0]}"
        for text in texts[1:]:
            if self._columns is None or len(line) + 3 + len(text) < self._columns:
                line += f", {text}"
            else:
                yield f"{line},".encode()
                line = f"{_INDENT}  {text}"
        yield line.encode()


def terminal_columns() -> int | None:
    """Return the width of the terminal that is the standard output; None if it is none."""
    if sys.stdout is None or not sys.stdout.isatty():
        return None
    try:
        return os.get_terminal_size(sys.stdout.fileno()).columns or None
    except OSError:
        return None
