"""Print how many frames come each second: live_loop.py URL PROTOCOL SECONDS."""

import sys
import time

import canser

url, protocol, seconds = sys.argv[1:]
with canser.open(url, protocol) as port:
    end = time.monotonic() + float(seconds)
    second, count = time.monotonic() + 1, 0
    while time.monotonic() < end:
        count += len(port.read_batch(timeout=0.1))
        if time.monotonic() >= second:
            print(f"{count:,} frames")
            second, count = second + 1, 0
    print(f"{port.stats.bytes_skipped:,} bytes were in no packet")
