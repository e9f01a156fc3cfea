"""What a database says about messages and signals: plain values, of any file format."""

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["Message", "SignalInfo", "pgn_of"]

# The source address that stands for any sender in the ids of a J1939 database.
_ANY_SENDER = 0xFE


@dataclass(frozen=True, kw_only=True)
class SignalInfo:
    """What a database says about a signal, given by `Message.signals`.

    Attributes
    ----------
    name : str
        The name.
    start, bit_count : int
        Where it lies in the data: the first bit as DBC files count them, and the number of bits.
    is_big_endian, is_signed, is_float : bool
        What the bits are.
    scale, offset : int or float
        The physical value is raw * scale + offset.
    minimum, maximum : int, float or None
        The range that the database tells. Values outside of it are decoded like others.
    unit, comment : str
        "" if there is none.
    choices : mapping of int to str, or None
        The texts of raw values.
    multiplexer : str or None
        The signal whose value selects this one. None: it is always there.
    pages : tuple of int
        The values of the multiplexer that select it.
    is_multiplexer : bool
        Whether its value selects other signals.
    """

    name: str
    start: int
    bit_count: int
    is_big_endian: bool
    is_signed: bool
    is_float: bool
    scale: float
    offset: float
    minimum: float | None
    maximum: float | None
    unit: str
    comment: str
    choices: Mapping[int, str] | None
    multiplexer: str | None
    pages: tuple[int, ...]
    is_multiplexer: bool

    @property
    def last_bit(self) -> int:
        """The number of bits of data up to its last one; a shorter frame does not have it."""
        first = self.start
        if self.is_big_endian:
            # DBC files number the bits of each byte from its lowest one.
            first = 8 * (self.start // 8) + 7 - self.start % 8
        return first + self.bit_count


@dataclass(frozen=True, kw_only=True)
class Message:
    """What a database says about a message, given by `Database.messages`.

    Attributes
    ----------
    name : str
        The name.
    id : int
        The arbitration id.
    ext : bool
        Whether the id is an extended one.
    length : int
        Bytes of data, 0 to 8.
    pgn : int or None
        For J1939: the parameter group number, by which its frames are found.
    comment : str
        "" if there is none.
    signals : mapping of str to SignalInfo
        Its signals by their names.
    path : str
        The file that it comes from.
    """

    name: str
    id: int
    ext: bool
    length: int
    pgn: int | None
    comment: str
    signals: Mapping[str, SignalInfo]
    path: str

    @property
    def is_of_any_sender(self) -> bool:
        """Whether the id has the source address that stands for any sender."""
        return self.ext and self.id & 0xFF == _ANY_SENDER


def pgn_of(identifier: int) -> int:
    """Return the parameter group number of an extended id, as SAE J1939-21 defines it."""
    pgn = identifier >> 8 & 0x3FFFF
    # Below 240 the low byte is the destination.
    return pgn if (pgn >> 8) & 0xFF >= 240 else pgn & 0x3FF00
