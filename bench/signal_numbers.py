"""Signals of frames: over cantools, asammdf and numpy, and over the memory that they take.

Rows of `table.py`. The traffic: 30 messages of 8 signals in turn, those of half the messages in
the order of Intel, of the others in that of Motorola, all with a scale. The values are compared
first, with those of numpy all, with those of cantools and asammdf some.
"""

import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import canser
from bus_numbers import NumberRow
from canser._frames import FRAME_DTYPE, FrameArray
from measure import paired

Column = npt.NDArray[np.float64]
Columns = dict[str, Column]

MESSAGES, FIRST_ID = 30, 0x100

# Bits, whether signed, scale and offset: together 64 bits.
LAYOUT = [
    (16, True, 0.1, -40.05),
    (12, False, 0.25, 0.5),
    (12, True, 0.01, 0.0),
    (8, False, 0.5, -40.0),
    (8, False, 0.4, 0.0),
    (4, False, 0.1, 1.0),
    (3, False, 1.5, 0.0),
    (1, False, 0.5, 0.0),
]

FEW = 20_000  # frames that cantools decodes; its time is that of so many, scaled


def is_little(message: int) -> bool:
    return message % 2 == 0


def text() -> str:
    """Return the database."""
    lines = ['VERSION ""', "", "BU_: X", ""]
    for message in range(MESSAGES):
        lines.append(f"BO_ {FIRST_ID + message} M{message}: 8 X")
        first = 0
        for number, (length, signed, scale, offset) in enumerate(LAYOUT):
            little = is_little(message)
            start = first if little else first // 8 * 8 + 7 - first % 8
            kind = f"{int(little)}{'-' if signed else '+'}"
            lines.append(f' SG_ S{number} : {start}|{length}@{kind} ({scale},{offset}) [0|0] "" X')
            first += length
        lines.append("")
    return "\n".join(lines)


def traffic(count: int) -> FrameArray:
    """Return random frames of all messages, mixed, a tenth of a millisecond apart."""
    rng = np.random.default_rng(7)
    frames = np.zeros(count, FRAME_DTYPE)
    frames["id"] = FIRST_ID + rng.integers(0, MESSAGES, count)
    frames["dlc"] = 8
    frames["data"] = rng.integers(0, 256, (count, 8), np.uint8)
    frames["ts"] = 1_764_000_000 * 10**9 + np.arange(count) * 100_000
    return frames


def by_numpy(frames: FrameArray) -> Columns:
    """Return the values as a user of numpy finds them: sort, swap, shift, mask, scale."""
    ids = frames["id"].astype(np.uint16)
    order = np.argsort(ids, kind="stable")  # of 16 bits: a radix sort
    ids, words = ids[order], frames["data"].view(np.uint64)[:, 0][order]
    ts = frames["ts"][order]
    starts = np.searchsorted(ids, FIRST_ID + np.arange(MESSAGES + 1))
    found: Columns = {}
    for message in range(MESSAGES):
        part = words[starts[message] : starts[message + 1]]
        found[f"M{message}.ts"] = ts[starts[message] : starts[message + 1]]
        little, first = is_little(message), 0
        part = part if little else part.byteswap()
        for number, (length, signed, scale, offset) in enumerate(LAYOUT):
            end = first + length
            if signed:
                left = 64 - end if little else first
                raw: Any = (part << np.uint64(left)).view(np.int64) >> np.int64(64 - length)
            else:
                right = first if little else 64 - end
                raw = part >> np.uint64(right) & np.uint64((1 << length) - 1)
            found[f"M{message}.S{number}"] = raw * scale + offset
            first = end
    return found


def cantools_calls(path: Path, frames: FrameArray) -> tuple[Callable[[], Columns], Any]:
    """Return cantools into arrays, and cantools with each result thrown away."""
    import cantools  # noqa: PLC0415 - an optional extra

    database: Any = cantools.database.load_file(path)
    ids = frames["id"].tolist()
    payloads = [row.tobytes() for row in frames["data"]]

    def into_arrays() -> Columns:
        lists: dict[int, dict[str, list[float]]] = {}
        for number, payload in zip(ids, payloads, strict=True):
            decoded = database.decode_message(number, payload, decode_choices=False)
            columns = lists.get(number)
            if columns is None:
                columns = lists[number] = {name: [] for name in decoded}
            for name, value in decoded.items():
                columns[name].append(value)
        return {
            f"M{number - FIRST_ID}.{name}": np.array(values)
            for number, columns in lists.items()
            for name, values in columns.items()
        }

    def thrown_away() -> None:
        decode = database.decode_message
        for number, payload in zip(ids, payloads, strict=True):
            decode(number, payload, decode_choices=False)

    return into_arrays, thrown_away


