"""The types of the public interface, as the checkers of a user's program see them.

`typed/user.py` and `typed/star.py` are right. In `typed/wrong.py` each line with a mistake has a
comment that silences it, and both checkers report a comment that silences nothing: so each of
these mistakes is found.
"""

import json
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import canser

SCRIPTS = Path(__file__).parent / "typed"

# The scripts use python-can's messages, too.
pytestmark = pytest.mark.skipif(
    find_spec("can") is None, reason="python-can is not installed; canser[test] has it"
)


def run(folder: Path, *arguments: str) -> None:
    """Run a checker on copies of the scripts: nothing of this project's settings holds there."""
    if find_spec(arguments[0]) is None:
        pytest.skip(f"{arguments[0]} is not installed; canser[lint] has it")
    for script in SCRIPTS.glob("*.py"):
        shutil.copy(script, folder)
    # The package that the tests run with, as one that is installed: it counts by its py.typed.
    environment = os.environ | {"PYTHONPATH": str(Path(canser.__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


def test_mypy(tmp_path: Path) -> None:
    run(tmp_path, "mypy", "--strict", "--config-file=", "--no-error-summary", ".")


def test_pyright(tmp_path: Path) -> None:
    settings = {
        "typeCheckingMode": "standard",
        "enableTypeIgnoreComments": False,  # those are for mypy
        "reportUnnecessaryTypeIgnoreComment": "error",
    }
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    run(tmp_path, "basedpyright", "--pythonpath", sys.executable)
