"""A peer that vanishes without a word is noticed, in a network of the test's own."""

import errno
import json
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from canser.errors import PortGoneError
from canser.live import tcp
from canser.live.config import LineConfig
from canser.live.line import open_line
from device import PATIENCE
from servers import Server, TelnetServer

HERE = Path(__file__).parent

# Ports of both kinds, with the times of `tcp` made short. Some only read, some only write, one
# comes back. The program prints what became of each.
PROGRAM = """
import json, os, socket, subprocess, threading, time, warnings
warnings.simplefilter("ignore")  # pyserial sets names of threads in an old way
import canser
from canser.live import tcp
from device import until
from servers import Server, TelnetServer

LIMIT_S = 30.0
FRAME = canser.encode(canser.frames("123#DEADBEEF"), "seeed")
results = {}
tcp._IDLE_S = tcp._INTERVAL_S = 1
tcp._PROBES, tcp._UNACKNOWLEDGED_MS = 2, 3000

def network(state):
    subprocess.run(["ip", "link", "set", "lo", state], check=True)

def reads(port):
    return len(port.read_batch(timeout=LIMIT_S))

def writes(port):
    deadline = time.monotonic() + LIMIT_S
    while time.monotonic() < deadline:
        port.send("123#DEADBEEF", timeout=LIMIT_S)
        time.sleep(0.05)

def watch(name, call, port):
    try:
        results[name] = "nothing", str(call(port))
    except canser.CanserError as error:
        results[name] = type(error).__name__, str(error)

network("up")
threads = []
for kind, make in (("socket", Server), ("rfc2217", TelnetServer)):
    for call in (reads, writes):
        server = make()
        port = canser.open(server.url, "seeed")
        server.say(FRAME)
        assert len(port.read_batch(timeout=LIMIT_S)) == 1
        name = f"{kind} {call.__name__}"
        threads.append(threading.Thread(target=watch, args=(name, call, port), daemon=True))
listening = socket.create_server(("127.0.0.1", 0))
url = f"socket://127.0.0.1:{listening.getsockname()[1]}"
returning = canser.open(url, "seeed", reconnect=True)
before = listening.accept()[0]
network("down")
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
until(lambda: returning._reader._line is None)
network("up")
again = listening.accept()[0]
again.sendall(FRAME)
count = len(returning.read_batch(timeout=LIMIT_S))
results["comes back"] = count, [gap.reason for gap in returning.take_gaps()]
print(json.dumps(results), flush=True)
os._exit(0)
"""


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    """Return what became of the ports of the program."""
    for tool in ("unshare", "ip"):
        if shutil.which(tool) is None:
            pytest.skip(f"there is no {tool} here, for a network of the test's own")
    own = ["unshare", "--map-root-user", "--net"]
    tried = subprocess.run(
        [*own, "ip", "link", "set", "lo", "up"], capture_output=True, text=True, check=False
    )
    if tried.returncode:
        pytest.skip(f"a network of the test's own is not allowed here: {tried.stderr.strip()}")
    paths = [str(HERE / "helpers"), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [*own, sys.executable, "-c", PROGRAM],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("kind", ["socket", "rfc2217"])
def test_who_reads_hears_that_the_peer_is_dead(results: dict[str, Any], kind: str) -> None:
    name, text = results[f"{kind} reads"]
    assert name == "PortGoneError"
    assert text.startswith(f"{kind}://127.0.0.1:")
    assert " is gone: " in text


@pytest.mark.parametrize("kind", ["socket", "rfc2217"])
def test_who_writes_hears_that_the_peer_is_dead(results: dict[str, Any], kind: str) -> None:
    name, text = results[f"{kind} writes"]
    assert name == "SendError"
    assert "the device is gone; 0 of 1 frames were sent" in text


def test_a_port_that_may_comes_back_when_the_network_does(results: dict[str, Any]) -> None:
    assert results["comes back"] == [1, ["reconnect"]]


@pytest.mark.filterwarnings("ignore:setDaemon:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:setName:DeprecationWarning")
@pytest.mark.skipif(sys.platform != "linux", reason="these options are Linux'")
@pytest.mark.parametrize("kind", [Server, TelnetServer])
def test_the_system_asks_a_silent_peer_and_gives_up_in_16_s(kind: type[Server]) -> None:
    with kind() as server:
        line: Any = open_line(server.url, LineConfig(baudrate=115_200))
        try:
            connection = line._source if kind is Server else line._port._socket
            asked = {
                name: connection.getsockopt(socket.IPPROTO_TCP, getattr(socket, name))
                for name in ("TCP_KEEPIDLE", "TCP_KEEPINTVL", "TCP_KEEPCNT", "TCP_USER_TIMEOUT")
            }
            assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        finally:
            line.close()
    assert list(asked.values()) == [10, 2, 3, 15_000]


class Connection:
    """A connection that takes note of what it is set to."""

    def __init__(self) -> None:
        self.asked: list[tuple[Any, ...]] = []

    def setsockopt(self, *option: int) -> None:
        self.asked.append(option)

    def ioctl(self, *control: Any) -> None:
        self.asked.append(control)


def test_macos_is_asked_by_the_names_that_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    for name in ("TCP_KEEPIDLE", "TCP_USER_TIMEOUT"):
        monkeypatch.delattr(socket, name, raising=False)
    names = {"TCP_KEEPALIVE": 0x10, "TCP_KEEPINTVL": 0x101, "TCP_KEEPCNT": 0x102}
    for name, number in names.items():
        monkeypatch.setattr(socket, name, number, raising=False)
    connection: Any = Connection()
    tcp.notice_dead_peer(connection)
    tcp_level = socket.IPPROTO_TCP
    assert connection.asked == [
        (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
        (tcp_level, 0x10, 10),
        (tcp_level, 0x101, 2),
        (tcp_level, 0x102, 3),
    ]


def test_an_old_windows_is_asked_by_a_control_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.delattr(socket, "TCP_KEEPIDLE", raising=False)
    monkeypatch.setattr(socket, "SIO_KEEPALIVE_VALS", 0x98000004, raising=False)
    connection: Any = Connection()
    tcp.notice_dead_peer(connection)
    assert connection.asked[1:] == [(0x98000004, (1, 10_000, 2000))]


@pytest.mark.parametrize(
    "number",
    [errno.ETIMEDOUT, errno.EHOSTUNREACH, errno.EHOSTDOWN, errno.ENETUNREACH, errno.ENETDOWN],
)
def test_a_network_that_is_down_means_that_the_line_is_gone(
    monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def fail(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    with Server() as server:
        line = open_line(server.url, LineConfig(baudrate=115_200))
        try:
            server.say(b"1")
            why = f"^{server.url} is gone: {os.strerror(number)}; is its server on, and the network"
            with monkeypatch.context() as patched:
                patched.setattr(os, "readv", fail)
                with pytest.raises(PortGoneError, match=why):
                    line.read_into(memoryview(bytearray(10)), PATIENCE)
                patched.setattr(os, "write", fail)
                with pytest.raises(PortGoneError, match=why):
                    line.write(memoryview(b"1"), PATIENCE, [])
        finally:
            line.close()
