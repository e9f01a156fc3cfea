"""Writing recordings by python-can: `can.Logger` and the tools find this by the suffix."""

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

# Messages that are gathered before they are written.
_BATCH: Final = 512


class CaptureWriter(BinaryIOMessageWriter):
    """Write messages into a recording, as the bytes that an adapter would send for them.

    Notes
    -----
    A message that the protocol cannot carry is left out, such as an error frame in most protocols.
    A `canser.CanserWarning` at the end counts these messages. Times are kept to 2 ms; times of the
    protocol's own clock are kept exactly.

    Examples
    --------
    >>> import can
    >>> message = can.Message(1_700_000_000.0, 0x123, is_extended_id=False, data=[1])
    >>> with can.Logger("run.pcapng", protocol="seeed") as logger:
    ...     logger(message)
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
            The recording. An open file must have a descriptor.
        protocol : str, default "serial"
            The protocol of the bytes: a name of `canser.protocols()`.
        ts_unit : {"ms", "us", "ns", "s"}, default "ms"
            Unit of the times in the bytes, if the protocol has a clock.
        **options
            Options of python-can for other formats; they mean nothing here.
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
        """Write a message, or keep it until more have come."""
        self._messages.append(msg)
        if len(self._messages) == _BATCH:
            self._flush()

    def _flush(self) -> None:
        messages, self._messages = self._messages, []
        if messages:
            self._recording.write(make_frames(messages))

    def stop(self) -> None:
        """Write the messages that are kept, and close the file."""
        try:
            self._flush()
            for remark in self._recording.finish():
                text = f"{getattr(self.file, 'name', 'the file')}: {remark}"
                warnings.warn(text, CanserWarning, stacklevel=2)
        finally:
            super().stop()
