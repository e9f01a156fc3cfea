"""Decoder, decode and encode: buffers, room, errors, threads. The wire is tested elsewhere."""

import array
import copy
import ctypes
import gc
import json
import mmap
import os
import pickle
import platform
import subprocess
import sys
import threading
import tracemalloc
from collections.abc import Callable, Mapping
from dataclasses import FrozenInstanceError, asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import canser
from canser import adapters
from canser._frames import FRAME_DTYPE, NO_TIME, FrameArray
from canser._protocols import TS_UNITS
from canser.codec import decoder as codec
from canser.simulation.simulator import Simulator
from canser.simulation.traffic import line_noise, vehicle

PROTOCOLS = canser.protocols()
SOME = vehicle(0.2, extended=False)
PLACES = np.arange(1000)
RAW = {protocol: canser.encode(SOME, protocol) for protocol in PROTOCOLS}
BYTES = np.frombuffer(RAW["serial"], np.uint8).copy()


def same(got: FrameArray, protocol: str, want: FrameArray = SOME) -> bool:
    """Whether decoded frames are those that were encoded, as far as the wire carries them."""
    want = want.copy()
    if protocol != "serial":
        want["ts"] = NO_TIME
    want["data"][want["rtr"]] = 0
    return np.array_equal(got, want)


def test_protocols_are_the_table_of_c() -> None:
    assert list(canser.protocols()) == sorted(canser.protocols())
    assert {"cantalope", "seeed", "serial"} <= set(canser.protocols())


@pytest.mark.parametrize(
    ("spelling", "name"),
    [
        *[("python-can", "serial"), ("seeedstudio", "seeed"), ("waveshare", "seeed")],
        *[("SERIAL", "serial"), ("Seeed", "seeed"), ("Cantalope", "cantalope")],
        ("Waveshare", "seeed"),
    ],
)
def test_other_spellings_are_accepted(spelling: str, name: str) -> None:
    assert canser.Decoder(spelling).protocol == name
    assert np.array_equal(canser.decode(RAW[name], spelling), canser.decode(RAW[name], name))


def test_unknown_names_say_what_there_is() -> None:
    with pytest.raises(ValueError, match=f"'Foo'; have: {', '.join(canser.protocols())}$"):
        canser.decode(b"", "Foo")
    # A letter that is only much like an s.
    with pytest.raises(ValueError, match="unknown protocol"):
        canser.decode(b"", "\u017ferial")
    with pytest.raises(TypeError, match="protocol must be a name"):
        canser.Decoder(3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="unknown ts_unit 'min'; have: s, ms, us, ns"):
        canser.Decoder("serial", ts_unit="min")
    with pytest.raises(ValueError, match="unknown ts_unit"):
        canser.encode(SOME, "serial", ts_unit=["ms"])  # type: ignore[call-overload]


# Every kind of buffer, read where it lies.


