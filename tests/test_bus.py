"""The bus of python-can: what python-can's tests ask of its own serial bus, and what is ours."""

import asyncio
import gc
import logging
import math
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

can = pytest.importorskip("can")
pytest.importorskip("termios", reason="pseudo terminals are POSIX's")

import canser  # noqa: E402
from canser._frames import FrameArray  # noqa: E402
from canser.python_can.bus import CanserBus  # noqa: E402
from canser.simulation.simulator import Simulator  # noqa: E402
from canser.simulation.traffic import vehicle  # noqa: E402
from device import PATIENCE, Device  # noqa: E402
from plugins import needs_installation  # noqa: E402
from readers import read_config  # noqa: E402
from reference import Frame  # noqa: E402
from samples import EPOCH, array, listed  # noqa: E402
from wires import echo, linked  # noqa: E402

pytestmark = needs_installation

CLOCK_END = 0xFFFF_FFFF / 1000  # of a counter of 32 bits in milliseconds


def message(**fields: Any) -> Any:
    return can.Message(**{"is_extended_id": False, **fields})


def same(sent: Any, received: Any) -> bool:
    return received is not None and sent.equals(received, timestamp_delta=None)


def come(bus: Any, count: int) -> list[Any]:
    found = [bus.recv(PATIENCE) for _ in range(count)]
    assert None not in found
    return found


def until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def wait_for_bytes(bus: CanserBus, count: int) -> None:
    """Wait until so many have come, and nobody has taken one."""
    until(lambda: bus.port.ring_fill * (8 << 20) >= count)


# What python-can's tests ask of its SerialBus, where bytes come straight back.


@pytest.fixture(params=["loop", "terminal"])
def looped(request: pytest.FixtureRequest) -> Iterator[Any]:
    if request.param == "loop":
        with can.Bus(interface="canser", channel="loop://", protocol="serial", timeout=0.1) as bus:
            yield bus
    else:
        with (
            echo() as path,
            can.Bus(interface="canser", channel=path, protocol="serial", timeout=0.1) as bus,
        ):
            yield bus


MESSAGES: dict[str, dict[str, Any]] = {
    **{f"byte {byte}": {"data": [byte]} for byte in range(256)},
    **{f"dlc {dlc}": {"data": bytes(dlc)} for dlc in range(9)},
    "no data": {"data": None},
    "least standard id": {"arbitration_id": 0},
    "greatest standard id": {"arbitration_id": 0x7FF},
    "least extended id": {"arbitration_id": 0, "is_extended_id": True},
    "greatest extended id": {"arbitration_id": 0x1FFF_FFFF, "is_extended_id": True},
    "error frame": {"is_error_frame": True},
    "remote frame": {"is_remote_frame": True},
    "remote frame with a dlc": {"is_remote_frame": True, "dlc": 4},
}


def test_messages_come_back(looped: Any) -> None:
    for name, fields in MESSAGES.items():
        sent = message(**fields)
        looped.send(sent)
        assert same(sent, looped.recv(PATIENCE)), name


@pytest.mark.parametrize("seconds", [0, 0.001, 1.001, CLOCK_END])
def test_times_come_back(looped: Any, seconds: float) -> None:
    sent = message(timestamp=seconds)
    looped.send(sent)
    received = looped.recv(PATIENCE)
    assert same(sent, received)
    assert received.timestamp == seconds


@pytest.mark.parametrize("seconds", [CLOCK_END + 0.001, CLOCK_END + 1, -1, math.nan, math.inf])
def test_times_out_of_range_are_refused(looped: Any, seconds: float) -> None:
    with pytest.raises(ValueError, match=f"timestamp {seconds} is out of range"):
        looped.send(message(timestamp=seconds))
    looped.send(message(arbitration_id=1))
    assert looped.recv(PATIENCE).arbitration_id == 1


def test_its_protocol_is_classic_can(looped: Any) -> None:
    assert looped.protocol is can.CanProtocol.CAN_20


