"""Adapters that need time: configured, asked until they listen, and no frame is lost before."""

import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

import canser
import canser.live.setup
from canser import adapters
from canser.adapters import AdapterConfig
from canser.live.reader import Sending
from canser.live.setup import Setup
from canser.simulation.faults import Faults
from canser.simulation.simulator import Simulator
from canser.simulation.traffic import vehicle
from reference import WIRE_FORMATS

posix = pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are POSIX")

if sys.platform != "win32":
    from beside import running
    from device import PATIENCE, Device, until
    from readers import Background, content, plugged, read_configured, waiting

CONFIG = adapters.configuration("seeed", AdapterConfig(bitrate=500_000))
ASK = canser.protocol("seeed").status_request
FRAMES = vehicle(0.2)
FAULTS = Faults(deaf=0.7, swallow=True)


class Adapter:
    """An adapter by a clock of its own. `said`: the packets that it was sent, with the times."""

    def __init__(self, *, deaf: float = 0, swallow: bool = False, mute: bool = False) -> None:
        self.now = 1000.0
        self._begin, self._deaf = self.now, deaf
        self._swallow, self._swallowing, self._mute = swallow, False, mute
        self.configured = False
        self.busy = 0  # writes that find no room
        self.said: list[tuple[float, str]] = []
        self.answers = b""

    def monotonic(self) -> float:
        return self.now

    def write(self, packet: bytes) -> bool:
        if self.busy:
            self.busy -= 1
            return False
        name = {CONFIG: "config", ASK: "ask"}.get(packet, "frame")
        self.said.append((round(self.now - self._begin, 3), name))
        if self.now - self._begin >= self._deaf:
            if self._swallowing:
                self._swallowing = False
            elif packet == CONFIG:
                self.configured, self._swallowing = True, self._swallow
            elif packet == ASK and not self._mute:
                self.answers += ASK
        return True

    def set_up(self, setup: Setup, *, latency: float = 0.001) -> float:
        """Do all steps until the adapter listens; return the seconds that it took."""
        begin, offset = self.now, 0
        while not setup.listening:
            pause = setup.step(self.now, self.write)
            if setup.listening:
                break
            assert pause is not None
            if self.answers and latency <= pause:
                self.now += latency
                setup.take(memoryview(self.answers), offset)
                offset += len(self.answers)
                self.answers = b""
            else:
                self.now += pause
        return round(self.now - begin, 3)


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Adapter, Setup]]:
    """Return a function that makes an adapter, which is configured just now, and its setup."""

    def made(protocol: str = "seeed", packet: bytes = CONFIG, **faults: float) -> tuple:  # type: ignore[type-arg]
        adapter = Adapter(**faults)  # type: ignore[arg-type]
        monkeypatch.setattr(canser.live.setup, "time", adapter)
        setup = Setup(protocol, packet)
        if packet:
            adapter.write(packet)
        setup.start()
        return adapter, setup

    return made


Make = Callable[..., tuple[Adapter, Setup]]


def test_an_adapter_that_answers_at_once(make: Make) -> None:
    adapter, setup = make()
    assert adapter.set_up(setup) == 0.101
    assert adapter.said == [(0, "config"), (0.1, "ask")]
    assert not setup.active  # no answer is missing
    assert not setup.take_silence()


def test_one_that_swallows_the_request_is_configured_again(make: Make) -> None:
    adapter, setup = make(swallow=True)
    assert adapter.set_up(setup) == 0.402
    assert [name for _, name in adapter.said] == ["config", "ask", "ask", "config", "ask", "ask"]
    assert [at for at, _ in adapter.said] == [0, 0.1, 0.2, 0.201, 0.301, 0.401]
    assert adapter.configured
    assert not adapter._swallowing  # the next frame gets through


def test_one_that_is_deaf_is_configured_when_it_listens(make: Make) -> None:
    adapter, setup = make(deaf=0.7)
    assert adapter.set_up(setup) == 0.802
    assert [name for _, name in adapter.said] == ["config", *["ask"] * 7, "config", "ask"]
    assert adapter.configured


def test_one_that_is_deaf_and_swallows(make: Make) -> None:
    adapter, setup = make(deaf=0.7, swallow=True)
    assert adapter.set_up(setup) == 0.902
    assert adapter.configured
    assert not adapter._swallowing
    assert [name for _, name in adapter.said].count("config") == 2


