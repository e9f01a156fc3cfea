"""Captures in files: read and blocks, mapped and piped."""

import bz2
import copy
import gzip
import io
import mmap
import os
import pickle
import re
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
import pytest

import canser
from canser import _input
from canser._frames import FRAME_DTYPE, FrameArray
from canser.codec import doubt
from canser.errors import CanserWarning, FormatError, NoProtocolError
from canser.files import raw
from canser.files.raw import BLOCK_FRAMES
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter
from canser.simulation.traffic import line_noise, vehicle
from reference import WIRE_FORMATS

PROTOCOLS = canser.protocols()


def capture_of(protocol: str, tmp_path: Path, seconds: float = 3) -> tuple[Path, FrameArray]:
    frames = vehicle(seconds, extended=WIRE_FORMATS[protocol].has_ext)
    raw = b"junk" + line_noise(canser.encode(frames, protocol)) + b"\xaa"
    path = tmp_path / f"{protocol}.bin"
    path.write_bytes(raw)
    return path, canser.decode(raw, protocol)


def recording_of(capture: Path) -> Path:
    path = capture.with_suffix(".pcapng")
    info = RecordingInfo("serial", 2_000_000, 500_000, "us", "")
    with RecordingWriter(path, info) as writer:
        writer.write(capture.read_bytes(), 0, 0)
    return path


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_read_is_decode_of_the_file(protocol: str, tmp_path: Path) -> None:
    path, want = capture_of(protocol, tmp_path)
    offsets = np.empty(len(want), np.int64)
    for source in (path, str(path)):
        assert np.array_equal(canser.read(source, protocol, offsets=offsets), want)
    at = np.empty_like(offsets)
    canser.decode(path.read_bytes(), protocol, offsets=at)
    assert np.array_equal(offsets, at)
    with path.open("rb") as file:
        assert np.array_equal(canser.read(file, protocol), want)
    assert np.array_equal(canser.read(io.BytesIO(path.read_bytes()), protocol), want)


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("window", [1, 3])
@pytest.mark.parametrize("room", [None, 1, 100, 1 << 16])
def test_blocks_add_up_to_the_whole(
    protocol: str, window: int, room: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Windows of a page or so: packets lie across their borders.
    monkeypatch.setattr(_input, "WINDOW", window * mmap.ALLOCATIONGRANULARITY)
    path, want = capture_of(protocol, tmp_path, 0.5 if room == 1 else 3)
    out = None if room is None else np.empty(room, FRAME_DTYPE)
    with canser.blocks(path, protocol, out=out) as run:
        got = [block.copy() for block in run]
        assert np.array_equal(np.concatenate(got), want)
        assert run.bytes_done == run.bytes_total == path.stat().st_size
        stats = run.decoder.stats
    assert stats.frames == len(want)
    assert stats.bytes_in == path.stat().st_size
    assert stats.pending == 0
    assert all(len(block) == (room or BLOCK_FRAMES) for block in got[:-2])


def test_blocks_without_out_are_new_arrays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(raw, "BLOCK_FRAMES", 100)
    path, want = capture_of("seeed", tmp_path)
    assert np.array_equal(np.concatenate(list(canser.blocks(path, "seeed"))), want)


def test_blocks_with_out_are_views_of_it_and_give_offsets(tmp_path: Path) -> None:
    path, want = capture_of("seeed", tmp_path)
    out, offsets = np.empty(64, FRAME_DTYPE), np.empty(64, np.int64)
    at: list[int] = []
    for block in canser.blocks(path, "seeed", out=out, offsets=offsets):
        assert np.shares_memory(block, out)
        at.extend(offsets[: len(block)].tolist())
    whole = np.empty(len(want), np.int64)
    canser.decode(path.read_bytes(), "seeed", offsets=whole)
    assert at == whole.tolist()


def test_progress_is_told(tmp_path: Path) -> None:
    path, want = capture_of("serial", tmp_path)
    seen: list[tuple[int, int | None]] = []
    out = np.empty(500, FRAME_DTYPE)
    blocks = canser.blocks(
        path, "serial", out=out, progress=lambda done, total: seen.append((done, total))
    )
    assert sum(map(len, blocks)) == len(want)
    size = path.stat().st_size
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    assert seen[-1] == (size, size)
    assert len(seen) >= len(want) // 500


def test_a_file_is_read_from_where_it_stands(tmp_path: Path) -> None:
    path = tmp_path / "x.bin"
    raw = canser.encode(vehicle(1), "seeed")
    path.write_bytes(b"header" + raw)
    with path.open("rb") as file:
        file.seek(6)
        blocks = canser.blocks(file, "seeed")
        assert np.array_equal(np.concatenate(list(blocks)), canser.decode(raw, "seeed"))
        assert blocks.decoder.stats.bytes_skipped == 0
        assert not file.closed
        file.seek(6)
        assert len(canser.read(file, "seeed")) == len(canser.decode(raw, "seeed"))
        file.seek(0, os.SEEK_END)
        assert len(canser.read(file, "seeed")) == 0
        assert list(canser.blocks(file, "seeed")) == []


def test_an_empty_file_has_no_frames(tmp_path: Path) -> None:
    path = tmp_path / "empty.bin"
    path.touch()
    assert len(canser.read(path, "serial")) == 0
    assert list(canser.blocks(path, "serial")) == []


class OneRead(io.RawIOBase):
    """A file that is none of the system's, and gives a few bytes at a time."""

    def __init__(self, raw: bytes) -> None:
        self._raw = io.BytesIO(raw)

    def readable(self) -> bool:
        return True

    def readinto(self, room: bytearray) -> int:  # type: ignore[override]
        return self._raw.readinto(memoryview(room)[:7])


class OnlyRead:
    """The least that reads."""

    def __init__(self, raw: bytes) -> None:
        self._raw = io.BytesIO(raw)

    def read(self, size: int = -1) -> bytes:
        return self._raw.read(size)


@pytest.mark.parametrize("kind", [io.BytesIO, OneRead, OnlyRead])
def test_what_cannot_be_mapped_is_read(kind: type, tmp_path: Path) -> None:
    path, want = capture_of("seeed", tmp_path, 1)
    blocks = canser.blocks(cast(BinaryIO, kind(path.read_bytes())), "seeed")
    assert blocks.bytes_total is None
    assert np.array_equal(np.concatenate(list(blocks)), want)


def test_a_file_that_unpacks_what_it_reads_is_read_and_not_mapped(tmp_path: Path) -> None:
    path, want = capture_of("serial", tmp_path)
    packed = tmp_path / "run.bin.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    with gzip.open(packed) as file:
        blocks = canser.blocks(cast(BinaryIO, file), "serial")
        assert np.array_equal(np.concatenate(list(blocks)), want)
    with gzip.open(packed) as file:
        assert np.array_equal(canser.read(cast(BinaryIO, file), "serial"), want)


def test_frames_of_a_pipe_come_as_its_bytes_come() -> None:
    reader, writer = os.pipe()
    raw = canser.encode(vehicle(0.1), "seeed")
    want = canser.decode(raw, "seeed")
    with open(reader, "rb") as source:  # noqa: PTH123
        blocks = canser.blocks(source, "seeed")
        # Read by a thread: if frames were held back this would wait for ever.
        got: list[FrameArray] = []
        for _ in range(3):
            os.write(writer, raw)
            thread = threading.Thread(target=lambda: got.append(next(blocks)))
            thread.start()
            thread.join(10)
            assert not thread.is_alive()
            assert np.array_equal(got[-1], want)
        os.close(writer)
        assert list(blocks) == []


@pytest.mark.skipif(sys.platform == "win32", reason="named pipes of POSIX")
def test_a_named_pipe_is_read_by_its_path(tmp_path: Path) -> None:
    path = tmp_path / "fifo"
    os.mkfifo(path)
    raw = canser.encode(vehicle(1), "serial")
    thread = threading.Thread(target=path.write_bytes, args=(raw,))
    thread.start()
    assert np.array_equal(canser.read(path, "serial"), canser.decode(raw, "serial"))
    thread.join()


def test_mistakes_show_at_once(tmp_path: Path) -> None:
    path, _ = capture_of("seeed", tmp_path, 0.2)
    with pytest.raises(ValueError, match="unknown protocol"):
        canser.blocks(path, "foo")
    with pytest.raises(TypeError, match="out must be"):
        canser.blocks(path, "seeed", out=np.empty(3))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="offsets goes with out"):
        canser.blocks(path, "seeed", offsets=np.empty(3, np.int64))
    with pytest.raises(FileNotFoundError):
        canser.blocks(tmp_path / "none.bin", "seeed")
    with pytest.raises(FileNotFoundError):
        canser.read(tmp_path / "none.bin", "seeed")
    with pytest.raises(OSError, match=r"directory|Permission"):
        canser.read(tmp_path, "seeed")
    with pytest.raises(ValueError, match="threads"):
        canser.read(path, "seeed", threads=0)