def test_its_descriptor_is_one(looped: Any) -> None:
    number = looped.fileno()
    # So python-can's test, which was written for a mock, makes it greater than all.
    number.__gt__ = lambda _: True
    assert isinstance(number, int)
    assert number > 0
    assert number != -1


# What they ask of two buses that are connected.


@pytest.fixture(params=canser.protocols())
def pair(request: pytest.FixtureRequest) -> Iterator[tuple[CanserBus, CanserBus]]:
    with (
        linked() as (first, second),
        CanserBus(first, protocol=request.param) as one,
        CanserBus(second, protocol=request.param) as other,
    ):
        yield one, other


@pytest.mark.parametrize(
    "fields",
    [
        {"arbitration_id": 0x100, "data": range(1, 9)},
        {"arbitration_id": 0x123456, "is_extended_id": True, "data": range(10, 18)},
        {"arbitration_id": 0x200, "is_remote_frame": True, "dlc": 4},
        {"arbitration_id": 0x300, "data": [4, 5, 6]},
        {"arbitration_id": 0x400},
    ],
    ids=["standard", "extended", "remote", "three bytes", "no bytes"],
)
def test_messages_go_both_ways(pair: tuple[CanserBus, CanserBus], fields: dict[str, Any]) -> None:
    one, other = pair
    sent = message(**fields)
    if sent.is_extended_id and one.port.protocol == "cantalope":
        with pytest.raises(ValueError, match="no extended frames"):
            one.send(sent)
        return
    one.send(sent)
    assert same(sent, other.recv(PATIENCE))
    sent.arbitration_id += 1
    other.send(sent)
    assert same(sent, one.recv(PATIENCE))


def test_nothing_comes_of_nothing(pair: tuple[CanserBus, CanserBus]) -> None:
    assert pair[0].recv(0.01) is None
    assert pair[0].recv(0) is None
    assert pair[0].recv(-1) is None
    assert len(pair[0].recv_batch(timeout=0)) == 0


@pytest.mark.parametrize("protocol", canser.protocols())
def test_times_of_the_host_are_of_day(protocol: str) -> None:
    with (
        linked() as (first, second),
        CanserBus(first, protocol=protocol) as one,
        CanserBus(second, protocol=protocol, device_time=False) as other,
    ):
        before = time.time()
        one.send(message(arbitration_id=1))
        one.send(message(arbitration_id=2))
        received = come(other, 2)
        after = time.time()
    # The clocks of the system and of the port may differ by what NTP puts right.
    assert before - 5 < received[0].timestamp <= received[1].timestamp < after + 5


def test_times_of_day_go_out_by_their_differences() -> None:
    """So a log of any bus can be played into one whose times are a counter."""
    start = EPOCH / 1e9
    with (
        linked() as (first, second),
        CanserBus(first, protocol="serial") as one,
        CanserBus(second, protocol="serial") as two,
    ):
        for step in (0.0, 0.25, 2_000_000.0):
            one.send(message(timestamp=start + step))
        times = [received.timestamp for received in come(two, 3)]
    assert [round(seconds - times[0], 3) for seconds in times] == [0.0, 0.25, 2_000_000.0]


def test_periodic_messages_end_with_their_duration(pair: tuple[CanserBus, CanserBus]) -> None:
    one, other = pair
    reader = can.BufferedReader()
    with can.Notifier(one, [reader], 0.1):
        task: Any = other.send_periodic(message(arbitration_id=5, data=[1]), 0.002, 0.02)
        assert reader.get_message(PATIENCE).arbitration_id == 5
        until(lambda: not task.thread.is_alive())
    assert not other.port.closed


def test_periodic_messages_end_with_the_bus(pair: tuple[CanserBus, CanserBus]) -> None:
    one, other = pair
    tasks: list[Any] = [other.send_periodic(message(arbitration_id=n), 0.001) for n in (1, 2)]
    came: set[int] = set()
    while came != {1, 2}:  # the second task may begin late
        came |= {found.arbitration_id for found in come(one, 1)}
    other.shutdown()
    until(lambda: not any(task.thread and task.thread.is_alive() for task in tasks))


