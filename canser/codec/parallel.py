"""Threads that decode ahead of a stream, each from a guess, and are joined to it.

The calling thread decodes, straight to where the frames are wanted. Meanwhile each helper takes a
stretch of the bytes ahead, guesses where its first packet starts, and decodes into its own room.
The calling thread comes to the stretch later. If the stream then stands where the helper started,
the guess was right, and the stretch is joined: that takes the same time for few frames and many.
If not, the stretch is thrown away, and the calling thread decodes these bytes like any others.
"""

import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Self

from canser._core.buffers import Pointer
from canser._core.stream import BEHIND, ParallelChunk, Stream
from canser._threads import count_cores

__all__ = ["STRETCH", "Ahead", "limit_threads"]

# The bytes of a stretch, 1 MiB. Their decoding takes long compared with the Python around it, and
# they fit into a cache.
STRETCH = 1 << 20

# The smallest stretch, 64 KiB. Stretches shrink towards the end, so that all threads end together.
_STRETCH_LEAST = 1 << 16

# A helper starts this many stretches ahead of the calling thread, so that it is done before the
# calling thread arrives.
_LEAD = 2

# The most threads that are used. A helper decodes a stretch in 100 to 250 us, and the calling
# thread joins it in 20 to 40 us, in Python. More helpers would only wait.
_THREADS_MOST = 16

# The most stretches that the helpers rest for. After each wrong guess they rest for 1, 4, 16 and
# then 64 stretches. So input on which no guess is right takes hardly longer than with one thread.
_REST_MOST = 64


def limit_threads(threads: int) -> int:
    """Return how many of `threads` are of use: at most one for each core, and at most 16."""
    return 1 if threads == 1 else min(threads, count_cores(), _THREADS_MOST)


class _Claim:
    """A stretch that a helper has taken, and the decision about it."""

    def __init__(self, first: int, stop: int, chunk: ParallelChunk) -> None:
        self.first, self.stop, self.chunk = first, stop, chunk
        self.decoded = False
        self.decided = False
        self.deliver: Callable[[], None] | None = None

    def decode(self, data: Pointer, data_len: int, start: int) -> None:
        """Decode the stretch; `start` is the stream offset of the data."""
        self.chunk.decode(data, data_len, self.first - start, self.stop - start, start)


