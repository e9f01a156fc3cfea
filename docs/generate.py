"""Pages that are made of the project itself: so they cannot say anything else.

The table of protocols and their wire diagrams, the formats of files, the command line, the C
interface, the names of the Python interface, and the figures of the benchmarks.
"""

import argparse
import re
import tempfile
import warnings
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

import canser
from canser import plots
from canser.commands import COMMANDS
from canser.commands.cli import parser
from canser.files.formats import BUILT_IN

ROOT = Path(__file__).parent.parent

# The sections of the Python interface: the module that a name comes from, and the heading.
SECTIONS = {
    "codec.decoder": "Decode and encode",
    "_core.stream": "Decode and encode",
    "files.reading": "Read files",
    "files.writing": "Write and convert files",
    "tables.table": "Tables",
    "tables.convert": "Tables",
    "signals.database": "Signals",
    "signals.decoder": "Signals",
    "signals.signals": "Signals",
    "signals.signal": "Signals",
    "signals.report": "Signals",
    "signals.messages": "Signals",
    "files.fits": "Which protocol is it",
    "analysis.summary": "What is in a file",
    "codec.bits": "Bits and load of the bus",
    "analysis.ids": "Statistics of ids",
    "analysis.groups": "Statistics of ids",
    "analysis.dropouts": "Statistics of ids",
    "analysis.compare": "Statistics of ids",
    "analysis.load": "Bits and load of the bus",
    "live.ports": "Live ports",
    "live.config": "Live ports",
    "live.ring": "Live ports",
    "live.run": "Live ports",
    "timing.clocks": "Live ports",
    "adapters": "Adapters",
    "live.recording": "Recordings",
    "live.recorder": "Recordings",
    "recording.header": "Recordings",
    "simulation.simulator": "Simulation",
    "simulation.faults": "Simulation",
    "_frames": "Frames",
    "_items": "Frames",
    "analysis.times": "Frames",
    "_display": "Frames",
    "_protocols": "Protocols",
    "_core.table": "Protocols",
    "errors": "Errors and warnings",
}
ORDER = list(dict.fromkeys(SECTIONS.values()))


def write_pages(folder: Path) -> None:
    """Write all pages; those that are as they were keep their time."""
    folder.mkdir(exist_ok=True)
    pages = {
        "protocols.md": protocols(),
        "formats.md": formats(),
        "held.md": held(),
        "command-line.md": command_line(),
        "c-interface.md": c_interface(),
        "python.md": python(),
        "benchmarks.md": benchmarks(),
    }
    for name, lines in pages.items():
        text = "\n".join(lines).rstrip() + "\n"
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def protocols() -> Iterator[str]:
    """Yield the table of protocols, and the comment that opens each C file."""
    yield "| protocol | also called | frame, bytes | device clock | baud rate | bit rates |"
    yield "|---|---|---|---|---|---|"
    rows = [canser.protocol(name) for name in canser.protocols()]
    for row in rows:
        sizes = f"{row.frame_min} to {row.frame_max}"
        if row.frame_min == row.frame_max:
            sizes = str(row.frame_min)
        rates = "-"
        if row.bitrates:
            rates = f"{len(row.bitrates)}, {min(row.bitrates):,} to {max(row.bitrates):,}"
        yield (
            f"| [`{row.name}`](#{row.name}) | {', '.join(row.aliases) or '-'} | {sizes} "
            f"| {'yes' if row.has_clock else 'no'} | {row.baudrate:,} "
            f"| {rates} |"
        )
    for row in rows:
        source = (ROOT / "csrc" / "protocols" / f"{row.name}.c").read_text(encoding="utf-8")
        yield f"\n## {row.name}\n"
        yield "```text"
        yield from comment_lines(source)
        yield "```"


def comment_lines(source: str) -> list[str]:
    """Return the text of the first comment in C."""
    comment = re.search(r"/\*(.*?)\*/", source, re.DOTALL)
    assert comment
    lines = [re.sub(r"^ \* ?", "", line).rstrip() for line in comment[1].splitlines()]
    return [lines[0].strip(), *lines[1:]] if lines[0].strip() else lines[1:]


def formats() -> Iterator[str]:
    """Yield the table of file formats."""
    yield "| format | a file is | names | cannot hold |"
    yield "|---|---|---|---|"
    for name, each in BUILT_IN.items():
        suffixes = ", ".join(f"`{suffix}`" for suffix in each.suffixes) or "-"
        lost = "; ".join(each.cannot_hold) or "-"
        yield f"| `{name}` | {each.about} | {suffixes} | {lost} |"


