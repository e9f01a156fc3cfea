"""Captures of CAN frames by Wireshark, tcpdump and their kin: pcap and pcapng.

A packet holds a frame as SocketCAN has it (link type 227), or behind a header of 16 bytes (link
type 113, of captures of all interfaces). Classic pcap has one link type for the file. In pcapng
each section describes interfaces, whose names are the channels, and blocks of packets tell the
direction. A pcapng file whose first interface is canser's is a recording.

Sources: draft-ietf-opsawg-pcap, draft-ietf-opsawg-pcapng, www.tcpdump.org/linktypes.

Frames of CAN FD and CAN XL are counted, and left out. So are packets of other networks, such as
LIN, and packets without all bytes of their frame. The file to write is pcapng if its name ends in
.pcapng, else classic pcap.
"""

import struct
from collections.abc import Iterator, Mapping
from typing import BinaryIO, Final

import numpy as np

from canser._core.pcap import (
    BLOCK_MAX,
    LINK_CAN,
    LINK_COOKED,
    RECORD_MAX,
    PacketReader,
    PacketWriter,
)
from canser._core.text import NO_CHANNEL, Codes
from canser._frames import NO_TIME, FrameArray
from canser._input import Input
from canser.errors import ForeignFormatError, FormatError
from canser.files.reader import Reader, ReadOptions
from canser.files.tagged import TaggedReader
from canser.files.writer import WriteOptions
from canser.files.writer import Writer as AnyWriter
from canser.recording import pcapng
from canser.recording.pcapng import Order, u16, u32

about: Final = "a capture of CAN frames"

cannot_hold: Final = (
    "whether a time is known",
    "times before 1970",
    "channels and directions, if its name does not end in .pcapng",
)

# The number at the start of a pcap file: its byte order, and the places of its seconds.
_MAGICS: Final[dict[bytes, tuple[Order, int]]] = {
    struct.pack(f"{order}I", number): (order, places)
    for order in ("<", ">")
    for number, places in ((0xA1B2C3D4, 6), (0xA1B23C4D, 9))
}
_NANOSECONDS: Final = 0xA1B23C4D

# The headers of a pcap file and of a record, the shortest section and interface, in bytes.
_FILE_HEAD: Final = 24
_RECORD_HEAD: Final = 16
_SECTION_MIN: Final = 28
_INTERFACE_MIN: Final = 20

# Types of blocks, beside those of `pcapng`: packets of old files, packets without a time, and those
# that tell nothing of packets: names, secrets.
_OLD, _SIMPLE, _NAMES, _SECRETS = 2, 3, 4, 10

# Codes of options: of an interface, and of its statistics.
_NAME, _RESOLUTION, _OFFSET = 2, 9, 14
_DROPPED: Final = 5

# The resolution of times without that option: microseconds.
_MICROSECONDS: Final = 6

# Interfaces of a section: more than any computer has.
_INTERFACES_MOST: Final = 1 << 12

# The bytes of the longest option's value.
_OPTION_MOST: Final = 0xFFFF

# A link type for private use: that of canser's recordings.
_PRIVATE: Final = 147

# Other networks that messages name.
_NETWORKS_SHOWN: Final = 8

# Other networks by their link types.
_NETWORKS: Final = {
    0: "loopback",
    1: "Ethernet",
    101: "IP",
    105: "Wi-Fi",
    127: "Wi-Fi",
    _PRIVATE: "raw bytes",
    187: "Bluetooth",
    189: "USB",
    201: "Bluetooth",
    210: "FlexRay",
    212: "LIN",
    220: "USB",
    249: "USB",
}


def sniff(head: bytes) -> bool:
    """Return whether a file starts as pcap or pcapng does; 12 bytes are enough."""
    return head[:4] in _MAGICS or pcapng.is_pcapng(head)


def read(source: Input, options: ReadOptions) -> Reader:
    """Open a capture.

    Raises
    ------
    FormatError
        The file is no capture, or it is a pcap file of another network than CAN.
    """
    return _CaptureReader(source, options)


