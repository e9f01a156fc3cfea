"""Frames of recordings: by the library and by the command, with the times of the line."""

import io
import os
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
import pytest

import canser
import plain_pcapng
from calls import BAD_CALL, BAD_DATA, GOOD, assert_fails, names, run
from canser import _input
from canser._core.buffers import FrameRoom
from canser._frames import FRAME_DTYPE, FrameArray
from canser.errors import CanserWarning, NoProtocolError, RecordingError
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter
from canser.simulation.traffic import vehicle
from canser.timing.clocks import FrameClock
from reference import WIRE_FORMATS

INFO = RecordingInfo("seeed", 2_000_000, 500_000, "ms", "/dev/ttyUSB0")
EPOCH = 1_700_000_000_000_000_000
MS = 1_000_000
BYTE = 5_000  # nanoseconds on the line of INFO

# Bytes, arrival, lost before.
Written = tuple[bytes, int, int]


def record(path: Path, pieces: list[Written], info: RecordingInfo = INFO) -> Path:
    with RecordingWriter(path, info) as writer:
        for piece in pieces:
            writer.write(*piece)
    return path


def traffic(protocol: str, seconds: float = 3) -> tuple[FrameArray, bytes, list[Written]]:
    """Return frames, their bytes, and these in pieces as a host reads them, EPOCH on.

    A piece has the bytes of a few milliseconds.
    """
    frames = vehicle(seconds, extended=WIRE_FORMATS[protocol].has_ext)
    raw = canser.encode(frames, protocol)
    offsets = np.empty(len(frames), np.int64)
    canser.decode(raw, protocol, offsets=offsets)
    sizes = np.diff(offsets, append=len(raw))
    # Bytes go over the line one after the other, not before the frame was on the bus.
    came = np.empty(len(raw), np.int64)
    free = 0
    for ts, at, size in zip(frames["ts"].tolist(), offsets.tolist(), sizes.tolist(), strict=True):
        free = max(free, ts) + size * BYTE
        came[at : at + size] = free - np.arange(size)[::-1] * BYTE
    rng = np.random.default_rng(1)
    pieces, at, now = [], 0, 0
    while at < len(raw):
        now += int(rng.integers(1, 8)) * MS
        end = int(np.searchsorted(came, now, "right"))
        if end > at:
            pieces.append((raw[at:end], EPOCH + now, 0))
            at = end
    return frames, raw, pieces


def untimed(frames: FrameArray) -> FrameArray:
    frames = frames.copy()
    frames["ts"] = 0
    return frames


PROTOCOLS = canser.protocols()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_recording_gives_the_frames_of_its_bytes(protocol: str, tmp_path: Path) -> None:
    _, raw, pieces = traffic(protocol)
    path = record(tmp_path / "run.pcapng", pieces, replace(INFO, protocol=protocol))
    want = canser.decode(raw, protocol)
    offsets, at = np.empty((2, len(want)), np.int64)
    canser.decode(raw, protocol, offsets=at)
    got = canser.read(path, offsets=offsets)
    assert np.array_equal(untimed(got), untimed(want))
    assert np.array_equal(offsets, at)
    with canser.blocks(path) as blocks:
        assert blocks.recording == replace(INFO, protocol=protocol)
        assert np.array_equal(np.concatenate(list(blocks)), got)
        assert blocks.decoder.stats.bytes_in == len(raw)
        assert blocks.bytes_done == blocks.bytes_total == path.stat().st_size
        assert blocks.notes == ((), (), "")


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_times_are_those_of_the_line(protocol: str, tmp_path: Path) -> None:
    # As a port gives them: the pieces as they were read. A recording keeps these to 2 ms.
    frames, raw, pieces = traffic(protocol, 10)
    clocked = protocol == "serial"
    live = canser.decode(raw, protocol)
    offsets = np.empty(len(live), np.int64)
    canser.decode(raw, protocol, offsets=offsets)
    clock = FrameClock(MS if clocked else None, INFO.byte_ns)
    end = 0
    for data, arrival, _ in pieces:
        end += len(data)
        clock.arrivals.add(end, arrival)
    room = FrameRoom(live, offsets, np.append(offsets[1:], len(raw)))
    clock.assign_times(room, len(live), len(raw))
    path = record(tmp_path / "run.pcapng", pieces, replace(INFO, protocol=protocol))
    got = canser.read(path)
    assert np.abs(got["ts"] - live["ts"]).max() <= 3 * MS
    # And that is when they were on the bus, but for the 8 ms of a read and what queued.
    late = got["ts"] - EPOCH - frames["ts"]
    assert late.min() >= (-2 * MS if clocked else 0)
    assert np.median(late) <= 10 * MS


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("room", [1, 7, 100, 1 << 16])
@pytest.mark.parametrize("window", [1 << 16, 8 << 20])
def test_blocks_of_any_size_are_the_same(
    protocol: str, room: int, window: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_input, "WINDOW", window)
    _, _, pieces = traffic(protocol, 0.5 if room < 10 else 3)
    pieces[20] = (*pieces[20][:2], 5)
    path = record(tmp_path / "run.pcapng", pieces, replace(INFO, protocol=protocol))
    with pytest.warns(CanserWarning, match="gaps in the recording: 1, bytes lost: 5"):
        want = canser.read(path)
    out, at = np.empty(room, FRAME_DTYPE), np.empty(room, np.uint64)
    got, offsets = [], []
    for block in canser.blocks(path, out=out, offsets=at, threads=2):
        assert np.shares_memory(block, out)
        got.append(block.copy())
        offsets += at[: len(block)].tolist()
    assert all(len(block) == room for block in got[:-1])
    assert np.array_equal(np.concatenate(got), want)
    assert offsets == sorted(set(offsets))


