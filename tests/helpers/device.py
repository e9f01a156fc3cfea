"""What live ports are tested with: the far end of a pseudo terminal, and waiting for things."""

import contextlib
import os
import select
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Self

PATIENCE = 60.0
"""Seconds after which what a test waits for will not come any more."""


def until(condition: Callable[[], object]) -> None:
    """Wait until a condition holds."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "this never came true"
        time.sleep(0.001)


def descriptors() -> int:
    """Return how many files this process has open."""
    return len(list(Path("/proc/self/fd").iterdir()))


class Device:
    """A device at the far end of a pseudo terminal; `url` is where it is plugged in.

    `feed` writes in a thread of its own, because a terminal holds some kilobytes only. `link`:
    a path for it that stays, whatever number the terminal has.
    """

    def __init__(self, link: Path | None = None, *, cooked: bool = False) -> None:
        self.master, self.slave = os.openpty()
        if not cooked:
            tty.setraw(self.slave)
        self.url = os.ttyname(self.slave)
        self._link = link
        if link is not None:
            link.unlink(missing_ok=True)
            link.symlink_to(self.url)
            self.url = str(link)
        os.set_blocking(self.master, False)
        self._gone = threading.Event()
        self._lock = threading.Lock()
        self._feeders: list[threading.Thread] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def feed(self, data: bytes) -> threading.Thread:
        """Send bytes to the host, behind those that were fed earlier."""

        def write() -> None:
            if before is not None:
                before.join()
            view = memoryview(data)
            poll = select.poll()
            poll.register(self.master, select.POLLOUT)
            while view and not self._gone.is_set():
                if poll.poll(10):
                    with contextlib.suppress(BlockingIOError):
                        view = view[os.write(self.master, view) :]

        feeder = threading.Thread(target=write, daemon=True)
        with self._lock:  # several threads may feed
            before = self._feeders[-1] if self._feeders else None
            feeder.start()
            self._feeders.append(feeder)
        return feeder

    def write(self, data: bytes, ended: Callable[[], object] = lambda: False) -> None:
        """Send bytes; return when the terminal has taken the last, or who reads has ended."""
        feeder = self.feed(data)
        until(lambda: not feeder.is_alive() or ended())

    def fed(self) -> None:
        """Wait until the terminal has taken all that was fed."""
        for feeder in self._feeders:
            feeder.join(PATIENCE)
            assert not feeder.is_alive(), "nobody reads what is fed"
        self._feeders.clear()

    def read(self, count: int) -> bytes:
        """Return so many bytes that the host has sent."""
        data = b""
        while len(data) < count:
            data += self.read_some(count - len(data))
        return data

    def read_some(self, most: int = 4096) -> bytes:
        """Return what the host has sent, one byte at least."""
        assert self.hears(PATIENCE), "the host sends nothing more"
        return os.read(self.master, most)

    def hears(self, timeout: float = 0) -> bool:
        """Return whether the host has sent something."""
        poll = select.poll()
        poll.register(self.master, select.POLLIN)
        return bool(poll.poll(timeout * 1000))

    def waiting(self) -> bool:
        """Return whether bytes wait in the terminal that the host has not read."""
        poll = select.poll()
        poll.register(self.slave, select.POLLIN)
        return bool(poll.poll(0))

    def unplug(self) -> None:
        """Be gone; what the host has not read is gone, too."""
        if self._gone.is_set():
            return
        self._gone.set()
        for feeder in self._feeders:
            feeder.join()
        self._feeders.clear()
        if self._link is not None:
            # The terminal's number is soon somebody else's.
            self._link.unlink(missing_ok=True)
        os.close(self.slave)
        os.close(self.master)
