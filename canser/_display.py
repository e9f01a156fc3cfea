"""Frames to look at: lines of text, and a table in a notebook."""

from collections.abc import Callable, Iterator
from html import escape
from typing import Any, Final, TextIO

import numpy as np

from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray, check_frames, copy_records
from canser.files.candump import Dump

__all__ = ["load_ipython_extension", "show", "unload_ipython_extension"]

# The most frames of one array that are shown. Of a larger array, half of them are at each end.
_SHOWN_MAX: Final = 40

_COLUMNS: Final = ("", "ts (s)", "id", "flags", "dlc", "data")
_LEFT: Final = ("flags", "data")  # columns aligned left; the others are numbers


def show(frames: FrameArray, file: TextIO | None = None) -> None:
    """Print frames as `canser dump` does, at most 40 of them, and how many there are.

    Of more than 40 frames the first 20 and the last 20 are printed, and between them how many
    are left out.

    Parameters
    ----------
    frames
        Array of FRAME_DTYPE, shape (n,).
    file
        Open for writing text; the standard output by default.

    Raises
    ------
    TypeError
        For what is no array of FRAME_DTYPE, and for a masked array.
    ValueError
        For an array that does not have one dimension.

    Examples
    --------
    >>> canser.show(canser.frames("123#DEADBEEF", "7E0#R8"))
    (0.000000) can0 123#DEADBEEF
    (0.000000) can0 7E0#R8
    2 frames; a time that is not known is shown as 0
    """
    check_frames(frames, "frames")
    head, left_out, tail = _parts(frames)
    lines_of = Dump("a").text
    lines = lines_of(copy_records(head)).decode()
    if left_out:
        lines += f"... {_counted(left_out)} left out ...\n{lines_of(copy_records(tail)).decode()}"
    note = (
        "; a time that is not known is shown as 0"
        if (head["ts"] == NO_TIME).any() or (tail["ts"] == NO_TIME).any()
        else ""
    )
    print(f"{lines}{_counted(len(frames))}{note}", file=file)


def load_ipython_extension(ipython: Any) -> None:
    """Show arrays of frames as tables in a notebook; for ``%load_ext canser``.

    Holds for arrays of FRAME_DTYPE with one dimension. All others look as before.

    Parameters
    ----------
    ipython
        The shell, an ``IPython.InteractiveShell``.
    """
    formatter = ipython.display_formatter.formatters["text/html"]
    before = formatter.for_type(np.ndarray)
    if not isinstance(before, _FrameTable):
        formatter.for_type(np.ndarray, _FrameTable(before))


def unload_ipython_extension(ipython: Any) -> None:
    """Show arrays of frames as any other array again; for ``%unload_ext canser``.

    Parameters
    ----------
    ipython
        The shell, an ``IPython.InteractiveShell``.
    """
    formatter = ipython.display_formatter.formatters["text/html"]
    table = formatter.for_type(np.ndarray)
    if isinstance(table, _FrameTable):  # else another extension has replaced it
        formatter.pop(np.ndarray)
        if table.before is not None:
            formatter.for_type(np.ndarray, table.before)


class _FrameTable:
    """Makes the HTML of an array of frames; for any other array calls `before`."""

    def __init__(self, before: Callable[[Any], str | None] | None) -> None:
        self.before = before

    def __call__(self, array: Any) -> str | None:
        masked = isinstance(array, np.ma.MaskedArray)
        if array.dtype == FRAME_DTYPE and array.ndim == 1 and not masked:
            return _to_html(array)
        if self.before is not None:
            return self.before(array)
        # A subclass of ndarray may have its own HTML. IPython asks for it only if no function is
        # registered.
        own = getattr(array, "_repr_html_", None)
        return own() if callable(own) else None


def _parts(frames: FrameArray) -> tuple[FrameArray, int, FrameArray]:
    """Return the first frames to show, the number left out, and the last frames to show."""
    if len(frames) <= _SHOWN_MAX:
        return frames, 0, frames[:0]
    half = _SHOWN_MAX // 2
    return frames[:half], len(frames) - 2 * half, frames[-half:]


def _counted(count: int) -> str:
    return f"{count:,} frame{'s' * (count != 1)}"


def _to_html(frames: FrameArray) -> str:
    """Return frames as an HTML table, with their indices."""
    head, left_out, tail = _parts(frames)
    shown = [*head["ts"].tolist(), *tail["ts"].tolist()]
    places = 9 if any(ts != NO_TIME and ts % 1000 for ts in shown) else 6
    titles = "".join(f"<th>{escape(title)}</th>" for title in _COLUMNS)
    rows = [*_html_rows(head, 0, places)]
    if left_out:
        rows.append(f'<tr><td colspan="{len(_COLUMNS)}">{_counted(left_out)} left out</td></tr>')
        rows += _html_rows(tail, len(head) + left_out, places)
    return (
        f'<table style="font-family: monospace">\n<thead><tr>{titles}</tr></thead>\n<tbody>\n'
        + "\n".join(rows)
        + f"\n</tbody>\n</table>\n<p>{_counted(len(frames))}</p>"
    )


def _html_rows(frames: FrameArray, first: int, places: int) -> Iterator[str]:
    for index, (number, ext, rtr, dlc, err, data, ts) in enumerate(frames.tolist(), first):
        kinds = {"ext": ext, "rtr": rtr, "err": err}
        cells = (
            f"{index:,}",
            _seconds(ts, places),
            f"{number:08X}" if ext else f"{number:03X}",
            " ".join(name for name, is_set in kinds.items() if is_set),
            str(dlc),
            "" if rtr else " ".join(f"{byte:02X}" for byte in data[:dlc]),
        )
        yield "<tr>" + "".join(map(_cell, _COLUMNS, cells)) + "</tr>"


def _cell(title: str, text: str) -> str:
    align = "left" if title in _LEFT else "right"
    return f'<td style="text-align: {align}">{escape(text)}</td>'


def _seconds(ts: int, places: int) -> str:
    if ts == NO_TIME:
        return "unknown"
    whole, rest = divmod(abs(ts), 1_000_000_000)
    return f"{'-' * (ts < 0)}{whole}.{f'{rest:09}'[:places]}"
