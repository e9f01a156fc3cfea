"""What a simulated adapter sends: traffic and answers as bytes, accounted for to the byte."""

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

# Frames that are encoded at once: some 50 KB, more than a terminal holds.
_FRAMES = 4096

# Frames that are due within this time of the last ones go out together: a wake of the sender
# for each frame would cost more than it shows, as a host's clock of arrivals is no finer.
_TOGETHER_NS = 200_000

# Steps of the traffic's time that are no pauses, as in `canser play`: back, the clock of a
# device that has started anew; forward, a false time out of noise.
_BACK_NS = 1_000_000_000
_FORWARD_NS = 3_600_000_000_000

_Places = npt.NDArray[np.int64]
_Times = npt.NDArray[np.int64]


@dataclass(slots=True)
class Counts:
    """What has gone out. Law: bytes == encoded - lost + inserted."""

    frames: int = 0  # damaged ones too
    intact: int = 0  # of these, without a hit
    untimed: int = 0  # of all frames, those without a time
    encoded: int = 0
    lost: int = 0
    inserted: int = 0
    flipped: int = 0

    def add(self, other: "Counts") -> None:
        """Add those of a block that is done."""
        for name in self.__slots__:
            setattr(self, name, getattr(self, name) + getattr(other, name))


class Block:
    """Some frames as they go over the line. `sent` says how many bytes of `data` have gone."""

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
        # Whoever decodes what was encoded finds where each frame begins.
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
        self._inserted = _behind(hit.inserted, hit.lost) + np.arange(len(hit.inserted))
        self._flipped = _behind(hit.flipped, hit.lost) + np.searchsorted(
            hit.inserted, hit.flipped, "right"
        )
        self.ends = _behind(ends, hit.lost) + np.searchsorted(hit.inserted, ends)
        # A byte that was added in front of a frame leaves it whole.
        within = np.setdiff1d(hit.inserted, starts)
        bad = np.concatenate((hit.lost, hit.flipped, within))
        whole = np.ones(len(frames), np.int64)
        whole[np.searchsorted(ends, bad, "right")] = 0
        self._intact = np.append(0, np.cumsum(whole))

    @property
    def done(self) -> bool:
        """Whether all of it has gone."""
        return self.sent == len(self.data)

    def boundary(self) -> int:
        """Return where the frame ends that is going out; where nothing is, where it stands."""
        if self.sent == 0:
            return 0
        return int(self.ends[self.ends.searchsorted(self.sent)])

    def due_end(self, elapsed_ns: int) -> int:
        """Return where the last frame ends that is due by a time."""
        count = int(self._due.searchsorted(elapsed_ns, "right"))
        return int(self.ends[count - 1]) if count else 0

    def next_due(self) -> int:
        """Return when the next byte is due; there must be one."""
        return int(self._due[self.ends.searchsorted(self.sent, "right")])

    def counts(self) -> Counts:
        """Return what has gone out so far."""
        lost, inserted, flipped = (
            int(np.searchsorted(places, self.sent))
            for places in (self._lost, self._inserted, self._flipped)
        )
        if self.done:
            lost = len(self._lost)  # those behind the last byte too
        encoded = self.sent + lost - inserted
        frames = int(np.searchsorted(self._clean_ends, encoded, "right"))
        intact, untimed = int(self._intact[frames]), int(self._untimed[frames])
        return Counts(frames, intact, untimed, encoded, lost, inserted, flipped)

    def counts_cut(self) -> Counts:
        """Return what has gone out, with the rest of the frame that is going out as lost."""
        counts = self.counts()
        begin = self._clean_ends[counts.frames - 1] if counts.frames else 0
        if counts.encoded > begin:
            frame_end = int(self._clean_ends[counts.frames])
            counts.lost += frame_end - counts.encoded
            counts.encoded = frame_end
            counts.frames += 1
            counts.untimed = int(self._untimed[counts.frames])
        return counts


def _behind(places: _Places, lost: _Places) -> _Places:
    """Return where bytes come to lie when the lost ones before them are gone."""
    return places - np.searchsorted(lost, places)


