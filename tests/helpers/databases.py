"""Databases to test with: one of our own, and the folder beside the project, where it is there."""

import gzip
import json
import struct
from collections.abc import Iterable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import canser
from canser._frames import FRAME_DTYPE, FrameArray
from plain_signals import Found, Number, decode_plainly
from reference import Frame, pack

DATABASES = Path(__file__).parents[3] / "shared" / "databases"

needs_databases = pytest.mark.skipif(
    not DATABASES.is_dir(), reason="the folder of databases, ../shared/databases, is not here"
)


def cantools_release() -> int:
    """Return the first number of the version of cantools, 0 if it is not installed."""
    try:
        return int(metadata.version("cantools").partition(".")[0])
    except metadata.PackageNotFoundError:
        return 0


needs_refusal = pytest.mark.skipif(
    0 < cantools_release() < 45, reason="cantools reads entries of no signal before 45"
)

NAMES = [
    "abs.dbc",
    "boat.dbc",
    "car.dbc",
    "edge.dbc",
    "floating_point.dbc",
    "foobar.dbc",
    "issue_184_extended_mux_cascaded.dbc",
    "issue_184_extended_mux_independent_multiplexors.dbc",
    "issue_184_extended_mux_multiple_values.dbc",
    "j1939.dbc",
    "motohawk.dbc",
    "multiplex.dbc",
    "multiplex_2.dbc",
    "multiplex_choices.dbc",
    "signed.dbc",
    "socialledge.dbc",
    "tesla.dbc",
    "vehicle.dbc",
    "vw_mqb.dbc",
]

each_database = pytest.mark.parametrize("name", NAMES)

# A message of each kind: plain, of pages, of pages within pages, J1939 of both forms, an extended
# one that is not, and one that shares its number with a standard one.
OWN = """VERSION ""

BU_: X

BO_ 256 Plain: 8 X
 SG_ First : 0|8@1+ (1,0) [0|0] "" X
 SG_ Fourth : 24|8@1+ (0.5,0) [0|0] "V" X
 SG_ Last : 56|8@1- (2,-1) [0|0] "A" X

BO_ 257 Paged: 8 X
 SG_ Page M : 0|4@1+ (1,0) [0|0] "" X
 SG_ Always : 8|8@1+ (1,0) [0|0] "" X
 SG_ One m1 : 16|8@1+ (1,0) [0|0] "" X
 SG_ AlsoOne m1 : 24|8@1+ (0.1,0) [0|0] "" X
 SG_ Two m2 : 16|16@1- (1,0) [0|0] "" X
 SG_ OneToThree m1 : 56|8@1+ (1,0) [0|0] "" X

BO_ 258 Nested: 8 X
 SG_ Outer M : 0|4@1+ (1,0) [0|0] "" X
 SG_ Inner m1M : 4|4@1+ (1,0) [0|0] "" X
 SG_ Some m3 : 8|8@1+ (1,0) [0|0] "" X
 SG_ Other m0 : 8|8@1+ (1,0) [0|0] "" X

BO_ 259 Named: 1 X
 SG_ Gear : 0|4@1- (1,0) [0|0] "" X
 SG_ Scaled : 4|4@1+ (0.5,1) [0|0] "" X

BO_ 2147483904 SameNumber: 8 X
 SG_ First : 0|16@1+ (1,0) [0|0] "" X

BO_ 2566844926 Broadcast: 8 X
 SG_ Speed : 0|16@1+ (0.125,0) [0|0] "rpm" X

BO_ 2565472510 Request: 3 X
 SG_ Asked : 0|24@1+ (1,0) [0|0] "" X

BO_ 2566844753 OneSource: 8 X
 SG_ Own : 0|8@1+ (1,0) [0|0] "" X

VAL_ 259 Gear -1 "reverse" 0 "neutral" 7 "top" ;
VAL_ 259 Scaled 0 "raw zero" 10 "raw ten" ;
SG_MUL_VAL_ 257 One Page 1-1;
SG_MUL_VAL_ 257 AlsoOne Page 1-1;
SG_MUL_VAL_ 257 Two Page 2-2;
SG_MUL_VAL_ 257 OneToThree Page 1-3;
SG_MUL_VAL_ 258 Inner Outer 1-1;
SG_MUL_VAL_ 258 Some Inner 3-5, 9-9;
SG_MUL_VAL_ 258 Other Outer 0-0;
"""


def encoding_of(name: str) -> str | None:
    """Return what cantools must be told; canser finds it out."""
    return "utf-8" if name in ("boat.dbc", "edge-utf8.dbc", "vw_mqb.dbc") else None


