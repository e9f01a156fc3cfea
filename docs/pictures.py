"""The pictures of docs/tasks/pictures.md: drawn anew from simulated traffic for each build."""

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

import canser
from canser import plots
from canser._frames import FrameArray
from canser.simulation.traffic import line_noise, vehicle

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Pixels of a picture: as wide as a page of the documentation on a good screen.
_WIDTH: Final = 1200

_BITRATE: Final = 500_000

_TEXTS: Final = {0: "neutral", 1: "first", 2: "second", 3: "third", 4: "fourth"}


def drive() -> FrameArray:
    """Return a minute of traffic with an hour in which the recorder was off, and a lost id."""
    frames = vehicle(60, extended=False)
    first = int(frames["id"][0])
    seconds = frames["ts"] / 1e9
    kept = (frames["id"] != first) | (seconds < 20) | (seconds > 23)
    frames = frames.compress(kept & ~frames["rtr"])
    frames["ts"][frames["ts"] > 40e9] += 3_600 * 10**9
    return frames


def signals() -> dict[str, canser.Signal]:
    """Return a speed and a gear over three minutes, as `Database.decode` gives them."""
    seconds = np.arange(18_000) / 100
    speed = 60 - 55 * np.cos(seconds / 9) + 4 * np.sin(seconds * 2.1)
    ts = (seconds * 1e9).astype(np.int64)
    kept = (seconds < 70) | (seconds > 74)
    made = {
        "Speed": (speed, "km/h", None),
        "Torque": (np.gradient(speed) * 900 + 80, "Nm", None),
        "Gear": (np.clip(speed // 28 + 1, 1, 5).astype(np.int64), "", _TEXTS),
    }
    return {
        name: canser.Signal(
            name=name,
            message="Engine",
            group="Engine",
            ts=ts[kept].view("M8[ns]"),
            values=values[kept],
            unit=unit,
            choices=choices,
        )
        for name, (values, unit, choices) in made.items()
    }


def noisy_stream(folder: Path) -> Path:
    """Return a file whose line became bad in the middle."""
    raw = canser.encode(vehicle(60), "serial")
    third = len(raw) // 3
    path = folder / "run.bin"
    noise = line_noise(raw[third : 2 * third], rate=2e-3)
    path.write_bytes(raw[:third] + noise + raw[2 * third :])
    return path


def changed(frames: FrameArray) -> FrameArray:
    """Return another drive: an id is new, one is gone, one is half as fast, bits move."""
    ids = np.unique(frames["id"])
    slow = frames["id"] == ids[3]
    kept = (frames["id"] != ids[5]) & (~slow | (np.cumsum(slow) % 2 == 0))
    frames = frames.compress(kept)
    frames["id"][frames["id"] == ids[8]] = 0x7A0
    frames["data"][frames["id"] == ids[12], 5] ^= 3
    frames["data"][np.flatnonzero(frames["id"] == ids[12])[::4], 5] ^= 0x18
    return frames


def write_pictures(folder: Path) -> None:
    """Write all pictures into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    frames, other = drive(), vehicle(30, extended=False)
    busiest = f"{canser.id_stats(frames)['id'][2]:03X}"
    figures: dict[str, Figure] = {
        "overview": plots.overview(frames, _BITRATE, width=_WIDTH),
        "overview-dark": plots.overview(frames, _BITRATE, width=_WIDTH, dark=True),
        "load": plots.bus_load(frames, _BITRATE, width=_WIDTH),
        "ids": plots.ids(other, width=_WIDTH),
        "periods": plots.periods(frames, width=_WIDTH),
        "raster": plots.raster(frames, width=_WIDTH),
        "payload": plots.payload(frames, busiest, width=_WIDTH),
        "signals": plots.signals(signals(), width=_WIDTH),
        "compare": plots.compare(other, changed(other), width=_WIDTH),
    }
    with tempfile.TemporaryDirectory() as scratch:
        figures["stream"] = plots.stream(noisy_stream(Path(scratch)), "serial", width=_WIDTH)
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png")
