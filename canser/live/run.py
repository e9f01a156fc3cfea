"""A recording as the whole job of a program: `canser.record`."""

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
    url, protocol : str
        As for `canser.open`.
    path : str or path
        A name that ends in `.pcapng`.
    duration : float, optional
        Seconds until the end; None: until `stop`, or an error.
    stop : callable, optional
        Is asked five times a second whether the recording shall end, such as the `is_set` of a
        `threading.Event`.
    bus_bitrate : int, optional
        Of the CAN bus in bit/s, for the load and the file, where the adapter is not configured.
    on_event : callable, optional
        Is called with each `RecorderEvent`. Without it warnings are those of Python.
    on_status : callable, optional
        Is called with a `RecorderStatus` five times a second, and once at the end, after the file
        is closed, whatever has ended the recording.
    **options
        `bitrate`, `config`, `line`, `ts_unit` and `reconnect` as for `canser.open`; `size`,
        `time`, `keep`, `triggers`, `before`, `after` and `force` as for `RecordConfig`.

    Returns
    -------
    RecorderStatus
        How it has ended.

    Raises
    ------
    TypeError, ValueError
        For an argument that is wrong.
    PortNotFoundError, PortDeniedError, PortBusyError, PortError
        For a port that cannot be opened.
    PortGoneError
        When the device is gone, without `reconnect`. All that came before is recorded.
    OutputExistsError, FileNotFoundError, PermissionError
        For a path that will not do.
    OSError
        When the disk is full, or away. The message tells what is recorded.
    Exception
        Whatever `stop`, `on_event` and `on_status` raise, and KeyboardInterrupt: they end the
        recording, and the file is closed.

    Examples
    --------
    >>> import canser
    >>> status = canser.record("loop://", "seeed", "run.pcapng", duration=0.1)
    >>> status.bytes_recorded, status.files_kept  # doctest: +SKIP
    (0, ('run.pcapng',))
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
    # Before the port is opened: what is wrong with the path is told, and nothing is made.
    files = config.make_files(path, info)
    with open_port(url, protocol, **cast(PortOptions, for_port)) as port, port._reading:
        job = RecordingJob(
            port._stream, files, config, port._clock, bitrate=bitrate, tell=on_event or warn_of
        )
        try:
            with job:
                _follow(job, seconds, stop, on_status)
                job.drain(port.close)
        finally:
            status = job.status
            if on_status is not None:
                on_status(status)
    return status


def _follow(
    job: RecordingJob,
    duration: float | None,
    stop: Callable[[], bool] | None,
    on_status: Callable[[RecorderStatus], None] | None,
) -> None:
    def asked() -> bool:
        return stop is not None and stop()

    # Also before there is a file: a program that sees the file can rely on `stop`.
    stopped = asked()
    job.start()
    end = None if duration is None else time.monotonic() + duration
    while not stopped:
        left = ROUND_S if end is None else end - time.monotonic()
        if left <= 0:
            break
        job.step(min(left, ROUND_S))
        if on_status is not None:
            on_status(job.status)
        stopped = asked()
