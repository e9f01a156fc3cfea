"""Starting threads, with an error that names their purpose if that is impossible."""

import threading

from canser.errors import CanserError

__all__ = ["start_thread"]


def start_thread(
    thread: threading.Thread, name: str, kind: type[CanserError] = CanserError
) -> None:
    """Start a thread for what `name` names; an error of `kind` where the system starts no more."""
    try:
        thread.start()
    except RuntimeError as error:
        raise kind(f"{name}: {error}; end some processes, or allow more with 'ulimit -u'") from None
