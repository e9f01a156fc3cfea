"""canser against the reference: the same frames, offsets, control packets and statistics.

On noise, on bytes that look like packets, on streams damaged in every way, however they are cut
into pieces and however little room there is for the frames; and the laws that hold without any
reference.
"""

import random
from itertools import cycle, pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import canser
import reference
import shared
import vectors
from canser._core.buffers import FrameRoom, input_bytes
from conftest import Run, assert_agree
from long import LONG, longer
from reference import ID_EXT_MAX, ID_MAX, NO_TIME, TICK_NS, WIRE_FORMATS, Frame

PROTOCOLS = canser.protocols()
UNITS = tuple(TICK_NS)

every_protocol = pytest.mark.parametrize("protocol", PROTOCOLS)


def array(frames: list[Frame]) -> npt.NDArray[np.void]:
    return np.frombuffer(reference.pack(frames), canser.FRAME_DTYPE)


# --- strategies ---

any_unit = st.sampled_from(UNITS)
any_byte = st.integers(0, 255)
any_time = st.integers(-(2**63), 2**63 - 1)
any_raw = st.sampled_from([0, 1, 0x7FFF_FFFF, 0x8000_0000, 0xAAAA_AAAA, 0xFFFF_FFFF]) | st.integers(
    0, 2**32 - 1
)
any_id = st.sampled_from([0, 1, ID_MAX, ID_MAX + 1, ID_EXT_MAX, ID_EXT_MAX + 1, 2**32 - 1])


def long_bytes(alphabet: bytes) -> st.SearchStrategy[bytes]:
    """Many bytes out of one seed: Hypothesis alone hardly ever draws long lists."""
    return st.builds(
        lambda seed, size: bytes(random.Random(seed).choices(alphabet, k=size)),
        st.integers(0, 2**32),
        st.integers(0, 600),
    )


def random_bytes(_protocol: str) -> st.SearchStrategy[bytes]:
    return st.binary(max_size=200) | long_bytes(bytes(range(256)))


def few_significant_bytes(protocol: str, max_size: int) -> st.SearchStrategy[bytes]:
    return st.lists(st.sampled_from(WIRE_FORMATS[protocol].significant), max_size=max_size).map(
        bytes
    )


def significant_bytes(protocol: str) -> st.SearchStrategy[bytes]:
    # The marks more often than the rest: without them nothing ever starts.
    alphabet = WIRE_FORMATS[protocol].significant
    alphabet += 2 * alphabet[:3]
    return few_significant_bytes(protocol, 100) | long_bytes(alphabet)


@st.composite
def good_frames(draw: st.DrawFn, protocol: str) -> Frame:
    """Draw a frame that the format carries without loss, its time left out."""
    significant = WIRE_FORMATS[protocol].significant
    ext = WIRE_FORMATS[protocol].has_ext and draw(st.booleans())
    limit = ID_EXT_MAX if ext else ID_MAX
    id_ = draw(st.sampled_from([0, 0x55, 0xAA, 0x555, ID_MAX, limit]) | st.integers(0, limit))
    rtr = draw(st.booleans())
    err = WIRE_FORMATS[protocol].has_err and draw(st.booleans())
    dlc = draw(st.integers(0, 8))
    data = b"" if rtr else draw(st.binary(min_size=dlc, max_size=dlc))
    if draw(st.booleans()):
        data = bytes(significant[byte % len(significant)] for byte in data)
    return Frame(id_, ext, rtr, dlc, err, data.ljust(8, b"\0"))


@st.composite
def any_frames(draw: st.DrawFn) -> Frame:
    """Draw a row that a caller may hand to encode, good or not."""
    return Frame(
        draw(any_id | st.integers(0, ID_MAX)),
        draw(st.booleans()),
        draw(st.booleans()),
        draw(st.integers(0, 8) | st.sampled_from([9, 15, 255])),
        draw(st.booleans()),
        draw(st.binary(min_size=8, max_size=8)),
        draw(any_time | st.sampled_from([NO_TIME, -1, 0, 1_000_000])),
    )


