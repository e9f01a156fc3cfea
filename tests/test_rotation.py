"""Bytes in, files out: no port, and no clock but the one that the tests make."""

import errno
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import canser
import canser.recording.rotation
import shared  # noqa: F401 - Hypothesis' settings
from canser.recording.header import RecordingInfo
from canser.recording.reader import Recording
from canser.recording.rotation import RecordingFiles
from canser.recording.writer import RecordingWriter
from canser.simulation.traffic import vehicle
from long import LONG

INFO = RecordingInfo("seeed", 2_000_000, 500_000, "ms", "/dev/test")
MS = 1_000_000
SECOND = 1_000 * MS
START = 1_700_000_000 * SECOND

RAW = canser.encode(vehicle(1.5), "seeed")


@pytest.fixture(scope="module", autouse=True)
def _quick_disk() -> Iterator[None]:
    """Let nothing be written through: here it is about which bytes go where."""
    with pytest.MonkeyPatch.context() as patch:
        for name in {"fsync", "fdatasync"} & set(dir(os)):
            patch.setattr(os, name, lambda _: None)
        yield


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def content(path: Path) -> bytes:
    with Recording(path) as recording:
        raw = b"".join(bytes(piece.data) for piece in recording)
        assert recording.remarks == []
    return raw


def packets(raw: bytes) -> list[int]:
    """Return where packets end, 0 in front of them."""
    starts = np.empty(len(raw), np.int64)
    count = len(canser.decode(raw, "seeed", offsets=starts))
    return [*starts[:count].tolist(), len(raw)]


ENDS = packets(RAW)


def border(offset: int) -> int:
    """Return the last end of a packet that is not behind an offset."""
    return ENDS[int(np.searchsorted(ENDS, offset, side="right")) - 1]


def feed(
    recorder: RecordingFiles,
    raw: bytes = RAW,
    *,
    step: int = 1000,
    every: int = 50 * MS,
    triggers: Iterable[int] = (),
) -> None:
    """Feed bytes in pieces, as a port does; triggers are milliseconds since the start."""
    waiting = sorted(START + ms * MS for ms in triggers)
    done = 0
    for number, begin in enumerate(range(0, len(raw), step)):
        ns = START + (number + 1) * every
        piece = raw[begin : begin + step]
        recorder.write(memoryview(piece), ns)
        done += len(piece)
        due = [ts for ts in waiting if ts <= ns]
        waiting = waiting[len(due) :]
        recorder.advance(border(done), ns, due)


def test_one_file_holds_all_bytes_and_their_times(tmp_path: Path) -> None:
    recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO)
    assert names(tmp_path) == []
    recorder.start(START)
    feed(recorder)
    recorder.close()
    recorder.close()
    assert names(tmp_path) == ["run.pcapng"]
    assert content(tmp_path / "run.pcapng") == RAW
    assert recorder.bytes_in == recorder.bytes_recorded == len(RAW)
    assert recorder.bytes_passed == 0
    with Recording(tmp_path / "run.pcapng") as recording:
        assert recording.info == INFO
        arrivals = [piece.arrival_ns for piece in recording]
    last = START + -(-len(RAW) // 1000) * 50 * MS
    assert arrivals[-1] == last
    assert arrivals == sorted(arrivals)
    assert [(event.kind, Path(event.path).name) for event in recorder.events] == [
        ("opened", "run.pcapng"),
        ("closed", "run.pcapng"),
    ]


@settings(max_examples=20 if LONG else 10)
@given(
    step=st.integers(1, 3000),
    size=st.integers(1500, 12_000),
    period=st.none() | st.integers(1, 900),
)
def test_files_by_turns_lose_no_byte_and_cut_no_frame(
    tmp_path_factory: pytest.TempPathFactory, step: int, size: int, period: int | None
) -> None:
    folder = tmp_path_factory.mktemp("turns")
    raw = RAW[: ENDS[800]]
    recorder = RecordingFiles(
        str(folder / "run.pcapng"),
        INFO,
        size=size,
        period_ns=None if period is None else period * MS,
    )
    recorder.start(START)
    feed(recorder, raw, step=step)
    recorder.close()
    files = sorted(folder.iterdir())
    assert [file.name for file in files] == [
        f"run-{number + 1:06}.pcapng" for number in range(len(files))
    ]
    parts = [content(file) for file in files]
    assert b"".join(parts) == raw
    assert recorder.bytes_recorded == len(raw)
    # One round may hold more than a file: then a file ends where it must.
    if step + 20 < size - 1100:
        for part in parts:
            decoder = canser.Decoder("seeed")
            decoder.feed(part)
            assert (decoder.stats.bytes_skipped, decoder.pending) == (0, 0)
        assert all(file.stat().st_size <= size for file in files)


def test_a_round_that_is_larger_than_a_file(tmp_path: Path) -> None:
    recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO, size=5_000)
    recorder.start(START)
    for number in range(20):
        recorder.write(bytes([number]) * 1_000, START + number * MS)
    recorder.advance(20_000, START + 20 * MS)
    recorder.close()
    assert b"".join(content(path) for path in sorted(tmp_path.iterdir())) == b"".join(
        bytes([number]) * 1_000 for number in range(20)
    )
    assert all(path.stat().st_size <= 5_000 for path in tmp_path.iterdir())


