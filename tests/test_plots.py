"""Pictures: what they show, at which places, and what they must not show."""

import doctest
import inspect
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import canser
from canser._frames import NO_TIME, FrameArray
from canser.signals.signal import Signal
from canser.simulation.traffic import line_noise, vehicle

pytest.importorskip("matplotlib")

import matplotlib as mpl
from matplotlib import pyplot as plt
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from canser import plots
from canser.plots._payload import count_flips
from canser.plots._raster import count_frames
from canser.plots._samples import Samples, reduce_samples
from canser.plots._style import DARK, LIGHT, Style, count_colours
from canser.plots._table import LINES_MOST, IdTable
from canser.plots._text import clock_text, duration_text, plain, wrapped
from canser.plots._timeline import Timeline, steady_frames

_S = 1_000_000_000
FRAMES = vehicle(4)


def periodic(count: int, *, ids: int = 1, step: int = 10_000_000) -> FrameArray:
    """Return frames of some ids in turn, with a counter in byte 0."""
    frames = np.zeros(count, canser.FRAME_DTYPE)
    frames["id"] = 0x100 + np.arange(count) % ids
    frames["dlc"] = 2
    frames["data"][:, 0] = np.arange(count) // ids
    frames["ts"] = np.arange(count) * step
    return frames


def with_hole(seconds: int) -> FrameArray:
    frames = periodic(2_000)
    frames["ts"][1_000:] += seconds * _S
    return frames


def pixels(image: Any) -> Any:
    """Return the values of an image, masked where it is empty."""
    return image.get_array()


def title(figure: Any, place: int = 0) -> str:
    return str(figure.axes[place].get_title(loc="left"))


def texts(figure: Any) -> str:
    """Return all texts of a figure."""
    return "\n".join(each.get_text() for each in figure.findobj(mpl.text.Text))


def signal(values: Any, *, step: int = 10_000_000, **more: Any) -> Signal:
    values = np.asarray(values)
    ts = (np.arange(len(values)) * step).view("M8[ns]")
    return Signal(name="S", message="M", group="M", ts=ts, values=values, **more)


PICTURES: dict[str, Any] = {
    "bus_load": lambda frames, **look: plots.bus_load(frames, 500_000, **look),
    "ids": plots.ids,
    "overview": lambda frames, **look: plots.overview(frames, 500_000, **look),
    "payload": lambda frames, **look: plots.payload(frames, "100", **look),
    "periods": plots.periods,
    "raster": plots.raster,
    "compare": lambda frames, **look: plots.compare(frames, frames[::2], **look),
}


@pytest.mark.parametrize("picture", PICTURES.values(), ids=PICTURES)
@pytest.mark.parametrize("dark", [False, True])
def test_every_picture_is_drawn(picture: Any, dark: bool, tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    figure = picture(periodic(500, ids=3), width=800, dark=dark)
    figure.savefig(tmp_path / "x.png")
    assert figure.get_figwidth() * figure.dpi == 800
    assert to_rgb(figure.get_facecolor()) == to_rgb((DARK if dark else LIGHT).ground)
    assert dict(mpl.rcParams) == before


CASES = {
    "none": periodic(0),
    "one": periodic(1),
    "one time": periodic(50, step=0),
    "no times": periodic(50),
    "an hour": with_hole(3_600),
    "only remote": periodic(20),
}
CASES["no times"]["ts"] = NO_TIME
CASES["only remote"]["rtr"] = True


@pytest.mark.parametrize("picture", PICTURES.values(), ids=PICTURES)
@pytest.mark.parametrize("frames", CASES.values(), ids=CASES)
def test_odd_captures_are_drawn(picture: Any, frames: FrameArray, tmp_path: Path) -> None:
    picture(frames, width=400).savefig(tmp_path / "x.svg")


def test_a_notebook_shows_a_figure_without_pyplot() -> None:
    figure = plots.raster(vehicle(1))
    assert figure._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]


