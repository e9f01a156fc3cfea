"""A slow server of RFC 2217 is not gone, and time-outs are those of the caller."""

import contextlib
import itertools
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

import canser
from canser.errors import PortError
from canser.live.config import LineConfig
from canser.live.line import Line, open_line
from device import PATIENCE, until
from servers import TelnetServer

pytestmark = [
    pytest.mark.filterwarnings("ignore:setDaemon:DeprecationWarning"),  # pyserial's own
    pytest.mark.filterwarnings("ignore:setName:DeprecationWarning"),
]

CONFIG = LineConfig(baudrate=115_200)

# Every byte, and those that are doubled in rows of every parity.
DATA = bytes(range(256)) + b"\xff" * 1001 + b"\xff\x00" * 50 + b"\xfe\xff\xff\xff\xfd"


class SlowServer(TelnetServer):
    """A server that takes nothing while `busy`, and little before that."""

    def __init__(self) -> None:
        self.free = threading.Event()
        self.free.set()
        self.answers = bytearray()  # of the client, as they came
        super().__init__()
        self._listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)

    def __exit__(self, *_: object) -> None:
        self.free.set()
        super().__exit__()

    def hear(self, data: bytes) -> None:
        self.answers += data
        super().hear(data)
        assert self.free.wait(PATIENCE)


@contextlib.contextmanager
def opened(server: TelnetServer, config: LineConfig = CONFIG, query: str = "") -> Iterator[Line]:
    line = open_line(server.url + query, config)
    try:
        yield line
    finally:
        line.close()


def fill(server: SlowServer, line: Any) -> bytes:
    """Write until neither the server nor the connection takes more; return what was written."""
    line._port._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    server.free.clear()
    written = bytearray()
    while True:
        data = memoryview(DATA[len(written) % len(DATA) :])
        count = line.write(data, 0.2, [])
        if not count:
            return bytes(written)
        written += data[:count]


def test_a_server_that_takes_nothing_for_a_while_is_not_gone() -> None:
    with SlowServer() as server, opened(server) as line:
        written = fill(server, line)
        begin = time.monotonic()
        for timeout in [0.01, 0] * 10:  # the system may find a little more room
            written += DATA[: line.write(memoryview(DATA), timeout, [])]
        assert time.monotonic() - begin < 2.5, "pyserial's own time-out is 5 s"
        server.free.set()
        assert line.write(memoryview(b"on"), PATIENCE, []) == 2
        until(lambda: len(server.heard) == len(written) + 2)
        assert bytes(server.heard) == written + b"on"


def test_sending_to_a_slow_server_ends_by_the_time_out_and_so_does_close() -> None:
    frames = canser.frames(["123#DEADBEEF"] * 100_000)

    def send_on() -> None:
        while True:
            port.send(frames, timeout=0.1)

    with SlowServer() as server:
        port = canser.open(server.url, "seeed")
        server.free.clear()
        with pytest.raises(canser.SendTimeoutError, match="took no more within the time-out"):
            send_on()
        server.say(canser.encode(frames[:1], "seeed"))
        assert len(port.read_batch(timeout=PATIENCE)) == 1, "it is there still"
        port.close()
        assert not server.free.is_set()


def test_a_command_that_the_server_does_not_take_at_once_goes_out_later() -> None:
    """The thread of pyserial would wait 5 s for it, read nothing meanwhile, and end."""
    echo, status = b"\xff\xfd\x7f", b"\xff\xfc\x7f"  # do what is not known; I will not
    with SlowServer() as server, opened(server) as line:
        written = fill(server, line)
        server.write(echo)
        server.say(b"still here")
        room = memoryview(bytearray(100))
        assert line.read_into(room, PATIENCE)
        assert status not in server.answers
        until(lambda: line.unwritten() == len(status) or line.unwritten() == len(status) + 1)
        server.free.set()
        until(lambda: line.unwritten() == 0)
        until(lambda: status in server.answers)
        until(lambda: len(server.heard) == len(written))
        assert bytes(server.heard) == written


@pytest.mark.parametrize("size", [1, 2, 3])
def test_a_doubled_byte_that_is_cut_in_two_stays_one(size: int) -> None:
    class Narrow:
        """A connection that takes few bytes at a time."""

        def __init__(self, connection: socket.socket) -> None:
            self._connection = connection
            self._sizes = itertools.cycle([size, 1])

        def send(self, data: bytes) -> int:
            return self._connection.send(data[: next(self._sizes)])

        def __getattr__(self, name: str) -> Any:
            return getattr(self._connection, name)

    with TelnetServer() as server, opened(server) as line:
        port: Any = line._port  # type: ignore[attr-defined]
        port._socket = Narrow(port._socket)
        data = memoryview(DATA)
        while data:
            data = data[line.write(data, PATIENCE, []) :]
            port.telnet_send_option(b"\xfc", b"\x7f")  # in the middle of everything
        until(lambda: line.unwritten() == 0)
        until(lambda: len(server.heard) == len(DATA))
        assert bytes(server.heard) == DATA


def test_a_read_ends_after_its_timeout() -> None:
    room = memoryview(bytearray(10))
    with TelnetServer() as server, opened(server) as line:
        begin = time.monotonic()
        for _ in range(50):
            assert line.read_into(room, 0.001) == 0
        assert time.monotonic() - begin < 2.5, "pyserial's own time-out is 0.1 s"


class MuteServer(TelnetServer):
    """A server that does not answer when it is asked to purge its buffers."""

    def write(self, data: bytes) -> None:
        if not data.startswith(b"\xff\xfa\x2c\x70"):  # SERVER_PURGE_DATA
            super().write(data)


def test_a_purge_without_an_answer_matters_only_where_it_was_asked_for() -> None:
    with MuteServer() as server, opened(server, query="?timeout=0.3") as line:
        server.say(b"here")
        assert line.read_into(memoryview(bytearray(10)), PATIENCE)
    with MuteServer() as server:
        why = (
            r"^cannot open .*\?timeout=0.3 at 115200 baud: its server did not answer within 0.3 s; "
            r"is it one of RFC 2217\? A slow one needs \?timeout=0.6 in the URL$"
        )
        with pytest.raises(PortError, match=why):
            open_line(f"{server.url}?timeout=0.3", LineConfig(baudrate=115_200, flush=True))


def test_a_command_that_makes_no_sense_ends_the_line_behind_what_came_before() -> None:
    """The thread of pyserial ends there, without a word to its readers."""
    with TelnetServer() as server, opened(server) as line:
        server.write(b"last\xff\xf0")  # the end of a command that has not begun
        room = memoryview(bytearray(10))
        assert line.read_into(room, PATIENCE) == 4
        assert bytes(room[:4]) == b"last"
        for _ in range(2):
            with pytest.raises(canser.PortGoneError):
                line.read_into(room, PATIENCE)
