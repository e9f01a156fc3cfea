"""Arrays of frames from texts, tuples, messages and other arrays."""

import reprlib
from collections.abc import Iterable, Iterator
from typing import Any, Protocol, SupportsIndex, TypeAlias

import numpy as np

from canser._checks import real, whole
from canser._core.buffers import BytesLike, as_bytes
from canser._frames import NO_TIME, FrameArray, check_frames, concat, copy_records, reason_invalid
from canser._notation import parse_frame
from canser._rows import Row, check_row, rows_to_frames

__all__ = ["FrameItem", "FrameItems", "MessageLike", "frames", "message_to_row"]

_STANDARD_MAX = 0x7FF


class MessageLike(Protocol):
    """The attributes of a message that are read, such as a `can.Message` of python-can."""

    @property
    def timestamp(self) -> float:
        """Seconds; 0 if the time is not known."""

    @property
    def arbitration_id(self) -> int:
        """The id, without flag bits."""

    @property
    def is_extended_id(self) -> bool:
        """Whether the id has 29 bits."""

    @property
    def is_remote_frame(self) -> bool:
        """Whether it is a remote frame, which has a dlc and no data."""

    @property
    def is_error_frame(self) -> bool:
        """Whether it is an error frame."""

    @property
    def dlc(self) -> int:
        """The data length code, 0 to 8."""

    @property
    def data(self) -> BytesLike:
        """The data, as long as the dlc says; none in a remote frame."""


# One argument that stands for frames, and the same or an iterable of these.
FrameItem: TypeAlias = str | tuple[SupportsIndex, BytesLike] | MessageLike | np.void | FrameArray
FrameItems: TypeAlias = FrameItem | Iterable[FrameItem]


def frames(*items: FrameItems) -> FrameArray:
    r"""Make an array of frames from texts, tuples, messages and other frames.

    Parameters
    ----------
    *items
        Any mix, in the order of the frames:

        - a text in candump's notation: ``"123#DEADBEEF"``, ``"18FEF100#01.02"`` (extended: eight
          digits), ``"123#R8"`` (remote, dlc 8), ``"20000080#00"`` (an error frame);
        - a tuple ``(arbitration_id, data)``: a data frame, extended if the id is over 0x7FF;
          `data` is bytes or another buffer of 0 to 8 bytes;
        - a message of python-can, or any object with the attributes `timestamp` (seconds),
          `arbitration_id`, `is_extended_id`, `is_remote_frame`, `is_error_frame`, `dlc`, `data`;
        - an array of FRAME_DTYPE, shape (n,), contiguous or not, or one record of it;
        - a list or another iterable of these, such as a ``can.LogReader``.

    Returns
    -------
    FrameArray
        New array of FRAME_DTYPE, shape (n,). `ts` in nanoseconds is that of the array or of the
        message; NO_TIME for a text, a tuple, and a message whose timestamp is 0, as python-can
        has it where no time is known.

    Raises
    ------
    ValueError
        For what is no frame of classic CAN: a text that cannot be read, an id over 0x1FFFFFFF,
        more than 8 bytes, a message of CAN FD, a timestamp that does not fit `ts`.
    TypeError
        For anything else.

    Examples
    --------
    >>> made = canser.frames("123#DEADBEEF", (0x18FEF100, b"\x01\x02"))
    >>> made["id"].tolist(), made["ext"].tolist(), made["dlc"].tolist()
    ([291, 419361024], [False, True], [4, 2])
    >>> len(canser.frames(made, ["7E0#R8"] * 3))
    5
    """
    arrays: list[FrameArray] = []
    rows: list[Row] = []
    for part in _to_parts(items):
        if isinstance(part, tuple):
            rows.append(part)
        else:
            # A copy, as an iterable of arrays may fill the same array again and again.
            arrays += [rows_to_frames(rows), copy_records(part)]
            rows.clear()
    return concat([*arrays, rows_to_frames(rows)])


def message_to_row(message: MessageLike, ts: int) -> Row:
    """Return the frame of a message of python-can at this time; ValueError if it is none."""
    rtr, data = message.is_remote_frame, bytes(memoryview(message.data))  # type: ignore[arg-type]
    dlc = whole(message.dlc, "the message's dlc", "8")
    arbitration_id = whole(message.arbitration_id, "the message's arbitration_id", "0x123")
    if getattr(message, "is_fd", False):
        raise ValueError("the message is one of CAN FD; serial adapters know classic CAN only")
    wrong = reason_invalid(arbitration_id, message.is_extended_id, dlc)
    if wrong is not None:
        raise ValueError(wrong)
    if len(data) != (0 if rtr else dlc):
        raise ValueError(f"the message has {len(data)} bytes of data, but its dlc is {dlc}")
    return arbitration_id, message.is_extended_id, rtr, dlc, message.is_error_frame, data, ts


def _to_parts(items: Iterable[Any]) -> Iterator[Row | FrameArray]:
    """Yield the frames of items: a row for a single frame, or an array of frames."""
    for item in items:
        if isinstance(item, str):
            yield parse_frame(item)
        elif isinstance(item, tuple):
            yield _tuple_to_row(item)
        elif isinstance(item, (np.ndarray, np.void)):
            yield _checked_array(item)
        elif hasattr(item, "arbitration_id"):
            yield _timed_message_to_row(item)
        elif isinstance(item, Iterable) and not isinstance(item, (bytes, bytearray, memoryview)):
            yield from _to_parts(item)
        else:
            raise TypeError(
                f"cannot make a frame of {_shown(item)}; give a text such as '123#DEADBEEF', "
                "(arbitration_id, data), a message of python-can, an array of canser.FRAME_DTYPE, "
                "or a list of these"
            )


def _tuple_to_row(item: tuple[Any, ...]) -> Row:
    if len(item) != 2:
        raise TypeError(
            f"cannot make a frame of {_shown(item)}; a tuple must be (arbitration_id, data): pass "
            "several frames as a list"
        )
    arbitration_id = whole(item[0], "the arbitration_id of a tuple", "0x123", least=0)
    data = as_bytes(item[1]).tobytes()
    ext = arbitration_id > _STANDARD_MAX
    try:
        return check_row((arbitration_id, ext, False, len(data), False, data, NO_TIME))
    except ValueError as error:
        raise ValueError(f"{_shown(item)}: {error}") from None


def _checked_array(item: np.void | FrameArray) -> FrameArray:
    array = item.reshape(1) if isinstance(item, np.void) else item
    check_frames(array, "frames")
    return array


def _timed_message_to_row(message: MessageLike) -> Row:
    seconds = real(message.timestamp, "the message's timestamp", "1700000000.25")
    try:
        if not abs(seconds) < 2**63 / 1e9:  # or it is NaN
            raise ValueError("the timestamp does not fit 64 bits of nanoseconds")
        return message_to_row(message, round(seconds * 1e9) if seconds else NO_TIME)
    except ValueError as error:
        raise ValueError(
            f"message {message.arbitration_id:#x} at {seconds:.15g} s: {error}"
        ) from None


def _shown(item: object) -> str:
    return " ".join(reprlib.repr(item).split())
