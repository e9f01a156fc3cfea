"""Setting an adapter up: its configuration, then status requests until it answers.

Otherwise the first frames of a program would be lost: an analyzer does not listen for 0.7 s after
it was opened or plugged in, and swallows the first packet behind its configuration (both seen on
hardware).
"""

import time
from collections.abc import Callable
from typing import Final

from canser import adapters
from canser._core.table import find_protocol
from canser.codec.decoder import Decoder

__all__ = ["SILENCE_S", "Setup"]

# The interval of the status requests, and the pause between the configuration and the first one:
# the pause that the adapter's document asks for.
_ASK_EVERY_S: Final = 0.1

#: An adapter that has not answered within this time is never asked again.
SILENCE_S: Final = 2.0

# An analyzer does not listen for this time after it was opened or plugged in (seen on hardware).
_DEAF_S: Final = 0.7

# Answers are taken until this time after the adapter was found to listen. Later ones are not
# waited for.
_LATE_S: Final = 1.0

# The pause before another try, if the line took nothing or another thread was writing.
_BUSY_S: Final = 0.01


class Setup:
    """The configuration of an adapter, and whether the adapter listens by now.

    Each thread that writes `config_packet` calls `start` after it. The thread that reads the line
    calls `step` and `take` while the setup is `active`. Without a configuration, or if the protocol
    has no status request, the adapter is not asked, and is taken to listen.

    The adapter is asked every 0.1 s. If it answers the first request, it listens. If it answers a
    later one, it may have missed its configuration: the configuration is written again, and the
    adapter is asked again. The same is done if the adapter was still being asked after an earlier
    configuration, as it may have swallowed the packet behind that one. An adapter that did not
    answer for 2 s is never asked again: from then on it is taken to listen 0.7 s after each
    configuration.
    """

    def __init__(self, protocol: str, config_packet: bytes) -> None:
        self.config_packet = config_packet  # b"" leaves the adapter as it is
        self._protocol = protocol
        self._request = find_protocol(protocol).status_request
        self._asking: _Asking | None = None
        self._silent = False  # the adapter did not answer, and is not asked any more
        self._silence_taken = False
        self._answers: set[int] = set()  # the stream offsets of answers that are not decoded yet

    @property
    def asks(self) -> bool:
        """Whether the adapter has to be asked, or waited for, after its configuration."""
        return bool(self.config_packet and self._request)

    @property
    def listening(self) -> bool:
        """Whether the adapter listens, as far as is known."""
        asking = self._asking
        return asking is None or asking.listening

    @property
    def active(self) -> bool:
        """Whether `step` and `take` have to be called."""
        asking = self._asking
        return asking is not None and not asking.over

    def start(self) -> None:
        """Start anew: the configuration was written just now."""
        if self.asks:
            doubtful = not self.listening
            self._asking = _Asking(
                self._protocol, time.monotonic(), asks=not self._silent, doubtful=doubtful
            )

    def step(self, now: float, write: Callable[[bytes], bool]) -> float | None:
        """Write the packet that is due; return the seconds until the next step, None for never.

        `now`: of time.monotonic(). `write` returns False if the line takes nothing just now.
        """
        asking = self._asking
        if asking is None or asking.over:
            return None
        if not asking.listening:
            self._advance(asking, now, write)
        if asking.listening and (asking.answered >= asking.asked or now >= asking.next_at):
            asking.over = True
            return None
        return max(asking.next_at - now, 0)

    def take(self, data: memoryview, offset: int | None) -> None:
        """Look for answers in bytes that came.

        `offset`: the stream offset of the first byte; None if the bytes are thrown away.
        """
        asking = self._asking
        if asking is None:
            return
        decoder = asking.decoder
        shift = None if offset is None else offset - decoder.position
        decoder.feed(data)
        for control in decoder.take_controls():
            if adapters.report(self._protocol, control.data).kind != "status":
                continue
            if asking.answered < asking.asked:
                asking.answered += 1
                if shift is not None:
                    self._answers.add(control.offset + shift)

    def end(self) -> None:
        """Take no more statuses for answers: from now on they answer another caller."""
        if self._asking is not None and self._asking.listening:
            self._asking.over = True

    def take_answer(self, offset: int) -> bool:
        """Return whether the control packet at this offset is an answer, once."""
        if offset not in self._answers:
            return False
        self._answers.discard(offset)
        return True

    def take_silence(self) -> bool:
        """Return whether the adapter did not answer, once."""
        was_taken, self._silence_taken = self._silence_taken, self._silent
        return self._silent and not was_taken

    def _advance(self, asking: "_Asking", now: float, write: Callable[[bytes], bool]) -> None:
        if asking.heard:
            if asking.again or (asking.asked == 1 and not asking.doubtful):
                asking.listen(now)
            elif write(self.config_packet):
                asking.begin(now)
                asking.again = True
            else:
                asking.next_at = now + _BUSY_S
        elif now >= asking.end_at:
            self._silent = self._silent or not asking.again
            asking.listen(now)
        elif now >= asking.next_at:
            if write(self._request):
                asking.asked += 1
            asking.next_at = min(now + _ASK_EVERY_S, asking.end_at)


class _Asking:
    """The requests after a configuration, also one that is written twice, and their answers.

    One thread changes it.
    """

    def __init__(self, protocol: str, now: float, *, asks: bool, doubtful: bool) -> None:
        self.decoder = Decoder(protocol)
        self.doubtful = doubtful  # the adapter may have swallowed this configuration
        self.asked = self.answered = 0  # how often
        self.again = False  # the configuration was written a second time
        self.listening = self.over = False
        self.begin(now)
        if not asks:
            self.next_at = self.end_at = now + _DEAF_S

    def begin(self, now: float) -> None:
        """Start to ask: the configuration was written just now."""
        self._asked_before, self._answered_before = self.asked, self.answered
        self.next_at, self.end_at = now + _ASK_EVERY_S, now + SILENCE_S

    @property
    def heard(self) -> bool:
        """Whether a request and an answer have followed the last configuration."""
        return self.answered > self._answered_before and self.asked > self._asked_before

    def listen(self, now: float) -> None:
        """Note that the adapter listens; answers to other requests may still come."""
        self.listening, self.next_at = True, now + _LATE_S
