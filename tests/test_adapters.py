"""What adapters understand besides frames: configurations, requests, and what they report."""

import io
import itertools
import re
import struct
from dataclasses import FrozenInstanceError, asdict, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canser
import vectors
from canser import adapters
from canser.adapters import AdapterConfig, AdapterReport

BITRATES = [1000 * kilo for kilo in (1000, 800, 500, 400, 250, 200, 125, 100, 50, 20, 10, 5)]
MODES = ["normal", "loopback", "silent", "loopback-silent"]
NAMES = ", ".join(canser.protocols())
FRAME_TYPES = ["all", "extended"]
KINDS = {"seeed": {"status", "configuration", "other"}, "cantalope": {"ping", "error"}}
IDS = st.integers(0, 0x1FFF_FFFF)

SETTINGS = st.fixed_dictionaries(
    {
        "bitrate": st.sampled_from(BITRATES),
        "mode": st.sampled_from(MODES),
        "frame_type": st.sampled_from(FRAME_TYPES),
        "filter_id": IDS,
        "filter_mask": IDS,
        "once": st.booleans(),
        "fixed": st.booleans(),
    }
)


def fixed_packet(*body: int) -> bytes:
    """Return a fixed packet of `seeed` by its bytes from the command on; zeros follow."""
    filled = bytes(body).ljust(17, b"\0")
    return b"\xaa\x55" + filled + bytes([sum(filled) & 0xFF])


# Control packets, frames, and what is neither.
PIECES = [
    b"\xff\xff\0",
    b"\xff\xff\1\7",
    fixed_packet(4, 3, 96),
    fixed_packet(0x12, 3, 1),
    fixed_packet(1, 1, 1),
    b"\xaa\xc0\1\0\x55",
    b"\0",
]


def configuration(protocol: str, *, fixed: bool = False, **settings: Any) -> bytes:
    """Return the packet that configures an adapter, by default to 500 kbit/s."""
    config = AdapterConfig(**{"bitrate": 500_000, **settings})
    return adapters.configuration(protocol, config, fixed=fixed)


def control_of(raw: bytes, protocol: str) -> bytes:
    """Decode bytes that must be one control packet and nothing else; return it."""
    decoder = canser.Decoder(protocol)
    assert not len(decoder.feed(raw))
    assert not decoder.pending
    (control,) = decoder.take_controls()
    assert control == (0, raw)
    return control.data


def test_the_line() -> None:
    rates = {name: canser.protocol(name).baudrate for name in canser.protocols()}
    assert rates == dict.fromkeys(rates, 115_200) | {"seeed": 2_000_000}
    assert canser.protocol("waveshare").baudrate == 2_000_000


def test_who_takes_a_configuration() -> None:
    taken = {name: canser.protocol(name).bitrates for name in canser.protocols()}
    assert taken == dict.fromkeys(taken, ()) | {"seeed": tuple(BITRATES)}
    assert [name for name in taken if canser.protocol(name).configures] == ["seeed"]


def test_a_real_trace() -> None:
    # python-can asks for no retransmission.
    trace = bytes.fromhex("AA 55 12 03 01 00 00 00 00 00 00 00 00 00 01 00 00 00 00 17")
    assert configuration("seeed", once=True) == trace
    assert adapters.report("seeed", trace) == AdapterReport(
        "configuration",
        bitrate=500_000,
        mode="normal",
        frame_type="all",
        filter_id=0,
        filter_mask=0,
        once=True,
        fixed=False,
    )


def test_all_fields_of_a_configuration() -> None:
    raw = bytes.fromhex("AA 55 02 05 02 67 45 23 01 FF FF FF 1F 02 00 00 00 00 00 F7")
    settings: dict[str, Any] = {
        "bitrate": 250_000,
        "mode": "silent",
        "frame_type": "extended",
        "filter_id": 0x1234567,
        "filter_mask": 0x1FFFFFFF,
        "once": False,
        "fixed": True,
    }
    assert configuration("waveshare", **settings) == raw
    assert adapters.report("waveshare", raw) == AdapterReport("configuration", **settings)


@pytest.mark.parametrize("protocol", ["seeed", "cantalope"])
def test_control_packets_of_the_vectors(protocol: str) -> None:
    """Each is explained, and every kind is among them."""
    kinds = {
        report.kind
        for vector in vectors.load(protocol)
        for control in vector.controls
        for report in [adapters.report(protocol, control.data)]
    }
    assert kinds == KINDS[protocol]


@given(SETTINGS)
def test_a_configuration_says_what_was_asked_for(settings: dict[str, Any]) -> None:
    raw = configuration("seeed", **settings)
    assert raw == fixed_packet(
        0x02 if settings["fixed"] else 0x12,
        BITRATES.index(settings["bitrate"]) + 1,
        FRAME_TYPES.index(settings["frame_type"]) + 1,
        *struct.pack("<II", settings["filter_id"], settings["filter_mask"]),
        MODES.index(settings["mode"]),
        settings["once"],
    )
    report = adapters.report("seeed", control_of(raw, "seeed"))
    assert report == AdapterReport("configuration", **settings)


