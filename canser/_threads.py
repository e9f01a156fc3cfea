"""Threads: started with an error that names their purpose, and those that help with jobs."""

import os
import sys
import threading
from collections import deque
from collections.abc import Callable
from typing import Final, Generic, TypeVar

from canser.errors import CanserError

__all__ = ["Helpers", "count_cores", "start_thread", "useful_threads"]

_Result = TypeVar("_Result")


# Threads that are of use where one thread joins what all of them have done.
_MOST: Final = 4


def count_cores() -> int:
    """Return the number of cores that this process may use."""
    if sys.version_info >= (3, 13):
        return os.process_cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def useful_threads(threads: int | None) -> int:
    """Return how many threads to use where one joins what others do: `threads`, but up to 4.

    None for one for each core.
    """
    return min(count_cores() if threads is None else threads, _MOST)


def start_thread(
    thread: threading.Thread, name: str, kind: type[CanserError] = CanserError
) -> None:
    """Start a thread for what `name` names; an error of `kind` where the system starts no more."""
    try:
        thread.start()
    except RuntimeError as error:
        raise kind(f"{name}: {error}; end some processes, or allow more with 'ulimit -u'") from None


class _Job(Generic[_Result]):
    """Work, and what has come of it."""

    def __init__(self, work: Callable[[], _Result]) -> None:
        self.work = work
        self.results: list[_Result] = []
        self.error: BaseException | None = None
        self.is_done = False

    def run(self) -> None:
        try:
            self.results.append(self.work())
        except BaseException as error:  # noqa: BLE001 - raised again where the result is taken
            self.error = error

    def check(self) -> None:
        """Raise the error of the work, if there is one."""
        if self.error is not None:
            try:
                raise self.error
            finally:
                # The exception's frames refer to this object: they would be a cycle.
                self.error = None


class Helpers(Generic[_Result]):
    """Threads that do jobs, whose results come in the order of the jobs.

    `threads` counts the calling thread: it does jobs while it waits for a result. The other ones
    are started for the first job. If the system starts no more threads, those that run do the work,
    or the caller alone. A context manager, which ends the threads.
    """

    def __init__(self, threads: int, name: str) -> None:
        self._wanted, self._name = threads - 1, name
        self._threads: list[threading.Thread] = []
        self._changed = threading.Condition()
        self._jobs: deque[_Job[_Result]] = deque()  # whose results were not taken
        self._waiting: deque[_Job[_Result]] = deque()  # those of them that were not begun
        self._is_closed = False

    def __enter__(self) -> "Helpers[_Result]":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        """Return the number of jobs whose results were not taken."""
        return len(self._jobs)

    def put(self, work: Callable[[], _Result]) -> None:
        """Add a job."""
        job = _Job(work)
        with self._changed:
            self._jobs.append(job)
            self._waiting.append(job)
            self._changed.notify()
        while len(self._threads) < self._wanted:
            thread = threading.Thread(target=self._run, name=f"canser {self._name}", daemon=True)
            try:
                thread.start()
            except RuntimeError:  # the system has no more
                self._wanted = len(self._threads)
                break
            self._threads.append(thread)

    def take(self) -> _Result:
        """Wait for the first job, and return its result or raise its error."""
        first = self._jobs[0]
        while not first.is_done:
            with self._changed:
                job = self._waiting.popleft() if self._waiting else None
                if job is None and not first.is_done:
                    self._changed.wait()
            if job is not None:
                self._do(job)
                if not isinstance(job.error, (Exception, type(None))):
                    job.check()  # the caller is to end now, such as by Ctrl-C
        with self._changed:
            self._jobs.popleft()
        first.check()
        return first.results[0]

    def check(self) -> None:
        """Raise the error of the first job, if it has ended by one already."""
        if self._jobs and self._jobs[0].error is not None:
            raise self._jobs[0].error

    def drop(self) -> None:
        """Forget all jobs. Those that were begun go on to their ends."""
        with self._changed:
            self._jobs.clear()
            self._waiting.clear()

    def close(self) -> None:
        """Forget all jobs, and wait for the ends of those that were begun."""
        # At the interpreter's end the threads are stopped already, at any point.
        if sys.is_finalizing():
            return
        with self._changed:
            self._jobs.clear()
            self._waiting.clear()
            self._is_closed = True
            self._changed.notify_all()
        for thread in self._threads:
            # The garbage collector may close an iterator in one of these threads.
            if thread is not threading.current_thread():
                thread.join()

    def _do(self, job: _Job[_Result]) -> None:
        job.run()
        with self._changed:
            job.is_done = True
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._waiting and not self._is_closed:
                    self._changed.wait()
                if self._is_closed:
                    return
                job = self._waiting.popleft()
            self._do(job)
