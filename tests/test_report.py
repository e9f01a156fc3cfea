"""The texts that the command prints, word for word where a script may read them."""

import pytest

import canser
from canser._frames import FrameArray
from canser.analysis import report
from canser.codec.decoder import Decoder, Stats
from canser.simulation.traffic import vehicle
from reference import NO_TIME, Frame
from samples import EPOCH, MILLISECOND, SECOND, array, info_of, timed

STANDARD = bytes.fromhex("AA C8 2301 0011223344556677 55")
STATUS = bytes.fromhex("AA55 04 01 02") + bytes(14) + b"\x07"
NOISE = bytes.fromhex("00 AA 00")


def info(frames: FrameArray, decoder: Decoder | None = None) -> list[str]:
    return list(info_of(frames, decoder=decoder).lines())


def info_of_stream(stream: bytes) -> list[str]:
    """Return what is said of a stream of `seeed`."""
    decoder = canser.Decoder("seeed")
    frames = decoder.feed(stream)
    decoder.flush()
    return info(frames, decoder)


def stats_of(stream: bytes) -> Stats:
    decoder = canser.Decoder("seeed")
    decoder.feed(stream)
    return decoder.stats


def named(name: str, lines: list[str]) -> str:
    """Return the line that begins with a name."""
    return next(line for line in lines if line.startswith(name))


def test_a_file_is_told_by_its_frames_and_ids() -> None:
    frames = array(
        Frame(0x123, dlc=8, ts=0),
        Frame(0x18FEF100, ext=True, dlc=2, ts=10 * MILLISECOND),
        Frame(0x123, dlc=4, ts=20 * MILLISECOND),
        Frame(0x7E0, rtr=True, dlc=2, ts=SECOND),
        Frame(0x123, rtr=True, dlc=8, ts=2 * SECOND),
    )
    assert info(frames) == [
        "frames     5, 2.5/s",
        "kinds      4 standard, 1 extended, 2 remote",
        "ids        3",
        "time       2.000 s, from 0.000 to 2.000",
        "dlc        2: 2, 4: 1, 8: 2",
        "",
        "      id     frames   share     rate/s   period ms  dlc",
        "     123          3  60.00%       1.50           -  4..8  1 remote",
        "     7E0          1  20.00%       0.50           -  2  remote",
        "18FEF100          1  20.00%       0.50           -  2",
    ]


def test_no_frames_have_no_table() -> None:
    assert info(array()) == [
        "frames     0",
        "ids        0",
        "time       not known: there are no times in it",
        "dlc        -",
    ]


def test_error_frames_are_named() -> None:
    assert named("kinds", info(array(Frame(1, err=True)))) == "kinds      1 standard, 1 error"


def test_unknown_times_make_no_rates() -> None:
    lines = info(timed(NO_TIME, NO_TIME))
    assert lines[0] == "frames     2"
    assert named("time", lines) == "time       not known: there are no times in it"
    assert lines[-1].split() == ["100", "2", "100.00%", "-", "-", "0"]


def test_a_time_of_day_has_its_date() -> None:
    assert named("time", info(timed(EPOCH, EPOCH + SECOND))) == (
        "time       1.000 s, from 1544106679.433 (2018-12-06 14:31:19 UTC) "
        "to 1544106680.433 (2018-12-06 14:31:20 UTC)"
    )


def test_the_last_time_that_a_record_holds_is_told() -> None:
    assert "2262-04-11" in named("time", info(timed(2**63 - 1)))


def test_jumps_of_the_clock_are_told_and_not_counted_as_time() -> None:
    hours = 9 * 3_600 * SECOND
    lines = info(timed(hours, hours + SECOND, 0, SECOND))
    assert named("time", lines).startswith("time       2.000 s without the jumps of the clock (1)")
    assert lines[0] == "frames     4, 2.0/s"


def test_false_times_are_told_and_not_counted_as_time() -> None:
    times = [number * SECOND for number in range(10)]
    lines = info(timed(*times[:5], 3_600 * 400 * SECOND, *times[5:]))
    assert named("time", lines) == (
        "time       9.000 s, from 0.000 to 9.000; false times left out: 1"
    )
    assert lines[0] == "frames     11, 1.2/s"
    lines = info(timed(*times, *times[:5], 3_600 * 400 * SECOND, *times[5:]))
    assert named("time", lines) == (
        "time       18.000 s without the jumps of the clock (1); false times left out: 1"
    )


