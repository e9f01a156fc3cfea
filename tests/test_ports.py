"""Live ports: what goes in comes out, once, in order, in time, and nobody waits for nothing."""

import asyncio
import contextlib
import copy
import gc
import pickle
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import canser
from canser._frames import FRAME_DTYPE, FrameArray
from canser.adapters import AdapterConfig
from canser.live.config import LineConfig
from canser.simulation.traffic import line_noise
from device import PATIENCE, Device, descriptors, until
from readers import (
    Background,
    being_read,
    collect,
    content,
    frames_of,
    plugged,
    read_config,
    traffic,
    waiting,
)
from reference import Frame
from samples import array

# Bytes come here faster than any line has them, and so the device's clock looks too slow.
pytestmark = pytest.mark.filterwarnings("ignore:.*the device clock:canser.CanserWarning")

PROTOCOLS = canser.protocols()
STATUS = bytes.fromhex("AA5504 0500" + "00" * 14 + "09")


# Reading


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_frame_comes_with_its_time(protocol: str) -> None:
    frames = traffic(2, protocol)
    before = time.time_ns()
    with plugged(protocol) as (device, port):
        device.feed(canser.encode(frames, protocol))
        got = collect(port, len(frames))
        assert content(got) == content(frames)
        # A byte may have been on the line before the port was opened, by the line's rate.
        assert before - 10_000_000_000 < got["ts"].min()
        assert got["ts"].max() <= time.time_ns() + 1_000_000
        if protocol != "serial":  # whose clock no host can believe at this speed
            assert (np.diff(got["ts"]) >= 0).all()
        assert port.stats.frames == len(frames)
        assert port.stats.bytes_skipped == port.bytes_lost == 0
        assert (port.protocol, port.baudrate) == (protocol, canser.protocol(protocol).baudrate)
        assert port.ring_fill == 0
        assert not port.take_gaps()


@settings(max_examples=25)
@given(
    protocol=st.sampled_from(PROTOCOLS),
    noise=st.booleans(),
    cuts=st.lists(st.integers(1, 40), min_size=1, max_size=30),
    room=st.sampled_from([1, 2, 7, 64]),
)
def test_it_does_not_matter_how_the_stream_is_cut(
    protocol: str, noise: bool, cuts: list[int], room: int
) -> None:
    raw = canser.encode(traffic(0.1, protocol), protocol)
    if noise:
        raw = line_noise(raw, rate=0.02)
    expected = canser.decode(raw, protocol)
    whole = canser.Decoder(protocol)
    whole.feed(raw)
    whole.flush()
    out = np.empty(room, FRAME_DTYPE)
    got: list[FrameArray] = []
    with warnings.catch_warnings(), plugged(protocol) as (device, port):
        warnings.simplefilter("ignore", canser.CanserWarning)
        position = 0
        for cut in cuts:
            device.feed(raw[position : position + cut])
            device.fed()
            position += cut
            got.append(port.read_batch(out, timeout=0).copy())
        device.feed(raw[position:])
        while port.stats.bytes_in + waiting(port) < len(raw) or waiting(port):
            got.append(port.read_batch(out, timeout=0.001).copy())
        device.unplug()
        with contextlib.suppress(canser.PortGoneError):
            while True:
                got.append(port.read_batch(out, timeout=PATIENCE).copy())
        assert content(np.concatenate(got)) == content(expected)
        assert port.stats == whole.stats


def test_a_batch_has_as_many_frames_as_asked_for() -> None:
    frames = traffic(1)
    with plugged() as (device, port):
        device.feed(canser.encode(frames, "seeed"))
        first = port.read_batch(max_frames=7, min_frames=7, timeout=PATIENCE)
        second = port.read_batch(max_frames=100, min_frames=50, timeout=PATIENCE)
        rest = port.read_batch(min_frames=len(frames) - 7 - len(second), timeout=PATIENCE)
        assert len(first) == 7
        assert 50 <= len(second) <= 100
        assert content(np.concatenate([first, second, rest])) == content(frames)


def test_a_batch_may_be_late_and_short() -> None:
    frames = traffic(1)[:5]
    with plugged() as (device, port):
        # As many as there are: room is made for what has come.
        assert len(port.read_batch(max_frames=10**30, timeout=0)) == 0
        assert len(port.read_batch(timeout=0)) == 0
        assert len(port.read_batch(timeout=0.001)) == 0
        assert len(port.read_batch(min_frames=0)) == 0
        device.feed(canser.encode(frames, "seeed"))
        until(lambda: waiting(port) == len(canser.encode(frames, "seeed")))
        batch = port.read_batch(min_frames=6, timeout=0.001)
        assert content(batch) == content(frames)


