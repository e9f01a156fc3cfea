"""The monitor as its users see it: keys, marks, a device that goes, and a real terminal."""

import asyncio
import os
import queue
import re
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import canser
from canser._frames import FRAME_DTYPE, FrameArray
from canser.commands import cli
from canser.live.ports import Gap
from canser.timing.host import HostClock
from samples import MILLISECOND as MS

pytest.importorskip("textual")

from textual.pilot import Pilot
from textual.widgets import Static

from canser.monitoring._table import Heading, Table
from canser.monitoring.monitor import Monitor
from canser.monitoring.signals import RowSignals

PATIENCE = 60

PROTOCOL = "seeed"

posix = pytest.mark.skipif(sys.platform == "win32", reason="terminals are POSIX")

SMALL, LARGE = (80, 24), (160, 50)


class FakePort:
    """A port whose batches a test makes."""

    url, protocol, baudrate, bitrate = "/dev/fake", PROTOCOL, 115_200, 500_000
    bytes_lost, ring_fill = 0, 0.0

    def __init__(self) -> None:
        self.batches: queue.Queue[FrameArray | Exception] = queue.Queue()
        self.gaps: list[Gap] = []
        self._decoder = canser.Decoder(self.protocol)

    def read_batch(self, out: FrameArray, *, timeout: float, **_: int) -> FrameArray:
        try:
            came = self.batches.get(timeout=timeout)
        except queue.Empty:
            return out[:0]
        if isinstance(came, Exception):
            raise came
        counted = came.copy()
        counted["err"] = False  # the protocol has no error frames
        self._decoder.feed(canser.encode(counted, self.protocol))
        return came

    def feed(self, raw: bytes) -> None:
        """Feed bytes that are no frames."""
        self._decoder.feed(raw)

    @property
    def stats(self) -> canser.Stats:
        return self._decoder.stats

    def take_gaps(self) -> list[Gap]:
        gaps, self.gaps = self.gaps, []
        return gaps


def frames(arbitration_id: int, *data: bytes, every: int = 10 * MS, **fields: Any) -> FrameArray:
    """Return frames of one id with these payloads, up to now."""
    made = np.zeros(len(data), FRAME_DTYPE)
    made["id"], made["dlc"] = arbitration_id, [len(one) for one in data]
    padded = b"".join(one.ljust(8, b"\0") for one in data)
    made["data"] = np.frombuffer(padded, np.uint8).reshape(-1, 8)
    made["ts"] = HostClock()() - every * np.arange(len(data))[::-1]
    for name, value in fields.items():
        made[name] = value
    return made


