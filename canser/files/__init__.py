"""Private: files of frames and of raw bytes, one module a format. `canser` has the public names.

A format has a `read(file, name, tell)` that yields arrays of FRAME_DTYPE in bounded
memory, and calls `tell` at the end with remarks on what the frames do not hold; and a
`Writer(file)` with `write(frames)` and `finish()`, which returns remarks on what the file
could not hold.
"""
