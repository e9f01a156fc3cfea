"""Every fault of a live port, produced: a clear error or a counted event, and nothing lost."""

import contextlib
import errno
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
from bisect import bisect_left
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import canser
from canser._frames import FRAME_DTYPE, FrameArray
from canser.live.reader import Sending
from canser.simulation.traffic import line_noise, vehicle
from device import PATIENCE, Device, descriptors, until
from readers import (
    Background,
    being_read,
    collect,
    content,
    plugged,
    read_config,
    traffic,
    waiting,
)
from reference import Frame
from samples import array

# Bytes come here faster than any line has them, and so the device's clock looks too slow.
pytestmark = pytest.mark.filterwarnings("ignore:.*the device clock:canser.CanserWarning")

MIB = 1 << 20


# A device that goes away


def test_unplugged_while_reading_delivers_what_was_read_first() -> None:
    frames = traffic(1)
    raw = canser.encode(frames, "seeed")
    with plugged() as (device, port):
        device.feed(raw)
        until(lambda: waiting(port) == len(raw))
        device.unplug()
        assert content(collect(port, len(frames), max_frames=100)) == content(frames)
        for _ in range(2):  # and so it stays
            with pytest.raises(canser.PortGoneError, match=f"{device.url} is gone: unplugged"):
                port.read_batch()
        with pytest.raises(canser.PortGoneError):
            list(port.batches())
        assert not port.closed


def test_unplugged_in_the_middle_of_a_frame() -> None:
    raw = canser.encode(traffic(1)[:2], "seeed")
    with plugged() as (device, port):
        device.feed(raw[:-1])
        until(lambda: waiting(port) == len(raw) - 1)
        device.unplug()
        assert len(port.read_batch(min_frames=2)) == 1
        with pytest.raises(canser.PortGoneError):
            port.read_batch()
        assert port.stats.pending == 0
        assert port.stats.rejects["cut"] > 0


def test_unplugged_while_somebody_waits() -> None:
    with plugged() as (device, port):
        reader = Background(port.read_batch)
        until(lambda: being_read(port))
        device.unplug()
        assert isinstance(reader.join().error, canser.PortGoneError)


def test_unplugged_while_writing() -> None:
    """A frame that was cut is not said to be sent: its rest never goes out."""
    frames = traffic(100)
    raw = canser.encode(frames, "seeed")
    with plugged() as (device, port):
        sender = Background(lambda: port.send(frames))
        heard = device.read(4000)
        device.unplug()
        error = sender.join().error
        assert isinstance(error, canser.SendError)
        assert "gone" in str(error)
        assert heard == raw[:4000]
        assert len(canser.decode(heard, "seeed")) <= error.sent < len(frames)
        with pytest.raises(canser.SendError) as caught:
            port.send(frames)
        assert caught.value.sent == 0
        with pytest.raises(canser.PortGoneError):
            port.drain()


def test_a_server_that_hangs_up_while_somebody_writes() -> None:
    """All that was taken by the system is counted, and no frame that was not whole."""
    frames = traffic(1000)
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        with canser.open(url, "seeed") as port:
            client, _ = server.accept()
            sender = Background(lambda: port.send(frames))
            client.recv(1)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            client.close()  # with a reset
            error = sender.join().error
            assert isinstance(error, canser.SendError)
            assert 0 < error.sent < len(frames)
            with pytest.raises(canser.PortGoneError):
                port.read_batch()


def test_a_port_that_was_never_there() -> None:
    before = descriptors()
    with Device() as device:
        url = device.url
    for name in ("/dev/no-such-port", url):
        with pytest.raises(canser.PortNotFoundError, match=f"no port {name}; is the adapter"):
            canser.open(name, "seeed")
    assert descriptors() == before


