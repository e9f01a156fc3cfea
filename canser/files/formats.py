"""The formats of files: those of canser, and those that other packages add.

A format is a module, or another object, with these attributes:

- `suffixes`: the suffixes of its files' names, such as `(".log",)`, the usual one first;
- `sniff(head)`: whether the first bytes of a file are clearly of this format;
- `read(source, options)`: returns a `Reader`, which reads in bounded memory;
- `write(file, options)`: returns a `Writer`; None for a format that canser only reads;
- `cannot_hold`: what the format has no place for, a text each;
- `about`: what a file of this format is, such as "a candump log".

Other packages add formats by entry points of the group `canser.formats`. The entry point has the
name of the format. There `read(file, name, add_remark)` takes a file that is open for reading
bytes, its name in messages, and a function. It yields arrays of FRAME_DTYPE. At the end it calls
`add_remark` with a text for each thing that the frames do not hold. `write(file)` returns a
`Writer`.
"""

import shlex
import warnings
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from canser._input import Input
from canser.errors import CanserWarning, ForeignFormatError
from canser.files.foreign import HEAD_LEN, TEXT, recognise
from canser.files.judge import is_auto, is_surely
from canser.files.packed import without_packing
from canser.files.reader import DecodedReader, Reader, ReadOptions
from canser.files.writer import WriteOptions, Writer
from canser.recording.header import starts_recording

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = [
    "BUILT_IN",
    "PCAPNG",
    "RAW",
    "Format",
    "choose_format",
    "find_format",
    "format_names",
    "format_of_name",
]

RAW: Final = "raw"
PCAPNG: Final = "pcapng"

_GROUP: Final = "canser.formats"


# For the attributes of a format see this module's docstring.
Format = Any


class _BuiltIn:
    """A format of canser. Its module is imported when it is asked for more than its suffixes."""

    def __init__(self, module: str, *suffixes: str) -> None:
        self._module = f"canser.files.{module}"
        self.suffixes = suffixes

    def __getattr__(self, name: str) -> Any:
        return getattr(import_module(self._module), name)


BUILT_IN: Final[dict[str, Format]] = {
    RAW: _BuiltIn("raw", ".bin", ".raw"),
    PCAPNG: _BuiltIn("recordings", ".pcapng"),
    "arrow": _BuiltIn("arrow", ".arrow", ".feather"),
    "asc": _BuiltIn("asc", ".asc"),
    "blf": _BuiltIn("blf", ".blf"),
    "candump": _BuiltIn("candump", ".log"),
    "csv": _BuiltIn("csv", ".csv"),
    "gvret": _BuiltIn("gvret", ".gvret.csv"),
    "mf4": _BuiltIn("mf4", ".mf4"),
    "npy": _BuiltIn("npy", ".npy"),
    "parquet": _BuiltIn("parquet", ".parquet"),
    "pcap": _BuiltIn("pcap", ".pcap"),
    "trc": _BuiltIn("trc", ".trc"),
}


class _Added:
    """A format that another package adds."""

    def __init__(self, name: str, module: Any) -> None:
        self._module = module
        self.about = str(getattr(module, "about", f"a {name} file"))
        self.suffixes = tuple(module.suffixes)
        self.cannot_hold = tuple(getattr(module, "cannot_hold", ()))
        self._name = name
        self.write = self._write if getattr(module, "write", None) is not None else None

    def sniff(self, head: bytes) -> bool:
        try:
            return bool(self._module.sniff(head))
        except Exception as error:  # noqa: BLE001 - a package of others may raise anything
            _warn(self._name, error)
            return False

    def read(self, source: Input, options: ReadOptions) -> Reader:
        return DecodedReader(source, options, self._module.read)

    def _write(self, file: BinaryIO, options: WriteOptions) -> Writer:  # noqa: ARG002
        writer: Writer = self._module.write(file)
        return writer


@cache
def _all() -> dict[str, Format]:
    """Return all formats by their names. A name of canser's formats cannot be taken over."""
    from importlib.metadata import entry_points  # noqa: PLC0415 - slow, and often not needed

    formats = dict(BUILT_IN)
    for point in entry_points(group=_GROUP):
        added = _load(point)
        if added is not None:
            formats.setdefault(point.name, added)
    return formats


