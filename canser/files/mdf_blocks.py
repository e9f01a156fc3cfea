"""The blocks of an MDF file of version 4, checked before asammdf follows their links.

A block has an id, such as ##CG, its length, and links to other blocks. asammdf follows links
without end where they form a circle, and takes all the memory that a block asks for. So the blocks
that hold records, channels and data are visited here, once each. Source: the ASAM standard, and
asammdf's `v4_blocks`.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO, Final

__all__ = ["BLOCK_MOST", "RECORD_MOST", "check_blocks", "data_len"]

# The most bytes of a record, and of an inflated block of data. Programs write up to 32 MiB.
RECORD_MOST: Final = 1 << 24
BLOCK_MOST: Final = 1 << 28

# Blocks that are visited. A file of a million channels has fewer.
_BLOCKS_MOST: Final = 1 << 24

# Id, bytes of the block, number of its links.
_HEADER: Final = struct.Struct("<4s4xQQ")
_HEADER_AT: Final = 64

# Flags, bytes of a record, bytes of its invalidation bits.
_GROUP: Final = struct.Struct("<16xHHxxxxII")
# Type, bit offset, byte offset, number of bits.
_CHANNEL: Final = struct.Struct("<BxxBII")
# Type of packing, inflated bytes, bytes.
_PACKED: Final = struct.Struct("<2xBxxxxxQQ")

# The links that are followed, the last one for all behind it. Others go back, or to texts.
_LINKS: Final[dict[bytes, tuple[slice, ...]]] = {
    b"##HD": (slice(0, 2), slice(3, 5)),
    b"##DG": (slice(0, 3),),
    b"##CG": (slice(0, 2),),
    b"##CN": (slice(0, 2), slice(4, 6)),
    b"##CC": (slice(4, None),),
    b"##CA": (slice(0, 1),),
    b"##DL": (slice(None),),
    b"##LD": (slice(None),),
    b"##HL": (slice(0, 1),),
    b"##FH": (slice(0, 1),),
    b"##AT": (slice(0, 1),),
    b"##EV": (slice(0, 1),),
}

# Blocks of data, which may be longer than the file if it was not finalized.
_DATA: Final = (b"##DT", b"##SD", b"##DV", b"##RD")

_FLAG_VARIABLE: Final = 1
_VIRTUAL: Final = (3, 6)
_DEFLATED: Final = (0, 1)


def check_blocks(file: BinaryIO, size: int, *, is_final: bool) -> None:
    """Raise ValueError unless the links of a file end, and its lengths are those of a log."""
    # The way from the header to the block at hand: each with the blocks that it links to.
    way: list[tuple[int, Iterator[int], int]] = []
    is_open: dict[int, bool] = {}  # blocks that were visited, and whether they are on the way

    def visit(at: int, record: int) -> None:
        kind, links, record = _block(file, at, size, record, is_final=is_final)
        if kind == b"##DL" and not is_final and links and links[0]:
            raise ValueError(
                f"byte {at:,}: it was not finalized, and has several lists of blocks, which "
                "asammdf cannot finalize"
            )
        is_open[at] = True
        way.append((at, iter(links), record))

    visit(_HEADER_AT, 0)
    while way:
        at, links, record = way[-1]
        target = next(links, None)
        if target is None:
            is_open[at] = False
            way.pop()
        elif target not in is_open:
            if len(is_open) == _BLOCKS_MOST:
                raise ValueError(f"it has over {_BLOCKS_MOST:,} blocks")
            visit(target, record)
        elif is_open[target]:
            raise ValueError(f"byte {at:,}: its links come back to the block at byte {target:,}")


def _block(
    file: BinaryIO, at: int, size: int, record: int, *, is_final: bool
) -> tuple[bytes, list[int], int]:
    """Return the id of a block, the links to follow, and the bytes of a record."""
    head = _read(file, at, _HEADER.size, size)
    kind, length, count = _HEADER.unpack(head)
    if not kind.startswith(b"##"):
        raise ValueError(f"byte {at:,}: no block begins here: {kind!r}")
    if kind in _DATA and not is_final:
        return kind, [], record
    if length < _HEADER.size + 8 * count or at + length > size:
        raise ValueError(
            f"byte {at:,}: the block {kind.decode('latin-1')} has {length:,} bytes and "
            f"{count:,} links, and the file ends at {size:,}; is it cut off?"
        )
    if kind == b"##DZ":
        _check_packed(file, at + _HEADER.size, size)
    if kind not in _LINKS:
        return kind, [], record
    raw = _read(file, at + _HEADER.size, 8 * count, size)
    links = struct.unpack(f"<{count}Q", raw)
    data_at = at + _HEADER.size + len(raw)
    if kind == b"##CG":
        flags, _, values, invalid = _GROUP.unpack(_read(file, data_at, _GROUP.size, size))
        record = values + invalid
        if flags & _FLAG_VARIABLE:
            record = 0
        elif record > RECORD_MOST:
            raise ValueError(f"byte {at:,}: a record of {record:,} bytes; at most {RECORD_MOST:,}")
    elif kind == b"##CN":
        of, bit, byte, bits = _CHANNEL.unpack(_read(file, data_at, _CHANNEL.size, size))
        if of not in _VIRTUAL and byte + (bit + bits + 7) // 8 > record:
            raise ValueError(
                f"byte {at:,}: a channel ends at byte {byte + (bit + bits + 7) // 8:,} of a record "
                f"of {record:,}"
            )
        if len(links) > 5 and links[5] and _read(file, links[5], 4, size) == b"##CG":
            links = links[:5]  # a group of variable data: it is in the list of groups
    return kind, [each for part in _LINKS[kind] for each in links[part] if each], record


def _check_packed(file: BinaryIO, at: int, size: int) -> None:
    """Raise ValueError unless a packed block has as many bytes as it says, and not too many."""
    packing, inflated, length = _PACKED.unpack(_read(file, at, _PACKED.size, size))
    if inflated > BLOCK_MOST:
        raise ValueError(f"byte {at:,}: a block of {inflated:,} bytes; at most {BLOCK_MOST:,}")
    packed = _read(file, at + _PACKED.size, length, size)
    if packing in _DEFLATED:
        found = len(zlib.decompressobj().decompress(packed, inflated + 1))
        if found != inflated:
            raise ValueError(f"byte {at:,}: a block of {inflated:,} bytes has {found:,}, or more")


def _read(file: BinaryIO, at: int, length: int, size: int) -> bytes:
    """Return bytes of the file; ValueError if it has fewer."""
    if at + length > size:
        raise ValueError(
            f"byte {at:,}: {length:,} bytes from here are not in the file; is it cut off?"
        )
    file.seek(at)
    return file.read(length)


def data_len(file: BinaryIO, at: int) -> int:
    """Return the inflated bytes of the data at a place: of a block, or of a list of blocks.

    The file is one that `check_blocks` has found good.
    """
    size = file.seek(0, io.SEEK_END)
    total, places = 0, [at]
    while places:
        at = places.pop()
        kind, length, count = _HEADER.unpack(_read(file, at, _HEADER.size, size))
        if kind == b"##DZ":
            total += _PACKED.unpack(_read(file, at + _HEADER.size, _PACKED.size, size))[1]
        elif kind in _DATA:
            total += length - _HEADER.size
        else:
            links = struct.unpack(f"<{count}Q", _read(file, at + _HEADER.size, 8 * count, size))
            places += [each for part in _LINKS.get(kind, ()) for each in links[part] if each]
    return total
