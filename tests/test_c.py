"""What is tested in C: every short string, guard pages around all memory, the fuzz target.

Each program is built twice: optimised, and with sanitizers where the compiler has them.
"""

import os
import random
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

import canser
import vectors
from long import LONG, takes_long

HERE = Path(__file__).parent
CORE = HERE.parent / "csrc"
SOURCES = sorted(CORE.rglob("*.c"))
SHARED = [HERE / "c" / "plain.c", HERE / "c" / "drive.c"]

COMPILER = shlex.split(os.environ.get("CC") or "cc")

FAST = ["-O2", "-ffp-contract=off"]
DEBUG = ["-g", "-O1"]
SANITIZED = [*DEBUG, "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]

# The memory of tables, memory.c, comes from functions of the test.
COUNTED = ["-DCANSER_MALLOC=counted_malloc", "-DCANSER_FREE=counted_free", "-pthread"]

# Strings of each set and length: as many as take some seconds, under sanitizers too. All of them
# take more than a minute.
STRINGS = [] if LONG else ["2000"]
SHORT = "500" if LONG else "100"

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="guard pages are made with POSIX calls"),
    pytest.mark.skipif(not shutil.which(COMPILER[0]), reason=f"no C compiler {COMPILER[0]!r}"),
]


def run(*command: str | Path) -> str:
    """Run a command to its end; return what it prints, and show it where it fails."""
    done = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    assert done.returncode == 0, f"{shlex.join(map(str, command))}\n{done.stdout}"
    return done.stdout


def build(program: Path, *arguments: str | Path) -> Path:
    run(*COMPILER, "-std=c11", *arguments, "-o", program)
    return program


def build_test(folder: Path, name: str, flags: list[str], *more: str) -> Path:
    """Build a program of one file, or of all files of a folder, with `more` flags of its own."""
    own = sorted((HERE / "c" / name).glob("*.c")) or [HERE / "c" / f"{name}.c"]
    core = build_core(folder, flags)
    if COUNTED[0] in more:
        own.append(CORE / "memory.c")
        core = [path for path in core if path.name != object_of(own[-1])]
    return build(folder / name, *flags, *more, f"-I{CORE}", f"-I{HERE / 'c'}", *own, *core)


def object_of(source: Path) -> str:
    return "_".join(source.parts[-2:]) + ".o"


def build_core(folder: Path, flags: list[str]) -> list[Path]:
    """Compile what all programs share, once for all of them with the same flags.

    Of processes that test side by side one compiles, and the others wait.
    """
    session = folder.parent.parent if "PYTEST_XDIST_WORKER" in os.environ else folder.parent
    built = session / f"core{''.join(flags).replace('/', '_')}"
    building = session / f"{built.name}.new"
    while not built.exists():
        try:
            building.mkdir()
        except FileExistsError:
            time.sleep(0.05)
            continue
        try:
            for source in [] if built.exists() else [*SHARED, *SOURCES]:
                target = building / object_of(source)
                run(*COMPILER, "-std=c11", *flags, f"-I{CORE}", "-c", source, "-o", target)
            if not built.exists():
                building.rename(built)
        finally:
            shutil.rmtree(building, ignore_errors=True)  # as it is after an error
    return sorted(built.iterdir())


def assert_all_pass(output: str) -> None:
    """Assert that the closing line counts checks that passed, and none that failed."""
    closing = re.fullmatch(r"(\d+) passed, (\d+) failed", output.splitlines()[-1])
    assert closing, output
    assert int(closing[1]) > 0, output
    assert int(closing[2]) == 0, output


