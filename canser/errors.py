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


class ForeignFormatError(FormatError):
    """A file is plainly of another format than raw bytes or a recording.

    Attributes
    ----------
    what : str
        Which format it is.
    option : str
        What `format` reads it, "" if canser does not.
    """

    def __init__(self, message: str, *, what: str, option: str) -> None:
        super().__init__(message)
        self.what, self.option = what, option


class NoProtocolError(ValueError):
    """Raw bytes are to be read, and their protocol is neither given nor plain.

    Attributes
    ----------
    name : str
        The file.
    looks : str
        What the bytes look like, with the name.
    choices : tuple of str
        The protocols to choose from; the one that fits alone if there is one, with "auto" if
        that would take it.
    """

    def __init__(self, name: str, looks: str, choices: tuple[str, ...]) -> None:
        looks = f"{name}: {looks}"
        super().__init__(f"{looks}; give protocol={' or '.join(map(repr, choices))}")
        self.name, self.looks, self.choices = name, looks, choices


class WrongProtocolError(ValueError):
    """A recording is to be read in another protocol than its own.

    Attributes
    ----------
    what : str
        Which protocol it has, and which was given.
    """

    def __init__(self, what: str) -> None:
        super().__init__(f"{what}; leave the protocol out, or accept it by as_is=True")
        self.what = what


class OutputExistsError(FileExistsError):
    """The file to write is there already, and must not be replaced."""


class ReaderGoneError(BrokenPipeError):
    """The reader of the standard output has gone, as `head` does."""


class RecordingError(FormatError):
    """A recording holds nothing that can be read; the message names the place."""


class PortError(CanserError):
    """What goes wrong with a port; the message names it, and the remedy."""


class PortNotFoundError(PortError):
    """There is no such port."""


class PortDeniedError(PortError):
    """The port is there, and this user may not open it; the message names the group."""


class PortBusyError(PortError):
    """Another program has the port open."""


class PortGoneError(PortError):
    """The port was there and is no more: unplugged, or the other end has closed it."""


class PortClosedError(PortError):
    """The port is used after `close`."""


class SendError(PortError):
    """Not all frames could be sent.

    Attributes
    ----------
    sent : int
        The frames that went out whole before the error.
    reason : str
        Why no more went out.
    """

    def __init__(self, message: str, sent: int, reason: str = "") -> None:
        super().__init__(message)
        self.sent, self.reason = sent, reason


class SendTimeoutError(SendError):
    """The adapter, the line or the bus took no more within the time-out."""


class CanserWarning(UserWarning):
    """What a caller should know of a port or a file, and goes on without."""
