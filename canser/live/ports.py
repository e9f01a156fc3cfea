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
from canser.live.pacing import AHEAD_FRAMES, Pacer, longest_bits
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

# Bits of a byte on the line: the start bit, 8 data bits, the stop bit (8N1).
_BYTE_BITS: Final = 10

# The pause after a configuration, where the protocol has no status request: such an adapter cannot
# be asked whether it listens.
_SETTLE_S: Final = 0.1

# `request_status` decodes at most this many frames at once. They wait for later reads.
_AHEAD_FRAMES: Final = 4096

# `send` checks at this interval whether the adapter listens.
_LOOK_EVERY_S: Final = 0.005

# `request_status` reads for this time, and then lets other threads read.
_TURN_S: Final = 0.02

_DEAF: Final = "the adapter did not say within the time-out that it listens"
_BUSY: Final = "the bus can have sent no more within the time-out"


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
        What pyserial opens: a device such as `/dev/ttyUSB0` or `COM3`, a pseudo terminal,
        `socket://host:port`, `rfc2217://host:port`, `loop://`.
    protocol : str
        The protocol of the adapter: a name of `canser.protocols()` or an accepted spelling.
    bitrate : int, optional
        Bit rate of the CAN bus, in bit/s. The adapter is configured to it when the port is
        opened, and again when the device comes back.
    config : AdapterConfig, optional
        The whole configuration of the adapter, instead of `bitrate`. Without `bitrate` and
        `config` the adapter is left as it is.
    line : LineConfig, optional
        How the serial line is opened; by default `LineConfig()`.
    ts_unit : {"ms", "us", "ns", "s"}, default "ms"
        Unit of the device's clock, as for `Decoder`.
    device_time : bool, default False
        Whether frames keep the times of the device's clock, unwrapped, in nanoseconds. Otherwise
        frames get host times, see `Port`.
    reconnect : bool, default False
        Whether the port waits for a device that is gone, and goes on when it is back. The gap is
        reported by `Port.take_gaps`. Otherwise the stream ends with PortGoneError.
    on_bytes : callable, optional
        `on_bytes(data, arrival_ns, lost)` is called with all bytes as they came, before their
        frames are returned. `data` is a memoryview, valid until the call returns. `arrival_ns` is
        when its bytes had arrived, in epoch nanoseconds. `lost` is the number of bytes that are
        missing before `data`, -1 if that number is unknown. At the end of the stream `data` may
        be empty: then the last bytes are missing.

    Returns
    -------
    Port
        The open port, a context manager.

    Raises
    ------
    TypeError, ValueError
        For an argument that is wrong.
    PortNotFoundError
        If there is no such port, or no server answers.
    PortDeniedError
        If this user may not open the port.
    PortBusyError
        If the port is open in another program.
    PortError
        If the port cannot be opened for another reason. The three errors above are PortErrors, too.

    Notes
    -----
    An adapter may need some time until it listens. Where the protocol has a status request, a
    configured adapter is asked for its status until it answers. Only `Port.send` and
    `Port.request_status` wait for the answer. If none comes there is a `CanserWarning`.

    Examples
    --------
    `loop://` is a line that returns each byte that is sent:

    >>> with canser.open("loop://", "seeed") as port:
    ...     port.send("123#DEADBEEF")
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

    Attributes
    ----------
    url : str
        The URL of the port, as it was given to `open`.
    protocol : str
        The protocol's name, one of `canser.protocols()`.
    baudrate : int
        Of the serial line, in bit/s.
    bitrate : int or None
        Of the CAN bus, in bit/s; None if the adapter was not configured.
    decoder : Decoder
        The decoder of the port's bytes.

    Notes
    -----
    A thread reads the line into a ring of raw bytes. The thread that calls `read_batch` decodes
    these bytes, straight into the array that is returned. Several threads may read: each frame
    goes to one of them.

    The times of frames are epoch nanoseconds of a clock that does not step. Where the protocol
    has a clock, a frame's time follows from the device's clock; else it is when the last byte of
    the frame came. With `device_time` the times are those of the device's own clock.

    A port must be opened in the process that uses it. After a fork the port of the parent raises
    `PortError` in the child.

    Examples
    --------
    >>> with canser.open("loop://", "seeed") as port:
    ...     count = port.send(canser.frames("123#DEADBEEF", "124#"))
    ...     frames = port.read_batch(min_frames=2)
    >>> frames["id"].tolist()
    [291, 292]
    >>> port.stats.frames, port.stats.bytes_skipped
    (2, 0)
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
        self._held = False  # the argument of the last `hold_ready`
        # Nothing in the thread may refer to the port: otherwise the port would never be collected.
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
            reader = self._reader  # alone: the stream must not refer to the port
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
            # At the end of the program the thread is stopped already, and cannot be joined.
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

        Parameters
        ----------
        out : FrameArray, shape (cap,), optional
            The array that gets the frames, contiguous and writeable. Without it a new one is made.
        max_frames : int, default 4096
            The most frames of a new array, 1 or more. Does not matter with `out`.
        min_frames : int, default 1
            The call waits until this many frames are there; 0 to `max_frames`, or to the length
            of `out`.
        timeout : float or None, seconds
            The longest wait: None waits for ever, 0 not at all.

        Returns
        -------
        FrameArray, shape (n,)
            `out[:n]` if `out` is given, else a new array. After the time-out these are the frames
            that have come, and n may be 0.

        Raises
        ------
        PortGoneError
            When the device is gone, after all frames that came before are returned.
        PortClosedError
            When the port is closed, also during the wait.
        TypeError, ValueError, BufferError
            For an argument that is wrong; for `out` as in `Decoder.feed_into`.

        Notes
        -----
        No exception loses a frame. After one of `on_bytes`, or Ctrl-C, the next call returns the
        frames that this call had.

        Examples
        --------
        >>> out = np.empty(4096, canser.FRAME_DTYPE)
        >>> with canser.open("loop://", "seeed") as port:
        ...     count = port.send(canser.frames("123#DEADBEEF", "124#"))
        ...     port.read_batch(out, min_frames=2, timeout=1.0)["dlc"].tolist()
        [4, 0]
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
        """Yield batches of frames as they come, until the port is closed.

        A batch is gathered until it is full, or until `timeout` seconds have passed. Batches
        without a frame are not yielded.

        Parameters
        ----------
        max_frames : int, default 4096
            The most frames of a batch, 1 or more. Does not matter with `out`.
        timeout : float, default 0.05, seconds
            How long a batch is gathered at most.
        out : FrameArray, shape (cap,), optional
            The array that gets each batch, contiguous and writeable. The next batch overwrites
            it. Without `out` each batch is a new array.

        Yields
        ------
        FrameArray, shape (n,)
            The next frames, one or more; `out[:n]` if `out` is given.

        Raises
        ------
        PortGoneError
            When the device is gone, after all frames that came before are yielded.
        TypeError, ValueError, BufferError
            For an argument that is wrong, as in `read_batch`.

        Examples
        --------
        >>> with canser.open("loop://", "seeed") as port:
        ...     count = port.send(canser.frames("123#DEADBEEF", "124#"))
        ...     for batch in port.batches(timeout=0.01):
        ...         port.close()
        >>> batch["id"].tolist()
        [291, 292]
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

        Parameters
        ----------
        max_frames : int, default 4096
            The most frames of a batch, 1 or more.
        timeout : float, default 0.05, seconds
            How long a batch is gathered at most.

        Yields
        ------
        FrameArray, shape (n,)
            The next frames, one or more, as a new array.

        Raises
        ------
        PortGoneError
            When the device is gone, after all frames that came before are yielded.
        TypeError, ValueError
            For an argument that is wrong.

        Notes
        -----
        A task that is cancelled here loses no frame: the next read returns them.

        Examples
        --------
        >>> import asyncio
        >>> async def first_batch():
        ...     with canser.open("loop://", "seeed") as port:
        ...         port.send("123#DEADBEEF")
        ...         async for batch in port.batches_async(timeout=0.01):
        ...             return batch
        >>> asyncio.run(first_batch())["id"].tolist()
        [291]
        """
        import asyncio  # noqa: PLC0415 - imported where it is used: it takes 30 ms

        max_frames = whole(max_frames, "max_frames", "4096", least=1)
        pause = check_timeout(timeout)
        loop, came = asyncio.get_running_loop(), asyncio.Event()

        def set_came() -> None:  # by any thread
            if not loop.is_closed():
                loop.call_soon_threadsafe(came.set)

        try:
            while True:
                came.clear()
                wanted = max_frames * self._frame_min
                self._ring.listen(wanted, set_came)
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
        """Return a descriptor that is readable while bytes wait, or the port is gone.

        Returns
        -------
        int
            A descriptor for select(), poll() and event loops. Do not read from it.

        Raises
        ------
        PortClosedError
            When the port is closed.
        PortError
            If the system has no descriptor left.

        Notes
        -----
        POSIX only.

        Examples
        --------
        >>> import select
        >>> with canser.open("loop://", "seeed") as port:
        ...     count = port.send("123#DEADBEEF")
        ...     readable, _, _ = select.select([port], [], [], 1.0)
        ...     readable == [port]
        True
        """
        self._check_open()
        try:
            return self._ring.fileno()
        except OSError as error:  # no descriptor is left
            raise PortError(f"{self.url}: {error.strerror or error}") from None

    def hold_ready(self, held: bool) -> None:
        """Keep the descriptor of `fileno` readable, though the port has no bytes left.

        Parameters
        ----------
        held : bool
            Whether the caller itself holds frames that it has read and not handed on. Otherwise
            a select() would wait while these frames are there.
        """
        self._held = held
        self._hold_signal()

    def _hold_signal(self) -> None:
        self._ring.hold_ready(self._held or self._stream.ready > 0)

    def take_controls(self) -> list[Control]:
        """Return the control packets since the last call, oldest first.

        Returns
        -------
        list of Control
            Offset in the stream and bytes of each packet. `adapters.report` says what a packet
            means.

        Notes
        -----
        Of the packets that are not taken the newest 65,536 are kept. Answers to the status
        requests that follow a configuration are not among them; `stats` counts them, too.

        Examples
        --------
        >>> with canser.open("loop://", "seeed") as port:
        ...     port.take_controls()
        []
        """
        return _take_all(self._stream.controls)

    def take_gaps(self) -> list[Gap]:
        """Return the gaps since the last call, oldest first: places where bytes are missing.

        Returns
        -------
        list of Gap
            Offset, number of missing bytes, time and reason of each gap. Of the gaps that are not
            taken the newest 65,536 are kept.

        Examples
        --------
        >>> with canser.open("loop://", "seeed") as port:
        ...     port.take_gaps()
        []
        """
        return _take_all(self._stream.gaps)

    @property
    def stats(self) -> Stats:
        """The decoder's counters, of the bytes that were read so far: `Stats`."""
        return self.decoder.stats

    @property
    def bytes_lost(self) -> int:
        """Bytes that came while the ring was full, and were thrown away: an int."""
        return self._ring.lost

    @property
    def ring_fill(self) -> float:
        """How full the ring of raw bytes is: a float, 0 to 1."""
        return self._ring.fill

    @property
    def clock(self) -> ClockEstimate | None:
        """Offset and drift of the device's clock: `ClockEstimate`, or None.

        None if the protocol has no clock, while nothing is known of the clock, and with
        `device_time`.
        """
        return self._stream.loop.clock.estimate

    @property
    def status(self) -> AdapterReport | None:
        """The last status that the adapter sent: `AdapterReport`; None before the first one.

        Answers to the status requests that follow a configuration do not count.
        """
        return self._stream.status

    @property
    def closed(self) -> bool:
        """Whether `close` was called: a bool."""
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
        path : str or path-like
            The file to record into; its name ends in `.pcapng`.
        on_event : callable, optional
            `on_event(event)` is called with each `RecorderEvent`, by the recorder's thread.
            Nothing is recorded while it runs. It may close the recorder and the port, but must
            not wait for a thread that closes them. An exception that it raises becomes a
            `CanserWarning`, and the recording goes on. Without `on_event` Python's warnings
            report what is wrong.
        **options
            The fields of `RecordConfig`: `size`, `time`, `keep`, `triggers`, `before`, `after`
            and `force`.

        Returns
        -------
        Recorder
            The running recording, a context manager. It ends with its `close`, or with the port.

        Raises
        ------
        TypeError, ValueError
            For an argument that is wrong.
        OutputExistsError
            If the file is there already, without `force`.
        FileNotFoundError, PermissionError
            If the folder is missing, or must not be written to.
        OSError
            If the file cannot be made.
        PortClosedError, PortGoneError
            When the port is closed, or the device is gone.

        Examples
        --------
        >>> with canser.open("loop://", "seeed") as port:
        ...     recorder = port.record("run.pcapng")  # until the port is closed
        ...     count = port.send(canser.frames("123#DEADBEEF", "124#"))
        ...     frames = port.read_batch(min_frames=2)
        >>> canser.read("run.pcapng")["id"].tolist()
        [291, 292]
        """
        self._check_open()
        config, on_event = RecordConfig(**options), callback(on_event, "on_event", "an event")
        info = RecordingInfo(self.protocol, self.baudrate, self.bitrate, self._ts_unit, self.url)
        files = config.make_files(path, info)
        ring = Ring(self._ring_size)
        # A decoder of the recording's own: it finds the ends of packets, and triggers.
        stream = self._make_stream(ring, Decoder(self.protocol, ts_unit=self._ts_unit))
        clock, bitrate = self._clock, self.bitrate  # no reference to the port

        def make_job(report: OnEvent) -> RecordingJob:
            return RecordingJob(stream, files, config, clock, bitrate=bitrate, on_event=report)

        recorder = Recorder(self.url, make_job, self._reader, ring, on_event or warn_of)
        self._recorders.add(recorder)
        for other in list(self._recorders):
            if other.closed:
                self._recorders.discard(other)
        return recorder

    # Writing

    def send(self, frames: FrameItems, *, timeout: float | None = None, pace: bool = True) -> int:
        """Send frames, as fast as the line and the bus take them; return how many.

        Returns when the system has taken the last byte.

        Parameters
        ----------
        frames : FrameArray, shape (n,), or what `canser.frames` takes
            The frames, such as "123#DEADBEEF"; an array must be contiguous. Without a frame, [],
            the call only waits until the adapter listens. A time that is not known goes out as
            the time since the port was opened.
        timeout : float or None, seconds
            The longest time for the whole call; None waits for ever.
        pace : bool, default True
            Whether frames go out no faster than the bus sends them, see Notes. False sends as
            fast as the line takes them.

        Returns
        -------
        int
            The number of frames, n. All of them are sent.

        Raises
        ------
        TypeError, ValueError
            For an argument that is wrong, or a frame that the protocol cannot carry. Nothing is
            sent then.
        SendTimeoutError
            If the adapter does not listen in time, or the line or the bus takes no more. `sent`
            is the number of frames that went out. A frame that the time-out cuts counts as sent:
            its rest goes out before anything else.
        SendError
            When the line is gone; `sent` as above.
        PortClosedError
            When the port is closed.

        Notes
        -----
        An adapter throws away frames for which it has no room. So `pace` keeps at most 16 frames
        on their way that the bus cannot have sent yet. Each is taken to be as long as stuff bits
        can make it. The bit rate of the bus must be known for that: see `bitrate` of `open`.

        If the adapter was configured, the call waits until the adapter listens.

        Examples
        --------
        >>> with canser.open("loop://", "seeed") as port:
        ...     port.send("123#DEADBEEF")
        ...     port.send(canser.frames("124#", "18FEF100#01"), timeout=1.0)
        1
        2
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
        self._stream.warn_of_silence(4)
        written, why = 0, _DEAF
        if listens:
            written, why = self._write_frames(frames, raw, deadline, pace=pace)
        if not why:
            return len(frames)
        sent = int(np.searchsorted(self._ends(raw), written, side="right"))
        kind = SendTimeoutError if why in (NO_MORE, _DEAF, _BUSY) else SendError
        raise kind(f"{self.url}: {why}; {sent} of {len(frames)} frames were sent", sent, why)

    def send_raw(self, data: BytesLike, *, timeout: float | None = None) -> None:
        """Send bytes as they are, such as a command that canser does not know.

        Does not wait until the adapter listens.

        Parameters
        ----------
        data : bytes-like
            The bytes.
        timeout : float or None, seconds
            The longest time for the call; None waits for ever.

        Raises
        ------
        SendTimeoutError
            If the line did not take all bytes in time; its `sent` is 0.
        SendError
            If the line is gone; its `sent` is 0.
        PortClosedError
            When the port is closed.
        TypeError, ValueError, BufferError
            For an argument that is wrong.

        Examples
        --------
        >>> with canser.open("loop://", "seeed") as port:
        ...     port.send_raw(bytes.fromhex("aac12301ff55"))
        ...     port.read_batch()["id"].tolist()
        [291]
        """
        self._check_open()
        timeout = check_timeout(timeout)
        raw = as_bytes(data).tobytes()
        written, why = self._reader.write(raw, timeout, _missing_nothing)
        if why:
            kind = SendTimeoutError if why == NO_MORE else SendError
            raise kind(f"{self.url}: {why}; {written} of {len(raw)} bytes were sent", 0, why)

    def drain(self, *, timeout: float | None = None) -> bool:
        """Wait until the line has sent all bytes that were written.

        Parameters
        ----------
        timeout : float or None, seconds
            The longest wait; None waits for ever.

        Returns
        -------
        bool
            Whether all bytes are sent; False after the time-out.

        Raises
        ------
        PortGoneError
            When the device is gone.
        PortClosedError
            When the port is closed.

        Examples
        --------
        >>> with canser.open("loop://", "seeed") as port:
        ...     count = port.send("123#DEADBEEF")
        ...     port.drain(timeout=1.0)
        True
        """
        self._check_open()
        timeout = check_timeout(timeout)
        deadline = _deadline(timeout)
        # Writes the rest of a frame that a time-out of `send` has cut.
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
            # As long as the line needs for these bytes, within limits: a shorter sleep would take
            # processor time, and a longer one would delay `close` and the time-out.
            time.sleep(min(max(held * _BYTE_BITS / self.baudrate, 0.0005), 0.02))

    @property
    def bytes_unsent(self) -> int:
        """Bytes that were written and that the system still holds: an int.

        0 for pseudo terminals and `rfc2217://`, where the number is not known. Raises
        `PortGoneError` when the device is gone.
        """
        self._check_open()
        return self._reader.unwritten()

    # The adapter's own commands

    def configure(self, config: AdapterConfig | None = None, *, bitrate: int | None = None) -> None:
        """Configure the adapter, as `canser.open` does.

        Returns when the configuration is written. Where the protocol has a status request the
        adapter is then asked for its status until it answers; `send` waits for the answer.

        Parameters
        ----------
        config : AdapterConfig, optional
            How the adapter is to work.
        bitrate : int, optional
            Bit rate of the CAN bus in bit/s, instead of `config`. All else has the defaults of
            `AdapterConfig`.

        Raises
        ------
        TypeError
            For an argument of another type.
        ValueError
            Without `config` and `bitrate`, with both, or as `adapters.configuration`.
        SendError
            If the line does not take the configuration.
        PortClosedError
            When the port is closed.

        Examples
        --------
        >>> with canser.open("loop://", "seeed") as port:
        ...     port.configure(bitrate=500_000)
        ...     port.bitrate
        500000
        """
        config = adapter_config(bitrate, config)
        if config is None:
            raise ValueError("bitrate is missing; give bitrate or config")
        before = self._setup.config_packet
        # Set before it is sent: otherwise the reader's thread could write the old one after it.
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

        If the adapter was configured, the call waits until the adapter listens. Frames that come
        meanwhile are returned by the next reads.

        Parameters
        ----------
        timeout : float or None, default 1.0, seconds
            The longest wait for the answer; None waits for ever.

        Returns
        -------
        AdapterReport
            The status, with the adapter's error counters.

        Raises
        ------
        ValueError
            If the protocol has no status request.
        PortError
            If no answer comes in time.
        PortClosedError
            When the port is closed.

        Examples
        --------
        `loop://` returns the request, which reads as a status without errors:

        >>> with canser.open("loop://", "seeed") as port:
        ...     status = port.request_status()
        >>> status.receive_errors, status.transmit_errors
        (0, 0)
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
        self._stream.warn_of_silence(4)
        self._setup.end()
        self._stream.status = None
        self.send_raw(request, timeout=_left(deadline))
        while (status := self._stream.status) is None:
            self._check_open()
            if deadline is not None and time.monotonic() >= deadline:
                raise no_answer
            # While another thread reads, that thread finds the answer.
            if self._take_turn(_sooner(deadline, _TURN_S)):
                try:
                    ready = self._stream.ready
                    self._stream.read(ready + _AHEAD_FRAMES, ready + 1, _sooner(deadline, _TURN_S))
                finally:
                    self._hold_signal()
                    self._reading.release()
        return status

    def close(self) -> None:
        """Close the port.

        A read that waits in another thread ends with `PortClosedError`. Recordings of the port
        record what had come, and end. The port may be closed again, and by a signal handler.

        Raises
        ------
        PortError
            If the system cannot close the line. It counts as closed then.

        Examples
        --------
        >>> port = canser.open("loop://", "seeed")
        >>> port.close()
        >>> port.closed
        True
        """
        was_closed, self._closed = self._closed, True
        if self._pid != os.getpid():
            return  # after a fork: the threads are the parent's, and its line stays open
        if not was_closed:
            self._reader.end(PortClosedError(f"{self.url} is closed"))
            self._reader.close()
        # If a signal handler or another thread has closed the port, it may not have waited for
        # the recorders.
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
        # The answers to the requests of `setup` are known by their offsets in the port's own ring.
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
            time.sleep(_LOOK_EVERY_S if left is None else min(left, _LOOK_EVERY_S))
        return True

    def _take_turn(self, deadline: float | None) -> bool:
        """Wait until no other thread reads, and keep others from it; False after the deadline."""
        left = -1.0 if deadline is None else max(deadline - time.monotonic(), 0)
        return self._reading.acquire(timeout=left)

    def _write_frames(
        self, frames: FrameArray, raw: bytes, deadline: float | None, *, pace: bool
    ) -> tuple[int, str]:
        """Write encoded frames; return how many bytes went out or will, and why not all did.

        `frames`: the frames that are encoded in `raw`.
        """
        written, sent, why = 0, 0, ""
        if not pace or self.bitrate is None or not len(frames):
            return self._reader.write(raw, _left(deadline), self._missing)
        ends = None  # not needed if all frames may go out at once, which is the usual case
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
        """Return how many bytes the packet lacks that is cut behind `sent` bytes of `part`."""
        ends = self._ends(part)
        return int(ends[np.searchsorted(ends, sent)]) - sent

    def _ends(self, raw: bytes) -> npt.NDArray[np.int64]:
        """Return the offset behind each packet in the output of `encode`."""
        starts = np.empty(len(raw) // self._frame_min + 1, np.int64)
        count = len(decode(raw, self.protocol, ts_unit=self._ts_unit, offsets=starts))
        return np.append(starts[1:count], len(raw))


class _Connect:
    """Open the line, write the adapter's configuration if there is one, and start its setup."""

    def __init__(self, url: str, line: LineConfig, setup: Setup) -> None:
        self._url, self._line, self._setup = url, line, setup

    def __call__(self) -> Line:
        line = open_line(self._url, self._line)
        packet = self._setup.config_packet  # read once: another thread may replace it
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
    """Return the deadline of a time-out in seconds, by time.monotonic(); None for never."""
    seconds = check_timeout(timeout)
    return None if seconds is None else time.monotonic() + seconds


def _missing_nothing(data: bytes, sent: int) -> int:  # noqa: ARG001 - raw bytes have no packets
    return 0


def _left(deadline: float | None) -> float | None:
    """Return the seconds until a deadline, 0 after it; None for never."""
    return None if deadline is None else max(deadline - time.monotonic(), 0)


def _sooner(deadline: float | None, seconds: float) -> float:
    """Return the deadline or the time in `seconds`, whichever is sooner."""
    soon = time.monotonic() + seconds
    return soon if deadline is None else min(deadline, soon)


def _take_all(items: deque[_T]) -> list[_T]:
    """Remove all items and return them; another thread may add more meanwhile."""
    taken = []
    with contextlib.suppress(IndexError):
        while True:
            taken.append(items.popleft())
    return taken


class PortInfo(NamedTuple):
    """A serial port of this machine, returned by `list_ports`."""

    #: The URL for `open`, such as "/dev/ttyUSB0" or "COM3".
    url: str
    #: The device's own name; "" if it has none.
    name: str
    #: USB ids and serial number, or what else the system knows of the device; "" for nothing.
    hardware: str


def list_ports() -> list[PortInfo]:
    """Return the serial ports that are plugged in.

    Returns
    -------
    list of PortInfo
        URL, name and hardware of each port, in the order of their URLs.

    Examples
    --------
    >>> for port in canser.list_ports():
    ...     print(port.url, port.name)  # doctest: +SKIP
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