def mapped(raw: bytes, tmp_path: Path) -> mmap.mmap:
    path = tmp_path / "raw.bin"
    path.write_bytes(raw)
    with path.open("rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


BUFFERS: dict[str, Callable[[bytes, Path], Any]] = {
    "bytes": lambda raw, _: raw,
    "bytearray": lambda raw, _: bytearray(raw),
    "memoryview": lambda raw, _: memoryview(raw),
    "read-only array": lambda raw, _: np.frombuffer(raw, np.uint8),
    "int8 array": lambda raw, _: np.frombuffer(raw, np.int8).copy(),
    "two dimensions": lambda raw, _: np.frombuffer(raw, np.uint8)[None, :],
    "mmap": mapped,
    "array.array": lambda raw, _: array.array("B", raw),
    "ctypes": lambda raw, _: (ctypes.c_ubyte * len(raw)).from_buffer_copy(raw),
    "odd address": lambda raw, _: memoryview(b"x" + raw)[1:],
}


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("kind", BUFFERS)
def test_any_contiguous_buffer_of_bytes_is_read(kind: str, protocol: str, tmp_path: Path) -> None:
    data = BUFFERS[kind](RAW[protocol], tmp_path)
    assert same(canser.decode(data, protocol), protocol)


@pytest.mark.parametrize(
    ("data", "error", "message"),
    [
        ("AA55", TypeError, "data must be bytes .* not str; encode it first"),
        (None, TypeError, "data must be bytes .* not NoneType"),
        ([1, 2], TypeError, "not list"),
        (np.zeros(4, np.uint16), TypeError, "single bytes, not an array of uint16"),
        (np.zeros(4, FRAME_DTYPE), TypeError, "single bytes"),
        (np.zeros(4, object), TypeError, "single bytes"),
        (np.zeros(4, "M8[ns]"), TypeError, "not an array of datetime64"),
        (array.array("I", [1]), TypeError, r"view\('u1'\)"),
        (np.zeros(8, np.uint8)[::2], BufferError, "not contiguous.*ascontiguousarray"),
        (memoryview(b"abcdef")[::-1], BufferError, "not contiguous"),
    ],
)
def test_what_is_no_buffer_of_bytes_is_an_error(
    data: Any, error: type[Exception], message: str
) -> None:
    decoder = canser.Decoder("serial")
    for call in (decoder.feed, lambda x: decoder.feed_into(x, np.empty(1, FRAME_DTYPE))):
        with pytest.raises(error, match=message):
            call(data)
    with pytest.raises(error, match=message):
        canser.identify(data)
    assert decoder.stats.bytes_in == 0


def read_only(frames: FrameArray) -> FrameArray:
    frames.flags.writeable = False
    return frames


@pytest.mark.parametrize(
    ("out", "error", "message"),
    [
        (np.empty(4), TypeError, "out must be an array as .* makes, not an array of float64"),
        (np.empty(4, object), TypeError, "not an array of object"),
        (bytearray(96), TypeError, "not bytearray"),
        (None, TypeError, "not NoneType"),
        (np.empty(4, FRAME_DTYPE.newbyteorder()), TypeError, "out must be"),
        (np.empty((2, 2), FRAME_DTYPE), ValueError, "out has 2 dimensions; it must have one"),
        (np.empty(8, FRAME_DTYPE)[::2], ValueError, "out is not contiguous"),
        (np.empty(0, FRAME_DTYPE), ValueError, "room for 0 frames"),
        (read_only(np.empty(4, FRAME_DTYPE)), BufferError, "out is read-only"),
        (np.empty(200, np.uint8)[1:193].view(FRAME_DTYPE), ValueError, "multiple of 8 bytes"),
    ],
)
def test_an_out_that_cannot_be_filled_is_an_error(
    out: Any, error: type[Exception], message: str
) -> None:
    decoder = canser.Decoder("seeed")
    decoder.feed(b"\xaa")
    with pytest.raises(error, match=message):
        decoder.feed_into(RAW["seeed"], out)
    with pytest.raises(error, match=message):
        decoder.flush_into(out)
    assert decoder.stats.bytes_in == decoder.pending == 1


@pytest.mark.parametrize(
    ("offsets", "error", "message"),
    [
        (np.empty(4, np.int32), TypeError, "offsets must be an array"),
        (np.empty(4, float), TypeError, "offsets must be an array"),
        (np.empty(3, np.int64), ValueError, "offsets has room for 3, out for 4 frames"),
        (np.empty(8, np.int64)[::2], ValueError, "offsets is not contiguous"),
        (np.empty(5, np.int64).view(np.uint8)[4:36].view(np.int64), ValueError, "multiple of 8"),
    ],
)
def test_offsets_that_cannot_be_filled_are_an_error(
    offsets: Any, error: type[Exception], message: str
) -> None:
    decoder = canser.Decoder("seeed")
    with pytest.raises(error, match=message):
        decoder.feed_into(RAW["seeed"], np.empty(4, FRAME_DTYPE), offsets)
    assert decoder.stats.bytes_in == 0


def masked(array: Any) -> Any:
    return np.ma.masked_array(array)


@pytest.mark.parametrize(
    ("name", "call"),
    {
        "data of decode": lambda: canser.decode(masked(BYTES), "serial"),
        "data of feed": lambda: canser.Decoder("serial").feed(masked(BYTES)),
        "data of feed_into": lambda: canser.Decoder("serial").feed_into(
            masked(BYTES), np.empty(9, FRAME_DTYPE)
        ),
        "data of identify": lambda: canser.identify(masked(BYTES)),
        "data of report": lambda: adapters.report("seeed", masked(BYTES)),
        "data of line_noise": lambda: line_noise(masked(BYTES)),
        "out of decode": lambda: canser.decode(b"", "serial", out=masked(SOME)),
        "out of feed_into": lambda: canser.Decoder("serial").feed_into(b"", masked(SOME)),
        "out of flush_into": lambda: canser.Decoder("serial").flush_into(masked(SOME)),
        "out of blocks": lambda: canser.blocks(os.devnull, "serial", out=masked(SOME)),
        "out of encode": lambda: canser.encode(SOME, "serial", out=masked(BYTES)),
        "offsets of decode": lambda: canser.decode(b"", "serial", offsets=masked(PLACES)),
        "offsets of read": lambda: canser.read(os.devnull, "serial", offsets=masked(PLACES)),
        "offsets of feed_into": lambda: canser.Decoder("serial").feed_into(
            b"", np.empty(9, FRAME_DTYPE), masked(PLACES)
        ),
        "frames of encode": lambda: canser.encode(masked(SOME), "serial"),
        "frames of match": lambda: canser.match(masked(SOME), "123:7FF"),
        "frames of encode_blocks": lambda: codec.Encoder("serial").encode(masked(SOME)),
        "traffic of Simulator": lambda: Simulator("serial", masked(SOME)),
    }.items(),
)
def test_a_mask_is_never_lost_in_silence(name: str, call: Callable[[], Any]) -> None:
    name = name.partition(" ")[0]
    text = f"^{name} is a masked array, and its mask would be lost; pass {name}.data, or the part"
    with pytest.raises(TypeError, match=text):
        call()


def test_memory_that_overlaps_is_an_error() -> None:
    out = np.zeros(100, FRAME_DTYPE)
    decoder = canser.Decoder("seeed")
    with pytest.raises(ValueError, match="share memory"):
        decoder.feed_into(out[90:].view(np.uint8), out)
    with pytest.raises(ValueError, match="share memory"):
        decoder.feed_into(RAW["seeed"], out[:4], out.view(np.int64)[:4])
    with pytest.raises(ValueError, match="share memory"):
        canser.encode(out, "seeed", out=out.view(np.uint8))
    decoder.feed_into(out[90:].view(np.uint8), out[:90])  # beside each other is fine


# Room: feed_into stops when it is full, decode says how much is needed.


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_feed_into_stops_when_out_is_full_and_goes_on(protocol: str) -> None:
    decoder = canser.Decoder(protocol)
    out = np.empty(7, FRAME_DTYPE)
    offsets = np.empty(7, np.uint64)
    raw, found, at = RAW[protocol], [], []
    while raw:
        used, count = decoder.feed_into(raw, out, offsets)
        assert used == len(raw) or count == 7
        found.append(out[:count].copy())
        at.extend(offsets[:count].tolist())
        raw = raw[used:]
    assert same(np.concatenate(found), protocol)
    whole = np.empty(len(SOME), np.int64)
    canser.decode(RAW[protocol], protocol, offsets=whole)
    assert at == whole.tolist()


def test_rows_past_the_count_stay_as_they_were() -> None:
    out = np.zeros(len(SOME) + 3, FRAME_DTYPE)
    out["id"] = 77
    _, count = canser.Decoder("seeed").feed_into(RAW["seeed"], out)
    assert count == len(SOME)
    assert out["id"][count:].tolist() == [77] * 3
    assert not out["data"][count:].any()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_decode_fills_out(protocol: str) -> None:
    out = np.empty(len(SOME) + 1, FRAME_DTYPE)
    frames = canser.decode(RAW[protocol], protocol, out=out)
    assert np.shares_memory(frames, out)
    assert same(frames, protocol)
    exact = canser.decode(RAW[protocol], protocol, out=out[: len(SOME)])
    assert len(exact) == len(SOME)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_decode_says_how_much_room_is_needed(protocol: str) -> None:
    want = f"room for 5 frames, but the data holds {len(SOME)}; make room for at least"
    with pytest.raises(ValueError, match=f"out has {want}"):
        canser.decode(RAW[protocol], protocol, out=np.empty(5, FRAME_DTYPE))
    with pytest.raises(ValueError, match=f"offsets has {want}"):
        canser.decode(RAW[protocol], protocol, offsets=np.empty(5, np.int64))


@pytest.mark.parametrize("threads", [1, 2])
def test_offsets_without_out_are_what_errors_name(threads: int) -> None:
    none = np.empty(0, np.int64)
    empty = canser.decode(b"", "serial", offsets=none, threads=threads)
    assert (empty.shape, empty.dtype) == ((0,), FRAME_DTYPE)
    with pytest.raises(ValueError, match=r"^offsets has room for 0 frames, but the data holds"):
        canser.decode(RAW["serial"], "serial", offsets=none, threads=threads)
    for wrong in (3, [1, 2], np.empty(4, np.int32)):
        with pytest.raises(TypeError, match=r"^offsets must be an array"):
            canser.decode(b"", "serial", offsets=wrong, threads=threads)  # type: ignore[arg-type]


def test_with_offsets_alone_the_frames_are_a_new_array_of_just_the_size() -> None:
    frames = canser.decode(RAW["seeed"], "seeed", offsets=np.empty(5 * len(SOME), np.int64))
    assert same(frames, "seeed")
    assert frames.base is None
    assert frames.flags.owndata


def test_room_is_enough_where_only_noise_follows() -> None:
    out = np.empty(len(SOME), FRAME_DTYPE)
    assert len(canser.decode(RAW["seeed"] + b"noise\xaa", "seeed", out=out)) == len(SOME)


def test_frames_that_the_end_of_the_stream_lets_out_need_room_too() -> None:
    # A cut fixed packet; only at the end is it clear that a frame lies inside.
    inner = bytes.fromhex("AA C1 23 01 77 55")
    raw = inner + b"\xaa\x55\x01" + inner
    assert canser.decode(raw, "seeed")["id"].tolist() == [0x123, 0x123]
    assert len(canser.decode(raw, "seeed", out=np.empty(2, FRAME_DTYPE))) == 2
    with pytest.raises(ValueError, match="room for 1 frames, but the data holds 2"):
        canser.decode(raw, "seeed", out=np.empty(1, FRAME_DTYPE))


def test_arrays_that_are_returned_own_their_memory() -> None:
    decoder = canser.Decoder("seeed")
    first = decoder.feed(RAW["seeed"])
    kept = first.copy()
    decoder.feed(bytes(1000) + RAW["seeed"])
    assert np.array_equal(first, kept)
    assert first.base is None
    assert first.flags.owndata
    large = canser.decode(RAW["seeed"] * 300, "seeed")
    assert large.base is None
    assert len(large) == 300 * len(SOME)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_new_array_holds_no_more_than_its_frames(protocol: str) -> None:
    # Room for the most that the bytes can hold would be up to six times as much.
    for times in (1, 20, 1000):
        tracemalloc.start()
        try:
            frames = canser.decode(RAW[protocol] * times, protocol)
            held, _ = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert frames.base is None
        assert frames.flags.owndata
        assert held < frames.nbytes + len(RAW[protocol]) * times + 100_000


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="it is the C library that keeps them")
@pytest.mark.parametrize("count", [8_000, 90_000, 400_000])
def test_decode_in_a_loop_allocates_no_new_pages(count: int) -> None:
    # A page that is new takes longer than the decoding of the frames in it.
    code = f"""if True:
        import resource
        import canser, numpy as np
        frames = np.zeros({count}, canser.FRAME_DTYPE)
        frames["dlc"] = 8
        raw = canser.encode(frames, "cantalope")
        for round in range(30):
            if round == 10:
                begin = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
            frames = canser.decode(raw, "cantalope")
        print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - begin)
    """
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(run.stdout) < 20