def test_who_is_about_to_send_does_not_fail_when_the_bus_ends(
    pair: tuple[CanserBus, CanserBus], caplog: pytest.LogCaptureFixture
) -> None:
    bus, _ = pair
    about, closed = threading.Event(), threading.Event()

    def wait(_: Any) -> None:
        about.set()
        closed.wait(PATIENCE)

    task: Any = bus.send_periodic(message(), 0.001, modifier_callback=wait)
    assert about.wait(PATIENCE)
    bus.shutdown()
    closed.set()
    task.thread.join(PATIENCE)  # an error in it would be one of the test
    assert not task.thread.is_alive()
    assert not caplog.records


def test_periodic_messages_may_start_later(pair: tuple[CanserBus, CanserBus]) -> None:
    one, other = pair
    task: Any = other.send_periodic(message(arbitration_id=3), 0.001, autostart=False)
    assert one.recv(0.01) is None
    task.start()
    assert come(one, 1)[0].arbitration_id == 3


def test_many_threads_use_a_thread_safe_bus() -> None:
    senders, each = 20, 50
    with linked() as (first, second):
        one = can.ThreadSafeBus(interface="canser", channel=first, protocol="serial")
        two = can.ThreadSafeBus(interface="canser", channel=second, protocol="serial")
        two.set_filters([{"can_id": 0x100, "can_mask": 0x700}])
        found: list[Any] = []

        def send(number: int) -> None:
            for turn in range(each):
                one.send(message(arbitration_id=0x100 + number, data=[turn]))
                one.send(message(arbitration_id=0x200 + number, data=[turn]))

        def receive() -> None:
            found.extend(two.recv(PATIENCE) for _ in range(each))

        threads = [threading.Thread(target=send, args=(number,)) for number in range(senders)]
        threads += [threading.Thread(target=receive) for _ in range(senders)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        one.shutdown()
        two.shutdown()
    got = sorted((each.arbitration_id, each.data[0]) for each in found)
    assert got == [(0x100 + number, turn) for number in range(senders) for turn in range(each)]


# Filters.


@pytest.fixture
def fed() -> Iterator[tuple[Device, CanserBus]]:
    with Device() as line, CanserBus(line.url, protocol="seeed") as bus:
        yield line, bus


def numbered(*ids: int, ext: bool = False) -> bytes:
    return canser.encode(array(*(Frame(number, ext) for number in ids)), "seeed")


@pytest.mark.parametrize(
    "filters",
    [
        None,
        [],
        [{"can_id": 0x11, "can_mask": 0x7FF}],
        [{"can_id": 0x11, "can_mask": 0x7FF, "extended": True}],
        [{"can_id": 0x11, "can_mask": 0x21, "extended": False}, {"can_id": 0x22, "can_mask": 0xFF}],
        [{"can_id": 0, "can_mask": -1}],
        [{"can_id": 0x2000_0011, "can_mask": 0x2000_0000}],
        [{"can_id": 0x8000_0011, "can_mask": 0x7FF}],
        [{"can_id": 0x11, "can_mask": 0}],
    ],
    ids=str,
)
def test_filters_are_those_of_python_can(fed: tuple[Device, CanserBus], filters: Any) -> None:
    line, bus = fed
    end = 0x7EE
    bus.set_filters(filters and [*filters, {"can_id": end, "can_mask": 0x7FF, "extended": False}])
    ids = range(0x40)
    every = [message(arbitration_id=n, is_extended_id=ext) for ext in (False, True) for n in ids]
    want = [
        (each.arbitration_id, each.is_extended_id) for each in every if bus._matches_filters(each)
    ]
    line.write(numbered(*ids) + numbered(*ids, ext=True) + numbered(end))
    found = come(bus, len(want) + 1)
    got = [(each.arbitration_id, each.is_extended_id) for each in found]
    assert got == [*want, (end, False)]


def test_new_filters_hold_for_what_has_come_already(fed: tuple[Device, CanserBus]) -> None:
    line, bus = fed
    line.write(numbered(*range(8)))
    wait_for_bytes(bus, len(numbered(*range(8))))
    assert come(bus, 1)[0].arbitration_id == 0
    bus.set_filters([{"can_id": 6, "can_mask": 0x7FE}])
    line.write(numbered(3, 0x7))
    assert [found.arbitration_id for found in come(bus, 3)] == [6, 7, 7]


def test_a_filter_that_cannot_be_read_leaves_no_open_port() -> None:
    with Device() as line:
        with pytest.raises(KeyError):
            CanserBus(line.url, [{"id": 1}], protocol="seeed")  # type: ignore[typeddict-item]
        with CanserBus(line.url, protocol="seeed") as bus:  # it is free again
            assert bus.filters is None


# Descriptors and notifiers.


def readable(bus: Any, timeout: float = 0) -> bool:
    return bool(select.select([bus], [], [], timeout)[0])


def test_the_descriptor_is_readable_as_long_as_frames_wait(
    fed: tuple[Device, CanserBus],
) -> None:
    line, bus = fed
    descriptor = bus.fileno()  # once: asking for it looks anew
    assert not readable(descriptor)
    line.write(numbered(*range(5)))
    for number in range(5):
        assert readable(descriptor, PATIENCE)
        assert come(bus, 1)[0].arbitration_id == number
    assert not readable(descriptor)
    line.write(numbered(1, 2))
    assert readable(descriptor, PATIENCE)
    bus.recv(PATIENCE)
    bus.recv(PATIENCE)
    assert not readable(descriptor)


def test_the_descriptor_is_readable_for_frames_that_were_taken_before_it_was_asked_for(
    fed: tuple[Device, CanserBus],
) -> None:
    line, bus = fed
    line.write(numbered(1, 2))
    wait_for_bytes(bus, len(numbered(1, 2)))
    assert come(bus, 1)[0].arbitration_id == 1
    descriptor = bus.fileno()
    assert readable(descriptor)
    line.write(numbered(3))
    got: list[int] = []
    while len(got) < 2:
        got += bus.recv_batch(timeout=PATIENCE)["id"].tolist()
    assert got == [2, 3]
    assert not readable(descriptor)


def test_notifiers_take_turns(pair: tuple[CanserBus, CanserBus]) -> None:
    one, other = pair
    for turn in range(2):
        reader = can.BufferedReader()
        with can.Notifier(one, [reader], 0.1) as notifier:
            other.send(message(arbitration_id=turn))
            assert reader.get_message(PATIENCE).arbitration_id == turn
            assert can.Notifier.find_instances(one) == (notifier,)
            with pytest.raises(ValueError, match="multiple"):
                can.Notifier(one, [reader])


def test_a_notifier_of_two_buses(pair: tuple[CanserBus, CanserBus]) -> None:
    one, other = pair
    reader = can.BufferedReader()
    with can.Notifier([one, other], [reader], 0.1):
        one.send(message(arbitration_id=1))
        other.send(message(arbitration_id=2))
        got = {reader.get_message(PATIENCE).arbitration_id for _ in range(2)}
    assert got == {1, 2}


def test_a_notifier_of_an_event_loop_gets_all_of_a_batch(fed: tuple[Device, CanserBus]) -> None:
    line, bus = fed
    count = 500

    async def run() -> list[int]:
        reader = can.AsyncBufferedReader()
        with can.Notifier(bus, [reader], loop=asyncio.get_running_loop()):
            # One write: all of it is there when the loop is woken, and nothing wakes it again.
            line.write(numbered(*range(count)))
            return [
                (await asyncio.wait_for(reader.get_message(), PATIENCE)).arbitration_id
                for _ in range(count)
            ]

    assert asyncio.run(run()) == list(range(count))


# Batches.


def test_batches_and_messages_share_one_stream(fed: tuple[Device, CanserBus]) -> None:
    line, bus = fed
    line.write(numbered(*range(10)))
    ids: list[int] = []
    while len(ids) < 10:
        ids.append(come(bus, 1)[0].arbitration_id)
        if len(ids) < 10:
            ids += bus.recv_batch(max_frames=2, timeout=PATIENCE)["id"].tolist()
    assert ids == list(range(10))


def test_batches_are_exact() -> None:
    frames = array(
        Frame(0x7FF, ts=0, dlc=8, data=bytes(range(8))),
        Frame(0x1FFF_FFFF, ext=True, ts=10**6, dlc=1, data=b"\x01".ljust(8, b"\0")),
        Frame(5, rtr=True, dlc=3, ts=2 * 10**6),
        Frame(6, err=True, ts=(2**31 - 1) * 10**6),
    )
    with (
        linked() as (first, second),
        CanserBus(first, protocol="serial") as one,
        CanserBus(second, protocol="serial") as two,
    ):
        assert one.send_batch(frames) == len(frames)
        got: list[Frame] = []
        while len(got) < len(frames):
            got += listed(two.recv_batch(max_frames=3, timeout=PATIENCE))
        assert got == listed(frames)
        # And those that recv had taken already.
        one.send_batch(frames)
        wait_for_bytes(two, len(canser.encode(frames, "serial")))
        two.recv(PATIENCE)
        rest = two.recv_batch(timeout=PATIENCE)
        assert listed(rest) == listed(frames)[1:]
        rest["id"] = 1  # the caller's own


def test_batches_pass_the_filters(fed: tuple[Device, CanserBus]) -> None:
    line, bus = fed
    bus.set_filters([{"can_id": 3, "can_mask": 0x7FF}])
    line.write(numbered(1, 2))
    assert len(bus.recv_batch(timeout=0.01)) == 0
    line.write(numbered(*range(8)))
    assert bus.recv_batch(timeout=PATIENCE)["id"].tolist() == [3]
    with pytest.raises(ValueError, match="max_frames is 0"):
        bus.recv_batch(max_frames=0)


# What cannot be sent.


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"is_fd": True}, "CAN FD"),
        ({"arbitration_id": 0x800}, "id 0x800 is over 0x7ff"),
        ({"arbitration_id": 0x2000_0000, "is_extended_id": True}, "over 0x1fffffff"),
        ({"arbitration_id": -1}, "id -0x1"),
        ({"dlc": 9, "data": bytes(9)}, "dlc 9"),
        ({"dlc": 2, "data": bytes(3)}, "3 bytes of data, but its dlc is 2"),
        ({"dlc": 3, "data": b""}, "0 bytes of data, but its dlc is 3"),
    ],
    ids=str,
)
def test_a_message_that_no_format_carries_is_refused(
    looped: Any, fields: dict[str, Any], why: str
) -> None:
    with pytest.raises(ValueError, match=why):
        looped.send(message(**fields))


