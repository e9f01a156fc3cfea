"""Messages as the tables that C decodes by: pages, multiplexers, fields."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canser._core.signals import (
    CASE_DTYPE,
    KNOWN_ID_DTYPE,
    MUX_DEPTH,
    MUX_DTYPE,
    NO_TABLE,
    PAGE_DTYPE,
    PGN_DTYPE,
    SIGNAL_DTYPE,
    SignalTables,
    find_spread,
)
from canser.signals.messages import Message, SignalInfo
from canser.signals.parts import Part, Parts
from canser.signals.plans import Plan, Record, field_of, plan_of

__all__ = ["Layout", "Page"]

_TABLE_LEN: Final = 256

_Records = npt.NDArray[np.void]


class Page(NamedTuple):
    """Signals that are selected together, by their least dlc."""

    name: str
    message: Message
    plans: dict[int, list[Plan]]


class Layout:
    """All messages as tables.

    `selected`: the full names of the signals that are decoded; None: all. `keeps_raw`: whether raw
    numbers are kept of all signals.
    """

    def __init__(
        self, messages: Sequence[Message], *, selected: frozenset[str] | None, keeps_raw: bool
    ) -> None:
        self.messages = messages
        self.pages: list[Page] = []
        #: Whether signals were selected by name.
        self.is_selected = selected is not None
        self._selected, self._keeps_raw = selected, keeps_raw
        self._records: list[Record] = []
        self._page_records: list[tuple[int, int, int]] = []
        self._muxes: list[tuple[Any, ...]] = []
        self._cases: list[tuple[int, int, int, int]] = []
        self._links: list[int] = []
        self._tables: list[npt.NDArray[np.uint16]] = []
        #: The number of the first page of each message.
        self.roots = [self._add_message(message) for message in messages]
        #: Records of all signals that are decoded, of SIGNAL_DTYPE.
        self.records = np.array(self._records, SIGNAL_DTYPE)
        self._arrays = self._make_arrays()
        #: Each page, and each of its least dlcs, the smallest first.
        steps = [(number, dlc) for number, page in enumerate(self.pages) for dlc in page.plans]
        self._step_pages, self._step_dlcs = np.array(steps, np.intp).reshape(-1, 2).T
        self._last_parts: tuple[bytes, Parts] | None = None
        self._spread = find_spread(self._arrays["ids"]["key"])

    def tables(self) -> SignalTables:
        """Return new tables, in which nothing is counted yet."""
        return SignalTables(**self._arrays, spread=self._spread)

    def parts(self, dlcs: npt.NDArray[np.uint64]) -> tuple[Parts, npt.NDArray[np.uint64]]:
        """Return the groups of a batch, those with samples and all that were selected by name.

        The second result are their samples. `dlcs` are the frames of each page by their dlc.
        Signals of a page that need different lengths have the same samples as long as no frame is
        shorter than one of them.
        """
        # Frames of each page with a dlc, or a longer one; of those that the signals need.
        counts = np.cumsum(dlcs[:, ::-1], axis=1)[:, ::-1][self._step_pages, self._step_dlcs]
        is_first = np.ones(len(counts), np.bool_)
        is_first[1:] = (np.diff(self._step_pages) > 0) | (counts[1:] != counts[:-1])
        is_there = (counts > 0) | self.is_selected
        key = is_first.tobytes() + is_there.tobytes()
        last = self._last_parts
        if last is None or last[0] != key:  # they are mostly those of the batch before
            self._last_parts = last = key, self._make_parts(is_first, is_there)
        return last[1], counts[is_first & is_there]

    def _make_parts(
        self, is_first: npt.NDArray[np.bool_], is_there: npt.NDArray[np.bool_]
    ) -> Parts:
        """Return groups: one begins where `is_first` of a least dlc of a page is true."""
        parts: list[Part] = []
        first_group = np.zeros(len(self.pages), np.uint32)
        group_count = np.zeros(len(self.pages), np.uint32)
        numbers = np.cumsum(is_first)
        for number in np.unique(numbers[is_there]).tolist():
            steps = np.flatnonzero(numbers == number)
            place = int(self._step_pages[steps[0]])
            page = self.pages[place]
            least = self._step_dlcs[steps].tolist()
            name = f"{page.name}[dlc>={least[0]}]" if group_count[place] else page.name
            plans = [plan for dlc in least for plan in page.plans[dlc]]
            if not group_count[place]:
                first_group[place] = len(parts)
            group_count[place] += 1
            parts.append(Part.of(name, page.message.name, plans))
        return Parts(parts, self.records, first_group, group_count)

    def _make_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the tables that SignalTables takes."""
        pages = np.zeros(len(self.pages), PAGE_DTYPE)
        names = ("first_mux", "mux_count", "full_dlc")
        for name, values in zip(names, np.array(self._page_records).T, strict=bool(self.pages)):
            pages[name] = values
        ids = np.zeros(len(self.messages), KNOWN_ID_DTYPE)
        ids["key"] = [message.id | message.ext << 31 for message in self.messages]
        ids["page"] = np.array(self.roots) + 1
        return {
            "ids": ids,
            "pgns": self._pgns(),
            "pages": pages,
            "muxes": np.array(self._muxes, MUX_DTYPE),
            "cases": np.array(self._cases, CASE_DTYPE),
            "links": np.array(self._links, np.uint32),
            "tables": np.concatenate([np.zeros(0, np.uint16), *self._tables]),
        }

    def _pgns(self) -> _Records:
        """Return the parameter groups that one message has.

        If several messages have the same one, it belongs to the one of any sender. Without that,
        each is found by its own id only.
        """
        groups: dict[int, list[int]] = {}
        for number, message in enumerate(self.messages):
            if message.pgn is not None:
                groups.setdefault(message.pgn, []).append(number)
        found = []
        for pgn, numbers in sorted(groups.items()):
            general = [each for each in numbers if self.messages[each].is_of_any_sender]
            chosen = general if len(numbers) > 1 else numbers
            if len(chosen) == 1:
                found.append((pgn, self.roots[chosen[0]]))
        return np.array(found, PGN_DTYPE)

    def _add_message(self, message: Message) -> int:
        below: dict[str | None, list[SignalInfo]] = {}
        for signal in message.signals.values():
            below.setdefault(signal.multiplexer if signal.pages else None, []).append(signal)
        return self._add_page(message, message.name, below.get(None, []), below, MUX_DEPTH)

    def _add_page(
        self,
        message: Message,
        name: str,
        signals: list[SignalInfo],
        below: Mapping[str | None, list[SignalInfo]],
        depth: int,
    ) -> int:
        """Add a page of these signals, and the pages that they select; return its number.

        `below` are the signals that each multiplexer selects.
        """
        number = len(self.pages)
        plans: dict[int, list[Plan]] = {}
        for signal in signals:
            if self._selected is None or f"{message.name}.{signal.name}" in self._selected:
                plan = plan_of(signal, len(self._records), keeps_raw=self._keeps_raw)
                self._records += plan.records
                plans.setdefault(plan.least_dlc, []).append(plan)
        self.pages.append(Page(name, message, dict(sorted(plans.items()))))
        self._page_records.append((0, 0, 0))
        muxes = [
            each
            for each in signals
            if each.is_multiplexer and (below.get(each.name) or each.choices)
        ]
        if muxes and not depth:
            raise ValueError(
                f"message {message.name}: multiplexers lie more than {MUX_DEPTH} deep, or select "
                "each other"
            )
        records = [self._mux(message, name, mux, below, depth - 1) for mux in muxes]
        full = max((-(-each.last_bit // 8) for each in signals), default=0)
        self._page_records[number] = (len(self._muxes), len(records), full)
        self._muxes += records
        return number

    def _mux(
        self,
        message: Message,
        name: str,
        mux: SignalInfo,
        below: Mapping[str | None, list[SignalInfo]],
        depth: int,
    ) -> tuple[Any, ...]:
        """Add the pages of a multiplexer, and return its record."""
        parts: dict[tuple[int, ...], list[SignalInfo]] = {}
        for signal in below.get(mux.name, ()):
            parts.setdefault(signal.pages, []).append(signal)
        by_value: dict[int, list[int]] = {}
        for values, signals in parts.items():
            label = f"{name}[{mux.name}={_ranges(values)}]"
            number = self._add_page(message, label, signals, below, depth)
            for value in values:
                by_value.setdefault(value, []).append(number)
        # A value with a text is known, though it selects nothing.
        for value in mux.choices or ():
            by_value.setdefault(value % 2**64, [])
        first = len(self._cases)
        cases = list(_cases(by_value))
        for low, high, numbers in cases:
            self._cases.append((low, high, len(self._links), len(numbers)))
            self._links += numbers
        table = NO_TABLE
        if mux.bit_count <= 8 and not mux.is_signed and len(cases) < 2**16:
            table = _TABLE_LEN * len(self._tables)
            by_number = np.zeros(_TABLE_LEN, np.uint16)
            for case, (low, high, _) in enumerate(cases):
                by_number[low : min(high, _TABLE_LEN - 1) + 1] = case + 1
            self._tables.append(by_number)
        return field_of(mux), -(-mux.last_bit // 8), first, len(cases), table


def _cases(by_value: Mapping[int, list[int]]) -> Iterator[tuple[int, int, list[int]]]:
    """Yield ranges of neighbouring values that select the same pages."""
    low = high = -1
    pages: list[int] = []
    for value in sorted(by_value):
        if low >= 0 and value == high + 1 and by_value[value] == pages:
            high = value
            continue
        if low >= 0:
            yield low, high, pages
        low = high = value
        pages = by_value[value]
    if low >= 0:
        yield low, high, pages


def _ranges(values: Sequence[int]) -> str:
    """Write numbers in their order, neighbours as ranges: "1-3,9"."""
    shown = []
    for low, high, _ in _cases({value: [0] for value in values}):
        shown.append(str(low) if low == high else f"{low}-{high}")
    return ",".join(shown)
