"""Recordings: what the standard's own readers see in them, and what damage does to them."""

import errno
import io
import os
import random
import shutil
import struct
import subprocess
import sys
import threading
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
import pytest

import plain_pcapng
from canser import _input
from canser.errors import RecordingError
from canser.recording import writer as writing
from canser.recording.header import RecordingInfo, is_recording
from canser.recording.reader import Recording
from canser.recording.recovery import recover
from canser.recording.writer import RecordingWriter
from canser.timing.arrivals import DataBlock
from recordings import BYTE, EPOCH, INFO, MS, Got, listed, packets, recorded, spread


def test_the_file_is_what_the_standard_says() -> None:
    raw = recorded([(b"abcde", EPOCH, 0), (b"fg", EPOCH + 9, 300), (b"hijk", EPOCH + 10**9, -1)])
    section, interface, *packets, statistics = plain_pcapng.read(raw)
    assert section.kind == plain_pcapng.SECTION
    assert (section.number(4, 2), section.number(6, 2)) == (1, 0)
    assert section.body[8:16] == b"\xff" * 8
    assert section.options(16)[4].startswith(b"canser ")
    assert b"bytes lost right before" in section.options(16)[1]
    assert interface.kind == plain_pcapng.INTERFACE
    assert interface.number(0, 2) == 147
    told = interface.options(8)
    assert told[2] == b"/dev/ttyUSB0"
    words, _, base_word = told[3].partition(b" base=")
    assert words == b"canser: protocol=seeed baudrate=2000000 bitrate=500000 ts_unit=us"
    base = int(base_word[:16], 16)
    assert base < 1 << 62
    assert base_word[16:] == b"%08x" % zlib.crc32(base_word[:16])
    assert int.from_bytes(told[8], "little") == 2_000_000
    assert told[9] == b"\x09"
    seen = []
    for block in packets:
        options = block.packet_options
        assert options[3] == b"\x02" + zlib.crc32(block.packet).to_bytes(4, "little")
        packet_id = int.from_bytes(options[5], "little") - base
        dropped = int.from_bytes(options.get(4, b""), "little")
        seen.append((block.packet, block.ts, dropped, packet_id))
    assert seen == [
        (b"abcde", EPOCH, 0, 0),
        (b"fg", EPOCH + 9, 300, 305),
        (b"hijk", EPOCH + 10**9, 2**64 - 1, 307 + (1 << 32)),
    ]
    assert statistics.kind == plain_pcapng.STATISTICS
    counts = statistics.options(12)
    assert int.from_bytes(counts[4], "little") == 11
    assert int.from_bytes(counts[5], "little") == 300
    assert [struct.unpack("<II", counts[code]) for code in (2, 3)] == [
        divmod(EPOCH, 1 << 32),
        divmod(EPOCH + 10**9, 1 << 32),
    ]


def test_capinfos_reads_it(tmp_path: Path) -> None:
    if shutil.which("capinfos") is None:
        assert "CI" not in os.environ, "capinfos is missing: install wireshark-common"
        pytest.skip("capinfos, of wireshark-common, is not installed")
    path = tmp_path / "run.pcapng"
    path.write_bytes(recorded(spread(3)))
    done = subprocess.run(
        ["capinfos", "-M", path], capture_output=True, text=True, check=True, timeout=60
    )
    for line in (
        "Number of packets:   3",
        f"Data size:           {sum(len(data) for data, *_ in spread(3))}",
        "Name = /dev/ttyUSB0",
        "Description = canser: protocol=seeed baudrate=2000000 bitrate=500000 ts_unit=us",
        "Encapsulation = USER 0",
        "Time resolution = 0x09",
        "Number of packets = 3",
        "2023-11-14 22:13:20.123456789",
        "2023-11-14 22:13:22.123456789",
    ):
        assert line in done.stdout
    assert done.stderr == ""


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    pieces = spread(50)
    with RecordingWriter(path, INFO) as writer:
        for piece in pieces:
            writer.write(*piece)
    assert writer.blocks_written == 50
    assert writer.bytes_written == sum(len(data) for data, *_ in pieces)
    want = [(*piece, False) for piece in pieces]
    assert is_recording(path.read_bytes()[:12])
    for source in (path, str(path)):
        with Recording(source) as got:
            assert got.info == INFO
            assert [(bytes(data), *rest) for data, *rest in got] == want
            assert got.remarks == []
            assert got.bytes_done == got.bytes_total == path.stat().st_size


@pytest.mark.parametrize(
    "info",
    [
        RecordingInfo("any", 1, None, "ns", ""),
        RecordingInfo("any", 12_000_000, 1, "s", "socket://[::1]:5000/a b=c canser: é"),
    ],
)
def test_the_line_is_told(info: RecordingInfo) -> None:
    with Recording(cast(BinaryIO, io.BytesIO(recorded([], info)))) as got:
        assert got.info == info
        assert list(got) == []


