"""The formats of files, by the suffix of their names."""

from canser.files import candump, csv, npy

__all__ = ["BY_SUFFIX"]

# The suffix of a file's name, and the module that knows the format.
BY_SUFFIX = {".npy": npy, ".csv": csv, ".log": candump}
