"""Connections over TCP: the server that a URL names, connected to within a time."""

import socket
from typing import Final
from urllib.parse import urlsplit

from canser.errors import PortNotFoundError

__all__ = ["connect", "server_of"]

# A TCP connection must come about within this time.
_CONNECT_TIMEOUT_S: Final = 5.0


def server_of(url: str) -> tuple[str, int]:
    """Return the host and the port of a URL, or raise ValueError."""
    remedy = f"write {url.partition('://')[0]}://host:port"
    try:
        parts = urlsplit(url)
        host, number = parts.hostname, parts.port
        (host or "").encode("idna")
    except ValueError as error:
        raise ValueError(f"cannot read {url!r}: {error}; {remedy}") from None
    if not host or number is None:
        raise ValueError(f"cannot read {url!r}: host or port is missing; {remedy}")
    return host, number


def connect(url: str, host: str, number: int) -> socket.socket:
    """Connect to the server of a URL, or raise PortNotFoundError."""
    try:
        return socket.create_connection((host, number), timeout=_CONNECT_TIMEOUT_S)
    except OSError as error:
        raise PortNotFoundError(
            f"nobody answers at {url}: {error.strerror or error}; is the server running?"
        ) from None
