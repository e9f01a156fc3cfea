"""A recording as the whole work of a program: `canser.record`."""

import os
import time
from collections.abc import Callable
from typing import Unpack, cast

from canser._checks import callback, instance, whole
from canser._checks import timeout as check_seconds
from canser._core.table import find_protocol
from canser.live.config import LineConfig, PortOptions, adapter_config
from canser.live.ports import open as open_port
from canser.live.recording import (
    ROUND_S,
    OnEvent,
    RecordConfig,
    RecorderStatus,
    RecordingJob,
    RecordOptions,
    warn_of,
)
from canser.recording.header import RecordingInfo

__all__ = ["JobOptions", "record"]


class JobOptions(RecordOptions, PortOptions, total=False):
    """The keywords of `RecordConfig` and of `canser.open`."""


def record(
    url: str,
    protocol: str,
    path: str | os.PathLike[str],
    *,
    duration: float | None = None,
    stop: Callable[[], bool] | None = None,
    bus_bitrate: int | None = None,
    on_event: OnEvent | None = None,
    on_status: Callable[[RecorderStatus], None] | None = None,
    **options: Unpack[JobOptions],
) -> RecorderStatus:
    """Open a port, record what it receives, and close it; as `canser log` does.

    Parameters
    ----------
    url : str
        The port, as for `canser.open`.
    protocol : str
        The protocol of the adapter, as for `canser.open`.
    path : str or path-like
        The file to record into; its name ends in `.pcapng`.
    duration : float or None, seconds
        The time until the recording ends. None: until `stop`, or an error.
    stop : callable, optional
        `stop()` is called five times a second, and returns whether the recording shall end; such
        as the `is_set` of a `threading.Event`.
    bus_bitrate : int, optional
        Bit rate of the CAN bus in bit/s, if the adapter is not configured. It gives the load of
        the bus, and is noted in the file.
    on_event : callable, optional
        `on_event(event)` is called with each `RecorderEvent`. Without it Python's warnings report
        what is wrong.
    on_status : callable, optional
        `on_status(status)` is called with a `RecorderStatus` five times a second, and once at the
        end, after the file is closed, whatever has ended the recording.
    **options
        The keywords `bitrate`, `config`, `line`, `ts_unit` and `reconnect` of `canser.open`, and
        the fields of `RecordConfig`: `size`, `time`, `keep`, `triggers`, `before`, `after` and
        `force`.

    Returns
    -------
    RecorderStatus
        The status at the end.

    Raises
    ------
    TypeError, ValueError
        For an argument that is wrong.
    PortNotFoundError, PortDeniedError, PortBusyError, PortError
        If the port cannot be opened, as for `canser.open`.
    PortGoneError
        When the device is gone, without `reconnect`. All bytes that came before are recorded.
    OutputExistsError
        If the file is there already, without `force`.
    FileNotFoundError, PermissionError
        If the folder is missing, or must not be written to.
    OSError
        When the disk is full, or away. The message says what is recorded.
    Exception
        What `stop`, `on_event` and `on_status` raise, and KeyboardInterrupt. The recording ends,
        and the file is closed.

    Examples
    --------
    >>> status = canser.record("loop://", "seeed", "run.pcapng", duration=0.01)
    >>> status.files, status.bytes_recorded, status.bytes_lost
    (1, 0, 0)

    Record for days, into files of 100 MB, and keep the newest 20 of them:

    >>> status = canser.record(
    ...     "/dev/ttyUSB0", "seeed", "run.pcapng", size="100M", keep=20, reconnect=True
    ... )  # doctest: +SKIP
    """
    seconds = check_seconds(duration, "duration")
    callback(stop, "stop", "nothing")
    callback(on_event, "on_event", "an event")
    callback(on_status, "on_status", "a status")
    for name in options:
        if name not in JobOptions.__annotations__:
            raise TypeError(f"record() got an unexpected keyword argument {name!r}")
    names = RecordOptions.__annotations__.keys()
    for_files = {name: value for name, value in options.items() if name in names}
    for_port = {name: value for name, value in options.items() if name not in names}
    config = RecordConfig(**cast(RecordOptions, for_files))
    row, line = find_protocol(protocol), options.get("line")
    line = LineConfig() if line is None else instance(line, "line", LineConfig)
    adapter = adapter_config(options.get("bitrate"), options.get("config"))
    bitrate = None if adapter is None else adapter.bitrate
    if bus_bitrate is not None:
        bus_bitrate = whole(bus_bitrate, "bus_bitrate", "500000", least=1)
        bitrate = bus_bitrate if bitrate is None else bitrate
    info = RecordingInfo(
        protocol=row.name,
        baudrate=line.baudrate or row.baudrate,
        bitrate=bitrate,
        ts_unit=options.get("ts_unit", "ms"),
        device=url,
    )
    # Before the port is opened: a path that is wrong raises here, and no file is made yet.
    files = config.make_files(path, info)
    with open_port(url, protocol, **cast(PortOptions, for_port)) as port, port._reading:
        job = RecordingJob(
            port._stream, files, config, port._clock, bitrate=bitrate, on_event=on_event or warn_of
        )
        try:
            with job:
                _record_until(job, seconds, stop, on_status)
                job.drain(port.close)
        finally:
            status = job.status
            if on_status is not None:
                on_status(status)
    return status


def _record_until(
    job: RecordingJob,
    duration: float | None,
    stop: Callable[[], bool] | None,
    on_status: Callable[[RecorderStatus], None] | None,
) -> None:
    """Record in rounds until `duration` seconds are over, or `stop` returns True."""

    def is_stopped() -> bool:
        return stop is not None and stop()

    # `stop` is called before there is a file: a program that sees the file can rely on that.
    stopped = is_stopped()
    job.start()
    end = None if duration is None else time.monotonic() + duration
    while not stopped:
        left = ROUND_S if end is None else end - time.monotonic()
        if left <= 0:
            break
        job.step(min(left, ROUND_S))
        if on_status is not None:
            on_status(job.status)
        stopped = is_stopped()