def test_time_turns_without_size(tmp_path: Path) -> None:
    recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO, period_ns=200 * MS)
    recorder.start(START)
    feed(recorder, RAW[: ENDS[800]])
    recorder.close()
    spans = []
    for path in sorted(tmp_path.iterdir()):
        with Recording(path) as recording:
            times = [piece.arrival_ns for piece in recording]
        spans.append(times[-1] - times[0])
    assert len(spans) >= 2
    assert max(spans) <= 200 * MS
    assert b"".join(content(path) for path in sorted(tmp_path.iterdir())) == RAW[: ENDS[800]]


def test_keep_deletes_the_oldest_of_this_run_only(tmp_path: Path) -> None:
    old = tmp_path / "run-000007.pcapng"
    old.write_text("old")
    other = tmp_path / "run-1.pcapng"
    other.write_text("other")
    recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO, size=3_000, keep=2)
    recorder.start(START)
    feed(recorder, step=500)
    # One that was taken away is no error, and what has its name then is another file.
    taken = Path(recorder.files_kept[0])
    taken.unlink()
    assert recorder.files_kept == [recorder.file]
    taken.write_text("put there")
    feed(recorder, RAW, step=500)
    recorder.close()
    assert taken.read_text() == "put there"
    taken.unlink()
    left = [name for name in names(tmp_path) if name not in (old.name, other.name)]
    assert len(left) == 2
    assert (old.read_text(), other.read_text()) == ("old", "other")
    made = [Path(event.path).name for event in recorder.events if event.kind == "opened"]
    gone = [Path(event.path).name for event in recorder.events if event.kind == "deleted"]
    assert made[0] == "run-000008.pcapng"
    assert gone == [name for name in made[:-2] if name != taken.name]
    assert left == made[-2:]


def test_numbers_that_somebody_else_takes_are_left_out(tmp_path: Path) -> None:
    recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO, size=20_000)
    (tmp_path / "run-000001.pcapng").write_text("theirs")
    recorder.start(START)
    feed(recorder, RAW[:1000])
    recorder.close()
    assert (tmp_path / "run-000001.pcapng").read_text() == "theirs"
    assert content(tmp_path / "run-000002.pcapng") == RAW[:1000]


def test_force_replaces_and_counts_from_one(tmp_path: Path) -> None:
    for name in ("run.pcapng", "run-000001.pcapng", "run-000009.pcapng"):
        (tmp_path / name).write_text("old")
    for size in (None, 1 << 20):
        recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO, force=True, size=size)
        recorder.start(START)
        feed(recorder)
        recorder.close()
    assert content(tmp_path / "run.pcapng") == content(tmp_path / "run-000001.pcapng") == RAW
    assert (tmp_path / "run-000009.pcapng").read_text() == "old"


