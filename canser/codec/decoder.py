"""Decoding and encoding without I/O: `Decoder` for a stream, `decode` and `encode` for a whole."""

import operator
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeVar, overload
from weakref import ref

import numpy as np
import numpy.typing as npt

from canser._core.buffers import (
    NULL,
    BytesLike,
    FrameRoom,
    Offsets,
    Pointer,
    check_output,
    input_bytes,
    input_frames,
    is_same,
    output_frames,
    output_offsets,
)
from canser._core.packets import encode_into
from canser._core.stream import (
    FRAMES_MOST,
    SMALL_MOST,
    Control,
    ParallelChunk,
    Stream,
    decode_small,
    unpack_controls,
)
from canser._core.table import find_protocol
from canser._frames import FRAME_DTYPE, FrameArray
from canser._guards import ReadOnlyDict, Uncopied
from canser._protocols import tick_ns
from canser.codec.doubt import is_doubtful
from canser.codec.parallel import STRETCH, Ahead, limit_threads
from canser.codec.sinks import FixedArray, GrowingArray, Sink
from canser.errors import CanserWarning

__all__ = ["Control", "Decoder", "Encoder", "Stats", "decode", "encode"]

_Array = TypeVar("_Array")
_Ref = Callable[[], _Array | None]

# A decoder keeps the newest control packets that were not taken, at most this many. They take
# 2 MiB, and are over an hour of pings at ten a second.
_CONTROLS_KEPT = 1 << 16


@dataclass(frozen=True, slots=True)
class Stats:
    """The counters of a stream, a snapshot; returned by `Decoder.stats` and others.

    Two laws always hold: `bytes_in == bytes_framed + bytes_control + bytes_skipped + pending`, and
    the rejects add up to `bytes_skipped`. The counters depend on the bytes alone, not on how the
    stream was cut.
    """

    #: Bytes taken.
    bytes_in: int
    #: Bytes inside frames.
    bytes_framed: int
    #: Bytes inside control packets.
    bytes_control: int
    #: Bytes inside no packet.
    bytes_skipped: int
    #: Frames found.
    frames: int
    #: Control packets found: valid packets that are no CAN frames.
    controls: int
    #: Unbroken runs of skipped bytes.
    resyncs: int
    #: Skipped bytes by the reason why no packet starts there.
    rejects: Mapping[str, int]
    #: Bytes held: the start of a packet that is not whole yet.
    pending: int
    #: Steps of the device clock forward through zero: the counter of 32 bits has wrapped.
    ts_wraps: int
    #: Steps of the device clock back: a restart, or false frames.
    ts_backsteps: int
    #: The steps back of more than 2**24 ticks from a clock that has made 16 small steps forward.
    #: Each is a restart, a silence of more than half a turn of the counter, or a false time. The
    #: bytes do not tell which, and all later times may be whole turns off.
    ts_uncertain: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "rejects", ReadOnlyDict(self.rejects))


def add_stats(one: Stats, other: Stats) -> Stats:
    """Return the counters of two streams together."""
    rejects = {name: count + other.rejects[name] for name, count in one.rejects.items()}
    counters = {
        field.name: getattr(one, field.name) + getattr(other, field.name)
        for field in fields(Stats)
        if field.name != "rejects"
    }
    return Stats(rejects=rejects, **counters)