def good_packets(protocol: str) -> st.SearchStrategy[bytes]:
    return st.builds(
        lambda frame, raw: reference.encode([frame._replace(ts=raw)], protocol, tick_ns=1),
        good_frames(protocol),
        any_raw,
    )


@st.composite
def odd_serial(draw: st.DrawFn) -> bytes:
    """Draw a frame of the other dialects: any id word, filler bytes in a remote frame."""
    word = draw(any_id | st.integers(0, 2**32 - 1))
    dlc = draw(st.integers(0, 9))
    body = draw(st.binary(min_size=dlc, max_size=dlc))
    head = b"\xaa" + draw(any_raw).to_bytes(4, "little") + bytes([dlc])
    return head + word.to_bytes(4, "little") + body + b"\xbb"


@st.composite
def odd_seeed(draw: st.DrawFn) -> bytes:
    """Draw a variable packet with any id, of either dialect of remote frames."""
    type_ = 0xC0 | draw(st.integers(0, 0x3F))
    id_ = draw(any_id | st.integers(0, ID_MAX)).to_bytes(4, "little")[: 4 if type_ & 0x20 else 2]
    dlc = type_ & 0x0F
    body = draw(st.binary(min_size=dlc, max_size=dlc) | st.just(b""))
    return bytes([0xAA, type_]) + id_ + body + b"\x55"


@st.composite
def fixed_seeed(draw: st.DrawFn) -> bytes:
    """Draw a fixed packet: a frame, a control packet, or a frame with one thing wrong."""
    kind, form = draw(st.integers(1, 2)), draw(st.integers(1, 2))
    limit = ID_EXT_MAX if kind == 2 else ID_MAX
    fields = {
        "command": 0x01,
        "kind": kind,
        "form": form,
        "id": draw(st.just(limit) | st.integers(0, limit)),
        "dlc": draw(st.integers(0, 8)),
        "last": 0,
        "sum": 0,
    }
    wrong = {
        "command": st.sampled_from([0x00, 0x02, 0x04, 0x12, 0xFF]),
        "kind": st.sampled_from([0, 3]),
        "form": st.sampled_from([0, 3]),
        "id": st.just(limit + 1) | st.integers(limit + 1, 2**32 - 1),
        "dlc": st.sampled_from([9, 255]),
        "last": st.integers(1, 255),
        "sum": st.integers(1, 255),
    }
    if draw(st.booleans()):
        name = draw(st.sampled_from(sorted(wrong)))
        fields[name] = draw(wrong[name])
    body = bytes([fields["command"], fields["kind"], fields["form"]])
    body += fields["id"].to_bytes(4, "little") + bytes([fields["dlc"]])
    body += draw(st.binary(min_size=8, max_size=8)) + bytes([fields["last"]])
    return b"\xaa\x55" + body + bytes([(sum(body) + fields["sum"]) & 0xFF])


@st.composite
def odd_cantalope(draw: st.DrawFn) -> bytes:
    """Draw a ping, an error report, another command, or any header and what it asks for."""
    commands = [b"\xff\xff\x00", b"\xff\xff\x01\x07", b"\xff\xff\x02", b"\xff\xff"]
    almost = st.integers(0, 15).map(lambda bit: 0xFFFF ^ 1 << bit)
    header = draw(almost | st.integers(0, 0xFFFF))
    body = draw(st.binary(min_size=header & 0x0F, max_size=header & 0x0F))
    return draw(st.sampled_from(commands) | st.just(header.to_bytes(2, "big") + body))


@st.composite
def odd_canet13(draw: st.DrawFn) -> bytes:
    """Draw any info byte, any id, and 8 bytes, of which not all are data."""
    info = draw(any_byte | st.sampled_from([0x08, 0x88, 0xC8, 0x09, 0x18, 0x28]))
    id_ = draw(any_id | st.integers(0, ID_MAX))
    return bytes([info]) + id_.to_bytes(4, "big") + draw(st.binary(min_size=8, max_size=8))


