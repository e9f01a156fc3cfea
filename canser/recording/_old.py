"""Set aside the old file whose name a new recording takes, until the new one holds bytes."""

import os
from pathlib import Path

from canser.errors import OutputExistsError
from canser.recording._lock import is_locked

__all__ = ["OldFile", "check_replaceable"]


def check_replaceable(path: Path) -> None:
    """Raise OutputExistsError for a file that may not be replaced."""
    if not path.is_file():
        raise OutputExistsError(f"{path} is no file; name one")
    try:
        locked = is_locked(path)
    except OSError as error:
        raise OutputExistsError(
            f"{path} is not replaced, as another program may record into it: {error.strerror}"
        ) from None
    if locked:
        raise OutputExistsError(f"another program records into {path}; end it, or name another")
    old = _old_name(path)
    if os.path.lexists(old):
        raise OutputExistsError(
            f"{old} is there already: an earlier run was killed before it had recorded anything; "
            "move the file away, or delete it"
        )


class OldFile:
    """A file that was renamed from its name, `name`, to that name with .old behind it, `path`.

    OutputExistsError for a file that may not be replaced.
    """

    def __init__(self, path: Path) -> None:
        check_replaceable(path)
        self.name = path
        self.path = _old_name(path)
        path.rename(self.path)

    def delete(self) -> None:
        """Delete the old file, as the new recording holds bytes."""
        self.path.unlink(missing_ok=True)

    def put_back(self) -> None:
        """Give the old file its name back. It replaces a new recording that holds no bytes."""
        self.path.replace(self.name)


def _old_name(path: Path) -> Path:
    return path.with_name(f"{path.name}.old")
