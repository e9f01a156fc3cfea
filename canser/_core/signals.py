"""Signals in the data of frames: C's work for each frame, and its memory."""

import secrets
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser._core._lib import ffi, lib
from canser._core.buffers import input_frames, raise_status
from canser._frames import FrameArray

__all__ = [
    "CASE_DTYPE",
    "FLOATS",
    "GROUP_DTYPE",
    "KNOWN_ID_DTYPE",
    "MUX_DEPTH",
    "MUX_DTYPE",
    "NO_MESSAGE",
    "NO_TABLE",
    "PAGE_DTYPE",
    "PGN_DTYPE",
    "SCALED",
    "SIGNAL_DTYPE",
    "WHOLE",
    "SignalTables",
    "find_spread",
]

NO_MESSAGE: Final[int] = lib.CANSER_NO_MESSAGE
NO_TABLE: Final[int] = lib.CANSER_NO_TABLE
MUX_DEPTH: Final[int] = lib.CANSER_MUX_DEPTH
_BLOCK: Final[int] = lib.CANSER_SIGNAL_BLOCK

# The kinds of signals; floats by their number of bits.
WHOLE: Final[int] = lib.CANSER_SIGNAL_WHOLE
SCALED: Final[int] = lib.CANSER_SIGNAL_SCALED
FLOATS: Final[dict[int, int]] = {
    16: lib.CANSER_SIGNAL_FLOAT16,
    32: lib.CANSER_SIGNAL_FLOAT32,
    64: lib.CANSER_SIGNAL_FLOAT64,
}


def _struct(name: str) -> np.dtype[np.void]:
    """Return the dtype of a struct of C; a pointer is a number."""
    fields = dict(ffi.typeof(name).fields)
    return np.dtype(
        {
            "names": list(fields),
            "formats": [_format(field.type) for field in fields.values()],
            "offsets": [field.offset for field in fields.values()],
            "itemsize": ffi.sizeof(name),
        }
    )


def _format(kind: Any) -> Any:
    if kind.kind == "struct":
        return _struct(kind.cname)
    if kind.kind == "array":
        return (_format(kind.item), (kind.length,))
    if kind.kind == "pointer":
        return f"u{ffi.sizeof(kind)}"
    if kind.cname == "double":
        return np.float64
    unsigned = int(ffi.cast(kind, -1)) > 0
    return f"{'u' if unsigned else 'i'}{ffi.sizeof(kind)}"


SIGNAL_DTYPE: Final = _struct("canser_signal")
GROUP_DTYPE: Final = _struct("canser_group")
PAGE_DTYPE: Final = _struct("canser_page")
MUX_DTYPE: Final = _struct("canser_mux")
CASE_DTYPE: Final = _struct("canser_case")
KNOWN_ID_DTYPE: Final = _struct("canser_known_id")
PGN_DTYPE: Final = _struct("canser_pgn")

# The types of a database's fields, by their names.
_POINTERS: Final = {name: field.type for name, field in ffi.typeof("canser_database").fields}

# Ids that are kept at most. Only noise has so many: then their places take up to 128 MiB.
_IDS_MOST: Final = 1 << 20

# Numbers that are tried to spread the ids of a database.
_TRIES: Final = 50

Records = npt.NDArray[np.void]

# The first page of each frame.
Routes = npt.NDArray[np.uint16]


def _places(id_count: int) -> int:
    """Return the places of a table of ids: at least 4 for each."""
    return max(64, 1 << (4 * id_count).bit_length())


def find_spread(keys: npt.NDArray[np.uint32]) -> int:
    """Return a random number that spreads these ids over their places, so that few meet.

    Where two meet, the processor cannot guess where the search for one of them ends.
    """
    tried = []
    for _ in range(_TRIES):
        spread = secrets.randbits(32) | 1
        places = (keys * np.uint32(spread)).astype(np.uint64) * _places(len(keys)) >> 32
        tried.append((len(keys) - len(np.unique(places)), spread))
        if not tried[-1][0]:
            break
    return min(tried)[1]


