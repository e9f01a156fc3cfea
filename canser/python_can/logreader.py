"""Captures as logs of python-can: `can.LogReader` and its tools read them, by their suffix."""

import logging
import warnings
from collections.abc import Iterator
from io import BufferedIOBase
from itertools import starmap
from typing import BinaryIO, Final, cast

import can
import numpy as np
from can.io.generic import BinaryIOMessageReader
from can.typechecking import StringPathLike

from canser._frames import FRAME_DTYPE
from canser.errors import CanserWarning
from canser.files.judge import AUTO
from canser.files.reader import ReadOptions
from canser.files.reading import Blocks, Source
from canser.python_can._messages import to_rows

__all__ = ["CaptureReader"]

_LOG: Final = logging.getLogger("can.canser")

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
        as_is: bool = False,
    ) -> None:
        """Open a capture.

        `file`: a path, or a file open for reading bytes. `protocol`, `ts_unit`, `as_is`,
        warnings and errors as for `canser.blocks`. Without a protocol it is "auto", and the
        log tells which protocol that is: these messages may be sent by `can_player`.
        """
        super().__init__(file)
        self._as_is = as_is
        try:
            options = ReadOptions(
                protocol=protocol or AUTO,
                ts_unit=ts_unit,
                out=np.empty(_BATCH, FRAME_DTYPE),
                as_is=as_is,
            )
            self._blocks = Blocks(cast(Source, self.file), options)
            for finding in self._blocks.notes.found:
                _LOG.warning("%s", finding)
        except BaseException:
            if self.file is not file:
                self.file.close()
            raise

    def __iter__(self) -> Iterator[can.Message]:
        for frames in self._blocks:
            yield from starmap(can.Message, to_rows(frames))
        notes = self._blocks.notes._replace(found=())  # the log has told which protocol it is
        for remark in notes.lines if self._as_is else notes.all_lines:
            warnings.warn(remark, CanserWarning, stacklevel=2)

    def stop(self) -> None:
        """Close the file."""
        self._blocks.close()
        super().stop()