def test_dense_data_behind_sparse_data_is_whole() -> None:
    # The room is estimated from the beginning, here noise: it must grow, several times.
    raw = bytes(2 << 20) + RAW["seeed"] * 500
    frames = canser.decode(raw, "seeed")
    assert same(frames, "seeed", np.tile(SOME, 500))
    short = bytes.fromhex("AA C0 23 01 55") * 400_000
    frames = canser.decode(RAW["seeed"] * 300 + short, "seeed")
    assert len(frames) == 300 * len(SOME) + 400_000


def test_nothing_gives_nothing() -> None:
    for protocol in PROTOCOLS:
        frames = canser.decode(b"", protocol)
        assert frames.dtype == FRAME_DTYPE
        assert frames.shape == (0,)
        assert canser.encode(frames, protocol) == b""


# State.


def test_stats_are_a_frozen_snapshot() -> None:
    decoder = canser.Decoder("serial")
    before = decoder.stats
    decoder.feed(RAW["serial"] + b"\x01\x02\xaa")
    after = decoder.stats
    assert before.frames == before.bytes_in == 0
    assert after.frames == len(SOME)
    assert after.pending == decoder.pending == 1
    assert after.bytes_skipped == after.rejects["marker"] == 2
    assert after.bytes_in == after.bytes_framed + after.bytes_skipped + after.pending
    assert list(after.rejects) == [
        "marker", "type", "dlc", "id", "end", "sum", "field", "command", "cut",
    ]  # fmt: skip
    with pytest.raises(FrozenInstanceError):
        after.frames = 3  # type: ignore[misc]


