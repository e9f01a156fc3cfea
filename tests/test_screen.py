"""What a command tells while it runs: nobody may hold it up."""

import contextlib
import errno
import os
import sys
import threading
import time
import warnings
from pathlib import Path

import pytest

from canser.commands import _screen
from canser.commands._screen import Lines, fit, warnings_as_lines
from canser.errors import CanserWarning


def read_all(fd: int) -> str:
    text = b""
    while piece := os.read(fd, 65536):
        text += piece
    return text.decode()


def fill(pipe: int) -> None:
    """Write into a pipe until it takes no more."""
    os.set_blocking(pipe, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(pipe, bytes(4096))
    os.set_blocking(pipe, True)


@pytest.mark.parametrize(
    ("columns", "line"),
    [
        (80, "one  two  three"),
        (16, "one  two  three"),
        (15, "one two three"),
        (14, "one two three"),
        (13, "one  two"),
        (9, "one  two"),
        (8, "one two"),
        (7, "one"),
        (4, "one"),
        (3, "on"),
        (1, ""),
    ],
)
def test_parts_are_whole_or_left_out(columns: int, line: str) -> None:
    assert fit(["one", "two", "three"], columns) == line


def test_lines_come_in_order_and_all_of_them() -> None:
    reader, writer = os.pipe()
    with Lines(writer) as lines:
        for number in range(1000):
            lines.put(str(number))
    os.close(writer)
    assert read_all(reader) == "".join(f"{number}\n" for number in range(1000))
    os.close(reader)


def test_lines_go_above_what_stands() -> None:
    reader, writer = os.pipe()
    clear = "\r\x1b[K"
    with Lines(writer) as lines:
        lines.show_status("50 %")
        assert os.read(reader, 100).decode() == f"{clear}50 %"
        lines.put("news")
        assert os.read(reader, 100).decode() == f"{clear}news\n50 %"
        lines.show_status("")
        assert os.read(reader, 100).decode() == clear
        lines.put("end")
        assert os.read(reader, 100).decode() == "end\n"
    os.close(writer)
    os.close(reader)


def test_nobody_waits_for_who_does_not_read() -> None:
    reader, writer = os.pipe()
    with Lines(writer) as lines:
        # More than a pipe holds: a print would wait here for ever.
        for number in range(2000):
            lines.put(f"{number:0200}")
        started = threading.Event()
        text = []

        def read() -> None:
            started.set()
            text.append(read_all(reader))

        thread = threading.Thread(target=read)
        thread.start()
        started.wait()
    os.close(writer)
    thread.join()
    os.close(reader)
    assert text == ["".join(f"{number:0200}\n" for number in range(2000))]


@pytest.mark.skipif(sys.platform == "win32", reason="how pipes break differs there")
def test_nobody_cares_for_who_has_gone() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with Lines(writer) as lines:
        lines.put("nobody reads this")
        lines.put("nor this")
    os.close(writer)
    assert isinstance(lines.error, BrokenPipeError)
    assert not lines.unread


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_an_error_is_told_once_and_ends_the_writing() -> None:
    told: list[OSError] = []
    with open("/dev/full", "wb", buffering=0) as full, Lines(full.fileno(), told.append) as lines:  # noqa: PTH123
        for number in range(3):
            lines.put(str(number))
    assert [error.errno for error in told] == [errno.ENOSPC]
    assert lines.error is told[0]
    assert not lines.unread


def test_lines_beyond_those_that_are_kept_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_screen, "_KEPT", 100)
    reader, writer = os.pipe()
    fill(writer)
    with Lines(writer) as lines:
        lines.put("first")
        while lines._lines:  # until it is on its way
            time.sleep(0.001)
        for number in range(150):
            lines.put(str(number))
        assert lines.dropped == 50
        lines.put("last", last=True)
        assert lines.dropped == 50
        text: list[str] = []
        thread = threading.Thread(target=lambda: text.append(read_all(reader)))
        thread.start()
    os.close(writer)
    thread.join()
    os.close(reader)
    assert text[0].lstrip("\0").splitlines() == ["first", *map(str, range(50, 150)), "last"]


def test_a_slow_reader_gets_all_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that takes far less than a page of the pipe in the time of the patience."""
    monkeypatch.setattr(_screen, "PATIENCE_S", 1.0)
    reader, writer = os.pipe()
    fill(writer)
    ended = threading.Event()
    got = bytearray()

    def read() -> None:
        for _ in range(20):  # 2 s
            got.extend(os.read(reader, 10))
            ended.wait(0.1)
        got.extend(read_all(reader).encode())

    with Lines(writer) as lines:
        lines.put("end")
        thread = threading.Thread(target=read)
        thread.start()
    os.close(writer)
    thread.join()
    os.close(reader)
    assert not lines.unread
    assert got.endswith(b"end\n")


def test_the_end_does_not_wait_for_a_reader_that_takes_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_screen, "PATIENCE_S", 0.2)
    reader, writer = os.pipe()
    fill(writer)
    with Lines(writer) as lines:
        lines.put("end")
    assert lines.unread
    assert lines.error is None
    os.close(reader)  # ends the thread
    lines._thread.join()
    os.close(writer)


def test_warnings_of_this_package_are_lines() -> None:
    told: list[str] = []
    with warnings.catch_warnings(record=True) as others, warnings_as_lines(told.append):
        warnings.simplefilter("always")
        for _ in range(2):
            warnings.warn("look out", CanserWarning, stacklevel=1)
        warnings.warn("old", DeprecationWarning, stacklevel=1)
    assert told == ["look out", "look out"]
    assert [str(other.message) for other in others] == ["old"]
