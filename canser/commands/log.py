"""`canser log`: record the bytes that a port receives.

With --json each line on standard output is an object with a `type` and a `time` (epoch seconds):

    status   the present counters, once a second:
             elapsed: seconds since the port was opened
             frames, bytes: so far; bytes == framed + control + skipped + pending
             frames_per_s, bytes_per_s, bus_load: of the last second; the load is 0 to 1, by the
               exact bits of the frames, and null without --bitrate
             resyncs: runs of skipped bytes
             lost: bytes that came while the ring was full
             gaps, gaps_unknown: places where bytes are missing, and those of unknown length
             ring: the share of the ring that is full, 0 to 1
             recorded: bytes in files; at the end only those that are on the disk for sure
             not_recorded: bytes too far from any trigger
             vanished: bytes in files that were removed or replaced while they were open
             triggers: so far
             files: number of files opened; file: the open one, or ""
             lines_dropped: objects that are missing because earlier ones were not read
    end      the last object; the fields of a status, and
             reason: of the end: "signal", "duration" or "error"
             error: why the exit code is 1, or null. Objects that could not be written are
               reported on standard error only
    opened, closed, deleted    a file: path
    vanished  a file that was removed, replaced or renamed while it was open: path
             renamed: whether its bytes still exist under a new name; lost: bytes that are gone.
             The recording goes on in another file, and the exit code is 1
    restored  the old file that --force replaces has its name back, because nothing was recorded:
             path
    set_aside  that old file stays as NAME.old, because it is not sure that anything was recorded:
             path
    trigger  path: the file that was open, or ""
    gap      offset: in the stream; lost: bytes, -1 if unknown; reason: "overflow", "reconnect" or
             "watchdog"
    back     the device is back after a gap
    clock_set  the host's clock was set: step_ns, positive if forward. The times in the open file
             go on as before; the next file begins with the new time
    error    number: the error that the adapter reports
    warning  message

The recording goes on even if objects cannot be written. A reader that ends, as in `| head -1`,
is no error. If objects cannot be written, as on a full disk, or their reader takes nothing for
5 s at the end, standard error reports that, and the exit code is 1. For a slow reader the newest
10,000 objects are kept, and the end waits until they are read.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, Self

from canser.analysis import report
from canser.commands import _stop
from canser.commands._numbers import duration, whole
from canser.commands._parser import BAD_DATA, GOOD, CallError, Commands, DataError, add_command
from canser.commands._port import duration_arguments, port_arguments, port_options
from canser.commands._screen import PATIENCE_S, Lines, StatusLine, warnings_as_lines
from canser.errors import (
    PortBusyError,
    PortDeniedError,
    PortError,
    PortNotFoundError,
    StreamClosedError,
)
from canser.live.recording import RecordConfig, RecorderEvent, RecorderStatus
from canser.live.run import record

__all__ = ["add"]

# Interval of the status objects of --json.
_STATUS_EVERY_S: Final = 1.0

# The fields of an event as JSON, besides its type and time; other events have those of files.
_FACTS: Final = {
    "vanished": ("path", "lost", "renamed"),
    "gap": ("offset", "lost", "reason"),
    "back": (),
    "error": ("number",),
    "clock_set": ("step_ns",),
}
_FACTS_OF_FILES: Final = ("path",)


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
    parser.add_argument("target", metavar="OUT", help="recording to write, a .pcapng file")
    parser.add_argument(
        "--force",
        action="store_true",
        help="replace existing files; the old file is kept as OUT.old until the first bytes are "
        "on the disk, and gets its name back if none are (default: refuse)",
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help="print a JSON object each second and for each event on standard output; if they "
        "cannot be written, the recording goes on, and the exit code is 1 (default: a status "
        "line on standard error)",
    )
    rotation = parser.add_argument_group(
        "rotation",
        "with --size or --time, OUT run.pcapng becomes run-000001.pcapng and so on",
    )
    rotation.add_argument(
        "--size",
        type=_size,
        help="largest size of a file in bytes, such as 100M (default: no limit)",
    )
    rotation.add_argument(
        "--time", type=duration, help="longest time in a file, such as 1h (default: no limit)"
    )
    rotation.add_argument(
        "--keep",
        metavar="N",
        type=whole(least=1),
        help="keep the newest N files of this run, and delete older ones (default: keep all)",
    )
    events = parser.add_argument_group(
        "events", "with --trigger, record only the bytes around each event, into its own file"
    )
    events.add_argument(
        "--trigger",
        dest="triggers",
        metavar="FILTER",
        action="append",
        default=[],
        help="event: a frame that matches, in hexadecimal: an id of up to 3 digits (standard) or "
        "of 8 digits (extended), ID:MASK, ID~MASK (inverse) or #MASK (error frames); or 'error': "
        "an error frame, or an error that the adapter reports; given several times, each is an "
        "event (default: record all)",
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
    if args.json and sys.stdout is None:
        raise StreamClosedError("the standard output is closed; open it, or leave --json out")
    if not args.triggers and (args.before, args.after) != (None, None):
        raise CallError("--before and --after are about a trigger; name one with --trigger")
    with _stop.stop_on_signals() as stop, Lines(sys.stderr.fileno()) as messages:
        with (
            _Reporter(messages, as_json=args.json) as reporter,
            warnings_as_lines(reporter.warn),
        ):
            ended = _Log(args, reporter).run(stop)
        if ended is not None:
            messages.put(f"canser: {ended}", last=True)
    return BAD_DATA if ended is not None or reporter.failed else GOOD


def _size(text: str) -> int | str | None:
    try:
        return RecordConfig(size=text).size
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


class _Reporter:
    """Report to people on standard error, or to machines on standard output; a context manager."""

    def __init__(self, messages: Lines, *, as_json: bool) -> None:
        """`messages`: the lines on standard error."""
        self.failed = False  # objects are missing on standard output
        self._messages = messages
        self._objects = Lines(sys.stdout.fileno(), self._fail) if as_json else None
        self._lines = self._objects or messages
        # None with --json.
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
            return  # the reader has ended, which is no error
        self.failed = True
        self._messages.put(
            f"canser: standard output: {error.strerror}; the objects from now on are missing, "
            "the recording goes on",
            last=True,
        )

    @property
    def dropped(self) -> int:
        """The number of lines that are missing because their reader was too slow."""
        return self._lines.dropped

    @property
    def due(self) -> bool:
        """Whether the next status is due."""
        return time.monotonic() >= self._due if self.status is None else self.status.due

    def event(self, kind: str, text: str, ts: int, **facts: Any) -> None:
        """Report an event: as a line, or as an object with the facts."""
        if self.status is not None:
            self._lines.put(text)
        else:
            self.object(kind, ts, facts)

    def object(self, kind: str, ts: int, facts: dict[str, Any]) -> None:
        """Write an object for machines."""
        if kind == "status":
            # Counted from when this status was due, so that a late one does not shift the next.
            self._due = max(self._due + _STATUS_EVERY_S, time.monotonic())
        line = json.dumps({"type": kind, "time": round(ts / 1e9, 6), **facts})
        self._lines.put(line, last=kind == "end")

    def last_lines(self, lines: Iterable[str]) -> None:
        """Write the last lines for people."""
        for line in lines:
            self._lines.put(line, last=True)

    def warn(self, text: str) -> None:
        """Report a warning."""
        self.event("warning", f"canser: {text}", time.time_ns(), message=text)


class _Log:
    """A run of the command: it reports the events and the status of the recording."""

    def __init__(self, args: argparse.Namespace, reporter: _Reporter) -> None:
        self._args, self._reporter = args, reporter
        self._status: RecorderStatus | None = None  # None before the recording has begun

    def run(self, stop: _stop.Stop) -> Exception | None:
        """Record until the end; return why the exit code is not 0."""
        args = self._args
        error: Exception | None = None

        def asked() -> bool:
            stop.interrupts = False
            return stop.wanted

        stop.interrupts = True  # until the port is open
        try:
            record(
                args.channel,
                args.protocol,
                args.target,
                duration=args.duration,
                stop=asked,
                bus_bitrate=args.bitrate,
                on_event=self._report_event,
                on_status=self._report_status,
                size=args.size,
                time=args.time,
                keep=args.keep,
                triggers=args.triggers,
                before=args.before,
                after=args.after,
                force=args.force,
                **port_options(args),
            )
        except (ValueError, PortNotFoundError, PortDeniedError, PortBusyError) as wrong:
            raise CallError(str(wrong)) from None
        except (PortError, OSError) as ended:
            if self._status is None:
                raise
            error = ended
        status = self._status
        assert status is not None
        reason = "error" if error is not None else "signal" if stop else "duration"
        if error is None and status.files_vanished:
            error = DataError(
                f"files that were removed, replaced or renamed while they were open: "
                f"{status.files_vanished:,}; {status.bytes_vanished:,} bytes are gone"
            )
        self._summary(status, reason, error)
        return error

    # Reports

    def _report_event(self, event: RecorderEvent) -> None:
        kind, reporter = event.kind, self._reporter
        if kind == "warning":
            reporter.warn(event.text)
        elif kind != "closed" or reporter.status is None:
            names = _FACTS.get(kind, _FACTS_OF_FILES)
            facts = {name: getattr(event, name) for name in names}
            reporter.event(kind, event.text, event.ts, **facts)

    def _report_status(self, status: RecorderStatus) -> None:
        self._status = status
        if not self._reporter.due:
            return
        if self._reporter.status is None:
            self._reporter.object("status", time.time_ns(), self._facts(status))
            return
        self._reporter.status.show(self._parts(status))

    def _facts(self, status: RecorderStatus) -> dict[str, Any]:
        """Return the fields of a status, for machines."""
        stats, rates = status.stats, status.rates
        return {
            "elapsed": round(status.elapsed_s, 3),
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
            "lost": status.bytes_lost,
            "gaps": status.gaps,
            "gaps_unknown": status.gaps_unknown,
            "ring": round(status.ring_fill, 4),
            "recorded": status.bytes_recorded,
            "not_recorded": status.bytes_passed,
            "vanished": status.bytes_vanished,
            "triggers": status.triggers,
            "files": status.files,
            "file": status.file,
            "lines_dropped": self._reporter.dropped,
        }

    def _parts(self, status: RecorderStatus) -> list[str]:
        """Return the parts of the status line, for people, the most important ones first."""
        rates = status.rates
        parts = [
            _clock_text(status.elapsed_s),
            f"{rates.frames:,.0f} frames/s",
            f"{_bytes_text(rates.bytes)}/s",
        ]
        if rates.load is not None:
            parts.append(f"load {rates.load:.0%}")
        parts += [
            f"skipped {status.stats.bytes_skipped:,}",
            f"lost {status.bytes_lost:,}",
            f"ring {status.ring_fill:.0%}",
        ]
        if status.away:
            parts.insert(0, "no device")
        if status.recording:
            parts.append(f"{Path(status.file).name} {_bytes_text(status.file_bytes)}")
        else:
            parts.append(f"waiting for trigger {status.triggers + 1:,}")
        return parts

    def _summary(self, status: RecorderStatus, reason: str, error: Exception | None) -> None:
        stats = status.stats
        if self._reporter.status is None:
            facts = {"reason": reason, "error": None if error is None else str(error)}
            self._reporter.object("end", time.time_ns(), facts | self._facts(status))
            return
        self._reporter.status.clear()
        lines = [
            f"{self._args.channel}: {stats.frames:,} frames in {status.elapsed_s:,.1f} s",
            report.conservation(stats),
        ]
        if stats.bytes_skipped:
            lines.append(f"skipped: {report.reject_text(stats)}; resyncs: {stats.resyncs:,}")
        lines.append(f"recorded: {status.bytes_recorded:,} bytes in {_files_text(status)}")
        if self._args.triggers:
            lines.append(
                f"triggers: {status.triggers:,}; {status.bytes_passed:,} bytes far from any "
                "were not recorded"
            )
        unknown = status.gaps_unknown
        text = f"; gaps of unknown length: {unknown:,}" if unknown else ""
        lines.append(f"lost: {status.bytes_lost:,} bytes{text}")
        if self._reporter.dropped:
            lines.append(
                f"lines not shown, because standard error was not read: {self._reporter.dropped:,}"
            )
        self._reporter.last_lines(lines)


def _files_text(status: RecorderStatus) -> str:
    """Return the number of files that were made, and the names of those that exist."""
    names = [Path(path).name for path in status.files_kept]
    if not status.files:
        return "no file"
    if status.files == len(names) == 1:
        return names[0]
    text = f"{status.files:,} file{'s' * (status.files > 1)}"
    if len(names) < status.files:
        text += f", {len(names):,} kept"
    if not names:
        return text
    separator = ", " if len(names) == status.files else ": "
    return text + separator + (names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}")


def _bytes_text(count: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count:.0f} B"


def _clock_text(seconds: float) -> str:
    minutes, left = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours:02}:{minutes:02}:{left:02}"
