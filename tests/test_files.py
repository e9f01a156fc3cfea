"""Files of any format by one call: what they are, several as one stream, written and converted."""

import contextlib
import importlib.metadata
import io
import itertools
import os
import sys
import warnings
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import canser
from canser import CanserWarning, FrameArray
from canser.commands.cli import main
from canser.files import formats
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter
from canser.simulation.traffic import vehicle
from device import descriptors
from reference import NO_TIME, Frame
from samples import EPOCH, MILLISECOND, SECOND, array, listed, timed

PROTOCOLS = canser.protocols()
FRAMES = vehicle(2, extended=False)
LOGGED = FRAMES.copy()
LOGGED["ts"] += EPOCH


def saved(path: Path, frames: FrameArray, protocol: str | None = None) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CanserWarning)  # what the file cannot hold
        canser.write(frames, path, protocol)
    return path


def recorded(path: Path, raw: bytes, protocol: str) -> Path:
    info = RecordingInfo(protocol, canser.protocol(protocol).baudrate, None, "ms", "/dev/x")
    with RecordingWriter(path, info) as writer:
        for at in range(0, len(raw), 4096):
            writer.write(raw[at : at + 4096], EPOCH + at * 100_000)
    return path


# What a file is.


@pytest.mark.parametrize("suffix", [".log", ".csv", ".npy"])
@pytest.mark.parametrize("name", ["run", "run.txt", "run.bin", "run.npy", "run.log"])
def test_the_content_tells_the_format_whatever_the_name(
    tmp_path: Path, suffix: str, name: str
) -> None:
    made = saved(tmp_path / f"made{suffix}", LOGGED)
    path = tmp_path / name
    made.rename(path)
    assert canser.read(path).tobytes() == LOGGED.tobytes()
    assert b"".join(block.tobytes() for block in canser.blocks(path)) == LOGGED.tobytes()
    with path.open("rb") as file:
        assert canser.read(file).tobytes() == LOGGED.tobytes()
    assert canser.read(io.BytesIO(path.read_bytes())).tobytes() == LOGGED.tobytes()


def test_a_recording_is_known_by_its_content(tmp_path: Path) -> None:
    raw = canser.encode(FRAMES, "seeed")
    path = recorded(tmp_path / "run.csv", raw, "seeed")
    with canser.blocks(path) as blocks:
        assert blocks.format == "pcapng"
        assert sum(map(len, blocks)) == len(FRAMES)


