"""A serial line as bytes: opened raw and exclusive by any URL, read in place, written.

pyserial opens and sets the line. If the line has a descriptor, bytes are then read and written
through it: pyserial's own `read` loses the bytes that it has when a port dies, and uses select(),
which takes no descriptor above 1023.
"""

import contextlib
import errno
import os
import select
import socket
import stat
import sys
import time
from typing import Any, Final, Protocol

from canser.errors import (
    PortBusyError,
    PortDeniedError,
    PortError,
    PortGoneError,
    PortNotFoundError,
)
from canser.live.config import LineConfig
from canser.live.tcp import connect, notice_dead_peer, server_of

if sys.platform != "win32":
    import fcntl
    import grp
    import termios

__all__ = ["Line", "open_line"]

# A read of a line without a descriptor cannot be woken. It checks at this interval whether it shall
# end.
_LOOK_EVERY_S: Final = 0.1


class Line(Protocol):
    """An open line. One thread reads and one writes at a time."""

    def read_into(self, room: memoryview, timeout: float | None) -> int:
        """Wait for at least one byte, and read what is there into `room`; return how many bytes.

        0 after `timeout` seconds (None: never) or after `wake`. PortGoneError when the line is
        dead.
        """

    def write(self, data: memoryview, timeout: float | None, counts: list[int]) -> int:
        """Write what the line takes; return how many bytes, 0 after `timeout` seconds.

        Appends the number to `counts`, unless it is 0.
        """

    def unwritten(self) -> int:
        """Return how many written bytes the system still holds."""

    def wake(self) -> None:
        """Let a `read_into` of another thread return at once."""

    def close(self) -> None:
        """Close the line; no thread may be in `read_into`."""


def open_line(url: str, config: LineConfig) -> Line:
    """Open a line by a URL of pyserial's, 8N1, raw, exclusive.

    `config`: its baud rate must be set; its `ring_size` and `ping` do not matter here.
    Raises PortNotFoundError, PortDeniedError, PortBusyError, PortError, and ValueError for an
    impossible URL or baud rate.
    """
    if not url:
        raise PortNotFoundError("url is empty: there is no port ''; 'canser ports' lists the ports")
    scheme = url.partition("://")[0].lower()
    server = server_of(url) if scheme in _OVER_TCP else None
    if scheme == "socket":
        assert server is not None
        if names := " and ".join(_levels(config)):
            raise ValueError(
                f"{url} carries no modem lines, so {names} cannot be set; "
                f"use rfc2217://, or leave {names} out"
            )
        source: Any = connect(url, *server)
    else:
        source = _open_serial(url, config)
        if scheme == "rfc2217":
            return _Rfc2217(source, url)
        if not _has_descriptor(source):
            return _Serial(source, url)
    try:
        if scheme == "socket":
            source.setblocking(False)
            source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            notice_dead_peer(source)
        else:
            _make_raw(source.fd, url)
            _claim(source.fd)
        return _Descriptor(source, url)
    except (OSError, termios_error) as error:  # the device may vanish at any time
        source.close()
        raise _open_error(url, config.baudrate, error) from None
    except BaseException:
        source.close()
        raise


# The schemes of lines that are connections to a server.
_OVER_TCP: Final = ("socket", "rfc2217")


def _open_serial(url: str, config: LineConfig) -> Any:
    import serial  # noqa: PLC0415 - imported where it is used

    assert config.baudrate is not None  # `canser.open` has set it
    options: Any = {"baudrate": config.baudrate, "timeout": _LOOK_EVERY_S, "exclusive": True}
    port: Any
    try:
        if url.lower().startswith("rfc2217:"):
            from canser.live.rfc2217 import Rfc2217Port  # noqa: PLC0415 - as serial

            port = Rfc2217Port(None, **options)
            port.port = url
        else:
            port = serial.serial_for_url(url, do_not_open=True, **options)
    except serial.SerialException as error:  # hwgrep:// has looked for the port already
        raise PortNotFoundError(
            f"there is no port {url}: {error}; 'canser ports' lists the ports"
        ) from None
    # Each kind of URL reads its options by code of its own, which raises any kind of exception.
    except Exception as error:  # noqa: BLE001
        raise ValueError(f"cannot open {url!r} at {config.baudrate} baud: {_text(error)}") from None
    if not config.flush:
        # Otherwise `open` throws away the bytes that wait: by calls of these methods.
        port.reset_input_buffer = port._reset_input_buffer = _nothing
    levels = _levels(config)
    for name, level in levels.items():
        setattr(port, name, level)  # before `open`: otherwise a line has the other level at first
    try:
        port.open()
    except Exception as error:  # noqa: BLE001 - as above
        raise _open_error(url, config.baudrate, error) from None
    try:
        # `open` ignores that modem lines are missing. Setting them again raises.
        for name, level in levels.items():
            setattr(port, name, level)
    except OSError as error:
        port.close()
        if error.errno not in (errno.ENOTTY, errno.EINVAL):
            raise _open_error(url, config.baudrate, error) from None
        raise ValueError(
            f"{url} has no modem lines (pseudo terminals have none), so {name} cannot be set; "
            f"leave {name} out"
        ) from None
    return port


