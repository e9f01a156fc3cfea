"""Errors of the system that say what they are about: those of reading and writing do not."""

import contextlib
import io
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Buffer

__all__ = ["NamedFile", "named"]


@contextlib.contextmanager
def named(name: str, *, always: bool = False) -> Iterator[None]:
    """Give an OSError of the block a name, if it has none or `always`.

    `always` is for what has another name than the one that the user knows, such as a file that
    is still being written.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None or always:
            if error.errno is None:  # some have a text, and nothing else
                error.args = (f"{name}: {error}",)
            else:
                error.filename = name
                del error.filename2  # as None it would be shown
        raise


class NamedFile(io.FileIO):
    """A file to write, unbuffered, whose errors have its name.

    `opened`: what `open` takes, a path or a descriptor, which stays open. `label`: the name.
    """

    def __init__(self, opened: str | int, mode: str, label: str) -> None:
        with named(label, always=True):
            super().__init__(opened, mode, closefd=isinstance(opened, str))
        self.label = label

    def write(self, data: "Buffer", /) -> int:
        """Write some of the bytes, and return how many."""
        with named(self.label):
            return super().write(data)

    def close(self) -> None:
        """Close the file."""
        with named(getattr(self, "label", "")):
            super().close()