def test_paths_that_will_not_do(tmp_path: Path) -> None:
    there = tmp_path / "run.pcapng"
    there.write_text("old")
    with pytest.raises(FileExistsError, match=r"run\.pcapng is there already; --force"):
        RecordingFiles(str(there), INFO)
    with pytest.raises(ValueError, match=r"run\.bin is no name of a recording; .* \.pcapng"):
        RecordingFiles(str(tmp_path / "run.bin"), INFO)
    with pytest.raises(FileNotFoundError):
        RecordingFiles(str(tmp_path / "nowhere" / "run.pcapng"), INFO)
    (tmp_path / "folder.pcapng").mkdir()
    with pytest.raises(FileExistsError, match="is no file"):
        RecordingFiles(str(tmp_path / "folder.pcapng"), INFO, force=True)
    assert there.read_text() == "old"


@pytest.mark.parametrize(
    "wrong",
    [{"size": 0}, {"period_ns": 0}, {"keep": 2}, {"size": 9, "keep": 0}, {"window_ns": (-1, 0)}],
    ids=str,
)
def test_values_that_make_no_sense(tmp_path: Path, wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"it must be|give their size|are 0 or more"):
        RecordingFiles(str(tmp_path / "run.pcapng"), INFO, **wrong)  # type: ignore[arg-type]


def test_lost_bytes_stand_where_they_are_missing(tmp_path: Path) -> None:
    recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO)
    recorder.start(START)
    recorder.write(b"one", START, 0)
    recorder.write(b"two", START + MS, 17)
    recorder.write(b"three", START + 2 * MS, -1)
    recorder.advance(5, START + 2 * MS)  # in the middle of the second
    recorder.close()
    with Recording(tmp_path / "run.pcapng") as recording:
        found = [(bytes(piece.data), piece.lost) for piece in recording]
    assert found == [(b"one", 0), (b"two", 17), (b"three", -1)]


# Triggers


def windows(times: list[int], before: int, after: int) -> list[tuple[int, int]]:
    """Return what surrounds times, joined where it touches, in plain Python."""
    joined: list[tuple[int, int]] = []
    for time in sorted(times):
        begin, end = time - before, time + after
        if joined and begin <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(end, joined[-1][1]))
        else:
            joined.append((begin, end))
    return joined


