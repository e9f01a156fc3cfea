"""One stream in C, and the stretches of it that other threads decode ahead."""

import threading
import time
from collections.abc import Callable
from typing import Any, Final, NamedTuple, ParamSpec, TypeVar

import numpy as np
import numpy.typing as npt

from canser._core._lib import ffi, lib
from canser._core.buffers import Pointer, raise_status
from canser._core.table import PROTOCOLS, REJECT_NAMES, Protocol, row_of
from canser._frames import FRAME_DTYPE, FrameArray, copy_records

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

# A packet is only taken when this many bytes behind its first one are known.
BEHIND: Final = int(lib.CANSER_BEHIND)

# The most bytes for one small call into a new array: more than a read of a port mostly returns.
SMALL_MOST: Final = 4096
_SMALL_FRAMES: Final = (SMALL_MOST + BEHIND) // min(row.frame_min for row in PROTOCOLS.values()) + 1

# A small call returns the number of frames up to this limit, all bytes taken. For larger numbers
# see `Stream.feed_small`.
FRAMES_MOST: Final = 2**32 - 1

_FRAME_SIZE: Final = FRAME_DTYPE.itemsize

# The room for control packets, in packets. C stops where it is full, and is called again.
_CONTROL_CAP: Final = 1024
_CONTROL_DTYPE: Final = np.dtype([("offset", "u8"), ("len", "u1"), ("bytes", "u1", (23,))])
assert _CONTROL_DTYPE.itemsize == ffi.sizeof("canser_control")


class Control(NamedTuple):
    """A packet that is valid but is no CAN frame; returned by `Decoder.take_controls`."""

    #: The offset of its first byte in the stream.
    offset: int
    #: The packet as it came.
    data: bytes


# A batch as an array of words. Its counts are its last two words: frames, then control packets.
_BATCH_WORDS: Final = ffi.sizeof("canser_batch") // ffi.sizeof("size_t")
_FOUND_WORD: Final = ffi.offsetof("canser_batch", "frame_count") // ffi.sizeof("size_t")
assert ffi.offsetof("canser_batch", "control_count") == (_FOUND_WORD + 1) * ffi.sizeof("size_t")
assert _BATCH_WORDS == _FOUND_WORD + 2


