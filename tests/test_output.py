"""Files that appear whole or not at all, and what is written in place."""

import os
import stat
import sys
import threading
from pathlib import Path

import pytest

from canser._output import whole_file
from canser.errors import OutputExistsError

posix = pytest.mark.skipif(sys.platform == "win32", reason="Windows has other files and names")


class SomeError(Exception):
    """What goes wrong in the middle of a file."""


def write(path: Path | str, *, force: bool = False) -> None:
    with whole_file(str(path), force=force) as file:
        file.write(b"new")


def write_half(path: Path, *, force: bool = False, error: type[BaseException] = SomeError) -> None:
    with whole_file(str(path), force=force) as file:
        file.write(b"half")
        file.flush()
        raise error


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_gets_its_name_when_it_is_whole(tmp_path: Path) -> None:
    target = tmp_path / "x.log"
    with whole_file(str(target), force=False) as file:
        file.write(b"new")
        assert not target.exists()
    assert target.read_bytes() == b"new"
    assert names(tmp_path) == ["x.log"]


@pytest.mark.parametrize("error", [SomeError, KeyboardInterrupt, SystemExit, GeneratorExit])
def test_after_an_error_nothing_is_left(tmp_path: Path, error: type[BaseException]) -> None:
    with pytest.raises(error):
        write_half(tmp_path / "x.log", error=error)
    assert names(tmp_path) == []


def test_a_file_that_is_there_stays(tmp_path: Path) -> None:
    target = tmp_path / "x.log"
    target.write_bytes(b"old")
    with pytest.raises(OutputExistsError, match=r"x\.log is there already; --force replaces it"):
        write(target)
    assert target.read_bytes() == b"old"
    assert names(tmp_path) == ["x.log"]


def test_a_file_that_comes_up_meanwhile_stays(tmp_path: Path) -> None:
    target = tmp_path / "x.log"
    with pytest.raises(OutputExistsError), whole_file(str(target), force=False):
        target.write_bytes(b"of another")
    assert target.read_bytes() == b"of another"
    assert names(tmp_path) == ["x.log"]


def test_force_replaces(tmp_path: Path) -> None:
    target = tmp_path / "x.log"
    target.write_bytes(b"old")
    write(target, force=True)
    assert target.read_bytes() == b"new"
    assert names(tmp_path) == ["x.log"]


def test_after_an_error_force_has_replaced_nothing(tmp_path: Path) -> None:
    target = tmp_path / "x.log"
    target.write_bytes(b"old")
    with pytest.raises(SomeError):
        write_half(target, force=True)
    assert target.read_bytes() == b"old"
    assert names(tmp_path) == ["x.log"]


def test_two_at_once_do_not_disturb_each_other(tmp_path: Path) -> None:
    """Two threads, or two containers, where every process has the same number."""
    target = tmp_path / "x.log"
    with whole_file(str(target), force=True) as outer:
        outer.write(b"outer")
        with whole_file(str(target), force=True) as inner:
            inner.write(b"inner")
        assert target.read_bytes() == b"inner"
    assert target.read_bytes() == b"outer"
    assert names(tmp_path) == ["x.log"]


@posix
def test_a_name_may_be_as_long_as_the_file_system_has_it(tmp_path: Path) -> None:
    target = tmp_path / ("x" * 251 + ".log")
    target.write_bytes(b"old")
    write(target, force=True)
    assert target.read_bytes() == b"new"


def test_a_folder_that_is_missing_is_named_as_it_was_given(tmp_path: Path) -> None:
    target = tmp_path / "missing" / "x.log"
    with pytest.raises(FileNotFoundError) as error:
        write(target)
    assert error.value.filename == str(target)


def test_a_folder_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises((IsADirectoryError, PermissionError)):
        write(tmp_path, force=True)


def test_a_dash_is_the_standard_output(capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    write("-")
    assert capfdbinary.readouterr().out == b"new"


@posix
@pytest.mark.parametrize("umask", [0o022, 0o077, 0o002])
def test_permissions_follow_the_umask(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        write(tmp_path / "x.log")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "x.log").stat().st_mode) == 0o666 & ~umask


@posix
def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    target, link = tmp_path / "folder" / "x.log", tmp_path / "link.log"
    target.write_bytes(b"old")
    link.symlink_to(target)
    with pytest.raises(SomeError):
        write_half(link, force=True)
    assert target.read_bytes() == b"old"
    write(link, force=True)
    assert link.is_symlink()
    assert target.read_bytes() == b"new"
    assert names(tmp_path / "folder") == ["x.log"]


@posix
def test_a_link_to_what_is_not_there_yet_makes_it(tmp_path: Path) -> None:
    target, link = tmp_path / "x.log", tmp_path / "link.log"
    link.symlink_to(target)
    write(link)
    assert link.is_symlink()
    assert target.read_bytes() == b"new"


@posix
def test_a_named_pipe_is_written_in_place(tmp_path: Path) -> None:
    fifo = tmp_path / "x.log"
    os.mkfifo(fifo)
    got: list[bytes] = []
    reader = threading.Thread(target=lambda: got.append(fifo.read_bytes()), daemon=True)
    reader.start()
    write(fifo)
    reader.join(timeout=10)
    assert got == [b"new"]
    assert stat.S_ISFIFO(fifo.stat().st_mode)
    assert names(tmp_path) == ["x.log"]


@posix
def test_a_device_is_written_in_place() -> None:
    write(os.devnull)
    assert stat.S_ISCHR(Path(os.devnull).stat().st_mode)


@posix
@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="there is no /dev/fd here")
def test_a_pipe_that_a_shell_hands_on_is_written_in_place() -> None:
    """As in `canser convert run.bin >(gzip > run.log.gz)`, and as /dev/stdout is."""
    reading, writing = os.pipe()
    try:
        write(f"/dev/fd/{writing}")
        assert os.read(reading, 100) == b"new"
    finally:
        os.close(reading)
        os.close(writing)


@pytest.mark.skipif(sys.platform == "win32", reason="permissions of POSIX")
def test_a_file_that_is_replaced_keeps_its_permissions(tmp_path: Path) -> None:
    target = tmp_path / "x.log"
    target.write_bytes(b"old")
    target.chmod(0o600)
    with whole_file(str(target), force=True) as file:
        file.write(b"new")
    assert target.read_bytes() == b"new"
    assert target.stat().st_mode & 0o777 == 0o600
