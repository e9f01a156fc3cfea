"""An hour of a line at 2,000,000 baud, compressed in time: nothing may be lost.

A virtual adapter, a process of its own, sends the bytes of that hour through a pseudo terminal;
they are read, decoded, and recorded beside that, in a rotation of files. Every frame is compared
with what was sent, the last files are read back, and memory and descriptors must stay what
they were after the first minutes. Ends with exit code 1 where anything is wrong.
"""

import argparse
import os
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt

import canser
import data
from canser._frames import FrameArray
from canser.simulation.simulator import Simulator
from canser.simulation.traffic import vehicle
from measure import machine

# Bytes a second at 2,000,000 baud, 10 bits a byte.
PACE = 200_000

# Frames at a time, files by turns, and how many of those stay.
ROOM = 1 << 16
FILE_SIZE = 50_000_000
KEEP = 3

# Minutes of the line after which memory and descriptors are what they shall stay.
WARM = 6
MEMORY_SLACK = 4 << 20


@contextmanager
def adapter(protocol: str, traffic: FrameArray, baudrate: int) -> Iterator[str]:
    """Run a virtual adapter that sends its traffic over and over; give its URL."""
    told, tell = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            with Simulator(protocol, traffic, loop=True, pace="line", baudrate=baudrate) as device:
                os.write(tell, device.url.encode())
                signal.pause()
        finally:
            os._exit(0)
    os.close(tell)
    try:
        yield os.read(told, 1000).decode()
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        os.close(told)


def content(frames: FrameArray) -> npt.NDArray[np.uint64]:
    """Return frames as rows of two words: all but the time."""
    return frames.view(np.uint64).reshape(-1, 3)[:, :2]


def is_next(frames: FrameArray, at: int, sent: npt.NDArray[np.uint64]) -> bool:
    """Return whether these are the frames that were sent, from the `at`th on, round by round."""
    rows = content(frames)
    places = (at + np.arange(len(rows))) % len(sent)
    return np.array_equal(rows, sent[places])


def resident() -> int:
    """Return the bytes of memory that this process holds."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize()


def descriptors() -> int:
    """Return how many files this process has open."""
    return len(list(Path("/proc/self/fd").iterdir()))


def soak(protocol: str, hours: float, times: int, folder: Path) -> list[str]:
    """Send, read, compare, record; return what is wrong."""
    traffic = vehicle(120, extended=data.has_extended(protocol))
    sent = content(canser.decode(canser.encode(traffic, protocol), protocol))
    todo = int(hours * 3600 * PACE)
    wrong = []
    count, minutes, settled = 0, 0, (0, 0)
    out = np.empty(ROOM, canser.FRAME_DTYPE)
    with (
        adapter(protocol, traffic, 2_000_000 * times) as url,
        canser.open(url, protocol, line=canser.LineConfig(baudrate=2_000_000)) as port,
        port.record(str(folder / "run.pcapng"), size=FILE_SIZE, keep=KEEP) as recorder,
    ):
        begin = time.monotonic()
        while port.decoder.position < todo:
            frames = port.read_batch(out, min_frames=ROOM // 2, timeout=30)
            if not len(frames):
                return [f"{protocol}: nothing came for 30 s"]
            if lost := port.bytes_lost + recorder.status.bytes_lost:
                return [f"{protocol}: {lost:,} bytes came too fast; lower --times"]
            if not is_next(frames, count, sent):
                return [f"{protocol}: frame {count:,} or one of the next is not what was sent"]
            count += len(frames)
            if port.decoder.position >= (minutes + 1) * 60 * PACE:
                minutes += 1
                now = resident(), descriptors()
                settled = now if minutes == min(WARM, int(hours * 60)) else settled
                if minutes % 10 == 0:
                    print(f"{minutes:4} min: {now[0] >> 20} MiB, {now[1]} descriptors", flush=True)
                if minutes > WARM and now[0] > settled[0] + MEMORY_SLACK:
                    wrong.append(f"{protocol}: memory grew to {now[0]:,} from {settled[0]:,} bytes")
                    settled = now
                if minutes > WARM and now[1] != settled[1]:
                    wrong.append(f"{protocol}: {now[1]} descriptors, not {settled[1]}")
                    settled = now
        took = time.monotonic() - begin
        stats = port.stats
        if stats.bytes_skipped or port.take_gaps():
            wrong.append(f"{protocol}: {stats.bytes_skipped:,} bytes skipped")
    # The recording ends somewhere, mostly within a packet: the end of the file is the end of the
    # stream, and in cantalope part of a packet may hold a shorter one.
    recorded = recorder.status
    at = recorded.stats.frames % len(traffic)
    cut = canser.encode(traffic[at : at + 1], protocol)[: recorded.stats.pending]
    end = content(canser.decode(cut, protocol))
    kept = min(KEEP, recorded.files)
    wrong += [
        f"{protocol}: {line}"
        for line in check_files(folder, kept, recorded.stats.frames, sent, end)
    ]
    print(
        f"{protocol}: {count:,} frames, {stats.bytes_in:,} bytes, all as sent; "
        f"{hours:g} h of the line in {took:.0f} s; {recorded.files} files"
    )
    return wrong


def check_files(
    folder: Path,
    kept: int,
    count: int,
    sent: npt.NDArray[np.uint64],
    end: npt.NDArray[np.uint64],
) -> list[str]:
    """Read the last files: they must hold the last frames, then those of `end`, nothing else."""
    files = sorted(folder.glob("*.pcapng"))
    found = [canser.concat(canser.blocks(file)) for file in files]
    last = content(found[-1])
    if not np.array_equal(last[len(last) - len(end) :], end):
        return [f"{files[-1].name} does not end as the stream did"]
    found[-1] = found[-1][: len(last) - len(end)]
    at = count - sum(map(len, found))
    wrong = [] if len(files) == kept else [f"{len(files)} files are there, not {kept}"]
    for file, frames in zip(files, found, strict=True):
        if not is_next(frames, at, sent):
            wrong.append(f"{file.name} does not hold what was sent")
        at += len(frames)
    return wrong


def main() -> None:
    """Soak, for each protocol that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--hours", type=float, default=1, help="of the line, for each protocol")
    parser.add_argument("--times", type=int, default=50, help="as fast as the line goes")
    parser.add_argument("protocols", nargs="*", default=canser.protocols())
    args = parser.parse_args()
    # The device clock runs as many times too fast as time is compressed.
    warnings.simplefilter("ignore", canser.CanserWarning)
    print(machine())
    wrong = []
    for protocol in args.protocols:
        with tempfile.TemporaryDirectory() as folder:
            wrong += soak(protocol, args.hours, args.times, Path(folder))
    for line in wrong:
        print(line)
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
