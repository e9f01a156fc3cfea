"""Choose the protocol of raw bytes, and doubt it if too many bytes were skipped."""

from typing import Final

from canser._core.buffers import BytesLike
from canser._input import Input
from canser._protocols import protocols
from canser.codec.decoder import Decoder
from canser.codec.doubt import has_marks, is_doubtful
from canser.errors import NoProtocolError
from canser.files.fits import Fit, identify

__all__ = [
    "AUTO",
    "check_protocol",
    "choose_protocol",
    "describe_doubt",
    "describe_fit",
    "is_auto",
    "is_surely",
    "likely",
]

# The name that stands for the protocol that fits best, if its score (`Fit.score`) is at least
# `_AUTO_SCORE`. Captures of real adapters score 0.98 and more. A line that damages 1 byte in 100
# scores 0.75.
AUTO: Final = "auto"
_AUTO_SCORE: Final = 0.9

# Bytes of a pipe to wait for before its protocol is chosen: 1.4 s of the slowest adapter's line.
_AUTO_LEN: Final = 1 << 14

# Frames without a gap that are no accident.
_FEW: Final = 8

_NOTHING: Final = "no protocol that canser knows"


def check_protocol(protocol: str | None, ts_unit: str | None) -> None:
    """Raise ValueError for a protocol or a unit that does not exist, TypeError for no text."""
    known = protocols()[0] if protocol is None or is_auto(protocol) else protocol
    Decoder(known, ts_unit="ms" if ts_unit is None else ts_unit)


def is_auto(protocol: str | None) -> bool:
    """Return whether the protocol is to be chosen by the bytes."""
    return isinstance(protocol, str) and protocol.lower() == AUTO


def choose_protocol(protocol: str | None, source: Input) -> tuple[str, str]:
    """Return the protocol of raw bytes, and a remark if "auto" has found it, otherwise "".

    NoProtocolError if no protocol is given, or "auto" finds none that fits well enough.
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


def is_surely(protocol: str, head: bytes) -> bool:
    """Return whether the first bytes of a file are raw bytes of a protocol beyond doubt.

    They are packets without a gap. Other bytes may be as well where packets have no marks.
    """
    if not has_marks(protocol):
        return False
    decoder = Decoder(protocol)
    return len(decoder.feed(head)) > _FEW and not decoder.stats.bytes_skipped


def _no_protocol(name: str, fit: Fit | None) -> NoProtocolError:
    """Return the error for bytes with this best fit; `fit` is None if there are no bytes."""
    if fit is None:
        return NoProtocolError(name, "there are no bytes to tell a protocol by", protocols())
    choices = likely(fit) or protocols()
    if _is_plain(fit):
        choices = (fit.protocol, AUTO)
    return NoProtocolError(name, f"these bytes look like {describe_fit(fit)}", choices)


def describe_doubt(name: str, protocol: str, bytes_in: int, skipped: int, sample: BytesLike) -> str:
    """Return why bytes are not of a protocol, "" if they may be.

    `skipped`: the bytes in no packet. `sample`: some of the bytes, to name what they look like.
    """
    if not is_doubtful(protocol, bytes_in, skipped):
        return ""
    fit = identify(sample)[0]
    look = describe_fit(fit) if protocol not in likely(fit) else _NOTHING
    return (
        f"{name}: {skipped / bytes_in:.0%} of the {bytes_in:,} bytes are in no "
        f"{protocol} packet; they look like {look}"
    )


def _is_plain(fit: Fit) -> bool:
    return fit.fits and fit.score >= _AUTO_SCORE


def likely(fit: Fit) -> tuple[str, ...]:
    """Return the protocols that bytes may be of which this is the best fit."""
    return (fit.protocol, *fit.rivals) if fit.fits or fit.rivals else ()


def describe_fit(fit: Fit) -> str:
    """Return what bytes with this best fit look like."""
    if fit.fits:
        return f"{fit.protocol} ({fit.score:.0%})"
    return " or ".join(likely(fit)) or _NOTHING
