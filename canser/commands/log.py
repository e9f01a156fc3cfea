"""`canser log`: record what a port receives, for as long as it takes.

With --json each line on standard output is an object with a `type` and a `time` (epoch seconds):

    status   once a second, and `end`, the last one, which has besides
               reason: of the end: "signal", "duration" or "error"
               error: why the exit code is 1, or null; that objects could not be written is
               told on standard error only
             elapsed: seconds since the port was opened
             frames, bytes: so far; bytes == framed + control + skipped + pending
             frames_per_s, bytes_per_s, bus_load: of the last second; the load is 0 to 1 without
               stuff bits, so a lower bound, and null where --bitrate is not given
             resyncs: runs of skipped bytes; lost: bytes that came while the ring was full;
             gaps, gaps_unknown: places where bytes are missing, and those of unknown length
             ring: how full it is, 0 to 1
             recorded, not_recorded: bytes in files, at the end those that are on the disk for
               sure, and bytes far from any trigger
             vanished: bytes in files that were removed or replaced while they were open
             triggers; files: that were opened; file: the open one, or ""
             lines_dropped: objects that are missing, because those before them were not read
    opened, closed, deleted    a file: path
    vanished  a file that was removed, replaced or renamed while it was open: path;
             renamed: whether its bytes are there, under a new name; lost: bytes that are gone.
             The recording goes on in another file, and the exit code is 1
    restored, set_aside  the old file that --force replaces has its name back, as nothing was
             recorded; or stays as NAME.old, as it is not sure that anything was: path
    trigger  path: of the file that was open, or ""
    gap      offset: in the stream; lost: bytes, -1 where not known; reason: "overflow",
             "reconnect" or "watchdog"
    back     the device is back after a gap
    error    number: what the adapter reports
    warning  message

The recording goes on, whatever becomes of the objects. A reader that ends, as in `| head -1`,
is no error. Where the objects cannot be written, as on a full disk, and where at the end their
reader takes nothing for 5 s, standard error says so, and the exit code is 1. For a slow reader
the newest 10,000 objects are kept, and the end waits until they are read.
"""

import argparse
import contextlib
import json
import sys
import time
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from canser import adapters
from canser._frames import FRAME_DTYPE, FrameArray, match
from canser._protocols import protocol
from canser._signals import Stop, stop_on_signals
from canser.analysis import report
from canser.commands._numbers import byte_count, duration, whole
from canser.commands._parser import BAD_DATA, GOOD, CallError, Commands, DataError, add_command
from canser.commands._port import duration_arguments, open_port, port_arguments
from canser.commands._screen import PATIENCE_S, Lines, StatusLine, warnings_as_lines
from canser.errors import PortError, StreamClosedError
from canser.live.meter import Meter
from canser.live.ports import Port, host_clock
from canser.live.ring import Gap
from canser.recording.header import RecordingInfo
from canser.recording.recorder import MEMORY, Event, Recorder

__all__ = ["add"]

# The most frames that are taken at once, and how long they are waited for.
_ROOM: Final = 4096
_ROUND_S: Final = 0.2

# After the wish to stop, bytes on their way are waited for: until none come for _QUIET_S, and
# for _DRAIN_S at most.
_QUIET_S: Final = 0.05
_DRAIN_S: Final = 0.5

# The time between two status objects of --json.
_STATUS_EVERY_S: Final = 1.0

_WINDOW_S: Final = 5.0  # before and after a trigger, by default

_SIZE_LEAST: Final = 100_000

_REASONS: Final = {
    "overflow": "this program was too slow",
    "reconnect": "the device was gone",
    "watchdog": "the ping did not come back",
}

