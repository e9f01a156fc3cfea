"""The base of readers of text: usual lines are read in C, and any other one by one in Python."""

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from canser._core.text import Taken, TextReader
from canser._frames import NO_TIME, FrameArray, put_records
from canser._input import Input
from canser._rows import Row
from canser._threads import useful_threads
from canser.errors import FormatError
from canser.files.ahead import Ahead, Stretch
from canser.files.reader import ReadOptions
from canser.files.tagged import TaggedReader

__all__ = ["BLANKS", "Line", "LineReader"]

# Blanks of ASCII. Without them, strip() would take the blanks of all scripts.
BLANKS: Final = " \t\r\n\v\f"

# Limit for a line of text, in bytes. A line of a frame has under 200; a longer one is no text.
_LINE_MOST: Final = 1 << 16

# The share of steps back above which times may be differences; and the fewest steps back that tell.
_STEPS_BACK_SHARE: Final = 0.01
_STEPS_BACK_LEAST: Final = 10

_NOTHING: Final = Taken(0, 0, 0)

# Bytes that are read before threads may begin, with the header and a few frames.
_FIRST: Final = 1 << 14


def _find_end(data: memoryview, begin: int) -> int:
    """Return the place behind the line that begins at a place; 0 if it has no end."""
    for size in (256, _LINE_MOST):  # mostly a line is short: little is copied
        found = bytes(data[begin : begin + size]).find(b"\n")
        if found >= 0:
            return begin + found + 1
    return 0


class Line(NamedTuple):
    """What a line says."""

    row: Row
    #: Name of the channel as the file has it; None if it is not told.
    channel: str | None = None
    #: "R", "Rx" and the like; None if it is not told.
    direction: str | None = None