@pytest.mark.parametrize("protocol", ["seeed", "cantalope"])
def test_an_error_frame_is_refused_where_the_format_has_none(protocol: str) -> None:
    with (
        Device() as line,
        CanserBus(line.url, protocol=protocol) as bus,
        pytest.raises(ValueError, match="error frame"),
    ):
        bus.send(message(is_error_frame=True))


def test_a_line_that_takes_no_more_is_a_timeout(fed: tuple[Device, CanserBus]) -> None:
    line, bus = fed
    count = 0

    def fill() -> None:
        nonlocal count
        while True:
            bus.send(message(arbitration_id=count & 0x7FF, data=bytes(8)), timeout=0)
            count += 1

    with pytest.raises(can.CanTimeoutError, match="took no more"):
        fill()
    # What was sent without an error goes out whole, with what a later call brings.
    first = line.read(13 * (count - 1))
    bus.send(message(arbitration_id=0x7EE))
    frames = canser.decode(first + line.read(13 + 5), "seeed")
    assert frames["id"].tolist() == [*(number & 0x7FF for number in range(count)), 0x7EE]
    with pytest.raises(can.CanTimeoutError) as raised:
        bus.send_batch(np.repeat(array(Frame(1, dlc=8)), 100_000), timeout=0)
    cause = raised.value.__cause__
    assert isinstance(cause, canser.SendTimeoutError)
    assert 0 < cause.sent < 100_000