def test_one_that_answers_late_is_configured_twice_at_most(make: Make) -> None:
    adapter, setup = make()
    adapter.set_up(setup, latency=0.09)
    assert [name for _, name in adapter.said] == ["config", "ask"]
    adapter, setup = make(deaf=0.15, swallow=True)
    adapter.set_up(setup, latency=0.0999)
    assert [name for _, name in adapter.said].count("config") == 2
    assert not adapter._swallowing


def test_one_that_never_answers_is_asked_for_two_seconds_and_not_again(make: Make) -> None:
    adapter, setup = make(mute=True)
    assert adapter.set_up(setup) == 2
    assert [name for _, name in adapter.said] == ["config", *["ask"] * 19]
    assert setup.take_silence()
    assert not setup.take_silence()
    for _ in range(2):
        adapter.said.clear()
        setup.start()
        assert adapter.set_up(setup) == 0.7
        assert adapter.said == []
        assert not setup.active
        assert not setup.take_silence()


def test_one_that_answers_no_more_behind_its_second_configuration(make: Make) -> None:
    adapter, setup = make(deaf=0.15)
    write = adapter.write

    def until_configured(packet: bytes) -> bool:
        adapter._mute = adapter.configured
        return write(packet)

    adapter.write = until_configured  # type: ignore[method-assign]
    adapter.set_up(setup)
    assert [name for _, name in adapter.said] == ["config", *["ask"] * 2, "config", *["ask"] * 19]
    assert not setup.take_silence()  # it has answered


def test_a_configuration_behind_another_one_is_written_again(make: Make) -> None:
    """It may be the packet that is swallowed; then the first request is answered."""
    adapter, setup = make(swallow=True)
    adapter.write(CONFIG)
    assert adapter.configured
    adapter.configured = False
    setup.start()
    adapter.set_up(setup)
    assert [name for _, name in adapter.said] == ["config", "config", "ask", "config", "ask", "ask"]
    assert adapter.configured
    adapter.said.clear()
    adapter.write(CONFIG)  # once it listens
    setup.start()
    adapter.set_up(setup)
    assert [name for _, name in adapter.said] == ["config", "ask", "ask", "config", "ask", "ask"]


def test_a_line_that_takes_nothing_is_asked_again(make: Make) -> None:
    adapter, setup = make()
    adapter.busy = 3
    adapter.set_up(setup)
    assert adapter.said == [(0, "config"), (0.4, "ask")]
    adapter, setup = make(deaf=0.15)
    adapter.now += 0.2
    setup.step(adapter.now, adapter.write)
    adapter.now += 0.1
    setup.step(adapter.now, adapter.write)
    adapter.busy = 2
    adapter.set_up(setup)
    assert [name for _, name in adapter.said] == ["config", "ask", "ask", "config", "ask"]


@pytest.mark.parametrize("protocol", canser.protocols())
def test_without_a_configuration_nothing_is_asked(make: Make, protocol: str) -> None:
    adapter, setup = make(protocol, b"")
    assert setup.listening
    assert not setup.active
    assert setup.step(adapter.now, adapter.write) is None
    assert adapter.said == []


@pytest.mark.parametrize("protocol", ["serial", "cantalope"])
def test_without_a_status_request_nothing_is_asked(make: Make, protocol: str) -> None:
    _, setup = make(protocol, b"set")
    assert not setup.asks
    assert setup.listening
    assert not setup.active


def test_answers_are_known_by_where_they_are(make: Make) -> None:
    """In the middle of a stream, behind the end of a frame, in pieces; late ones, too."""
    adapter, setup = make()
    raw = canser.encode(FRAMES[:5], "seeed")
    adapter.now += 0.1
    for _ in range(3):
        setup.step(adapter.now, adapter.write)
        adapter.now += 0.1
    stream = raw[7:] + ASK + raw + ASK + ASK + ASK
    for begin in range(0, len(stream), 11):
        setup.take(memoryview(stream)[begin : begin + 11], 5000 + begin)
    answers = [5000 + len(raw) - 7, 5020 + 2 * len(raw) - 7, 5040 + 2 * len(raw) - 7]
    found = [offset for offset in range(4990, 5000 + len(stream)) if setup.take_answer(offset)]
    assert found == answers  # the fourth was not asked for
    assert not any(map(setup.take_answer, answers))


