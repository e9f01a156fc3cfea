"""A bus of python-can over a live port: `can.Bus(interface="canser", ...)`."""

import logging
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from threading import Lock
from typing import Any, Final, cast

import can
import numpy as np
import numpy.typing as npt
from can.broadcastmanager import CyclicSendTaskABC, ThreadBasedCyclicSendTask
from can.typechecking import AutoDetectedConfig, CanFilters, Channel

from canser._checks import timeout as check_timeout
from canser._checks import whole
from canser._core.table import find_protocol
from canser._frames import NO_TIME, FrameArray
from canser._guards import Uncopied
from canser._items import message_to_row
from canser._protocols import protocols, tick_ns
from canser._rows import rows_to_frames
from canser.adapters import AdapterConfig
from canser.errors import PortError, SendTimeoutError
from canser.live import ports
from canser.live.config import LineConfig, flat_config
from canser.python_can._messages import MessageRow, to_rows

__all__ = ["CanserBus"]

_LOG: Final = logging.getLogger("can.canser")

# Options that python-can's tools and configuration files give to every bus. They mean nothing here.
_MEANINGLESS: Final = {"fd", "single_handle", "timeout"}

# The most frames that are taken from the port at once.
_BATCH: Final = 4096

# The longest time that `shutdown` waits for the line to send its bytes.
_DRAIN_S: Final = 1.0

# Timestamps in this range are epoch seconds; smaller ones are device seconds.
_EPOCH_FROM_S: Final = 1_000_000_000
_EPOCH_TO_S: Final = 1 << 32

# The device's clock counts this many ticks, and starts again: a counter of 32 bits.
_TICKS: Final = 1 << 32

# Of a filter: its id, its mask, and whether frames must be extended, None for any.
_Rule = tuple[np.int64, np.int64, bool | None]


def _take_fields(kind: type[AdapterConfig | LineConfig], options: dict[str, Any]) -> dict[str, Any]:
    """Remove the options that are fields of a value object, and return them."""
    names = {field.name for field in fields(kind)} & options.keys()
    return {name: options.pop(name) for name in names}


class _Descriptor(int):
    """A descriptor that takes attributes: python-can's test of its serial bus sets one on it."""