class Screen:
    """What is on the screen, and who types."""

    def __init__(self, app: Monitor, pilot: Pilot[None], port: Any) -> None:
        self.app, self.pilot, self.port = app, pilot, port
        self.table = app.query_one(Table)

    def lines(self) -> list[str]:
        """Return the lines of the table that hold anything."""
        lines = [self.table.render_line(y).text for y in range(self.table.size.height)]
        return [line for line in lines if line.strip()]

    def ids(self) -> list[str]:
        return [line.split()[0] for line in self.lines()]

    def status(self) -> str:
        return str(self.app.query_one("_Status", Static).content)

    def note(self) -> str:
        note = self.app.query_one("#note", Static)
        return str(note.content) if note.display else ""

    def counter(self, name: str) -> str:
        found = re.search(rf"(?:^| ){re.escape(name)} (\S+)", self.status(), re.MULTILINE)
        return found[1] if found else ""

    async def until(self, condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, f"{self.status()}\n{self.note()}\n{self.lines()}"
            await self.pilot.pause(0.02)

    async def send(self, *batches: FrameArray) -> None:
        """Send frames, and wait until they are counted."""
        total = self.port.stats.frames + sum(map(len, batches))
        for batch in batches:
            self.port.batches.put(batch)
        await self.until(lambda: self.counter("frames") == f"{total:,}")


def show(
    test: Callable[[Screen], Awaitable[None]],
    *,
    port: Any = None,
    size: tuple[int, int] = SMALL,
    **options: Any,
) -> Monitor:
    """Run a test in the app."""
    port = port or FakePort()
    app = Monitor(cast("canser.Port", port), **options)

    async def run() -> None:
        async with app.run_test(size=size) as pilot:
            screen = Screen(app, pilot, port)
            await screen.until(screen.status)
            await test(screen)

    asyncio.run(run())
    return app


@pytest.mark.parametrize("size", [SMALL, LARGE], ids=str)
def test_a_row_for_each_id_under_its_titles(size: tuple[int, int]) -> None:
    async def test(screen: Screen) -> None:
        await screen.send(
            frames(0x18FEF100, *[b"\1\2\3"] * 4, ext=True),
            frames(0x123, *[bytes(8)] * 1_234, every=2 * MS),
            frames(0x7E0, bytes(2), rtr=True),
            frames(0x7E0, b"ABCDEFGH"),
            frames(0x7E0, b"ABCDEFGH"),
        )
        assert screen.ids() == ["123", "7E0", "7E0", "18FEF100"]
        first, answer, asked, extended = screen.lines()
        assert first.split()[:4] == ["123", "1,234", "2.00", "0.000"]
        assert "00 00 00 00 00 00 00 00" in first
        assert "41 42 43 44 45 46 47 48" in answer
        assert ("ABCDEFGH" in answer) == (size == LARGE)
        assert asked.split()[:5] == ["7E0", "R", "1", "-", "-"]
        assert "remote request" in asked
        assert extended.split()[1:3] == ["4", "10.00"]
        assert "01 02 03" in extended
        heading = screen.app.query_one(Heading).render().plain
        for title, text in (("ID", "123"), ("Count", "1,234"), ("Period ms", "2.00")):
            assert heading.index(title) + len(title) == first.index(text) + len(text)
        assert heading.index("Data") == first.index("00 00 00")
        assert heading.index("Seen") + 4 == first.index("now") + 3
        assert len(heading) <= size[0]
        assert all(len(line) <= size[0] for line in screen.status().splitlines())

    show(test, size=size)


SORTS = {
    "i": (["100", "200", "300"], ["300", "200", "100"]),
    "n": (["300", "100", "200"], ["200", "100", "300"]),
    "p": (["200", "300", "100"], ["100", "300", "200"]),
    "j": (["100", "300", "200"], ["300", "100", "200"]),  # that of 200 is not known
    "d": (["300", "100", "200"], ["100", "200", "300"]),
    "s": (["200", "300", "100"], ["100", "300", "200"]),
}


@pytest.mark.parametrize("key", SORTS)
def test_a_key_sorts_and_again_the_other_way_round(key: str) -> None:
    async def test(screen: Screen) -> None:
        now = HostClock()()
        for arbitration_id, ts, dlc in (
            (0x100, [0, 30, 50], 7),  # a jitter of 5 ms
            (0x200, [100, 101], 7),
            (0x300, [60, 62, 64, 66, 68, 70], 2),
        ):
            made = frames(arbitration_id, *[bytes(dlc)] * len(ts))
            made["ts"] = now + np.array(ts) * MS
            await screen.send(made)
        await screen.pilot.press("s" if key == "i" else "i")
        for expected in SORTS[key]:
            await screen.pilot.press(key)
            assert screen.ids() == expected

    show(test)


def test_an_error_frame_is_no_data_frame() -> None:
    async def test(screen: Screen) -> None:
        await screen.send(frames(0x004, b"a"), frames(0x004, bytes(8), err=True))
        data, error = screen.lines()
        assert data.split()[:2] == ["004", "1"]
        assert error.split()[:3] == ["00000004", "E", "1"]

    show(test)


def test_all_sorts_are_tested() -> None:
    keys = {b.key for b in Monitor.BINDINGS if getattr(b, "action", "").startswith("sort(")}  # type: ignore[union-attr]
    assert keys == SORTS.keys()


def test_a_click_on_a_title_sorts() -> None:
    async def test(screen: Screen) -> None:
        await screen.send(frames(0x100, b"a"), frames(0x200, b"a", b"b"))
        heading = screen.app.query_one(Heading)
        at = heading.render().plain.index("Count")
        await screen.pilot.click(Heading, offset=(at, 0))
        await screen.until(lambda: screen.ids() == ["200", "100"])
        assert heading.render().plain.index("\u25bcCount") == at - 1

    show(test)


def test_bytes_that_change_are_marked_without_colour_too(monkeypatch: pytest.MonkeyPatch) -> None:
    now = HostClock()() + 3_600_000 * MS
    monkeypatch.setattr("canser.monitoring.monitor.HostClock", lambda: lambda: now)

    async def test(screen: Screen) -> None:
        nonlocal now
        await screen.send(frames(0x100, bytes(8), ts=now), frames(0x200, bytes(8), ts=now))
        assert marked(screen, "100") == []
        changed = frames(0x100, b"\0\0\7\0\0\0\0\xff", ts=now)
        await screen.send(changed, frames(0x200, bytes(8), ts=now))
        assert marked(screen, "100") == ["07", "FF"]
        assert marked(screen, "200") == []
        now += 1_000 * MS  # the mark fades
        await screen.until(lambda: marked(screen, "100", "bold") == ["07", "FF"])
        assert marked(screen, "100") == []
        now += 2_000 * MS
        await screen.until(lambda: marked(screen, "100", "bold") == [])
        assert "3 s" in screen.lines()[0]  # since it was seen

    show(test)


def marked(screen: Screen, name: str, how: str = "reverse") -> list[str]:
    """Return the bytes in the row of an id that are reversed, or bold only."""
    (y,) = [y for y, line in enumerate(screen.lines()) if line.split()[0] == name]
    found = []
    for segment in list(screen.table.render_line(y))[1:]:
        style = segment.style
        if style is not None and ("reverse" if style.reverse else style.bold and "bold") == how:
            found += segment.text.split()
    return found


def test_filter_as_typed_kept_or_cancelled() -> None:
    async def test(screen: Screen) -> None:
        await screen.send(*(frames(i, b"a") for i in (0x101, 0x102, 0x201)))
        await screen.pilot.press("slash", *"10")
        assert "digits alone match the start of an id" in [
            str(each.content) for each in screen.app.query("#filter Static").results(Static)
        ]
        assert screen.ids() == ["101", "102"]
        assert screen.counter("ids") == "2/3"
        await screen.pilot.press(*"2:")
        wrong = screen.app.query_one("#wrong", Static)
        assert "cannot read the filter '102:'" in str(wrong.content)
        assert wrong.display
        assert screen.ids() == ["102"]
        await screen.pilot.press("enter")  # not with an error
        assert wrong.display
        await screen.pilot.press(*"7FF", "enter")
        assert screen.ids() == ["102"]
        assert not wrong.display
        await screen.pilot.press("n")  # is a key again, not a letter
        assert screen.ids() == ["102"]
        await screen.pilot.press("slash", *["backspace"] * 7, "escape")
        assert screen.ids() == ["102"]
        await screen.pilot.press("slash", *["backspace"] * 7)
        assert screen.ids() == ["101", "102", "201"]
        await screen.pilot.press(*"7", "enter")
        assert "the filter 7 passes none of 3 ids" in screen.lines()[0]

    show(test)


def test_filter_from_the_start() -> None:
    async def test(screen: Screen) -> None:
        await screen.send(*(frames(i, b"a") for i in (0x101, 0x102, 0x201)))
        assert screen.ids() == ["102", "201"]

    show(test, filters="201 102:7FF")


def test_pause_holds_the_table_and_counts_on() -> None:
    async def test(screen: Screen) -> None:
        await screen.send(frames(0x100, b"a"))
        await screen.pilot.press("space")
        assert "PAUSED" in screen.status()
        before = screen.lines()
        await screen.send(frames(0x100, b"b"), frames(0x200, b"c"))
        assert screen.lines() == before
        await screen.pilot.press("n")  # sorts what is there
        assert screen.lines() == before
        await screen.pilot.press("space")
        assert "LIVE" in screen.status()
        assert [line.split()[:2] for line in screen.lines()] == [["100", "2"], ["200", "1"]]

    show(test)


@pytest.mark.parametrize("keys", [["c"], ["space", "c"]], ids=str)
def test_clear(keys: list[str]) -> None:
    async def test(screen: Screen) -> None:
        await screen.send(frames(0x100, b"a"))
        await screen.pilot.press(*keys)
        assert screen.lines()[0].strip() == "waiting for frames"
        assert screen.counter("ids") == "0"
        assert screen.counter("frames") == "1"  # of the port: they are not forgotten

    show(test)


def test_what_goes_wrong_on_the_way_is_counted() -> None:
    async def test(screen: Screen) -> None:
        screen.port.feed(b"\0\0\0")
        screen.port.bytes_lost, screen.port.ring_fill = 12_345, 0.5
        screen.port.gaps = [Gap(0, 12_345, 0, "overflow")]
        await screen.send(frames(0x100, b"a"))
        await screen.until(lambda: screen.counter("gaps") == "1")
        names = ("skipped", "resyncs", "lost", "ring")
        assert [screen.counter(name) for name in names] == ["3", "1", "12,345", "50%"]

    show(test)


def test_header_names_the_port() -> None:
    async def test(screen: Screen) -> None:
        title = screen.status().splitlines()[0]
        assert title.startswith("/dev/fake  seeed \u00b7 115,200 baud \u00b7 250 kbit/s")

    show(test, bitrate=250_000)


def test_noise_only_asks_for_the_baud_rate() -> None:
    async def test(screen: Screen) -> None:
        screen.port.feed(bytes(5_000))
        await screen.until(lambda: "5,000 bytes have come" in screen.lines()[0])

    show(test)


def test_ids_without_a_row_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canser.monitoring.livetable._IDS_MOST", 2)

    async def test(screen: Screen) -> None:
        await screen.send(*(frames(i, b"a") for i in range(5)))
        await screen.until(lambda: screen.note().startswith("3 frames have no row"))

    show(test)


def test_the_last_remark_is_shown() -> None:
    remarks: list[str] = []

    async def test(screen: Screen) -> None:
        assert screen.note() == ""
        remarks.append("the clock steps")
        await screen.until(lambda: screen.note() == "the clock steps")
        remarks.append("9% of the bytes are in no frame [bold]")
        await screen.until(lambda: screen.note() == "9% of the bytes are in no frame [bold]")

    show(test, remarks=remarks)


def test_more_rows_than_lines_scroll() -> None:
    async def test(screen: Screen) -> None:
        await screen.send(*(frames(i, b"a") for i in range(0x100, 0x164)))
        assert screen.ids()[0] == "100"
        await screen.pilot.press("end")
        await screen.until(lambda: screen.ids()[-1] == "163")
        await screen.send(frames(0x150, b"b"))
        assert screen.ids()[-1] == "163"

    show(test)


def test_a_device_that_goes_leaves_the_table() -> None:
    error = canser.PortGoneError("/dev/fake is gone")

    async def test(screen: Screen) -> None:
        await screen.send(frames(0x100, b"a"))
        screen.port.batches.put(error)
        await screen.until(lambda: "/dev/fake is gone" in screen.note())
        assert "GONE" in screen.status()
        assert screen.ids() == ["100"]
        await screen.pilot.press("n", "slash", *"2", "enter")
        assert "the filter 2 passes none of 1 ids" in screen.lines()[0]
        await screen.pilot.press("q")

    assert show(test).error is error


@pytest.mark.parametrize("key", ["q", "ctrl+c"])
def test_quitting_leaves_no_thread(key: str) -> None:
    before = threading.active_count()

    async def test(screen: Screen) -> None:
        assert "canser monitor" in {thread.name for thread in threading.enumerate()}
        await screen.pilot.press(key)
        await screen.until(lambda: not screen.app.is_running)

    app = show(test)
    assert app.error is None
    assert threading.active_count() == before


def test_it_ends_when_it_is_told() -> None:
    stopped = threading.Event()

    async def test(screen: Screen) -> None:
        stopped.set()
        deadline = time.monotonic() + PATIENCE
        while screen.app.is_running:
            assert time.monotonic() < deadline
            await asyncio.sleep(0.01)

    show(test, stopped=stopped.is_set)


# With a port and with a terminal


@contextmanager
def adapter() -> Iterator[tuple[int, str]]:
    """Open a pseudo terminal as an adapter has it: its descriptor, and the port's path."""
    import pty  # noqa: PLC0415
    import tty  # noqa: PLC0415

    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    path = os.ttyname(theirs)
    os.close(theirs)
    # Closed by the test, or here.
    with open(ours, "wb", buffering=0, closefd=True) as file:  # noqa: PTH123
        yield file.fileno(), path


@posix
def test_a_port_is_read_to_its_end_and_no_descriptor_stays() -> None:
    raw = canser.encode(frames(0x5A7, *[bytes(8)] * 2_000), PROTOCOL)
    proc = "/proc/self/fd"
    before = len(os.listdir(proc)) if os.path.isdir(proc) else 0  # noqa: PTH112, PTH208

    async def test(screen: Screen) -> None:
        await asyncio.to_thread(write_all, line, raw)
        await screen.until(lambda: screen.counter("frames") == "2,000")
        assert screen.lines()[0].split()[:2] == ["5A7", "2,000"]
        assert screen.counter("skipped") == "0"
        hang_up(line)
        await screen.until(lambda: "q quits" in screen.note())
        assert screen.lines()[0].split()[:2] == ["5A7", "2,000"]

    with adapter() as (line, path), canser.open(path, PROTOCOL) as port:
        app = show(test, port=port)
    assert isinstance(app.error, canser.PortGoneError)
    if before:
        assert len(os.listdir(proc)) == before  # noqa: PTH208


def hang_up(line: int) -> None:
    """Close the adapter's end; its number stays taken, by nothing."""
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, line)
    os.close(nothing)