@pytest.mark.parametrize("unit", ["", "min", ["ms"]], ids=repr)
@pytest.mark.parametrize("protocol", ["serial", None])
@pytest.mark.parametrize("recorded", [False, True])
def test_a_unit_that_is_none_is_an_error(
    recorded: bool, protocol: str | None, unit: Any, tmp_path: Path
) -> None:
    path, _ = capture_of("serial", tmp_path, 0.2)
    if recorded:
        path = recording_of(path)
    with pytest.raises(ValueError, match=rf"^unknown ts_unit {re.escape(repr(unit))}; have: s, "):
        canser.read(path, protocol, ts_unit=unit)
    with pytest.raises(ValueError, match=rf"^unknown ts_unit {re.escape(repr(unit))}; have: s, "):
        canser.blocks(path, protocol, ts_unit=unit)


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, pickle.dumps])
def test_what_holds_a_file_cannot_be_copied(again: Callable[[Any], Any], tmp_path: Path) -> None:
    path, want = capture_of("serial", tmp_path, 0.2)
    with canser.blocks(path, "serial") as blocks:
        with pytest.raises(TypeError, match="a Blocks cannot be copied or pickled: the copy would"):
            again(blocks)
        assert np.array_equal(canser.concat(blocks), want)
    info = RecordingInfo("serial", 2_000_000, 500_000, "us", "")
    with (
        RecordingWriter(tmp_path / "run.pcapng", info) as writer,
        pytest.raises(TypeError, match="a RecordingWriter cannot be copied"),
    ):
        again(writer)


