"""Frames to signals: the tables of a database, fed with arrays of frames."""

import threading
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canser._checks import instance
from canser._core.arrow import is_shared, shared_empty
from canser._core.signals import GROUP_DTYPE, Routes
from canser._frames import FrameArray, contiguous_frames
from canser.signals.layout import Layout, Page
from canser.signals.named import unknown_name
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

_Columns = npt.NDArray[np.uint64]


class _Part(NamedTuple):
    """A group of a batch: signals of a page that have the same samples."""

    name: str
    page: Page
    plans: list[Plan]
    least_dlc: int
    samples: int


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
            parts = list(self._parts(counts))
            columns = _columns(parts, out)
            self._decode(frames, routes, parts, columns)
        groups = {part.name: _group(part, rows) for part, rows in zip(parts, columns, strict=True)}
        return Signals(groups, self, dict(zip(groups, columns, strict=True)))

    def _parts(self, dlcs: npt.NDArray[np.uint64]) -> Iterator[_Part]:
        """Yield the groups of a batch: those with samples, and all that were selected by name.

        `dlcs` are the frames of each page by their dlc. Signals of a page that need different
        lengths have the same samples as long as no frame is shorter than one of them.
        """
        pages = self._tables.pages
        pages["group_count"] = 0
        # Frames of each page with a dlc, or a longer one.
        counts = np.cumsum(dlcs[:, ::-1], axis=1)[:, ::-1]
        is_selected = self._layout.is_selected
        first = 0
        for number in np.flatnonzero(counts[:, 0] + is_selected).tolist():
            page = self._layout.pages[number]
            parts: dict[int, _Part] = {}
            for least_dlc, plans in page.plans.items():
                samples = int(counts[number, least_dlc])
                if samples in parts:
                    same = parts[samples]
                    parts[samples] = same._replace(plans=same.plans + plans, least_dlc=least_dlc)
                elif samples or is_selected:
                    name = f"{page.name}[dlc>={least_dlc}]" if parts else page.name
                    parts[samples] = _Part(name, page, plans, least_dlc, samples)
            if parts:
                pages["first_group"][number], pages["group_count"][number] = first, len(parts)
                first += len(parts)
                yield from parts.values()

    def _decode(
        self, frames: FrameArray, routes: Routes, parts: list[_Part], columns: list[_Columns]
    ) -> None:
        rows = [
            (rows.ctypes.data, part.samples, part.least_dlc)
            for part, rows in zip(parts, columns, strict=True)
        ]
        groups = np.zeros(len(parts), GROUP_DTYPE)
        for name, values in zip(("ts", "cap", "least_dlc"), zip(*rows, strict=True), strict=False):
            groups[name] = values
        numbers: list[int] = []
        places: list[int] = []
        for place, part in enumerate(parts):
            before = len(numbers)
            for plan in part.plans:
                numbers += range(plan.first, plan.first + len(plan.records))
            places += [place] * (len(numbers) - before)
        signals = self._layout.records[numbers]
        of_group = np.array(places, np.intp)
        counts = np.bincount(of_group, minlength=len(parts))
        groups["signal_count"] = counts
        groups["first_signal"] = np.cumsum(counts) - counts
        # The rows of a group's columns: the times, then the signals.
        steps = np.array([rows.strides[0] for rows in columns], np.uint64)
        row = np.arange(len(signals)) - groups["first_signal"][of_group] + 1
        signals["values"] = groups["ts"][of_group] + row.astype(np.uint64) * steps[of_group]
        self._tables.decode(frames, routes, groups, signals)


def _columns(parts: list[_Part], out: Signals | None) -> list[_Columns]:
    """Return room for the times and the values of each group, a row for each column."""
    used = {} if out is None else out._columns
    found: list[_Columns | None] = []
    shapes = []
    for part in parts:
        count = 1 + sum(len(plan.records) for plan in part.plans)
        shape = count, -(-part.samples // _STEP) * _STEP
        old = used.get(part.name)
        # A table that another program may have must not change.
        if old is not None and (len(old) != count or old.shape[1] < shape[1] or is_shared(old)):
            old = None
        found.append(old)
        shapes.append(shape if old is None else (0, 0))
    new = _room(shapes)
    return [new_one if old is None else old for old, new_one in zip(found, new, strict=True)]


def _room(shapes: list[tuple[int, int]]) -> list[_Columns]:
    """Return arrays of these shapes. Small ones share memory, up to _POOL elements."""
    found: list[_Columns] = []
    pool, at = np.empty(0, np.uint64), 0
    for place, (count, length) in enumerate(shapes):
        size = count * length
        if size > len(pool) - at:
            rest = sum(count * length for count, length in shapes[place:])
            pool, at = shared_empty(max(size, min(rest, _POOL)), np.uint64), 0
        found.append(pool[at : at + size].reshape(count, length))
        at += size
    return found


def _group(part: _Part, columns: _Columns) -> Group:
    ts = columns[0, : part.samples].view("M8[ns]")
    message = part.page.message
    signals, at = {}, 1
    for plan in part.plans:
        arrays = [
            columns[at + i, : part.samples].view(dtype) for i, dtype in enumerate(plan.dtypes)
        ]
        at += len(arrays)
        signals[plan.info.name] = Signal(
            name=plan.info.name,
            message=message.name,
            group=part.name,
            ts=ts,
            values=arrays[0],
            unit=plan.info.unit,
            choices=plan.info.choices,
            raw=None if plan.raw_at is None else arrays[plan.raw_at],
        )
    return Group(part.name, message.name, ts, signals)
