"""What the bytes of a file are: by how they begin, by what fits them, by what was skipped."""

import shlex
from typing import Final

from canser._binding import BytesLike
from canser._input import Input
from canser.codec import Decoder, protocols
from canser.doubt import is_doubtful
from canser.errors import FormatError
from canser.foreign import HEAD_LEN, Foreign, recognise
from canser.identify import Fit, identify

__all__ = [
    "AUTO",
    "ForeignFormatError",
    "NoProtocolError",
    "WrongProtocolError",
    "check_protocol",
    "choose_protocol",
    "describe_doubt",
    "describe_fit",
    "is_auto",
]

# The protocol that stands for the one that fits the bytes, if its score is this at least. The
# captures of real adapters score 0.98 and more; a line that damages 1 byte in 100, 0.75.
AUTO: Final = "auto"
_AUTO_SCORE: Final = 0.9

# Of a pipe so many bytes are waited for to find the protocol that fits, or its end: 1.4 seconds of
# the slowest adapter's line.
_AUTO_LEN: Final = 1 << 14

_NOTHING: Final = "no protocol that canser knows"


class NoProtocolError(ValueError):
    """Raw bytes are to be read, and their protocol is neither given nor plain.

    `looks`: what they look like. `choices`: the protocols to choose from, the one that fits
    alone if there is one, with "auto" if that would take it.
    """

    def __init__(self, name: str, fit: Fit | None) -> None:
        self.choices = protocols()
        self.looks = f"{name}: there are no bytes to tell a protocol by"
        if fit is not None:
            self.looks = f"{name}: these bytes look like {describe_fit(fit)}"
            if fit.fits:
                self.choices = (fit.protocol, AUTO) if _is_plain(fit) else (fit.protocol,)
        choices = " or ".join(map(repr, self.choices))
        super().__init__(f"{self.looks}; give protocol={choices}")


class WrongProtocolError(ValueError):
    """A recording is to be read in another protocol than its own; `what` says so."""

    def __init__(self, name: str, own: str, given: str) -> None:
        self.what = f"{name} is a recording in {own}, not in {given}"
        super().__init__(f"{self.what}; leave the protocol out, or accept it by as_is=True")


class ForeignFormatError(FormatError):
    """A file is plainly of another format than raw bytes or a recording; `what` says which."""

    def __init__(self, name: str, found: Foreign) -> None:
        self.found = found
        self.what = f"{name} is {found.name}, not raw bytes"
        super().__init__(f"{self.what}; {found.remedy.replace('FILE', shlex.quote(name))}")


def check_protocol(protocol: str | None, ts_unit: str | None) -> None:
    """Raise for a protocol or a unit that does not exist."""
    known = protocols()[0] if protocol is None or is_auto(protocol) else protocol
    Decoder(known, ts_unit="ms" if ts_unit is None else ts_unit)


def is_auto(protocol: str | None) -> bool:
    """Return whether a protocol is to be found by the bytes."""
    return isinstance(protocol, str) and protocol.lower() == AUTO


def choose_protocol(protocol: str | None, source: Input, *, as_is: bool) -> tuple[str, str]:
    """Return the protocol of raw bytes, and a remark where "auto" has found it, else "".

    NoProtocolError where it is neither given nor plain, FormatError for another format.
    """
    if not as_is and (found := recognise(bytes(source.some(0)[:HEAD_LEN]))) is not None:
        raise ForeignFormatError(source.name, found)
    if protocol is not None and not is_auto(protocol):
        return protocol, ""
    if source.size is None and is_auto(protocol):
        source.at(0, _AUTO_LEN)
    sample = source.sample()
    if not len(sample) and is_auto(protocol):
        return protocols()[0], "is empty"
    fit = identify(sample)[0] if len(sample) else None
    if fit is None or not is_auto(protocol) or not _is_plain(fit):
        raise NoProtocolError(source.name, fit)
    return fit.protocol, f"read as {describe_fit(fit)}"


def describe_doubt(name: str, decoder: Decoder, sample: BytesLike) -> str:
    """Say why the bytes that a decoder has read are not of its protocol; "" if they may be.

    `sample`: some of these bytes, by which to tell what they look like.
    """
    bytes_in, skipped = decoder.position, decoder.skipped
    if not is_doubtful(decoder.protocol, bytes_in, skipped):
        return ""
    fit = identify(sample)[0]
    look = describe_fit(fit) if fit.protocol != decoder.protocol else _NOTHING
    return (
        f"{name}: {skipped / bytes_in:.0%} of the {bytes_in:,} bytes are in no "
        f"{decoder.protocol} packet; they look like {look}"
    )


def _is_plain(fit: Fit) -> bool:
    return fit.fits and fit.score >= _AUTO_SCORE


def describe_fit(fit: Fit) -> str:
    """Say what bytes look like of which this is the best fit."""
    if fit.fits:
        return f"{fit.protocol} ({fit.score:.0%})"
    return _NOTHING