# The exceptions that python-can promises.


@pytest.mark.parametrize(
    ("arguments", "error", "why"),
    [
        ({"channel": "/dev/no-such-port"}, can.CanInitializationError, "no-such-port"),
        ({"channel": __file__}, can.CanInitializationError, "no serial port"),
        ({"channel": "socket://127.0.0.1:1"}, can.CanInitializationError, "no server answers"),
        ({"channel": "nonsense://x"}, ValueError, "nonsense"),
        ({"channel": ""}, ValueError, "channel is empty"),
        ({"channel": 3}, TypeError, "channel is 3"),
        ({"protocol": None}, ValueError, "cantalope, seeed, serial"),
        ({"protocol": "morse"}, ValueError, "morse.*cantalope, seeed, serial"),
        ({"protocol": "seeed", "bitrate": 123}, ValueError, "bitrate 123"),
        ({"protocol": "cantalope", "bitrate": 500_000}, ValueError, "no configuration"),
        ({"protocol": "seeed", "device_time": True}, ValueError, "no device time"),
        ({"ts_unit": "h"}, ValueError, "ts_unit"),
        ({"baudrate": 0}, ValueError, "baudrate is 0"),
        ({"mode": "silent"}, ValueError, "bitrate"),
        ({"fd": True}, ValueError, "classic CAN"),
    ],
    ids=str,
)
def test_a_bus_that_cannot_be(arguments: dict[str, Any], error: type[Exception], why: str) -> None:
    with pytest.raises(error, match=why):
        CanserBus(**{"channel": "loop://", "protocol": "serial", **arguments})
    gc.collect()  # an open port would warn