_ABOUT_FILES: Final = {
    "opened": "recording into",
    "closed": "closed",
    "deleted": "deleted",
    "restored": "nothing was recorded, and there is the old file again:",
    "set_aside": "the old file stays:",
}


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "log",
        "  canser log -c /dev/ttyUSB0 -p seeed --bitrate 500000 run.pcapng\n"
        "  canser log -c /dev/ttyUSB0 -p seeed --size 100M --keep 20 run.pcapng\n"
        "  canser log -c /dev/ttyACM0 -p serial --trigger 123 --trigger error \\\n"
        "      --before 10s --after 30s event.pcapng\n"
        "  canser log -c socket://gateway:4000 -p serial --reconnect --json \\\n"
        "      run.pcapng | jq .frames_per_s",
        run=run,
        parents=[port_arguments(), duration_arguments()],
    )
    parser.add_argument("target", metavar="OUT", help="a .pcapng file")
    parser.add_argument(
        "--force",
        action="store_true",
        help="replace files that are there: an old one is OUT.old until the first bytes are on "
        "the disk, and gets its name back if none ever are",
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help="a JSON object a second, and one for each event, on standard output; where they "
        "cannot be written the recording goes on, and the exit code is 1",
    )
    rotation = parser.add_argument_group(
        "rotation", "OUT run.pcapng is then run-000001.pcapng and so on"
    )
    rotation.add_argument("--size", type=_size, help="bytes of a file at most, such as 100M")
    rotation.add_argument("--time", type=duration, help="time in a file at most, such as 1h")
    rotation.add_argument(
        "--keep",
        metavar="N",
        type=whole(least=1),
        help="delete the oldest files of this run, keep N",
    )
    events = parser.add_argument_group("events", "record only what surrounds them, a file for each")
    events.add_argument(
        "--trigger",
        dest="triggers",
        metavar="FILTER",
        action="append",
        default=[],
        help="a frame that passes: an id of up to three (standard) or of eight digits (extended), "
        "ID:MASK, ID~MASK or #MASK, hexadecimal; or 'error': an error frame or an error that the "
        "adapter reports; several: any of them",
    )
    events.add_argument(
        "--before",
        metavar="TIME",
        type=duration,
        help="record at least this time before a trigger (default: 5s)",
    )
    events.add_argument(
        "--after",
        metavar="TIME",
        type=duration,
        help="record at least this time after a trigger (default: 5s)",
    )


def run(args: argparse.Namespace) -> int:
    filters = [text for text in args.triggers if text != "error"]
    try:
        match(np.empty(0, FRAME_DTYPE), *filters)
        recorder = _recorder(args)
    except ValueError as error:
        raise CallError(str(error)) from None
    if args.json and sys.stdout is None:
        raise StreamClosedError("the standard output is closed; open it, or leave --json out")
    with (
        contextlib.closing(recorder),
        stop_on_signals() as stop,
        Lines(sys.stderr.fileno()) as messages,
    ):
        with (
            _Reporter(messages, as_json=args.json) as reporter,
            warnings_as_lines(reporter.warn),
            open_port(args, on_bytes=recorder.write) as port,
        ):
            ended = _Log(args, filters, port, recorder, reporter).run(stop)
        if ended is not None:
            messages.put(f"canser: {ended}", last=True)
    return BAD_DATA if ended is not None or reporter.failed else GOOD


def _recorder(args: argparse.Namespace) -> Recorder:
    window_ns = None
    if args.triggers:
        before, after = (_WINDOW_S if s is None else s for s in (args.before, args.after))
        window_ns = int(before * 1e9), int(after * 1e9)
    elif args.before is not None or args.after is not None:
        raise CallError("--before and --after are about a trigger; name one with --trigger")
    info = RecordingInfo(
        protocol=args.protocol,
        baudrate=args.baudrate or protocol(args.protocol).baudrate,
        bitrate=args.bitrate,
        ts_unit=args.ts_unit,
        device=args.channel,
    )
    return Recorder(
        args.target,
        info,
        size=args.size,
        period_ns=None if args.time is None else int(args.time * 1e9),
        window_ns=window_ns,
        keep=args.keep,
        force=args.force,
    )


def _size(text: str) -> int:
    size = byte_count(text)
    if size < _SIZE_LEAST:
        raise argparse.ArgumentTypeError(
            f"the size {text} is too small for a file; give 100k or more"
        )
    return size