class SignalTables:
    """A database as tables of C, and all that is counted; see canser_database.

    `ids` are the ids of its messages, `spread` is what `find_spread` returns for them. All arrays
    are of the dtypes above.
    """

    def __init__(
        self,
        *,
        ids: Records,
        pgns: Records,
        pages: Records,
        muxes: Records,
        cases: Records,
        links: npt.NDArray[np.uint32],
        tables: npt.NDArray[np.uint16],
        spread: int,
    ) -> None:
        self.pages = pages.copy()
        #: The frames of each page by their dlc.
        self.dlcs = np.zeros((len(pages), 9), np.uint64)
        constant: dict[str, npt.NDArray[Any]] = {
            "pgns": pgns,
            "muxes": muxes,
            "cases": cases,
            "links": links,
            "tables": tables,
        }
        self._constant = constant
        self._database = database = ffi.new("canser_database *")
        self._point("pages", self.pages)
        self._point("dlcs", self.dlcs)
        self._cursors = np.empty(len(pages), np.uintp)
        self._point("cursors", self._cursors)
        for name, array in constant.items():
            self._point(name, array)
        database.pgn_count = len(pgns)
        database.page_count = len(pages)
        database.id_count = len(ids)
        database.spread = spread
        database.id_most = max(_IDS_MOST, 2 * len(ids))
        self._used = ffi.new("size_t *")
        # Ids are put in their places by moving them out of a table in which they are in a row.
        self._ids = ids
        self._point("ids", ids)
        database.id_cap = len(ids)
        self._move_ids()

    @property
    def unknown_ids(self) -> Records:
        """The ids without a message that are kept, of KNOWN_ID_DTYPE, in no order."""
        ids: Records = self._ids[self._ids["page"] == NO_MESSAGE]
        return ids

    @property
    def remote_count(self) -> int:
        """Remote frames."""
        return int(self._database.remote_count)

    @property
    def error_count(self) -> int:
        """Error frames."""
        return int(self._database.error_count)

    @property
    def other_count(self) -> int:
        """Frames without a message whose id is not kept."""
        return int(self._database.other_count)

    def count(self, frames: FrameArray) -> tuple[Routes, npt.NDArray[np.uint64]]:
        """Count contiguous frames: in `unknown_ids`, `dlcs` and `pages`.

        Returns where each belongs, and how many of these frames each page has by their dlc, an
        array of shape (pages, 9).
        """
        before = self.dlcs.copy()
        routes = np.empty(len(frames), np.uint16)
        frames_at, routes_at = input_frames(frames), ffi.from_buffer("uint16_t[]", routes)
        done = 0
        while True:
            rest = len(frames) - done
            self._check(
                lib.canser_database_count(
                    self._database, frames_at + done, rest, routes_at + done, self._used
                )
            )
            done += self._used[0]
            if done == len(frames):
                return routes, self.dlcs - before
            self._move_ids()

    def decode(self, frames: FrameArray, routes: Routes, groups: Records, signals: Records) -> None:
        """Decode contiguous frames into the columns that groups and signals point to.

        `routes` is what `count` returned. The groups of a page are those that `pages` names.
        """
        # Blocks of a power of two bytes would meet in few places of the processor's cache.
        blocks = np.empty((len(groups), 2 * _BLOCK + 8), np.uint64)
        groups["block"] = blocks.ctypes.data + np.arange(len(groups)) * blocks.strides[0]
        self._point("groups", groups)
        self._point("signals", signals)
        self._database.group_count = len(groups)
        self._check(
            lib.canser_database_decode(
                self._database,
                input_frames(frames),
                len(frames),
                ffi.from_buffer("uint16_t[]", routes),
            )
        )

    def _move_ids(self) -> None:
        cap = _places(self._database.id_count)
        ids = np.zeros(cap, KNOWN_ID_DTYPE)
        at = ffi.from_buffer("canser_known_id[]", ids)
        self._check(lib.canser_database_move_ids(self._database, at, cap))
        self._ids = ids

    def _point(self, name: str, array: npt.NDArray[Any]) -> None:
        setattr(self._database, name, ffi.cast(_POINTERS[name], array.ctypes.data))

    @staticmethod
    def _check(status: int) -> None:
        if status == lib.CANSER_RANGE:
            raise RuntimeError("frames were changed while they were decoded; pass a copy")
        if status:
            raise_status(status)
