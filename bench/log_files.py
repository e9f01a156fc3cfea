"""Log files, read and written, beside python-can, and beside a copy of the same bytes.

Rows of `table.py`. In memory: a buffer of text to an array, and back, over python-can's readers and
writers with the same buffer and messages; for GVRET over a loop of Python's csv module, as
python-can has none. File to file: reading by `blocks`, and writing, over a copy of the file by
read() and write(). Files are written where none is; candump's also in the place of one.
"""

import csv
import io
import os
import struct
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import canser
import data
from canser._frames import FrameArray
from canser.files.containers import packing
from canser.files.formats import find_format
from canser.files.writer import WriteOptions
from measure import paired


class LogRow(NamedTuple):
    """A line of the table."""

    what: str
    protocol: str
    reached: float
    required: float | None
    note: str = ""


# Frames in memory. python-can takes about a second for them.
COUNT = 100_000

# Required over python-can: reading and writing.
REQUIRED = {"candump": (100, 100), "csv": (50, 50), "asc": (50, 50), "trc": (50, 50),
            "gvret": (50, 50), "blf": (10, 3)}  # fmt: skip
BINARY = ("blf",)


def traffic(count: int) -> FrameArray:
    """Return data frames with times of whole microseconds, from a date on."""
    frames = data.periodic(count * 11 // 10, "serial")
    frames = frames.compress(~(frames["rtr"] | frames["err"]))[:count]
    assert len(frames) == count
    frames["ts"] = 1_767_225_600 * 10**9 + frames["ts"] // 1000 * 1000
    return frames


def to_messages(frames: FrameArray) -> list[Any]:
    """Return frames as messages of python-can."""
    import can  # noqa: PLC0415 - seldom used

    return [
        can.Message(
            timestamp=float(frame["ts"] / 1e9),
            arbitration_id=int(frame["id"]),
            is_extended_id=bool(frame["ext"]),
            dlc=int(frame["dlc"]),
            data=bytes(frame["data"][: frame["dlc"]]),
            channel=0,
        )
        for frame in frames
    ]


def written(name: str, frames: FrameArray) -> bytes:
    """Return frames as the bytes of a file."""
    file = io.BytesIO()
    writer = find_format(name).write(file, WriteOptions())
    writer.write(frames)
    writer.finish()
    return file.getvalue()


def _gvret_read(text: str) -> int:
    rows = csv.reader(io.StringIO(text))
    next(rows)
    found = [
        (int(row[0]) * 1000, int(row[1], 16), row[2] == "true", row[3],
         bytes(int(each, 16) for each in row[6 : 6 + int(row[5])]))
        for row in rows
    ]  # fmt: skip
    return len(found)


def _gvret_write(messages: list[Any]) -> str:
    file = io.StringIO()
    rows = csv.writer(file)
    for message in messages:
        kind = "true" if message.is_extended_id else "false"
        rows.writerow(
            [int(message.timestamp * 1e6), f"{message.arbitration_id:08X}", kind, "Rx", 0,
             message.dlc, *(f"{byte:02X}" for byte in message.data)]
        )  # fmt: skip
    return file.getvalue()


def peers(name: str, messages: list[Any]) -> tuple[Callable[[bytes], int], Callable[[], bytes]]:
    """Return what reads a file with python-can, and what writes the messages with it."""
    import can  # noqa: PLC0415 - seldom used

    if name == "gvret":
        return lambda raw: _gvret_read(raw.decode()), lambda: _gvret_write(messages).encode()
    reader, writer = {
        "candump": (can.CanutilsLogReader, can.CanutilsLogWriter),
        "csv": (can.CSVReader, can.CSVWriter),
        "asc": (can.ASCReader, can.ASCWriter),
        "trc": (can.TRCReader, can.TRCWriter),
        "blf": (can.BLFReader, can.BLFWriter),
    }[name]
    binary = name in BINARY

    def read(raw: bytes) -> int:
        file: Any = io.BytesIO(raw) if binary else io.StringIO(raw.decode())
        found: Any = reader(file)
        return sum(1 for _ in found)

    def write() -> bytes:
        below: Any = io.BytesIO()
        below.name = name  # which the writer of TRC asks for
        file: Any = below if binary else io.TextIOWrapper(below)
        put = writer(file)
        for message in messages:
            put(message)
        if binary:
            file.close = lambda: None  # the writer closes what it was given
            put.stop()
            return bytes(file.getvalue())
        file.flush()
        return bytes(below.getvalue())

    return read, write


def in_memory(name: str, rounds: int) -> Iterator[LogRow]:
    """Compare with python-can, one buffer and one set of messages for both."""
    frames = traffic(COUNT)
    messages = to_messages(frames)
    read, write = peers(name, messages)
    raw = written(name, frames)

    def ours() -> FrameArray:
        return canser.read(io.BytesIO(raw), format=name)

    got = ours()
    assert (got["id"] == frames["id"]).all(), f"reading {name} is wrong"
    assert (got["data"] == frames["data"]).all(), f"reading {name} is wrong"
    assert read(raw) == COUNT, f"python-can does not read {name} as it is written"
    required_read, required_write = REQUIRED[name]
    peer_s, our_s, ratio = paired(lambda: read(raw), ours, rounds)
    note = f"{COUNT / our_s / 1e6:.1f} M frames/s, python-can {COUNT / peer_s / 1e3:.0f} k"
    yield LogRow(f"read {name}, over python-can", "", ratio, required_read, note)
    room = io.BytesIO(bytes(len(raw)))  # written over again and again

    def put() -> None:
        room.seek(0)
        writer = find_format(name).write(room, WriteOptions())
        writer.write(frames)
        writer.finish()

    put()
    assert room.getvalue() == raw
    peer_s, our_s, ratio = paired(write, put, rounds)
    note = f"{COUNT / our_s / 1e6:.1f} M frames/s, python-can {COUNT / peer_s / 1e3:.0f} k"
    yield LogRow(f"write {name}, over python-can", "", ratio, required_write, note)


def remove(*paths: Path) -> None:
    """Remove the files that are there."""
    for path in paths:
        path.unlink(missing_ok=True)


def file_to_file(name: str, count: int, folder: Path, rounds: int) -> Iterator[LogRow]:
    """Compare with a copy of the file's bytes by read() and write()."""
    frames = traffic(count)
    suffix = find_format(name).suffixes[0]
    path, made, copied = folder / f"run{suffix}", folder / f"made{suffix}", folder / "copy"
    canser.write(frames, path, force=True)
    size = path.stat().st_size
    out = frames[: 1 << 16].copy()

    def copy() -> None:
        with path.open("rb", buffering=0) as source, copied.open("wb", buffering=0) as target:
            while piece := source.read(1 << 20):
                target.write(piece)

    def read() -> int:
        return sum(map(len, canser.blocks(path, out=out)))

    def write() -> None:
        canser.write(frames, made, force=True)

    def before() -> None:
        remove(made, copied)

    def row(what: str, required: float | None, copy_s: float, our_s: float, ratio: float) -> LogRow:
        note = f"{size / our_s / 1e9:.2f} GB/s, copy {size / copy_s / 1e9:.2f}"
        return LogRow(f"{what} {name}, over a copy", "", ratio, required, note)

    assert read() == count
    rounds = 2 * rounds + 1  # a call is short, and the time of new pages of the disk's cache varies
    yield row("blocks of", 0.5, *paired(copy, read, rounds, before))
    yield row("write to", 0.5, *paired(copy, write, rounds, before))
    if name == "candump":
        yield row("replace", None, *paired(copy, write, rounds))


def packing_alone(count: int, folder: Path, rounds: int) -> Iterator[LogRow]:
    """Compare inflating and deflating the containers of a BLF file, and no more, with a copy."""
    path, copied = folder / "run.blf", folder / "copy"
    canser.write(traffic(count), path, force=True)
    raw, module = path.read_bytes(), packing()
    packed = []
    (at,) = struct.unpack_from("<I", raw, 4)
    while at < len(raw):
        (size,) = struct.unpack_from("<I", raw, at + 8)
        packed.append(raw[at + 32 : at + size])  # behind the headers of a container
        at += size + size % 4
    contents = [module.decompress(each) for each in packed]

    def copy() -> None:
        copied.write_bytes(path.read_bytes())

    def inflate() -> None:
        for each in packed:
            module.decompress(each)

    def deflate() -> None:
        for each in contents:
            module.compress(each, 1)

    for what, work in (("inflating", inflate), ("deflating", deflate)):
        copy_s, our_s, ratio = paired(copy, work, 2 * rounds + 1, lambda: remove(copied))
        note = f"{our_s:.3f} s, copy {copy_s:.3f}; {module.__name__}"
        yield LogRow(f"{what} blf, no more, over a copy", "", ratio, None, note)


def mf4(folder: Path, rounds: int) -> Iterator[LogRow]:
    """Compare writing MF4 with python-can, by the frame, and with asammdf alone."""
    import asammdf  # noqa: PLC0415 - seldom used
    import can  # noqa: PLC0415

    count, fewer = 400_000, 10_000
    frames = traffic(count)
    messages = to_messages(frames[:fewer])
    path, other = folder / "run.mf4", folder / "other.mf4"
    dtype = [
        ("CAN_DataFrame.BusChannel", "<u1"), ("CAN_DataFrame.ID", "<u4"),
        ("CAN_DataFrame.IDE", "<u1"), ("CAN_DataFrame.DLC", "<u1"),
        ("CAN_DataFrame.DataLength", "<u1"), ("CAN_DataFrame.DataBytes", "<u1", (8,)),
        ("CAN_DataFrame.Dir", "<u1"),
    ]  # fmt: skip

    def ours() -> None:
        canser.write(frames, path, force=True)

    def by_python_can() -> None:
        with can.MF4Writer(str(other)) as writer:
            for message in messages:
                writer(message)

    def by_asammdf() -> None:
        records = np.zeros(count, dtype)
        for name, field in (("ID", "id"), ("IDE", "ext"), ("DLC", "dlc"), ("DataBytes", "data")):
            records[f"CAN_DataFrame.{name}"] = frames[field]
        records["CAN_DataFrame.DataLength"] = frames["dlc"]
        records["CAN_DataFrame.BusChannel"] = 1
        seconds = (frames["ts"] - frames["ts"][0]) / 1e9
        source = asammdf.Source(
            "CAN", "CAN", "", asammdf.Source.SOURCE_BUS, asammdf.Source.BUS_TYPE_CAN
        )
        with asammdf.MDF(version="4.10") as made:
            signal = asammdf.Signal(records, seconds, name="CAN_DataFrame", source=source)
            made.append(signal, acq_name="CAN", acq_source=source)
            made.save(other, overwrite=True, compression=2)

    def before() -> None:
        remove(path, other)

    peer_s, our_s, ratio = paired(by_python_can, ours, rounds, before)
    note = f"{count / our_s / 1e6:.1f} M frames/s, python-can {fewer / peer_s / 1e3:.0f} k"
    yield LogRow("write mf4, over python-can", "", ratio * count / fewer, 100, note)
    peer_s, our_s, ratio = paired(by_asammdf, ours, rounds, before)
    note = f"{count / our_s / 1e6:.1f} M frames/s, asammdf {count / peer_s / 1e6:.1f}"
    yield LogRow("write mf4, over asammdf alone", "", ratio, 0.9, note)


# Writes the table of an Arrow file as Parquet, as canser does.
BY_PYARROW = """
import pyarrow as pa, pyarrow.parquet as parquet
with pa.memory_map({source!r}) as file:
    table = pa.ipc.open_file(file).read_all()
parquet.write_table(table, {target!r}, compression="zstd", compression_level=3,
    use_dictionary=["id", "dlc", "data", "channel"],
    column_encoding={{"ts": "DELTA_BINARY_PACKED"}})
"""


def to_parquet(folder: Path, count: int, rounds: int) -> Iterator[LogRow]:
    """Compare raw bytes to Parquet, a whole process, with pyarrow writing the same table."""
    raw, made = folder / "run.bin", folder / "run.parquet"
    canser.write(traffic(count), raw, "serial", force=True)
    canser.convert(raw, folder / "run.arrow", "serial", force=True)
    target = folder / "other.parquet"
    code = BY_PYARROW.format(source=str(folder / "run.arrow"), target=str(target))
    command = ["-m", "canser", "convert", str(raw), str(made), "-p", "serial", "--force"]

    # Both keep the bytecode of their modules in the warm round, as an installed package has it:
    # where an environment forbids that, a checkout is compiled at each start.
    environment = {**os.environ, "PYTHONPYCACHEPREFIX": str(folder / "bytecode")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)

    def run(*arguments: str) -> None:
        subprocess.run(
            [sys.executable, *arguments], check=True, capture_output=True, env=environment
        )

    run("-c", code)
    run(*command)
    assert (canser.read(target) == canser.read(made)).all()
    peer_s, our_s, ratio = paired(
        lambda: run("-c", code), lambda: run(*command), rounds, lambda: remove(made, target)
    )
    # What both take before the first frame.
    few, tiny = folder / "few.bin", folder / "few.parquet"
    canser.write(traffic(100), few, "serial", force=True)
    start = ["-m", "canser", "convert", str(few), str(tiny), "-p", "serial", "--force"]
    peer_start_s, start_s, _ = paired(
        lambda: run("-c", "import pyarrow.parquet"), lambda: run(*start), rounds
    )
    note = f"{our_s:.2f} s, {start_s:.2f} of it to start; "
    note += f"pyarrow {peer_s:.2f}, {peer_start_s:.2f} of it to start"
    yield LogRow("raw to parquet, process, over pyarrow", "", ratio, 0.8, note)


def rows(rounds: int, folder: Path, count: int = 1_000_000) -> Iterator[LogRow]:
    """Yield all rows."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in REQUIRED:
            yield from in_memory(name, rounds)
        for name in REQUIRED:
            yield from file_to_file(name, count, folder, rounds)
        yield from packing_alone(count, folder, rounds)
        yield from mf4(folder, rounds)
        yield from to_parquet(folder, 2 * count, rounds)


def main() -> None:
    """Print the rows alone."""
    import tempfile  # noqa: PLC0415

    with tempfile.TemporaryDirectory() as folder:
        for row in rows(3, Path(folder)):
            required = "" if row.required is None else f"{row.required:.3g}"
            print(f"{row.what:40} {row.reached:8.3g} {required:>8}  {row.note}", flush=True)


if __name__ == "__main__":
    main()
