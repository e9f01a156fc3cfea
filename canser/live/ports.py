"""Live ports: frames in batches, with host times; sending; the adapter's own commands."""

import contextlib
import os
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import AsyncIterator, Iterator
from dataclasses import replace
from typing import Final, NamedTuple, Self, TypeVar, Unpack

import numpy as np
import numpy.typing as npt

from canser import adapters
from canser._checks import callback, flag, instance, text, whole
from canser._checks import timeout as check_timeout
from canser._core.buffers import BytesLike, as_bytes, input_frames, output_frames
from canser._core.table import find_protocol
from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray, copy_records
from canser._guards import Uncopied
from canser._items import FrameItems
from canser._items import frames as make_frames
from canser.adapters import AdapterConfig, AdapterReport
from canser.codec.decoder import Control, Decoder, Stats, decode, encode
from canser.errors import (
    PortClosedError,
    PortError,
    SendError,
    SendTimeoutError,
)
from canser.live.config import LineConfig, adapter_config
from canser.live.line import Line, open_line
from canser.live.meter import longest_bits
from canser.live.pacing import AHEAD_FRAMES, Pacer
from canser.live.reader import NO_MORE, LineReader
from canser.live.recorder import Recorder
from canser.live.recording import (
    OnEvent,
    RecordConfig,
    RecordingJob,
    RecordOptions,
    warn_of,
)
from canser.live.ring import Gap, Ring
from canser.live.setup import Setup
from canser.live.stream import LiveStream, OnBytes, Watchdog
from canser.recording.header import RecordingInfo
from canser.timing.clocks import ClockEstimate
from canser.timing.host import ClockSteps, HostClock
from canser.timing.loop import TimedDecoder

__all__ = ["Gap", "Port", "PortInfo", "list_ports", "open"]

_T = TypeVar("_T")

# Bits of a byte on the line, with its start and stop bit.
_BYTE_BITS: Final = 10

# The pause after a configuration where the adapter cannot be asked whether it listens.
_SETTLE_S: Final = 0.1

# Frames that a call which waits for a status decodes at once, for later reads.
_AHEAD: Final = 4096

# A send looks this often whether the adapter listens.
_LOOK_S: Final = 0.005

_DEAF: Final = "the adapter did not say within the time-out that it listens"
_BUSY: Final = "the bus can have sent no more within the time-out"


# A call that waits for a status reads for this time, and then lets other threads read.
_TURN_S: Final = 0.02


def open(  # noqa: A001 - the name that the interface has, used as canser.open
    url: str,
    protocol: str,
    *,
    bitrate: int | None = None,
    config: AdapterConfig | None = None,
    line: LineConfig | None = None,
    ts_unit: str = "ms",
    device_time: bool = False,
    reconnect: bool = False,
    on_bytes: OnBytes | None = None,
) -> "Port":
    """Open a live port: raw, exclusively, and with a thread that reads it.

    Parameters
    ----------
    url : str
        Whatever pyserial opens: a device, a pseudo terminal, `socket://host:port`,
        `rfc2217://host:port`, `loop://`.
    protocol : str
        What the adapter speaks: a name of `canser.protocols()` or an accepted spelling.
    bitrate : int, optional
        Of the CAN bus in bit/s. The adapter is configured to it when it is opened, and again
        when it comes back. Adapters that know a status request are asked for their status until
        they answer: they need some time before they listen. Only `Port.send` and
        `Port.request_status` wait for that, and a CanserWarning tells where no answer comes.
    config : AdapterConfig, optional
        The whole configuration of the adapter, instead of `bitrate`. Without both of them the
        adapter is left as it is.
    line : LineConfig, optional
        The serial line; by default `LineConfig()`.
    ts_unit : {"ms", "us", "ns", "s"}, default "ms"
        Unit of the device's clock, as for `Decoder`.
    device_time : bool, default False
        Whether frames keep the times of the device's clock, unwrapped, in nanoseconds, and get
        no host times.
    reconnect : bool, default False
        Whether to wait for a device that is gone, and to go on. The gap is reported.
    on_bytes : callable, optional
        Is given all bytes as they came, before their frames are returned:
        `on_bytes(data, arrival_ns, lost)`. `data` is a memoryview, good until the call returns;
        `arrival_ns` is in epoch nanoseconds; `lost` bytes are missing before it, -1 if their
        number is unknown.

    Returns
    -------
    Port
        The open port, a context manager.

    Raises
    ------
    TypeError, ValueError
        For an argument that is wrong.
    PortNotFoundError, PortDeniedError, PortBusyError, PortError
        For a port that cannot be opened.

    Examples
    --------
    >>> with canser.open("loop://", "seeed") as port:
    ...     port.send(canser.decode(bytes.fromhex("aac12301ff55"), "seeed"))
    ...     port.read_batch()["id"]
    1
    array([291], dtype=uint32)
    """
    text(url, "url", "'/dev/ttyUSB0'")
    row = find_protocol(protocol)
    line = LineConfig() if line is None else instance(line, "line", LineConfig)
    if line.baudrate is None:
        line = replace(line, baudrate=row.baudrate)
    if line.ping is not None and not row.ping:
        raise ValueError(f"{row.name} adapters know no ping; leave ping out")
    device_time = flag(device_time, "device_time")
    if device_time and not row.has_clock:
        raise ValueError(f"{row.name} frames carry no device time; leave device_time out")
    callback(on_bytes, "on_bytes", "data, arrival_ns and lost")
    return Port(
        url,
        Decoder(row.name, ts_unit=ts_unit),
        line,
        adapter_config(bitrate, config),
        ts_unit=ts_unit,
        device_time=device_time,
        reconnect=flag(reconnect, "reconnect"),
        on_bytes=on_bytes,
    )


