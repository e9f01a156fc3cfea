"""A recording as the whole job of a program: `canser.record`."""

import time
from collections.abc import Callable
from typing import Final, Unpack, cast

from canser._checks import timeout as check_seconds
from canser._core.table import find_protocol
from canser.live.config import LineConfig, PortOptions, adapter_config
from canser.live.ports import open as open_port
from canser.live.recorder import OnEvent
from canser.live.recording import (
    RecordConfig,
    RecorderStatus,
    RecordingJob,
    RecordOptions,
)
from canser.recording.header import RecordingInfo

__all__ = ["JobOptions", "record"]

# The time between two looks at whether the job shall end, and between two statuses.
_ROUND_S: Final = 0.2


class JobOptions(RecordOptions, PortOptions, total=False):
    """The keywords of `RecordConfig` and of `canser.open`."""


def record(
    url: str,
    protocol: str,
    path: str,
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
    path : str
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
        Is called with a `RecorderStatus` five times a second, and once at the end.
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

    Examples
    --------
    >>> import canser
    >>> status = canser.record("loop://", "seeed", "run.pcapng", duration=0.1)
    >>> status.bytes_recorded, status.files_kept  # doctest: +SKIP
    (0, ('run.pcapng',))
    """
    seconds = check_seconds(duration, "duration")
    names = RecordOptions.__annotations__.keys()
    for_files = {name: value for name, value in options.items() if name in names}
    for_port = {name: value for name, value in options.items() if name not in names}
    config = RecordConfig(**cast(RecordOptions, for_files))
    row, line = find_protocol(protocol), options.get("line") or LineConfig()
    adapter = adapter_config(options.get("bitrate"), options.get("config"))
    bitrate = bus_bitrate if adapter is None else adapter.bitrate
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
        job = RecordingJob(port._stream, files, config, port._clock, bitrate=bitrate, tell=on_event)
        try:
            try:
                _follow(job, seconds, stop, on_status)
            finally:
                job.close()
        except OSError as error:
            raise job.explain(error) from error
        finally:
            if on_status is not None:
                on_status(job.status)
        return job.status


def _follow(
    job: RecordingJob,
    duration: float | None,
    stop: Callable[[], bool] | None,
    on_status: Callable[[RecorderStatus], None] | None,
) -> None:
    job.start()
    end = None if duration is None else time.monotonic() + duration
    while stop is None or not stop():
        left = _ROUND_S if end is None else end - time.monotonic()
        if left <= 0:
            break
        job.step(min(left, _ROUND_S))
        if on_status is not None:
            on_status(job.status)
    job.drain()
