"""The containers of a BLF log: packed and unpacked by zlib, by several threads.

A container is packed by itself, so several can be worked on at once. Their contents come in order.
"""

import struct
import zlib
from collections import deque
from collections.abc import Iterator
from functools import partial
from typing import Any, Final

from canser._core.blf import OBJECT_MOST
from canser._threads import Helpers, useful_threads

__all__ = ["CONTAINER", "OBJECT", "Packer", "Unpacker", "packing"]

# The first bytes of each object, also of a container.
OBJECT: Final = b"LOBJ"

# Signature, bytes of this header and its version, bytes of the object, type; method, inflated size.
CONTAINER: Final = struct.Struct("<4sHHIIH6xI4x")
_TYPE: Final = 10
_STORED, _ZLIB = 0, 2

# The most inflated bytes of a container that is unpacked ahead. Those of Vector have 128 KiB.
_AHEAD_MOST: Final = 1 << 20


def packing() -> Any:
    """Return the module that inflates and deflates: isal's, which is faster, or else Python's."""
    try:
        from isal import isal_zlib  # noqa: PLC0415 - where it is installed
    except ImportError:
        return zlib
    return isal_zlib


class Packer:
    """Makes containers of contents; at the end `close` ends the threads."""

    def __init__(self) -> None:
        self._zlib = packing()
        self._threads = useful_threads(None)
        self._helpers: Helpers[bytes] = Helpers(self._threads, "packing")
        self.close = self._helpers.close

    def put(self, content: memoryview) -> Iterator[bytes]:
        """Pack a content, which is copied; yield the containers that are done."""
        self._helpers.put(partial(self._pack, bytes(content)))
        while len(self._helpers) > 2 * self._threads:
            yield self._helpers.take()

    def rest(self) -> Iterator[bytes]:
        """Yield all other containers."""
        while self._helpers:
            yield self._helpers.take()

    def _pack(self, content: bytes) -> bytes:
        packed = self._zlib.compress(content, 1)
        size = CONTAINER.size + len(packed)
        header = CONTAINER.pack(OBJECT, 16, 1, size, _TYPE, _ZLIB, len(content))
        return bytes(header + packed + bytes(size % 4))


class Unpacker:
    """Gives the contents of containers; at the end `close` ends the threads."""

    def __init__(self, threads: int | None) -> None:
        self._zlib = packing()
        self._threads = useful_threads(threads)
        self._helpers: Helpers[bytes] = Helpers(self._threads, "unpacking")
        self.close = self._helpers.close
        self._begun: deque[int] = deque()  # offsets of containers that are unpacked ahead
        self._next = 0  # the offset behind them

    def look_ahead(self, data: memoryview, offset: int) -> None:
        """Unpack containers that lie in `data`, whose first one begins at an offset of the file."""
        if not self._begun or self._begun[0] != offset:
            self._helpers.drop()
            self._begun.clear()
            self._next = offset
        while self._threads > 1 and len(self._begun) < 2 * self._threads:
            at = self._next - offset
            if len(data) - at < CONTAINER.size:
                return
            sign, _, _, size, kind, method, inflated = CONTAINER.unpack_from(data, at)
            is_usual = (sign, kind, method) == (OBJECT, _TYPE, _ZLIB) and inflated <= _AHEAD_MOST
            if not is_usual or not CONTAINER.size <= size <= len(data) - at:
                return
            packed = bytes(data[at + CONTAINER.size : at + size])
            self._helpers.put(partial(self._inflate, packed, inflated))
            self._begun.append(self._next)
            self._next += size + size % 4

    def content(self, raw: memoryview, size: int, offset: int) -> bytes:
        """Return the inflated bytes of a container; ValueError if it is damaged.

        `raw` has fewer bytes than `size` where the file is cut off; the content is cut, too.
        """
        *_, method, inflated = CONTAINER.unpack_from(raw)
        if method == _STORED:
            return bytes(raw[CONTAINER.size :])
        if method != _ZLIB:
            raise ValueError(f"has the method {method}; {_STORED} and {_ZLIB} are known")
        if inflated > OBJECT_MOST:
            raise ValueError(f"has {inflated:,} bytes inflated; at most {OBJECT_MOST:,} are read")
        try:
            if self._begun and self._begun[0] == offset:
                self._begun.popleft()
                content = self._helpers.take()
            else:
                content = self._inflate(raw[CONTAINER.size :], inflated)
        except self._zlib.error as error:
            raise ValueError(f"cannot be inflated: {error}") from None
        if len(content) > inflated:
            raise ValueError(f"inflates to more than {inflated:,} bytes, which it says it has")
        if len(raw) >= size and len(content) < inflated:
            raise ValueError(f"inflates to {len(content):,} bytes, and says it has {inflated:,}")
        return content

    def _inflate(self, packed: bytes | memoryview, inflated: int) -> bytes:
        # One byte more, for a container that has more than it says.
        content: bytes = self._zlib.decompressobj().decompress(packed, inflated + 1)
        return content