def test_a_port_is_for_one_bus_at_a_time(fed: tuple[Device, CanserBus]) -> None:
    line, _ = fed
    with pytest.raises(can.CanInitializationError, match="open in another program"):
        CanserBus(line.url, protocol="seeed")


def test_what_means_nothing_is_told_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        with CanserBus("loop://", protocol="serial", single_handle=True, timeout=1, fd=False):
            assert not caplog.records
        with CanserBus("loop://", protocol="serial", rtscts=True):
            assert ["rtscts" in record.message for record in caplog.records] == [True]


def test_the_fields_of_both_configs_are_options(caplog: pytest.LogCaptureFixture) -> None:
    config = canser.AdapterConfig(bitrate=250_000, mode="silent")
    line = canser.LineConfig(baudrate=9600, ring_size=1 << 20)
    with (
        caplog.at_level(logging.WARNING),
        Device() as device,
        CanserBus(device.url, protocol="seeed", **asdict(config), **asdict(line)) as bus,
    ):
        assert read_config(device) == canser.adapters.configuration("seeed", config)
        assert bus.state is can.BusState.PASSIVE
        assert bus.port.baudrate == 9600
    assert not caplog.records


def test_an_unplugged_adapter_is_an_error_behind_its_last_frame(
    fed: tuple[Device, CanserBus],
) -> None:
    line, bus = fed
    line.write(numbered(1, 2))
    wait_for_bytes(bus, len(numbered(1, 2)))
    line.unplug()
    assert [found.arbitration_id for found in come(bus, 2)] == [1, 2]
    for _ in range(2):
        with pytest.raises(can.CanOperationError, match="is gone"):
            bus.recv(PATIENCE)
    with pytest.raises(can.CanOperationError, match="is gone"):
        bus.recv_batch(timeout=PATIENCE)
    with pytest.raises(can.CanOperationError, match="gone"):
        bus.send(message())
    assert readable(bus)