@pytest.mark.parametrize("protocol", ["", "foo"])
def test_a_protocol_that_is_none_is_no_fault_of_the_recording(
    protocol: str, tmp_path: Path
) -> None:
    path = recording_of(capture_of("serial", tmp_path, 0.2)[0])
    for call in (canser.read, canser.blocks):
        with pytest.raises(ValueError, match=rf"^unknown protocol '{protocol}'"):
            call(path, protocol)


@pytest.mark.parametrize("offsets", [[1, 2], np.zeros(500), np.zeros(500, np.int32)])
def test_offsets_for_a_recording_are_checked_as_for_raw_bytes(offsets: Any, tmp_path: Path) -> None:
    path = recording_of(capture_of("serial", tmp_path, 0.2)[0])
    with pytest.raises(TypeError, match=r"^offsets must be an array"):
        canser.read(path, offsets=offsets)


@pytest.mark.skipif(sys.platform == "win32", reason="resident memory by /proc or resource")
def test_memory_stays_bounded(tmp_path: Path) -> None:
    # The largest resident size of a process of its own, over a file far larger.
    path = tmp_path / "large.bin"
    one = canser.encode(vehicle(30), "serial")
    with path.open("wb") as file:
        for _ in range(200_000_000 // len(one)):
            file.write(one)
    code = (
        "import resource, sys, numpy as np, canser\n"
        "out = np.zeros(65536, canser.FRAME_DTYPE)\n"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "before = peak()\n"
        "for _ in canser.blocks(sys.argv[1], 'serial', out=out): pass\n"
        "print(peak() - before)\n"
    )
    import subprocess  # noqa: PLC0415

    run = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True
    )
    unit = 1 if sys.platform == "darwin" else 1024
    assert int(run.stdout) * unit < 64 << 20


