"""Plot one byte of an id over time: plot_byte.py FILE ID BYTE OUT.png. Needs matplotlib."""

import sys

import matplotlib.pyplot as plt

import canser

path, arbitration_id, place, out = sys.argv[1:]
frames = canser.read(path)
frames = frames.compress(canser.match(frames, arbitration_id))
seconds = (frames["ts"] - frames["ts"][0]) / 1e9
figure, axes = plt.subplots(figsize=(9, 3), layout="constrained")
axes.plot(seconds, frames["data"][:, int(place)], drawstyle="steps-post", linewidth=1)
axes.set(xlabel="time, s", ylabel=f"byte {place}", title=f"id {arbitration_id}")
figure.savefig(out, dpi=150)
