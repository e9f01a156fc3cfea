"""Database files, read by cantools; with a way on where it refuses an entry."""

import logging
import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

from canser.errors import CanserWarning, FormatError
from canser.signals.messages import Message, SignalInfo, pgn_of

__all__ = ["LoadedFile", "load_file"]

# Formats by the end of the name; for other names cantools finds out.
_FORMATS: Final = {".dbc": "dbc", ".kcd": "kcd", ".arxml": "arxml", ".sym": "sym"}

# Entries of a DBC file that are skipped at most. Each one costs another look at the file.
_SKIPPED_MOST: Final = 50

# Entries that a file may do without: texts, attributes, and signals, which are then missing.
# Without others, such as types of floats, values would be wrong.
_SKIPPABLE: Final = ("VAL_", "VAL_TABLE_", "CM_", "BA_", "BA_DEF_", "BA_DEF_DEF_", "SIG_GROUP_")

_DATA_BITS: Final = 64


class LoadedFile(NamedTuple):
    """What a file has: messages, and the names of those left out, each with the reason."""

    messages: list[Message]
    left_out: dict[str, str]


def load_file(path: str | os.PathLike[str], encoding: str | None, match: str) -> LoadedFile:
    """Read a file. `encoding` None: UTF-8 if the text is that, else cp1252. `match`: see Database.

    FormatError if cantools refuses the file; ImportError without it.
    """
    name = os.fspath(path)
    loaded = _load(name, encoding)
    found = LoadedFile([], {})
    names, ids = set(), set()
    for each in loaded.messages:
        key = each.frame_id, each.is_extended_frame
        reason = ""
        if each.name in names:
            reason = "another message of the file has the same name"
        elif key in ids:
            reason = f"another message of the file has the id {each.frame_id:X}, too"
        elif each.length > 8:
            reason = f"it has {each.length} bytes, which is no frame of classic CAN"
        if reason:
            found.left_out[each.name] = reason
            continue
        names.add(each.name)
        ids.add(key)
        signals = dict(_signals(each, found.left_out))
        found.messages.append(
            Message(
                name=each.name,
                id=each.frame_id,
                ext=each.is_extended_frame,
                length=each.length,
                pgn=_pgn(each, match),
                comment=each.comment or "",
                signals=signals,
                path=name,
            )
        )
    return found


def _pgn(message: Any, match: str) -> int | None:
    if match == "id" or not message.is_extended_frame:
        return None
    is_group = message.protocol == "j1939" or message.frame_id & 0xFF == 0xFE
    return pgn_of(message.frame_id) if match == "pgn" or is_group else None


def _signals(message: Any, left_out: dict[str, str]) -> Iterator[tuple[str, SignalInfo]]:
    """Yield the signals of a message that can be decoded."""
    names = set()
    multiplexers = {each.name for each in message.signals if each.is_multiplexer}
    for each in message.signals:
        signal = _signal(each)
        reason = ""
        if each.name in names:
            reason = "another signal of the message has the same name"
        elif signal.last_bit > _DATA_BITS or signal.start < 0:
            reason = "it has bits past the 8 bytes of a frame"
        elif signal.is_float and signal.bit_count not in (16, 32, 64):
            reason = f"it is a float of {signal.bit_count} bits"
        elif signal.pages and signal.multiplexer not in multiplexers:
            reason = "its multiplexer is not in the message"
        if reason:
            left_out[f"{message.name}.{each.name}"] = reason
            continue
        names.add(each.name)
        yield each.name, signal


def _signal(signal: Any) -> SignalInfo:
    choices = signal.choices
    return SignalInfo(
        name=signal.name,
        start=signal.start,
        bit_count=signal.length,
        is_big_endian=signal.byte_order == "big_endian",
        is_signed=signal.is_signed,
        is_float=signal.is_float,
        scale=signal.scale,
        offset=signal.offset,
        minimum=signal.minimum,
        maximum=signal.maximum,
        unit=signal.unit or "",
        comment=signal.comment or "",
        choices={raw: str(text) for raw, text in choices.items()} if choices else None,
        multiplexer=signal.multiplexer_signal,
        pages=tuple(sorted(signal.multiplexer_ids or ())),
        is_multiplexer=signal.is_multiplexer,
    )


# ---- Reading by cantools.


