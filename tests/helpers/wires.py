"""Lines that carry what is written: from one terminal to another, and back."""

import os
import select
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from device import Device


@contextmanager
def linked() -> Iterator[tuple[str, str]]:
    """Give two paths: what is written to one is read from the other."""
    with Device() as first, Device() as second, _carried([(first, second), (second, first)]):
        yield first.url, second.url


@contextmanager
def echo() -> Iterator[str]:
    """Give a path that gives back what is written to it."""
    with Device() as line, _carried([(line, line)]):
        yield line.url


@contextmanager
def _carried(ways: list[tuple[Device, Device]]) -> Iterator[None]:
    """Carry bytes from one terminal to another."""
    stop, stopper = os.pipe()
    threads = [
        threading.Thread(target=_carry, args=(source.master, target.master, stop))
        for source, target in ways
    ]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        os.close(stopper)  # readable for all of them now
        for thread in threads:
            thread.join()
        os.close(stop)


def _carry(source: int, target: int, stop: int) -> None:
    while True:
        ready, _, _ = select.select([source, stop], [], [])
        if stop in ready:
            return
        rest = memoryview(os.read(source, 4096))
        while rest:
            _, writable, _ = select.select([stop], [target], [])
            if not writable:
                return
            # No more than fits: the terminal would keep the thread.
            os.set_blocking(target, False)
            with suppress(BlockingIOError):
                rest = rest[os.write(target, rest) :]
