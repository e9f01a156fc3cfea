"""What the README shows works as it stands there."""

import re
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import canser
from canser.files.formats import BUILT_IN
from canser.simulation.simulator import Simulator
from canser.simulation.traffic import line_noise, vehicle

README = Path(__file__).parents[1] / "README.md"


BLOCKS = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are POSIX")
def test_the_lines_of_python_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(README.with_name("examples") / "car.dbc", tmp_path)
    Path("run.bin").write_bytes(line_noise(canser.encode(vehicle(2), "serial")))
    files, statistics, signals, live, bus = BLOCKS
    names: dict[str, object] = {}
    exec(files, names)
    assert len(names["frames"]) == 1  # type: ignore[arg-type]
    assert Path("run.csv").exists()
    if find_spec("pandas") is None:
        statistics = re.sub("^df = .*$", "", statistics, flags=re.MULTILINE)
    exec(statistics, names)
    assert len(names["stats"])  # type: ignore[arg-type]
    exec(signals, names)
    assert len(names["rpm"])  # type: ignore[arg-type]
    # The loop that goes on for ever ends after a batch.
    for code in (live.replace("    ...\n", "    break\n"), bus):
        with Simulator("seeed", vehicle(2), loop=True) as device:
            exec(code.replace("/dev/ttyUSB0", device.url), names)
    assert names["message"]
    assert len(canser.read("run-000001.pcapng"))


def test_the_commands_are_those_of_the_makefile() -> None:
    makefile = README.with_name("Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^\$ make (\w+)", README.read_text(encoding="utf-8"), re.MULTILINE):
        assert f"\n{target}:" in makefile


def test_the_tables_are_complete() -> None:
    text = README.read_text(encoding="utf-8")
    for name in (*canser.protocols(), *BUILT_IN):
        assert f"\n| `{name}` |" in text, f"README has no row for {name}"
