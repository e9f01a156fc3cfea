"""Errors of the system say what they are about, in every command and for every kind of file."""

import errno
import io
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import canser
from canser._input import Input
from canser._named import named
from canser._output import whole_file
from canser.commands._source import opened
from canser.commands.cli import main
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter
from canser.simulation.traffic import vehicle

posix = pytest.mark.skipif(sys.platform == "win32", reason="Windows has other files and names")

GOOD, BAD_DATA, BAD_CALL = 0, 1, 2


def fail(error: OSError) -> None:
    raise error


@pytest.mark.parametrize(
    ("raised", "always", "text"),
    [
        (OSError(errno.EIO, "bad"), False, "[Errno 5] bad: 'x'"),
        (OSError(errno.EIO, "bad", "y"), False, "[Errno 5] bad: 'y'"),
        (OSError(errno.EIO, "bad", "y", None, "z"), True, "[Errno 5] bad: 'x'"),
        (OSError("all bad"), False, "x: all bad"),
        (BrokenPipeError(errno.EPIPE, "bad"), False, "[Errno 32] bad: 'x'"),
    ],
)
def test_an_error_gets_a_name(raised: OSError, always: bool, text: str) -> None:
    with pytest.raises(OSError, match="bad") as caught, named("x", always=always):
        fail(raised)
    assert caught.value is raised
    assert str(raised) == text


class Broken(io.BytesIO):
    """A file that cannot be read."""

    name = "broken.bin"

    def read1(self, _: int | None = -1) -> bytes:
        raise OSError(errno.EIO, "Input/output error")


def test_a_file_that_breaks_while_it_is_read_is_named() -> None:
    for call in (lambda: canser.read(Broken(), "seeed"), lambda: Input(Broken()).some(0)):
        with pytest.raises(OSError, match=r"Input/output error: 'broken\.bin'"):
            call()


def test_the_standard_input_has_that_name(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = Broken()
    broken.name = "<stdin>"
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(broken))
    with pytest.raises(OSError, match=r"Input/output error: 'standard input'"):
        canser.read(opened(["-"]))


@posix
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_a_disk_that_is_full_is_named_by_write_and_by_close() -> None:
    for size in (1, 1 << 20):
        with (
            pytest.raises(OSError, match=r"No space left on device: '/dev/full'"),
            whole_file("/dev/full", force=True) as file,
        ):
            file.write(bytes(size))


def test_an_error_inside_the_block_is_not_that_of_the_file(tmp_path: Path) -> None:
    with (
        pytest.raises(OSError, match="bad") as caught,
        whole_file(str(tmp_path / "x"), force=True),
    ):
        fail(OSError(errno.EIO, "bad"))
    assert caught.value.filename is None


def test_the_name_is_that_of_the_user_and_not_a_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: Path, target: Path) -> None:
        raise OSError(errno.EIO, "bad", str(self), None, str(target))

    monkeypatch.setattr(Path, "replace", refuse)
    for target in (tmp_path / "x.log", tmp_path / "missing" / "x.log"):
        with (
            pytest.raises(OSError, match=r"bad|No such") as caught,
            whole_file(str(target), force=False) as file,
        ):
            file.write(b"x")
        assert str(caught.value).endswith(f": {str(target)!r}")
    assert list(tmp_path.iterdir()) == []


