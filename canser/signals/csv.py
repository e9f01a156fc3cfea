"""Signals as comma-separated values: a row for each sample, or one for each time of a grid.

    ts,message,signal,value,unit,text
    1631416514.717133,EngineData,RPM,2000.0,rpm,
    1631416514.717133,EngineData,Gear,1,,first

ts in seconds, nan if it is not known; exact, with six decimal places, or nine if the time has
nanoseconds. Values are the shortest numbers that are read back as the same ones.

    ts,EngineData.RPM,EngineData.Gear
    1631416514.710000,,
    1631416514.720000,2000.0,first

On a grid, a signal with texts has its text, or its number where that has none; and nothing where it
has no value.
"""

import csv
import dataclasses
import io
from collections.abc import Callable, Sequence
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

from canser._core.text import TextWriter
from canser._frames import FRAME_DTYPE, FrameArray
from canser.signals.decoder import SignalDecoder
from canser.signals.samples import numbered_samples, sample_texts
from canser.signals.signal import Signal
from canser.signals.signals import Resampled

__all__ = ["COLUMNS", "SampleWriter", "write_grid"]

COLUMNS: Final = ("ts", "message", "signal", "value", "unit", "text")

# Frames, or times of a grid, whose rows are made at a time: 10 MB, if each has some signals.
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

    def finish(self) -> None:
        """End the file: nothing is left to write."""

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


def write_grid(file: BinaryIO, grid: Resampled) -> None:
    """Write signals on one time base under a header, a row for each time."""
    times = _Times()
    file.write(fields(["ts", *grid]) + b"\n")
    for at in range(0, len(grid.ts), _FRAMES_AT_ONCE):
        part = slice(at, at + _FRAMES_AT_ONCE)
        stamps = times.texts(grid.ts[part].view(np.int64))
        cells = np.empty((len(stamps), 2 * len(grid) + 2), object)
        cells[:, 0], cells[:, 1::2], cells[:, -1] = stamps, b",", b"\n"
        for place, signal in enumerate(grid.values(), 1):
            cells[:, 2 * place] = _cells(signal, part)
        file.write(b"".join(cells.ravel().tolist()))


def _cells(signal: Signal, part: slice) -> npt.NDArray[np.object_]:
    """Return some values of a signal as fields."""
    raw = None if signal.raw is None else signal.raw[part]
    shown = dataclasses.replace(signal, values=signal.values[part], raw=raw)
    texts = {number: fields([text]) for number, text in (signal.choices or {}).items()}
    found = sample_texts(shown, lambda value, raw: texts.get(raw) or repr(value).encode())
    if signal.valid is not None:
        found[~signal.valid[part]] = b""
    return found


class _Times:
    """Makes texts of times as the other files of comma-separated values have them."""

    def __init__(self) -> None:
        self._lines = TextWriter("csv")

    def texts(self, ts: npt.NDArray[np.int64]) -> npt.NDArray[np.object_]:
        """Return times in seconds."""
        frames = np.zeros(len(ts), FRAME_DTYPE)
        frames["ts"] = ts
        texts: list[bytes] = []
        for part in self._lines.lines(frames, None, None):
            data = bytes(part)
            # Behind the time all lines are the same.
            rest = data[data.index(b",") : data.index(b"\n") + 1]
            texts += data.split(rest)[:-1]
        made = np.empty(len(ts), object)
        made[:] = texts
        return made
