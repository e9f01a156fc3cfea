"""Plot signals of a port while they come: live_signals.py URL PROTOCOL DB SECONDS SIGNAL..."""

import sys
import time

import matplotlib.pyplot as plt
import numpy as np

import canser

WIDTH = 10.0  # seconds in the plot

url, protocol, path, seconds, *names = sys.argv[1:]
decoder = canser.Database(path).decoder(names)
figure, axes = plt.subplots(len(names), sharex=True, squeeze=False, layout="constrained")
lines = [each.plot([], [], drawstyle="steps-post", linewidth=1)[0] for each in axes.flat]

with canser.open(url, protocol) as port:
    begin, end = np.datetime64(time.time_ns(), "ns"), time.monotonic() + float(seconds)
    for batch in port.batches(timeout=0.1):
        signals = decoder.feed(batch)
        for name, line, axis in zip(names, lines, axes.flat, strict=True):
            x = np.append(line.get_xdata(), (signals[name].ts - begin) / np.timedelta64(1, "s"))
            y = np.append(line.get_ydata(), signals[name].values)
            recent = x > x.max(initial=0) - WIDTH
            line.set_data(x[recent], y[recent])
            axis.set_ylabel(f"{name}, {signals[name].unit}")
            axis.relim()
            axis.autoscale_view()
        plt.pause(0.01)  # draws
        if time.monotonic() > end or not plt.fignum_exists(figure.number):
            break
print(decoder.report)