def test_an_adapter_is_unplugged_while_somebody_waits(fed: tuple[Device, CanserBus]) -> None:
    line, bus = fed
    errors: list[Exception] = []
    done = threading.Event()

    class Keeper(can.Listener):  # type: ignore[misc, name-defined]
        def on_message_received(self, _: Any) -> None:
            raise AssertionError

        def on_error(self, error: Exception) -> None:
            errors.append(error)
            done.set()

    with can.Notifier(bus, [Keeper()], 0.05):
        line.unplug()
        assert done.wait(PATIENCE)
    assert isinstance(errors[0], can.CanOperationError)


def test_an_adapter_is_unplugged_while_somebody_sends(fed: tuple[Device, CanserBus]) -> None:
    line, bus = fed
    errors: list[Exception] = []

    def send() -> None:
        try:
            while True:
                bus.send(message(data=bytes(8)))
        except can.CanError as error:
            errors.append(error)

    thread = threading.Thread(target=send)
    thread.start()
    line.read(1000)
    line.unplug()
    thread.join(PATIENCE)
    assert [type(error) for error in errors] == [can.CanOperationError]


def test_shutdown_ends_who_waits(fed: tuple[Device, CanserBus]) -> None:
    _, bus = fed
    errors: list[Exception] = []
    began = threading.Event()

    def receive() -> None:
        began.set()
        try:
            bus.recv()
        except can.CanError as error:
            errors.append(error)

    thread = threading.Thread(target=receive)
    thread.start()
    began.wait()
    bus.shutdown()
    thread.join(PATIENCE)
    assert [type(error) for error in errors] == [can.CanOperationError]


@pytest.mark.parametrize("read", [False, True])
def test_shutdown_sends_the_rest_of_a_message_or_tells_that_it_is_lost(
    caplog: pytest.LogCaptureFixture, read: bool
) -> None:
    frames = vehicle(20)
    with Device() as line:
        bus = CanserBus(line.url, protocol="seeed")
        with pytest.raises(can.CanTimeoutError) as caught:
            bus.send_batch(frames, timeout=0.05)
        cause = caught.value.__cause__
        assert isinstance(cause, canser.SendError)
        taken = canser.encode(frames[: cause.sent], "seeed")
        rest = bus.port.bytes_unsent
        assert rest > 0  # the last of them is cut
        if read:
            heard = line.read(len(taken) - rest)
            bus.shutdown()
            assert heard + line.read(rest) == taken
            assert "not sent" not in caplog.text
        else:
            bus.shutdown()
            assert f"{line.url}: {rest} bytes are not sent, and are lost" in caplog.text


def test_after_shutdown(fed: tuple[Device, CanserBus]) -> None:
    _, bus = fed
    bus.shutdown()
    bus.shutdown()
    calls: list[Callable[[], Any]] = [
        lambda: bus.recv(0),
        lambda: bus.send(message()),
        lambda: bus.recv_batch(timeout=0),
        lambda: bus.send_batch(array(Frame(1))),
        bus.fileno,
    ]
    for call in calls:
        with pytest.raises(can.CanOperationError, match="is closed"):
            call()
    with pytest.raises(NotImplementedError):
        bus.flush_tx_buffer()


def test_a_bus_that_is_forgotten_closes_its_port(caplog: pytest.LogCaptureFixture) -> None:
    with Device() as line:
        CanserBus(line.url, protocol="seeed")
        gc.collect()
        assert "not properly shut down" in caplog.text
        CanserBus(line.url, protocol="seeed").shutdown()


# The adapter, and how python-can finds it.


def test_the_adapter_is_configured_and_may_be_made_passive() -> None:
    with Device() as line, CanserBus(line.url, protocol="seeed", bitrate=500_000) as bus:
        said = canser.adapters.report("seeed", read_config(line))
        assert (said.bitrate, said.mode) == (500_000, "normal")
        assert bus.state is can.BusState.ACTIVE
        bus.state = can.BusState.ACTIVE
        bus.state = can.BusState.PASSIVE
        said = canser.adapters.report("seeed", read_config(line))
        assert (said.bitrate, said.mode) == (500_000, "silent")
        assert bus.state is can.BusState.PASSIVE
        with pytest.raises(NotImplementedError):
            bus.state = can.BusState.ERROR


