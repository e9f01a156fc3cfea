"""How near host times are to the truth where the device has a clock, and how much is chance.

Lines, hosts and clocks are simulated (lines.py), so that the truth is known: when each frame was on
the bus. The second figure is of the same stream without every tenth frame: by how much the times of
the others move. No estimate by which frames came earliest can be steadier than that.
"""

import argparse

import numpy as np

from lines import BYTE_NS, EPOCH, MS, US, Stream, Times, bus, send, ticks, timed

FAST_NS = 1e10 / 2_000_000
PPM = 20  # by which the device's clock is fast

# Of a vehicle, a frame every so many milliseconds for each identifier.
PERIODS = (10, 10, 10, 20, 20, 50, 100, 100, 200, 500, 1000)


def vehicle(seconds: float) -> Times:
    """Return the times of frames that are sent by period."""
    phases = np.random.default_rng(4).integers(0, 10 * MS, len(PERIODS))
    each = [
        EPOCH + phase + np.arange(0, seconds * 1e9, period * MS).astype(np.int64)
        for phase, period in zip(phases, PERIODS, strict=True)
    ]
    return np.sort(np.concatenate(each))


def lines(seconds: float) -> dict[str, tuple[Times, float]]:
    """Return the times of frames on each line, and how long it takes for a byte."""
    return {
        "115,200 baud, 5 frames/s": (bus(2, seconds, 5), BYTE_NS),
        "115,200 baud, 100 frames/s": (bus(2, seconds, 100), BYTE_NS),
        "115,200 baud, 450 frames/s": (bus(2, seconds, 450), BYTE_NS),
        "115,200 baud, by period": (vehicle(seconds), BYTE_NS),
        "2,000,000 baud, 2,000 frames/s": (bus(3, min(seconds, 120), 2000), FAST_NS),
        "2,000,000 baud, by period": (vehicle(seconds), FAST_NS),
    }


def p99_us(differences: Times) -> int:
    return round(float(np.percentile(np.abs(differences), 99)) / US)


def measure(stream: Stream, unit: str, byte_ns: float) -> tuple[int, int, int]:
    """Return the median error, the 99th percentile, and by how much times move, in microseconds."""
    device = ticks(stream.truth, unit, PPM)
    times, _ = timed(stream, device, byte_ns=byte_ns)
    error = np.abs(times - stream.truth)
    kept = np.arange(len(times)) % 10 != 9
    fewer = stream.without(~kept)
    moved = timed(fewer, device[kept], byte_ns=byte_ns)[0] - times[kept]
    return round(float(np.median(error)) / US), p99_us(error), p99_us(moved)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=300, help="of each line")
    args = parser.parse_args()
    print(
        "host times, in microseconds: error at the median and the 99th percentile; by how much they"
    )
    print("move without every tenth frame, at the 99th percentile")
    print(f"{'':44s}{'ticks of 1 ms':>20s}{'ticks of 1 us':>20s}")
    for name, (truth, byte_ns) in lines(args.seconds).items():
        for latency in (1, 4, 16):
            stream = send(truth, byte_ns=byte_ns, latency=latency * MS)
            cells = "".join(
                f"{median:8,d}{most:6,d}{moved:6,d}"
                for median, most, moved in (measure(stream, unit, byte_ns) for unit in ("ms", "us"))
            )
            print(f"{f'{name}, {latency} ms reads':44s}{cells}")


if __name__ == "__main__":
    main()