# Packets of other dialects, and those that are almost good, where there are any.
ODD: dict[str, st.SearchStrategy[bytes]] = {
    "canet13": odd_canet13(),
    "cantalope": odd_cantalope(),
    "seeed": odd_seeed() | fixed_seeed(),
    "serial": odd_serial(),
}


@st.composite
def damaged(draw: st.DrawFn, stream: bytes) -> bytes:
    """Damage the stream: a few bytes flipped, lost, inserted, doubled, or cut off."""
    damage = st.tuples(
        st.sampled_from(["flip", "delete", "insert", "duplicate", "cut"]),
        st.integers(0, 2**16),
        st.integers(1, 20),
        any_byte,
    )
    for kind, place, length, byte in draw(st.lists(damage, max_size=6)):
        start = place % (len(stream) + 1)
        head, tail = stream[:start], stream[start:]
        match kind:
            case "flip" if tail:
                stream = head + bytes([tail[0] ^ (byte or 1)]) + tail[1:]
            case "delete":
                stream = head + tail[length:]
            case "insert":
                stream = head + bytes([byte]) + tail
            case "duplicate":
                stream = head + tail[:length] + tail
            case "cut" if length == 1:
                stream = head
    return stream


@st.composite
def packets_and_noise(draw: st.DrawFn, protocol: str) -> bytes:
    """Packets good and odd, cut packets and noise, and damage on top of it all."""
    packets = good_packets(protocol)
    odd = ODD.get(protocol, packets)
    cut = st.builds(lambda packet, cut: packet[:cut], packets | odd, st.integers(1, 19))
    noise = st.binary(max_size=6) | few_significant_bytes(protocol, 6)
    count = draw(st.integers(0, 16))
    anything = packets | packets | odd | cut | noise
    segments = draw(st.lists(anything, min_size=count, max_size=count))
    return draw(damaged(b"".join(segments)))


