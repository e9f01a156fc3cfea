"""Private: the compiled module `_lib`, and its only importers.

Nothing of cffi leaves this folder but opaque pointers. Every check that C cannot make is made
here, before a byte is touched; alignment and overlap are C's.
"""