def test_a_file_that_is_there_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    path.write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        RecordingWriter(path, INFO)
    assert path.read_bytes() == b"precious"


def test_pieces_that_follow_each_other_on_the_line_share_a_block() -> None:
    # At the line's rate, up to 2 ms late each: no time is off by more.
    rng = np.random.default_rng(2)
    on_line = EPOCH + np.arange(1, 2001) * 100 * BYTE
    came = np.maximum.accumulate(on_line + rng.integers(0, 2 * MS, 2000))
    pieces = [(rng.bytes(100), int(one), 0) for one in came]
    got, _ = listed(recorded(pieces))
    assert b"".join(data for data, *_ in got) == b"".join(data for data, *_ in pieces)
    # A second of it: by the age of chunks alone.
    assert len(got) == 4


def test_a_block_holds_64_kib_at_most() -> None:
    data = np.random.default_rng(3).bytes(300_000)
    got, _ = listed(recorded([(data[:9], EPOCH, 0), (data[9:], EPOCH + 2 * 10**9, 0)]))
    assert b"".join(data for data, *_ in got) == data
    assert [len(data) for data, *_ in got] == [9, *[1 << 16] * 4, 299_991 - (1 << 18)]
    # The parts of one piece came one after the other, the last when the piece did.
    assert [ts for _, ts, *_ in got][1:] == [
        EPOCH + 2 * 10**9 - (299_991 - end) * BYTE
        for end in (65536, 131072, 196608, 262144, 299_991)
    ]


def test_parts_never_come_before_what_was_there() -> None:
    # A line far faster than it says.
    got, _ = listed(recorded([(b"x", EPOCH, 0), (bytes(200_000), EPOCH + 1, 0)]))
    assert [ts for _, ts, *_ in got] == [EPOCH, EPOCH, EPOCH, EPOCH, EPOCH + 1]


@pytest.mark.parametrize("step", [-3600, -1, 1, 3600])
def test_a_clock_that_is_set_ends_the_block(step: int) -> None:
    pieces = [(b"a", EPOCH, 0), (b"b", EPOCH + step * 1000 * MS, 0)]
    got, _ = listed(recorded(pieces))
    assert got == [(*piece, False) for piece in pieces]


def rebuilt(got: list[Got], baudrate: int) -> list[int]:
    """Return when each byte came, by a reader that counts back at the line's rate."""
    times = []
    for data, ts, *_ in got:
        times += [ts - round((len(data) - at) * 10e9 / baudrate) for at in range(1, len(data) + 1)]
    return times


@pytest.mark.parametrize("baudrate", [9_600, 115_200, 2_000_000])
@pytest.mark.parametrize("traffic", ["frames", "bursts", "flood"])
def test_no_piece_gets_a_time_that_is_far_off(baudrate: int, traffic: str) -> None:
    rng = np.random.default_rng(4)
    pieces, came = [], EPOCH
    for _ in range(3000):
        data = rng.bytes(int(rng.integers(1, 60)))
        on_line = round(len(data) * 10e9 / baudrate)
        came += {
            "frames": on_line + int(rng.integers(0, 2 * MS)),
            "bursts": on_line + (20 * MS if rng.random() < 0.05 else 0),
            "flood": 1000,
        }[traffic]
        pieces.append((data, came, 0))
    got, _ = listed(recorded(pieces, replace(INFO, baudrate=baudrate)))
    ends = np.cumsum([len(data) for data, *_ in pieces]) - 1
    off = np.array(rebuilt(got, baudrate))[ends] - np.array([ts for _, ts, _ in pieces])
    assert np.abs(off).max() <= writing.TIME_ERROR_NS + 1
    if traffic != "flood":
        # What the format costs is bounded by time, however small the pieces are.
        seconds = (came - EPOCH) / 1e9
        assert len(got) <= 504 * seconds + 1
        assert max(len(data) for data, *_ in got) > 60, "and it is not a block for each piece"


