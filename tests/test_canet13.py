"""`canet13` from end to end: what a converter sends over TCP arrives, by every way there is."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import numpy as np
import pytest

import canser
from canser._frames import FrameArray
from canser.commands import cli
from canser.simulation.traffic import vehicle

SENT = vehicle(1)


@contextmanager
def converter() -> Iterator[tuple[str, list[bytes]]]:
    """Send the frames to each client; yield the URL, and what the clients send."""
    received: list[bytes] = []
    stop = threading.Event()

    def serve() -> None:
        while not stop.is_set():
            try:
                client, _ = server.accept()
            except TimeoutError:
                continue
            with client:
                client.settimeout(0.05)
                client.sendall(canser.encode(SENT, "canet13"))
                while not stop.is_set():
                    try:
                        data = client.recv(4096)
                    except TimeoutError:
                        continue
                    if not data:
                        break
                    received.append(data)

    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.05)
        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield f"socket://127.0.0.1:{server.getsockname()[1]}", received
        finally:
            stop.set()
            thread.join()


def assert_sent(frames: FrameArray) -> None:
    for name in ("id", "ext", "rtr", "dlc", "data"):
        assert np.array_equal(frames[name], SENT[name]), name


def test_a_port() -> None:
    with converter() as (url, received), canser.open(url, "canet13") as port:
        frames = port.read_batch(
            np.empty(len(SENT), canser.FRAME_DTYPE), min_frames=len(SENT), timeout=10
        )
        assert_sent(frames)
        assert port.stats.bytes_skipped == 0
        port.send("12345678#1234567800")
        port.drain()
        deadline = time.monotonic() + 10
        while sum(map(len, received)) < 13 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert b"".join(received) == bytes.fromhex("85 12345678 1234567800 000000")


def test_a_recording_and_files(tmp_path: Path) -> None:
    out = tmp_path / "run.pcapng"
    with converter() as (url, _):
        arguments = ["log", "-c", url, "-p", "canet13", str(out), "--duration", "1s"]
        assert cli.main(arguments) == 0
    assert_sent(canser.read(out))
    assert cli.main(["convert", str(out), str(tmp_path / "run.bin")]) == 0
    with pytest.warns(canser.CanserWarning, match="read as canet13"):
        assert_sent(canser.read(tmp_path / "run.bin", "auto"))


def test_the_bus_of_python_can() -> None:
    with (
        converter() as (url, _),
        can.Bus(interface="canser", channel=url, protocol="canet13") as bus,
    ):
        for frame in SENT[:100]:
            message = bus.recv(timeout=10)
            assert message is not None
            assert message.arbitration_id == frame["id"]
            assert bytes(message.data) == frame["data"].tobytes()[: len(message.data)]


def test_what_it_cannot_do() -> None:
    with pytest.raises(ValueError, match="canet13 adapters take no configuration"):
        canser.open("loop://", "canet13", bitrate=500_000)
    frames = canser.frames("123#01")
    frames["err"] = True
    with pytest.raises(ValueError, match="the format has no error frames"):
        canser.encode(frames, "canet13")


def test_random_bytes_are_not_recognised() -> None:
    for seed in range(20):
        noise = np.random.default_rng(seed).bytes(20_000)
        assert not any(fit.fits for fit in canser.identify(noise))
