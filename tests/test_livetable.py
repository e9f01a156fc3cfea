"""The live table against one in plain Python; its order, its filters, its limits."""

import dataclasses
import math
import statistics
import threading
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray
from canser.monitoring import livetable
from canser.monitoring.livetable import (
    COLUMNS,
    ROW_DTYPE,
    LiveTable,
    RowArray,
    choose,
    exact,
    ordered,
)
from plain_ids import plain_runs
from reference import Frame
from samples import MILLISECOND as MS
from samples import array

Kind = tuple[bool, bool, int, bool]


@dataclasses.dataclass
class Plain:
    """What the table should say of one kind of frame."""

    last: Frame
    count: int = 1
    changed: list[int] = dataclasses.field(default_factory=lambda: [NO_TIME] * 8)
    steps: list[int] = dataclasses.field(default_factory=list)
    timed: tuple[int, int] = NO_TIME, 0  # the last time, and its run

    def add(self, frame: Frame) -> None:
        self.count += 1
        for at in range(8):
            # A byte that is not there differs from every one that is.
            before, after = (f.data[at] if at < f.dlc else None for f in (self.last, frame))
            if before != after:
                self.changed[at] = max(self.changed[at], frame.ts)
        self.last = frame

    def add_time(self, ts: int, run: int) -> None:
        if self.timed[1] == run != 0 and ts >= self.timed[0]:
            self.steps.append(ts - self.timed[0])
        self.timed = ts, run

    def pace(self) -> tuple[float, float, float]:
        """Return period, jitter and rate."""
        steps = self.steps[-32:]
        if not steps:
            return math.nan, math.nan, math.nan
        period = statistics.median(steps)
        near = [step for step in steps if 0.5 * period <= step <= 1.5 * period]
        jitter = max(near) - min(near) if len(near) > 1 else math.nan
        return period, jitter, 1e9 * len(steps) / sum(steps) if sum(steps) else math.nan


@st.composite
def traffic(draw: st.DrawFn) -> list[Frame]:
    frames = []
    start = 0
    for _ in range(draw(st.integers(0, 60))):
        start += draw(st.sampled_from((0, 0, 10 * MS, 500 * MS)))
        ext = draw(st.booleans())
        dlc = draw(st.integers(0, 8))
        rtr = draw(st.booleans())
        frames.append(
            Frame(
                draw(st.sampled_from((0, 1, 0x7FF, *((0x800, 0x1FFF_FFFF) if ext else ())))),
                ext,
                rtr,
                dlc,
                draw(st.booleans()),
                bytes(0 if rtr else draw(st.integers(0, 1)) for _ in range(dlc)).ljust(8, b"\0"),
                # In order or nearly so, and now and then a restart of the clock.
                draw(st.one_of(st.integers(start, start + 9 * MS), st.sampled_from((0, NO_TIME)))),
            )
        )
    return frames


@given(traffic(), st.lists(st.integers(0, 60)))
def test_it_says_what_a_plain_table_says(frames: list[Frame], cuts: list[int]) -> None:
    plain: dict[Kind, Plain] = {}
    runs = plain_runs([frame.ts for frame in frames])
    for frame, run in zip(frames, runs, strict=True):
        kind = (frame.err, frame.ext, frame.id, frame.rtr)
        if kind in plain:
            plain[kind].add(frame)
        else:
            plain[kind] = Plain(frame)
        plain[kind].add_time(frame.ts, run)

    table = LiveTable()
    for piece in np.split(array(*frames), sorted(min(cut, len(frames)) for cut in cuts)):
        table.add(piece)

    rows = table.rows()
    assert rows.dtype == ROW_DTYPE
    assert table.frames == len(frames)
    kinds = [(bool(r["err"]), bool(r["ext"]), int(r["id"]), bool(r["rtr"])) for r in rows]
    assert kinds == sorted(plain)
    for row, kind in zip(rows, kinds, strict=True):
        expected = plain[kind]
        assert row["count"] == expected.count
        assert row["dlc"] == expected.last.dlc
        assert row["ts"] == expected.last.ts
        assert row["data"].tobytes() == expected.last.data
        assert row["changed"].tolist() == expected.changed
        period, jitter, rate = expected.pace()
        assert row["period"] == pytest.approx(period, rel=1e-9, nan_ok=True)
        assert row["jitter"] == pytest.approx(jitter, rel=1e-6, abs=1e-9 * period, nan_ok=True)
        assert row["rate"] == pytest.approx(rate, rel=1e-9, nan_ok=True)


