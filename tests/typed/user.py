"""What a user writes: type checkers must find nothing here. It is checked, and never run."""

import sys
from pathlib import Path
from typing import Any, assert_type

import can
import numpy as np
import numpy.typing as npt

import canser
from canser import adapters, errors


def look(path: Path) -> canser.FrameArray:
    """Read a file whole, choose, join and show."""
    frames = canser.read(path, "seeed")
    assert_type(frames, canser.FrameArray)
    assert_type(canser.match(frames, "123", "7E0:7F8"), npt.NDArray[np.bool_])
    chosen = frames.compress(canser.match(frames, "123"))
    known = chosen.compress(chosen["ts"] != canser.NO_TIME)
    seconds: npt.NDArray[np.float64] = known["ts"] / 1e9
    print(known["id"].max(), seconds.mean(), known["ts"].view("m8[ns]").max())
    joined = canser.concat([known, frames[:10]])
    canser.show(joined)
    canser.show(joined, sys.stderr)
    return joined


def count(path: str) -> int:
    """Go through a file that is larger than memory."""
    out = np.empty(1 << 16, canser.FRAME_DTYPE)
    total = 0
    for block in canser.blocks(path, "serial", ts_unit="us", out=out):
        total += len(block)
    return total


def stream(chunks: list[bytes]) -> canser.Stats:
    """Decode a stream without a new array for each chunk."""
    decoder = canser.Decoder("serial", ts_unit="us")
    out = np.empty(4096, canser.FRAME_DTYPE)
    offsets = np.empty(len(out), np.int64)
    for chunk in chunks:
        view = memoryview(chunk)
        while view:
            used, frame_count = decoder.feed_into(view, out, offsets)
            print(out[:frame_count]["dlc"].sum(), offsets[:frame_count])
            view = view[used:]
    assert_type(decoder.flush_into(out), int)
    for control in decoder.take_controls():
        assert_type(control, canser.Control)
        assert_type(control.data, bytes)
    assert_type(decoder.stats.bytes_skipped, int)
    return decoder.stats


def there_and_back(raw: bytes | bytearray | memoryview) -> bytes:
    """Decode and encode bytes, and find out what they are."""
    best = canser.identify(raw)[0]
    assert_type(best.fits, bool)
    protocol = canser.protocol(best.protocol)
    assert_type(protocol.has_clock, bool)
    assert_type(canser.protocols(), tuple[str, ...])
    frames = canser.decode(raw, protocol.name)
    room = np.empty(20 * len(frames), np.uint8)
    assert_type(canser.encode(frames, "seeed", out=room), npt.NDArray[np.uint8])
    return canser.encode(frames, "seeed")


def convert_all(paths: list[Path]) -> None:
    """Read several files as one stream, and write any format."""
    with canser.blocks(paths, format="candump", bus="can0") as blocks:
        assert_type(blocks.stats, canser.Stats | None)
        assert_type(blocks.notes.doubt, str)
        done = canser.write(blocks, "all.npy", force=True)
    assert_type(done.frames, int)
    canser.convert([*paths, "more.csv"], "all.bin", "serial", strict=True)


def make() -> canser.FrameArray:
    """Make frames of what is at hand."""
    message = can.Message(arbitration_id=0x123, data=[1, 2])
    texts = ["123#DEADBEEF", "7E0#R8"]
    made = canser.frames("123#DEADBEEF", (0x123, b"\x01"), message, texts, [message, message])
    return canser.frames(made, made[0], [(np.uint32(5), made["data"][0])], can.LogReader("a.blf"))


def live(url: str) -> None:
    """Read from a port, and send."""
    with canser.open(url, "seeed", bitrate=500_000, reconnect=True) as port:
        assert_type(port, canser.Port)
        out = np.empty(4096, canser.FRAME_DTYPE)
        assert_type(port.read_batch(out, timeout=0.1), canser.FrameArray)
        for batch in port.batches(max_frames=4096, timeout=0.05):
            assert_type(batch, canser.FrameArray)
            assert_type(port.send(batch), int)
            break
        port.send("123#DEADBEEF", pace=False)
        port.send((0x18FEF100, bytearray(8)), timeout=1.0)
        port.send([can.Message(), "123#"])
        port.send(canser.frames("123#R"))
        estimate = port.clock
        assert_type(estimate, canser.ClockEstimate | None)
        for gap in port.take_gaps():
            assert_type(gap, canser.Gap)
        if port.status is not None:
            assert_type(port.status, canser.AdapterReport)
            assert_type(port.status.receive_errors, int | None)
    for info in canser.list_ports():
        assert_type(info, canser.PortInfo)
    config = canser.AdapterConfig(bitrate=500_000, mode="silent")
    assert_type(adapters.configuration("seeed", config), bytes)
    line = canser.LineConfig(baudrate=2_000_000, dtr="off")
    with canser.open(url, "seeed", config=config, line=line) as other:
        other.configure(bitrate=250_000)


async def live_async(url: str) -> None:
    """Read from a port in an event loop."""
    with canser.open(url, "cantalope") as port:
        async for batch in port.batches_async():
            assert_type(batch, canser.FrameArray)


def careful(url: str) -> str:
    """Handle all errors."""
    try:
        live(url)
    except canser.SendTimeoutError as error:
        assert_type(error.sent, int)
    except (canser.PortBusyError, errors.PortNotFoundError) as error:
        return f"{canser.__version__}: {error}"
    except canser.CanserError as error:
        return str(error)
    return ""


def loaded(shell: Any) -> None:
    """Load the extension of notebooks."""
    canser.load_ipython_extension(shell)
