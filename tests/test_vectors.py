"""Every vector, decoded in every way of cutting it in two, by canser and by the reference."""

import numpy as np
import pytest

import canser
import reference
import vectors
from conftest import Run, assert_agree
from vectors import Vector

VECTORS = vectors.load_all()

every_vector = pytest.mark.parametrize("vector", VECTORS, ids=str)


def check(vector: Vector, *pieces: bytes) -> None:
    run = Run(vector.protocol, vector.unit)
    for piece in pieces:
        run.feed(piece)
    assert run.decoder.pending == vector.pending
    run.flush()
    assert_agree(run, vector.expected())


@every_vector
def test_reference(vector: Vector) -> None:
    tick_ns = reference.TICK_NS[vector.unit]
    held = reference.decode(vector.stream, vector.protocol, tick_ns, flush=False)
    held.stats.check()
    assert held.stats.pending == vector.pending
    assert reference.decode(vector.stream, vector.protocol, tick_ns) == vector.expected()


@every_vector
def test_whole(vector: Vector) -> None:
    check(vector, vector.stream)


@every_vector
def test_byte_by_byte(vector: Vector) -> None:
    check(vector, *(bytes([byte]) for byte in vector.stream))


@every_vector
def test_every_split(vector: Vector) -> None:
    for cut in range(len(vector.stream) + 1):
        check(vector, vector.stream[:cut], vector.stream[cut:])


@every_vector
def test_one_shot(vector: Vector) -> None:
    expected = vector.expected()
    offsets = np.zeros(len(vector.stream), np.int64)
    frames = canser.decode(vector.stream, vector.protocol, ts_unit=vector.unit, offsets=offsets)
    assert frames.tobytes() == reference.pack(expected.frames)
    assert offsets[: len(frames)].tolist() == expected.offsets


@pytest.mark.parametrize("vector", [vector for vector in VECTORS if vector.canonical], ids=str)
def test_canonical(vector: Vector) -> None:
    frames = np.frombuffer(reference.pack(vector.frames), canser.FRAME_DTYPE)
    assert canser.encode(frames, vector.protocol, ts_unit=vector.unit) == vector.stream
    tick_ns = reference.TICK_NS[vector.unit]
    assert reference.encode(vector.frames, vector.protocol, tick_ns) == vector.stream


def test_every_protocol_has_vectors() -> None:
    assert {vector.protocol for vector in VECTORS} == set(canser.protocols())


@pytest.mark.parametrize("protocol", canser.protocols())
def test_every_reason_has_a_vector(protocol: str) -> None:
    seen = {reason for vector in vectors.load(protocol) for reason in vector.skipped}
    assert seen == reference.WIRE_FORMATS[protocol].reasons


GOOD = """
vector: name
from: design: wire formats
quote: words
bytes: 00
"""


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("bytes: 0G", "line 6: non-hexadecimal"),
        ("colour: red", "line 6: unknown key 'colour'"),
        ("from: hearsay", "line 6: unknown document 'hearsay'"),
        ("frame: 0 id=1 dlc=2 data=11", "line 6: the payload is not as long"),
        ("frame: 0 id=1 dlc=0 remote", "line 6: unknown .'remote'"),
        ("skipped: bad=1", "line 6: reason 'bad' is unknown"),
        ("unit: h", "line 6: unknown unit 'h'"),
        ("canonical: no", "line 6: canonical is yes"),
        ("vector: name", "line 6: two vectors are named 'name'"),
        ("vector: other", "'other' needs a quote and bytes"),
    ],
)
def test_mistakes_in_a_file_are_told(line: str, problem: str) -> None:
    assert len(vectors.parse(GOOD, "serial")) == 1
    with pytest.raises(ValueError, match=problem):
        vectors.parse(GOOD + line, "serial")