@pytest.mark.parametrize(
    "source", [b"\xaa", bytearray(3), memoryview(b"x"), None, 3, io.StringIO("x"), 1.5]
)
def test_what_is_no_file_is_refused_by_name(source: object) -> None:
    for reads in (canser.read, canser.blocks):
        with pytest.raises(TypeError, match=r"give a path, or a file|open it for bytes"):
            reads(cast(BinaryIO, source), "seeed")


def test_a_file_open_for_writing_or_for_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.bin"
    with path.open("wb") as file, pytest.raises(TypeError, match=r"x\.bin is not open for reading"):
        canser.read(file, "seeed")
    with path.open() as text, pytest.raises(TypeError, match=r"x\.bin is open for text"):
        canser.read(cast(BinaryIO, text), "seeed")


def test_an_empty_ts_unit_is_an_error_everywhere(tmp_path: Path) -> None:
    path, _ = capture_of("serial", tmp_path, 0.2)
    for reads in (canser.read, canser.blocks):
        with pytest.raises(ValueError, match="unknown ts_unit ''"):
            reads(path, "serial", ts_unit="")


def test_a_file_that_gets_shorter_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_input, "WINDOW", mmap.ALLOCATIONGRANULARITY)
    path, _ = capture_of("serial", tmp_path)
    size = path.stat().st_size
    with canser.blocks(path, "serial", out=np.empty(10, FRAME_DTYPE)) as run:
        next(run)
        os.truncate(path, size - 1000)
        with pytest.raises(OSError, match=rf"got shorter .* of {size:,} bytes.*serial\.bin"):
            list(run)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_file_that_gets_shorter_while_it_is_read_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    """It is cut by the time of its second window, or before it is mapped as a whole."""
    monkeypatch.setattr(_input, "WINDOW", mmap.ALLOCATIONGRANULARITY)
    path, _ = capture_of("serial", tmp_path)
    check, calls = _input.Input.check_size, []

    def cut(source: _input.Input) -> None:
        calls.append(source)
        if len(calls) == 2:
            os.truncate(path, 5000)
        check(source)

    monkeypatch.setattr(_input.Input, "check_size", cut)
    with pytest.raises(OSError, match=r"got shorter .*: 5,000 of.*serial\.bin"):
        canser.read(path, "serial", threads=threads)


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="files of /proc are Linux's")
def test_a_file_that_does_not_know_its_size_is_read_as_a_pipe() -> None:
    path = Path("/proc/self/environ")
    assert path.stat().st_size == 0
    with canser.blocks(path, "seeed", as_is=True) as run:
        list(run)
        assert run.decoder.stats.bytes_in == len(path.read_bytes()) > 0


WRONG = [(have, want) for have in PROTOCOLS for want in PROTOCOLS if have != want]


@pytest.mark.parametrize(("protocol", "wrong"), WRONG)
def test_the_wrong_protocol_is_one_warning(protocol: str, wrong: str, tmp_path: Path) -> None:
    path, _ = capture_of(protocol, tmp_path)
    look = rf"{protocol}\.bin: \d+% of the .* in no {wrong} packet; they look like {protocol} \("
    with pytest.warns(CanserWarning, match=look) as told:
        frames = canser.read(path, wrong)
    assert len(told) == 1
    assert told[0].filename == __file__
    blocks = canser.blocks(path, wrong)
    with pytest.warns(CanserWarning, match=look) as told:
        parts = list(blocks)
    assert list(blocks) == []
    assert len(told) == 1
    assert told[0].filename == __file__
    with pytest.warns(CanserWarning, match=f"in no {wrong} packet") as told:
        assert np.array_equal(canser.decode(path.read_bytes(), wrong), frames)
    assert len(told) == 1
    assert np.array_equal(np.concatenate([frames[:0], *parts]), frames)
    # These say nothing: warnings are errors here.
    canser.read(path, wrong, as_is=True)
    list(canser.blocks(path, wrong, as_is=True))
    canser.decode(path.read_bytes(), wrong, as_is=True)
    decoder = canser.Decoder(wrong)
    decoder.feed(path.read_bytes())
    decoder.flush()


