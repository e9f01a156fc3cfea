"""Logs by many tools, against frames that plain parsers have found in them."""

import datetime as dt
import gzip
import json
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import canser
from canser.errors import FormatError
from shared import LOG_FILES, needs_logs

pytestmark = needs_logs

FORMATS = (".log", ".txt", ".csv", ".asc", ".trc", ".blf", ".pcap", ".pcapng", ".mf4")

# Of captures the channel is the number of the interface, which has a name besides.
CAPTURES = (".pcap", ".pcapng")


class Seen(NamedTuple):
    """A frame as `expected.json.gz` has it; None for what the file does not tell."""

    ts: int | None
    channel: str | None
    direction: str
    id: int | None
    ext: bool | None
    rtr: bool
    err: bool
    dlc: int | None
    data: str | None


def load() -> dict[str, Any]:
    if not LOG_FILES.exists():
        return {}
    with gzip.open(LOG_FILES / "expected.json.gz") as file:
        everything: dict[str, Any] = json.load(file)
    return everything


EXPECTED = load()
READ = [name for name, what in EXPECTED.items() if what and name.endswith(FORMATS)]
FOREIGN = [name for name, what in EXPECTED.items() if not what and name != "edge"]

# Of these the last line is cut: there it is a frame with less data than its length says.
CUT = {"canboat_candumpSample1.txt"}


def seen(path: Path) -> tuple[list[Seen], canser.Blocks]:
    """Return all frames of a file, with channels by name and directions."""
    rows = []
    # Expected times of MF4 files have the start added.
    epoch = "file" if path.suffix == ".mf4" else None
    blocks = canser.blocks(path, tz=dt.UTC, epoch=epoch)
    for frames in blocks:
        names = blocks.channel_names
        for at, frame in enumerate(frames):
            assert blocks.channels is not None
            assert blocks.directions is not None
            rtr, dlc = bool(frame["rtr"]), int(frame["dlc"])
            data = bytes(frame["data"][: 0 if rtr else dlc]).hex()
            sent = bool(blocks.directions[at])
            rows.append(
                Seen(
                    None if frame["ts"] == canser.NO_TIME else int(frame["ts"]),
                    names.get(int(blocks.channels[at])),
                    "Tx" if sent else "Rx",
                    int(frame["id"]), bool(frame["ext"]), rtr, bool(frame["err"]), dlc, data,
                )
            )  # fmt: skip
    return rows, blocks


def wanted(name: str, got: list[Seen]) -> list[Seen]:
    """Return the frames that a file must give; what it does not tell is as it was read."""
    rows = []
    start = EXPECTED[name].get("start_ns") or 0
    names = sorted({each.channel or "" for each in got})
    for given, have in zip(EXPECTED[name]["frames"], [*got, *got], strict=False):
        ts, channel, direction, number, ext, rtr, err, dlc, data = given
        if name.endswith(".blf"):
            ts -= start
            if not err and dlc > 15:
                continue  # no frame of classic CAN has it: it is counted
            dlc = min(dlc, 8)
            channel = channel if channel < 256 else ""
        told = str(channel) if channel not in ("", 0) or have.channel == "0" else have.channel
        if name.endswith(CAPTURES):
            told = (
                have.channel if channel == names.index(have.channel or "") else f"channel {channel}"
            )
            direction = direction or "Rx"
        rows.append(
            Seen(
                ts, told, direction,
                have.id if number is None else number,
                # The digits of an error frame do not tell it.
                have.ext if ext is None or err else bool(ext),
                bool(rtr), bool(err),
                have.dlc if dlc is None else dlc,
                have.data if data is None else data,
            )
        )  # fmt: skip
    return rows


@pytest.mark.parametrize("name", READ)
def test_a_log_is_read_as_its_tool_meant_it(name: str) -> None:
    if name.endswith(".mf4"):
        pytest.importorskip("asammdf")
    got, blocks = seen(LOG_FILES / name)
    frames = wanted(name, got)
    left_out = EXPECTED[name]["fd"]
    if name in CUT:
        frames.pop()
        assert any("the last line is cut off" in remark for remark in blocks.notes.remarks)
    assert got == frames
    told = [remark for remark in blocks.notes.remarks if "CAN FD" in remark]
    assert told == (
        [f"{LOG_FILES / name}: CAN FD frames, left out: {left_out}"] if left_out else []
    )


@pytest.mark.parametrize("name", FOREIGN)
def test_another_format_is_named_in_one_line(name: str) -> None:
    with pytest.raises(FormatError) as error:
        canser.read(LOG_FILES / name)
    assert "\n" not in str(error.value)
    assert "not raw bytes" in str(error.value)


# The start that a log names, as local time; by the formats' documents.
STARTS = {
    "edge.asc": "2026-01-01T00:00:00.123",
    "edge.blf": "2026-01-01T00:00:00.123",
    "edge-pycan46.mf4": "2026-11-26T09:38:52.535598",
    "edge.trc": "2026-01-01T00:00:00.123457",
    "edge-1.1.trc": "2026-01-01T00:00:00.123457",
    "logfile.asc": "2017-09-30T15:06:13.191",
    "css_multiple_CAN.asc": "2020-02-14T08:51:20",
    "css_multiple_CAN.trc": "2020-02-13T08:57:08.161546",
    "made-no-begin.asc": "2026-01-01",
    "busmaster_FormatConvASC2LOG.asc": "2012-05-18",
    "test_CanMessage_V1_0_BUS1.trc": "2021-12-18T14:28:07.062",
    "issue_1256.asc": "2014-05-27T16:09:35",
    "test_CanMessage.asc": "2017-09-30T22:06:13.191",
}


@pytest.mark.parametrize("name", STARTS)
def test_the_start_is_what_the_file_says(name: str) -> None:
    if name.endswith(".mf4"):
        pytest.importorskip("asammdf")
    _, blocks = seen(LOG_FILES / name)
    assert blocks.start_ns is not None
    date = dt.datetime.fromisoformat(STARTS[name]).replace(tzinfo=dt.UTC)
    assert abs(blocks.start_ns - int(date.timestamp() * 1e6) * 1000) < 9_000
    zone = dt.timezone(dt.timedelta(hours=2))
    with canser.blocks(LOG_FILES / name, tz=zone) as others:
        next(others)
        assert others.start_ns == blocks.start_ns - 2 * 3600 * 10**9
