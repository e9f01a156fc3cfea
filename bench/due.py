"""How late frames come that `canser simulate` sends when they are due.

A process of its own reads the terminal, and compares when each frame comes with the time that it
carries; beside it, in the same way, a bare loop that sleeps until each frame is due and writes it.
Run it where nothing else runs: each wake of either waits for the scheduler.
"""

import argparse
import os
import select
import sys
import time
import tty
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

import canser
from canser.simulation.simulator import Simulator
from canser.simulation.traffic import vehicle
from measure import machine

PERCENTILES = (50, 90, 99, 99.9)


def lateness_ms(fd: int, count: int) -> npt.NDArray[np.float64]:
    """Read so many frames of a terminal; return how late each was, over the earliest ones."""
    decoder = canser.Decoder("serial", ts_unit="us")
    out = np.empty(4096, canser.FRAME_DTYPE)
    due: list[int] = []
    came: list[int] = []
    while len(due) < count and select.select([fd], [], [], 10)[0]:
        data = os.read(fd, 1 << 16)
        now = time.monotonic_ns()
        _, more = decoder.feed_into(data, out)
        due += out["ts"][:more].tolist()
        came += [now] * more
    if len(due) < count:
        sys.exit(f"{len(due):,} of {count:,} frames came")
    late = (np.array(came) - np.array(due)) / 1e6
    # The two clocks differ by a constant: one frame in a hundred counts as in time.
    return np.asarray(late - np.percentile(late, 1))


def simulated(frames: canser.FrameArray) -> npt.NDArray[np.float64]:
    with Simulator("serial", frames, ts_unit="us") as device:
        return in_a_child(lambda: os.open(device.url, os.O_RDWR | os.O_NOCTTY), len(frames))


def bare(frames: canser.FrameArray) -> npt.NDArray[np.float64]:
    """Sleep until each frame is due, and write it."""
    packets = [canser.encode(one, "serial", ts_unit="us") for one in frames.reshape(-1, 1)]
    ours, theirs = os.openpty()
    first = int(frames["ts"][0])

    def send() -> None:
        begin = time.monotonic_ns()
        for packet, ts in zip(packets, frames["ts"].tolist(), strict=True):
            rest = (ts - first - (time.monotonic_ns() - begin)) / 1e9
            if rest > 0:
                time.sleep(rest)
            os.write(ours, packet)

    return in_a_child(lambda: theirs, len(frames), send)


def in_a_child(
    opened: Callable[[], int], count: int, send: Callable[[], None] | None = None
) -> npt.NDArray[np.float64]:
    """Read in a process of its own; return how late the frames were."""
    receiver, sender = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            fd = opened()
            tty.setraw(fd)
            os.write(sender, b"ready")
            late = lateness_ms(fd, count)
            with open(sender, "wb") as file:  # noqa: PTH123
                file.write(late.tobytes())
        finally:
            os._exit(0)
    os.close(sender)
    with open(receiver, "rb") as file:  # noqa: PTH123
        file.read(5)
        if send is not None:
            send()
        late = np.frombuffer(file.read())
    os.waitpid(pid, 0)
    return late


def main() -> None:
    """Print the percentiles of both, in turns."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--seconds", type=float, default=20, help="of a vehicle's traffic")
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    frames = vehicle(args.seconds)
    print(machine())
    print(f"{len(frames):,} frames in {args.seconds:g} s; ms late, of so many percent at most")
    print(f"{'':16}" + "".join(f"{share:>8g}" for share in PERCENTILES) + "    within 1 ms")
    for _ in range(args.rounds):
        for name, run in (("canser simulate", simulated), ("a bare loop", bare)):
            late = run(frames)
            row = "".join(f"{value:8.2f}" for value in np.percentile(late, PERCENTILES))
            print(f"{name:16}{row}{(late < 1).mean():15.1%}", flush=True)


if __name__ == "__main__":
    main()
