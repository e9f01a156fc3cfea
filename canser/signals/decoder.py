"""Frames to signals: the tables of a database, fed with arrays of frames."""

import threading
from collections.abc import Sequence
from typing import Final

import numpy as np

from canser._checks import instance
from canser._core.arrow import is_shared, shared_empty
from canser._frames import FrameArray, contiguous_frames
from canser.signals.layout import Layout
from canser.signals.named import Made, unknown_name
from canser.signals.parts import Columns, Part
from canser.signals.plans import Plan
from canser.signals.report import DecodeReport, make_report
from canser.signals.signal import Signal
from canser.signals.signals import Group, Signals

__all__ = ["SignalDecoder"]

# Columns begin at multiples of these elements of 8 bytes.
_STEP: Final = 8

# Elements of arrays that are made together, 16 MiB: large enough that the system gives it in large
# pages, and small enough that it may be kept by one signal that is still in use.
_POOL: Final = 1 << 21


class SignalDecoder:
    """Decodes batches of frames; made by `Database.decoder`."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._tables = layout.tables()
        self._frame_count = 0
        # Two threads may not count at the same time.
        self._lock = threading.Lock()

    @property
    def report(self) -> DecodeReport:
        """What was decoded of all batches, and what was not, and why."""
        with self._lock:
            return make_report(
                self._layout.messages, self._layout.roots, self._tables, self._frame_count
            )

    def why_absent(self, name: str) -> str:
        """Return why a signal has no samples.

        Parameters
        ----------
        name : str
            The signal: "Message.Signal" or "Signal".

        Returns
        -------
        str
            A line, for a name that the database does not have, too.
        """
        names = []
        for message in self._layout.messages:
            for signal in message.signals:
                names.append(f"{message.name}.{signal}")
                if name not in (signal, f"{message.name}.{signal}"):
                    continue
                what = f"{message.name}.{signal} has no samples"
                seen = self.report.messages.get(message.name, 0)
                if not seen:
                    return f"{what}: no frame of the message was seen, id {message.id:X}"
                return f"{what} in {seen:,} frames of its message: see the report"
        return unknown_name(name, "signal", names)

    def feed(self, frames: FrameArray, *, out: Signals | None = None) -> Signals:
        """Decode a batch of frames.

        Parameters
        ----------
        frames : array of FRAME_DTYPE, shape (n,)
            The frames, contiguous or not.
        out : Signals, optional
            What an earlier call returned: its arrays are used again where they are large enough,
            so they change. By default all arrays are new.

        Returns
        -------
        Signals
            The signals of this batch. Its report is that of all batches so far.

        Raises
        ------
        TypeError
            `frames` is no array of FRAME_DTYPE, or `out` is no Signals.
        """
        frames = contiguous_frames(frames)
        if out is not None:
            instance(out, "out", Signals)
        with self._lock:
            routes, counts = self._tables.count(frames)
            self._frame_count += len(frames)
            parts, samples = self._layout.parts(counts)
            columns = _columns(parts.parts, samples.tolist(), out)
            self._tables.pages["first_group"] = parts.first_group
            self._tables.pages["group_count"] = parts.group_count
            self._tables.decode(frames, routes, *parts.tables(columns, samples))
        groups = {
            part.name: _group(part, rows[:, :count])
            for part, rows, count in zip(parts.parts, columns, samples.tolist(), strict=True)
        }
        by_group = dict(zip(groups, columns, strict=True))
        return Signals(groups, self, by_group, parts.places)


def _columns(parts: Sequence[Part], samples: list[int], out: Signals | None) -> list[Columns]:
    """Return room for the times and the values of each group, a row for each column."""
    used = {} if out is None else out._columns
    found: list[Columns | None] = []
    shapes = []
    for part, count in zip(parts, samples, strict=True):
        shape = part.column_count, -(-count // _STEP) * _STEP
        old = used.get(part.name)
        # A table that another program may have must not change.
        if old is not None and (len(old) != shape[0] or old.shape[1] < shape[1] or is_shared(old)):
            old = None
        found.append(old)
        shapes.append(shape if old is None else (0, 0))
    new = _room(shapes)
    return [new_one if old is None else old for old, new_one in zip(found, new, strict=True)]


def _room(shapes: list[tuple[int, int]]) -> list[Columns]:
    """Return arrays of these shapes. Small ones share memory, up to _POOL elements."""
    found: list[Columns] = []
    pool, at = np.empty(0, np.uint64), 0
    for place, (count, length) in enumerate(shapes):
        size = count * length
        if size > len(pool) - at:
            rest = sum(count * length for count, length in shapes[place:])
            pool, at = shared_empty(max(size, min(rest, _POOL)), np.uint64), 0
        found.append(pool[at : at + size].reshape(count, length))
        at += size
    return found


def _group(part: Part, columns: Columns) -> Group:
    ts = columns[0].view("M8[ns]")

    def make(place: tuple[Plan, int]) -> Signal:
        plan, at = place
        arrays = [columns[at + i].view(dtype) for i, dtype in enumerate(plan.dtypes)]
        return Signal(
            name=plan.info.name,
            message=part.message,
            group=part.name,
            ts=ts,
            values=arrays[0],
            unit=plan.info.unit,
            choices=plan.info.choices,
            raw=None if plan.raw_at is None else arrays[plan.raw_at],
        )

    return Group(part.name, part.message, ts, Made(part.plans, make))
