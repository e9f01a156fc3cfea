"""The live table of a port in the terminal, as an application of textual, an optional extra."""

import threading
import time
from collections.abc import Callable, Sequence
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt
from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.widgets import Footer, Input, Static

from canser._frames import FRAME_DTYPE
from canser.codec.decoder import Stats
from canser.live.meter import Meter, Rates
from canser.live.ports import Port
from canser.monitoring._table import DESCENDING, Heading, Table
from canser.monitoring.livetable import ROW_DTYPE, LiveTable, RowArray, choose, ordered
from canser.monitoring.signals import RowSignals
from canser.timing.host import HostClock

__all__ = ["Monitor"]

# Interval at which the screen is drawn, at any frame rate. Frames are read in batches of the same
# time, so that many frames make no more batches than few.
_TICK_S: Final = 0.1

# Frames of a batch at most.
_ROOM: Final = 1 << 15


class _Reader(threading.Thread):
    """Read a port into a live table, to its end or until `stop`.

    `error` is the error that has ended the reading. The port stays open: its owner closes it.
    """

    def __init__(self, port: Port, bitrate: int | None) -> None:
        super().__init__(name="canser monitor", daemon=True)
        self.table = LiveTable()
        self.meter = Meter(bitrate, time.monotonic())
        self.stats: Stats = port.stats
        self.gaps = 0
        self.error: Exception | None = None
        self._port, self._ending = port, threading.Event()

    def run(self) -> None:
        room = np.empty(_ROOM, FRAME_DTYPE)
        try:
            while not self._ending.is_set():
                frames = self._port.read_batch(room, min_frames=_ROOM, timeout=_TICK_S)
                self.table.add(frames)
                self.gaps += len(self._port.take_gaps())
                self.stats = self._port.stats
                self.meter.add(frames, self.stats.bytes_in, time.monotonic())
        except Exception as error:  # noqa: BLE001 - the application shows it
            self.error = error

    def stop(self) -> None:
        """End the thread, and wait for its end."""
        self._ending.set()
        self.join()


class _Status(Static):
    """The lines at the top: the port, the rates, and the counters of faults."""


class _FilterLine(Input):
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "submit", "Done", priority=True),
        Binding("escape", "app.cancel_filter", "Cancel"),
    ]


