"""The lock of a recording: other recorders see it, readers do not."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from canser.recording._lock import is_locked, lock
from canser.recording.header import RecordingInfo
from canser.recording.reader import Recording
from canser.recording.writer import RecordingWriter

INFO = RecordingInfo("seeed", 2_000_000, 500_000, "us", "/dev/ttyUSB0")


def test_the_lock_ends_with_the_file(tmp_path: Path) -> None:
    path = tmp_path / "x"
    assert not is_locked(path)
    with path.open("xb") as first:
        assert lock(first.fileno())
        assert is_locked(path)
        with path.open("rb") as second:
            assert not lock(second.fileno())
    assert not is_locked(path)


def test_a_recording_is_locked_while_it_is_written_and_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "run.pcapng"
    code = "import sys; from pathlib import Path; from canser.recording._lock import is_locked\n"
    code += "print(is_locked(Path(sys.argv[1])))"

    def seen_by_others() -> str:
        call = [sys.executable, "-c", code, str(path)]
        done = subprocess.run(call, check=True, capture_output=True, text=True)
        return str(done.stdout).strip()

    with RecordingWriter(path, INFO) as writer:
        writer.write(b"abc", 10**18)
        writer.sync()
        assert seen_by_others() == "True"
        with Recording(path) as recording:
            assert [bytes(piece.data) for piece in recording] == [b"abc"]
    assert seen_by_others() == "False"


@pytest.mark.skipif(sys.platform == "win32", reason="flock is POSIX")
@pytest.mark.parametrize("code", [errno.ENOLCK, errno.ENOTSUP, errno.EINVAL])
def test_a_file_system_without_locks_does_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    def flock(*_: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr("fcntl.flock", flock)
    path = tmp_path / "run.pcapng"
    RecordingWriter(path, INFO).close()
    assert not is_locked(path)


def test_a_new_file_that_another_one_locks_first_is_left_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("canser.recording.writer.lock", lambda _: False)
    path = tmp_path / "run.pcapng"
    with pytest.raises(FileExistsError, match="another program records into it") as caught:
        RecordingWriter(path, INFO)
    assert caught.value.filename == str(path)
    assert path.exists()


WINDOWS = """
import numpy, cffi, select, sys, types
sys.platform = "win32"
for name in ("termios", "fcntl", "grp", "pty", "tty"):
    sys.modules[name] = None
calls = []
import ctypes

class Kernel:
    def __init__(self, name, use_last_error):
        assert (name, use_last_error) == ("kernel32", True)

    def LockFile(self, handle, *rest):
        calls.append((handle.value, *rest))
        return len(calls) == 1

sys.modules["msvcrt"] = types.SimpleNamespace(get_osfhandle=lambda fd: 1000 + fd)
ctypes.WinDLL, ctypes.get_last_error = Kernel, lambda: {2: 33, 3: 1}[len(calls)]
from canser.recording._lock import lock
print(lock(7), lock(7), lock(7), calls[0])
"""


def test_windows_locks_a_byte_that_no_file_has() -> None:
    """By a copy of its calls; an error other than that of the lock is a system without locks."""
    call = [sys.executable, "-c", WINDOWS]
    done = subprocess.run(call, check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "True False True (1007, 0, 1073741824, 1, 0)"