@settings(max_examples=40)
@given(
    times=st.lists(st.integers(50, 1400), max_size=5),
    before=st.integers(0, 400),
    after=st.integers(0, 400),
    step=st.integers(100, 1500),
)
def test_what_surrounds_triggers_is_there_and_little_more(
    tmp_path_factory: pytest.TempPathFactory,
    times: list[int],
    before: int,
    after: int,
    step: int,
) -> None:
    folder = tmp_path_factory.mktemp("triggers")
    raw = RAW[: ENDS[1500]]
    recorder = RecordingFiles(str(folder / "e.pcapng"), INFO, window_ns=(before * MS, after * MS))
    recorder.start(START)
    every = 20 * MS
    feed(recorder, raw, step=step, every=every, triggers=times)
    recorder.close()
    assert recorder.bytes_in == recorder.bytes_recorded + recorder.bytes_passed == len(raw)
    ended = (-(-len(raw) // step)) * 20
    seen = [time for time in times if time <= ended]
    assert recorder.triggers == len(seen)
    # Each file is one unbroken part of the stream, cut between packets, in order.
    spans = []
    done = 0
    for path in sorted(folder.iterdir()):
        part = content(path)
        at = raw.find(part, done)
        assert at >= done
        assert at in ENDS
        assert at + len(part) in ENDS
        done = at + len(part)
        spans.append((at, done))
    assert sum(end - begin for begin, end in spans) == recorder.bytes_recorded
    # All that came within a window is in a file; what came two rounds away from all is in
    # none. (A piece ends with a part of a packet: what settles was there a bit earlier.)
    wanted = windows(seen, before, after)
    for number, begin in enumerate(range(0, len(raw), step)):
        ms = (number + 1) * 20
        byte = border(min(begin + step, len(raw))) - 1
        if byte < begin:
            continue
        inside = any(start <= byte < end for start, end in spans)
        if ms in seen or any(start < ms <= end for start, end in wanted):
            assert inside
        if not any(start - 40 <= ms <= end + 40 for start, end in wanted):
            assert not inside


def test_triggers_whose_surroundings_touch_share_a_file(tmp_path: Path) -> None:
    recorder = RecordingFiles(str(tmp_path / "e.pcapng"), INFO, window_ns=(200 * MS, 100 * MS))
    # The second begins 250 ms behind the first one's end, the third 100 ms behind the second's.
    feed(recorder, RAW, step=200, every=10 * MS, triggers=[300, 850, 1050])
    recorder.close()
    assert names(tmp_path) == ["e-000001.pcapng", "e-000002.pcapng"]
    assert [event.ts for event in recorder.events if event.kind == "trigger"] == [
        START + ms * MS for ms in (300, 850, 1050)
    ]
    second = content(tmp_path / "e-000002.pcapng")
    assert second in RAW
    assert len(second) >= (850 - 650 + 1150 - 850) // 10 * 200 - 200


def test_without_a_trigger_there_is_no_file(tmp_path: Path) -> None:
    recorder = RecordingFiles(str(tmp_path / "e.pcapng"), INFO, window_ns=(SECOND, SECOND))
    recorder.start(START)
    feed(recorder)
    assert not recorder.recording
    recorder.close()
    assert names(tmp_path) == []
    assert (recorder.bytes_recorded, recorder.bytes_passed) == (0, len(RAW))


def test_what_waits_for_a_trigger_is_bounded_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(canser.recording.rotation, "MEMORY", 6_000)
    recorder = RecordingFiles(str(tmp_path / "e.pcapng"), INFO, window_ns=(3600 * SECOND, 0))
    feed(recorder, RAW[: ENDS[1000]], step=500)
    assert recorder.out_of_memory
    # Each round is two pieces, which take some memory besides their bytes.
    assert 2_500 <= recorder.bytes_in - recorder.bytes_passed <= 5_000
    recorder.advance(recorder.bytes_in, START + SECOND, [START + SECOND])
    recorder.close()
    part = content(tmp_path / "e-000001.pcapng")
    assert part
    assert RAW[: ENDS[1000]].endswith(part)
    assert recorder.bytes_passed + recorder.bytes_recorded == ENDS[1000]


def test_long_events_are_cut_by_size(tmp_path: Path) -> None:
    recorder = RecordingFiles(
        str(tmp_path / "e.pcapng"), INFO, window_ns=(0, 3600 * SECOND), size=5_000, keep=3
    )
    feed(recorder, step=500, triggers=[100])
    recorder.close()
    left = sorted(tmp_path.iterdir())
    assert len(left) == 3
    assert RAW.endswith(b"".join(content(path) for path in left))


def test_arrival_of_a_byte(tmp_path: Path) -> None:
    recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO)
    recorder.start(START)
    for number in range(3):
        recorder.write(bytes(10), START + number)
    assert [recorder.arrival_of(offset) for offset in (0, 9, 10, 29)] == [
        START, START, START + 1, START + 2,
    ]  # fmt: skip
    recorder.advance(15, START)
    assert [recorder.arrival_of(offset) for offset in (15, 20)] == [START + 1, START + 2]
    recorder.close()


@pytest.mark.parametrize("turns", [False, True])
def test_a_full_disk_leaves_a_good_file_and_ends_it(tmp_path: Path, turns: bool) -> None:
    resource = pytest.importorskip("resource")
    more = {"size": 100_000} if turns else {}
    recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO, **more)  # type: ignore[arg-type]
    recorder.start(START)
    bounds = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8_000, bounds[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            feed(recorder, every=300 * MS)
        full = recorder.bytes_recorded
        recorder.write(b"more", START)
        recorder.advance(recorder.bytes_in, START)
        recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, bounds)
    assert 5_000 <= full == recorder.bytes_recorded <= 8_000
    (path,) = tmp_path.iterdir()
    assert content(path) == RAW[:full]
    assert os.path.getsize(path) <= 8_000  # noqa: PTH202