def test_an_answer_is_one_no_more_when_a_user_asks(make: Make) -> None:
    adapter, setup = make(deaf=0.15)
    adapter.set_up(setup)
    assert setup.active  # the first request is not answered
    setup.end()
    assert not setup.active
    adapter, setup = make(deaf=0.15)
    adapter.set_up(setup)
    adapter.now += 0.99
    setup.step(adapter.now, adapter.write)
    assert setup.active
    adapter.now += 0.01
    assert setup.step(adapter.now, adapter.write) is None
    assert not setup.active


# Over pseudo terminals


def received(device: Simulator, count: int) -> canser.FrameArray:
    until(lambda: device.report().frames_received == count)
    return device.received


@posix
@pytest.mark.parametrize(
    "faults", [FAULTS, Faults(deaf=0.7), Faults(swallow=True), Faults()], ids=str
)
def test_every_frame_gets_through_right_after_opening(faults: Faults) -> None:
    with (
        Simulator("seeed", faults=faults) as device,
        canser.open(device.url, "seeed", bitrate=500_000) as port,
    ):
        assert port.send(FRAMES, timeout=PATIENCE) == len(FRAMES)
        assert content(received(device, len(FRAMES))) == content(FRAMES)
        assert device.configuration is not None
        assert device.configuration.bitrate == 500_000


@posix
def test_every_frame_gets_through_right_after_a_replug(tmp_path: Path) -> None:
    link = str(tmp_path / "port")
    with (
        Simulator("seeed", faults=FAULTS, link=link) as device,
        canser.open(link, "seeed", bitrate=500_000, reconnect=True) as port,
    ):
        port.send(FRAMES)
        received(device, len(FRAMES))
        device.unplug()
        until(lambda: not port._reader.running)
        with pytest.raises(canser.SendError, match="the device is gone"):
            port.send(FRAMES)
        device.replug()
        until(lambda: port._reader.running)
        port.send(FRAMES)
        assert content(received(device, 2 * len(FRAMES))) == content(FRAMES) * 2
        assert device.configuration is not None  # that of the new terminal


@posix
def test_every_frame_gets_through_behind_another_configuration() -> None:
    with (
        Simulator("seeed", faults=Faults(swallow=True)) as device,
        canser.open(device.url, "seeed") as port,
    ):
        port.send(FRAMES)
        port.configure(bitrate=125_000)
        port.send(FRAMES)
        assert content(received(device, 2 * len(FRAMES))) == content(FRAMES) * 2
        assert device.configuration is not None
        assert device.configuration.bitrate == 125_000


@posix
def test_answers_are_counted_and_recorded_but_not_given() -> None:
    seen: list[bytes] = []
    with (
        Simulator("seeed", FRAMES, faults=FAULTS, pace="max") as device,
        canser.open(
            device.url,
            "seeed",
            bitrate=500_000,
            on_bytes=lambda data, *_: seen.append(bytes(data)),
        ) as port,
    ):
        # Found without a read, among the frames that come.
        until(lambda: not port._setup.active)
        assert port.stats.controls == 0
        status = port.request_status(timeout=PATIENCE)
        assert status.kind == "status"
        until(lambda: len(port.read_batch(timeout=0)) == 0 and not waiting(port))
        controls = port.take_controls()
        assert [control.data for control in controls] == [ASK]
        counted = device.report().controls["status"]
        assert port.stats.controls == counted >= 2
        found = canser.Decoder("seeed")
        found.feed(b"".join(seen))
        assert found.stats == port.stats
        assert found.take_controls()[-1] == controls[0]


@posix
def test_a_status_is_waited_for_as_long_as_it_is_asked_for() -> None:
    with (
        Simulator("seeed", faults=FAULTS) as device,
        canser.open(device.url, "seeed", bitrate=500_000) as port,
    ):
        with pytest.raises(canser.PortError, match=r"did not answer the status request within 0 s"):
            port.request_status(timeout=0)
        assert port.status is None
        assert port.request_status(timeout=PATIENCE) == port.status


@posix
def test_only_a_send_waits_and_within_its_time() -> None:
    with plugged(bitrate=500_000) as (device, port):
        with pytest.raises(canser.SendTimeoutError, match="did not say within the") as caught:
            port.send(FRAMES, timeout=0.01)
        assert caught.value.sent == 0
        with pytest.raises(ValueError, match="frame 1"):  # before it waits
            port.send(canser.frames(["123#", "20000080#"]))
        port.send_raw(b"raw")
        assert read_configured(device, b"raw") == CONFIG
        device.feed(canser.encode(FRAMES[:1], "seeed"))
        assert len(port.read_batch(timeout=PATIENCE)) == 1


