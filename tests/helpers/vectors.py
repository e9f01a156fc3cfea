"""The parser of the vector files, `vectors/<protocol>.txt`.

A vector is a block of lines `key: value`; blank lines stand between vectors, a line that starts
with `#` is a comment. Numbers are decimal, ids and bytes hexadecimal.

    vector: name            what it shows; starts the block
    from: document          one of SOURCES
    quote: line             the document's own words, in one piece; a quote belongs to the `from`
                            above it, and a vector has at least one
    bytes: AA 00*4 BB       the stream; XX*n is n times the byte, a `#` starts a comment; several
                            such lines follow each other in the stream
    unit: us                of the device's clock: s, ms, us or ns; ms if not given
    frame: 0 id=123 ext rtr err dlc=2 data=1122 ts=5_000_000
                            an expected frame: the offset of its first byte, the id, the flags that
                            are set, the dlc, the payload, the time in ns; data and ts are left out
                            where the frame has none
    control: 19 FF FF 00    an expected control packet: offset and bytes
    skipped: marker=2 cut=1 the rejects by reason, one for each skipped byte
    resyncs: 1              unbroken runs of skipped bytes
    wraps: 1                steps of the clock forward through zero
    backsteps: 1            steps of the clock back
    uncertain: 1            of these, those of more than 2**24 ticks from a clock in line
    pending: 1              bytes held before the end of the stream is told
    canonical: yes          encoding the frames gives the same bytes

What is not given is not expected: no frame, nothing skipped, 0. A mistake in a file is a
ValueError that names the file and the line.
"""

from dataclasses import dataclass, field
from pathlib import Path

from reference import REASONS, TICK_NS, Control, Frame, Result, Stats

FOLDER = Path(__file__).parents[1] / "vectors"

SOURCES = (
    "python-can documentation, CAN over Serial",
    "Seeed, Serial port (USB) to CAN protocol definition",
    "CANtalope Serial Protocol",
    "USR-CANET200 manual, CAN frame format",
    "design: wire formats",
)

ONCE = ("unit", "skipped", "resyncs", "wraps", "backsteps", "uncertain", "pending", "canonical")


@dataclass
class Vector:
    """One stream and all that is expected of it."""

    protocol: str
    name: str
    quotes: list[tuple[str, str]] = field(default_factory=list)
    stream: bytes = b""
    unit: str = "ms"
    frames: list[Frame] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)
    controls: list[Control] = field(default_factory=list)
    skipped: dict[str, int] = field(default_factory=dict)
    resyncs: int = 0
    wraps: int = 0
    backsteps: int = 0
    uncertain: int = 0
    pending: int = 0
    canonical: bool = False

    def __str__(self) -> str:
        return f"{self.protocol}: {self.name}"

    def expected(self) -> Result:
        """Return what a decoder must give once the stream has ended."""
        skipped = sum(self.skipped.values())
        control = sum(len(packet.data) for packet in self.controls)
        return Result(
            self.frames,
            self.offsets,
            self.controls,
            Stats(
                bytes_in=len(self.stream),
                bytes_framed=len(self.stream) - control - skipped,
                bytes_control=control,
                bytes_skipped=skipped,
                frames=len(self.frames),
                controls=len(self.controls),
                resyncs=self.resyncs,
                rejects=dict.fromkeys(REASONS, 0) | self.skipped,
                pending=0,
                ts_wraps=self.wraps,
                ts_backsteps=self.backsteps,
                ts_uncertain=self.uncertain,
            ),
        )


def parse_bytes(text: str) -> bytes:
    stream = b""
    for word in text.partition("#")[0].split():
        byte, _, times = word.partition("*")
        stream += bytes.fromhex(byte) * int(times or 1)
    return stream


def parse_frame(text: str) -> tuple[int, Frame]:
    offset, *words = text.split()
    flags = [word for word in words if "=" not in word]
    values = dict(word.split("=") for word in words if "=" in word)
    unknown = set(flags) - {"ext", "rtr", "err"} | set(values) - {"id", "dlc", "data", "ts"}
    if unknown:
        raise ValueError(f"unknown {sorted(unknown)}")
    dlc = int(values["dlc"])
    data = bytes.fromhex(values.get("data", ""))
    if len(data) != (0 if "rtr" in flags else dlc):
        raise ValueError("the payload is not as long as the dlc says")
    frame = Frame(
        id=int(values["id"], 16),
        ext="ext" in flags,
        rtr="rtr" in flags,
        dlc=dlc,
        err="err" in flags,
        data=data.ljust(8, b"\0"),
    )
    if "ts" in values:
        frame = frame._replace(ts=int(values["ts"]))
    return int(offset), frame


def parse_skipped(text: str) -> dict[str, int]:
    skipped = {}
    for word in text.split():
        reason, _, count = word.partition("=")
        if reason not in REASONS or reason in skipped:
            raise ValueError(f"reason {reason!r} is unknown or given twice")
        skipped[reason] = int(count)
    return skipped


def parse_line(vector: Vector, source: str, key: str, value: str) -> None:
    match key:
        case "quote":
            if not source:
                raise ValueError("a quote needs its document above it")
            vector.quotes.append((source, value))
        case "bytes":
            vector.stream += parse_bytes(value)
        case "unit":
            if value not in TICK_NS:
                raise ValueError(f"unknown unit {value!r}")
            vector.unit = value
        case "frame":
            offset, frame = parse_frame(value)
            vector.offsets.append(offset)
            vector.frames.append(frame)
        case "control":
            offset_text, _, packet = value.partition(" ")
            vector.controls.append(Control(int(offset_text), parse_bytes(packet)))
        case "skipped":
            vector.skipped = parse_skipped(value)
        case "resyncs" | "wraps" | "backsteps" | "uncertain" | "pending":
            setattr(vector, key, int(value))
        case "canonical":
            if value != "yes":
                raise ValueError("canonical is yes, or left out")
            vector.canonical = True
        case _:
            raise ValueError(f"unknown key {key!r}")


def parse(text: str, protocol: str) -> list[Vector]:
    """Return all vectors of a file, in their order."""
    vectors: list[Vector] = []
    source = ""
    seen: set[str] = set()
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        key, _, value = (part.strip() for part in line.partition(":"))
        try:
            if key == "vector":
                if value in [vector.name for vector in vectors]:
                    raise ValueError(f"two vectors are named {value!r}")
                vectors.append(Vector(protocol, value))
                source, seen = "", set()
            elif not vectors:
                raise ValueError("no vector was started")
            elif key == "from":
                if value not in SOURCES:
                    raise ValueError(f"unknown document {value!r}")
                source = value
            else:
                if key in ONCE and key in seen:
                    raise ValueError(f"{key} is given twice")
                seen.add(key)
                parse_line(vectors[-1], source, key, value)
        except (KeyError, ValueError) as problem:
            raise ValueError(f"{protocol}.txt, line {number}: {problem}") from problem
    for vector in vectors:
        if not vector.quotes or not vector.stream:
            raise ValueError(f"{protocol}.txt: {vector.name!r} needs a quote and bytes")
    return vectors


def load(protocol: str) -> list[Vector]:
    """Return the vectors of one protocol."""
    return parse((FOLDER / f"{protocol}.txt").read_text(encoding="utf-8"), protocol)


def load_all() -> list[Vector]:
    """Return the vectors of every protocol that has a file."""
    return [vector for path in sorted(FOLDER.glob("*.txt")) for vector in load(path.stem)]