def write_all(line: int, raw: bytes) -> None:
    while raw:
        raw = raw[os.write(line, raw) :]


class Terminal:
    """A terminal of 80 columns with a program in it."""

    def __init__(self, *arguments: str) -> None:
        import fcntl  # noqa: PLC0415
        import pty  # noqa: PLC0415
        import struct  # noqa: PLC0415
        import termios  # noqa: PLC0415

        self.ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        self.shown = b""
        plain = {n: v for n, v in os.environ.items() if n not in {"COLUMNS", "LINES", "NO_COLOR"}}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "canser", *arguments],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env=plain | {"TERM": "xterm-256color"},
            start_new_session=True,
        )
        os.close(theirs)

    def until(self, condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, self.shown[-3_000:]
            if select.select([self.ours], [], [], 0.05)[0]:
                try:
                    self.shown += os.read(self.ours, 65_536)
                except OSError:  # Linux: the program has ended
                    self.process.wait(PATIENCE)

    def press(self, keys: bytes) -> None:
        os.write(self.ours, keys)

    def __enter__(self) -> "Terminal":
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self.ours)


@posix
@pytest.mark.parametrize("how", ["q", "signal"])
def test_the_command_in_a_terminal(how: str) -> None:
    raw = canser.encode(frames(0x5A7, *[b"\xc0\xff\xee"] * 10), PROTOCOL)
    with (
        adapter() as (line, path),
        Terminal("monitor", "-c", path, "-p", PROTOCOL) as terminal,
    ):
        terminal.until(lambda: b"waiting for frames" in terminal.shown)
        write_all(line, raw)
        terminal.until(lambda: b"5A7" in terminal.shown and b"C0 FF EE" in terminal.shown)
        if how == "q":
            terminal.press(b"q")
        else:
            terminal.process.send_signal(signal.SIGTERM)
        terminal.until(lambda: terminal.process.poll() is not None)
        assert terminal.process.returncode == 0
        # The screen that was there before is back.
        assert terminal.shown.rindex(b"\x1b[?1049l") > terminal.shown.rindex(b"\x1b[?1049h")


