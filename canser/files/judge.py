"""What the bytes of a file are: by how they begin, by what fits them, by what was skipped."""

from typing import Final

from canser._core.buffers import BytesLike
from canser._input import Input
from canser._protocols import protocols
from canser.codec.decoder import Decoder
from canser.codec.doubt import is_doubtful
from canser.errors import NoProtocolError
from canser.files.fits import Fit, identify

__all__ = [
    "AUTO",
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


def check_protocol(protocol: str | None, ts_unit: str | None) -> None:
    """Raise for a protocol or a unit that does not exist."""
    known = protocols()[0] if protocol is None or is_auto(protocol) else protocol
    Decoder(known, ts_unit="ms" if ts_unit is None else ts_unit)


def is_auto(protocol: str | None) -> bool:
    """Return whether a protocol is to be found by the bytes."""
    return isinstance(protocol, str) and protocol.lower() == AUTO


def choose_protocol(protocol: str | None, source: Input) -> tuple[str, str]:
    """Return the protocol of raw bytes, and a remark where "auto" has found it, else "".

    NoProtocolError where it is neither given nor plain.
    """
    if protocol is not None and not is_auto(protocol):
        return protocol, ""
    if source.size is None and is_auto(protocol):
        source.at(0, _AUTO_LEN)
    sample = source.sample()
    if not len(sample) and is_auto(protocol):
        return protocols()[0], "is empty"
    fit = identify(sample)[0] if len(sample) else None
    if fit is None or not is_auto(protocol) or not _is_plain(fit):
        raise _no_protocol(source.name, fit)
    return fit.protocol, f"read as {describe_fit(fit)}"


def _no_protocol(name: str, fit: Fit | None) -> NoProtocolError:
    """Return the error for bytes of which this is the best fit, None where there are none."""
    if fit is None:
        return NoProtocolError(name, "there are no bytes to tell a protocol by", protocols())
    choices = protocols()
    if fit.fits:
        choices = (fit.protocol, AUTO) if _is_plain(fit) else (fit.protocol,)
    return NoProtocolError(name, f"these bytes look like {describe_fit(fit)}", choices)


def describe_doubt(name: str, protocol: str, bytes_in: int, skipped: int, sample: BytesLike) -> str:
    """Say why bytes, of which so many are in no packet, are not of a protocol; "" if they may be.

    `sample`: some of these bytes, by which to tell what they look like.
    """
    if not is_doubtful(protocol, bytes_in, skipped):
        return ""
    fit = identify(sample)[0]
    look = describe_fit(fit) if fit.protocol != protocol else _NOTHING
    return (
        f"{name}: {skipped / bytes_in:.0%} of the {bytes_in:,} bytes are in no "
        f"{protocol} packet; they look like {look}"
    )


def _is_plain(fit: Fit) -> bool:
    return fit.fits and fit.score >= _AUTO_SCORE


def describe_fit(fit: Fit) -> str:
    """Say what bytes look like of which this is the best fit."""
    if fit.fits:
        return f"{fit.protocol} ({fit.score:.0%})"
    return _NOTHING