def asammdf_call(path: Path, frames: FrameArray, folder: Path) -> Callable[[], Any] | None:
    """Return asammdf's extraction of the bus, from an open file, if asammdf is there."""
    try:
        import asammdf  # noqa: PLC0415 - an optional extra
    except ImportError:
        return None
    recorded = folder / "signals.mf4"
    canser.write(frames, recorded, force=True)
    opened = asammdf.MDF(recorded)

    def extract() -> Any:
        return opened.extract_bus_logging({"CAN": [(path, 0)]})

    return extract


def assert_values(signals: canser.Signals, expected: Columns, what: str) -> None:
    """Assert that columns are those of canser, to the last bit."""
    for name, values in expected.items():
        if name.endswith(".ts"):
            own: Any = signals.groups[name.removesuffix(".ts")].ts.view(np.int64)
        else:
            own = signals[name].values
        assert np.array_equal(own, values), f"{what}: {name} is another"


def assert_like_asammdf(signals: canser.Signals, extracted: Any) -> None:
    for message in range(MESSAGES):
        for number in range(len(LAYOUT)):
            values = signals[f"M{message}.S{number}"].values
            theirs = extracted.get(f"M{message}.S{number}").samples
            assert np.allclose(theirs, values), f"asammdf: M{message}.S{number} is another"


def rows(rounds: int, folder: Path, count: int = 1_000_000) -> Iterator[NumberRow]:
    """Yield the rows."""
    path = folder / "signals.dbc"
    path.write_text(text())
    frames, database = traffic(count), canser.Database(path)
    room = database.decode(frames)
    assert_values(room, by_numpy(frames), "numpy")
    assert len(room) == MESSAGES * len(LAYOUT)
    few = frames[:FEW]
    into_arrays, thrown_away = cantools_calls(path, few)
    assert_values(database.decode(few), into_arrays(), "cantools")

    def ours() -> None:
        nonlocal room
        room = database.decode(frames, out=room)

    # L: what is read is copied, as numpy copies records; what is written is filled.
    copy = np.empty_like(frames)
    columns = [np.empty_like(signal.values) for signal in room.values()]
    columns += [np.empty(len(group.ts), np.int64) for group in room.groups.values()]

    def limit() -> None:
        np.copyto(copy, frames)
        for column in columns:
            column.fill(0)

    def words() -> None:
        np.copyto(copy.view(np.uint64), frames.view(np.uint64))
        for column in columns:
            column.fill(0)

    def fresh() -> None:
        database.decode(frames)

    def row(
        what: str, peer: Callable[[], object], required: float | None, peer_count: int
    ) -> NumberRow:
        few_rounds = rounds if peer_count == count else max(rounds // 3, 1)
        peer_s, our_s, ratio = paired(peer, ours, few_rounds)
        rate = count / our_s / 1e6
        note = f"{rate:.1f} M frames/s, {rate * len(LAYOUT):.0f} M values/s; "
        note += f"peer {peer_count / peer_s / 1e6:.3g} M frames/s"
        return NumberRow(what, "", ratio * count / peer_count, required, note)

    yield row("signals, over cantools into arrays", into_arrays, 300, len(few))
    yield row("signals, over bare decode_message", thrown_away, 150, len(few))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        extract = asammdf_call(path, frames, folder)
        if extract is None:
            print("asammdf is not installed: signals are not compared with its extraction")
        else:
            assert_like_asammdf(room, extract())
            yield row("signals, over asammdf's extraction", extract, 20, count)
    yield row("signals, over numpy by hand", lambda: by_numpy(frames), 5, count)
    yield row("signals, over L", limit, 1.3, count)
    yield row("signals, over L, copied as words", words, None, count)
    reused_s, fresh_s, ratio = paired(ours, fresh, rounds)
    note = f"{count / fresh_s / 1e6:.1f} M frames/s, reused {count / reused_s / 1e6:.1f}"
    yield NumberRow("signals, new arrays, over reused", "", ratio, 0.8, note)


def main() -> None:
    """Print the rows alone."""
    import tempfile  # noqa: PLC0415

    with tempfile.TemporaryDirectory() as folder:
        for row in rows(7, Path(folder)):
            required = "" if row.required is None else f"{row.required:.3g}"
            print(f"{row.what:40} {row.reached:8.3g} {required:>8}  {row.note}", flush=True)


if __name__ == "__main__":
    main()