class Monitor(App[None]):
    """Show the frames from an open port in a table until the user quits.

    A separate thread reads the port to its end; the port is not closed.

    `filters`: the text of the filter line at first, see `livetable.choose`. `bitrate`: that of
    the bus in bit/s, for the bus load, if the port does not know it. `remarks`: a list that may
    grow; its last remark is shown. `stopped`: the application also ends when it returns True.
    `signals`: what shows the signals of each row under it.
    """

    ENABLE_COMMAND_PALETTE = False

    CSS = """
    Screen { background: $background; }
    _Status { height: 3; background: $panel; padding: 0 1; text-wrap: nowrap; }
    Heading { height: 1; background: $primary-darken-2; color: $text; }
    Table {
        background: $background; overflow-x: hidden; scrollbar-size-vertical: 1;
        scrollbar-color: $primary; scrollbar-background: $background;
    }
    Table > .id { color: $text-primary; text-style: bold; }
    Table > .number { color: $foreground; }
    Table > .quiet { color: $foreground-disabled; }
    Table > .error { color: $text-error; text-style: bold; }
    Table > .constant { color: $foreground-muted; }
    Table > .data { color: $foreground; }
    Table > .fading { color: $text-warning; text-style: bold; }
    Table > .fresh { color: $warning-muted; background: $text-warning; text-style: bold reverse; }
    Table > .bar { color: $primary; }
    #note { display: none; height: auto; padding: 0 1; background: $error; color: $text; }
    #note.remark { background: $warning-darken-2; }
    #filter { display: none; height: 1; background: $panel; }
    #filter Static { width: auto; padding: 0 1; text-style: bold; }
    #filter Input { width: 1fr; height: 1; border: none; padding: 0; background: $panel; }
    #wrong { display: none; height: auto; padding: 0 1; color: $text-error; background: $panel; }
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("i", "sort('id')", "ID"),
        Binding("n", "sort('count')", "Count"),
        Binding("p", "sort('period')", "Period"),
        Binding("j", "sort('jitter')", "Jitter"),
        Binding("d", "sort('dlc')", "DLC"),
        Binding("s", "sort('ts')", "Seen"),
        Binding("slash", "filter", "Filter", key_display="/"),
        Binding("space", "pause", "Pause", key_display="space"),
        Binding("c", "clear", "Clear"),
        Binding("q,ctrl+c", "quit", "Quit", key_display="q"),
    ]

    def __init__(
        self,
        port: Port,
        *,
        filters: str = "",
        bitrate: int | None = None,
        remarks: Sequence[str] = (),
        stopped: Callable[[], bool] = lambda: False,
        signals: RowSignals | None = None,
    ) -> None:
        super().__init__()
        self._port, self._filter, self._signals = port, filters, signals
        self._remarks, self._stopped = remarks, stopped
        self._bitrate = port.bitrate if bitrate is None else bitrate
        self._reader = _Reader(port, self._bitrate)
        self._stats = port.stats
        self._clock = HostClock()
        self._begin = time.monotonic()
        self._paused = self._ended = False
        self._before = ""  # the filter before the one that is being typed
        # All rows as they are shown, the time of this state (ns), and the number of their frames.
        self._rows: RowArray = np.zeros(0, ROW_DTYPE)
        self._now = self._frames = 0

    @property
    def error(self) -> Exception | None:
        """The error that has ended the reading, or None."""
        return self._reader.error

    def compose(self) -> ComposeResult:
        """Lay out the screen."""
        yield _Status()
        yield Heading()
        yield Table(self._signals)
        yield Static(id="note", markup=False)
        with Horizontal(id="filter"):
            yield Static("Filter", markup=False)
            names = "" if self._signals is None else "  RPM"
            yield _FilterLine(placeholder=f"18F  123:7FF  #FF{names}", compact=True)
            hint = "digits alone match the start of an id"
            yield Static(hint + (names and ", text a name"), markup=False)
        yield Static(id="wrong", markup=False)
        yield Footer(compact=True)

    def on_mount(self) -> None:
        """Start the thread that reads."""
        self.query_one(Table).focus()
        self._reader.start()
        self.set_interval(_TICK_S, self._draw)
        self.call_after_refresh(self._draw)

    def on_unmount(self) -> None:
        """End the thread."""
        if self._reader.is_alive():
            self._reader.stop()

    # Actions of the keys

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Return whether the footer shows a key: those of the table are off in the filter line."""
        off = action in {"sort", "filter", "pause", "clear"} and isinstance(
            self.focused, _FilterLine
        )
        return not off and super().check_action(action, parameters)

    def action_sort(self, by: str) -> None:
        """Sort by a key; the second time in the reverse order."""
        heading = self.query_one(Heading)
        heading.descending = not heading.descending if heading.by == by else by in DESCENDING
        heading.by = by
        heading.refresh()
        self._draw()

    def action_pause(self) -> None:
        """Pause or continue the display; frames are counted all the time."""
        self._paused = not self._paused
        self._draw()

    def action_clear(self) -> None:
        """Remove all rows."""
        self._reader.table.clear()
        if self._signals is not None:
            self._signals.clear()
        self._take()
        self._draw()

    def action_filter(self) -> None:
        """Open the filter line."""
        line = self.query_one(_FilterLine)
        self._before = line.value = self._filter
        self.query_one("#filter").display = True
        line.focus()

    def action_cancel_filter(self) -> None:
        """Close the filter line, and restore the filter before."""
        self.query_one(_FilterLine).value = self._filter = self._before
        self._close_filter()

    def on_input_changed(self, event: Input.Changed) -> None:
        """Apply the filter while it is typed."""
        wrong = self.query_one("#wrong", Static)
        try:
            self._choose(event.value)
        except ValueError as error:
            wrong.update(str(error))
            wrong.display = True
            return
        wrong.display = False
        self._filter = event.value
        self._draw()

    def on_input_submitted(self) -> None:
        """Close the filter line, unless its filter cannot be read."""
        if not self.query_one("#wrong").display:
            self._close_filter()

    def _close_filter(self) -> None:
        self.query_one("#filter").display = self.query_one("#wrong").display = False
        self.query_one(Table).focus()
        self._draw()

    # The display

    def _take(self) -> None:
        """Copy the present state of the table."""
        table = self._reader.table
        self._rows, self._frames, self._now = table.rows(), table.frames, self._clock()

    def _draw(self) -> None:
        if not self.is_running:
            return  # the application is ending, and its widgets are gone
        if self._stopped():
            self.exit()
            return
        error = self.error
        # Before the rows, so that no counted frame is missing in the rows.
        self._stats = self._reader.stats
        # When the device is gone the table stays as it is.
        if not self._paused and (error is None or not self._ended):
            self._take()
        self._ended = error is not None
        heading = self.query_one(Heading)
        shown = self._rows.compress(self._choose(self._filter))
        shown = ordered(shown, heading.by, descending=heading.descending)
        self.query_one(Table).show(shown, self._now, self._frames, self._hint())
        self._show_status(len(shown))
        self._show_note()

    def _choose(self, text: str) -> npt.NDArray[np.bool_]:
        """Mark the rows that match a filter; ValueError if it cannot be read."""
        if self._signals is None:
            return choose(self._rows, text)
        return self._signals.choose(self._rows, text)

    def _hint(self) -> str:
        if len(self._rows):
            return f"the filter {self._filter} passes none of {len(self._rows):,} ids"
        skipped = self._stats.bytes_skipped
        if skipped and not self._stats.frames:
            return (
                f"{skipped:,} bytes have come, but no {self._port.protocol} frame is among them: "
                "are baud rate and protocol right?"
            )
        return "waiting for frames"

    def _show_note(self) -> None:
        note = self.query_one("#note", Static)
        error, others = self.error, self._reader.table.others
        if error is not None:
            text = f"{error}. The table stays as it was; q quits."
        elif others:
            text = (
                f"{others:,} frames have no row, because there are too many ids: "
                "are baud rate and protocol right?"
            )
        elif self._remarks:
            text = self._remarks[-1]
        else:
            return
        if text != str(note.content):
            note.set_class(error is None, "remark")
            note.update(text)
            note.display = True

    def _show_status(self, shown: int) -> None:
        status = self.query_one(_Status)
        # The size stays the same, so no other widget needs a new layout.
        status.update(self._status_text(shown, status.size.width), layout=False)

    def _status_text(self, shown: int, width: int) -> Text:
        port, stats = self._port, self._stats
        rates = Rates(0, 0, None) if self.error is not None else self._reader.meter.rates()
        ids = f"{len(self._rows):,}"
        good = (
            ("frames", f"{stats.frames:,}"),
            ("frames/s", f"{rates.frames:,.0f}"),
            ("kB/s", f"{rates.bytes / 1e3:,.1f}"),
            ("bus load", "-" if rates.load is None else f"{rates.load:.0%}"),
            ("ids", f"{shown:,}/{ids}" if self._filter else ids),
        )
        bad = (
            ("skipped", f"{stats.bytes_skipped:,}"),
            ("resyncs", f"{stats.resyncs:,}"),
            ("lost", f"{port.bytes_lost:,}"),
            ("gaps", f"{self._reader.gaps:,}"),
            ("ring", f"{port.ring_fill:.0%}"),
        )
        lines = (self._title(width), _cells(good, width, ""), _cells(bad, width, "yellow"))
        return Text("\n").join(lines)

    def _title(self, width: int) -> Text:
        port = self._port
        about = [port.protocol, f"{port.baudrate:,} baud"]
        if self._bitrate is not None:
            about.append(f"{self._bitrate / 1000:g} kbit/s")
        seconds = int(time.monotonic() - self._begin)
        right = Text("  ")
        if self._filter:
            right.append(f" /{self._filter} ", "reverse")
            right.append(" ")
        right.append(f"{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02} ", "dim")
        state, style = (
            (" GONE ", "bold white on red")
            if self.error is not None
            else (" PAUSED ", "bold black on yellow")
            if self._paused
            else (" LIVE ", "bold black on green")
        )
        right.append(state, style)
        left = Text.assemble((port.url, "bold"), "  ", (" \u00b7 ".join(about), "dim"))
        room = max(width - right.cell_len, 0)
        left.truncate(room, overflow="ellipsis", pad=True)
        return left + right


# Widths of the cells on a line of 78 characters; the first has room for ten digits.
_CELLS: Final = (20, 16, 16, 15, 11)


def _cells(cells: Sequence[tuple[str, str]], width: int, colour: str) -> Text:
    """Return counters, pairs of name and value, in columns; values other than 0 in a colour."""
    text = Text(no_wrap=True)
    for (name, value), share in zip(cells, _CELLS, strict=True):
        text.append(f"{name} ", "dim")
        text.append(value, "bold" if value in ("0", "0%") else f"bold {colour}")
        text.append(" " * max(share * width // 78 - len(name) - 1 - len(value), 1))
    return text