def test_a_device_that_does_not_take_its_configuration() -> None:
    before = descriptors()
    with Device() as device:
        raw_port = canser.open(device.url, "seeed")
        with contextlib.suppress(canser.SendError):
            raw_port.send(traffic(20), timeout=0.1)
        raw_port.close()
        until(lambda: raw_port.closed)
        fill = os.open(device.url, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(fill, bytes(4096))
        os.close(fill)
        with pytest.raises(canser.PortError, match="does not take the adapter's configuration"):
            canser.open(device.url, "seeed", bitrate=500_000)
        with Device() as other:  # the port is free again
            assert other.url != device.url
        canser.open(device.url, "seeed").close()
    assert descriptors() == before


@pytest.mark.parametrize("name", ["canser connecting", "canser reader"])
def test_where_no_thread_can_be_started_the_line_is_closed_again(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    start = threading.Thread.start

    def fail(thread: threading.Thread) -> None:
        if thread.name == name:
            raise RuntimeError("can't start new thread")
        start(thread)

    with Device() as device:
        before = descriptors()
        with monkeypatch.context() as patched:
            patched.setattr(threading.Thread, "start", fail)
            with pytest.raises(
                canser.PortError, match=f"^{device.url}: can't start new thread; .*ulimit -u"
            ):
                canser.open(device.url, "seeed")
        assert descriptors() == before
        canser.open(device.url, "seeed").close()


@pytest.mark.parametrize(
    ("raised", "kind", "text"),
    [
        (OSError(errno.ENOMEM, "Cannot allocate memory"), canser.PortError, "Cannot allocate"),
        (OSError(errno.EIO, "Input/output error"), canser.PortGoneError, "unplugged"),
        (AttributeError("'NoneType' object"), canser.PortError, "AttributeError 'NoneType'"),
        (ValueError(), canser.PortError, "ValueError"),
    ],
)
def test_whatever_ends_the_thread_names_the_port(
    monkeypatch: pytest.MonkeyPatch, raised: Exception, kind: type[Exception], text: str
) -> None:
    def fail(*_: object) -> None:
        raise raised

    with plugged() as (device, port):
        with monkeypatch.context() as patched:
            patched.setattr(os, "readv", fail)
            device.feed(b"1")
            with pytest.raises(kind, match=re.escape(device.url) + ".*" + text) as caught:
                port.read_batch(timeout=PATIENCE)
        assert type(caught.value) is kind


def test_errors_of_writing_name_the_port_once(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.ENOMEM, "Cannot allocate memory")

    with plugged() as (device, port):
        with monkeypatch.context() as patched:
            patched.setattr(os, "write", fail)
            with pytest.raises(canser.SendError) as caught:
                port.send(traffic(1))
        assert str(caught.value).startswith(f"{device.url}: Cannot allocate memory; 0 of ")
        device.unplug()
        until(lambda: port._reader._line is None)
        with pytest.raises(canser.SendError, match=f"^{device.url}: the device is gone; 0 of "):
            port.send(traffic(1))
        calls: list[Callable[[], int]] = [port.drain, lambda: port.bytes_unsent]
        for call in calls:
            with pytest.raises(canser.PortGoneError, match=f"^{device.url}: the device is gone"):
                call()


def test_a_descriptor_that_cannot_be_made_names_the_port(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    with plugged() as (device, port), monkeypatch.context() as patched:
        patched.setattr(os, "pipe", fail)
        with pytest.raises(canser.PortError, match=f"^{device.url}: Too many open files"):
            port.fileno()


# A device that comes back


@contextlib.contextmanager
def replugged(
    tmp_path: Path, protocol: str = "seeed", **options: Any
) -> Iterator[tuple[Device, canser.Port, Callable[[], Device]]]:
    """Yield a device, its port, and a function that plugs it out and in again."""
    link = tmp_path / "port"
    devices = [Device()]
    link.symlink_to(devices[0].url)

    def replug() -> Device:
        new = Device()
        devices.append(new)
        fresh = tmp_path / "new"
        fresh.symlink_to(new.url)
        fresh.replace(link)
        devices[-2].unplug()
        return new

    try:
        with canser.open(str(link), protocol, reconnect=True, **options) as port:
            yield devices[0], port, replug
    finally:
        for device in devices:
            device.unplug()


def test_a_device_that_comes_back_goes_on_behind_a_marked_gap(tmp_path: Path) -> None:
    frames = traffic(1)
    raw = canser.encode(frames, "seeed")
    seen: list[tuple[bytes, int]] = []

    def on_bytes(data: memoryview, _: int, lost: int) -> None:
        seen.append((bytes(data), lost))

    before = time.time_ns()
    with replugged(tmp_path, on_bytes=on_bytes) as (device, port, replug):
        device.feed(raw + raw[:5])  # the first half of a frame, of which the rest is lost
        until(lambda: waiting(port) == len(raw) + 5)
        new = replug()
        new.feed(raw)
        got = collect(port, 2 * len(frames))
        assert content(got) == content(frames) * 2
        (gap,) = port.take_gaps()
        assert (gap.offset, gap.lost, gap.reason) == (len(raw) + 5, -1, "reconnect")
        assert before < gap.ts <= time.time_ns()
        assert [lost for _, lost in seen if lost] == [-1]
        assert b"".join(data for data, _ in seen) == raw + raw[:5] + raw
        assert port.stats.bytes_skipped == 5
        sender = Background(lambda: port.send(frames))
        assert new.read(len(raw)) == raw
        sender.join()


def test_a_packet_does_not_go_on_on_another_line(tmp_path: Path) -> None:
    frames = traffic(20)
    with replugged(tmp_path) as (_, port, replug):
        with pytest.raises(canser.SendError):
            port.send(frames, timeout=0.05)  # in the middle of a frame, as a rule
        port._reader._sending = Sending(b"the rest")  # and here for sure
        new = replug()
        until(lambda: port.take_gaps() or not len(port.read_batch(timeout=0)))
        mark = array(Frame(0x7E5, dlc=1, data=b"\x55".ljust(8, b"\0")))

        def send() -> bool:
            try:
                return bool(port.send(mark))
            except canser.SendError:
                return False

        until(send)
        raw = canser.encode(mark, "seeed")
        assert new.read(len(raw)) == raw


def test_a_device_that_comes_back_is_configured_again(tmp_path: Path) -> None:
    first = canser.adapters.configuration("seeed", canser.AdapterConfig(bitrate=250_000))
    second = canser.adapters.configuration("seeed", canser.AdapterConfig(bitrate=125_000))
    with replugged(tmp_path, bitrate=250_000) as (device, port, replug):
        assert read_config(device) == first
        new = replug()
        assert read_config(new) == first
        until(lambda: port._reader._line is not None)
        port.configure(bitrate=125_000)
        assert read_config(new) == second
        assert read_config(replug()) == second


def test_a_port_may_be_closed_while_its_device_is_away() -> None:
    with plugged(reconnect=True) as (device, port):
        reader = Background(port.read_batch)
        device.unplug()
        until(lambda: port._reader._line is None)
        with pytest.raises(canser.SendError, match="the device is gone"):
            port.send(traffic(1))
        with pytest.raises(canser.PortGoneError, match="the device is gone"):
            port.drain()
        port.close()
        assert isinstance(reader.join().error, canser.PortClosedError)


def test_a_device_that_comes_back_as_something_else_is_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whatever goes wrong in the thread, who reads hears of it."""
    with plugged(reconnect=True) as (device, port):

        def connect() -> None:
            raise RuntimeError("not what anybody expected")

        monkeypatch.setattr(port._reader, "_connect", connect)
        device.unplug()
        with pytest.raises(canser.PortError, match="not what anybody expected"):
            port.read_batch()


# Ports that are not to be had


def in_a_child(call: Callable[[], object]) -> str:
    """Call in a forked process; return the error's kind and message."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        text = "no error"
        try:
            call()
        except BaseException as error:  # noqa: BLE001 - told to the parent
            text = f"{type(error).__name__}: {error}"
        finally:
            os.write(writing, text.encode())
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        text = pipe.read().decode()
    os.waitpid(child, 0)
    return text


def as_nobody(call: Callable[[], object]) -> str:
    """Call in a process of a user with no rights; return the error's kind and message."""

    def call_without_rights() -> None:
        os.setgroups([])
        os.setgid(65534)
        os.setuid(65534)
        call()

    return in_a_child(call_without_rights)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
@pytest.mark.parametrize(
    ("mode", "remedy"),
    [
        (0o660, "it belongs to the group {group}, and this user does not; 'sudo usermod -aG"),
        (0o600, "its group {group} may not read and write; 'sudo chmod g+rw {url}'"),
    ],
)
def test_permission_denied(mode: int, remedy: str) -> None:
    with Device() as device:
        path = Path(device.url)
        path.chmod(mode)
        text = as_nobody(lambda: canser.open(device.url, "seeed"))
        url = device.url
        remedy = remedy.format(group=path.group(), url=url)
    assert text.startswith(f"PortDeniedError: {url} may not be opened by this user: {remedy}")


def test_a_busy_port() -> None:
    frames = traffic(1)
    before = descriptors()
    with plugged() as (device, port):
        device.feed(canser.encode(frames, "seeed"))
        inside = descriptors()
        for flush in (False, True):
            with pytest.raises(canser.PortBusyError, match="is open in another program"):
                canser.open(device.url, "seeed", line=canser.LineConfig(flush=flush))
        assert descriptors() == inside
        assert content(collect(port, len(frames))) == content(frames)
    assert descriptors() == before


# Wrong bytes


def test_partial_frames_across_reads() -> None:
    frames = traffic(1)[:20]
    raw = canser.encode(frames, "seeed")
    got: list[FrameArray] = []
    with plugged() as (device, port):
        for byte in raw:
            device.feed(bytes([byte]))
            device.fed()
            until(lambda: waiting(port))
            got.append(port.read_batch(timeout=0))
        assert max(map(len, got)) == 1
        assert content(np.concatenate(got)) == content(frames)


def heard_at_a_wrong_rate(data: bytes, speed: float) -> bytes:
    """Return what a receiver hears that samples so many times as fast as the bits come."""
    bits = np.ones((len(data), 10), np.uint8)
    bits[:, 0] = 0
    bits[:, 1:9] = np.unpackbits(np.frombuffer(data, np.uint8)[:, None], 1, bitorder="little")
    line = bits.ravel()
    falls = np.flatnonzero(line == 0).tolist()
    heard, position = [], 0.0
    while (place := bisect_left(falls, position)) < len(falls):
        start = max(float(falls[place]), position)
        samples = (start + (np.arange(1, 9) + 0.5) / speed).astype(int)
        if samples[-1] >= len(line):
            break
        heard.append(np.packbits(line[samples], bitorder="little")[0])
        position = start + 9.5 / speed
    return bytes(heard)


def warned(protocol: str, raw: bytes) -> list[str]:
    """Return the warnings of skipped bytes while these are read."""
    with warnings.catch_warnings(record=True) as caught, plugged(protocol) as (device, port):
        warnings.simplefilter("always")
        device.feed(raw)
        while port.stats.bytes_in < len(raw):
            port.read_batch(timeout=0.001)
    assert {w.category for w in caught} <= {canser.CanserWarning}
    return [str(w.message) for w in caught if "of the bytes are in no" in str(w.message)]


@pytest.mark.parametrize("speed", [0.25, 0.5, 0.8, 1.2])
@pytest.mark.parametrize("protocol", canser.protocols())
def test_a_wrong_bit_rate_is_told_once(protocol: str, speed: float) -> None:
    raw = canser.encode(traffic(60, protocol), protocol)[: int(10_000 / speed)]
    (text,) = warned(protocol, heard_at_a_wrong_rate(raw, speed))
    assert f"are in no {protocol} frame; are the baud rate and the protocol right?" in text


@pytest.mark.parametrize("protocol", canser.protocols())
def test_a_wrong_protocol_is_told(protocol: str) -> None:
    for other in set(canser.protocols()) - {protocol}:
        assert len(warned(protocol, canser.encode(traffic(5, other), other))) == 1


@pytest.mark.parametrize("protocol", canser.protocols())
def test_a_bad_line_is_no_wrong_bit_rate(protocol: str) -> None:
    raw = canser.encode(traffic(20, protocol), protocol)
    assert warned(protocol, line_noise(raw, rate=0.01)) == []


# A slow consumer


def test_a_stall_of_the_consumer_loses_nothing() -> None:
    """1.2 MB: six seconds of a line at 2 Mbaud."""
    frames = np.tile(traffic(10), 6)
    raw = canser.encode(frames, "seeed")
    raw = raw * (6 * MIB // 5 // len(raw) + 1)
    with plugged() as (device, port):
        device.feed(raw)
        device.fed()  # although nobody reads
        until(lambda: waiting(port) == len(raw))
        assert 0 < port.ring_fill < 1
        device.unplug()
        count = 0
        with contextlib.suppress(canser.PortGoneError):
            while True:
                batch = port.read_batch()
                expected = frames[(np.arange(len(batch)) + count) % len(frames)]
                assert batch["data"].tobytes() == expected["data"].tobytes()
                count += len(batch)
        assert count == len(raw) // len(canser.encode(frames, "seeed")) * len(frames)
        assert port.bytes_lost == port.stats.bytes_skipped == 0
        assert port.take_gaps() == []


def test_a_longer_stall_is_counted_to_the_byte() -> None:
    frames = traffic(60)
    raw = canser.encode(frames, "seeed")
    size = 1 << 16
    kept = bytearray()
    with plugged(
        line=canser.LineConfig(ring_size=size), on_bytes=lambda data, *_: kept.extend(data)
    ) as (device, port):
        device.feed(raw)
        device.fed()
        until(lambda: waiting(port) + port.bytes_lost == len(raw))
        assert port.ring_fill == 1
        assert port.bytes_lost == len(raw) - size
        expected = canser.decode(raw[:size], "seeed")
        assert content(collect(port, len(expected))) == content(expected)
        assert len(port.read_batch(timeout=0)) == 0
        (gap,) = port.take_gaps()
        assert (gap.offset, gap.lost, gap.reason) == (size, len(raw) - size, "overflow")
        assert bytes(kept) == raw[:size]
        # There is room again, and nothing of what comes now is lost.
        device.feed(raw[: size // 2])
        expected = canser.decode(raw[: size // 2], "seeed")
        assert content(collect(port, len(expected))) == content(expected)
        assert port.bytes_lost == len(raw) - size


def test_a_ring_that_was_just_full_and_is_read_loses_nothing() -> None:
    """The thread waits for bytes it would throw away; who reads makes room meanwhile."""
    size = 1 << 16
    frames = traffic(60)
    raw = canser.encode(frames, "seeed")
    with plugged(line=canser.LineConfig(ring_size=size)) as (device, port):
        device.feed(raw[:size])
        until(lambda: waiting(port) == size)
        until(lambda: port._ring.room() is None)
        first = canser.decode(raw[:size], "seeed")
        assert len(collect(port, len(first))) == len(first)
        device.feed(raw[size : size + 3000])
        until(lambda: waiting(port) + port.bytes_lost == 3000)
        assert port.bytes_lost == 0
        both = canser.decode(raw[: size + 3000], "seeed")
        assert len(collect(port, len(both) - len(first))) == len(both) - len(first)


# Signals


READER = """
import signal, sys, canser
port = canser.open(sys.argv[1], "seeed")
if sys.argv[2] == "handler":
    signal.signal(signal.SIGTERM, lambda *_: port.close())
print("ready", flush=True)
count = 0
try:
    with port:
        for batch in port.batches(timeout=float(sys.argv[3])):
            count += len(batch)
            print(count, flush=True)
except KeyboardInterrupt:
    print("interrupted", flush=True)
print("end", count, flush=True)
"""


@pytest.mark.parametrize(
    ("number", "how", "last", "code"),
    [
        (signal.SIGINT, "plain", "end 9", 0),
        (signal.SIGTERM, "handler", "end 9", 0),
        (signal.SIGTERM, "plain", "9", -signal.SIGTERM),
        (signal.SIGKILL, "plain", "9", -signal.SIGKILL),
    ],
)
def test_signals_end_a_program_and_leave_the_port_free(
    number: signal.Signals, how: str, last: str, code: int
) -> None:
    with Device() as device:
        command = [sys.executable, "-W", "error", "-c", READER, device.url, how, "0.01"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            device.feed(canser.encode(traffic(1)[:9], "seeed"))
            while process.stdout.readline() != "9\n":
                assert process.poll() is None
            process.send_signal(number)
            rest = process.stdout.read().split("\n")
            assert process.wait(PATIENCE) == code
        assert (rest[-2] if len(rest) > 1 else "9") == last
        with canser.open(device.url, "seeed") as port:
            device.feed(canser.encode(traffic(1)[:9], "seeed"))
            assert len(collect(port, 9)) == 9


def test_a_handler_may_close_the_port_at_any_place() -> None:
    """Signals come at any line of the main thread, locks held or not."""
    frames = np.tile(traffic(5), 20)
    raw = canser.encode(frames, "seeed")
    for microseconds in range(200, 4200, 200):
        with plugged() as (device, port):
            device.feed(raw)
            before = signal.signal(signal.SIGALRM, lambda *_: port.close())
            signal.setitimer(signal.ITIMER_REAL, microseconds / 1e6)
            try:
                while not port.closed:
                    with contextlib.suppress(canser.PortClosedError, canser.SendError):
                        port.read_batch(max_frames=50)
                        port.send(frames[:50])
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
                signal.signal(signal.SIGALRM, before)


# Fork


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_forked_process_gets_an_error_and_harms_nothing() -> None:
    frames = traffic(1)
    with plugged() as (device, port):
        reader = Background(port.read_batch)
        until(lambda: being_read(port))  # locks are held over the fork
        for call in (
            port.read_batch,
            lambda: port.send(frames),
            lambda: list(port.batches()),
            port.request_status,
            port.fileno,
            port.drain,
        ):
            text = in_a_child(call)
            assert text.startswith(f"PortError: {device.url} was opened by process {os.getpid()}")
            assert text.endswith("open it in the process that uses it")
        assert in_a_child(port.close) == "no error"
        assert in_a_child(port.__del__) == "no error"
        device.feed(canser.encode(frames, "seeed"))
        got = reader.join().result
        assert isinstance(got, np.ndarray)
        rest = collect(port, len(frames) - len(got))
        assert content(np.concatenate([got, rest])) == content(frames)
        sender = Background(lambda: port.send(frames))
        assert device.read(20) == canser.encode(frames, "seeed")[:20]
        port.close()
        sender.join()


# The watchdog of cantalope


PING = b"\xff\xff\x00"


class Answering:
    """A device that sends pings back as long as it is `answering`."""

    def __init__(self, device: Device, *, answering: bool = True) -> None:
        self.answering = threading.Event()
        if answering:
            self.answering.set()
        self.pings = 0
        self._ending = threading.Event()
        self._device = device
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> "Answering":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join(PATIENCE)

    def _run(self) -> None:
        decoder = canser.Decoder("cantalope")
        while not self._ending.is_set():
            if self._device.hears(0.01):
                decoder.feed(self._device.read_some())
                for _ in decoder.take_controls():
                    self.pings += 1
                    if self.answering.is_set():
                        self._device.feed(PING)


def test_a_ping_that_comes_back() -> None:
    frames = traffic(1, "cantalope")
    # So seldom that no machine is too busy to answer in time.
    with (
        plugged("cantalope", line=canser.LineConfig(ping=1)) as (device, port),
        Answering(device) as far,
    ):
        device.feed(canser.encode(frames, "cantalope"))
        assert content(collect(port, len(frames))) == content(frames)
        until(lambda: len(port.read_batch(timeout=0.001)) or port.stats.controls == 2)
        assert far.pings == 2
        assert {control.data for control in port.take_controls()} == {PING}
        assert port.take_gaps() == []


def test_pings_go_out_between_frames_and_never_within() -> None:
    frames = np.tile(traffic(1, "cantalope"), 5)
    raw = canser.encode(frames, "cantalope")
    with plugged("cantalope", line=canser.LineConfig(ping=0.001)) as (device, port):

        def send() -> None:
            for start in range(0, len(frames), 100):
                port.send(frames[start : start + 100])

        sender = Background(send)
        decoder = canser.Decoder("cantalope")
        got: list[FrameArray] = []
        while decoder.stats.bytes_framed < len(raw):
            got.append(decoder.feed(device.read_some()))
        sender.join()
        assert content(np.concatenate(got)) == content(frames)
        assert decoder.stats.controls
        assert decoder.stats.bytes_skipped == 0


def test_a_ping_that_does_not_come_back() -> None:
    with (
        warnings.catch_warnings(record=True) as caught,
        plugged("cantalope", line=canser.LineConfig(ping=0.01)) as (device, port),
        Answering(device, answering=False) as far,
    ):
        warnings.simplefilter("always")
        gaps: list[canser.Gap] = []

        def lost() -> bool:
            port.read_batch(timeout=0.01)
            gaps.extend(port.take_gaps())
            return bool(gaps)

        until(lost)
        assert [(gap.offset, gap.lost, gap.reason) for gap in gaps] == [(0, -1, "watchdog")]
        pings = far.pings
        until(lambda: far.pings > pings)  # it goes on asking
        far.answering.set()
        until(lambda: len(port.read_batch(timeout=0.01)) or port.stats.controls)
        assert port.take_gaps() == []
    (warning,) = caught
    assert warning.category is canser.CanserWarning
    assert "the ping does not come back" in str(warning.message)


@pytest.mark.filterwarnings("ignore::canser.CanserWarning")
def test_a_stream_out_of_step_finds_the_place_at_the_ping() -> None:
    """The rest of a frame is lost, and so it would eat what follows."""
    with plugged("cantalope", line=canser.LineConfig(ping=0.01)) as (device, port):
        # Eight bytes are said to follow, and two do.
        device.feed(b"\x00\x28" + b"\x11\x22")
        until(lambda: len(port.read_batch(timeout=0.01)) or port.take_gaps())
        good = array(Frame(0x123, dlc=2, data=b"\x33\x44".ljust(8, b"\0")))
        device.feed(PING + canser.encode(good, "cantalope"))
        until(lambda: content(port.read_batch(timeout=0.01)[-1:]) == content(good))
        assert port.stats.bytes_skipped > 0


def test_a_device_that_is_away_has_no_lost_ping(tmp_path: Path) -> None:
    with replugged(tmp_path, "cantalope", line=canser.LineConfig(ping=1)) as (device, port, replug):
        with Answering(device) as far:
            until(lambda: len(port.read_batch(timeout=0.001)) or port.stats.controls)
            assert far.pings
        port_path = Path(port.url)
        target = port_path.readlink()
        port_path.unlink()
        device.unplug()
        until(lambda: port._ring.at_gap)
        port.read_batch(timeout=0)
        watchdog = port._stream._watchdog
        assert watchdog is not None
        now, watchdog.now = watchdog.now, lambda: time.time_ns() + 10**12  # the ping was long ago
        port._stream._watch()
        watchdog.now = now
        assert [gap.reason for gap in port.take_gaps()] == ["reconnect"]
        port_path.symlink_to(target)
        new = replug()
        with Answering(new):
            controls = port.stats.controls
            until(lambda: len(port.read_batch(timeout=0.01)) or port.stats.controls > controls)
            assert [gap.reason for gap in port.take_gaps()] == []


@pytest.mark.filterwarnings("ignore::canser.CanserWarning")
def test_a_reader_that_is_never_idle_sees_a_lost_ping() -> None:
    """Frames come all the time, and so nobody ever waits."""
    frames = traffic(1, "cantalope")
    raw = canser.encode(frames, "cantalope")
    with plugged("cantalope", line=canser.LineConfig(ping=0.01)) as (device, port):
        out = np.empty(50, FRAME_DTYPE)
        device.feed(raw)

        def gone_wrong() -> bool:
            if waiting(port) < 5000:
                device.feed(raw)
                until(lambda: waiting(port) >= 5000)
            port.read_batch(out)
            return bool(port.take_gaps())

        until(gone_wrong)


def test_the_vehicle_has_no_frame_of_the_mark() -> None:
    """Tests here tell a frame by an id that no other frame has."""
    assert not (vehicle(60)["id"] == 0x7E5).any()
