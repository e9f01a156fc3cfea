"""The decoders that canser is compared with: numpy alone, a loop in numba, python-can.

Each takes a clean stream: what `canser.encode` makes, frame behind frame without a
byte between them. Run as a program, it checks them and prints their speeds.
"""

import argparse
import functools
import importlib
import io
import struct
import time
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

import canser
import data
from canser._frames import FrameArray

Bytes = npt.NDArray[np.uint8]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]
Decode = Callable[[Bytes, FrameArray], int]

_START, _SERIAL_END, _SEEED_END = 0xAA, 0xBB, 0x55

# numpy works on so many bytes at a time: what it makes of them stays in the cache,
# and there are enough frames that the calls themselves do not count.
_CHUNK = 1 << 19

# Room around a chunk, so that one gather may take more than the frame.
_BEFORE, _BEHIND = 8, 32

# By the dlc: the bytes that count in a payload of eight.
_PAYLOAD = np.array([(1 << 8 * n) - 1 for n in range(9)] + [0] * 7, np.uint64)

# By the type byte of seeed: the length of the frame, the bytes that an extended id
# has more, the second word of the record, the mask of the payload, the id's place
# and the bits that it must not have.
_TYPE = np.arange(256)
_LENGTH = np.where(
    (_TYPE >= 0xC0) & (_TYPE & 0xF <= 8), 5 + (_TYPE & 0xF) + (_TYPE >> 4 & 2), 0
).astype(np.uint8)
_MORE = (_TYPE >> 4 & 2).astype(np.uint8)
_META = (_TYPE >> 5 & 1 | (_TYPE >> 4 & 1) << 8 | (_TYPE & 0xF) << 16).astype(np.uint32)
_KEPT = np.where(_TYPE & 0x10, np.uint64(0), _PAYLOAD[_TYPE & 0xF])
_ID_SHIFT = np.where(_TYPE & 0x20, 0, 16).astype(np.uint32)
_ID_BAD = np.where(_TYPE & 0x20, 0xE000_0000, 0xFFFF_F800).astype(np.uint32)

# cantalope is walked by many lanes side by side, one numpy operation for a step of
# all. They start so many bytes ahead: by then chains from different places have met.
_LANES, _LANE_BYTES, _WARM_BYTES = 2000, 1200, 120

# glibc hands large arrays back to the system, and numpy's temporaries would cost a page
# fault every 4 KiB in every call. Once a block of this size is freed it keeps them.
np.empty(30 << 20, np.uint8)


_SERIAL_HEAD = struct.Struct("<BIBI")


def struct_serial(raw: bytes) -> list[tuple[int, int, bytes]]:
    """Decode `serial` by a loop as it is written by hand: a tuple for each frame."""
    frames = []
    pos = 0
    while pos + 11 <= len(raw):
        start, time_ms, dlc, number = _SERIAL_HEAD.unpack_from(raw, pos)
        end = pos + 10 + dlc
        if start != _START or dlc > 8 or end >= len(raw) or raw[end] != _SERIAL_END:
            pos += 1
            continue
        frames.append((time_ms, number, raw[pos + 10 : end]))
        pos = end + 1
    return frames


