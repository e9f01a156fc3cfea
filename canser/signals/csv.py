"""Signals as comma-separated values: a row for each sample.

    ts,message,signal,value,unit,text
    1631416514.717133,EngineData,RPM,2000.0,rpm,
    1631416514.717133,EngineData,Gear,1,,first

ts in seconds, nan if it is not known; exact, with six decimal places, or nine if the time has
nanoseconds. Values are the shortest numbers that are read back as the same ones.
"""

import csv
import io
from collections.abc import Callable, Sequence
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

from canser._core.text import TextWriter
from canser._frames import FRAME_DTYPE, FrameArray
from canser.signals.decoder import SignalDecoder
from canser.signals.samples import numbered_samples
from canser.signals.signals import Signal

__all__ = ["COLUMNS", "SampleWriter"]

COLUMNS: Final = ("ts", "message", "signal", "value", "unit", "text")

# Frames whose rows are made at a time: 10 MB, if each has some signals.
_FRAMES_AT_ONCE: Final = 1 << 15

# Rows of a signal that are kept, for values that come again.
_KEPT_MOST: Final = 1 << 12


class SampleWriter:
    """Write the signals of frames as rows under a header, in the order of the frames."""

    def __init__(self, file: BinaryIO, decoder: SignalDecoder) -> None:
        self._file, self._decoder = file, decoder
        self._times = _Times()
        self._tails: dict[str, Callable[[Any, Any], bytes]] = {}
        self.count = 0  # samples so far
        file.write(fields(COLUMNS) + b"\n")

    def write(self, frames: FrameArray) -> None:
        """Append the samples of a block."""
        for at in range(0, len(frames), _FRAMES_AT_ONCE):
            part = frames[at : at + _FRAMES_AT_ONCE]
            samples = numbered_samples(self._decoder, part)
            cells = np.empty(2 * samples.total, object)
            counts = np.diff(samples.ends, prepend=0)
            is_used = counts > 0
            cells[::2] = np.repeat(self._times.texts(part["ts"][is_used]), counts[is_used])
            cells[1::2] = samples.texts(self._tail_of)
            self._file.write(b"".join(cells.tolist()))
            self.count += samples.total

    def _tail_of(self, signal: Signal) -> Callable[[Any, Any], bytes]:
        """Return the function that makes the row of a sample behind its time."""
        if signal.full_name not in self._tails:
            self._tails[signal.full_name] = _make_tail(signal)
        return self._tails[signal.full_name]


def _make_tail(signal: Signal) -> Callable[[Any, Any], bytes]:
    head = b"," + fields([signal.message, signal.name]) + b","
    unit = b"," + fields([signal.unit, ""])
    texts = {raw: fields([text]) for raw, text in (signal.choices or {}).items()}
    ends = {raw: unit + text + b"\n" for raw, text in texts.items()}
    end = unit + b"\n"
    made: dict[Any, bytes] = {}

    def tail(value: Any, raw: Any) -> bytes:
        found = made.get(raw)
        # -0.0 equals 0.0, and NaN equals nothing.
        if found is None or not raw:
            found = b"%b%b%b" % (head, repr(value).encode(), ends.get(raw, end))
            if len(made) < _KEPT_MOST:
                made[raw] = found
        return found

    return tail


def fields(values: Sequence[str]) -> bytes:
    """Return texts as the fields of a row, quoted where needed."""
    row = io.StringIO()
    csv.writer(row, lineterminator="").writerow(values)
    return row.getvalue().encode() if values != [""] else b""


class _Times:
    """Makes texts of times as the other files of comma-separated values have them."""

    def __init__(self) -> None:
        self._lines = TextWriter("csv")

    def texts(self, ts: npt.NDArray[np.int64]) -> npt.NDArray[np.object_]:
        """Return times in seconds."""
        frames = np.zeros(len(ts), FRAME_DTYPE)
        frames["ts"] = ts
        made = np.empty(len(ts), object)
        at = 0
        for part in self._lines.lines(frames, None, None):
            rows = bytes(part).splitlines()
            made[at : at + len(rows)] = [row[: row.index(b",")] for row in rows]
            at += len(rows)
        return made
