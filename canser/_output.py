"""Files that appear as a whole or not at all; the standard output; the standard error."""

import contextlib
import errno
import io
import os
import shutil
import stat
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, TextIO, cast

from canser._named import NamedFile, named
from canser.errors import OutputExistsError, ReaderGoneError, StreamClosedError


class _StandardOutput(NamedFile):
    """The standard output, whose reader may end at any time."""

    def __init__(self) -> None:
        super().__init__(sys.stdout.fileno(), "wb", "standard output")

    def write(self, data: Any) -> int:
        """Write at least a part of the bytes; ReaderGoneError if there is no reader."""
        try:
            return super().write(data)
        except BrokenPipeError as error:
            raise ReaderGoneError(errno.EPIPE, error.strerror, error.filename) from None


@contextlib.contextmanager
def standard_output() -> Iterator[BinaryIO]:
    """Open the standard output for bytes, buffered; at the end all bytes are written.

    With `python -u`, sys.stdout has no buffer, and writes only a part, without an error, when a
    disk becomes full. StreamClosedError if it is closed, ReaderGoneError if its reader ends.
    """
    if sys.stdout is None:
        raise StreamClosedError("the standard output is closed; open it, or name a file")
    with named("standard output"):
        sys.stdout.flush()
    with io.BufferedWriter(_StandardOutput()) as file:
        yield cast(BinaryIO, file)


class _Messages(io.FileIO):
    """A file for writing that drops what it cannot write."""

    def write(self, data: Any) -> int:
        """Write at least a part of the bytes, or drop them all."""
        with contextlib.suppress(OSError):
            done: int | None = super().write(data)
            if done is not None:  # None: the stream does not block, and takes no bytes now
                return done
        return len(data)


@contextlib.contextmanager
def optional_messages() -> Iterator[None]:
    """Let sys.stderr, if it is a file, drop messages that it cannot write.

    Otherwise a message to a full disk, or to a pipe without a reader, would end the work in the
    middle. A closed standard error drops all messages.
    """
    before = sys.stderr
    try:
        fd = os.open(os.devnull, os.O_WRONLY) if before is None else before.fileno()
    except io.UnsupportedOperation:  # in a notebook, and in tests
        yield
        return
    file = io.BufferedWriter(_Messages(fd, "w", closefd=before is None))
    encoding = None if before is None else before.encoding
    sys.stderr = io.TextIOWrapper(file, encoding, errors="backslashreplace", line_buffering=True)
    try:
        yield
    finally:
        sys.stderr.close()
        sys.stderr = before


@contextlib.contextmanager
def whole_file(path: str, *, force: bool) -> Iterator[BinaryIO]:
    """Open a file for writing that gets its name when the block ends without an error.

    Until then it has a temporary name in the same folder. After an error it is removed. "-" is the
    standard output. A pipe or a device is written in place. OutputExistsError if the file exists
    and `force` is False. If files are read, too, call `check_apart` before.
    """
    if path == "-":
        with standard_output() as file:
            yield file
        return
    target = Path(path)
    if target.exists() and not target.is_file():
        with io.BufferedWriter(NamedFile(path, "wb", path)) as file:
            yield cast(BinaryIO, file)
        return
    target = Path(os.path.realpath(path))  # a link stays a link
    _check_free(target, path, force=force)
    partial = target.with_name(f".canser-{os.urandom(4).hex()}.part")
    try:
        # A signal may come as soon as the file is there.
        with io.BufferedWriter(NamedFile(str(partial), "xb", path)) as file:
            yield cast(BinaryIO, file)
            file.flush()
        _check_free(target, path, force=force)
        with named(path, always=True):
            if target.exists():
                shutil.copymode(target, partial)
            partial.replace(target)
    except BaseException:
        with contextlib.suppress(OSError):  # it may be that no file could be made
            partial.unlink()
        raise


def check_apart(target: str, *others: str) -> None:
    """Raise OutputExistsError if a file to write is one of the others, also by a link.

    "-" is the standard output as a target, and the standard input as one of the others.
    """
    written = _status(target, sys.stdout)
    for other in others:
        read = _status(other, sys.stdin)
        if written is None or read is None:  # files that do not exist yet
            same = target != "-" and os.path.realpath(target) == os.path.realpath(other)
        else:
            same = stat.S_ISREG(written.st_mode) and os.path.samestat(written, read)
        if same:
            raise OutputExistsError(
                f"{target} and {other} are one file; give one of them another name"
            )


def _status(path: str, stream: TextIO | None) -> os.stat_result | None:
    """Return the status of a file, None where there is none."""
    try:
        if path != "-":
            return os.stat(path)  # noqa: PTH116 - follows links
        return None if stream is None else os.fstat(stream.fileno())
    except (OSError, ValueError):  # ValueError: a stream that is no file
        return None


def _check_free(target: Path, path: str, *, force: bool) -> None:
    if target.exists() and not force:
        raise OutputExistsError(f"{path} is there already; --force replaces it")