def numpy_serial(raw: Bytes, out: FrameArray) -> int:
    """Decode `serial` with numpy alone; return the number of frames."""
    words4, words8 = _words(out)
    ts: Ints = out["ts"]
    count = pos = 0
    exact = False
    last, turned = None, 0  # the counter of the last frame, and the ticks in its turns
    while pos < len(raw):
        around, size = _around(raw, pos, _CHUNK)
        chunk = around[_BEFORE:]
        marked = _behind_end(chunk, size, _SERIAL_END)
        marked &= chunk[5 : len(marked) + 5] <= 8
        at = _where(marked, exact)
        dlc, flags = chunk[5:].take(at), chunk[9:].take(at)
        length = dlc + np.uint8(11)
        special = bool((flags & 0x60).any())
        if special:  # a remote frame without payload
            rows = np.flatnonzero(flags & 0x40)
            rows = rows[chunk[at[rows] + 10] == _SERIAL_END]
            length[rows] = 11
        at, end, (dlc, flags) = _first_come(at, length, dlc, flags)
        if not _linked(chunk, at, end, _SERIAL_END):
            exact = _retry(exact)
            continue
        exact = False
        new = slice(count, count + len(at))
        count += len(at)
        pos += int(end[-1])

        # From six bytes ahead, all but the time lies on its alignment.
        rows24 = _gather(around, _BEFORE - 6, at, 24)
        found4, found8 = rows24.view(np.uint32), rows24.view(np.uint64)
        flagged = found4[:, 3]
        np.bitwise_and(flagged, 0x1FFF_FFFF, out=words4[new, 0])
        np.multiply(dlc, 1 << 16, out=words4[new, 1], dtype=np.uint32)
        np.greater(flagged & 0x9FFF_FFFF, 0x7FF, out=out["ext"][new])
        payload = _PAYLOAD.take(dlc)
        if special:
            rows = np.flatnonzero(flags & 0x60)
            remote = flags[rows] & 0x40 != 0
            out["rtr"][new][rows] = remote
            out["err"][new][rows] = flags[rows] & 0x20 != 0
            payload[rows[remote]] = 0
        np.bitwise_and(found8[:, 2], payload, out=words8[new, 1])

        counter = found4[:, 2] << np.uint32(8)
        counter |= found4[:, 1] >> 24
        ticks, turned = _unwrap(counter, last, turned)
        last = counter[-1]
        np.multiply(ticks, 1_000_000, out=ts[new])
    return count


def numpy_seeed(raw: Bytes, out: FrameArray) -> int:
    """Decode `seeed` with numpy alone; return the number of frames."""
    words4, words8 = _words(out)
    count = pos = 0
    exact = False
    while pos < len(raw):
        around, size = _around(raw, pos, _CHUNK)
        chunk = around[_BEFORE:]
        marked = _behind_end(chunk, size, _SEEED_END)
        marked &= chunk[1 : len(marked) + 1] >= 0xC0
        at = _where(marked, exact)
        kind = chunk[1:].take(at)
        length = _LENGTH.take(kind)
        remote = kind & 0x10
        if remote.any():  # a remote frame without payload
            rows = np.flatnonzero(remote)
            header = 4 + _MORE[kind[rows]]
            rows = rows[chunk[at[rows] + header] == _SEEED_END]
            length[rows] = 5 + _MORE[kind[rows]]
        at, end, (kind,) = _first_come(at, length, kind)
        linked = _linked(chunk, at, end, _SEEED_END)
        if linked:
            # Such that the payload, behind either kind of id, lies on its alignment.
            rows16 = _gather(around, _BEFORE - 4, at + _MORE.take(kind), 16)
            ids = rows16.view(np.uint32)[:, 1] >> _ID_SHIFT.take(kind)
            linked = not (ids & _ID_BAD.take(kind)).any()
        if not linked:
            exact = _retry(exact)
            continue
        exact = False
        new = slice(count, count + len(at))
        count += len(at)
        pos += int(end[-1])
        words4[new, 0] = ids
        words4[new, 1] = _META.take(kind)
        np.bitwise_and(rows16.view(np.uint64)[:, 1], _KEPT.take(kind), out=words8[new, 1])
        out["ts"][new] = canser.NO_TIME
    return count