def test_stats_can_be_compared_and_kept() -> None:
    decoder = canser.Decoder("serial")
    decoder.feed(RAW["serial"])
    stats = decoder.stats
    assert stats == decoder.stats
    assert pickle.loads(pickle.dumps(stats)) == stats
    assert asdict(stats)["rejects"] == stats.rejects
    decoder.feed(b"x")
    assert stats != decoder.stats


def test_rejects_cannot_be_changed_by_those_who_get_them() -> None:
    given = {"cut": 1}
    decoder = canser.Decoder("serial")
    decoder.feed(b"\x01\x02" + RAW["serial"])
    stats = decoder.stats
    before = dict(stats.rejects)
    rejects: Any = stats.rejects
    changes: list[Callable[[], Any]] = [
        lambda: rejects.__setitem__("cut", 7),
        lambda: rejects.__delitem__("cut"),
        lambda: rejects.update(cut=7),
        lambda: rejects.setdefault("new", 7),
        lambda: rejects.pop("cut"),
        lambda: rejects.pop("none", None),
        rejects.popitem,
        rejects.clear,
        lambda: rejects.__ior__({"cut": 7}),
    ]
    for change in changes:
        with pytest.raises(TypeError, match=r"cannot be changed; dict\(\.\.\.\) makes a copy"):
            change()
    assert stats.rejects == before == decoder.stats.rejects
    assert isinstance(stats.rejects, Mapping)
    # Nor through the dict that they were made of.
    own = replace(stats, rejects=given)
    given["cut"] = 2
    assert own.rejects == {"cut": 1}


