"""The only importer of the compiled module: buffer checks, status to exception.

Nothing of cffi leaves this module but opaque pointers. Every check that C cannot
make is made here, before a byte is touched; alignment and overlap are C's.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias, cast
from weakref import ref

import numpy as np
import numpy.typing as npt

from canser._core import ffi, lib
from canser.frames import FRAME_DTYPE, FrameArray, copy_records, describe, refuse_mask

if TYPE_CHECKING:
    from typing_extensions import Buffer

# Any buffer of bytes; below Python 3.12 an array is none for a type checker.
BytesLike: TypeAlias = "Buffer | npt.NDArray[Any]"

Pointer = Any
Offsets = npt.NDArray[np.int64] | npt.NDArray[np.uint64]
Times = npt.NDArray[np.int64]

# The record of Python is the struct of C, field by field.
for _name, _field in ffi.typeof("canser_frame").fields:
    assert FRAME_DTYPE.fields is not None
    assert FRAME_DTYPE.fields[_name][1] == _field.offset
    assert FRAME_DTYPE.fields[_name][0].itemsize == ffi.sizeof(_field.type)
assert FRAME_DTYPE.itemsize == ffi.sizeof("canser_frame")

# The bytes behind a packet's first one without which it is not taken.
BEHIND: Final = int(lib.CANSER_BEHIND)

# How many control packets C may leave before it must ask for room again.
_CONTROL_CAP: Final = 1024
_CONTROL_DTYPE: Final = np.dtype([("offset", "u8"), ("len", "u1"), ("bytes", "u1", (23,))])
assert _CONTROL_DTYPE.itemsize == ffi.sizeof("canser_control")


@dataclass(frozen=True)
class Protocol:
    """One row of the table of protocols in C."""

    name: str
    aliases: tuple[str, ...]
    frame_min: int  # bytes of the shortest frame
    frame_max: int  # bytes of the longest frame as encode writes it
    has_clock: bool  # frames carry a device timestamp
    baudrate: int  # of the serial line, as adapters come
    bitrates: tuple[int, ...]  # that an adapter can be configured to; empty: to none
    ping: bytes  # empty: there is none
    status_request: bytes  # empty: there is none
    row: Pointer


class Control(NamedTuple):
    """A packet that is valid but is no CAN frame: its stream offset and its bytes."""

    offset: int
    data: bytes


class Config(NamedTuple):
    """How an adapter is to work: the struct of C, field by field."""

    bitrate: int
    filter_id: int
    filter_mask: int
    mode: int  # index of MODE_NAMES
    ext_only: bool
    once: bool
    fixed: bool


class Explained(NamedTuple):
    """What a control packet says; what its kind does not have is zero."""

    kind: str
    receive_errors: int
    transmit_errors: int
    number: int
    config: Config


def _text(pointer: Pointer) -> str:
    return str(ffi.string(pointer).decode("ascii"))


def _packet(packet: Pointer) -> bytes:
    return bytes(packet.bytes)[: packet.len]


def _read_bitrates(row: Pointer) -> Iterator[int]:
    for index in count():
        if not row.bitrates or not row.bitrates[index]:
            return
        yield row.bitrates[index]


def _read_table() -> Iterator[Protocol]:
    for index in count():
        row = lib.canser_protocol_at(index)
        if not row:
            return
        yield Protocol(
            name=_text(row.name),
            aliases=tuple(_text(row.aliases).split()),
            frame_min=row.frame_min,
            frame_max=row.frame_max,
            has_clock=bool(row.has_clock),
            baudrate=row.baudrate,
            bitrates=tuple(_read_bitrates(row)),
            ping=_packet(row.ping),
            status_request=_packet(row.status_request),
            row=row,
        )


PROTOCOLS: Final = {protocol.name: protocol for protocol in _read_table()}
_SPELLINGS: Final = {
    spelling: protocol
    for protocol in PROTOCOLS.values()
    for spelling in (protocol.name, *protocol.aliases)
}
REJECT_NAMES: Final = tuple(
    _text(lib.canser_reject_name(reason)) for reason in range(lib.CANSER_REJECT_COUNT)
)
MODE_NAMES: Final = tuple(
    _text(lib.canser_mode_name(mode)) for mode in range(lib.CANSER_MODE_COUNT)
)


# What frames are called that a format cannot carry, by the numbers that `refuse` gives; the
# first one stands for frames that it can.
REFUSAL_NAMES: Final = tuple(
    _text(lib.canser_refusal_name(refusal)) for refusal in range(lib.CANSER_REFUSAL_COUNT)
)
REFUSAL_TIME: Final = int(lib.CANSER_REFUSAL_TIME)


def find_protocol(name: str) -> Protocol:
    """Return the protocol of a name or accepted spelling, in any case, or raise."""
    if not isinstance(name, str):
        raise TypeError(f"protocol must be a name such as 'serial', not {describe(name)}")
    try:
        return _SPELLINGS[name.lower()]
    except KeyError:
        have = ", ".join(PROTOCOLS)
        raise ValueError(f"unknown protocol {name!r}; have: {have}") from None


def _check_bytes(data: BytesLike) -> memoryview:
    """Return a view of the caller's bytes, or raise."""
    refuse_mask(data, "data")
    try:
        view = memoryview(cast("Buffer", data))
    except (TypeError, ValueError):  # ValueError: datetime64 arrays and the like
        hint = "; encode it first" if isinstance(data, str) else ""
        raise TypeError(
            f"data must be bytes or another buffer of bytes, not {describe(data)}{hint}"
        ) from None
    if view.format.lstrip("@=<>!") not in ("B", "b", "c"):
        raise TypeError(
            f"data must hold single bytes, not {describe(data)} with items of format "
            f"{view.format!r}; pass .view('u1') of an array, or its bytes"
        )
    if not view.c_contiguous:
        raise BufferError(
            "data is not contiguous; pass a contiguous buffer, such as np.ascontiguousarray(data)"
        )
    return view