def _levels(config: LineConfig) -> dict[str, bool]:
    """Return the modem lines that have to be set, and whether on."""
    asked = {"dtr": config.dtr, "rts": config.rts}
    return {name: level == "on" for name, level in asked.items() if level != "leave"}


def _nothing() -> None:
    """Throw no bytes away."""


termios_error: Final[type[Exception]] = termios.error if sys.platform != "win32" else OSError


def _open_error(url: str, baudrate: int | None, error: Exception) -> Exception:
    """Return the error of this package for an error of the system or of pyserial."""
    number = _number(error)
    kind: type[Exception] = PortError
    if not isinstance(error, (OSError, termios_error)):
        kind, text = ValueError, f"cannot open {url!r} at {baudrate} baud: {_text(error)}"
    elif number and url.lower().startswith("rfc2217:"):
        kind = PortNotFoundError
        text = f"cannot open {url}: {_reason(error)}; is the server running?"
    elif number in (errno.EACCES, errno.EPERM):
        kind = PortDeniedError
        text = f"{url} may not be opened by this user{_group_hint(url)}"
    elif number in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK):
        kind, text = PortBusyError, f"{url} is open in another program; close it there"
    elif number in (errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.EIO):
        kind = PortNotFoundError
        text = f"there is no port {url}; is the adapter plugged in? 'canser ports' lists the ports"
    elif number in (errno.EMFILE, errno.ENFILE):
        text = f"cannot open {url}: {_reason(error)}; allow more with 'ulimit -n'"
    elif _is_file(url):
        text = f"{url} is no serial port; files are read by canser.read"
    elif number == errno.ENOTTY:
        text = f"{url} is no serial port; 'canser ports' lists the ports"
    else:
        text = f"cannot open {url} at {baudrate} baud: {_reason(error)}"
    return kind(text)


def _is_file(url: str) -> bool:
    """Return whether the path exists, and is no device."""
    with contextlib.suppress(OSError):
        return not stat.S_ISCHR(os.stat(url).st_mode)  # noqa: PTH116
    return False


def _reason(error: Exception) -> str:
    """Return the system's text of an error, without its number and pyserial's text."""
    number = _number(error)
    if number > 0:
        return os.strerror(number)
    # Errors of name servers have numbers of their own.
    return getattr(error.__context__, "strerror", None) or _text(error)


def _number(error: BaseException) -> int:
    """Return the system's number of an error, or of its cause; 0 for none."""
    number = _own_number(error)
    if not number and error.__context__ is not None:
        number = _own_number(error.__context__)
    return number


def _own_number(error: BaseException) -> int:
    # Errors of termios have no `errno`: their number is the first argument.
    found = getattr(error, "errno", None) or next(iter(error.args), None)
    return found if isinstance(found, int) else 0


def _text(error: Exception) -> str:
    """Return the text of an error, with its type where pyserial gives a mere key or no text."""
    if isinstance(error, LookupError) or not str(error):
        return f"{type(error).__name__} {error}".strip()
    return str(error)


_GROUP_MAY: Final = stat.S_IRGRP | stat.S_IWGRP


def _group_hint(path: str) -> str:
    """Return the remedy for a user who may not open a device."""
    if sys.platform == "win32":
        return ""
    try:
        status = os.stat(path)  # noqa: PTH116
        name = grp.getgrgid(status.st_gid).gr_name
    except (OSError, KeyError):
        return ""
    if status.st_mode & _GROUP_MAY != _GROUP_MAY:
        return f": its group {name} may not read and write; 'sudo chmod g+rw {path}'"
    if status.st_gid in (os.getegid(), *os.getgroups()):
        return f", though it belongs to the group {name}, and this user does, too"
    return (
        f": it belongs to the group {name}, and this user does not; "
        f"'sudo usermod -aG {name} $USER', then log in again"
    )


def _has_descriptor(port: Any) -> bool:
    """Return whether pyserial reads the port from a descriptor; spy://, for example, does not."""
    import serial  # noqa: PLC0415

    return sys.platform != "win32" and type(port).read is serial.Serial.read