DBC = """BU_: ECU
BO_ 291 EngineData: 8 ECU
 SG_ RPM : 0|16@1+ (0.25,0) [0|16000] "rpm" ECU
 SG_ Gear : 16|4@1+ (1,0) [0|0] "" ECU
 SG_ Temperature : 24|8@1- (1,-40) [0|0] "\u00b0C" ECU
BO_ 512 %s: 8 ECU
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" ECU
 SG_ Left m0 : 8|8@1+ (1,0) [0|0] "" ECU
 SG_ Right m1 : 8|8@1+ (0.1,0) [0|0] "A" ECU
BO_ 513 Another%s: 8 ECU
 SG_ A : 0|8@1+ (1,0) [0|0] "" ECU
 SG_ B : 8|8@1+ (1,0) [0|0] "" ECU
 SG_ C : 16|8@1+ (1,0) [0|0] "" ECU
 SG_ D : 24|8@1+ (1,0) [0|0] "" ECU
 SG_ E : 32|8@1+ (1,0) [0|0] "" ECU
 SG_ F : 40|8@1+ (1,0) [0|0] "" ECU
 SG_ G : 48|8@1+ (1,0) [0|0] "" ECU
VAL_ 291 Gear 0 "neutral" 1 "first" ;
"""
LONG_NAME = "A_message_with_the_longest_name_"