@posix
def test_a_request_goes_out_behind_the_rest_of_a_packet() -> None:
    """Otherwise a packet that was cut would keep all requests back."""
    with plugged(bitrate=500_000) as (device, port):
        port._reader._sending = Sending(b"the rest")
        assert read_configured(device, b"the rest" + ASK) == CONFIG


@posix
def test_a_send_that_waits_ends_with_its_port() -> None:
    with plugged(bitrate=500_000) as (_, port):
        sender = Background(lambda: port.send(FRAMES))
        port.close()
        error = sender.join().error
        assert isinstance(error, canser.SendError | canser.PortClosedError)
    with plugged(bitrate=500_000) as (device, port):
        sender = Background(lambda: port.send(FRAMES))
        device.unplug()
        assert isinstance(sender.join().error, canser.SendError)


@posix
def test_where_nothing_can_be_asked_the_configuration_settles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    row = replace(canser.protocol("seeed"), status_request=b"")
    monkeypatch.setattr(canser.live.setup, "find_protocol", lambda _: row)
    raw = canser.encode(FRAMES, "seeed")
    with Device() as device:
        begin = time.monotonic()
        with canser.open(device.url, "seeed", bitrate=500_000) as port:
            assert time.monotonic() - begin >= 0.1
            port.send(FRAMES, timeout=0, pace=False)
            begin = time.monotonic()
            port.configure(bitrate=500_000)
            assert time.monotonic() - begin >= 0.1
            assert device.read(40 + len(raw)) == CONFIG + raw + CONFIG
            assert not device.hears()


@contextmanager
def quick(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with monkeypatch.context() as patched:
        patched.setattr(canser.live.setup, "SILENCE_S", 0.25)
        patched.setattr(canser.live.stream, "SILENCE_S", 0.25)
        yield


@posix
@pytest.mark.parametrize("call", ["send", "read_batch", "a read that waits"])
def test_an_adapter_that_does_not_answer_is_told_once_where_it_is_used(
    monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    with quick(monkeypatch), plugged(bitrate=500_000) as (device, port):
        if call == "read_batch":
            until(lambda: port._setup.listening)
        timeout = 0 if call == "read_batch" else 1
        with pytest.warns(canser.CanserWarning) as told:
            port.send(FRAMES[:1]) if call == "send" else port.read_batch(timeout=timeout)
        (warning,) = told.list
        assert str(warning.message).startswith(
            f"{device.url} did not answer its status request within 0.25 s; "
        )
        assert warning.filename == __file__
        assert threading.current_thread() is threading.main_thread()
        port.send(FRAMES[:1])
        port.read_batch(timeout=0)
        assert read_configured(device, canser.encode(FRAMES[:1], "seeed")) == CONFIG


@posix
def test_a_frame_goes_out_though_no_answer_came(monkeypatch: pytest.MonkeyPatch) -> None:
    with quick(monkeypatch), plugged(bitrate=500_000) as (device, port):
        until(lambda: port._setup.listening)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pytest.raises(canser.CanserWarning):
                port.send(FRAMES[:1])
        port.send(FRAMES[:1])  # the warning has sent nothing
        assert read_configured(device, canser.encode(FRAMES[:1], "seeed")) == CONFIG
        assert not device.hears()


@posix
@pytest.mark.parametrize("protocol", canser.protocols())
def test_a_port_without_a_configuration_sends_frames_only(protocol: str) -> None:
    frames = vehicle(0.2, extended=WIRE_FORMATS[protocol].has_ext)
    raw = canser.encode(frames, protocol)
    with plugged(protocol) as (device, port):
        assert not port._setup.active
        port.send(frames, timeout=0)
        assert device.read(len(raw)) == raw
        assert not device.hears()


@posix
def test_the_send_of_the_command_gets_every_frame_through(tmp_path: Path) -> None:
    texts = [f"{number:03X}#01" for number in range(20)]
    link = str(tmp_path / "can")
    with Simulator("seeed", faults=FAULTS, link=link) as device:
        arguments = ("send", "-c", "can", "-p", "seeed", "--bitrate", "500000", *texts)
        with running(tmp_path, *arguments) as run:
            assert run.end() == 0
        assert run.err == ["20 frames sent to can"]
        assert received(device, 20)["id"].tolist() == list(range(20))
