"""A simulated adapter on a pseudo terminal, for tests and trials without hardware."""

import collections
import contextlib
import itertools
import os
import select
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from typing import BinaryIO, Final, Self

import numpy as np

from canser import adapters
from canser._checks import flag, text, whole
from canser._checks import timeout as check_timeout
from canser._core.table import find_protocol
from canser._frames import FRAME_DTYPE, FrameArray, concat, copy_records
from canser._guards import ReadOnlyDict, Uncopied
from canser._named import named
from canser._threads import start_thread
from canser.adapters import AdapterReport
from canser.codec.decoder import Decoder, encode
from canser.errors import PortError
from canser.simulation._outgoing import Outgoing
from canser.simulation._terminal import Symlink, Terminal
from canser.simulation.faults import Faults

__all__ = ["PACES", "Simulator", "SimulatorReport"]

PACES: Final = ("traffic", "line", "max")

_MS: Final = 1_000_000  # nanoseconds

# At the pace "line" the bytes go out at this interval, as USB adapters send in bundles. At
# 2 Mbaud that is 4,000 bytes, and a terminal holds at least 12,000. It costs 1 % of a processor.
_TICK_NS: Final = 20 * _MS

# pyserial flushes the input right after opening: bytes sent before that would be lost. A host
# that does not flush gets its first bytes after this time.
_SETTLE_NS: Final = 100 * _MS

# Bits on the line for one byte: a start bit, eight data bits and a stop bit.
_BYTE_BITS: Final = 10

# Bytes of answers that may wait for the host. At this limit the adapter reads no more from the
# host; otherwise a host that sends and does not read would fill the memory.
_ANSWERS_MOST: Final = 1 << 20

# Frames from the host that are kept, the newest ones.
_RECEIVED_KEPT: Final = 1 << 16

# The terminal wakes the thread when the host opens it or reads. In rare cases it does not, so the
# thread also looks at these intervals: while no host is there, and while the terminal is full.
_LOOK_NS: Final = 1_000 * _MS
_FULL_NS: Final = 50 * _MS

# Bytes sent at most before the thread looks again at what the host has sent.
_BURST_BYTES: Final = 1 << 18


@dataclass(frozen=True, slots=True)
class SimulatorReport:
    """What a simulator has done so far, to the byte; made by `Simulator.report`.

    Notes
    -----
    `bytes_sent == bytes_encoded - bytes_lost + bytes_inserted + bytes_answered` always holds. The
    host has read all bytes sent, except `bytes_unread` and what the host itself has thrown away
    (`flushes`).
    """

    #: The protocol, a name of `canser.protocols()`.
    protocol: str
    #: How the traffic is paced: "traffic", "line" or "max", as for `Simulator`.
    pace: str
    #: Frames of the traffic that were sent, damaged ones too.
    frames: int
    #: Of `frames`, those with no byte lost, flipped or inserted inside them.
    frames_intact: int
    #: Of `frames`, those without a time.
    frames_untimed: int
    #: Bytes of `frames` before any fault.
    bytes_encoded: int
    #: Of `bytes_encoded`, those lost by noise or loss, or in a frame that an unplugging has cut.
    bytes_lost: int
    #: Bytes that noise has inserted.
    bytes_inserted: int
    #: Bytes of which noise has flipped one bit.
    bytes_flipped: int
    #: Bytes of answers, and of the host's frames that were sent back.
    bytes_answered: int
    #: Bytes that the terminal took.
    bytes_sent: int
    #: Of `bytes_sent`, those that the host had not read when the adapter was unplugged or closed.
    bytes_unread: int
    #: How often the host has thrown away its input after the first byte was sent.
    flushes: int
    #: How often the adapter has stalled.
    stalls: int
    #: How often the adapter was unplugged.
    unplugs: int
    #: Frames from the host.
    frames_received: int
    #: Of `frames_received`, those that were sent back.
    frames_echoed: int
    #: Bytes from the host, without `bytes_ignored`.
    bytes_received: int
    #: Of `bytes_received`, those inside no packet.
    bytes_skipped: int
    #: Bytes from the host that came while the adapter was deaf; not part of `bytes_received`.
    bytes_ignored: int
    #: Packets from the host that were ignored, each the first one after a configuration.
    packets_swallowed: int
    #: Packets from the host that are no frames, by their kind, such as "ping"; read-only.
    controls: Mapping[str, int]
    #: The last configuration from the host; None if there is none.
    configuration: AdapterReport | None

    def __post_init__(self) -> None:
        object.__setattr__(self, "controls", ReadOnlyDict(self.controls))


