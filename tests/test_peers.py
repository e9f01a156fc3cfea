"""python-can's own buses at the other end of a pseudo terminal: all frames there, all equal."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

can = pytest.importorskip("can")
pytest.importorskip("termios", reason="pseudo terminals are POSIX's")

from can.interfaces.seeedstudio.seeedstudio import SeeedBus  # noqa: E402
from can.interfaces.serial.serial_can import SerialBus  # noqa: E402

import shared  # noqa: E402
from canser.python_can.bus import CanserBus  # noqa: E402
from device import PATIENCE  # noqa: E402
from long import LONG, longer  # noqa: E402
from wires import linked  # noqa: E402

pytestmark = [shared.needs_captures, longer]

PEERS: dict[str, Callable[..., Any]] = {"serial": SerialBus, "seeed": SeeedBus}

COUNT = 100_000 if LONG else 10_000


@pytest.fixture(scope="module")
def traffic() -> list[Any]:
    """Return the messages of the logs, one behind the other, times in seconds from the first."""
    messages = []
    begin = 0
    for log in shared.LOGS:
        frames = shared.expected(log)
        times = begin + frames["ts"] - frames["ts"][0]
        begin = int(times[-1])
        messages += [
            can.Message(
                timestamp=ts / 1e9,
                arbitration_id=number,
                is_extended_id=ext,
                data=data[:dlc],
            )
            for ts, number, ext, dlc, data in zip(
                times.tolist(),
                frames["id"].tolist(),
                frames["ext"].tolist(),
                frames["dlc"].tolist(),
                frames["data"].tolist(),
                strict=True,
            )
        ]
    assert len(messages) >= COUNT
    chosen = messages[:: len(messages) // COUNT][:COUNT]
    kinds = {(message.is_extended_id, message.dlc) for message in chosen}
    assert {(False, 8), (False, 2), (True, 8)} <= kinds
    return chosen


@pytest.fixture(params=PEERS)
def pair(request: pytest.FixtureRequest) -> Iterator[tuple[CanserBus, Any]]:
    # A peer gives up in the middle of a frame after its time-out.
    with (
        linked() as (first, second),
        CanserBus(first, protocol=request.param) as ours,
        PEERS[request.param](second, timeout=PATIENCE) as peer,
    ):
        yield ours, peer


@contextmanager
def sent(bus: Any, messages: list[Any]) -> Iterator[None]:
    """Have messages sent meanwhile."""

    def send() -> None:
        for message in messages:
            bus.send(message)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        thread.join()


def come(bus: Any, count: int) -> Iterator[Any]:
    while count:
        message = bus.recv(PATIENCE)
        assert message is not None, f"{count} messages did not come"
        count -= 1
        yield message


def ticks(messages: list[Any]) -> list[int]:
    """Return times that were read from the line, in milliseconds."""
    return [round(message.timestamp * 1000) for message in messages]


def assert_equal(got: list[Any], want: list[Any]) -> None:
    assert len(got) == len(want)
    for one, other in zip(got, want, strict=True):
        assert one.equals(other, timestamp_delta=None), (one, other)


def test_all_that_a_peer_sends_is_received(pair: tuple[CanserBus, Any], traffic: list[Any]) -> None:
    ours, peer = pair
    with sent(peer, traffic):
        got = list(come(ours, COUNT))
    assert_equal(got, traffic)
    stats = ours.port.stats
    assert stats.frames == COUNT
    assert stats.bytes_skipped == stats.pending == ours.port.bytes_lost == 0
    if ours.port.protocol == "serial":
        # As the peer cuts them, in floating point.
        assert ticks(got) == [int(message.timestamp * 1000) for message in traffic]


def test_all_that_is_sent_is_received_by_a_peer(
    pair: tuple[CanserBus, Any], traffic: list[Any]
) -> None:
    ours, peer = pair
    with sent(ours, traffic):
        got = list(come(peer, COUNT))
    assert_equal(got, traffic)
    if ours.port.protocol == "serial":
        assert ticks(got) == [round(message.timestamp * 1e9) // 10**6 for message in traffic]