class _Reporter:
    """Tell people on standard error, or machines on standard output; a context manager."""

    def __init__(self, messages: Lines, *, as_json: bool) -> None:
        """`messages`: the lines on standard error."""
        self.failed = False  # objects are missing on standard output
        self._messages = messages
        self._objects = Lines(sys.stdout.fileno(), self._fail) if as_json else None
        self._lines = self._objects or messages
        # None where machines read.
        self.status = None if as_json else StatusLine(messages, sys.stderr.fileno())
        self._due = time.monotonic() + _STATUS_EVERY_S

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._objects is None:
            return
        self._objects.__exit__(*error)
        if self._objects.unread:
            self.failed = True
            self._messages.put(
                f"canser: standard output: the reader took nothing for {PATIENCE_S:.0f} s; "
                "the last objects are missing",
                last=True,
            )

    def _fail(self, error: OSError) -> None:
        if isinstance(error, BrokenPipeError):
            return  # the reader has ended, and that is its right
        self.failed = True
        self._messages.put(
            f"canser: standard output: {error.strerror}; the objects from now on are missing, "
            "the recording goes on",
            last=True,
        )

    @property
    def dropped(self) -> int:
        """How many lines are missing because their reader was too slow."""
        return self._lines.dropped

    @property
    def due(self) -> bool:
        """Whether it is time for the status."""
        return time.monotonic() >= self._due if self.status is None else self.status.due

    def event(self, kind: str, text: str, ts: int, **facts: Any) -> None:
        """Tell what has happened: a line, or an object with the facts."""
        if self.status is not None:
            self._lines.put(text)
        else:
            self.object(kind, ts, facts)

    def object(self, kind: str, ts: int, facts: dict[str, Any]) -> None:
        """Tell machines."""
        if kind == "status":
            # By the clock, not by when the last one was late.
            self._due = max(self._due + _STATUS_EVERY_S, time.monotonic())
        line = json.dumps({"type": kind, "time": round(ts / 1e9, 6), **facts})
        self._lines.put(line, last=kind == "end")

    def last_lines(self, lines: Iterable[str]) -> None:
        """Tell people how it has ended."""
        for line in lines:
            self._lines.put(line, last=True)

    def warn(self, text: str) -> None:
        """Tell a warning."""
        self.event("warning", f"canser: {text}", time.time_ns(), message=text)