def test_no_picture_is_kept_by_pyplot() -> None:
    before = plt.get_fignums()  # those of other tests
    plots.raster(FRAMES)
    assert plt.get_fignums() == before


def test_pictures_are_drawn_on_the_axes_of_others() -> None:
    figure = Figure(figsize=(8, 8))
    axes = figure.subplots(3, 2).ravel()
    assert plots.bus_load(FRAMES, ax=axes[0]) is figure
    for draw, ax in zip((plots.ids, plots.periods, plots.raster), axes[1:], strict=False):
        assert draw(FRAMES, ax=ax) is figure
        assert ax.get_title(loc="left")
    assert plots.payload(FRAMES, "7E0", ax=axes[4]) is figure
    assert plots.compare(FRAMES, FRAMES, ax=axes[5]) is figure


def test_pictures_of_two_threads_are_apart() -> None:
    """Styles are given to each part, not to matplotlib."""
    found: dict[bool, Any] = {}

    def draw(dark: bool) -> None:
        found[dark] = plots.periods(FRAMES, dark=dark).axes[0].xaxis.label.get_color()

    threads = [threading.Thread(target=draw, args=(dark,)) for dark in (False, True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {False: LIGHT.text, True: DARK.text}


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: plots.raster([1]), TypeError, "FRAME_DTYPE"),  # type: ignore[arg-type]
        (lambda: plots.raster(FRAMES, width=10), ValueError, "width is 10; give 400"),
        (lambda: plots.raster(FRAMES, dark="no"), TypeError, "dark"),  # type: ignore[arg-type]
        (lambda: plots.payload(FRAMES, "1234"), ValueError, "'1234' is no id"),
        (lambda: plots.payload(FRAMES, 0x123), TypeError, "id is 291; it must be a string"),  # type: ignore[arg-type]
        (lambda: plots.bus_load(FRAMES, 0), ValueError, "bitrate is 0"),
        (lambda: plots.signals([]), TypeError, "signals must be"),  # type: ignore[arg-type]
        (lambda: plots.signals({}), ValueError, "there are 0 signals"),
        (lambda: plots.signals({"S": signal([1])}, "T"), KeyError, "T"),
        (lambda: plots.signals({"S": signal([1])}, ax=[]), ValueError, "ax has 0 axes"),
    ],
)
def test_wrong_calls(call: Any, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        call()


# The time axis


def test_a_hole_is_hatched_with_its_length_and_takes_little_room() -> None:
    frames = with_hole(3_600)
    time = Timeline(frames)
    (hole,) = time.holes
    assert hole.length == pytest.approx(3_600.01)
    assert time.running == pytest.approx(19.98)
    assert hole.end - hole.begin == pytest.approx(0.05 * time.running)
    for figure in (plots.bus_load(frames, 500_000), plots.raster(frames)):
        assert "1:00:00 h" in [each.get_text() for each in figure.axes[0].texts][-1]
        assert "1 hole, 1:00:00 h" in texts(figure)
        hatched = [each for each in figure.axes[0].patches if each.get_hatch()]
        assert len(hatched) == 1


def test_a_short_hole_has_its_length() -> None:
    frames = periodic(20_000)
    frames["ts"][10_000:] += 2 * _S
    (hole,) = Timeline(frames).holes
    assert hole.end - hole.begin == pytest.approx(hole.length) == pytest.approx(2.01)


def test_ticks_tell_elapsed_time_behind_a_hole() -> None:
    axes = plots.bus_load(with_hole(3_600)).axes[0]
    labels = [each.get_text() for each in axes.get_xticklabels()]
    assert labels[0] == "0"
    assert labels[-1] == "3,615"
    places = axes.get_xticks()
    assert (np.diff(places) > 0).all()


def test_the_load_is_not_0_in_a_hole() -> None:
    """It is not known whether the bus was silent there."""
    frames = with_hole(30)
    (line,) = plots.bus_load(frames, 500_000).axes[0].lines
    x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    (hole,) = Timeline(frames).holes
    assert np.isnan(y).sum() == 1
    assert not ((x > hole.begin + 0.1) & (x < hole.end - 0.1)).any()
    assert np.nanmin(y) > 0


def test_a_clock_that_steps_back_goes_on() -> None:
    frames = periodic(2_000)
    frames["ts"][1_000:] -= frames["ts"][1_000]
    time = Timeline(frames)
    assert time.span == pytest.approx(19.98)
    assert time.restarts == [pytest.approx(9.99)]
    assert not time.holes
    assert (np.diff(time.places()) >= 0).all()
    figure = plots.bus_load(frames, 500_000)
    assert "the clock steps back (1)" in texts(figure)
    steady = steady_frames(frames)
    assert steady["ts"][1_000] == steady["ts"][999]
    assert (np.diff(steady["ts"]) >= 0).all()


def test_false_times_stretch_no_axis() -> None:
    """75 false times of a noisy line would make an axis of years."""
    frames = vehicle(10)
    frames = canser.decode(line_noise(canser.encode(frames, "serial"), rate=2e-3), "serial")
    time = Timeline(frames)
    assert time.untimed > 0
    assert time.span < 11
    columns = time.columns(100)
    assert (columns == -1).sum() == time.untimed
    note = f"{time.untimed} frames without a time, or with a false one, left out"
    assert note in texts(plots.raster(frames)).replace("\n", " ")
    assert len(steady_frames(frames)) == time.count


def test_frames_without_times_are_drawn_by_their_numbers() -> None:
    figure = plots.raster(CASES["no times"])
    assert figure.axes[0].get_xlabel() == "number of the frame"
    assert "no frame has a time" in texts(figure)
    assert "no frame has a time" in texts(plots.bus_load(CASES["no times"]))


def test_a_long_axis_is_in_hours() -> None:
    frames = periodic(2_000, step=10 * _S)
    axes = plots.bus_load(frames).axes[0]
    assert axes.get_xlabel() == "time since the first frame, h:mm:ss"
    assert "1:00:00" in [each.get_text() for each in axes.get_xticklabels()]


def test_dates_name_the_start() -> None:
    frames = periodic(100)
    frames["ts"] += 1_767_225_600 * _S
    assert plots.raster(frames).axes[0].get_xlabel() == "time since 2026-01-01 00:00:00 UTC, s"


# The rows


def test_rows_are_sorted_by_pattern_then_period_then_id() -> None:
    parts = []
    for number, step in ((0x300, 10), (0x100, 20), (0x200, 10)):
        frames = periodic(4_000 // step, step=step * 1_000_000)
        frames["id"] = number
        parts.append(frames)
    event = periodic(40)
    event["id"] = 0x001
    event["ts"] = np.cumsum(10 ** np.random.default_rng(1).uniform(6, 9, 40)).astype(np.int64)
    table = IdTable(canser.merge(*parts, event))
    assert table.names == ["200", "300", "100", "001"]
    assert [each.split()[1] for each in table.labels] == ["10", "10", "20", "event"]


def test_ids_with_few_frames_share_a_row_and_are_counted() -> None:
    few = periodic(30, ids=10)
    few["id"] += 0x300
    few["ts"] += 5_000_000
    frames = canser.merge(periodic(500), few)
    table = IdTable(frames)
    assert table.labels[1:] == ["10 ids < 10 frames"]
    assert table.sums(table.stats["count"]).tolist() == [500, 30]
    counts = np.bincount(table.line_of_frames())
    assert counts.tolist() == [500, 30]
    assert "10 ids < 10 frames in one row" in texts(plots.raster(frames))
    assert "10 ids < 10 frames not shown" in texts(plots.periods(frames)).replace("\n", " ")


def test_the_busiest_60_of_500_ids_are_shown_and_the_others_counted() -> None:
    frames = periodic(6_000, ids=500, step=100_000)
    busy = periodic(3_000, ids=60, step=200_000)
    busy["id"] += 0x400
    table = IdTable(canser.merge(frames, busy))
    assert table.shown == LINES_MOST
    assert table.labels[-1] == "500 more ids"
    assert set(table.names) == {f"{0x500 + number:03X}" for number in range(60)}
    assert table.sums(table.stats["count"]).sum() == 9_000
    assert title(plots.raster(canser.merge(frames, busy))).startswith("9,000 frames of 560 ids")


def test_a_raster_counts_each_frame_once() -> None:
    time, table = Timeline(FRAMES), IdTable(FRAMES)
    counts = count_frames(table.line_of_frames(), time.columns(300), len(table), 300)
    assert counts.sum() == len(FRAMES)
    for line, name in enumerate(table.names[:5]):
        frames = canser.by_id(FRAMES)[name]
        column = (frames["ts"] - FRAMES["ts"][0]) * 300 // np.ptp(FRAMES["ts"])
        assert counts[line].tolist() == np.bincount(np.minimum(column, 299), minlength=300).tolist()


def test_a_raster_leaves_empty_what_has_no_frame() -> None:
    (image,) = plots.raster(with_hole(30)).axes[0].images
    assert pixels(image).mask.any()
    assert pixels(image).min() >= 1


# Figures


def test_the_title_of_a_load_is_that_of_bus_load() -> None:
    rows = canser.bus_load(FRAMES, 500_000)
    found = title(plots.bus_load(FRAMES, 500_000))
    assert found.startswith("Bus load at 500 kbit/s in windows of 100 ms: mean ")
    assert found.endswith(f"highest {rows['load'].max():.1%}".replace("%", " %"))


def test_a_load_of_over_100_percent_asks_for_the_bit_rate() -> None:
    assert "x over 100 %" in texts(plots.bus_load(FRAMES, 10_000))
    assert "x over 100 %" not in texts(plots.bus_load(FRAMES, 1_000_000))


def test_error_frames_are_marked_and_counted() -> None:
    frames = periodic(1_000)
    frames["err"][500] = True
    figure = plots.bus_load(frames, 500_000)
    assert "x: 1 error frame, which have no length" in texts(figure)
    assert [line.get_marker() for line in figure.axes[0].lines].count("x") == 1


def test_missing_frames_have_a_second_sign() -> None:
    frames = periodic(1_000)
    frames = frames.compress(np.arange(1_000) % 100 != 50)
    figure = plots.periods(frames)
    assert title(figure) == "1 of 1 id is periodic; 10 frames missing"
    (wrong,) = [each for each in figure.axes[0].texts if each.get_color() == LIGHT.wrong]
    assert wrong.get_text().split() == ["10", "x"]


def test_loss_is_no_jitter() -> None:
    frames = periodic(1_000).compress(np.arange(1_000) % 10 != 5)
    assert "0 ms" in texts(plots.periods(frames))


def test_flips_are_counted_bit_by_bit() -> None:
    rng = np.random.default_rng(7)
    data = rng.integers(0, 256, (5_000, 8)).astype(np.uint8)
    columns = np.sort(rng.integers(0, 20, 5_000)).astype(np.int32)
    flips = np.zeros_like(data)
    flips[1:] = data[1:] ^ data[:-1]
    shuffled = rng.permutation(5_000)
    for order in (np.arange(5_000), shuffled):
        counts, found = count_flips(flips[order], columns[order], 22)
        assert counts.tolist() == np.bincount(columns, minlength=22).tolist()
        bits = np.unpackbits(flips, axis=1).reshape(-1, 8, 8).astype(np.int64)
        expected = np.zeros((22, 8, 8), np.int64)
        np.add.at(expected, columns, bits)
        assert np.array_equal(found, expected)


def test_the_highest_bit_is_on_top_and_still_bits_are_grey() -> None:
    frames = periodic(1_000)
    frames["data"][:, 1] = 0xFF
    figure = plots.payload(frames, "100")
    assert title(figure) == "Id 100: 8 of 16 bits move in 1,000 frames"
    ground, rates = figure.axes[0].images
    assert pixels(rates).shape[0] == 16
    by_bit = pixels(rates).filled(0).mean(axis=1)
    assert by_bit[:8].argmax() == 7  # the lowest bit of a counter moves most
    assert not by_bit[8:].any()
    assert not pixels(ground)[8:].any()
    assert next(each.get_text() for each in figure.axes[0].get_yticklabels()) == "0.7"


def test_least_and_most_of_a_column_are_kept() -> None:
    """Every n-th sample would leave out a peak."""
    values = np.zeros(100_000)
    values[54_321] = 7
    samples = Samples(np.arange(100_000) / 1_000, values, np.array([0]))
    shown = reduce_samples(samples, 200, 100)
    assert len(shown.at) == 200
    assert shown.high.max() == 7
    assert shown.low.max() == 0
    assert shown.mean.max() == pytest.approx(7 / 500)


def test_a_line_breaks_where_samples_are_missing() -> None:
    full = signal(np.arange(100.0))
    kept = np.r_[0:50, 53:100]
    cut = Signal(name="S", message="M", group="M", ts=full.ts[kept], values=full.values[kept])
    for each, breaks in ((full, 0), (cut, 1)):
        line = plots.signals({"S": each}).axes[0].lines[0]
        assert np.isnan(line.get_ydata()).sum() == breaks


def test_what_resampling_does_not_know_is_not_drawn() -> None:
    valid = np.arange(100) >= 40
    figure = plots.signals({"S": signal(np.where(valid, 5.0, 0.0), valid=valid)})
    assert title(figure) == "M.S: 5 to 5, mean 5"
    assert len(np.asarray(figure.axes[0].lines[0].get_xdata())) == 60


def test_a_dense_signal_has_its_mean_as_a_line() -> None:
    figure = plots.signals({"S": signal(np.tile([0, 10], 50_000))}, width=600)
    (line,) = figure.axes[0].lines
    assert np.asarray(line.get_ydata()) == pytest.approx(5, rel=0.02)
    assert len(figure.axes[0].collections) == 1


def test_bands_have_the_texts_of_the_table() -> None:
    values = np.repeat([0, 1, 5], 100)
    figure = plots.signals({"S": signal(values, choices={0: "off", 1: "on"})})
    assert title(figure) == "M.S: off, on, 1 value not in the table; 2 changes"
    inside = {each.get_text() for each in figure.axes[0].texts}
    assert {"off", "on", "5"} <= inside
    hatched = [each for each in figure.axes[0].collections if each.get_hatch()]
    assert len(hatched) == 1  # the value that is not in the table


def test_bands_shorter_than_a_pixel_are_one_of_several_values() -> None:
    values = np.arange(200_000) % 2
    figure = plots.signals({"S": signal(values, choices={0: "off", 1: "on"})}, width=600)
    assert "several values" in texts(figure)


def test_signals_of_a_clock_that_restarts() -> None:
    ts = np.r_[0:1_000, 0:1_000] * 10_000_000
    one = Signal(name="A", message="M", group="M", ts=ts.view("M8[ns]"), values=np.arange(2_000))
    figure = plots.signals({"A": one})
    assert list(figure.axes[0].get_xlim()) == pytest.approx([0, 19.98])
    other = signal(np.arange(1_000))
    with pytest.raises(ValueError, match="the clock restarts"):
        plots.signals({"A": one, "S": other})


def test_a_stream_shows_skipped_bytes_where_they_are(tmp_path: Path) -> None:
    raw = canser.encode(periodic(4_000), "serial")
    cut = len(raw) // 2
    (tmp_path / "run.bin").write_bytes(raw[:cut] + b"\xaa" * 5_000 + raw[cut:])
    figure = plots.stream(tmp_path / "run.bin", "serial")
    skipped = canser.info(tmp_path / "run.bin", "serial").stats
    assert skipped is not None
    assert title(figure).startswith(f"{skipped.bytes_skipped:,} of {skipped.bytes_in:,} bytes are")
    stairs: Any = figure.axes[0].patches[0]
    values, edges, _ = stairs.get_data()
    assert cut / 1e3 - 1 <= edges[values.argmax()] <= cut / 1e3 + 6
    canser.write(periodic(3), tmp_path / "run.log")
    with pytest.raises(ValueError, match="holds frames"):
        plots.stream(tmp_path / "run.log")


def test_compare_counts_what_differs() -> None:
    frames = periodic(2_000, ids=4)
    other = frames.compress(
        (frames["id"] != 0x101) & ~((frames["id"] == 0x102) & (frames["ts"] // 40_000_000 % 2 == 0))
    )
    figure = plots.compare(frames, other, names=("one", "two"))
    found = canser.compare(frames, other)
    assert title(figure) == (
        f"3 ids in both, 1 in one only, 0 in two only; {len(found.bits)} bit"
        f"{' moves' if len(found.bits) == 1 else 's move'} in one only; 1 period differs"
    )
    assert "x only in one: 500 frames" in texts(figure)


# The look


def contrast(one: str, other: str) -> float:
    """Return the contrast of two colours, 1 to 21. Source: WCAG 2.1, relative luminance."""

    def luminance(colour: Any) -> float:
        parts = [
            c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)
        ]
        return float(np.dot(parts, (0.2126, 0.7152, 0.0722)))

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("style", [LIGHT, DARK], ids=["light", "dark"])
def test_colours_are_told_from_the_ground(style: Style) -> None:
    for colour in (style.text, style.faint):
        assert contrast(colour, style.ground) >= 4.5
    for colour in (style.ink, style.wrong):
        assert contrast(colour, style.ground) >= 3
    colours, _ = count_colours(style, 1, 100)
    assert contrast(colours(0), style.ground) >= 1.5


def test_texts_of_numbers() -> None:
    assert [plain(value) for value in (0, 1234.5, 0.00123, 999.6, -2.5)] == [
        *("0", "1,230", "0.00123", "1,000", "-2.5"),
    ]
    assert plain(2, even=True) == "2.00"
    assert [duration_text(ns) for ns in (0, 999.6e6, 1.38e9, 20e6, 700, 90.3e9, 3.6e12)] == [
        *("0 ms", "1 s", "1.38 s", "20 ms", "700 ns", "90.3 s", "1:00:00 h"),
    ]
    assert clock_text(3_725) == "1:02:05"
    assert "23.0 %" in wrapped("the highest load is 23.0 % of it", 25).splitlines()[1]


def test_each_public_picture_documents_its_parameters() -> None:
    griffe = pytest.importorskip("griffe")
    for name in plots.__all__:
        function = getattr(plots, name)
        parsed = griffe.Docstring(function.__doc__).parse("numpy")
        found = {section.kind.value: section.value for section in parsed}
        documented = [each.name for each in found["parameters"]]
        assert documented == list(inspect.signature(function).parameters), name
        assert {"returns", "raises", "examples"} <= found.keys(), name


@pytest.mark.parametrize("name", plots.__all__)
def test_examples_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = inspect.getdoc(getattr(plots, name)) or ""
    test = doctest.DocTestParser().get_doctest(text, {"np": np, "canser": canser}, name, name, 0)
    report: list[str] = []
    doctest.DocTestRunner(verbose=False).run(test, out=report.append)
    assert test.examples
    assert not report, "".join(report)