class Port(Uncopied):
    """A live port, made by `open`; a context manager.

    A thread drains the line into a ring of raw bytes. The thread that reads the port decodes them,
    straight into the array that is returned. Several threads may read: each frame goes to one of
    them. Frames have host times, epoch nanoseconds of a clock that does not step: by the device
    clock where the protocol has one, else when the last byte came. (Opened with
    `device_time` they have the times of the device's own clock.)
    """

    def __init__(
        self,
        url: str,
        decoder: Decoder,
        line: LineConfig,
        config: AdapterConfig | None,
        *,
        ts_unit: str,
        device_time: bool,
        reconnect: bool,
        on_bytes: OnBytes | None,
    ) -> None:
        self._closed, self._pid = True, os.getpid()  # until it is open
        self.url, self.decoder, self.protocol = url, decoder, decoder.protocol
        config_packet = b"" if config is None else adapters.configuration(self.protocol, config)
        self._setup = Setup(self.protocol, config_packet)
        self.bitrate = None if config is None else config.bitrate
        assert line.baudrate is not None  # `open` has set it
        self.baudrate = line.baudrate
        row = find_protocol(self.protocol)
        self._ts_unit, self._clocked, self._frame_min = ts_unit, row.has_clock, row.frame_min
        self._clock = HostClock()
        self._opened_ns = self._clock()
        self._ring_size = line.ring_size
        try:
            self._ring = Ring(line.ring_size)
        except (MemoryError, OverflowError):
            raise ValueError(
                f"ring_size is {line.ring_size}; it must be bytes that the system has memory for"
            ) from None
        self._pacer = Pacer()
        self._reading = threading.RLock()
        self._held = False  # what `hold_ready` was told
        # Nothing in the thread may hold the port: it would never be collected.
        self._reader = LineReader(
            url,
            _Connect(url, line, self._setup),
            self._ring,
            self._clock,
            self._setup,
            byte_s=_BYTE_BITS / self.baudrate,
            reconnect=reconnect,
            heartbeat=row.ping if line.ping is not None else b"",
            heartbeat_s=line.ping or 0.0,
        )
        self._watchdog: Watchdog | None = None
        if line.ping is not None:
            # Of the reader alone: the stream must not hold the port.
            reader = self._reader
            self._watchdog = Watchdog(line.ping, self._clock, lambda: reader.last_heartbeat)
        self._stream = self._make_stream(
            self._ring, decoder, device_time=device_time, on_bytes=on_bytes
        )
        self._recorders: set[Recorder] = set()
        self._closed = False

    def __repr__(self) -> str:
        return f"<canser.Port {self.url} {self.protocol}{' closed' if self._closed else ''}>"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        if not getattr(self, "_closed", True) and self._pid == os.getpid():
            warnings.warn(f"unclosed {self!r}", ResourceWarning, stacklevel=2, source=self)
            # At the end of the program its thread has ended already, wherever it was.
            if not sys.is_finalizing():
                self.close()

    # Reading

    def read_batch(
        self,
        out: FrameArray | None = None,
        *,
        max_frames: int = 4096,
        min_frames: int = 1,
        timeout: float | None = None,
    ) -> FrameArray:
        """Return the next frames.

        Waits until `min_frames` are there, or `timeout` is over, and returns the frames that there
        are.

        Parameters
        ----------
        out : FrameArray, optional
            Array of FRAME_DTYPE, shape (m,), contiguous, that the frames go to.
        max_frames : int, default 4096
            The most frames of a new array, where there is no `out`.
        min_frames : int, default 1
            The frames to wait for.
        timeout : float or None, seconds
            The longest wait. None waits for ever, 0 does not wait.

        Returns
        -------
        FrameArray
            FRAME_DTYPE, shape (n,): `out[:n]` if `out` is given, else a new array. After the
            time-out n may be 0.

        Raises
        ------
        PortGoneError
            The device is gone, and all frames that came before were returned.
        PortClosedError
            The port is closed, also by another thread meanwhile.
        TypeError, ValueError, BufferError
            As for `Decoder.feed_into`.

        Notes
        -----
        After another exception, of `on_bytes` or Ctrl-C, the next call returns the frames of this
        one.
        """
        self._check_open()
        if out is None:
            room = whole(max_frames, "max_frames", "4096", least=1)
        else:
            output_frames(out)
            room = len(out)
        if not 0 <= whole(min_frames, "min_frames", "1") <= room:
            raise ValueError(f"min_frames is {min_frames}; it must be 0 to {room}, the room")
        deadline = _deadline(timeout)
        if not self._take_turn(deadline):
            return np.empty(0, FRAME_DTYPE) if out is None else out[:0]
        try:
            count = self._stream.read(room, min_frames, deadline)
            batch = np.empty(min(count, room), FRAME_DTYPE) if out is None else out[:count]
            self._stream.take_into(batch)
            return batch
        finally:
            self._hold_signal()
            self._reading.release()

    def batches(
        self, *, max_frames: int = 4096, timeout: float = 0.05, out: FrameArray | None = None
    ) -> Iterator[FrameArray]:
        """Yield batches as they come, until the port is closed.

        Parameters
        ----------
        max_frames : int, default 4096
            The most frames of a batch, where there is no `out`.
        timeout : float, seconds, default 0.05
            The longest time in which a batch is gathered.
        out : FrameArray, optional
            Array of FRAME_DTYPE, shape (m,), that is filled again and again.

        Yields
        ------
        FrameArray
            FRAME_DTYPE, shape (n,), n >= 1.

        Raises
        ------
        PortGoneError
            As in `read_batch`.
        """
        least = max_frames if out is None else len(out)
        while True:
            try:
                batch = self.read_batch(
                    out, max_frames=max_frames, min_frames=least, timeout=timeout
                )
            except PortClosedError:
                return
            if len(batch):
                yield batch

    async def batches_async(
        self, *, max_frames: int = 4096, timeout: float = 0.05
    ) -> AsyncIterator[FrameArray]:
        """Yield batches as `batches` does, without blocking the event loop.

        A task that is cancelled here loses no frame.

        Parameters
        ----------
        max_frames : int, default 4096
            The most frames of a batch.
        timeout : float, seconds, default 0.05
            The longest time in which a batch is gathered.

        Yields
        ------
        FrameArray
            New array of FRAME_DTYPE, shape (n,), n >= 1.

        Raises
        ------
        PortGoneError
            As in `read_batch`.
        """
        import asyncio  # noqa: PLC0415 - imported where it is used: it takes 30 ms

        max_frames = whole(max_frames, "max_frames", "4096", least=1)
        pause = check_timeout(timeout)
        loop, came = asyncio.get_running_loop(), asyncio.Event()

        def tell() -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(came.set)

        try:
            while True:
                came.clear()
                wanted = max_frames * self._frame_min
                self._ring.listen(wanted, tell)
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(came.wait(), pause)
                try:
                    batch = self.read_batch(max_frames=max_frames, timeout=0)
                except PortClosedError:
                    return
                if len(batch):
                    yield batch
        finally:
            self._ring.listen(1, None)

    def fileno(self) -> int:
        """Return a descriptor that is readable while bytes wait, or when the port is gone.

        Returns
        -------
        int
            For select(), poll() and event loops. It must not be read. POSIX only.

        Raises
        ------
        PortError
            The system has no descriptor left.
        """
        self._check_open()
        try:
            return self._ring.fileno()
        except OSError as error:  # no descriptor is left
            raise PortError(f"{self.url}: {error.strerror or error}") from None

    def hold_ready(self, held: bool) -> None:
        """Keep the descriptor of `fileno` readable, for a caller who has frames left to hand on.

        Parameters
        ----------
        held : bool
            Whether to keep it readable.
        """
        self._held = held
        self._hold_signal()

    def _hold_signal(self) -> None:
        self._ring.hold_ready(self._held or self._stream.ready > 0)

    def take_controls(self) -> list[Control]:
        """Return the control packets since the last call, the oldest first.

        The newest 65,536 are kept. Answers to the requests that follow a configuration are not
        among them; `stats` counts them.

        Returns
        -------
        list of Control
            Each with its offset in the stream, and its bytes. `canser.adapters.report` explains
            them.
        """
        return _empty(self._stream.controls)

    def take_gaps(self) -> list[Gap]:
        """Return the places since the last call where bytes are missing, the oldest first.

        Returns
        -------
        list of Gap
            Each with its offset in the stream, and the number of missing bytes where it is known.
        """
        return _empty(self._stream.gaps)

    @property
    def stats(self) -> Stats:
        """The decoder's counters, of the bytes that were read so far."""
        return self.decoder.stats

    @property
    def bytes_lost(self) -> int:
        """Bytes that came while the ring was full, and were thrown away."""
        return self._ring.lost

    @property
    def ring_fill(self) -> float:
        """How full the ring is, 0 to 1."""
        return self._ring.fill

    @property
    def clock(self) -> ClockEstimate | None:
        """Offset and drift of the device clock; None where there is none, or nothing is known.

        With `device_time` nothing is.
        """
        return self._stream.loop.clock.estimate

    @property
    def status(self) -> AdapterReport | None:
        """The last status that came from the adapter, None before the first.

        Answers to the requests that follow a configuration do not count.
        """
        return self._stream.status

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._closed

    # Recording

    def record(
        self,
        path: str | os.PathLike[str],
        *,
        on_event: OnEvent | None = None,
        **options: Unpack[RecordOptions],
    ) -> Recorder:
        """Record all bytes from now on, in a thread, whether the port is read or not.

        Parameters
        ----------
        path : str or path
            A name that ends in `.pcapng`.
        on_event : callable, optional
            Is called with each `RecorderEvent`, by that thread; while it runs, nothing is
            recorded. It may close the recorder and the port, but must not wait for a thread
            that does. What it raises is a `CanserWarning`, and the recording goes on. Without
            it warnings are those of Python.
        **options
            `size`, `time`, `keep`, `triggers`, `before`, `after` and `force`, as for
            `RecordConfig`.

        Returns
        -------
        Recorder
            A context manager. The recording ends with it, and with the port.

        Raises
        ------
        TypeError, ValueError
            For an argument that is wrong.
        OutputExistsError, FileNotFoundError, PermissionError
            For a path that will not do.
        OSError
            For a file that cannot be made.
        PortClosedError, PortGoneError
            When the port is closed, or the device is gone.

        Examples
        --------
        >>> with canser.open("/dev/ttyUSB0", "seeed") as port:  # doctest: +SKIP
        ...     with port.record("run.pcapng", size="100M", keep=20) as recorder:
        ...         for batch in port.batches():
        ...             print(len(batch), recorder.status.bytes_recorded)
        """
        self._check_open()
        config, on_event = RecordConfig(**options), callback(on_event, "on_event", "an event")
        info = RecordingInfo(self.protocol, self.baudrate, self.bitrate, self._ts_unit, self.url)
        files = config.make_files(path, info)
        ring = Ring(self._ring_size)
        # A decoder of its own: it tells where packets end, and finds triggers.
        stream = self._make_stream(ring, Decoder(self.protocol, ts_unit=self._ts_unit))

        clock, bitrate = self._clock, self.bitrate

        def make_job(tell: OnEvent) -> RecordingJob:
            return RecordingJob(stream, files, config, clock, bitrate=bitrate, tell=tell)

        recorder = Recorder(self.url, make_job, self._reader, ring, on_event or warn_of)
        self._recorders.add(recorder)
        for other in list(self._recorders):
            if other.closed:
                self._recorders.discard(other)
        return recorder

    # Writing

    def send(self, frames: FrameItems, *, timeout: float | None = None, pace: bool = True) -> int:
        """Send frames, as fast as the line and the bus take them.

        Waits until an adapter that was configured listens. To wait for that alone, send no frames:
        []. Returns when the system has taken the last byte.

        Parameters
        ----------
        frames : FrameArray or FrameItems
            An array of FRAME_DTYPE, shape (n,), contiguous; or what `canser.frames` makes one of,
            such as "123#DEADBEEF". A time that is not known goes out as the time since the port
            was opened.
        timeout : float or None, seconds
            For the whole call. None waits for ever.
        pace : bool, default True
            Whether to stay at most 16 frames ahead of what the bus carries, where its bit rate is
            known. Each frame is taken to be as long as stuff bits can make it. An adapter throws
            away what it has no room for. False sends as fast as the line takes frames.

        Returns
        -------
        int
            The frames that were sent: all of them.

        Raises
        ------
        ValueError
            The format cannot carry a frame. Nothing is sent.
        SendTimeoutError
            The adapter does not listen, or the line or the bus takes no more in time. `sent` has
            the number of frames that went out. A frame that is cut counts as sent: its rest goes
            out before anything else.
        SendError
            The line is gone; with `sent` as above.
        """
        self._check_open()
        deadline, pace = _deadline(timeout), flag(pace, "pace")
        if not isinstance(frames, np.ndarray):
            frames = make_frames(frames)
        input_frames(frames)  # before its times are asked for
        if self._clocked:
            unknown = frames["ts"] == NO_TIME
            if unknown.any():
                frames = copy_records(frames)
                frames["ts"][unknown] = self._clock() - self._opened_ns
        raw = encode(frames, self.protocol, ts_unit=self._ts_unit)
        listens = self._wait_listening(deadline)
        self._stream.tell_silence(4)
        written, why = 0, _DEAF
        if listens:
            written, why = self._write_frames(frames, raw, deadline, pace=pace)
        if not why:
            return len(frames)
        whole = int(np.searchsorted(self._ends(raw), written, side="right"))
        kind = SendTimeoutError if why in (NO_MORE, _DEAF, _BUSY) else SendError
        raise kind(f"{self.url}: {why}; {whole} of {len(frames)} frames were sent", whole, why)

    def send_raw(self, data: BytesLike, *, timeout: float | None = None) -> None:
        """Send bytes as they are, such as a command that canser does not know.

        It does not wait until an adapter listens.

        Parameters
        ----------
        data : bytes-like
            The bytes.
        timeout : float or None, seconds
            The longest wait for the line. None waits for ever.

        Raises
        ------
        SendTimeoutError, SendError
            Not all bytes could be sent. `sent` is 0.
        """
        self._check_open()
        timeout = check_timeout(timeout)
        raw = as_bytes(data).tobytes()
        written, why = self._reader.write(raw, timeout, _missing_nothing)
        if why:
            kind = SendTimeoutError if why == NO_MORE else SendError
            raise kind(f"{self.url}: {why}; {written} of {len(raw)} bytes were sent", 0, why)

    def drain(self, *, timeout: float | None = None) -> bool:
        """Wait until the line has sent all that was written.

        Parameters
        ----------
        timeout : float or None, seconds
            The longest wait. None waits for ever.

        Returns
        -------
        bool
            Whether all was sent in time.

        Raises
        ------
        PortGoneError
            The device is gone.
        """
        self._check_open()
        timeout = check_timeout(timeout)
        deadline = _deadline(timeout)
        # What is left of a frame that a time-out of `send` has cut.
        _, why = self._reader.write(b"", timeout, _missing_nothing)
        while True:
            self._check_open()
            held = self._reader.unwritten()
            if why:
                return False
            if not held:
                return True
            if deadline is not None and time.monotonic() >= deadline:
                return False
            # As long as the line needs for it, but for not longer than one notices.
            time.sleep(min(max(held * _BYTE_BITS / self.baudrate, 0.0005), 0.02))

    @property
    def bytes_unsent(self) -> int:
        """Bytes that were written and that the system holds, as far as it tells.

        A pseudo terminal and `rfc2217://` tell nothing, and so this is 0 there. PortGoneError
        when the device is gone.
        """
        self._check_open()
        return self._reader.unwritten()

    # The adapter's own commands

    def configure(self, config: AdapterConfig | None = None, *, bitrate: int | None = None) -> None:
        """Configure the adapter, as `canser.open` does.

        Returns when the configuration is written. Adapters that know a status request are then
        asked for their status until they answer, for which `send` waits.

        Parameters
        ----------
        config : AdapterConfig, optional
            How the adapter is to work.
        bitrate : int, optional
            Of the CAN bus in bit/s, instead of `config`; all else is as in `AdapterConfig`.

        Raises
        ------
        TypeError
            For an argument of another type.
        ValueError
            Without `config` and `bitrate`, with both, or as `adapters.configuration`.
        SendError
            If the line does not take the configuration.
        """
        config = adapter_config(bitrate, config)
        if config is None:
            raise ValueError("bitrate is missing; give bitrate or config")
        before = self._setup.config_packet
        # Set first: otherwise the reader's thread could write the one before behind it.
        self._setup.config_packet = adapters.configuration(self.protocol, config)
        try:
            self.send_raw(self._setup.config_packet)
        except BaseException:
            self._setup.config_packet = before
            raise
        self.bitrate = config.bitrate
        if self._setup.asks:
            self._setup.start()
            self._reader.wake()
        else:
            time.sleep(_SETTLE_S)

    def request_status(self, *, timeout: float | None = 1.0) -> AdapterReport:
        """Ask the adapter for its status, and return the answer.

        Waits until an adapter that was configured listens. Frames that come meanwhile are returned
        by the next reads.

        Parameters
        ----------
        timeout : float or None, seconds, default 1
            The longest wait for the answer. None waits for ever.

        Returns
        -------
        AdapterReport
            The status, with the error counters of the adapter.

        Raises
        ------
        ValueError
            The protocol knows no status request.
        PortError
            No answer came in time.
        """
        request = find_protocol(self.protocol).status_request
        if not request:
            raise ValueError(f"{self.protocol} adapters know no status request")
        deadline = _deadline(timeout)
        self._check_open()
        no_answer = PortError(
            f"{self.url} did not answer the status request within {timeout or 0:g} s; "
            "is it this kind of adapter?"
        )
        if not self._wait_listening(deadline):
            raise no_answer
        self._stream.tell_silence(4)
        self._setup.end()
        self._stream.status = None
        self.send_raw(request, timeout=_left(deadline))
        while (status := self._stream.status) is None:
            self._check_open()
            if deadline is not None and time.monotonic() >= deadline:
                raise no_answer
            # Another thread that reads finds the answer, too.
            if self._take_turn(_sooner(deadline, _TURN_S)):
                try:
                    ready = self._stream.ready
                    self._stream.read(ready + _AHEAD, ready + 1, _sooner(deadline, _TURN_S))
                finally:
                    self._hold_signal()
                    self._reading.release()
        return status

    def close(self) -> None:
        """Close the port; a read that waits in another thread ends with PortClosedError.

        Recordings of it get what had come, and end. A signal handler may close it, too.
        """
        was_closed, self._closed = self._closed, True
        if self._pid != os.getpid():
            return  # the parent's: its threads are not here, and its line stays open
        if not was_closed:
            self._reader.end(PortClosedError(f"{self.url} is closed"))
            self._reader.close()
        # A signal handler or another thread that has closed it may not have waited for these.
        for recorder in list(self._recorders):
            recorder._end()

    # Inside

    def _make_stream(
        self,
        ring: Ring,
        decoder: Decoder,
        *,
        device_time: bool = False,
        on_bytes: OnBytes | None = None,
    ) -> LiveStream:
        loop = TimedDecoder(decoder, _BYTE_BITS * 1e9 / self.baudrate, device_time=device_time)
        # The answers to what set the adapter up are known by their places in the port's own ring.
        setup = self._setup if ring is self._ring else None
        return LiveStream(
            self.url,
            ring,
            loop,
            steps=ClockSteps(self._clock),
            on_bytes=on_bytes,
            watchdog=self._watchdog,
            setup=setup,
        )

    def _check_open(self) -> None:
        if self._closed:
            raise PortClosedError(f"{self.url} is closed")
        if self._pid != os.getpid():
            raise PortError(
                f"{self.url} was opened by process {self._pid}, before a fork; "
                "open it in the process that uses it"
            )

    def _wait_listening(self, deadline: float | None) -> bool:
        """Wait until the adapter listens, or there is no line; False after the deadline."""
        while not self._setup.listening and self._reader.running:
            left = _left(deadline)
            if left == 0:
                return False
            time.sleep(_LOOK_S if left is None else min(left, _LOOK_S))
        return True

    def _take_turn(self, deadline: float | None) -> bool:
        """Become the thread that reads; False after the deadline."""
        left = -1.0 if deadline is None else max(deadline - time.monotonic(), 0)
        return self._reading.acquire(timeout=left)

    def _write_frames(
        self, frames: FrameArray, raw: bytes, deadline: float | None, *, pace: bool
    ) -> tuple[int, str]:
        """Write encoded frames; return how many bytes went out or will, and why not all did."""
        written, sent, why = 0, 0, ""
        if not pace or self.bitrate is None or not len(frames):
            return self._reader.write(raw, _left(deadline), self._missing)
        ends = None  # where all frames may go out at once, as is mostly so, they are not needed
        while sent < len(frames) and not why:
            bits = longest_bits(frames[sent : sent + AHEAD_FRAMES])
            count = self._pacer.take([each / self.bitrate for each in bits], deadline)
            if not count:
                return written, _BUSY
            sent += count
            if sent < len(frames) and ends is None:
                ends = self._ends(raw)
            part = raw[written:] if ends is None else raw[written : ends[sent - 1]]
            more, why = self._reader.write(part, _left(deadline), self._missing)
            written += more
        return written, why

    def _missing(self, part: bytes, sent: int) -> int:
        """Return how many bytes are missing of the packet in `part` that is cut there."""
        ends = self._ends(part)
        return int(ends[np.searchsorted(ends, sent)]) - sent

    def _ends(self, raw: bytes) -> npt.NDArray[np.int64]:
        """Return where each of the packets ends that `encode` gave."""
        starts = np.empty(len(raw) // self._frame_min + 1, np.int64)
        count = len(decode(raw, self.protocol, ts_unit=self._ts_unit, offsets=starts))
        return np.append(starts[1:count], len(raw))


class _Connect:
    """Open the line, write the adapter's configuration if there is one, and start its setup."""

    def __init__(self, url: str, line: LineConfig, setup: Setup) -> None:
        self._url, self._line, self._setup = url, line, setup

    def __call__(self) -> Line:
        line = open_line(self._url, self._line)
        packet = self._setup.config_packet  # another thread may set the next one
        rest = memoryview(packet)
        try:
            while rest:
                count = line.write(rest, 1.0, [])
                if not count:
                    raise PortError(
                        f"{self._url} does not take the adapter's configuration; is it plugged in?"
                    )
                rest = rest[count:]
        except BaseException:
            line.close()
            raise
        self._setup.start()
        if packet and not self._setup.asks:
            time.sleep(_SETTLE_S)
        return line


def _deadline(timeout: float | None) -> float | None:
    """Return when a time-out is over, by time.monotonic(); None for never."""
    seconds = check_timeout(timeout)
    return None if seconds is None else time.monotonic() + seconds


def _missing_nothing(data: bytes, sent: int) -> int:  # noqa: ARG001 - of bytes that are no packets
    return 0


def _left(deadline: float | None) -> float | None:
    """Return the seconds until a deadline, 0 after it; None for never."""
    return None if deadline is None else max(deadline - time.monotonic(), 0)


def _sooner(deadline: float | None, seconds: float) -> float:
    """Return the deadline, or the time in this many seconds, whichever is sooner."""
    soon = time.monotonic() + seconds
    return soon if deadline is None else min(deadline, soon)


def _empty(items: deque[_T]) -> list[_T]:
    """Take all there is, while another thread may add to it."""
    taken = []
    with contextlib.suppress(IndexError):
        while True:
            taken.append(items.popleft())
    return taken


class PortInfo(NamedTuple):
    """A serial port of this machine; returned by `list_ports`."""

    #: What `open` takes.
    url: str
    #: Of the device, as it calls itself; "" where it does not.
    name: str
    #: USB ids and serial number, or what else the system knows; "" for nothing.
    hardware: str


def list_ports() -> list[PortInfo]:
    """Return the serial ports that are plugged in.

    Returns
    -------
    list of PortInfo
        In the order of their names.

    Examples
    --------
    >>> for port in canser.list_ports():  # doctest: +SKIP
    ...     print(port.url, port.description)
    /dev/ttyUSB0 USB Serial
    """
    from serial.tools.list_ports import comports  # noqa: PLC0415 - imported where it is used

    return [
        PortInfo(
            found.device,
            "" if found.description in (None, "n/a") else found.description,
            "" if found.hwid in (None, "n/a") else found.hwid,
        )
        for found in sorted(comports())
    ]