class Ahead:
    """Helpers that decode `data` ahead of a stream, which stands at its begin and holds no bytes.

    Iteration gives stream offsets and chunks. For an offset, the caller must decode up to it, from
    where the stream stands. A chunk has just been joined to the stream, and the caller must say by
    `deliver` how its frames are copied. Iteration ends before the last bytes, where a packet may
    not be whole.

    This is a context manager. When it is left, all frames are delivered. If the system starts no
    more threads, those that run do the work, or the caller alone.
    """

    def __init__(
        self,
        stream: Stream,
        data: Pointer,
        data_len: int,
        make_chunk: Callable[[], ParallelChunk],
        threads: int,
    ) -> None:
        self._stream, self._make_chunk = stream, make_chunk
        self._data, self._data_len, self._start = data, data_len, stream.position
        self._end = self._start + data_len - BEHIND
        self._threads = threads
        self._changed = threading.Condition()
        self._claims: deque[_Claim] = deque()
        self._joined: _Claim | None = None
        # The calling thread decodes the bytes between these two offsets. No helper takes them.
        self._from = self._stop = stream.position
        self._rest = 0  # stretches that the helpers rest for after the last wrong guess
        self._resting_to = 0
        self._closed = False
        self._failure: BaseException | None = None
        self._helpers = [
            threading.Thread(target=self._help, name="canser", daemon=True)
            for _ in range(min(threads - 1, data_len // _STRETCH_LEAST))
        ]

    def __enter__(self) -> Self:
        started = 0
        try:
            for helper in self._helpers:
                helper.start()
                started += 1
        except RuntimeError:  # "can't start new thread": the system has no more
            del self._helpers[started:]
            self._threads = started + 1
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._close()
        if self._failure is not None:
            try:
                raise self._failure
            finally:
                # The exception's frames refer to this object, and to all the room. Without this
                # they would be a cycle, left to the garbage collector.
                self._failure = None

    def _close(self) -> None:
        # At the interpreter's end the helpers are stopped already, at any point.
        if sys.is_finalizing():
            return
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for helper in self._helpers:
            # The garbage collector may run in a helper, and close an iterator that was dropped.
            if helper.is_alive() and helper is not threading.current_thread():
                helper.join()

    def __iter__(self) -> Iterator[int | ParallelChunk]:
        while (position := self._stream.position) < self._end and self._failure is None:
            with self._changed:
                claim = self._claims[0] if self._claims else None
                if claim is None or position < claim.first:
                    stop = min(position + STRETCH, claim.first if claim else self._end)
                    self._from, self._stop = position, stop
                    self._changed.notify_all()
                else:
                    while not claim.decoded:
                        self._changed.wait()
                    self._claims.popleft()
                    self._from = self._stop = claim.stop
            if claim is None or position < claim.first:
                yield stop
            elif self._stream.join(claim.chunk):
                self._rest //= 4
                self._joined = claim
                yield claim.chunk
            else:
                self._rest = min(4 * self._rest or 1, _REST_MOST)
                self._resting_to = position + self._rest * STRETCH
                self._decide(claim, None)

    def deliver(self, copy: Callable[[], None]) -> None:
        """Let the helper copy the chunk that was joined last; the copy may take a while."""
        assert self._joined is not None
        self._decide(self._joined, copy)

    def _decide(self, claim: _Claim, deliver: Callable[[], None] | None) -> None:
        with self._changed:
            claim.deliver, claim.decided = deliver, True
            self._changed.notify_all()

    def _claim(self, chunk: ParallelChunk, *, wait: bool) -> _Claim | None:
        """Take a stretch far enough ahead to be decoded before the caller arrives there."""
        with self._changed:
            while not self._closed:
                left = self._end - self._from
                length = min(STRETCH, max(left // (self._threads + 2), _STRETCH_LEAST))
                # The calling thread skips the stretches of other helpers.
                taken = sum(claim.stop - claim.first for claim in self._claims)
                first = max(self._from + taken + _LEAD * length, self._stop)
                if self._claims:
                    first = max(first, self._claims[-1].stop)
                if first + length > self._end:
                    return None
                if first >= self._resting_to:
                    claim = _Claim(first, first + length, chunk)
                    self._claims.append(claim)
                    return claim
                if not wait:
                    return None
                self._changed.wait()
        return None

    def _help(self) -> None:
        mine: deque[_Claim] = deque()
        try:
            spare = [self._make_chunk(), self._make_chunk()]
            while True:
                claim = self._claim(spare[-1], wait=not mine) if spare else None
                if claim is not None:
                    spare.pop()
                    mine.append(claim)
                    claim.decode(self._data, self._data_len, self._start)
                    with self._changed:
                        claim.decoded = True
                        self._changed.notify_all()
                elif not mine:
                    return
                # Without room, or without another stretch, there is time to wait.
                while mine and self._is_decided(mine[0], wait=claim is None or not spare):
                    done = mine.popleft()
                    if done.deliver is not None:
                        done.deliver()
                    spare.append(done.chunk)
        except BaseException as failure:  # noqa: BLE001 - raised again by the caller's thread
            with self._changed:
                self._failure = failure
                for claim in self._claims:
                    claim.decoded = True
                self._changed.notify_all()
            # The calling thread may wait for the copies of chunks that were joined before.
            for claim in mine:
                if self._is_decided(claim, wait=True) and claim.deliver is not None:
                    claim.deliver()

    def _is_decided(self, claim: _Claim, *, wait: bool) -> bool:
        with self._changed:
            while wait and not (claim.decided or self._closed):
                self._changed.wait()
            return claim.decided or self._closed