def test_who_waits_for_the_last_frame_rests(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = traffic(2)
    with plugged() as (device, port):
        device.feed(canser.encode(frames, "seeed"))
        looks: list[int] = []
        decode = port._stream.decode

        def look(most: int) -> int:
            looks.append(decode(most))
            return looks[-1]

        monkeypatch.setattr(port._stream, "decode", look)
        got = port.read_batch(max_frames=5000, min_frames=len(frames) + 1, timeout=0.5)
        assert content(got) == content(frames)
        assert len([count for count in looks if count == len(frames)]) < 50


def test_a_read_without_a_timeout_waits_for_a_frame() -> None:
    with plugged() as (device, port):
        reader = Background(port.read_batch)
        raw = canser.encode(traffic(1)[:1], "seeed")
        device.feed(raw[:3])
        device.fed()
        device.feed(raw[3:])
        assert content(frames_of(reader)) == content(traffic(1)[:1])


def test_a_batch_goes_into_the_callers_array() -> None:
    frames = traffic(1)
    out = np.zeros(10, FRAME_DTYPE)
    with plugged() as (device, port):
        device.feed(canser.encode(frames, "seeed"))
        batch = port.read_batch(out, min_frames=10, timeout=PATIENCE)
        assert batch.base is out
        assert content(out) == content(frames[:10])
        assert content(collect(port, len(frames) - 10)) == content(frames[10:])


def test_batches_do_not_share_memory() -> None:
    frames = traffic(1)
    with plugged() as (device, port):
        device.feed(canser.encode(frames, "seeed"))
        first = port.read_batch(max_frames=10, min_frames=10, timeout=PATIENCE)
        collect(port, len(frames) - 10, max_frames=10)
        assert content(first) == content(frames[:10])


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"max_frames": 0}, ValueError, "max_frames is 0; it must be 1 or more"),
        ({"min_frames": 5000}, ValueError, "min_frames is 5000; it must be 0 to 4096, the room"),
        ({"min_frames": -1}, ValueError, "min_frames is -1"),
        ({"out": np.empty(0, FRAME_DTYPE)}, ValueError, "out has room for 0 frames"),
        ({"out": np.empty(3)}, TypeError, "out"),
        ({"out": [1]}, TypeError, "out"),
    ],
)
def test_what_cannot_be_read_into(
    options: dict[str, Any], error: type[Exception], message: str
) -> None:
    with plugged() as (device, port):
        with pytest.raises(error, match=message):
            port.read_batch(**options)
        device.feed(canser.encode(traffic(1)[:1], "seeed"))
        assert len(port.read_batch(timeout=PATIENCE)) == 1


def test_batches_end_when_the_port_is_closed() -> None:
    frames = traffic(1)
    got: list[FrameArray] = []
    with plugged() as (device, port):
        device.feed(canser.encode(frames, "seeed"))
        for batch in port.batches(max_frames=100, timeout=0.01):
            assert 1 <= len(batch) <= 100
            got.append(batch)
            if sum(map(len, got)) == len(frames):
                port.close()
    assert content(np.concatenate(got)) == content(frames)
    assert len(got[0]) == 100


def test_batches_fill_the_callers_array_again_and_again() -> None:
    frames = traffic(1)
    out = np.empty(64, FRAME_DTYPE)
    got: list[FrameArray] = []
    with plugged() as (device, port):
        device.feed(canser.encode(frames, "seeed"))
        for batch in port.batches(out=out, timeout=0.01):
            assert batch.base is out
            got.append(batch.copy())
            if sum(map(len, got)) == len(frames):
                break
    assert content(np.concatenate(got)) == content(frames)


def test_two_threads_share_the_frames() -> None:
    frames = traffic(3)
    got: list[list[FrameArray]] = [[], []]
    with plugged() as (device, port):

        def read(mine: list[FrameArray]) -> None:
            mine.extend(port.batches(max_frames=50, timeout=0.001))

        readers = [Background(lambda mine=mine: read(mine)) for mine in got]  # type: ignore[misc]
        device.feed(canser.encode(frames, "seeed"))
        until(lambda: sum(map(len, got[0] + got[1])) == len(frames))
        port.close()
        for reader in readers:
            assert reader.join().error is None
    everything = np.concatenate(got[0] + got[1])
    assert sorted(content(everything)) == sorted(content(frames))