@st.composite
def hostile_bytes(draw: st.DrawFn, protocol: str) -> bytes:
    """Repeat a few significant bytes: a candidate at every byte, and none or few good.

    Long enough for code that looks at many positions at once.
    """
    odd = ODD.get(protocol, good_packets(protocol)).map(lambda packet: packet[:-1])
    pattern = draw(few_significant_bytes(protocol, 5) | odd | st.sampled_from([b"\xaa", b"\xff"]))
    times = draw(st.integers(0, 700 // (len(pattern) + 1)))
    good = draw(st.lists(good_packets(protocol), max_size=3))
    stream = b"".join([pattern * times + packet for packet in good] or [pattern * times])
    return stream + draw(few_significant_bytes(protocol, 20))


any_cuts = st.lists(st.integers(0, 2**16), max_size=8)
any_rooms = st.just([64]) | st.lists(st.integers(1, 5), min_size=1, max_size=4)


# --- the second opinion ---


def judge(protocol: str, stream: bytes, cuts: list[int], rooms: list[int], unit: str) -> None:
    """Compare the two at the end of every piece and at the end of the stream."""
    tick_ns = TICK_NS[unit]
    run = Run(protocol, unit, rooms)
    ends = sorted(cut % (len(stream) + 1) for cut in cuts)
    for start, end in pairwise([0, *ends, len(stream)]):
        run.feed(stream[start:end])
        assert_agree(run, reference.decode(stream[:end], protocol, tick_ns, flush=False))
    run.flush()
    expected = reference.decode(stream, protocol, tick_ns)
    assert_agree(run, expected)
    # One truth: the one-shot decode is feed and flush.
    decoder = canser.Decoder(protocol, ts_unit=unit)
    streamed = decoder.feed(stream).tobytes() + decoder.flush().tobytes()
    assert streamed == reference.pack(expected.frames)
    whole = canser.decode(stream, protocol, ts_unit=unit, as_is=True)
    assert whole.dtype == canser.FRAME_DTYPE
    assert whole.tobytes() == streamed
    pieces = [stream[start:end] for start, end in pairwise([0, *ends, len(stream)])]
    spans = find_spans(protocol, pieces, rooms)
    assert spans == [*zip(expected.offsets, expected.ends, strict=True)]


def find_spans(protocol: str, pieces: list[bytes], rooms: list[int]) -> list[tuple[int, int]]:
    """Return where each frame begins and ends, with room for a few at a time."""
    decoder = canser.Decoder(protocol)
    rows = np.empty((2, max(rooms)), np.int64)
    room = FrameRoom(np.empty(max(rooms), canser.FRAME_DTYPE), *rows)
    spans: list[tuple[int, int]] = []
    most = cycle(rooms)
    for piece in [*pieces, None]:
        rest = piece
        while rest or (rest is None and decoder.pending):
            before = decoder.counters.frames
            rows[:] = -1
            if rest is None:
                decoder.flush_room(room, 0, next(most))
            else:
                source = input_bytes(rest)
                rest = rest[decoder.feed_room(source, len(rest), room, 0, next(most)) :]
            count = decoder.counters.frames - before
            spans += zip(*rows[:, :count].tolist(), strict=True)
            assert (rows[:, count:] == -1).all()
    return spans


STREAMS = {
    "random bytes": random_bytes,
    "significant bytes": significant_bytes,
    "packets and noise": packets_and_noise,
    "hostile bytes": hostile_bytes,
}


@pytest.mark.parametrize("kind", STREAMS)
@every_protocol
@given(data=st.data())
def test_streams(protocol: str, kind: str, data: st.DataObject) -> None:
    stream = data.draw(STREAMS[kind](protocol), "stream")
    cuts, rooms = data.draw(any_cuts, "cuts"), data.draw(any_rooms, "rooms")
    judge(protocol, stream, cuts, rooms, data.draw(any_unit, "unit"))


@every_protocol
@pytest.mark.parametrize("byte", [0x00, 0x55, 0xAA, 0xBB, 0xC0, 0xFF])
def test_one_byte_over_and_over(protocol: str, byte: int) -> None:
    # Each length up to a few vectors' width and one that is long, then a good frame.
    good = reference.encode([Frame(0x123, dlc=2, data=b"\xaa\x55".ljust(8, b"\0"), ts=0)], protocol)
    for length in [*range(140), 5000]:
        judge(protocol, bytes([byte]) * length + good + b"\xaa", [], [64], "ms")


# --- long noise, of which many positions are looked at at once ---


def hex_units(*units: str) -> list[bytes]:
    return [bytes.fromhex(unit) for unit in units]


def fixed(body: str) -> bytes:
    """Return a fixed packet of `seeed` whose sum holds."""
    content = bytes.fromhex(body)
    return b"\xaa\x55" + content + bytes([sum(content) & 0xFF])


# What noise is made of: whole packets and what nearly is one, by the rule that it breaks; of
# other protocols their vectors.
UNITS_OF_NOISE = {
    "cantalope": [
        *hex_units("09", "0F", "FF", "FF FF", "FF FF 02", "FF FF FF 01", "FF FF 02 00 00"),
        *hex_units("01 00", "01 10", "24 61 AA", "24 78 FF FF 09 09 09 09 09 09", "FF 02 00 00"),
        *hex_units("FF FF 00", "FF FF 01 07"),
    ],
    "seeed": [
        *hex_units("AA", "55", "AA 55", "AA 55 01 55", "AA BF", "01"),
        *hex_units("AA C9", "AA EF", "AA C2 00 08", "AA E1 00 00 00 20", "AA D0 FF 08"),
        *hex_units("AA C0", "AA C8", "AA E8 AA AA", "AA E8 AA 55 55", "AA F8 01 02 03 04 07"),
        *hex_units("AA C0 23 01 55", "AA C1 FF 07 55 55", "AA E0 FF FF FF 1F 55"),
        *hex_units("AA E8 01 02 03 04 11 22 33 44 55 66 77 88 55", "AA C8 01 02 AA C0 00 01 55"),
        *hex_units("AA D0 23 01 55", "AA D8 23 01 55", "AA D2 23 01 00 00 55"),
        *hex_units("AA E6 55 01 AA 01 AA C1 55 01 AA C1 55"),
        *hex_units("AA E7 55 01 AA 01 AA C1 55 01 AA C1 55 55"),
        *hex_units("AA F0 01 02 03 04 55", "AA F8 01 02 03 04 01 02 03 04 05 06 07 08 55"),
        *hex_units("AA F8 01 02 03 04 55", "AA D8 23 01 01 02 03 04 05 06 07 08 AA"),
        fixed("01 01 01 FF 07 00 00 08 11 22 33 44 55 66 77 88 00"),
        fixed("01 02 02 FF FF FF 1F 00 11 22 33 44 55 66 77 88 00"),
        fixed("04 01 02" + 14 * " 00"),
        fixed("01 03 01 23 01 00 00 08" + 9 * " 00"),
        fixed("01 01 00 23 01 00 00 08" + 9 * " 00"),
        fixed("01 01 03 23 01 00 00 08" + 9 * " 00"),
        fixed("01 00 01 23 01 00 00 08" + 9 * " 00"),
        fixed("01 01 01 00 08 00 00 08" + 9 * " 00"),
        fixed("01 01 01 00 00 01 00 08" + 9 * " 00"),
        fixed("01 01 01 00 00 00 01 08" + 9 * " 00"),
        fixed("01 02 01 00 00 00 20 08" + 9 * " 00"),
        fixed("01 01 01 23 01 00 00 09" + 9 * " 00"),
        fixed("01 01 01 23 01 00 00 08" + 8 * " 00" + " 01"),
        fixed("01 01 01 23 01 00 00 08" + 9 * " 00")[:-1],
    ],
    "serial": [
        *hex_units("AA", "BB", "08", "01", "AA AA AA AA AA 08 08 08 08 08"),
        *hex_units("AA AA AA AA AA 08 08 08 08 08 BB BB BB BB BB", "AA 00 00 00 00 09"),
        *hex_units("AA AA AA AA AA 08 08 08 08 40 BB BB BB BB BB", "AA 01 02 03 04 10 BB BB"),
        *[
            b"\xaa\x01\x02\x03\x04" + bytes([dlc, 0x23, 0x01, 0, flags]) + bytes(length) + end
            for dlc in range(9)
            for flags in (0x00, 0x40, 0x80, 0xE0)
            for length in {0, dlc, 7}
            for end in (b"\xbb", b"\x00")
        ],
    ],
}


def units_of_noise(protocol: str) -> list[bytes]:
    vector_streams = [vector.stream for vector in vectors.load(protocol)]
    return UNITS_OF_NOISE.get(protocol, vector_streams)


def long_noise(protocol: str, chance: random.Random) -> bytes:
    """Return stretches of one, two or many units each: sparse, dense, regular and not."""
    stream = bytearray()
    while len(stream) < 6000:
        units = chance.choices(units_of_noise(protocol), k=chance.choice((1, 2, 2, 3, 12)))
        length = chance.choice((20, 200, 600))
        part = bytearray().join(chance.choices(units, k=length))[:length]
        if chance.random() < 0.3:
            for place in chance.choices(range(len(part)), k=len(part) // 20):
                part[place] = chance.choice(WIRE_FORMATS[protocol].significant)
        stream += part
        # Noise that stands by itself among frames.
        good = Frame(chance.randrange(ID_MAX), dlc=8, data=chance.randbytes(8), ts=0)
        stream += reference.encode([good] * chance.randrange(20), protocol) + b"\xbf\x0f"
    return bytes(stream)


@longer
@every_protocol
@pytest.mark.parametrize("seed", range(8 if LONG else 4))
def test_long_noise(protocol: str, seed: int) -> None:
    chance = random.Random(seed)
    stream = long_noise(protocol, chance)
    cuts = [chance.randrange(len(stream)) for _ in range(3)]
    for rooms in ([8000], [40, 1, 200]):
        judge(protocol, stream, cuts, rooms, "ms")


# Candidates without end, and no packet among them; of other protocols what is none in any.
DENSE = {
    "cantalope": "09",
    "seeed": "AA D8 55 01",
    "serial": "AA AA AA AA AA 08 08 08 08 08 BB BB BB BB BB",
}


@every_protocol
@pytest.mark.parametrize("seed", range(4))
def test_packets_in_dense_noise(protocol: str, seed: int) -> None:
    chance = random.Random(seed)
    dense = bytes.fromhex(DENSE.get(protocol, "3F"))
    stream = bytearray()
    for unit in units_of_noise(protocol):
        stream += dense * (chance.randrange(90, 220) // len(dense))
        stream += unit * chance.randrange(1, 4)
    judge(protocol, bytes(stream), [], [5000], "ms")


@every_protocol
@pytest.mark.parametrize("unit", range(12))
def test_one_unit_over_and_over(protocol: str, unit: int) -> None:
    # Behind runs of every length, so that it lies anywhere in what is looked at at once.
    units = units_of_noise(protocol)
    for chosen in units[unit::12]:
        stream = b"".join(chosen * times + b"\x0f\xbf" * times for times in range(1, 24))
        judge(protocol, stream, [], [5000], "ms")


@pytest.mark.parametrize(
    ("protocol", "packets"),
    [
        ("cantalope", b"\xff\xff\x00\x24\x60"),
        ("seeed", b"\xaa\x55\x04" + bytes(16) + b"\x04\xaa\xc0\x23\x01\x55"),
        ("serial", bytes.fromhex("AA 00 00 00 00 00 01 00 00 00 BB")),
    ],
)
def test_many_control_packets(protocol: str, packets: bytes) -> None:
    # More of them in one piece than any buffer between C and Python is likely to hold.
    stream = packets * 5000
    expected = reference.decode(stream, protocol)
    for room in (1000, 5000, 6000):
        run = Run(protocol, rooms=[room])
        run.feed(stream)
        run.flush()
        assert_agree(run, expected)


# --- laws ---


@every_protocol
@given(data=st.data())
def test_decode_gives_back_what_encode_sent(protocol: str, data: st.DataObject) -> None:
    frames = data.draw(st.lists(good_frames(protocol), max_size=20), "frames")
    unit = data.draw(any_unit, "unit")
    if WIRE_FORMATS[protocol].has_clock:
        # The first time is the counter's own; then any step that a signed difference can tell.
        # In seconds the steps are shorter, or the sum would leave the 64 bits of a time.
        most = 2**20 if unit == "s" else 2**31
        ticks = data.draw(any_raw, "first time")
        for index, frame in enumerate(frames):
            frames[index] = frame._replace(ts=ticks * TICK_NS[unit])
            ticks += data.draw(st.integers(-most, most - 1), "step")
    stream = canser.encode(array(frames), protocol, ts_unit=unit)
    assert (
        reference.unpack(canser.decode(stream, protocol, ts_unit=unit, as_is=True).tobytes())
        == frames
    )
    result = reference.decode(stream, protocol, TICK_NS[unit])
    assert result.frames == frames
    assert result.stats.bytes_framed == len(stream)


@every_protocol
@given(frames=st.lists(any_frames(), max_size=6), unit=any_unit)
def test_encode(protocol: str, frames: list[Frame], unit: str) -> None:
    try:
        expected = reference.encode(frames, protocol, TICK_NS[unit])
    except ValueError as problem:
        index = str(problem).split()[1].rstrip(":")
        with pytest.raises(ValueError, match=rf"\b{index}\b"):
            canser.encode(array(frames), protocol, ts_unit=unit)
    else:
        assert canser.encode(array(frames), protocol, ts_unit=unit) == expected


@every_protocol
@given(data=st.data())
def test_encode_good_frames(protocol: str, data: st.DataObject) -> None:
    # Whatever stands behind the dlc and in a remote frame does not count, nor does a time that
    # is no whole tick.
    rubbish = st.builds(
        lambda frame, data, ts: frame._replace(
            data=frame.data[: frame.dlc] + data[frame.dlc :], ts=ts
        ),
        good_frames(protocol),
        st.binary(min_size=8, max_size=8),
        any_time.filter(lambda ts: ts != NO_TIME),
    )
    frames = data.draw(st.lists(rubbish, max_size=20), "frames")
    unit = data.draw(any_unit, "unit")
    expected = reference.encode(frames, protocol, TICK_NS[unit])
    assert canser.encode(array(frames), protocol, ts_unit=unit) == expected


@every_protocol
@given(data=st.data())
def test_decode_with_arrays_and_threads(protocol: str, data: st.DataObject) -> None:
    stream = data.draw(packets_and_noise(protocol), "stream")
    threads = data.draw(st.integers(1, 3), "threads")
    expected = reference.decode(stream, protocol)
    count = len(expected.frames)
    assume(count > 0)
    out, offsets = np.zeros(count, canser.FRAME_DTYPE), np.zeros(count, np.int64)
    frames = canser.decode(stream, protocol, out=out, offsets=offsets, threads=threads, as_is=True)
    assert np.shares_memory(frames, out)
    assert frames.tobytes() == reference.pack(expected.frames)
    assert offsets.tolist() == expected.offsets
    if count > 1:
        with pytest.raises(ValueError, match=rf"\b{count}\b"):
            canser.decode(stream, protocol, out=out[:-1], threads=threads, as_is=True)


@every_protocol
@given(data=st.data())
def test_a_stream_may_go_on_behind_its_end(protocol: str, data: st.DataObject) -> None:
    streams = packets_and_noise(protocol)
    first, second = data.draw(streams, "first"), data.draw(streams, "second")
    run = Run(protocol, rooms=data.draw(any_rooms, "rooms"))
    run.feed(first)
    run.flush()
    run.feed(second)
    run.flush()
    one, two = reference.decode(first, protocol), reference.decode(second, protocol)
    offsets = one.offsets + [len(first) + offset for offset in two.offsets]
    assert run.result().offsets == offsets
    actual, clockless = run.result(), [frame._replace(ts=0) for frame in one.frames + two.frames]
    assert [frame._replace(ts=0) for frame in actual.frames] == clockless
    assert [packet.data for packet in actual.controls] == [
        packet.data for packet in one.controls + two.controls
    ]
    # A run of skipped bytes may reach across the end of the first stream.
    resyncs = one.stats.resyncs + two.stats.resyncs
    assert actual.stats.resyncs in (resyncs, resyncs - 1)
    for reason in reference.REASONS:
        rejects = one.stats.rejects[reason] + two.stats.rejects[reason]
        assert actual.stats.rejects[reason] == rejects


@every_protocol
@given(data=st.data())
def test_reset_forgets_everything(protocol: str, data: st.DataObject) -> None:
    streams = packets_and_noise(protocol)
    first, second = data.draw(streams, "first"), data.draw(streams, "second")
    run = Run(protocol)
    run.decoder.feed(first)
    run.decoder.reset()
    run.feed(second)
    run.flush()
    assert_agree(run, reference.decode(second, protocol))


# --- captures ---

# Captures without noise hold every frame of their log, and no byte outside a frame.
FRAME_COUNTS = {"car": 82_558, "tesla": 12_974, "boat": 12_274}

NAMES = [
    "boat.seeed",
    "boat.serial",
    "car-noisy.seeed",
    "car-noisy.serial",
    "car.cantalope",
    "car.seeed",
    "car.serial",
    "tesla.cantalope",
    "tesla.seeed",
    "tesla.serial",
]

every_capture = pytest.mark.parametrize("name", NAMES)


def capture(name: str) -> tuple[bytes, str]:
    """Return the bytes of a capture and its protocol."""
    return (shared.CAPTURES / f"{name}.bin").read_bytes(), name.partition(".")[2]


@shared.needs_captures
@every_capture
def test_start_of_capture(name: str) -> None:
    stream, protocol = capture(name)
    # Odd, so that the end cuts a packet in most captures.
    stream = stream[:100_003]
    held = reference.decode(stream, protocol, flush=False)
    expected = reference.decode(stream, protocol)
    assert ("noisy" in name) == (held.stats.bytes_skipped > 0)
    for piece_len, room in ((len(stream), 20_000), (4095, 4096), (1021, 7)):
        run = Run(protocol, rooms=[room])
        for start in range(0, len(stream), piece_len):
            run.feed(stream[start : start + piece_len])
        assert_agree(run, held)
        run.flush()
        assert_agree(run, expected)
    assert canser.decode(stream, protocol, threads=2, as_is=True).tobytes() == reference.pack(
        expected.frames
    )


@shared.needs_captures
@pytest.mark.parametrize("name", [name for name in NAMES if "noisy" not in name])
def test_whole_capture(name: str) -> None:
    stream, protocol = capture(name)
    decoder = canser.Decoder(protocol)
    frames = decoder.feed(stream)
    assert len(frames) == FRAME_COUNTS[name.partition(".")[0]]
    assert decoder.stats.bytes_framed == len(stream)


@shared.needs_captures
@every_capture
@settings(max_examples=15)
@given(data=st.data())
def test_damaged_capture(name: str, data: st.DataObject) -> None:
    stream, protocol = capture(name)
    start = data.draw(st.integers(0, len(stream) - 1), "start")
    length = data.draw(st.integers(0, 1500), "length")
    stream = data.draw(damaged(stream[start : start + length]), "stream")
    cuts, rooms = data.draw(any_cuts, "cuts"), data.draw(any_rooms, "rooms")
    judge(protocol, stream, cuts, rooms, "ms")


# --- the clock, which needs longer runs than chance gives ---


# Steps of a counter: a run of small ones, false times round the circle, and the way back to
# near where it stood, or not so near.
@st.composite
def steps_of_a_counter(draw: st.DrawFn) -> list[int]:
    run = draw(st.sampled_from([0, 1, 3, 14, 15, 16, 17, 18]))
    away = draw(st.lists(st.sampled_from([k << 29 for k in range(1, 8)]), max_size=5))
    near = draw(st.sampled_from([1, 0, -1, 2**24, 2**24 + 1, -(2**24), -(2**24) - 1]))
    return [draw(st.integers(0, 9))] * run + away + [near - sum(away)]


@settings(max_examples=400 if LONG else 150)
@given(
    st.integers(0, 2**32 - 1),
    st.lists(steps_of_a_counter(), max_size=6),
    st.lists(st.integers(0, 2000), max_size=4),
)
def test_clock(start: int, runs: list[list[int]], cuts: list[int]) -> None:
    raws = [start]
    for step in (step for run in runs for step in run):
        raws.append((raws[-1] + step) % 2**32)
    stream = b"".join(b"\xaa" + raw.to_bytes(4, "little") + bytes(5) + b"\xbb" for raw in raws)
    want = reference.decode(stream, "serial", 1)
    decoder = canser.Decoder("serial", ts_unit="ns")
    borders = [0, *sorted(cut for cut in cuts if cut < len(stream)), len(stream)]
    times = [ts for a, b in pairwise(borders) for ts in decoder.feed(stream[a:b])["ts"].tolist()]
    assert times == [frame.ts for frame in want.frames]
    assert decoder.stats.ts_wraps == want.stats.ts_wraps
    assert decoder.stats.ts_backsteps == want.stats.ts_backsteps
    assert decoder.stats.ts_uncertain == want.stats.ts_uncertain
