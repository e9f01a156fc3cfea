"""What a recording of a port is asked for, what it does, and what it tells meanwhile."""

import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Any, Final, NamedTuple, TypedDict

import numpy as np

from canser import adapters
from canser._checks import flag, real, whole
from canser._frames import FRAME_DTYPE, FrameArray, match
from canser._quantities import parse_bytes, parse_seconds
from canser.codec.decoder import Stats
from canser.errors import CanserWarning
from canser.live.meter import Meter, Rates
from canser.live.ring import Gap
from canser.live.stream import LiveStream
from canser.recording.header import RecordingInfo
from canser.recording.rotation import MEMORY, FileEvent, RecordingFiles
from canser.timing.host import ClockSteps, HostClock, describe_step

__all__ = [
    "RecordConfig",
    "RecordOptions",
    "RecorderEvent",
    "RecorderStatus",
    "RecordingJob",
]

# A file of less than this is mostly its own header.
_SIZE_LEAST: Final = 100_000

# What is recorded before and after a trigger, where the caller does not say.
_WINDOW_S: Final = 5.0

# Frames that are taken at once.
_ROOM: Final = 4096

# After the wish to stop, bytes on their way are waited for: until none come for _QUIET_S, and
# for _DRAIN_S at most.
_QUIET_S: Final = 0.05
_DRAIN_S: Final = 0.5

# The name of the trigger by error frames and by errors that the adapter reports.
_ERROR: Final = "error"

_GAP_REASONS: Final = {
    "overflow": "this program was too slow",
    "reconnect": "the device was gone",
    "watchdog": "the ping did not come back",
}

_FILE_TEXTS: Final = {
    "opened": "recording into",
    "closed": "closed",
    "deleted": "deleted",
    "restored": "nothing was recorded, and there is the old file again:",
    "set_aside": "the old file stays:",
}


class RecordOptions(TypedDict, total=False):
    """The fields of `RecordConfig` as keywords of a function."""

    size: int | str | None
    time: float | str | None
    keep: int | None
    triggers: str | Sequence[str]
    before: float | str | None
    after: float | str | None
    force: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordConfig:
    """Which files a recording makes.

    Attributes
    ----------
    size : int or str, optional
        Bytes of a file at most, such as `"100M"`; 100,000 or more. Then, as with `time` and
        `triggers`, files are NAME-000001.pcapng and so on.
    time : float or str, optional
        Time in a file at most, in seconds, or such as `"1h"`.
    keep : int, optional
        The newest files of this recording that are kept; older ones are deleted.
    triggers : str or sequence of str
        Record only what surrounds frames that pass one of these filters, such as `"123"` or
        `"700:7F0"`, or `"error"` for error frames and errors that the adapter reports.
    before, after : float or str, optional
        Time that is recorded before and after a trigger; by default 5 s.
    force : bool, default False
        Whether files that are there are replaced.

    Raises
    ------
    TypeError, ValueError
        For a value that is none of these.
    """

    size: int | str | None = None
    time: float | str | None = None
    keep: int | None = None
    triggers: str | Sequence[str] = ()
    before: float | str | None = None
    after: float | str | None = None
    force: bool = False

    def __post_init__(self) -> None:
        put = partial(object.__setattr__, self)
        if self.size is not None:
            size = self.size
            count = parse_bytes(size) if isinstance(size, str) else whole(size, "size", "'100M'")
            if count < _SIZE_LEAST:
                raise ValueError(f"the size {size} is too small for a file; give 100k or more")
            put("size", count)
        put("time", _seconds(self.time, "time"))
        if self.time == 0:
            raise ValueError("time is 0; it must be more than 0 seconds")
        if self.keep is not None:
            put("keep", whole(self.keep, "keep", "20", least=1))
        triggers = (self.triggers,) if isinstance(self.triggers, str) else tuple(self.triggers)
        put("triggers", triggers)
        match(np.empty(0, FRAME_DTYPE), *(text for text in triggers if text != _ERROR))
        if not triggers and (self.before, self.after) != (None, None):
            raise ValueError("before and after are about a trigger; name one in triggers")
        put("before", _seconds(self.before, "before"))
        put("after", _seconds(self.after, "after"))
        put("force", flag(self.force, "force"))

    def make_files(self, path: str, info: RecordingInfo) -> RecordingFiles:
        """Return what bytes are written to; no file is made yet."""
        window_ns = None
        if self.triggers:
            window_ns = _nanoseconds(self.before), _nanoseconds(self.after)
        assert self.size is None or isinstance(self.size, int)
        return RecordingFiles(
            path,
            info,
            size=self.size,
            period_ns=None if self.time is None else _nanoseconds(self.time),
            window_ns=window_ns,
            keep=self.keep,
            force=self.force,
        )


def _seconds(value: float | str | None, name: str) -> float | None:
    if value is None:
        return None
    if isinstance(value, str):
        return parse_seconds(value)
    seconds = real(value, name, "'10s'")
    if not 0 <= seconds < math.inf:
        raise ValueError(f"{name} is {seconds:g}; it must be 0 seconds or more, and not infinite")
    return seconds