def _load(name: str, encoding: str | None) -> Any:
    try:
        from cantools.database import load_string  # noqa: PLC0415 - an optional extra
        from cantools.database.errors import Error  # noqa: PLC0415 - an optional extra
    except ImportError:
        raise ImportError(
            f"{name} needs cantools, which is not installed: pip install 'canser[dbc]'"
        ) from None
    raw = Path(name).read_bytes()
    kind = _FORMATS.get(Path(name).suffix.lower())
    text = _decoded(raw, encoding, name, kind)
    lines = text.splitlines()
    skipped: list[str] = []
    while True:
        try:
            with _quiet():
                found = load_string("\n".join(lines) + "\n", kind, strict=False)
            break
        except (Error, KeyError, ValueError, TypeError) as error:
            reason = _reason(error)
            place = _place(reason, lines)
            entry = _entry(reason, lines) if kind == "dbc" else []
            at = f"{name}: " if place is None else f"{name}: line {place + 1}: "
            if not entry or len(skipped) >= _SKIPPED_MOST:
                raise FormatError(f"{at}{reason}") from None
            for line in entry:
                skipped.append(f"line {line + 1} ({reason})")
                lines[line] = ""
    if not hasattr(found, "messages"):
        raise FormatError(f"{name}: a database of diagnostics, which has no messages")
    if skipped:
        warnings.warn(
            f"{name}: skipped what cantools refuses: {', '.join(skipped)}",
            CanserWarning,
            stacklevel=4,
        )
    return found


def _decoded(raw: bytes, encoding: str | None, name: str, kind: str | None) -> str:
    if encoding is not None:
        try:
            return raw.decode(encoding)
        except UnicodeDecodeError as error:
            raise FormatError(
                f"{name}: byte {error.start} is not {encoding}; give another encoding="
            ) from None
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        if kind in ("kcd", "arxml"):
            raise FormatError(f"{name}: the file is not UTF-8; give encoding=") from None
        return raw.decode("cp1252", "replace")


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep cantools from logging what is told in `left_out`."""
    logger = logging.getLogger("cantools")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def _reason(error: Exception) -> str:
    """Return why cantools refuses a file, in a line."""
    text = " ".join(str(error).split())
    # It puts the format in front, and the text in quotes.
    found = re.fullmatch(r'[A-Z]+: "(.*)"', text)
    return found[1] if found else text


def _place(reason: str, lines: list[str]) -> int | None:
    """Return the line of what cantools refuses, from 0, or None."""
    found = re.search(r"at line (\d+), column", reason)
    if found:
        return int(found[1]) - 1
    entry = _entry(reason, lines)
    return entry[0] if entry else None


def _entry(reason: str, lines: list[str]) -> list[int]:
    """Return the lines of entries that cantools refuses and that can be skipped, from 0."""
    found = re.search(r"unused (VAL_|SIG_VALTYPE_) entries in DBC: (.*)", reason)
    if found:
        # Entries of signals that are not there: nothing is lost with them.
        keys = re.findall(rf"{found[1]} (\d+) (\w+)", found[2])
        wanted = {(found[1], *key) for key in keys}
        starts = (line.replace(":", " ").split()[:3] for line in lines)
        return [at for at, start in enumerate(starts) if tuple(start) in wanted]
    found = re.search(r"The signal (\w+) length 0 .* in message (\w+)", reason)
    if found:
        message = _message_lines(lines, found[2])
        return [at for at in message if re.match(rf"\s*SG_\s+{found[1]}\b", lines[at])]
    found = re.search(r"frame id .* in message (\w+)", reason)
    if found:
        return _message_lines(lines, found[1])
    found = re.search(r"at line (\d+), column", reason)
    if not found or int(found[1]) > len(lines):
        return []
    at = int(found[1]) - 1
    words = lines[at].split()
    if words and words[0] == "SG_":
        return [at]
    is_whole = lines[at].rstrip().endswith(";") and lines[at].count('"') % 2 == 0
    return [at] if words and words[0] in _SKIPPABLE and is_whole else []


def _message_lines(lines: list[str], name: str) -> list[int]:
    """Return the lines of a message and its signals."""
    for first, line in enumerate(lines):
        if re.match(rf"\s*BO_\s+\d+\s+{name}\s*:", line):
            end = first + 1
            while end < len(lines) and lines[end].lstrip().startswith("SG_"):
                end += 1
            return list(range(first, end))
    return []
