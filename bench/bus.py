"""Print the frames a second of canser's bus against python-can's own, over pseudo terminals.

Each bus reads the same stream of `serial`, written by a process of its own, as fast as the
terminal takes it. What comes out is checked first. Bare `can.Message`s, made of what is
there already, bound what any bus of python-can can reach.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial

import can
import numpy as np
from can.interfaces.serial.serial_can import SerialBus

import canser
import data
from canser._frames import FrameArray
from canser.python_can._messages import MessageRow, to_rows
from canser.python_can.bus import CanserBus
from measure import Work, machine, paired

PROTOCOL = "serial"

# For each byte on its standard input it writes the stream once.
FEEDER = """
import os, sys
line, stream = int(sys.argv[1]), open(sys.argv[2], "rb").read()
while os.read(0, 1):
    rest = memoryview(stream)
    while rest:
        rest = rest[os.write(line, rest):]
"""

# required: over python-can's SerialBus
REQUIRED = 5


@contextmanager
def fed(stream: str) -> Iterator[tuple[str, Callable[[], None]]]:
    """Give the path of a terminal, and a function that has the stream written to it."""
    import tty  # noqa: PLC0415 - POSIX only

    master, slave = os.openpty()
    tty.setraw(slave)
    feeder = subprocess.Popen(
        [sys.executable, "-c", FEEDER, str(master), stream],
        stdin=subprocess.PIPE,
        pass_fds=[master],
    )
    assert feeder.stdin is not None
    go = feeder.stdin.fileno()
    try:
        yield os.ttyname(slave), lambda: (os.write(go, b"."), None)[1]
    finally:
        feeder.stdin.close()
        feeder.wait()
        os.close(master)
        os.close(slave)


def messages(bus: can.BusABC, feed: Callable[[], None], count: int) -> list[can.Message]:
    """Have the stream written, and receive its messages."""
    feed()
    found: list[can.Message] = []
    for _ in range(count):
        message = bus.recv(10)
        assert message is not None, f"{len(found)} messages of {count} came"
        found.append(message)
    return found


def receive(bus: can.BusABC, feed: Callable[[], None], count: int) -> None:
    """Do the same and keep none: what lists cost is not the bus's."""
    feed()
    recv = bus.recv
    for _ in range(count):
        recv(10)


def batches(bus: CanserBus, feed: Callable[[], None], count: int) -> FrameArray:
    """Have the stream written, and receive it as arrays."""
    feed()
    found: list[FrameArray] = []
    while (had := sum(map(len, found))) < count:
        found.append(bus.recv_batch(timeout=10))
        assert len(found[-1]), f"{had} frames of {count} came"
    return canser.concat(found)


def bare(arguments: list[MessageRow]) -> None:
    """Make the messages, and do nothing else."""
    message = can.Message
    for row in arguments:
        message(*row)


def is_right(message: can.Message, row: MessageRow) -> bool:
    return message.equals(can.Message(*row), timestamp_delta=0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=30_000, help="in the stream")
    parser.add_argument("--rounds", type=int, default=9, help="of each pair")
    args = parser.parse_args()
    count, rounds = args.frames, args.rounds
    frames = data.mixed(count, PROTOCOL)
    arguments = list(to_rows(frames))
    print(machine())
    with tempfile.NamedTemporaryFile() as file, ExitStack() as stack:
        file.write(canser.encode(frames, PROTOCOL))
        file.flush()
        theirs, feed_theirs = stack.enter_context(fed(file.name))
        ours, feed_ours = stack.enter_context(fed(file.name))
        # A time-out of its own, in which it gives up: none that a busy machine is late for.
        peer = stack.enter_context(SerialBus(theirs, timeout=10))
        bus = stack.enter_context(CanserBus(ours, protocol=PROTOCOL))
        assert all(map(is_right, messages(peer, feed_theirs, count), arguments)), "python-can"
        assert all(map(is_right, messages(bus, feed_ours, count), arguments)), "canser"
        assert np.array_equal(batches(bus, feed_ours, count), frames), "canser, in batches"
        by_peer = partial(receive, peer, feed_theirs, count)
        by_bus = partial(receive, bus, feed_ours, count)
        pairs: dict[str, Work] = {
            "canser, messages": by_bus,
            "canser, batches": partial(batches, bus, feed_ours, count),
            "bare can.Message": partial(bare, arguments),
        }
        print(f"{'':20} {'frames a second':>15} {'over SerialBus':>14} {'required':>9}")
        reached: dict[str, float] = {}
        for name, work in pairs.items():
            their_time, time, ratio = paired(by_peer, work, rounds)
            if not reached:
                print(f"{'SerialBus':20} {count / their_time:15,.0f}")
            reached[name] = ratio
            required = f"{REQUIRED:9}" if work is by_bus else ""
            print(f"{name:20} {count / time:15,.0f} {ratio:14.1f} {required}")
    return 0 if reached["canser, messages"] >= REQUIRED else 1


if __name__ == "__main__":
    sys.exit(main())
