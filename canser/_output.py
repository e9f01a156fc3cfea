"""Files that appear whole or not at all."""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO


class OutputExistsError(FileExistsError):
    """The file is there, and nobody said that it may be replaced."""


@contextlib.contextmanager
def whole_file(path: str, *, force: bool) -> Iterator[BinaryIO]:
    """Open a file for writing that gets its name when the block ends without an error.

    Until then it has a temporary name beside it, and after an error it is gone. "-" is
    the standard output; a pipe or a device is written in place. OutputExistsError if
    the file is there and `force` is False.
    """
    if path == "-":
        yield sys.stdout.buffer
        sys.stdout.buffer.flush()
        return
    target = Path(os.path.realpath(path))  # a link stays a link
    if target.exists() and not target.is_file():
        with target.open("wb") as file:
            yield file
        return
    _check_free(target, path, force=force)
    partial = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with partial.open("xb") as file:
            yield file
            file.flush()
        _check_free(target, path, force=force)
        partial.replace(target)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def _check_free(target: Path, path: str, *, force: bool) -> None:
    if target.exists() and not force:
        raise OutputExistsError(f"{path} is there already; --force replaces it")