def numpy_cantalope(raw: Bytes, out: FrameArray) -> int:
    """Decode `cantalope` with numpy alone; return the number of frames."""
    words4, words8 = _words(out)
    count = pos = 0
    while pos < len(raw):
        around, size = _around(raw, pos, _LANES * _LANE_BYTES)
        starts = _walk(around[_BEFORE:], size)
        for at in np.array_split(starts, len(starts) // 16384 + 1):
            rows16 = _gather(around, _BEFORE - 6, at, 16)
            head = rows16.view(np.uint32)[:, 1]
            low = (head >> 24).astype(np.uint8)
            dlc = low & 0xF
            if dlc.max() > 8:
                raise ValueError("not a clean stream")
            new = slice(count, count + len(at))
            count += len(at)
            np.bitwise_or(head >> 13 & 0x7F8, low >> 5, out=words4[new, 0])
            words4[new, 1] = _META.take(low & 0x1F)
            np.bitwise_and(rows16.view(np.uint64)[:, 1], _KEPT.take(low), out=words8[new, 1])
            out["ts"][new] = canser.NO_TIME
        pos += int(at[-1]) + 2 + int(dlc[-1])
    if pos > len(raw):
        raise ValueError("not a clean stream")
    return count


def _words(out: FrameArray) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.uint64]]:
    """Return the records as rows of words: fewer columns to write than fields."""
    return out.view(np.uint32).reshape(-1, 6), out.view(np.uint64).reshape(-1, 3)


def _around(raw: Bytes, pos: int, size: int) -> tuple[Bytes, int]:
    """Return a chunk with room around it, zeros past the stream's ends, and its size."""
    low, high = pos - _BEFORE, pos + size + _BEHIND
    around = raw[max(low, 0) : high]
    if low < 0 or high > len(raw):
        around = np.pad(around, (max(-low, 0), max(high - len(raw), 0)))
    return around, min(size, len(raw) - pos)


def _gather(around: Bytes, first: int, at: Ints, width: int) -> npt.NDArray[Any]:
    """Return the bytes from `first + at` on, one row each."""
    # Overlapping items of a void type: a memcpy a row, and no index of every byte.
    items: npt.NDArray[np.void] = np.ndarray(
        (len(around) - first - width + 1,), f"V{width}", around, first, (1,)
    )
    return items[at].view(np.uint8).reshape(-1, width)


