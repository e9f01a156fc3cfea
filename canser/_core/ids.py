"""Frames by their ids: C's work for each frame, and its memory."""

import secrets
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canser._core._lib import ffi, lib
from canser._core.buffers import NULL, input_frames, raise_status
from canser._core.text import Codes
from canser._frames import FrameArray

__all__ = [
    "NO_ROW",
    "NO_STEP",
    "ROW_DTYPE",
    "STEP_BINS",
    "STEP_LIST",
    "Rows",
    "Runs",
    "order_rows",
    "runs_of",
]

NO_ROW: Final[int] = lib.CANSER_NO_ROW
NO_STEP: Final[int] = lib.CANSER_NO_STEP
STEP_BINS: Final[int] = lib.CANSER_STEP_BINS
STEP_LIST: Final[int] = lib.CANSER_STEP_LIST

# The struct canser_id.
ROW_DTYPE: Final[np.dtype[np.void]] = np.dtype(
    [
        ("id", np.uint32),
        ("ext", np.bool_),
        ("rtr", np.bool_),
        ("channel", np.uint8),
        ("err", np.bool_),
        ("data", np.uint8, (8,)),
        ("head", np.uint8, (8,)),
        ("first", np.int64),
        ("last", np.int64),
        ("moving", np.uint8, (8,)),
        ("changes", np.int64),
        ("remote", np.int64),
        ("steps", np.int64),
        ("breaks", np.int64),
        ("least", np.uint64),
        ("spread", np.uint64),
        ("longest_at", np.int64),
        ("sum", np.uint64),
        ("base", np.int64),
        ("run", np.uint32),
        ("list", np.uint32),
        ("listed", np.uint32),
        ("dlcs", np.uint32),
        ("early", np.uint64, (lib.CANSER_EARLY_STEPS,)),
    ],
    align=True,
)
for _name, _field in ffi.typeof("canser_id").fields:
    assert ROW_DTYPE.fields is not None
    assert ROW_DTYPE.fields[_name][1] == _field.offset, _name
assert ffi.sizeof("canser_id") == ROW_DTYPE.itemsize

# Rows at first, and the lists that are made together: their pages take memory only when they are
# written.
_FIRST_ROWS: Final = 128
_LISTS: Final = 64

_MOST: Final = 2 ** (8 * ffi.sizeof("size_t")) - 1

RowNumbers = npt.NDArray[np.uint32]
Steps = npt.NDArray[np.int64]


