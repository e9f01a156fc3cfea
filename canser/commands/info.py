"""`canser info`: what is in a file, and which protocol it is."""

import argparse
import os
import stat

import numpy as np

from canser._progress import Progress
from canser._protocols import protocols
from canser.analysis import report
from canser.analysis.tally import Tally
from canser.codec.decoder import Control
from canser.commands._parser import GOOD, CallError, Commands, DataError, add_command, show
from canser.commands._source import (
    ProtocolNeededError,
    check_found,
    open_source,
    say_remarks,
    source_arguments,
)
from canser.files.fits import Fit, identify
from canser.files.frame_file import FrameFile

__all__ = ["add"]


def add(commands: Commands) -> None:
    """Add the command."""
    add_command(
        commands,
        "info",
        "  canser info run.bin\n"
        "  canser info run.bin -p serial --ts-unit us\n"
        "  canser info run.log\n"
        "  canser info run.pcapng",
        run=run,
        parents=[source_arguments()],
    )


def run(args: argparse.Namespace) -> int:
    tally = Tally()
    with Progress(f"reading {args.source}") as progress, _open(args, progress) as source:
        for frames in source:
            tally.add(frames)
        stats, controls = None, list[Control]()
        if source.decoder is not None:
            stats, controls = source.decoder.stats, source.decoder.take_controls()
    if source.recording is not None:
        show(report.recording_lines(source.recording))
    show(report.info_lines(tally, stats, controls))
    say_remarks(source)
    check_found(source, as_is=args.as_is)
    return GOOD


def _open(args: argparse.Namespace, progress: Progress) -> FrameFile:
    """Open IN; raw bytes of which nobody said the protocol in the one that fits."""
    try:
        return open_source(args, progress)
    except ProtocolNeededError:
        args.protocol = _identify(args).protocol
        return open_source(args, progress)


def _identify(args: argparse.Namespace) -> Fit:
    """Print which protocol fits the bytes of IN; raise DataError if none does."""
    mode = 0 if args.source == "-" else os.stat(args.source).st_mode  # noqa: PTH116
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        name = "standard input" if args.source == "-" else args.source
        raise CallError(
            f"{name} can be read only once: name its protocol with -p "
            f"({', '.join(protocols())}), or put it into a file first"
        )
    if os.path.getsize(args.source) == 0:  # noqa: PTH202
        raise DataError(f"{args.source} is empty")
    raw = np.memmap(args.source, np.uint8, mode="r")
    fits = identify(raw)
    best = fits[0]
    show([*report.fit_lines(fits, len(raw)), ""])
    if not best.fits:
        raise DataError(f"no protocol fits {args.source}; name it with -p if you know better")
    show([f"protocol   {best.protocol}, which explains {best.score:.1%} of it beyond chance"])
    return best