def test_a_frame_does_not_reach_over_a_gap(tmp_path: Path) -> None:
    frame = canser.encode(vehicle(1)[:1], "seeed")
    one, other = frame[:5], frame[5:]
    together = [(one, EPOCH, 0), (other, EPOCH + MS, 0)]
    assert len(canser.read(record(tmp_path / "a.pcapng", together))) == 1
    apart = [(one, EPOCH, 0), (other, EPOCH + MS, 1), (frame, EPOCH + 2 * MS, 0)]
    path = record(tmp_path / "b.pcapng", apart)
    blocks = canser.blocks(path)
    (block,) = blocks
    assert len(block) == 1
    assert blocks.decoder.stats.bytes_skipped == len(frame)
    assert blocks.notes.lines == (f"{path}: gaps in the recording: 1, bytes lost: 1",)


def test_pieces_of_all_sizes_between_gaps(tmp_path: Path) -> None:
    raw = canser.encode(vehicle(30), "seeed")
    rng = np.random.default_rng(8)
    runs, pieces, at = [b""], list[Written](), 0
    for step in range(60):
        data = raw[at : at + int(rng.choice([1, 500, 5_000, 40_000]))]
        lost = int(rng.random() < 0.2)
        if lost:
            runs.append(b"")
        runs[-1] += data
        at += len(data)
        pieces.append((data, EPOCH + step * 1000 * MS, lost))
    assert at < len(raw)
    path = record(tmp_path / "run.pcapng", pieces)
    got = canser.blocks(path)
    want = np.concatenate([canser.decode(run, "seeed") for run in runs])
    frames = np.concatenate(list(got))
    assert np.array_equal(untimed(frames), untimed(want))
    assert np.all(np.diff(frames["ts"]) >= 0)
    gaps = len(runs) - 1
    assert got.notes.remarks == (f"{path}: gaps in the recording: {gaps}, bytes lost: {gaps}",)


def test_damage_is_left_out_and_told(tmp_path: Path) -> None:
    frames, _, pieces = traffic("seeed")
    path = record(tmp_path / "run.pcapng", pieces)
    whole = canser.read(path)
    raw = bytearray(path.read_bytes())
    blocks = plain_pcapng.read(bytes(raw))
    raw[blocks[40].offset + 30] ^= 1
    hurt = tmp_path / "hurt.pcapng"
    hurt.write_bytes(raw[:-200])
    with pytest.warns(CanserWarning) as caught:
        got = canser.read(hurt)
    texts = [str(warning.message) for warning in caught]
    assert len(texts) == 3
    assert texts[0].startswith(f"{hurt}: left out: ")
    assert texts[1].startswith(f"{hurt}: torn tail, left out: ")
    lost = len(blocks[40].packet)
    assert texts[2].endswith(f"gaps in the recording: 1, bytes lost: {lost}")
    assert len(frames) - 60 < len(got) < len(frames)
    rows = {row.tobytes() for row in untimed(whole)}
    assert {row.tobytes() for row in untimed(got)} <= rows
    # A stray frame from the middle of two would be a new one.
    blocks_again = canser.blocks(hurt)
    assert sum(map(len, blocks_again)) == len(got)
    assert list(blocks_again.notes.remarks) == texts


