"""The exceptions of canser, and its warning.

Exception
    CanserError                files and ports
        FormatError            a file's content
            ForeignFormatError
            RecordingError
        StreamClosedError
        PortError              ports
            PortNotFoundError
            PortDeniedError
            PortBusyError
            PortGoneError
            PortClosedError
            SendError
                SendTimeoutError
    ValueError                 arguments
        NoProtocolError
        WrongProtocolError
    OSError
        FileExistsError
            OutputExistsError
        BrokenPipeError
            ReaderGoneError
UserWarning
    CanserWarning
"""


class CanserError(Exception):
    """An error with a file or a port that is no mistake of the caller.

    The caller's mistakes are ValueError, TypeError and BufferError. Noise on the wire never raises
    an exception: it is counted in `Stats`.
    """


class FormatError(CanserError):
    """A file's content is not valid in its format; the message names the place."""


class StreamClosedError(CanserError):
    """The standard input or output is closed, and the call needs it."""


class ForeignFormatError(FormatError):
    """The file has another format than raw bytes or a recording.

    Attributes
    ----------
    what : str
        Which format it is.
    option : str
        The `format` that reads it, "" if canser does not.
    """

    def __init__(self, message: str, *, what: str, option: str) -> None:
        super().__init__(message)
        self.what, self.option = what, option


class NoProtocolError(ValueError):
    """Raw bytes without a protocol, and their content does not tell it.

    Attributes
    ----------
    name : str
        The file.
    looks : str
        What the bytes look like, with the name.
    choices : tuple of str
        The protocols to choose from. If only one fits, it is the only one, with "auto" if that
        would take it.
    """

    def __init__(self, name: str, looks: str, choices: tuple[str, ...]) -> None:
        looks = f"{name}: {looks}"
        super().__init__(f"{looks}; give protocol={' or '.join(map(repr, choices))}")
        self.name, self.looks, self.choices = name, looks, choices


class WrongProtocolError(ValueError):
    """The protocol given for a recording is not the recording's.

    Attributes
    ----------
    what : str
        Which protocol it has, and which was given.
    """

    def __init__(self, what: str) -> None:
        super().__init__(f"{what}; leave the protocol out, or accept it by as_is=True")
        self.what = what


class OutputExistsError(FileExistsError):
    """The file to write exists, and the call may not replace it."""


class ReaderGoneError(BrokenPipeError):
    """The reader of the standard output has ended, as `head` does."""


class RecordingError(FormatError):
    """A recording has nothing that can be read; the message names the place."""


class PortError(CanserError):
    """An error with a port; the message names the port, and the remedy."""


class PortNotFoundError(PortError):
    """There is no such port."""


class PortDeniedError(PortError):
    """The port exists, and this user may not open it; the message names the group."""


class PortBusyError(PortError):
    """Another program has the port open."""


class PortGoneError(PortError):
    """The port has gone: it was unplugged, or the other end has closed it."""


class PortClosedError(PortError):
    """The port is used after `close`."""


class SendError(PortError):
    """Some frames were not sent.

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
    """The adapter, the line or the bus took no more frames within the timeout."""


class CanserWarning(UserWarning):
    """A message about a port or a file that the work goes on in spite of."""
