"""File formats for frames, one module each: what `canser convert` reads and writes.

A format has a `read(file, name, tell)` that yields arrays of FRAME_DTYPE in bounded
memory, and calls `tell` at the end with remarks on what the frames do not hold; and a
`Writer(file)` with `write(frames)` and `finish()`, which returns remarks on what the file
could not hold.
"""

from canser.formats import candump, csv, npy

__all__ = ["BY_SUFFIX", "candump", "csv", "npy"]

# The suffix of a file's name, and the module that knows the format.
BY_SUFFIX = {".npy": npy, ".csv": csv, ".log": candump}
