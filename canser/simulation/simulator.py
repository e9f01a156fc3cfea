"""A simulated adapter on a pseudo terminal: a device where no device is."""

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

# What the line carries is sent this often, as USB adapters do: 4,000 bytes of the fastest line,
# of which a terminal holds 12,000 at least, for one percent of a processor.
_TICK_NS: Final = 20 * _MS

# pyserial flushes the input right after opening: nothing is sent before that. Other hosts
# do not, and get their bytes after this time.
_SETTLE_NS: Final = 100 * _MS

# Bytes on the line for one of data: a start and a stop bit go with eight bits.
_BITS: Final = 10

# A host that sends and does not read is made to wait when so many bytes wait for it.
_ANSWERS_MAX: Final = 1 << 20

# The newest frames of the host that are kept.
_RECEIVED_KEPT: Final = 1 << 16

# A look at a host that is away, or does not read: the terminal wakes us, but for rare cases.
_LOOK_NS: Final = 1_000 * _MS
_FULL_NS: Final = 50 * _MS

# After so many bytes a look at what the host sends.
_BURST: Final = 1 << 18


@dataclass(frozen=True, slots=True)
class SimulatorReport:
    """What a simulator has done, to the byte.

    Law: `bytes_sent == bytes_encoded - bytes_lost + bytes_inserted + bytes_answered`. Of
    these the host has read all but `bytes_unread`, and what it has itself thrown away
    (`flushes`).
    """

    protocol: str
    pace: str  # "traffic", "line" or "max"
    frames: int  # of the traffic that were sent, damaged ones too
    frames_intact: int  # of these, with no byte lost, flipped or added within
    frames_untimed: int  # of all that were sent, those without a time
    bytes_encoded: int  # of these frames
    bytes_lost: int  # by injected faults
    bytes_inserted: int
    bytes_flipped: int
    bytes_answered: int  # of answers, and of frames that were sent back
    bytes_sent: int  # that the terminal took
    bytes_unread: int  # of these, not read by the host before the end or an unplugging
    flushes: int  # times that the host has thrown away its input after the first byte
    stalls: int
    unplugs: int
    frames_received: int  # from the host
    frames_echoed: int  # of these, sent back
    bytes_received: int
    bytes_skipped: int  # of these, inside no packet
    bytes_ignored: int  # from the host while the adapter was deaf; not among those received
    packets_swallowed: int  # from the host, each right behind a configuration
    controls: Mapping[str, int]  # packets from the host that are no frames, by their kind
    configuration: AdapterReport | None  # the last one

    def __post_init__(self) -> None:
        object.__setattr__(self, "controls", ReadOnlyDict(self.controls))


_NO_FAULTS: Final = Faults()