class _Schedule:
    """When frames are due, in nanoseconds from the first one with a time.

    A frame without a time is due with the one before it, and so is one out of order.
    """

    def __init__(self) -> None:
        self.elapsed = 0  # of the recorded time, without its jumps
        self._before: int | None = None  # the last recorded time of this round
        self._last = 0  # when the last frame is due

    def start_round(self, pause_ns: int) -> None:
        """Let the next frame follow after a pause, whatever its recorded time is."""
        self._before = None
        self.elapsed += pause_ns

    def due(self, ts: _Times) -> _Times:
        """Return when the next frames are due, one or more."""
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
    """Yield the frames of some traffic in arrays for a block each, for ever with `loop`.

    With them comes when they are due, in nanoseconds from the first one. Each round's times
    go on where the round before has ended.
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
        # The time between two frames is that between two rounds.
        shift += (last - first) + (last - first) // max(count - 1, 1)
        schedule.start_round((schedule.elapsed - begin) // max(count - 1, 1))


class Outgoing:
    """The bytes that are to go out: those of the traffic, and answers between two frames.

    `timed`: the traffic goes out by its times; None: if any of the first frames has one, and
    then it is set. What `next` returns is offered, and what `wrote` says of it has gone.
    `answering` counts the bytes of answers that wait. Traffic that is no array is taken ahead
    by a thread, for to read and to parse it takes longer than two frames are apart; `starved`:
    no more of it has come yet.
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
        self._begun = False  # the first frames have been looked at
        self._config: AdapterReport | None = None
        self._rest: tuple[FrameArray, _Times] | None = None  # of a block that was cut
        # What the block is made of, and when it is due.
        self._chunk = np.empty(0, FRAME_DTYPE), np.empty(0, np.int64)
        self._kept = np.empty(0, np.int64)  # the places in it of the block's frames
        self._block: Block | None = None
        self._blocks = 0
        self._renewing = False  # at the end of the frame that is going out, the block is cut
        self._answers: collections.deque[memoryview] = collections.deque()
        self._answer_begun = False  # the first one is going out
        self._answer_offered = False
        self._done = Counts()
        self.answering = 0
        self.answered = 0

    def counts(self) -> Counts:
        """Return what of the traffic has gone out."""
        counts = Counts()
        counts.add(self._done)
        if self._block is not None:
            counts.add(self._block.counts())
        return counts

    def answer(self, packet: bytes) -> None:
        """Send a packet between two frames, as soon as may be."""
        self._answers.append(memoryview(packet))
        self.answering += len(packet)

    def configure(self, config: AdapterReport | None) -> None:
        """Send only frames that pass the filter, behind the frame that is going out."""
        self._config, self._renewing = config, True

    def end(self) -> None:
        """End the traffic behind the frame that is going out."""
        if self._ahead is None:
            self._traffic.close()
        else:
            self._ahead.end()
        frames, due = self._chunk
        self._chunk, self._rest, self._renewing = (frames[:0], due[:0]), None, True

    def close(self) -> None:
        """Let go of the traffic."""
        if self._ahead is None:
            self._traffic.close()
        else:
            self._ahead.close()

    def ready(self) -> bool:
        """Return whether there is anything to send, now or later."""
        return bool(self._answers) or self._load() is not None or self.starved

    def next(self, room: int, elapsed_ns: int) -> memoryview:
        """Return the next bytes to send, `room` at most; none if none are due."""
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
        """Return for how long nothing is to go out, when `next` has returned nothing."""
        block = self._load()
        if block is None or not self.timed:
            return 0
        return max(block.next_due() - elapsed_ns, _TOGETHER_NS)

    def wrote(self, count: int) -> None:
        """Take note that so many bytes of those that were offered have gone."""
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
        """Go on with the next frame; the rest of the one going out is lost, and all answers."""
        self._cut()
        self._answers.clear()
        self._answer_begun, self.answering = False, 0

    def _load(self) -> Block | None:
        """Return the block to send from; None when all has gone, or it is starved."""
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
        # The first frames are waited for: they tell by what they are to be paced.
        chunk = self._ahead.take(wait=not self._begun)
        self.starved = chunk is None and not self._ahead.ended
        return chunk

    def _cut(self) -> None:
        """Take leave of the block; the frames behind the one going out are the rest."""
        if self._block is not None:
            counts = self._block.counts_cut()
            self._done.add(counts)
            if counts.frames < len(self._kept):
                frames, due = self._chunk
                start = self._kept[counts.frames]
                self._rest = frames[start:], due[start:]
            self._block = None

    def _encode(self, frames: FrameArray, due: _Times) -> None:
        """Make the next block, of the frames that pass the filter."""
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
        """Find out whether there are times to send by."""
        self._begun = True
        any_time = bool((first["ts"] != NO_TIME).any())
        if self.timed and not any_time:
            raise ValueError(
                "pace 'traffic' sends frames by their times, and these have none; "
                "use 'line' or 'max'"
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
