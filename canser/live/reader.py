"""A line and the thread that reads it into rings; writing of whole packets; opening anew."""

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Final

from canser._threads import start_thread
from canser.errors import CanserError, PortError, PortGoneError
from canser.live.connecting import connect_aside
from canser.live.line import Line
from canser.live.ring import Ring, holds
from canser.live.setup import Setup

__all__ = ["NO_MORE", "LineReader"]

# Bytes of memory for reads while the ring is full: these bytes are only counted.
_SCRATCH: Final = 1 << 16

# Otherwise each frame that comes alone would wake the thread. So the thread sleeps for _REST_S
# after a read of less than _FULL_READ bytes (a terminal holds 4 KiB), and times may be late by that
# sleep. A line is busy if its bytes take more than the share _BUSY of the time. There the thread
# sleeps for _REST_BUSY_S: bytes are dated back from the baud rate, so the error is at most a fifth
# of the sleep. At 2 Mbaud 2,400 bytes come in that sleep, 3/5 of what a terminal holds.
_REST_S: Final = 0.001
_REST_BUSY_S: Final = 0.012
_BUSY: Final = 0.8
_FULL_READ: Final = 4000

# If bytes come faster than this share of the nominal baud rate, the line has no baud rate, as a
# pseudo terminal. Then the thread does not sleep.
_NO_BAUDRATE: Final = 1.5

# The share is measured over this time: many sleeps.
_WINDOW_S: Final = 0.1

# The time between two attempts to open a line anew: the first one, and the longest.
_RETRY_S: Final = (0.05, 1.0)

NO_MORE: Final = "the line took no more within the time-out"
GONE: Final = "the device is gone"

# The longest time for which a writer holds the lock of the line. Otherwise `close` would wait for
# a line that takes no bytes.
_HOLD_S: Final = 0.05


def _choose_rest(share: float) -> float:
    """Return the sleep after a small read, in seconds, by the share of the time a line is busy."""
    if share > _NO_BAUDRATE:
        return 0.0
    return _REST_BUSY_S if share > _BUSY else _REST_S


class Sending:
    """Bytes that are being sent, and how many have left: known even if a thread is interrupted.

    `missing(data, n)`: as for `LineReader.write`; None: all of `data` has to go out.
    """

    def __init__(
        self, data: bytes = b"", missing: Callable[[bytes, int], int] | None = None
    ) -> None:
        self._data, self._missing = data, missing
        self.counts: list[int] = []  # bytes that each write has sent

    @property
    def sent(self) -> int:
        """The number of bytes that have left."""
        return sum(self.counts)

    @property
    def left(self) -> memoryview:
        """The bytes that have not left."""
        return memoryview(self._data)[self.sent :]

    @property
    def rest(self) -> bytes:
        """The rest of a packet that is cut. It must go out before anything else does."""
        sent = self.sent
        if self._missing is None:
            return self._data[sent:]
        if not 0 < sent < len(self._data):
            return b""
        return self._data[sent : sent + self._missing(self._data, sent)]


