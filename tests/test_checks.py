"""An argument that is wrong is named, with its value and what it may be; nothing is guessed."""

import math
import sys
from collections.abc import Callable
from dataclasses import fields
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import canser
from canser import adapters
from canser._checks import flag, real, timeout, whole
from canser.adapters import AdapterConfig
from canser.live.config import LineConfig
from canser.simulation.faults import Faults
from canser.simulation.simulator import Simulator
from canser.simulation.traffic import vehicle

posix = pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are POSIX")

NOT_WHOLE = ["500k", "5", b"5", 1.5, 500_000.0, True, np.True_, math.nan, None, [5], 1 + 0j]
NOT_REAL = ["x", "1", b"1", True, np.True_, None, [1.0], 1j]
NOT_FLAGS = ["no", "", 0, 1, None, 0.0, []]


@pytest.mark.parametrize("value", NOT_WHOLE, ids=repr)
def test_what_is_no_whole_number(value: object) -> None:
    with pytest.raises(TypeError, match=r"^x is .*; it must be an integer, such as 7$"):
        whole(value, "x", "7")


@pytest.mark.parametrize("value", [5, np.int8(5), np.uint64(5)])
def test_whole_numbers(value: Any) -> None:
    number = whole(value, "x", "7", least=5)
    assert (number, type(number)) == (5, int)
    with pytest.raises(ValueError, match=r"^x is 5; it must be 6 or more$"):
        whole(value, "x", "7", least=6)


@pytest.mark.parametrize("value", NOT_REAL, ids=repr)
def test_what_is_no_number(value: object) -> None:
    with pytest.raises(TypeError, match=r"^x is .*; it must be a number, such as 0\.5$"):
        real(value, "x", "0.5")


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2), np.int8(2), Fraction(2)])
def test_numbers(value: Any) -> None:
    assert real(value, "x", "0.5") == timeout(value) == 2.0


def test_timeouts() -> None:
    assert timeout(None) is timeout(math.inf) is timeout(1e300) is None
    assert timeout(-1) == -1.0
    with pytest.raises(ValueError, match=r"^timeout is nan"):
        timeout(math.nan)
    for value in ("x", True, Decimal(1), [1]):
        with pytest.raises(TypeError, match=r"^timeout is .* number of seconds, or None"):
            timeout(value)


@pytest.mark.parametrize("value", NOT_FLAGS, ids=repr)
def test_what_is_neither_true_nor_false(value: object) -> None:
    with pytest.raises(TypeError, match=r"^x is .*; it must be True or False$"):
        flag(value, "x")


def test_a_long_value_is_one_short_line() -> None:
    for value in ("x" * 10_000, np.zeros((100, 100)), list(range(10_000))):
        with pytest.raises(TypeError) as caught:
            whole(value, "x", "7")
        assert len(str(caught.value)) < 200
        assert "\n" not in str(caught.value)


# The interface


def names(call: Callable[..., object], name: str, value: object, **others: Any) -> None:
    """Assert that a call names an argument that is wrong, and its value."""
    with pytest.raises((TypeError, ValueError)) as caught:
        call(**others, **{name: value})
    text = str(caught.value)
    assert name in text
    assert "\n" not in text
    shown = (repr(value), str(value), type(value).__name__)
    assert any(one in text for one in shown) or len(shown[0]) > 20, text


SETTINGS: dict[str, list[Any]] = {
    "bitrate": NOT_WHOLE[:-3],
    "filter_id": NOT_WHOLE,
    "filter_mask": NOT_WHOLE,
    "mode": [5, None, True, ["normal"]],
    "frame_type": [5, None, True],
    "once": NOT_FLAGS,
}
OPEN = SETTINGS | {
    "baudrate": ["fast", 1.5, True, 115_200.0, math.nan, 0, -1],
    "ring_size": [*NOT_WHOLE, 0, 10**15, 10**30],
    "dtr": ["high", True, None, 1],
    "rts": ["low", False, None, 0],
    "ping": ["x", True, math.nan, math.inf, 0, -1],
    "ts_unit": [5, None, "h"],
    "device_time": NOT_FLAGS,
    "flush": NOT_FLAGS,
    "reconnect": NOT_FLAGS,
    "on_bytes": [5, "x"],
    "url": [5, None, b"/dev/x", Path("/dev/x")],
    "protocol": [5, None, "foo"],
    "config": [5, 500_000, "silent", {}],
    "line": [5, 115_200, "off", {}],
}


# The value objects of `open`, by the argument that takes one.
OBJECTS: dict[str, type[Any]] = {"config": AdapterConfig, "line": LineConfig}


def opened(**options: Any) -> canser.Port:
    """Open a port; options that are fields of a value object go there."""
    for argument, kind in OBJECTS.items():
        found = {field.name for field in fields(kind)} & options.keys()
        if found - {"bitrate"}:
            options[argument] = kind(**{name: options.pop(name) for name in found})
    return canser.open(**options)


