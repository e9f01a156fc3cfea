"""Files of frames to send, checked before: false frames would do harm on a bus."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Self

from canser._frames import FrameArray
from canser.codec.decoder import Decoder
from canser.codec.doubt import LEAST_BYTES, is_doubtful
from canser.commands._parser import CallError, DataError
from canser.commands._source import check_found, opened, options_named
from canser.files.fits import identify
from canser.files.formats import RAW
from canser.files.judge import describe_fit, likely
from canser.files.reader import ReadOptions
from canser.files.reading import Blocks

__all__ = ["TrafficFile"]


class TrafficFile(Iterator[FrameArray]):
    """The frames of files that are to be sent; "-" is standard input.

    Raw bytes are read in `options.protocol`. They are checked when they are opened: DataError
    unless they fit the protocol, as `identify` finds from a whole file, or from the first 64 KiB
    of a pipe. Read a file to its end once before sending anything of it: at its end comes a
    DataError if too many of its bytes are in no packet. Each block of a pipe is checked before
    it is returned. `options.as_is` accepts all bytes.

    Several files are one stream, and each is checked; a pipe must be alone. CallError and
    FormatError as from `open_source`.
    """

    def __init__(
        self,
        paths: list[str],
        file_format: str | None,
        options: ReadOptions,
        *,
        sort: bool = False,
    ) -> None:
        options = replace(options, raw_only=True)
        if len(paths) > 1:
            for path in paths:
                if not Path(path).exists() or Path(path).is_dir():
                    continue  # opening it raises an error that says more
                if not Path(path).is_file():
                    raise CallError(f"{path} can be read only once; give it as the only IN")
                TrafficFile([path], file_format, options).__exit__()
        with options_named():
            self.blocks = Blocks(opened(paths), options, format=file_format, sort=sort)
        self.name = ", ".join("standard input" if path == "-" else path for path in paths)
        self._as_is = options.as_is
        self._is_pipe = not Path(paths[0]).is_file()
        self._checked = (0, 0)  # bytes in and bytes skipped when a block was last checked
        try:
            with options_named():
                raw = self.blocks.format == RAW  # waits for the first bytes of a pipe
            if raw and not options.as_is:
                self._check_raw(self.blocks.decoder)
        except BaseException:
            self.blocks.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.blocks.close()

    @property
    def remarks(self) -> tuple[str, ...]:
        """The remarks on the files so far, with their names."""
        return self.blocks.notes.lines

    def _check_raw(self, decoder: Decoder) -> None:
        sample = self.blocks.sample()
        if not len(sample):
            return
        fit = identify(sample)[0]
        if decoder.protocol not in likely(fit):
            raise DataError(
                f"{self.name}: these bytes look like {describe_fit(fit)}, not like "
                f"{decoder.protocol}; none of them are sent; --as-is accepts them"
            )

    def __next__(self) -> FrameArray:
        try:
            frames = next(self.blocks)
        except StopIteration:
            check_found(self.blocks, as_is=self._as_is)
            raise
        if self._is_pipe and self.blocks.stats is not None and not self._as_is:
            self._check_block(self.blocks.decoder)
        return frames

    def _check_block(self, decoder: Decoder) -> None:
        """Raise DataError if the bytes since the last check do not look like the protocol."""
        bytes_in, skipped = decoder.position, decoder.skipped
        came, bad = bytes_in - self._checked[0], skipped - self._checked[1]
        if came < LEAST_BYTES:
            return
        if is_doubtful(decoder.protocol, came, bad):
            raise DataError(
                f"{self.name}: {bad / came:.0%} of the {came:,} bytes up to byte {bytes_in:,} are "
                f"in no {decoder.protocol} packet; frames from there on are not sent; "
                "--as-is accepts them"
            )
        self._checked = bytes_in, skipped