# Commands


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a file of each kind; nothing writes into it."""
    made = tmp_path_factory.mktemp("files")
    raw = canser.encode(vehicle(1), "seeed")
    (made / "run.bin").write_bytes(raw)
    np.save(made / "run.npy", vehicle(1))
    info = RecordingInfo("seeed", 2_000_000, None, "ms", "/dev/x")
    with RecordingWriter(made / "run.pcapng", info) as writer:
        writer.write(raw, 1_700_000_000_000_000_000)
    (made / "folder").mkdir()
    return made


READERS = {
    "info": ["info", "NAME"],
    "dump": ["dump", "NAME", "-p", "seeed"],
    "convert": ["convert", "NAME", "out.npy", "-p", "seeed"],
    "convert from csv": ["convert", "NAME", "out.npy", "--from", "csv"],
    "recover": ["recover", "NAME", "out.pcapng"],
    "play": ["play", "NAME", "-c", "/dev/nothing", "-p", "seeed"],
    "play a log": ["play", "NAME", "-c", "/dev/nothing", "-p", "seeed", "--from", "candump"],
    "simulate": ["simulate", "-p", "seeed", "--traffic", "NAME"],
}
WRITERS = {
    "convert": ["convert", "run.bin", "NAME", "-p", "seeed", "--to", "candump", "--force"],
    "convert to raw": ["convert", "run.npy", "NAME", "-p", "seeed", "--to", "raw", "--force"],
    "recover": ["recover", "run.pcapng", "NAME", "--force"],
    "copy": ["simulate", "-p", "seeed", "--copy", "NAME", "--force"],
    "report": ["simulate", "-p", "seeed", "--report", "NAME", "--force"],
    "link": ["simulate", "-p", "seeed", "--link", "NAME"],
}
BAD_NAMES = {
    "missing": "missing/x.pcapng",
    "a file as a folder": "run.bin/x.pcapng",
    "a long name": "x" * 300 + ".pcapng",
    "a line end": "missing/new\nline.pcapng",
    "no text": "missing/\udcff.pcapng",
}


def fails(folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str],
          arguments: list[str], name: str) -> str:  # fmt: skip
    """Run a command that fails; return its one line."""
    monkeypatch.chdir(folder)
    before = sorted(os.listdir(folder))  # noqa: PTH208
    code = main([name if argument == "NAME" else argument for argument in arguments])
    out, err = capfd.readouterr()
    assert code in (BAD_DATA, BAD_CALL)
    assert out == ""
    (line,) = err.splitlines()
    assert sorted(os.listdir(folder)) == before  # noqa: PTH208
    return line


@posix
@pytest.mark.parametrize("kind", BAD_NAMES)
@pytest.mark.parametrize("command", [*READERS, *WRITERS])
def test_a_name_that_cannot_be_opened_is_in_the_message(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    command: str,
    kind: str,
) -> None:
    name = BAD_NAMES[kind]
    for arguments in (READERS.get(command), WRITERS.get(command)):
        if arguments is not None:
            line = fails(folder, monkeypatch, capfd, arguments, name)
            assert name.encode("unicode_escape").decode() in line


@posix
@pytest.mark.parametrize("command", [name for name in WRITERS if name != "link"])
def test_a_folder_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], command: str
) -> None:
    line = fails(folder, monkeypatch, capfd, WRITERS[command], "folder")
    assert line == "canser: folder: Is a directory"


@posix
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize("command", ["convert", "convert to raw", "recover"])
def test_a_device_that_is_full_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], command: str
) -> None:
    line = fails(folder, monkeypatch, capfd, WRITERS[command], "/dev/full")
    assert line == "canser: /dev/full: No space left on device"


@posix
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize(
    "arguments",
    [
        ["info", "run.bin", "-p", "seeed"],
        ["dump", "run.bin", "-p", "seeed"],
        ["convert", "run.bin", "-", "-p", "seeed"],
        ["simulate", "-p", "seeed"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_standard_output_that_is_full_is_named(folder: Path, arguments: list[str]) -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "canser", *arguments],
            cwd=folder, stdout=full, stderr=subprocess.PIPE, check=False, timeout=60,
        )  # fmt: skip
    assert done.returncode == BAD_DATA
    assert done.stderr == b"canser: standard output: No space left on device\n"


def test_no_thread_for_a_command_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def refuse(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    assert main(["send", "-c", "loop://", "-p", "seeed", "123#"]) == BAD_DATA
    assert main(["log", "-c", "loop://", "-p", "seeed", "x.pcapng"]) == BAD_DATA
    first, second = capfd.readouterr().err.splitlines()
    assert first.startswith("canser: loop://: can't start new thread; ")
    assert second.startswith("canser: can't start new thread: ")