def test_bytes_are_conserved_in_print() -> None:
    stats = stats_of(NOISE + STANDARD * 1_000 + STATUS + STANDARD[:5])
    assert report.conservation(stats) == (
        "13,028 bytes = 13,000 framed + 20 control + 3 skipped + 5 pending"
    )


def test_rejects_are_named_most_first_and_none_that_are_zero() -> None:
    assert report.reject_text(stats_of(NOISE + STANDARD)) == "marker 2, type 1"
    assert report.reject_text(stats_of(STANDARD)) == ""


def test_raw_bytes_are_told_with_their_counters() -> None:
    lines = info_of_stream(NOISE + STANDARD + STATUS)
    assert (
        named("bytes", lines)
        == "bytes      36 bytes = 13 framed + 20 control + 3 skipped + 0 pending"
    )
    assert named("resyncs", lines) == "resyncs    1"
    assert named("skipped", lines) == "skipped    marker 2, type 1"
    assert named("controls", lines) == "controls   1"
    assert lines[lines.index("controls   1") + 1] == f"           at 16: {STATUS.hex(' ').upper()}"


def test_a_clean_stream_has_no_line_of_skipped_bytes() -> None:
    assert not any(line.startswith(("skipped", "clock")) for line in info_of_stream(STANDARD))


@pytest.mark.parametrize(("count", "more"), [(4, []), (5, ["           and 1 more"])])
def test_of_many_control_packets_four_are_shown(count: int, more: list[str]) -> None:
    lines = info_of_stream(STATUS * count)
    shown = [number for number, line in enumerate(lines) if line.startswith("           at ")]
    assert len(shown) == 4
    assert lines[shown[-1] + 1 :] == more


def test_wraps_and_steps_back_of_the_device_clock_are_told() -> None:
    decoder = canser.Decoder("serial")
    frames = decoder.feed(
        canser.encode(timed(*(ms * MILLISECOND for ms in (2**32 - 1, 2**32, 0xFFFFFFFF))), "serial")
    )
    lines = info(frames, decoder)
    assert named("clock", lines) == "clock      wraps 1, steps back 1"


def test_uncertain_steps_back_of_a_clock_in_line_are_told() -> None:
    # A restart, a step back that is small, and one from a clock that is not in line again.
    times = [2**25 + k for k in range(17)] + [0, *range(2, 20), 5, 6, 2**25, 7]
    decoder = canser.Decoder("serial")
    frames = decoder.feed(canser.encode(timed(*(ms * MILLISECOND for ms in times)), "serial"))
    assert named("clock", info(frames, decoder)) == (
        "clock      wraps 0, steps back 3, of these uncertain 1"
    )


def test_a_ranking_has_a_row_for_each_protocol_the_best_first() -> None:
    raw = canser.encode(vehicle(1), "serial")
    fits = canser.identify(raw)
    lines = list(report.fit_lines(fits, len(raw)))
    assert lines[0].split() == [
        "protocol",
        "score",
        "explained",
        "by",
        "chance",
        "frames",
        "resyncs",
    ]
    assert [line.split()[0] for line in lines[1:]] == [fit.protocol for fit in fits]
    assert lines[1].startswith("serial     100.0%")


def test_a_ranking_says_where_it_counts_a_sample() -> None:
    raw = canser.encode(vehicle(10), "serial")
    *_, last = report.fit_lines(canser.identify(raw[:262_144]), 262_144)
    assert not last.startswith("counted")
    *_, last = report.fit_lines(canser.identify(raw[:262_145]), 262_145)
    assert last == "counted in a sample of 262,144 of 262,145 bytes"


def test_tables_fit_a_terminal_of_80_columns() -> None:
    lines = info(vehicle(10))
    table = lines[lines.index("") :] + list(report.fit_lines(canser.identify(STANDARD), 10**12))
    assert max(map(len, table)) <= 80


def test_ids_stand_most_frequent_first() -> None:
    """What noise makes up is seen once, and stands at the end."""
    ids = (0x100, 0x7FF, 0x7FF, 0x001)
    lines = info(array(*(Frame(number, ts=0) for number in ids)))
    assert [line.split()[0] for line in lines[-3:]] == ["7FF", "001", "100"]
