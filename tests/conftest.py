"""What the tests share: settings, signals, cores for threads, a decoder that is watched."""

import gc
import os
import signal
from collections.abc import Iterable, Iterator
from itertools import cycle

import hypothesis
import numpy as np
import pytest

import canser
from canser.codec import parallel
from long import EXAMPLES
from reference import RECORD, Control, Result, Stats, unpack

# No deadline: a shared machine is late now and then. In CI the same examples every time, so that
# a failure there is never the luck of the draw.
hypothesis.settings.register_profile(
    "canser",
    deadline=None,
    max_examples=EXAMPLES,
    derandomize=bool(os.environ.get("CI")),
)
hypothesis.settings.load_profile("canser")

# These Python ignores by itself, and a child of `subprocess` does not.
PYTHONS_OWN = {getattr(signal, name, None) for name in ("SIGPIPE", "SIGXFSZ")}


def restore_signals() -> None:
    """Give signals that the parent of the tests let be ignored their default action.

    `make test &` in a script ignores SIGINT, nohup SIGHUP. Children inherit that, a command
    of canser's honours it, and the tests that end commands with signals would wait in vain.
    A handler is not inherited. So children start with all defaults; the tests themselves are
    interrupted by SIGINT, and go on after the others, as the parent wished.
    """
    for number in signal.valid_signals() - PYTHONS_OWN:
        if signal.getsignal(number) is signal.SIG_IGN:
            interrupt = number == signal.SIGINT
            signal.signal(number, signal.default_int_handler if interrupt else lambda *_: None)


restore_signals()


def pytest_collection_finish() -> None:
    """Keep what is there before the tests out of the garbage collection.

    Thousands of tests and their modules take a collection 0.3 s, and many tests collect.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _many_cores() -> Iterator[None]:
    """Let tests use as many threads as they ask for, on a machine of any size."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parallel, "count_cores", lambda: 64)
        yield


class Run:
    """A decoder fed piece by piece, all that came out of it, and the laws after every call."""

    def __init__(self, protocol: str, unit: str = "ms", rooms: Iterable[int] = (64,)) -> None:
        """`rooms`: how many frames fit into `out`, call by call, over and over."""
        self.decoder = canser.Decoder(protocol, ts_unit=unit)
        self.rooms: Iterator[int] = cycle(rooms)
        self.records = bytearray()
        self.offsets: list[int] = []
        self.controls: list[Control] = []

    def feed(self, piece: bytes) -> None:
        """Feed all of the piece, in as many calls as the room takes."""
        while True:
            bytes_in = self.decoder.stats.bytes_in
            used, full = self._call(piece)
            assert self.decoder.stats.bytes_in == bytes_in + used
            piece = piece[used:]
            # A full `out` may have left whole packets behind, even where all bytes are taken.
            if not full:
                assert not piece, "stopped before the end although there was room"
                return

    def flush(self) -> None:
        """End the stream."""
        self._call(None)
        while self.decoder.pending:
            self._call(None)

    def result(self) -> Result:
        """Return all that came out so far."""
        stats = Stats.of(self.decoder.stats)
        return Result(unpack(bytes(self.records)), self.offsets, self.controls, stats)

    def _call(self, piece: bytes | None) -> tuple[int, bool]:
        """Feed or, with None, flush once; return the bytes used and whether `out` is full."""
        room = next(self.rooms)
        untouched = b"\xee" * RECORD.size
        out = np.frombuffer(bytearray(untouched * room), canser.FRAME_DTYPE)
        offsets = np.full(room, -1, np.int64)
        if piece is None:
            used, count = 0, self.decoder.flush_into(out, offsets)
        else:
            used, count = self.decoder.feed_into(piece, out, offsets)
        assert out[count:].tobytes() == untouched * (room - count)
        self.records += out[:count].tobytes()
        self.offsets += offsets[:count].tolist()
        self.controls += [Control(*control) for control in self.decoder.take_controls()]
        stats = Stats.of(self.decoder.stats)
        stats.check()
        assert stats.pending == self.decoder.pending
        assert stats.frames == len(self.offsets)
        assert stats.controls == len(self.controls)
        return used, count == room


def assert_agree(run: Run, expected: Result) -> None:
    """Assert that all that came out is what was expected, to the last byte of the records."""
    actual = run.result()
    assert actual.stats == expected.stats
    assert actual.offsets == expected.offsets
    assert actual.controls == expected.controls
    assert actual.frames == expected.frames
    # Equal frames may still hide a bool that is neither 0 nor 1.
    assert bytes(run.records) == b"".join(RECORD.pack(*frame) for frame in expected.frames)