@pytest.fixture(scope="module")
def debug_flags(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return the sanitizers, if a program that is built with them runs, or none.

    They take four times as long to build: so only where all that takes long is run. Elsewhere
    the programs are optimised, and share what is compiled for the others.
    """
    if not LONG:
        return FAST
    folder = tmp_path_factory.mktemp("trial")
    source = folder / "trial.c"
    source.write_text("int main(void) { return 0; }\n", encoding="utf-8")
    try:
        run(build(folder / "trial", *SANITIZED, source))
    except AssertionError:
        return DEBUG
    return SANITIZED


def test_every_short_string(tmp_path: Path) -> None:
    assert_all_pass(run(build_test(tmp_path, "cases", FAST), *STRINGS))


@takes_long
def test_short_strings_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    assert_all_pass(run(build_test(tmp_path, "cases", debug_flags), SHORT))


def test_guard_pages(tmp_path: Path) -> None:
    assert_all_pass(run(build_test(tmp_path, "guard", FAST)))


@takes_long
def test_guard_pages_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    assert_all_pass(run(build_test(tmp_path, "guard", debug_flags)))


def test_lines_of_text(tmp_path: Path) -> None:
    assert_all_pass(run(build_test(tmp_path, "text", FAST), "20000" if LONG else "2000"))


@takes_long
def test_lines_of_text_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    assert_all_pass(run(build_test(tmp_path, "text", debug_flags)))


def test_objects_of_blf(tmp_path: Path) -> None:
    assert_all_pass(run(build_test(tmp_path, "blf", FAST), "50000" if LONG else "5000"))


@takes_long
def test_objects_of_blf_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    assert_all_pass(run(build_test(tmp_path, "blf", debug_flags)))


def test_signals(tmp_path: Path) -> None:
    assert_all_pass(run(build_test(tmp_path, "signals", FAST), "2000" if LONG else "200"))


@takes_long
def test_signals_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    assert_all_pass(run(build_test(tmp_path, "signals", debug_flags)))


def test_frames_by_their_ids(tmp_path: Path) -> None:
    assert_all_pass(run(build_test(tmp_path, "ids", FAST), "2000" if LONG else "200"))


@takes_long
def test_frames_by_their_ids_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    assert_all_pass(run(build_test(tmp_path, "ids", debug_flags)))


def test_frames_that_change(tmp_path: Path) -> None:
    assert_all_pass(run(build_test(tmp_path, "changes", FAST), "2000" if LONG else "200"))


@takes_long
def test_frames_that_change_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    assert_all_pass(run(build_test(tmp_path, "changes", debug_flags)))


def test_lengths_on_the_bus(tmp_path: Path) -> None:
    assert_all_pass(run(build_test(tmp_path, "bits", FAST), "1000000"))


@takes_long
def test_lengths_on_the_bus_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    assert_all_pass(run(build_test(tmp_path, "bits", debug_flags)))


def test_signals_at_other_times(tmp_path: Path) -> None:
    assert_all_pass(run(build_test(tmp_path, "resample", FAST), "100000" if LONG else "10000"))


@takes_long
def test_signals_at_other_times_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    assert_all_pass(run(build_test(tmp_path, "resample", debug_flags)))


def test_captures(tmp_path: Path) -> None:
    assert_all_pass(run(build_test(tmp_path, "pcap", FAST), "20000" if LONG else "2000"))


@takes_long
def test_captures_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    assert_all_pass(run(build_test(tmp_path, "pcap", debug_flags)))


def test_tables(tmp_path: Path) -> None:
    assert_all_pass(run(build_test(tmp_path, "arrow", FAST, *COUNTED)))


@takes_long
def test_tables_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    assert_all_pass(run(build_test(tmp_path, "arrow", debug_flags, *COUNTED)))


def test_blocks_of_recordings(tmp_path: Path) -> None:
    assert_all_pass(run(build_test(tmp_path, "recording", FAST)))


@takes_long
def test_blocks_of_recordings_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    assert_all_pass(run(build_test(tmp_path, "recording", debug_flags)))


def test_small_calls(tmp_path: Path) -> None:
    assert_all_pass(run(build_test(tmp_path, "small", FAST, "-pthread")))


@takes_long
def test_small_calls_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    assert_all_pass(run(build_test(tmp_path, "small", debug_flags, "-pthread")))


@takes_long
def test_threads_sanitized(tmp_path: Path, debug_flags: list[str]) -> None:
    if debug_flags is not SANITIZED:
        pytest.skip("the compiler has no sanitizers")
    flags = [*DEBUG, "-fsanitize=thread"]
    assert_all_pass(run(build_test(tmp_path, "small", flags, "-pthread")))
    assert_all_pass(run(build_test(tmp_path, "arrow", flags, *COUNTED)))


def test_a_protocol_of_long_packets(tmp_path: Path, debug_flags: list[str]) -> None:
    sources: list[str | Path] = [f"-I{CORE}", HERE / "c" / "long.c", *SOURCES]

    header = (CORE / "canser.h").read_text(encoding="utf-8")
    others = re.findall(r"^ +(ROW\(\w+, \d+\))", header, re.MULTILINE)
    assert len(others) == len(canser.protocols())

    def rows(longest: int) -> str:
        return f"-DCANSER_PROTOCOLS(ROW)={' '.join(others)} ROW(long40, {longest})"

    flags = debug_flags if LONG else ["-O0"]  # which builds in a third of the time
    assert_all_pass(run(build(tmp_path / "long", *flags, rows(40), *sources)))
    # A row that says less than is so does not get as far.
    with pytest.raises(AssertionError, match="how long packets are"):
        build(tmp_path / "short", "-fsyntax-only", rows(39), *sources)


@takes_long
def test_more_than_4_gib(tmp_path: Path) -> None:
    # It says so where the address space is too small.
    output = run(build_test(tmp_path, "guard", FAST), "--huge")
    if "skipped" in output:
        pytest.skip(output)
    assert_all_pass(output)


def test_fuzz_target(tmp_path: Path, debug_flags: list[str]) -> None:
    """Not a search, which is the fuzzer's work: the target builds, runs, and finds nothing."""
    chance = random.Random(1)
    names = canser.protocols()
    inputs = []
    for index, vector in enumerate(vectors.load_all()):
        for copy in range(4):
            # The options choose the protocol by their remainder; then tick and capacities.
            options = names.index(vector.protocol)
            options += len(names) * chance.randrange((256 - options) // len(names))
            pieces = chance.randbytes(chance.randrange(16))
            head = bytes([options, *chance.choices((0, 1, 7, 255), k=3), len(pieces)]) + pieces
            stream = bytearray(vector.stream * 3)
            for _ in range(copy if stream else 0):
                stream[chance.randrange(len(stream))] = chance.choice(stream)
            inputs.append(tmp_path / f"{index}-{copy}")
            inputs[-1].write_bytes(head + stream)
    program = build_test(tmp_path, "fuzz", debug_flags, "-DFUZZ_MAIN")
    assert_all_pass(run(program, *inputs))
