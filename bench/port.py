"""Print what a live port reaches over a pseudo terminal, beside a bare loop of os.read.

The same process feeds both, through the same terminal, in turn; all frames are counted, and none
of the bytes may be skipped. README.md, beside this file, explains the figures.
"""

import argparse
import os
import signal
import time
import tty
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from statistics import median

import numpy as np

import canser
import data
from canser._frames import FrameArray
from measure import machine, seconds

# What the line of the fastest adapters carries, in bytes a second: 2,000,000 baud, 10 bits a byte.
PACE = 200_000

# How often an adapter's bytes come, in seconds: USB hands them on every few milliseconds.
TICK = 0.005


class Feeder:
    """A process that writes bytes into a pseudo terminal when it is told to."""

    def __init__(self, raw: bytes) -> None:
        self.raw = raw
        master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.url = os.ttyname(self.slave)
        told, self._tell = os.pipe()
        self._pid = os.fork()
        if self._pid == 0:
            try:
                while order := os.read(told, 1):
                    self._write(master, paced=order == b"p")
            finally:
                os._exit(0)
        os.close(told)
        os.close(master)

    def start(self) -> None:
        """Have all bytes written as fast as they are read."""
        os.write(self._tell, b"w")

    def start_pace(self) -> None:
        """Have bytes written at the line's pace, until the feeder is closed."""
        os.write(self._tell, b"p")

    def close(self) -> None:
        """End the process."""
        os.kill(self._pid, signal.SIGKILL)
        os.waitpid(self._pid, 0)
        os.close(self._tell)
        os.close(self.slave)

    def _write(self, master: int, *, paced: bool) -> None:
        todo = memoryview(self.raw)
        if not paced:
            while todo:
                todo = todo[os.write(master, todo[: 1 << 16]) :]
            return
        begin, done = time.monotonic(), 0
        while True:
            time.sleep(TICK)
            due = int((time.monotonic() - begin) * PACE)
            while done < due:
                at = done % len(todo)
                done += os.write(master, todo[at : at + due - done])


@contextmanager
def fed(raw: bytes) -> Iterator[Feeder]:
    """Make a feeder; close it."""
    feeder = Feeder(raw)
    try:
        yield feeder
    finally:
        feeder.close()


def bare(feeder: Feeder) -> None:
    """Read all bytes, and do nothing else."""
    os.set_blocking(feeder.slave, True)
    feeder.start()
    left = len(feeder.raw)
    while left:
        left -= len(os.read(feeder.slave, 1 << 16))


def decoding(feeder: Feeder, protocol: str, out: FrameArray) -> None:
    """Read all bytes and decode them as they come: no thread, no ring, no times."""
    os.set_blocking(feeder.slave, True)
    feeder.start()
    decoder = canser.Decoder(protocol)
    while decoder.position < len(feeder.raw):
        data = memoryview(os.read(feeder.slave, 1 << 16))
        while data:
            used, _ = decoder.feed_into(data, out)
            data = data[used:]


def batches(port: canser.Port, feeder: Feeder, count: int, out: FrameArray) -> None:
    """Read all bytes as frames."""
    feeder.start()
    left = count
    while left:
        left -= len(port.read_batch(out, min_frames=min(len(out), left), timeout=60))


def ratios(protocol: str, count: int, rounds: int) -> Iterator[tuple[float, float, float]]:
    """Yield the bytes a second of a bare loop, of one that decodes, and of `read_batch`."""
    frames = data.mixed(count, protocol)
    out = np.empty(1 << 16, canser.FRAME_DTYPE)
    with fed(canser.encode(frames, protocol)) as feeder:
        bytes_in = len(feeder.raw)
        for _ in range(rounds + 1):
            alone = bytes_in / seconds(lambda: bare(feeder))
            plain = bytes_in / seconds(lambda: decoding(feeder, protocol, out))
            # Open while it is measured only: its thread would take the bytes of the bare loop.
            with canser.open(feeder.url, protocol) as port:
                mine = bytes_in / seconds(partial(batches, port, feeder, count, out))
                assert port.stats.bytes_framed == bytes_in
                assert port.stats.bytes_skipped == port.bytes_lost == 0
            yield alone, plain, mine


def load(protocol: str, span: float) -> tuple[float, float]:
    """Return the share of a core that a bare loop and `read_batch` take at the line's pace."""
    out = np.empty(1 << 16, canser.FRAME_DTYPE)
    raw = canser.encode(data.mixed(200_000, protocol), protocol)
    with fed(raw) as feeder:
        feeder.start_pace()
        begin, used = time.monotonic(), time.process_time()
        while time.monotonic() - begin < span:
            os.read(feeder.slave, 1 << 16)
        alone = (time.process_time() - used) / span
    with (
        fed(raw) as feeder,
        canser.open(feeder.url, protocol, line=canser.LineConfig(baudrate=2_000_000)) as port,
    ):
        feeder.start_pace()
        begin, used = time.monotonic(), time.process_time()
        while time.monotonic() - begin < span:
            port.read_batch(out, min_frames=len(out), timeout=0.05)
        mine = (time.process_time() - used) / span
        assert port.stats.bytes_framed > 0.9 * PACE * span
        assert port.stats.bytes_skipped == port.bytes_lost == 0
    return alone, mine


def main() -> None:
    """Measure, check, print."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--frames", type=int, default=1_000_000, help="frames a round")
    parser.add_argument("--rounds", type=int, default=9, help="rounds, of which the median counts")
    parser.add_argument("--seconds", type=float, default=5, help="how long at the line's pace")
    args = parser.parse_args()
    # The device clock runs too fast or too slowly, by as much as time is compressed.
    warnings.simplefilter("ignore", canser.CanserWarning)
    print(machine())
    print("\nread_batch over a bare os.read, bytes a second (0.9 wanted)")
    for protocol in canser.protocols():
        _, *rounds = ratios(protocol, args.frames, args.rounds)
        alone, plain, mine = (median(column) / 1e6 for column in zip(*rounds, strict=True))
        reached = median(c / a for a, _, c in rounds)
        simple = median(b / a for a, b, _ in rounds)
        print(
            f"{protocol:10} {reached:5.2f}   bare {alone:6.1f} MB/s, read_batch {mine:6.1f} MB/s; "
            f"a loop that decodes what it reads {plain:6.1f} MB/s, {simple:.2f}"
        )
    print("\nshare of a core at 2,000,000 baud, a batch every 50 ms (under 2 % wanted)")
    for protocol in canser.protocols():
        alone, mine = load(protocol, args.seconds)
        print(f"{protocol:10} {mine:6.2%}   a bare os.read {alone:6.2%}")


if __name__ == "__main__":
    main()
