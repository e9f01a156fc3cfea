"""The simulated adapter, from the host's side of a real pseudo terminal."""

import copy
import io
import os
import pickle
import select
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import canser
from canser import adapters
from canser._frames import FrameArray
from canser.simulation.faults import Faults
from canser.simulation.simulator import Simulator, SimulatorReport
from canser.simulation.traffic import Damaged, damage, vehicle
from device import descriptors
from reference import NO_TIME, Frame
from samples import array, listed, timed

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are POSIX")

# Nothing here takes long; a machine that is busy with other things may.
PATIENCE = 60

PROTOCOLS = canser.protocols()
FRAMES = vehicle(2, extended=False)


class Host:
    """A plain descriptor of the host's side, that reads in small pieces and large ones."""

    def __init__(self, path: str) -> None:
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def readable(self, timeout: float) -> bool:
        waiting = select.poll()
        waiting.register(self.fd, select.POLLIN)
        return bool(waiting.poll(timeout * 1000))

    def read(self, count: int) -> bytes:
        """Return so many bytes; fewer at a hangup."""
        data = b""
        while len(data) < count:
            assert self.readable(PATIENCE), f"{len(data)} bytes of {count} came"
            part = os.read(self.fd, count - len(data))
            if not part:
                break
            data += part
        return data

    def read_all(self, device: Simulator) -> bytes:
        """Return all that comes until the device says that it has sent all."""
        data = bytearray()
        deadline = time.monotonic() + PATIENCE
        while not device.wait(0):
            assert time.monotonic() < deadline
            data += self.take()
        return bytes(data)

    def take(self) -> bytes:
        """Return what is there, or comes soon."""
        return os.read(self.fd, 65_536) if self.readable(0.02) else b""

    def write(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self.fd, data) :]
            except BlockingIOError:
                time.sleep(0.001)


@contextmanager
def host(device: Simulator) -> Iterator[Host]:
    one = Host(device.url)
    try:
        yield one
    finally:
        os.close(one.fd)


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def check(report: SimulatorReport) -> None:
    """Assert the law of what is sent."""
    assert report.bytes_sent == (
        report.bytes_encoded - report.bytes_lost + report.bytes_inserted + report.bytes_answered
    )
    assert 0 <= report.frames_intact <= report.frames


def configuration(**settings: Any) -> bytes:
    """Return the packet that configures an adapter, by default to 500 kbit/s."""
    config = canser.AdapterConfig(**{"bitrate": 500_000, **settings})
    return adapters.configuration("seeed", config)


def open_descriptors() -> list[str]:
    return sorted(path.name for path in Path("/proc/self/fd").iterdir())


@pytest.mark.parametrize("pace", ["line", "max"])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_byte_is_read_and_reported(protocol: str, pace: str) -> None:
    copy = io.BytesIO()
    with (
        Simulator(protocol, FRAMES, pace=pace, baudrate=4_000_000, copy=copy) as device,
        host(device) as one,
    ):
        data = one.read_all(device)
        report = device.report()
    assert data == canser.encode(FRAMES, protocol) == copy.getvalue()
    assert set(data) == set(range(256))
    assert report == device.report()
    assert (report.frames, report.frames_intact) == (len(FRAMES), len(FRAMES))
    assert report.bytes_sent == report.bytes_encoded == len(data)
    assert report.bytes_unread == report.flushes == report.bytes_lost == 0
    check(report)


def test_traffic_in_parts_of_any_size() -> None:
    parts = [FRAMES[:0], FRAMES[:1], FRAMES[1:1], FRAMES[1:]]
    with Simulator("seeed", iter(parts), pace="max") as device, host(device) as one:
        assert one.read_all(device) == canser.encode(FRAMES, "seeed")


def test_traffic_that_does_not_come_keeps_neither_answers_nor_the_end() -> None:
    more = threading.Event()

    def parts() -> Iterator[FrameArray]:
        yield FRAMES[:10]
        more.wait(PATIENCE)

    ping = canser.protocol("cantalope").ping
    with Simulator("cantalope", parts(), pace="max") as device, host(device) as one:
        one.read(len(canser.encode(FRAMES[:10], "cantalope")))
        assert not device.finished
        one.write(ping)
        assert one.read(len(ping)) == ping
        device.stop()
        assert device.wait(PATIENCE)
        more.set()


