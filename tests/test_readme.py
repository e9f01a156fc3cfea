"""What the README shows works as it stands there."""

import re
from pathlib import Path

import pytest

import canser
from canser.traffic import line_noise, vehicle

README = Path(__file__).parents[1] / "README.md"


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
def test_the_lines_of_python_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    for name, protocol in (("run.bin", "serial"), ("week.bin", "seeed")):
        Path(name).write_bytes(line_noise(canser.encode(vehicle(2), protocol)))
    names: dict[str, object] = {}
    exec(code, names)
    assert len(names["frames"]) > 3000  # type: ignore[arg-type]
    assert names["count"]


def test_the_commands_are_those_of_the_makefile() -> None:
    makefile = README.with_name("Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^\$ make (\w+)", README.read_text(encoding="utf-8"), re.MULTILINE):
        assert f"\n{target}:" in makefile