@pytest.fixture
def database(tmp_path: Path) -> canser.Database:
    pytest.importorskip("cantools")
    (tmp_path / "car.dbc").write_text(DBC % (LONG_NAME, LONG_NAME))
    return canser.Database(tmp_path / "car.dbc")


def words(lines: list[str]) -> list[str]:
    """Return the lines under ids, in which blanks do not count."""
    return [" ".join(line.split()) for line in lines if line.startswith("           ")]


def test_signals_are_under_their_id(database: canser.Database) -> None:
    async def test(screen: Screen) -> None:
        await screen.send(
            frames(0x123, bytes.fromhex("401F0181"), bytes.fromhex("421F013C")),
            frames(0x124, b"a"),
            frames(0x123, b"", rtr=True),
        )
        await screen.until(lambda: len(screen.lines()) == 5)
        head, *under = screen.lines()[:3]
        assert head.split()[:2] == ["123", "2"]
        assert words(under) == ["EngineData RPM 2000.5 rpm Gear first", "Temperature 20 \u00b0C"]
        assert under[0].index("RPM") == under[1].index("Temperature")
        # The remote frames of the id, and an id of no message, have none.
        assert [line.split()[:2] for line in screen.lines()[3:]] == [["123", "R"], ["124", "1"]]

    show(test, signals=RowSignals(database, database.decoder()))


