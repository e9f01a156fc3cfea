"""Sending frames to a port, and counting those that the line has certainly sent."""

import argparse
import time
from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np

from canser._frames import FrameArray, copy_records
from canser.codec.decoder import decode, encode
from canser.commands._parser import DataError
from canser.errors import PortError, SendError, SendTimeoutError
from canser.live.ports import Port

__all__ = ["Sender", "pace_argument"]

# A line that takes or sends no byte for this time is taken to be broken.
_PATIENCE_S: Final = 10.0

# Interval at which the progress of a slow line is checked, and `wanted` is called.
_LOOK_S: Final = 0.1


def pace_argument(parser: argparse.ArgumentParser) -> None:
    """Add the argument that switches pacing off."""
    parser.add_argument(
        "--no-pace",
        dest="pace",
        action="store_false",
        help="send as fast as the serial line takes frames; an adapter throws away frames for "
        "which it has no room (default, if --bitrate configures the adapter: at most 16 frames "
        "ahead of what the bus carries)",
    )


class Sender:
    """Send frames to a port; DataError, with the counts, if the line does not send them.

    `wanted`: returns whether to go on; called ten times a second. `pace`: as for `Port.send`.
    `sent`: the number of frames that the line has certainly sent. Frames that the system still
    holds are not counted. A pseudo terminal does not report the bytes that it holds, so all
    bytes that it has taken count as sent.
    """

    def __init__(
        self, port: Port, wanted: Callable[[], bool] = lambda: True, *, pace: bool = True
    ) -> None:
        self._port, self._wanted, self._pace = port, wanted, pace
        self.sent = 0
        # Frames that the line has taken and perhaps not sent: their number and bytes, per call.
        self._held: deque[tuple[int, bytes]] = deque()
        self._held_len = self._unsent_len = 0

    def wait_listening(self) -> None:
        """Wait until the adapter listens, or until `wanted` returns False."""
        while self._wanted():
            try:
                self._port.send([], timeout=_LOOK_S)
            except SendTimeoutError:
                continue
            except PortError:
                pass  # sending the first frame reports the error
            return

    def send(self, frames: FrameArray) -> None:
        """Send frames; return when the line has taken them, or when `wanted` returns False."""
        moved_at = time.monotonic()
        while len(frames) and self._wanted():
            try:
                count = self._port.send(frames, timeout=_LOOK_S, pace=self._pace)
            except SendTimeoutError as error:
                count = error.sent
            except SendError as error:
                self._add(frames[: error.sent])
                raise self._failed(f"{self._port.url}: {error.reason}") from None
            except PortError as error:
                raise self._failed(str(error)) from None
            self._add(frames[:count])
            frames = frames[count:]
            if count:
                moved_at = time.monotonic()
            elif time.monotonic() - moved_at >= _PATIENCE_S:
                raise self._failed(f"{self._port.url} took nothing for {_PATIENCE_S:g} s")

    def drain(self) -> None:
        """Wait until the line has sent all bytes that it has taken."""
        moved_at, unsent_len = time.monotonic(), self._unsent_len
        try:
            while not self._port.drain(timeout=_LOOK_S):
                self._look()
                if self._unsent_len < unsent_len:
                    moved_at, unsent_len = time.monotonic(), self._unsent_len
                elif time.monotonic() - moved_at >= _PATIENCE_S:
                    raise self._failed(f"{self._port.url} sent nothing for {_PATIENCE_S:g} s")
        except PortError as error:
            raise self._failed(str(error)) from None
        self._look()

    def _add(self, frames: FrameArray) -> None:
        """Keep the bytes of frames that the line has taken."""
        if len(frames):
            timed = copy_records(frames)
            timed["ts"] = 0  # as a port does; a frame without a time cannot be encoded
            raw = encode(timed, self._port.protocol)
            self._held.append((len(frames), raw))
            self._held_len += len(raw)
            self._unsent_len += len(raw)
            self._look()

    def _look(self) -> None:
        """Update the counters by what the line has sent; keep them if the line is gone."""
        try:
            self._unsent_len = min(self._port.bytes_unsent, self._held_len)
        except PortError:
            return
        while self._held and self._held_len - len(self._held[0][1]) >= self._unsent_len:
            count, raw = self._held.popleft()
            self.sent += count
            self._held_len -= len(raw)

    def _failed(self, why: str) -> DataError:
        self._look()
        sent, waiting = self.sent, sum(count for count, _ in self._held)
        if self._held:
            _, raw = self._held[0]
            starts = np.empty(len(raw), np.int64)
            count = len(decode(raw, self._port.protocol, offsets=starts))
            ends = np.append(starts[1:count], len(raw))
            whole = int(np.searchsorted(ends, self._held_len - self._unsent_len, side="right"))
            sent, waiting = sent + whole, waiting - whole
        return DataError(
            f"{why}; frames sent for sure: {sent:,}, "
            f"taken by the line but not known to be sent: {waiting:,}"
        )
