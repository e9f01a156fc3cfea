"""Print and plot the time of decoding against the size of the input: it grows linearly.

For each protocol three inputs: clean; noisy, with one byte in 1000 replaced; and hostile,
of the streams of hostile.py the one that takes longest. One piece is fed into an array
that is used again and again; what does not fit goes in as the array is emptied. The
fastest of some rounds counts, since what disturbs one only adds to it.
"""

import argparse
import math
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import canser
import data
from hostile import PATTERN, Bytes, hostile, noisy, tiled
from measure import machine

SMALLEST, LARGEST = 1 << 10, 1 << 30
OUT_FRAMES = 1 << 20

# The exponent is fitted from here on: below, the call itself is a good part of the time,
# and a processor learns by heart which branches a short stream takes.
FIT_FROM = 1 << 16

# More than this is not linear: what is left of it is memory, which is slower than a cache.
EXPONENT = 1.05

# A short stream is decoded for so many seconds in each round.
ROUND_S = 0.01


@dataclass(frozen=True)
class Growth:
    """The time of one input at each size."""

    protocol: str
    kind: str  # clean, noisy, hostile
    stream: str  # which one it is, where the kind is hostile
    sizes: list[int]
    seconds: list[float]

    @property
    def ns_per_byte(self) -> list[float]:
        return [second / size * 1e9 for size, second in zip(self.sizes, self.seconds, strict=True)]

    @property
    def exponent(self) -> float:
        """The exponent of time over size; not a number where there are too few sizes."""
        fitted = np.array(self.sizes) >= FIT_FROM
        if fitted.sum() < 2:
            return math.nan
        x, y = np.log(self.sizes)[fitted], np.log(self.seconds)[fitted]
        return float(np.polyfit(x, y, 1)[0])


def take(decoder: canser.Decoder, raw: Bytes, out: canser.FrameArray) -> None:
    """Decode all of a stream, however often the array gets full."""
    done = 0
    while done < len(raw):
        used, _ = decoder.feed_into(raw[done:], out)
        done += used


def fastest(
    protocol: str, streams: list[Bytes], out: canser.FrameArray, rounds: int
) -> list[float]:
    """Return the seconds that each stream takes when nothing disturbs it.

    The streams take turns, so that a slow minute of the machine is no slow stream.
    """
    decoder = canser.Decoder(protocol)
    best = [math.inf] * len(streams)
    for _ in range(rounds):
        for index, raw in enumerate(streams):
            spent = 0.0
            while spent < ROUND_S:
                decoder.reset()
                start = time.perf_counter()
                take(decoder, raw, out)
                seconds = time.perf_counter() - start
                spent += seconds
                best[index] = min(best[index], seconds)
            assert decoder.stats.bytes_in == len(raw), "decoding is wrong"
    return best


