"""The pages of docs/: their Python runs, and their commands are ones that exist."""

import re
import shlex
import shutil
import sys
import warnings
from pathlib import Path

import pytest

import canser
from canser.commands import COMMANDS
from canser.commands.cli import parser
from canser.simulation.simulator import Simulator
from canser.simulation.traffic import vehicle

DOCS = Path(__file__).parents[1] / "docs"
PAGES = {
    path.relative_to(DOCS).as_posix(): path.read_text(encoding="utf-8")
    for path in sorted(DOCS.rglob("*.md"))
    if "generated" not in path.parts
}


# Packages of which the examples of a page are left out where they are not installed.
PACKAGES = ("cantools", "duckdb", "matplotlib", "pandas", "polars", "pyarrow", "xarray")


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGES[page], re.DOTALL | re.MULTILINE)


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
@pytest.mark.filterwarnings("ignore:run.bin. read as serial", "ignore:run.(asc|blf)|tuesday.asc")
@pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are POSIX")
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")])
def test_the_python_of_a_page_runs(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(DOCS.parent / "examples" / "car.dbc", ".")
    Path("run.bin").write_bytes(canser.encode(vehicle(2), "serial"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what these formats cannot hold
        for name in ("run.asc", "run.blf", "run.csv", "monday.log", "tuesday.asc", "two-buses.log"):
            frames = vehicle(1)
            if name.startswith("run.") and name != "run.csv":
                frames["ts"] += 1_767_225_600 * 10**9
            canser.write(frames, name)
    names: dict[str, object] = {}
    ran = 0
    with Simulator("seeed", vehicle(2), loop=True) as adapter:
        for code in blocks(page, "python"):
            try:
                exec(code.replace("/dev/ttyUSB0", adapter.url), names)
            except ModuleNotFoundError as missing:
                if missing.name not in PACKAGES:
                    raise
            else:
                ran += 1
    assert ran


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "console")])
def test_the_commands_of_a_page_exist(page: str) -> None:
    whole = parser(COMMANDS)
    for block in blocks(page, "console"):
        for line in re.findall(r"^\$ canser (.*)$", block, re.MULTILINE):
            arguments = shlex.split(line.split("|")[0].removesuffix("&"), comments=True)
            if arguments[0].startswith("-"):
                continue
            assert whole.parse_args(arguments).run


def test_every_page_is_in_the_table_of_contents() -> None:
    listed = set(re.findall(r"^([a-z]+(?:/[a-z-]+)?)$", PAGES["index.md"], re.MULTILINE))
    assert listed == {page.removesuffix(".md") for page in PAGES} - {"index"}