def _make_raw(fd: int, url: str) -> None:
    """Set a terminal so that every byte passes as it is, and check that.

    Otherwise the terminal removes the bytes 03, 11 and 13, turns 0D into 0A, and doubles FF.
    """
    if sys.platform == "win32":
        return
    wanted = termios.tcgetattr(fd)
    for place, bits in _COOKED.items():
        wanted[place] &= ~bits
    wanted[_CFLAG] = wanted[_CFLAG] & ~termios.CSIZE | termios.CS8 | termios.CREAD | termios.CLOCAL
    # Otherwise a read gives no bytes both without data and at the end. So it fails with EAGAIN
    # without data, and gives no bytes at the end.
    wanted[_CC][termios.VMIN], wanted[_CC][termios.VTIME] = 1, 0
    termios.tcsetattr(fd, termios.TCSANOW, wanted)
    found = termios.tcgetattr(fd)
    for place, bits in _COOKED.items():
        if found[place] & bits:
            raise PortError(
                f"{url} changes bytes on their way (settings {place}: {found[place] & bits:#x} "
                "stay on): its driver cannot carry binary data"
            )
    if found[_OSPEED] != wanted[_OSPEED] or found[_CFLAG] & termios.CSIZE != termios.CS8:
        raise PortError(f"{url} did not take its speed or 8 data bits: its driver cannot do that")


if sys.platform != "win32":
    _CFLAG, _OSPEED, _CC = 2, 5, 6
    # The flags that change bytes, by their place in the list of tcgetattr(): input, output, control
    # and local settings.
    _COOKED: Final = {
        0: termios.IGNBRK | termios.BRKINT | termios.PARMRK | termios.INPCK | termios.ISTRIP
        | termios.INLCR | termios.IGNCR | termios.ICRNL | termios.IXON | termios.IXOFF
        | termios.IXANY,
        1: termios.OPOST,
        2: termios.PARENB | termios.CSTOPB | getattr(termios, "CRTSCTS", 0),
        3: termios.ECHO | termios.ECHONL | termios.ICANON | termios.ISIG | termios.IEXTEN,
    }  # fmt: skip


def _claim(fd: int) -> None:
    """Keep other programs from opening the device, also those that ask for no lock, such as cat.

    Not on pseudo terminals: there the claim would stay after a program was killed.
    """
    if sys.platform != "win32":
        with contextlib.suppress(OSError):
            if not os.ttyname(fd).startswith("/dev/pts/"):
                fcntl.ioctl(fd, termios.TIOCEXCL)


# A terminal gives at most 4 KiB in one read. A read of _FULL_READ bytes or more is followed by
# another one, up to _BURST bytes in all. All these bytes get one time of arrival.
_FULL_READ: Final = 4000
_BURST: Final = 1 << 16

# After a read of this many bytes the next one mostly finds more. So that one does not poll first.
_BUSY_READ: Final = 1024

# The longest time for poll(), in milliseconds: an int of C.
_POLL_MAX_MS: Final = (1 << 31) - 1

# Errors by which the other end of a connection does not answer.
_SILENT: Final = {
    errno.ETIMEDOUT, errno.EHOSTUNREACH, errno.EHOSTDOWN, errno.ENETUNREACH, errno.ENETDOWN,
}  # fmt: skip

# Errors by which a line is dead.
_DEAD: Final = _SILENT | {
    errno.EIO, errno.ENXIO, errno.ENODEV, errno.EPIPE, errno.ECONNRESET, errno.ECONNABORTED,
    errno.EBADF, errno.ENOTCONN, errno.ESHUTDOWN,
}  # fmt: skip


