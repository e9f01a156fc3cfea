"""kill -9 at any moment: every block that is whole in the file is recovered, and nothing else."""

import io
import os
import subprocess
import sys
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
import pytest

import plain_pcapng
from canser.errors import RecordingError
from canser.recording.reader import Recording
from canser.recording.recovery import recover
from long import LONG, longer

# More of them in `make soak`.
RUNS = int(os.environ.get("CANSER_KILLS", "200" if LONG else "25"))

# Starts writers as its children, kills each at a random moment, and names its file: a fork
# costs a hundredth of a new interpreter. A writer writes as fast as it can, until it is
# killed, numbers of 8 bytes in pieces of any size. With 0 the line
# is busy, and blocks are as large as they get; with 1 each piece is a block.
KILLER = """
import array, os, random, signal, sys, time
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter

STREAM = memoryview(array.array("Q", range(1 << 22)))

def write(path, choice, sparse):
    info = RecordingInfo("any", 1_000_000_000, None, "ms", "generator")
    writer = RecordingWriter(path, info)
    stream, sent, ns = STREAM.cast("B"), 0, 10**18
    while sent < len(stream):
        piece = stream[sent : sent + choice.randrange(1, 20_000)]
        sent += len(piece)
        ns += len(piece) * 10 + sparse * 3_000_000
        writer.write(piece, ns)
    signal.pause()

folder, runs = sys.argv[1], int(sys.argv[2])
choice = random.Random(1)
for run in range(runs):
    path = f"{folder}/{run}.pcapng"
    seed = choice.random()
    child = os.fork()
    if child == 0:
        try:
            write(path, random.Random(seed), run % 2)
        finally:
            os._exit(1)
    while not os.path.exists(path):
        pass
    if run % 4:  # else right at the start
        while os.path.getsize(path) < 1_000:
            pass
        time.sleep(choice.choice([0.001, 0.02]) * choice.random())
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status), "it ended by itself"
    print(path, flush=True)
"""


@longer
@pytest.mark.skipif(sys.platform == "win32", reason="kill -9 is POSIX")
def test_what_was_written_survives(tmp_path: Path) -> None:
    killer = subprocess.Popen(
        # Of threads that numpy has started its children know nothing, and need not.
        [sys.executable, "-W", "ignore", "-c", KILLER, tmp_path, str(RUNS)],
        stdout=subprocess.PIPE,
        text=True,
    )
    runs = blocks = torn = 0
    with killer:
        assert killer.stdout is not None
        for line in killer.stdout:
            path = Path(line.strip())
            runs += 1
            found, cut = check(path)
            blocks += found
            torn += cut
            path.unlink()
    assert killer.returncode == 0
    assert runs == RUNS
    # Not all too early: it is the middle of the work that is tested.
    assert blocks > 20 * RUNS
    assert torn > RUNS // 20
    print(f"{runs} kills, {blocks} blocks, {torn} torn tails")


def check(path: Path) -> tuple[int, bool]:
    """Return the blocks of a file, each as it was written, and whether its tail is torn."""
    raw = path.read_bytes()
    whole = plain_pcapng.read(raw, torn=True)
    packets = [block for block in whole if block.kind == plain_pcapng.PACKET]
    if len(whole) < 2:
        with pytest.raises(RecordingError):
            Recording(path)
        return 0, True
    left = len(raw) - whole[-1].end
    with Recording(path) as got:
        pieces = [(bytes(piece.data), piece.arrival_ns) for piece in got]
        assert pieces == [(block.packet, block.ts) for block in packets]
        assert len(got.remarks) == bool(left)
        assert all(f"{left:,} bytes at byte {whole[-1].end:,}" in text for text in got.remarks)
    stream = b"".join(data for data, _ in pieces)
    sent = np.arange(len(stream) // 8 + 1, dtype=np.uint64).tobytes()
    assert stream == sent[: len(stream)]
    copy = io.BytesIO()
    with path.open("rb") as file:
        done = recover(file, cast(BinaryIO, copy))
    assert copy.getvalue() == raw[: whole[-1].end]
    assert (done.blocks, done.bytes_left_out) == (len(packets), left)
    return len(packets), left > 0