def test_what_is_given_wins(tmp_path: Path) -> None:
    _, raw, pieces = traffic("serial")
    path = record(tmp_path / "run.pcapng", pieces, replace(INFO, protocol="seeed", ts_unit="us"))
    for reads in (canser.read, canser.blocks):
        with pytest.raises(ValueError, match=r"run\.pcapng is a recording in seeed, not in serial"):
            reads(path, "serial")
    got = canser.read(path, "serial", ts_unit="ms", as_is=True)
    assert np.array_equal(untimed(got), untimed(canser.decode(raw, "serial")))
    with canser.blocks(path, "python-can", as_is=True) as blocks:
        assert blocks.decoder.protocol == "serial"
        assert "ts_unit='us'" in repr(blocks.decoder)


def test_a_recording_of_a_later_protocol_is_named(tmp_path: Path) -> None:
    path = record(tmp_path / "run.pcapng", [], replace(INFO, protocol="canopus"))
    with pytest.raises(RecordingError, match=f"'canopus'; have: {canser.protocols()[0]}"):
        canser.read(path)
    with pytest.raises(RecordingError, match="'canopus'"):
        canser.blocks(path)
    assert len(canser.read(path, "seeed", as_is=True)) == 0


def test_raw_bytes_need_a_protocol(tmp_path: Path) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(canser.encode(vehicle(1), "seeed"))
    with pytest.raises(
        NoProtocolError, match=r"look like seeed .*protocol='seeed' or 'auto'$"
    ) as caught:
        canser.read(path)
    assert isinstance(caught.value, ValueError)
    with pytest.raises(NoProtocolError, match=r"run\.bin: these bytes look like seeed"):
        canser.blocks(path)
    with pytest.raises(NoProtocolError, match="look like no protocol"):
        canser.blocks(cast(BinaryIO, io.BytesIO(b"\x0a\x0d\x0d\x0abut nothing else")))


def test_raw_bytes_that_start_as_a_recording_does_are_raw() -> None:
    for count in (1, 2, 4, 11):
        raw = b"\x0a\x0d\x0d\x0a\x40\0\0\0\x4d\x3c\x2b\x1a"[:count] + canser.encode(
            vehicle(0.1), "seeed"
        )
        got = canser.read(cast(BinaryIO, io.BytesIO(raw)), "seeed")
        assert np.array_equal(got, canser.decode(raw, "seeed"))
    assert len(canser.read(cast(BinaryIO, io.BytesIO(b"\x0a\x0d")), "seeed")) == 0


def test_offsets_that_are_too_small_are_told(tmp_path: Path) -> None:
    _, _, pieces = traffic("seeed")
    path = record(tmp_path / "run.pcapng", pieces)
    count = len(canser.read(path))
    with pytest.raises(ValueError, match=f"the data holds {count}; make room"):
        canser.read(path, offsets=np.empty(count - 1, np.int64))


def test_frames_of_a_pipe_come_as_they_are_recorded() -> None:
    reader, writer = os.pipe()
    with open(reader, "rb") as source, open(writer, "wb", buffering=0) as sink:  # noqa: PTH123
        blocks = canser.blocks(source, "seeed")
        recorder = RecordingWriter(cast(BinaryIO, sink), INFO)
        got: list[FrameArray] = []
        for step in range(3):
            recorder.write(canser.encode(vehicle(0.1), "seeed"), EPOCH + step * 1000 * MS)
            recorder.sync()
            # Read by a thread: if frames were held back this would wait for ever.
            thread = threading.Thread(target=lambda: got.append(next(blocks)))
            thread.start()
            thread.join(60)
            assert not thread.is_alive()
            assert len(got[-1]) == len(vehicle(0.1))
            assert got[-1]["ts"][-1] == EPOCH + step * 1000 * MS
        recorder.close()
        sink.close()
        assert list(blocks) == []


# The command.


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """Return a recording of three seconds, run.pcapng, and nothing else in its folder."""
    return record(tmp_path / "run.pcapng", traffic("seeed")[2])