def input_bytes(data: BytesLike) -> Pointer:
    """Return a pointer to the caller's bytes, no copy; it holds the buffer."""
    # What nothing can be wrong with goes the short way.
    if type(data) is bytes:
        return ffi.from_buffer("uint8_t[]", data)
    view = _check_bytes(data)
    # A pointer that holds a memoryview, in a cycle such as an exception and its frames,
    # crashes the garbage collector of Python before 3.12.7. It does not look into arrays.
    return ffi.from_buffer("uint8_t[]", np.frombuffer(view, np.uint8))


def as_bytes(data: BytesLike) -> npt.NDArray[np.uint8]:
    """Return the caller's bytes as an array, no copy."""
    return np.frombuffer(_check_bytes(data), np.uint8)


def _check_array(array: Any, name: str, dtypes: tuple[Any, ...], make: str) -> None:
    """Raise unless `array` is one-dimensional, of a dtype, and contiguous."""
    if not isinstance(array, np.ndarray) or array.dtype not in dtypes:
        raise TypeError(f"{name} must be an array as {make} makes, not {describe(array)}")
    refuse_mask(array, name)
    if array.ndim != 1:
        raise ValueError(f"{name} has {array.ndim} dimensions; it must have one")
    if not array.flags.c_contiguous:
        raise ValueError(f"{name} is not contiguous; pass np.ascontiguousarray({name})")


def _check_writeable(array: npt.NDArray[Any], name: str) -> None:
    if not array.flags.writeable:
        raise BufferError(f"{name} is read-only; pass an array that can be written")


def input_frames(frames: FrameArray) -> Pointer:
    """Return a pointer to frames to read, no copy; it holds the array."""
    _check_array(frames, "frames", (FRAME_DTYPE,), "np.empty(n, canser.FRAME_DTYPE)")
    return ffi.from_buffer("canser_frame[]", frames)


