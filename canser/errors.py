"""The exceptions of canser that are not Python's own."""


class CanserError(Exception):
    """What goes wrong with files and ports, apart from the caller's mistakes.

    Mistakes of the caller are ValueError, TypeError and BufferError. Noise on
    the wire is never an exception: it is counted in `Stats`.
    """


class FormatError(CanserError):
    """A file does not hold what its format promises; the message names the place."""


class StreamClosedError(CanserError):
    """The standard input or output is to be used, and the caller has closed it."""


class RecordingError(FormatError):
    """A recording holds nothing that can be read; the message names the place."""


class PortError(CanserError):
    """What goes wrong with a port; the message names it, and the remedy."""


class PortNotFoundError(PortError):
    """There is no such port."""


class PortDeniedError(PortError):
    """The port is there, and this user may not open it; the message names the group."""


class PortBusyError(PortError):
    """Somebody else has the port open."""


class PortGoneError(PortError):
    """The port was there and is no more: unplugged, or the other end has closed it."""


class PortClosedError(PortError):
    """The port is used after `close`."""


class SendError(PortError):
    """Not all could be sent; `sent` frames went out whole before it, and `reason` says why."""

    def __init__(self, message: str, sent: int, reason: str = "") -> None:
        super().__init__(message)
        self.sent, self.reason = sent, reason


class SendTimeoutError(SendError):
    """The line took no more within the time-out."""


class CanserWarning(UserWarning):
    """What a caller should know of a port or a file, and goes on without."""
