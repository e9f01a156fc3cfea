"""Writers: the options of writing, and the interface of all formats."""

from dataclasses import dataclass
from typing import Protocol

from canser._frames import FrameArray

__all__ = ["WriteOptions", "Writer"]


@dataclass(frozen=True, kw_only=True, slots=True)
class WriteOptions:
    """How a file is to be written."""

    #: Protocol of raw bytes and of a recording; None for formats that hold frames.
    protocol: str | None = None
    #: Unit of the device's timestamps in raw bytes.
    ts_unit: str = "ms"
    #: Whether frames that the protocol cannot carry are an error; otherwise they are left out.
    strict: bool = False


class Writer(Protocol):
    """Writes frames into a file."""

    def write(self, frames: FrameArray) -> None:
        """Append frames."""

    def finish(self) -> list[str]:
        """Write what completes the file; return remarks on what it could not hold."""