@pytest.mark.parametrize(
    "again",
    [
        copy.copy,
        copy.deepcopy,
        *(lambda x, n=n: pickle.loads(pickle.dumps(x, n)) for n in range(6)),
        lambda stats: canser.Stats(**asdict(stats)),
    ],
)
def test_stats_can_be_copied_and_stay_frozen(again: Callable[[canser.Stats], canser.Stats]) -> None:
    decoder = canser.Decoder("serial")
    decoder.feed(b"\x01\x02" + RAW["serial"])
    stats = again(decoder.stats)
    assert stats == decoder.stats
    assert repr(stats) == repr(decoder.stats)
    assert json.loads(json.dumps(asdict(stats)))["rejects"] == stats.rejects
    with pytest.raises(TypeError):
        stats.rejects["cut"] = 7  # type: ignore[index]


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_decoder_cannot_be_copied(again: Callable[[Any], Any]) -> None:
    class Mine(canser.Decoder):
        pass

    for make in (canser.Decoder, Mine):
        decoder = make("serial")
        text = f"a {make.__name__} cannot be copied or pickled: the copy would share its state"
        with pytest.raises(TypeError, match=text):
            again(decoder)
        assert same(decoder.feed(RAW["serial"]), "serial")


def test_reset_forgets_everything() -> None:
    decoder = canser.Decoder("seeed")
    fresh = decoder.stats
    decoder.feed(bytes.fromhex("AA 55 04") + bytes(16) + b"\x04" + b"noise" + b"\xaa")
    assert decoder.stats.controls == 1
    decoder.reset()
    assert decoder.stats == fresh
    assert decoder.pending == 0
    assert decoder.take_controls() == []


def test_feeding_goes_on_after_the_end_as_after_a_gap() -> None:
    decoder = canser.Decoder("serial")
    half = len(RAW["serial"]) // 2 + 3
    frames = [decoder.feed(RAW["serial"][:half]), decoder.flush()]
    offsets = np.empty(len(SOME), np.int64)
    used, count = decoder.feed_into(RAW["serial"], np.empty(len(SOME), FRAME_DTYPE), offsets)
    assert (used, count) == (len(RAW["serial"]), len(SOME))
    assert offsets[0] == half
    assert decoder.stats.frames == count + sum(map(len, frames))


