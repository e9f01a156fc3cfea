"""A recording in a thread of its own, while a program uses the port."""

import contextlib
import threading
import warnings
from collections.abc import Callable
from typing import Self

from canser._guards import Uncopied
from canser._threads import start_thread
from canser.errors import CanserWarning, PortClosedError, PortError
from canser.live.reader import LineReader
from canser.live.recording import (
    ROUND_S,
    OnEvent,
    RecorderEvent,
    RecorderStatus,
    RecordingJob,
)
from canser.live.ring import Ring

__all__ = ["Recorder"]


class _Thread(threading.Thread):
    """The thread of a recorder."""


class Recorder(Uncopied):
    """A recording of all bytes that a port receives, made by `Port.record`; a context manager.

    Close the recorder, or the port, before the program ends. Otherwise the file lacks what is not
    on the disk yet: the bytes of the last second, and those that wait in the ring.

    Attributes
    ----------
    error : Exception or None
        What has ended the recording, if it ended before `close` and before the port was closed.

    Notes
    -----
    A thread takes the bytes from a ring of the recorder's own, whether the port is read or not. So
    a slow reader does not lose bytes of the recording, and a slow disk does not lose bytes of the
    reader. Each loss is counted by itself: `Port.bytes_lost`, and `bytes_lost` in `status`.

    The recording ends with `close`, with the port, when the device is gone, or with an error of
    the disk.

    Examples
    --------
    >>> with canser.open("loop://", "seeed") as port:
    ...     recorder = port.record("run.pcapng")
    ...     count = port.send(canser.frames("123#DEADBEEF", "124#"))
    ...     frames = port.read_batch(min_frames=2)
    >>> status = recorder.status
    >>> status.bytes_recorded, status.bytes_lost
    (14, 0)
    """

    def __init__(
        self,
        url: str,
        make_job: Callable[[OnEvent], RecordingJob],
        reader: LineReader,
        ring: Ring,
        on_event: OnEvent,
    ) -> None:
        self._url, self._reader, self._ring, self._on_event = url, reader, ring, on_event
        self.error: Exception | None = None
        self._unraised: Exception | None = None  # for `close`
        self._ending = threading.Event()
        self._job = make_job(self._report)
        self._thread = _Thread(target=self._run, name="canser recorder", daemon=True)
        with contextlib.ExitStack() as undo:
            undo.enter_context(self._job)
            # The ring gets bytes before there is a file. Otherwise bytes would be missing that
            # come while the file is made.
            undo.callback(reader.remove_ring, ring)
            reader.add_ring(ring)
            self._job.start()
            self._status = self._job.status
            start_thread(self._thread, url, PortError)
            undo.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def status(self) -> RecorderStatus:
        """A snapshot of the recording: `RecorderStatus`.

        It is about 0.2 s old, or older if the disk is slow.
        """
        return self._status

    @property
    def closed(self) -> bool:
        """Whether the recording has ended, and its file is closed: a bool."""
        return not self._thread.is_alive()

    def close(self) -> None:
        """Record what the line has delivered until now, and close the file.

        Takes up to 0.7 s if bytes keep coming. May be called again, by any thread, and by
        `on_event`; then the recording ends after that call of `on_event`.

        Raises
        ------
        OSError
            Once, if the disk was full or away. The message says what is recorded.
        CanserWarning
            Once, if there was a warning and warnings are errors.
        """
        self._end()
        error, self._unraised = self._unraised, None
        if error is not None:
            raise error

    def _end(self) -> None:
        """End the recording as `close` does, and raise nothing; also called by the port.

        Does not wait for the end in `on_event`, and in a signal handler that came while this
        thread held a lock. Otherwise the wait would never end.
        """
        self._ending.set()
        in_event = isinstance(threading.current_thread(), _Thread)
        if not (in_event or self._ring.locked_here or self._reader.locked_here):
            self._thread.join()

    def _run(self) -> None:
        job = self._job
        try:
            with job:
                try:
                    while not self._ending.is_set():
                        job.step(ROUND_S)
                        self._status = job.status
                    job.drain(self._stop_filling)
                finally:
                    self._stop_filling()
        except PortClosedError:
            pass
        except Exception as error:  # noqa: BLE001 - `error` and `close` report it
            self.error = error
            if not isinstance(error, PortError):  # the port itself raises those
                self._unraised = error
                job.warn(f"{self._url}: {error}")
        self._status = job.status

    def _stop_filling(self) -> None:
        self._reader.remove_ring(self._ring)

    def _report(self, event: RecorderEvent) -> None:
        """Call `on_event`; the recording goes on after any exception."""
        try:
            self._on_event(event)
        except CanserWarning as warning:  # warnings are errors
            self._unraised = self._unraised or warning
        except BaseException as error:  # noqa: BLE001 - SystemExit, too
            self._warn(f"{self._url}: on_event failed: {type(error).__name__}: {error}")

    def _warn(self, message: str) -> None:
        try:
            warnings.warn(message, CanserWarning, stacklevel=2)
        except Exception as error:  # noqa: BLE001 - warnings are errors, or cannot be shown
            self._unraised = self._unraised or error
