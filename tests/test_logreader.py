"""Captures as logs of python-can: found by their suffix, every message as it was."""

import gc
import gzip
import io
from pathlib import Path

import numpy as np
import pytest

can = pytest.importorskip("can")

import canser  # noqa: E402
from canser.errors import (  # noqa: E402
    CanserWarning,
    NoProtocolError,
    RecordingError,
)
from canser.python_can.logreader import CaptureReader  # noqa: E402
from logs import assert_equal, raw, recording, traffic  # noqa: E402
from plugins import needs_installation  # noqa: E402
from reference import Frame  # noqa: E402
from samples import EPOCH, array  # noqa: E402

pytestmark = needs_installation

MS = 1_000_000


@pytest.mark.parametrize("protocol", canser.protocols())
@pytest.mark.parametrize("suffix", [".bin", ".raw", ".BIN"])
def test_raw_bytes_tell_their_protocol(tmp_path: Path, protocol: str, suffix: str) -> None:
    path = raw(tmp_path / f"run{suffix}", protocol)
    with can.LogReader(path) as reader:
        assert isinstance(reader, CaptureReader)
        assert_equal(list(reader), canser.read(path, protocol))


@pytest.mark.parametrize("protocol", canser.protocols())
def test_recordings_have_times_of_day(tmp_path: Path, protocol: str) -> None:
    path = recording(tmp_path / "run.pcapng", protocol)
    frames = canser.read(path)
    with can.LogReader(path) as reader:
        messages = list(reader)
    assert_equal(messages, frames)
    assert messages[0].timestamp == pytest.approx(EPOCH / 1e9, abs=60)


def test_every_kind_of_frame(tmp_path: Path) -> None:
    frames = array(
        Frame(0x7FF, dlc=8, data=bytes(range(8)), ts=0),
        Frame(0x1FFF_FFFF, ext=True, dlc=1, data=b"\x09".ljust(8, b"\0"), ts=MS),
        Frame(0, rtr=True, dlc=5, ts=2 * MS),
        Frame(1, err=True, ts=(1 << 31) * MS),
    )
    path = tmp_path / "run.bin"
    path.write_bytes(canser.encode(frames, "serial"))
    with can.LogReader(path, protocol="serial") as reader:
        assert_equal(list(reader), frames)


def test_what_is_given_wins(tmp_path: Path) -> None:
    path = raw(tmp_path / "run.bin", "serial")
    with can.LogReader(path, protocol="seeed", as_is=True) as reader:
        assert_equal(list(reader), canser.read(path, "seeed", as_is=True))
    with can.LogReader(path, protocol="serial", ts_unit="us") as reader:
        assert_equal(list(reader), canser.read(path, "serial", ts_unit="us"))


@pytest.mark.parametrize("given", [None, "seeed"])
def test_compressed_captures(tmp_path: Path, given: str | None) -> None:
    plain = raw(tmp_path / "run.bin", "seeed")
    packed = tmp_path / "run.bin.gz"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    # python-can hands no arguments on to the reader of what it decompresses.
    with (
        gzip.open(packed) as file,
        can.LogReader(packed) if given is None else CaptureReader(file, protocol=given) as reader,
    ):
        assert_equal(list(reader), canser.read(plain, "seeed"))


@pytest.mark.parametrize("given", [None, "seeed"])
def test_files_that_are_open(tmp_path: Path, given: str | None) -> None:
    path = raw(tmp_path / "run.bin", "seeed")
    for file in (path.open("rb"), io.BytesIO(path.read_bytes())):
        with CaptureReader(file, protocol=given) as reader:
            assert_equal(list(reader), canser.read(path, "seeed"))
        assert file.closed


def test_a_file_is_read_from_where_it_stands(tmp_path: Path) -> None:
    path = raw(tmp_path / "run.bin", "seeed")
    with path.open("rb") as file:
        skipped = canser.encode(traffic("seeed")[:10], "seeed")
        file.seek(len(skipped))
        with CaptureReader(file) as reader:
            assert_equal(list(reader), canser.read(path, "seeed")[10:])