def test_more_columns_hold_more_signals(database: canser.Database) -> None:
    async def test(screen: Screen) -> None:
        await screen.send(frames(0x123, bytes.fromhex("401F0F")))
        # The last one is not in the frame.
        await screen.until(
            lambda: words(screen.lines()) == ["EngineData RPM 2000 rpm Gear 15 Temperature -"]
        )

    show(test, signals=RowSignals(database, database.decoder()), size=LARGE)


def test_signals_are_below_a_long_name_if_that_takes_fewer_lines(
    database: canser.Database,
) -> None:
    async def test(screen: Screen) -> None:
        await screen.send(frames(0x201, bytes(range(8))))
        lines = [f"Another{LONG_NAME}", "A 0 B 1 C 2 D 3 E 4 F 5 G 6"]
        await screen.until(lambda: words(screen.lines()) == lines)

    show(test, signals=RowSignals(database, database.decoder()))


def test_signals_of_pages_stay_when_they_were_seen(database: canser.Database) -> None:
    async def test(screen: Screen) -> None:
        async def until(*lines: str) -> None:
            await screen.until(lambda: words(screen.lines()) == list(lines))

        await screen.send(frames(0x200, b"\0\x07"))
        await until(f"{LONG_NAME} Page 0 Left 7")
        await screen.send(frames(0x200, b"\1\x0f"))
        await until(f"{LONG_NAME} Page 1 Left 7", "Right 1.5 A")
        rows = [*screen.table.render_line(1), *screen.table.render_line(2)]
        looks = {segment.text.strip(): segment.style for segment in rows}
        assert looks["7"] != looks["1.5 A"] == looks["1"]
        await screen.pilot.press("c")
        await screen.send(frames(0x200, b"\1\x0f"))
        await until(f"{LONG_NAME} Page 1 Right 1.5 A")

    show(test, signals=RowSignals(database, database.decoder()))


def test_signals_are_sorted_and_filtered_with_their_ids(database: canser.Database) -> None:
    async def test(screen: Screen) -> None:
        await screen.send(
            frames(0x123, b"\0\0\1"), frames(0x200, b"\0\7"), frames(0x300, b"a", b"a")
        )
        firsts = ["123", "EngineData", "Temperature", "200", LONG_NAME, "300"]
        await screen.until(lambda: screen.ids() == firsts)
        await screen.pilot.press("n")
        await screen.until(lambda: screen.ids() == [firsts[-1], *firsts[:-1]])
        await screen.pilot.press("i", "slash", *"GEAR")
        await screen.until(lambda: screen.ids() == firsts[:3])
        assert screen.counter("ids") == "1/3"
        assert "text a name" in str(screen.app.query("#filter Static").last(Static).content)
        await screen.pilot.press(*" 2")
        await screen.until(lambda: screen.ids() == firsts[:-1])
        await screen.pilot.press(*"x")
        assert "'2x'" in str(screen.app.query_one("#wrong", Static).content)

    show(test, signals=RowSignals(database, database.decoder()))


def test_chosen_signals_only(database: canser.Database) -> None:
    async def test(screen: Screen) -> None:
        await screen.send(frames(0x123, b"\0\0\1"), frames(0x200, b"\1\7"))
        await screen.until(lambda: words(screen.lines()) == ["EngineData Gear first"])

    show(test, signals=RowSignals(database, database.decoder(["Gear", "Left"])))