def test_control_packets_are_taken_once() -> None:
    ping, error = b"\xff\xff\x00", b"\xff\xff\x01\x07"
    decoder = canser.Decoder("cantalope")
    decoder.feed(b"\x24\x60" + ping)
    decoder.feed(error[:1])
    decoder.feed(error[1:])
    assert decoder.take_controls() == [canser.Control(2, ping), canser.Control(5, error)]
    assert decoder.take_controls() == []
    assert decoder.stats.controls == 2
    assert decoder.controls_dropped == 0


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview, lambda x: np.frombuffer(x, "u1")])
def test_control_packets_that_fill_their_room_more_than_once(kind: Callable[[bytes], Any]) -> None:
    raw = b"\xff\xff\x00" * 1500 + b"\x24\x60" + b"\xff\xff\x00" * 1500 + b"\x24\x80"
    decoder = canser.Decoder("cantalope")
    out, offsets = np.empty(4, FRAME_DTYPE), np.empty(4, np.int64)
    for begin in (0, len(raw)):
        assert decoder.feed_into(kind(raw), out, offsets) == (len(raw), 2)
        assert out["id"][:2].tolist() == [0x123, 0x124]
        assert (offsets[:2] - begin).tolist() == [4500, len(raw) - 2]
        assert len(decoder.take_controls()) == 3000


def test_arrays_that_change_between_calls_are_seen() -> None:
    decoder = canser.Decoder("seeed")
    raw = RAW["seeed"]
    out, offsets = np.empty(len(SOME), FRAME_DTYPE), np.empty(len(SOME), np.int64)
    for _ in range(2):
        assert decoder.feed_into(raw, out, offsets) == (len(raw), len(SOME))
    out.flags.writeable = False
    with pytest.raises(BufferError, match="out is read-only"):
        decoder.feed_into(raw, out, offsets)
    out.flags.writeable = True
    offsets.flags.writeable = False
    with pytest.raises(BufferError, match="offsets is read-only"):
        decoder.feed_into(raw, out, offsets)
    assert decoder.feed_into(raw, out) == (len(raw), len(SOME))
    short = np.empty(3, np.int64)
    with pytest.raises(ValueError, match="offsets has room for 3"):
        decoder.feed_into(raw, out, short)


def test_another_array_at_the_place_of_the_last_is_checked() -> None:
    decoder = canser.Decoder("seeed")
    for rows in (5, 9, 2):
        out = np.empty(rows, FRAME_DTYPE)
        assert decoder.feed_into(RAW["seeed"], out)[1] == rows
        assert same(out, "seeed", SOME[:rows])
        del out
        with pytest.raises(TypeError, match="not NoneType"):
            decoder.feed_into(b"", None)  # type: ignore[arg-type]
    out, offsets = np.empty(9, FRAME_DTYPE), np.full(9, 7, np.int64)
    at = offsets.ctypes.data
    decoder.feed_into(RAW["seeed"], out, offsets)
    watched = (ctypes.c_int64 * 9).from_address(at)
    del offsets
    again = np.full(9, 7, np.int64)  # mostly the same memory
    decoder.feed_into(RAW["seeed"], out)
    assert again.tolist() == [7] * 9 or again.ctypes.data != at
    assert len(watched) == 9


def test_control_packets_that_nobody_takes_are_bounded_and_counted() -> None:
    count = codec._CONTROLS_KEPT * 2 + 500
    decoder = canser.Decoder("cantalope")
    out = np.empty(1, FRAME_DTYPE)
    assert decoder.feed_into(b"\xff\xff\x00" * count, out) == (3 * count, 0)
    kept = decoder.take_controls()
    assert decoder.stats.controls == count == len(kept) + decoder.controls_dropped
    assert len(kept) >= codec._CONTROLS_KEPT
    assert kept[-1] == canser.Control(3 * (count - 1), b"\xff\xff\x00")


def test_decode_keeps_no_control_packets() -> None:
    # No caller could take them.
    raw = b"\xff\xff\x00" * 100_000
    tracemalloc.start()
    try:
        canser.decode(raw, "cantalope", out=np.empty(1, FRAME_DTYPE))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 100_000


@pytest.mark.parametrize(("unit", "tick"), TS_UNITS.items())
def test_units_of_time(unit: str, tick: int) -> None:
    frames = np.zeros(3, FRAME_DTYPE)
    frames["ts"] = np.array([0, 1, 5]) * tick
    raw = canser.encode(frames, "serial", ts_unit=unit)
    assert canser.decode(raw, "serial", ts_unit=unit)["ts"].tolist() == frames["ts"].tolist()
    assert raw[1::11][:3] == b"\x00\x01\x05"


def test_a_flipped_top_bit_of_the_clock_spoils_its_own_time_only() -> None:
    # Half a turn away and half a turn back: both are steps back by the sign alone.
    frames = np.zeros(40, FRAME_DTYPE)
    frames["ts"] = np.arange(40) * 10
    raw = bytearray(canser.encode(frames, "serial", ts_unit="ns"))
    raw[11 * 20 + 4] ^= 0x80
    expected = frames["ts"].copy()
    expected[20] -= 2**31
    decoder = canser.Decoder("serial", ts_unit="ns")
    assert decoder.feed(raw)["ts"].tolist() == expected.tolist()
    assert (decoder.stats.ts_backsteps, decoder.stats.ts_wraps) == (1, 1)