class _Log:
    """A run of the command: rounds of reading, recording and telling."""

    def __init__(
        self,
        args: argparse.Namespace,
        filters: list[str],
        port: Port,
        recorder: Recorder,
        reporter: _Reporter,
    ) -> None:
        self._port, self._recorder, self._reporter = port, recorder, reporter
        self._filters, self._errors = filters, "error" in args.triggers
        self._triggered, self._duration = bool(args.triggers), args.duration
        self._clock = host_clock()
        self._begin = time.monotonic()
        self._meter = Meter(args.bitrate, self._begin)
        self._room = np.empty(_ROOM, FRAME_DTYPE)
        self._gaps = self._gaps_unknown = 0
        self._away = self._told_memory = False
        self._gap_end = 0  # bytes that had come when the device went away

    def run(self, stop: Stop) -> Exception | None:
        """Record until the end; return why the exit code is not 0."""
        error: Exception | None = None
        try:
            try:
                self._recorder.start(self._clock())
                self._follow(stop)
            finally:
                self._take(self._room[:0])
        except (PortError, OSError) as ended:
            error = ended
        try:
            self._recorder.close()
        except OSError as ended:
            error = error or ended
        self._tell_events()
        reason = "error" if error is not None else "signal" if stop else "duration"
        if isinstance(error, OSError):
            error = _disk_error(error, self._recorder)
        if error is None and self._recorder.vanished:
            error = DataError(
                f"files that were removed, replaced or renamed while they were open: "
                f"{self._recorder.vanished:,}; {self._recorder.bytes_vanished:,} bytes are gone"
            )
        self._summary(reason, error)
        return error

    def _follow(self, stop: Stop) -> None:
        end = None if self._duration is None else self._begin + self._duration
        while not stop:
            left = _ROUND_S if end is None else end - time.monotonic()
            if left <= 0:
                return
            self._read(min(left, _ROUND_S))
            if self._reporter.due:
                self._tell_status()
        # What the line has delivered until now may wait in the system, or in the ring.
        end = time.monotonic() + _DRAIN_S
        while True:
            before, left = self._recorder.bytes_in, end - time.monotonic()
            self._read(_QUIET_S if left > 0 else 0)
            after = self._recorder.bytes_in
            # Not between a byte that is recorded and the frame that it belongs to.
            if after == self._port.decoder.position and (after == before or left <= 0):
                return

    def _read(self, timeout: float) -> None:
        room = self._room
        self._take(self._port.read_batch(room, min_frames=len(room), timeout=timeout))

    def _take(self, frames: FrameArray) -> None:
        """Count frames, and record the bytes that they came in."""
        port, recorder = self._port, self._recorder
        self._meter.add(frames, recorder.bytes_in, time.monotonic())
        triggers = self._triggers(frames)
        self._tell_gaps()
        recorder.advance(port.decoder.position - port.decoder.pending, self._clock(), triggers)
        self._tell_events()

    def _triggers(self, frames: FrameArray) -> list[int]:
        """Return the times of what is waited for, ascending."""
        times: list[int] = []
        if self._filters and len(frames):
            times += frames["ts"][match(frames, *self._filters)].tolist()
        if self._errors:
            times += frames["ts"][frames["err"]].tolist()
        for offset, data in self._port.take_controls():
            said = adapters.report(self._port.protocol, data)
            if said.kind == "error":
                ts = self._recorder.arrival_of(offset)
                text = f"the adapter reports error {said.number}"
                self._reporter.event("error", text, ts, number=said.number)
                times += [ts] if self._errors else []
        return sorted(times)

    # Telling

    def _tell_gaps(self) -> None:
        for gap in self._port.take_gaps():
            self._gaps += 1
            self._gaps_unknown += gap.lost < 0
            self._away = gap.reason == "reconnect"
            text = _gap_text(gap)
            if self._away:
                text += f"; waiting for {self._port.url}"
            self._reporter.event(
                "gap", text, gap.ts, offset=gap.offset, lost=gap.lost, reason=gap.reason
            )
            self._gap_end = self._recorder.bytes_in
        if self._away and self._recorder.bytes_in > self._gap_end:
            self._away = False
            self._reporter.event("back", f"{self._port.url} is back", self._clock())

    def _tell_events(self) -> None:
        recorder = self._recorder
        while recorder.events:
            event = recorder.events.popleft()
            kind, path, ts = event.kind, event.path, event.ts
            if kind == "vanished":
                self._reporter.event(
                    kind, _vanished_text(event), ts, path=path, lost=event.lost,
                    renamed=event.renamed,
                )  # fmt: skip
            elif kind == "trigger":
                when = datetime.fromtimestamp(ts / 1e9).astimezone()
                self._reporter.event("trigger", f"trigger at {when:%H:%M:%S.%f}", ts, path=path)
            elif kind != "closed" or self._reporter.status is None:
                self._reporter.event(kind, f"{_ABOUT_FILES[kind]} {path}", ts, path=path)
        if recorder.out_of_memory and not self._told_memory:
            self._told_memory = True
            self._reporter.warn(
                f"{MEMORY >> 20} MiB are too little for all that came before a trigger; "
                "--before is shorter than it says"
            )

    def _tell_status(self) -> None:
        if self._reporter.status is None:
            self._reporter.object("status", self._clock(), self._facts())
            return
        self._reporter.status.show(self._parts())

    def _facts(self) -> dict[str, Any]:
        """Return how things stand, for machines."""
        port, recorder, rates = self._port, self._recorder, self._meter.rates()
        stats = port.stats
        return {
            "elapsed": round(time.monotonic() - self._begin, 3),
            "frames": stats.frames,
            "frames_per_s": round(rates.frames, 1),
            "bytes": stats.bytes_in,
            "bytes_per_s": round(rates.bytes, 1),
            "bus_load": None if rates.load is None else round(rates.load, 4),
            "framed": stats.bytes_framed,
            "control": stats.bytes_control,
            "skipped": stats.bytes_skipped,
            "pending": stats.pending,
            "resyncs": stats.resyncs,
            "lost": port.bytes_lost,
            "gaps": self._gaps,
            "gaps_unknown": self._gaps_unknown,
            "ring": round(port.ring_fill, 4),
            "recorded": recorder.bytes_recorded,
            "not_recorded": recorder.bytes_passed,
            "vanished": recorder.bytes_vanished,
            "triggers": recorder.triggers,
            "files": recorder.files,
            "file": recorder.file,
            "lines_dropped": self._reporter.dropped,
        }

    def _parts(self) -> list[str]:
        """Return how things stand, for people, most wanted first."""
        port, recorder, rates = self._port, self._recorder, self._meter.rates()
        stats = port.stats
        parts = [
            _clock_text(time.monotonic() - self._begin),
            f"{rates.frames:,.0f} frames/s",
            f"{_bytes_text(rates.bytes)}/s",
        ]
        if rates.load is not None:
            parts.append(f"load {rates.load:.0%}")
        parts += [
            f"skipped {stats.bytes_skipped:,}",
            f"lost {port.bytes_lost:,}",
            f"ring {port.ring_fill:.0%}",
        ]
        if self._away:
            parts.insert(0, "no device")
        if recorder.recording:
            parts.append(f"{Path(recorder.file).name} {_bytes_text(recorder.file_bytes)}")
        else:
            parts.append(f"waiting for trigger {recorder.triggers + 1:,}")
        return parts

    def _summary(self, reason: str, error: Exception | None) -> None:
        port, recorder, stats = self._port, self._recorder, self._port.stats
        if self._reporter.status is None:
            facts = {"reason": reason, "error": None if error is None else str(error)}
            self._reporter.object("end", self._clock(), facts | self._facts())
            return
        self._reporter.status.clear()
        seconds = time.monotonic() - self._begin
        lines = [
            f"{port.url}: {stats.frames:,} frames in {seconds:,.1f} s",
            report.conservation(stats),
        ]
        if stats.bytes_skipped:
            lines.append(f"skipped: {report.reject_text(stats)}; resyncs: {stats.resyncs:,}")
        lines.append(f"recorded: {recorder.bytes_recorded:,} bytes in {_files_text(recorder)}")
        if self._triggered:
            lines.append(
                f"triggers: {recorder.triggers:,}; {recorder.bytes_passed:,} bytes far from any "
                "were not recorded"
            )
        unknown = f"; gaps of unknown length: {self._gaps_unknown:,}" if self._gaps_unknown else ""
        lines.append(f"lost: {port.bytes_lost:,} bytes{unknown}")
        if self._reporter.dropped:
            lines.append(
                f"lines not shown, because standard error was not read: {self._reporter.dropped:,}"
            )
        self._reporter.last_lines(lines)