def output_frames(out: FrameArray) -> Pointer:
    """Return a pointer to room for frames; it holds the array."""
    _check_array(out, "out", (FRAME_DTYPE,), "np.empty(n, canser.FRAME_DTYPE)")
    _check_writeable(out, "out")
    if not len(out):
        raise ValueError("out has room for 0 frames; it needs room for at least 1")
    return ffi.from_buffer("canser_frame[]", out)


_OFFSET_DTYPES = (np.dtype(np.int64), np.dtype(np.uint64))


def output_offsets(offsets: Offsets | None, frame_cap: int) -> Pointer:
    """Return a pointer to room for stream offsets, or NULL; it holds the array."""
    if offsets is None:
        return ffi.NULL
    _check_array(offsets, "offsets", _OFFSET_DTYPES, "np.empty(n, np.int64)")
    _check_writeable(offsets, "offsets")
    if len(offsets) < frame_cap:
        raise ValueError(
            f"offsets has room for {len(offsets)}, out for {frame_cap} frames; "
            "make offsets as long as out"
        )
    return ffi.from_buffer("int64_t[]", offsets)


def output_room(
    out: FrameArray, count: int, offsets: Offsets | None
) -> tuple[Pointer, int, Pointer]:
    """Return pointers into checked arrays behind `count` frames, and the room there.

    They hold nothing: the caller holds the arrays.
    """
    at = ffi.NULL if offsets is None else ffi.from_buffer("int64_t[]", offsets) + count
    return ffi.from_buffer("canser_frame[]", out) + count, len(out) - count, at


def output_bytes(out: npt.NDArray[np.uint8]) -> Pointer:
    """Return a pointer to room for bytes; it holds the array."""
    _check_array(out, "out", (np.dtype(np.uint8),), "np.empty(n, np.uint8)")
    _check_writeable(out, "out")
    return ffi.from_buffer("uint8_t[]", out)


def _raise_status(status: int) -> None:
    if status == lib.CANSER_MISALIGNED:
        raise ValueError(
            "an array of frames or offsets does not begin at a multiple of 8 bytes; "
            "pass a fresh one, such as np.empty(n, canser.FRAME_DTYPE)"
        )
    if status == lib.CANSER_OVERLAP:
        raise ValueError("input and output share memory; pass arrays apart from each other")
    raise AssertionError(f"canser's C core returned the status {status}")


# A batch counted in words, and where in it the counts lie: frames, then control packets.
_BATCH_WORDS: Final = ffi.sizeof("canser_batch") // ffi.sizeof("size_t")
_FOUND_WORD: Final = ffi.offsetof("canser_batch", "frame_count") // ffi.sizeof("size_t")
assert ffi.offsetof("canser_batch", "control_count") == (_FOUND_WORD + 1) * ffi.sizeof("size_t")
assert _BATCH_WORDS == _FOUND_WORD + 2


def _nothing() -> None:
    """Stand in for a reference to no array."""


