"""The bytes that a simulated adapter sends: traffic and answers, with counters to the byte."""

import collections
from collections.abc import Generator, Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray, copy_records, refuse_mask
from canser.adapters import AdapterReport
from canser.codec.decoder import decode, encode
from canser.simulation._ahead import Ahead
from canser.simulation.traffic import damage

__all__ = ["Block", "Counts", "Outgoing", "rounds"]

# Frames that are encoded at once: some 50 KB, more than a terminal holds (12 to 20 KB).
_FRAMES = 4096

# Frames that are due within this time of each other go out together. Otherwise the sender would
# wake for each frame, and a host does not measure arrivals more finely than this.
_TOGETHER_NS = 200_000

# Larger steps of the recorded time are no pauses, as in `canser play`. A step back: the device has
# restarted its clock. A step forward: a false time out of noise.
_BACK_NS = 1_000_000_000
_FORWARD_NS = 3_600_000_000_000

_Offsets = npt.NDArray[np.int64]
_Times = npt.NDArray[np.int64]


@dataclass(slots=True)
class Counts:
    """Counters of the traffic sent. The bytes sent are always encoded - lost + inserted."""

    frames: int = 0  # damaged ones too
    intact: int = 0  # of the frames, those without a fault inside them
    untimed: int = 0  # of the frames, those without a time
    encoded: int = 0  # bytes of the frames before any fault
    lost: int = 0
    inserted: int = 0
    flipped: int = 0

    def add(self, other: "Counts") -> None:
        """Add the counters of a block."""
        for name in self.__slots__:
            setattr(self, name, getattr(self, name) + getattr(other, name))


class Block:
    """Frames as bytes on the line. The first `sent` bytes of `data` have gone out."""

    def __init__(
        self,
        frames: FrameArray,
        due: _Times,
        protocol: str,
        ts_unit: str,
        *,
        noise: float,
        loss: float,
        seed: tuple[int, int],
    ) -> None:
        clean = encode(frames, protocol, ts_unit=ts_unit)
        self._untimed = np.append(0, np.cumsum(frames["ts"] == NO_TIME))
        starts = np.empty(len(frames), np.int64)
        # The decoder finds the offset of each frame.
        found = decode(clean, protocol, ts_unit=ts_unit, offsets=starts)
        assert len(found) == len(frames)
        ends = np.append(starts[1:], len(clean))
        self.frames = frames
        self.sent = 0
        self._due = due
        self._clean_ends = ends
        none = np.empty(0, np.int64)
        if not noise and not loss:
            self.data = memoryview(clean)
            self._lost = self._inserted = self._flipped = none
            self.ends = ends
            self._intact = np.arange(len(frames) + 1)
            return
        hit = damage(clean, noise=noise, loss=loss, seed=seed)
        self.data = memoryview(hit.data)
        before_lost = np.searchsorted(hit.lost, hit.lost)
        self._lost = hit.lost - before_lost + np.searchsorted(hit.inserted, hit.lost)
        self._inserted = _without_lost(hit.inserted, hit.lost) + np.arange(len(hit.inserted))
        self._flipped = _without_lost(hit.flipped, hit.lost) + np.searchsorted(
            hit.inserted, hit.flipped, "right"
        )
        self.ends = _without_lost(ends, hit.lost) + np.searchsorted(hit.inserted, ends)
        # A byte that was inserted in front of a frame does not damage it.
        inside = np.setdiff1d(hit.inserted, starts)
        bad = np.concatenate((hit.lost, hit.flipped, inside))
        intact = np.ones(len(frames), np.int64)
        intact[np.searchsorted(ends, bad, "right")] = 0
        self._intact = np.append(0, np.cumsum(intact))

    @property
    def done(self) -> bool:
        """Whether all bytes have gone out."""
        return self.sent == len(self.data)

    def boundary(self) -> int:
        """Return the end of the frame that is going out; between two frames, the present offset."""
        if self.sent == 0:
            return 0
        return int(self.ends[self.ends.searchsorted(self.sent)])

    def due_end(self, elapsed_ns: int) -> int:
        """Return the end of the last frame that is due by a time."""
        count = int(self._due.searchsorted(elapsed_ns, "right"))
        return int(self.ends[count - 1]) if count else 0

    def next_due(self) -> int:
        """Return the time at which the next byte is due; there must be one."""
        return int(self._due[self.ends.searchsorted(self.sent, "right")])

    def counts(self) -> Counts:
        """Return the counters of the bytes that have gone out."""
        lost, inserted, flipped = (
            int(np.searchsorted(offsets, self.sent))
            for offsets in (self._lost, self._inserted, self._flipped)
        )
        if self.done:
            lost = len(self._lost)  # bytes lost after the last sent byte too
        encoded = self.sent + lost - inserted
        frames = int(np.searchsorted(self._clean_ends, encoded, "right"))
        intact, untimed = int(self._intact[frames]), int(self._untimed[frames])
        return Counts(frames, intact, untimed, encoded, lost, inserted, flipped)

    def counts_cut(self) -> Counts:
        """Return the counters, with the rest of the frame that is going out as lost."""
        counts = self.counts()
        begin = self._clean_ends[counts.frames - 1] if counts.frames else 0
        if counts.encoded > begin:
            frame_end = int(self._clean_ends[counts.frames])
            counts.lost += frame_end - counts.encoded
            counts.encoded = frame_end
            counts.frames += 1
            counts.untimed = int(self._untimed[counts.frames])
        return counts


