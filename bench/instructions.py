"""Count the instructions of the C core, and fail where they differ from the recorded ones.

Time on a shared machine tells nothing of a few per cent; the number of instructions is
the same in every run. It depends on the compiler and the architecture, which are
recorded with it. A figure that got better fails, too, until it is recorded: else what
was won could be lost again without a sound.
"""

import argparse
import json
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import canser
import data
from hostile import hostile, noisy

HERE = Path(__file__).parent
CORE = HERE.parent / "csrc"
RECORD = HERE / "instructions.json"

COMPILER = shlex.split(os.environ.get("CC") or "cc")
FLAGS = ["-O3", "-std=c11"]  # those of the extension

FRAMES = 20_000
HOSTILE_BYTES = 200_000
TOLERANCE = 0.05


class Case(NamedTuple):
    """One figure: what is run, and what its instructions are divided by."""

    work: str
    protocol: str
    stream: str
    raw: bytes
    units: int  # frames sent, whether they are found or not; bytes where there are none
    frames: int | None  # how many must be found, where that is known

    @property
    def name(self) -> str:
        return f"{self.work} {self.protocol} {self.stream}"


def cases() -> Iterator[Case]:
    for protocol in canser.protocols():
        raw = canser.encode(data.mixed(FRAMES, protocol), protocol)
        noise = noisy(np.frombuffer(raw, np.uint8), 0.001, 1).tobytes()
        bad = hostile(protocol, HOSTILE_BYTES)["all AA"].tobytes()
        yield Case("encode", protocol, "mixed", raw, FRAMES, FRAMES)
        yield Case("decode", protocol, "mixed", raw, FRAMES, FRAMES)
        yield Case("decode", protocol, "noisy", noise, FRAMES, None)
        yield Case("decode", protocol, "hostile", bad, HOSTILE_BYTES, 0)


def run(command: list[str]) -> str:
    """Run a command to its end; return what it prints, or end with what it says."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        sys.exit(f"{command[0]} does not run: {error.strerror}")
    if done.returncode:
        sys.exit(f"{shlex.join(command)}\n{done.stderr.strip()}")
    return done.stdout


def build(program: Path) -> None:
    sources = [*sorted(CORE.rglob("*.c")), HERE / "instructions.c"]
    run([*COMPILER, *FLAGS, f"-I{CORE}", *map(str, sources), "-o", str(program)])


def count(program: Path, case: Case, folder: Path) -> float:
    """Return the instructions of a case per frame or byte."""
    stream, profile = folder / "stream", folder / "profile"
    stream.write_bytes(case.raw)
    found = run(
        [
            "valgrind",
            "--quiet",
            "--tool=callgrind",
            # From where this function is entered until it is left. A compiler may
            # give a copy of it a longer name.
            f"--toggle-collect=measured_{case.work}*",
            f"--callgrind-out-file={profile}",
            *map(str, (program, case.protocol, case.work, stream)),
        ]
    )
    if case.frames is not None and int(found) != case.frames:
        sys.exit(f"{case.name}: {int(found)} frames found, not {case.frames}")
    totals = re.search(r"^totals: (\d+)", profile.read_text(encoding="utf-8"), re.MULTILINE)
    if not totals or not int(totals[1]):
        sys.exit(f"{case.name}: callgrind has counted nothing; has the function been inlined?")
    return round(int(totals[1]) / case.units, 2)


def measure() -> dict[str, Any]:
    """Return what is recorded: the figures, and what they depend on."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        build(folder / "instructions")
        figures = {case.name: count(folder / "instructions", case, folder) for case in cases()}
    return {
        "architecture": platform.machine(),
        "compiler": run([*COMPILER, "--version"]).splitlines()[0],
        "figures": figures,
    }


def origin(figures: dict[str, Any]) -> tuple[str, str, str]:
    """Return what the figures depend on: the architecture, the compiler, its major version."""
    version: str = figures["compiler"]
    # In brackets stands whose package it is.
    major = re.search(r"(\d+)\.\d", re.sub(r"\(.*?\)", "", version))
    name = "clang" if "clang" in version else "gcc"
    return figures["architecture"], name, major[1] if major else "?"


def compare(now: dict[str, Any], recorded: dict[str, Any]) -> list[str]:
    """Print the table; return what is wrong."""
    before: dict[str, float] = recorded.get("figures", {})
    wrong = []
    print(f"{'work':7} {'protocol':10} {'stream':9} {'recorded':>9} {'now':>9} {'change':>8}")
    for name, figure in now["figures"].items():
        work, protocol, stream = name.split()
        row = f"{work:7} {protocol:10} {stream:9}"
        if name not in before:
            print(f"{row} {'-':>9} {figure:9.2f}")
            wrong.append(f"{name}: no figure is recorded; record it with --record")
            continue
        change = figure / before[name] - 1
        print(f"{row} {before[name]:9.2f} {figure:9.2f} {change:+8.1%}")
        if change > TOLERANCE:
            wrong.append(f"{name}: {change:.1%} more instructions than recorded")
        elif change < -TOLERANCE:
            wrong.append(
                f"{name}: {-change:.1%} fewer instructions than recorded; "
                "record the better figure with --record"
            )
    wrong += [f"{name}: recorded, but not measured" for name in before.keys() - now["figures"]]
    if recorded and origin(recorded) != origin(now):
        # Nothing else that could be said is worth anything.
        return [
            f"not comparable: recorded with {recorded['compiler']} on {recorded['architecture']}, "
            f"and this is {now['compiler']} on {now['architecture']}; name the compiler in CC, "
            "or record its figures with --record"
        ]
    return wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--record", action="store_true", help=f"write {RECORD.name}")
    args = parser.parse_args()
    if not shutil.which("valgrind"):
        sys.exit("valgrind is not installed; without it no instructions are counted")
    now = measure()
    recorded = json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.exists() else {}
    print(f"{now['compiler']} on {now['architecture']}")
    print(f"instructions per frame, {FRAMES:,} sent; hostile: per byte of {HOSTILE_BYTES:,}\n")
    wrong = compare(now, recorded)
    if args.record:
        RECORD.write_text(json.dumps(now, indent=4, sort_keys=True) + "\n", encoding="utf-8")
        print(f"\nrecorded in {RECORD.name}")
        return 0
    if wrong:
        print("", *wrong, sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
