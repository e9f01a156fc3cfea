"""Every protocol over a connection, as a gateway has it: read, sent, recorded, and as a bus."""

import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import canser
from calls import BAD_CALL, GOOD, assert_fails, run
from device import PATIENCE, until
from readers import collect, content, traffic
from servers import Server

# Bytes come here faster than any line has them, and so the device's clock looks too slow.
pytestmark = pytest.mark.filterwarnings("ignore:.*the device clock:canser.CanserWarning")

PROTOCOLS = canser.protocols()

every_protocol = pytest.mark.parametrize("protocol", PROTOCOLS)


@pytest.fixture
def server() -> Iterator[Server]:
    with Server() as server:
        yield server


@every_protocol
def test_frames_are_read_and_sent(server: Server, protocol: str) -> None:
    frames = traffic(2, protocol)
    raw = canser.encode(frames, protocol)
    with canser.open(server.url, protocol) as port:
        server.say(raw)
        assert content(collect(port, len(frames))) == content(frames)
        assert port.stats.bytes_framed == len(raw)
        port.send(frames)
        until(lambda: len(server.heard) >= len(raw))
    assert server.heard == raw


@pytest.mark.skipif(sys.platform == "win32", reason="a signal ends the command")
@every_protocol
def test_the_command_records_what_comes(server: Server, protocol: str, tmp_path: Path) -> None:
    from beside import running  # noqa: PLC0415 - POSIX only

    frames = traffic(2, protocol)
    raw = canser.encode(frames, protocol)
    arguments = ("log", "-c", server.url, "-p", protocol, "--json", "run.pcapng")
    with running(tmp_path, *arguments) as command:
        server.say(raw)
        command.wait_object("status", bytes=len(raw))
        assert command.end(signal.SIGINT) == GOOD
    assert content(canser.read(tmp_path / "run.pcapng")) == content(frames)


@every_protocol
def test_messages_of_python_can(server: Server, protocol: str) -> None:
    can = pytest.importorskip("can")
    from canser.python_can.bus import CanserBus  # noqa: PLC0415 - needs python-can

    frames = traffic(0.2, protocol)
    with CanserBus(server.url, protocol=protocol) as bus:
        server.say(canser.encode(frames, protocol))
        for frame in frames:
            message = bus.recv(PATIENCE)
            assert message is not None
            assert message.arbitration_id == frame["id"]
            assert message.is_extended_id == frame["ext"]
            assert message.is_remote_frame == frame["rtr"]
            assert message.data == frame["data"][: frame["dlc"]].tobytes()
        bus.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=[1, 2, 3]))
        until(lambda: server.heard)
    (back,) = canser.decode(server.heard, protocol)
    assert (back["id"], back["dlc"], back["data"].tolist()) == (0x123, 3, [1, 2, 3, *bytes(5)])


@pytest.mark.parametrize(
    "protocol", [name for name in PROTOCOLS if not canser.protocol(name).configures]
)
def test_a_configuration_is_refused_where_adapters_take_none(
    server: Server, protocol: str, tmp_path: Path
) -> None:
    why = f"{protocol} adapters take no configuration; leave bitrate out"
    with pytest.raises(ValueError, match=f"^{why}$"):
        canser.open(server.url, protocol, bitrate=500_000)
    # In the command a bit rate alone is for the load of the bus.
    options = ("--bitrate", "500000", "--mode", "silent", "run.pcapng")
    assert_fails(run(tmp_path, "log", "-c", server.url, "-p", protocol, *options), BAD_CALL, why)