def _without_lost(offsets: _Offsets, lost: _Offsets) -> _Offsets:
    """Return the offsets of bytes when the lost bytes before them are removed."""
    return offsets - np.searchsorted(lost, offsets)


class _Schedule:
    """The times at which frames are due, in nanoseconds from the first frame with a time.

    A frame without a time, or out of order, is due together with the frame before it.
    """

    def __init__(self) -> None:
        self.elapsed = 0  # nanoseconds of the recorded time, without its jumps
        self._before: int | None = None  # the last recorded time of this round
        self._last = 0  # the time at which the last frame is due

    def start_round(self, pause_ns: int) -> None:
        """Let the next frame follow after a pause, without regard to its recorded time."""
        self._before = None
        self.elapsed += pause_ns

    def due(self, ts: _Times) -> _Times:
        """Return the times at which the next frames are due; there must be at least one."""
        due = np.full(len(ts), self._last, np.int64)
        timed = ts != NO_TIME
        times = ts[timed]
        if len(times):
            before = int(times[0]) if self._before is None else self._before
            steps = np.diff(times, prepend=before)
            steps[(steps < -_BACK_NS) | (steps > _FORWARD_NS)] = 0
            due[timed] = self.elapsed + np.cumsum(steps)
            self._before, self.elapsed = int(times[-1]), int(due[timed][-1])
        due = np.maximum.accumulate(np.maximum(due, self._last))
        self._last = int(due[-1])
        return due


