"""Messages as the tables that C decodes by: pages, multiplexers, fields."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canser._core.signals import (
    CASE_DTYPE,
    FLOATS,
    KNOWN_ID_DTYPE,
    MESSAGE_DTYPE,
    MUX_DEPTH,
    MUX_DTYPE,
    NO_TABLE,
    PAGE_DTYPE,
    PGN_DTYPE,
    SCALED,
    SIGNAL_DTYPE,
    WHOLE,
    SignalTables,
)
from canser.signals.messages import Message, SignalInfo

__all__ = ["Layout", "Page", "Plan"]

_TABLE_LEN: Final = 256
_INT64: Final = range(-(2**63), 2**63)
_UINT64: Final = range(2**64)

_Records = npt.NDArray[np.void]


class Plan(NamedTuple):
    """How a signal is decoded.

    `records` are one or two of SIGNAL_DTYPE: for the values, and for the raw numbers if they are
    kept apart. `raw_at` is the place of the raw ones among the columns, or None.
    """

    info: SignalInfo
    least_dlc: int
    dtypes: tuple[np.dtype[Any], ...]
    records: tuple[_Records, ...]
    raw_at: int | None


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
        self, messages: Sequence[Message], *, selected: set[str] | None, keeps_raw: bool
    ) -> None:
        self.messages = messages
        self.pages: list[Page] = []
        #: Whether signals were selected by name.
        self.is_selected = selected is not None
        self._selected, self._keeps_raw = selected, keeps_raw
        self._page_records: list[tuple[int, int, int, int]] = []
        self._muxes: list[tuple[Any, ...]] = []
        self._cases: list[tuple[int, int, int, int]] = []
        self._links: list[int] = []
        self._tables: list[npt.NDArray[np.uint16]] = []
        #: The number of the first page of each message.
        self.roots = [self._add_message(message) for message in messages]

    def tables(self) -> SignalTables:
        """Return new tables, in which nothing is counted yet."""
        ids = np.zeros(len(self.messages), KNOWN_ID_DTYPE)
        messages = np.zeros(len(self.messages), MESSAGE_DTYPE)
        for number, message in enumerate(self.messages):
            ids[number] = (0, message.id, number, message.ext, 1)
        messages["page"] = self.roots
        pages = np.zeros(len(self.pages), PAGE_DTYPE)
        for name, values in zip(
            ("first_mux", "mux_count", "full_dlc", "depth"),
            zip(*self._page_records, strict=True),
            strict=bool(self.pages),
        ):
            pages[name] = values
        muxes = np.zeros(len(self._muxes), MUX_DTYPE)
        for number, mux in enumerate(self._muxes):
            muxes[number] = mux
        return SignalTables(
            ids=ids,
            pgns=self._pgns(),
            messages=messages,
            pages=pages,
            muxes=muxes,
            cases=np.array(self._cases, CASE_DTYPE),
            links=np.array(self._links, np.uint32),
            tables=np.concatenate(self._tables) if self._tables else np.zeros(0, np.uint16),
        )

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
                found.append((pgn, chosen[0]))
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
                plan = _plan(signal, self._keeps_raw)
                plans.setdefault(plan.least_dlc, []).append(plan)
        self.pages.append(Page(name, message, dict(sorted(plans.items()))))
        self._page_records.append((0, 0, 0, 0))
        muxes = [each for each in signals if each.is_multiplexer and below.get(each.name)]
        if muxes and not depth:
            raise ValueError(
                f"message {message.name}: multiplexers lie more than {MUX_DEPTH} deep, or select "
                "each other"
            )
        records = [self._mux(message, name, mux, below, depth - 1) for mux in muxes]
        full = max((-(-each.last_bit // 8) for each in signals), default=0)
        self._page_records[number] = (len(self._muxes), len(records), full, MUX_DEPTH - depth)
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
        for signal in below[mux.name]:
            parts.setdefault(signal.pages, []).append(signal)
        by_value: dict[int, list[int]] = {}
        for values, signals in parts.items():
            label = f"{name}[{mux.name}={_ranges(values)}]"
            number = self._add_page(message, label, signals, below, depth)
            for value in values:
                by_value.setdefault(value, []).append(number)
        first = len(self._cases)
        cases = list(_cases(by_value))
        for low, high, numbers in cases:
            self._cases.append((low, high, len(self._links), len(numbers)))
            self._links += numbers
        table = NO_TABLE
        if mux.bit_count <= 8 and len(cases) < 2**16:
            table = _TABLE_LEN * len(self._tables)
            by_number = np.zeros(_TABLE_LEN, np.uint16)
            for case, (low, high, _) in enumerate(cases):
                by_number[low : min(high, _TABLE_LEN - 1) + 1] = case + 1
            self._tables.append(by_number)
        return _field(mux), -(-mux.last_bit // 8), first, len(cases), table


def _cases(by_value: Mapping[int, list[int]]) -> Iterator[tuple[int, int, list[int]]]:
    """Yield ranges of neighbouring values that select the same pages."""
    low = high = -1
    pages: list[int] = []
    for value in sorted(by_value):
        if pages and value == high + 1 and by_value[value] == pages:
            high = value
            continue
        if pages:
            yield low, high, pages
        low = high = value
        pages = by_value[value]
    if pages:
        yield low, high, pages


def _ranges(values: Sequence[int]) -> str:
    """Write numbers in their order, neighbours as ranges: "1-3,9"."""
    shown = []
    for low, high, _ in _cases({value: [0] for value in values}):
        shown.append(str(low) if low == high else f"{low}-{high}")
    return ",".join(shown)


def _field(signal: SignalInfo) -> tuple[bool, int, int, bool]:
    shift = 64 - signal.last_bit if signal.is_big_endian else signal.start
    return signal.is_big_endian, shift, signal.bit_count, signal.is_signed


def _plan(signal: SignalInfo, keeps_raw: bool) -> Plan:
    is_plain = signal.scale == 1 and signal.offset == 0
    raw_dtype: np.dtype[Any]
    if signal.is_float:
        kind, dtype, raw_dtype = FLOATS[signal.bit_count], np.dtype(np.float64), np.dtype("f8")
        raw_kind = kind
    else:
        low, high = _raw_range(signal)
        raw_dtype, raw_kind = np.dtype(np.uint64 if high not in _INT64 else np.int64), WHOLE
        kind, dtype = _column(signal, low, high)
    whole = (int(signal.scale), int(signal.offset)) if kind == WHOLE else (1, 0)
    values = _record(signal, whole, kind, is_raw=False)
    plan = Plan(signal, -(-signal.last_bit // 8), (dtype,), (values,), None)
    if is_plain and (signal.is_float or dtype == raw_dtype):
        return plan._replace(raw_at=0) if keeps_raw or signal.choices else plan
    if not keeps_raw and not signal.choices:
        return plan
    raw = _record(signal, (1, 0), raw_kind, is_raw=True)
    return plan._replace(dtypes=(dtype, raw_dtype), records=(values, raw), raw_at=1)


def _record(signal: SignalInfo, whole: tuple[int, int], kind: int, *, is_raw: bool) -> _Records:
    record = np.zeros((), SIGNAL_DTYPE)
    record["factor"], record["addend"] = float(signal.scale), float(signal.offset)
    record["scale"], record["offset"] = (np.int64(_wrapped(each)) for each in whole)
    record["field"] = _field(signal)
    record["kind"], record["is_raw"] = kind, is_raw
    return record


def _wrapped(number: int) -> int:
    """Return a number of 64 bits as a signed one."""
    return (number + 2**63) % 2**64 - 2**63


def _raw_range(signal: SignalInfo) -> tuple[int, int]:
    if signal.is_signed:
        return -(2 ** (signal.bit_count - 1)), 2 ** (signal.bit_count - 1) - 1
    return 0, 2**signal.bit_count - 1


def _column(signal: SignalInfo, low: int, high: int) -> tuple[int, np.dtype[Any]]:
    """Return the kind of a signal of whole bits, and the type of its column."""
    if float(signal.scale).is_integer() and float(signal.offset).is_integer():
        ends = [raw * int(signal.scale) + int(signal.offset) for raw in (low, high)]
        for numbers, dtype in ((_INT64, np.int64), (_UINT64, np.uint64)):
            if all(end in numbers for end in ends):
                return WHOLE, np.dtype(dtype)
    return SCALED, np.dtype(np.float64)
