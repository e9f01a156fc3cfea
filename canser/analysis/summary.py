"""Summarise a file of frames or raw bytes: `canser.info`, and the object that it returns."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import tzinfo
from pathlib import Path
from typing import Any, Final

import numpy as np

from canser._core.ids import Rows
from canser._core.stream import Control
from canser._dates import date_text
from canser._frames import NO_TIME, FrameArray, contiguous_frames
from canser._input import Input
from canser.analysis import report
from canser.analysis.ids import ID_STATS_DTYPE, IdStatsArray, finish, in_order
from canser.analysis.plain import to_plain
from canser.codec.decoder import Stats
from canser.errors import NoProtocolError
from canser.files.fits import Fit, identify
from canser.files.packed import unpacked
from canser.files.reading import (
    Blocks,
    FilePart,
    Progress,
    Source,
    Sources,
    checked_options,
    listed,
)
from canser.recording.header import RecordingInfo
from canser.timing.restarts import Clock

__all__ = ["FileInfo", "info", "rank_protocols", "summarise"]

# Bytes of a packed file by which its protocol is found. Of others it is found by all bytes.
_SAMPLE_LEN: Final = 1 << 20

# The fields of `canser.id_stats`, but for the two that tell rows of an id apart.
_ROW_DTYPE: Final[np.dtype[np.void]] = np.dtype(
    [
        *(
            (name, ID_STATS_DTYPE[name])
            for name in ID_STATS_DTYPE.names or ()
            if name not in ("rtr", "channel")
        ),
        ("remote", np.int64),
        ("share", np.float64),
        ("rate", np.float64),
    ],
    align=True,
)


@dataclass(frozen=True, slots=True, eq=False)
class FileInfo:
    """What is in a file: frames, times, ids, bytes; returned by `info`.

    `str` of it is the text that `canser info` prints. Times are in nanoseconds.

    Notes
    -----
    A step of the clock back by more than a second is a restart, or a false time that noise has
    made. Neither changes a span, a rate or a period.

    A row of `ids` has the fields of `canser.id_stats`, except `rtr` and `channel`: the remote
    frames of an id are in its row, and so are its frames on all channels. Besides:

    - `remote` (int64): remote frames among the frames;
    - `share` (float64): share of all frames, 0 to 1;
    - `rate` (float64): frames per second of `span_ns`, NaN if not known.

    Memory is bounded, so the fields that come from the distribution of intervals are exact up to
    8,704 intervals of an id, and within 1 % from there on: see `canser.IdStats`.
    """

    #: Frames of all kinds: `standard` + `extended`.
    frames: int
    #: Frames with an id of 11 bits.
    standard: int
    #: Frames with an id of 29 bits.
    extended: int
    #: Remote frames among `frames`.
    remote: int
    #: Error frames among `frames`.
    errors: int
    #: Frames by their dlc, 0 to 8: nine numbers.
    dlc: tuple[int, ...]
    #: The first time, in nanoseconds; None if no time is known.
    first_ns: int | None
    #: The last time, in nanoseconds; None if no time is known.
    last_ns: int | None
    #: Time from the first frame to the last, in nanoseconds: the sum over all runs of the clock.
    #: None if no time is known.
    span_ns: int | None
    #: How many times the clock restarted.
    restarts: int
    #: Times that are left out, because they fit neither those before nor those after them.
    false_times: int
    #: Frames per second of `span_ns`, None if not known.
    rate: float | None
    #: A row for each id, the most frequent first, shape (n,); read-only. An id may have two or
    #: three rows: standard, extended, and of error frames. For the fields see the notes.
    ids: IdStatsArray
    #: Name of the file; several names with commas between them.
    name: str = ""
    #: Each file with its name, its format, and its number of frames.
    files: tuple[FilePart, ...] = ()
    #: Protocol of raw bytes and recordings, None for formats that hold frames.
    protocol: str | None = None
    #: Counters of the decoder, None for formats that hold frames.
    stats: Stats | None = None
    #: Control packets, the last 65,536 if there are more.
    controls: tuple[Control, ...] = ()
    #: The line that a recording is of, None for other files.
    recording: RecordingInfo | None = None
    #: The time from which the times of the last file count, in nanoseconds since 1970; None if the
    #: file names none.
    start_ns: int | None = None
    #: The same as a date with its zone, "" if the file names none.
    start: str = ""
    #: Why the bytes are not of the protocol, "" if they may be.
    doubt: str = ""
    #: Messages about the files, with their names: what is damaged, lost, or not read.
    remarks: tuple[str, ...] = ()
    #: How well each protocol fits, the best first; empty if the protocol was not found that way.
    fits: tuple[Fit, ...] = ()

    def __str__(self) -> str:
        return "\n".join([*self.lines(), *self._notes()])

    def lines(self, top: int | None = None) -> Iterator[str]:
        """Yield the text line by line, without the remarks and the doubt that `str` ends with.

        Parameters
        ----------
        top : int, optional
            Show at most this number of ids, the most frequent ones, and how many are left out.
            By default all ids are shown.

        Yields
        ------
        str
            A line of text, without a line end.
        """
        if self.fits and self.stats is not None:
            best = self.fits[0]
            yield from report.fit_lines(self.fits, self.stats.bytes_in)
            yield ""
            yield f"protocol   {best.protocol}, which explains {best.score:.1%} of it beyond chance"
        if len(self.files) > 1:
            yield from (f"file       {name}, {of}: {count:,}" for name, of, count in self.files)
        if self.recording is not None:
            yield from report.recording_lines(self.recording)
        per_second = "" if self.rate is None else f", {self.rate:,.1f}/s"
        yield f"frames     {self.frames:,}{per_second}"
        kinds = {name: getattr(self, name) for name in ("standard", "extended", "remote")}
        kinds["error"] = self.errors
        if self.frames:
            counts = ", ".join(f"{count:,} {name}" for name, count in kinds.items() if count)
            yield f"kinds      {counts}"
        yield f"ids        {len(self.ids):,}"
        times = report.time_text(
            self.first_ns, self.last_ns, self.span_ns, self.restarts, self.false_times
        )
        yield f"time       {times}"
        if self.start:
            yield f"start      {self.start}"
        dlc = ", ".join(f"{dlc}: {count:,}" for dlc, count in enumerate(self.dlc) if count)
        yield f"dlc        {dlc or '-'}"
        if self.stats is not None:
            yield from report.stats_lines(self.stats, self.controls)
        if len(self.ids):
            yield ""
            yield from report.id_lines(self.ids[:top])
            left_out = self.ids[len(self.ids) if top is None else top :]
            if len(left_out):
                frames = left_out["count"].sum()
                yield f"ids left out: {len(left_out):,}; frames of them: {frames:,}"

    def as_dict(self, top: int | None = None) -> dict[str, Any]:
        """Return all fields as values that JSON has, as `canser info --json` prints them.

        Parameters
        ----------
        top : int, optional
            Include at most this number of ids, the most frequent ones. By default all ids.

        Returns
        -------
        dict
            The fields by their names. `ids` is a list of dicts, with the fields of a row as keys.
            `stats` and `recording` are dicts, `controls` and `fits` lists of dicts; the data of a
            control packet are hexadecimal digits. Values whose names end in `_ns` are whole
            nanoseconds. What is not known is None. `ids_left_out` is the number of ids that `top`
            leaves out.
        """
        shown = replace(self, ids=self.ids[:top])
        left_out = len(self.ids) - len(shown.ids)
        plain: dict[str, Any] = to_plain(shown)
        return {**plain, "ids_left_out": left_out}

    def _notes(self) -> Iterator[str]:
        if self.doubt or self.remarks:
            yield ""
        yield from self.remarks
        if self.doubt:
            yield self.doubt


def info(
    source: Sources,
    protocol: str | None = None,
    *,
    format: str | None = None,  # noqa: A002 - as in `canser.read`
    ts_unit: str | None = None,
    bus: str | None = None,
    times: str | None = None,
    tz: tzinfo | None = None,
    sort: bool = False,
    skip_bad: bool = False,
    as_is: bool = False,
    progress: Progress | None = None,
) -> FileInfo:
    """Read one file, or several as one stream, and return a summary of the content.

    Memory is bounded, unless frames are sorted.

    Parameters
    ----------
    source : str, path-like, binary file, or list of these
        The file to read, or several as one stream, as for `canser.blocks`.
    protocol : str, optional
        Protocol of raw bytes: a name of `protocols()`, or "auto". By default the protocol that
        fits a file best, if the file is given by its path.
    format : str, optional
        "raw", "pcapng", "candump", "csv" or "npy"; by default as for `canser.blocks`.
    ts_unit : str, optional
        Unit of the device's timestamps in raw bytes: "s", "ms", "us" or "ns"; "ms" by default.
    bus : str, optional
        Channel to read from a log of several buses, such as "can0"; all channels by default.
    times : {None, "delta"}, optional
        "delta" if times in a text log are differences, as for `canser.blocks`.
    tz : datetime.tzinfo, optional
        Time zone of dates in a file, which name none; local time by default.
    sort : bool, optional
        Order all frames by their times, as for `canser.read`. False by default.
    skip_bad : bool, optional
        Leave out the lines of a text log that cannot be read, and count them.
    as_is : bool, optional
        Read the bytes in the protocol given, whatever they look like, as for `canser.blocks`.
    progress : callable, optional
        Called after each block as `progress(bytes_done, bytes_total)`. `bytes_total` is None if
        it is not known.

    Returns
    -------
    FileInfo
        The summary. `str` of it is the text that `canser info` prints.

    Raises
    ------
    NoProtocolError
        A ValueError: raw bytes fit no protocol, or they come from a pipe and have none.
    FormatError
        As for `canser.blocks`; so are ValueError, TypeError and OSError.

    Examples
    --------
    >>> from pathlib import Path
    >>> frames = np.zeros(11, canser.FRAME_DTYPE)
    >>> frames["id"], frames["ts"] = 0x123, np.arange(11) * 10_000_000
    >>> _ = Path("run.bin").write_bytes(canser.encode(frames, "serial"))
    >>> found = canser.info("run.bin", "serial")
    >>> found.span_ns, found.ids["period_ns"] / 1e6
    (100000000, array([10.]))
    >>> print(found)
    frames     11, 110.0/s
    kinds      11 standard
    ids        1
    time       0.100 s, from 0.000 to 0.100
    dlc        0: 11
    bytes      121 bytes = 121 framed + 0 control + 0 skipped + 0 pending
    resyncs    0
    controls   0
    <BLANKLINE>
          id     frames   share     rate/s   period ms  dlc
         123         11 100.00%     110.00       10.00  0
    """
    options = checked_options(
        format,
        protocol=protocol,
        ts_unit=ts_unit,
        bus=bus,
        times=times,
        tz=tz,
        skip_bad=skip_bad,
        as_is=as_is,
    )
    fits: list[Fit] = []

    def read_all() -> FileInfo:
        with Blocks(source, options, format=format, progress=progress, sort=sort) as file:
            return _describe(file, fits, tz)

    try:
        return read_all()
    except NoProtocolError as error:
        named = [each for each in listed(source) if error.name == str(each)]
        fits = rank_protocols(named[0]) if named else []
        if not fits or not fits[0].fits:
            raise
    # Files that hold frames, or are recordings, need no protocol.
    options = replace(options, protocol=fits[0].protocol, raw_only=True)
    return read_all()


def _describe(file: Blocks, fits: list[Fit], tz: tzinfo | None) -> FileInfo:
    """Return what is in open files. `fits`: the ranking that found the protocol, if any."""
    found = summarise(file)
    notes = file.notes
    return replace(
        found,
        name=", ".join(part.name for part in file.files),
        files=tuple(file.files),
        protocol=file.protocol,
        stats=file.stats,
        controls=tuple(file.take_controls()),
        recording=file.recording,
        start_ns=file.start_ns,
        start="" if file.start_ns is None else date_text(file.start_ns, tz),
        doubt=notes.doubt,
        remarks=notes.lines,
        fits=tuple(fits),
    )


def rank_protocols(source: Source) -> list[Fit]:
    """Return how well the protocols fit a file, the best first; [] for a pipe or an empty file."""
    if not isinstance(source, (str, os.PathLike)):
        return []
    if not Path(source).is_file() or not Path(source).stat().st_size:
        return []
    with Input(source) as file, unpacked(file) as plain:
        if plain is not file:
            return identify(plain.at(0, _SAMPLE_LEN))
    return identify(np.memmap(source, np.uint8, mode="r"))


def summarise(blocks: Iterable[FrameArray]) -> FileInfo:
    """Return what is in frames. The fields about files keep their defaults."""
    rows, clock = Rows(remote_apart=False, keeps_steps=True), Clock()
    dlc, count = np.zeros(9, np.int64), 0
    for block in blocks:
        frames = contiguous_frames(block)
        rows.add(frames)
        times = frames["ts"]
        clock.add(times[times != NO_TIME])
        dlc += np.bincount(frames["dlc"], minlength=9)[:9]
        count += len(frames)
    span = clock.span_ns
    seconds = span / 1e9 if span else None
    ids = _complete(rows, count, seconds)
    extended = int(ids["count"] @ ids["ext"])
    return FileInfo(
        frames=count,
        standard=count - extended,
        extended=extended,
        remote=int(ids["remote"].sum()),
        errors=int(ids["count"] @ ids["err"]),
        dlc=tuple(dlc.tolist()),
        first_ns=clock.first,
        last_ns=clock.last,
        span_ns=span,
        restarts=clock.restarts,
        false_times=clock.false_times,
        rate=None if seconds is None else count / seconds,
        ids=ids,
    )


def _complete(rows: Rows, count: int, seconds: float | None) -> IdStatsArray:
    """Return the rows of all ids, the most frequent first."""
    counted = finish(rows)
    ids = np.zeros(len(counted), _ROW_DTYPE)
    for name in _ROW_DTYPE.names or ():
        if name in (ID_STATS_DTYPE.names or ()):
            ids[name] = counted[name]
    ids["remote"] = rows.rows["remote"][in_order(rows.rows)]
    ids["share"] = ids["count"] / count if count else 0
    ids["rate"] = np.nan if seconds is None else ids["count"] / seconds
    ids = ids.take(np.argsort(-ids["count"], kind="stable"))
    ids.flags.writeable = False
    return ids