def _files_text(recorder: Recorder) -> str:
    """Return how many files were made, and the names of those that are there."""
    names = [Path(path).name for path in recorder.files_kept]
    if not recorder.files:
        return "no file"
    if recorder.files == len(names) == 1:
        return names[0]
    text = f"{recorder.files:,} file{'s' * (recorder.files > 1)}"
    if len(names) < recorder.files:
        text += f", {len(names):,} kept"
    if not names:
        return text
    separator = ", " if len(names) == recorder.files else ": "
    return text + separator + (names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}")


def _vanished_text(event: Event) -> str:
    if event.renamed:
        return f"{event.path} was renamed while it was open; its bytes are under its new name"
    return (
        f"{event.path} was removed or replaced while it was open; its {event.lost:,} bytes are gone"
    )


def _disk_error(error: OSError, recorder: Recorder) -> Exception:
    elsewhere = recorder.bytes_passed + recorder.bytes_vanished
    missing = recorder.bytes_in - recorder.bytes_recorded - elsewhere
    if not recorder.files:
        rest = "nothing is recorded"
    elif recorder.bytes_unsure:
        rest = f"the last {missing:,} bytes may not be on the disk"
    else:
        rest = f"what was written is good, the last {missing:,} bytes are not in it"
    return OSError(
        f"STOPPED: {error.filename or recorder.last_file}: {error.strerror or error}; {rest}"
    )


def _gap_text(gap: Gap) -> str:
    lost = "bytes are missing" if gap.lost < 0 else f"{gap.lost:,} bytes are lost"
    return f"gap: {lost} at byte {gap.offset:,}: {_REASONS[gap.reason]}"


def _bytes_text(count: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count:.0f} B"


def _clock_text(seconds: float) -> str:
    minutes, left = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours:02}:{minutes:02}:{left:02}"