class Stream:
    """The state of one stream in C, with room for its control packets.

    Without `keeps_controls` there is no such room: they are counted, not kept. Not safe for
    two threads: its owner takes a lock.
    """

    def __init__(self, protocol: Protocol, tick_ns: int, *, keeps_controls: bool = True) -> None:
        self.protocol = protocol
        self._tick_ns = tick_ns
        self._state = ffi.new("canser_decoder *")
        self._stats = self._state.stats
        # The batch and the bytes used, in one piece: what a call has found is read at
        # once, for each read costs as much as the decoding of some frames.
        self._memory = ffi.new("size_t[]", _BATCH_WORDS + 1)
        self._batch = ffi.cast("canser_batch *", self._memory)
        self._used = self._memory + _BATCH_WORDS
        self._found = self._memory + _FOUND_WORD
        if keeps_controls:
            self._controls = np.empty(_CONTROL_CAP, _CONTROL_DTYPE)
            self._batch.controls = self._controls_at = ffi.from_buffer(
                "canser_control[]", self._controls
            )
            self._batch.control_cap = _CONTROL_CAP
        # Where the last call's frames went, held by nobody here.
        self._out: Callable[[], object] = _nothing
        self._offsets: Callable[[], object] = _nothing
        self._cap = self._offset_cap = 0
        self.reset()

    def aim(self, out: FrameArray, offsets: Offsets | None) -> None:
        """Check the arrays that frames and offsets go to.

        They are mostly those of last time. Then that takes a tenth of the time: what may
        have become of them since is asked, and no pointer is made anew.
        """
        # A reference to an array that is gone gives None, which may be what is asked for.
        if (
            out is not None
            and out is self._out()
            and len(out) == self._cap
            and out.flags.writeable
            and (
                not self._offset_cap
                if offsets is None
                else offsets is self._offsets()
                and offsets.flags.writeable
                and len(offsets) == self._offset_cap
            )
        ):
            return
        self.aim_at(output_frames(out), len(out), output_offsets(offsets, len(out)))
        self._out, self._cap = ref(out), len(out)
        if offsets is not None:
            self._offsets, self._offset_cap = ref(offsets), len(offsets)

    def aim_at(self, out: Pointer, cap: int, at: Pointer) -> None:
        """Tell where frames and offsets go by pointers, which must stay good."""
        batch = self._batch
        batch.frames, batch.frame_cap, batch.offsets = out, cap, at
        self._out = self._offsets = _nothing
        self._offset_cap = 0

    def reset(self) -> None:
        """Start anew: counters zero, nothing held, the clock not started."""
        lib.canser_decoder_init(self._state, self.protocol.row, self._tick_ns)

    def feed(self, data: Pointer, data_len: int) -> list[int]:
        """Decode bytes; return the frames and control packets found, and the bytes used.

        Stops early where the room for frames or for control packets is full.
        """
        status = lib.canser_decoder_feed(self._state, data, data_len, self._batch, self._used)
        if status:
            _raise_status(status)
        found: list[int] = ffi.unpack(self._found, 3)
        return found

    def advance(self, data: Pointer, data_len: int, stop: int) -> int:
        """Decode as `feed` does what starts before `stop`, hold nothing; return the frames."""
        status = lib.canser_decoder_advance(
            self._state, data, data_len, stop, self._batch, self._used
        )
        if status:
            _raise_status(status)
        return int(self._batch.frame_count)

    def join(self, chunk: "Chunk") -> bool:
        """Go on over a chunk, if it starts where the stream stands; else return False."""
        status = lib.canser_decoder_join(self._state, chunk.state, chunk.frames_at)
        if status == lib.CANSER_APART:
            return False
        if status:
            _raise_status(status)
        return True

    def flush(self) -> int:
        """End the stream; return the frames. Again while bytes are pending."""
        status = lib.canser_decoder_flush(self._state, self._batch)
        if status:
            _raise_status(status)
        return int(self._batch.frame_count)

    def controls(self) -> npt.NDArray[np.void] | None:
        """Return a copy of the control packets of the last call, None for none."""
        found = self._batch.control_count
        return copy_records(self._controls[:found]) if found else None

    @property
    def position(self) -> int:
        """The stream offset behind all bytes taken."""
        return int(self._stats.bytes_in)

    @property
    def skipped(self) -> int:
        """Bytes inside no packet."""
        return int(self._stats.bytes_skipped)

    @property
    def pending(self) -> int:
        """Bytes held."""
        return int(self._state.carry_len)

    def counters(self) -> dict[str, Any]:
        """Return every field of `Stats` by name."""
        stats = self._stats
        values = {name: getattr(stats, name) for name, _ in ffi.typeof("canser_stats").fields}
        values["rejects"] = dict(zip(REJECT_NAMES, stats.rejects, strict=True))
        values["pending"] = self.pending
        return values