def test_python_can_sends_the_same() -> None:
    seeedstudio = pytest.importorskip("can.interfaces.seeedstudio.seeedstudio")
    bus = seeedstudio.SeeedBus.__new__(seeedstudio.SeeedBus)  # without a line to open
    bus.filter_id, bus.mask_id = bytes(4), bytes(4)
    bus._is_shutdown = True
    modes = dict(zip(bus.OPERATIONMODE, MODES, strict=True))
    frame_types = dict(zip(bus.FRAMETYPE, FRAME_TYPES, strict=True))
    for bitrate, mode, frame_type in itertools.product(bus.BITRATE, modes, frame_types):
        bus.bit_rate, bus.op_mode, bus.frame_type = bitrate, mode, frame_type
        bus.ser = io.BytesIO()
        bus.init_frame()
        ours = configuration(
            "seeed",
            bitrate=bitrate,
            mode=modes[mode],
            frame_type=frame_types[frame_type],
            once=True,
        )
        assert bus.ser.getvalue() == ours
    bus.ser = io.BytesIO()
    bus.status_frame()
    assert bus.ser.getvalue() == canser.protocol("seeed").status_request


def test_by_default_all_frames_pass() -> None:
    assert configuration("seeed") == fixed_packet(0x12, 3, 1)


@pytest.mark.parametrize("place", range(2, 19))
@pytest.mark.parametrize("command", [0x12, 0x02])
def test_what_a_configuration_cannot_say_is_other(command: int, place: int) -> None:
    """Every value of every byte: it is told, or the packet is none that anybody knows."""
    good = {
        2: {0x12, 0x02},
        3: set(range(1, 13)),
        4: {1, 2},
        13: set(range(4)),
        14: {0, 1},
    }
    if 5 <= place < 13:  # filter and mask
        good[place] = set(range(256))
    body = [command, 3, 1, *[0] * 14]
    told = set()
    for value in range(256):
        body[place - 2] = value
        if (place, value) == (2, 1):
            continue  # a frame
        report = adapters.report("seeed", fixed_packet(*body))
        if report.kind == "configuration":
            told.add(value)
        elif (place, value) != (2, 4):  # a status
            assert report == AdapterReport("other")
    assert told == good.get(place, {0})


def test_all_bits_of_a_filter_are_told() -> None:
    raw = fixed_packet(0x12, 3, 1, *[0x78, 0x56, 0x34, 0x92, 0xFF, 0xFF, 0xFF, 0xFF])
    report = adapters.report("seeed", raw)
    assert (report.filter_id, report.filter_mask) == (0x92345678, 0xFFFFFFFF)


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        (
            {"bitrate": 123456},
            "bitrate 123456 is none of the adapter's: 1000000, 800000, 500000, 400000, 250000, "
            "200000, 125000, 100000, 50000, 20000, 10000, 5000",
        ),
        ({"bitrate": 1}, "bitrate 1 is none of the adapter's: 1000000, "),
        ({"bitrate": 0}, "bitrate is 0; it must be 1 or more"),
        ({"bitrate": -1}, "bitrate is -1; it must be 1 or more"),
        ({"bitrate": 1 << 32 | 500_000}, "bitrate 4295467296 is none of the adapter's: "),
        ({"mode": "listen"}, "unknown mode 'listen'; have: normal, loopback, silent, loopback-si"),
        ({"mode": ["normal"]}, "unknown mode ['normal']; have: normal, "),
        ({"frame_type": "standard"}, "unknown frame_type 'standard'; have: all, extended"),
        ({"filter_id": 1 << 29}, "filter_id is 0x20000000; it must be 0 to 0x1fffffff"),
        ({"filter_id": -1}, "filter_id is -0x1; it must be 0 to 0x1fffffff"),
        ({"filter_mask": 1 << 64}, "filter_mask is 0x10000000000000000; it must be 0 to 0x1fffff"),
    ],
)
def test_values_out_of_range_say_what_there_is(settings: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(problem)}.*\\Z"):
        configuration("seeed", **settings)


@pytest.mark.parametrize("name", ["bitrate", "filter_id", "filter_mask"])
@pytest.mark.parametrize("value", [500_000.0, "500000", None])
def test_numbers_are_whole_numbers(name: str, value: object) -> None:
    settings: dict[str, Any] = {name: value}
    with pytest.raises(TypeError, match="integer"):
        configuration("seeed", **settings)