def test_late_traffic_goes_on_by_its_times_without_a_burst() -> None:
    more = threading.Event()
    frames = timed(*(n * 10_000_000 for n in range(20)))

    def parts() -> Iterator[FrameArray]:
        yield frames[:10]
        more.wait(PATIENCE)
        yield frames[10:]

    with Simulator("serial", parts()) as device, host(device) as one:
        one.read(len(canser.encode(frames[:10], "serial")))
        time.sleep(0.3)  # longer than what is left
        begin = time.monotonic()
        more.set()
        one.read_all(device)
        assert time.monotonic() - begin >= 0.08


def test_nothing_is_sent_before_a_host_has_opened_it_and_none_when_it_is_gone() -> None:
    with Simulator("seeed", FRAMES, pace="max") as device:
        assert not device.connected
        assert not device.wait(0.3)
        assert device.report().bytes_sent == 0
        with host(device) as one:
            data = one.read(5_000)
            assert device.connected
        until(lambda: not device.connected)
        sent = device.report().bytes_sent
        assert not device.wait(0.3)
        assert device.report().bytes_sent == sent
        with host(device) as one:
            data += one.read_all(device)
    assert data == canser.encode(FRAMES, "seeed")
    assert device.report().bytes_unread == 0


def test_what_nobody_reads_is_counted() -> None:
    with Simulator("seeed", FRAMES, pace="max") as device, host(device) as one:
        data = one.read(100)
        until(lambda: device.report().bytes_sent > 5_000)
        device.close()
        assert one.read(1) == b""
    report = device.report()
    assert report.bytes_sent == len(data) + report.bytes_unread
    assert report.bytes_unread > 4_000
    check(report)


def test_a_flush_of_the_host_is_seen() -> None:
    with Simulator("seeed", FRAMES, pace="max") as device, host(device) as one:
        one.read(100)
        termios.tcflush(one.fd, termios.TCIFLUSH)
        until(lambda: device.report().flushes == 1)
        assert one.read(100)


def test_a_flush_right_after_opening_loses_nothing() -> None:
    with Simulator("seeed", FRAMES, pace="max") as device, host(device) as one:
        termios.tcflush(one.fd, termios.TCIFLUSH)
        assert one.read_all(device) == canser.encode(FRAMES, "seeed")
        assert device.report().flushes == 0


def test_a_flush_of_what_the_host_before_has_left_is_seen() -> None:
    with Simulator("seeed", FRAMES, pace="max") as device:
        with host(device) as one:
            one.read(10)
            until(lambda: device.report().bytes_sent > 5_000)
        until(lambda: not device.connected)
        with host(device) as one:
            termios.tcflush(one.fd, termios.TCIFLUSH)
            until(lambda: device.report().flushes == 1)


def test_the_line_sets_the_pace() -> None:
    data = canser.encode(FRAMES[:1000], "seeed")
    rate = 200_000
    with (
        Simulator("seeed", FRAMES[:1000], pace="line", baudrate=rate) as device,
        host(device) as one,
    ):
        begin = time.monotonic()
        assert one.read_all(device) == data
        assert time.monotonic() - begin >= len(data) * 10 / rate


def test_the_times_of_the_frames_set_the_pace() -> None:
    second = 1_000_000_000
    frames = timed(7 * second, 7 * second + 100_000_000, 7 * second + 600_000_000)
    with Simulator("serial", frames, pace="traffic") as device, host(device) as one:
        first = one.read(len(canser.encode(frames[:1], "serial")))
        begin = time.monotonic()
        rest = one.read_all(device)
        # The first one may be read late, by a tick of the device.
        assert time.monotonic() - begin >= 0.5
    assert first + rest == canser.encode(frames, "serial")


