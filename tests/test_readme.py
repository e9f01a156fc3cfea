"""What the README shows works as it stands there."""

import re
import sys
from pathlib import Path

import pytest

import canser
from canser.simulation.simulator import Simulator
from canser.simulation.traffic import line_noise, vehicle

README = Path(__file__).parents[1] / "README.md"


BLOCKS = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
@pytest.mark.filterwarnings("ignore:run.bin. read as serial")
@pytest.mark.filterwarnings("ignore:run.pcapng. frames with a time before 1970")
@pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are POSIX")
def test_the_lines_of_python_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, protocol in (("run.bin", "serial"), ("week.bin", "seeed")):
        Path(name).write_bytes(line_noise(canser.encode(vehicle(2), protocol)))
    files, live, recording, bus = BLOCKS
    names: dict[str, object] = {}
    exec(files, names)
    assert len(names["frames"]) > 3000  # type: ignore[arg-type]
    assert names["count"]
    # The loop that goes on for ever ends after a batch.
    live, recording = (code.replace("    ...\n", "    break\n") for code in (live, recording))
    recording = recording.replace("duration=3600", "duration=0.3")
    names["frames"] = vehicle(1)  # those of the first lines have seen noise
    for code in (recording, live, bus):
        with Simulator("seeed", vehicle(2), loop=True) as device:
            exec(code.replace("/dev/ttyUSB0", device.url), names)
    assert len(names["batch"]) >= 100  # type: ignore[arg-type]
    assert names["message"]
    assert len(canser.read("run-000001.pcapng"))


def test_the_commands_are_those_of_the_makefile() -> None:
    makefile = README.with_name("Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^\$ make (\w+)", README.read_text(encoding="utf-8"), re.MULTILINE):
        assert f"\n{target}:" in makefile