# Encoding.


@pytest.mark.parametrize(
    ("protocol", "change", "message"),
    [
        ("serial", {"dlc": 9}, "dlc is over 8"),
        ("serial", {"id": 0x800}, "over 0x7FF and ext is not set; set ext"),
        ("serial", {"id": 0x20000000, "ext": True}, "over 0x1FFFFFFF"),
        ("serial", {"id": 0xFFFFFFFF}, "over 0x7FF"),
        ("serial", {"ts": NO_TIME}, "ts is not known .NaT.; set ts"),
        ("seeed", {"err": True}, "no error frames; leave them out"),
        ("seeed", {"id": 0x800}, "over 0x7FF"),
        ("cantalope", {"ext": True}, "no extended frames; leave them out"),
        ("cantalope", {"err": True}, "no error frames"),
        ("cantalope", {"dlc": 255}, "dlc is over 8"),
    ],
)
@pytest.mark.parametrize("index", [0, 1, 40, 99])
def test_a_frame_that_cannot_be_carried_is_named(
    protocol: str, change: dict[str, Any], message: str, index: int
) -> None:
    frames = np.zeros(100, FRAME_DTYPE)
    for name, value in change.items():
        frames[name][index] = value
    with pytest.raises(ValueError, match=f"{protocol} cannot carry frame {index} .*{message}"):
        canser.encode(frames, protocol)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_encode_into_room_of_just_the_size(protocol: str) -> None:
    raw = RAW[protocol]
    room = np.full(len(raw) + 1, 77, np.uint8)
    got = canser.encode(SOME, protocol, out=room[:-1])
    assert np.shares_memory(got, room)
    assert got.tobytes() == raw
    assert room[-1] == 77
    with pytest.raises(ValueError, match=f"enough for {len(SOME) - 1} of {len(SOME)} frames"):
        canser.encode(SOME, protocol, out=room[:-2])