def test_nobody_waits_for_another_reader() -> None:
    with plugged() as (_, port):
        reader = Background(port.read_batch)
        until(lambda: being_read(port))
        assert len(port.read_batch(timeout=0)) == 0
        assert len(port.read_batch(timeout=0.001)) == 0
        assert port.take_controls() == []
        assert port.take_gaps() == []
        assert reader.running
        port.close()
        assert isinstance(reader.join().error, canser.PortClosedError)


# Exceptions on the way


class StopError(BaseException):
    """As KeyboardInterrupt, which pytest does not like."""


def test_an_interrupt_of_a_wait_loses_no_frame() -> None:
    frames = traffic(1)
    main = threading.get_ident()

    def stop(*_: object) -> None:
        raise StopError

    before = signal.signal(signal.SIGUSR1, stop)
    try:
        with plugged() as (device, port):
            device.feed(canser.encode(frames[:100], "seeed"))

            def interrupt() -> None:
                until(lambda: port.stats.frames == 100 and not waiting(port))
                signal.pthread_kill(main, signal.SIGUSR1)

            interrupter = Background(interrupt)
            with pytest.raises(StopError):
                port.read_batch(min_frames=101)
            interrupter.join()
            device.feed(canser.encode(frames[100:], "seeed"))
            assert content(collect(port, len(frames))) == content(frames)
    finally:
        signal.signal(signal.SIGUSR1, before)