class Decoder(Uncopied):
    """Decode one stream, piece by piece, without I/O.

    The frames do not depend on how the stream is cut. Two threads may share a decoder: one waits
    for the other. A signal handler must use a decoder of its own: where it interrupts a call of
    this one in its own thread, its call raises RuntimeError and changes nothing. C works without
    the GIL, so decoders in several threads run in parallel. A decoder cannot be copied or pickled.

    Parameters
    ----------
    protocol : str
        A name of `protocols()` or an accepted spelling.
    ts_unit : {"ms", "us", "ns", "s"}, default "ms"
        The unit of the device's timestamps. The wire does not tell it. A protocol without a clock
        does not use it.

    Raises
    ------
    TypeError
        `protocol` is no string.
    ValueError
        `protocol` or `ts_unit` is unknown.

    Notes
    -----
    A device's clock is a counter of 32 bits, which the decoder unwraps by the bytes alone: each
    step is the shorter way round. A false time out of noise spoils its own frame only. But all
    times after it may be whole turns off (a turn: 49.7 days of "ms", 71.6 minutes of "us")

    - after 4 false times in a row, or 2 before the clock has made 16 small steps forward;
    - after a silence of more than half a turn, which reads as a step back.

    `Stats.ts_uncertain` counts where that may be. Frames of a port and of a recording have the
    host's time: there neither happens.

    Examples
    --------
    >>> decoder = canser.Decoder("seeed")
    >>> len(decoder.feed(bytes.fromhex("aac12301ff55 aac2")))
    1
    >>> decoder.feed(bytes.fromhex("24010102 55"))["id"]
    array([292], dtype=uint32)
    >>> decoder.stats.bytes_skipped
    0
    """

    _keeps_controls = True  # for `take_controls`

    def __init__(self, protocol: str, *, ts_unit: str = "ms") -> None:
        self._protocol = find_protocol(protocol)
        self._ts_unit = ts_unit
        self._stream = Stream(self._protocol, tick_ns(ts_unit), keeps_controls=self._keeps_controls)
        # At hand, as each look costs as much as some frames.
        self._feed_small, self._shared = self._stream.feed_small, self._stream.shared
        self._alone = self._stream.alone
        # The last arrays of the caller's, checked and not held: `out`, its length, both as a
        # target, and `offsets`. The same ones come again mostly: then only what can have changed
        # is asked for. In one piece, so that it is of one call.
        self._output: tuple[_Ref[FrameArray], int, Pointer, _Ref[Offsets] | None]
        self._output = (lambda: None, 0, NULL, None)
        self._controls: deque[npt.NDArray[np.void]] = deque()
        self._controls_held = 0
        self._controls_dropped = 0

    def __repr__(self) -> str:
        return f"Decoder({self.protocol!r}, ts_unit={self._ts_unit!r})"

    @property
    def protocol(self) -> str:
        """The protocol's name."""
        return self._protocol.name

    @property
    def ts_unit(self) -> str:
        """The unit of the device's timestamps."""
        return self._ts_unit

    def feed(self, data: BytesLike) -> FrameArray:
        """Decode the next bytes; return the frames they complete.

        Parameters
        ----------
        data : bytes-like
            Any contiguous buffer of bytes, read in place. All of it is taken; a packet that is not
            whole is held (`pending`).

        Returns
        -------
        FrameArray
            New array of FRAME_DTYPE, shape (n,), that owns its memory.

        Raises
        ------
        TypeError, BufferError
            `data` is no contiguous buffer of bytes.
        RuntimeError
            The call interrupts another one of the same thread (in a signal handler).
        """
        source = data if type(data) is bytes else input_bytes(data)
        if len(source) <= SMALL_MOST:
            frames = self._stream.feed_to_new(source)
            if frames is not None:
                return frames
        return self._alone(self._collect, input_bytes(data), ends=False)

    def feed_into(
        self, data: BytesLike, out: FrameArray, offsets: Offsets | None = None
    ) -> tuple[int, int]:
        """Decode the next bytes into `out`; allocate nothing.

        Parameters
        ----------
        data : bytes-like
            Any contiguous buffer of bytes, read in place.
        out : FrameArray
            Array of FRAME_DTYPE, shape (n,), n >= 1, contiguous. Rows behind the frames stay as
            they were.
        offsets : numpy array of int64 or uint64, optional
            At least as long as `out`. It is filled with the position of each frame's first byte in
            the stream.

        Returns
        -------
        used : int
            The bytes that were taken. Fewer than `data` has if `out` is full: call again with
            `data[used:]`.
        count : int
            The frames, now in `out[:count]`.

        Raises
        ------
        TypeError
            An argument has a wrong type or dtype.
        ValueError
            An array has a wrong shape, no room, a wrong alignment, or shares memory with another
            one.
        BufferError
            `data` is not contiguous, or an array is read-only.
        RuntimeError
            The call interrupts another one of the same thread (in a signal handler).

        Notes
        -----
        After an error nothing was taken.
        """
        source = data if type(data) is bytes else input_bytes(data)
        size = len(source)
        last, cap, target, last_offsets = self._output
        if (
            out is not last()
            or out is None  # which an array that is gone is, too
            or len(out) != cap
            or not out.flags.writeable
            or (
                (offsets is not None or last_offsets is not None)
                and not is_same(offsets, last_offsets, cap)
            )
        ):
            target = check_output(out, offsets)
            self._output = ref(out), len(out), target, None if offsets is None else ref(offsets)
        found = self._feed_small(self._shared, source, size, target)
        left = found >> 32
        if not left:
            return size, found
        if left > 0:
            return size - left, found & FRAMES_MOST
        return self._alone(self._feed_to, input_bytes(data), size, target)

    def flush(self) -> FrameArray:
        """End the stream: scan what is held; return the last frames.

        A candidate that lacks bytes counts as skipped (reject "cut"). Feeding may go on
        afterwards, as after a gap: counters, offsets and clock go on.

        Returns
        -------
        FrameArray
            New array of FRAME_DTYPE, shape (n,).
        """
        return self._alone(self._collect, input_bytes(b""), ends=True)

    def flush_into(self, out: FrameArray, offsets: Offsets | None = None) -> int:
        """End the stream as `flush` does, into `out`; return the number of frames.

        Call again while `pending` is not 0: `out` was full.

        Parameters
        ----------
        out : FrameArray
            As in `feed_into`.
        offsets : numpy array of int64 or uint64, optional
            As in `feed_into`.

        Returns
        -------
        int
            The frames, now in `out[:count]`.

        Raises
        ------
        TypeError, ValueError, BufferError
            As in `feed_into`.
        """
        return self._alone(self._flush_to, check_output(out, offsets))

    def feed_room(
        self, source: Pointer, source_len: int, room: FrameRoom, count: int, most: int
    ) -> int:
        """Decode the next bytes into room behind `count` frames, until it has `most`.

        For this package's own use. Returns the bytes used; `counters.frames` tells how many frames
        came, whatever exception ends this.
        """
        target = room.between(count, most)
        found = self._feed_small(self._shared, source, source_len, target)
        if found >= 0:
            return source_len - (found >> 32)
        used, _ = self._alone(self._feed_to, source, source_len, target)
        return used

    def flush_room(self, room: FrameRoom, count: int, most: int) -> None:
        """End the stream into room as `feed_room` takes it; for this package's own use."""
        while self._stream.pending and count < most:
            count += self._alone(self._flush_to, room.between(count, most))

    def reset(self) -> None:
        """Forget everything: counters zero, nothing held, no control packets."""
        self._alone(self._reset)

    @property
    def stats(self) -> Stats:
        """The counters as they are now."""
        return Stats(**self._alone(self._stream.counters))

    @property
    def position(self) -> int:
        """The stream offset behind all bytes taken."""
        return self._stream.position

    @property
    def counters(self) -> Any:
        """The counters in C's memory, for this package's own use: they change as it decodes."""
        return self._stream.counters_now

    @property
    def skipped(self) -> int:
        """Bytes inside no packet so far: `stats.bytes_skipped`, without the rest."""
        return self._stream.skipped

    @property
    def pending(self) -> int:
        """Bytes held: the start of a packet that is not whole yet."""
        return self._stream.pending

    @property
    def has_controls(self) -> bool:
        """Whether there are control packets to take."""
        return bool(self._controls)

    def take_controls(self) -> list[Control]:
        """Return the control packets since the last call, the oldest first.

        `Stats.controls` counts them all. Of those that are not taken, the newest 65,536 are kept,
        and `controls_dropped` counts the others.

        Returns
        -------
        list of Control
            Each with its offset in the stream, and its bytes.
        """
        batches = self._alone(self._hand_over_controls)
        return [control for rows in batches for control in unpack_controls(rows)]

    @property
    def controls_dropped(self) -> int:
        """Control packets that were not taken in time, and are counted only."""
        return self._controls_dropped

    # What follows, but for what says otherwise, is done alone.

    def _reset(self) -> None:
        self._stream.reset()
        self._controls.clear()
        self._controls_held = self._controls_dropped = 0

    def _hand_over_controls(self) -> list[npt.NDArray[np.void]]:
        batches = list(self._controls)
        self._controls.clear()
        self._controls_held = 0
        return batches

    def _feed_to(self, source: Pointer, source_len: int, target: Pointer) -> tuple[int, int]:
        """Decode into a target; return the bytes used and the frames."""
        used = count = 0
        while True:
            self._stream.aim_at_target(target, count)
            more_count, controls, more = self._stream.feed(source + used, source_len - used)
            used += more
            count += more_count
            # Bytes are left because the target is full, or the room for control packets.
            if not controls:
                return used, count
            self._keep_controls()
            if used == source_len or count == target.frame_cap:
                return used, count

    def _flush_to(self, target: Pointer) -> int:
        """End the stream into a target; return the frames."""
        self._stream.aim_at_target(target, 0)
        # The bytes held are fewer than the room for control packets.
        count = self._stream.flush()
        self._keep_controls()
        return count

    def _keep_controls(self, chunk: ParallelChunk | None = None) -> bool:
        """Keep the control packets of the last call, or of a chunk; True if there are any."""
        rows = (chunk or self._stream).controls()
        if rows is None:
            return False
        self._controls.append(rows)
        self._controls_held += len(rows)
        # Dropped one by one: so the packets kept do not depend on how the stream was cut.
        while (excess := self._controls_held - _CONTROLS_KEPT) > 0:
            oldest = self._controls.popleft()
            if excess < len(oldest):
                self._controls.appendleft(oldest[excess:])
            dropped = min(excess, len(oldest))
            self._controls_held -= dropped
            self._controls_dropped += dropped
        return True

    def make_chunk(self, offsets: bool) -> ParallelChunk:
        """Return room for any stretch that a helper decodes; for this package's own use."""
        most = STRETCH // self._protocol.frame_min + 1
        return ParallelChunk(self._protocol, tick_ns(self._ts_unit), most, offsets=offsets)

    def _collect(self, source: Pointer, *, ends: bool, threads: int = 1) -> FrameArray:
        """Decode all of `source` into a new array without spare rows; the lock is held."""
        sink = GrowingArray(self.make_chunk, self._stream, len(source))
        self._run(source, sink, ends=ends, threads=threads)
        return sink.result()

    def _fill(
        self, source: Pointer, out: FrameArray, offsets: Offsets | None, threads: int
    ) -> tuple[int, int]:
        """Decode all of `source` and its end into `out`; the arrays are checked.

        Returns the number of frames in `out`, and the number of frames that `source` holds.
        """
        sink = FixedArray(self.make_chunk, out, offsets)
        self._alone(self._run, source, sink, ends=True, threads=threads)
        return min(sink.count, len(out)), sink.count

    def _run(self, source: Pointer, sink: Sink, *, ends: bool, threads: int = 1) -> None:
        """Decode all of `source` into a sink; the lock is held."""
        used = 0
        if threads > 1:
            start = self._stream.position
            for _ in self._run_ahead(source, sink, threads, _call):
                pass
            used = self._stream.position - start
        while used < len(source):
            self._stream.aim_at(*sink.room())
            count, _, more = self._stream.feed(source + used, len(source) - used)
            self._keep_controls()
            used += more
            sink.wrote(count)
        while ends and self._stream.pending:
            self._stream.aim_at(*sink.room())
            count = self._stream.flush()
            self._keep_controls()
            sink.wrote(count)

    def run_ahead(self, source: Pointer, sink: Sink, threads: int) -> Iterator[None]:
        """Decode all of `source` but its last bytes by several threads, into a sink.

        For this package's own use, and for a stream that holds no bytes. Yields whenever the sink
        may be emptied. Between two steps other threads may use the decoder. RuntimeError if one of
        them has fed or reset it: the stream would no longer be that of `source`.
        """
        return self._run_ahead(source, sink, threads, self._alone)

    def _run_ahead(
        self, source: Pointer, sink: Sink, threads: int, call: Callable[..., bool]
    ) -> Iterator[None]:
        """Run ahead in steps; `call` does each of them while no other thread uses the stream."""
        stream, start, source_len = self._stream, self._stream.position, len(source)
        stretch = expected = start

        def step(stretches: Iterator[int | ParallelChunk]) -> bool:
            nonlocal stretch, expected
            if stream.position != expected or stream.pending:
                raise RuntimeError(
                    "the decoder was fed or reset while its blocks were being decoded; "
                    "use a Decoder of its own"
                )
            if expected >= stretch:
                item = next(stretches, None)
                if item is None:
                    return False
                if isinstance(item, ParallelChunk):
                    self._keep_controls(item)
                    ahead.deliver(sink.place(item))
                else:
                    stretch = item
            if expected < stretch:
                done = expected - start
                stream.aim_at(*sink.room())
                count = stream.advance(source + done, source_len - done, stretch - expected)
                self._keep_controls()
                sink.wrote(count)
            expected = stream.position
            return True

        with Ahead(stream, source, source_len, sink.chunk, threads) as ahead:
            stretches = iter(ahead)
            while call(step, stretches):
                yield