def test_two_thousand_frames_a_second() -> None:
    pieces = [(bytes(13), EPOCH + frame * MS // 2, 0) for frame in range(20_000)]
    raw = recorded(pieces)
    got, _ = listed(raw)
    assert len(got) <= 400 * 10
    assert len(raw) <= 2.1 * 13 * 20_000


def test_a_loss_lies_between_two_blocks() -> None:
    pieces = [
        (b"a", EPOCH, 7),
        (b"b", EPOCH + 1, 0),
        (b"c", EPOCH + 2, 5),
        (b"", EPOCH + 3, 2),
        (b"d", EPOCH + 4, 3),
        (b"e", EPOCH + 5, -1),
        (b"", EPOCH + 6, 4),
        (b"", EPOCH + 6, -1),
        (b"f", EPOCH + 7, 1),
        (b"", EPOCH + 8, 9),
    ]
    raw = recorded(pieces)
    assert listed(raw)[0] == [
        (b"ab", EPOCH + 1, 7, True),
        (b"c", EPOCH + 2, 5, True),
        (b"d", EPOCH + 4, 5, True),
        (b"e", EPOCH + 5, -1, True),
        (b"f", EPOCH + 7, -1, True),
        (b"", EPOCH + 8, 9, True),
    ]
    *_, statistics = plain_pcapng.read(raw)
    assert int.from_bytes(statistics.options(12)[5], "little") == 7 + 5 + 5 + 9


@pytest.mark.parametrize("lost", [9, -1])
def test_lost_bytes_that_no_bytes_follow_are_in_the_file(tmp_path: Path, lost: int) -> None:
    path = tmp_path / "run.pcapng"
    with RecordingWriter(path, INFO) as writer:
        writer.write(b"abc", EPOCH)
        writer.write(b"", EPOCH + MS, lost)
        writer.sync()
        assert listed(path.read_bytes())[0][1:] == [(b"", EPOCH + MS, lost, True)]
        writer.write(b"def", EPOCH + 2 * MS)
        writer.write(b"", EPOCH + 3 * MS, 1)
    assert listed(path.read_bytes()) == (
        [
            (b"abc", EPOCH, 0, False),
            (b"", EPOCH + MS, lost, True),
            (b"def", EPOCH + 2 * MS, 0, False),
            (b"", EPOCH + 3 * MS, 1, True),
        ],
        [],
    )
    counts = plain_pcapng.read(path.read_bytes())[-1].options(12)
    assert int.from_bytes(counts[4], "little") == writer.bytes_written == 6
    assert int.from_bytes(counts[5], "little") == max(lost, 0) + 1


def test_notes_lie_between_the_bytes(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    with RecordingWriter(path, INFO) as writer:
        writer.write(b"abc", EPOCH)
        writer.note("the clock was set: é", EPOCH + 1)
        writer.note("and\nagain\x1b", EPOCH + 2)
        writer.write(b"defg", EPOCH + 3, 5)
        writer.note("the end", EPOCH + 4)
        with pytest.raises(ValueError, match="the note has 65,536 bytes; 65,535 are possible"):
            writer.note("é" * (1 << 15), EPOCH + 5)
    raw = path.read_bytes()
    assert packets(raw)[-1].packet_options[1] == b"the end"
    pieces, remarks = listed(raw)
    assert pieces == [(b"abc", EPOCH, 0, False), (b"defg", EPOCH + 3, 5, True)]
    assert remarks == [
        "note at byte 3 of the line: the clock was set: é",
        "note at byte 3 of the line: and again",
        "note at byte 7 of the line: the end",
    ]
    with pytest.raises(ValueError, match="closed"):
        writer.note("too late", EPOCH + 6)


def test_of_many_notes_not_every_one_is_told(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    with RecordingWriter(path, INFO) as writer:
        for number in range(30):
            writer.note(f"note {number}", EPOCH + number)
            writer.write(b"x", EPOCH + number)
    pieces, remarks = listed(path.read_bytes())
    assert len(pieces) == 30
    assert len(remarks) == 21
    assert remarks[-1] == "more notes are in the file, and not given one by one"


def test_poll_closes_a_chunk_that_is_old(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    with RecordingWriter(path, INFO) as writer:
        writer.write(b"abc", EPOCH)
        writer.poll(EPOCH + 249 * MS)
        assert writer.blocks_written == 0
        writer.poll(EPOCH + 250 * MS)
        assert (writer.blocks_written, writer.bytes_written) == (1, 3)
        assert [block.packet for block in plain_pcapng.read(path.read_bytes())[2:]] == [b"abc"]
        writer.write(b"def", EPOCH + 500 * MS)
        writer.sync()
        assert writer.blocks_written == 2


def test_it_is_written_through_once_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = "fdatasync" if hasattr(os, "fdatasync") else "fsync"
    sizes: list[int] = []
    plain = getattr(os, name)

    def watched(descriptor: int) -> None:
        plain(descriptor)
        sizes.append(os.fstat(descriptor).st_size)

    monkeypatch.setattr(os, name, watched)
    path = tmp_path / "run.pcapng"
    with RecordingWriter(path, INFO) as writer:
        assert sizes, "the header is on the disk before anything comes"
        sizes.clear()
        for step in range(1000):  # ten seconds
            writer.write(b"0123456789", EPOCH + step * 10 * MS)
            on_disk = sizes[-1] if sizes else 0
        assert 9 <= len(sizes) <= 11
        quiet = len(sizes)
        writer.poll(EPOCH + 12_000 * MS)
        assert len(sizes) == quiet + 1
        writer.poll(EPOCH + 20_000 * MS)
        assert len(sizes) == quiet + 1, "nothing has come since"
        assert on_disk < sizes[-1]
    assert sizes[-1] == path.stat().st_size


def test_a_writer_that_is_closed_says_so(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "run.pcapng", INFO)
    writer.close()
    writer.close()
    with pytest.raises(ValueError, match="closed"):
        writer.write(b"x", EPOCH)
    with pytest.raises(ValueError, match="closed"):
        writer.poll(EPOCH)
    with pytest.raises(ValueError, match="closed"):
        writer.sync()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows lets no open file be moved")
@pytest.mark.parametrize("how", ["removed", "renamed", "replaced"])
def test_a_name_that_is_lost_is_seen_within_a_second_and_at_the_end(
    tmp_path: Path, how: str
) -> None:
    path, other = tmp_path / "run.pcapng", tmp_path / "other"
    for wait_s in (1, 0):
        writer = RecordingWriter(path, INFO)
        writer.poll(EPOCH)
        assert (writer.vanished, writer.renamed) == (False, False)
        if how == "removed":
            path.unlink()
        elif how == "renamed":
            path.rename(other)
        else:
            other.write_text("other")
            other.replace(path)
        writer.poll(EPOCH + wait_s * 1000 * MS)
        assert writer.vanished == bool(wait_s)
        writer.close()
        assert (writer.vanished, writer.renamed) == (True, how == "renamed")
        path.unlink(missing_ok=True)


# A limit on the size of files is to the writer what a full disk is.
FILLER = """
import errno, random, resource, sys
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter

path, room = sys.argv[1], int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
data = random.Random(5).randbytes(50_000)
try:
    with RecordingWriter(path, RecordingInfo("any", 2_000_000, None, "ms", "x")) as writer:
        try:
            for second in range(100):
                writer.write(data, 10**18 + second * 10**9)
        except OSError as error:
            assert error.errno == errno.EFBIG
            try:
                writer.write(data, 0)
            except ValueError as again:
                print(again)
            raise
except OSError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="limits on file sizes are POSIX")
@pytest.mark.parametrize("room", [0, 1, 100, 3_000, 65_536, 200_001])
def test_a_full_disk_leaves_a_file_that_is_good(room: int, tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    done = subprocess.run(
        [sys.executable, "-c", FILLER, path, str(room)], capture_output=True, text=True, check=True
    )
    *again, error = done.stdout.splitlines()
    assert "File too large" in error
    header = recorded([], RecordingInfo("any", 2_000_000, None, "ms", "x"), close=False)
    if room < len(header):
        assert not path.exists()
        return
    assert again == ["the recording is closed, or its disk was full; start a new one"]
    raw = path.read_bytes()
    data = random.Random(5).randbytes(50_000)
    whole = (room - len(header)) // (len(data) + 64)
    assert len(raw) == len(header) + whole * (len(data) + 60)
    plain_pcapng.read(raw)
    pieces, remarks = listed(raw)
    assert remarks == []
    assert [piece for piece, *_ in pieces] == [data] * whole


@pytest.mark.parametrize("at", ["write", "fdatasync"])
@pytest.mark.skipif(sys.platform != "linux", reason="fdatasync is not everywhere")
def test_errors_name_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: str) -> None:
    path = tmp_path / "run.pcapng"

    def fail(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, at, fail)
        with pytest.raises(OSError, match="No space left") as caught:
            RecordingWriter(path, INFO)
    assert caught.value.filename == str(path)
    assert not path.exists()
    with RecordingWriter(path, INFO) as writer:
        writer.write(b"abc", EPOCH)
        with monkeypatch.context() as patch:
            patch.setattr(os, at, fail)
            with pytest.raises(OSError, match="No space left") as caught:
                writer.sync()
        assert caught.value.filename == str(path)


@pytest.mark.skipif(sys.platform != "linux", reason="fdatasync is not everywhere")
def test_after_a_failed_sync_only_what_was_synced_before_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A system tells once that it has lost what it could not write, and then forgets it."""
    failures = [OSError(errno.EIO, os.strerror(errno.EIO))]

    def fail_once(_: int) -> None:
        if failures:
            raise failures.pop()

    writer = RecordingWriter(tmp_path / "run.pcapng", INFO)
    writer.write(b"good", EPOCH)
    writer.sync()
    assert writer.bytes_synced == 4
    monkeypatch.setattr(os, "fdatasync", fail_once)
    writer.write(b"unknown", EPOCH + 1000 * MS)
    with pytest.raises(OSError, match="Input/output error"):
        writer.sync()
    assert not failures
    with pytest.raises(ValueError, match="start a new one"):
        writer.sync()
    writer.close()
    assert (writer.bytes_written, writer.bytes_synced) == (11, 4)


@pytest.mark.skipif(sys.platform != "linux", reason="fdatasync is not everywhere")
@pytest.mark.parametrize("syncs", [True, False])
def test_what_was_written_before_the_disk_was_full_is_synced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, syncs: bool
) -> None:
    writer = RecordingWriter(tmp_path / "run.pcapng", INFO)
    writer.write(b"before", EPOCH)
    writer.poll(EPOCH + 300 * MS)
    writer.write(b"last", EPOCH + 400 * MS)

    def fail(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", fail)
        if not syncs:
            patch.setattr(os, "fdatasync", fail)
        with pytest.raises(OSError, match="No space left"):
            writer.sync()
    writer.close()
    assert (writer.bytes_written, writer.bytes_synced) == (6, 6 if syncs else 0)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is not here")
def test_a_full_device_is_told() -> None:
    with open("/dev/full", "wb", buffering=0) as file, pytest.raises(OSError) as caught:  # noqa: PTH123, PT011
        RecordingWriter(cast(BinaryIO, file), INFO)
    assert caught.value.errno == errno.ENOSPC


# Damage.


def test_every_length_of_a_torn_file_gives_its_whole_blocks() -> None:
    raw = recorded(spread(6))
    whole = plain_pcapng.read(raw)
    header = whole[2].offset
    for length in range(len(raw) + 1):
        torn = raw[:length]
        if length < header:
            with pytest.raises(RecordingError, match="no recording"):
                listed(torn)
            continue
        inside = [block for block in whole if block.end <= length]
        pieces, remarks = listed(torn)
        assert [(data, ts) for data, ts, *_ in pieces] == [
            (block.packet, block.ts) for block in inside if block.kind == plain_pcapng.PACKET
        ]
        missing = length - inside[-1].end
        assert len(remarks) == bool(missing)
        if missing:
            assert remarks[0].startswith(f"torn tail, left out: {missing:,} bytes at byte ")
            assert f"at byte {inside[-1].end:,}: " in remarks[0]


@pytest.mark.parametrize("tail", [1, 4096, 100_000])
def test_a_tail_of_zeros_is_left_out(tail: int) -> None:
    # What some file systems leave after a loss of power.
    raw = recorded(spread(3), close=False)
    pieces, remarks = listed(raw + bytes(tail))
    assert pieces == [(*piece, False) for piece in spread(3)]
    assert remarks == [
        f"torn tail, left out: {tail:,} bytes at byte {len(raw):,}: no block starts there"
    ]


@pytest.mark.parametrize("aged", [False, True])
@pytest.mark.parametrize("mask", [0x01, 0x80, 0xFF, 0x07])
def test_a_flipped_byte_never_gives_wrong_bytes(mask: int, aged: bool) -> None:
    raw = recorded([*spread(4), (b"behind a gap", EPOCH + 10**10, 77)])
    if aged:
        raw = plain_pcapng.without_ids(raw)
    want = listed(raw)[0]
    times = {at for block in packets(raw) for at in range(block.offset + 12, block.offset + 20)}
    # The last options are the drop count, where it is written, and the id.
    numbers = {at for block in packets(raw) for at in range(block.end - 16, block.end - 8)}
    drops = set(range(packets(raw)[-1].end - 28, packets(raw)[-1].end - 20))
    ids: set[int] = set()
    if aged:
        drops = numbers
    else:
        ids = numbers
    interface = plain_pcapng.read(raw)[1]
    told = range(interface.offset, interface.end)
    hurt = 0
    for at in range(len(raw)):
        bad = bytearray(raw)
        bad[at] ^= mask
        try:
            pieces, remarks = listed(bytes(bad))
        except RecordingError:
            assert at < interface.end, "a header that cannot be read"
            continue
        if at in times or at in drops:
            # The standard's hash is of the bytes alone; an impossible time is damage as any.
            assert [piece[0] for piece in pieces] == [piece[0] for piece in want] or remarks
            assert {piece[0] for piece in pieces} <= {piece[0] for piece in want}
            continue
        if at in ids:
            # That block is left out, or what is lost before it is told wrong; the others are here.
            hurt_block = next(
                piece for piece, b in zip(want, packets(raw), strict=True) if at < b.end
            )
            assert pieces != want
            left = [piece[:2] for piece in pieces if piece[:2] != hurt_block[:2]]
            assert left == [piece[:2] for piece in want if piece is not hurt_block]
            assert len(left) < len(pieces) or remarks
            continue
        if pieces == want:
            continue
        assert at not in told
        hurt += 1
        assert remarks
        missing = [piece for piece in want if piece[:2] not in [got[:2] for got in pieces]]
        assert len(missing) == 1
        where = want.index(missing[0])
        rest = want[where + 1 :]
        if rest:  # what comes behind the damage says so, and the ids how much is missing
            lost = -1 if aged else len(missing[0][0]) + rest[0][2]
            rest[0] = (*rest[0][:2], lost, True)
        assert pieces == want[:where] + rest
    assert hurt > sum(len(piece[0]) for piece in want)


def raw_block(kind: int, body: bytes, order: str = "<") -> bytes:
    length = struct.pack(f"{order}I", len(body) + 12)
    return struct.pack(f"{order}I", kind) + length + body + length


def packet(interface: int, data: bytes) -> bytes:
    """Return a packet as other programs write it: without options."""
    fixed = struct.pack("<5I", interface, 0, 0, len(data), len(data))
    return raw_block(plain_pcapng.PACKET, fixed + data + bytes(-len(data) % 4))


OTHER = raw_block(plain_pcapng.INTERFACE, struct.pack("<HHI", 1, 0, 65535))  # Ethernet


def test_what_is_not_ours_is_skipped() -> None:
    raw = recorded(spread(3))
    blocks = plain_pcapng.read(raw)
    cut = [raw[block.offset : block.end] for block in blocks]
    unknown = raw_block(0x40000BAD, b"\0\0\x7e\x9bvendor!!")
    mixed = cut[0] + unknown + cut[1] + OTHER + packet(1, b"ether") + cut[2] + unknown
    mixed += packet(1, b"") + cut[3] + OTHER + cut[4] + packet(2, b"x") + cut[5]
    pieces, remarks = listed(mixed)
    assert pieces == listed(raw)[0]
    assert remarks == ["blocks that are none of canser's, skipped: 5"]


def test_our_interface_need_not_be_the_first() -> None:
    raw = recorded(spread(3))
    section, interface, *rest = plain_pcapng.read(raw)
    moved = raw[: section.end] + OTHER + packet(0, b"ether") + raw[section.end : interface.end]
    for block in rest:
        one = bytearray(raw[block.offset : block.end])
        one[8:12] = b"\x01\0\0\0"  # the interface of a packet, and of statistics
        moved += one
    assert listed(moved)[0] == listed(raw)[0]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nothing", "no recording"),
        ("raw bytes", "no recording"),
        ("other programs' packets", "no interface of canser's"),
        ("a later version", "version that is not known"),
        ("damaged interface", "the block is cut short"),
    ],
)
def test_a_file_without_a_line_is_an_error(name: str, words: str) -> None:
    raw = bytearray(recorded(spread(3)))
    section, interface, *_ = plain_pcapng.read(bytes(raw))
    raw[12] = 2 if name == "a later version" else 1
    if name == "damaged interface":
        raw[interface.offset + 6] = 1
    if name == "other programs' packets":
        raw = raw[: section.end] + OTHER + packet(0, b"ether")
    bad = {"nothing": b"", "raw bytes": bytes(range(256)) * 9}.get(name, bytes(raw))
    with pytest.raises(RecordingError, match=words) as caught:
        listed(bad)
    assert "\n" not in str(caught.value)


def swapped(raw: bytes) -> bytes:
    """Return a file in the other byte order, as a big-endian machine writes it."""

    def turn(data: bytes, *sizes: int) -> bytes:
        out, at = b"", 0
        for size in sizes:
            out += data[at : at + size][::-1]
            at += size
        return out + data[at:]

    values: dict[int, dict[int, tuple[int, ...]]] = {
        plain_pcapng.SECTION: {},
        plain_pcapng.INTERFACE: {8: (8,)},
        plain_pcapng.PACKET: {3: (1, 4), 4: (8,), 5: (8,)},
        plain_pcapng.STATISTICS: {2: (4, 4), 3: (4, 4), 4: (8,), 5: (8,)},
    }
    fixed: dict[int, tuple[int, ...]] = {
        plain_pcapng.SECTION: (4, 2, 2, 8),
        plain_pcapng.INTERFACE: (2, 2, 4),
        plain_pcapng.PACKET: (4,) * 5,
        plain_pcapng.STATISTICS: (4,) * 3,
    }
    out = b""
    for block in plain_pcapng.read(raw):
        at = sum(fixed[block.kind])
        body = turn(block.body[:at], *fixed[block.kind])
        if block.kind == plain_pcapng.PACKET:
            padded = len(block.packet) + -len(block.packet) % 4
            body += block.body[at : at + padded]
            at += padded
        for code, value in block.options(at).items():
            body += struct.pack(">HH", code, len(value))
            body += turn(value, *values[block.kind].get(code, ())) + bytes(-len(value) % 4)
        out += raw_block(block.kind, body + bytes(4), ">")
    return out


def test_both_byte_orders_are_read() -> None:
    raw = recorded([*spread(4), (b"x", EPOCH + 10**11, 5)])
    big = swapped(raw)
    assert is_recording(big[:12])
    assert listed(big) == listed(raw)
    both = listed(raw + big)[0]
    assert [piece[0] for piece in both] == [piece[0] for piece in listed(raw)[0]] * 2
    torn = bytearray(big)
    torn[plain_pcapng.read(big)[3].offset + 5] ^= 1
    assert len(listed(bytes(torn))[0]) == 4


@pytest.mark.parametrize("cut", [0, 1, 30, 66, 80, 81, 82, 83])
def test_recordings_behind_one_another(cut: int) -> None:
    # The first may be torn, and then the second starts anywhere.
    first, second = spread(4), spread(3, seed=9)
    one = recorded(first, close=cut == 0)
    assert cut < len(one)
    pieces, remarks = listed(one[: len(one) - cut] + recorded(second))
    whole = 4 if cut == 0 else sum(b.end <= len(one) - cut for b in packets(one))
    lost = 0 if cut == 0 else -1
    assert pieces == [
        *((*piece, False) for piece in first[:whole]),
        (second[0][0], second[0][1], lost, True),
        *((*piece, False) for piece in second[1:]),
    ]
    assert len(remarks) == bool(cut)


def test_recordings_of_different_lines_are_not_mixed() -> None:
    other = replace(INFO, protocol="other")
    raw = recorded(spread(3)) + recorded(spread(2, seed=9), other) + recorded(spread(1, seed=8))
    pieces, remarks = listed(raw)
    assert [piece[0] for piece in pieces] == [
        *(data for data, *_ in spread(3)),
        *(data for data, *_ in spread(1, seed=8)),
    ]
    assert "is another line: left out" in remarks[0]
    assert remarks[1] == "blocks that are none of canser's, skipped: 2"


@pytest.mark.parametrize("damage", ["bytes", "head", "length", "hole", "zeros", "inserted"])
@pytest.mark.parametrize("window", [1 << 16, 8 << 20])
@pytest.mark.parametrize("mapped", [False, True])
@pytest.mark.parametrize("aged", [False, True])
def test_reading_goes_on_behind_damage(
    damage: str,
    window: int,
    mapped: bool,
    aged: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_input, "WINDOW", window)
    monkeypatch.setattr(_input, "CHUNK", 5000)
    rng = np.random.default_rng(6)
    sent = [(rng.bytes(30_000), EPOCH + second * 1000 * MS, 0) for second in range(40)]
    written = recorded(sent)
    raw = bytearray(plain_pcapng.without_ids(written) if aged else written)
    hurt = packets(bytes(raw))[17]
    if damage == "bytes":
        raw[hurt.offset + 5000] ^= 0x10
    elif damage == "head":
        raw[hurt.offset : hurt.offset + 64] = bytes(64)
    elif damage == "length":
        raw[hurt.offset + 6] ^= 0xFF
    elif damage == "hole":
        del raw[hurt.offset + 1000 : hurt.offset + 1777]
    elif damage == "zeros":
        raw[hurt.offset + 10 : hurt.offset + 4096] = bytes(4086)
    else:
        # Marks of blocks that are none.
        raw[hurt.offset : hurt.offset] = b"\x0a\x0d\x0d\x0a\x06\0\0\0" * 500 + b"\x06"
    want = [(*piece, False) for piece in sent]
    if damage != "inserted":
        del want[17]
        want[17] = (*want[17][:2], 30_000, True)
    if aged:
        want[17] = (*want[17][:2], -1, True)
    path = tmp_path / "run.pcapng"
    path.write_bytes(raw)
    source: BinaryIO = path.open("rb") if mapped else cast(BinaryIO, io.BytesIO(raw))
    with source, Recording(source) as got:
        assert [(bytes(data), *rest) for data, *rest in got] == want
        (remark,) = got.remarks
    assert remark.startswith("left out: ")
    assert f" bytes at byte {hurt.offset:,}: " in remark


def test_of_much_damage_not_every_place_is_named() -> None:
    raw = bytearray(recorded(spread(200)))
    for block in packets(bytes(raw))[::2]:
        raw[block.offset + 28] ^= 1
    pieces, remarks = listed(bytes(raw))
    assert [piece[0] for piece in pieces] == [data for data, *_ in spread(200)[1::2]]
    assert len(remarks) == 21
    assert remarks[-1] == "more is left out, and not named one by one"


def test_pieces_of_a_pipe_come_as_they_are_written() -> None:
    reader, writer = os.pipe()
    with open(reader, "rb") as source, open(writer, "wb", buffering=0) as sink:  # noqa: PTH123
        target = RecordingWriter(cast(BinaryIO, sink), INFO)
        got: list[Got] = []
        recorded_pieces = Recording(source)
        for data, *rest in spread(3):
            target.write(data, *rest)
            target.sync()
            # Read by a thread: if a piece were held back this would wait for ever.
            thread = threading.Thread(target=lambda: got.append(_own(next(recorded_pieces))))
            thread.start()
            thread.join(60)
            assert not thread.is_alive()
            assert got[-1] == (data, *rest, False)
        target.close()
        sink.close()
        assert list(recorded_pieces) == []


def _own(piece: DataBlock) -> Got:
    return bytes(piece.data), piece.arrival_ns, piece.lost, piece.gap


def test_a_file_is_read_from_where_it_stands(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    path.write_bytes(b"header!" + recorded(spread(3)))
    with path.open("rb") as file:
        file.seek(7)
        with Recording(file) as got:
            assert [_own(piece) for piece in got] == [(*piece, False) for piece in spread(3)]
        assert not file.closed


def test_memory_stays_bounded(tmp_path: Path) -> None:
    path = tmp_path / "large.pcapng"
    data = np.random.default_rng(7).bytes(60_000)
    with RecordingWriter(path, INFO) as writer:
        for second in range(4000):
            writer.write(data, EPOCH + second * 1000 * MS)
    code = (
        "import sys\n"
        "from canser.recording.reader import Recording\n"
        "peak = lambda: int([line.split()[1] for line in open('/proc/self/status')"
        " if line.startswith('VmHWM')][0])\n"
        "before = peak()\n"
        "file = open(0, 'rb') if sys.argv[1] == '-' else sys.argv[1]\n"
        "count = sum(len(piece.data) for piece in Recording(file))\n"
        "print(count, peak() - before)\n"
    )
    if not Path("/proc/self/status").exists():
        pytest.skip("resident memory by /proc")
    for argument in (str(path), "-"):
        # A pipe, which cannot be mapped.
        stdin = subprocess.Popen(["cat", path], stdout=subprocess.PIPE)
        done = subprocess.run(
            [sys.executable, "-c", code, argument],
            stdin=stdin.stdout,
            capture_output=True,
            text=True,
            check=True,
        )
        assert stdin.stdout is not None
        stdin.stdout.close()
        stdin.wait()
        count, kib = map(int, done.stdout.split())
        assert count == 240_000_000
        assert kib < 64 << 10


# Recovery.


def older() -> bytes:
    blocks = packets(raw := recorded(spread(4, seed=12)))
    return raw[blocks[0].offset : blocks[-1].end]


def damages() -> dict[str, Callable[[bytearray], object]]:
    return {
        "none": bytearray.copy,
        "torn": lambda raw: raw.__delitem__(slice(-100, None)),
        "bytes": lambda raw: raw.__setitem__(packets(bytes(raw))[3].offset + 30, 0x0A),
        "hole": lambda raw: raw.__delitem__(slice(700, 777)),
        "zeros": lambda raw: raw.__setitem__(slice(600, 1200), bytes(600)),
        "behind": lambda raw: raw.extend(recorded(spread(5, seed=11), close=False)[:-3]),
        "older": lambda raw: raw.__setitem__(slice(700, 1200), older()),
        "torn and behind": lambda raw: raw.__setitem__(slice(-50, None), recorded(spread(5))),
    }


@pytest.mark.parametrize("damage", damages())
def test_the_repaired_copy_gives_what_the_damaged_file_gives(damage: str) -> None:
    raw = bytearray(recorded([*spread(20), (b"after a loss", EPOCH + 10**12, 5)]))
    damages()[damage](raw)
    want, remarks = listed(bytes(raw))
    assert len(want) >= 12
    target = io.BytesIO()
    done = recover(cast(BinaryIO, io.BytesIO(raw)), cast(BinaryIO, target))
    assert done.remarks == remarks
    assert (done.info, done.blocks) == (INFO, len(want))
    assert done.bytes_kept == sum(len(piece[0]) for piece in want)
    # The drop count that says so behind the torn end takes room.
    added = 12 if damage == "torn and behind" else 0
    assert done.bytes_left_out == len(raw) - len(target.getvalue()) + added
    assert (damage == "none") == (done.bytes_left_out == 0)
    plain_pcapng.read(target.getvalue())
    assert listed(target.getvalue()) == (want, [])
    if damage == "none":
        assert target.getvalue() == raw


def test_nothing_can_be_recovered_from_no_recording() -> None:
    with pytest.raises(RecordingError, match="no recording"):
        recover(cast(BinaryIO, io.BytesIO(bytes(1000))), cast(BinaryIO, io.BytesIO()))