@pytest.mark.parametrize(
    ("frames", "error", "message"),
    [
        (SOME[0], TypeError, "frames must be an array"),
        (SOME["id"], TypeError, "not an array of uint32"),
        (SOME[::2], ValueError, "frames is not contiguous; pass np.ascontiguousarray"),
        (SOME[:4].reshape(2, 2), ValueError, "frames has 2 dimensions"),
        (None, TypeError, "not NoneType"),
    ],
)
def test_what_is_no_array_of_frames_is_not_encoded(
    frames: Any, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        canser.encode(frames, "serial")


def test_an_encoder_counts_frames_over_all_blocks() -> None:
    bad = SOME[:3].copy()
    bad["dlc"][1] = 9
    encoder = codec.Encoder("seeed")
    raw = encoder.encode(SOME[:10]).tobytes() + encoder.encode(SOME[10:30]).tobytes()
    assert raw == canser.encode(SOME[:30], "seeed")
    with pytest.raises(ValueError, match="frame 31"):
        encoder.encode(bad)


# Threads and memory.


@pytest.mark.parametrize("threads", [0, -1, 2.5, "2"])
def test_a_number_of_threads_is_a_positive_integer(threads: Any) -> None:
    with pytest.raises((TypeError, ValueError), match=r"threads|integer"):
        canser.decode(b"", "serial", threads=threads)


def test_two_threads_on_one_decoder_lose_nothing() -> None:
    decoder = canser.Decoder("cantalope")
    packet = canser.encode(SOME[:1], "cantalope")
    errors: list[BaseException] = []
    counts: list[int] = []

    def work() -> None:
        try:
            out = np.empty(64, FRAME_DTYPE)
            found = 0
            for _ in range(300):
                found += decoder.feed_into(packet * 40, out)[1]
                decoder.stats  # noqa: B018 - read while the other thread feeds
            counts.append(found)
        except BaseException as error:  # noqa: BLE001
            errors.append(error)

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        threads = [threading.Thread(target=work) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(before)
    assert not errors
    assert sum(counts) == decoder.stats.frames == 4 * 300 * 40


def test_a_thread_waits_for_another_one_and_a_handler_in_its_own_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    decoder = canser.Decoder("serial")
    packet = canser.encode(SOME[:1], "serial")
    working, done = threading.Event(), threading.Event()
    real = decoder._stream.flush
    refused: list[str] = []
    found: list[int] = []

    def flush() -> int:
        # What a signal handler does that interrupts this thread here.
        for call in (
            lambda: decoder.feed(packet),
            lambda: decoder.feed_into(packet, np.empty(9, FRAME_DTYPE)),
            lambda: decoder.stats,
            decoder.reset,
            decoder.take_controls,
            decoder.flush,
        ):
            with pytest.raises(RuntimeError, match="use a Decoder of its own in the handler"):
                call()
            refused.append("")
        working.set()
        assert done.wait(30)
        return real()

    monkeypatch.setattr(decoder._stream, "flush", flush)
    decoder.feed(packet[:-1])
    held = threading.Thread(target=decoder.flush)
    held.start()
    assert working.wait(30)
    others = [
        threading.Thread(target=lambda: found.append(len(decoder.feed(packet)))),
        threading.Thread(target=lambda: found.append(decoder.feed(packet * 9).size)),
        threading.Thread(target=lambda: found.append(decoder.stats.frames * 0)),
    ]
    for other in others:
        other.start()
    others[0].join(0.05)
    assert not found  # they wait
    done.set()
    for thread in [held, *others]:
        thread.join(30)
    assert len(refused) == 6
    assert sorted(found) == [0, 1, 9]
    assert decoder.stats.frames == 10
    assert decoder.stats.bytes_skipped == len(packet) - 1


def test_an_exception_leaves_a_decoder_that_works(monkeypatch: pytest.MonkeyPatch) -> None:
    decoder = canser.Decoder("serial")
    packet = canser.encode(SOME[:1], "serial")

    def interrupt() -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(decoder._stream, "counters", interrupt)
        for _ in range(2):
            with pytest.raises(KeyboardInterrupt):
                decoder.stats  # noqa: B018
    assert len(decoder.feed(packet)) == decoder.stats.frames == 1


def test_the_gil_is_free_while_c_works() -> None:
    # While one thread decodes, another one's Python runs: it sees the work unfinished.
    raw = np.frombuffer(line_noise(RAW["serial"] * 2000), np.uint8)
    out = np.empty(len(raw) // 11 + 1, FRAME_DTYPE)
    decoder = canser.Decoder("serial")
    started, done = threading.Event(), threading.Event()
    turns = 0

    def work() -> None:
        started.set()
        for _ in range(20):
            decoder.feed_into(raw, out)
        done.set()

    before = sys.getswitchinterval()
    sys.setswitchinterval(10)  # nobody takes the GIL from a thread that holds it
    try:
        thread = threading.Thread(target=work)
        thread.start()
        started.wait()
        while not done.is_set():
            turns += 1
            done.wait(0.0001)
        thread.join()
    finally:
        sys.setswitchinterval(before)
    assert turns > 3


def test_feed_into_allocates_nothing() -> None:
    decoder = canser.Decoder("serial")
    out = np.empty(len(SOME) + 1, FRAME_DTYPE)
    raw = RAW["serial"]
    for _ in range(3):
        decoder.feed_into(raw, out)
    tracemalloc.start()
    try:
        for _ in range(100):
            decoder.feed_into(raw, out)
        kept, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # A few small objects of the call itself, and no more than of one call.
    assert peak < 4096
    assert kept < 2048


def test_input_is_not_held_after_the_call() -> None:
    decoder = canser.Decoder("serial")
    data = bytearray(RAW["serial"] + b"\xaa")
    decoder.feed(data)
    data.clear()  # a bytearray that is held by somebody cannot be resized
    assert decoder.pending == 1


def test_repr_can_be_typed() -> None:
    assert repr(canser.Decoder("waveshare", ts_unit="us")) == "Decoder('seeed', ts_unit='us')"


def test_an_error_that_is_kept_is_collected() -> None:
    # A cycle of an exception and its frames, one of which points to the caller's bytes:
    # Python before 3.12.7 crashes where such a pointer holds a memoryview.
    def keep(data: bytes) -> Exception:
        try:
            canser.decode(data, "serial", out=np.empty(1, FRAME_DTYPE))
        except ValueError as error:
            kept = error
        return kept

    gc.freeze()  # the collector need not look at all objects of the other tests
    try:
        for _ in range(100):
            keep(b"\xaa" + bytes(9) + b"\xbb\xaa" + bytes(9) + b"\xbb")
            gc.collect()
    finally:
        gc.unfreeze()
