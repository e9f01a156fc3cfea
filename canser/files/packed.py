"""Files packed by gzip or zstd: unpacked as they are read, and packed as they are written."""

import contextlib
import io
import zlib
from collections.abc import Iterator
from gzip import GzipFile
from pathlib import PurePath
from typing import Any, BinaryIO, Final, cast

from canser._input import Input
from canser._output import whole_file
from canser.errors import FormatError

__all__ = ["packed_file", "unpacked", "without_packing"]

# The suffixes, with the first bytes of such files (RFC 1952, RFC 8878).
_MAGICS: Final = {".gz": b"\x1f\x8b\x08", ".zst": b"\x28\xb5\x2f\xfd"}

# The level of gzip: the usual one of the command gzip. Python's own is 9, at half the speed.
_GZIP_LEVEL: Final = 6

# Bytes that are unpacked at a time.
_CHUNK: Final = 1 << 18


def without_packing(name: str) -> str:
    """Return the name of a file without the suffix of its packing."""
    return name[: -len(PurePath(name).suffix)] if _packing(name) else name


def _packing(name: str) -> str:
    """Return the suffix of a packing that a file's name has, "" for none."""
    suffix = PurePath(name).suffix.lower()
    return suffix if suffix in _MAGICS else ""


def unpacked(source: Input) -> Input:
    """Return the bytes of a file as they were before it was packed; `source` itself if it is not.

    Waits for the first bytes of a pipe. FormatError if what unpacks zstd is not installed.
    """
    head = bytes(source.some(0)[:4])
    for suffix, magic in _MAGICS.items():
        if head.startswith(magic):
            file = io.BufferedReader(source.stream(), _CHUNK)
            unpacker = _Unpacker(_open(suffix, file, "rb", source.name), source.name)
            return Input(cast(BinaryIO, unpacker), below=source)
    return source


class _Unpacker(io.RawIOBase):
    """Unpacked bytes, with the name of the packed file."""

    def __init__(self, file: Any, name: str) -> None:
        super().__init__()
        self._file, self.name = file, name

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        try:
            # read1: what could be unpacked before an error is not lost.
            data: bytes = self._file.read1(_CHUNK if size < 0 else size)
        except EOFError:
            raise FormatError(f"{self.name} is cut off: its packing has no end") from None
        except (OSError, zlib.error, ValueError) as error:
            raise FormatError(f"{self.name}: cannot be unpacked: {error}") from None
        except Exception as error:
            # The errors of zstd and isal are of packages that may not be there.
            if type(error).__name__ not in ("ZstdError", "IsalError"):
                raise
            raise FormatError(f"{self.name}: cannot be unpacked: {error}") from None
        return data


def _open(suffix: str, file: Any, mode: str, name: str) -> Any:
    """Open a packed file. FormatError if what it needs is not installed."""
    if suffix == ".gz":
        if mode == "rb":
            return _gzip_reader()(fileobj=file, mode=mode)
        return GzipFile(fileobj=file, mode=mode, compresslevel=_GZIP_LEVEL, filename="", mtime=0)
    try:
        zstd = _zstd()
        # With a checksum damage is found, as by gzip.
        options = {zstd.CompressionParameter.checksum_flag: True} if mode == "wb" else None
        return zstd.ZstdFile(file, mode, options=options)
    except ImportError:
        raise FormatError(
            f"{name} is packed by zstd, and backports.zstd is not installed: "
            "pip install 'canser[zstd]', or unpack it first: unzstd"
        ) from None


def _gzip_reader() -> Any:
    """Return the class that reads gzip: that of isal, three times as fast, if it is installed."""
    try:
        from isal import igzip  # noqa: PLC0415 - an optional extra
    except ImportError:
        return GzipFile
    return igzip.IGzipFile


def _zstd() -> Any:
    try:
        from compression import zstd  # noqa: PLC0415 - from Python 3.14 on
    except ImportError:
        from backports import zstd  # noqa: PLC0415 - an optional extra
    return zstd


@contextlib.contextmanager
def packed_file(path: str, *, force: bool) -> Iterator[BinaryIO]:
    """Open a file to write, as `whole_file` does, packed if its suffix is .gz or .zst."""
    with whole_file(path, force=force) as file:
        suffix = _packing(path)
        if not suffix:
            yield file
            return
        packer = _open(suffix, file, "wb", path)
        with packer, io.BufferedWriter(_Packer(packer), _CHUNK) as buffered:
            yield cast(BinaryIO, buffered)


class _Packer(io.RawIOBase):
    """Takes bytes to pack. It cannot seek back."""

    def __init__(self, file: Any) -> None:
        super().__init__()
        self._file = file

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        return int(self._file.write(data))
