"""Lines of every kind: all bytes pass both ways, nothing is eaten, changed or flushed."""

import contextlib
import errno
import fcntl
import os
import resource
import subprocess
import sys
import termios
import threading
from collections.abc import Callable, Iterator
from dataclasses import FrozenInstanceError
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from canser.errors import PortBusyError, PortError, PortGoneError, PortNotFoundError
from canser.live.config import LineConfig
from canser.live.line import Line, open_line
from device import PATIENCE, Device, descriptors, until
from servers import Server, TelnetServer

EVERY_BYTE = bytes(range(256)) + bytes(reversed(range(256)))


def read(line: Line, count: int) -> bytes:
    """Read so many bytes."""
    data = b""
    room = memoryview(bytearray(4096))
    while len(data) < count:
        got = line.read_into(room[: count - len(data)], PATIENCE)
        assert got, f"{len(data)} bytes came, {count} should"
        data += room[:got]
    return data


def write(line: Line, data: bytes) -> None:
    view = memoryview(data)
    while view:
        count = line.write(view, PATIENCE, [])
        assert count
        view = view[count:]


@contextlib.contextmanager
def opened(url: str, **options: Any) -> Iterator[Line]:
    line = open_line(url, LineConfig(baudrate=115_200, **options))
    try:
        yield line
    finally:
        line.close()


def test_a_pseudo_terminal_passes_every_byte() -> None:
    with Device() as device, opened(device.url) as line:
        device.feed(EVERY_BYTE)
        assert read(line, len(EVERY_BYTE)) == EVERY_BYTE
        write(line, EVERY_BYTE)
        assert device.read(len(EVERY_BYTE)) == EVERY_BYTE


def test_a_cooked_terminal_is_made_raw() -> None:
    with Device(cooked=True) as device, opened(device.url) as line:
        device.feed(EVERY_BYTE)
        assert read(line, len(EVERY_BYTE)) == EVERY_BYTE
        assert not device.hears(), "it echoes"
        write(line, EVERY_BYTE)
        assert device.read(len(EVERY_BYTE)) == EVERY_BYTE


def test_every_setting_that_changes_bytes_is_taken_back() -> None:
    with Device() as device:
        bad = termios.tcgetattr(device.slave)
        bad[0] |= termios.PARMRK | termios.INPCK | termios.ISTRIP | termios.IXOFF | termios.INLCR
        bad[1] |= termios.OPOST
        bad[2] = bad[2] & ~termios.CSIZE | termios.CS7 | termios.PARENB
        termios.tcsetattr(device.slave, termios.TCSANOW, bad)
        with opened(device.url) as line:
            device.feed(EVERY_BYTE)
            assert read(line, len(EVERY_BYTE)) == EVERY_BYTE


def test_a_driver_that_keeps_changing_bytes_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(termios, "tcsetattr", lambda *_: None)
    with (
        Device(cooked=True) as device,
        pytest.raises(PortError, match=f"{device.url} changes bytes on their way"),
    ):
        open_line(device.url, LineConfig(baudrate=115_200))


def test_a_socket_passes_every_byte() -> None:
    with Server() as server, opened(server.url) as line:
        server.say(EVERY_BYTE)
        assert read(line, len(EVERY_BYTE)) == EVERY_BYTE
        write(line, EVERY_BYTE)
        until(lambda: bytes(server.heard) == EVERY_BYTE)


# pyserial's own.
old_threads = pytest.mark.filterwarnings(
    "ignore:setDaemon:DeprecationWarning", "ignore:setName:DeprecationWarning"
)


@old_threads
def test_rfc2217_passes_every_byte() -> None:
    with TelnetServer() as server, opened(server.url) as line:
        server.say(EVERY_BYTE)
        assert read(line, len(EVERY_BYTE)) == EVERY_BYTE
        write(line, EVERY_BYTE)
        until(lambda: bytes(server.heard) == EVERY_BYTE)
        assert line.unwritten() == 0


