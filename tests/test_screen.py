"""What a command tells while it runs: nobody may hold it up."""

import os
import sys
import threading
import warnings

import pytest

from canser.commands._screen import Lines, fit, warnings_as_lines
from canser.errors import CanserWarning


def read_all(fd: int) -> str:
    text = b""
    while piece := os.read(fd, 65536):
        text += piece
    return text.decode()


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
        lines.stand("50 %")
        assert os.read(reader, 100).decode() == f"{clear}50 %"
        lines.put("news")
        assert os.read(reader, 100).decode() == f"{clear}news\n50 %"
        lines.stand("")
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


def test_warnings_of_this_package_are_lines() -> None:
    told: list[str] = []
    with warnings.catch_warnings(record=True) as others, warnings_as_lines(told.append):
        warnings.simplefilter("always")
        for _ in range(2):
            warnings.warn("look out", CanserWarning, stacklevel=1)
        warnings.warn("old", DeprecationWarning, stacklevel=1)
    assert told == ["look out", "look out"]
    assert [str(other.message) for other in others] == ["old"]
