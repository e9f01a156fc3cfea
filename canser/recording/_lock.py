"""A lock that prevents two recorders from writing one file. It does not hinder readers."""

import errno
import os
import sys
from pathlib import Path
from typing import Final

if sys.platform != "win32":
    import fcntl

__all__ = ["is_locked", "lock"]

# On Windows, a lock denies other programs the locked bytes. So the lock is on one byte at 4 EiB,
# which no file has. This is the high word of that offset. (msvcrt.locking reaches only 2 GiB, and
# a recording may be larger.)
_HIGH_WORD: Final = 1 << 30
_LOCK_VIOLATION: Final = 33  # ERROR_LOCK_VIOLATION of winerror.h

# Errors of flock if another program has the lock. EACCES comes from some network drives.
_TAKEN: Final = {errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES}


def lock(fd: int) -> bool:
    """Lock an open file until it is closed; return False if another program has locked it.

    Also returns True on a file system that has no locks.
    """
    return _lock(fd)


def is_locked(path: Path) -> bool:
    """Return whether another program has locked a file; False if there is no file.

    OSError for a file that may not be read.
    """
    try:
        # O_NONBLOCK: otherwise opening a named pipe waits for its writer.
        fd = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except (FileNotFoundError, NotADirectoryError):
        return False
    try:
        return not lock(fd)
    finally:
        os.close(fd)


if sys.platform == "win32":

    def _lock(fd: int) -> bool:
        import ctypes  # noqa: PLC0415 - these modules exist on Windows only
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
