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
