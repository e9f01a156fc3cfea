"""Connections over TCP: opened with a time-out, and closed when the other end is silent."""

import socket
import sys
from typing import Final
from urllib.parse import urlsplit

from canser.errors import PortNotFoundError

__all__ = ["connect", "notice_dead_peer", "server_of"]

# The longest time until a server accepts a connection.
_CONNECT_TIMEOUT_S: Final = 5.0

# A peer without power or cable is as silent as one that has nothing to send. So the system sends a
# keep-alive probe after _IDLE_S without a byte, and then every _INTERVAL_S. After _PROBES without
# an answer the connection is dead: 10 + 3 * 2 = 16 s after the last byte.
_IDLE_S: Final = 10
_INTERVAL_S: Final = 2
_PROBES: Final = 3

# The system sends no probes while sent bytes wait for their acknowledgement. Linux then ends the
# connection after this time, by default after some 15 minutes. Linux also ends it if the peer
# answers, but takes no bytes for this time.
_UNACKNOWLEDGED_MS: Final = 15_000


def server_of(url: str) -> tuple[str, int]:
    """Return the host and the port number of a URL, or raise ValueError."""
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
            f"no server answers at {url}: {error.strerror or error}; is the server running?"
        ) from None


def notice_dead_peer(connection: socket.socket) -> None:
    """Make the system end a connection whose other end does not answer any more."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    if sys.platform == "win32" and not hasattr(socket, "TCP_KEEPIDLE"):
        # Windows 10 before version 1709. Its number of probes is fixed: 10.
        connection.ioctl(socket.SIO_KEEPALIVE_VALS, (1, _IDLE_S * 1000, _INTERVAL_S * 1000))
        return
    options = {
        "TCP_KEEPIDLE": _IDLE_S,
        "TCP_KEEPALIVE": _IDLE_S,  # the name of TCP_KEEPIDLE on macOS
        "TCP_KEEPINTVL": _INTERVAL_S,
        "TCP_KEEPCNT": _PROBES,
        "TCP_USER_TIMEOUT": _UNACKNOWLEDGED_MS,  # Linux only
    }
    for name, value in options.items():
        option = getattr(socket, name, None)
        if option is not None:
            connection.setsockopt(socket.IPPROTO_TCP, option, value)