@pytest.mark.skipif(not hasattr(os, "fdatasync"), reason="fdatasync is not everywhere")
def test_a_failed_sync_ends_it_and_the_rest_is_unsure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO)
    recorder.start(START)
    feed(recorder, RAW[: ENDS[500]])
    recorder.advance(recorder.bytes_in, START + 100 * SECOND)
    synced = recorder.bytes_recorded

    def fail(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", fail)
        recorder.write(b"unsure", START + 200 * SECOND)
        with pytest.raises(OSError, match="Input/output error") as caught:
            recorder.advance(recorder.bytes_in, START + 201 * SECOND)
        assert recorder.bytes_recorded == synced
    recorder.close()
    assert caught.value.filename == str(tmp_path / "run.pcapng")
    assert (recorder.bytes_recorded, recorder.bytes_unsure) == (synced, 6)
    assert recorder.bytes_in == synced + 6


# Files that are removed, replaced or renamed while they are open


def record_until(recorder: RecordingFiles, raw: bytes, until_s: int) -> None:
    """Record bytes that end with a packet, and let a second of the clock go by."""
    ns = START + until_s * SECOND
    recorder.write(raw, ns - 500 * MS)
    recorder.advance(recorder.bytes_in, ns)


FIRST, NEXT, THIRD = (
    RAW[begin:end]
    for begin, end in ((0, ENDS[300]), (ENDS[300], ENDS[600]), (ENDS[600], ENDS[900]))
)
posix = pytest.mark.skipif(sys.platform == "win32", reason="Windows lets no open file be moved")


def vanished(recorder: RecordingFiles) -> list[tuple[str, int, bool]]:
    return [
        (Path(event.path).name, event.lost, event.renamed)
        for event in recorder.events
        if event.kind == "vanished"
    ]


@posix
@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize(
    "what", ["removed", "renamed", "replaced", "folder removed", "folder renamed"]
)
def test_a_file_that_vanishes_is_told_and_another_one_goes_on(
    tmp_path: Path, what: str, force: bool
) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    path = folder / "run.pcapng"
    recorder = RecordingFiles(str(path), INFO, force=force)
    recorder.start(START)
    record_until(recorder, FIRST, 1)
    new = path
    if what == "removed":
        path.unlink()
    elif what == "renamed":
        path.rename(folder / "moved.pcapng")
    elif what == "replaced":
        (folder / "other").write_text("other")
        (folder / "other").replace(path)
        new = folder / "run-000001.pcapng"
    elif what == "folder removed":
        path.unlink()
        folder.rmdir()
    else:
        folder.rename(tmp_path / "elsewhere")
    record_until(recorder, NEXT, 3)
    record_until(recorder, THIRD, 5)
    assert recorder.file == str(new)
    recorder.close()
    renamed = "renamed" in what
    lost = 0 if renamed else len(FIRST + NEXT)
    assert vanished(recorder) == [("run.pcapng", lost, renamed)]
    assert (recorder.vanished, recorder.bytes_vanished) == (1, lost)
    assert recorder.bytes_recorded == recorder.bytes_in - lost
    assert content(new) == THIRD
    assert recorder.files_kept == [str(new)]
    if what == "replaced":
        assert path.read_text() == "other"
    if renamed:
        (old,) = {*tmp_path.rglob("*.pcapng")} - {new}
        assert content(old) == FIRST + NEXT


@posix
def test_numbered_files_go_on_with_the_next_number(tmp_path: Path) -> None:
    recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO, size=1 << 20, keep=2)
    recorder.start(START)
    record_until(recorder, FIRST, 1)
    Path(recorder.file).unlink()
    record_until(recorder, NEXT, 3)
    record_until(recorder, THIRD, 5)
    recorder.close()
    assert names(tmp_path) == ["run-000002.pcapng"]
    assert content(tmp_path / "run-000002.pcapng") == THIRD
    assert vanished(recorder) == [("run-000001.pcapng", len(FIRST + NEXT), False)]


