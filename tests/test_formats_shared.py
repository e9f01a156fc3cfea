"""Text logs by many tools, against frames that plain parsers have found in them."""

import gzip
import io
import json
from collections.abc import Callable
from typing import Any

import pytest

from canser.errors import FormatError
from canser.files import candump, csv
from reference import NO_TIME, Frame
from samples import listed
from shared import LOG_FILES, needs_logs

pytestmark = needs_logs

CHANNELS = "frames of 2 channels become one: "
SENT = "direction is not kept: received "

# Files that are read whole, and what is told of them.
READ = {
    "canboat_actisense-522.candump.log": [],
    "canboat_candump-fast.txt": [],
    "edge-asc2log.log": [CHANNELS + "can0 7, can1 2"],
    "edge-pycan33.log": [CHANNELS + "0 7, 1 2"],
    "edge.log": [CHANNELS + "can0 7, can1 2", SENT + "8, sent 1"],
    "made-nul-tail.log": ["ends in 64 NUL bytes; was the power cut? Frames may be missing"],
    "savvycan_candump.log": [],
    "edge.csv": [],
    "edge-pycan33.csv": [],
}

# Files of which some lines are left out here, for they hold no frame of classic CAN: the number
# of those, and what is told of the others.
READ_IN_PART = {
    # The last line is torn.
    "canboat_candumpSample3.txt": (1, []),
    "css_multiple_CAN.log": (128, [CHANNELS + "can0 18, can1 18"]),
    "made-all.log": (
        3,
        [
            "frames of 3 channels become one: can0 5, vcan-long.name 1, can1 2",
            SENT + "7, sent 1",
            "raw dlcs of 9 to 15 become 8: 2",
        ],
    ),
}

# Files of other formats, and of the line that says so.
REFUSED = {
    "busmaster_Replay_04.log": "line 1: .*BUSMASTER",
    "savvycan_BusMasterLog.log": "line 1: .*BUSMASTER",
    "savvycan_MicrochipLog.log": "line 1: ",
    "edge-screen.txt": "line 1: ",
    "made-screen.txt": "line 1: ",
    "canboat_candumpSample1.txt": "line 9: ",
    "canboat_sample-YDWG02.txt": "line 1: ",
    "css_multiple_CAN.csv": "no column timestamp, ",
    "edge.gvret.csv": "no column timestamp, ",
    "made-gvret-old.csv": "no column timestamp, ",
}


def reader(name: str) -> Callable[..., Any]:
    return csv.parse if name.endswith(".csv") else candump.parse


def read(name: str, raw: bytes) -> tuple[list[Frame], list[str]]:
    told: list[str] = []
    return listed(reader(name)(io.BytesIO(raw), name, told.append)), told


def expected(name: str) -> list[Frame]:
    with gzip.open(LOG_FILES / "expected.json.gz") as file:
        rows = json.load(file)[name]["frames"]
    return [
        Frame(
            number,
            # An error frame's digits do not tell it.
            bool(ext) and not err,
            bool(rtr),
            dlc,
            bool(err),
            bytes.fromhex(data or "").ljust(8, b"\0"),
            NO_TIME if ts is None else ts,
        )
        for ts, _, _, number, ext, rtr, err, dlc, data in rows
    ]


@pytest.mark.parametrize("name", READ)
def test_a_log_is_read_as_its_tool_meant_it(name: str) -> None:
    assert read(name, (LOG_FILES / name).read_bytes()) == (expected(name), READ[name])


@pytest.mark.parametrize("name", READ_IN_PART)
def test_all_classic_frames_of_a_log_are_read(name: str) -> None:
    left_out, told = READ_IN_PART[name]
    lines = (LOG_FILES / name).read_bytes().splitlines(keepends=True)
    good = []
    for line in lines:
        try:
            read(name, line)
        except FormatError:
            continue
        good.append(line)
    assert len(lines) - len(good) == left_out
    assert read(name, b"".join(good)) == (expected(name), told)
    with pytest.raises(FormatError):
        read(name, b"".join(lines))


@pytest.mark.parametrize("name", REFUSED)
def test_another_format_is_an_error_of_one_line(name: str) -> None:
    with pytest.raises(FormatError, match=REFUSED[name]) as error:
        read(name, (LOG_FILES / name).read_bytes())
    assert "\n" not in str(error.value)