def test_the_commands_take_a_recording(recorded: Path) -> None:
    folder, count = recorded.parent, len(traffic("seeed")[0])
    done = run(folder, "convert", "run.pcapng", "run.npy")
    assert (done.returncode, done.stdout) == (GOOD, b"")
    assert done.stderr.decode().splitlines()[0] == f"run.pcapng -> run.npy: {count:,} frames"
    assert len(done.stderr.decode().splitlines()) == 2
    assert np.array_equal(np.load(folder / "run.npy"), canser.read(recorded))
    done = run(folder, "dump", "run.pcapng")
    assert (done.returncode, done.stderr) == (GOOD, b"")
    assert len(done.stdout.splitlines()) == count
    assert done.stdout.startswith(b"(1700000000.")
    done = run(folder, "info", "run.pcapng")
    assert (done.returncode, done.stderr) == (GOOD, b"")
    lines = done.stdout.decode().splitlines()
    assert lines[0] == "recording  seeed from /dev/ttyUSB0, 2,000,000 baud"
    assert lines[1] == "bus        500,000 bit/s"
    assert lines[2].startswith(f"frames     {count:,}")
    assert any("2023-11-14 22:13:20 UTC" in line for line in lines)


def test_the_commands_take_a_recording_from_a_pipe(recorded: Path) -> None:
    for arguments in (["info", "-"], ["dump", "-"], ["convert", "-", "-"]):
        done = run(recorded.parent, *arguments, stdin=recorded.read_bytes())
        assert done.returncode == GOOD
        assert done.stdout.count(b"\n") > 20


def test_remarks_are_printed(recorded: Path) -> None:
    recorded.write_bytes(recorded.read_bytes()[:-100])
    for arguments in (
        ["info", "run.pcapng"],
        ["dump", "run.pcapng"],
        ["convert", "run.pcapng", "-"],
    ):
        done = run(recorded.parent, *arguments)
        assert done.returncode == GOOD
        assert "run.pcapng: torn tail, left out: " in done.stderr.decode()


def test_recover_makes_a_good_copy(recorded: Path) -> None:
    folder, raw = recorded.parent, recorded.read_bytes()
    done = run(folder, "recover", "run.pcapng", "same.pcapng")
    assert done.returncode == GOOD
    assert done.stderr.decode().endswith(" bytes of the line; all is good\n")
    assert (folder / "same.pcapng").read_bytes() == raw
    recorded.write_bytes(raw[:-150])
    done = run(folder, "recover", "run.pcapng", "whole.pcapng")
    assert done.returncode == GOOD
    torn, summary = done.stderr.decode().splitlines()
    assert torn.startswith("run.pcapng: torn tail, left out: ")
    assert summary.startswith("run.pcapng -> whole.pcapng: ")
    assert "bytes left out" in summary
    whole = (folder / "whole.pcapng").read_bytes()
    assert whole == raw[: len(whole)]
    blocks = plain_pcapng.read(whole)
    assert summary.split(": ")[1].startswith(f"{len(blocks) - 2:,} blocks, ")
    assert recorded.read_bytes() == raw[:-150]
    assert_fails(run(folder, "recover", "run.pcapng", "same.pcapng"), BAD_CALL, "--force")
    assert run(folder, "recover", "run.pcapng", "same.pcapng", "--force").returncode == GOOD
    assert (folder / "same.pcapng").read_bytes() == whole


def test_recover_of_what_is_none(tmp_path: Path) -> None:
    (tmp_path / "run.bin").write_bytes(canser.encode(vehicle(1), "seeed"))
    done = run(tmp_path, "recover", "run.bin", "x.pcapng")
    assert_fails(done, BAD_DATA, "run.bin", "no recording")
    assert_fails(run(tmp_path, "recover", "none", "x.pcapng"), BAD_CALL, "none", "No such file")
    assert_fails(run(tmp_path, "info", "run.bin", "-p", "x"), BAD_CALL, "'x'")
    assert names(tmp_path) == ["run.bin"]


@pytest.mark.skipif(sys.platform == "win32", reason="named pipes of POSIX")
def test_a_recording_in_a_named_pipe(recorded: Path) -> None:
    os.mkfifo(recorded.parent / "fifo")
    raw = recorded.read_bytes()
    thread = threading.Thread(target=(recorded.parent / "fifo").write_bytes, args=(raw,))
    thread.start()
    assert run(recorded.parent, "info", "fifo").stdout.startswith(b"recording  seeed")
    thread.join()
