"""Writers: the options of writing, and the interface of all formats."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import tzinfo
from typing import BinaryIO, Protocol, cast

from canser._frames import FrameArray

__all__ = ["WriteOptions", "Writer", "give", "patchable"]


@dataclass(frozen=True, kw_only=True, slots=True)
class WriteOptions:
    """How a file is to be written."""

    #: Protocol of raw bytes and of a recording; None for formats that hold frames.
    protocol: str | None = None
    #: Unit of the device's timestamps in raw bytes.
    ts_unit: str = "ms"
    #: Whether frames that the protocol cannot carry are an error; otherwise they are left out.
    strict: bool = False
    #: Names of channels by their codes, as the files that are read have them; more may come.
    channel_names: Mapping[int, str] = field(default_factory=dict)
    #: Time zone of dates without one; None for local time.
    tz: tzinfo | None = None
    #: Name of the file; "" if it has none.
    name: str = ""


class Writer(Protocol):
    """Writes frames into a file.

    A writer with the attribute `takes_tags` also takes the channels and directions of frames:
    `write(frames, channels, directions)`, each an array of uint8 or None. A method `abandon`, if
    there is one, is called after an error instead of `finish`.
    """

    def write(self, frames: FrameArray) -> None:
        """Append frames."""

    def finish(self) -> list[str]:
        """Write what completes the file; return remarks on what it could not hold."""


def patchable(file: BinaryIO) -> BinaryIO:
    """Return a file in which one can seek back to the header: this one, or a temporary one.

    At the end `give` hands the bytes over.
    """
    if file.seekable():
        return file
    import tempfile  # noqa: PLC0415 - slow, and seldom needed

    return cast(BinaryIO, tempfile.TemporaryFile())


def give(made: BinaryIO, file: BinaryIO) -> None:
    """Copy the bytes of a file that `patchable` made for another one, such as a pipe."""
    if made is not file:
        made.seek(0)
        shutil.copyfileobj(made, file, 1 << 20)
        made.close()