class _Descriptor:
    """A line with a descriptor: a terminal, or a connection over TCP."""

    def __init__(self, source: Any, url: str) -> None:
        self._source, self._url = source, url
        self._fd: int = source.fileno()
        self._woken, self._waker = os.pipe()
        self._busy = False  # whether the last read gave _BUSY_READ bytes or more
        # poll() and not select(), which takes no descriptor above 1023.
        self._readable, self._writable = select.poll(), select.poll()
        self._readable.register(self._fd, select.POLLIN)
        self._readable.register(self._woken, select.POLLIN)
        self._writable.register(self._fd, select.POLLOUT)

    def read_into(self, room: memoryview, timeout: float | None) -> int:
        # A busy line mostly has bytes: to poll first would cost a third more.
        count = self._read(room) if self._busy else None
        if count is None:
            ms = None if timeout is None else min(max(timeout, 0) * 1000, _POLL_MAX_MS)
            ready = self._readable.poll(ms)
            if any(fd == self._woken for fd, _ in ready):
                os.read(self._woken, 64)
            elif ready:
                count = self._read(room)
        if not count:
            return 0
        more, end = count, min(len(room), _BURST)
        while more >= _FULL_READ and count < end:
            try:
                more = self._read(room[count:]) or 0
            except (PortGoneError, OSError):
                break  # the next call raises it again; these bytes are returned first
            count += more
        self._busy = count >= _BUSY_READ
        return count

    def _read(self, room: memoryview) -> int | None:
        """Read what is there; None if no byte is."""
        try:
            count = os.readv(self._fd, [room])
        except BlockingIOError:
            return None
        except OSError as error:
            raise self._gone(error) from None
        if not count:
            raise self._gone(None)
        return count

    def write(self, data: memoryview, timeout: float | None, counts: list[int]) -> int:
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            try:
                # In one call of C: otherwise a signal handler that raises could come between the
                # write and the note of its number.
                counts.extend(map(os.write, (self._fd,), (data,)))
                return counts[-1]
            except BlockingIOError:
                pass
            except OSError as error:
                raise self._gone(error) from None
            left = None if deadline is None else max(deadline - time.monotonic(), 0) * 1000
            ready = self._writable.poll(left)
            if not ready:
                return 0
            if ready[0][1] & (select.POLLHUP | select.POLLNVAL):
                raise self._gone(None)

    def unwritten(self) -> int:
        try:
            held = fcntl.ioctl(self._fd, termios.TIOCOUTQ, bytes(4))
        except OSError as error:
            raise self._gone(error) from None
        return int.from_bytes(held, sys.byteorder)

    def wake(self) -> None:
        os.write(self._waker, b"\0")

    def close(self) -> None:
        try:
            self._source.close()
        except OSError as error:
            raise PortError(f"{self._url}: {error.strerror or error}") from None
        finally:
            os.close(self._woken)
            os.close(self._waker)

    def _gone(self, error: OSError | None) -> Exception:
        if error is not None and error.errno not in _DEAD:
            return PortError(f"{self._url}: {error.strerror or error}")
        if error is not None and error.errno in _SILENT:
            return PortGoneError(
                f"{self._url} is gone: {os.strerror(error.errno)}; "
                "is its server on, and the network up?"
            )
        return _gone(self._url)


class _Serial:
    """A line that only pyserial can read: loop://, spy://, and the ports of Windows."""

    def __init__(self, port: Any, url: str) -> None:
        self._port, self._url = port, url
        self._awake = False

    def read_into(self, room: memoryview, timeout: float | None) -> int:
        deadline = None if timeout is None else time.monotonic() + timeout
        left = _LOOK_EVERY_S
        while not self._awake:
            if deadline is not None:
                left = min(max(deadline - time.monotonic(), 0), _LOOK_EVERY_S)
            try:
                data = self._receive(len(room), left)
            except (OSError, TypeError) as error:  # TypeError: closed meanwhile
                raise _gone(self._url) from error
            if data:
                room[: len(data)] = data
                return len(data)
            if deadline is not None and time.monotonic() >= deadline:
                break
        self._awake = False
        return 0

    def _receive(self, most: int, timeout: float) -> bytes:  # noqa: ARG002 - pyserial has its own
        """Return what is there, or the first byte that comes within _LOOK_EVERY_S."""
        data: bytes = self._port.read(max(1, min(self._port.in_waiting, most)))
        return data

    def write(
        self,
        data: memoryview,
        timeout: float | None,  # noqa: ARG002 - see below
        counts: list[int],
    ) -> int:
        # Not every kind of port has a time-out for writing. A short part keeps the call short.
        part = bytes(data[:4096])
        try:
            written = self._port.write(part)
        except (OSError, TypeError) as error:
            raise _gone(self._url) from error
        counts.append(len(part) if written is None else int(written))
        return counts[-1]

    def unwritten(self) -> int:
        try:
            return int(getattr(self._port, "out_waiting", 0))
        except (OSError, TypeError) as error:  # TypeError: closed meanwhile
            raise _gone(self._url) from error

    def wake(self) -> None:
        self._awake = True

    def close(self) -> None:
        try:
            self._port.close()
        except OSError as error:
            raise PortError(f"{self._url}: {error.strerror or error}") from None


class _Rfc2217(_Serial):
    """A line of a server of RFC 2217, with the caller's time-outs."""

    def _receive(self, most: int, timeout: float) -> bytes:
        data: bytes = self._port.receive(most, timeout)
        return data

    def write(self, data: memoryview, timeout: float | None, counts: list[int]) -> int:
        try:
            counts.append(int(self._port.transmit(data, timeout)))
        except OSError as error:
            raise _gone(self._url) from error
        return counts[-1]


def _gone(url: str) -> PortGoneError:
    return PortGoneError(f"{url} is gone: unplugged, or closed at its other end")