def inputs(protocol: str, largest: int, out: canser.FrameArray) -> Iterator[tuple[str, str, Bytes]]:
    """Yield the kind, the name and the bytes of each input, at its largest."""
    frames = data.mixed(PATTERN // 16, protocol)
    raw = np.frombuffer(canser.encode(frames, protocol), np.uint8)
    yield "clean", "", tiled(raw, largest)
    yield "noisy", "", tiled(noisy(raw, 0.001, 1), largest)
    streams = hostile(protocol, PATTERN)
    # Which one is the worst depends on the decoder: so it is asked.
    seconds = fastest(protocol, list(streams.values()), out, 3)
    worst = max(zip(seconds, streams, strict=True))[1]
    yield "hostile", worst, tiled(streams[worst], largest)


def grow(protocol: str, largest: int, rounds: int) -> Iterator[Growth]:
    """Measure one protocol at 1 KiB, 4 KiB and so on; holds three inputs of the largest size."""
    sizes = [1 << bits for bits in range(10, 63, 2) if SMALLEST <= 1 << bits <= largest]
    out = np.zeros(OUT_FRAMES, canser.FRAME_DTYPE)
    kinds = list(inputs(protocol, sizes[-1], out))
    streams = [raw[:size] for _, _, raw in kinds for size in sizes]
    seconds = fastest(protocol, streams, out, rounds)
    for index, (kind, stream, _) in enumerate(kinds):
        first = index * len(sizes)
        yield Growth(protocol, kind, stream, sizes, seconds[first : first + len(sizes)])


def size_text(size: int) -> str:
    power = (size.bit_length() - 1) // 10
    return f"{size >> 10 * power} {('B', 'KiB', 'MiB', 'GiB')[power]}"


def size_of(text: str) -> int:
    """Return the bytes of a size such as 16M, 16MiB or 16777216."""
    match = re.fullmatch(r"(\d+) ?(?:([KMG])(?:iB)?)?", text)
    size = int(match[1]) << 10 * " KMG".index(match[2] or " ") if match else 0
    if size < SMALLEST:
        raise argparse.ArgumentTypeError(f"{text!r} is no size such as 16M, of 1K or more")
    return size


def plot(growths: list[Growth], path: Path) -> None:
    """Draw the time, and the time of a byte, over the size."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - only a plot needs it
    from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator  # noqa: PLC0415

    # Clean and noisy lie one upon the other: the one is drawn thin on the other.
    styles: dict[str, dict[str, Any]] = {
        "hostile": {"color": "#b5305f", "marker": "^", "markersize": 6, "linewidth": 1.8},
        "noisy": {"color": "#f0b040", "marker": "s", "markersize": 9, "linewidth": 4.5},
        "clean": {"color": "#00558c", "marker": "o", "markersize": 4, "linewidth": 1.4},
    }
    protocols = list(dict.fromkeys(growth.protocol for growth in growths))
    sizes = growths[0].sizes
    every = [second for growth in growths for second in growth.seconds]
    figure = Figure(figsize=(13, 8.4), layout="constrained")
    axes = figure.subplots(
        2, len(protocols), sharex=True, sharey="row", squeeze=False, height_ratios=[3, 2]
    )
    for (above, below), protocol in zip(axes.T, protocols, strict=True):
        ours = [growth for growth in growths if growth.protocol == protocol]
        for growth in sorted(ours, key=lambda growth: list(styles).index(growth.kind)):
            name = f"{growth.kind}, {growth.stream}" if growth.stream else growth.kind
            label = f"{name}: {growth.exponent:.3f}"
            above.plot(sizes, growth.seconds, label=label, **styles[growth.kind])
            below.plot(sizes, growth.ns_per_byte, **styles[growth.kind])
        # Below what was measured, a line of slope one to hold it against.
        guide = min(growth.seconds[-1] / sizes[-1] for growth in ours) / 3
        line = [guide * size for size in sizes]
        above.plot(sizes, line, color="#777777", linestyle="--", label="a slope of 1")
        above.legend(
            title=protocol,
            title_fontproperties={"size": 14, "weight": "bold"},
            alignment="left",
            loc="lower left",
            bbox_to_anchor=(0, 1),
            frameon=False,
            fontsize=10,
        )
        for axis in (above, below):
            axis.set_xscale("log", base=2)
            axis.set_yscale("log")
            axis.axvspan(sizes[0] / 2, FIT_FROM, color="#f2f2f2", zorder=0)
            axis.grid(color="#dddddd", linewidth=0.7)
            axis.set_axisbelow(True)
            axis.spines[["top", "right"]].set_visible(False)
        above.set_xlim(sizes[0] / 1.5, sizes[-1] * 1.5)
        above.set_xticks(sizes[::2], [size_text(size) for size in sizes[::2]])
        above.set_ylim(min(every) / 2, max(every) * 2)
        above.yaxis.set_major_formatter(EngFormatter("s"))
        below.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        below.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        for axis in (above, below):
            axis.minorticks_off()
        below.set_xlabel("size of the input")
    axes[0, 0].set_ylabel("time of decoding")
    axes[1, 0].set_ylabel("nanoseconds per byte")
    figure.suptitle(
        "Time of decoding over the size of the input, "
        f"and its exponent from {size_text(FIT_FROM)} on",
        fontsize=16,
        fontweight="bold",
        x=0.01,
        ha="left",
    )
    figure.supxlabel(
        f"{machine()}; one thread. Grey: not in the fit, for the call itself takes a good part.",
        fontsize=9,
        color="#555555",
    )
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--largest", type=size_of, default=LARGEST, help="the largest size, such as 16M (1G)"
    )
    parser.add_argument("--rounds", type=int, default=5, help="rounds, of which the best counts")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="write the plot, as PNG")
    args = parser.parse_args()
    print(machine())
    print("nanoseconds per byte, one thread; exponent of time over size from 64 KiB on\n")
    growths: list[Growth] = []
    for protocol in canser.protocols():
        for growth in grow(protocol, args.largest, args.rounds):
            if not growths:
                head = "".join(f"{size_text(size):>8}" for size in growth.sizes)
                print(f"{'protocol':10} {'input':8}{head} {'exponent':>9}")
            row = "".join(f"{value:8.2f}" for value in growth.ns_per_byte)
            print(f"{protocol:10} {growth.kind:8}{row} {growth.exponent:9.3f}", flush=True)
            growths.append(growth)
    worst = ", ".join(f"{g.protocol} {g.stream}" for g in growths if g.stream)
    low, high = min(g.exponent for g in growths), max(g.exponent for g in growths)
    print(f"\nhostile: {worst}")
    print(f"time grows with size to the power of {low:.3f} to {high:.3f}; 1 is linear,")
    print(f"{EXPONENT} the most that is wanted")
    if args.plot:
        plot(growths, args.plot)


if __name__ == "__main__":
    main()
