"""Count what a file says of its frames and FRAME_DTYPE has no field for; report it at the end."""

import warnings
from collections.abc import Callable, Iterable
from typing import Final

from canser.errors import CanserWarning, FormatError

__all__ = ["AddRemark", "Unkept", "report_remarks"]

# Takes a remark about a file: a line of text without the file's name.
AddRemark = Callable[[str], object]

# Names that are counted one by one: channels and directions. A log of real buses has fewer.
# Otherwise a damaged file, with a new name in each line, would need memory without bound.
_NAMES_MOST: Final = 16

# Key that counts all names beyond `_NAMES_MOST`. No name has a line end.
_MORE: Final = "\n"

# Characters of a name that are shown. Names of Linux interfaces have at most 15 characters.
_SHOWN: Final = 32

# How programs write the direction. A frame without one was received.
_DIRECTIONS: Final = {
    "": "received", "r": "received", "rx": "received", "t": "sent", "tx": "sent",
}  # fmt: skip


class Unkept:
    """Counts what the lines of a text say of frames and FRAME_DTYPE has no field for."""

    def __init__(self, bus: str | None = None) -> None:
        self.bus = bus  # the bus to read, None for all
        self._other_buses: dict[str, int] = {}  # frames of each bus that is not read
        self.raw_dlcs = 0  # frames with a raw dlc of 9 to 15, which is 8 bytes
        self.nuls = 0  # NUL bytes at the end of the file
        self.columns: list[str] = []  # names of columns that are not read
        # Frames by channel and direction; None if the format does not have the word.
        self._counts: dict[tuple[str | None, str | None], int] = {}

    def is_other_bus(self, channel: str | None) -> bool:
        """Return whether a frame is of a bus that is not read, and count such a frame."""
        if self.bus is None or channel == self.bus:
            return False
        name = channel or ""
        if name not in self._other_buses and len(self._other_buses) >= _NAMES_MOST:
            name = _MORE
        self._other_buses[name] = self._other_buses.get(name, 0) + 1
        return True

    def check_bus(self, name: str) -> None:
        """Raise FormatError if the file has frames, but none of the bus to read."""
        if self._other_buses and not self._counts:
            raise FormatError(
                f"{name} has no frame of the bus {self.bus}; it has {_listed(self._other_buses)}"
            )

    def add(self, channel: str | None, direction: str | None) -> None:
        """Count a frame."""
        try:
            self._counts[channel, direction] += 1
        except KeyError:
            key = self._known(channel, 0), self._known(direction, 1)
            self._counts[key] = self._counts.get(key, 0) + 1

    def _known(self, name: str | None, place: int) -> str | None:
        """Return the key to count a name by: the name itself, or `_MORE` if there are too many."""
        known = {key[place] for key in self._counts}
        return name if name in known or len(known) < _NAMES_MOST else _MORE

    def _by(self, place: int) -> dict[str, int]:
        """Return the frames by channel (place 0) or by direction (1)."""
        counts: dict[str, int] = {}
        for key, count in self._counts.items():
            name = key[place]
            if name is not None:
                shown = _DIRECTIONS.get(name.lower(), name) if place == 1 else name
                counts[shown] = counts.get(shown, 0) + count
        return counts

    def remarks(self) -> list[str]:
        """Return the remarks, a line each."""
        remarks = []
        channels, directions = self._by(0), self._by(1)
        if len(channels) > 1:
            number = f"more than {_NAMES_MOST}" if _MORE in channels else str(len(channels))
            remarks.append(f"frames of {number} channels become one: {_listed(channels)}")
        if self._other_buses:
            left_out = sum(self._other_buses.values())
            remarks.append(f"frames of other buses, left out: {left_out:,}")
        if directions.keys() - {"received"}:
            remarks.append(f"direction is not kept: {_listed(directions)}")
        if self.raw_dlcs:
            remarks.append(f"raw dlcs of 9 to 15 become 8: {self.raw_dlcs:,}")
        if self.columns:
            shown = [_printable(name) for name in self.columns[:_NAMES_MOST]]
            more = ["and more"] if len(self.columns) > _NAMES_MOST else []
            remarks.append(f"columns that are not read: {', '.join([*shown, *more])}")
        if self.nuls:
            remarks.append(
                f"ends in {self.nuls:,} NUL bytes; was the power cut? Frames may be missing"
            )
        return remarks


def _listed(counts: dict[str, int]) -> str:
    """Return names and counts as text, with the count of `_MORE` at the end."""
    more = counts.pop(_MORE, 0)
    shown = [f"{_printable(name)} {count:,}" for name, count in counts.items()]
    return ", ".join([*shown, f"and more {more:,}"] if more else shown)


def _printable(name: str) -> str:
    """Return a name from a file so that a terminal can show it: not empty, no control codes."""
    cut = name if len(name) <= _SHOWN else f"{name[:_SHOWN]}..."
    return cut if cut and cut.isprintable() else ascii(cut)


def report_remarks(remarks: Iterable[str], name: str, add_remark: AddRemark | None) -> None:
    """Pass the remarks about a file to `add_remark`; without one, warn of each."""
    for remark in remarks:
        if add_remark is None:
            # The warning points to the code that asks the calling generator for its next block.
            warnings.warn(f"{name}: {remark}", CanserWarning, stacklevel=3)
        else:
            add_remark(remark)
