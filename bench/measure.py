"""How things are measured here: two calls in turn, and the median of their ratio."""

import platform
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import numpy.typing as npt

Work = Callable[[], object]


def machine() -> str:
    """Name the CPU, its cores, the compiler and the versions."""
    cpu = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    cores = 0
    if cpuinfo.exists():
        lines = cpuinfo.read_text().splitlines()
        names = [x.split(":")[1].strip() for x in lines if x.startswith("model name")]
        cpu, cores = (names or [cpu])[0], len(names)
    try:
        run = subprocess.run(["cc", "--version"], capture_output=True, text=True, check=False)
        compiler = run.stdout.splitlines()[0]
    except (OSError, IndexError):
        compiler = "unknown compiler"
    return (
        f"{cpu}, {cores or '?'} cores; {compiler}; "
        f"Python {platform.python_version()}, numpy {np.__version__}"
    )


def seconds(work: Work) -> float:
    """Return the time of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def paired(
    first: Work, second: Work, rounds: int, before: Work | None = None
) -> tuple[float, float, float]:
    """Time two calls in turn; return the median time of each, and of the ratio first/second.

    `before` is called before each call, and not timed.
    """

    def timed(work: Work) -> float:
        if before is not None:
            before()
        return seconds(work)

    timed(first)
    timed(second)  # both are warm now
    times = [(timed(first), timed(second)) for _ in range(rounds)]
    return (
        median(a for a, _ in times),
        median(b for _, b in times),
        median(a / b for a, b in times),
    )


def copy_and_fill(
    source: npt.NDArray[np.generic], copy: npt.NDArray[np.generic], target: npt.NDArray[np.generic]
) -> None:
    """Do the work of L: copy what is read, fill what is written."""
    np.copyto(copy, source)
    target.fill(0)
