"""Frames that are to be sent: judged before they go out, for false ones do harm on a bus."""

from pathlib import Path

from canser._frames import FrameArray
from canser.codec.doubt import LEAST_BYTES, is_doubtful
from canser.commands._parser import DataError
from canser.commands._source import check_found, options_named
from canser.files.fits import identify
from canser.files.frame_file import FrameFile, format_of
from canser.files.judge import describe_fit

__all__ = ["TrafficFile"]


class TrafficFile(FrameFile):
    """A file of frames to send, "-" for the standard input; raw bytes are of `protocol`.

    What raw bytes are is judged when they are opened: DataError unless they fit the protocol, as
    `identify` tells by all of a file, or by the first 64 KiB of a pipe. A file should be read to
    its end once before anything of it is sent: at the end comes a DataError if too many of its
    bytes lie in no packet. Of a pipe each block is judged before it is handed on.
    `as_is` accepts all. CallError, FormatError as from `open_source`.
    """

    def __init__(
        self, path: str, file_format: str | None, *, protocol: str, ts_unit: str, as_is: bool
    ) -> None:
        with options_named():
            super().__init__(
                path,
                format_of(path, file_format),
                protocol=protocol,
                ts_unit=ts_unit,
                as_is=as_is,
                raw_only=True,
            )
        self._as_is = as_is
        self._is_pipe = not Path(path).is_file()
        self._judged = (0, 0)  # bytes in and bytes skipped when a block was last judged
        if self.decoder is None or self.recording is not None or as_is:
            return
        try:
            self._judge_raw()
        except BaseException:
            self.__exit__()
            raise

    def _judge_raw(self) -> None:
        assert self.decoder is not None
        sample = self.sample()
        if not len(sample):
            return
        fit = identify(sample)[0]
        if not fit.fits or fit.protocol != self.decoder.protocol:
            raise DataError(
                f"{self.name}: these bytes look like {describe_fit(fit)}, not like "
                f"{self.decoder.protocol}; nothing of them is sent; --as-is accepts them"
            )

    def __next__(self) -> FrameArray:
        try:
            frames = super().__next__()
        except StopIteration:
            check_found(self, as_is=self._as_is)
            raise
        if self._is_pipe and self.decoder is not None and not self._as_is:
            self._judge_block()
        return frames

    def _judge_block(self) -> None:
        """Raise DataError if the bytes since the last block are not of the protocol."""
        assert self.decoder is not None
        bytes_in, skipped = self.decoder.position, self.decoder.skipped
        came, bad = bytes_in - self._judged[0], skipped - self._judged[1]
        if came < LEAST_BYTES:
            return
        if is_doubtful(self.decoder.protocol, came, bad):
            raise DataError(
                f"{self.name}: {bad / came:.0%} of the {came:,} bytes up to byte {bytes_in:,} are "
                f"in no {self.decoder.protocol} packet; frames from there on are not sent; "
                "--as-is accepts them"
            )
        self._judged = bytes_in, skipped
