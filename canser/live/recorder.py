"""A recording beside whatever else a program does with a port."""

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
    """Records what a port receives, made by `Port.record`; a context manager.

    A thread of its own takes the bytes from a ring of its own: it records all of them, whether
    the port is read or not. A slow reader and a slow disk do not lose each other's bytes; each
    loss is counted by itself, here in `status`.

    The recording ends with `close`, with the port, when the device is gone, or with an error of
    the disk. At the end of the program it does not end by itself: what is not on the disk is
    missing then, the last second and what waits in the ring.

    Attributes
    ----------
    error : Exception or None
        What has ended the recording before `close` and before the port was closed.
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
        self._job = make_job(self._tell)
        self._thread = _Thread(target=self._run, name="canser recorder", daemon=True)
        with contextlib.ExitStack() as undo:
            undo.enter_context(self._job)
            # Before there is a file: making one takes a while, in which bytes come.
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
        """How the recording stands: about 0.2 s ago, longer where the disk takes longer."""
        return self._status

    @property
    def closed(self) -> bool:
        """Whether the recording has ended, and its file is closed."""
        return not self._thread.is_alive()

    def close(self) -> None:
        """Record what the line has delivered until now, and close the file.

        May be called again, by any thread, and by `on_event`: the recording ends after that call
        of `on_event` then. Takes up to 0.7 s where bytes keep coming.

        Raises
        ------
        OSError
            Once, where the disk was full or away: the message tells what is recorded.
        CanserWarning
            Once, where warnings are errors and there was one.
        """
        self._end()
        error, self._unraised = self._unraised, None
        if error is not None:
            raise error

    def _end(self) -> None:
        """End the recording as `close` does, without an error; for the port, too.

        The end is not waited for where this thread must not wait: in `on_event`, and in a signal
        handler that came while a lock was held.
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
        except Exception as error:  # noqa: BLE001 - the owner asks for it
            self.error = error
            if not isinstance(error, PortError):  # that the reader of the port is told
                self._unraised = error
                job.warn(f"{self._url}: {error}")
        self._status = job.status

    def _stop_filling(self) -> None:
        self._reader.remove_ring(self._ring)

    def _tell(self, event: RecorderEvent) -> None:
        """Tell of an event; whatever that raises, the recording goes on."""
        try:
            self._on_event(event)
        except CanserWarning as warning:  # warnings are errors
            self._unraised = self._unraised or warning
        except BaseException as error:  # noqa: BLE001 - SystemExit, too
            self._warn(f"{self._url}: on_event failed: {type(error).__name__}: {error}")

    def _warn(self, told: str) -> None:
        try:
            warnings.warn(told, CanserWarning, stacklevel=2)
        except Exception as error:  # noqa: BLE001 - warnings are errors, or cannot be shown
            self._unraised = self._unraised or error
