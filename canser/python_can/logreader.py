"""Captures as logs of python-can: `can.LogReader` and its tools read them, by their suffix."""

import warnings
from collections.abc import Iterator
from contextlib import suppress
from io import BufferedIOBase
from itertools import starmap
from typing import BinaryIO, Final, cast

import can
import numpy as np
from can.io.generic import BinaryIOMessageReader
from can.typechecking import StringPathLike

from canser.captures import Blocks, NoProtocolError, Source, blocks
from canser.errors import CanserWarning
from canser.frames import FRAME_DTYPE
from canser.identify import identify
from canser.python_can._messages import rows

__all__ = ["CaptureReader"]

# What is looked at to tell the protocol of raw bytes.
_SAMPLE: Final = 1 << 20

# Frames that are made messages at a time.
_BATCH: Final = 4096


class CaptureReader(BinaryIOMessageReader):
    """Read the messages of a recording, or of raw bytes, in bounded memory.

    A recording's messages have times of day. Those of raw bytes have the times of the
    device's clock in seconds, and 0 where the format has none. As those of python-can's own
    serial buses they have no channel. What is damaged in a recording is left out, and a
    CanserWarning at the end tells of it.
    """

    def __init__(
        self,
        file: StringPathLike | BinaryIO | BufferedIOBase,
        *,
        protocol: str | None = None,
        ts_unit: str | None = None,
    ) -> None:
        """Open a capture.

        `file`: a path, or a file open for reading bytes. `protocol`, `ts_unit` as for
        `canser.blocks`; raw bytes are looked at if there is no protocol, as by
        `canser.identify`.

        NoProtocolError, a ValueError, for bytes of which nobody knows the protocol;
        RecordingError for pcapng that is none of canser's; OSError for a file that cannot
        be read.
        """
        super().__init__(file)
        self._name = str(getattr(self.file, "name", "the file"))
        try:
            self._blocks = self._open(protocol, ts_unit)
        except BaseException:
            if self.file is not file:
                self.file.close()
            raise

    def _open(self, protocol: str | None, ts_unit: str | None) -> Blocks:
        source = cast(Source, self.file)
        room = np.empty(_BATCH, FRAME_DTYPE)
        start = None
        with suppress(OSError):  # a pipe cannot be looked at and then read
            start = self.file.tell()
        try:
            return blocks(source, protocol, ts_unit=ts_unit, out=room)
        except NoProtocolError:
            if start is None:
                raise
        self.file.seek(start)
        sample = self.file.read(_SAMPLE)
        self.file.seek(start)
        best = identify(sample)[0]
        if sample and not best.fits:
            raise NoProtocolError(
                f"{self._name} is no recording, and these bytes are of no protocol known here: "
                f"{best.protocol} comes closest, with {best.explained:.0%} of them in frames "
                f"and {best.chance:.0%} expected by chance; give protocol="
            )
        return blocks(source, best.protocol, ts_unit=ts_unit, out=room)

    def __iter__(self) -> Iterator[can.Message]:
        for frames in self._blocks:
            yield from starmap(can.Message, rows(frames))
        for remark in self._blocks.remarks:
            warnings.warn(f"{self._name}: {remark}", CanserWarning, stacklevel=2)

    def stop(self) -> None:
        """Close the file."""
        self._blocks.close()
        super().stop()
