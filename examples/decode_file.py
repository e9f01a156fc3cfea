"""Decode a file of raw bytes, and say what was in it: decode_file.py FILE PROTOCOL."""

import sys

import canser

path, protocol = sys.argv[1:]
frames = canser.read(path, protocol)
print(f"{len(frames):,} frames")
canser.show(frames[:5])
