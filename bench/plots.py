"""Print the seconds that each picture of 10 M frames takes, in memory, to a PNG of 1,200 pixels.

A picture may take 2 s of a processor: on a machine that does nothing else that is its time. The
first picture of a process takes some 0.5 s more: matplotlib is loaded.
"""

import argparse
import io
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np

import canser
from canser import plots
from canser._frames import FrameArray
from canser.simulation.traffic import vehicle

# What a picture may take.
_MOST_S: Final = 2.0


def long_drive(count: int) -> FrameArray:
    """Return a minute of traffic, over and over."""
    minute = vehicle(60, extended=False)
    frames = np.empty(count, canser.FRAME_DTYPE)
    for first in range(0, count, len(minute)):
        part = frames[first : first + len(minute)]
        part[:] = minute[: len(part)]
        part["ts"] += first // len(minute) * 60_000_000_000
    return frames


def signals_of(frames: FrameArray) -> dict[str, canser.Signal]:
    """Return a signal that has a sample for each frame."""
    signal = canser.Signal(
        name="Value",
        message="All",
        group="All",
        ts=np.ascontiguousarray(frames["ts"]).view("M8[ns]"),
        values=frames["data"][:, 0].astype(np.float64),
    )
    return {"Value": signal}


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    frames = long_drive(args.frames)
    one_id = frames.copy()
    one_id["id"] = 0x123
    signals = signals_of(frames)
    name = f"{canser.id_stats(frames[:100_000])['id'][0]:03X}"
    half = len(frames) // 2
    pictures: dict[str, Callable[[], Any]] = {
        "bus load": lambda: plots.bus_load(frames, 500_000),
        "ids": lambda: plots.ids(frames),
        "periods": lambda: plots.periods(frames),
        "raster": lambda: plots.raster(frames),
        "payload of an id": lambda: plots.payload(frames, name),
        "payload, one id in all": lambda: plots.payload(one_id, "123"),
        "a signal with all samples": lambda: plots.signals(signals),
        "two halves compared": lambda: plots.compare(frames[:half], frames[half:]),
        "overview": lambda: plots.overview(frames, 500_000),
    }
    plots.raster(frames[:1000]).savefig(io.BytesIO())
    print(
        f"{args.frames:,} frames; medians of {args.rounds} rounds: seconds of a processor, and of "
        "the clock"
    )
    for what, draw in pictures.items():
        seconds = []
        for _ in range(args.rounds):
            begin = time.process_time(), time.perf_counter()
            draw().savefig(io.BytesIO())
            seconds.append((time.process_time() - begin[0], time.perf_counter() - begin[1]))
        processor, clock = np.median(seconds, axis=0).tolist()
        mark = "" if processor <= _MOST_S else f"  over {_MOST_S:g} s"
        print(f"{what:28} {processor:6.2f} {clock:6.2f}{mark}", flush=True)


if __name__ == "__main__":
    main()
