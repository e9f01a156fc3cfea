"""Reading captures by python-can: `can.LogReader` and the tools find this by the suffix."""

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

# The most frames that are decoded at once.
_BATCH: Final = 4096


class CaptureReader(BinaryIOMessageReader):
    """Read the messages of a recording, or of raw bytes, in bounded memory.

    Notes
    -----
    Messages of a recording have epoch seconds. Messages of raw bytes have the times of the device's
    clock in seconds, 0 if the protocol has no clock. Their channel is None, as in messages of
    python-can's own serial buses. The damaged parts of a recording are left out, and a
    `canser.CanserWarning` at the end reports them.

    Examples
    --------
    >>> import can
    >>> message = can.Message(1_700_000_000.0, 0x123, is_extended_id=False, data=[1])
    >>> with can.Logger("run.pcapng", protocol="seeed") as logger:
    ...     logger(message)
    >>> with can.LogReader("run.pcapng") as reader:
    ...     [message.arbitration_id for message in reader]
    [291]
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

        Parameters
        ----------
        file : path, or file open for reading bytes
            The capture.
        protocol : str, default "auto"
            The protocol of the bytes, as for `canser.blocks`. With "auto" the log names the
            protocol that was found, as `can_player` may send these messages.
        ts_unit : {"ms", "us", "ns", "s"}, optional
            Unit of the device's clock, as for `canser.blocks`.
        as_is : bool, default False
            As for `canser.blocks`.

        Notes
        -----
        Warnings and errors are those of `canser.blocks`.
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
        notes = self._blocks.notes._replace(found=())  # the log has named the protocol already
        for remark in notes.lines if self._as_is else notes.all_lines:
            warnings.warn(remark, CanserWarning, stacklevel=2)

    def stop(self) -> None:
        """Close the file."""
        self._blocks.close()
        super().stop()
