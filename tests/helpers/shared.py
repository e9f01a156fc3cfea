"""The folder of real captures beside the project, where it is there."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray

CAPTURES = Path(__file__).parents[3] / "shared" / "captures"

needs_captures = pytest.mark.skipif(
    not CAPTURES.is_dir(), reason="the folder of real captures, ../shared/captures, is not here"
)

LOG_FILES = Path(__file__).parents[3] / "shared" / "logs"

needs_logs = pytest.mark.skipif(
    not LOG_FILES.is_dir(), reason="the folder of logs by many tools, ../shared/logs, is not here"
)

# The logs, read here by plain Python and not by canser: time in microseconds, id,
# extended, data.
Row = tuple[int, int, bool, bytes]


def candump_rows() -> Iterator[Row]:
    for line in (CAPTURES / "car.candump.log").read_text().splitlines():
        stamp, _, frame = line.split()
        arbitration_id, data = frame.split("#")
        seconds, micros = stamp.strip("()").split(".")
        yield (
            int(seconds) * 1_000_000 + int(micros),
            int(arbitration_id, 16),
            len(arbitration_id) > 3,
            bytes.fromhex(data),
        )


def gvret_rows() -> Iterator[Row]:
    for line in (CAPTURES / "tesla.gvret.csv").read_text().splitlines()[1:]:
        stamp, arbitration_id, extended, _, dlc, *data = line.split(",")
        payload = bytes.fromhex("".join(data))[: int(dlc)]
        yield int(stamp), int(arbitration_id, 16), extended == "true", payload


def trc_rows() -> Iterator[Row]:
    for line in (CAPTURES / "boat.trc").read_text(encoding="latin-1").splitlines():
        if not line.startswith(";"):
            _, stamp, _, arbitration_id, dlc, *data = line.split()
            payload = bytes.fromhex("".join(data))
            assert len(payload) == int(dlc)
            micros = round(float(stamp) * 1000)
            yield micros, int(arbitration_id, 16), len(arbitration_id) == 8, payload


LOGS = {"car": candump_rows, "tesla": gvret_rows, "boat": trc_rows}


def expected(log: str) -> FrameArray:
    """Return the frames of a log; `ts` in nanoseconds as the log has it."""
    rows = list(LOGS[log]())
    frames = np.zeros(len(rows), FRAME_DTYPE)
    stamps, ids, exts, datas = zip(*rows, strict=True)
    frames["ts"], frames["id"], frames["ext"] = np.array(stamps) * 1000, ids, exts
    frames["dlc"] = [len(data) for data in datas]
    padded = b"".join(data.ljust(8, b"\0") for data in datas)
    frames["data"] = np.frombuffer(padded, np.uint8).reshape(-1, 8)
    return frames


__all__ = ["CAPTURES", "LOGS", "NO_TIME", "expected", "needs_captures"]