class Stream:
    """The state of one stream in C, with room for its control packets.

    Without `keeps_controls` there is no such room: control packets are counted only. `feed_small`
    may be called by several threads. All other calls that change the state go through `alone`,
    unless the owner has only one thread.

    `feed_small(shared, data, data_len, target)` is canser_stream_feed. It decodes up to 1 MiB, and
    returns the number of frames. A number over FRAMES_MOST means that the target is full: its upper
    32 bits are the number of bytes left, the lower 32 the frames. -1 means that nothing was done:
    `feed` does it, or raises.
    """

    def __init__(self, protocol: Protocol, tick_ns: int, *, keeps_controls: bool = True) -> None:
        self.protocol = protocol
        self._tick_ns = tick_ns
        self.shared = ffi.new("canser_stream *", {"keeps_controls": keeps_controls})
        self._keeps_controls = keeps_controls
        self._state = ffi.addressof(self.shared, "decoder")
        self.counters_now = self._state.stats  # canser_stats
        self.feed_small: Callable[..., int] = lib.canser_stream_feed
        # For all calls but `feed_small`. The lock is reentrant, so that a signal handler gets an
        # error. Otherwise it would wait for the thread that it has interrupted, for ever.
        self._lock = threading.RLock()
        self._working = False
        # The batch and the bytes used are one array, and are read at once: each read of its own
        # would take as long as decoding some frames.
        self._memory = ffi.new("size_t[]", _BATCH_WORDS + 1)
        self._batch = ffi.cast("canser_batch *", self._memory)
        self._used = self._memory + _BATCH_WORDS
        self._found = self._memory + _FOUND_WORD
        self.reset()

    def alone(
        self,
        work: Callable[_Arguments, _Result],
        *args: _Arguments.args,
        **kwargs: _Arguments.kwargs,
    ) -> _Result:
        """Call `work` while no other thread changes the state; return what it returns.

        RuntimeError if this thread is in such a call already: this one is in a signal handler.
        """
        with self._lock:
            if self._working:
                raise RuntimeError(
                    "this decoder is at work in the same thread, which a signal handler has "
                    "interrupted; use a Decoder of its own in the handler"
                )
            try:
                self._working = True
                # Another thread may be in a small call, which takes at most 1 MiB.
                while not lib.canser_stream_take(self.shared):
                    time.sleep(0)
                return work(*args, **kwargs)
            finally:
                self._working = False
                lib.canser_stream_release(self.shared)

    def feed_to_new(self, data: bytes) -> FrameArray | None:
        """Decode up to SMALL_MOST bytes into a new array; None if nothing was done, as above."""
        room = _take_room()
        found = self.feed_small(self.shared, data, len(data), room[1])
        return None if found < 0 else _copy(room, found)

    def aim_at(self, out: Pointer, cap: int, at: Pointer, ends: Pointer = ffi.NULL) -> None:
        """Set where frames, offsets and ends go; the pointers must stay good."""
        batch = self._batch
        batch.frames, batch.frame_cap, batch.offsets, batch.ends = out, cap, at, ends
        if self._keeps_controls and not batch.controls:
            self._controls = np.empty(_CONTROL_CAP, _CONTROL_DTYPE)
            batch.controls = ffi.from_buffer("canser_control[]", self._controls)
            batch.control_cap = _CONTROL_CAP

    def aim_at_target(self, target: Pointer, count: int) -> None:
        """Set a target for the next frames, behind its first `count`."""
        at = target.offsets and target.offsets + count
        ends = target.ends and target.ends + count
        self.aim_at(target.frames + count, target.frame_cap - count, at, ends)

    def reset(self) -> None:
        """Start anew: counters zero, nothing held, the clock not started."""
        lib.canser_decoder_init(self._state, row_of(self.protocol), self._tick_ns)

    def feed(self, data: Pointer, data_len: int) -> list[int]:
        """Decode bytes; return the frames and control packets found, and the bytes used.

        Stops early where the room for frames or for control packets is full.
        """
        status = lib.canser_decoder_feed(self._state, data, data_len, self._batch, self._used)
        if status:
            raise_status(status)
        found: list[int] = ffi.unpack(self._found, 3)
        return found

    def advance(self, data: Pointer, data_len: int, stop: int) -> int:
        """Decode what starts before `stop`, and hold no bytes; return the number of frames."""
        status = lib.canser_decoder_advance(
            self._state, data, data_len, stop, self._batch, self._used
        )
        if status:
            raise_status(status)
        return int(self._batch.frame_count)

    def join(self, chunk: "ParallelChunk") -> bool:
        """Go on behind a chunk if it starts where the stream stands; else return False."""
        status = lib.canser_decoder_join(self._state, chunk.state, chunk.frames_at)
        if status == lib.CANSER_MISMATCH:
            return False
        if status:
            raise_status(status)
        return True

    def flush(self) -> int:
        """End the stream; return the number of frames. Call again while bytes are pending."""
        status = lib.canser_decoder_flush(self._state, self._batch)
        if status:
            raise_status(status)
        return int(self._batch.frame_count)

    def controls(self) -> npt.NDArray[np.void] | None:
        """Return the last call's control packets, copied; None for none, and after a small call."""
        found = self._batch.control_count
        return copy_records(self._controls[:found]) if found else None

    @property
    def position(self) -> int:
        """The stream offset behind all bytes taken."""
        return int(self.counters_now.bytes_in)

    @property
    def skipped(self) -> int:
        """Bytes inside no packet."""
        return int(self.counters_now.bytes_skipped)

    @property
    def pending(self) -> int:
        """Bytes held."""
        return int(self._state.carry_len)

    def counters(self) -> dict[str, Any]:
        """Return every field of `Stats` by name."""
        stats = self.counters_now
        values = {name: getattr(stats, name) for name, _ in ffi.typeof("canser_stats").fields}
        values["rejects"] = dict(zip(REJECT_NAMES, stats.rejects, strict=True))
        values["pending"] = self.pending
        return values