def write(file: BinaryIO, options: WriteOptions) -> AnyWriter:
    """Begin a capture: pcapng if the name of the file ends so, else pcap."""
    if options.name.lower().endswith(".pcapng"):
        return BlockWriter(file, options.channel_names)
    return RecordWriter(file)


class RecordWriter:
    """Writes frames as a pcap file, with times in nanoseconds."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._packets = PacketWriter(is_blocks=False)
        # Version 2.4, no time zone, the longest packet.
        head = struct.pack("<IHHiIII", _NANOSECONDS, 2, 4, 0, 0, RECORD_MAX, LINK_CAN)
        file.write(head)

    def write(self, frames: FrameArray) -> None:
        """Append frames."""
        for part in self._packets.packets(frames, None, None):
            self._file.write(part)

    def finish(self) -> list[str]:
        """Return what the capture could not hold."""
        return _times_lost(self._packets)


class BlockWriter:
    """Writes frames as a pcapng file, with an interface for each channel."""

    takes_tags = True

    def __init__(self, file: BinaryIO, names: Mapping[int, str] | None = None) -> None:
        # Imported here: it takes 10 ms to import, and readers do not need it.
        from importlib.metadata import version  # noqa: PLC0415

        self._file = file
        self._names = {} if names is None else names
        self._packets = PacketWriter(is_blocks=True)
        self._described: set[int] = set()  # the channels that have an interface
        section = struct.pack("<IHHq", pcapng.MAGIC, 1, 0, -1)
        application = f"canser {version('canser')}".encode()
        file.write(pcapng.block(pcapng.SECTION, section, [(pcapng.APPLICATION, application)]))

    def write(
        self, frames: FrameArray, channels: Codes | None = None, directions: Codes | None = None
    ) -> None:
        """Append frames."""
        if channels is None:
            codes = [NO_CHANNEL] if len(frames) else []
        else:
            codes = np.flatnonzero(np.bincount(channels, minlength=256)).tolist()
        for code in codes:
            self._describe(code)
        for part in self._packets.packets(frames, channels, directions):
            self._file.write(part)

    def _describe(self, code: int) -> None:
        """Write the interface of a channel, unless that is done."""
        if code in self._described:
            return
        self._packets.state.numbers[code] = len(self._described)
        self._described.add(code)
        options = [(_RESOLUTION, b"\x09")]
        if code != NO_CHANNEL:
            name = self._names.get(code, f"can{code}").encode("utf-8", "replace")
            options.insert(0, (_NAME, name[:_OPTION_MOST]))
        # No limit for the length of packets.
        fixed = struct.pack("<HHI", LINK_CAN, 0, 0)
        self._file.write(pcapng.block(pcapng.INTERFACE, fixed, options))

    def finish(self) -> list[str]:
        """Return what the capture could not hold."""
        if not self._described:
            self._describe(NO_CHANNEL)  # so that a file without frames is one of CAN, too
        return _times_lost(self._packets)


def _times_lost(packets: PacketWriter) -> list[str]:
    remarks = {
        "frames without a time, written as 0": packets.state.unknown_times,
        "frames with a time that the format cannot hold, written as 0": packets.state.outside_times,
    }
    return [f"{what}: {count:,}" for what, count in remarks.items() if count]


class _CaptureReader(TaggedReader):
    """Reads packets: usual ones in C, and any other block or record in Python."""

    def __init__(self, source: Input, options: ReadOptions) -> None:
        self._c = PacketReader()
        super().__init__(source, options)
        self._offset = self.bytes_done = 0
        self._order: Order = "<"
        self._snap_lens: list[int] = []  # of the section's interfaces; 0 for no limit
        self._has_can = False
        self._networks: dict[int, None] = {}  # link types of other networks, in order
        self._lost: dict[int, int] = {}  # packets lost, by interface of this section
        self._lost_before = 0  # of the sections before it
        self._unknown = 0  # blocks of types that are not known
        self._nuls = self._cut = 0  # bytes at the end of the file
        self._bad = ""  # why the rest of the file cannot be read
        head = bytes(source.at(0, pcapng.LENGTH_MIN))
        self._is_blocks = pcapng.is_pcapng(head)
        if self._is_blocks:
            self._c.begin(is_blocks=True, is_big=False)  # until the section tells it
        else:
            self._begin_pcap()

    def _new_rows(self) -> None:
        super()._new_rows()
        self._c.use(self._frames, self._channels, self._directions)

    def _begin_pcap(self) -> None:
        """Read the header of a pcap file."""
        name, head = self._source.name, self._source.at(0, _FILE_HEAD)
        found = _MAGICS.get(bytes(head[:4]))
        if found is None:
            raise FormatError(f"{name} is no capture: it starts neither as pcap nor as pcapng")
        if len(head) < _FILE_HEAD:
            raise FormatError(f"{name}: the header is cut off: {len(head)} of {_FILE_HEAD} bytes")
        self._order, places = found
        self._c.begin(is_blocks=False, is_big=self._order == ">")
        self._add_link(u32(head, 20, self._order) & 0xFFFF)  # above: the length of checksums
        self._c.add_interface(u32(head, 20, self._order) & 0xFFFF, NO_CHANNEL, places)
        self._check_network()
        self.has_buses = False
        self._advance(_FILE_HEAD)

    def _add_link(self, link_type: int) -> bool:
        """Take note of a link type; return whether it is of CAN."""
        is_can = link_type in (LINK_CAN, LINK_COOKED)
        if is_can:
            self._has_can = True
        else:
            self._networks[link_type] = None
        return is_can

    def _check_network(self) -> None:
        """Raise FormatError if the capture has no interface of CAN."""
        if self._has_can or self._bad:
            return
        name = self._source.name
        if not self._networks:
            raise FormatError(f"{name} is no capture: it describes no interface; is it cut off?")
        what = f"{name} is a capture of {self._other_networks}, not of CAN"
        remedy = "Wireshark reads it"
        if _PRIVATE in self._networks:
            remedy = "if it is a recording of canser, its format is pcapng"
        raise ForeignFormatError(f"{what}; {remedy}", what=what, option="")

    @property
    def _other_networks(self) -> str:
        """The names of the networks that are not CAN, or their numbers."""
        names = [_NETWORKS.get(each, f"link type {each}") for each in self._networks]
        return " and ".join(dict.fromkeys(names[:_NETWORKS_SHOWN]))

    def _advance(self, count: int) -> None:
        self._offset += count
        self.bytes_done = self._offset

    def _fill(self) -> Iterator[None]:
        source = self._source
        take_next = self._take_block if self._is_blocks else self._take_record
        while True:
            data = source.ahead(self._offset)
            if not data:
                break
            taken = self._c.read(data, self._count)
            self._advance(taken.used)
            self._count += taken.frames
            if self._count == len(self._frames):
                yield
                continue
            if source.size is None and not taken.is_unusual:
                yield  # a pipe is waited for: frames go on before
            try:
                goes_on = take_next(is_unusual=taken.is_unusual)
            except FormatError as error:
                yield  # the frames before it
                if not self._options.skip_bad:
                    raise
                self._bad = str(error)
                break
            if not goes_on:
                break
            if self._count == len(self._frames):
                yield
        self._check_network()
        yield

    def _take_record(self, *, is_unusual: bool) -> bool:  # noqa: ARG002 - the length tells it
        """Look at the next record of pcap; return False if the file ends in it."""
        head = self._source.at(self._offset, _RECORD_HEAD)
        if len(head) < _RECORD_HEAD:
            return self._end(len(head))
        length = u32(head, 8, self._order)
        if length > RECORD_MAX:
            raise self._damaged(f"a packet of {length:,} bytes, over the limit of {RECORD_MAX:,}")
        if not any(head):
            if self._ends_in_nuls():
                return False
            raise self._damaged("zeros stand where a packet begins")
        if not length:
            self._c.state.cut_count += 1
            self._advance(_RECORD_HEAD)
            return True
        whole = self._source.at(self._offset, _RECORD_HEAD + length)
        return len(whole) == _RECORD_HEAD + length or self._end(len(whole))

    def _take_block(self, *, is_unusual: bool) -> bool:
        """Look at the next block of pcapng; return False if the file ends in it."""
        head = self._source.at(self._offset, pcapng.LENGTH_MIN)
        if len(head) < pcapng.LENGTH_MIN:
            return self._end(len(head))
        is_section = head[:4] == pcapng.SECTION_MARK
        order = pcapng.section_order(head) if is_section else self._order
        if order is None:
            raise self._damaged("the byte order of the section is not known")
        kind, length = u32(head, 0, order), u32(head, 4, order)
        if not pcapng.LENGTH_MIN <= length <= BLOCK_MAX or length % 4:
            if not any(head) and self._ends_in_nuls():
                return False
            raise self._damaged(f"a block of {length:,} bytes: a length that no block has")
        whole = self._source.at(self._offset, length)
        if len(whole) < length:
            return self._end(len(whole))
        if is_unusual:
            if whole[-4:] != whole[4:8]:
                raise self._damaged("the two lengths of the block differ")
            self._take_unusual(kind, whole, order)
            self._advance(length)
        return True

    def _take_unusual(self, kind: int, whole: memoryview, order: Order) -> None:
        """Take a whole block that C has left."""
        if kind == pcapng.SECTION:
            self._begin_section(whole, order)
        elif kind == pcapng.INTERFACE:
            self._add_interface(whole)
        elif kind == pcapng.ENHANCED:
            raise self._damaged(self._why(whole))
        elif kind in (_OLD, _SIMPLE):
            self._take_other_packet(kind, whole)
        elif kind == pcapng.STATISTICS:
            self._take_statistics(whole)
        elif kind not in (_NAMES, _SECRETS):
            self._unknown += 1

    def _begin_section(self, whole: memoryview, order: Order) -> None:
        if len(whole) < _SECTION_MIN or u16(whole, 12, order) != 1:
            raise self._damaged("the section is of a version that is not known")
        self._order = order
        self._c.begin(is_blocks=True, is_big=order == ">")
        self._snap_lens = []
        self._lost_before += sum(self._lost.values())
        self._lost = {}

    def _add_interface(self, whole: memoryview) -> None:
        number, order = len(self._snap_lens), self._order
        if len(whole) < _INTERFACE_MIN:
            raise self._damaged("the interface is not described")
        if number == _INTERFACES_MOST:
            raise self._damaged(f"more than {_INTERFACES_MOST:,} interfaces")
        values = {
            code: bytes(whole[at : at + length])
            for code, at, length in pcapng.options(whole, 16, order)
        }
        name = values.get(_NAME, b"").decode("utf-8", "replace").rstrip("\0") or str(number)
        resolution, seconds = values.get(_RESOLUTION, b""), values.get(_OFFSET, b"")
        (offset,) = struct.unpack(f"{order}q", seconds) if len(seconds) == 8 else (0,)
        offset_ns = offset * 1_000_000_000
        if abs(offset_ns) >= 1 << 63:
            raise self._damaged(f"times begin at {offset} s, over 64 bits of nanoseconds")
        link_type = u16(whole, 8, order)
        self._c.add_interface(
            link_type,
            self._code(name) if self._add_link(link_type) else NO_CHANNEL,
            resolution[0] if len(resolution) == 1 else _MICROSECONDS,
            offset_ns,
        )
        self._snap_lens.append(u32(whole, 12, order))

    def _why(self, whole: memoryview) -> str:
        """Return what is wrong with an enhanced packet block."""
        if len(whole) < pcapng.ENHANCED_HEAD_LEN + 4:
            return "a block that is too short for a packet"
        number, length = u32(whole, 8, self._order), u32(whole, 20, self._order)
        if number >= len(self._snap_lens):
            have = len(self._snap_lens)
            return f"a packet of the interface {number}, but {have} are described"
        if length > len(whole) - pcapng.ENHANCED_HEAD_LEN - 4:
            return f"a packet of {length:,} bytes, which do not fit into its block"
        return "a time that does not fit 64 bits of nanoseconds"

    def _take_other_packet(self, kind: int, whole: memoryview) -> None:
        """Take a packet of another type as an enhanced packet block."""
        order, made = self._order, bytearray(whole)
        if kind == _OLD and len(whole) >= pcapng.ENHANCED_HEAD_LEN + 4:
            # The same but for two numbers of 16 bits, the interface and the packets lost.
            struct.pack_into(f"{order}I", made, 8, u16(whole, 8, order))
        elif kind == _SIMPLE and len(whole) >= 16 and self._snap_lens:
            # Its original length only, of the first interface, without a time.
            data, original = bytes(whole[12:-4]), u32(whole, 8, order)
            length = min(original, self._snap_lens[0] or original, len(data))
            total = pcapng.ENHANCED_HEAD_LEN + len(data) + 4
            head = struct.pack(f"{order}7I", 0, total, 0, 0, 0, length, original)
            made = bytearray(head + data + struct.pack(f"{order}I", total))
        else:
            raise self._damaged("a packet that does not fit into its block")
        struct.pack_into(f"{order}I", made, 0, pcapng.ENHANCED)
        taken = self._c.read(bytes(made), self._count)
        if not taken.packets:
            raise self._damaged(self._why(memoryview(made)))
        if kind == _SIMPLE:
            self._frames["ts"][self._count : self._count + taken.frames] = NO_TIME
        self._count += taken.frames

    def _take_statistics(self, whole: memoryview) -> None:
        """Take note of how many packets an interface lost so far."""
        for code, at, length in pcapng.options(whole, 20, self._order):
            number = u32(whole, 8, self._order)
            if code == _DROPPED and length == 8 and number < len(self._snap_lens):
                (count,) = struct.unpack_from(f"{self._order}Q", whole, at)
                self._lost[number] = count

    def _end(self, left: int) -> bool:
        """End the file, whose last bytes are no whole packet; return False."""
        if left and not self._ends_in_nuls():
            self._cut = left
        return False

    def _ends_in_nuls(self) -> bool:
        """Return whether only NUL bytes are left; count them."""
        at = self._offset
        while data := self._source.ahead(at):
            if bytes(data).strip(b"\0"):
                return False
            at += len(data)
        self._nuls = at - self._offset
        return True

    def _damaged(self, why: str) -> FormatError:
        return FormatError(
            f"{self._source.name}, byte {self._offset:,}: {why}; is it damaged? skip_bad=True "
            "reads what is before"
        )

    @property
    def remarks(self) -> list[str]:
        """Remarks on the file: what the frames do not hold."""
        state, remarks = self._c.state, super().remarks
        lost = max(state.dropped_count, self._lost_before + sum(self._lost.values()))
        counts = {
            "CAN FD frames, left out": state.fd_count,
            "CAN XL frames, left out": state.xl_count,
            f"packets of {self._other_networks or 'other networks'}, left out": state.other_count,
            "packets that are no frame of CAN, left out": state.bad_count,
            "packets cut short, left out": state.cut_count,
            "packets that the capture lost, as it tells": lost,
            "comments on packets, left out": state.comment_count,
            "blocks of types that are not known, skipped": self._unknown,
        }
        remarks += [f"{what}: {count:,}" for what, count in counts.items() if count]
        if self._bad:
            remarks.append(f"cannot be read to its end: {self._bad}")
        if self._cut:
            remarks.append(f"the last packet is cut off, and left out: {self._cut:,} bytes")
        if self._nuls:
            remarks.append(
                f"ends in {self._nuls:,} NUL bytes; was the power cut? Frames may be missing"
            )
        return remarks
