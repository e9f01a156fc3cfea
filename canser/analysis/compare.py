"""What differs between two drives: `canser.compare`."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser._frames import FrameArray
from canser.analysis.ids import IdStatsArray, id_stats
from canser.analysis.names import id_text
from canser.analysis.plain import to_plain

__all__ = ["Comparison", "compare"]

_Records = npt.NDArray[np.void]

# What tells an id: the fields by which the rows of two drives are put together.
_KEY: Final = ("id", "ext", "rtr", "err")
_KEY_FIELDS: Final = [("id", np.uint32), *((name, np.bool_) for name in _KEY[1:])]

IDS_DTYPE: Final[np.dtype[np.void]] = np.dtype(
    [*_KEY_FIELDS, ("found_in", "U4"), ("count_a", np.int64), ("count_b", np.int64)], align=True
)
BITS_DTYPE: Final[np.dtype[np.void]] = np.dtype(
    [*_KEY_FIELDS, ("byte", np.uint8), ("bit", np.uint8), ("moves_in", "U1")], align=True
)
TIMING_DTYPE: Final[np.dtype[np.void]] = np.dtype(
    [
        *_KEY_FIELDS,
        ("pattern_a", "U8"),
        ("pattern_b", "U8"),
        ("period_a_ns", np.float64),
        ("period_b_ns", np.float64),
        ("jitter_a_ns", np.float64),
        ("jitter_b_ns", np.float64),
        ("missing_a", np.float64),
        ("missing_b", np.float64),
    ],
    align=True,
)

# A period that differs by less than this part is the same: a crystal is off by less than 0.01 %,
# and the times of an adapter by a few steps, which the median mostly takes out.
_PERIOD_SAME: Final = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """What differs between the frames of two drives, a and b; returned by `compare`.

    `str` of it is the text that `canser compare` prints.

    Notes
    -----
    Each row has the fields `id` (uint32), `ext`, `rtr` and `err` (bool). The other fields are:

    - of `ids`: `found_in` ("a", "b" or "both"), `count_a` and `count_b` (int64), the frames;
    - of `bits`: `byte` (uint8, 0 to 7), `bit` (uint8, 0 for the lowest), `moves_in` ("a" or "b");
    - of `timing`: `pattern_a`, `period_a_ns`, `jitter_a_ns`, `missing_a`, and the same of b; see
      `canser.id_stats`.
    """

    #: A row for each id of either, shape (n,).
    ids: _Records
    #: A row for each bit of the data that moves in one of them only, shape (n,): of ids in both.
    bits: _Records
    #: A row for each id in both that is periodic, or comes in bursts, in one of them, shape (n,).
    timing: _Records

    @property
    def only_a(self) -> _Records:
        """The rows of `ids` that are in a only."""
        return self.ids.compress(self.ids["found_in"] == "a")

    @property
    def only_b(self) -> _Records:
        """The rows of `ids` that are in b only: what is new."""
        return self.ids.compress(self.ids["found_in"] == "b")

    @property
    def retimed(self) -> _Records:
        """The rows of `timing` whose pattern differs, or whose periods differ by over 2 %."""
        timing = self.timing
        a, b = timing["period_a_ns"], timing["period_b_ns"]
        near = np.abs(b - a) <= _PERIOD_SAME * np.minimum(a, b)
        return timing.compress((timing["pattern_a"] != timing["pattern_b"]) | ~near)

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def lines(self) -> Iterator[str]:
        """Yield the text line by line.

        Yields
        ------
        str
            A line of text, without a line end.
        """
        of_a, of_b = len(self.only_a), len(self.only_b)
        both = len(self.ids) - of_a - of_b
        yield f"ids        {both:,} in both, {of_a:,} in A only, {of_b:,} in B only"
        for row in [*self.only_a, *self.only_b]:
            name, count = id_text(row), row["count_a"] + row["count_b"]
            yield f"           {name:>8} in {row['found_in'].upper()} only, {count:,} frames"
        yield f"bits       {len(self.bits):,} move in one only"
        for name, drive, places in _places_by_id(self.bits):
            yield f"           {name:>8} in {drive.upper()} only: {places}"
        retimed = self.retimed
        yield f"timing     {len(retimed):,} of {len(self.timing):,} ids differ"
        for row in retimed:
            a, b = (_pace(row, drive) for drive in "ab")
            yield f"           {id_text(row):>8} {a} in A, {b} in B"

    def as_dict(self) -> dict[str, Any]:
        """Return all as values that JSON has, as `canser compare --json` prints them.

        Returns
        -------
        dict
            `ids`, `bits` and `timing`: lists of dicts with the fields of a row. What is not known
            is None.
        """
        plain: dict[str, Any] = to_plain(self)
        return plain


def _places_by_id(bits: _Records) -> Iterator[tuple[str, str, str]]:
    """Yield each id and drive with the bits that move there only, as text."""
    places: dict[tuple[str, str], list[str]] = {}
    for row in bits:
        key = id_text(row), str(row["moves_in"])
        places.setdefault(key, []).append(f"{row['byte']}.{row['bit']}")
    for (name, drive), each in places.items():
        yield name, drive, "byte.bit " + " ".join(each)


def _pace(row: np.void, drive: str) -> str:
    pattern, period = str(row[f"pattern_{drive}"]), float(row[f"period_{drive}_ns"])
    return pattern if np.isnan(period) else f"{pattern} {period / 1e6:,.2f} ms"


def compare(
    a: FrameArray | Iterable[FrameArray], b: FrameArray | Iterable[FrameArray]
) -> Comparison:
    """Compare the frames of two drives: which ids, which bits, and which periods differ.

    Parameters
    ----------
    a, b : array of FRAME_DTYPE, shape (n,), or iterable of such arrays
        The frames of each drive, as for `canser.id_stats`.

    Returns
    -------
    Comparison
        Three arrays of records. `str` of it is a text.

    Raises
    ------
    TypeError
        `a` or `b` is no array of FRAME_DTYPE and no iterable of them.
    ValueError
        A shape is not (n,).

    Examples
    --------
    >>> found = canser.compare(canser.frames("123#00", "124#"), canser.frames("123#00", "123#04"))
    >>> found.only_a["id"]
    array([292], dtype=uint32)
    >>> print(found)
    ids        1 in both, 1 in A only, 0 in B only
                    124 in A only, 1 frames
    bits       1 move in one only
                    123 in B only: byte.bit 0.2
    timing     0 of 0 ids differ
    """
    return compare_stats(id_stats(a), id_stats(b))


def compare_stats(a: IdStatsArray, b: IdStatsArray) -> Comparison:
    """Return what differs between the rows of two drives."""
    rows_a, rows_b = ({row[[*_KEY]].item(): row for row in rows} for rows in (a, b))
    keys = sorted({*rows_a, *rows_b}, key=lambda key: (key[3], key[1], key[0], key[2]))
    shared = [key for key in keys if key in rows_a and key in rows_b]
    ids = [
        (*key, _found_in(key in rows_a, key in rows_b), _count(rows_a, key), _count(rows_b, key))
        for key in keys
    ]
    bits = [
        (*key, byte, bit, drive)
        for key in shared
        for byte, bit, drive in _moving(rows_a[key]["moving"], rows_b[key]["moving"])
    ]
    names = ("pattern", "period_ns", "jitter_ns", "missing")
    timing = [
        (*key, *(row[name] for name in names for row in (rows_a[key], rows_b[key])))
        for key in shared
        if not np.isnan([rows_a[key]["period_ns"], rows_b[key]["period_ns"]]).all()
    ]
    return Comparison(
        _frozen(ids, IDS_DTYPE), _frozen(bits, BITS_DTYPE), _frozen(timing, TIMING_DTYPE)
    )


def _found_in(in_a: bool, in_b: bool) -> str:
    return "both" if in_a and in_b else "a" if in_a else "b"


def _count(rows: dict[Any, np.void], key: Any) -> int:
    return int(rows[key]["count"]) if key in rows else 0


def _moving(a: npt.NDArray[np.uint8], b: npt.NDArray[np.uint8]) -> Iterator[tuple[int, int, str]]:
    """Yield the bits that move in one of two drives."""
    for byte, (of_a, of_b) in enumerate(zip(a.tolist(), b.tolist(), strict=True)):
        for bit in range(8):
            if (of_a ^ of_b) >> bit & 1:
                yield byte, bit, "a" if of_a >> bit & 1 else "b"


def _frozen(rows: list[tuple[Any, ...]], dtype: np.dtype[np.void]) -> _Records:
    array = np.array(rows, dtype)
    array.flags.writeable = False
    return array