def _call(work: Callable[..., bool], *args: object) -> bool:
    """Call `work`: its caller holds the lock."""
    return work(*args)


class _OneShot(Decoder):
    """A decoder of one whole buffer: it counts control packets, and keeps none."""

    _keeps_controls = False


def decode(
    data: BytesLike,
    protocol: str,
    *,
    ts_unit: str = "ms",
    out: FrameArray | None = None,
    offsets: Offsets | None = None,
    threads: int = 1,
    as_is: bool = False,
) -> FrameArray:
    """Decode a whole buffer, to its end.

    Parameters
    ----------
    data : bytes-like
        Any contiguous buffer of bytes (bytes, bytearray, memoryview, mmap, numpy), read in place.
    protocol : str
        A name of `protocols()` or an accepted spelling.
    ts_unit : {"ms", "us", "ns", "s"}, default "ms"
        The unit of the device's timestamps, as for `Decoder`.
    out : FrameArray, optional
        Array of FRAME_DTYPE, shape (m,), that the frames go to.
    offsets : numpy array of int64 or uint64, optional
        It is filled with the position of each frame's first byte.
    threads : int, default 1
        How many threads may work on it: at most one for each core is used, and 16. The result is
        the same for any number.
    as_is : bool, default False
        Whether to leave out the warning about a protocol that is not that of the bytes.

    Returns
    -------
    FrameArray
        The frames, FRAME_DTYPE, shape (n,): a new array, or `out[:n]` if `out` is given.

    Raises
    ------
    ValueError
        `out` or `offsets` is too small; the message has the number that is needed. And as for
        `Decoder.feed_into`.
    TypeError, BufferError
        As for `Decoder.feed_into`.

    Warns
    -----
    CanserWarning
        Too many bytes lie in no packet for the protocol to be right: half of 1,000 or more; see
        `blocks`.

    Notes
    -----
    For the counters use a `Decoder`.

    Examples
    --------
    >>> canser.decode(bytes.fromhex("aac12301ff55"), "seeed")["data"][0, 0]
    np.uint8(255)
    """
    if type(threads) is not int or threads != 1:
        threads = check_threads(threads)
    # Threads are of no use for what is small.
    if type(data) is bytes and len(data) <= SMALL_MOST and out is None and offsets is None:
        row = find_protocol(protocol)
        frames, skipped = decode_small(row, tick_ns(ts_unit), data)
        if skipped and not as_is:
            _warn_of_doubt(row.name, len(data), skipped)
        return frames
    decoder = _OneShot(protocol, ts_unit=ts_unit)
    frames = decode_with(decoder, data, out=out, offsets=offsets, threads=threads)
    if not as_is:
        _warn_of_doubt(decoder.protocol, decoder.position, decoder.skipped)
    return frames