@posix
def test_a_file_that_vanishes_in_the_last_second_is_told(tmp_path: Path) -> None:
    recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO)
    recorder.start(START)
    record_until(recorder, FIRST, 1)
    Path(recorder.file).unlink()
    recorder.close()
    assert vanished(recorder) == [("run.pcapng", len(FIRST), False)]
    assert (recorder.bytes_recorded, recorder.bytes_vanished) == (0, len(FIRST))
    assert names(tmp_path) == []


@posix
def test_what_surrounds_a_trigger_goes_on_in_a_new_file(tmp_path: Path) -> None:
    recorder = RecordingFiles(str(tmp_path / "e.pcapng"), INFO, window_ns=(0, 60 * SECOND))
    recorder.start(START)
    recorder.write(FIRST, START)
    recorder.advance(recorder.bytes_in, START, [START])
    Path(recorder.file).unlink()
    record_until(recorder, NEXT, 3)
    record_until(recorder, THIRD, 5)
    recorder.close()
    assert names(tmp_path) == ["e-000002.pcapng"]
    assert content(tmp_path / "e-000002.pcapng") == THIRD
    assert recorder.bytes_vanished == len(FIRST + NEXT)


@posix
def test_a_name_that_another_recorder_has_ends_it(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    recorder = RecordingFiles(str(path), INFO)
    recorder.start(START)
    record_until(recorder, FIRST, 1)
    path.rename(tmp_path / "moved.pcapng")
    other = RecordingFiles(str(path), INFO)
    other.start(START)
    with pytest.raises(OSError, match="another program records into it now") as caught:
        record_until(recorder, NEXT, 3)
    assert caught.value.filename == str(path)
    recorder.write(THIRD, START)
    recorder.close()
    other.close()
    assert content(tmp_path / "moved.pcapng") == FIRST + NEXT
    assert content(path) == b""
    assert names(tmp_path) == ["moved.pcapng", "run.pcapng"]
    assert recorder.bytes_recorded == len(FIRST + NEXT)


@posix
def test_a_file_system_that_does_not_know_its_files_is_not_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On some network drives a file has another number each time."""
    monkeypatch.setattr(os.path, "samestat", lambda *_: False)
    recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO, size=3_000, keep=2)
    recorder.start(START)
    feed(recorder, step=500)
    recorder.close()
    assert vanished(recorder) == []
    assert len(names(tmp_path)) == 2


# The old file that is replaced by force


def old_files(recorder: RecordingFiles) -> list[tuple[str, str]]:
    return [
        (event.kind, Path(event.path).name)
        for event in recorder.events
        if event.kind in ("restored", "set_aside")
    ]


@pytest.fixture(params=[False, True], ids=["one", "numbered"])
def forced(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[RecordingFiles, Path]:
    """Return a recorder that replaces an old file, and its path."""
    path = tmp_path / ("run-000001.pcapng" if request.param else "run.pcapng")
    path.write_text("old")
    size = 1 << 20 if request.param else None
    return RecordingFiles(str(tmp_path / "run.pcapng"), INFO, force=True, size=size), path


def test_the_old_file_is_deleted_when_bytes_are_on_the_disk(
    forced: tuple[RecordingFiles, Path],
) -> None:
    recorder, path = forced
    old = path.with_name(f"{path.name}.old")
    assert path.read_text() == "old"
    recorder.start(START)
    recorder.advance(0, START)
    recorder.advance(0, START + 5 * SECOND)  # the header is on the disk, and no byte
    assert old.read_text() == "old"
    recorder.write(FIRST, START + 6 * SECOND)
    recorder.advance(recorder.bytes_in, START + 6 * SECOND)
    recorder.advance(recorder.bytes_in, START + 7 * SECOND)
    assert names(path.parent) == [path.name]
    recorder.close()
    assert content(path) == FIRST
    assert old_files(recorder) == []


def test_bytes_of_less_than_a_second_replace_it_too(forced: tuple[RecordingFiles, Path]) -> None:
    recorder, path = forced
    recorder.start(START)
    recorder.write(FIRST, START)
    recorder.close()
    assert names(path.parent) == [path.name]
    assert content(path) == FIRST


def test_the_old_file_comes_back_when_no_byte_came(forced: tuple[RecordingFiles, Path]) -> None:
    recorder, path = forced
    recorder.start(START)
    assert names(path.parent) == [path.name, f"{path.name}.old"]
    recorder.close()
    assert names(path.parent) == [path.name]
    assert path.read_text() == "old"
    assert old_files(recorder) == [("restored", path.name)]
    assert recorder.files_kept == []


@pytest.mark.parametrize("room", [0, 1000], ids=["header", "first block"])
def test_the_old_file_comes_back_when_the_disk_is_full_at_once(
    forced: tuple[RecordingFiles, Path], room: int
) -> None:
    resource = pytest.importorskip("resource")
    recorder, path = forced
    bounds = resource.getrlimit(resource.RLIMIT_FSIZE)

    def record() -> None:
        recorder.start(START)
        feed(recorder, every=300 * MS)

    resource.setrlimit(resource.RLIMIT_FSIZE, (room, bounds[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            record()
        assert recorder.files == bool(room)
        recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, bounds)
    assert names(path.parent) == [path.name]
    assert path.read_text() == "old"


def test_both_files_stay_where_it_is_not_sure_that_the_new_one_holds_anything(
    forced: tuple[RecordingFiles, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder, path = forced
    recorder.start(START)

    def fail(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        for name in {"fsync", "fdatasync"} & set(dir(os)):
            patch.setattr(os, name, fail)
        recorder.write(FIRST, START)
        with pytest.raises(OSError, match="Input/output"):
            recorder.close()
    assert path.with_name(f"{path.name}.old").read_text() == "old"
    assert path.exists()
    assert old_files(recorder) == [("set_aside", f"{path.name}.old")]


@posix
def test_the_old_file_stays_where_the_new_one_vanishes_at_once(
    forced: tuple[RecordingFiles, Path],
) -> None:
    recorder, path = forced
    recorder.start(START)
    path.unlink()
    recorder.close()
    assert names(path.parent) == [f"{path.name}.old"]
    assert old_files(recorder) == [("set_aside", f"{path.name}.old")]


def test_an_old_file_that_was_set_aside_earlier_is_not_replaced(tmp_path: Path) -> None:
    """By a run that was killed: it may be the only copy."""
    for number in ("", "-000001"):
        path = tmp_path / f"run{number}.pcapng"
        path.write_text("new")
        old = tmp_path / f"run{number}.pcapng.old"
        old.write_text("old")
        with pytest.raises(FileExistsError, match=rf"{old.name} is there already: an earlier run"):
            RecordingFiles(
                str(tmp_path / "run.pcapng"), INFO, force=True, size=1 << 20 if number else None
            )
        assert (path.read_text(), old.read_text()) == ("new", "old")


def test_a_file_that_is_recorded_into_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    with RecordingWriter(path, INFO) as writer:
        with pytest.raises(FileExistsError, match=r"another program records into .*run\.pcapng"):
            RecordingFiles(str(path), INFO, force=True)
        writer.write(b"abc", START)
    assert content(path) == b"abc"


def test_numbered_files_that_may_not_be_replaced_are_left_out(tmp_path: Path) -> None:
    recorder = RecordingFiles(str(tmp_path / "run.pcapng"), INFO, force=True, size=1 << 20)
    (tmp_path / "run-000001.pcapng").mkdir()
    with RecordingWriter(tmp_path / "run-000002.pcapng", INFO):
        recorder.start(START)
        assert recorder.file == str(tmp_path / "run-000003.pcapng")
        recorder.close()
