"""Threads: started with an error that names their purpose, and one that does a piece of work."""

import threading
from collections.abc import Callable

from canser.errors import CanserError

__all__ = ["Job", "start_thread"]


def start_thread(
    thread: threading.Thread, name: str, kind: type[CanserError] = CanserError
) -> None:
    """Start a thread for what `name` names; an error of `kind` where the system starts no more."""
    try:
        thread.start()
    except RuntimeError as error:
        raise kind(f"{name}: {error}; end some processes, or allow more with 'ulimit -u'") from None


class Job:
    """Work that a thread of its own does, from now on; `name` is what it is for.

    As `concurrent.futures` does, whose import takes as long as that of ten other modules.
    """

    def __init__(self, work: Callable[[], None], name: str) -> None:
        self._work = work
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=f"canser {name}")
        start_thread(self._thread, name)

    def _run(self) -> None:
        try:
            self._work()
        except BaseException as error:  # noqa: BLE001 - raised again by `check`
            self._error = error

    def wait(self) -> None:
        """Wait until the work has ended, by an error, too."""
        self._thread.join()

    def check(self) -> None:
        """Raise the error that has ended the work, if there is one so far."""
        if self._error is not None:
            raise self._error
