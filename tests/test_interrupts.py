"""The tests themselves, started where signals are ignored: their children have the defaults."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="ignored signals are POSIX's")

# The tests as a script or nohup starts them, what they do with SIGHUP, and a child of theirs.
STARTED = """
import os, signal, subprocess, sys
for name in sys.argv[2:]:
    signal.signal(getattr(signal, name), signal.SIG_IGN)
import conftest
os.kill(os.getpid(), signal.SIGHUP)
try:
    os.kill(os.getpid(), signal.SIGINT)
except KeyboardInterrupt:
    print("interrupted", flush=True)
subprocess.run([sys.executable, "-c", sys.argv[1]], check=True)
"""

CHILD = """
import signal
print(*(n.name for n in signal.valid_signals() if signal.getsignal(n) is signal.SIG_IGN))
"""


def test_children_of_tests_start_with_default_signals() -> None:
    ignored = ("SIGINT", "SIGHUP", "SIGQUIT", "SIGTERM")
    done = subprocess.run(
        [sys.executable, "-c", STARTED, CHILD, *ignored],
        cwd=Path(__file__).parent,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parent / "helpers")},
        capture_output=True,
        text=True,
        check=True,
    )
    interrupted, names = done.stdout.splitlines()
    assert interrupted == "interrupted"
    assert not {*ignored} & {*names.split()}
    assert {*names.split()} <= {"SIGPIPE", "SIGXFSZ"}
