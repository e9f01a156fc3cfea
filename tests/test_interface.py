"""The public interface as a user writes it, line by line, from bytes to arrays and back."""

import sys
from pathlib import Path

import numpy as np
import pytest

import canser
from canser.simulation.simulator import Simulator
from canser.simulation.traffic import vehicle


@pytest.fixture
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    frames = vehicle(2)
    frames["ts"] += 1_600_000_000 * 10**9
    canser.write(frames, "a.pcapng", "serial")
    frames["ts"] += 10 * 10**9
    canser.write(frames, "b.pcapng", "serial")
    Path("week.bin").write_bytes(canser.encode(frames, "serial"))
    Path("run.bin").write_bytes(canser.encode(vehicle(2), "seeed"))


@pytest.mark.usefixtures("_folder")
def test_files() -> None:
    frames = canser.read("run.bin", "seeed")
    assert len(frames) == len(vehicle(2))
    both = canser.read(["a.pcapng", "b.pcapng"])
    assert len(both) == 2 * len(frames)
    canser.write(both, "run.csv")
    canser.convert("a.pcapng", "run.npy")
    assert canser.read("run.npy").tobytes() == canser.read("a.pcapng").tobytes()
    assert canser.info("run.csv").frames == len(both)


@pytest.mark.usefixtures("_folder")
def test_bytes() -> None:
    raw = Path("run.bin").read_bytes()
    frames = canser.decode(raw, "seeed")
    assert frames["ts"].view("m8[ns]").dtype == "m8[ns]"
    out = np.empty(1 << 20, canser.FRAME_DTYPE)
    decoder = canser.Decoder("serial", ts_unit="us")
    used, count = decoder.feed_into(Path("week.bin").read_bytes(), out)
    assert (used, count) == (Path("week.bin").stat().st_size, len(frames))
    assert (decoder.stats.bytes_skipped, decoder.stats.resyncs) == (0, 0)
    assert sum(len(block) for block in canser.blocks("week.bin", "serial", out=out)) == count
    assert canser.protocol("seeed").has_clock is False


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are POSIX")
def test_a_port() -> None:
    silent = canser.AdapterConfig(bitrate=500_000, mode="silent")
    line = canser.LineConfig(baudrate=2_000_000)
    with (
        Simulator("seeed", vehicle(2), loop=True) as device,
        canser.open(device.url, "seeed", config=silent, line=line) as port,
    ):
        for batch in port.batches(max_frames=4096, timeout=5):
            assert len(batch)
            break
        assert port.send(canser.frames("123#DEADBEEF")) == 1
        assert port.send(["123#R", (0x18FEF100, b"\1")]) == 2
