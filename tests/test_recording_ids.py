"""Blocks that are good, but not where they belong: their ids tell, and what is missing."""

import io
from typing import BinaryIO, cast

import hypothesis.strategies as st
from hypothesis import given

import plain_pcapng
from canser.errors import RecordingError
from canser.recording.recovery import recover
from recordings import EPOCH, MS, Written, line, listed, packets, recorded, spread


def test_blocks_of_an_older_recording_are_left_out() -> None:
    mine, older = line(spread(8)), line(spread(8, seed=2))
    other = plain_pcapng.without_ids(recorded(spread(1, seed=3)))
    aged = other[packets(other)[0].offset : packets(other)[0].end]
    whole = [(*piece, False) for piece in spread(8)]
    for at in range(9):
        for stale in (older.blocks[:1], older.blocks[2:6], [aged]):
            blocks = [*mine.blocks[:at], *stale, *mine.blocks[at:]]
            pieces, (remark,) = listed(b"".join([mine.header, *blocks, mine.end]))
            assert pieces == whole
            begin = len(mine.header) + sum(map(len, mine.blocks[:at]))
            why = "not as canser writes it" if stale == [aged] else "of another recording"
            size = sum(map(len, stale))
            assert remark == f"left out: {size:,} bytes at byte {begin:,}: the block is {why}"


def test_blocks_that_are_there_a_second_time_are_left_out() -> None:
    told = [*spread(4), (b"behind a gap", EPOCH + 10**11, 300), (b"", EPOCH + 10**11 + 1, 7)]
    mine = line(told)
    want = [(*piece, piece[2] != 0) for piece in told]
    for at in range(1, 7):
        for first in range(at):
            again = mine.blocks[first:at]
            blocks = [*mine.blocks[:at], *again, *mine.blocks[at:]]
            pieces, (remark,) = listed(b"".join([mine.header, *blocks, mine.end]))
            assert pieces == want
            assert remark.endswith(": the block is there a second time")


def test_blocks_that_are_missing_are_a_gap_of_their_bytes() -> None:
    told = [
        *spread(3),
        (b"behind a gap", EPOCH + 10**11, 300),
        (b"", EPOCH + 10**11 + 1, 7),
        (b"next", EPOCH + 10**11 + 2 * MS, 0),
        (b"unknown", EPOCH + 10**11 + 3 * MS, -1),
        (b"", EPOCH + 10**11 + 4 * MS, -1),
        (b"last", EPOCH + 2 * 10**11, 0),
    ]
    mine = line(told)
    for chosen in range(1 << len(told)):
        kept = [number for number in range(len(told)) if chosen >> number & 1]
        want, before = [], 0
        for number in kept:
            data, ns, lost = told[number]
            missing = told[before:number]
            unknown = lost < 0 or any(one[2] < 0 for one in missing)
            lost = -1 if unknown else lost + sum(len(one[0]) + one[2] for one in missing)
            want.append((data, ns, lost, lost != 0))
            before = number + 1
        raw = b"".join([mine.header, *(mine.blocks[number] for number in kept), mine.end])
        assert listed(raw) == (want, [])


def test_the_start_of_an_older_recording_does_not_end_the_file() -> None:
    """Its sectors held an older file from its first byte on: as if that one were put behind."""
    mine, older = line(spread(8)), line(spread(3, seed=2))
    parts = [mine.header, *mine.blocks[:4], older.header, *older.blocks, *mine.blocks[6:], mine.end]
    pieces, remarks = listed(b"".join(parts))
    missing = sum(len(piece[0]) for piece in spread(8)[4:6])
    first, *others = spread(3, seed=2)
    back, last = spread(8)[6:]
    assert pieces == [
        *((*piece, False) for piece in spread(8)[:4]),
        (*first, True),
        *((*piece, False) for piece in others),
        (*back[:2], missing, True),
        (*last, False),
    ]
    assert remarks == []


def test_a_recording_behind_another_whose_section_is_damaged() -> None:
    first, second = recorded(spread(4)), recorded(spread(3, seed=9))
    section = plain_pcapng.read(second)[0]
    for at in range(section.end):
        torn = bytearray(second)
        torn[at] ^= 0x40
        pieces, _ = listed(first + torn)
        start, *others = spread(3, seed=9)
        assert pieces[:4] == [(*piece, False) for piece in spread(4)]
        assert pieces[4] in ((*start, True), (*start[:2], -1, True))
        assert pieces[5:] == [(*piece, False) for piece in others]


def test_a_recording_behind_another_whose_interface_is_gone_is_left_out() -> None:
    first, second = recorded(spread(4)), bytearray(recorded(spread(3, seed=9)))
    section, interface, *_ = plain_pcapng.read(bytes(second))
    second[section.end : interface.end] = bytes(interface.end - section.end)
    pieces, remarks = listed(first + second)
    assert pieces == [(*piece, False) for piece in spread(4)]
    assert remarks[0].startswith("torn tail, left out: ")


def test_a_recording_behind_another_begins_anew() -> None:
    raw = recorded(spread(4))
    pieces, remarks = listed(raw + raw)
    assert [piece[:2] for piece in pieces] == [piece[:2] for piece in spread(4)] * 2
    assert [piece[2:] for piece in pieces] == [
        (0, False),
        (0, False),
        (0, False),
        (0, False),
        (0, True),
        (0, False),
        (0, False),
        (0, False),
    ]
    assert remarks == []


@st.composite
def files(draw: st.DrawFn) -> bytes:
    """Return files as crashes, copies and bad sectors leave them."""
    raw = b""
    for _ in range(draw(st.integers(1, 3))):
        raw += draw(one_file())
    for _ in range(draw(st.integers(0, 2))):
        hurt = bytearray(raw)
        at = draw(st.integers(0, len(raw) - 1))
        hurt[at] ^= 1 << draw(st.integers(0, 7))
        raw = bytes(hurt)
    return raw[: len(raw) - draw(st.sampled_from([0, 0, 0, 1, 40, 300]))]


@st.composite
def one_file(draw: st.DrawFn) -> bytes:
    """Return a recording, some blocks of which are missing, there twice, or not its own."""
    told: list[Written] = []
    for number in range(draw(st.integers(1, 12))):
        lost = draw(st.sampled_from([0, 0, 0, 1, 500, -1]))
        data = draw(st.binary(min_size=0 if lost else 1, max_size=30))
        told.append((data, EPOCH + number * 1000 * MS, lost))
    mine = line(told)
    older = line(spread(3, seed=5))
    blocks = list(mine.blocks)
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, len(blocks)))
        other = draw(st.sampled_from(blocks + older.blocks + [older.header, b"noise", b""]))
        blocks[at : at + draw(st.integers(0, 2))] = [other]
    return b"".join([mine.header, *blocks, mine.end])


@given(files())
def test_the_repaired_copy_gives_what_the_file_gives(raw: bytes) -> None:
    try:
        want, remarks = listed(raw)
    except RecordingError:
        return
    target = io.BytesIO()
    done = recover(cast(BinaryIO, io.BytesIO(raw)), cast(BinaryIO, target))
    assert done.remarks == remarks
    assert (done.blocks, done.bytes_kept) == (len(want), sum(len(piece[0]) for piece in want))
    # What says that an unknown number of bytes is missing takes room.
    added = len(target.getvalue()) - (len(raw) - done.bytes_left_out)
    assert added in range(0, 12 * len(want) + 1, 12)
    copy, remarks = listed(target.getvalue())
    assert copy == want
    assert not [remark for remark in remarks if "left out: " in remark]