def _load(point: "EntryPoint") -> Format | None:
    try:
        return _Added(point.name, point.load())
    except Exception as error:  # noqa: BLE001 - a package of others may raise anything
        _warn(point.name, error)
        return None


def _warn(name: str, error: Exception) -> None:
    """Warn that a format of another package does not work."""
    what = f"{type(error).__name__}: {error}"
    text = f"the format {name!r} of another package cannot be used: {what}"
    warnings.warn(text, CanserWarning, stacklevel=3)


def _in_turn(*, added: bool) -> Iterator[dict[str, Format]]:
    """Yield the formats of canser; and if none of these is the one, with `added` all formats."""
    yield BUILT_IN
    if added:
        yield _all()


def format_names() -> tuple[str, ...]:
    """Return the names of all formats."""
    return tuple(_all())


def find_format(name: str) -> Format:
    """Return the format with a name; ValueError if there is none."""
    found = BUILT_IN.get(name) if isinstance(name, str) else None
    if found is None and name in _all():
        found = _all()[name]
    if found is None:
        raise ValueError(f"unknown format {name!r}; have: {', '.join(_all())}")
    return found


def format_of_name(path: str) -> str | None:
    """Return the name of the format that has the suffix of a file's name, None if none has."""
    file_name = PurePath(without_packing(path)).name.lower()
    for formats in _in_turn(added="." in file_name):
        found = [
            (len(suffix), -place, name)
            for place, (name, each) in enumerate(formats.items())
            for suffix in each.suffixes
            if file_name.endswith(suffix) and file_name != suffix
        ]
        if found:  # the longest suffix, such as .gvret.csv; of equal ones that of the first format
            return max(found)[2]
    return None


def choose_format(source: Input, options: ReadOptions, given: str | None) -> str:
    """Return the name of a file's format: as given, or else by its content, or else by its name.

    Waits for as few bytes of a pipe as the answer needs. ForeignFormatError for a format that
    canser does not read, and for one that holds frames if a protocol of raw bytes is given.
    """
    if given is not None:
        find_format(given)
        return given
    if starts_recording(source):
        return PCAPNG
    given_raw = options.protocol is not None and not is_auto(options.protocol)
    forced = given_raw and not options.raw_only
    if forced and options.as_is:
        return RAW
    head = _head(source, wait=options.protocol is None)
    # Formats take long to import, and those of other packages to find. They are not asked about
    # bytes that are surely of the given protocol.
    sure = given_raw and is_surely(str(options.protocol), head)
    found = None if sure else _sniffed(head, added=not forced)
    if found is not None:
        if forced:
            what = f"{source.name} is {find_format(found).about}, not raw bytes"
            raise ForeignFormatError(f"{what}; leave the protocol out", what=what, option=found)
        return found
    foreign = recognise(head)
    by_name = format_of_name(source.name) if not forced else None
    if (
        foreign is not None
        and not options.as_is
        and (foreign is not TEXT or by_name in (None, RAW))
    ):
        what = f"{source.name} is {foreign.about}, not raw bytes"
        remedy = foreign.remedy.replace("FILE", shlex.quote(source.name))
        raise ForeignFormatError(f"{what}; {remedy}", what=what, option="")
    # The suffix .pcapng alone makes no recording; the reader of raw bytes reports what it finds.
    return RAW if by_name in (None, PCAPNG) else by_name


def _head(source: Input, *, wait: bool) -> bytes:
    """Return the first bytes of a file; of a pipe its first line, or what has arrived."""
    if source.size is None and wait:
        size = 1
        while len(source.at(0, size)) == size < HEAD_LEN:
            held = bytes(source.some(0))
            if b"\n" in held or BUILT_IN["pcap"].sniff(held):
                break
            size = len(held) + 1
    return bytes(source.some(0)[:HEAD_LEN])


def _sniffed(head: bytes, *, added: bool) -> str | None:
    for formats in _in_turn(added=added):
        for name, each in formats.items():
            if name != PCAPNG and each.sniff(head):
                return name
    return None