def _nanoseconds(seconds: float | str | None) -> int:
    assert not isinstance(seconds, str)
    return int((_WINDOW_S if seconds is None else seconds) * 1e9)


class RecorderEvent(NamedTuple):
    """Something that has happened in a recording."""

    #: "opened", "closed", "deleted", "vanished", "restored", "set_aside": a file, `path`.
    #: "trigger"; "gap"; "back": the device is back after a gap. "error": what the adapter
    #: reports, `number`. "clock_set": the host's clock, by `step_ns`. "warning".
    kind: str
    #: What has happened, in a line.
    text: str
    #: When, in epoch nanoseconds.
    ts: int
    #: The file; of a trigger the one that was open, or "".
    path: str = ""
    #: Bytes: of a gap, -1 where their number is unknown; or gone with a file that has vanished.
    lost: int = 0
    #: Of a gap: where it is in the stream.
    offset: int = 0
    #: Of a gap: "overflow", "reconnect" or "watchdog".
    reason: str = ""
    #: Of a file that has vanished: it has another name, and its bytes are there.
    renamed: bool = False
    #: Of an error: what has happened, by the adapter's own numbers.
    number: int = 0
    #: By how many nanoseconds the host's clock was set forward.
    step_ns: int = 0


@dataclass(frozen=True, slots=True)
class RecorderStatus:
    """How a recording stands; bytes are those of the line."""

    elapsed_s: float  # since it began
    stats: Stats  # of all bytes that came
    rates: Rates  # of the last second
    bytes_in: int  # taken from the port
    bytes_recorded: int  # in files; at the end those that are on the disk for sure
    bytes_passed: int  # not recorded on purpose: no trigger was near
    bytes_vanished: int  # in files that were removed or replaced while they were open
    bytes_unsure: int  # written, but not known to be on the disk
    bytes_lost: int  # that came while the recording's own ring was full
    gaps: int  # places where bytes are missing
    gaps_unknown: int  # of these, those of which the number of bytes is unknown
    triggers: int
    files: int  # that were opened
    files_kept: tuple[str, ...]  # the paths of those that are there, oldest first
    files_vanished: int
    file: str  # the path of the open one, "" for none
    file_bytes: int  # in the open one
    last_file: str  # the path of the one that was opened last
    recording: bool  # whether what comes is recorded, and does not wait for a trigger
    away: bool  # the device is gone, and waited for
    ring_fill: float  # how full the recording's ring is, 0 to 1


