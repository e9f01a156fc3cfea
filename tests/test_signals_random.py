"""Signals of random databases against the plain decoder, of real ones against cantools."""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

cantools = pytest.importorskip("cantools")

import canser  # noqa: E402
from databases import (  # noqa: E402
    assert_like_plain,
    by_frame,
    each_database,
    frame,
    full,
    needs_databases,
    numbered,
    opened,
    parsed,
    shown,
)
from long import EXAMPLES  # noqa: E402
from plain_signals import decode_signals  # noqa: E402
from reference import ID_EXT_MAX, ID_MAX, Frame  # noqa: E402

# The text of a database.

NUMBERS = st.one_of(
    st.sampled_from(["1", "2", "-1", "0.1", "-0.5", "0.001", "1e-07", "3.0", "1000", "9876543210"]),
    st.floats(-1e6, 1e6, allow_nan=False).filter(bool).map(repr),
)
SCALINGS = st.one_of(
    st.just(("1", "0")),
    st.tuples(NUMBERS, st.one_of(st.sampled_from(["0", "-40.05", "7", "-128"]), NUMBERS)),
)


@dataclass
class Line:
    """A signal."""

    name: str
    place: str
    is_float: bool
    is_multiplexer: bool = False
    parent: str | None = None
    pages: tuple[tuple[int, int], ...] = ()
    texts: tuple[int, ...] = ()

    def text(self) -> str:
        mark = f"m{self.pages[0][0]}" if self.parent else ""
        mark += "M" if self.is_multiplexer else ""
        return f' SG_ {self.name} {mark} : {self.place} [0|0] "" X\n'

    def selects(self, number: int) -> str:
        if self.parent is None:
            return ""
        ranges = ", ".join(f"{low}-{high}" for low, high in self.pages)
        return f"SG_MUL_VAL_ {number} {self.name} {self.parent} {ranges};\n"

    def names(self, number: int) -> str:
        texts = "".join(f'{value} "text {value}" ' for value in self.texts)
        return f"VAL_ {number} {self.name} {texts};\n" if texts else ""

    def type(self, number: int) -> str:
        kind = 2 if "|64@" in self.place else 1
        return f"SIG_VALTYPE_ {number} {self.name} : {kind};\n" if self.is_float else ""


@st.composite
def placed(draw: st.DrawFn, name: str, room: int, longest: int, floats: bool) -> Line:
    """Return a signal anywhere in `room` bits; one may lie over the other."""
    is_float = floats and room >= 16 and draw(st.integers(0, 4)) == 0
    lengths = [each for each in (16, 32, 64) if each <= room]
    length = draw(st.sampled_from(lengths) if is_float else st.integers(1, min(room, longest)))
    first = draw(st.integers(0, room - length))
    little = draw(st.booleans())
    start = first if little else first // 8 * 8 + 7 - first % 8
    sign = draw(st.sampled_from("+-"))
    scale, offset = draw(SCALINGS) if floats else ("1", "0")
    return Line(name, f"{start}|{length}@{int(little)}{sign} ({scale},{offset})", is_float)


PAGES = st.lists(
    st.tuples(st.integers(0, 7), st.integers(0, 3)).map(lambda pair: (pair[0], sum(pair))),
    min_size=1,
    max_size=3,
).map(tuple)


# Signals with texts keep their raw numbers; a multiplexer's value with a text is known.
TEXTS = st.just(()) | st.lists(st.integers(-1, 8), min_size=1, max_size=3, unique=True).map(tuple)


@st.composite
def signals(draw: st.DrawFn, room: int) -> list[Line]:
    """Return the signals of a message, with up to three multiplexers, side by side or nested."""
    lines: list[Line] = []
    for i in range(draw(st.integers(0, 3))):
        line = draw(placed(f"Page{i}", room, 4, floats=False))
        line.is_multiplexer = True
        line.texts = draw(TEXTS)
        is_below = draw(st.booleans())
        if lines and is_below:
            line.parent, line.pages = draw(st.sampled_from(lines)).name, draw(PAGES)
        lines.append(line)
    multiplexers = list(lines)
    for i in range(draw(st.integers(1, 6))):
        line = draw(placed(f"S{i}", room, 64, floats=True))
        line.texts = draw(TEXTS)
        is_below = draw(st.booleans())
        if multiplexers and is_below:
            line.parent, line.pages = draw(st.sampled_from(multiplexers)).name, draw(PAGES)
        lines.append(line)
    return list(draw(st.permutations(lines)))


IDS = st.one_of(
    st.tuples(st.integers(0, ID_MAX), st.just(False)),
    st.tuples(st.integers(0, ID_EXT_MAX), st.just(True)),
    st.tuples(st.integers(0, ID_EXT_MAX >> 8).map(lambda top: top << 8 | 0xFE), st.just(True)),
)


