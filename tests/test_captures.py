"""Captures in files: read and blocks, mapped and piped."""

import gzip
import io
import mmap
import os
import sys
import threading
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
import pytest

import canser
from canser import _input, captures
from canser.frames import FRAME_DTYPE, FrameArray
from canser.simulation.traffic import line_noise, vehicle

PROTOCOLS = canser.protocols()


def capture_of(protocol: str, tmp_path: Path, seconds: float = 3) -> tuple[Path, FrameArray]:
    frames = vehicle(seconds, extended=protocol != "cantalope")
    raw = b"junk" + line_noise(canser.encode(frames, protocol)) + b"\xaa"
    path = tmp_path / f"{protocol}.bin"
    path.write_bytes(raw)
    return path, canser.decode(raw, protocol)


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
    assert all(len(block) == (room or captures.BLOCK_FRAMES) for block in got[:-2])


def test_blocks_without_out_are_new_arrays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(captures, "BLOCK_FRAMES", 100)
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