def _warn_of_doubt(protocol: str, bytes_in: int, skipped: int) -> None:
    if is_doubtful(protocol, bytes_in, skipped):
        warnings.warn(
            f"{skipped / bytes_in:.0%} of the {bytes_in:,} bytes are in no "
            f"{protocol} packet; canser.identify tells which protocol fits, and "
            "as_is=True accepts them",
            CanserWarning,
            stacklevel=3,
        )


def decode_with(
    decoder: Decoder,
    data: BytesLike,
    *,
    out: FrameArray | None = None,
    offsets: Offsets | None = None,
    threads: int = 1,
) -> FrameArray:
    """Decode a whole buffer by a new decoder, as `decode` does, without its warning."""
    source = input_bytes(data)
    if out is not None:
        output_frames(out)
        output_offsets(offsets, len(out))
        room, name = out, "out"
    elif offsets is not None:
        output_offsets(offsets, 0)
        room, name = np.empty(len(offsets), FRAME_DTYPE), "offsets"
    else:
        return decoder._collect(source, ends=True, threads=threads)
    count, needed = decoder._fill(source, room, offsets, threads)
    _check_room(name, len(room), needed)
    if out is not None:
        return out[:count]
    # What is too much is given back: no other object refers to the array.
    room.resize(count, refcheck=False)
    return room


