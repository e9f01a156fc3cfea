"""Frames as a person looks at them: `canser.show`, and tables in a notebook."""

import doctest
import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import canser
import canser._display
from canser.commands.cli import main
from reference import Frame
from samples import SECOND, array, timed


def shown(frames: canser.FrameArray) -> list[str]:
    file = io.StringIO()
    canser.show(frames, file)
    return file.getvalue().splitlines()


def test_frames_are_shown_as_dump_prints_them(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    log = "(1.500000) can0 123#DEAD\n(2.000001) can0 18FEF100#R3\n(-3.000000) can0 20000080#00\n"
    (tmp_path / "run.bin").write_bytes(
        canser.encode(canser.frames("123#DEAD", "18FEF100#R3", "001#"), "seeed")
    )
    assert main(["dump", "-p", "seeed", str(tmp_path / "run.bin")]) == 0
    dumped = capfd.readouterr().out
    canser.show(canser.read(tmp_path / "run.bin", "seeed"))
    printed = capfd.readouterr().out
    assert printed == dumped + "3 frames; a time that is not known is shown as 0\n"

    frames = canser.frames("123#DEAD", "18FEF100#R3", "20000080#00")
    frames["ts"] = [1_500_000_000, 2_000_001_000, -3_000_000_000]
    canser.show(frames)
    assert capfd.readouterr().out == f"{log}3 frames\n"


@pytest.mark.parametrize("count", [0, 1, 39, 40])
def test_up_to_forty_frames_are_all_shown(count: int) -> None:
    *lines, total = shown(timed(*(n * SECOND for n in range(count))))
    assert lines == [f"({n}.000000) can0 100#" for n in range(count)]
    assert total == ("1 frame" if count == 1 else f"{count} frames")


@pytest.mark.parametrize(("count", "left_out"), [(41, "1 frame"), (5_000, "4,960 frames")])
def test_of_more_the_first_and_the_last_are_shown(count: int, left_out: str) -> None:
    lines = shown(timed(*(n * SECOND for n in range(count))))
    every = [f"({n}.000000) can0 100#" for n in range(count)]
    assert lines == [
        *every[:20],
        f"... {left_out} left out ...",
        *every[-20:],
        f"{count:,} frames",
    ]


def test_any_strides_are_shown() -> None:
    assert shown(timed(1, 2, 3, SECOND)[::-3]) == [
        "(1.000000) can0 100#",
        "(0.000000) can0 100#",
        "2 frames",
    ]


@pytest.mark.parametrize(
    ("frames", "error", "words"),
    [
        (np.zeros(2), TypeError, "frames must be an array of canser.FRAME_DTYPE, not an array of"),
        ("123#", TypeError, "not str"),
        (np.zeros((2, 2), canser.FRAME_DTYPE), ValueError, "2 dimensions"),
        (np.ma.masked_array(np.zeros(2, canser.FRAME_DTYPE)), TypeError, "masked"),
    ],
)
def test_what_is_no_array_of_frames(frames: Any, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        canser.show(frames)


def test_the_examples_run() -> None:
    done = doctest.testmod(canser._display, extraglobs={"canser": canser})
    assert done.attempted
    assert not done.failed


# In a notebook.


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Any]:
    """Return a shell with the extension loaded, as a notebook has it."""
    pytest.importorskip("IPython", reason="IPython is not installed; canser[notebook] has it")
    from IPython.core.interactiveshell import InteractiveShell  # noqa: PLC0415
    from traitlets.config import Config  # noqa: PLC0415

    config = Config(HistoryManager={"enabled": False})
    made: Any = InteractiveShell(ipython_dir=str(tmp_path), config=config)  # type: ignore[no-untyped-call]
    made.run_line_magic("load_ext", "canser")
    yield made
    made.restore_sys_module_state()


def html(shell: Any, value: Any) -> str | None:
    bundle, _ = shell.display_formatter.format(value)
    assert bundle["text/plain"]
    found: str | None = bundle.get("text/html")
    return found


def cells(table: str | None) -> list[list[str]]:
    """Return the texts of a table, row by row."""
    assert table is not None
    return [
        re.findall(r"<t[dh][^>]*>([^<]*)</t[dh]>", row) for row in re.findall("<tr>.*?</tr>", table)
    ]


TITLES = ["", "ts (s)", "id", "flags", "dlc", "data"]


def test_frames_are_a_table(shell: Any) -> None:
    frames = array(
        Frame(0x12, dlc=2, data=b"\xde\xad".ljust(8, b"\0"), ts=1_544_106_679_432_583_000),
        Frame(0x123, ext=True, rtr=True, dlc=8, ts=-1_500_000_000),
        Frame(0x80, err=True, dlc=8, ts=canser.NO_TIME),
    )
    table = html(shell, frames)
    assert cells(table) == [
        TITLES,
        ["0", "1544106679.432583", "012", "", "2", "DE AD"],
        ["1", "-1.500000", "00000123", "ext rtr", "8", ""],
        ["2", "unknown", "080", "err", "8", "00 00 00 00 00 00 00 00"],
    ]
    assert table is not None
    assert table.endswith("<p>3 frames</p>")


def test_times_have_nine_places_where_they_have_nanoseconds(shell: Any) -> None:
    assert [row[1] for row in cells(html(shell, timed(5, -SECOND)))[1:]] == [
        "0.000000005",
        "-1.000000000",
    ]


def test_of_many_frames_the_ends_are_shown(shell: Any) -> None:
    table = html(shell, timed(*range(1_000)))
    _, *rows = cells(table)
    assert len(rows) == 41
    assert [row[0] for row in rows] == [
        *map(str, range(20)),
        "960 frames left out",
        *map(str, range(980, 1_000)),
    ]
    assert "<p>1,000 frames</p>" in (table or "")
    assert html(shell, timed()) is not None


class Framed(np.ndarray[Any, Any]):
    """An array with HTML of its own."""

    def _repr_html_(self) -> str:
        return "own"


def test_all_else_looks_as_before(shell: Any) -> None:
    frames = timed(1, 2)
    others = [
        frames["ts"],
        np.zeros((2, 2), canser.FRAME_DTYPE),
        np.ma.masked_array(frames),
        np.zeros(2, [("id", "u4")]),
        frames[0],
        "text",
    ]
    assert [html(shell, other) for other in others] == [None] * len(others)
    assert html(shell, np.zeros(2).view(Framed)) == "own"
    assert type(frames) is np.ndarray


def test_unload_and_load_again(shell: Any) -> None:
    frames = timed(1)
    shell.run_line_magic("unload_ext", "canser")
    assert html(shell, frames) is None
    shell.run_line_magic("load_ext", "canser")
    assert html(shell, frames) is not None
    shell.run_line_magic("reload_ext", "canser")
    canser.load_ipython_extension(shell)  # twice is the same as once
    canser.unload_ipython_extension(shell)
    assert html(shell, frames) is None
    canser.unload_ipython_extension(shell)


def test_another_function_for_arrays_is_kept(shell: Any) -> None:
    canser.unload_ipython_extension(shell)
    formatter = shell.display_formatter.formatters["text/html"]
    formatter.for_type(np.ndarray, lambda array: f"{array.dtype}")
    canser.load_ipython_extension(shell)
    assert html(shell, np.zeros(1)) == "float64"
    assert cells(html(shell, timed(1)))[0] == TITLES
    canser.unload_ipython_extension(shell)
    assert html(shell, np.zeros(1)) == "float64"
    canser.load_ipython_extension(shell)
    formatter.for_type(np.ndarray, lambda _: "newer")
    canser.unload_ipython_extension(shell)
    assert html(shell, timed(1)) == "newer"