_NO_FAULTS: Final = Faults()


class Simulator(Uncopied):
    """A simulated serial CAN adapter: a pseudo terminal, served by a thread; a context manager.

    The adapter is plugged in when the `with` block begins, and unplugged for good when the block
    ends.

    Parameters
    ----------
    protocol : str
        What the adapter speaks: a name of `canser.protocols()` or an accepted spelling.
    traffic : numpy.ndarray or iterable of numpy.ndarray, optional
        The frames to send: an array of FRAME_DTYPE, shape (n,), or an iterable of such arrays.
        The first frames are taken when the `with` block begins. A thread takes the parts of an
        iterable before they are due; while no part is there, the adapter pauses.
    ts_unit : {"ms", "us", "ns", "s"}, default "ms"
        Unit of the device's timestamps, as for `canser.Decoder`.
    loop : bool, default False
        Whether to send the traffic over and over. The times of each round continue those of the
        round before. An iterable must then be one that can be read again, such as a list.
    pace : {"traffic", "line", "max"}, optional
        How fast to send. "traffic": by the frames' times, as an adapter on a bus does; a frame
        without a time goes out with the frame before it. "line": as fast as the serial line
        carries at `baudrate`, which may be more than a bus carries. "max": as fast as the host
        reads. Default: "line" if `baudrate` is given or none of the first frames has a time,
        otherwise "traffic"; `report` says which.
    baudrate : int, optional
        Bits per second of the serial line, for the pace "line". Default: that of the protocol's
        adapters.
    echo : bool, default False
        Whether to send the host's frames back.
    faults : Faults, optional
        What goes wrong on purpose. Default: nothing.
    link : str, default ""
        Path of a symbolic link to the terminal, "" for none. The link stays the same while the
        name of the terminal changes with each `replug`.
    copy : binary file, optional
        A file, open for writing, that gets exactly the bytes that were sent.

    Raises
    ------
    TypeError
        For an argument of another type.
    ValueError
        For an argument out of range, or an unknown name. When the `with` block begins: for first
        frames that the protocol cannot carry, and for the pace "traffic" if they have no times.
    PortError
        When the `with` block begins: where there are no pseudo terminals, as on Windows, or no
        thread can be started.
    OSError
        When the `with` block begins: if the system has no terminal left, or the link cannot be
        made. FileExistsError if `link` is a file, or a link to anything but a terminal.

    Attributes
    ----------
    protocol : str
        The protocol, a name of `canser.protocols()`.
    echo : bool
        Whether the host's frames are sent back. It may be changed at any time.
    mute : bool
        Whether the adapter answers no ping and no request for its status; at first
        `faults.mute`. It may be changed at any time.

    Notes
    -----
    Sending begins when a host has opened `url`: as soon as the host has flushed its input, or
    0.1 s later. It pauses while no host has the terminal open, and while the terminal is full.
    So no bytes are lost except on purpose.

    The adapter answers as a real one does. It sends a ping, and the answer to a request for its
    status (without bus errors), between two frames. It takes a configuration, and from then on
    sends only frames that pass its filter. It sends the host's frames back if `echo` is set or
    the configured mode is a loopback. Frames of its traffic always have the variable form.

    An error of the thread, such as a later frame that the protocol cannot carry, is raised by
    `wait`, by `wait_unplugged`, and at the end of the `with` block.

    Examples
    --------
    >>> frames = canser.frames("123#DEADBEEF", "124#01")
    >>> with canser.Simulator("seeed", frames) as device:
    ...     with canser.open(device.url, "seeed") as port:
    ...         batch = port.read_batch(min_frames=2, timeout=5)
    ...     report = device.report()
    >>> batch["id"]
    array([291, 292], dtype=uint32)
    >>> report.frames, report.bytes_unread
    (2, 0)
    """

    def __init__(
        self,
        protocol: str,
        traffic: FrameArray | Iterable[FrameArray] = (),
        *,
        ts_unit: str = "ms",
        loop: bool = False,
        pace: str | None = None,
        baudrate: int | None = None,
        echo: bool = False,
        faults: Faults = _NO_FAULTS,
        link: str = "",
        copy: BinaryIO | None = None,
    ) -> None:
        self._decoder = Decoder(protocol, ts_unit=ts_unit)
        self.protocol = self._decoder.protocol
        self.echo = flag(echo, "echo")
        if not isinstance(faults, Faults):
            raise TypeError(f"faults is {faults!r}; it must be a canser.Faults")
        self.mute = faults.mute
        self._pace = _pace_asked(pace, baudrate)
        self._baudrate = find_protocol(self.protocol).baudrate
        if baudrate is not None:
            self._baudrate = whole(baudrate, "baudrate", "115200", least=1)
        if copy is not None and not hasattr(copy, "write"):
            raise TypeError(f"copy is {copy!r}; it must be a file open for writing bytes")
        self._ts_unit = ts_unit
        self._stalls = collections.deque(sorted(faults.stalls))
        self._unplug_at = faults.unplug_after
        self._deaf_ns, self._swallows = int(faults.deaf * 1e9), faults.swallow
        self._copy = copy
        self._symlink = Symlink(text(link, "link", "'/tmp/can'"))
        self._link_path = link

        self._out = Outgoing(
            self.protocol,
            traffic,
            ts_unit=ts_unit,
            loop=flag(loop, "loop"),
            timed=None if self._pace is None else self._pace == "traffic",
            noise=faults.noise,
            loss=faults.loss,
            seed=faults.seed,
        )
        self._elapsed_ns = 0  # the time in which bytes could go out
        self._stepped_ns = 0  # when the last step was
        self._sending = False  # whether the time since the last step counts as elapsed
        self._settled_ns = 0  # when the host is ready, unless it flushes its input before
        self._stalled_until_ns = 0
        self._deaf_until_ns = 0
        self._swallowing = False  # the next packet from the host is ignored
        self._left = False  # the last host has left bytes unread in the terminal
        self._full = False
        self._noticed = False  # the host has opened, closed, written or flushed
        self._finished = False

        self._bytes_sent = self._bytes_unread = 0
        self._flushes = self._stalled = self._unplugs = 0
        self._frames_received = self._frames_echoed = 0
        self._bytes_ignored = self._packets_swallowed = 0
        self._controls: collections.Counter[str] = collections.Counter()
        self._configuration: AdapterReport | None = None
        self._received: collections.deque[FrameArray] = collections.deque()
        self._received_len = 0
        self._room = np.empty(4096, FRAME_DTYPE)
        self._offsets = np.empty(4096, np.int64)

        self._terminal: Terminal | None = None
        self._path = ""
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        self._actions: collections.deque[tuple[Callable[[], None], Future[None]]] = (
            collections.deque()
        )
        self._closing = False
        self._ended = threading.Event()  # all is sent and read, or the thread has ended
        self._unplugged = threading.Event()
        self._error: BaseException | None = None

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as opening:
            self._wake_out, self._wake_in = os.pipe()
            opening.callback(os.close, self._wake_in)
            opening.callback(os.close, self._wake_out)
            os.set_blocking(self._wake_in, False)
            self._plug()
            opening.callback(self._hang_up)
            opening.callback(self._out.close)
            self._out.ready()  # takes the first frames, which decide the pace
            thread = threading.Thread(target=self._serve, name="canser simulator", daemon=True)
            start_thread(thread, "the simulator", PortError)
            opening.pop_all()
        self._thread = thread
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close()
        if kind is None:
            self._raise()

    @property
    def url(self) -> str:
        """The path that the host opens: the link, or the present name of the terminal."""
        return self._link_path or self._path

    @property
    def connected(self) -> bool:
        """Whether a host has the terminal open; always True where the system does not report it."""
        terminal = self._terminal
        return terminal is not None and terminal.open

    @property
    def finished(self) -> bool:
        """Whether all traffic is sent. `wait` returns whether the host has also read it."""
        return self._finished

    @property
    def received(self) -> FrameArray:
        """The newest 65,536 frames from the host, oldest first: a new array of FRAME_DTYPE."""
        with self._lock:
            parts = list(self._received)
        kept = concat(parts)
        return kept[max(0, len(kept) - _RECEIVED_KEPT) :]

    @property
    def configuration(self) -> AdapterReport | None:
        """The last configuration from the host; None if there is none."""
        return self._configuration

    def report(self) -> SimulatorReport:
        """Return what was done so far.

        Returns
        -------
        SimulatorReport
            The counters of this moment.
        """
        with self._lock:
            sent = self._out.counts()
            stats = self._decoder.stats
            return SimulatorReport(
                protocol=self.protocol,
                pace=self._paced(),
                frames=sent.frames,
                frames_intact=sent.intact,
                frames_untimed=sent.untimed,
                bytes_encoded=sent.encoded,
                bytes_lost=sent.lost,
                bytes_inserted=sent.inserted,
                bytes_flipped=sent.flipped,
                bytes_answered=self._out.answered,
                bytes_sent=self._bytes_sent,
                bytes_unread=self._bytes_unread,
                flushes=self._flushes,
                stalls=self._stalled,
                unplugs=self._unplugs,
                frames_received=self._frames_received,
                frames_echoed=self._frames_echoed,
                bytes_received=stats.bytes_in,
                bytes_skipped=stats.bytes_skipped,
                bytes_ignored=self._bytes_ignored,
                packets_swallowed=self._packets_swallowed,
                controls=self._controls,
                configuration=self._configuration,
            )

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until all traffic is sent, and read by the host.

        The adapter goes on to answer the host after that.

        Parameters
        ----------
        timeout : float or None, seconds
            How long to wait; None for ever.

        Returns
        -------
        bool
            Whether all traffic is sent and read.

        Raises
        ------
        Exception
            The error that has ended the thread.
        """
        self._ended.wait(check_timeout(timeout))
        self._raise()
        return self._ended.is_set()

    def wait_unplugged(self, timeout: float | None = None) -> bool:
        """Wait until the adapter is unplugged, as after `Faults.unplug_after` bytes.

        Parameters
        ----------
        timeout : float or None, seconds
            How long to wait; None for ever.

        Returns
        -------
        bool
            Whether the adapter is unplugged.

        Raises
        ------
        Exception
            The error that has ended the thread.
        """
        self._unplugged.wait(check_timeout(timeout))
        self._raise()
        return self._unplugged.is_set()

    def stop(self) -> None:
        """End the traffic after the frame that is going out; `wait` waits for that frame."""

        def stop() -> None:
            self._out.end()
            self._stalls.clear()
            self._stalled_until_ns = 0

        self._do(stop)

    def unplug(self, *, drain: bool = True, timeout: float | None = None) -> bool:
        """Unplug the adapter: the host's side hangs up.

        The rest of a frame that is going out is lost, and counted.

        Parameters
        ----------
        drain : bool, default True
            Whether to unplug only when the host has read all bytes that were sent. Otherwise the
            bytes that the host has not read are lost, and counted as unread.
        timeout : float or None, seconds
            How long to wait for the host; None for ever.

        Returns
        -------
        bool
            Whether the adapter is unplugged.
        """

        def unplug() -> None:
            if drain:
                self._unplug_at = self._bytes_sent
            else:
                self._unplug()

        self._do(unplug)
        return self.wait_unplugged(timeout)

    def replug(self) -> None:
        """Plug the adapter in again, as a new terminal, and go on with the next frame."""

        def replug() -> None:
            if self._terminal is None:
                self._plug()

        self._do(replug)

    def close(self) -> None:
        """Unplug the adapter for good. Bytes that the host has not read are lost, and counted."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._closing = True
        self._wake()
        thread.join()
        os.close(self._wake_in)
        os.close(self._wake_out)

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _do(self, action: Callable[[], None]) -> None:
        """Have the thread do something, and wait until it is done; do nothing after the end."""
        done: Future[None] = Future()
        with self._lock:
            if self._thread is None or self._closing:
                return
            self._actions.append((action, done))
            self._wake()
        done.result()

    def _wake(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(self._wake_in, b"\0")

    # All methods from here on run in the thread.

    def _serve(self) -> None:
        try:
            while not self._closing:
                with self._lock:
                    self._act()
                    timeout_ns = self._step()
                self._pause(timeout_ns)
        except BaseException as error:  # noqa: BLE001 - raised again by the caller's thread
            self._error = error
        finally:
            with self._lock:
                self._closing = True
                self._out.close()
                self._hang_up()
                actions = list(self._actions)
                self._actions.clear()
            for _, done in actions:
                done.set_result(None)
            self._ended.set()
            self._unplugged.set()

    def _act(self) -> None:
        while self._actions:
            action, done = self._actions.popleft()
            try:
                action()
            except Exception as error:  # noqa: BLE001 - raised again by the caller's thread
                done.set_exception(error)
            else:
                done.set_result(None)

    def _pause(self, timeout_ns: int) -> None:
        """Wait for the host, an action, or a time since the last step; less than 0: for ever."""
        waiting = select.poll()
        waiting.register(self._wake_out, select.POLLIN)
        if self._terminal is not None:
            wanted = select.POLLOUT if self._full else 0
            if self._out.answering < _ANSWERS_MOST:
                wanted |= select.POLLIN
            self._terminal.register(waiting, wanted)
        rest_ns = 0
        if timeout_ns < 0:
            seen = dict(waiting.poll(None))
        else:
            left_ns = max(0, timeout_ns - (time.monotonic_ns() - self._stepped_ns))
            # Polling takes whole milliseconds. The rest is slept, or frames would be late.
            whole_ms, rest_ns = divmod(left_ns, _MS)
            seen = dict(waiting.poll(whole_ms))
        if rest_ns and not seen:
            time.sleep(rest_ns / 1e9)
        if seen.pop(self._wake_out, 0):
            os.read(self._wake_out, 4096)
        self._noticed = any(event != select.POLLOUT for event in seen.values())

    def _step(self) -> int:
        """Do all work that is due; return the nanoseconds to the next work, -1 for no work."""
        terminal = self._terminal
        if terminal is None:
            return -1
        now = time.monotonic_ns()
        if self._sending:
            self._elapsed_ns += now - self._stepped_ns
        self._stepped_ns = now
        self._sending = self._full = False
        self._look_for_host(terminal, now)
        if self._noticed:
            self._receive(terminal)
        if self._unplug_at is not None and self._bytes_sent >= self._unplug_at:
            return self._when_drained(terminal, self._unplug)
        self._finished = not self._out.ready()
        if self._finished:
            return -1 if self._ended.is_set() else self._when_drained(terminal, self._ended.set)
        if self._stalls and self._bytes_sent >= self._stalls[0][0]:
            self._stalled_until_ns = now + int(self._stalls.popleft()[1] * 1e9)
            self._stalled += 1
        quiet = max(self._settled_ns, self._stalled_until_ns) - now
        if quiet > 0:
            return quiet
        return self._send(terminal) if terminal.open else _LOOK_NS

    def _look_for_host(self, terminal: Terminal, now: int) -> None:
        """Give a host that has just opened the terminal the time to flush its input."""
        before = terminal.open
        if terminal.look(noticed=self._noticed):
            self._settled_ns = now + _SETTLE_NS
            self._deaf_until_ns = now + self._deaf_ns
        elif before and not terminal.open:
            self._left = not terminal.drained()

    @staticmethod
    def _when_drained(terminal: Terminal, action: Callable[[], None]) -> int:
        """Do something if the host has read all bytes; return as `_step`."""
        if not terminal.drained():
            return _TICK_NS
        action()
        return -1

    def _receive(self, terminal: Terminal) -> None:
        """Take the bytes that the host has sent."""
        while self._out.answering < _ANSWERS_MOST:
            data, flushed = terminal.read()
            if flushed:
                self._flushed()
            elif not data:
                return
            elif self._stepped_ns < self._deaf_until_ns:
                self._bytes_ignored += len(data)
            else:
                self._take(memoryview(data))

    def _flushed(self) -> None:
        settling = self._settled_ns > self._stepped_ns
        self._settled_ns = 0
        if self._left or (self._bytes_sent and not settling):
            self._flushes += 1
        self._left = False

    def _take(self, data: memoryview) -> None:
        """Decode the bytes of the host, and handle frames and control packets in their order."""
        count = len(self._room)
        while count == len(self._room):
            used, count = self._decoder.feed_into(data, self._room, self._offsets)
            data = data[used:]
            start = 0
            for control in self._decoder.take_controls():
                stop = int(np.searchsorted(self._offsets[:count], control.offset))
                self._take_frames(self._room[start:stop])
                self._take_control(control.data)
                start = stop
            self._take_frames(self._room[start:count])

    def _take_frames(self, frames: FrameArray) -> None:
        """Take frames from the host."""
        if len(frames) and self._swallow():
            frames = frames[1:]
        if not len(frames):
            return
        self._frames_received += len(frames)
        self._received.append(copy_records(frames))
        self._received_len += len(frames)
        while self._received_len - len(self._received[0]) >= _RECEIVED_KEPT:
            self._received_len -= len(self._received.popleft())
        config = self._configuration
        if self.echo or (config is not None and str(config.mode).startswith("loopback")):
            self._frames_echoed += len(frames)
            self._out.answer(encode(frames, self.protocol, ts_unit=self._ts_unit))

    def _take_control(self, packet: bytes) -> None:
        """Do what a control packet from the host asks for."""
        if self._swallow():
            return
        asked = adapters.report(self.protocol, packet)
        self._controls[asked.kind] += 1
        if asked.kind == "configuration":
            self._configuration = asked
            self._out.configure(asked)
            self._swallowing = self._swallows
        elif asked.kind == "ping" and not self.mute:
            self._out.answer(packet)
        elif asked.kind == "status" and not self.mute:
            # The same bytes are a request, and a status without errors. Here are no errors.
            self._out.answer(find_protocol(self.protocol).status_request)

    def _swallow(self) -> bool:
        """Return whether to ignore the next packet from the host, and count it if so."""
        swallowed, self._swallowing = self._swallowing, False
        self._packets_swallowed += swallowed
        return swallowed

    def _paced(self) -> str:
        """Return the pace: the given one, or the one that the first frames' times decide."""
        return self._pace or ("line" if self._out.timed is False else "traffic")

    def _send(self, terminal: Terminal) -> int:
        """Write the bytes that are due; return the nanoseconds until more are."""
        self._sending = True
        room = _BURST_BYTES
        pace = self._paced()
        if pace == "line":
            due = self._elapsed_ns * self._baudrate // (_BYTE_BITS * 1_000_000_000)
            room = min(room, due - self._bytes_sent)
        stop = self._stop_at()
        if stop is not None:
            room = min(room, stop - self._bytes_sent)
        while room > 0:
            piece = self._out.next(room, self._elapsed_ns)
            if not piece and self._out.starved:
                self._sending = False  # this time does not count; otherwise a burst would follow
                return _TICK_NS
            if not piece:
                return self._out.wait_ns(self._elapsed_ns)
            taken = terminal.write(piece)
            self._out.wrote(taken)
            self._bytes_sent += taken
            if self._copy is not None:
                self._copy.write(piece[:taken])
            if taken < len(piece):
                self._sending, self._full = False, True
                return _FULL_NS
            room -= taken
        return _TICK_NS if pace == "line" and stop != self._bytes_sent else 0

    def _stop_at(self) -> int | None:
        """Return the number of bytes at the next stall or unplugging, None if there is none."""
        stops = [at for at, _ in itertools.islice(self._stalls, 1)]
        if self._unplug_at is not None:
            stops.append(self._unplug_at)
        return min(stops, default=None)

    def _plug(self) -> None:
        with named("a new pseudo terminal"):
            terminal = Terminal()
        try:
            self._symlink.point(terminal.path)
        except BaseException:
            terminal.close()
            raise
        self._terminal, self._path = terminal, terminal.path
        self._configuration = None
        self._out.configure(None)
        self._deaf_until_ns = time.monotonic_ns() + self._deaf_ns
        self._swallowing = False
        self._unplugged.clear()

    def _unplug(self) -> None:
        if self._terminal is None:
            return
        self._hang_up()
        self._unplugs += 1
        self._unplug_at = None
        self._out.cut()
        self._decoder.flush()
        self._unplugged.set()

    def _hang_up(self) -> None:
        terminal, self._terminal = self._terminal, None
        if terminal is not None:
            self._symlink.remove()
            self._bytes_unread += terminal.close()


def _pace_asked(pace: str | None, baudrate: int | None) -> str | None:
    """Return the pace that is asked for; None if the first frames decide."""
    if pace is not None and pace not in PACES:
        raise ValueError(f"unknown pace {pace!r}; have: {', '.join(PACES)}")
    return "line" if pace is None and baudrate is not None else pace