# What formats may hold, with frames that tell: their values are looked at after they were written
# and read again.
_SECOND: Final = 1_000_000_000
_ODD: Final = np.zeros(6, canser.FRAME_DTYPE)
_ODD["id"] = [0x123, 0x123, 0x456, 0x80, 0x7FF, 0x1]
_ODD["ext"] = [True, False, False, False, False, True]
_ODD["rtr"] = [False, False, True, False, False, False]
_ODD["err"] = [False, False, False, True, False, False]
_ODD["dlc"] = [1, 0, 8, 8, 2, 1]
_ODD["data"][3] = range(8)
_ODD["ts"] = [1_767_225_600 * _SECOND + 1_000_000 * at for at in range(6)]
_ODD["ts"][4] += 1
_ODD["ts"][5] = canser.NO_TIME
_CHANNELS: Final = np.array([0, 1, 0, 1, 0, 1], np.uint8)
_DIRECTIONS: Final = np.array([0, 1, 0, 0, 1, 0], np.uint8)


def held() -> Iterator[str]:
    """Yield the table of what each format of frames holds, found by writing and reading."""
    names = [name for name in BUILT_IN if name not in ("raw", "pcapng")]
    yield (
        "| format | times in ns | unknown times | remote frames | error frames | their id and data "
        "| channels | directions |"
    )
    yield "|---|---|---|---|---|---|---|---|"
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in names:
            suffix = BUILT_IN[name].suffixes[0]
            marks = " | ".join("yes" if each else "-" for each in kept(Path(folder) / f"x{suffix}"))
            yield f"| `{name}` | {marks} |"


def kept(path: Path) -> tuple[bool, ...]:
    """Return what a file holds of `_ODD`, in the order of the columns."""
    canser.write(_ODD, path, channels=_CHANNELS, directions=_DIRECTIONS)
    channels, directions = np.zeros((2, 6), np.uint8)
    got = canser.read(path, channels=channels, directions=directions, epoch="file")
    by_kind = {kind: got.compress(got[kind]) for kind in ("rtr", "err")}
    error = by_kind["err"]
    known = got.compress(got["ts"] != canser.NO_TIME)
    return (
        bool((known["ts"] == _ODD["ts"][4]).any()),
        bool((got["ts"] == canser.NO_TIME).any()),
        [int(dlc) for dlc in by_kind["rtr"]["dlc"]] == [8],
        len(error) == 1,
        bool(len(error) and error["id"][0] == 0x80 and error["data"][0, 7] == 7),
        channels[: len(got)].tolist()[:2] == [0, 1],
        directions[: len(got)].tolist()[:2] == [0, 1],
    )


def command_line() -> Iterator[str]:
    """Yield the help of each command."""
    whole = parser(COMMANDS)
    yield from help_of("canser", whole)
    for action in whole._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, command in action.choices.items():
                yield from help_of(f"canser {name}", command)


def help_of(title: str, command: argparse.ArgumentParser) -> Iterator[str]:
    """Yield the help of one command under its name."""
    yield f"## {title}\n"
    yield "```text"
    yield command.format_help().rstrip()
    yield "```\n"


def c_interface() -> Iterator[str]:
    """Yield the declarations of canser.h, each under its comment."""
    header = (ROOT / "csrc" / "canser.h").read_text(encoding="utf-8")
    yield "```text"
    yield from comment_lines(header)
    yield "```\n"
    body = header[header.index("/* The time of a frame") : header.rindex("#ifdef __cplusplus")]
    for block in body.split("\n\n"):
        group = re.match(r"/\* ---- (.*?): (.*?)\*/", block, re.DOTALL)
        if group:
            what = " ".join(line.strip(" *") for line in group[2].splitlines())
            yield f"## {group[1]}\n\n{what.strip().capitalize()}\n"
        elif "cffi:" not in block:
            yield f"```c\n{block}\n```\n"


def benchmarks() -> Iterator[str]:
    """Yield bench/README.md; files that it links to are named only."""
    text = (ROOT / "bench" / "README.md").read_text(encoding="utf-8")
    yield re.sub(r"\[([^\]]+)\]\(\.\./[^)]+\)", r"\1", text)


def python() -> Iterator[str]:
    """Yield a directive for each public name, by sections."""
    sections: dict[str, list[str]] = defaultdict(list)
    for name in dir(canser):
        thing = getattr(canser, name)
        module = str(getattr(thing, "__module__", ""))
        if hasattr(thing, "__qualname__") and module.startswith("canser."):
            sections[SECTIONS[module.removeprefix("canser.")]].append(directive(name, thing))
    for heading in ORDER:
        yield f"## {heading}\n"
        yield from sections[heading]
    yield "## Pictures\n"
    yield from (directive(f"plots.{name}", getattr(plots, name)) for name in plots.__all__)


def directive(name: str, thing: object) -> str:
    """Return what makes Sphinx show a name with its docstring."""
    if not isinstance(thing, type):
        return f"```{{eval-rst}}\n.. autofunction:: canser.{name}\n```\n"
    options = "   :members:\n   :inherited-members: Exception, tuple, dict, object\n"
    return f"```{{eval-rst}}\n.. autoclass:: canser.{name}\n{options}```\n"