def sent(*ts: int, arbitration_id: int = 0x123, **fields: Any) -> FrameArray:
    """Return frames of one id at some times."""
    frames = np.zeros(len(ts), FRAME_DTYPE)
    frames["ts"], frames["id"], frames["dlc"] = ts, arbitration_id, 8
    for name, value in fields.items():
        frames[name] = value
    return frames


def one_row(*batches: FrameArray) -> Any:
    table = LiveTable()
    for batch in batches:
        table.add(batch)
    (row,) = table.rows()
    return row


def test_a_steady_id_has_its_period_and_no_jitter() -> None:
    row = one_row(sent(*range(0, 1_000 * MS, 10 * MS)))
    assert row["period"] == pytest.approx(10 * MS)
    assert row["jitter"] < 1_000


def test_jitter_is_the_range_of_the_last_intervals_near_the_period() -> None:
    late = np.random.default_rng(1).integers(-MS // 2, MS // 2, 100)
    times = np.cumsum(10 * MS + late)
    row = one_row(sent(*times.tolist()))
    last = np.diff(times)[-32:]
    assert row["period"] == np.median(last)
    assert row["jitter"] == last.max() - last.min()


def test_the_last_32_steps_count_however_they_come() -> None:
    times = np.cumsum([0, *[100 * MS] * 40, *[10 * MS] * 16, *[20 * MS] * 16])
    table = LiveTable()
    for batch in np.array_split(sent(*times.tolist()), 7):
        table.add(batch)
    (row,) = table.rows()
    assert row["period"] == 15 * MS
    assert row["jitter"] == 10 * MS
    assert row["rate"] == pytest.approx(1_000 / 15)
    table.add(sent(int(times[-1]) + 20 * MS))
    (row,) = table.rows()
    assert row["period"] == 20 * MS


def test_a_lost_frame_changes_neither_period_nor_jitter() -> None:
    row = one_row(sent(*(number * 10 * MS for number in range(100) if number % 9)))
    assert (row["period"], row["jitter"]) == (10 * MS, 0)
    assert row["rate"] < 95


def test_the_rate_of_bursts_is_not_that_of_their_steps() -> None:
    bursts = [second * 1_000 * MS + number * MS for second in range(20) for number in range(4)]
    row = one_row(sent(*bursts))
    assert row["period"] == MS
    assert row["rate"] == pytest.approx(4, rel=0.1)


def test_no_step_leads_across_a_restart_of_the_clock() -> None:
    """The second id comes later behind the restart than in front of it."""
    table = LiveTable()
    for run in range(2):
        table.add(sent(*range(0, 5_000 * MS, 10 * MS)))
        table.add(sent(5_000 * MS + run * 7 * MS, arbitration_id=0x456))
    first, second = table.rows()
    assert first["period"] == 10 * MS
    assert first["jitter"] == 0
    assert math.isnan(second["period"])
    table.add(sent(5_057 * MS, arbitration_id=0x456))
    assert table.rows()["period"].tolist() == [10 * MS, 50 * MS]


def test_a_false_time_keeps_no_row_from_its_period() -> None:
    table = LiveTable()
    for second in range(10):
        table.add(sent(second * 1_000 * MS, arbitration_id=0x456))
        table.add(sent(*range(second * 1_000 * MS, (second + 1) * 1_000 * MS, 10 * MS)))
        table.add(sent((second - 900) * 1_000 * MS, arbitration_id=0x7FF))
    rows = table.rows()
    assert rows["period"][:2].tolist() == [10 * MS, 1_000 * MS]


def test_an_old_pace_is_forgotten() -> None:
    row = one_row(
        sent(*range(0, 10_000 * MS, 100 * MS)), sent(*range(10_000 * MS, 12_000 * MS, MS))
    )
    assert row["period"] == pytest.approx(MS, rel=1e-6)
    assert row["jitter"] < 1_000


def test_times_of_today_keep_their_nanoseconds() -> None:
    epoch = 1_792_000_000_000_000_000
    row = one_row(sent(epoch, epoch + 10_000_001), sent(epoch + 20_000_002))
    assert row["period"] == pytest.approx(10_000_001, abs=0.1)


def test_nothing_is_known_of_a_single_frame() -> None:
    row = one_row(sent(5))
    assert math.isnan(row["period"])
    assert math.isnan(row["jitter"])
    assert (row["changed"] == NO_TIME).all()


def test_frames_of_ids_beyond_the_limit_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(livetable, "_IDS_MOST", 3)
    table = LiveTable()
    table.add(np.concatenate([sent(1, arbitration_id=i) for i in (9, 5)]))
    table.add(np.concatenate([sent(2, arbitration_id=i) for i in (1, 9, 2, 2, 3, 5)]))
    table.add(sent(3, arbitration_id=0x7FF))
    rows = table.rows()
    assert rows["id"].tolist() == [1, 5, 9]
    assert rows["count"].tolist() == [1, 2, 2]
    assert (table.frames, table.others) == (9, 4)
    assert rows["count"].sum() + table.others == table.frames


def test_clear_forgets_all() -> None:
    table = LiveTable()
    table.add(sent(1, 2, 3))
    table.clear()
    assert (table.frames, table.others, len(table.rows())) == (0, 0, 0)
    table.add(sent(7, 9))
    (row,) = table.rows()
    assert (row["count"], row["period"]) == (2, 2)


def test_rows_are_a_copy() -> None:
    table = LiveTable()
    table.add(sent(1))
    rows = table.rows()
    table.add(sent(2))
    assert rows["count"].tolist() == [1]
    rows["count"] = 100
    assert table.rows()["count"].tolist() == [2]


def test_two_threads_lose_no_frame() -> None:
    table = LiveTable()
    batches = [sent(*range(7), arbitration_id=i % 50) for i in range(400)]

    def add() -> None:
        for batch in batches:
            table.add(batch)

    threads = [threading.Thread(target=add) for _ in range(2)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        rows = table.rows()
        assert rows["count"].sum() <= 2 * 7 * 400
    assert table.frames == table.rows()["count"].sum() == 2 * 7 * 400


# Order


def some_rows() -> RowArray:
    table = LiveTable()
    table.add(sent(*range(0, 100, 10), arbitration_id=0x300))
    table.add(sent(*range(0, 150, 50), arbitration_id=0x100, dlc=2))
    table.add(sent(900, arbitration_id=0x200, dlc=4))
    table.add(sent(1, 2, 4, arbitration_id=0x0AB, ext=True))
    return table.rows()


ORDERS = {
    "id": [0x100, 0x200, 0x300, 0x0AB],
    "count": [0x200, 0x100, 0x0AB, 0x300],
    "dlc": [0x100, 0x200, 0x300, 0x0AB],
    "ts": [0x0AB, 0x300, 0x100, 0x200],
}


def test_all_orders_are_tested() -> None:
    assert {*ORDERS, "period", "jitter"} == {*COLUMNS}


@pytest.mark.parametrize("by", ORDERS)
def test_rows_are_sorted_by(by: str) -> None:
    assert ordered(some_rows(), by)["id"].tolist() == ORDERS[by]


@pytest.mark.parametrize("by", ["period", "jitter"])
@pytest.mark.parametrize("descending", [False, True])
def test_what_is_not_known_comes_last(by: str, descending: bool) -> None:
    rows = ordered(some_rows(), by, descending=descending)
    assert rows["id"][-1] == 0x200
    assert (np.diff(rows[by][:-1]) * (-1 if descending else 1) >= 0).all()


@pytest.mark.parametrize("by", ["count", "dlc", "ts"])
def test_the_other_way_round_equal_ones_stay_by_id(by: str) -> None:
    rows = some_rows()
    expected = sorted(range(4), key=lambda at: -int(rows[by][at]))
    assert ordered(rows, by, descending=True)["id"].tolist() == rows["id"][expected].tolist()


def test_ids_downwards() -> None:
    assert ordered(some_rows(), "id", descending=True)["id"].tolist() == ORDERS["id"][::-1]


# Filters


@pytest.mark.parametrize(
    ("text", "chosen"),
    [
        ("", ["100", "102", "18F", "000018F0", "18FEF1AA", "ERR"]),
        ("  ", ["100", "102", "18F", "000018F0", "18FEF1AA", "ERR"]),
        ("100:7FF", ["100"]),
        ("100~7FF", ["102", "18F", "000018F0", "18FEF1AA"]),
        ("#4", ["ERR"]),
        ("18f", ["18F", "18FEF1AA"]),
        ("10", ["100", "102"]),
        ("0", ["000018F0", "ERR"]),
        ("18FEF1AA", ["18FEF1AA"]),
        ("00", ["000018F0", "ERR"]),
        ("100:7FF 18FE", ["100", "18FEF1AA"]),
        ("100:7FF,102", ["100", "102"]),
        ("7", []),
        ("0x18f", ["18F", "18FEF1AA"]),
        ("0X18F:0x7FF", ["18F"]),
    ],
)
def test_a_filter_chooses(text: str, chosen: list[str]) -> None:
    rows, names = filtered_rows()
    assert [names[at] for at in np.flatnonzero(choose(rows, text))] == chosen


@pytest.mark.parametrize(
    ("text", "spelled", "chosen"),
    [
        ("", "", ["100", "102", "18F", "000018F0", "18FEF1AA", "ERR"]),
        ("18F", "18F:800007FF", ["18F"]),
        ("0x102,100:7FF", "102:800007FF 100:7FF", ["100", "102"]),
        ("10", "10:800007FF", []),
        ("18FEF1AA  4", "18FEF1AA:9FFFFFFF 4:800007FF", ["18FEF1AA"]),
        ("#4", "#4", ["ERR"]),
    ],
)
def test_exact_filters_keep_their_meaning_where_digits_are_prefixes(
    text: str, spelled: str, chosen: list[str]
) -> None:
    rows, names = filtered_rows()
    assert exact(text) == spelled
    assert [names[at] for at in np.flatnonzero(choose(rows, spelled))] == chosen


@pytest.mark.parametrize("text", ["18FE", "100 800", "123:", "#", "\u0661"])
def test_an_exact_filter_that_cannot_be_read_is_an_error(text: str) -> None:
    with pytest.raises(ValueError, match=r"the filter .* write "):
        exact(text)


def filtered_rows() -> tuple[RowArray, list[str]]:
    """Return some rows, and their names."""
    table = LiveTable()
    for standard in (0x100, 0x102, 0x18F):
        table.add(sent(1, arbitration_id=standard))
    for extended in (0x18F0, 0x18FEF1AA):
        table.add(sent(1, arbitration_id=extended, ext=True))
    table.add(sent(1, arbitration_id=0x004, err=True))
    return table.rows(), ["100", "102", "18F", "000018F0", "18FEF1AA", "ERR"]


@given(st.integers(0, 0x7FF), st.integers(1, 3))
def test_the_first_digits_of_an_id_choose_it(arbitration_id: int, count: int) -> None:
    rows = np.zeros(0x800, ROW_DTYPE)
    rows["id"] = np.arange(0x800)
    prefix = f"{arbitration_id:03X}"[:count]
    expected = [f"{i:03X}".startswith(prefix) for i in range(0x800)]
    assert choose(rows, prefix).tolist() == expected


@pytest.mark.parametrize("text", ["123:", "xyz", "123:7FF nope", "123456789", "12#4", "\u0661"])
def test_a_filter_that_cannot_be_read_is_an_error(text: str) -> None:
    with pytest.raises(ValueError, match=r"cannot read the filter .*such as 123:7FF"):
        choose(np.empty(0, ROW_DTYPE), text)


def test_a_million_frames_at_once() -> None:
    ids = np.random.default_rng(1).integers(0, 0x800, 1_000_000)
    frames = np.zeros(len(ids), FRAME_DTYPE)
    frames["id"], frames["ts"] = ids, np.arange(len(ids))
    table = LiveTable()
    table.add(frames)
    assert table.rows()["count"].tolist() == np.bincount(ids, minlength=0x800).tolist()