def test_an_adapter_that_needs_time_gets_every_message() -> None:
    """Right after opening, and right after its state has changed."""
    frames = vehicle(0.1)
    with (
        Simulator("seeed", faults=canser.Faults(deaf=0.5, swallow=True)) as device,
        CanserBus(device.url, protocol="seeed", bitrate=500_000) as bus,
    ):
        with pytest.raises(can.CanTimeoutError, match="did not say within the time-out"):
            bus.send(message(arbitration_id=1), timeout=0)
        for number in (2, 3):
            bus.send(message(arbitration_id=number))
        bus.state = can.BusState.PASSIVE
        bus.state = can.BusState.ACTIVE
        assert bus.send_batch(frames) == len(frames)
        until(lambda: device.report().frames_received == 2 + len(frames))
        assert device.received["id"].tolist() == [2, 3, *frames["id"].tolist()]
        assert device.configuration is not None
        assert device.configuration.mode == "normal"
        assert bus.port.take_controls() == []


def test_the_bus_sets_the_pace_of_messages() -> None:
    with (
        Simulator("seeed") as device,
        CanserBus(device.url, protocol="seeed", bitrate=10_000) as bus,
    ):
        for number in range(16):
            bus.send(message(arbitration_id=number))

        def send_too_many() -> None:
            for _ in range(1000):
                bus.send(message(arbitration_id=16), timeout=0)

        with pytest.raises(can.CanTimeoutError, match="the bus can have sent no more"):
            send_too_many()
        until(lambda: device.report().frames_received >= 16)


def test_the_state_of_an_adapter_that_is_not_configured_stays(
    fed: tuple[Device, CanserBus],
) -> None:
    _, bus = fed
    bus.state = can.BusState.ACTIVE
    with pytest.raises(NotImplementedError, match="bitrate"):
        bus.state = can.BusState.PASSIVE


def test_python_can_finds_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "canser" in can.VALID_INTERFACES
    ports = [canser.PortInfo("/dev/ttyUSB0", "", "")]
    monkeypatch.setattr(canser.live.ports, "list_ports", lambda: ports)
    found = can.detect_available_configs("canser")
    assert {each["protocol"] for each in found} == set(canser.protocols())
    assert {each["channel"] for each in found} == {"/dev/ttyUSB0"}
    with can.Bus(**{**found[0], "channel": "loop://"}, ignore_config=True) as bus:
        assert isinstance(bus, CanserBus)


def test_importing_canser_or_its_bus_is_no_matter_of_the_other() -> None:
    code = (
        "import sys, canser.python_can.bus; "
        "print(*sorted({'asyncio', 'serial'} & sys.modules.keys()))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "serial" not in run.stdout.split()


def test_every_message_has_data_of_its_own(looped: Any) -> None:
    for _ in range(2):
        looped.send(message(data=[1, 2]))
    first, second = come(looped, 2)
    first.data[0] = 9
    assert bytes(second.data) == b"\x01\x02"


def test_numbers_of_messages_are_pythons_own(looped: Any) -> None:
    looped.send(message(arbitration_id=7, data=[1]))
    received = looped.recv(PATIENCE)
    kinds = {
        name: type(getattr(received, name))
        for name in ("timestamp", "arbitration_id", "is_extended_id", "is_error_frame", "dlc")
    }
    assert set(kinds.values()) == {float, int, bool}
    assert type(received.data) is bytearray
    assert received.is_rx


def test_frames_fit_the_arrays(looped: Any) -> None:
    looped.send(message(arbitration_id=7, data=[1]))
    frames: FrameArray = looped.recv_batch(timeout=PATIENCE)
    assert frames.dtype == canser.FRAME_DTYPE
    assert listed(frames) == [Frame(7, dlc=1, data=b"\x01".ljust(8, b"\0"), ts=0)]
