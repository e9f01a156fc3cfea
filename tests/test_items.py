"""Arrays of frames from texts, tuples, messages and other frames: `canser.frames`."""

import doctest
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import canser
import canser._items
from canser._frames import FRAME_DTYPE, NO_TIME
from reference import Frame
from samples import array, listed


@dataclass
class Message:
    """A message as python-can has it, without python-can."""

    timestamp: float = 0.0
    arbitration_id: int = 0x123
    is_extended_id: bool = False
    is_remote_frame: bool = False
    is_error_frame: bool = False
    dlc: int = 2
    data: bytes = b"\x01\x02"


TEXT = Frame(0x123, dlc=4, data=bytes.fromhex("DEADBEEF00000000"), ts=NO_TIME)
MESSAGE = Frame(0x123, dlc=2, data=bytes.fromhex("0102000000000000"), ts=NO_TIME)


def test_texts() -> None:
    frames = canser.frames(["123#DEADBEEF", "18FEF100#", "123#R8", "20000080#00", "7ff#01.02.ff"])
    assert frames["id"].tolist() == [0x123, 0x18FEF100, 0x123, 0x80, 0x7FF]
    assert frames["ext"].tolist() == [False, True, False, False, False]
    assert frames["rtr"].tolist() == [False, False, True, False, False]
    assert frames["err"].tolist() == [False, False, False, True, False]
    assert frames["dlc"].tolist() == [4, 0, 8, 1, 3]
    assert frames["data"][0].tobytes() == bytes.fromhex("DEADBEEF 00000000")
    assert frames["data"][4].tobytes() == bytes.fromhex("0102FF 0000000000")
    assert (frames["ts"] == NO_TIME).all()
    assert len(canser.frames()) == len(canser.frames([])) == 0


@pytest.mark.parametrize(
    "text",
    [
        "",
        "123",
        "12#00",
        "123#0",
        "123#GG",
        "800#",
        "123##0",
        "1234#",
        "0x123#11",
        "1_2#11",
        "12 #11",
        " 123#11",
        "123#11 ",
        "123#1 1",
        "123#11\n",
        "123#1_1",
        "\u0661\u0662\u0663#11",
        "123#\uff11\uff11",
        "123#R\u0661",
        "+12#11",
        "123#11.",
        "123#1122334455667788_E",
        "123#R8_9",
        "123#11 T",
    ],
)
def test_texts_that_are_no_frame(text: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(repr(text))}"):
        canser.frames(["123#00", text])


def test_tuples() -> None:
    made = canser.frames((0x7FF, b""), (0x800, bytearray(b"\1")), (np.uint32(1), memoryview(b"\2")))
    assert listed(made) == [
        Frame(0x7FF, ts=NO_TIME),
        Frame(0x800, ext=True, dlc=1, data=b"\1" + bytes(7), ts=NO_TIME),
        Frame(0x001, dlc=1, data=b"\2" + bytes(7), ts=NO_TIME),
    ]
    data = np.arange(8, dtype=np.uint8)
    assert canser.frames((0x1FFFFFFF, data))["data"].tolist() == [data.tolist()]


def test_messages() -> None:
    made = canser.frames(
        Message(),
        Message(timestamp=1_544_106_679.5, is_extended_id=True),
        Message(-0.25, 0x7FF, is_remote_frame=True, dlc=8, data=b""),
        Message(is_error_frame=True),
    )
    assert listed(made) == [
        MESSAGE,
        MESSAGE._replace(ts=1_544_106_679_500_000_000, ext=True),
        Frame(0x7FF, rtr=True, dlc=8, ts=-250_000_000),
        MESSAGE._replace(err=True),
    ]


def test_messages_of_python_can() -> None:
    can = pytest.importorskip("can")
    messages = [
        can.Message(arbitration_id=0x123, is_extended_id=False, data=[1, 2]),
        can.Message(arbitration_id=0x7E0, is_remote_frame=True, dlc=3, timestamp=2.5),
    ]
    made = canser.frames(messages)
    assert listed(made) == [MESSAGE, Frame(0x7E0, ext=True, rtr=True, dlc=3, ts=2_500_000_000)]
    with pytest.raises(ValueError, match=r"^message 0x123 at 1.5 s: the message is one of CAN FD"):
        canser.frames(can.Message(arbitration_id=0x123, timestamp=1.5, is_fd=True))


