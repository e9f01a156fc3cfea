"""What a recording of a port is asked for, what it does, and what it tells meanwhile."""

import os
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Any, Final, NamedTuple, Self, TypedDict

import numpy as np

from canser import adapters
from canser._checks import flag, real, text, whole
from canser._frames import FRAME_DTYPE, FrameArray, match
from canser._quantities import LONGEST_S, parse_bytes, parse_seconds
from canser.codec.decoder import Stats
from canser.errors import CanserWarning
from canser.live.meter import Meter, Rates
from canser.live.ring import Gap
from canser.live.stream import LiveStream
from canser.recording.header import RecordingInfo
from canser.recording.rotation import MEMORY, FileEvent, RecordingFiles
from canser.timing.host import HostClock, describe_step

__all__ = [
    "ROUND_S",
    "OnEvent",
    "RecordConfig",
    "RecordOptions",
    "RecorderEvent",
    "RecorderStatus",
    "RecordingJob",
    "warn_of",
]

# The time between two looks at whether a recording shall end, and between two statuses.
ROUND_S: Final = 0.2

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

_CLOCK_TEXT: Final = (
    "times in the open file go on as before, a file that begins later has the new time"
)

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

    Examples
    --------
    >>> canser.RecordConfig(size="100M", keep=20).keep
    20
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
        if self.time is not None and not _nanoseconds(self.time):
            raise ValueError(f"time is {self.time:g}; it must be more than 0 seconds")
        put("triggers", _triggers(self.triggers))
        if self.keep is not None:
            put("keep", whole(self.keep, "keep", "20", least=1))
        if not self.triggers and (self.before, self.after) != (None, None):
            raise ValueError("before and after are about a trigger; name one in triggers")
        put("before", _seconds(self.before, "before"))
        put("after", _seconds(self.after, "after"))
        put("force", flag(self.force, "force"))

    def make_files(self, path: str | os.PathLike[str], info: RecordingInfo) -> RecordingFiles:
        """Return what bytes are written to; for this package's own use. No file is made yet."""
        path = path if isinstance(path, os.PathLike) else text(path, "path", "'run.pcapng'")
        window_ns = None
        if self.triggers:
            window_ns = _nanoseconds(self.before), _nanoseconds(self.after)
        assert self.size is None or isinstance(self.size, int)
        return RecordingFiles(
            os.fspath(path),
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
        try:
            return parse_seconds(value)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
    seconds = real(value, name, "10 or '10s'")
    if not 0 <= seconds <= LONGEST_S:
        raise ValueError(f"{name} is {seconds:g}; it must be 0 to {LONGEST_S:,} seconds")
    return seconds


def _nanoseconds(seconds: float | str | None) -> int:
    assert not isinstance(seconds, str)
    return int((_WINDOW_S if seconds is None else seconds) * 1e9)


def _triggers(value: object) -> tuple[str, ...]:
    """Return filters, each of which can be read."""
    if isinstance(value, str):
        value = (value,)
    elif not isinstance(value, Sequence):
        raise TypeError(f"triggers is {value!r}; it must be a filter or several, such as '123'")
    triggers = tuple(text(each, "a trigger", "'123' or 'error'") for each in value)
    match(np.empty(0, FRAME_DTYPE), *(each for each in triggers if each != _ERROR))
    return triggers


class RecorderEvent(NamedTuple):
    """Something that has happened in a recording; given by a recording to `on_event`."""

    #: "opened", "closed", "deleted"; "vanished": removed, replaced or renamed while it was open;
    #: "restored", "set_aside": what `force` was to replace: a file, `path`.
    #: "trigger"; "gap"; "back": the device is back after a gap. "error": what the adapter
    #: reports, `number`. "clock_set": the host's clock, by `step_ns`. "warning".
    kind: str
    #: What has happened, in a line.
    text: str
    #: When, in epoch nanoseconds of the host's clock as it is set now.
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


OnEvent = Callable[[RecorderEvent], None]


def warn_of(event: RecorderEvent) -> None:
    """Make a warning of Python's of an event that is one; what tells where nothing else does."""
    if event.kind in ("warning", "clock_set"):
        warnings.warn(event.text, CanserWarning, stacklevel=2)


@dataclass(frozen=True, slots=True)
class RecorderStatus:
    """How far a recording is; returned by `Recorder.status`. Bytes are those of the line.

    `bytes_in == bytes_recorded + bytes_passed + bytes_vanished` once it has ended, unless the disk
    was full or away. `bytes_lost` are not in it.

    Attributes
    ----------
    elapsed_s : float
        Seconds since it began.
    stats : Stats
        The decoder's counters, of all bytes that were taken.
    rates : Rates
        `frames` and `bytes` per second, and the `load` of the bus, 0 to 1 (None where its bit rate
        is not known), of the last second.
    bytes_in : int
        Bytes that were taken from the port.
    bytes_recorded : int
        Bytes in files; at the end those that are on the disk for sure.
    bytes_passed : int
        Bytes that are not recorded on purpose: no trigger was near.
    bytes_vanished : int
        Bytes in files that were removed or replaced while they were open.
    bytes_unsure : int
        Bytes that were written, but are not known to be on the disk.
    bytes_lost : int
        Bytes that came while the recording's own ring was full.
    gaps : int
        Places where bytes are missing.
    gaps_unknown : int
        Those of them of which the number of missing bytes is unknown.
    triggers : int
        Triggers so far.
    files : int
        Files that were opened.
    files_kept : tuple of str
        The paths of those that were not deleted by `keep`, oldest first; at the end only of those
        that are there.
    files_vanished : int
        Files that were removed, replaced or renamed while they were open.
    file : str
        The path of the open file, "" for none.
    file_bytes : int
        Bytes in the open file.
    last_file : str
        The path of the file that was opened last, "" for none.
    recording : bool
        Whether what comes is recorded, and does not wait for a trigger.
    away : bool
        Whether the device is gone, and waited for.
    ring_fill : float
        How full the recording's ring is, 0 to 1.
    """

    elapsed_s: float
    stats: Stats
    rates: Rates
    bytes_in: int
    bytes_recorded: int
    bytes_passed: int
    bytes_vanished: int
    bytes_unsure: int
    bytes_lost: int
    gaps: int
    gaps_unknown: int
    triggers: int
    files: int
    files_kept: tuple[str, ...]
    files_vanished: int
    file: str
    file_bytes: int
    last_file: str
    recording: bool
    away: bool
    ring_fill: float


class RecordingJob:
    """Rounds of reading a stream, recording its bytes, and telling what happens.

    A context manager, for one thread: at its end it records what is held, and closes the file.
    An OSError of the disk then tells what is recorded. `tell` is called with each event.
    """

    def __init__(
        self,
        stream: LiveStream,
        files: RecordingFiles,
        config: RecordConfig,
        clock: HostClock,
        *,
        bitrate: int | None,
        tell: OnEvent,
    ) -> None:
        self._stream, self._files, self._clock, self._tell = stream, files, clock, tell
        self._filters = [each for each in config.triggers if each != _ERROR]
        self._errors = _ERROR in config.triggers
        self._begin = time.monotonic()
        self._meter = Meter(bitrate, self._begin)
        self._room = np.empty(_ROOM, FRAME_DTYPE)
        self._gaps = self._gaps_unknown = 0
        self._away = self._told_memory = False
        self._gap_end = 0  # bytes that had come when the device went away
        self._ended = False
        stream.on_bytes = files.write
        stream.on_warning = self.warn
        stream.on_clock_set = self._clock_was_set

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._stream.tell_missing()
            self._files.close()
        finally:
            self._ended = True
            try:
                self._tell_files()
            finally:
                error = self._files.error
                if isinstance(error, OSError):
                    raise self._explain(error) from error

    def start(self) -> None:
        """Open the first file, where none waits for a trigger; its event comes with `step`.

        Raises what has ended the stream already; no file is made then.
        """
        if (error := self._stream.end_error()) is not None:
            raise error
        now = self._clock()
        # The port may have been opened before the clock was set.
        self._files.clock_was_set(self._stream.steps.look(), now)
        self._files.start(now)

    def step(self, timeout: float) -> None:
        """Record what comes within this time, in seconds.

        Raises what ends the stream, and OSError of the disk.
        """
        self._tell_files()
        deadline = time.monotonic() + timeout
        try:
            self._stream.read(_ROOM, _ROOM, deadline)
        finally:
            self._take()

    def drain(self, stop: Callable[[], object]) -> None:
        """Record what the line has delivered: some may wait in the system, or in the ring.

        `stop` lets no more bytes into the ring. Without it a line that is faster than the disk
        would keep this from its end.
        """
        end, stream = time.monotonic() + _DRAIN_S, self._stream
        quiet = False
        while not quiet and (left := end - time.monotonic()) > 0:
            before = self._files.bytes_in
            self.step(min(_QUIET_S, left))
            quiet = self._files.bytes_in == before and not len(stream.ring)
        stop()
        while len(stream.ring) or stream.ring.at_gap:
            stream.decode(_ROOM)
            self._take()

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
            # Each look at the disk takes a microsecond or more a file.
            files_kept=tuple(files.files_kept if self._ended else files.files_made),
            files_vanished=files.vanished,
            file=files.file,
            file_bytes=files.file_bytes,
            last_file=files.last_file,
            recording=files.recording,
            away=self._away,
            ring_fill=self._stream.ring.fill,
        )

    def _explain(self, error: OSError) -> OSError:
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
        stopped = OSError(f"STOPPED: {where}: {error.strerror or error}; {rest}")
        stopped.errno = error.errno
        return stopped

    def _take(self) -> None:
        """Count the frames that are decoded, and record the bytes that they came in."""
        frames = self._room[: self._stream.take_into(self._room)]
        files, now = self._files, self._clock()
        self._meter.add(frames, files.bytes_in, time.monotonic())
        triggers = self._find_triggers(frames)
        self._tell_gaps()
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
                told = f"the adapter reports error {said.number}"
                self._event("error", told, ts, number=said.number)
                times += [ts] if self._errors else []
        return sorted(times)

    def _event(self, kind: str, told: str, ts: int, **facts: Any) -> None:
        """Tell of something; `ts`: of the clock that does not step."""
        self._tell(RecorderEvent(kind, told, self._as_set(ts), **facts))

    def _as_set(self, ts: int) -> int:
        """Return a time as the host's clock has it, which may have been set meanwhile."""
        return ts + self._stream.steps.ahead_ns

    def warn(self, told: str) -> None:
        """Tell of something that is wrong."""
        self._event("warning", told, self._clock())

    def _clock_was_set(self, step_ns: int) -> None:
        now = self._clock()
        self._files.clock_was_set(step_ns, now)
        told = f"{self._stream.url}: {describe_step(step_ns)}; {_CLOCK_TEXT}"
        self._event("clock_set", told, now, step_ns=step_ns)

    def _tell_gaps(self) -> None:
        gaps, url = self._stream.gaps, self._stream.url
        while gaps:
            gap = gaps.popleft()
            self._gaps += 1
            self._gaps_unknown += gap.lost < 0
            self._away = gap.reason == "reconnect"
            told = _gap_text(gap)
            if self._away:
                told += f"; waiting for {url}"
            facts = {"offset": gap.offset, "lost": gap.lost, "reason": gap.reason}
            self._event("gap", told, gap.ts, **facts)
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
                _file_text(event, self._as_set(event.ts)),
                event.ts,
                path=event.path,
                lost=event.lost,
                renamed=event.renamed,
            )
        if files.out_of_memory and not self._told_memory:
            self._told_memory = True
            self.warn(
                f"{self._stream.url}: {MEMORY >> 20} MiB are too little for all that came before "
                "a trigger; less than `before` says is recorded"
            )


def _gap_text(gap: Gap) -> str:
    lost = "bytes are missing" if gap.lost < 0 else f"{gap.lost:,} bytes are lost"
    return f"gap: {lost} at byte {gap.offset:,}: {_GAP_REASONS[gap.reason]}"


def _file_text(event: FileEvent, ts: int) -> str:
    if event.kind == "trigger":
        return f"trigger at {datetime.fromtimestamp(ts / 1e9).astimezone():%H:%M:%S.%f}"
    if event.kind != "vanished":
        return f"{_FILE_TEXTS[event.kind]} {event.path}"
    if event.renamed:
        return f"{event.path} was renamed while it was open; its bytes are under its new name"
    return (
        f"{event.path} was removed or replaced while it was open; its {event.lost:,} bytes are gone"
    )