def test_an_interrupt_right_behind_the_decoder_loses_no_frame(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """There a signal that came while C was at work is handled."""
    frames = traffic(1)
    pieces: list[bytes] = []

    def on_bytes(data: memoryview, *_: object) -> None:
        pieces.append(bytes(data))

    with plugged(on_bytes=on_bytes) as (device, port):
        raw = canser.encode(frames, "seeed")
        device.feed(raw)
        until(lambda: waiting(port) == len(raw))
        feed_room = port.decoder.feed_room

        def feed_and_stop(*args: Any) -> int:
            feed_room(*args)
            raise StopError

        monkeypatch.setattr(port.decoder, "feed_room", feed_and_stop)
        for room in (10, 20, 30):
            with pytest.raises(StopError):
                port.read_batch(max_frames=room)
        monkeypatch.undo()
        assert select_readable(port)
        assert content(collect(port, len(frames))) == content(frames)
    assert b"".join(pieces) == raw


def select_readable(port: canser.Port) -> bool:
    """Return whether the port's descriptor is readable."""
    poll = select.poll()
    poll.register(port, select.POLLIN)
    return bool(poll.poll(0))


def test_an_exception_in_on_bytes_loses_no_frame_and_no_byte() -> None:
    frames = traffic(1)
    pieces: list[bytes] = []

    def on_bytes(data: memoryview, *_: object) -> None:
        pieces.append(bytes(data))
        if len(pieces) % 2:
            raise OSError("the disk is full")

    errors = 0
    got: list[FrameArray] = []
    with plugged(on_bytes=on_bytes) as (device, port):
        device.feed(canser.encode(frames, "seeed"))
        while sum(map(len, got)) < len(frames):
            try:
                got.append(port.read_batch(timeout=PATIENCE))
            except OSError:
                errors += 1
    assert errors
    assert content(np.concatenate(got)) == content(frames)
    assert b"".join(pieces) == canser.encode(frames, "seeed")


def test_on_bytes_may_close_the_port() -> None:
    ports: list[canser.Port] = []
    with plugged(on_bytes=lambda *_: ports[0].close()) as (device, port):
        ports.append(port)
        device.feed(canser.encode(traffic(1)[:3], "seeed"))
        with contextlib.suppress(canser.PortClosedError):
            port.read_batch(timeout=PATIENCE)
        assert port.closed


def test_a_read_that_waits_returns_what_has_come_when_the_port_is_closed() -> None:
    frames = traffic(1)[:5]
    with plugged() as (device, port):
        reader = Background(lambda: port.read_batch(min_frames=100))
        until(lambda: being_read(port))
        device.feed(canser.encode(frames, "seeed"))
        until(lambda: waiting(port) + port.stats.bytes_in == len(canser.encode(frames, "seeed")))
        port.close()
        assert content(frames_of(reader)) == content(frames)


# The bytes as they came


def test_on_bytes_sees_every_byte_and_what_is_lost_before_it() -> None:
    seen: list[tuple[bytes, int, int]] = []

    def on_bytes(data: memoryview, ns: int, lost: int) -> None:
        seen.append((bytes(data), ns, lost))

    raw = line_noise(canser.encode(traffic(20), "seeed"))
    with (
        warnings.catch_warnings(),
        plugged(on_bytes=on_bytes, line=LineConfig(ring_size=1 << 16)) as (device, port),
    ):
        warnings.simplefilter("ignore", canser.CanserWarning)
        device.feed(raw)
        device.fed()
        until(lambda: waiting(port) + port.bytes_lost == len(raw))
        lost = port.bytes_lost
        assert lost == len(raw) - (1 << 16)
        while waiting(port):
            port.read_batch(timeout=0)
        device.feed(raw[:1000])
        until(lambda: waiting(port) == 1000)
        while waiting(port):
            port.read_batch(timeout=0)
        gaps = port.take_gaps()
    assert b"".join(data for data, _, _ in seen) == raw[: 1 << 16] + raw[:1000]
    assert [lost for _, _, lost in seen if lost] == [lost]
    assert next(data for data, _, lost in seen if lost) == raw[: len(seen[-1][0])]
    assert [(gap.offset, gap.lost, gap.reason) for gap in gaps] == [(1 << 16, lost, "overflow")]
    times = [ns for _, ns, _ in seen]
    assert times == sorted(times)


# Asyncio


def test_an_async_iterator_gives_every_frame() -> None:
    frames = traffic(1)
    got: list[FrameArray] = []

    async def read(port: canser.Port) -> None:
        async for batch in port.batches_async(max_frames=100, timeout=0.01):
            got.append(batch)
            if sum(map(len, got)) == len(frames):
                port.close()

    with plugged() as (device, port):
        device.feed(canser.encode(frames, "seeed"))
        asyncio.run(asyncio.wait_for(read(port), PATIENCE))
    assert content(np.concatenate(got)) == content(frames)
    assert max(map(len, got)) <= 100


def test_a_cancelled_task_loses_no_frame() -> None:
    frames = traffic(1)
    got: list[FrameArray] = []

    async def read(port: canser.Port) -> None:
        async for batch in port.batches_async(max_frames=10, timeout=0.001):
            got.append(batch)
            await asyncio.sleep(0)

    async def run(device: Device, port: canser.Port) -> None:
        raw = canser.encode(frames, "seeed")
        position = 0
        while sum(map(len, got)) < len(frames):
            device.feed(raw[position : position + 500])
            position += 500
            before = len(got)
            task = asyncio.create_task(read(port))
            while len(got) == before and sum(map(len, got)) < len(frames):
                await asyncio.sleep(0)
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    with plugged() as (device, port):
        asyncio.run(asyncio.wait_for(run(device, port), PATIENCE))
    assert content(np.concatenate(got)) == content(frames)


def test_an_async_iterator_ends_with_the_device() -> None:
    async def read(port: canser.Port) -> int:
        count = 0
        async for batch in port.batches_async():
            count += len(batch)
            if count == 5:
                device.unplug()
        return count

    with plugged() as (device, port):
        device.feed(canser.encode(traffic(1)[:5], "seeed"))
        with pytest.raises(canser.PortGoneError):
            asyncio.run(asyncio.wait_for(read(port), PATIENCE))


def test_the_event_loop_goes_on_while_a_thread_reads() -> None:
    async def read(port: canser.Port) -> str:
        async def first() -> None:
            async for _ in port.batches_async(timeout=0.001):
                return

        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(first(), 0.01)
        return "went on"

    with plugged() as (_, port):
        reader = Background(port.read_batch)
        until(lambda: being_read(port))
        assert asyncio.run(read(port)) == "went on"
        assert reader.running
        port.close()
        reader.join()


# The descriptor


def test_the_descriptor_is_readable_while_bytes_wait() -> None:
    frames = traffic(1)[:9]
    with plugged() as (device, port):
        assert not select_readable(port)
        device.feed(canser.encode(frames, "seeed"))
        assert select.select([port], [], [], PATIENCE)[0] == [port]
        assert content(collect(port, 9)) == content(frames)
        assert not select_readable(port)
        port.hold_ready(True)
        assert select_readable(port)
        port.hold_ready(False)
        assert not select_readable(port)
        device.unplug()
        assert select.select([port], [], [], PATIENCE)[0] == [port]
        with pytest.raises(canser.PortGoneError):
            port.read_batch(timeout=0)
        assert select_readable(port)
        port.close()
        with pytest.raises(canser.PortClosedError):
            port.fileno()


# The adapter's own commands


def test_control_packets_reach_the_user() -> None:
    frames = traffic(1)[:9]
    raw = canser.encode(frames, "seeed")
    with plugged() as (device, port):
        assert port.status is None
        device.feed(STATUS + raw + STATUS)
        assert content(collect(port, 9)) == content(frames)
        until(lambda: len(port.read_batch(timeout=0)) or port.stats.controls == 2)
        assert [tuple(control) for control in port.take_controls()] == [
            (0, STATUS),
            (20 + len(raw), STATUS),
        ]
        assert port.take_controls() == []
        assert port.status is not None
        assert (port.status.receive_errors, port.status.transmit_errors) == (5, 0)


def test_error_reports_reach_the_user() -> None:
    with plugged("cantalope") as (device, port):
        device.feed(b"\xff\xff\x01\x07")
        until(lambda: len(port.read_batch(timeout=0)) or port.stats.controls)
        assert [control.data for control in port.take_controls()] == [b"\xff\xff\x01\x07"]


def test_a_status_is_asked_for_and_no_frame_is_lost() -> None:
    frames = traffic(1)
    raw = canser.encode(frames, "seeed")
    with plugged() as (device, port):
        device.feed(raw[:5000])
        until(lambda: waiting(port) == 5000)
        asker = Background(lambda: port.request_status(timeout=PATIENCE))
        assert device.read(20) == canser.protocol("seeed").status_request
        device.feed(raw[5000:] + STATUS)
        report = asker.join().result
        assert isinstance(report, canser.adapters.AdapterReport)
        assert report.receive_errors == 5
        assert select_readable(port)
        assert content(collect(port, len(frames), max_frames=100)) == content(frames)
        until(lambda: not waiting(port) or len(port.read_batch(timeout=0)))
        assert not select_readable(port)


def test_a_status_is_asked_for_while_another_thread_reads() -> None:
    with plugged() as (device, port):
        reader = Background(port.read_batch)
        until(lambda: being_read(port))
        asker = Background(lambda: port.request_status(timeout=PATIENCE))
        device.read(20)
        device.feed(STATUS)
        assert asker.join().error is None
        assert reader.running
        device.feed(canser.encode(traffic(1)[:1], "seeed"))
        assert len(frames_of(reader)) == 1


def test_a_status_that_does_not_come() -> None:
    with plugged() as (device, port):
        with pytest.raises(canser.PortError, match="did not answer the status request"):
            port.request_status(timeout=0.01)
        asker = Background(lambda: port.request_status(timeout=PATIENCE))
        device.read(40)
        device.unplug()
        assert isinstance(asker.join().error, canser.PortGoneError)
    with plugged() as (device, port):
        asker = Background(lambda: port.request_status(timeout=PATIENCE))
        device.read(20)
        port.close()
        assert isinstance(asker.join().error, canser.PortClosedError)
    with plugged("serial") as (_, port), pytest.raises(ValueError, match="know no status request"):
        port.request_status()


def test_an_adapter_is_configured() -> None:
    silent = AdapterConfig(bitrate=250_000, mode="silent")
    once = AdapterConfig(bitrate=500_000, once=True)
    with plugged(config=silent) as (device, port):
        assert read_config(device) == canser.adapters.configuration("seeed", silent)
        assert port.bitrate == 250_000
        port.configure(once)
        assert read_config(device) == canser.adapters.configuration("seeed", once)
        assert port.bitrate == 500_000
        port.configure(bitrate=250_000)
        plain = AdapterConfig(bitrate=250_000)
        assert read_config(device) == canser.adapters.configuration("seeed", plain)
        assert port.bitrate == 250_000
        with pytest.raises(ValueError, match="bitrate is missing; give bitrate or config"):
            port.configure()
        with pytest.raises(ValueError, match="bitrate is 250000, but config has the bitrate 500"):
            port.configure(once, bitrate=250_000)


def test_a_bitrate_configures_an_adapter_as_a_config_of_it() -> None:
    with plugged(bitrate=250_000) as (device, port):
        plain = AdapterConfig(bitrate=250_000)
        assert read_config(device) == canser.adapters.configuration("seeed", plain)
        assert port.bitrate == 250_000


@pytest.mark.parametrize(
    ("protocol", "options", "message"),
    [
        ("foo", {}, f"unknown protocol 'foo'; have: {', '.join(canser.protocols())}"),
        ("seeed", {"line": LineConfig(ping=1)}, "seeed adapters know no ping; leave ping out"),
        (
            "seeed",
            {"bitrate": 250_000, "config": AdapterConfig(bitrate=500_000)},
            "bitrate is 250000, but config has the bitrate 500000; give one of both",
        ),
        ("seeed", {"bitrate": 1}, "bitrate 1 is none of the adapter's"),
        ("serial", {"bitrate": 500_000}, "serial adapters take no configuration"),
        ("serial", {"ts_unit": "h"}, "unknown ts_unit 'h'"),
    ],
)
def test_what_cannot_be_asked_for(protocol: str, options: dict[str, Any], message: str) -> None:
    with Device() as device:
        with pytest.raises(ValueError, match=message):
            canser.open(device.url, protocol, **options)
        canser.open(device.url, "seeed").close()


# Sending


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_frames_are_sent(protocol: str) -> None:
    frames = traffic(1, protocol)
    raw = canser.encode(frames, protocol)
    with plugged(protocol) as (device, port):
        sender = Background(lambda: port.send(frames))
        assert device.read(len(raw)) == raw
        assert sender.join().result == len(frames)
        assert port.send(frames[:0]) == 0
        assert port.drain(timeout=PATIENCE)


def test_frames_without_a_time_are_sent_with_that_since_the_start() -> None:
    frames = array(Frame(1), Frame(2, ts=7_000_000))
    with plugged("serial") as (device, port):
        assert port.send(frames) == 2
        sent = canser.decode(device.read(22), "serial")
        assert 0 <= sent["ts"][0] < PATIENCE * 1e9
        assert sent["ts"][1] == 7_000_000
        assert frames["ts"][0] == canser.NO_TIME


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_what_stands_for_frames_is_sent(protocol: str) -> None:
    texts = ["123#DEADBEEF", "001#", "7E0#R8"]
    frames = canser.frames(texts)
    frames["ts"] = 0
    size = len(canser.encode(frames, protocol))
    with plugged(protocol) as (device, port):
        assert port.send("123#DEADBEEF") == 1
        assert port.send([(0x001, b""), frames[2]]) == 2
        assert port.send([]) == 0
        sent = canser.decode(device.read(size), protocol)
        assert content(sent) == content(frames)
        with pytest.raises(ValueError, match="'124##0' is CAN FD"):
            port.send(["123#", "124##0"])
        assert not device.hears()


@pytest.mark.parametrize("protocol", canser.protocols())
def test_a_mask_is_never_lost_in_silence(protocol: str) -> None:
    frames = np.zeros(4, canser.FRAME_DTYPE)
    frames["ts"] = canser.NO_TIME
    with plugged(protocol) as (_, port):
        with pytest.raises(TypeError, match="frames is a masked array"):
            port.send(np.ma.masked_array(frames))
        with pytest.raises(TypeError, match="out is a masked array"):
            port.read_batch(np.ma.masked_array(frames), timeout=0)
        with pytest.raises(TypeError, match="data is a masked array"):
            port.send_raw(np.ma.masked_array(np.zeros(4, np.uint8)))


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_port_cannot_be_copied(again: Callable[[Any], Any]) -> None:
    with plugged("cantalope") as (_, port):
        with pytest.raises(TypeError, match="a Port cannot be copied or pickled: the copy would"):
            again(port)
        assert not port.closed


def test_a_frame_that_cannot_be_encoded_sends_nothing() -> None:
    with plugged("cantalope") as (device, port):
        with pytest.raises(ValueError, match="frame 1"):
            port.send(array(Frame(1), Frame(2, ext=True)))
        assert not device.hears()
        with pytest.raises(TypeError):
            port.send([1])  # type: ignore[list-item]


def test_what_could_not_be_sent_is_counted_and_the_next_packet_is_whole() -> None:
    """A line that takes no more, in the middle of a frame; then it takes the rest."""
    frames = traffic(20)
    raw = canser.encode(frames, "seeed")
    with plugged() as (device, port):
        with pytest.raises(canser.SendError, match="took no more within the time-out") as caught:
            port.send(frames, timeout=0.05)
        sent = caught.value.sent
        assert 0 < sent < len(frames)
        assert str(sent) in str(caught.value)
        with pytest.raises(canser.SendError) as caught:
            port.send(frames[sent:], timeout=0)
        sent += caught.value.sent
        with pytest.raises(canser.SendError) as again:
            port.send_raw(b"nothing of this", timeout=0)
        assert again.value.sent == 0
        assert not port.drain(timeout=0)
        sender = Background(lambda: port.send(frames[sent:]))
        assert device.read(len(raw)) == raw
        assert sender.join().result == len(frames) - sent


def test_drain_sends_the_rest_of_a_frame() -> None:
    frames = traffic(20)
    with plugged() as (device, port):
        with pytest.raises(canser.SendError) as caught:
            port.send(frames, timeout=0.05)
        assert caught.value.reason == "the line took no more within the time-out"
        assert 0 < port.bytes_unsent < 20  # a pseudo terminal does not tell what it holds
        drainer = Background(lambda: port.drain(timeout=PATIENCE))
        raw = canser.encode(frames[: caught.value.sent], "seeed")
        assert device.read(len(raw)) == raw
        assert drainer.join().result is True
        assert port.bytes_unsent == 0


def test_bytes_that_a_connection_holds_are_not_sent() -> None:
    frames = traffic(5)
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        with canser.open(url, "seeed") as port:
            many = frames.repeat(200)  # more than the buffers of both sides take
            with pytest.raises(canser.SendError):
                port.send(many, timeout=0.5)
            assert port.bytes_unsent > 1000
            client, _ = server.accept()
            with client:
                drainer = Background(lambda: port.drain(timeout=PATIENCE))
                client.settimeout(0.05)
                while drainer.running:
                    with contextlib.suppress(TimeoutError):
                        client.recv(1 << 20)
                assert drainer.join().result is True
                assert port.bytes_unsent == 0


def test_packets_of_two_threads_do_not_mix() -> None:
    frames = traffic(5)
    with plugged() as (device, port):

        def send() -> None:
            rest = frames
            while len(rest):
                try:
                    rest = rest[port.send(rest, timeout=0.001) :]
                except canser.SendError as error:
                    rest = rest[error.sent :]

        senders = [Background(send), Background(send)]
        decoder = canser.Decoder("seeed")
        raw = device.read(2 * len(canser.encode(frames, "seeed")))
        got = decoder.feed(raw)
        assert decoder.stats.bytes_skipped == 0
        assert sorted(content(got)) == sorted(content(frames) * 2)
        for sender in senders:
            assert sender.join().error is None


def test_a_send_that_is_interrupted_leaves_whole_packets() -> None:
    frames = traffic(20)
    main = threading.get_ident()

    def stop(*_: object) -> None:
        raise StopError

    before = signal.signal(signal.SIGUSR1, stop)
    try:
        with plugged() as (device, port):

            def interrupt() -> None:
                until(lambda: port._reader._writing.locked() and device.hears())
                signal.pthread_kill(main, signal.SIGUSR1)

            interrupter = Background(interrupt)
            with pytest.raises(StopError):
                port.send(frames)
            interrupter.join()
            mark = array(Frame(0x7E5, dlc=1, data=b"\x55".ljust(8, b"\0")))
            sender = Background(lambda: port.send(mark))
            decoder = canser.Decoder("seeed")
            got: list[FrameArray] = []
            while not any((frames["id"] == 0x7E5).any() for frames in got):
                got.append(decoder.feed(device.read_some()))
            sender.join()
            everything = np.concatenate(got)
            assert decoder.stats.bytes_skipped == 0
            assert content(everything[-1:]) == content(mark)
            assert content(everything[:-1]) == content(frames[: len(everything) - 1])
    finally:
        signal.signal(signal.SIGUSR1, before)


def test_sends_that_are_interrupted_at_any_moment_cut_no_packet() -> None:
    frames = traffic(20)
    rng = np.random.default_rng(1)

    def stop(*_: object) -> None:
        raise StopError

    before = signal.signal(signal.SIGALRM, stop)
    try:
        with plugged() as (device, port):
            decoder = canser.Decoder("seeed")

            def read() -> None:
                while not (decoder.feed(device.read_some())["id"] == 0x7E5).any():
                    pass

            def send() -> None:
                while True:
                    port.send(frames)

            reader = Background(read)
            for wait_s in rng.uniform(0.001, 0.01, 150).tolist():
                signal.setitimer(signal.ITIMER_REAL, wait_s)
                with pytest.raises(StopError):
                    send()
            port.send(array(Frame(0x7E5, dlc=1, data=b"\x55".ljust(8, b"\0"))))
            reader.join()
            assert decoder.stats.bytes_skipped == 0
            assert decoder.stats.frames > 150
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


# Closing


def test_a_port_is_closed_once() -> None:
    before = descriptors()
    with plugged() as (device, port):
        port.fileno()
        assert repr(port) == f"<canser.Port {device.url} seeed>"
        assert not port.closed
        port.close()
        port.close()
        assert port.closed
        assert repr(port) == f"<canser.Port {device.url} seeed closed>"
        for call in (port.read_batch, port.drain, port.fileno, port.request_status):
            with pytest.raises(canser.PortClosedError, match=f"{device.url} is closed"):
                call()
        with pytest.raises(canser.PortClosedError):
            port.send(traffic(1))
        assert list(port.batches()) == []
        assert port.stats.frames == 0
        assert port.take_gaps() == []
    assert descriptors() == before
    assert not [t for t in threading.enumerate() if t.name == "canser reader"]


@pytest.mark.parametrize("way", ["read", "send", "drain"])
def test_whoever_waits_ends_when_the_port_is_closed(way: str) -> None:
    frames = traffic(100)
    with plugged() as (device, port):
        if way == "read":
            waiter = Background(port.read_batch)
            until(lambda: being_read(port))
        elif way == "send":
            waiter = Background(lambda: port.send(frames))
            until(device.hears)
        else:
            with contextlib.suppress(canser.SendError):
                port.send(frames, timeout=0.05)
            waiter = Background(port.drain)
        Background(port.close).join()
        error = waiter.join().error
        if way == "send":
            assert isinstance(error, canser.SendError)
            assert "the port is closed" in str(error)
            assert 0 < error.sent < len(frames)
        else:
            assert isinstance(error, canser.PortClosedError | canser.PortGoneError)


def test_a_port_that_nobody_closes_is_told_and_closed() -> None:
    before = descriptors()
    with Device() as device:
        ports = [canser.open(device.url, "seeed")]
        with pytest.warns(ResourceWarning, match=f"unclosed <canser.Port {device.url} seeed>"):
            ports.clear()
        canser.open(device.url, "seeed").close()
    assert descriptors() == before


def test_a_port_may_be_collected_in_its_own_thread() -> None:
    """The garbage collector runs in whatever thread allocates."""
    done = threading.Event()
    with Device() as device:
        port = canser.open(device.url, "seeed")
        reader, put = port._reader, port._ring.put

        def collect_in(count: int, ns: int) -> None:
            put(count, ns)
            with reader._ring._lock:
                gc.collect()
            done.set()

        reader._ring.put = collect_in  # type: ignore[method-assign]
        cycle: list[object] = [port]
        cycle.append(cycle)
        gc.disable()
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                del port, cycle
                device.feed(b"x")
                assert done.wait(PATIENCE)
                reader._thread.join(PATIENCE)
                assert not reader._thread.is_alive()
            assert [w.category for w in caught] == [ResourceWarning]
        finally:
            gc.enable()


@pytest.mark.parametrize("how", ["left open", "in a thread", "in a generator"])
def test_a_program_ends_although_its_port_is_open(how: str) -> None:
    program = (
        "import sys, threading, canser\n"
        "port = canser.open(sys.argv[1], 'seeed')\n"
        "if sys.argv[2] == 'in a thread':\n"
        "    threading.Thread(target=port.read_batch, daemon=True).start()\n"
        "batches = port.batches()\n"
        "if sys.argv[2] == 'in a generator':\n"
        "    threading.Thread(target=lambda: next(batches), daemon=True).start()\n"
    )
    with Device() as device:
        run = subprocess.run(
            [sys.executable, "-c", program, device.url, how],
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
        )
        assert (run.returncode, run.stderr) == (0, "")


def test_ports_are_listed() -> None:
    for port in canser.list_ports():
        assert port.url
        assert "n/a" not in (port.name, port.hardware)
