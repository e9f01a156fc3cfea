"""A lock that keeps two recorders off one file; readers go on."""

import errno
import os
import sys
from pathlib import Path
from typing import Final

if sys.platform != "win32":
    import fcntl

__all__ = ["is_locked", "lock"]

# A lock of Windows keeps others off the bytes that it is about, and so it is about one that no
# file has: at 4 EiB. (msvcrt.locking ends at 2 GiB, which a recording may have.)
_HIGH_WORD: Final = 1 << 30
_LOCK_VIOLATION: Final = 33  # winerror.h

# What flock says where another one has the lock; some network drives say EACCES.
_TAKEN: Final = {errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES}


def lock(fd: int) -> bool:
    """Lock an open file until it is closed; return False where another one has it locked.

    True on a file system that knows no locks, too.
    """
    return _lock(fd)


def is_locked(path: Path) -> bool:
    """Return whether another one has a file locked; False if there is none.

    OSError for a file that may not be read.
    """
    try:
        # Without O_NONBLOCK the opening of a named pipe waits for its writer.
        fd = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except (FileNotFoundError, NotADirectoryError):
        return False
    try:
        return not lock(fd)
    finally:
        os.close(fd)


if sys.platform == "win32":

    def _lock(fd: int) -> bool:
        import ctypes  # noqa: PLC0415 - these are there on Windows only
        import msvcrt  # noqa: PLC0415

        kernel = ctypes.WinDLL("kernel32", use_last_error=True)
        handle = ctypes.c_void_p(msvcrt.get_osfhandle(fd))
        done = kernel.LockFile(handle, 0, _HIGH_WORD, 1, 0)
        return bool(done) or ctypes.get_last_error() != _LOCK_VIOLATION
else:

    def _lock(fd: int) -> bool:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            return error.errno not in _TAKEN
        return True
