"""A pseudo terminal, seen from the side of the device.

This module relies on these rules of Linux:

- The terminal holds 12 to 20 KB. When it is full it takes no more bytes, and loses none.
- Closing the device's side throws away the bytes that the host has not read.
- In packet mode (ioctl_tty(2), TIOCPKT) the device learns that the host has flushed its input.
- Only a descriptor of the host's side shows whether all bytes were read. While the device holds
  such a descriptor, it sees no hangup when the host goes. inotify(7) reports that instead.
"""

import contextlib
import ctypes
import errno
import os
import select
import struct
import sys
import time
from pathlib import Path
from typing import Final

from canser._named import named
from canser.errors import PortError

__all__ = ["Symlink", "Terminal"]

_OPENED: Final = 0x20  # IN_OPEN
_CLOSED: Final = 0x08 | 0x10  # IN_CLOSE_WRITE, IN_CLOSE_NOWRITE
_EVENT: Final = struct.Struct("iIII")  # watch, mask, cookie, length of the name (here 0)

# inotify merges two openings at once into one event, so a closing can look like the last one
# although a host is still there. So a host that seems away is looked for at this interval.
_LOOK_EVERY_S: Final = 1.0


class Terminal:
    """A raw pseudo terminal; the host opens `path`. Not blocking, for one thread.

    It holds descriptors of both sides, so hosts may come and go. OSError if the system has no
    terminal left, PortError where there are none at all.
    """

    def __init__(self) -> None:
        if sys.platform == "win32":
            raise PortError("there are no pseudo terminals on Windows; use Linux, macOS or WSL")
        import fcntl  # noqa: PLC0415
        import termios  # noqa: PLC0415

        with contextlib.ExitStack() as opening:
            self._device, self._host = os.openpty()
            opening.callback(os.close, self._device)
            self.path = os.ttyname(self._host)
            opening.callback(lambda: os.close(self._host))
            self._make_raw()
            os.set_blocking(self._device, False)
            os.set_blocking(self._host, False)
            fcntl.ioctl(self._device, termios.TIOCPKT, struct.pack("i", 1))
            self._flush_mark = termios.TIOCPKT_FLUSHREAD
            self._watch = _Watch(self.path) if sys.platform == "linux" else None
            opening.pop_all()
        # Without inotify the host is assumed to be there.
        self.open = self._watch is None
        self._looked = time.monotonic()

    def register(self, waiting: "select.poll", wanted: int) -> None:
        """Let `waiting` wait for the host to open or close, and for the events `wanted`."""
        waiting.register(self._device, wanted)
        if self._watch is not None:
            waiting.register(self._watch.fd, select.POLLIN)

    def look(self, *, noticed: bool) -> bool:
        """Set `open`, whether a host has the terminal open; return whether one has just opened it.

        `noticed`: whether an event has come since the last call.
        """
        if self._watch is None:
            return False
        seen = self._watch.read() if noticed else 0
        if seen & _CLOSED or (not self.open and time.monotonic() > self._looked + _LOOK_EVERY_S):
            before, self.open = self.open, self._probe()
            # A host may close and open again before the probe looks.
            return self.open and (not before or bool(seen & _OPENED))
        if seen & _OPENED:
            self.open = True
        return bool(seen & _OPENED)

    def read(self) -> tuple[bytes, bool]:
        """Return the bytes that the host has written, and whether it has flushed its input."""
        try:
            packet = os.read(self._device, 65_536)
        except BlockingIOError:
            return b"", False
        # In packet mode the first byte is 0 for data, otherwise a set of flags.
        return (packet[1:], False) if packet[0] == 0 else (b"", bool(packet[0] & self._flush_mark))

    def write(self, data: memoryview) -> int:
        """Write as many bytes as the terminal has room for; return their number."""
        try:
            return os.write(self._device, data)
        except BlockingIOError:
            return 0

    def drained(self) -> bool:
        """Return whether the host has read all bytes that were written."""
        # Polling waits for bytes that the kernel is moving between the two sides. But a reader
        # may make the kernel move more at this moment, so one look is not enough.
        for _ in range(3):
            waiting = select.poll()
            waiting.register(self._host, select.POLLIN)
            if waiting.poll(0):
                return False
            time.sleep(0.001)
        return True

    def close(self) -> int:
        """Hang up; return the number of bytes that were written and not read by the host."""
        unread = 0
        with contextlib.suppress(BlockingIOError):
            while part := os.read(self._host, 65_536):
                unread += len(part)
        os.close(self._host)
        os.close(self._device)
        if self._watch is not None:
            self._watch.close()
        return unread

    def _make_raw(self) -> None:
        import termios  # noqa: PLC0415
        import tty  # noqa: PLC0415

        # The default of tty.setraw, TCSAFLUSH, would throw away the bytes that wait.
        tty.setraw(self._host, termios.TCSANOW)

    def _probe(self) -> bool:
        """Return whether a host has the terminal open; if none has, closing our side hangs up."""
        import fcntl  # noqa: PLC0415
        import termios  # noqa: PLC0415

        assert self._watch is not None
        self._watch.stop()
        # On a pseudo terminal the exclusive mode outlives the host that has set it (TIOCEXCL).
        # Otherwise no host could open the terminal again.
        fcntl.ioctl(self._host, termios.TIOCNXCL)
        os.close(self._host)
        hung = select.poll()
        hung.register(self._device, 0)
        there = not hung.poll(0)
        self._host = os.open(self.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._watch.start()
        if not there:
            self._make_raw()  # the last host may have set another mode
        self._looked = time.monotonic()
        return there


class _Watch:
    """The openings and closings of a file, by inotify, which Python does not wrap."""

    def __init__(self, path: str) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._path = os.fsencode(path)
        self.fd: int = self._libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if self.fd < 0:
            self._fail()
        try:
            self.start()
        except OSError:
            os.close(self.fd)
            raise

    def start(self) -> None:
        self._number = self._libc.inotify_add_watch(self.fd, self._path, _OPENED | _CLOSED)
        if self._number < 0:
            self._fail()

    def stop(self) -> None:
        self._libc.inotify_rm_watch(self.fd, self._number)

    def read(self) -> int:
        """Return the kinds of all events since the last call, as a set of bits."""
        seen = 0
        with contextlib.suppress(BlockingIOError):
            for _, mask, _, _ in _EVENT.iter_unpack(os.read(self.fd, 64 * _EVENT.size)):
                seen |= mask
        return seen

    def close(self) -> None:
        os.close(self.fd)

    def _fail(self) -> None:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), os.fsdecode(self._path))


class Symlink:
    """A symbolic link that stays while terminals come and go; path "" for none.

    FileExistsError if the path is something else, even a link that leads to no terminal. A link
    to a terminal is replaced: a simulator that was killed has left it.
    """

    def __init__(self, path: str) -> None:
        self._path = Path(path) if path else None
        self._target = ""

    def point(self, target: str) -> None:
        """Make the link, or change its target, in one step."""
        if self._path is None:
            return
        if self._path.exists() and not (self._path.is_symlink() and self._path.is_char_device()):
            raise FileExistsError(
                errno.EEXIST, "there already, and no link to a terminal", str(self._path)
            )
        fresh = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        # Otherwise the error would name the terminal, which is not at fault.
        with named(str(self._path), always=True):
            fresh.symlink_to(target)
            fresh.replace(self._path)
        self._target = target

    def remove(self) -> None:
        """Remove the link, unless it has another target by now."""
        if self._path is not None and self._target:
            with contextlib.suppress(FileNotFoundError, OSError):
                if os.readlink(self._path) == self._target:  # noqa: PTH115
                    self._path.unlink()
        self._target = ""
