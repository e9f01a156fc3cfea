"""Signals: equal to cantools and to a plain decoder on real databases, and what is told of them."""

import copy
import gc
import math
import pickle
import random
import weakref
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

cantools = pytest.importorskip("cantools")

import canser  # noqa: E402
from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray  # noqa: E402
from canser.signals.decoder import SignalDecoder  # noqa: E402
from canser.signals.layout import Layout  # noqa: E402
from canser.signals.messages import Message, SignalInfo  # noqa: E402
from canser.signals.report import UNKNOWN_ID_DTYPE  # noqa: E402
from databases import (  # noqa: E402
    DATABASES,
    OWN,
    assert_like_plain,
    assert_report,
    by_frame,
    each_database,
    expectations,
    frame,
    full,
    needs_databases,
    needs_refusal,
    numbered,
    opened,
    parsed,
    plainly,
    present,
    shown,
)
from long import takes_long  # noqa: E402
from plain_signals import decode_plainly, is_whole  # noqa: E402
from reference import Frame  # noqa: E402
from samples import array  # noqa: E402
from shared import CAPTURES, needs_captures  # noqa: E402
from shared import expected as logged  # noqa: E402


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> canser.Database:
    return canser.Database(written(tmp_path_factory.mktemp("own"), OWN))


def written(folder: Path, text: str) -> Path:
    path = folder / "own.dbc"
    path.write_text(text)
    return path


def parsed_own() -> Any:
    return cantools.database.load_string(OWN, "dbc", strict=False)


# Every value that cantools and the plain decoder say.


def vectors(name: str) -> list[tuple[Frame, dict[str, Any], dict[str, str]]]:
    rows = []
    for number, ext, data, values, *labels in expectations()["vectors"][name]:
        rows.append(
            (
                frame(number, ext, bytes.fromhex(data)),
                values.get("plain", values),
                labels[0] if labels else {},
            )
        )
    return rows


@needs_databases
@each_database
def test_the_plain_decoder_reads_every_vector(name: str) -> None:
    for each, values, _ in vectors(name):
        found = decode_plainly(parsed(name), each.id, each.ext, each.data[: each.dlc])
        assert found
        assert shown(found.values) == shown(values), each


@needs_databases
@each_database
def test_every_vector_in_one_array(name: str) -> None:
    rows = vectors(name)
    frames = [each for each, _, _ in rows]
    signals = opened(name).decode(numbered(frames), raw=True)
    made, raw = by_frame(signals, len(rows)), by_frame(signals, len(rows), raw=True)
    found = plainly(parsed(name), frames)
    for (each, values, labels), has, before, plain in zip(rows, made, raw, found, strict=True):
        assert plain
        assert shown(has) == shown(full(plain.message, values)), each
        assert shown(before) == shown(full(plain.message, plain.raw)), each
        texts = {}
        for full_name, number in before.items():
            choices = signals[full_name].choices or {}
            if number in choices:
                texts[full_name.removeprefix(f"{plain.message}.")] = choices[int(number)]
        if "error" not in values:
            assert texts == labels or (not labels and plain.unknown_page), each
    assert_report(signals.report, frames, found)
    columns = {
        f"{message.name}.{signal.name}": is_whole(signal)
        for message in parsed(name).messages
        for signal in message.signals
    }
    for full_name, signal in signals.items():
        assert signal.values.dtype.kind in ("iu" if columns[full_name] else "f"), full_name
        assert signal.values.dtype.itemsize == 8