@st.composite
def databases(draw: st.DrawFn) -> str:
    """Return the text of a database."""
    ids = draw(st.lists(IDS, min_size=1, max_size=3, unique_by=lambda each: each[0] >> 8 & 0x3FF00))
    messages, rest = "", ""
    for i, (number, ext) in enumerate(ids):
        coded = number | ext << 31
        length = draw(st.sampled_from([8, 8, 8, 5, 1, 0]))
        lines = draw(signals(8 * length)) if length else []
        messages += f"BO_ {coded} M{i}: {length} X\n" + "".join(x.text() for x in lines) + "\n"
        rest += "".join(x.selects(coded) + x.type(coded) + x.names(coded) for x in lines)
    return f'VERSION ""\n\nBU_: X\n\n{messages}{rest}'


def frames_for(database: Any) -> st.SearchStrategy[list[Frame]]:
    """Return frames: most of them are of a message, some of its group, or of none."""

    @st.composite
    def one(draw: st.DrawFn) -> Frame:
        message = draw(st.sampled_from(database.messages))
        number, ext = message.frame_id, message.is_extended_frame
        if ext and draw(st.integers(0, 3)) == 0:
            number ^= draw(st.sampled_from([0x21, 0x0C000000, 0x3300, 0x01000000, 0x2FF]))
        elif draw(st.integers(0, 9)) == 0:
            number, ext = draw(IDS)
        data = draw(st.binary(min_size=8, max_size=8))
        data = data[: draw(st.one_of(st.just(8), st.integers(0, 8)))]
        made = frame(number, ext, data)
        kind = draw(st.integers(0, 19))
        if kind == 0:
            return made._replace(rtr=True, data=bytes(8))
        return made._replace(err=True) if kind == 1 else made

    return st.lists(one(), max_size=12)


def open_text(text: str) -> tuple[Any, canser.Database]:
    """Return a database as cantools has it, and as canser has it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "random.dbc"
        path.write_text(text)
        return cantools.database.load_file(str(path), strict=False), canser.Database(path)


@given(st.data())
def test_random_databases(data: st.DataObject) -> None:
    theirs, ours = open_text(data.draw(databases()))
    for _ in range(3):
        assert_like_plain(theirs, ours, data.draw(frames_for(theirs)))


@settings(max_examples=EXAMPLES // 2)
@given(st.data())
def test_groups_of_random_databases(data: st.DataObject) -> None:
    theirs, ours = open_text(data.draw(databases()))
    frames = numbered(data.draw(frames_for(theirs)))
    decoded = ours.decode(frames, raw=True)
    found = set()
    for name, group in decoded.groups.items():
        assert group.name == name
        for signal in group.values():
            assert np.array_equal(signal.ts, group.ts)
            found.add(signal.full_name)
    assert found == set(decoded)
    # The same of a selection, in pieces, into arrays that are used again.
    known = sorted(f"{m.name}.{signal.name}" for m in theirs.messages for signal in m.signals)
    names = data.draw(st.lists(st.sampled_from(known), unique=True)) if known else []
    cut = data.draw(st.integers(0, len(frames)))
    decoder = ours.decoder(names)
    parts = [decoder.feed(frames[:cut]), decoder.feed(frames[cut:])]
    room = ours.decode(frames[:cut], names)
    again = ours.decode(frames, names, out=room)
    for name in names:
        whole = decoded.get(name)
        expected = whole.values.tolist() if whole else []
        pieces = [value for part in parts for value in part[name].values.tolist()]
        assert shown_all(pieces) == shown_all(expected)
        assert shown_all(again[name].values.tolist()) == shown_all(expected)
    assert set(again) == set(names)


def shown_all(values: list[Any]) -> list[Any]:
    return [shown({"": value}) for value in values]


@needs_databases
@each_database
@settings(max_examples=max(EXAMPLES // 5, 5))
@given(st.data())
def test_random_payloads_of_real_databases(name: str, data: st.DataObject) -> None:
    messages = [message for message in parsed(name).messages if message.length <= 8]
    payload = st.binary(max_size=8) | st.binary(min_size=8, max_size=8)
    drawn = data.draw(
        st.lists(st.tuples(st.sampled_from(messages), payload), min_size=10, max_size=30)
    )
    frames = [frame(each.frame_id, each.is_extended_frame, content) for each, content in drawn]
    made = by_frame(opened(name).decode(numbered(frames)), len(frames))
    for (message, content), has in zip(drawn, made, strict=True):
        try:
            wanted = message.decode(content, decode_choices=False, allow_truncated=True)
        except cantools.database.DecodeError:
            wanted = decode_signals(message, content).values
        assert shown(has) == shown(full(message.name, wanted)), (message.name, content.hex())
