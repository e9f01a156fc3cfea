"""Arithmetic on the times of frames: arrivals, and the line from a device's clock to the host's."""

from canser._core._lib import ffi, lib
from canser._core.buffers import OFFSET_DTYPES, Offsets, Times, check_array, raise_status


def find_arrivals(
    pieces: Times, byte_ns: float, offsets: Offsets, arrivals: Times, *, end: int, reach: int
) -> None:
    """Set `arrivals` to when the frames at these offsets had come.

    `pieces`: the offset behind each and its time, in turn. See canser_times_arrivals.
    """
    check_array(offsets, "offsets", OFFSET_DTYPES, "np.empty(n, np.int64)")
    if len(offsets) != len(arrivals):
        raise ValueError(f"there are {len(offsets)} offsets for {len(arrivals)} frames")
    status = lib.canser_times_arrivals(
        ffi.from_buffer("canser_piece[]", pieces),
        len(pieces) // 2,
        byte_ns,
        ffi.from_buffer("int64_t[]", offsets),
        len(offsets),
        end,
        reach,
        ffi.from_buffer("int64_t[]", arrivals),
    )
    if status:
        raise_status(status)


def find_ranked(values: Times, rank: int) -> tuple[int, int, int]:
    """Return the value that has this many below it, the lowest and the highest one."""
    ranked = ffi.new("canser_ranked *")
    status = lib.canser_times_rank(ffi.from_buffer("int64_t[]", values), len(values), rank, ranked)
    if status:
        raise_status(status)
    return ranked.value, ranked.low, ranked.high


def find_lowest(values: Times, rank: int) -> int:
    """Return where the value stands that has this many below it, a few; the first of equal ones."""
    index = ffi.new("size_t *")
    status = lib.canser_times_lowest(ffi.from_buffer("int64_t[]", values), len(values), rank, index)
    if status:
        raise_status(status)
    return int(index[0])


class ClockLine:
    """The line from device times to host times: what a device's clock stands at.

    `early`: how far a device time may lie before those of the past, and a host time behind
    its arrival. `latest`: no host time lies before this one. See canser_times_map.
    """

    def __init__(self, early: int, latest: int) -> None:
        self._line = ffi.new("canser_line *")
        self._trust = ffi.new("canser_trust *", {"early": early})
        self._latest = ffi.new("int64_t *", latest)

    def set(self, device: int, host: int, drift: float) -> None:
        """Have the host's time be `host` when the device's is `device`."""
        self._line.device, self._line.host, self._line.drift = device, host, drift

    def floor_at(self, latest: int) -> None:
        """Let no host time come before this one."""
        self._latest[0] = latest

    def find_residuals(self, device: Times, arrivals: Times, residuals: Times) -> None:
        """Set `residuals` to how far arrivals lie above the line, in nanoseconds."""
        status = lib.canser_times_heights(
            self._line,
            ffi.from_buffer("int64_t[]", device),
            ffi.from_buffer("int64_t[]", arrivals),
            len(residuals),
            ffi.from_buffer("int64_t[]", residuals),
        )
        if status:
            raise_status(status)

    def map(self, device: Times, times: Times, reached: int, late: int) -> None:
        """Turn arrivals into host times, in place.

        `reached`: a device time of the past. `late`: how far a host time may lie before its
        arrival.
        """
        self._trust.reached, self._trust.late = reached, late
        status = lib.canser_times_map(
            self._line,
            self._trust,
            ffi.from_buffer("int64_t[]", device),
            len(times),
            ffi.from_buffer("int64_t[]", times),
            self._latest,
        )
        if status:
            raise_status(status)
