"""A recording of a port: its options, its work, its events and its status."""

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

# A recording checks at this interval whether it shall end, and makes a status.
ROUND_S: Final = 0.2

# The smallest `size` of a file, in bytes. The header of a smaller file would be a large part of it.
_SIZE_LEAST: Final = 100_000

# The default of `before` and `after`: the time that is recorded around a trigger.
_WINDOW_S: Final = 5.0

# The most frames that are taken from the stream at once.
_BATCH_FRAMES: Final = 4096

# When a recording shall end, some bytes may still be on their way from the line. They are recorded
# until none come for _QUIET_S, and for _DRAIN_S at most.
_QUIET_S: Final = 0.05
_DRAIN_S: Final = 0.5

# The name of the trigger for error frames and for errors that the adapter reports.
_ERROR: Final = "error"

_GAP_REASONS: Final = {
    "overflow": "this program was too slow",
    "reconnect": "the device was gone",
    "watchdog": "the ping did not come back",
}

_CLOCK_TEXT: Final = (
    "times in the open file go on as before; a file that is opened later has the new time"
)

_FILE_TEXTS: Final = {
    "opened": "recording into",
    "closed": "closed",
    "deleted": "deleted",
    "restored": "nothing was recorded; the old file has its name back:",
    "set_aside": "the old file is kept as",
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
    """Which files a recording makes: the options of `Port.record` and `canser.record`.

    All fields are keywords with a default, and are checked when the object is made. Sizes and
    times that were texts are numbers then.

    Raises
    ------
    TypeError, ValueError
        For a value that a field cannot have, and for `before` or `after` without `triggers`.

    Notes
    -----
    Without `size`, `time` and `triggers` a recording is one file. Otherwise its files are
    numbered: NAME-000001.pcapng, NAME-000002.pcapng and so on.

    Examples
    --------
    The newest 20 files of 100 MB, and an hour at most, each:

    >>> config = canser.RecordConfig(size="100M", time="1h", keep=20)
    >>> config.size, config.time
    (100000000, 3600.0)

    Only what comes up to 5 s before and 30 s after a frame 123, or after an error:

    >>> config = canser.RecordConfig(triggers=["123", "error"], after="30s")
    """

    #: The most bytes of a file, 100,000 or more, as a number or such as "100M". None: no limit.
    size: int | str | None = None
    #: The longest time in a file, in seconds or such as "1h", more than 0. None: no limit.
    time: float | str | None = None
    #: How many files of this recording are kept, 1 or more: the newest ones. Older files are
    #: deleted. None: all files are kept. For numbered files only.
    keep: int | None = None
    #: Filters such as "123" or "700:7F0", as for `canser.match`, or "error". Only bytes around a
    #: frame that passes one of them are recorded. "error" stands for error frames, and for errors
    #: that the adapter reports.
    triggers: str | Sequence[str] = ()
    #: Time that is recorded before a trigger, in seconds or such as "10s". None: 5 s.
    before: float | str | None = None
    #: Time that is recorded after a trigger, in seconds or such as "10s". None: 5 s.
    after: float | str | None = None
    #: Whether files that are there already are replaced.
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
        """Return the writer of the files; no file is made yet. For this package's own use."""
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
    """Return the triggers as a tuple; TypeError or ValueError if one is no filter."""
    if isinstance(value, str):
        value = (value,)
    elif not isinstance(value, Sequence):
        raise TypeError(f"triggers is {value!r}; it must be a filter or several, such as '123'")
    triggers = tuple(text(each, "a trigger", "'123' or 'error'") for each in value)
    # Raises what is wrong with a filter.
    match(np.empty(0, FRAME_DTYPE), *(each for each in triggers if each != _ERROR))
    return triggers


class RecorderEvent(NamedTuple):
    """Something that has happened in a recording, given by it to `on_event`.

    Notes
    -----
    The kinds of events:

    - "opened", "closed": the file `path` was opened or closed.
    - "deleted": the file `path` was deleted, as newer ones are kept.
    - "vanished": the file `path` was removed, replaced or renamed while it was open.
    - "restored": `force` had set the file `path` aside. It has its name back, as nothing was
      recorded.
    - "set_aside": `force` had set the file aside. It is kept as `path`.
    - "trigger": a trigger has come.
    - "gap": bytes are missing; see `Gap`.
    - "back": the device is back after a gap.
    - "error": the adapter reports the error `number`.
    - "clock_set": the host's clock was set, by `step_ns`.
    - "warning": something is wrong; `text` says what.
    """

    #: One of the names above.
    kind: str
    #: What has happened, in one line.
    text: str
    #: When, in epoch nanoseconds of the host's clock as it is set now.
    ts: int
    #: The file; for a trigger the file that was open, or "".
    path: str = ""
    #: For a gap: the number of missing bytes, -1 if it is unknown. For a file that has vanished:
    #: the number of the line's bytes that are gone with it.
    lost: int = 0
    #: For a gap: stream offset of the first byte behind it.
    offset: int = 0
    #: For a gap: "overflow", "reconnect" or "watchdog".
    reason: str = ""
    #: For a file that has vanished: whether it has another name, so that its bytes are there.
    renamed: bool = False
    #: For an error: what has happened, by the adapter's own numbers.
    number: int = 0
    #: By how many nanoseconds the host's clock was set forward; less than 0: back.
    step_ns: int = 0


OnEvent = Callable[[RecorderEvent], None]


def warn_of(event: RecorderEvent) -> None:
    """Warn by Python's warnings of an event that is a warning: the default of `on_event`."""
    if event.kind in ("warning", "clock_set"):
        warnings.warn(event.text, CanserWarning, stacklevel=2)


@dataclass(frozen=True, slots=True)
class RecorderStatus:
    """A snapshot of a recording, made by `Recorder.status` and `canser.record`.

    Counts of bytes are those of the line, but for `file_bytes`.

    Notes
    -----
    When a recording has ended, `bytes_in == bytes_recorded + bytes_passed + bytes_vanished`,
    unless the disk was full or away. `bytes_in` does not include `bytes_lost`.
    """

    #: Seconds since the recording began.
    elapsed_s: float
    #: The decoder's counters, of all bytes that were taken from the port.
    stats: Stats
    #: Of the last second: `frames` per second, `bytes` per second, and `load` of the bus, 0 to 1,
    #: which is None if the bit rate of the bus is not known.
    rates: Rates
    #: Bytes that were taken from the port.
    bytes_in: int
    #: Bytes in files; at the end only those that are on the disk for sure.
    bytes_recorded: int
    #: Bytes that are not recorded on purpose: no trigger was near.
    bytes_passed: int
    #: Bytes in files that were removed or replaced while they were open.
    bytes_vanished: int
    #: Bytes that were written, but are not known to be on the disk.
    bytes_unsure: int
    #: Bytes that came while the recording's own ring was full.
    bytes_lost: int
    #: Gaps: places where bytes are missing.
    gaps: int
    #: Gaps with an unknown number of missing bytes.
    gaps_unknown: int
    #: Triggers so far.
    triggers: int
    #: Files that were opened.
    files: int
    #: Paths of the files that were not deleted by `keep`, oldest first; at the end only of files
    #: that are there.
    files_kept: tuple[str, ...]
    #: Files that were removed, replaced or renamed while they were open.
    files_vanished: int
    #: Path of the open file; "" if none is open.
    file: str
    #: Size of the open file, in bytes.
    file_bytes: int
    #: Path of the file that was opened last; "" if none was.
    last_file: str
    #: Whether bytes are recorded as they come, and do not wait for a trigger.
    recording: bool
    #: Whether the device is gone, and the recording waits for it.
    away: bool
    #: How full the recording's ring is, 0 to 1.
    ring_fill: float


class RecordingJob:
    """Read a stream, record its bytes, and report events, in rounds.

    A context manager, for one thread: at its end it records the bytes that are held, and closes
    the file. An OSError of the disk then says what is recorded. `on_event` gets each event.
    """

    def __init__(
        self,
        stream: LiveStream,
        files: RecordingFiles,
        config: RecordConfig,
        clock: HostClock,
        *,
        bitrate: int | None,
        on_event: OnEvent,
    ) -> None:
        self._stream, self._files, self._clock, self._on_event = stream, files, clock, on_event
        self._filters = [each for each in config.triggers if each != _ERROR]
        self._errors = _ERROR in config.triggers
        self._begin = time.monotonic()
        self._meter = Meter(bitrate, self._begin)
        self._batch = np.empty(_BATCH_FRAMES, FRAME_DTYPE)
        self._gaps = self._gaps_unknown = 0
        self._away = self._memory_reported = False
        self._gap_end = 0  # `bytes_in` at the last gap
        self._ended = False
        stream.on_bytes = files.write
        stream.on_warning = self.warn
        stream.on_clock_set = self._clock_was_set

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._stream.report_missing()
            self._files.close()
        finally:
            self._ended = True
            try:
                self._report_files()
            finally:
                error = self._files.error
                if isinstance(error, OSError):
                    raise self._explain(error) from error

    def start(self) -> None:
        """Open the first file, unless files wait for a trigger; `step` reports its event.

        Raises the error of a stream that has ended already; no file is made then.
        """
        if (error := self._stream.end_error()) is not None:
            raise error
        now = self._clock()
        # The port may have been opened before the clock was set.
        self._files.clock_was_set(self._stream.steps.look(), now)
        self._files.start(now)

    def step(self, timeout: float) -> None:
        """Record the bytes that come within this time, in seconds.

        Raises the error that ends the stream, and OSError of the disk.
        """
        self._report_files()
        deadline = time.monotonic() + timeout
        try:
            self._stream.read(_BATCH_FRAMES, _BATCH_FRAMES, deadline)
        finally:
            self._take()

    def drain(self, stop: Callable[[], object]) -> None:
        """Record the bytes that the line has delivered, and that wait in the system or the ring.

        `stop` keeps new bytes out of the ring. Otherwise this would never end on a line that is
        faster than the disk.
        """
        end, stream = time.monotonic() + _DRAIN_S, self._stream
        quiet = False
        while not quiet and (left := end - time.monotonic()) > 0:
            before = self._files.bytes_in
            self.step(min(_QUIET_S, left))
            quiet = self._files.bytes_in == before and not len(stream.ring)
        stop()
        while len(stream.ring) or stream.ring.at_gap:
            stream.decode(_BATCH_FRAMES)
            self._take()

    @property
    def status(self) -> RecorderStatus:
        """The status as it is now."""
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
            # Only the last status asks the disk: that takes a microsecond or more for each file.
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
        """Return an error of the disk whose message says what became of the bytes."""
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
        """Take the frames that are decoded, and record their bytes."""
        frames = self._batch[: self._stream.take_into(self._batch)]
        files, now = self._files, self._clock()
        self._meter.add(frames, files.bytes_in, time.monotonic())
        triggers = self._find_triggers(frames)
        self._report_gaps()
        files.advance(self._stream.loop.border, now, triggers)
        self._report_files()

    def _find_triggers(self, frames: FrameArray) -> list[int]:
        """Return the times of the triggers in these frames and in control packets, ascending."""
        times: list[int] = []
        if self._filters and len(frames):
            times += frames["ts"][match(frames, *self._filters)].tolist()
        if self._errors:
            times += frames["ts"][frames["err"]].tolist()
        controls, protocol = self._stream.controls, self._stream.decoder.protocol
        while controls:
            offset, data = controls.popleft()
            report = adapters.report(protocol, data)
            if report.kind == "error":
                ts = self._files.arrival_of(offset)
                message = f"the adapter reports error {report.number}"
                self._event("error", message, ts, number=report.number)
                times += [ts] if self._errors else []
        return sorted(times)

    def _event(self, kind: str, message: str, ts: int, **facts: Any) -> None:
        """Report an event; `ts`: of the clock that does not step."""
        self._on_event(RecorderEvent(kind, message, self._as_set(ts), **facts))

    def _as_set(self, ts: int) -> int:
        """Return a time by the host's clock, which may have been set since the port was opened."""
        return ts + self._stream.steps.ahead_ns

    def warn(self, message: str) -> None:
        """Report a warning."""
        self._event("warning", message, self._clock())

    def _clock_was_set(self, step_ns: int) -> None:
        now = self._clock()
        self._files.clock_was_set(step_ns, now)
        message = f"{self._stream.url}: {describe_step(step_ns)}; {_CLOCK_TEXT}"
        self._event("clock_set", message, now, step_ns=step_ns)

    def _report_gaps(self) -> None:
        gaps, url = self._stream.gaps, self._stream.url
        while gaps:
            gap = gaps.popleft()
            self._gaps += 1
            self._gaps_unknown += gap.lost < 0
            self._away = gap.reason == "reconnect"
            message = _gap_text(gap)
            if self._away:
                message += f"; waiting for {url}"
            facts = {"offset": gap.offset, "lost": gap.lost, "reason": gap.reason}
            self._event("gap", message, gap.ts, **facts)
            self._gap_end = self._files.bytes_in
        if self._away and self._files.bytes_in > self._gap_end:
            self._away = False
            self._event("back", f"{url} is back", self._clock())

    def _report_files(self) -> None:
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
        if files.out_of_memory and not self._memory_reported:
            self._memory_reported = True
            self.warn(
                f"{self._stream.url}: {MEMORY >> 20} MiB are too little for the bytes before "
                "a trigger; a shorter time than `before` is recorded"
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
