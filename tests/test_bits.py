"""The lengths of frames on the bus, against the bits one by one."""

import os
import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
from plain_bits import length_on_the_bus
from reference import ID_EXT_MAX, ID_MAX, Frame
from samples import FRAMES, array
from shared import expected, needs_captures

RUNS = [b"\0" * 8, b"\xff" * 8, b"\x0f" * 8, b"\xf8\x3e" * 4, b"\x55" * 8]


@given(FRAMES)
def test_lengths_are_those_of_the_bits(frames: list[Frame]) -> None:
    lengths = [0 if frame.err else length_on_the_bus(frame) for frame in frames]
    assert canser.frame_bits(array(*frames)).tolist() == lengths


@given(
    st.lists(
        st.builds(
            lambda ext, number, rtr, dlc, data: Frame(
                number & (ID_EXT_MAX if ext else ID_MAX),
                ext=ext,
                rtr=rtr,
                dlc=dlc,
                data=b"" if rtr else data[:dlc].ljust(8, b"\0"),
            ),
            st.booleans(),
            st.sampled_from([0, ID_MAX, ID_EXT_MAX, 0x1E1E1E1E]) | st.integers(0, ID_EXT_MAX),
            st.booleans(),
            st.integers(0, 8),
            st.sampled_from(RUNS) | st.binary(min_size=8, max_size=8),
        ),
        min_size=1,
        max_size=9,
    )
)
def test_lengths_of_frames_with_long_runs_of_equal_bits(frames: list[Frame]) -> None:
    lengths = [length_on_the_bus(frame) for frame in frames]
    assert canser.frame_bits(array(*frames)).tolist() == lengths


TAIL = 1 + 1 + 1 + 7 + 3


@pytest.mark.parametrize(
    ("text", "length"),
    [
        # 34 zeros, as the CRC is 0, too: a stuff bit behind each five of them.
        ("000#", 34 + 6 + TAIL),
        # 00000 00000 00 1 00000 0 111001111000101: three stuff bits.
        ("000#R", 34 + 3 + TAIL),
        # 0101..01, and 001101100000100 as CRC: one stuff bit.
        ("555#5555555555555555", 19 + 64 + 15 + 1 + TAIL),
    ],
)
def test_lengths_that_were_counted_by_hand(text: str, length: int) -> None:
    assert canser.frame_bits(canser.frames(text)).tolist() == [length]


def test_what_has_no_bits() -> None:
    assert canser.frame_bits(array()).tolist() == []
    assert canser.frame_bits(array(Frame(1, err=True, dlc=8))).tolist() == [0]


def test_frames_that_are_not_contiguous_are_taken() -> None:
    frames = canser.frames("123#", "124#0102030405060708", "123#01")
    assert canser.frame_bits(frames[::2]).tolist() == canser.frame_bits(frames).tolist()[::2]


def test_what_is_no_array_of_frames_is_refused() -> None:
    with pytest.raises(TypeError, match=r"frames must be an array of canser\.FRAME_DTYPE"):
        canser.frame_bits(np.zeros(3))  # type: ignore[arg-type]


@needs_captures
def test_the_car_sends_116_bits_a_frame() -> None:
    assert canser.frame_bits(expected("car")).mean() == pytest.approx(116.1, abs=0.05)


CANUTILS = os.environ.get("CANUTILS_SRC")


@pytest.mark.skipif(CANUTILS is None, reason="CANUTILS_SRC names no source of can-utils")
def test_lengths_of_data_frames_are_those_of_can_utils(tmp_path: Path) -> None:
    """Its lengths of remote frames have data, which are not sent."""
    assert CANUTILS is not None
    rng = np.random.default_rng(1)
    frames = np.zeros(100_000, canser.FRAME_DTYPE)
    frames["ext"] = rng.integers(0, 2, len(frames))
    frames["id"] = rng.integers(0, ID_EXT_MAX + 1, len(frames))
    frames["id"] &= np.where(frames["ext"], ID_EXT_MAX, ID_MAX).astype(np.uint32)
    frames["dlc"] = rng.integers(0, 9, len(frames))
    frames["data"] = rng.integers(0, 256, (len(frames), 8))
    frames["data"][np.arange(8) >= frames["dlc"][:, None]] = 0
    # A struct can_frame: the id with the flag, the dlc, three bytes of padding, the data.
    raw = np.zeros(len(frames), [("id", "u4"), ("dlc", "u1"), ("pad", "u1", 3), ("data", "u1", 8)])
    raw["id"] = frames["id"] | np.where(frames["ext"], np.uint32(1 << 31), np.uint32(0))
    raw["dlc"], raw["data"] = frames["dlc"], frames["data"]
    (tmp_path / "frames").write_bytes(raw.tobytes())
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include <linux/can.h>\n#include "canframelen.h"\n'
        "int main(void) { struct canfd_frame f = {0};"
        " while (fread(&f, 16, 1, stdin) == 1)"
        ' printf("%u\\n", can_frame_length(&f, CFL_EXACT, sizeof(struct can_frame))); }\n'
    )
    compiler = (sysconfig.get_config_var("CC") or "cc").split()[0]
    source = Path(CANUTILS)
    subprocess.run(
        [compiler, f"-I{source}", tmp_path / "main.c", source / "canframelen.c", "-o", "main"],
        cwd=tmp_path,
        check=True,
    )
    with (tmp_path / "frames").open("rb") as file:
        done = subprocess.run([tmp_path / "main"], stdin=file, capture_output=True, check=True)
    assert canser.frame_bits(frames).tolist() == [int(line) for line in done.stdout.split()]