def test_the_wrong_protocol_is_a_warning(tmp_path: Path) -> None:
    path = raw(tmp_path / "run.bin", "serial")
    with (
        can.LogReader(path, protocol="seeed") as reader,
        pytest.warns(CanserWarning, match=r"run\.bin: .* look like serial \(\d+%\)") as told,
    ):
        list(reader)
    assert len(told) == 1


def test_the_log_tells_which_protocol_was_found(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = raw(tmp_path / "run.bin", "seeed")
    with can.LogReader(path) as reader:
        list(reader)
    assert "run.bin: read as seeed (100%)" in caplog.text


def test_a_pipe_is_judged_by_its_first_bytes() -> None:
    bytes_ = canser.encode(traffic("seeed"), "seeed")

    class Pipe(io.BytesIO):
        def tell(self) -> int:
            raise io.UnsupportedOperation

        def seek(self, *_: int) -> int:
            raise io.UnsupportedOperation

    with CaptureReader(Pipe(bytes_), protocol="seeed") as reader:
        assert_equal(list(reader), canser.decode(bytes_, "seeed"))
    with CaptureReader(Pipe(bytes_)) as reader:
        assert_equal(list(reader), canser.decode(bytes_, "seeed"))
    pipe = Pipe(np.random.default_rng(1).bytes(5000))
    with pytest.raises(NoProtocolError, match="no protocol"):
        CaptureReader(pipe)
    assert not pipe.closed  # it is the caller's


@pytest.mark.parametrize("suffix", [".bin", ".raw"])
def test_nothing_has_no_messages(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    path.touch()
    with can.LogReader(path) as reader:
        assert list(reader) == []


def test_what_fits_no_protocol_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "noise.bin"
    path.write_bytes(np.random.default_rng(1).integers(0, 256, 100_000, np.uint8).tobytes())
    with pytest.raises(ValueError, match=r"noise\.bin: these bytes look like no .*give protocol="):
        can.LogReader(path)
    with pytest.raises(ValueError, match="unknown protocol 'morse'"):
        can.LogReader(path, protocol="morse")
    with pytest.raises(ValueError, match="ts_unit"):
        can.LogReader(path, protocol="serial", ts_unit="h")
    with pytest.raises(TypeError, match="protokol"):
        can.LogReader(path, protokol="serial")
    with pytest.raises(FileNotFoundError):
        can.LogReader(tmp_path / "nowhere.bin")
    gc.collect()  # a file left open would warn


def test_a_foreign_recording_is_an_error(tmp_path: Path) -> None:
    path = recording(tmp_path / "run.pcapng", "seeed")
    bytes_ = bytearray(path.read_bytes())
    path.write_bytes(bytes_.replace(b"canser:", b"foreig:"))
    with pytest.raises(RecordingError):
        can.LogReader(path)
    gc.collect()


def test_a_torn_recording_gives_what_is_good_and_warns(tmp_path: Path) -> None:
    path = recording(tmp_path / "run.pcapng", "seeed")
    whole = len(canser.read(path))
    path.write_bytes(path.read_bytes()[:-30])
    with can.LogReader(path) as reader, pytest.warns(CanserWarning, match=r"run\.pcapng: "):
        messages = list(reader)
    assert 0 < len(messages) <= whole


def test_stopping_in_the_middle_closes_the_file(tmp_path: Path) -> None:
    path = raw(tmp_path / "run.bin", "seeed")
    reader = can.LogReader(path)
    next(iter(reader))
    reader.stop()
    reader.stop()
    assert reader.file.closed


def test_messages_can_be_synchronized(tmp_path: Path) -> None:
    path = raw(tmp_path / "run.bin", "serial")
    with can.LogReader(path) as reader:
        played = list(can.MessageSync(reader, timestamps=False, gap=0))
    assert len(played) == len(traffic("serial"))
