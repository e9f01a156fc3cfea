"""Names in errors of the system: those of reading and writing have none."""

import contextlib
import io
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Buffer

__all__ = ["NamedFile", "named"]


@contextlib.contextmanager
def named(name: str, *, always: bool = False) -> Iterator[None]:
    """Give an OSError of the block a name, if it has none, or always with `always`.

    `always` is for a file whose current name is not the one that the user knows, such as a file
    that is still being written.
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

    `opened` is a path or a descriptor, which stays open. `label` is the name.
    """

    def __init__(self, opened: str | int, mode: str, label: str) -> None:
        with named(label, always=True):
            super().__init__(opened, mode, closefd=isinstance(opened, str))
        self.label = label

    def write(self, data: "Buffer", /) -> int:
        """Write some of the bytes, and return their number."""
        with named(self.label):
            return super().write(data)

    def close(self) -> None:
        """Close the file."""
        with named(getattr(self, "label", "")):
            super().close()