@cache
def parsed(name: str) -> Any:
    """Return a database of the folder as cantools has it."""
    import cantools  # noqa: PLC0415 - an optional extra

    return cantools.database.load_file(
        str(DATABASES / name), strict=False, encoding=encoding_of(name)
    )


@cache
def opened(name: str) -> canser.Database:
    """Return a database of the folder as canser has it."""
    return canser.Database(DATABASES / name)


@cache
def expectations() -> Any:
    """Return what cantools says, and a plain decoder where cantools raises."""
    with gzip.open(DATABASES / "expected.json.gz", "rt") as file:
        return json.load(file)


def frame(arbitration_id: int, ext: bool, data: bytes, ts: int = 0) -> Frame:
    """Return a data frame."""
    return Frame(arbitration_id, ext, dlc=len(data), data=data.ljust(8, b"\0"), ts=ts)


def numbered(frames: Iterable[Frame]) -> FrameArray:
    """Return frames as an array; each is known by its time, its place in nanoseconds."""
    records = bytearray(pack(each._replace(ts=i) for i, each in enumerate(frames)))
    return np.frombuffer(records, FRAME_DTYPE)


def by_frame(signals: canser.Signals, count: int, *, raw: bool = False) -> list[dict[str, Number]]:
    """Return the values of each of `count` numbered frames, by the full names of the signals."""
    found: list[dict[str, Number]] = [{} for _ in range(count)]
    for name, signal in signals.items():
        column = signal.raw if raw else signal.values
        assert column is not None
        places = signal.ts.view(np.int64).tolist()
        assert len(places) == len(column)
        assert places == sorted(set(places)), f"{name}: the order of the frames is lost"
        for place, value in zip(places, column.tolist(), strict=True):
            found[place][name] = value
    return found


def bits(value: Number) -> Number | bytes | str:
    """Return what is equal for equal values: type and bits; one NaN is as good as another."""
    if isinstance(value, int):
        return value
    return "NaN" if value != value else struct.pack("<d", value)


def shown(values: dict[str, Number]) -> dict[str, Any]:
    """Return values so that they can be compared, to the last bit, and read."""
    return {
        name: (bits(value), value) if value == value else "NaN" for name, value in values.items()
    }


def full(message: str, values: dict[str, Number]) -> dict[str, Number]:
    """Return values by the full names of their signals."""
    return {f"{message}.{name}": value for name, value in values.items()}


def plainly(database: Any, frames: Iterable[Frame], match: str = "auto") -> list[Found | None]:
    """Return what the plain decoder finds in frames; remote and error frames have nothing."""
    return [
        None
        if each.rtr or each.err
        else decode_plainly(database, each.id, each.ext, each.data[: each.dlc], match)
        for each in frames
    ]


def assert_like_plain(
    database: Any, decoder: canser.Database, frames: list[Frame], match: str = "auto"
) -> canser.Signals:
    """Assert that values, raw values and report are those of the plain decoder."""
    found = plainly(database, frames, match)
    signals = decoder.decode(numbered(frames), raw=True)
    for what, raw in (("values", False), ("raw", True)):
        made = by_frame(signals, len(frames), raw=raw)
        for each, has, wanted in zip(frames, made, found, strict=True):
            expected = full(wanted.message, getattr(wanted, what)) if wanted else {}
            assert shown(has) == shown(expected), (what, each)
    assert_report(signals.report, frames, found)
    return signals


def assert_report(
    report: canser.DecodeReport, frames: list[Frame], found: list[Found | None]
) -> None:
    """Assert that a report is that of what the plain decoder found."""

    def counted(which: Iterable[Found]) -> dict[str, int]:
        counts: dict[str, int] = {}
        for each in which:
            counts[each.message] = counts.get(each.message, 0) + 1
        return counts

    decoded = [each for each in found if each]
    unknown: dict[tuple[int, bool], int] = {}
    for each, has in zip(frames, found, strict=True):
        if not (has or each.rtr or each.err):
            unknown[each.id, each.ext] = unknown.get((each.id, each.ext), 0) + 1
    assert report.frame_count == len(frames)
    assert present(report.messages) == counted(decoded)
    assert present(report.short) == counted(each for each in decoded if each.short)
    assert present(report.unknown_pages) == counted(each for each in decoded if each.unknown_page)
    rows = report.unknown_ids.tolist()
    assert {(number, ext): count for number, ext, count in rows} == unknown
    assert len(rows) == len(unknown)
    assert [row[2] for row in rows] == sorted((row[2] for row in rows), reverse=True)
    assert report.error_count == sum(each.err for each in frames)
    assert report.remote_count == sum(each.rtr and not each.err for each in frames)


def present(counts: Any) -> dict[str, int]:
    """Return counts without those of nothing."""
    return {name: count for name, count in counts.items() if count}