def _behind_end(chunk: Bytes, size: int, end_mark: int) -> Bools:
    """Mark the start marks that stand behind an end mark, or at the chunk's start."""
    marked: Bools = chunk[: -(-size // 4) * 4] == _START
    marked[1:] &= chunk[: len(marked) - 1] == end_mark
    marked[size:] = False
    return marked


def _where(marked: Bools, exact: bool) -> Ints:
    """Return the positions marked; at most one of four aligned ones, unless `exact`."""
    # numpy searches sparse marks by memchr, one call a mark, and dense ones without a
    # branch. So make them dense: four to a word. The product is the place in the word.
    if exact:
        return np.flatnonzero(marked)
    fours = marked.view(np.uint32)
    at = np.flatnonzero(fours != 0)
    place = fours.take(at)
    place *= np.uint32(0x00010203)
    place >>= 24
    at <<= 2
    at += place
    return at


def _first_come(at: Ints, length: Bytes, *more: Bytes) -> tuple[Ints, Ints, Sequence[Bytes]]:
    """Drop the positions inside the frames of others; return the rest, and the ends."""
    end = at + length
    while (clash := at[1:] < end[:-1]).any():
        # Of a run of clashes the first frame stays, and what clashes with it goes.
        drop = np.flatnonzero(clash & ~np.concatenate(([False], clash[:-1]))) + 1
        at, end = np.delete(at, drop), np.delete(end, drop)
        more = tuple(np.delete(x, drop) for x in more)
    return at, end, more


def _linked(chunk: Bytes, at: Ints, end: Ints, end_mark: int) -> bool:
    """Return whether each frame starts where the one before ends, and all are whole."""
    # Between two frames the end mark was seen together with the start mark.
    return bool(
        len(at)
        and at[0] == 0
        and chunk[0] == _START
        and at[-1] < end[-1] <= len(chunk)
        and chunk[end[-1] - 1] == end_mark
        and (at[1:] == end[:-1]).all()
    )


def _unwrap(
    counter: npt.NDArray[np.uint32], last: np.uint32 | None, turned: int
) -> tuple[Ints, int]:
    """Return the ticks of counters by signed differences, and those in whole turns."""
    ticks = counter.astype(np.int64)
    if last is None:
        last = counter[0]
    rising = counter[0] >= last and (counter[1:] >= counter[:-1]).all()
    if turned or not rising or counter[-1] - last >= 1 << 31:
        steps = np.diff(counter, prepend=last).view(np.int32)
        np.cumsum(steps, dtype=np.int64, out=ticks)
        ticks += turned + int(last)
    return ticks, int(ticks[-1]) - int(counter[-1])


def _retry(exact: bool) -> bool:
    """Ask for an exact search, unless there was one."""
    if exact:
        raise ValueError("not a clean stream")
    return True


def _walk(chunk: Bytes, size: int) -> Ints:
    """Return where the frames of a chunk of `cantalope` start."""
    lanes = max(1, size // _LANE_BYTES)
    stop: Ints = np.arange(1, lanes + 1) * size // lanes
    start = np.concatenate(([0], stop[:-1]))
    at = start - _WARM_BYTES
    at[0] = 0
    while (behind := at < start).any():
        at = np.where(behind, _step(chunk, at), at)

    rows, end = _lanes(chunk, at, stop)
    # Where a lane does not start at the end of the one before, it goes again from there.
    while (wrong := np.flatnonzero(at[1:] != end[:-1]) + 1).size:
        at[wrong] = end[wrong - 1]
        again, end[wrong] = _lanes(chunk, at[wrong], stop[wrong])
        if len(again) > len(rows):
            rows = np.pad(rows, ((0, len(again) - len(rows)), (0, 0)), constant_values=size)
        rows[: len(again), wrong] = again
        rows[len(again) :, wrong] = size
    by_lane = np.ascontiguousarray(rows.T)
    return by_lane[by_lane < stop[:, None]]


def _step(chunk: Bytes, at: Ints) -> Ints:
    dlc = chunk[1:].take(at, mode="clip")
    dlc &= 0xF
    dlc += 2
    return at + dlc


def _lanes(chunk: Bytes, at: Ints, stop: Ints) -> tuple[Ints, Ints]:
    """Walk from `at` until all lanes are at their stops; return the steps and the ends."""
    rows = [at]
    while (at < stop).any():
        at = _step(chunk, at)
        rows.append(at)
    steps = np.array(rows)
    return steps, np.where(steps < stop, np.iinfo(np.int64).max, steps).min(axis=0)


NUMPY: dict[str, Decode] = {
    "cantalope": numpy_cantalope,
    "seeed": numpy_seeed,
    "serial": numpy_serial,
}


@functools.cache
def numba_loop(protocol: str) -> Decode:
    """Return a loop that decodes `protocol`, compiled at its first call."""
    numba: Any = importlib.import_module("numba")
    jit = numba.njit(nogil=True, cache=False)
    loop = jit(_LOOPS[protocol])

    def decode(raw: Bytes, out: FrameArray) -> int:
        payload = _words(out)[1][:, 1]
        fields = (out[name] for name in ("id", "ext", "rtr", "dlc", "err"))
        return int(loop(raw, (*fields, payload, out["ts"])))

    return decode


# What numba compiles: a loop as one writes it, with every check, one byte on after
# a reject. Two things make it twice as fast: unsigned indices, for a signed one may
# count from the end, and a payload read and written as one number.
_at = np.uintp
_u4, _u8 = np.uint32, np.uint64


def _loop_serial(raw: Any, fields: Any) -> Any:
    ids, ext, rtr, dlcs, err, payload, ts = fields
    count = pos = 0
    size = len(raw)
    ticks = np.int64(0)
    last = _u4(0)
    while pos + 11 <= size:
        dlc = int(raw[_at(pos + 5)])
        if raw[_at(pos)] != 0xAA or dlc > 8:
            pos += 1
            continue
        flagged = _u4(0)
        counter = _u4(0)
        for k in range(4):
            flagged |= _u4(raw[_at(pos + 6 + k)]) << _u4(8 * k)
            counter |= _u4(raw[_at(pos + 1 + k)]) << _u4(8 * k)
        remote = flagged & _u4(0x4000_0000) != 0
        sent = 0 if remote and raw[_at(pos + 10)] == 0xBB else dlc
        if pos + 11 + sent > size or raw[_at(pos + 10 + sent)] != 0xBB:
            pos += 1
            continue
        word = _u8(0)
        if pos + 18 <= size:
            for k in range(8):
                word |= _u8(raw[_at(pos + 10 + k)]) << _u8(8 * k)
            word &= _PAYLOAD[_at(dlc)]
        else:
            for k in range(sent):
                word |= _u8(raw[_at(pos + 10 + k)]) << _u8(8 * k)
        if count == 0:
            ticks = np.int64(counter)
        else:
            ticks += np.int64(np.int32(counter - last))
        last = counter
        row = _at(count)
        plain = flagged & _u4(0x1FFF_FFFF)
        ids[row] = plain
        ext[row] = (flagged & _u4(0x8000_0000) != 0) | (plain > 0x7FF)
        rtr[row] = remote
        dlcs[row] = dlc
        err[row] = flagged & _u4(0x2000_0000) != 0
        payload[row] = _u8(0) if remote else word
        ts[row] = ticks * 1_000_000
        count += 1
        pos += 11 + sent
    return count


def _loop_seeed(raw: Any, fields: Any) -> Any:
    ids, ext, rtr, dlcs, err, payload, ts = fields
    count = pos = 0
    size = len(raw)
    while pos + 5 <= size:
        kind = int(raw[_at(pos + 1)])
        dlc = kind & 0xF
        if raw[_at(pos)] != 0xAA or kind < 0xC0 or dlc > 8:
            pos += 1
            continue
        wide = kind & 0x20 != 0
        remote = kind & 0x10 != 0
        header = 6 if wide else 4
        if pos + header + 1 > size:
            pos += 1
            continue
        plain = _u4(raw[_at(pos + 2)]) | _u4(raw[_at(pos + 3)]) << _u4(8)
        if pos + 6 <= size:  # read in any case: the kind of the id cannot be predicted
            high = _u4(raw[_at(pos + 4)]) << _u4(16) | _u4(raw[_at(pos + 5)]) << _u4(24)
            plain |= high if wide else _u4(0)
        start = pos + header
        end = start if remote and raw[_at(start)] == 0x55 else start + dlc
        if plain > (0x1FFF_FFFF if wide else 0x7FF) or end >= size or raw[_at(end)] != 0x55:
            pos += 1
            continue
        word = _u8(0)
        if start + 8 <= size:
            for k in range(8):
                word |= _u8(raw[_at(start + k)]) << _u8(8 * k)
            word &= _PAYLOAD[_at(dlc)]
        else:
            for k in range(end - start):
                word |= _u8(raw[_at(start + k)]) << _u8(8 * k)
        row = _at(count)
        ids[row] = plain
        ext[row] = wide
        rtr[row] = remote
        dlcs[row] = dlc
        err[row] = False
        payload[row] = _u8(0) if remote else word
        ts[row] = -(2**63)
        count += 1
        pos = end + 1
    return count


def _loop_cantalope(raw: Any, fields: Any) -> Any:
    ids, ext, rtr, dlcs, err, payload, ts = fields
    count = pos = 0
    size = len(raw)
    while pos + 2 <= size:
        low = int(raw[_at(pos + 1)])
        dlc = low & 0xF
        start = pos + 2
        if dlc > 8 or start + dlc > size:
            pos += 1
            continue
        word = _u8(0)
        if start + 8 <= size:
            for k in range(8):
                word |= _u8(raw[_at(start + k)]) << _u8(8 * k)
            word &= _PAYLOAD[_at(dlc)]
        else:
            for k in range(dlc):
                word |= _u8(raw[_at(start + k)]) << _u8(8 * k)
        remote = low & 0x10 != 0
        row = _at(count)
        ids[row] = int(raw[_at(pos)]) << 3 | low >> 5
        ext[row] = False
        rtr[row] = remote
        dlcs[row] = dlc
        err[row] = False
        payload[row] = _u8(0) if remote else word
        ts[row] = -(2**63)
        count += 1
        pos = start + dlc
    return count


_LOOPS = {"cantalope": _loop_cantalope, "seeed": _loop_seeed, "serial": _loop_serial}

PYTHON_CAN = {
    "serial": ("serial.serial_can", "SerialBus", "_ser"),
    "seeed": ("seeedstudio.seeedstudio", "SeeedBus", "ser"),
}


def python_can(protocol: str, raw: bytes) -> int:
    """Read the bytes through python-can's own bus; return the number of frames."""
    can: Any = importlib.import_module("can")
    module, name, port = PYTHON_CAN[protocol]
    bus_class: Any = getattr(importlib.import_module(f"can.interfaces.{module}"), name)
    take = io.BytesIO(raw).read

    def read(size: int = 1) -> bytes:
        return take(size)

    # The constructors open a port. Without them, only the port is another one, and it
    # never waits.
    bus = bus_class.__new__(bus_class)
    setattr(bus, port, SimpleNamespace(read=read, close=lambda: None))
    can.BusABC.__init__(bus, channel="memory")
    recv = bus.recv
    count = 0
    while recv(0) is not None:
        count += 1
    bus.shutdown()
    return count


def written(protocol: str) -> dict[str, Decode]:
    """Return the decoders that are written here for a protocol, if any, by their names."""
    works: dict[str, Decode] = {}
    if protocol in NUMPY:
        works["numpy"] = NUMPY[protocol]
        try:
            works["a numba loop"] = numba_loop(protocol)
        except ImportError:
            print("numba is not installed: pip install 'canser[bench]'")
    return works


def _sets(count: int, protocol: str) -> dict[str, FrameArray]:
    return {"mixed": data.mixed(count, protocol), "periodic": data.periodic(count, protocol)}


def _seconds(work: Callable[[], object], rounds: int) -> float:
    """Return the least time of a call; the first one warms up."""
    times = []
    for _ in range(rounds + 1):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times[1:])


def _compare(protocol: str, traffic: str, frames: FrameArray, rounds: int) -> None:
    """Check every decoder on one set of frames, and print the speeds."""
    raw = np.frombuffer(canser.encode(frames, protocol), np.uint8)
    expected = canser.decode(raw, protocol)
    out = np.zeros(len(frames) + 1, canser.FRAME_DTYPE)
    works = written(protocol)
    for name, work in works.items():
        out.view(np.uint8).fill(0xEE)
        count = work(raw, out)
        assert np.array_equal(out[:count], expected), f"{name} decodes {protocol} wrongly"
    decoder = canser.Decoder(protocol)
    speeds = {"canser": len(frames) / _seconds(lambda: decoder.feed_into(raw, out), rounds)}
    for name, work in works.items():
        speeds[name] = len(frames) / _seconds(functools.partial(work, raw, out), rounds)
    if protocol in PYTHON_CAN:
        # Remote frames make python-can lose its place.
        few = frames[~frames["rtr"]][:20_000]
        few_raw = canser.encode(few, protocol)
        assert python_can(protocol, few_raw) == len(few), f"python-can loses {protocol} frames"
        speeds["python-can"] = len(few) / _seconds(lambda: python_can(protocol, few_raw), 2)
    print(
        f"{protocol:10} {traffic:9}"
        + "".join(f"  {name} {speed / 1e6:.3g}" for name, speed in speeds.items())
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=200_000, help="frames of a set")
    parser.add_argument("--rounds", type=int, default=9, help="rounds of each decoder")
    args = parser.parse_args()
    print(
        f"millions of frames a second, best of {args.rounds} rounds, {args.frames:,} frames a set\n"
    )
    for protocol in canser.protocols():
        for traffic, frames in _sets(args.frames, protocol).items():
            _compare(protocol, traffic, frames, args.rounds)


if __name__ == "__main__":
    main()