def decode_pieces(
    decoder: Decoder, pieces: Iterable[BytesLike], total: int, offsets: Offsets | None
) -> FrameArray:
    """Decode bytes that come in pieces, `total` in all, to their end, by a new decoder.

    Each piece is read before the next one is asked for. The result and the errors are those of
    `decode_with` for all bytes at once.
    """
    sink: FixedArray | GrowingArray
    if offsets is None:
        sink = GrowingArray(decoder.make_chunk, decoder._stream, total)
    else:
        output_offsets(offsets, 0)
        room = np.empty(len(offsets), FRAME_DTYPE)
        sink = FixedArray(decoder.make_chunk, room, offsets)
    for piece in pieces:
        decoder._alone(decoder._run, input_bytes(piece), sink, ends=False)
    decoder._alone(decoder._run, input_bytes(b""), sink, ends=True)
    if isinstance(sink, GrowingArray):
        return sink.result()
    _check_room("offsets", len(room), sink.count)
    room.resize(sink.count, refcheck=False)
    return room


def _check_room(name: str, room: int, needed: int) -> None:
    if needed > room:
        raise ValueError(
            f"{name} has room for {room} frames, but the data holds {needed}; "
            f"make room for at least {needed}"
        )


@overload
def encode(frames: FrameArray, protocol: str, *, ts_unit: str = "ms") -> bytes: ...
@overload
def encode(
    frames: FrameArray, protocol: str, *, ts_unit: str = "ms", out: npt.NDArray[np.uint8]
) -> npt.NDArray[np.uint8]: ...
def encode(
    frames: FrameArray,
    protocol: str,
    *,
    ts_unit: str = "ms",
    out: npt.NDArray[np.uint8] | None = None,
) -> bytes | npt.NDArray[np.uint8]:
    """Encode frames as an adapter sends them, one packet after the other.

    Data past the dlc and the data of remote frames are not sent. A protocol with a clock sends `ts`
    in ticks of `ts_unit`, rounded down, modulo 2**32 as a device's counter wraps. The others send
    no time.

    Parameters
    ----------
    frames : FrameArray
        Array of FRAME_DTYPE, shape (n,), contiguous.
    protocol : str
        A name of `protocols()` or an accepted spelling.
    ts_unit : {"ms", "us", "ns", "s"}, default "ms"
        The unit of the device's clock.
    out : numpy array of uint8, optional
        The bytes go there. `protocol(name).frame_max` bytes a frame are always enough. Bytes past
        the result may be written over.

    Returns
    -------
    bytes or numpy array of uint8
        The bytes; or `out[:n]` if `out` is given.

    Raises
    ------
    ValueError
        The format cannot carry a frame: the message has its index, and the reason (an id over the
        limit of its kind, a dlc over 8, an extended or an error frame that the format does not
        have, a time that is not known). Or `out` is too small.
    TypeError, BufferError
        An argument has a wrong type, or an array is not contiguous or read-only.

    Examples
    --------
    >>> canser.encode(canser.frames("123#FF"), "seeed").hex(" ")
    'aa c1 23 01 ff 55'
    """
    row = find_protocol(protocol)
    unit = tick_ns(ts_unit)
    if out is not None:
        return out[: encode_into(row, unit, frames, out)]
    input_frames(frames)  # before its length is asked for
    room = np.empty(len(frames) * row.frame_max, np.uint8)
    return room[: encode_into(row, unit, frames, room)].tobytes()


class Encoder:
    """Encode one array of frames after the other, as `encode` does.

    A frame that the format cannot carry is named by its index over all arrays.
    """

    def __init__(self, protocol: str, *, ts_unit: str = "ms") -> None:
        self._protocol, self._tick_ns = find_protocol(protocol), tick_ns(ts_unit)
        self._room = np.empty(0, np.uint8)
        self._first = 0

    def encode(self, frames: FrameArray) -> npt.NDArray[np.uint8]:
        """Return the bytes of frames; the array is good until the next call."""
        needed = len(frames) * self._protocol.frame_max
        if len(self._room) < needed:
            self._room = np.empty(needed, np.uint8)
        size = encode_into(self._protocol, self._tick_ns, frames, self._room, first=self._first)
        self._first += len(frames)
        return self._room[:size]


def check_threads(threads: int) -> int:
    """Return how many of these threads are of use, or raise TypeError or ValueError."""
    number = operator.index(threads)
    if number < 1:
        raise ValueError(f"threads is {number}; it must be 1 or more")
    return limit_threads(number)
