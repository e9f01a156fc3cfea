"""The build where something is missing: one line that says what, and how to get it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("setuptools")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="its compiler is not on the path")

ROOT = Path(__file__).parent.parent

# Runs setup.py as a Python does whose headers are not installed.
WITHOUT_HEADERS = """
import runpy, sys, sysconfig
sysconfig.get_path = lambda *_, **__: "/nowhere"
sys.argv = ["setup.py", "build_ext"]
runpy.run_path("setup.py", run_name="__main__")
"""


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """Return a folder with what the extension is made of."""
    shutil.copytree(ROOT / "csrc", tmp_path / "csrc")
    shutil.copy(ROOT / "setup.py", tmp_path)
    return tmp_path


def build(source: Path, *arguments: str, **environment: str) -> tuple[int, str, str]:
    """Run Python there; return the exit code, the last line on standard error, and all of it."""
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=source,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    return done.returncode, done.stderr.splitlines()[-1], done.stderr


@pytest.mark.parametrize("where", ["CC", "PATH"])
def test_without_a_compiler_the_build_says_so_in_a_line(source: Path, where: str) -> None:
    code, line, said = build(source, "setup.py", "build_ext", **{where: str(source / "nothing")})
    assert code == 1
    assert "Traceback" not in said
    assert line.startswith("canser: a C compiler is needed, and there is no ")
    assert ("xcode-select" if sys.platform == "darwin" else "apt install build-essential") in line


def test_without_headers_of_python_the_build_says_so_in_a_line(source: Path) -> None:
    code, line, said = build(source, "-c", WITHOUT_HEADERS)
    assert code == 1
    assert "Traceback" not in said
    assert line.startswith("canser: the headers of Python are missing (/nowhere/Python.h)")
    assert "apt install python3-dev" in line