class RecordingJob:
    """Rounds of reading a stream, recording its bytes, and telling what happens.

    `tell` is called with each event; without it warnings are those of Python. For one thread.
    """

    def __init__(
        self,
        stream: LiveStream,
        files: RecordingFiles,
        config: RecordConfig,
        clock: HostClock,
        *,
        bitrate: int | None,
        tell: Callable[[RecorderEvent], None] | None,
    ) -> None:
        self._stream, self._files, self._clock, self._tell = stream, files, clock, tell
        self._filters = [text for text in config.triggers if text != _ERROR]
        self._errors = _ERROR in config.triggers
        self._steps = ClockSteps(clock)
        self._begin = time.monotonic()
        self._meter = Meter(bitrate, self._begin)
        self._room = np.empty(_ROOM, FRAME_DTYPE)
        self._gaps = self._gaps_unknown = 0
        self._away = self._told_memory = False
        self._gap_end = 0  # bytes that had come when the device went away
        stream.on_bytes = files.write
        if tell is not None:
            stream.on_warning = self._warn

    def start(self) -> None:
        """Open the first file, where none waits for a trigger."""
        self._files.start(self._clock())
        self._tell_files()

    def step(self, timeout: float) -> None:
        """Record what comes within this time, in seconds.

        Raises what ends the stream, and OSError of the disk.
        """
        stream, room = self._stream, self._room
        deadline = time.monotonic() + timeout
        try:
            stream.read(len(room), len(room), deadline)
        finally:
            self._take(room[: stream.take_into(room)])

    def drain(self) -> None:
        """Record what the line has delivered: some may wait in the system, or in the ring."""
        end = time.monotonic() + _DRAIN_S
        while True:
            before, left = self._files.bytes_in, end - time.monotonic()
            self.step(_QUIET_S if left > 0 else 0)
            after = self._files.bytes_in
            # Not between a byte that is recorded and the frame that it belongs to.
            if after == self._stream.decoder.position and (after == before or left <= 0):
                return

    def close(self) -> None:
        """Record what is held, and close the file. May be called again."""
        self._stream.tell_missing()
        try:
            self._files.close()
        finally:
            self._tell_files()

    @property
    def status(self) -> RecorderStatus:
        """How things stand."""
        files, stats = self._files, self._stream.decoder.stats
        return RecorderStatus(
            elapsed_s=time.monotonic() - self._begin,
            stats=stats,
            rates=self._meter.rates(),
            bytes_in=files.bytes_in,
            bytes_recorded=files.bytes_recorded,
            bytes_passed=files.bytes_passed,
            bytes_vanished=files.bytes_vanished,
            bytes_unsure=files.bytes_unsure,
            bytes_lost=self._stream.ring.lost,
            gaps=self._gaps,
            gaps_unknown=self._gaps_unknown,
            triggers=files.triggers,
            files=files.files,
            files_kept=tuple(files.files_kept),
            files_vanished=files.vanished,
            file=files.file,
            file_bytes=files.file_bytes,
            last_file=files.last_file,
            recording=files.recording,
            away=self._away,
            ring_fill=self._stream.ring.fill,
        )

    def explain(self, error: OSError) -> OSError:
        """Return an error of the disk with what became of the bytes."""
        files = self._files
        elsewhere = files.bytes_passed + files.bytes_vanished
        missing = files.bytes_in - files.bytes_recorded - elsewhere
        if not files.files:
            rest = "nothing is recorded"
        elif files.bytes_unsure:
            rest = f"the last {missing:,} bytes may not be on the disk"
        else:
            rest = f"what was written is good, the last {missing:,} bytes are not in it"
        where = error.filename or files.last_file
        return OSError(f"STOPPED: {where}: {error.strerror or error}; {rest}")

    def _take(self, frames: FrameArray) -> None:
        """Count frames, and record the bytes that they came in."""
        files, now = self._files, self._clock()
        self._meter.add(frames, files.bytes_in, time.monotonic())
        triggers = self._find_triggers(frames)
        self._tell_gaps()
        if step_ns := self._steps.look():
            text = f"{describe_step(step_ns)}; times go on as before, until the next file"
            self._event("clock_set", text, now, step_ns=step_ns)
            files.clock_was_set(step_ns, now)
        files.advance(self._stream.loop.border, now, triggers)
        self._tell_files()

    def _find_triggers(self, frames: FrameArray) -> list[int]:
        """Return the times of what is waited for, ascending."""
        times: list[int] = []
        if self._filters and len(frames):
            times += frames["ts"][match(frames, *self._filters)].tolist()
        if self._errors:
            times += frames["ts"][frames["err"]].tolist()
        controls, protocol = self._stream.controls, self._stream.decoder.protocol
        while controls:
            offset, data = controls.popleft()
            said = adapters.report(protocol, data)
            if said.kind == "error":
                ts = self._files.arrival_of(offset)
                text = f"the adapter reports error {said.number}"
                self._event("error", text, ts, number=said.number)
                times += [ts] if self._errors else []
        return sorted(times)

    def _event(self, kind: str, text: str, ts: int, **facts: Any) -> None:
        if self._tell is not None:
            self._tell(RecorderEvent(kind, text, ts, **facts))
        elif kind in ("warning", "clock_set"):
            warnings.warn(f"{self._stream.url}: {text}", CanserWarning, stacklevel=6)

    def _warn(self, text: str) -> None:
        self._event("warning", text, self._clock())

    def _tell_gaps(self) -> None:
        gaps, url = self._stream.gaps, self._stream.url
        while gaps:
            gap = gaps.popleft()
            self._gaps += 1
            self._gaps_unknown += gap.lost < 0
            self._away = gap.reason == "reconnect"
            text = _gap_text(gap)
            if self._away:
                text += f"; waiting for {url}"
            facts = {"offset": gap.offset, "lost": gap.lost, "reason": gap.reason}
            self._event("gap", text, gap.ts, **facts)
            self._gap_end = self._files.bytes_in
        if self._away and self._files.bytes_in > self._gap_end:
            self._away = False
            self._event("back", f"{url} is back", self._clock())

    def _tell_files(self) -> None:
        files = self._files
        while files.events:
            event = files.events.popleft()
            self._event(
                event.kind,
                _file_text(event),
                event.ts,
                path=event.path,
                lost=event.lost,
                renamed=event.renamed,
            )
        if files.out_of_memory and not self._told_memory:
            self._told_memory = True
            self._warn(
                f"{MEMORY >> 20} MiB are too little for all that came before a trigger; "
                "less than `before` says is recorded"
            )


def _gap_text(gap: Gap) -> str:
    lost = "bytes are missing" if gap.lost < 0 else f"{gap.lost:,} bytes are lost"
    return f"gap: {lost} at byte {gap.offset:,}: {_GAP_REASONS[gap.reason]}"


def _file_text(event: FileEvent) -> str:
    if event.kind == "trigger":
        return f"trigger at {datetime.fromtimestamp(event.ts / 1e9).astimezone():%H:%M:%S.%f}"
    if event.kind != "vanished":
        return f"{_FILE_TEXTS[event.kind]} {event.path}"
    if event.renamed:
        return f"{event.path} was renamed while it was open; its bytes are under its new name"
    return (
        f"{event.path} was removed or replaced while it was open; its {event.lost:,} bytes are gone"
    )
