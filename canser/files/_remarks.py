"""What a file says of its frames and a frame has no room for: counted, and told at the end."""

import warnings
from collections.abc import Callable, Iterable
from typing import Final

from canser.errors import CanserWarning, FormatError

__all__ = ["Tell", "Unkept", "tell_all"]

# Takes a remark on a file, a line without the file's name.
Tell = Callable[[str], object]

# A bus has few interfaces. A damaged file has other names without end: beyond this number they
# are counted together.
_NAMES_MOST: Final = 16

# Stands for those: no name has a line end.
_MORE: Final = "\n"

# Characters of a name that are shown; an interface of Linux has 15 at most.
_SHOWN: Final = 32

# How programs write the direction. What has none was received.
_DIRECTIONS: Final = {
    "": "received", "r": "received", "rx": "received", "t": "sent", "tx": "sent",
}  # fmt: skip


class Unkept:
    """Counts what the lines of a text say of frames, and FRAME_DTYPE has no field for."""

    def __init__(self, bus: str | None = None) -> None:
        self.bus = bus  # that is read, None for all
        self._other_buses: dict[str, int] = {}  # frames of those that are not read
        self.raw_dlcs = 0  # frames with a raw dlc of 9 to 15, which is 8 bytes
        self.nuls = 0  # bytes at the end of the file
        self.columns: list[str] = []  # names of columns that are not read
        # Frames by channel and direction; None where the format has no such word.
        self._counts: dict[tuple[str | None, str | None], int] = {}

    def is_other_bus(self, channel: str | None) -> bool:
        """Return whether a frame is of a bus that is not read; it is counted."""
        if self.bus is None or channel == self.bus:
            return False
        name = channel or ""
        if name not in self._other_buses and len(self._other_buses) >= _NAMES_MOST:
            name = _MORE
        self._other_buses[name] = self._other_buses.get(name, 0) + 1
        return True

    def check_bus(self, name: str) -> None:
        """Raise FormatError if the file has frames, and none of the bus that is read."""
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
        """Return a name to count by: its own, or the one for all beyond the most."""
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
        """Return what a caller should know, a line each."""
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
    """Return names and counts, those beyond the most at the end."""
    more = counts.pop(_MORE, 0)
    shown = [f"{_printable(name)} {count:,}" for name, count in counts.items()]
    return ", ".join([*shown, f"and more {more:,}"] if more else shown)


def _printable(name: str) -> str:
    """Return a name of a file as a terminal may show it: nothing empty, no control codes."""
    cut = name if len(name) <= _SHOWN else f"{name[:_SHOWN]}..."
    return cut if cut and cut.isprintable() else ascii(cut)


def tell_all(remarks: Iterable[str], name: str, tell: Tell | None) -> None:
    """Hand remarks on a file to `tell`, or warn of them where that is None."""
    for remark in remarks:
        if tell is None:
            # Up to where the generator that calls this is asked for its next block.
            warnings.warn(f"{name}: {remark}", CanserWarning, stacklevel=3)
        else:
            tell(remark)
