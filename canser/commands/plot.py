"""`canser plot`: pictures of a file."""

import argparse
import warnings
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from canser import plots
from canser._frames import FRAME_DTYPE, FrameArray, concat, copy_records
from canser._output import check_apart, whole_file
from canser._progress import Progress
from canser.analysis.load import BITRATE_MOST
from canser.commands._numbers import duration, whole
from canser.commands._parser import GOOD, CallError, Commands, DataError, add_command, write_line
from canser.commands._source import (
    check_found,
    open_source,
    selection,
    selection_arguments,
    source_arguments,
    write_remarks,
)
from canser.errors import CanserWarning
from canser.files.reading import Blocks
from canser.files.selection import Selection
from canser.plots._stream import part_frames
from canser.plots._style import check_matplotlib
from canser.plots._timeline import steady_frames

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["add"]

_KINDS: Final = (
    "overview",
    "load",
    "ids",
    "periods",
    "raster",
    "payload",
    "signals",
    "stream",
    "compare",
)

# The options that only some pictures have, by the attribute of the arguments.
_ONLY: Final = {
    "bitrate": ("overview", "load"),
    "window": ("overview", "load"),
    "id": ("payload",),
    "databases": ("signals",),
    "names": ("signals",),
}

# The formats of a picture, which are the suffixes of its file.
_SUFFIXES: Final = ("png", "svg", "pdf")

# Letters of the name of a file in a picture.
_NAME_MOST: Final = 24

# The signals that are drawn if none is named.
_SIGNALS_MOST: Final = 12


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "plot",
        "  canser plot run.log -o run.png\n"
        "  canser plot run.bin -p serial -b 500000 -o run.png --dark\n"
        "  canser plot run.log --kind raster --start 10s --end 20s -o raster.svg\n"
        "  canser plot run.log --id 123 -o bits.png\n"
        "  canser plot run.log --db car.dbc --signal RPM --signal Gear -o signals.png\n"
        "  canser plot run.bin -p serial --kind stream -o line.png\n"
        "  canser plot good.log bad.log --kind compare -o difference.png",
        run=run,
        parents=[source_arguments()],
    )
    parser.add_argument(
        "-o",
        dest="target",
        metavar="OUT",
        required=True,
        help="picture to write: .png, .svg or .pdf; - for standard output, as PNG",
    )
    parser.add_argument(
        "--kind",
        choices=_KINDS,
        metavar="KIND",
        help="overview: load, raster and periods on one page; load: of the bus over time; ids: "
        "frames by id; periods: with jitter and missing frames; raster: which id came when; "
        "payload: which bits of --id move; signals: of --db over time; stream: skipped bytes of "
        "raw bytes; compare: what differs between two files IN (default: payload with --id, "
        "signals with --db, otherwise overview)",
    )
    parser.add_argument(
        "-b",
        "--bitrate",
        metavar="BITRATE",
        type=whole(least=1, most=BITRATE_MOST),
        help="bit rate of the bus in bit/s, for its load in percent (default: that of a recording)",
    )
    parser.add_argument(
        "--window",
        metavar="TIME",
        type=duration,
        help="length of the windows in which the load is counted, such as 100ms or 1s (default: "
        "100ms, and longer for a file of over 13 minutes)",
    )
    parser.add_argument(
        "--id",
        metavar="ID",
        help="id of the payload: one to three hexadecimal digits of a standard id, or eight of an "
        "extended one",
    )
    parser.add_argument(
        "--db",
        dest="databases",
        metavar="FILE",
        action="append",
        help="database of the signals, such as a DBC file; may be given several times",
    )
    parser.add_argument(
        "--signal",
        dest="names",
        metavar="NAME",
        action="append",
        help="signal to draw: Signal, Message.Signal, or Message for all of its signals; may be "
        f"given several times (default: the first {_SIGNALS_MOST} that have samples)",
    )
    parser.add_argument(
        "--width",
        metavar="PIXELS",
        type=whole(least=400, most=20_000),
        default=1200,
        help="width of the picture in pixels, 400 to 20,000 (default: 1200)",
    )
    parser.add_argument(
        "--dark", action="store_true", help="draw on a dark ground (default: on white)"
    )
    selection_arguments(parser)
    parser.add_argument(
        "--force", action="store_true", help="replace OUT if it exists (default: refuse)"
    )


def run(args: argparse.Namespace) -> int:
    suffix = _suffix(args.target)
    kind, chosen = _kind(args), selection(args)
    if kind == "stream" and not chosen.is_all:
        raise CallError("--kind stream shows all bytes; leave the choice of frames out")
    check_apart(args.target, *args.sources)
    look = {"width": args.width, "dark": args.dark}
    with whole_file(args.target, force=args.force) as file:
        try:
            check_matplotlib()
            figure = _draw(args, kind, chosen, look)
        except ModuleNotFoundError as error:
            raise CallError(str(error)) from None
        figure.savefig(file, format=suffix)
    return GOOD


