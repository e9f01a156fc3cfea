"""Files packed by gzip and zstd: every format in them, cut and damaged ones, pipes."""

import gzip
import io
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import canser
from canser.errors import CanserWarning, FormatError
from canser.simulation.traffic import vehicle
from samples import listed

FRAMES = vehicle(1)


def packings() -> list[str]:
    try:
        from canser.files.packed import _zstd  # noqa: PLC0415

        _zstd()
    except ImportError:
        return [".gz"]
    return [".gz", ".zst"]


@pytest.mark.filterwarnings("ignore::canser.CanserWarning")
@pytest.mark.parametrize("packing", packings())
@pytest.mark.parametrize("name", ["x.log", "x.csv", "x.asc", "x.trc", "x.npy", "x.bin"])
def test_a_file_is_packed_and_unpacked(tmp_path: Path, name: str, packing: str) -> None:
    protocol = "serial" if name == "x.bin" else None
    canser.write(FRAMES, tmp_path / name, protocol)
    canser.write(FRAMES, tmp_path / f"{name}{packing}", protocol)
    plain = canser.read(tmp_path / name, protocol)
    assert listed(canser.read(tmp_path / f"{name}{packing}", protocol)) == listed(plain)
    assert (tmp_path / f"{name}{packing}").stat().st_size < (tmp_path / name).stat().st_size * 0.7
    if packing == ".gz":
        unpacked = gzip.decompress((tmp_path / f"{name}{packing}").read_bytes())
        assert unpacked == (tmp_path / name).read_bytes()


def test_the_content_tells_that_a_file_is_packed(tmp_path: Path) -> None:
    canser.write(FRAMES, tmp_path / "x.log")
    (tmp_path / "y.log").write_bytes(gzip.compress((tmp_path / "x.log").read_bytes()))
    assert len(canser.read(tmp_path / "y.log")) == len(FRAMES)
    assert len(canser.read(io.BytesIO((tmp_path / "y.log").read_bytes()))) == len(FRAMES)
    assert len(canser.read([tmp_path / "x.log", tmp_path / "y.log"], sort=True)) == 2 * len(FRAMES)


def test_info_finds_the_protocol_in_a_packed_file(tmp_path: Path) -> None:
    canser.write(FRAMES, tmp_path / "x.bin.gz", "serial")
    found = canser.info(tmp_path / "x.bin.gz")
    assert (found.protocol, found.frames) == ("serial", len(FRAMES))


@pytest.mark.parametrize("packing", packings())
def test_of_a_cut_file_the_frames_before_come_first(tmp_path: Path, packing: str) -> None:
    path = tmp_path / f"x.log{packing}"
    noise = np.random.default_rng(1)
    frames = canser.concat([vehicle(1)] * 30)
    frames["data"] = noise.integers(0, 256, frames["data"].shape)  # so that it packs badly
    canser.write(frames, path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    before: list[int] = []
    with pytest.raises(FormatError, match=rf"x\.log{packing} is cut off") as error:
        before.extend(map(len, canser.blocks(path)))
    assert sum(before) > len(frames) // 4
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("packing", packings())
def test_damage_is_one_line(tmp_path: Path, packing: str) -> None:
    path = tmp_path / f"x.log{packing}"
    canser.write(FRAMES, path)
    whole = path.read_bytes()
    chance = np.random.default_rng(2)
    wrong = 0
    for _ in range(60):
        damaged = bytearray(whole)
        damaged[int(chance.integers(4, len(whole)))] ^= int(chance.integers(1, 256))
        path.write_bytes(damaged)
        try:
            canser.read(path)
        except FormatError as error:
            wrong += 1
            assert "\n" not in str(error)  # noqa: PT017 - any other exception fails
        except CanserWarning:
            wrong += 1
    assert wrong > 50


def test_a_bomb_takes_no_memory(tmp_path: Path) -> None:
    with gzip.open(tmp_path / "x.log.gz", "wb") as file:
        for _ in range(100):
            file.write(b"(1.0) can0 123#\n" * 65_536)  # 100 MiB
    tracemalloc.start()
    try:
        count = sum(map(len, canser.blocks(tmp_path / "x.log.gz")))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert count == 100 * 65_536
    assert peak < 20e6


def test_a_pipe_may_be_packed(tmp_path: Path) -> None:
    canser.write(FRAMES, tmp_path / "x.log.gz")
    call = [sys.executable, "-m", "canser", "info", "-"]
    with (tmp_path / "x.log.gz").open("rb") as file:
        done = subprocess.run(call, stdin=file, capture_output=True, check=True)
    assert f"frames     {len(FRAMES):,}".encode() in done.stdout


def test_a_recording_cannot_be_packed(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"cannot be packed; name it .*x\.pcapng$"):
        canser.write(FRAMES, tmp_path / "x.pcapng.gz", "serial")


def test_without_the_package_zstd_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("backports", "backports.zstd", "compression", "compression.zstd"):
        monkeypatch.setitem(sys.modules, name, None)
    (tmp_path / "x.log.zst").write_bytes(b"\x28\xb5\x2f\xfd" + bytes(50))
    with pytest.raises(FormatError, match=r"pip install 'canser\[zstd\]', or unpack it first"):
        canser.read(tmp_path / "x.log.zst")
    with pytest.raises(FormatError, match=r"backports\.zstd is not installed"):
        canser.write(FRAMES, tmp_path / "y.log.zst")
    assert [path.name for path in tmp_path.iterdir()] == ["x.log.zst"]
