"""ASAM MF4: there and back, python-can and asammdf as peers, files that are cut and hostile."""

import datetime as dt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import canser
from canser.errors import CanserWarning
from reference import Frame
from samples import EPOCH, FRAMES, SECOND, array, listed

asammdf = pytest.importorskip("asammdf")
can = pytest.importorskip("can")

EDGE = [
    Frame(0x123, ext=True, dlc=8, data=bytes(range(1, 9)), ts=EPOCH + 789),
    Frame(0x456, rtr=True, dlc=8, ts=EPOCH + 1_000_789),
    Frame(0x457, rtr=True, dlc=0, ts=EPOCH + 2_000_789),
    Frame(0x18FEF100, ext=True, rtr=True, dlc=4, ts=EPOCH + 3_000_789),
    Frame(0x80, err=True, dlc=8, data=bytes(range(8)), ts=EPOCH + 4_000_789),
    Frame(0x7FF, dlc=3, data=b"\xaa\x55\xbb" + bytes(5), ts=EPOCH + 5_000_789),
    Frame(0, dlc=0, ts=EPOCH + 4_500_789),
    Frame(0x1FFFFFFF, ext=True, dlc=1, data=b"\xff" + bytes(7), ts=EPOCH + 6_000_790),
    Frame(0x7DF, dlc=8, data=b"\xff" * 8, ts=EPOCH + 3600 * SECOND + 789),
]
CHANNELS = np.array([0, 0, 0, 0, 0, 1, 0, 0, 1], np.uint8)
DIRECTIONS = np.array([0, 0, 0, 0, 0, 1, 0, 0, 0], np.uint8)


def tagged(path: Path, **options: Any) -> tuple[list[Frame], list[int], list[int], list[str]]:
    """Return frames with dates, their channels and directions, and the remarks."""
    frames: list[Frame] = []
    channels: list[int] = []
    directions: list[int] = []
    with canser.blocks(path, **{"epoch": "file", "tz": dt.UTC, **options}) as blocks:
        for block in blocks:
            assert blocks.channels is not None
            assert blocks.directions is not None
            frames += listed(block)
            channels += blocks.channels.tolist()
            directions += blocks.directions.tolist()
    told = [each for each in blocks.notes.remarks if "become one" not in each]
    return frames, channels, directions, [each for each in told if "direction" not in each]


def test_the_nine_edge_frames_there_and_back(tmp_path: Path) -> None:
    path = tmp_path / "x.mf4"
    with pytest.warns(CanserWarning, match="before that of others, which readers put in order: 1"):
        done = canser.write(array(*EDGE), path, channels=CHANNELS, directions=DIRECTIONS)
    assert len(done.remarks) == 1
    order = sorted(range(9), key=lambda at: EDGE[at].ts)
    assert tagged(path) == (
        [EDGE[at] for at in order],
        CHANNELS[order].tolist(),
        DIRECTIONS[order].tolist(),
        [],
    )


@settings(max_examples=30, deadline=None)
@given(frames=FRAMES, data=st.data())
def test_any_frames_there_and_back(
    frames: list[Frame], data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("mf4") / "x.mf4"
    codes = st.lists(st.integers(0, 255), min_size=len(frames), max_size=len(frames))
    channels = np.array(data.draw(codes), np.uint8)
    directions = channels % 2
    plain = np.array(array(*frames))
    plain["ts"] = EPOCH + np.arange(len(frames)) * 1_234_567_891
    canser.write(plain, path, channels=channels, directions=directions)
    got, got_channels, got_directions, remarks = tagged(path)
    assert (got, remarks) == (listed(plain), [])
    assert (got_channels, got_directions) == (channels.tolist(), directions.tolist())
