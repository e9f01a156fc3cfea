"""What is in a file of frames or raw bytes: `canser.info`, and the object that it returns."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser._core.stream import Control
from canser._frames import FrameArray
from canser.analysis import report
from canser.analysis.ids import ID_DTYPE, IdRows, IdStatistics
from canser.analysis.plain import to_plain
from canser.analysis.steps import StepStatistics
from canser.codec.decoder import Stats
from canser.errors import NoProtocolError
from canser.files.fits import Fit, identify
from canser.files.judge import check_protocol
from canser.files.reader import ReadOptions
from canser.files.reading import Blocks, FilePart, Progress, Source, Sources, listed
from canser.recording.header import RecordingInfo

__all__ = ["FileInfo", "info", "rank_protocols", "summarise"]

_ROW_DTYPE: Final[np.dtype[np.void]] = np.dtype(
    [
        *((name, ID_DTYPE[name]) for name in ID_DTYPE.names or () if name != "rtr"),
        ("share", np.float64),
        ("rate", np.float64),
        ("period_ns", np.float64),
        ("period_p99_ns", np.float64),
    ],
    align=True,
)


@dataclass(frozen=True, slots=True, eq=False)
class FileInfo:
    """What is in a file: frames, times, ids, bytes. `str` of it is the text of `canser info`.

    Times are nanoseconds. A step back of the clock of more than a second is a restart, or a
    false time out of noise. Neither changes a span, a rate or a period.

    Attributes
    ----------
    name : str
        The file; several with commas between them.
    files : tuple of FilePart
        Each file: its name, its format, and its frames.
    frames : int
        Frames of all kinds: `standard` + `extended`.
    standard, extended : int
        Frames by the length of their id, 11 or 29 bits.
    remote, errors : int
        Remote frames and error frames among them.
    dlc : tuple of int
        Frames by their dlc, 0 to 8: nine numbers.
    first_ns, last_ns : int or None
        The first and the last time, None where no time is known.
    span_ns : int or None
        The time from first to last, of each run of the clock, in sum.
    restarts : int
        How often the clock restarted.
    false_times : int
        Times that are left out, as they fit neither those before nor those behind them.
    rate : float or None
        Frames a second of `span_ns`.
    ids : ndarray
        A row for each id, the most frequent first, shape (n,). An id may have two or three rows:
        standard, extended, and of error frames. Read-only. The fields:
        `id` (uint32), `ext`, `err` (bool);
        `count`, `remote` (int64): frames, and remote frames among them;
        `dlc_least`, `dlc_most` (uint8);
        `first_ns`, `last_ns` (int64): the first and the last known time, `canser.NO_TIME` if there
        is none;
        `share` (float64): of all frames, 0 to 1;
        `rate` (float64): frames a second of `span_ns`, NaN if not known;
        `period_ns`, `period_p99_ns` (float64): median and 99th percentile of the steps of time from
        one frame of the id to the next, NaN if there are none. Steps back and steps across a
        restart do not count. Exact for ids with up to 1,024 steps, and for a clock of milliseconds;
        else within 1/128.
    protocol : str or None
        Of raw bytes and recordings, None for files of frames.
    stats : Stats or None
        The counters of the decoder, None for files of frames.
    controls : tuple of Control
        Control packets, the last 65,536 if there are more.
    recording : RecordingInfo or None
        What a recording knows of its line, None for other files.
    doubt : str
        Why the bytes are not of the protocol, "" if they may be.
    remarks : tuple of str
        What else is to be known, with the name of the file: what is damaged, lost, or not read.
    fits : tuple of Fit
        How well the protocols fit, the best first, if the protocol was found so; else empty.
    """

    frames: int
    standard: int
    extended: int
    remote: int
    errors: int
    dlc: tuple[int, ...]
    first_ns: int | None
    last_ns: int | None
    span_ns: int | None
    restarts: int
    false_times: int
    rate: float | None
    ids: IdRows
    name: str = ""
    files: tuple[FilePart, ...] = ()
    protocol: str | None = None
    stats: Stats | None = None
    controls: tuple[Control, ...] = ()
    recording: RecordingInfo | None = None
    doubt: str = ""
    remarks: tuple[str, ...] = ()
    fits: tuple[Fit, ...] = ()

    def __str__(self) -> str:
        return "\n".join([*self.lines(), *self._notes()])

    def lines(self, top: int | None = None) -> Iterator[str]:
        """Yield the text line by line, without the remarks and the doubt that `str` ends with.

        Parameters
        ----------
        top : int, optional
            Show the most frequent ids only, this many at most, and how many are left out.
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
            told = ", ".join(f"{count:,} {name}" for name, count in kinds.items() if count)
            yield f"kinds      {told}"
        yield f"ids        {len(self.ids):,}"
        times = report.time_text(
            self.first_ns, self.last_ns, self.span_ns, self.restarts, self.false_times
        )
        yield f"time       {times}"
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
        """Return all of it as JSON has it, as `canser info --json` prints it.

        Parameters
        ----------
        top : int, optional
            The most frequent ids only, this many at most.

        Returns
        -------
        dict
            The attributes by their names. `ids` is a list of dicts, with the fields of a row as
            keys; `stats`, `recording`, `controls` and `fits` are dicts too, the data of a control
            packet in hexadecimal digits. Names that end with `_ns` are whole nanoseconds. What is
            not known is None. Besides there is `ids_left_out`, the number of ids that `top`
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
    sort: bool = False,
    as_is: bool = False,
    progress: Progress | None = None,
) -> FileInfo:
    """Read a file, or several as one stream, to the end and tell what is in it.

    Memory is bounded, unless frames are sorted.

    Parameters
    ----------
    source, format, ts_unit, bus, as_is, progress
        As for `canser.blocks`.
    sort : bool
        As for `canser.read`.
    protocol : str, optional
        The protocol of raw bytes. Without it the one that fits them best, of a file with a path.

    Returns
    -------
    FileInfo
        Its `str` is what `canser info` prints.

    Raises
    ------
    NoProtocolError
        For raw bytes that fit no protocol; those of a pipe need their `protocol`.
    FormatError, ValueError, OSError
        As `canser.blocks` raises them.

    Examples
    --------
    >>> frames = np.zeros(3, canser.FRAME_DTYPE)
    >>> frames["id"], frames["ts"] = 0x123, [0, 10_000_000, 20_000_000]
    >>> _ = Path("run.bin").write_bytes(canser.encode(frames, "serial"))
    >>> found = canser.info("run.bin", "serial")
    >>> found.span_ns, found.ids["period_ns"] / 1e6
    (20000000, array([10.]))
    >>> print(found)
    frames     3, 150.0/s
    kinds      3 standard
    ids        1
    time       0.020 s, from 0.000 to 0.020
    dlc        0: 3
    bytes      33 bytes = 33 framed + 0 control + 0 skipped + 0 pending
    resyncs    0
    controls   0
    <BLANKLINE>
          id     frames   share     rate/s   period ms  dlc
         123          3 100.00%     150.00       10.00  0
    """
    check_protocol(protocol, ts_unit)
    options = ReadOptions(protocol=protocol, ts_unit=ts_unit, bus=bus, as_is=as_is)
    fits: list[Fit] = []

    def told() -> FileInfo:
        with Blocks(source, options, format=format, progress=progress, sort=sort) as file:
            return _tell(file, fits)

    try:
        return told()
    except NoProtocolError as error:
        named = [each for each in listed(source) if error.name == str(each)]
        fits = rank_protocols(named[0]) if named else []
        if not fits or not fits[0].fits:
            raise
    # Of several files those that hold frames need no protocol.
    options = replace(options, protocol=fits[0].protocol, raw_only=True)
    return told()


def _tell(file: Blocks, fits: list[Fit]) -> FileInfo:
    """Return what is in open files; `fits`: how the protocol was found, if it was."""
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
    return identify(np.memmap(source, np.uint8, mode="r"))


def summarise(blocks: Iterable[FrameArray]) -> FileInfo:
    """Tell what is in frames."""
    statistics, steps = IdStatistics(remote_apart=False), StepStatistics()
    dlc = np.zeros(9, np.int64)
    for frames in blocks:
        batch = statistics.add(frames)
        steps.add(np.repeat(batch.places, batch.step_counts), batch.steps)
        dlc += np.bincount(frames["dlc"], minlength=9)[:9]
    clock = statistics.clock
    span = clock.span_ns
    seconds = span / 1e9 if span else None
    ids = _complete(statistics, steps, seconds)
    extended = int(ids["count"] @ ids["ext"])
    return FileInfo(
        frames=statistics.frames,
        standard=statistics.frames - extended,
        extended=extended,
        remote=int(ids["remote"].sum()),
        errors=int(ids["count"] @ ids["err"]),
        dlc=tuple(dlc.tolist()),
        first_ns=clock.first,
        last_ns=clock.last,
        span_ns=span,
        restarts=clock.restarts,
        false_times=clock.false_times,
        rate=None if seconds is None else statistics.frames / seconds,
        ids=ids,
    )


def _complete(
    statistics: IdStatistics, steps: StepStatistics, seconds: float | None
) -> npt.NDArray[np.void]:
    """Return the rows of all ids, the most frequent first."""
    counted = statistics.rows()
    ids = np.zeros(len(counted), _ROW_DTYPE)
    for name in ID_DTYPE.names or ():
        if name != "rtr":
            ids[name] = counted[name]
    medians, p99s = steps.median_and_p99(len(statistics))
    ids["share"] = ids["count"] / statistics.frames
    ids["rate"] = np.nan if seconds is None else ids["count"] / seconds
    ids["period_ns"], ids["period_p99_ns"] = medians[statistics.places], p99s[statistics.places]
    ids = ids.take(np.argsort(-ids["count"], kind="stable"))
    ids.flags.writeable = False
    return ids