class Simulator(Uncopied):
    """A serial CAN adapter that is not there: a pseudo terminal, and a thread that serves it.

    `protocol`: a name of `protocols()`. `traffic`: the frames it sends: an array of
    FRAME_DTYPE, or an iterable of such; with `loop` over and over, their times going on.
    Sending begins when a host has opened `url`: as soon as the host has flushed its input, or
    0.1 s later. It pauses while no host has it open and while the terminal is full; so nothing
    is lost that is not lost on purpose. An iterable is taken ahead, by a thread; it pauses while
    no more has come.

    `pace`: "traffic" sends by the frames' times, as an adapter on a bus does; a frame without
    a time goes out with the one before it. "line" sends as fast as the serial line of
    `baudrate` (default: that of the adapters) carries, which may be more than a bus carries,
    "max" as fast as the host reads. By default it is "traffic", but "line" where a baudrate is
    given or the first frames have no time at all; `report` tells which.

    It behaves as an adapter does: sends ping and status request straight back (there are no
    bus errors) between two frames, unless it is `mute`; takes a configuration, sends only frames
    that pass its filter, and in a mode of loopback, or with `echo`, sends the host's frames
    back. Frames always have the variable form.

    `faults`: what goes wrong on purpose.

    `link`: a path where a symbolic link stands for the terminal, whose own name changes
    with each `replug`. `copy`: a binary file that gets the very bytes that were sent.

    A context manager: plugged in at its start, unplugged and gone at its end. ValueError
    for wrong arguments; PortError where there are no pseudo terminals. The first frames are
    taken at the start. What the thread fails at, as later frames that the format cannot
    carry, comes from `wait` and at the end.
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
        self._elapsed_ns = 0  # in which it could send
        self._stepped_ns = 0  # when the last step was
        self._sending = False  # the time since then counts
        self._settled_ns = 0  # when a host that has opened it is taken to be ready
        self._stalled_until_ns = 0
        self._deaf_until_ns = 0
        self._swallowing = False  # the next packet of the host is ignored
        self._left = False  # bytes lie in the terminal that the last host did not read
        self._full = False
        self._noticed = False  # something of the host
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
        self._ended = threading.Event()  # all is sent and read, or it never will be
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
            self._out.ready()  # takes the first frames, and so the pace is known
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
        """What the host opens: the link, or the terminal as it is called now."""
        return self._link_path or self._path

    @property
    def connected(self) -> bool:
        """Whether a host has it open; always true where the system does not tell."""
        terminal = self._terminal
        return terminal is not None and terminal.open

    @property
    def finished(self) -> bool:
        """Whether all traffic is sent; `wait` tells whether it is read, too."""
        return self._finished

    @property
    def received(self) -> FrameArray:
        """The frames from the host, oldest first, the newest 65,536 of them: a new array."""
        with self._lock:
            parts = list(self._received)
        kept = concat(parts)
        return kept[max(0, len(kept) - _RECEIVED_KEPT) :]

    @property
    def configuration(self) -> AdapterReport | None:
        """The last configuration that the host has sent."""
        return self._configuration

    def report(self) -> SimulatorReport:
        """Return what was done so far."""
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
        """Wait until all traffic is sent, and read by the host; return whether it is.

        It goes on to answer then. Raises what the thread has failed at.
        """
        self._ended.wait(check_timeout(timeout))
        self._raise()
        return self._ended.is_set()

    def wait_unplugged(self, timeout: float | None = None) -> bool:
        """Wait until it has unplugged itself; return whether it has."""
        self._unplugged.wait(check_timeout(timeout))
        self._raise()
        return self._unplugged.is_set()

    def stop(self) -> None:
        """End the traffic with the frame that is going out. `wait` waits for its bytes."""

        def stop() -> None:
            self._out.end()
            self._stalls.clear()
            self._stalled_until_ns = 0

        self._do(stop)

    def unplug(self, *, drain: bool = True, timeout: float | None = None) -> bool:
        """Pull the plug: the host's side hangs up. Return whether it is out.

        With `drain` when the host has read what was sent; else at once, and what it has
        not read is gone. The rest of a frame that was going out is lost.
        """

        def unplug() -> None:
            if drain:
                self._unplug_at = self._bytes_sent
            else:
                self._unplug()

        self._do(unplug)
        return self.wait_unplugged(timeout)

    def replug(self) -> None:
        """Plug it in again, as a new terminal, and go on with the next frame."""

        def replug() -> None:
            if self._terminal is None:
                self._plug()

        self._do(replug)

    def close(self) -> None:
        """Unplug it for good. What the host has not read is gone, and counted."""
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
        """Have the thread do something; nothing after the end."""
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

    # From here on all is done by the thread.

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
        """Wait for the host, for a wish, or for the time since the step; less than 0: for ever."""
        waiting = select.poll()
        waiting.register(self._wake_out, select.POLLIN)
        if self._terminal is not None:
            wanted = select.POLLOUT if self._full else 0
            if self._out.answering < _ANSWERS_MAX:
                wanted |= select.POLLIN
            self._terminal.register(waiting, wanted)
        rest_ns = 0
        if timeout_ns < 0:
            seen = dict(waiting.poll(None))
        else:
            left_ns = max(0, timeout_ns - (time.monotonic_ns() - self._stepped_ns))
            # Polling takes whole milliseconds; what is due must not wait for the next one.
            whole_ms, rest_ns = divmod(left_ns, _MS)
            seen = dict(waiting.poll(whole_ms))
        if rest_ns and not seen:
            time.sleep(rest_ns / 1e9)
        if seen.pop(self._wake_out, 0):
            os.read(self._wake_out, 4096)
        self._noticed = any(event != select.POLLOUT for event in seen.values())

    def _step(self) -> int:
        """Do what there is to do; return for how many nanoseconds there is nothing more."""
        terminal = self._terminal
        if terminal is None:
            return -1
        now = time.monotonic_ns()
        if self._sending:
            self._elapsed_ns += now - self._stepped_ns
        self._stepped_ns = now
        self._sending = self._full = False
        self._greet(terminal, now)
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

    def _greet(self, terminal: Terminal, now: int) -> None:
        """Give a host that has opened it just now the time to flush its input."""
        before = terminal.open
        if terminal.look(noticed=self._noticed):
            self._settled_ns = now + _SETTLE_NS
            self._deaf_until_ns = now + self._deaf_ns
        elif before and not terminal.open:
            self._left = not terminal.drained()

    @staticmethod
    def _when_drained(terminal: Terminal, action: Callable[[], None]) -> int:
        """Do something if the host has read all; return for how long there is nothing to do."""
        if not terminal.drained():
            return _TICK_NS
        action()
        return -1

    def _receive(self, terminal: Terminal) -> None:
        """Take what the host has sent."""
        while self._out.answering < _ANSWERS_MAX:
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
        """Decode what the host has sent, and do what it says, in its order."""
        count = len(self._room)
        while count == len(self._room):
            used, count = self._decoder.feed_into(data, self._room, self._offsets)
            data = data[used:]
            start = 0
            for control in self._decoder.take_controls():
                stop = int(np.searchsorted(self._offsets[:count], control.offset))
                self._hear(self._room[start:stop])
                self._obey(control.data)
                start = stop
            self._hear(self._room[start:count])

    def _hear(self, frames: FrameArray) -> None:
        """Take frames of the host's."""
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

    def _obey(self, packet: bytes) -> None:
        """Do what a control packet says."""
        if self._swallow():
            return
        said = adapters.report(self.protocol, packet)
        self._controls[said.kind] += 1
        if said.kind == "configuration":
            self._configuration = said
            self._out.configure(said)
            self._swallowing = self._swallows
        elif said.kind == "ping" and not self.mute:
            self._out.answer(packet)
        elif said.kind == "status" and not self.mute:
            # A request reads as a status without errors, and there are none here.
            self._out.answer(find_protocol(self.protocol).status_request)

    def _swallow(self) -> bool:
        """Return whether the next packet of the host is ignored, which is counted then."""
        swallowed, self._swallowing = self._swallowing, False
        self._packets_swallowed += swallowed
        return swallowed

    def _paced(self) -> str:
        """Return the pace; where none was asked for, that of the first frames' times."""
        return self._pace or ("line" if self._out.timed is False else "traffic")

    def _send(self, terminal: Terminal) -> int:
        """Write what is due; return for how many nanoseconds nothing more is."""
        self._sending = True
        room = _BURST
        pace = self._paced()
        if pace == "line":
            due = self._elapsed_ns * self._baudrate // (_BITS * 1_000_000_000)
            room = min(room, due - self._bytes_sent)
        stop = self._stop_at()
        if stop is not None:
            room = min(room, stop - self._bytes_sent)
        while room > 0:
            piece = self._out.next(room, self._elapsed_ns)
            if not piece and self._out.starved:
                self._sending = False  # the time stands still, so that no burst follows
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
        """Return after how many bytes it stalls or unplugs itself, if it does."""
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
    """Return the pace that is asked for; None where the first frames decide."""
    if pace is not None and pace not in PACES:
        raise ValueError(f"unknown pace {pace!r}; have: {', '.join(PACES)}")
    return "line" if pace is None and baudrate is not None else pace