class LineReader:
    """An open line, and a thread that reads it into a ring as fast as bytes come.

    Raises the exceptions of `connect`, and PortError if the system starts no more threads.

    Parameters
    ----------
    url : str
        For messages.
    connect : callable
        Opens the line and configures the adapter. It is called here, and again after the line is
        gone if `reconnect`.
    ring : Ring
        Gets all bytes.
    clock : callable
        Returns epoch nanoseconds.
    setup : Setup
        Asks the adapter whether it listens.
    byte_s : float
        Seconds that a byte takes on the line.
    reconnect : bool
        Whether the line is opened anew after it is gone.
    heartbeat : bytes
        A packet that is sent every `heartbeat_s` seconds; b"" for none.
    heartbeat_s : float
        See `heartbeat`.
    """

    def __init__(
        self,
        url: str,
        connect: Callable[[], Line],
        ring: Ring,
        clock: Callable[[], int],
        setup: Setup,
        *,
        byte_s: float,
        reconnect: bool,
        heartbeat: bytes,
        heartbeat_s: float,
    ) -> None:
        self._url, self._connect, self._ring, self._clock = url, connect, ring, clock
        self._setup = setup
        self._byte_s = byte_s
        self._reconnect, self._heartbeat, self._heartbeat_s = reconnect, heartbeat, heartbeat_s
        self.last_heartbeat = 0  # epoch ns of the last heartbeat on this line; 0: none yet
        self._closing = threading.Event()
        self._line: Line | None = connect_aside(url, connect, self._closing)  # None: it is gone
        # Held to write, and to change the line. Reentrant, as a signal handler may close
        # the port in the middle of a write.
        self._line_lock = threading.RLock()
        self._line_held = threading.Condition(self._line_lock)  # for `holds`
        self._writing = threading.Lock()
        self._sending = Sending()  # the last bytes that were sent, or should have been
        # Held to change the tuple of further rings, and to end these rings.
        self._rings_lock = threading.RLock()
        self._rings_held = threading.Condition(self._rings_lock)
        self._more_rings: tuple[Ring, ...] = ()
        self._ended: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="canser reader", daemon=True)
        try:
            start_thread(self._thread, url, PortError)
        except PortError:
            self._finish()
            raise

    def write(
        self, data: bytes, timeout: float | None, missing: Callable[[bytes, int], int]
    ) -> tuple[int, str]:
        """Write the rest of an earlier packet that was cut, then `data`.

        `missing(data, n)`: returns how many bytes are missing of the packet that is cut behind the
        first n bytes of `data`. They go out before anything else, unless the line is gone.

        Returns how many bytes of `data` went out or will, and why not all did ("" if all did).
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        held: list[bool] = []
        try:
            # In one call of C: otherwise a signal handler that raises could come between the
            # lock and the note that it is held.
            left = -1 if timeout is None else max(timeout, 0)
            held.extend(map(self._writing.acquire, (True,), (left,)))
            if not held[0]:
                return 0, NO_MORE
            if rest := self._sending.rest:
                why = self._send(Sending(rest), deadline)
                if why:
                    return 0, why
            sending = Sending(data, missing)
            why = self._send(sending, deadline)
            if why not in ("", NO_MORE):
                self._sending = Sending()
                return sending.sent, why
            return sending.sent + len(sending.rest), why
        finally:
            if held and held[0]:
                self._writing.release()

    def _send(self, sending: "Sending", deadline: float | None) -> str:
        """Write until all is out; return why not all is, "" if all is."""
        self._sending, why = sending, ""
        while sending.left and not why:
            why = self._write_some(sending, deadline)
        return why

    def add_ring(self, ring: Ring) -> None:
        """Put all bytes from now on into a further ring."""
        with self._rings_lock:
            if self._ended is not None:
                ring.close(self._ended)
            self._more_rings += (ring,)

    def remove_ring(self, ring: Ring) -> None:
        """Put no more bytes into a ring of `add_ring`."""
        with self._rings_lock:
            self._more_rings = tuple(other for other in self._more_rings if other is not ring)

    def end(self, error: Exception) -> None:
        """End the stream: `error` follows the bytes that are in the rings."""
        self._ring.close(error)
        with self._rings_lock:
            self._ended = self._ended or error
            for ring in self._more_rings:
                ring.close(error)

    @property
    def running(self) -> bool:
        """Whether there is a line, and the thread reads it."""
        return self._line is not None and self._thread.is_alive() and not self._closing.is_set()

    def wake(self) -> None:
        """Wake the thread, so that it calls the next step of `setup` at once."""
        with self._line_lock:
            if self._line is not None:
                self._line.wake()

    def unwritten(self) -> int:
        """Return how many written bytes have not gone out; PortGoneError if the line is gone."""
        with self._line_lock:
            if self._line is None:
                raise PortGoneError(f"{self._url}: {self._why_no_line()}")
            return len(self._sending.rest) + self._line.unwritten()

    def close(self) -> None:
        """End the thread, close the line, and release the ring.

        The reading thread does this if the caller must not wait for it: in a signal handler that
        came while a lock was held, and if the reading thread itself has collected the port.
        """
        self._closing.set()
        must_not_wait = self._thread is threading.current_thread() or self.locked_here
        self.wake()
        if self._thread.is_alive() and must_not_wait:
            return
        self._thread.join()
        self._finish()

    @property
    def locked_here(self) -> bool:
        """Whether this thread holds a lock: a signal has interrupted a method here."""
        return holds(self._line_held) or holds(self._rings_held) or self._ring.locked_here

    def _finish(self) -> None:
        with self._line_lock:
            line, self._line = self._line, None
        if line is not None:
            line.close()
        self._ring.release()

    def _write_some(self, sending: "Sending", deadline: float | None) -> str:
        left = _HOLD_S if deadline is None else min(deadline - time.monotonic(), _HOLD_S)
        if self._closing.is_set():  # before the lock is taken, as `close` waits for the lock
            return self._why_no_line()
        with self._line_lock:
            if self._line is None:
                return self._why_no_line()
            try:
                count = self._line.write(sending.left, max(left, 0), sending.counts)
            except PortGoneError:
                return GONE
            except (CanserError, OSError) as error:
                return str(error).removeprefix(f"{self._url}: ")
        return NO_MORE if not count and left < _HOLD_S else ""

    def _why_no_line(self) -> str:
        return "the port is closed" if self._closing.is_set() else GONE

    def _run(self) -> None:
        try:
            self._keep_draining()
        except Exception as error:  # noqa: BLE001 - otherwise a reader would wait for ever
            self.end(error)
        finally:
            if self._closing.is_set():
                self._finish()

    def _keep_draining(self) -> None:
        while not self._closing.is_set():
            line = self._line
            assert line is not None
            try:
                self._drain(line)
            except (CanserError, OSError) as error:
                with self._line_lock:
                    self._line = None
                line.close()
                if not self._reconnect or not isinstance(error, PortGoneError):
                    self.end(error)
                    return
                self.last_heartbeat = 0
                now = self._clock()
                for ring in (self._ring, *self._more_rings):
                    ring.interrupt(now, "reconnect")
                self._come_back()

    def _drain(self, line: Line) -> None:
        """Read until the line is gone, or the port is closed."""
        ring, closing, setup = self._ring, self._closing, self._setup
        write = partial(self._send_packet, line)
        scratch = memoryview(bytearray(_SCRATCH))
        begin = due = time.monotonic()
        came, rest_s = 0, _REST_S
        while not closing.is_set():
            timeout = None
            if self._heartbeat:
                now = time.monotonic()
                if now >= due:
                    if write(self._heartbeat):
                        self.last_heartbeat = self._clock()
                    due = max(due + self._heartbeat_s, now)
                timeout = max(due - now, 0)
            if setup.active:
                pause = setup.step(time.monotonic(), write)
                timeout = min((each for each in (timeout, pause) if each is not None), default=None)
            room = ring.room()
            data = scratch if room is None else room
            count = line.read_into(data, timeout)
            if not count:
                continue
            ns = self._clock()
            if setup.active:
                setup.take(data[:count], None if room is None else ring.end)
            if room is None:
                ring.append(data[:count], ns)
            else:
                ring.put(count, ns)
            for other in self._more_rings:
                other.append(data[:count], ns)
            came += count
            if rest_s and count < _FULL_READ:
                time.sleep(rest_s)
            if (now := time.monotonic()) - begin > _WINDOW_S:
                rest_s = _choose_rest(came * self._byte_s / (now - begin))
                begin, came = now, 0

    def _send_packet(self, line: Line, packet: bytes) -> bool:
        """Send a packet; False if the line takes nothing, or another packet is going out."""
        if not self._writing.acquire(blocking=False):
            return False
        try:
            # The rest of a packet that was cut goes first.
            if rest := self._sending.rest:
                self._sending = Sending(rest)
                line.write(self._sending.left, 0, self._sending.counts)
            if self._sending.rest:
                return False
            sending = Sending(packet)
            if not line.write(sending.left, 0, sending.counts):
                return False
            self._sending = sending
            return True
        finally:
            self._writing.release()

    def _come_back(self) -> None:
        """Open the line anew, as soon as that is possible."""
        pause, longest = _RETRY_S
        while not self._closing.wait(pause):
            # A thread that writes must end first. Otherwise the rest of its packet would go out
            # on the new line.
            if not self._writing.acquire(blocking=False):
                continue
            self._sending = Sending()
            self._writing.release()
            try:
                line = connect_aside(self._url, self._connect, self._closing)
            except (CanserError, OSError):
                pause = min(pause * 2, longest)
                continue
            with self._line_lock:
                self._line = line
            return