def test_only_rows_on_the_screen_are_decoded(database: canser.Database) -> None:
    decoder = database.decoder()
    decoded: list[list[int]] = []

    class Watched:
        def feed(self, batch: FrameArray) -> canser.Signals:
            decoded.append(batch["id"].tolist())
            return decoder.feed(batch)

    async def test(screen: Screen) -> None:
        ids = [0x123, *range(0x130, 0x170), 0x200]
        await screen.send(*(frames(each, b"\0\0\1") for each in ids))
        await screen.until(lambda: len(screen.lines()) == screen.table.size.height)
        height = screen.table.size.height
        assert screen.table.virtual_size.height == len(ids) + 3
        del decoded[:]
        await screen.send(frames(0x123, b"\0\0\0"))
        await screen.until(lambda: "Gear neutral" in words(screen.lines())[0])
        assert all(each[0] == 0x123 and len(each) <= height for each in decoded)
        screen.table.scroll_end(animate=False)
        await screen.until(lambda: words(screen.lines())[-1:] == [f"{LONG_NAME} Page 0 Left 0"])
        assert screen.lines()[-2].split()[0] == "200"
        # From a line of signals on.
        screen.table.scroll_to(y=1, animate=False)
        await screen.until(lambda: screen.ids()[:3] == ["EngineData", "Temperature", "130"])

    show(test, signals=RowSignals(database, cast(Any, Watched())))


@posix
def test_the_command_shows_signals(database: canser.Database, tmp_path: Path) -> None:
    del database  # it has made the file
    raw = canser.encode(frames(0x123, *[bytes.fromhex("401F01")] * 10), PROTOCOL)
    dbc = str(tmp_path / "car.dbc")
    with (
        adapter() as (line, path),
        Terminal("monitor", "-c", path, "-p", PROTOCOL, "--db", dbc) as terminal,
    ):
        terminal.until(lambda: b"waiting for frames" in terminal.shown)
        write_all(line, raw)
        terminal.until(lambda: b"2000 rpm" in terminal.shown and b"first" in terminal.shown)
        terminal.press(b"q")
        terminal.until(lambda: terminal.process.poll() is not None)
        assert terminal.process.returncode == 0


@posix
def test_the_command_says_at_its_end_that_the_device_went() -> None:
    with (
        adapter() as (line, path),
        Terminal("monitor", "-c", path, "-p", PROTOCOL) as terminal,
    ):
        terminal.until(lambda: b"waiting for frames" in terminal.shown)
        hang_up(line)
        terminal.until(lambda: b"GONE" in terminal.shown)
        terminal.press(b"q")
        terminal.until(lambda: terminal.process.poll() is not None)
        assert terminal.process.returncode == 1
        last = terminal.shown[terminal.shown.rindex(b"\x1b[?1049l") :]
        assert f"canser: {path}".encode() in last


def fails(*arguments: str, code: str = "pass") -> str:
    """Run the command outside of any terminal; return its only line."""
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            f"import sys; {code}; from canser.commands.cli import main; "
            "sys.exit(main(sys.argv[1:]))",
            *arguments,
        ],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    (line,) = done.stderr.splitlines()
    return line


CALL = ("monitor", "-c", "/dev/nowhere", "-p", PROTOCOL)


def test_without_textual_the_command_says_how_to_get_it() -> None:
    line = fails(*CALL, code="sys.modules['textual'] = None")
    assert line == "canser: the monitor needs textual: pip install 'canser[monitor]'"


def test_without_a_terminal_the_command_says_so() -> None:
    assert "needs a terminal" in fails(*CALL)


def test_a_filter_that_cannot_be_read_is_told() -> None:
    assert "cannot read the filter '12:'" in fails(*CALL, "--filter", "12:")


def test_a_database_that_is_not_there_is_told() -> None:
    pytest.importorskip("cantools")
    assert fails(*CALL, "--db", "no.dbc") == "canser: no.dbc: No such file or directory"


def test_signals_need_a_database() -> None:
    assert "--signal needs a database" in fails(*CALL, "--signal", "RPM")


def test_a_filter_of_the_call_is_exact() -> None:
    assert "'18FE' has 4 digits" in fails(*CALL, "--filter", "123", "--filter", "18FE")


def test_help_fits_80_columns(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        cli.main(["monitor", "--help"])
    lines = capfd.readouterr().out.splitlines()
    assert lines[lines.index("examples:") + 1].startswith("  canser monitor")
    assert max(map(len, lines)) <= 80