def table(wrong: dict[str, list[Any]]) -> list[tuple[str, Any]]:
    return [(name, value) for name, values in wrong.items() for value in values]


@pytest.mark.parametrize(("name", "value"), table(OPEN), ids=str)
def test_open(name: str, value: object) -> None:
    good: dict[str, Any] = {"url": "loop://", "protocol": "seeed"}
    if name in SETTINGS:
        good["bitrate"] = 500_000
    if name == "ping":
        good["protocol"] = "cantalope"
    names(opened, name, value, **{key: good[key] for key in good if key != name})


# What a bus has, too; None is its default for two of them.
BUS = [
    (name, value)
    for name, value in table(OPEN)
    if name not in ("on_bytes", "config", "line")
    and not (value is None and name in ("device_time", "protocol"))
]


@pytest.mark.parametrize(("name", "value"), BUS, ids=str)
def test_the_bus(name: str, value: object) -> None:
    pytest.importorskip("can")
    from canser.python_can.bus import CanserBus  # noqa: PLC0415

    good: dict[str, Any] = {"channel": "loop://", "protocol": "seeed"}
    if name in SETTINGS:
        good["bitrate"] = 500_000
    if name == "ping":
        good["protocol"] = "cantalope"
    name = "channel" if name == "url" else name
    names(CanserBus, name, value, **{key: good[key] for key in good if key != name})


@pytest.mark.parametrize(
    ("name", "value"), table(SETTINGS | {"bitrate": NOT_WHOLE, "fixed": NOT_FLAGS}), ids=str
)
def test_a_configuration(name: str, value: object) -> None:
    config = {"bitrate": 500_000}

    def make(**given: Any) -> bytes:
        fixed = given.pop("fixed", False)
        return adapters.configuration("seeed", AdapterConfig(**config | given), fixed=fixed)

    names(make, name, value)


CALLS: dict[str, dict[str, list[Any]]] = {
    "read_batch": {
        "max_frames": [*NOT_WHOLE, 0],
        "min_frames": [*NOT_WHOLE, -1],
        "timeout": ["x", True, math.nan, [1]],
    },
    "batches": {"max_frames": [*NOT_WHOLE, 0], "timeout": ["x", True, math.nan]},
    "send": {"pace": NOT_FLAGS, "timeout": ["x", True, math.nan]},
    "send_raw": {"timeout": ["x", True, math.nan]},
    "drain": {"timeout": ["x", True, math.nan]},
    "request_status": {"timeout": ["x", True, math.nan]},
    "configure": {"bitrate": NOT_WHOLE[:-3], "config": [5, 500_000, "silent", {}]},
}


@pytest.mark.parametrize(
    ("call", "name", "value"),
    [(call, name, value) for call, wrong in CALLS.items() for name, value in table(wrong)],
    ids=str,
)
def test_a_port(call: str, name: str, value: object) -> None:
    first: dict[str, tuple[Any, ...]] = {"send": (vehicle(0.01),), "send_raw": (b"x",)}
    with canser.open("loop://", "seeed") as port:

        def run(**options: Any) -> None:
            result = getattr(port, call)(*first.get(call, ()), **options)
            if call == "batches":
                next(result)

        names(run, name, value)


def test_a_port_waits_for_ever_and_not_at_all() -> None:
    frames = vehicle(0.01)
    with canser.open("loop://", "seeed") as port:
        for end in (math.inf, 1e300, None):
            assert port.send(frames, timeout=end) == len(frames)
            assert port.drain(timeout=end)
            assert len(port.read_batch(min_frames=len(frames), timeout=end)) == len(frames)
        for end in (0, -1, -math.inf):
            assert len(port.read_batch(timeout=end)) == 0


@posix
@pytest.mark.parametrize(
    ("name", "value"),
    table(
        {
            "baudrate": ["fast", 1.5, True, 0],
            "faults": [5, None, {"noise": 1}],
            "pace": [5, True, "fast"],
            "loop": NOT_FLAGS,
            "echo": NOT_FLAGS,
            "link": [5, None, b"x"],
            "copy": [5, "x"],
            "ts_unit": [5, None, "h"],
        }
    ),
    ids=str,
)
def test_a_simulator(name: str, value: object) -> None:
    names(lambda **more: Simulator("seeed", **more), name, value)


@pytest.mark.parametrize(
    ("name", "value"),
    table(
        {
            "noise": [*NOT_REAL, math.nan, -1, 2],
            "loss": [*NOT_REAL, math.nan, -1, 2],
            "stalls": [5, [5], [(1,)], [(-1, 2.0)], [(1, "x")], [(1.5, 2.0)], [(1, math.inf)]],
            "unplug_after": ["x", 1.5, True, -1],
            "seed": [*NOT_WHOLE, -1],
            "mute": NOT_FLAGS,
            "deaf": [*NOT_REAL, math.nan, math.inf, -1],
            "swallow": NOT_FLAGS,
        }
    ),
    ids=str,
)
def test_faults(name: str, value: object) -> None:
    names(Faults, name, value)