@old_threads
def test_rfc2217_that_hangs_up_is_gone_after_its_last_byte() -> None:
    with TelnetServer() as server, opened(server.url) as line:
        server.say(EVERY_BYTE)
        server.hang_up()
        assert read(line, len(EVERY_BYTE)) == EVERY_BYTE
        with pytest.raises(PortGoneError, match="is gone"):
            line.read_into(memoryview(bytearray(10)), PATIENCE)


def test_loop_passes_every_byte() -> None:
    with opened("loop://") as line:
        write(line, EVERY_BYTE)
        assert read(line, len(EVERY_BYTE)) == EVERY_BYTE


def test_a_read_gives_what_is_there_not_one_byte() -> None:
    """On socket:// pyserial's in_waiting would make it one byte a call."""
    room = memoryview(bytearray(4096))
    with Server() as server, opened(server.url) as line:
        server.say(EVERY_BYTE)
        assert line.read_into(room, PATIENCE) == len(EVERY_BYTE)
    with opened("loop://") as line:
        write(line, EVERY_BYTE)
        assert line.read_into(room, PATIENCE) == len(EVERY_BYTE)


def test_bytes_that_wait_already_stay() -> None:
    with Device() as device:
        device.feed(b"early")
        device.fed()
        with opened(device.url) as line:
            device.feed(b" late")
            assert read(line, 10) == b"early late"


def test_bytes_that_wait_already_go_if_asked() -> None:
    with Device() as device:
        device.feed(b"early")
        device.fed()
        until(device.waiting)
        with opened(device.url, flush=True) as line:
            assert not device.waiting()
            device.feed(b"late")
            assert read(line, 4) == b"late"


def test_a_read_ends_after_its_timeout() -> None:
    room = memoryview(bytearray(10))
    with Device() as device, opened(device.url) as line:
        assert line.read_into(room, 0) == 0
        assert line.read_into(room, 0.001) == 0
    with opened("loop://") as line:
        assert line.read_into(room, 0.001) == 0


@pytest.mark.parametrize("kind", ["pty", "loop"])
def test_a_read_ends_when_it_is_woken(kind: str) -> None:
    with Device() as device, opened(device.url if kind == "pty" else "loop://") as line:
        counts: list[int] = []

        def wait() -> None:
            counts.append(line.read_into(memoryview(bytearray(10)), None))

        reader = threading.Thread(target=wait, daemon=True)
        reader.start()
        line.wake()
        reader.join(PATIENCE)
        assert counts == [0]


def test_a_write_ends_after_its_timeout() -> None:
    with Device() as device, opened(device.url) as line:
        while line.write(memoryview(bytes(4096)), 0.02, []):
            pass
        assert device.read(100) == bytes(100)


def test_what_the_system_still_holds_is_told() -> None:
    with Server() as server, opened(server.url) as line:
        write(line, EVERY_BYTE)
        until(lambda: line.unwritten() == 0)
    with Device() as device, opened(device.url) as line:
        assert line.unwritten() == 0


