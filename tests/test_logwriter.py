"""Recordings that python-can writes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

can = pytest.importorskip("can")

import canser  # noqa: E402
from canser.simulation.traffic import vehicle  # noqa: E402
from samples import EPOCH, MILLISECOND, listed  # noqa: E402

FRAMES = vehicle(1, extended=False)
FRAMES["ts"] += EPOCH


def messages() -> list[Any]:
    return [
        can.Message(
            timestamp=int(frame["ts"]) / 1e9,
            arbitration_id=int(frame["id"]),
            is_extended_id=bool(frame["ext"]),
            is_remote_frame=bool(frame["rtr"]),
            dlc=int(frame["dlc"]),
            data=None if frame["rtr"] else frame["data"][: frame["dlc"]].tobytes(),
        )
        for frame in FRAMES
    ]


@pytest.mark.parametrize("protocol", [None, *canser.protocols()])
def test_messages_come_back(tmp_path: Path, protocol: str | None) -> None:
    path = tmp_path / "run.pcapng"
    options = {} if protocol is None else {"protocol": protocol}
    with can.Logger(str(path), **options) as log:
        for message in messages():
            log(message)
    back = canser.read(path)
    untimed = [frame._replace(ts=0) for frame in listed(back)]
    assert untimed == [frame._replace(ts=0) for frame in listed(FRAMES)]
    assert np.abs(back["ts"] - FRAMES["ts"]).max() <= 2 * MILLISECOND
    with can.LogReader(str(path)) as reader:
        assert [message.arbitration_id for message in reader] == FRAMES["id"].tolist()


def test_what_the_protocol_cannot_carry_is_counted(tmp_path: Path) -> None:
    log = can.Logger(str(tmp_path / "run.pcapng"), protocol="seeed")
    log(can.Message(is_error_frame=True, timestamp=1.0))
    log(can.Message(arbitration_id=1, timestamp=2.0))
    with pytest.warns(canser.CanserWarning, match=r"run\.pcapng.*1 frame left out: error frames 1"):
        log.stop()
    assert canser.read(tmp_path / "run.pcapng")["id"].tolist() == [1]


def test_a_protocol_that_does_not_exist_leaves_no_file_open(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="unknown protocol"):
        can.Logger(str(tmp_path / "run.pcapng"), protocol="sped")