@pytest.mark.parametrize(("skipped", "limit"), [(1, 0.5), (0.9999, 0.5), (0.9, 0.27), (0.1, 0.03)])
def test_the_limit_is_half_of_the_bytes_only_where_packets_have_marks(
    skipped: float, limit: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doubt, "_skipped_of_random", lambda _: skipped)
    assert doubt.most_skipped("seeed") == pytest.approx(limit)
    assert doubt.has_marks("seeed") == (limit == 0.5)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_noisy_line_is_no_wrong_protocol(protocol: str) -> None:
    frames = vehicle(3, extended=WIRE_FORMATS[protocol].has_ext)
    for seed in range(5):
        canser.decode(line_noise(canser.encode(frames, protocol), rate=0.01, seed=seed), protocol)
    canser.decode(bytes(999), protocol)  # too few bytes to tell anything by


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_auto_reads_what_fits_plainly_and_says_which(protocol: str, tmp_path: Path) -> None:
    path, want = capture_of(protocol, tmp_path)
    for auto in ("auto", "AUTO"):
        with pytest.warns(CanserWarning, match=rf"\.bin: read as {protocol} \(\d+%\)") as told:
            assert np.array_equal(canser.read(path, auto), want)
        assert len(told) == 1
        assert told[0].filename == __file__
    for source in (path, OnlyRead(path.read_bytes())):
        with pytest.warns(CanserWarning, match=f"read as {protocol}") as told:
            blocks = list(canser.blocks(cast(BinaryIO, source), "auto"))
        assert np.array_equal(np.concatenate(blocks), want)
        assert told[0].filename == __file__


def test_auto_does_not_guess(tmp_path: Path) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(line_noise(canser.encode(vehicle(3), "serial"), rate=0.03))
    assert 0.5 < canser.identify(path.read_bytes())[0].score < 0.9
    with pytest.raises(NoProtocolError, match=r"look like serial \(\d+%\); give protocol='serial'"):
        canser.read(path, "auto")
    path.write_bytes(np.random.default_rng(1).bytes(5000))
    with pytest.raises(NoProtocolError, match="no protocol that canser knows; give protocol="):
        canser.read(path, "auto")
    path.write_bytes(b"")
    with pytest.warns(CanserWarning, match=r"run\.bin: is empty"):
        assert len(canser.read(path, "auto")) == 0


@pytest.mark.parametrize("protocol", [None, "seeed", "auto"])
@pytest.mark.parametrize(
    ("head", "message"),
    [
        (b"***BUSMASTER Ver 2.4.0***\n***PROTOCOL CAN***\n***NOTE***\n", "BUSMASTER"),
        (b"@ TEXT @ 3 @ 22 @ 0 @ 0 @ 500 @ 100 @\r\n", "CANHacker"),
        (bz2.compress(b"x" * 99), "bzip2.*bunzip2"),
        (b"SQLite format 3\0" * 9, "a SQLite database.*python-can"),
        (b"MDF     3.30    " * 9, "MDF file of a version before 4.*asammdf"),
        (b"Generic File\1\0\x22\0" * 9, "encrypted log of the CANedge"),
        (b"TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength\n", "CANedge"),
        (b"dear diary, today nothing came over the bus\n", "a text"),
    ],
    ids=["BUSMASTER", "CANHacker", "bzip2", "SQLite", "MDF 3", "MFE", "CANedge", "text"],
)
def test_other_formats_are_named_with_what_reads_them(
    head: bytes, message: str, protocol: str | None, tmp_path: Path
) -> None:
    path = tmp_path / "run.x"
    path.write_bytes(head)
    for reads in (canser.read, canser.blocks):
        with pytest.raises(FormatError, match=rf"run\.x is .*{message}"):
            reads(path, protocol)
    if protocol == "seeed":
        assert len(canser.read(path, protocol, as_is=True)) == 0
