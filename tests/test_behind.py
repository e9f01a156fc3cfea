"""Parts that a thread writes: their order, the memory that they lie in, errors, the end."""

import io
import threading
import time
from pathlib import Path
from typing import Any, BinaryIO, cast

import pytest

import canser
from canser.files.behind import Behind
from canser.simulation.traffic import vehicle

SIZE = 1 << 17


class Slow(io.RawIOBase):
    """A file that takes its time, and has no room behind `most` bytes."""

    def __init__(self, most: int = 1 << 30) -> None:
        super().__init__()
        self.most, self.held = most, b""

    def write(self, part: Any) -> int:
        time.sleep(0.002)
        if len(self.held) + len(part) > self.most:
            raise OSError(28, "No space left on device")
        self.held += bytes(part)
        return len(part)


def threads() -> int:
    return sum(each.name == "canser writing" for each in threading.enumerate())


def test_parts_in_two_rooms_are_written_in_their_order() -> None:
    file = Slow()
    behind = Behind(cast(BinaryIO, file))
    rooms = [bytearray(SIZE), bytearray(SIZE)]
    wanted = b""
    for number in range(20):
        room = rooms[number % 2]
        room[:] = bytes([number]) * SIZE
        size = SIZE if number % 3 else 10  # small ones are written at once
        behind.write(memoryview(room)[:size])
        wanted += bytes([number]) * size
    behind.finish()
    assert file.held == wanted
    assert threads() == 0


def test_an_error_is_raised_by_the_next_call_and_ends_the_thread() -> None:
    behind = Behind(cast(BinaryIO, Slow(3 * SIZE)))
    for _ in range(4):
        behind.write(bytes(SIZE))
    with pytest.raises(OSError, match="No space left"):
        behind.write(bytes(SIZE))
    behind.abandon()
    assert threads() == 0
    behind = Behind(cast(BinaryIO, Slow(SIZE // 2)))
    behind.write(bytes(SIZE))
    with pytest.raises(OSError, match="No space left"):
        behind.finish()
    assert threads() == 0


def test_without_a_thread_all_parts_are_written(monkeypatch: pytest.MonkeyPatch) -> None:
    def start(_: Any) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", start)
    file = Slow()
    behind = Behind(cast(BinaryIO, file))
    for _ in range(3):
        behind.write(bytes(SIZE))
    behind.finish()
    assert len(file.held) == 3 * SIZE


@pytest.mark.parametrize("file_format", ["candump", "csv", "gvret", "asc", "trc", "pcap"])
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.filterwarnings("ignore::canser.CanserWarning")
def test_a_full_disk_is_told_and_leaves_no_thread(file_format: str) -> None:
    with pytest.raises(OSError, match="No space left on device") as caught:
        canser.write(vehicle(20), "/dev/full", format=file_format, force=True)
    assert caught.value.filename == "/dev/full"
    assert threads() == 0