def test_a_frame_that_is_due_within_a_millisecond_is_not_kept_for_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What the thread waits in all is what it is to wait: polling knows whole milliseconds."""
    waited = []

    class Poll:
        def register(self, *_: object) -> None:
            pass

        def poll(self, timeout_ms: int) -> list[tuple[int, int]]:
            waited.append(timeout_ms * 1_000_000)
            return []

    device = Simulator("serial")
    device._wake_out = -1
    monkeypatch.setattr(select, "poll", Poll)
    monkeypatch.setattr(time, "sleep", lambda seconds: waited.append(round(seconds * 1e9)))
    monkeypatch.setattr(time, "monotonic_ns", lambda: 100)
    for wait in (0, 300_000, 1_000_000, 7_250_000):
        waited.clear()
        device._stepped_ns = 0
        device._pause(100 + wait)
        assert sum(waited) == wait


def test_the_pace_of_the_frames_needs_their_times() -> None:
    device = Simulator("seeed", array(Frame(1, ts=NO_TIME)), pace="traffic")
    before = open_descriptors()
    with pytest.raises(ValueError, match="by their times, and these have none"), device:
        pass
    assert open_descriptors() == before


NEVER = array(Frame(1, ts=NO_TIME), Frame(2, ts=NO_TIME))
PACE_OF: list[tuple[FrameArray, dict[str, object], str]] = [
    (FRAMES, {}, "traffic"),
    (FRAMES, {"baudrate": 9600}, "line"),
    (FRAMES, {"pace": "max", "baudrate": 9600}, "max"),
    (FRAMES[:0], {}, "traffic"),
    (NEVER, {}, "line"),
    (NEVER, {"pace": "max"}, "max"),
    (np.concatenate([NEVER, FRAMES]), {}, "traffic"),
]


@pytest.mark.parametrize(("traffic", "options", "pace"), PACE_OF)
def test_the_pace_is_that_of_the_times_if_there_are_any(
    traffic: FrameArray, options: dict[str, object], pace: str
) -> None:
    with Simulator("seeed", [traffic[:0], traffic], **options) as device:  # type: ignore[arg-type]
        assert device.report().pace == pace


def test_by_default_no_more_is_sent_than_the_bus_has_carried() -> None:
    second = 1_000_000_000
    frames = timed(0, second // 2, second)
    with Simulator("serial", frames) as device, host(device) as one:
        one.read(1)
        begin = time.monotonic()
        one.read_all(device)
        assert time.monotonic() - begin >= 0.9


def test_frames_without_a_time_go_with_the_one_before_and_are_counted() -> None:
    frames = array(Frame(1, ts=0), *[Frame(n, ts=NO_TIME) for n in range(100)])
    with Simulator("seeed", frames) as device, host(device) as one:
        assert one.read_all(device) == canser.encode(frames, "seeed")
        report = device.report()
    assert (report.pace, report.frames, report.frames_untimed) == ("traffic", 101, 100)


def test_those_of_a_frame_that_was_cut_are_counted_too() -> None:
    with (
        Simulator("seeed", NEVER, pace="max", faults=Faults(unplug_after=7)) as device,
        host(device) as one,
    ):
        one.read(100)
        assert device.wait_unplugged(PATIENCE)
        report = device.report()
    assert (report.frames, report.frames_untimed) == (2, 2)


def test_a_loop_goes_on_in_time() -> None:
    frames = timed(1_000_000_000, 1_010_000_000, 1_030_000_000)
    with Simulator("serial", frames, loop=True, pace="max") as device, host(device) as one:
        data = one.read(len(canser.encode(frames, "serial")) * 3)
        assert not device.wait(0)
    steps = np.diff(canser.decode(data, "serial")["ts"]) // 1_000_000
    assert steps.tolist() == [10, 20, 15, 10, 20, 15, 10, 20]


@pytest.mark.parametrize(("noise", "loss"), [(0.01, 0), (0, 0.05), (0.02, 0.02), (0, 1)])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_faults_are_those_of_the_seed_and_counted(protocol: str, noise: float, loss: float) -> None:
    def run(seed: int) -> tuple[bytes, SimulatorReport]:
        with (
            Simulator(
                protocol, FRAMES, pace="max", faults=Faults(noise=noise, loss=loss, seed=seed)
            ) as device,
            host(device) as one,
        ):
            return one.read_all(device), device.report()

    data, report = run(3)
    clean = canser.encode(FRAMES, protocol)
    hit = damage(clean, noise=noise, loss=loss, seed=(3, 1))
    assert data == hit.data
    assert report.bytes_lost == len(hit.lost)
    assert report.bytes_inserted == len(hit.inserted)
    assert report.bytes_flipped == len(hit.flipped)
    assert (report.frames, report.bytes_encoded) == (len(FRAMES), len(clean))
    assert report.frames_intact == intact_frames(protocol, hit)
    check(report)
    assert run(3) == (data, report)
    assert run(4)[0] != data or loss == 1


def intact_frames(protocol: str, hit: Damaged) -> int:
    """Return the number of frames that no hit is in, counted one by one."""
    lost, inserted, flipped = (set(p.tolist()) for p in (hit.lost, hit.inserted, hit.flipped))
    whole = start = 0
    for frame in range(len(FRAMES)):
        end = start + len(canser.encode(FRAMES[frame : frame + 1], protocol))
        places = set(range(start, end))
        whole += not places & (lost | flipped) and not (places - {start}) & inserted
        start = end
    return whole


def test_intact_frames_are_found_by_the_decoder() -> None:
    with (
        Simulator("seeed", FRAMES, pace="max", faults=Faults(noise=0.005)) as device,
        host(device) as one,
    ):
        found = canser.decode(one.read_all(device), "seeed")
        report = device.report()
    assert 0 < report.frames_intact < len(FRAMES)
    # A false start in front of a frame may swallow it, and a hit may leave a frame as it was.
    assert len(found) == pytest.approx(report.frames_intact, rel=0.02)


def test_a_stall_is_silence_at_its_byte() -> None:
    with (
        Simulator(
            "seeed", FRAMES, pace="max", faults=Faults(stalls=[(2_000, 0.3), (1_000, 0.3)])
        ) as device,
        host(device) as one,
    ):
        begin = time.monotonic()
        data = one.read(1_001)
        assert time.monotonic() - begin >= 0.3
        data += one.read(1_000)
        assert time.monotonic() - begin >= 0.6
        data += one.read_all(device)
        assert device.report().stalls == 2
    assert data == canser.encode(FRAMES, "seeed")


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_ping_and_status_come_straight_back_between_two_frames(protocol: str) -> None:
    asked = canser.protocol(protocol).ping + canser.protocol(protocol).status_request
    with (
        Simulator(protocol, FRAMES, loop=True, pace="max") as device,
        host(device) as one,
    ):
        data = one.read(3_000)
        one.write(asked * 3)
        decoder = canser.Decoder(protocol)
        decoder.feed(data)
        while decoder.stats.bytes_control < 3 * len(asked):
            decoder.feed(one.take())
    assert b"".join(control.data for control in decoder.take_controls()) == asked * 3
    assert decoder.stats.bytes_skipped == 0
    report = device.report()
    assert report.bytes_answered == 3 * len(asked)
    assert sum(report.controls.values()) == (3 if asked else 0)
    assert set(report.controls) <= {"ping", "status"}
    check(report)


def test_a_mute_one_counts_and_says_nothing() -> None:
    ping = canser.protocol("cantalope").ping
    with Simulator("cantalope", faults=Faults(mute=True)) as device, host(device) as one:
        one.write(ping)
        until(lambda: device.report().controls == {"ping": 1})
        device.mute = False
        one.write(ping)
        assert one.read(len(ping)) == ping
        assert device.report().bytes_answered == len(ping)


def until_taken(device: Simulator, count: int) -> None:
    """Wait until so many bytes of the host have been heard, or ignored."""

    def taken() -> bool:
        report = device.report()
        return report.bytes_ignored + report.bytes_received == count

    until(taken)


def test_a_deaf_one_ignores_what_it_is_sent_and_counts_it() -> None:
    asked = canser.protocol("seeed").status_request
    with Simulator("seeed", faults=Faults(deaf=0.3)) as device:
        sent = 0
        for round_number in range(1, 3):  # a host, and another one
            begin = time.monotonic()
            with host(device) as one:
                one.write(asked)
                sent += len(asked)
                until_taken(device, sent)
                while not one.readable(0.01):
                    one.write(asked)
                    sent += len(asked)
                assert time.monotonic() - begin >= 0.3
                until_taken(device, sent)
                one.take()
            until(lambda: not device.connected)
            report = device.report()
            assert report.bytes_ignored >= round_number * len(asked)
        assert report.bytes_received == 20 * report.controls["status"] == report.bytes_answered


def test_one_that_was_plugged_in_again_is_deaf_again() -> None:
    asked = canser.protocol("seeed").status_request
    with Simulator("seeed", faults=Faults(deaf=0.3)) as device:
        device.unplug()
        begin = time.monotonic()
        device.replug()
        with host(device) as one:
            while not one.readable(0.01):
                one.write(asked)
            assert time.monotonic() - begin >= 0.3


@pytest.mark.parametrize("asks", [False, True])
def test_the_packet_behind_a_configuration_is_swallowed(asks: bool) -> None:
    """A frame or a request; and so it is behind the next configuration."""
    asked = canser.protocol("seeed").status_request
    frames = array(Frame(1), Frame(2), Frame(3))
    packets = asked * 3 if asks else canser.encode(frames, "seeed")
    with Simulator("seeed", faults=Faults(swallow=True)) as device, host(device) as one:
        one.write(packets)
        one.write(configuration() + packets)
        one.write(configuration(bitrate=250_000) + packets)
        until(lambda: device.report().bytes_received == 40 + 3 * len(packets))
        report = device.report()
        assert report.packets_swallowed == 2
        assert report.controls == ({"configuration": 2} | ({"status": 7} if asks else {}))
        assert report.frames_received == (0 if asks else 7)
        assert device.received["id"].tolist() == ([] if asks else [1, 2, 3, 2, 3, 2, 3])
        assert report.configuration is not None
        assert report.configuration.bitrate == 250_000


def test_a_configuration_is_taken() -> None:
    packet = configuration(bitrate=250_000, mode="silent", once=True)
    with Simulator("seeed") as device, host(device) as one:
        assert device.configuration is None
        one.write(packet)
        until(lambda: device.configuration is not None)
        assert device.configuration == adapters.report("seeed", packet)
        assert device.report().controls == {"configuration": 1}
        assert device.report().bytes_answered == 0


def test_the_filter_holds_from_the_next_frame_on() -> None:
    frames = vehicle(2)
    with Simulator("seeed", frames, pace="max") as device, host(device) as one:
        data = one.read(1_000)
        one.write(configuration(frame_type="extended"))
        until(lambda: device.configuration is not None)
        data += one.read_all(device)
        report = device.report()
    found = canser.decode(data, "seeed")
    first = int(np.flatnonzero(~found["ext"])[-1]) + 1
    found["ts"] = frames["ts"][0]
    frames["ts"] = frames["ts"][0]
    assert listed(found[:first]) == listed(frames[:first])
    rest = frames[first:]
    assert listed(found[first:]) == listed(rest[rest["ext"]])
    assert report.frames == len(found)
    assert report.bytes_sent == len(data)


def test_a_filter_by_id() -> None:
    wanted = int(FRAMES["id"][0])
    with (
        Simulator("seeed", FRAMES, pace="max", faults=Faults(stalls=[(0, 0.2)])) as device,
        host(device) as one,
    ):
        one.write(configuration(filter_id=wanted, filter_mask=0x7FF))
        found = canser.decode(one.read_all(device), "seeed")
    assert found["id"].tolist() == [wanted] * int((FRAMES["id"] == wanted).sum())


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_echo_sends_all_back_in_order(protocol: str) -> None:
    sent = canser.encode(FRAMES, protocol)
    with Simulator(protocol, echo=True, pace="max") as device, host(device) as one:
        writer = threading.Thread(target=one.write, args=(sent,))
        writer.start()
        data = one.read(len(sent))
        writer.join()
        report = device.report()
        received = device.received
    assert data == sent
    assert report.frames_received == report.frames_echoed == len(FRAMES)
    assert (report.bytes_received, report.bytes_skipped) == (len(sent), 0)
    assert received.tobytes() == canser.decode(sent, protocol).tobytes()
    check(report)


def test_the_mode_of_loopback_sends_what_comes_behind_it_back() -> None:
    before, between, behind = (canser.encode(part, "seeed") for part in np.split(FRAMES[:30], 3))
    loopback = configuration(mode="loopback")
    normal = configuration()
    with Simulator("seeed", pace="max") as device, host(device) as one:
        one.write(before + loopback + between + normal + behind)
        until(lambda: device.report().frames_received == 30)
        assert one.read(len(between)) == between
        assert device.report().frames_echoed == 10
        assert device.wait(PATIENCE)
        assert device.report().bytes_sent == len(between)


def test_noise_from_the_host_is_counted() -> None:
    with Simulator("seeed") as device, host(device) as one:
        one.write(b"\0\1\2" + canser.encode(FRAMES[:1], "seeed"))
        until(lambda: device.report().frames_received == 1)
        assert device.report().bytes_skipped == 3


def test_the_newest_frames_of_the_host_are_kept() -> None:
    many = np.resize(FRAMES, 70_000)
    with Simulator("seeed") as device, host(device) as one:
        one.write(canser.encode(many, "seeed"))
        until(lambda: device.report().frames_received == 70_000)
        kept = device.received
    assert len(kept) == 65_536
    assert kept["id"].tolist() == many["id"][-65_536:].tolist()


def test_stop_ends_behind_the_frame_that_is_going_out() -> None:
    with Simulator("seeed", FRAMES, loop=True, pace="max") as device, host(device) as one:
        data = one.read(1_000)
        device.stop()
        data += one.read_all(device)
        report = device.report()
    decoder = canser.Decoder("seeed")
    assert len(decoder.feed(data)) == report.frames
    assert (decoder.stats.bytes_skipped, decoder.pending) == (0, 0)
    assert report.bytes_sent == len(data)


def test_unplugged_when_all_is_read_at_a_byte() -> None:
    clean = canser.encode(FRAMES, "seeed")
    with (
        Simulator("seeed", FRAMES, pace="max", faults=Faults(unplug_after=5_001)) as device,
        host(device) as one,
    ):
        data = one.read(len(clean))
        assert device.wait_unplugged(PATIENCE)
        assert data == clean[:5_001]
        assert os.read(one.fd, 10) == b""
        report = device.report()
    assert (report.unplugs, report.bytes_unread, report.bytes_sent) == (1, 0, 5_001)
    check(report)


def test_unplugged_at_once_what_is_not_read_is_gone() -> None:
    with Simulator("seeed", FRAMES, pace="max") as device, host(device) as one:
        data = one.read(10)
        until(lambda: device.report().bytes_sent > 5_000)
        assert device.unplug(drain=False)
        assert not device.connected
        data += one.read(10)
    report = device.report()
    assert report.bytes_sent == len(data) + report.bytes_unread
    check(report)


def test_unplugged_while_the_host_writes() -> None:
    failed = threading.Event()

    def write(one: Host) -> None:
        try:
            while True:
                one.write(canser.encode(FRAMES, "seeed"))
        except OSError:
            failed.set()

    with Simulator("seeed") as device, host(device) as one:
        writer = threading.Thread(target=write, args=(one,))
        writer.start()
        until(lambda: device.report().frames_received > 1_000)
        device.unplug()
        assert failed.wait(PATIENCE)
        writer.join()


def test_replugged_it_goes_on_with_the_next_frame(tmp_path: Path) -> None:
    link = tmp_path / "device"
    clean = canser.encode(FRAMES, "seeed")
    ends = np.cumsum([len(canser.encode(FRAMES[i : i + 1], "seeed")) for i in range(len(FRAMES))])
    cut = int(ends[500]) - 3  # within a frame
    with Simulator(
        "seeed", FRAMES, pace="max", faults=Faults(unplug_after=cut), link=str(link)
    ) as device:
        assert device.url == str(link)
        assert link.is_symlink()
        with host(device) as one:
            assert one.read(len(clean)) == clean[:cut]
            assert device.wait_unplugged(PATIENCE)
            assert not os.path.lexists(link)
            device.replug()
        assert link.readlink() == Path(device._path)
        with host(device) as one:
            assert one.read_all(device) == clean[ends[500] :]
        report = device.report()
    assert not os.path.lexists(link)
    assert (report.frames, report.frames_intact) == (len(FRAMES), len(FRAMES) - 1)
    assert (report.bytes_encoded, report.bytes_lost) == (len(clean), 3)
    check(report)


def test_a_replugged_one_has_forgotten_its_configuration() -> None:
    with Simulator("seeed") as device:
        with host(device) as one:
            one.write(configuration())
            until(lambda: device.configuration is not None)
            assert device.unplug(timeout=PATIENCE)
        device.replug()
        assert device.configuration is None
        device.replug()  # it is plugged in: nothing happens
        assert device.report().unplugs == 1


def test_a_host_that_claimed_it_can_open_it_again() -> None:
    with Simulator("seeed", FRAMES, loop=True, pace="max") as device:
        for _ in range(3):
            with host(device) as one:
                fcntl_exclusive(one.fd)
                assert one.read(1_000)
            until(lambda: not device.connected)


def fcntl_exclusive(fd: int) -> None:
    import fcntl  # noqa: PLC0415

    fcntl.ioctl(fd, termios.TIOCEXCL)


def test_what_the_last_host_has_set_is_undone() -> None:
    with Simulator("seeed", FRAMES, pace="max") as device:
        with host(device) as one:
            cooked = termios.tcgetattr(one.fd)
            cooked[3] |= termios.ICANON | termios.ECHO
            termios.tcsetattr(one.fd, termios.TCSANOW, cooked)
            until(lambda: device.connected)
        until(lambda: not device.connected)
        with host(device) as one:
            assert not termios.tcgetattr(one.fd)[3] & (termios.ICANON | termios.ECHO)


def test_a_second_host_that_leaves_stops_nothing() -> None:
    with Simulator("seeed", FRAMES, pace="max") as device, host(device) as one:
        data = one.read(100)
        for _ in range(5):
            with host(device):
                pass
        data += one.read_all(device)
        assert data == canser.encode(FRAMES, "seeed")


def test_no_file_is_replaced_by_the_link(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    before = open_descriptors()
    with pytest.raises(FileExistsError), Simulator("seeed", link=str(tmp_path / "file")):
        pass
    assert (tmp_path / "file").read_text() == "mine"
    assert open_descriptors() == before


def test_a_link_to_anything_but_a_terminal_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "folder")
    with (
        pytest.raises(FileExistsError, match="no link to a terminal"),
        Simulator("seeed", link=str(tmp_path / "link")),
    ):
        pass
    assert (tmp_path / "link").readlink() == tmp_path / "folder"


def test_a_link_to_a_terminal_is_replaced(tmp_path: Path) -> None:
    link = tmp_path / "link"
    with Simulator("seeed") as other:
        link.symlink_to(other.url)
        with Simulator("seeed", link=str(link)) as device:
            assert link.readlink() == Path(device._path)
    assert not os.path.lexists(link)


def test_a_dead_link_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("/nowhere")
    with Simulator("seeed", FRAMES, link=str(tmp_path / "link")) as device, host(device) as one:
        assert one.read(10)


def test_what_it_fails_at_is_raised() -> None:
    bad = array(Frame(1), Frame(0x800, ext=True))
    before = open_descriptors()
    with pytest.raises(ValueError, match="frame 1"), Simulator("cantalope", bad):
        pass
    assert open_descriptors() == before
    good = array(Frame(1))
    with (
        pytest.raises(ValueError, match="frame 0"),
        Simulator("cantalope", [good, array(Frame(1, err=True))]) as device,
        host(device),
    ):
        device.wait(PATIENCE)
    with (
        pytest.raises(ValueError, match="frame 0"),
        Simulator("cantalope", [good, array(Frame(1, err=True))]) as device,
        host(device),
    ):
        until(device._ended.is_set)


WRONG: list[tuple[dict[str, object], str]] = [
    ({"pace": "slow"}, "unknown pace 'slow'; have: traffic, line, max"),
    ({"baudrate": 0}, "baudrate is 0"),
    ({"ts_unit": "h"}, "unknown ts_unit 'h'"),
    ({"protocol": "foo"}, "unknown protocol 'foo'"),
]


@pytest.mark.parametrize(("wrong", "message"), WRONG, ids=[message for _, message in WRONG])
def test_wrong_arguments(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Simulator(**{"protocol": "seeed", **wrong})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"noise": 1.5}, "noise is 1.5"),
        ({"loss": float("nan")}, "loss is nan"),
        ({"stalls": [(1, -1)]}, "stalls is"),
        ({"unplug_after": -1}, "unplug_after is -1"),
    ],
)
def test_wrong_faults(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Faults(**wrong)


def test_no_descriptor_and_no_thread_is_left() -> None:
    before, threads = open_descriptors(), threading.active_count()
    for _ in range(3):
        with Simulator("seeed", FRAMES) as device:
            with host(device) as one:
                one.read(10)
            device.unplug(drain=False)
            device.replug()
        device.close()
        device.stop()
        device.replug()
    assert open_descriptors() == before
    assert threading.active_count() == threads


def test_python_can_reads_and_writes_serial() -> None:
    can = pytest.importorskip("can")
    frames = FRAMES[~FRAMES["rtr"]][:300]
    with Simulator("serial", frames, baudrate=1_000_000) as device:
        bus = can.Bus(interface="serial", channel=device.url, timeout=PATIENCE)
        try:
            found = [bus.recv(PATIENCE) for _ in range(len(frames))]
            for message in found:
                bus.send(message)
            until(lambda: device.report().frames_received == len(frames))
        finally:
            bus.shutdown()
        received, report = device.received, device.report()
    assert same_frames(found, frames)
    assert (report.flushes, report.bytes_unread) == (0, 0)
    for name in ("id", "ext", "dlc", "data"):
        assert (received[name] == frames[name]).all()


def test_python_can_configures_reads_and_writes_seeed() -> None:
    can = pytest.importorskip("can")
    frames = vehicle(1)
    frames = frames[~frames["rtr"]][:300]
    with Simulator("seeed", frames) as device:
        bus = can.Bus(
            interface="seeedstudio", channel=device.url, bitrate=250_000, timeout=PATIENCE
        )
        try:
            found = [bus.recv(PATIENCE) for _ in range(len(frames))]
            for message in found:
                bus.send(message)
            bus.status_frame()
            until(lambda: device.report().controls == {"configuration": 1, "status": 1})
        finally:
            bus.shutdown()
        received, report = device.received, device.report()
    assert same_frames(found, frames)
    assert report.configuration is not None
    assert report.configuration.bitrate == 250_000
    assert report.bytes_answered == 20
    for name in ("id", "ext", "dlc", "data"):
        assert (received[name] == frames[name]).all()


def same_frames(found: list[object], frames: FrameArray) -> bool:
    messages = [
        (m.arbitration_id, m.is_extended_id, m.dlc, bytes(m.data))  # type: ignore[attr-defined]
        for m in found
    ]
    return messages == [
        (f["id"], f["ext"], f["dlc"], f["data"].tobytes()[: f["dlc"]]) for f in frames
    ]


def test_where_no_thread_can_be_started_nothing_is_left_open(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    before, link = descriptors(), tmp_path / "link"
    monkeypatch.setattr(threading.Thread, "start", fail)
    with pytest.raises(canser.PortError, match=r"the simulator: can't start new thread; .*ulimit"):
        Simulator("seeed", link=str(link)).__enter__()
    assert descriptors() == before
    assert not link.is_symlink()


def test_without_a_free_terminal_the_error_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise OSError("out of pty devices")

    monkeypatch.setattr(os, "openpty", fail)
    with pytest.raises(OSError, match="a new pseudo terminal: out of pty devices"):
        Simulator("seeed").__enter__()


def test_a_report_is_of_its_moment_and_cannot_be_changed() -> None:
    simulator = Simulator("seeed")
    report = simulator.report()
    controls: Any = report.controls
    with pytest.raises(TypeError, match="cannot be changed"):
        controls["ping"] = 7
    simulator._controls["ping"] += 1
    assert report.controls == {}
    assert simulator.report().controls == {"ping": 1}
    assert copy.deepcopy(report) == pickle.loads(pickle.dumps(report)) == report


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_simulator_cannot_be_copied(again: Callable[[Any], Any]) -> None:
    with pytest.raises(TypeError, match="a Simulator cannot be copied or pickled"):
        again(Simulator("seeed"))
