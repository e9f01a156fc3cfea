"""Ports that are read: what is to come, what has come, and calls that wait in another thread."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import canser
from canser._frames import FRAME_DTYPE, FrameArray
from canser.simulation.traffic import vehicle
from device import PATIENCE, Device
from reference import WIRE_FORMATS
from samples import listed


def traffic(seconds: float, protocol: str = "seeed") -> FrameArray:
    return vehicle(seconds, extended=WIRE_FORMATS[protocol].has_ext)


def content(frames: FrameArray) -> list[tuple[Any, ...]]:
    """Return all of the frames but their times."""
    return [frame[:-1] for frame in listed(frames)]


def collect(port: canser.Port, count: int, **options: Any) -> FrameArray:
    """Read until so many frames are there."""
    batches = [np.empty(0, FRAME_DTYPE)]
    while sum(map(len, batches)) < count:
        batch = port.read_batch(timeout=PATIENCE, **options)
        assert len(batch), f"{sum(map(len, batches))} frames came, {count} should"
        batches.append(batch)
    return np.concatenate(batches)


def waiting(port: canser.Port) -> int:
    """Return how many bytes wait in the ring."""
    return len(port._ring)


def read_config(device: Device) -> bytes:
    """Return the next configuration that the host has sent, behind requests of the status."""
    asked = canser.protocol("seeed").status_request
    while (packet := device.read(20)) == asked:
        pass
    return packet


def read_configured(device: Device, packet: bytes) -> bytes:
    """Return the configuration that the host has sent, with requests of the status and `packet`."""
    config, asked = device.read(20), canser.protocol("seeed").status_request
    rest = b""
    while not rest.endswith(packet):
        rest += device.read(1)
    count = (len(rest) - len(packet)) // len(asked)
    assert rest == asked * count + packet
    return config


def being_read(port: canser.Port) -> bool:
    """Return whether another thread reads."""
    if port._reading.acquire(blocking=False):
        port._reading.release()
        return False
    return True


@contextlib.contextmanager
def plugged(protocol: str = "seeed", **options: Any) -> Iterator[tuple[Device, canser.Port]]:
    with Device() as device, canser.open(device.url, protocol, **options) as port:
        yield device, port


class Background:
    """A call in a thread of its own: its result or its exception."""

    def __init__(self, call: Callable[[], object]) -> None:
        self.result: object = None
        self.error: BaseException | None = None

        def run() -> None:
            try:
                self.result = call()
            except Exception as error:  # noqa: BLE001 - looked at by the test
                self.error = error

        self._thread = threading.Thread(target=run, daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    def join(self) -> "Background":
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive(), "it still waits"
        return self


def frames_of(reader: Background) -> FrameArray:
    """Return what a call in another thread has read."""
    result = reader.join().result
    assert isinstance(result, np.ndarray), reader.error
    return result