@needs_databases
@each_database
def test_one_by_one_is_as_all_at_once(name: str) -> None:
    rows = vectors(name)
    frames = numbered(each for each, _, _ in rows)
    whole = by_frame(opened(name).decode(frames), len(rows))
    decoder = opened(name).decoder()
    for i in range(0, len(rows), 1 + len(rows) // 150):
        alone = decoder.feed(frames[i : i + 1])
        assert shown({name: each.values.item() for name, each in alone.items()}) == shown(whole[i])
    for i in range(0, len(rows), 1 + len(rows) // 2):
        alone = opened(name).decode(frames[i : i + 1])
        assert shown({name: each.values.item() for name, each in alone.items()}) == shown(whole[i])
        assert alone.report.frame_count == 1
    assert decoder.report.frame_count == len(range(0, len(rows), 1 + len(rows) // 150))


@needs_databases
@each_database
def test_units_are_those_of_the_database(name: str) -> None:
    for message in parsed(name).messages:
        if message.length > 8:
            assert message.name in opened(name).left_out
            assert message.name not in opened(name).messages
            continue
        own = opened(name).messages[message.name]
        assert (own.id, own.ext, own.length) == (
            message.frame_id,
            message.is_extended_frame,
            message.length,
        )
        assert set(own.signals) == {signal.name for signal in message.signals}
        for signal in message.signals:
            info = own.signals[signal.name]
            assert (info.scale, info.offset) == (signal.scale, signal.offset)
            texts = {key: str(text) for key, text in (signal.choices or {}).items()}
            assert dict(info.choices or {}) == texts
            assert info.unit == (signal.unit or "") or not info.unit.isascii()


@needs_databases
def test_units_are_utf8_where_they_can_be() -> None:
    for name in ("edge.dbc", "edge-utf8.dbc"):
        message = opened(name).messages["LittleUnaligned"]
        units = [message.signals[each].unit for each in ("U13", "S33")]
        assert units == ["°C", "µV"]
        assert opened(name).messages["BigUnaligned"].signals["S5"].unit == "m/s²"
    assert (opened("edge.dbc").messages["Tables"].signals["Gear"].choices or {})[7] == (
        "größter Gang"
    )


@needs_databases
@each_database
def test_every_message_with_every_dlc(name: str) -> None:
    random_ = random.Random(name)
    frames = [
        frame(message.frame_id, message.is_extended_frame, random_.randbytes(dlc))
        for message in parsed(name).messages
        if message.length <= 8
        for dlc in range(9)
    ]
    assert_like_plain(parsed(name), opened(name), frames)


@needs_databases
def test_a_database_in_utf8_gives_the_same_values() -> None:
    frames = numbered(each for each, _, _ in vectors("edge.dbc"))
    assert_same_signals(opened("edge-utf8.dbc").decode(frames), opened("edge.dbc").decode(frames))


@needs_databases
@needs_refusal
def test_what_cantools_refuses_is_told_and_the_rest_is_read() -> None:
    with pytest.warns(canser.CanserWarning, match=r"tesla-broken\.dbc: .*line \d+ ") as warned:
        broken = canser.Database(DATABASES / "tesla-broken.dbc")
    assert len(warned) == 1
    assert "UI_mapSpeedLimit" in str(warned[0].message)
    frames = numbered(each for each, _, _ in vectors("tesla.dbc"))
    assert_same_signals(broken.decode(frames), opened("tesla.dbc").decode(frames))


# Whole captures.


@pytest.fixture(scope="module")
def captures() -> dict[str, tuple[FrameArray, canser.Signals]]:
    made = {}
    for name in ("car", "tesla", "boat"):
        frames = logged(name)
        made[name] = frames, opened(f"{name}.dbc").decode(frames)
    return made


# cantools raises at each frame of that message: it knows no page of theirs.
BEYOND: dict[str, set[str]] = {
    "car": set(),
    "tesla": set(),
    "boat": {"PGN_61184_multiplexed.manufacturerIndustry"},
}


@needs_databases
@needs_captures
@pytest.mark.parametrize("name", ["car", "tesla", "boat"])
def test_whole_captures(name: str, captures: dict[str, tuple[FrameArray, canser.Signals]]) -> None:
    frames, signals = captures[name]
    wanted = expectations()["captures"][name]
    assert set(signals) - set(wanted["signals"]) == BEYOND[name]
    for full_name, numbers in wanted["signals"].items():
        values = signals[full_name].values
        reached = {
            "n": len(values),
            "min": values.min().item(),
            "max": values.max().item(),
            "fsum": math.fsum(values.tolist()),
            "first": values[0].item(),
            "last": values[-1].item(),
            "changes": int(np.count_nonzero(values[1:] != values[:-1])),
        }
        assert reached == numbers, full_name
        assert type(reached["min"]) is type(numbers["min"]), full_name
    report = signals.report
    assert report.frame_count == wanted["frames"] == len(frames)
    assert present(report.messages) == wanted["decoded"]
    assert sum(report.unknown_ids["count"].tolist()) == len(frames) - sum(
        wanted["decoded"].values()
    )
    assert present(report.unknown_pages) == {k: n for k, (n, _) in wanted["errors"].items()}


@needs_databases
@needs_captures
def test_how_much_of_the_captures_is_decoded(
    captures: dict[str, tuple[FrameArray, canser.Signals]],
) -> None:
    decoded = {name: sum(each.report.messages.values()) for name, (_, each) in captures.items()}
    assert decoded == {"car": 38_015, "tesla": 1_618, "boat": 12_274}
    assert present(captures["boat"][1].report.unknown_pages) == {"PGN_61184_multiplexed": 141}
    assert len(captures["boat"][1].report.unknown_ids) == 0
    assert len(captures["boat"][1]["manufacturerIndustry"]) == 141


@needs_databases
@needs_captures
def test_no_frame_of_the_boat_has_an_id_of_its_database() -> None:
    database = canser.Database(str(DATABASES / "boat.dbc"), match="id")
    report = database.decode(logged("boat")).report
    assert present(report.messages) == {}
    assert sum(report.unknown_ids["count"].tolist()) == 12_274
    assert set(report.never_seen) == set(database.messages)


@needs_databases
@needs_captures
def test_times_of_signals_are_those_of_their_frames(
    captures: dict[str, tuple[FrameArray, canser.Signals]],
) -> None:
    frames, signals = captures["car"]
    for message in opened("car.dbc").messages.values():
        ts = frames["ts"][(frames["id"] == message.id) & ~frames["ext"]]
        for name in message.signals:
            signal = signals[f"{message.name}.{name}"]
            assert signal.ts.dtype == np.dtype("M8[ns]")
            assert np.array_equal(signal.ts.view(np.int64), ts)


@needs_databases
@needs_captures
@pytest.mark.parametrize("sizes", [[1000], [1, 7, 4096], [50_000]])
def test_a_feed_in_pieces_is_as_the_whole(
    sizes: list[int], captures: dict[str, tuple[FrameArray, canser.Signals]]
) -> None:
    frames, signals = captures["boat"]
    assert_feeds_like_whole(opened("boat.dbc"), frames, signals, sizes)


def assert_feeds_like_whole(
    database: canser.Database, frames: FrameArray, signals: canser.Signals, sizes: list[int]
) -> None:
    decoder = database.decoder()
    columns: dict[str, list[Any]] = {}
    begin = turn = 0
    while begin < len(frames):
        size = sizes[turn % len(sizes)]
        for name, signal in decoder.feed(frames[begin : begin + size]).items():
            columns.setdefault(name, []).append((signal.ts, signal.values))
        begin, turn = begin + size, turn + 1
    assert set(columns) == set(signals)
    for name, parts in columns.items():
        ts, values = (np.concatenate([part[i] for part in parts]) for i in range(2))
        assert values.dtype == signals[name].values.dtype
        assert np.array_equal(ts, signals[name].ts)
        assert np.array_equal(values, signals[name].values)
    assert_same_report(decoder.report, signals.report)


def assert_same_report(one: canser.DecodeReport, other: canser.DecodeReport) -> None:
    assert one.frame_count == other.frame_count
    assert present(one.messages) == present(other.messages)
    assert present(one.short) == present(other.short)
    assert present(one.unknown_pages) == present(other.unknown_pages)
    assert sorted(one.unknown_ids.tolist()) == sorted(other.unknown_ids.tolist())
    assert set(one.never_seen) == set(other.never_seen)
    assert (one.remote_count, one.error_count) == (other.remote_count, other.error_count)


def assert_same_signals(one: canser.Signals, other: canser.Signals) -> None:
    assert list(one) == list(other)
    for name, signal in one.items():
        assert signal.group == other[name].group
        assert signal.values.dtype == other[name].values.dtype
        assert np.array_equal(signal.ts, other[name].ts)
        assert signal.values.tobytes() == other[name].values.tobytes()
    assert_same_report(one.report, other.report)


@needs_databases
@needs_captures
def test_arrays_that_are_used_again_hold_the_same(
    captures: dict[str, tuple[FrameArray, canser.Signals]],
) -> None:
    frames, signals = captures["car"]
    database = opened("car.dbc")
    room = database.decode(frames[:50])
    for part in (frames, frames[:0], frames[:1000], frames[::-1], frames):
        room = database.decode(part, out=room)
        assert_same_signals(room, database.decode(part))
    assert_same_signals(room, signals)


def test_arrays_are_used_again(own: canser.Database) -> None:
    frames = numbered([frame(0x100, False, bytes(range(8)))] * 100)
    room = own.decode(frames)
    again = own.decode(frames, out=room)
    assert np.shares_memory(again["Plain.First"].values, room["Plain.First"].values)


def test_signals_that_are_not_used_any_more_are_freed_at_once(own: canser.Database) -> None:
    signals = own.decode(numbered([frame(0x100, False, bytes(8))]))
    assert signals["First"] is signals.groups["Plain"]["First"]
    known = weakref.ref(signals)
    gc.disable()  # a cycle would be found much later
    try:
        del signals
        assert known() is None
    finally:
        gc.enable()


def test_a_group_may_be_copied_and_pickled(own: canser.Database) -> None:
    group = own.decode(numbered([frame(0x100, False, bytes([7] * 8))])).groups["Plain"]
    for other in (pickle.loads(pickle.dumps(group)), copy.copy(group)):
        assert list(other) == list(group)
        assert other["Fourth"].values.tolist() == [3.5]


# Which message a frame belongs to.


@pytest.mark.parametrize(
    ("number", "ext", "message"),
    [
        (0x100, False, "Plain"),
        (0x100, True, "SameNumber"),
        (0x104, False, None),
        (0x18FEF1FE, True, "Broadcast"),
        (0x18FEF100, True, "Broadcast"),
        (0x0CFEF1AB, True, "Broadcast"),  # another priority
        (0x18FEF1FE & 0x7FF, False, None),
        (0x19FEF1FE, True, None),  # another data page
        (0x1AFEF1FE, True, None),  # the extended data page
        (0x18FEF200, True, None),
        (0x18EA00FE, True, "Request"),
        (0x18EA2130, True, "Request"),  # another destination
        (0x18EB00FE, True, None),
        (0x18FEF151, True, "OneSource"),  # its own id comes before the group
    ],
)
def test_messages_are_found_by_id_or_by_group(
    own: canser.Database, number: int, ext: bool, message: str | None
) -> None:
    frames = [frame(number, ext, bytes(range(1, 9)))]
    report = assert_like_plain(parsed_own(), own, frames).report
    assert list(present(report.messages)) == ([message] if message else [])


def test_match_id_and_pgn(tmp_path: Path) -> None:
    path = written(tmp_path, OWN)
    numbers = [
        *(0x18FEF1FE, 0x18FEF100, 0x0CFEF151, 0x18FEF151, 0x18EA00FE, 0x18EA2130),
        *(0x100, 0x10100, 0x1FFFFFFF),
    ]
    frames = [frame(number, ext, bytes(8)) for number in numbers for ext in (False, True)]
    frames = [each for each in frames if each.ext or each.id < 0x800]
    for match in ("id", "auto"):
        database = canser.Database(path, match=match)
        assert_like_plain(parsed_own(), database, frames, match)
    text = OWN.replace("2566844753", "2566845265")  # no second message of that group
    by_pgn = canser.Database(written(tmp_path, text), match="pgn")
    only = cantools.database.load_string(text, "dbc", strict=False)
    assert_like_plain(only, by_pgn, frames, "pgn")


def test_match_is_one_of_three(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="auto"):
        canser.Database(written(tmp_path, OWN), match="mask")


def test_remote_and_error_frames_are_counted(own: canser.Database) -> None:
    frames = [
        Frame(0x100, rtr=True, dlc=8),
        Frame(0x100, err=True, dlc=8),
        Frame(0x100, err=True, rtr=True, dlc=8),
        frame(0x100, False, bytes(8)),
        Frame(0x7FF, rtr=True),
    ]
    report = assert_like_plain(parsed_own(), own, frames).report
    assert (report.frame_count, report.remote_count, report.error_count) == (5, 2, 2)
    assert len(report.unknown_ids) == 0
    assert set(report.never_seen) == set(own.messages) - {"Plain"}


# Groups.


def test_signals_of_the_same_frames_share_a_group(own: canser.Database) -> None:
    frames = [
        frame(0x100, False, bytes(8)),
        *(frame(0x101, False, bytes([page, 2, 3, 4, 5, 6, 7, 8])) for page in (1, 2, 3, 7)),
        *(
            frame(0x102, False, bytes([outer | inner << 4, *range(7)]))
            for outer in (0, 1, 2)
            for inner in (3, 5, 6, 9)
        ),
    ]
    signals = assert_like_plain(parsed_own(), own, frames)
    assert {name: list(group) for name, group in signals.groups.items()} == {
        "Plain": ["First", "Fourth", "Last"],
        "Paged": ["Page", "Always"],
        "Paged[Page=1]": ["One", "AlsoOne"],
        "Paged[Page=2]": ["Two"],
        "Paged[Page=1-3]": ["OneToThree"],
        "Nested": ["Outer"],
        "Nested[Outer=1]": ["Inner"],
        "Nested[Outer=1][Inner=3-5,9]": ["Some"],
        "Nested[Outer=0]": ["Other"],
    }
    assert_groups(signals)
    assert signals.groups["Paged[Page=1]"]["AlsoOne"].values.tolist() == [0.4]
    assert present(signals.report.unknown_pages) == {"Paged": 1, "Nested": 5}


def assert_groups(signals: canser.Signals) -> None:
    seen = []
    for name, group in signals.groups.items():
        assert group.name == name
        for signal in group.values():
            assert (signal.group, signal.message) == (name, group.message)
            assert np.array_equal(signal.ts, group.ts)
            assert len(signal.values) == len(group.ts)
            seen.append(signal.full_name)
    assert sorted(seen) == sorted(signals)


def test_short_frames_split_a_group(own: canser.Database) -> None:
    frames = [frame(0x100, False, bytes(range(dlc))) for dlc in (8, 4, 0, 1, 3, 8)]
    signals = assert_like_plain(parsed_own(), own, frames)
    assert_groups(signals)
    assert signals["Plain.Fourth"].group == "Plain[dlc>=4]"
    assert signals["Plain.Last"].group == "Plain[dlc>=8]"
    assert signals["Plain.First"].group == "Plain"
    assert present(signals.report.short) == {"Plain": 4}


def test_a_page_with_a_name_and_no_signals_is_known(tmp_path: Path) -> None:
    text = OWN + 'VAL_ 257 Page 1 "one" 5 "nothing" ;\n'
    frames = [frame(0x101, False, bytes([page, *range(7)])) for page in (1, 4, 5, 6)]
    database = canser.Database(written(tmp_path, text))
    theirs = cantools.database.load_string(text, "dbc", strict=False)
    assert [decodes(theirs, each) for each in frames] == [True, False, True, False]
    report = assert_like_plain(theirs, database, frames).report
    assert present(report.unknown_pages) == {"Paged": 2}


def decodes(database: Any, each: Frame) -> bool:
    try:
        database.decode_message(each.id, each.data)
    except cantools.database.DecodeError:
        return False
    return True


def test_a_multiplexer_that_is_not_there_has_no_pages(own: canser.Database) -> None:
    frames = [frame(0x102, False, bytes(dlc)) for dlc in (0, 1, 2)]
    signals = assert_like_plain(parsed_own(), own, frames)
    assert len(signals["Nested.Outer"]) == 2
    assert len(signals["Nested.Other"]) == 1
    assert present(signals.report.short) == {"Nested": 2}
    assert present(signals.report.unknown_pages) == {}


# What may be asked for.


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["Plain.First"], {"Plain.First"}),
        (["Fourth"], {"Plain.Fourth"}),
        (["Plain.*"], {"Plain.First", "Plain.Fourth", "Plain.Last"}),
        (["P*.A*"], {"Paged.Always", "Paged.AlsoOne"}),
        (["*.First"], {"Plain.First", "SameNumber.First"}),
        (["Plain.First", "Plain.F*", "Speed"], {"Plain.First", "Plain.Fourth", "Broadcast.Speed"}),
    ],
)
def test_names_select_signals(own: canser.Database, names: list[str], found: set[str]) -> None:
    data = bytes([1, *range(7)])
    frames = numbered(
        frame(number, ext, data)
        for number, ext in [(0x100, False), (0x100, True), (0x101, False), (0x18FEF123, True)]
    )
    signals = own.decode(frames, names)
    assert set(signals) == found
    whole = own.decode(frames)
    for name, signal in signals.items():
        assert np.array_equal(signal.values, whole[name].values)
        assert np.array_equal(signal.ts, whole[name].ts)
    assert_groups(signals)
    fed = own.decoder(names).feed(frames)
    assert set(fed) == found


def test_what_was_asked_for_is_there_without_samples(own: canser.Database) -> None:
    names = ["Plain.First", "Paged.One", "Plain.Fourth"]
    for frames in (numbered([]), numbered([frame(0x100, False, b"")])):
        signals = own.decode(frames, names, raw=True)
        assert set(signals) == set(names)
        assert [len(signal) for signal in signals.values()] == [0, 0, 0]
        assert signals["Plain.Fourth"].values.dtype == np.float64
        assert signals["Plain.First"].values.dtype.kind in "iu"
        assert signals["Plain.Fourth"].unit == "V"
        assert len(own.decode(frames)) == 0


@pytest.mark.parametrize("name", ["Plain.Frist", "Fouth", "Q*", "plain", ""])
def test_a_name_that_nothing_has_is_refused(own: canser.Database, name: str) -> None:
    for call in (lambda: own.decode(numbered([]), ["First", name]), lambda: own.decoder([name])):
        with pytest.raises((KeyError, ValueError)) as raised:
            call()
        assert repr(name) in str(raised.value).replace('"', "'").replace("\\'", "'")
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize(("name", "near"), [("Plain.Frist", "Plain.First"), ("Fouth", "Fourth")])
def test_a_refusal_names_what_is_meant(own: canser.Database, name: str, near: str) -> None:
    with pytest.raises((KeyError, ValueError), match=near):
        own.decode(numbered([]), [name])


def test_a_short_name_must_be_the_only_one(own: canser.Database) -> None:
    frames = numbered([frame(0x100, False, bytes(8)), frame(0x100, True, bytes(8))])
    signals = own.decode(frames)
    with pytest.raises(KeyError, match=r"Plain\.First.*SameNumber\.First"):
        signals["First"]
    assert signals["Fourth"].full_name == "Plain.Fourth"


def test_raw_values_are_there_if_asked_for(own: canser.Database) -> None:
    frames = numbered([frame(0x100, False, bytes([1, 0, 0, 9, 0, 0, 0, 255]))])
    assert own.decode(frames)["Fourth"].raw is None
    signals = own.decode(frames, raw=True)
    columns = {name: (each.values.tolist(), each.raw.tolist()) for name, each in signals.items()}  # type: ignore[union-attr]
    assert columns == {
        "Plain.First": ([1], [1]),
        "Plain.Fourth": ([4.5], [9]),
        "Plain.Last": ([-3], [-1]),
    }


def test_texts_are_those_of_raw_values(own: canser.Database) -> None:
    signals = own.decode(numbered([frame(0x103, False, bytes([0xAF]))]), raw=True)
    gear, scaled = signals["Gear"], signals["Scaled"]
    assert (gear.choices, scaled.choices) == (
        {-1: "reverse", 0: "neutral", 7: "top"},
        {0: "raw zero", 10: "raw ten"},
    )
    assert (gear.values.tolist(), scaled.values.tolist()) == ([-1], [6.0])
    assert scaled.raw is not None
    assert scaled.choices is not None
    assert scaled.choices[scaled.raw.tolist()[0]] == "raw ten"


# Frames of any kind, and arrays of any kind.


def test_no_frames(own: canser.Database) -> None:
    signals = own.decode(numbered([]))
    assert len(signals) == len(signals.groups) == 0
    report = signals.report
    assert report.frame_count == report.remote_count == report.error_count == 0
    assert set(report.never_seen) == set(own.messages)
    assert report.unknown_ids.dtype == UNKNOWN_ID_DTYPE
    assert_same_report(own.decoder().report, report)


def test_arrays_of_any_layout(own: canser.Database) -> None:
    random_ = random.Random(1)
    frames = numbered(
        frame(random_.choice([0x100, 0x101, 0x102, 0x104]), False, random_.randbytes(8))
        for _ in range(500)
    )
    frozen = frames.copy()
    frozen.flags.writeable = False
    assert_same_signals(own.decode(frozen), own.decode(frames))
    spread = np.zeros(1000, FRAME_DTYPE)[::2]
    spread[:] = frames
    assert_same_signals(own.decode(spread), own.decode(frames))
    turned = frames[::-1]
    assert_same_signals(own.decode(turned), own.decode(turned.copy()))
    assert np.array_equal(frozen, frames)


def test_only_frames_are_decoded(own: canser.Database) -> None:
    numbers: Any = np.zeros(3)
    for call in (own.decode, own.decoder().feed):
        with pytest.raises(TypeError, match="FRAME_DTYPE"):
            call(numbers)
        with pytest.raises(ValueError, match="dimensions"):
            call(np.zeros((2, 2), FRAME_DTYPE))


def test_lengths_and_ids_out_of_range_do_no_harm(own: canser.Database) -> None:
    frames = numbered(frame(0x100, False, bytes(range(8))) for _ in range(6))
    frames["dlc"] = [8, 9, 15, 31, 64, 255]
    signals = own.decode(frames)
    assert signals["Last"].values.tolist() == [13] * 6
    frames["id"] |= np.uint32(0x80000000)
    frames["ext"] = [True, False] * 3
    report = own.decode(frames).report
    assert present(report.messages) == {}
    assert sum(report.unknown_ids["count"].tolist()) + report.other_count == 6


def test_times_that_are_not_known(own: canser.Database) -> None:
    times = [NO_TIME, 5, -7, 2**63 - 1, NO_TIME]
    frames = array(*(frame(0x100, False, bytes(8), ts) for ts in times))
    signal = own.decode(frames)["Plain.First"]
    assert signal.ts.view(np.int64).tolist() == times
    assert np.isnat(signal.ts).tolist() == [True, False, False, False, True]


def test_values_stay_when_the_frames_change(own: canser.Database) -> None:
    frames = numbered([frame(0x100, False, bytes([7] * 8))])
    signal = own.decode(frames)["Plain.First"]
    frames["data"] = 0
    frames["ts"] = 99
    assert (signal.values.tolist(), signal.ts.view(np.int64).tolist()) == ([7], [0])


def test_pieces_of_any_size_make_the_same_groups(own: canser.Database) -> None:
    random_ = random.Random(2)
    ids = [(0x100, False), (0x101, False), (0x102, False), (0x18FEF102, True), (0x7, False)]
    frames = numbered(
        frame(*random_.choice(ids), random_.randbytes(random_.choice([8, 8, 8, 3])))
        for _ in range(400)
    )
    for sizes in ([1], [2, 1, 60], [3, 50], [400]):
        assert_feeds_like_whole(own, frames, own.decode(frames), sizes)


def test_several_databases_are_one(tmp_path: Path) -> None:
    first, second = tmp_path / "first.dbc", tmp_path / "second.dbc"
    head, *messages = OWN.split("VAL_")[0].split("BO_ ")
    first.write_text("BO_ ".join([head, *messages[:3]]))
    second.write_text("BO_ ".join([head, *messages[3:]]))
    both = canser.Database(first, second)
    frames = numbered(
        frame(number, ext, bytes(8)) for number, ext in [(0x100, False), (0x18FEF177, True)]
    )
    assert set(both.decode(frames)) == {
        "Plain.First",
        "Plain.Fourth",
        "Plain.Last",
        "Broadcast.Speed",
    }
    assert list(both.messages) == [each.split()[1].rstrip(":") for each in messages]


def test_more_ids_than_are_kept(own: canser.Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canser._core.signals._IDS_MOST", 64)
    noise = [frame(number, True, bytes(8)) for number in range(1000)]
    group = [frame(0x18FEF100 + source, True, bytes([source] * 8)) for source in range(250)]
    known = [frame(0x100, False, bytes(8)), frame(0x18FEF151, True, b"\x07")]
    frames = numbered([*noise, *group, *known, *noise])
    decoder = own.decoder()
    for turn in (1, 2):
        signals = decoder.feed(frames)
        speeds = [source * 257 * 0.125 for source in range(250) if source != 0x51]
        assert signals["Speed"].values.tolist() == speeds
        assert signals["Own"].values.tolist() == [0x51, 7]
        assert len(signals["Plain.First"]) == 1
        report = decoder.report
        counts = {"SameNumber": 2, "Broadcast": 249, "OneSource": 2, "Plain": 1}
        assert report.messages == {name: turn * count for name, count in counts.items()}
        assert 0 < len(report.unknown_ids) <= 64
        kept = sum(report.unknown_ids["count"].tolist())
        assert kept + report.other_count == turn * 1998
        assert report.frame_count == turn * len(frames)


@takes_long
def test_more_pages_than_a_route_can_name() -> None:
    info = SignalInfo(
        name="S",
        start=0,
        bit_count=8,
        is_big_endian=False,
        is_signed=False,
        is_float=False,
        scale=1,
        offset=0,
        minimum=None,
        maximum=None,
        unit="",
        comment="",
        choices=None,
        multiplexer=None,
        pages=(),
        is_multiplexer=False,
    )
    plain = Message(
        name="", id=0, ext=True, length=8, pgn=None, comment="", signals={"S": info}, path=""
    )
    messages = tuple(replace(plain, name=f"M{number}", id=number) for number in range(66_000))
    decoder = SignalDecoder(Layout(messages, selected=None, keeps_raw=False))
    numbers = [0, 65_533, 65_534, 65_535, 65_536, 65_999, 66_000]
    signals = decoder.feed(numbered(frame(i, True, bytes([i % 251])) for i in numbers))
    assert {name: each.values.tolist() for name, each in signals.items()} == {
        f"M{number}.S": [number % 251] for number in numbers[:-1]
    }


def test_threads_do_not_disturb_each_other(own: canser.Database) -> None:
    random_ = random.Random(3)
    parts = [
        numbered(
            frame(random_.choice([0x100, 0x101, 0x102]), False, random_.randbytes(8))
            for _ in range(300)
        )
        for _ in range(8)
    ]
    alone = [own.decode(part) for part in parts]
    with ThreadPoolExecutor(8) as pool:
        for one, other in zip(pool.map(own.decode, parts), alone, strict=True):
            assert_same_signals(one, other)


@needs_databases
@needs_captures
def test_blocks_of_a_file_are_fed(
    captures: dict[str, tuple[FrameArray, canser.Signals]],
) -> None:
    decoder = opened("car.dbc").decoder(["ID_D4.*"])
    parts = [decoder.feed(block) for block in canser.blocks(CAPTURES / "car.serial.bin", "serial")]
    whole = captures["car"][1]
    for name in ("ID_D4.WS_FL", "ID_D4.WS_RR"):
        values = np.concatenate([part[name].values for part in parts])
        assert np.array_equal(values, whole[name].values)
    assert_same_report(decoder.report, whole.report)


# Arithmetic.


SCALED = """VERSION ""
BU_: X
BO_ 1 Each: 8 X
 SG_ Little : 0|16@1+ (0.1,-40.05) [0|0] "" X
 SG_ Big : 23|16@0+ (0.1,-40.05) [0|0] "" X
 SG_ Signed : 35|16@1- (0.1,-40.05) [0|0] "" X
"""


@pytest.mark.parametrize("times", [1, 12])  # in the cache, and past it
def test_no_product_is_fused_with_its_sum(tmp_path: Path, times: int) -> None:
    raw = np.tile(np.arange(65_536), times)
    payload = np.zeros((len(raw), 8), np.uint8)
    payload[:, 0], payload[:, 1] = raw & 255, raw >> 8
    payload[:, 2], payload[:, 3] = raw >> 8, raw & 255
    payload[:, 4:7] = (raw[:, None] << 3) >> [0, 8, 16] & 255
    frames = np.zeros(len(raw), FRAME_DTYPE)
    frames["id"], frames["dlc"], frames["data"] = 1, 8, payload
    signals = canser.Database(written(tmp_path, SCALED)).decode(frames)
    unsigned = raw * 0.1 + -40.05
    assert signals["Little"].values.tobytes() == unsigned.tobytes()
    assert signals["Big"].values.tobytes() == unsigned.tobytes()
    signed = raw.astype(np.int16) * 0.1 + -40.05
    assert signals["Signed"].values.tobytes() == signed.tobytes()


# Name, bits, sign, scale, offset, the type of the column.
COLUMNS = [
    ("I1", 64, "-", "1", "0", "i"),
    ("U1", 64, "+", "1", "0", "u"),
    ("I2", 63, "+", "1", "0", "i"),
    ("F1", 64, "+", "2", "0", "f"),
    ("F2", 64, "+", "1", "-1", "f"),
    ("F3", 64, "-", "1", "1", "f"),
    ("U2", 63, "+", "2", "1", "u"),
    ("I3", 62, "+", "-2", "0", "i"),
    ("I4", 8, "+", "2.0", "-3.0", "i"),
    ("F4", 8, "+", "1", "0.5", "f"),
    ("F5", 60, "-", "1000", "0", "f"),
    ("I5", 8, "+", "1", "-9223372036854775808", "i"),
    ("F6", 8, "+", "0.1", "0", "f"),
]


@pytest.mark.parametrize(("name", "bits", "sign", "scale", "offset", "kind"), COLUMNS)
def test_whole_numbers_stay_whole_where_they_fit(
    name: str, bits: int, sign: str, scale: str, offset: str, kind: str, tmp_path: Path
) -> None:
    text = f'VERSION ""\nBU_: X\nBO_ 1 M: 8 X\n SG_ {name} : 0|{bits}@1{sign} ({scale},{offset})'
    path = written(tmp_path, text + ' [0|0] "" X\n')
    ends = [bytes(8), b"\xff" * 8, (2**63).to_bytes(8, "little"), (2**62 + 1).to_bytes(8, "little")]
    frames = [frame(1, False, data) for data in ends]
    database = canser.Database(path)
    signals = assert_like_plain(cantools.database.load_file(path, strict=False), database, frames)
    assert signals[name].values.dtype.kind == kind
    assert signals[name].values.dtype.itemsize == 8