@pytest.fixture
def many_descriptors() -> Iterator[None]:
    """Leave no descriptor under 1024 free."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < 2048:
        pytest.skip(f"this user may open {hard} files only")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2048), hard))
    taken = [os.open(os.devnull, os.O_RDONLY)]
    while taken[-1] < 1100:
        taken.append(os.dup(taken[0]))
    try:
        yield
    finally:
        for fd in taken:
            os.close(fd)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.usefixtures("many_descriptors")
@pytest.mark.parametrize("kind", ["pty", "socket"])
def test_descriptors_above_1024_will_do(kind: str) -> None:
    with (
        Device() as device,
        Server() as server,
        opened(device.url if kind == "pty" else server.url) as line,
    ):
        if kind == "pty":
            device.feed(EVERY_BYTE)
        else:
            server.say(EVERY_BYTE)
        assert read(line, len(EVERY_BYTE)) == EVERY_BYTE
        assert line.read_into(memoryview(bytearray(10)), 0.001) == 0
        write(line, EVERY_BYTE)
        if kind == "pty":
            assert device.read(len(EVERY_BYTE)) == EVERY_BYTE
            while line.write(memoryview(bytes(4096)), 0.02, []):  # until it has to wait
                pass


def test_a_second_open_is_refused_and_harms_nothing() -> None:
    with Device() as device, opened(device.url) as line:
        device.feed(b"first's")
        device.fed()
        with pytest.raises(PortBusyError, match="open in another program; close it there"):
            open_line(device.url, LineConfig(baudrate=9600))
        assert read(line, 7) == b"first's"
    with Device() as device:
        open_line(device.url, LineConfig(baudrate=115_200)).close()
        open_line(device.url, LineConfig(baudrate=115_200)).close()


# What pyserial asks the system for, to switch modem lines on and off.
SWITCHES = {
    (termios.TIOCMBIS, termios.TIOCM_DTR): "dtr on",
    (termios.TIOCMBIC, termios.TIOCM_DTR): "dtr off",
    (termios.TIOCMBIS, termios.TIOCM_RTS): "rts on",
    (termios.TIOCMBIC, termios.TIOCM_RTS): "rts off",
}


@pytest.mark.parametrize(
    ("options", "switched"),
    [
        ({}, ["dtr on", "rts on"]),  # as opening does
        ({"dtr": "off"}, ["dtr off", "rts on"]),
        ({"rts": "off"}, ["dtr on", "rts off"]),
        ({"dtr": "off", "rts": "off"}, ["dtr off", "rts off"]),
        ({"dtr": "on", "rts": "on"}, ["dtr on", "rts on"]),
    ],
    ids=str,
)
def test_modem_lines_have_one_level_from_the_first_moment(
    monkeypatch: pytest.MonkeyPatch, options: dict[str, str], switched: list[str]
) -> None:
    """A pseudo terminal takes the part of a serial device, whose driver knows modem lines."""
    seen: list[str] = []
    ioctl = fcntl.ioctl

    def driver(fd: int, request: int, *rest: Any) -> Any:
        if request not in (termios.TIOCMBIS, termios.TIOCMBIC):
            return ioctl(fd, request, *rest)
        seen.append(SWITCHES[request, int.from_bytes(rest[0], sys.byteorder)])
        return 0

    with Device() as device:
        monkeypatch.setattr(fcntl, "ioctl", driver)
        with opened(device.url, **options):
            assert set(seen) == set(switched)


@pytest.mark.parametrize("name", ["dtr", "rts"])
@pytest.mark.parametrize("level", ["on", "off"])
def test_modem_lines_that_are_not_there(name: str, level: str) -> None:
    before = descriptors()
    with Device() as device:
        why = f"^{device.url} has no modem lines .*, so {name} cannot be set; leave {name} out$"
        with pytest.raises(ValueError, match=why):
            open_line(device.url, LineConfig(baudrate=115_200, **{name: level}))  # type: ignore[arg-type]
        with opened(device.url, **{name: "leave"}):
            pass
    why = f"^socket://127.0.0.1:1 carries no modem lines, so {name} cannot be set; use rfc2217://"
    with pytest.raises(ValueError, match=why):  # before it is looked for
        open_line("socket://127.0.0.1:1", LineConfig(baudrate=115_200, **{name: level}))  # type: ignore[arg-type]
    assert descriptors() == before


@old_threads
def test_modem_lines_over_rfc2217() -> None:
    with TelnetServer() as server, opened(server.url, dtr="off", rts="on"):
        port = server.manager.serial
        until(lambda: (port.dtr, port.rts) == (False, True))


def test_an_error_of_a_modem_line_closes_the_port(monkeypatch: pytest.MonkeyPatch) -> None:
    ioctl = fcntl.ioctl

    def driver(fd: int, request: int, *rest: Any) -> Any:
        if request == termios.TIOCMBIC:
            raise OSError(errno.EINVAL if not seen else errno.EIO, "no")
        return ioctl(fd, request, *rest)

    before = descriptors()
    with Device() as device:
        seen = True
        monkeypatch.setattr(fcntl, "ioctl", driver)
        with pytest.raises(PortNotFoundError, match=f"there is no port {device.url}"):
            open_line(device.url, LineConfig(baudrate=115_200, dtr="off"))
        seen = False
        with pytest.raises(ValueError, match="has no modem lines"):
            open_line(device.url, LineConfig(baudrate=115_200, dtr="off"))
    assert descriptors() == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dtr": "up"}, "unknown dtr 'up'; have: leave, on, off"),
        ({"rts": True}, "unknown rts True; have: leave, on, off"),
        ({"baudrate": 0}, "baudrate is 0; it must be 1 or more"),
        ({"ring_size": 1000}, "ring_size is 1000; it must be 65536 or more"),
        ({"ping": 0}, "ping is 0; it must be more than 0 seconds, and not infinite"),
        ({"ping": float("nan")}, "ping is nan"),
    ],
)
def test_a_line_config_is_checked_when_it_is_made(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        LineConfig(**options)


def test_a_line_config_holds_plain_values_and_stays() -> None:
    config = LineConfig(baudrate=np.int32(9600), flush=np.True_, ping=Fraction(1, 2))  # type: ignore[arg-type]
    assert config == LineConfig(baudrate=9600, flush=True, ping=0.5)
    kinds = [type(value) for value in (config.baudrate, config.flush, config.ping)]
    assert kinds == [int, bool, float]
    with pytest.raises(FrozenInstanceError):
        config.flush = False  # type: ignore[misc]


@pytest.mark.parametrize(
    ("url", "error", "message"),
    [
        ("/dev/no-such-port", PortNotFoundError, "there is no port /dev/no-such-port"),
        ("/etc/hostname", PortError, "no serial port; files are read by canser.read"),
        ("/", PortError, "/ is no serial port"),
        ("socket://127.0.0.1:1", PortNotFoundError, "no server answers at socket://127.0.0.1:1"),
        ("socket://127.0.0.1", ValueError, "host or port is missing; write socket://host:port"),
        ("socket://:5000", ValueError, "host or port is missing"),
        ("socket://host:port", ValueError, "write socket://host:port"),
        ("socket://host:99999", ValueError, "write socket://host:port"),
        ("rfc2217://127.0.0.1:1", PortError, "cannot open rfc2217://127.0.0.1:1"),
        ("nonsense://", ValueError, "cannot open 'nonsense://'"),
        ("", PortError, "''|no port"),
    ],
)
def test_what_cannot_be_opened(url: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message) as caught:
        open_line(url, LineConfig(baudrate=115_200))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("url", "error"),
    [
        ("hwgrep://no such port", PortNotFoundError),
        ("hwgrep://.&foo", ValueError),
        ("hwgrep://[", ValueError),
        ("spy:///dev/no-such-port", PortNotFoundError),
        ("spy:///dev/null?file=/no/such/folder", ValueError),
        ("alt:///dev/no-such-port", PortNotFoundError),
        ("alt:///dev/null?class=Nothing", ValueError),
        ("loop://?bad", ValueError),
        ("loop://?logging=bad", ValueError),
        ("rfc2217://", ValueError),
        ("rfc2217://host", ValueError),
        ("rfc2217://host:port", ValueError),
        ("rfc2217://127.0.0.1:1", PortNotFoundError),
        ("rfc2217://127.0.0.1:1?bad", PortError),
        ("rfc2217://no-such-host.invalid:1", PortNotFoundError),
        ("socket://[::1:1", ValueError),
        ("socket://127.0.0.1:1", PortNotFoundError),
        ("socket://" + "a" * 300 + ":1", ValueError),
        ("socket://a..b:1", ValueError),
        ("unknown://x", ValueError),
        ("a\0b", ValueError),
        ("/dev/null", PortError),
        ("/dev/full", PortError),
        ("/etc/passwd/x", PortError),
        ("/dev/" + "x" * 300, PortError),
    ],
)
def test_every_error_of_opening_names_the_url(url: str, error: type[Exception]) -> None:
    before = descriptors()
    with pytest.raises(error) as caught:
        open_line(url, LineConfig(baudrate=115_200))
    text = str(caught.value)
    assert url in text or repr(url) in text
    assert "\n" not in text
    assert "[Errno" not in text or "file=" in url
    assert type(caught.value) in (ValueError, PortError, PortNotFoundError)
    assert descriptors() == before


def test_an_empty_url() -> None:
    with pytest.raises(PortNotFoundError, match="url is empty"):
        open_line("", LineConfig(baudrate=115_200))


def test_without_a_free_descriptor_the_line_is_closed_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail() -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    with Device() as device, Server() as server:
        before = descriptors()
        with monkeypatch.context() as patched:
            patched.setattr(os, "pipe", fail)
            for url in (device.url, server.url):
                with pytest.raises(PortError, match=f"{url}: Too many open files; .*ulimit -n"):
                    open_line(url, LineConfig(baudrate=115_200))
        # The server's own end may be there still, or not yet.
        server.hang_up()
        until(lambda: descriptors() <= before)
        with opened(device.url):
            pass


def test_an_error_of_the_system_names_the_url(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))

    with Device() as device, opened(device.url) as line:
        device.write(b"1")
        room = memoryview(bytearray(10))
        calls: list[tuple[Any, str, Callable[[], int]]] = [
            (os, "readv", lambda: line.read_into(room, PATIENCE)),
            (os, "write", lambda: line.write(memoryview(b"1"), PATIENCE, [])),
            (fcntl, "ioctl", line.unwritten),
        ]
        for module, name, call in calls:
            with monkeypatch.context() as patched:
                patched.setattr(module, name, fail)
                with pytest.raises(PortError, match=f"^{device.url}: Cannot allocate memory$"):
                    call()


def test_a_rate_that_makes_no_sense() -> None:
    with Device() as device, pytest.raises(ValueError, match="baud"):
        open_line(device.url, LineConfig(baudrate=2**40))


def test_a_port_that_vanishes_while_it_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    """The module termios has an error of its own, which is no OSError."""

    def vanish(*_: object) -> None:
        raise termios.error(5, "Input/output error")

    with Device() as device:
        before = descriptors()
        monkeypatch.setattr("canser.live.line._make_raw", vanish)
        with pytest.raises(PortNotFoundError, match=f"there is no port {device.url}"):
            open_line(device.url, LineConfig(baudrate=115_200))
        assert descriptors() == before


def test_a_program_that_is_killed_leaves_the_port_free() -> None:
    program = (
        "import sys; from canser import LineConfig; from canser.live.line import open_line\n"
        "line = open_line(sys.argv[1], LineConfig(baudrate=115_200)); print('open', flush=True)\n"
        "line.read_into(memoryview(bytearray(10)), None)"
    )
    with Device() as device:
        with subprocess.Popen(
            [sys.executable, "-c", program, device.url], stdout=subprocess.PIPE
        ) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"open\n"
            with pytest.raises(PortBusyError):
                open_line(device.url, LineConfig(baudrate=115_200))
            process.kill()
        with opened(device.url) as line:
            device.feed(b"on")
            assert read(line, 2) == b"on"


def test_the_module_can_be_imported_without_termios() -> None:
    """As on Windows, where neither it nor fcntl, grp and poll() are there."""
    program = (
        "import sys; import numpy, cffi, select; sys.platform = 'win32'\n"
        "for name in ('termios', 'fcntl', 'grp', 'pty', 'tty'): sys.modules[name] = None\n"
        "del select.poll\n"
        "from canser.live import line, ports, reader, ring, stream"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
