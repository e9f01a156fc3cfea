"""pyserial's client of RFC 2217, with the caller's time-outs.

Otherwise a slow server would be taken for a dead one: pyserial's own `write` waits 5 s for a server
that takes nothing, whatever the caller's time-out, and then raises with a part of the bytes sent.
So do the answers that pyserial's thread sends.
"""

import contextlib
import queue
import select
import socket
import sys
import time
from typing import Any, Final

import serial
from serial import rfc2217

from canser.live.tcp import notice_dead_peer

__all__ = ["Rfc2217Port"]

# The byte that marks a command of telnet (RFC 854). As a byte of data it is doubled.
_IAC: Final = b"\xff"

# The most bytes that one call of `transmit` sends.
_SEND_MAX: Final = 4096

# The longest time for poll(), in milliseconds: an int of C.
_POLL_MAX_MS: Final = (1 << 31) - 1

# The longest wait for the thread of a connection that was shut down. It ends at once, mostly.
_THREAD_ENDS_S: Final = 0.2


class Rfc2217Port(rfc2217.Serial):
    """A serial port of a server of RFC 2217. One thread receives and one transmits at a time."""

    # Attributes of pyserial that its type stubs lack.
    _socket: socket.socket | None
    _network_timeout: float
    _write_lock: Any
    _read_buffer: Any
    _thread: Any

    # Bytes that go out before anything else: the second half of a doubled byte, and commands that
    # the connection did not take at once.
    _owed = b""

    def open(self) -> None:
        """Connect and negotiate; TimeoutError if the server answers too late, or never."""
        self._owed = b""
        try:
            super().open()
        except serial.SerialException as error:
            if error.__context__ is not None:
                raise  # an error of the connection, or of the URL
            limit = self._network_timeout
            raise TimeoutError(
                f"its server did not answer within {limit:g} s; is it one of RFC 2217? "
                f"A slow one needs ?timeout={2 * limit:g} in the URL"
            ) from None
        try:
            assert self._socket is not None
            notice_dead_peer(self._socket)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the connection, without pyserial's pause of 0.3 s."""
        self.is_open = False
        if self._socket is None:
            return
        with contextlib.suppress(OSError):  # the other end has closed it already
            self._socket.shutdown(socket.SHUT_RDWR)
        if self._thread is not None:
            self._thread.join(_THREAD_ENDS_S)
        self._socket.close()

    def reset_output_buffer(self) -> None:
        """Do nothing: `open` calls this, and this connection has written nothing yet."""

    def receive(self, most: int, timeout: float) -> bytes:
        """Return the bytes that have come, 1 to `most`; b"" after `timeout` seconds.

        OSError when the connection has ended, after its last byte was returned.
        """
        came, data = self._read_buffer, bytearray()
        with contextlib.suppress(queue.Empty):
            while len(data) < most:
                byte = came.get(timeout=0 if data else timeout)
                if byte is None:  # the end
                    came.put(None)  # for the next call
                    break
                data += byte
            if not data:
                raise ConnectionResetError("the connection has ended")
        return bytes(data)

    def _telnet_read_loop(self) -> None:
        """Read in a thread; any exception ends the stream, also one for an impossible command."""
        try:
            with contextlib.suppress(Exception):
                super()._telnet_read_loop()  # type: ignore[misc]
        finally:
            self._read_buffer.put(None)

    def transmit(self, data: memoryview, timeout: float | None) -> int:
        """Send what the connection takes; return how many bytes, 0 after `timeout` seconds.

        OSError when the connection has ended.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        wire = bytes(data[:_SEND_MAX]).replace(_IAC, _IAC * 2)
        while True:
            with self._write_lock:
                sent = self._send(wire)
                halves = wire[:sent].count(_IAC)  # an odd number: a doubled byte is cut
                self._owed += _IAC * (halves % 2)
            if sent:
                return sent - halves // 2
            left = None if deadline is None else max(deadline - time.monotonic(), 0)
            if not _writable(self._socket, left):
                return 0

    @property
    def out_waiting(self) -> int:
        """How many bytes the system has not taken yet; what the system holds is not known."""
        self._internal_raw_write(b"")
        return len(self._owed)

    def _internal_raw_write(self, data: bytes) -> None:
        """Send a command now, or else before the next bytes: pyserial's thread must not wait."""
        with self._write_lock:
            sent = self._send(data)
            self._owed += data[sent:]

    def _send(self, wire: bytes) -> int:
        """Send what the connection takes at once; return how many bytes of `wire`."""
        assert self._socket is not None
        if not _writable(self._socket, 0):
            return 0
        owed = len(self._owed)
        sent = self._socket.send(self._owed + wire)
        self._owed = self._owed[sent:]
        return max(sent - owed, 0)


def _writable(connection: socket.socket | None, timeout: float | None) -> bool:
    """Wait until a connection takes bytes, or has ended; False after `timeout` seconds."""
    assert connection is not None
    if sys.platform == "win32":
        return bool(select.select([], [connection], [], timeout)[1])
    poll = select.poll()  # and not select(), which takes no descriptor above 1023
    poll.register(connection, select.POLLOUT)
    return bool(poll.poll(None if timeout is None else min(timeout * 1000, _POLL_MAX_MS)))
