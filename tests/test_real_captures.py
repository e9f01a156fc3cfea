"""Real traffic as adapters send it: every frame of the logs, in order, nothing skipped."""

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

import canser
import shared
from canser._frames import NO_TIME, FrameArray
from canser.commands import cli
from canser.errors import CanserWarning

pytestmark = shared.needs_captures

PAIRS = [
    (log, protocol)
    for log in shared.LOGS
    for protocol in canser.protocols()
    if (log, protocol) != ("boat", "cantalope")  # it has no extended frames
    and (shared.CAPTURES / f"{log}.{protocol}.bin").exists()
]


def without_times(frames: FrameArray) -> FrameArray:
    timeless = frames.copy()
    timeless["ts"] = NO_TIME
    return timeless


@pytest.mark.parametrize(("log", "protocol"), PAIRS)
def test_every_frame_of_the_log_comes_back(log: str, protocol: str) -> None:
    raw = (shared.CAPTURES / f"{log}.{protocol}.bin").read_bytes()
    want = shared.expected(log)
    decoder = canser.Decoder(protocol)
    frames = np.concatenate((decoder.feed(raw), decoder.flush()))
    stats = decoder.stats
    assert np.array_equal(without_times(frames), without_times(want))
    assert stats.bytes_skipped == stats.resyncs == stats.controls == stats.pending == 0
    assert stats.bytes_framed == stats.bytes_in == len(raw)
    if protocol == "serial":
        assert np.array_equal(frames["ts"] % 1_000_000, np.zeros(len(frames)))
        ticks = frames["ts"] // 1_000_000
        if log != "boat":
            # Milliseconds from the first frame on, cut, in the floating point of
            # the program that wrote them.
            seconds = want["ts"] // 1000 / 1e6
            assert np.array_equal(ticks, np.trunc((seconds - seconds[0]) * 1000))
        else:
            # Its seconds were added to a date first, which costs some a millisecond.
            late = (want["ts"] - want["ts"][0]) // 1_000_000 - ticks
            assert set(late.tolist()) <= {-1, 0, 1}
    else:
        assert (frames["ts"] == NO_TIME).all()
    assert canser.encode(frames, protocol) == raw


@pytest.mark.parametrize(("log", "protocol"), PAIRS)
def test_convert_gives_the_frames_of_the_log(
    log: str, protocol: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raw = shared.CAPTURES / f"{log}.{protocol}.bin"
    out = tmp_path / "out.log"
    assert cli.main(["convert", str(raw), str(out), "-p", protocol]) == 0
    assert " + 0 skipped + 0 pending" in capsys.readouterr().err
    lines = [line.split()[-1] for line in out.read_text().splitlines()]
    want = [
        f"{arbitration_id:0{8 if ext else 3}X}#{data.hex().upper()}"
        for _, arbitration_id, ext, data in shared.LOGS[log]()
    ]
    assert lines == want
    back = tmp_path / "back.bin"
    assert cli.main(["convert", str(out), str(back), "-p", protocol]) == 0
    assert back.read_bytes() == raw.read_bytes()


@pytest.mark.parametrize("protocol", ["serial", "seeed"])
def test_a_noisy_line_loses_no_more_than_the_noise_hit(protocol: str) -> None:
    want = shared.expected("car")
    raw = (shared.CAPTURES / f"car-noisy.{protocol}.bin").read_bytes()
    decoder = canser.Decoder(protocol)
    frames = np.concatenate((decoder.feed(raw), decoder.flush()))
    stats = decoder.stats
    assert stats.bytes_in == stats.bytes_framed + stats.bytes_skipped
    assert sum(stats.rejects.values()) == stats.bytes_skipped
    # About one byte in 1000 is hit, so one frame in 80 (seeed) or 54 (serial) at
    # most is lost or changed; a flipped payload byte leaves a frame that differs.
    known = {frame.tobytes() for frame in without_times(want)}
    good = sum(frame.tobytes() in known for frame in without_times(frames))
    assert good > len(want) * 0.98
    assert len(frames) > len(want) * 0.985
    if protocol == "serial":
        # A false frame spoils its own time, never those behind it.
        span = want["ts"][-1] - want["ts"][0]
        outside = (frames["ts"] < 0) | (frames["ts"] > span)
        assert outside.mean() < 0.002
        assert abs(int(np.median(frames["ts"][-100:])) - span) < 1e9


@pytest.mark.parametrize("name", [f"{log}.{protocol}" for log, protocol in PAIRS])
def test_the_protocol_of_each_is_recognised(name: str) -> None:
    raw = (shared.CAPTURES / f"{name}.bin").read_bytes()
    for sample in (raw, raw[5:2000], raw[1:400]):
        best = canser.identify(sample)[0]
        assert best.fits
        assert best.protocol == name.split(".")[1]


@pytest.mark.parametrize(("log", "protocol"), PAIRS)
@pytest.mark.parametrize("wrong", canser.protocols())
def test_a_wrong_protocol_is_doubted(log: str, protocol: str, wrong: str) -> None:
    raw = (shared.CAPTURES / f"{log}.{protocol}.bin").read_bytes()
    with nullcontext() if wrong == protocol else pytest.warns(CanserWarning, match="in no"):
        canser.decode(raw, wrong)
