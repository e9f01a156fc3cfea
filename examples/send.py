"""Send a frame ten times a second: send.py URL PROTOCOL FRAME COUNT, such as 123#DEADBEEF."""

import sys
import time

import canser

url, protocol, frame, count = sys.argv[1:]
with canser.open(url, protocol) as port:
    due = time.monotonic()
    for _ in range(int(count)):
        port.send(frame)
        due += 0.1
        time.sleep(max(0, due - time.monotonic()))