class ParallelChunk:
    """A stretch of a stream, decoded from a guess into its own room.

    `frames` has room for `cap` frames, and `offsets` for their offsets where they are asked for.
    It is used by one thread at a time.
    """

    def __init__(self, protocol: Protocol, tick_ns: int, cap: int, *, offsets: bool) -> None:
        self._protocol, self._tick_ns, self._most = protocol, tick_ns, cap
        self.offsets = np.empty(cap, np.int64) if offsets else None
        self._controls = np.empty(_CONTROL_CAP, _CONTROL_DTYPE)
        self.state = ffi.new("canser_chunk *")
        self._batch = ffi.new("canser_batch *")
        self._take_room(np.empty(cap, FRAME_DTYPE))
        if self.offsets is not None:
            # A pointer in a struct keeps nothing alive: this object keeps the array.
            self._batch.offsets = ffi.from_buffer("int64_t[]", self.offsets)
        self._batch.controls = ffi.from_buffer("canser_control[]", self._controls)
        self._batch.control_cap = _CONTROL_CAP

    def _take_room(self, room: FrameArray) -> None:
        self.frames = room
        self.frames_at = ffi.from_buffer("canser_frame[]", self.frames)
        self._batch.frames, self._batch.frame_cap = self.frames_at, len(room)

    def decode(self, data: Pointer, data_len: int, first: int, stop: int, offset: int) -> None:
        """Decode what starts in data[first..stop); `offset` is the stream offset of data[0]."""
        row, tick_ns = row_of(self._protocol), self._tick_ns
        status = lib.canser_chunk_decode(
            self.state, row, tick_ns, data, data_len, first, stop, offset, self._batch
        )
        if status:
            raise_status(status)

    @property
    def count(self) -> int:
        """The frames in it."""
        return int(self.state.frame_count)

    def controls(self) -> npt.NDArray[np.void] | None:
        """Return a copy of its control packets, None for none."""
        found = self._batch.control_count
        return copy_records(self._controls[:found]) if found else None

    def deliver(self, out: Pointer, count: int, first: int = 0) -> None:
        """Copy `count` frames of the joined chunk to `out`, with their times."""
        lib.canser_chunk_deliver(self.state, self.frames_at, first, count, out)

    def make_room(self) -> FrameArray:
        """Return an array for the next stretch, a quarter longer than this one's frames need.

        If it is too short, the next stretch ends early.
        """
        return np.empty(min(self.count * 5 // 4 + 1024, self._most), FRAME_DTYPE)

    def hand_over(self, room: FrameArray) -> FrameArray:
        """Return the frames of the joined chunk, with their times, and take new room."""
        frames = self.frames[: self.count]
        self.deliver(self.frames_at, self.count)
        self._take_room(room)
        return frames


def unpack_controls(rows: npt.NDArray[np.void]) -> list[Control]:
    """Return control packets as Python values."""
    return [Control(int(row["offset"]), row["bytes"][: row["len"]].tobytes()) for row in rows]


# Free rooms for frames, each with a target: as many as threads have needed at once. A copy out of
# such a room takes a third of the time of a new array for the most frames, cut afterwards.
_free_rooms: Final[list[tuple[Pointer, Pointer]]] = []


def _take_room() -> tuple[Pointer, Pointer]:
    try:
        return _free_rooms.pop()
    except IndexError:
        frames = ffi.new("canser_frame[]", _SMALL_FRAMES)
        return frames, ffi.new("canser_target *", (frames, _SMALL_FRAMES))


def _copy(room: tuple[Pointer, Pointer], count: int) -> FrameArray:
    """Return the first frames of a room in a new array, and free the room."""
    frames = np.empty(count, FRAME_DTYPE)
    ffi.memmove(frames, room[0], count * _FRAME_SIZE)
    _free_rooms.append(room)
    return frames


def decode_small(protocol: Protocol, tick_ns: int, data: bytes) -> tuple[FrameArray, int]:
    """Decode up to SMALL_MOST bytes to their end; return the frames, and the skipped bytes."""
    room = _take_room()
    row = row_of(protocol)
    found = lib.canser_decode_small(row, tick_ns, data, len(data), room[0], _SMALL_FRAMES)
    assert found >= 0
    return _copy(room, found & FRAMES_MOST), found >> 32