def test_a_config_is_checked_when_it_is_made_and_stays() -> None:
    config = AdapterConfig(bitrate=np.int32(500_000), filter_id=np.uint8(7), once=np.True_)  # type: ignore[arg-type]
    assert config == AdapterConfig(bitrate=500_000, filter_id=7, once=True)
    assert [type(value) for value in (config.bitrate, config.filter_id, config.once)] == [
        int,
        int,
        bool,
    ]
    with pytest.raises(FrozenInstanceError):
        config.mode = "silent"  # type: ignore[misc]
    with pytest.raises(ValueError, match="unknown mode 'silence'; have: normal, loopback, silent"):
        replace(config, mode="silence")
    with pytest.raises(TypeError, match="bitrate"):  # the adapter is always set as a whole
        AdapterConfig(mode="silent")  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"^config is 500000; it must be a canser.AdapterConfig$"):
        adapters.configuration("seeed", 500_000)  # type: ignore[arg-type]


@pytest.mark.parametrize("protocol", sorted(set(canser.protocols()) - {"seeed"}))
def test_no_configuration(protocol: str) -> None:
    problem = f"{protocol} adapters take no configuration; leave bitrate out"
    with pytest.raises(ValueError, match=f"^{problem}$"):
        configuration(protocol)


def test_ping() -> None:
    pings = {name: canser.protocol(name).ping for name in canser.protocols()}
    assert pings == dict.fromkeys(pings, b"") | {"cantalope": b"\xff\xff\0"}
    control = control_of(pings["cantalope"], "cantalope")
    assert adapters.report("cantalope", control) == AdapterReport("ping")


def test_status_request() -> None:
    requests = {name: canser.protocol(name).status_request for name in canser.protocols()}
    request = bytes.fromhex("AA 55 04") + bytes(16) + b"\x04"
    assert requests == dict.fromkeys(requests, b"") | {"seeed": request}
    report = adapters.report("seeed", control_of(request, "seeed"))
    assert report == AdapterReport("status", receive_errors=0, transmit_errors=0)


@given(st.integers(0, 255), st.integers(0, 255), st.binary(min_size=14, max_size=14))
def test_a_status_has_both_error_counters(receive: int, transmit: int, rest: bytes) -> None:
    report = adapters.report("seeed", fixed_packet(4, receive, transmit, *rest))
    assert report == AdapterReport("status", receive_errors=receive, transmit_errors=transmit)


@given(st.integers(0, 255))
def test_an_error_has_its_number(number: int) -> None:
    report = adapters.report("cantalope", bytes([0xFF, 0xFF, 0x01, number]))
    assert report == AdapterReport("error", number=number)


@given(
    st.sampled_from(canser.protocols()),
    st.lists(st.sampled_from(PIECES), max_size=3).map(b"".join),
    st.integers(0, 44),
)
def test_a_report_is_of_one_control_packet(protocol: str, data: bytes, cut: int) -> None:
    data = data[:cut]
    decoder = canser.Decoder(protocol)
    decoder.feed(data)
    if decoder.take_controls() == [(0, data)]:
        assert adapters.report(protocol, data).kind in KINDS[protocol]
    else:
        with pytest.raises(ValueError, match=r"^data is not one control packet of .*\Z"):
            adapters.report(protocol, data)


@pytest.mark.parametrize(
    ("protocol", "data"),
    [
        ("serial", b""),
        ("cantalope", b""),
        ("cantalope", b"\xff\xff"),
        ("cantalope", b"\xff\xff\0" * 2),
        ("cantalope", b"\0\0\xff\xff\0"),
        ("cantalope", b"\xff\xff\0\0"),
        ("seeed", fixed_packet(4)[:-1]),
        ("seeed", fixed_packet(4) + b"\0"),
        ("seeed", fixed_packet(4)[:-1] + b"\5"),
        ("seeed", fixed_packet(1, 1, 1)),
    ],
)
def test_other_bytes_are_refused(protocol: str, data: bytes) -> None:
    with pytest.raises(ValueError, match=f"^data is not one control packet of {protocol}; pass"):
        adapters.report(protocol, data)


def test_any_buffer_is_reported() -> None:
    ping = bytearray(b"\xff\xff\0")
    assert adapters.report("cantalope", memoryview(ping)) == AdapterReport("ping")
    with pytest.raises(TypeError, match="data must be bytes"):
        adapters.report("cantalope", "ping")  # type: ignore[arg-type]


def test_a_report_is_frozen() -> None:
    report = AdapterReport("error", number=7)
    with pytest.raises(FrozenInstanceError):
        report.number = 8  # type: ignore[misc]
    assert {name for name, value in asdict(report).items() if value is not None} == {
        "kind",
        "number",
    }


def test_unknown_protocols() -> None:
    for call in (
        canser.protocol,
        configuration,
        lambda name: adapters.report(name, b""),
    ):
        with pytest.raises(ValueError, match=f"unknown protocol 'foo'; have: {NAMES}$"):
            call("foo")