class Chunk:
    """A stretch of a stream, decoded by a guess into room of its own.

    `frames` has room for `cap` frames, `offsets` for as many if they are asked for.
    For one thread at a time.
    """

    def __init__(self, protocol: Protocol, tick_ns: int, cap: int, *, offsets: bool) -> None:
        self._protocol, self._tick_ns, self._most = protocol, tick_ns, cap
        self.offsets = np.empty(cap, np.int64) if offsets else None
        self._controls = np.empty(_CONTROL_CAP, _CONTROL_DTYPE)
        self.state = ffi.new("canser_chunk *")
        self._batch = ffi.new("canser_batch *")
        self._take_room(np.empty(cap, FRAME_DTYPE))
        if self.offsets is not None:
            # The pointer in a struct holds nothing: the array is held here.
            self._batch.offsets = ffi.from_buffer("int64_t[]", self.offsets)
        self._batch.controls = ffi.from_buffer("canser_control[]", self._controls)
        self._batch.control_cap = _CONTROL_CAP

    def _take_room(self, room: FrameArray) -> None:
        self.frames = room
        self.frames_at = ffi.from_buffer("canser_frame[]", self.frames)
        self._batch.frames, self._batch.frame_cap = self.frames_at, len(room)

    def decode(self, data: Pointer, data_len: int, first: int, stop: int, offset: int) -> None:
        """Decode what starts in data[first..stop); `offset` is the stream's at data[0]."""
        row, tick_ns = self._protocol.row, self._tick_ns
        status = lib.canser_chunk_decode(
            self.state, row, tick_ns, data, data_len, first, stop, offset, self._batch
        )
        if status:
            _raise_status(status)

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
        """Return an array that should do for the next stretch, by what is in this one.

        Where it does not, the stretch ends early.
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


def encode_into(
    protocol: Protocol,
    tick_ns: int,
    frames: FrameArray,
    out: npt.NDArray[np.uint8],
    *,
    first: int = 0,
) -> int:
    """Encode all frames into `out`, and return the bytes written.

    `first` is the index of the first frame, as messages count.
    """
    source, target = input_frames(frames), output_bytes(out)
    result = ffi.new("canser_encoded *")
    status = lib.canser_encode(protocol.row, tick_ns, source, len(frames), target, len(out), result)
    done = result.frame_count
    if status == lib.CANSER_REFUSED:
        row = frames[done]
        why = _text(lib.canser_refusal_text(result.refusal))
        raise ValueError(
            f"{protocol.name} cannot carry frame {first + done} (id {int(row['id']):#x}, "
            f"ext {int(row['ext'])}, dlc {row['dlc']}): {why}"
        )
    if status:
        _raise_status(status)
    if done < len(frames):
        raise ValueError(
            f"out has room for {len(out)} bytes, enough for {done} of {len(frames)} frames; "
            f"{len(frames) * protocol.frame_max} bytes are always enough"
        )
    return int(result.byte_count)


def refuse(protocol: Protocol, frames: FrameArray) -> npt.NDArray[np.uint8]:
    """Return for each frame why `encode_into` refuses it: a place in REFUSAL_NAMES, 0 if not."""
    source = input_frames(frames)
    refusals = np.empty(len(frames), np.uint8)
    status = lib.canser_refuse(protocol.row, source, len(frames), output_bytes(refusals))
    if status:
        _raise_status(status)
    return refusals


def configure(protocol: Protocol, config: Config) -> bytes:
    """Return the packet that configures an adapter; the values are checked already."""
    packet = ffi.new("canser_packet *")
    status = lib.canser_configure(
        protocol.row, ffi.new("canser_config *", config._asdict()), packet
    )
    if status:
        _raise_status(status)
    return _packet(packet)


def explain(protocol: Protocol, data: BytesLike) -> Explained | None:
    """Return what a control packet says; None for bytes that are not one."""
    source, report = input_bytes(data), ffi.new("canser_report *")
    status = lib.canser_explain(protocol.row, source, len(source), report)
    if status == lib.CANSER_NO_CONTROL:
        return None
    if status:
        _raise_status(status)
    config = report.config
    return Explained(
        kind=_text(lib.canser_control_name(report.kind)),
        receive_errors=report.receive_errors,
        transmit_errors=report.transmit_errors,
        number=report.number,
        config=Config(
            bitrate=config.bitrate,
            filter_id=config.filter_id,
            filter_mask=config.filter_mask,
            mode=config.mode,
            ext_only=bool(config.ext_only),
            once=bool(config.once),
            fixed=bool(config.fixed),
        ),
    )


def find_arrivals(
    pieces: Times, byte_ns: float, offsets: Offsets, arrivals: Times, *, end: int, reach: int
) -> None:
    """Set `arrivals` to when the frames at these offsets had come.

    `pieces`: the offset behind each and its time, in turn. See canser_times_arrivals.
    """
    _check_array(offsets, "offsets", _OFFSET_DTYPES, "np.empty(n, np.int64)")
    if len(offsets) != len(arrivals):
        raise ValueError(f"there are {len(offsets)} offsets for {len(arrivals)} frames")
    status = lib.canser_times_arrivals(
        ffi.from_buffer("canser_piece[]", pieces),
        len(pieces) // 2,
        byte_ns,
        ffi.from_buffer("int64_t[]", offsets),
        len(offsets),
        end,
        reach,
        ffi.from_buffer("int64_t[]", arrivals),
    )
    if status:
        _raise_status(status)


def find_ranked(values: Times, rank: int) -> tuple[int, int, int]:
    """Return the value that has this many below it, the lowest and the highest one."""
    ranked = ffi.new("canser_ranked *")
    status = lib.canser_times_rank(ffi.from_buffer("int64_t[]", values), len(values), rank, ranked)
    if status:
        _raise_status(status)
    return ranked.value, ranked.low, ranked.high


def find_lowest(values: Times, rank: int) -> int:
    """Return where the value stands that has this many below it, a few; the first of equal ones."""
    index = ffi.new("size_t *")
    status = lib.canser_times_lowest(ffi.from_buffer("int64_t[]", values), len(values), rank, index)
    if status:
        _raise_status(status)
    return int(index[0])


class Line:
    """What a device's clock stands at, and the host times that follow.

    `early`: how far a device time may lie before those of the past, and a host time behind
    its arrival. `latest`: no host time lies before this one. See canser_times_map.
    """

    def __init__(self, early: int, latest: int) -> None:
        self._line = ffi.new("canser_line *")
        self._trust = ffi.new("canser_trust *", {"early": early})
        self._latest = ffi.new("int64_t *", latest)

    def lay(self, device: int, host: int, drift: float) -> None:
        """Have the host's time be `host` when the device's is `device`."""
        self._line.device, self._line.host, self._line.drift = device, host, drift

    def pass_by(self, latest: int) -> None:
        """Let no host time come before this one."""
        self._latest[0] = latest

    def find_heights(self, device: Times, arrivals: Times, heights: Times) -> None:
        """Set `heights` to how far arrivals lie above the line."""
        status = lib.canser_times_heights(
            self._line,
            ffi.from_buffer("int64_t[]", device),
            ffi.from_buffer("int64_t[]", arrivals),
            len(heights),
            ffi.from_buffer("int64_t[]", heights),
        )
        if status:
            _raise_status(status)

    def map(self, device: Times, times: Times, reached: int, late: int) -> None:
        """Turn arrivals into host times, in place.

        `reached`: a device time of the past. `late`: how far a host time may lie before its
        arrival.
        """
        self._trust.reached, self._trust.late = reached, late
        status = lib.canser_times_map(
            self._line,
            self._trust,
            ffi.from_buffer("int64_t[]", device),
            len(times),
            ffi.from_buffer("int64_t[]", times),
            self._latest,
        )
        if status:
            _raise_status(status)