class LineReader(TaggedReader):
    """Reads text. A subclass sets `format`, and defines `_parse` for the lines that C leaves."""

    #: The name of the format in C.
    format = ""
    #: Whether C may read lines. Otherwise all are read in Python.
    _in_c = True

    def __init__(self, source: Input, options: ReadOptions) -> None:
        self._c = TextReader(self.format)
        super().__init__(source, options)
        self._offset = self._number = 0  # bytes and lines so far
        self._nuls = 0  # NUL bytes at the end of the file
        self._bad: list[tuple[int, str]] = []  # the first line that cannot be read, and why
        self._bad_count = 0
        self._xl_count = 0
        self._is_cut = False
        self._frames_seen = 0
        self._c.state.before_ns = NO_TIME
        self._sum_ns = 0  # of the differences so far, with times="delta"
        self.bytes_done = 0
        self._is_ended = False
        self._threads = useful_threads(options.threads)

    def _new_rows(self) -> None:
        super()._new_rows()
        self._c.use(self._frames, self._channels, self._directions)

    def _named(self, name: str, code: int) -> None:
        self._c.add_name(name, code)

    def _parse(self, text: str) -> Line | None:
        """Return what a line says; None if it is no frame. ValueError if it cannot be read."""
        raise NotImplementedError

    def _see_times(self, frames: FrameArray) -> None:
        self._frames_seen += len(frames)
        if self._options.times == "delta":
            ts = frames["ts"]
            known = ts != NO_TIME
            if abs(self._sum_ns) + np.abs(ts[known].astype(np.float64)).sum() >= -NO_TIME:
                raise FormatError(
                    f"{self._source.name}: the times add up to over 64 bits of nanoseconds; they "
                    "are no differences"
                )
            times = np.cumsum(ts[known]) + self._sum_ns
            if len(times):
                self._sum_ns = int(times[-1])
                ts[known] = times

    def _fill(self) -> Iterator[None]:
        with Ahead(self._source, self.format, self._threads) as ahead:
            stop = 0  # of the stretch in which a line is unusual: the rest of it is read here
            while True:
                stretch = self._stretch(ahead) if self._offset >= stop else None
                if stretch is not None:
                    stop = stretch.stop
                    yield from self._join(stretch)
                    ahead.give_back(stretch)
                    continue
                data = self._source.ahead(self._offset)
                if not data:
                    break
                if stop > self._offset:
                    data = data[: stop - self._offset]
                elif self._threads > 1 and not self._has_frames:
                    data = data[: _find_end(data, _FIRST) or None]
                yield from self._read(data)
                if self._is_ended:
                    break
        yield

    def _read(self, data: memoryview) -> Iterator[None]:
        """Read usual lines, and one that is not."""
        source = self._source
        taken = self._c.read(data, self._count) if self._in_c else _NOTHING
        self._advance(taken.used)
        self._count += taken.frames
        self._number += taken.lines
        if self._count == len(self._frames):
            yield
            return
        left = len(data) - taken.used
        end = _find_end(data, taken.used)
        if end:
            self._take_line(bytes(data[taken.used : end]))
            if self._count == len(self._frames):
                yield
        elif left >= _LINE_MOST:
            if not self._take_nuls(data[taken.used :]):
                raise self._endless()
        else:  # the next line is not whole
            if source.size is None:
                yield  # a pipe is waited for: frames go on before
            # More bytes may come to the same memory: `data` is no longer looked at.
            if (
                len(source.ahead(self._offset)) <= left
                and len(source.at(self._offset, left + 1)) == left
            ):
                self._take_last(bytes(source.at(self._offset, left)))
                self._is_ended = True

    @property
    def _has_frames(self) -> bool:
        return bool(self._count or self._frames_seen)

    def _stretch(self, ahead: Ahead) -> Stretch | None:
        """Return the next lines if threads have read them."""
        # Relative times need the line before; and the header tells how lines are read.
        if self._in_c and self._has_frames and not self._c.state.is_relative:
            return ahead.take(self._offset, self._c)
        ahead.end()
        return None

    def _join(self, stretch: Stretch) -> Iterator[None]:
        """Take over the frames that a thread has read."""
        taken = stretch.taken
        assert taken is not None
        done = 0
        while done < taken.frames:
            count = min(len(self._frames) - self._count, taken.frames - done)
            to, part = slice(self._count, self._count + count), slice(done, done + count)
            put_records(self._frames[to], stretch.frames[part])
            self._channels[to] = stretch.channels[part]
            self._directions[to] = stretch.directions[part]
            self._count += count
            done += count
            if self._count == len(self._frames):
                yield
        self._c.join(stretch.text, stretch.frames[: taken.frames])
        self._advance(taken.used)
        self._number += taken.lines

    def _advance(self, count: int) -> None:
        self._offset += count
        self.bytes_done = self._offset

    def _endless(self) -> FormatError:
        number = self._number + 1
        return FormatError(f"{self._source.name}, line {number}: has no end; is it raw bytes?")

    def _take_last(self, raw: bytes) -> None:
        """Read the bytes behind the last line end."""
        if not self._take_nuls(raw):
            self._take_line(raw, is_last=True)

    def _take_nuls(self, raw: bytes | memoryview) -> bool:
        """Count bytes as NULs that a power cut has left; return False if they are none."""
        if bytes(raw).strip(b"\0"):
            return False
        self._nuls += len(raw)
        self._advance(len(raw))
        return True

    def _take_line(self, raw: bytes, *, is_last: bool = False) -> None:
        """Read a line in Python."""
        self._advance(len(raw))
        self._number += 1
        try:
            line = self._read_line(raw)
            if line is not None:
                code = self._code(line.channel)
                if line.row[-1] != NO_TIME:
                    self._c.state.steps_back += line.row[-1] < self._c.state.before_ns
                    self._c.state.before_ns = line.row[-1]
                self._put_row(line.row, code, sent=(line.direction or "")[:1] in ("T", "t"))
        except ValueError as error:
            if is_last and (self._count or self._tags.any):
                self._is_cut = True
                return
            if not self._options.skip_bad:
                raise FormatError(f"{self._source.name}, line {self._number}: {error}") from None
            if not self._bad_count:
                self._bad.append((self._number, str(error)))
            self._bad_count += 1

    def _read_line(self, raw: bytes) -> Line | None:
        try:
            text = raw.decode("utf-8-sig" if self._number == 1 else "utf-8").strip(BLANKS)
        except UnicodeDecodeError:
            raise ValueError("this is no text; is it raw bytes?") from None
        return self._parse(text) if text else None

    @property
    def remarks(self) -> list[str]:
        """Remarks on the file: what the frames do not hold."""
        remarks = super().remarks
        counts = {
            "CAN FD frames, left out": self._c.state.fd_count,
            "CAN XL frames, left out": self._xl_count,
        }
        remarks += [f"{what}: {count:,}" for what, count in counts.items() if count]
        back = self._c.state.steps_back
        share = self._frames_seen * _STEPS_BACK_SHARE
        if back >= max(share, _STEPS_BACK_LEAST) and self._options.times is None:
            remarks.append(
                f"times go back {back:,} times; if they are differences, "
                "times='delta' (--times delta) adds them up"
            )
        if self._bad_count:
            number, why = self._bad[0]
            remarks.append(
                f"lines that cannot be read, left out: {self._bad_count:,}; the first is line "
                f"{number}: {why}"
            )
        if self._is_cut:
            remarks.append("the last line is cut off, and left out")
        if self._nuls:
            remarks.append(
                f"ends in {self._nuls:,} NUL bytes; was the power cut? Frames may be missing"
            )
        return remarks
