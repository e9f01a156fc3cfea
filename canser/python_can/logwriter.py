"""Recordings as logs of python-can: `can.Logger` and its tools write them, by their suffix."""

import warnings
from io import BufferedIOBase
from typing import Any, BinaryIO, Final, cast

import can
from can.io.generic import BinaryIOMessageWriter
from can.typechecking import StringPathLike

from canser._items import frames as make_frames
from canser.errors import CanserWarning
from canser.files.recordings import RecordingFile
from canser.files.writer import WriteOptions

__all__ = ["CaptureWriter"]

# Messages that are written at a time.
_BATCH: Final = 512


class CaptureWriter(BinaryIOMessageWriter):
    """Write messages into a recording, as the bytes that an adapter would send for them.

    A message that the protocol cannot carry, such as an error frame in most, is left out, and a
    CanserWarning at the end counts them. Times are kept to 2 ms, and those of the protocol's
    own clock exactly.
    """

    def __init__(
        self,
        file: StringPathLike | BinaryIO | BufferedIOBase,
        *,
        protocol: str = "serial",
        ts_unit: str = "ms",
        **options: Any,
    ) -> None:
        """Begin a recording.

        Parameters
        ----------
        file : path, or file open for writing bytes
            A file that has a descriptor.
        protocol : str
            Of the bytes, a name of `canser.protocols()`.
        ts_unit : str
            Unit of the times in the bytes, where the protocol has them.
        options
            Of python-can, for other formats; they mean nothing here.
        """
        settings = WriteOptions(protocol=protocol, ts_unit=ts_unit)
        super().__init__(file, **options)
        try:
            self._recording = RecordingFile(cast(BinaryIO, self.file), settings)
        except BaseException:
            if self.file is not file:
                self.file.close()
            raise
        self._messages: list[can.Message] = []

    def on_message_received(self, msg: can.Message) -> None:
        """Take a message."""
        self._messages.append(msg)
        if len(self._messages) == _BATCH:
            self._flush()

    def _flush(self) -> None:
        messages, self._messages = self._messages, []
        if messages:
            self._recording.write(make_frames(messages))

    def stop(self) -> None:
        """Write the end, and close the file."""
        try:
            self._flush()
            for remark in self._recording.finish():
                text = f"{getattr(self.file, 'name', 'the file')}: {remark}"
                warnings.warn(text, CanserWarning, stacklevel=2)
        finally:
            super().stop()