def test_arrays_and_records_keep_all_that_they_say() -> None:
    every = array(*(Frame(n, ext=bool(n % 2), dlc=n, err=n == 3, ts=n) for n in range(8)))
    made = canser.frames(every, every[2], every[::-2], every[:0])
    assert listed(made) == [*listed(every), *listed(every[2:3]), *listed(every[::-2])]
    assert not np.shares_memory(canser.frames(every), every)
    made["id"] = 1  # it can be written
    assert every["id"].tolist() == list(range(8))


def test_any_mix_in_its_order() -> None:
    def generated() -> Iterator[Any]:
        yield "001#"
        yield [(2, b""), Message(arbitration_id=3)]

    made = canser.frames("000#", generated(), [canser.frames("004#"), canser.frames("005#")[0]])
    assert made["id"].tolist() == [0, 1, 2, 3, 4, 5]
    assert made.dtype == FRAME_DTYPE
    assert made.flags.aligned
    assert made.flags.owndata


def test_blocks_that_share_an_array_are_kept_apart() -> None:
    def blocks() -> Iterator[canser.FrameArray]:
        out = np.zeros(1, FRAME_DTYPE)
        for number in range(3):
            out["id"] = number
            yield out

    assert canser.frames(blocks())["id"].tolist() == [0, 1, 2]


MASKED = np.ma.MaskedArray(np.zeros(2, FRAME_DTYPE))


@pytest.mark.parametrize(
    ("item", "error", "words"),
    [
        ((0x20000000, b""), ValueError, "(536870912, b''): the id 0x20000000 is over 0x1fffffff"),
        ((0x123, bytes(9)), ValueError, "the dlc 9 is not 0 to 8"),
        ((-1, b""), ValueError, "the arbitration_id of a tuple is -1; it must be 0 or more"),
        ((1.5, b""), TypeError, "the arbitration_id of a tuple is 1.5; it must be an integer"),
        ((True, b""), TypeError, "is True; it must be an integer"),
        ((1, 2), TypeError, "data must be bytes"),
        ((1, "01"), TypeError, "data must be bytes"),
        ((1, np.zeros(2, np.uint16)), TypeError, "single bytes"),
        ((1, b"", True), TypeError, "a tuple must be (arbitration_id, data)"),
        (("123#", "124#"), TypeError, "the arbitration_id of a tuple is '123#'"),
        (b"123#00", TypeError, "cannot make a frame of b'123#00'; give a text such as"),
        (0x123, TypeError, "cannot make a frame of 291"),
        (None, TypeError, "cannot make a frame of None"),
        (np.zeros(2, np.uint8), TypeError, "an array of uint8"),
        (np.zeros(2, np.dtype([("id", "u4")]))[0], TypeError, "an array of"),
        (np.zeros((2, 2), FRAME_DTYPE), ValueError, "2 dimensions"),
        (np.zeros((), FRAME_DTYPE), ValueError, "0 dimensions"),
        (MASKED, TypeError, "masked"),
        (MASKED[0], TypeError, "masked"),
        (Message(arbitration_id=0x800), ValueError, "message 0x800 at 0 s: the id 0x800 is over"),
        (Message(arbitration_id=1.5), TypeError, "arbitration_id is 1.5"),  # type: ignore[arg-type]
        (Message(dlc=1), ValueError, "the message has 2 bytes of data, but its dlc is 1"),
        (Message(dlc=9, data=bytes(9)), ValueError, "the dlc 9 is not 0 to 8"),
        (Message(is_remote_frame=True), ValueError, "2 bytes of data"),
        (Message(timestamp=float("nan")), ValueError, "at nan s: the timestamp does not fit"),
        (Message(timestamp=1e10), ValueError, "the timestamp does not fit 64 bits of nanoseconds"),
        (Message(timestamp="now"), TypeError, "timestamp is 'now'"),  # type: ignore[arg-type]
        (Message(data=5), TypeError, "int"),  # type: ignore[arg-type]
    ],
    ids=str,
)
def test_what_is_no_frame(item: Any, error: type[Exception], words: str) -> None:
    for given in (item, [item]):
        with pytest.raises(error, match=re.escape(words)) as raised:
            canser.frames("123#00", given)
        assert "\n" not in str(raised.value)


def test_the_examples_run() -> None:
    done = doctest.testmod(canser._items, extraglobs={"canser": canser})
    assert done.attempted
    assert not done.failed
