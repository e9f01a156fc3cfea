"""Many blocks at once: the same bytes, times and gaps as block by block."""

import io
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import BinaryIO, cast

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

import plain_pcapng
from canser import _input
from canser.errors import RecordingError
from canser.recording.reader import Recording
from canser.recording.writer import RecordingWriter
from canser.timing.arrivals import DataRun
from recordings import EPOCH, INFO, MS, Got, damaged_files, listed, recorded, spread


def blocks_of(run: DataRun) -> list[Got]:
    """Return the blocks of a run."""
    assert len(run.ends) == len(run.times) > 0
    assert run.ends[-1] == len(run.data)
    begins = [0, *run.ends[:-1].tolist()]
    told = [(run.lost, run.gap), *[(0, False)] * (len(begins) - 1)]
    return [
        (bytes(run.data[begin:end]), ns, *gap)
        for begin, end, ns, gap in zip(
            begins, run.ends.tolist(), run.times.tolist(), told, strict=True
        )
    ]


def listed_by_runs(source: Path | BinaryIO, room_bytes: int) -> tuple[list[Got], list[str], int]:
    with Recording(source) as got:
        blocks = [block for run in got.runs(room_bytes) for block in blocks_of(run)]
        return blocks, got.remarks, got.bytes_done


@given(
    damaged_files(),
    st.sampled_from([1, 30, 100, 1 << 18]),
    st.sampled_from([(1 << 20, 1 << 17), (300, 130), (1, 1)]),
)
def test_runs_have_what_the_blocks_have(
    tmp_path_factory: pytest.TempPathFactory, raw: bytes, room_bytes: int, sizes: tuple[int, int]
) -> None:
    try:
        want, remarks = listed(raw)
    except RecordingError:
        return
    path = tmp_path_factory.mktemp("runs") / "run.pcapng"
    path.write_bytes(raw)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_input, "READ", sizes[0])
        patch.setattr(_input, "AHEAD", sizes[1])
        patch.setattr(_input, "CHUNK", sizes[0])
        for source in (path, cast(BinaryIO, io.BytesIO(raw))):
            assert listed_by_runs(source, room_bytes) == (want, remarks, len(raw))


@pytest.mark.parametrize("aged", [False, True])
@pytest.mark.parametrize("size", [1, 93, 5000, 1 << 16])
def test_a_run_has_many_blocks(tmp_path: Path, aged: bool, size: int) -> None:
    count = 4_000_000 // (size + 1000)
    rng = np.random.default_rng(1)
    told = [(rng.bytes(size), EPOCH + number * 1000 * MS, 0) for number in range(count)]
    raw = recorded(told)
    path = tmp_path / "run.pcapng"
    path.write_bytes(plain_pcapng.without_ids(raw) if aged else raw)
    with Recording(path) as got:
        runs = [blocks_of(run) for run in got.runs()]
        assert got.remarks == []
    assert [block for run in runs for block in run] == [(*block, False) for block in told]
    assert len(runs) <= 1 + -(-count // min(4096, (1 << 18) // size))


def test_blocks_larger_than_the_room_are_runs_of_their_own(tmp_path: Path) -> None:
    told = [(bytes([number]) * 1000, EPOCH + number * 1000 * MS, 0) for number in range(9)]
    path = tmp_path / "run.pcapng"
    path.write_bytes(recorded(told))
    with Recording(path) as got:
        assert [blocks_of(run) for run in got.runs(999)] == [[(*one, False)] for one in told]


def test_a_run_goes_on_behind_a_block(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    path.write_bytes(recorded(spread(9)))
    with Recording(path) as got:
        assert bytes(next(got).data) == spread(9)[0][0]
        (run,) = got.runs()
        assert [block[0] for block in blocks_of(run)] == [one[0] for one in spread(9)[1:]]
        assert list(got.runs()) == []


def test_the_runs_of_a_pipe_come_as_its_bytes_come() -> None:
    reader, writer = os.pipe()
    with open(reader, "rb") as source, open(writer, "wb", buffering=0) as sink:  # noqa: PTH123
        target = RecordingWriter(cast(BinaryIO, sink), INFO)
        got: list[Got] = []
        runs = Recording(source).runs()
        for piece in spread(5):
            target.write(*piece)
            target.sync()
            # Read by a thread: if a block were held back this would wait for ever.
            thread = threading.Thread(target=lambda: got.extend(blocks_of(next(runs))))
            thread.start()
            thread.join(60)
            assert not thread.is_alive()
            assert got[-1] == (*piece, False)
        target.close()
        sink.close()
        assert list(runs) == []


def test_parts_of_a_block_are_waited_for() -> None:
    told = [(b"x" * 50, EPOCH + number * 1000 * MS, 0) for number in range(3)]
    raw = recorded(told)
    reader, writer = os.pipe()
    with open(reader, "rb") as source:  # noqa: PTH123

        def trickle() -> None:
            for at in range(len(raw)):
                os.write(writer, raw[at : at + 1])
            os.close(writer)

        thread = threading.Thread(target=trickle)
        thread.start()
        with Recording(source) as got:
            blocks = [block for run in got.runs() for block in blocks_of(run)]
        thread.join()
    assert blocks == [(*one, False) for one in told]


@pytest.mark.parametrize("way", ["_read_at", "_read_by_seeking"])
def test_reading_leaves_a_file_where_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    monkeypatch.setattr(_input, "_read_at", getattr(_input, way))
    monkeypatch.setattr(_input, "READ", 200)
    monkeypatch.setattr(_input, "AHEAD", 100)
    path = tmp_path / "run.pcapng"
    path.write_bytes(b"before!" + recorded(spread(9)))
    want = [(*one, False) for one in spread(9)]
    for buffering in (0, -1):
        with path.open("rb", buffering=buffering) as file:
            assert file.read(7) == b"before!"
            assert listed_by_runs(file, 1 << 18)[:2] == (want, [])
            assert file.tell() == 7


CUTTER = """
import os, sys
from canser.recording.reader import Recording

path, way = sys.argv[1:]
got = Recording(path)
blocks = got.runs() if way == "runs" else got
next(blocks)
os.truncate(path, 700)
try:
    print(sum(1 for _ in blocks))
except OSError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows lets no open file be cut")
@pytest.mark.parametrize("way", ["runs", "blocks"])
def test_a_file_that_is_cut_while_it_is_read_is_an_error(tmp_path: Path, way: str) -> None:
    """The system ends a process that reads a mapped file behind its new end."""
    path = tmp_path / "run.pcapng"
    path.write_bytes(recorded([(bytes(60_000), EPOCH + n * 1000 * MS, 0) for n in range(100)]))
    size = path.stat().st_size
    done = subprocess.run(
        [sys.executable, "-c", CUTTER, path, way], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert f"it got shorter while it was read: 700 of {size:,} bytes are left" in done.stdout