class Rows:
    """A row of statistics for each id, kind and channel; see canser_ids.

    `remote_apart`: remote frames have rows of their own. `keeps_steps`: keep a list or a histogram
    of the steps of each row. `rows_most`: the most rows.
    """

    def __init__(
        self, *, remote_apart: bool, keeps_steps: bool = False, rows_most: int | None = None
    ) -> None:
        self._ids = ffi.new("canser_ids *")
        self._ids.is_remote_apart = remote_apart
        self._ids.spread = secrets.randbits(64) | 1
        self._ids.row_most = _MOST if rows_most is None else rows_most
        self._used = ffi.new("size_t *")
        self._rows = np.zeros(0, ROW_DTYPE)
        self._lists: list[npt.NDArray[np.uint64]] = []
        self._keeps_steps = keeps_steps
        self._make_rows(_FIRST_ROWS)
        if keeps_steps:
            self._make_lists()

    def __len__(self) -> int:
        return int(self._ids.row_count)

    @property
    def rows(self) -> npt.NDArray[np.void]:
        """All rows in the order in which they appeared: ROW_DTYPE, good until the next `add`."""
        return self._rows[: len(self)]

    @property
    def others(self) -> int:
        """Frames without a row."""
        return int(self._ids.others)

    @property
    def unit_ns(self) -> int:
        """The greatest common divisor of the bus's first steps, in nanoseconds."""
        return int(self._ids.runs.unit)

    @property
    def bytes_kept(self) -> int:
        """Bytes of all arrays. Pages of lists that were not written take no memory yet."""
        return self._rows.nbytes + self._slots.nbytes + sum(made.nbytes for made in self._lists)

    @property
    def has_histograms(self) -> bool:
        """Whether the steps of a row are counted in a histogram."""
        return bool((self.rows["listed"] > STEP_LIST).any())

    def add(
        self,
        frames: FrameArray,
        channels: Codes | None = None,
        row_of: RowNumbers | None = None,
        steps: Steps | None = None,
    ) -> None:
        """Add contiguous frames; `row_of` and `steps`, as long as they, are filled."""
        row_at = NULL if row_of is None else ffi.from_buffer("uint32_t[]", row_of)
        steps_at = NULL if steps is None else ffi.from_buffer("int64_t[]", steps)

        def add(done: int, *rest: Any) -> int:
            at = (each and each + done for each in (row_at, steps_at))
            return int(lib.canser_ids_add(*rest, *at, self._used))

        self._walk(add, frames, channels)

    def group(self, frames: FrameArray) -> RowNumbers:
        """Return the row of each of contiguous frames; `breaks` of the rows counts them."""
        row_of = np.empty(len(frames), np.uint32)
        row_at = ffi.from_buffer("uint32_t[]", row_of)

        def group(done: int, *rest: Any) -> int:
            return int(lib.canser_ids_group(*rest, row_at + done, self._used))

        self._walk(group, frames, None)
        return row_of

    def _walk(self, step: Callable[..., int], frames: FrameArray, channels: Codes | None) -> None:
        """Call `step` until all frames are taken, with more room each time."""
        frames_at = input_frames(frames)
        channels_at = NULL if channels is None else ffi.from_buffer("uint8_t[]", channels)
        done, count = 0, len(frames)
        while done < count:
            told = channels_at and channels_at + done
            status = step(done, self._ids, frames_at + done, count - done, told)
            if status:
                raise_status(status)
            done += self._used[0]
            if done < count:
                self._make_room()

    def steps(self, index: int) -> npt.NDArray[np.uint64]:
        """Return the steps of a row as they are kept: a list, or a histogram of shape (bins, 2)."""
        row = self._rows[index]
        listed = int(row["listed"])
        if not row["list"]:
            early: npt.NDArray[np.uint64] = row["early"][:listed]
            return early
        kept = np.frombuffer(
            ffi.buffer(self._ids.lists[int(row["list"]) - 1], 8 * STEP_LIST), np.uint64
        )
        return kept[:listed] if listed <= STEP_LIST else kept.reshape(STEP_BINS, 2)

    def _make_room(self) -> None:
        if self._ids.row_count == self._ids.row_cap:
            self._make_rows(2 * self._ids.row_cap)
        if self._keeps_steps and self._ids.list_count + 1 >= self._ids.list_cap:
            self._make_lists()

    def _make_rows(self, count: int) -> None:
        rows = np.zeros(count, ROW_DTYPE)
        _as_bytes(rows)[: self._rows.nbytes] = _as_bytes(self._rows)
        self._rows, self._slots = rows, np.zeros(16 * count, np.uint32)
        self._ids.rows, self._ids.row_cap = ffi.from_buffer("canser_id[]", rows), count
        self._ids.slots = ffi.from_buffer("uint32_t[]", self._slots)
        self._ids.slot_cap = len(self._slots)
        status = lib.canser_ids_fill_slots(self._ids)
        if status:
            raise_status(status)

    def _make_lists(self) -> None:
        old, made = self._ids.list_cap, np.zeros((_LISTS, STEP_LIST), np.uint64)
        self._lists.append(made)
        pointers = ffi.new("uint64_t *[]", old + _LISTS)
        ffi.memmove(pointers, self._ids.lists, old * ffi.sizeof("uint64_t *"))
        for i in range(_LISTS):
            pointers[old + i] = ffi.from_buffer("uint64_t[]", made[i])
        self._pointers = pointers
        self._ids.lists, self._ids.list_cap = pointers, old + _LISTS


def order_rows(
    row_of: RowNumbers, starts: Steps, counts: Steps, steps: Steps | None = None
) -> Steps:
    """Return the numbers of frames by their rows, in the order in which they came; or their steps.

    `starts`: the place of each row's first one in the result. `counts`: how many each row has.
    """
    ordered, ends = np.empty(int(counts.sum()), np.int64), starts + counts
    status = lib.canser_order_rows(
        ffi.from_buffer("uint32_t[]", row_of),
        NULL if steps is None else ffi.from_buffer("int64_t[]", steps),
        len(row_of),
        ffi.from_buffer("int64_t[]", starts.copy()),
        ffi.from_buffer("int64_t[]", ends),
        len(starts),
        ffi.from_buffer("int64_t[]", ordered),
        len(ordered),
    )
    if status:
        raise_status(status)
    return ordered


class Runs:
    """The runs of a bus's times; see canser_runs.

    A run is a stretch of time without a jump of the clock and without a hole.
    """

    def __init__(self) -> None:
        self._runs = ffi.new("canser_runs *")

    @property
    def unit_ns(self) -> int:
        """The greatest common divisor of the first steps, in nanoseconds."""
        return int(self._runs.unit)

    def add(self, frames: FrameArray) -> RowNumbers:
        """Return the run that each of contiguous frames is in, 0 if its time is unknown or false.

        Frames at the end that a later call finds to be false have numbers above that of their run.
        """
        run_of = np.empty(len(frames), np.uint32)
        run_at = ffi.from_buffer("uint32_t[]", run_of)
        status = lib.canser_runs_add(self._runs, input_frames(frames), len(frames), run_at)
        if status:
            raise_status(status)
        return run_of


def runs_of(frames: FrameArray) -> RowNumbers:
    """Return the run that each of contiguous frames is in, 0 if its time is unknown or false."""
    return Runs().add(frames)


def _as_bytes(rows: npt.NDArray[np.void]) -> npt.NDArray[np.uint8]:
    return rows.view(np.uint8)