def rounds(
    traffic: FrameArray | Iterable[FrameArray], *, loop: bool
) -> Generator[tuple[FrameArray, _Times]]:
    """Yield the frames of the traffic in arrays of one block, for ever with `loop`.

    With each array comes an array of the times at which the frames are due, in nanoseconds from
    the first frame. The times of each round continue those of the round before.
    """
    shift = 0
    schedule = _Schedule()
    while True:
        count, first, last, begin = 0, NO_TIME, NO_TIME, schedule.elapsed
        for part in [traffic] if isinstance(traffic, np.ndarray) else traffic:
            for start in range(0, len(part), _FRAMES):
                frames = part[start : start + _FRAMES]
                timed = frames["ts"] != NO_TIME
                if timed.any():
                    times = frames["ts"][timed]
                    first = int(times[0]) if first == NO_TIME else first
                    last = max(last, int(times.max()))
                due = schedule.due(frames["ts"])
                if shift:
                    frames = copy_records(frames)
                    frames["ts"][timed] += shift
                count += len(frames)
                yield frames, due
        if not loop or not count:
            return
        # The pause between two rounds is the mean time between two frames.
        shift += (last - first) + (last - first) // max(count - 1, 1)
        schedule.start_round((schedule.elapsed - begin) // max(count - 1, 1))


class Outgoing:
    """The bytes to send: those of the traffic, and answers between two frames.

    `next` offers bytes, and `wrote` says how many of them have gone out.

    Traffic that is no array is taken ahead by a thread: reading and parsing it takes longer than
    the time between two frames.

    `timed`: whether the traffic goes out by its times. None: the first frames decide, by whether
    any has a time; then it is set.
    `answering`: the bytes of answers that wait. `answered`: those that have gone out.
    `starved`: whether the thread has no part ready, though the traffic has not ended.
    """

    def __init__(
        self,
        protocol: str,
        traffic: FrameArray | Iterable[FrameArray],
        *,
        ts_unit: str,
        loop: bool,
        timed: bool | None,
        noise: float,
        loss: float,
        seed: int,
    ) -> None:
        refuse_mask(traffic, "traffic")
        self._protocol, self._ts_unit = protocol, ts_unit
        self._noise, self._loss, self._seed = noise, loss, seed
        self._traffic = rounds(traffic, loop=loop)
        self._ahead = None if isinstance(traffic, np.ndarray) else Ahead(self._traffic)
        self.starved = False
        self.timed = timed
        self._begun = False  # whether `timed` is decided
        self._config: AdapterReport | None = None
        # Frames with the times at which they are due: those of the block before the filter, and
        # those left over from a block that was cut.
        self._chunk = np.empty(0, FRAME_DTYPE), np.empty(0, np.int64)
        self._rest: tuple[FrameArray, _Times] | None = None
        self._kept = np.empty(0, np.int64)  # the indices in the chunk of the block's frames
        self._block: Block | None = None
        self._blocks = 0
        self._renewing = False  # the block is cut after the frame that is going out
        self._answers: collections.deque[memoryview] = collections.deque()
        self._answer_begun = False  # a part of the first answer has gone out
        self._answer_offered = False
        self._done = Counts()
        self.answering = 0
        self.answered = 0

    def counts(self) -> Counts:
        """Return the counters of the traffic that has gone out."""
        counts = Counts()
        counts.add(self._done)
        if self._block is not None:
            counts.add(self._block.counts())
        return counts

    def answer(self, packet: bytes) -> None:
        """Send a packet as soon as possible, between two frames."""
        self._answers.append(memoryview(packet))
        self.answering += len(packet)

    def configure(self, config: AdapterReport | None) -> None:
        """Send only frames that pass the filter, after the frame that is going out."""
        self._config, self._renewing = config, True

    def end(self) -> None:
        """End the traffic after the frame that is going out."""
        if self._ahead is None:
            self._traffic.close()
        else:
            self._ahead.end()
        frames, due = self._chunk
        self._chunk, self._rest, self._renewing = (frames[:0], due[:0]), None, True

    def close(self) -> None:
        """Close the traffic, and end the thread."""
        if self._ahead is None:
            self._traffic.close()
        else:
            self._ahead.close()

    def ready(self) -> bool:
        """Return whether there is anything to send, now or later."""
        return bool(self._answers) or self._load() is not None or self.starved

    def next(self, room: int, elapsed_ns: int) -> memoryview:
        """Return the next bytes to send, `room` at most; empty if none are due."""
        self._answer_offered = bool(self._answers) and (
            self._answer_begun or self._block is None or self._block.sent == self._block.boundary()
        )
        if self._answer_offered:
            return self._answers[0][:room]
        block = self._load()
        if block is None:
            return memoryview(b"")
        end = block.boundary() if self._answers or self._renewing else len(block.data)
        if self.timed:
            end = min(end, max(block.sent, block.due_end(elapsed_ns)))
        return block.data[block.sent : min(end, block.sent + room)]

    def wait_ns(self, elapsed_ns: int) -> int:
        """Return the nanoseconds until bytes are due, when `next` has returned none."""
        block = self._load()
        if block is None or not self.timed:
            return 0
        return max(block.next_due() - elapsed_ns, _TOGETHER_NS)

    def wrote(self, count: int) -> None:
        """Count bytes of those that `next` has offered as gone out."""
        if self._answer_offered:
            self.answered += count
            self.answering -= count
            rest = self._answers.popleft()[count:]
            if rest:
                self._answers.appendleft(rest)
            self._answer_begun = bool(rest) and (count > 0 or self._answer_begun)
        elif self._block is not None:
            self._block.sent += count

    def cut(self) -> None:
        """Go on with the next frame; the rest of the one going out and all answers are lost."""
        self._cut()
        self._answers.clear()
        self._answer_begun, self.answering = False, 0

    def _load(self) -> Block | None:
        """Return the block to send from; None after the last block, or while starved."""
        block = self._block
        if self._renewing and block is not None and block.sent == block.boundary():
            self._cut()
        while self._block is None or self._block.done:
            if self._block is not None:
                self._done.add(self._block.counts())
                self._block = None
            self._renewing = False
            chunk, self._rest = self._rest, None
            if chunk is None:
                chunk = self._next_chunk()
            if chunk is None:
                return None
            self._encode(*chunk)
        return self._block

    def _next_chunk(self) -> tuple[FrameArray, _Times] | None:
        if self._ahead is None:
            return next(self._traffic, None)
        # The first frames are waited for: they decide `timed`.
        chunk = self._ahead.take(wait=not self._begun)
        self.starved = chunk is None and not self._ahead.ended
        return chunk

    def _cut(self) -> None:
        """Drop the block; the frames after the one that is going out become the rest."""
        if self._block is not None:
            counts = self._block.counts_cut()
            self._done.add(counts)
            if counts.frames < len(self._kept):
                frames, due = self._chunk
                start = self._kept[counts.frames]
                self._rest = frames[start:], due[start:]
            self._block = None

    def _encode(self, frames: FrameArray, due: _Times) -> None:
        """Make the next block of the frames that pass the filter."""
        if not self._begun and len(frames):
            self._begin(frames)
        self._chunk, self._kept = (frames, due), np.flatnonzero(self._passed(frames))
        if not len(self._kept):
            return
        self._blocks += 1
        self._block = Block(
            frames.take(self._kept),
            due[self._kept],
            self._protocol,
            self._ts_unit,
            noise=self._noise,
            loss=self._loss,
            seed=(self._seed, self._blocks),
        )

    def _begin(self, first: FrameArray) -> None:
        """Decide whether the traffic goes out by its times."""
        self._begun = True
        any_time = bool((first["ts"] != NO_TIME).any())
        if self.timed and not any_time:
            raise ValueError(
                "pace 'traffic' sends frames by their times, and these have none; "
                "give pace 'line' or 'max'"
            )
        if self.timed is None:
            self.timed = any_time

    def _passed(self, frames: FrameArray) -> npt.NDArray[np.bool_]:
        config = self._config
        if config is None:
            return np.ones(len(frames), np.bool_)
        wanted, mask = np.uint32(config.filter_id or 0), np.uint32(config.filter_mask or 0)
        passed: npt.NDArray[np.bool_] = (frames["id"] & mask) == (wanted & mask)
        return passed & frames["ext"] if config.frame_type == "extended" else passed