def test_the_name_tells_where_the_content_does_not(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("dlc,data,arbitration_id,extended,remote,error,timestamp\n1,AA==,0x1,0,0,0,2\n")
    assert listed(canser.read(path)) == [Frame(1, dlc=1, ts=2 * SECOND)]
    empty = tmp_path / "run.log"
    empty.write_bytes(b"")
    assert len(canser.read(empty)) == 0


def test_a_format_that_is_given_wins(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    path.write_text("timestamp,arbitration_id,extended,remote,error,dlc,data\n")
    assert len(canser.read(path, format="csv")) == 0
    with pytest.raises(canser.FormatError, match="line 1"):
        canser.read(path, format="candump")
    with pytest.raises(ValueError, match="unknown format 'log'; have: raw, pcapng, arrow, asc, "):
        canser.read(path, format="log")


@pytest.mark.parametrize("suffix", [".log", ".csv", ".npy"])
def test_a_protocol_for_a_file_of_frames_is_an_error_that_names_the_format(
    tmp_path: Path, suffix: str
) -> None:
    path = saved(tmp_path / f"run{suffix}", LOGGED)
    about = {".log": "a candump log", ".csv": "a CSV file", ".npy": "a .npy file"}[suffix]
    with pytest.raises(canser.ForeignFormatError, match=f"is {about}.*leave the protocol out"):
        canser.read(path, "seeed")
    assert len(canser.read(path, "auto")) == len(LOGGED)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        canser.read(path, "seeed", as_is=True)


def test_a_file_of_frames_has_no_decoder_and_no_offsets(tmp_path: Path) -> None:
    path = saved(tmp_path / "run.npy", FRAMES)
    with canser.blocks(path) as blocks:
        assert blocks.stats is None
        assert blocks.recording is None
        with pytest.raises(ValueError, match="holds frames, and no bytes"):
            blocks.decoder  # noqa: B018
    offsets = np.empty(len(FRAMES), np.int64)
    with pytest.raises(ValueError, match="leave offsets out"):
        canser.read(path, offsets=offsets)


@pytest.mark.parametrize("room", [1, 7, 1000, 1 << 17])
@pytest.mark.parametrize("suffix", [".log", ".csv", ".npy"])
def test_out_is_filled_again_and_again(tmp_path: Path, suffix: str, room: int) -> None:
    path = saved(tmp_path / f"run{suffix}", FRAMES)
    out = np.empty(room, canser.FRAME_DTYPE)
    got = [(len(block), block.tobytes()) for block in canser.blocks(path, out=out)]
    assert b"".join(data for _, data in got) == FRAMES.tobytes()
    assert {size for size, _ in got[:-1]} <= {room}


def test_a_pipe_is_known_by_its_first_line() -> None:
    receiver, sender = os.pipe()
    with open(receiver, "rb", buffering=0) as file, open(sender, "wb", buffering=0) as pipe:  # noqa: PTH123
        pipe.write(b"(1.5")
        pipe.write(b"00000) can0 123#11\n")
        with canser.blocks(file) as blocks:
            pipe.close()
            assert listed(blocks) == [
                Frame(0x123, dlc=1, data=b"\x11".ljust(8, b"\0"), ts=3 * SECOND // 2)
            ]
            assert blocks.format == "candump"


# Formats of other packages.


def points(monkeypatch: pytest.MonkeyPatch, **modules: Any) -> None:
    def load(self: EntryPoint) -> Any:
        module = modules[self.name]
        if isinstance(module, Exception):
            raise module
        return module

    monkeypatch.setattr(EntryPoint, "load", load)
    found = [EntryPoint(name, f"other.{name}", "canser.formats") for name in modules]
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: found if group else [])
    formats._all.cache_clear()


@pytest.fixture
def _added(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    class Writer:
        def __init__(self, file: Any) -> None:
            self._file = file

        def write(self, frames: FrameArray) -> None:
            self._file.write(b"mine" + frames.tobytes())

        def finish(self) -> list[str]:
            return ["something is lost"]

    def read(file: Any, name: str, tell: Any) -> Iterator[FrameArray]:
        assert file.read(4) == b"mine"
        yield np.frombuffer(file.read(), canser.FRAME_DTYPE)
        tell(f"the end of {Path(name).name}")

    mine = SimpleNamespace(
        suffixes=(".mine", ".log"), sniff=lambda head: head[:4] == b"mine", read=read, write=Writer
    )
    broken = ImportError("no module named x")
    points(monkeypatch, mine=mine, csv=mine, broken=broken)
    yield
    monkeypatch.undo()
    formats._all.cache_clear()


@pytest.mark.usefixtures("_added")
def test_a_format_of_another_package_is_read_and_written(tmp_path: Path) -> None:
    path = tmp_path / "run.mine"
    with pytest.warns(CanserWarning) as caught:
        canser.write(FRAMES, path)
    texts = [str(warning.message) for warning in caught]
    assert texts[0] == (
        "the format 'broken' of another package cannot be used: ImportError: no module named x"
    )
    assert texts[-1] == f"{path}: something is lost"
    with pytest.warns(CanserWarning, match="the end of run"):
        assert canser.read(path).tobytes() == FRAMES.tobytes()
    other = path.rename(tmp_path / "run.other")
    with pytest.warns(CanserWarning, match="the end of run"):
        assert canser.read(other).tobytes() == FRAMES.tobytes()
    assert "mine" in formats.format_names()


@pytest.fixture
def _failing(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    def sniff(head: bytes) -> bool:
        raise IndexError(f"{len(head)} bytes")

    points(monkeypatch, failing=SimpleNamespace(suffixes=(".x",), sniff=sniff, read=None))
    yield
    monkeypatch.undo()
    formats._all.cache_clear()


@pytest.mark.usefixtures("_failing")
def test_a_format_of_another_package_that_fails_is_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(canser.encode(FRAMES, "seeed"))
    with pytest.warns(CanserWarning) as caught:
        assert len(canser.read(path, "auto")) == len(FRAMES)
    assert "'failing' of another package cannot be used: IndexError" in str(caught[0].message)
    assert len(canser.read(path, "seeed")) == len(FRAMES)  # it is not asked
    with pytest.raises(ValueError, match="reads failing, and does not write it"):
        canser.write(FRAMES, tmp_path / "run.x")


@pytest.mark.usefixtures("_failing")
@pytest.mark.parametrize(("written", "is_asked"), [("seeed", False), ("serial", True)])
def test_formats_of_other_packages_are_not_asked_about_what_is_surely_raw(
    tmp_path: Path, written: str, is_asked: bool
) -> None:
    path, out = tmp_path / "run.bin", tmp_path / "run.npy"
    path.write_bytes(canser.encode(FRAMES, written))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with contextlib.suppress(canser.CanserError):
            canser.convert(path, out, "seeed")
    assert any("'failing'" in str(each.message) for each in caught) == is_asked


@pytest.mark.usefixtures("_added")
def test_a_format_of_canser_wins(tmp_path: Path) -> None:
    with pytest.warns(CanserWarning, match="broken"):
        formats.format_names()
    canser.write(LOGGED[:3], tmp_path / "run.log")
    canser.write(LOGGED[:3], tmp_path / "run.csv", format="csv")
    assert (tmp_path / "run.log").read_bytes().startswith(b"(")
    assert (tmp_path / "run.csv").read_bytes().startswith(b"timestamp")


# Several files.


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_raw_files_are_one_stream_wherever_they_are_cut(
    tmp_path: Path, protocol: str, threads: int
) -> None:
    raw = canser.encode(FRAMES, protocol)
    rng = np.random.default_rng(1)
    for cuts in ([1], [len(raw) // 2 + 3], sorted(rng.integers(0, len(raw), 6).tolist())):
        paths = []
        for number, (begin, end) in enumerate(itertools.pairwise([0, *cuts, len(raw)])):
            paths.append(tmp_path / f"{number}.bin")
            paths[-1].write_bytes(raw[begin:end])
        with canser.blocks(paths, protocol, threads=threads) as blocks:
            got = canser.concat(blocks)
            stats = blocks.stats
        whole = canser.Decoder(protocol)
        assert got.tobytes() == canser.concat([whole.feed(raw), whole.flush()]).tobytes()
        assert stats == whole.stats
        assert canser.read(paths, protocol).tobytes() == got.tobytes()
        assert [file.name for file in blocks.files] == [str(path) for path in paths]
        assert sum(file.frames for file in blocks.files) == len(got)


@pytest.mark.parametrize("threads", [1, 3])
def test_raw_files_of_one_byte_are_one_stream(tmp_path: Path, threads: int) -> None:
    raw = canser.encode(FRAMES[:4], "serial")
    paths = []
    for number, byte in enumerate(raw):
        paths.append(tmp_path / f"{number}.bin")
        paths[-1].write_bytes(bytes([byte]))
    got = canser.read(paths, "serial", threads=threads)
    assert got.tobytes() == canser.decode(raw, "serial").tobytes()


def test_bytes_of_another_protocol_are_doubted_whatever_file_comes_last(tmp_path: Path) -> None:
    raw = tmp_path / "a.bin"
    raw.write_bytes(canser.encode(FRAMES, "serial"))
    last = saved(tmp_path / "b.npy", timed(NO_TIME))
    with canser.blocks([raw], "seeed") as blocks, pytest.warns(CanserWarning, match="are in no"):
        list(blocks)
    for command in (["info"], ["convert", "-o", str(tmp_path / "x.csv")], ["dump"]):
        assert main([*command, str(raw), str(last), "-p", "seeed"]) == 1
    assert not (tmp_path / "x.csv").exists()


def test_raw_files_with_offsets_are_one_stream(tmp_path: Path) -> None:
    raw = canser.encode(FRAMES, "seeed")
    paths = [tmp_path / "a.bin", tmp_path / "b.bin"]
    paths[0].write_bytes(raw[:1001])
    paths[1].write_bytes(raw[1001:])
    out, at = np.empty(100, canser.FRAME_DTYPE), np.empty(100, np.int64)
    got = [at[: len(block)].copy() for block in canser.blocks(paths, "seeed", out=out, offsets=at)]
    want = np.empty(len(FRAMES), np.int64)
    canser.decode(raw, "seeed", offsets=want)
    assert np.array_equal(np.concatenate(got), want)


def test_formats_may_mix(tmp_path: Path) -> None:
    later, last = LOGGED.copy(), LOGGED.copy()
    later["ts"] += 10 * SECOND
    last["ts"] += 20 * SECOND
    paths = [
        saved(tmp_path / "a.log", LOGGED),
        saved(tmp_path / "b.npy", later),
        saved(tmp_path / "c.csv", last),
    ]
    want = canser.concat([LOGGED, later, last])
    assert canser.read(paths).tobytes() == want.tobytes()
    assert canser.read(tuple(map(str, paths))).tobytes() == want.tobytes()
    with canser.blocks(paths) as blocks:
        assert sum(map(len, blocks)) == len(want)
    assert [(Path(name).name, kind, count) for name, kind, count in blocks.files] == [
        ("a.log", "candump", len(LOGGED)),
        ("b.npy", "npy", len(LOGGED)),
        ("c.csv", "csv", len(LOGGED)),
    ]


def test_the_protocol_of_a_list_is_that_of_its_raw_bytes(tmp_path: Path) -> None:
    paths = [
        saved(tmp_path / "a.bin", FRAMES, "serial"),
        saved(tmp_path / "b.npy", timed(NO_TIME)),
    ]
    got = canser.read(paths, "serial")
    assert len(got) == len(FRAMES) + 1
    with canser.blocks(paths, "serial") as blocks:
        assert sum(map(len, blocks)) == len(got)
        assert blocks.protocol == "serial"
        assert blocks.stats is not None
        assert blocks.stats.frames == len(FRAMES)


def test_a_packet_that_the_end_of_a_recording_cuts_does_not_go_on(tmp_path: Path) -> None:
    raw = canser.encode(FRAMES[:2], "seeed")
    first = recorded(tmp_path / "a.pcapng", raw[:5], "seeed")
    second = tmp_path / "b.bin"
    second.write_bytes(raw[5:])
    assert len(canser.read([first, second], "seeed")) == 1


def test_time_bases_do_not_mix(tmp_path: Path) -> None:
    paths = [saved(tmp_path / "a.npy", FRAMES), saved(tmp_path / "b.log", LOGGED)]
    with pytest.raises(canser.FormatError, match=r"b\.log counts its times from 1970, .*a\.npy"):
        canser.read(paths)
    with pytest.raises(canser.FormatError, match=r"a\.npy counts its times from a device's start"):
        canser.read(paths[::-1])
    untimed = saved(tmp_path / "c.npy", timed(NO_TIME, NO_TIME))
    assert len(canser.read([untimed, *paths[1:], untimed])) == len(LOGGED) + 4


def test_a_file_that_begins_too_early_is_told_and_sort_orders_all(tmp_path: Path) -> None:
    even, odd = timed(*range(0, 100, 2)).copy(), timed(*range(1, 100, 2)).copy()
    for frames in (even, odd):
        frames["ts"] = frames["ts"] * MILLISECOND + EPOCH
    paths = [saved(tmp_path / "a.npy", even), saved(tmp_path / "b.npy", odd)]
    with pytest.warns(CanserWarning, match=r"b\.npy begins 0\.097 s before the end of .*--sort"):
        assert len(canser.read(paths)) == 100
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(canser.read([paths[0]])) == 50
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        got = canser.read(paths, sort=True)
    assert got["ts"].tolist() == [EPOCH + ms * MILLISECOND for ms in range(100)]
    canser.convert(paths, tmp_path / "all.npy", sort=True)
    assert canser.read(tmp_path / "all.npy").tobytes() == got.tobytes()


def test_frames_of_the_same_time_keep_their_order_and_those_without_come_first(
    tmp_path: Path,
) -> None:
    frames = array(*(Frame(number, ts=ts) for number, ts in enumerate((2, 1, NO_TIME, 1, 2))))
    assert canser.read(saved(tmp_path / "x.npy", frames), sort=True)["id"].tolist() == [
        2, 1, 3, 0, 4,
    ]  # fmt: skip


def test_a_file_twice_begins_too_early(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.npy", LOGGED)
    with pytest.warns(CanserWarning, match=r"a\.npy begins .* before the end of .*a\.npy"):
        assert len(canser.read([path, path])) == 2 * len(LOGGED)


@pytest.mark.skipif(sys.platform == "win32", reason="descriptors are counted in /proc or /dev")
def test_files_that_were_read_are_closed(tmp_path: Path) -> None:
    paths = [saved(tmp_path / f"{n}.bin", FRAMES[:5], "seeed") for n in range(30)]
    before = descriptors()
    most = 0
    with canser.blocks(paths, "seeed") as blocks:
        for _ in blocks:
            most = max(most, descriptors() - before)
    assert most <= 4
    assert descriptors() == before


def test_the_bytes_of_all_files_are_counted(tmp_path: Path) -> None:
    paths = [saved(tmp_path / f"{n}.bin", FRAMES, "seeed") for n in range(3)]
    size = sum(path.stat().st_size for path in paths)
    told: list[tuple[int, int | None]] = []
    for _ in canser.blocks(paths, "seeed", progress=lambda done, total: told.append((done, total))):
        pass
    assert told[-1] == (size, size)
    assert [done for done, _ in told] == sorted(done for done, _ in told)


def test_no_file_is_an_error_and_a_missing_one_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="the list of files is empty"):
        canser.read([])
    first = saved(tmp_path / "a.npy", FRAMES)
    with pytest.raises(FileNotFoundError, match=r"missing\.npy"):
        canser.read([first, tmp_path / "missing.npy"])


# Writing.


@pytest.mark.parametrize("suffix", [".log", ".csv", ".npy"])
def test_write_takes_an_array_or_blocks(tmp_path: Path, suffix: str) -> None:
    one, other = tmp_path / f"one{suffix}", tmp_path / f"other{suffix}"
    done = canser.write(FRAMES, one)
    assert (done.frames, done.bytes_out, done.remarks) == (len(FRAMES), 0, [])
    canser.write(iter([FRAMES[:10], FRAMES[10:]]), other)
    assert one.read_bytes() == other.read_bytes()
    assert canser.read(one).tobytes() == FRAMES.tobytes()


def test_a_file_that_is_there_is_replaced_by_force_only(tmp_path: Path) -> None:
    path = saved(tmp_path / "run.log", FRAMES)
    with pytest.raises(canser.OutputExistsError, match="is there already"):
        canser.write(LOGGED, path)
    assert canser.read(path).tobytes() == FRAMES.tobytes()
    canser.write(LOGGED, path, force=True)
    assert canser.read(path).tobytes() == LOGGED.tobytes()


def test_what_a_file_cannot_hold_is_a_warning(tmp_path: Path) -> None:
    with pytest.warns(CanserWarning, match=r"x\.log: times cut to the microsecond: 1"):
        canser.write(timed(1), tmp_path / "x.log")
    with pytest.warns(CanserWarning, match=r"x\.bin: seeed carries no times"):
        done = canser.write(FRAMES, tmp_path / "x.bin", "seeed")
    assert done.bytes_out == (tmp_path / "x.bin").stat().st_size


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("x.xyz", {}, r"cannot tell the format of .*x\.xyz by its suffix; use .*\.log"),
        ("x.bin", {}, "raw bytes need a protocol"),
        ("x.pcapng", {}, "a recording needs a protocol"),
        ("x.log", {"format": "xyz"}, "unknown format 'xyz'"),
        ("x.bin", {"protocol": "sped"}, "unknown protocol 'sped'"),
        ("x.bin", {"protocol": "seeed", "ts_unit": "min"}, "unknown ts_unit 'min'"),
    ],
)
def test_a_call_that_is_wrong_leaves_no_file(
    tmp_path: Path, name: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        canser.write(FRAMES, tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_array_of_frames_is_not_written(tmp_path: Path) -> None:
    for bad in (np.zeros(3), FRAMES.reshape(1, -1), [FRAMES["id"]]):
        with pytest.raises(TypeError, match=r"arrays of canser\.FRAME_DTYPE"):
            canser.write(bad, tmp_path / "x.npy")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_frames_come_back_from_a_recording_with_their_times(tmp_path: Path, protocol: str) -> None:
    path = saved(tmp_path / "run.pcapng", LOGGED, protocol)
    back = canser.read(path)
    assert [frame._replace(ts=0) for frame in listed(back)] == [
        frame._replace(ts=0) for frame in listed(LOGGED)
    ]
    assert np.abs(back["ts"] - LOGGED["ts"]).max() <= 2 * MILLISECOND


def test_times_before_1970_are_0_in_a_recording_and_unknown_ones_those_before(
    tmp_path: Path,
) -> None:
    with pytest.warns(CanserWarning) as caught:
        canser.write(timed(NO_TIME, -5, SECOND, NO_TIME), tmp_path / "x.pcapng", "seeed")
    texts = sorted(str(warning.message).split(": ", 1)[1] for warning in caught)
    assert texts == [
        "frames with a time before 1970, written as 0: 1",
        "frames without a time, which get that of the frame before: 2",
    ]
    times = canser.read(tmp_path / "x.pcapng")["ts"]
    assert np.abs(times - [0, 0, SECOND, SECOND]).max() <= MILLISECOND


# Converting.


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_recording_becomes_the_bytes_of_its_line(tmp_path: Path, protocol: str) -> None:
    raw = b"\0noise" + canser.encode(FRAMES, protocol) + b"\xaa"
    source = recorded(tmp_path / "run.pcapng", raw, protocol)
    done = canser.convert(source, tmp_path / "run.bin")
    assert (tmp_path / "run.bin").read_bytes() == raw
    assert done.bytes_out == len(raw)
    with pytest.raises(canser.WrongProtocolError, match=f"is a recording in {protocol}"):
        canser.convert(source, tmp_path / "x.csv", next(p for p in PROTOCOLS if p != protocol))


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_raw_bytes_become_a_recording_of_the_same_bytes(tmp_path: Path, protocol: str) -> None:
    raw = canser.encode(FRAMES, protocol) + b"\xaa\0noise"
    source = tmp_path / "run.bin"
    source.write_bytes(raw)
    with pytest.warns(CanserWarning, match="times count from"):
        canser.convert(source, tmp_path / "run.pcapng", protocol)
    canser.convert(tmp_path / "run.pcapng", tmp_path / "back.bin")
    assert (tmp_path / "back.bin").read_bytes() == raw
    back, want = canser.read(tmp_path / "run.pcapng"), canser.read(source, protocol)
    assert back["id"].tolist() == want["id"].tolist()
    if canser.protocol(protocol).has_clock:
        assert np.abs(back["ts"] - want["ts"]).max() <= 2 * MILLISECOND
    else:
        # The line's rate.
        took = (len(raw) - 8) * 10e9 / canser.protocol(protocol).baudrate
        assert back["ts"][-1] == pytest.approx(took, abs=3 * MILLISECOND)


def test_several_files_become_one(tmp_path: Path) -> None:
    paths = [saved(tmp_path / f"{n}.bin", FRAMES, "serial") for n in range(2)]
    with pytest.warns(CanserWarning, match="before the end"):
        done = canser.convert(paths, tmp_path / "both.csv", "serial")
    assert done.frames == 2 * len(FRAMES)


def test_a_source_is_not_replaced(tmp_path: Path) -> None:
    path = saved(tmp_path / "run.log", FRAMES)
    with pytest.raises(canser.OutputExistsError, match="are one file"):
        canser.convert(path, path, force=True)
    assert canser.read(path).tobytes() == FRAMES.tobytes()


def test_raw_bytes_do_not_become_other_raw_bytes(tmp_path: Path) -> None:
    path = saved(tmp_path / "run.bin", FRAMES, "serial")
    with pytest.raises(ValueError, match="input and output are both raw bytes"):
        canser.convert(path, tmp_path / "x.bin", "serial")


def test_the_wrong_protocol_leaves_no_file(tmp_path: Path) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(canser.encode(FRAMES, "serial"))
    with pytest.raises(canser.FormatError, match="as_is=True accepts them"):
        canser.convert(path, tmp_path / "x.csv", "seeed")
    assert not (tmp_path / "x.csv").exists()


# The commands.


def test_info_is_one_report_with_a_line_for_each_file(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    later = LOGGED.copy()
    later["ts"] += 10 * SECOND
    paths = [str(saved(tmp_path / "a.log", LOGGED)), str(saved(tmp_path / "b.npy", later))]
    assert main(["info", *paths]) == 0
    lines = capfd.readouterr().out.splitlines()
    assert lines[:2] == [
        f"file       {paths[0]}, candump: {len(LOGGED):,}",
        f"file       {paths[1]}, npy: {len(LOGGED):,}",
    ]
    assert lines[2].startswith(f"frames     {2 * len(LOGGED):,}")
    found = canser.info(paths)
    assert [part.frames for part in found.files] == [len(LOGGED)] * 2
    assert str(found).splitlines() == lines


def test_info_finds_the_protocol_of_the_file_that_needs_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    saved(tmp_path / "a.npy", FRAMES)
    saved(tmp_path / "b.bin", FRAMES, "serial")
    (tmp_path / "noise.bin").write_bytes(np.random.default_rng(1).bytes(5000))
    found = canser.info(["a.npy", "b.bin"])
    assert (found.frames, found.protocol) == (2 * len(FRAMES), "serial")
    assert found.fits[0].protocol == "serial"
    assert main(["info", "a.npy", "noise.bin"]) == 1
    assert "no protocol fits noise.bin" in capfd.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["a.log", "b.npy", "out.csv"],
        ["a.log", "b.npy", "-o", "out.csv"],
        ["-o", "out.csv", "a.log", "b.npy"],
        ["a.log", "b.npy", "out.csv", "--sort"],
    ],
    ids=" ".join,
)
def test_convert_takes_several_files_as_cp_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    later = LOGGED.copy()
    later["ts"] += 10 * SECOND
    saved(tmp_path / "a.log", LOGGED)
    saved(tmp_path / "b.npy", later)
    assert main(["convert", *arguments]) == 0
    assert canser.read("out.csv").tobytes() == canser.concat([LOGGED, later]).tobytes()


def test_dump_takes_several_files(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    paths = [str(saved(tmp_path / f"{n}.npy", LOGGED[:3])) for n in range(2)]
    assert main(["dump", *paths]) == 0
    out, err = capfd.readouterr()
    assert len(out.splitlines()) == 6
    assert "--sort" in err


def test_a_recording_is_converted_to_its_bytes_and_back(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    raw = canser.encode(FRAMES, "seeed")
    source = recorded(tmp_path / "run.pcapng", raw, "seeed")
    out, again = str(tmp_path / "run.bin"), str(tmp_path / "again.pcapng")
    assert main(["convert", str(source), out]) == 0
    assert f"{len(raw):,} bytes of the line" in capfd.readouterr().err
    assert Path(out).read_bytes() == raw
    assert main(["convert", out, again, "-p", "seeed"]) == 0
    assert main(["convert", out, str(tmp_path / "x.pcapng")]) == 2
    assert len(canser.read(again)) == len(FRAMES)


def dumped(capfd: pytest.CaptureFixture[str], *arguments: str) -> list[str]:
    assert main(["dump", *arguments]) == 0
    return capfd.readouterr().out.splitlines()


def steps(tmp_path: Path, *, epoch: int = EPOCH) -> str:
    """Return a file of 10 frames, of the ids 0 to 9, a second from each other."""
    frames = array(*(Frame(number, ts=epoch + number * SECOND) for number in range(10)))
    return str(saved(tmp_path / "steps.npy", frames))


@pytest.mark.parametrize(
    ("options", "ids"),
    [
        (["--count", "3"], "012"),
        (["--start", "7s"], "789"),
        (["--end", "2s"], "01"),
        (["--start", "2s", "--end", "5s"], "234"),
        (["--start", "2s", "--count", "1"], "2"),
        (["--filter", "003", "--filter", "008"], "38"),
        (["--filter", "003:703", "--count", "2"], "37"),
        (["--start", "2018-12-06T14:31:24Z"], "56789"),
        (["--end", "2018-12-06 14:31:20.5"], "01"),
        (["--start", "2018-12-06T15:31:27+01:00"], "89"),
        (["--start", "1h"], ""),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_frames_are_chosen(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], options: list[str], ids: str
) -> None:
    path = steps(tmp_path)
    lines = dumped(capfd, path, *options)
    assert [line.split()[2][:3] for line in lines] == [f"00{digit}" for digit in ids]
    out = str(tmp_path / "out.csv")
    assert main(["convert", path, out, *options]) == 0
    assert canser.read(out)["id"].tolist() == [int(digit) for digit in ids]


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--start", "soon"], "cannot read the time 'soon'"),
        (["--start", "2018-13-06T15:31:24"], "cannot read the time"),
        (["--epoch", "now"], "cannot read the date 'now'; write 2026-11-26T08:00:00"),
        (["--count", "0"], "1 or more"),
        (["--filter", "1234"], "has 4 digits"),
        (["-t", "x"], "invalid choice"),
    ],
    ids=" ".join,
)
def test_a_choice_that_cannot_be_read_is_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], options: list[str], word: str
) -> None:
    try:
        code = main(["dump", steps(tmp_path), *options])
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 1
    out, err = capfd.readouterr()
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert word in line


def test_an_epoch_makes_dates_of_times_of_a_device(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = steps(tmp_path, epoch=7 * SECOND)
    date = "2018-12-06T15:31:19.000"
    lines = dumped(capfd, path, "--epoch", date, "--start", "8s", "-t", "A")
    assert lines == [
        "(2018-12-06 15:31:27.000000) can0 008#",
        "(2018-12-06 15:31:28.000000) can0 009#",
    ]
    assert main(["dump", steps(tmp_path / "..", epoch=EPOCH), "--epoch", date]) == 1
    assert "count from 1970 already" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("stamp", "times"),
    [
        ("a", ["1544110279.000000", "1544110280.000000"]),
        ("z", ["0.000000", "1.000000"]),
        ("d", ["0.000000", "1.000000", "1.000000"]),
    ],
)
def test_times_are_shown_as_candump_has_them(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], stamp: str, times: list[str]
) -> None:
    lines = dumped(capfd, steps(tmp_path, epoch=1544110279 * SECOND), "-t", stamp)
    assert [line[1 : line.index(")")] for line in lines][: len(times)] == times


def test_a_time_that_is_not_known_is_0_whatever_the_stamp(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = str(saved(tmp_path / "x.npy", timed(NO_TIME, SECOND, NO_TIME, 3 * SECOND)))
    for stamp, last in (("d", "2.000000"), ("z", "2.000000"), ("a", "3.000000")):
        times = [line.split(")")[0][1:] for line in dumped(capfd, path, "-t", stamp)]
        assert (times[0], times[2], times[3]) == ("0.000000", "0.000000", last)


TWO_BUSES = (
    "(1.000000) can0 001#11\n(2.000000) can1 002#22\n"
    "(3.000000) can1 003#33\n(4.000000) vcan0 004#44\n"
)


def test_one_bus_of_a_log(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "two.log"
    path.write_text(TWO_BUSES)
    assert [line.split()[2] for line in dumped(capfd, str(path), "--bus", "can1")] == [
        "002#22",
        "003#33",
    ]
    with pytest.warns(CanserWarning, match="frames of other buses, left out: 2"):
        assert canser.read(path, bus="can1")["id"].tolist() == [2, 3]
    with pytest.raises(canser.FormatError, match=r"no frame of the bus can9; it has can0 1, can1"):
        canser.read(path, bus="can9")
    assert main(["info", str(path), "--bus", "can0"]) == 0
    assert capfd.readouterr().out.startswith("frames     1")
    assert main(["convert", str(path), str(tmp_path / "x.csv"), "--bus", "vcan0"]) == 0
    assert canser.read(tmp_path / "x.csv")["id"].tolist() == [4]


def test_one_bus_of_a_csv_file(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    header = "timestamp,arbitration_id,extended,remote,error,dlc,data,channel\n"
    path.write_text(header + "1,0x1,0,0,0,0,,a\n2,0x2,0,0,0,0,,b\n")
    with pytest.warns(CanserWarning, match="left out: 1"):
        assert canser.read(path, bus="b")["id"].tolist() == [2]
    path.write_text("timestamp,arbitration_id,extended,remote,error,dlc,data\n1,0x1,0,0,0,0,\n")
    with pytest.raises(canser.FormatError, match="no column channel names the bus"):
        canser.read(path, bus="b")


def test_formats_without_buses_say_so(tmp_path: Path) -> None:
    paths = [saved(tmp_path / "x.bin", FRAMES, "seeed"), saved(tmp_path / "x.npy", FRAMES)]
    for path, protocol in zip(paths, ("seeed", None), strict=True):
        with pytest.raises(ValueError, match=r"x\.(bin|npy) names no buses; leave bus out"):
            canser.read(path, protocol, bus="can0")


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_a_script_completes_commands_and_options(
    shell: str, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("shtab", reason="completion is an optional extra")
    with pytest.raises(SystemExit) as ended:
        main(["--print-completion", shell])
    assert ended.value.code == 0
    script = capfd.readouterr().out
    for word in ("convert", "simulate") if shell == "tcsh" else ("convert", "--epoch", "--bus"):
        assert word in script
