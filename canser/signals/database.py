"""Databases: what the bytes of frames mean."""

import fnmatch
import os
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final

import numpy as np

from canser._checks import choice, flag, text
from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray
from canser.errors import CanserWarning
from canser.signals.dbc import load_file
from canser.signals.decoder import SignalDecoder
from canser.signals.encoder import encode_message
from canser.signals.layout import Layout
from canser.signals.messages import Message
from canser.signals.named import unknown_name
from canser.signals.signals import Signals

__all__ = ["Database"]

_MATCHES: Final = ("auto", "id", "pgn")

# Selections of signals whose tables are kept.
_LAYOUTS: Final = 8


class Database:
    """Messages and signals of database files: DBC, KCD, ARXML and SYM, as cantools reads them.

    Parameters
    ----------
    *paths : str or path-like
        One file or several. Where two files have a message with the same id or the same name, that
        of the first one counts, and a CanserWarning tells.
    match : {"auto", "id", "pgn"}
        How the message of a frame is found. "auto": by its id; else an extended one by its
        parameter group number, among the messages of J1939. These are those that the database
        marks as such, and those whose id has the source address FE, which stands for any sender.
        "id": by the id alone. "pgn": as "auto", but all messages with extended ids are of J1939.
    encoding : str, optional
        The encoding of the files. By default UTF-8 if the text is that, else cp1252.

    Attributes
    ----------
    messages : mapping of str to Message
        All messages by their names.
    left_out : mapping of str to str
        Messages and signals that cannot be decoded, such as messages of more than 8 bytes, and
        why.

    Raises
    ------
    FormatError
        A file is no database, or damaged. The message names the line.
    ImportError
        cantools is not installed.
    OSError
        A file cannot be read.

    Examples
    --------
    >>> db = canser.Database("car.dbc")
    >>> db
    <canser.Database: 4 messages, 10 signals>
    >>> frames = canser.frames("0A0#1027983A00000003", "0A0#7427983A00000004")
    >>> rpm = db.decode(frames)["RPM"]
    >>> rpm.values
    array([2000., 2020.])
    >>> rpm.unit
    'rpm'
    """

    def __init__(
        self,
        *paths: str | os.PathLike[str],
        match: str = "auto",
        encoding: str | None = None,
    ) -> None:
        choice(match, "match", _MATCHES)
        if not paths:
            raise TypeError("no file is given; give one or more, such as Database('car.dbc')")
        messages: dict[str, Message] = {}
        ids: dict[tuple[int, bool], Message] = {}
        left_out: dict[str, str] = {}
        for path in paths:
            loaded = load_file(path, encoding, match)
            left_out |= loaded.left_out
            for message in loaded.messages:
                other = messages.get(message.name) or ids.get((message.id, message.ext))
                if other and replace(message, path=other.path) == other:
                    continue
                if other:
                    why = f"{other.path} has {other.name} with the id {other.id:X}"
                    left_out[message.name] = why
                    _warn_of_twice(message, why)
                    continue
                messages[message.name] = ids[message.id, message.ext] = message
        self.messages: Mapping[str, Message] = MappingProxyType(messages)
        self.left_out: Mapping[str, str] = MappingProxyType(left_out)
        self._layouts: dict[tuple[frozenset[str] | None, bool], Layout] = {}

    def __repr__(self) -> str:
        count = sum(len(message.signals) for message in self.messages.values())
        return f"<canser.Database: {len(self.messages):,} messages, {count:,} signals>"

    def decode(
        self,
        frames: FrameArray,
        names: Iterable[str] | str | None = None,
        *,
        raw: bool = False,
        out: Signals | None = None,
    ) -> Signals:
        """Decode frames.

        Nothing stops it: frames without a message, frames that are too short, and unknown values
        of multiplexers are counted in `signals.report`. Values outside of the range that the
        database tells are decoded like others.

        Parameters
        ----------
        frames : array of FRAME_DTYPE, shape (n,)
            The frames, contiguous or not. A message is found by its id, on every channel.
        names : str or list of str, optional
            The signals: "Message.Signal", "Signal", "Message" for all of its signals, with * and ?
            for any characters. All that are named are in the result, perhaps without samples. By
            default all signals that have samples.
        raw : bool
            Whether `signal.raw` has the values before scale and offset. By default only signals
            with texts have them.
        out : Signals, optional
            What an earlier call returned: its arrays are used again where they are large enough,
            so they change. By default all arrays are new.

        Returns
        -------
        Signals
            The signals by their names, and the report.

        Raises
        ------
        TypeError
            `frames` is no array of FRAME_DTYPE.
        ValueError
            No signal has one of the names.

        Examples
        --------
        >>> db = canser.Database("car.dbc")
        >>> frames = canser.frames("0A0#1027983A00000003", "124#00")
        >>> signals = db.decode(frames)
        >>> list(signals)
        ['EngineData.RPM', 'EngineData.CoolantTemp', 'EngineData.Gear']
        >>> print(signals.report)
        1 of 2 frames belong to a message
        1 have an id that no message has: 124
        3 messages were never seen: WheelSpeeds, Power, Speed
        """
        return self.decoder(names, raw=raw).feed(frames, out=out)

    def decoder(
        self, names: Iterable[str] | str | None = None, *, raw: bool = False
    ) -> SignalDecoder:
        """Return a decoder for blocks of a file, or for batches of a port.

        Parameters
        ----------
        names, raw
            As in `decode`.

        Returns
        -------
        SignalDecoder
            Its method `feed` takes frames.

        Raises
        ------
        ValueError
            No signal has one of the names.

        Examples
        --------
        >>> decoder = canser.Database("car.dbc").decoder("RPM")
        >>> for data in ("1027983A00000003", "7427983A00000004"):
        ...     print(decoder.feed(canser.frames(f"0A0#{data}"))["RPM"].values)
        [2000.]
        [2020.]
        """
        flag(raw, "raw")
        selected = None if names is None else self._find(names)
        return SignalDecoder(self._layout(selected, keeps_raw=raw))

    def encode(self, messages: Mapping[str, Mapping[str, float | str]]) -> FrameArray:
        """Make frames from values of signals.

        Parameters
        ----------
        messages : mapping of str to mapping
            For each message the values of its signals: physical values, or texts of its value
            tables. Signals that a multiplexer does not select are not needed.

        Returns
        -------
        array of FRAME_DTYPE, shape (n,)
            A data frame for each message, in their order, without a time. Bits of no signal are 0.

        Raises
        ------
        ValueError
            There is no such message or signal, a signal is missing, or a value does not fit.

        Examples
        --------
        >>> db = canser.Database("car.dbc")
        >>> values = {"RPM": 2000, "CoolantTemp": 35, "Gear": "first"}
        >>> canser.show(db.encode({"EngineData": values}))
        (0.000000) can0 0A0#1027983A00000003
        1 frame; a time that is not known is shown as 0
        """
        frames = np.zeros(len(messages), FRAME_DTYPE)
        for frame, (name, values) in zip(frames, messages.items(), strict=True):
            if name not in self.messages:
                raise ValueError(unknown_name(name, "message", self.messages))
            encode_message(self.messages[name], values, frame)
        frames["ts"] = NO_TIME
        return frames

    def _layout(self, selected: frozenset[str] | None, *, keeps_raw: bool) -> Layout:
        """Return the tables for these signals; the last ones are kept, as they take time."""
        key = selected, keeps_raw
        if key not in self._layouts:
            layout = Layout(tuple(self.messages.values()), selected=selected, keeps_raw=keeps_raw)
            self._layouts = dict([*self._layouts.items(), (key, layout)][-_LAYOUTS:])
            return layout
        return self._layouts[key]

    def _find(self, names: Iterable[str] | str) -> frozenset[str]:
        """Return the full names of the signals that are named."""
        full = [
            f"{message.name}.{name}"
            for message in self.messages.values()
            for name in message.signals
        ]
        found: set[str] = set()
        for pattern in [names] if isinstance(names, str) else names:
            text(pattern, "a name", "'EngineData.RPM'")
            matching = [each for each in full if _is_named(each, pattern)]
            if not matching:
                raise ValueError(unknown_name(pattern, "signal", full))
            found.update(matching)
        return frozenset(found)


def _is_named(full: str, pattern: str) -> bool:
    message, _, name = full.rpartition(".")
    return any(fnmatch.fnmatchcase(each, pattern) for each in (full, name, message))


def _warn_of_twice(message: Message, why: str) -> None:
    warnings.warn(
        f"{message.path}: message {message.name} is left out, as {why}",
        CanserWarning,
        stacklevel=3,
    )
