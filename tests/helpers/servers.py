"""Servers of one client, for lines that are connections over TCP."""

import contextlib
import socket
import threading
from typing import Any, Self

import serial
import serial.rfc2217

from device import PATIENCE


class Server:
    """A server of one client. What it hears is in `heard`; it says what it is told to."""

    def __init__(self) -> None:
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self.heard = bytearray()
        self.here = threading.Event()  # a client is
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        return f"socket://127.0.0.1:{self.port}"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.hang_up()
        self._listening.close()

    def say(self, data: bytes) -> None:
        assert self.here.wait(PATIENCE)
        self._client.sendall(data)

    def hang_up(self) -> None:
        if self.here.is_set():
            with contextlib.suppress(OSError):
                self._client.shutdown(socket.SHUT_RDWR)
        else:
            with contextlib.suppress(OSError):
                self._listening.shutdown(socket.SHUT_RDWR)
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            self._client = self._listening.accept()[0]
            with self._client:
                self.start()
                self.here.set()
                while data := self._client.recv(4096):
                    self.hear(data)

    def start(self) -> None:
        """Get ready for the client."""

    def hear(self, data: bytes) -> None:
        self.heard += data


class TelnetServer(Server):
    """A server of RFC 2217, with a port that is a pseudo terminal."""

    @property
    def url(self) -> str:
        return f"rfc2217://127.0.0.1:{self.port}"

    def start(self) -> None:
        self._lock = threading.Lock()
        port: Any = serial.serial_for_url("loop://")
        connection: Any = self
        self.manager = serial.rfc2217.PortManager(port, connection)

    def write(self, data: bytes) -> None:
        """Send what the manager wants to tell the client."""
        with self._lock:
            self._client.sendall(data)

    def say(self, data: bytes) -> None:
        assert self.here.wait(PATIENCE)
        self.write(b"".join(self.manager.escape(data)))

    def hear(self, data: bytes) -> None:
        self.heard += b"".join(self.manager.filter(data))