def _suffix(target: str) -> str:
    """Return the format of the picture."""
    suffix = "png" if target == "-" else target.rpartition(".")[2].lower()
    if suffix not in _SUFFIXES:
        raise CallError(f"{target} is no name of a picture; end it with .png, .svg or .pdf")
    return suffix


def _kind(args: argparse.Namespace) -> str:
    """Return the kind of picture; CallError if the options do not go with it."""
    default = "payload" if args.id else "signals" if args.databases or args.names else "overview"
    kind: str = args.kind or default
    options = {"databases": "--db", "names": "--signal"}
    for name, kinds in _ONLY.items():
        if getattr(args, name) is not None and kind not in kinds:
            option = options.get(name, f"--{name}")
            raise CallError(f"{option} goes with --kind {' or '.join(kinds)}, not with {kind}")
    if kind == "payload" and not args.id:
        raise CallError("--kind payload needs an id: give --id, such as --id 123")
    if kind == "signals" and not args.databases:
        raise CallError("signals need a database: give --db, such as --db car.dbc")
    if kind == "compare" and len(args.sources) != 2:
        raise CallError(f"--kind compare takes two files IN, not {len(args.sources)}")
    return kind


def _draw(args: argparse.Namespace, kind: str, chosen: Selection, look: dict[str, Any]) -> "Figure":
    """Return the picture."""
    if kind == "stream":
        return _stream(args, look)
    if kind == "compare":
        a, b = ((_read(args, [path], chosen))[0] for path in args.sources)
        return plots.compare(a, b, names=_names(*args.sources), **look)
    frames, bitrate = _read(args, args.sources, chosen)
    if kind in ("overview", "load"):
        draw = plots.overview if kind == "overview" else plots.bus_load
        window = None if args.window is None else round(1e9 * args.window)
        try:
            return draw(frames, bitrate, window=window, **look)
        except ValueError as error:
            raise CallError(f"--{error}") from None
    if kind == "payload":
        try:
            return plots.payload(frames, args.id, **look)
        except ValueError as error:
            raise CallError(str(error)) from None
    if kind == "signals":
        return _signals(args, frames, look)
    simple = {"ids": plots.ids, "periods": plots.periods, "raster": plots.raster}
    return simple[kind](frames, **look)


def _names(a: str, b: str) -> tuple[str, str]:
    """Return what two files are called in a picture: their names, if these are short."""
    names = PurePath(a).name, PurePath(b).name
    is_short = names[0] != names[1] and max(map(len, names)) <= _NAME_MOST
    return names if is_short else ("A", "B")


def _read(
    args: argparse.Namespace, paths: list[str], chosen: Selection
) -> tuple[FrameArray, int | None]:
    """Return the chosen frames of files, and the bit rate."""
    one = argparse.Namespace(**{**vars(args), "sources": paths})
    found, channels = [], set()
    with (
        Progress(f"reading {paths[0]}") as progress,
        open_source(one, progress, raw_only=len(args.sources) > 1) as source,
    ):
        for frames, codes, _ in chosen.apply(source.tagged()):
            found.append(copy_records(frames))
            if codes is not None:
                channels |= set(np.flatnonzero(np.bincount(codes)).tolist())
        recording = source.recording
    _finish(source, as_is=args.as_is)
    if len(channels) > 1:
        write_line(
            f"the frames of {len(channels)} channels are drawn as one; choose one with --bus"
        )
    bitrate = args.bitrate
    if bitrate is None and recording is not None:
        bitrate = recording.bitrate
    return concat(found) if found else np.zeros(0, FRAME_DTYPE), bitrate


def _finish(source: Blocks, *, as_is: bool) -> None:
    write_remarks(source)
    check_found(source, as_is=as_is)


def _stream(args: argparse.Namespace, look: dict[str, Any]) -> "Figure":
    with open_source(args) as source:
        room = part_frames(source.bytes_total)
    with (
        Progress(f"reading {args.sources[0]}") as progress,
        open_source(args, progress, out=np.empty(room, FRAME_DTYPE)) as source,
    ):
        try:
            figure = plots.stream(source, **look)
        except ValueError as error:
            raise CallError(str(error)) from None
    _finish(source, as_is=args.as_is)
    return figure


def _signals(args: argparse.Namespace, frames: FrameArray, look: dict[str, Any]) -> "Figure":
    """Return the picture of signals."""
    from canser.signals.database import Database  # noqa: PLC0415 - slow, and not always needed

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", CanserWarning)
        try:
            database = Database(*args.databases)
        except ImportError as error:
            raise CallError(str(error)) from None
        try:
            signals = database.decode(steady_frames(frames), args.names)
        except ValueError as error:
            raise CallError(str(error)) from None
    for each in caught:
        write_line(str(each.message))
    names = list(signals)
    if args.names is None and len(names) > _SIGNALS_MOST:
        write_line(
            f"{len(names)} signals have samples, and the first {_SIGNALS_MOST} are drawn; name "
            "others with --signal"
        )
        names = names[:_SIGNALS_MOST]
    if not names:
        raise DataError(f"no frame has a signal of {', '.join(args.databases)}")
    try:
        return plots.signals(signals, names, **look)
    except ValueError as error:
        raise CallError(str(error)) from None
