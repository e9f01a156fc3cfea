"""Opening a line that takes its time: a wish to stop does not wait for it."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import canser
from canser.commands.cli import main
from canser.live import tcp
from canser.live.connecting import connect_aside
from device import PATIENCE, descriptors, until
from servers import Server, TelnetServer

INTERRUPTED = 130

FRAME = canser.encode(canser.frames("123#DEADBEEF"), "seeed")

pytestmark = [
    pytest.mark.filterwarnings("ignore:setDaemon:DeprecationWarning"),  # pyserial's own
    pytest.mark.filterwarnings("ignore:setName:DeprecationWarning"),
]


class NameServer:
    """A look-up of names that takes until `answer`. As the system's, no signal interrupts it."""

    def __init__(self) -> None:
        self.asked, self.answer = threading.Event(), threading.Event()
        self._look_up = socket.getaddrinfo

    def getaddrinfo(self, *args: Any, **options: Any) -> Any:
        self.asked.set()
        deadline = time.monotonic() + PATIENCE
        while not self.answer.is_set() and time.monotonic() < deadline:
            with contextlib.suppress(KeyboardInterrupt):
                self.answer.wait(0.01)
        return self._look_up(*args, **options)


@pytest.fixture
def names(monkeypatch: pytest.MonkeyPatch) -> Iterator[NameServer]:
    server = NameServer()
    monkeypatch.setattr(socket, "getaddrinfo", server.getaddrinfo)
    yield server
    server.answer.set()
    until(lambda: not connecting())


def connecting() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "canser connecting"]


@pytest.fixture
def silent() -> Iterator[int]:
    """Return the port of a server that answers no connection: it has as many as it takes."""
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(socket.socket())
        server.bind(("127.0.0.1", 0))
        server.listen(0)
        for _ in range(2):
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(server.getsockname())
        until(lambda: waits_in_vain(server.getsockname()))
        yield server.getsockname()[1]


def waits_in_vain(address: tuple[str, int]) -> bool:
    with socket.socket() as client:
        client.settimeout(0.1)
        return client.connect_ex(address) != 0


@contextlib.contextmanager
def interrupted_when(event: threading.Event) -> Iterator[None]:
    """Send this process a SIGINT when something has happened."""

    def interrupt() -> None:
        assert event.wait(PATIENCE)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        yield
    thread.join()


@pytest.mark.parametrize("kind", [Server, TelnetServer])
def test_ctrl_c_does_not_wait_for_a_name_server(names: NameServer, kind: type[Server]) -> None:
    with kind() as server:
        with interrupted_when(names.asked):
            canser.open(server.url, "seeed")
        assert len(connecting()) == 1, "it waits still"
        before = descriptors()
        names.answer.set()
        assert server.here.wait(PATIENCE), "the connection comes about"
        server._thread.join(PATIENCE)
        assert not server._thread.is_alive(), "and is closed at once"
        until(lambda: not connecting())
        assert descriptors() <= before


@pytest.mark.parametrize("command", ["log", "play"])
def test_ctrl_c_ends_a_command_that_waits_for_a_name_server(
    names: NameServer, command: str, tmp_path: Path
) -> None:
    (tmp_path / "sent.log").write_text("(1.0) can0 123#11\n")
    file = tmp_path / ("run.pcapng" if command == "log" else "sent.log")

    def interrupt() -> None:
        assert names.asked.wait(PATIENCE)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    url = "socket://localhost:1"
    assert main([command, "-c", url, "-p", "seeed", str(file)]) == INTERRUPTED
    assert not names.answer.is_set()
    thread.join()
    assert [path.name for path in tmp_path.iterdir()] == ["sent.log"]


def test_a_silent_server_is_an_error_after_the_time_limit(
    monkeypatch: pytest.MonkeyPatch, silent: int
) -> None:
    assert tcp._CONNECT_TIMEOUT_S == 5
    monkeypatch.setattr(tcp, "_CONNECT_TIMEOUT_S", 0.1)
    url = f"socket://127.0.0.1:{silent}"
    why = f"^no server answers at {url}: timed out; is the server running\\?$"
    with pytest.raises(canser.PortNotFoundError, match=why):
        canser.open(url, "seeed")


def test_close_does_not_wait_for_a_reconnect(names: NameServer) -> None:
    names.answer.set()
    with Server() as server:
        port = canser.open(server.url, "seeed", reconnect=True)
        server.say(FRAME)
        assert len(port.read_batch(timeout=PATIENCE)) == 1
        names.answer.clear()
        names.asked.clear()
        server.hang_up()
        assert names.asked.wait(PATIENCE)
        port.close()
        assert len(connecting()) == 1, "it waits still"
        assert not port._reader._thread.is_alive()
    with pytest.raises(canser.PortClosedError):
        port.read_batch()


def test_the_program_ends_while_a_name_server_is_asked() -> None:
    program = (
        "import sys, socket, threading, canser\n"
        "def ask(*_, **__): print('asked', flush=True); threading.Event().wait()\n"
        "socket.getaddrinfo = ask\n"
        "canser.open('socket://host:1', 'seeed')"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"asked\n"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE)
    assert errors.rstrip().endswith(b"KeyboardInterrupt")
    assert process.returncode == -signal.SIGINT


def test_an_attempt_that_ends_soon_is_waited_for() -> None:
    """A device is configured within 0.1 s. After `close` the next program must find it free."""
    stop, line = threading.Event(), object()

    def connect() -> Any:
        stop.set()
        time.sleep(0.1)
        return line

    assert connect_aside("url", connect, stop) is line