class _UntilShutdown:
    """A bus for the threads that send periodically.

    `shutdown` makes them stop, and does not wait for them. Otherwise a thread that sends just then
    would fail, as the port is closed.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus

    def send(self, msg: can.Message) -> None:
        try:
            self._bus.send(msg)
        except can.CanOperationError:
            if not self._bus._is_shutdown:
                raise


class CanserBus(Uncopied, can.BusABC):
    """A serial CAN adapter as a bus of python-can: `can.Bus(interface="canser", ...)`.

    Attributes
    ----------
    port : canser.Port
        The port of the bus, with its counters.

    Notes
    -----
    Messages have the times and the channel that python-can's own bus of the protocol gives. Times
    are those of the device's clock in seconds, if the protocol has one, else epoch seconds of the
    host. The channel is None.

    As with every bus of python-can, one thread may send while another one receives. Use a
    `can.ThreadSafeBus` for more threads.

    Examples
    --------
    >>> import can
    >>> with can.Bus(interface="canser", channel="loop://", protocol="seeed") as bus:
    ...     bus.send(can.Message(arbitration_id=0x123, data=[1], is_extended_id=False))
    ...     bus.recv(timeout=1.0).arbitration_id
    291
    """

    def __init__(
        self,
        channel: Channel,
        can_filters: CanFilters | None = None,
        *,
        protocol: str | None = None,
        ts_unit: str = "ms",
        device_time: bool | None = None,
        reconnect: bool = False,
        **options: Any,
    ) -> None:
        """Open a port as a bus.

        Parameters
        ----------
        channel : str
            The URL of the port, as for `canser.open`.
        can_filters : list of dict, optional
            As for any bus of python-can.
        protocol : str
            The protocol of the adapter: a name of `canser.protocols()` or an accepted spelling.
        ts_unit : {"ms", "us", "ns", "s"}, default "ms"
            Unit of the device's clock, as for `canser.open`.
        device_time : bool, optional
            Whether messages have times of the device's clock; False: times of the host. By default
            True if the protocol has a clock.
        reconnect : bool, default False
            Whether the port waits for a device that is gone, as for `canser.open`.
        **options
            The fields of `canser.AdapterConfig` and of `canser.LineConfig`. To configure the
            adapter `bitrate` is needed. Other options are ignored, as by python-can's own buses,
            and the log names them.

        Raises
        ------
        TypeError, ValueError
            For an argument that is wrong.
        can.CanInitializationError
            If the port cannot be opened.
        can.CanInterfaceNotImplementedError
            If pyserial is missing.
        """
        if not isinstance(channel, str):
            raise TypeError(f"channel is {channel!r}; it must be the URL of a port, such as COM3")
        if not channel:
            raise ValueError("channel is empty; it must be the URL of a port, such as /dev/ttyUSB0")
        if protocol is None:
            raise ValueError(f"protocol is missing; give one of {', '.join(protocols())}")
        if options.get("fd"):
            raise ValueError("fd is True, but serial adapters know classic CAN only; leave it out")
        self._config = flat_config(_take_fields(AdapterConfig, options))
        line = LineConfig(**_take_fields(LineConfig, options))
        for name in options.keys() - _MEANINGLESS:
            _LOG.warning("%s means nothing to the interface canser and is ignored", name)
        row = find_protocol(protocol)
        self._clocked, self._unit, self._tick_ns = row.has_clock, ts_unit, tick_ns(ts_unit)
        try:
            self.port = ports.open(
                channel,
                protocol,
                config=self._config,
                line=line,
                ts_unit=ts_unit,
                device_time=row.has_clock if device_time is None else device_time,
                reconnect=reconnect,
            )
        except PortError as error:
            raise can.CanInitializationError(str(error)) from error
        except ImportError as error:
            raise can.CanInterfaceNotImplementedError(str(error)) from error
        self.channel_info = f"{channel}, {row.name}"
        self._can_protocol = can.CanProtocol.CAN_20
        self._rules: list[_Rule] = []
        self._queue: deque[MessageRow] = deque()
        self._active_filters: object = None  # the filters that all frames in the queue have passed
        self._watched = False  # whether a caller has asked `fileno` for the descriptor
        self._lock = Lock()  # for several steps on the queue; not held during a wait
        try:
            super().__init__(channel, can_filters)
        except BaseException:
            self.port.close()
            raise

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._queue:
            self._fill(timeout)
        try:
            row = self._queue.popleft()  # atomic: needs no lock
        except IndexError:
            return None, True
        if self._watched and not self._queue:
            self._set_ready()
        # False: the filters have changed since, and python-can applies the new ones.
        return can.Message(*row), self._active_filters is self._filters

    def _fill(self, timeout: float | None) -> None:
        """Put the next frames that pass the filters into the queue; none after the time-out."""
        filters = self._filters
        frames = self._read(_BATCH, timeout)
        with self._lock:
            # Another thread may have put frames into the queue that passed other filters.
            same = not self._queue or filters is self._active_filters
            self._active_filters = filters if same else None
            self._queue.extend(to_rows(frames))
        if self._watched:
            self._set_ready()

    def _read(self, max_frames: int, timeout: float | None) -> FrameArray:
        """Return the next frames that pass the filters; none after the time-out."""
        timeout = check_timeout(timeout)
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            try:
                frames = self.port.read_batch(max_frames=max_frames, timeout=timeout)
            except PortError as error:
                raise can.CanOperationError(str(error)) from error
            if not len(frames):
                return frames
            if self._rules:
                frames = frames.compress(self._passes(frames))
            if len(frames):
                return frames
            timeout = None if deadline is None else deadline - time.monotonic()

    def recv_batch(self, *, max_frames: int = _BATCH, timeout: float | None = None) -> FrameArray:
        """Return the next frames as an array. A frame comes either here or as a message.

        Parameters
        ----------
        max_frames : int, default 4096
            The most frames to return, 1 or more.
        timeout : float or None, seconds
            The longest wait for the first frame that passes the filters; None waits for ever.

        Returns
        -------
        canser.FrameArray, shape (n,)
            The frames that pass the filters. After the time-out n may be 0.

        Raises
        ------
        TypeError, ValueError
            For an argument that is wrong.
        can.CanOperationError
            When the device is gone, or the bus is shut down.
        """
        max_frames = whole(max_frames, "max_frames", "4096", least=1)
        if not self._queue:
            return self._read(max_frames, timeout)
        taken: list[MessageRow] = []
        with self._lock:
            while self._queue and len(taken) < max_frames:
                taken.append(self._queue.popleft())
        if self._watched:
            self._set_ready()
        frames = rows_to_frames(
            (number, ext, rtr, dlc, err, bytes(data), round(ts * 1e9))
            for ts, number, ext, rtr, err, _, dlc, data in taken
        )
        return frames.compress(self._passes(frames)) if self._rules else frames

    def _apply_filters(self, filters: CanFilters | None) -> None:
        self._rules = [
            (np.int64(rule["can_id"]), np.int64(rule["can_mask"]), rule.get("extended"))
            for rule in filters or ()
        ]

    def _passes(self, frames: FrameArray) -> npt.NDArray[np.bool_]:
        """Return a mask of the frames that pass any of the filters, by python-can's rule."""
        ids = frames["id"].astype(np.int64)
        passed = np.zeros(len(frames), np.bool_)
        for wanted, mask, extended in self._rules:
            same = (ids ^ wanted) & mask == 0
            passed |= same if extended is None else same & (frames["ext"] == extended)
        return passed

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a message; returns when the system has taken it.

        Parameters
        ----------
        msg : can.Message
            The message. If the protocol has a clock, its timestamp is sent in ticks of that clock;
            epoch seconds, from 1,000,000,000 on, are sent modulo 2**32 ticks.
        timeout : float or None, seconds
            The longest time for the call; None waits for ever.

        Raises
        ------
        ValueError
            If the protocol cannot carry the message: CAN FD, an id or a time out of range, data
            that is not as long as the dlc says, an error frame in a protocol without these.
        can.CanTimeoutError
            If the message does not go out in time.
        can.CanOperationError
            When the device is gone, or the bus is shut down.

        Notes
        -----
        The call waits until a configured adapter listens. If the bit rate is known, frames go out
        no faster than the bus sends them. Both are as for `canser.Port.send`.
        """
        ts = self._ticking(msg.timestamp) if self._clocked else NO_TIME
        self._send(rows_to_frames([message_to_row(msg, ts)]), timeout)

    def send_batch(self, frames: FrameArray, *, timeout: float | None = None) -> int:
        """Send frames, as `canser.Port.send` does.

        Parameters
        ----------
        frames : canser.FrameArray, shape (n,)
            The frames, contiguous.
        timeout : float or None, seconds
            The longest time for the whole call; None waits for ever.

        Returns
        -------
        int
            The number of frames, n. All of them are sent.

        Raises
        ------
        TypeError, ValueError
            For an argument that is wrong, or a frame that the protocol cannot carry. Nothing is
            sent then.
        can.CanTimeoutError
            If the frames do not go out in time. Its cause is a `canser.SendError`, whose `sent` is
            the number of frames that went out.
        can.CanOperationError
            When the device is gone, with such a cause, or the bus is shut down.
        """
        return self._send(frames, timeout)

    def _send(self, frames: FrameArray, timeout: float | None) -> int:
        try:
            return self.port.send(frames, timeout=timeout)
        except SendTimeoutError as error:
            # All are sent, but for the rest of the last one, which goes out before anything else.
            if error.sent == len(frames):
                return error.sent
            raise can.CanTimeoutError(str(error)) from error
        except PortError as error:
            raise can.CanOperationError(str(error)) from error

    def _ticking(self, seconds: float) -> int:
        """Return the time of a message in nanoseconds; ValueError if the clock cannot show it."""
        if not 0 <= seconds < _EPOCH_TO_S:  # also raises for NaN
            raise ValueError(
                f"the timestamp {seconds} is out of range; it must be 0 or more, in seconds"
            )
        ns = round(seconds * 1e9)
        if ns >= _TICKS * self._tick_ns and seconds < _EPOCH_FROM_S:
            raise ValueError(
                f"the timestamp {seconds} is out of range: a clock in {self._unit} ends at "
                f"{(_TICKS - 1) * self._tick_ns / 1e9:.15g} seconds; use a coarser ts_unit"
            )
        return ns

    def fileno(self) -> int:
        """Return a descriptor that is readable while frames may be there, or the port is gone.

        Returns
        -------
        int
            A descriptor for select(), poll() and event loops. Do not read from it.

        Raises
        ------
        can.CanOperationError
            After `shutdown`.
        NotImplementedError
            On Windows.
        """
        if sys.platform == "win32":
            raise NotImplementedError("Windows cannot wait for descriptors; use a timeout")
        try:
            number = _Descriptor(self.port.fileno())
        except PortError as error:
            raise can.CanOperationError(str(error)) from error
        self._watched = True
        self._set_ready()
        return number

    def _set_ready(self) -> None:
        with self._lock:
            self.port.hold_ready(bool(self._queue))

    @property
    def state(self) -> can.BusState:
        """ACTIVE, or PASSIVE if the adapter is configured to listen only: `can.BusState`.

        Can be set if the bus was opened with a bitrate, so that the adapter is configured.
        Otherwise, and for ERROR, setting raises NotImplementedError.
        """
        silent = self._config is not None and "silent" in self._config.mode
        return can.BusState.PASSIVE if silent else can.BusState.ACTIVE

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        if new_state is self.state:
            return
        if self._config is None or new_state is can.BusState.ERROR:
            raise NotImplementedError(
                f"this bus cannot be made {new_state}; open it with a bitrate to configure "
                "its adapter"
            )
        mode = "silent" if new_state is can.BusState.PASSIVE else "normal"
        config = replace(self._config, mode=mode)
        try:
            self.port.configure(config)
        except PortError as error:
            raise can.CanOperationError(str(error)) from error
        self._config = config

    def _send_periodic_internal(
        self,
        msgs: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None = None,
        autostart: bool = True,
        modifier_callback: Callable[[can.Message], None] | None = None,
    ) -> CyclicSendTaskABC:
        task = super()._send_periodic_internal(msgs, period, duration, False, modifier_callback)
        assert isinstance(task, ThreadBasedCyclicSendTask)
        task.bus = cast(can.BusABC, _UntilShutdown(self))
        if autostart:
            task.start()
        return task

    def shutdown(self) -> None:
        """Stop periodic sending and close the port; a `recv` that waits ends with an error.

        Waits until the line has sent its bytes, at most one second. The log reports bytes that are
        left.
        """
        super().shutdown()
        try:
            if not self.port.drain(timeout=_DRAIN_S):
                _LOG.warning(
                    "%s: %d bytes are not sent, and are lost", self.port.url, self.port.bytes_unsent
                )
        except PortError:  # closed already, or gone: sending has raised that
            pass
        self.port.close()

    @staticmethod
    def _detect_available_configs() -> Sequence[AutoDetectedConfig]:
        # The protocol of an adapter is not known before it sends. So each is possible on each port.
        return [
            cast(
                AutoDetectedConfig,
                {"interface": "canser", "channel": port.url, "protocol": protocol},
            )
            for port in ports.list_ports()
            for protocol in protocols()
        ]
