"""A recording beside whatever else a program does with a port."""

import threading
import warnings
from collections.abc import Callable
from typing import Final, Self

from canser._guards import Uncopied
from canser._threads import start_thread
from canser.errors import CanserWarning, PortClosedError, PortError
from canser.live.reader import LineReader
from canser.live.recording import RecorderEvent, RecorderStatus, RecordingJob
from canser.live.ring import Ring

__all__ = ["OnEvent", "Recorder"]

OnEvent = Callable[[RecorderEvent], None]

# The thread looks this often whether it shall end.
_ROUND_S: Final = 0.2


class Recorder(Uncopied):
    """Records what a port receives, made by `Port.record`; a context manager.

    A thread of its own takes the bytes from a ring of its own: it records all of them, whether
    the port is read or not. A slow reader and a slow disk do not lose each other's bytes; each
    loss is counted by itself, here in `status`.

    The recording ends with `close`, with the port, or with an error of the disk.
    """

    def __init__(
        self,
        url: str,
        make_job: Callable[[Callable[[RecorderEvent], None]], RecordingJob],
        reader: LineReader,
        ring: Ring,
        on_event: OnEvent | None,
    ) -> None:
        self._url, self._reader, self._ring, self._on_event = url, reader, ring, on_event
        #: What has ended the recording before `close`, None for nothing.
        self.error: Exception | None = None
        self._raised = False  # the error, by `close`
        self._ending = threading.Event()
        self._job = make_job(self._tell)
        self._job.start()
        self._status = self._job.status
        self._thread = threading.Thread(target=self._run, name="canser recorder", daemon=True)
        reader.add_ring(ring)
        try:
            start_thread(self._thread, url, PortError)
        except BaseException:
            reader.remove_ring(ring)
            self._job.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def status(self) -> RecorderStatus:
        """How the recording stands, at most 0.2 s ago."""
        return self._status

    @property
    def closed(self) -> bool:
        """Whether the recording has ended, and its file is closed."""
        return not self._thread.is_alive()

    def close(self) -> None:
        """Record what the line has delivered until now, and close the file.

        OSError, once, where the disk was full or away: the message tells what is recorded.
        """
        self.end()
        if isinstance(self.error, OSError) and not self._raised:
            self._raised = True
            raise self.error

    def end(self) -> None:
        """End the recording as `close` does, without an error."""
        self._ending.set()
        if self._thread is not threading.current_thread():
            self._thread.join()

    def _run(self) -> None:
        job = self._job
        try:
            try:
                while not self._ending.is_set():
                    job.step(_ROUND_S)
                    self._status = job.status
                job.drain()
            finally:
                self._reader.remove_ring(self._ring)
                job.close()
        except PortClosedError:
            pass
        except OSError as error:
            self.error = job.explain(error)
        except Exception as error:  # noqa: BLE001 - the owner asks for it
            self.error = error
        self._status = job.status
        if isinstance(self.error, OSError):
            self._tell_warning(f"{self._url}: {self.error}")

    def _tell(self, event: RecorderEvent) -> None:
        if self._on_event is None:
            if event.kind == "warning":
                self._tell_warning(event.text)
            return
        try:
            self._on_event(event)
        except Exception as error:  # noqa: BLE001 - the recording goes on
            self._tell_warning(f"{self._url}: on_event failed: {type(error).__name__}: {error}")

    def _tell_warning(self, text: str) -> None:
        # Where warnings are errors, the recording goes on.
        try:
            warnings.warn(text, CanserWarning, stacklevel=3)
        except CanserWarning as warning:
            self.error = self.error or warning
