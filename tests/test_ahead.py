"""Parts that a thread takes ahead: their order, their number, their end."""

import threading
import time
from collections.abc import Callable, Iterator

import pytest

from canser.simulation._ahead import _PARTS, Ahead

# Nothing here takes long; a machine that is busy with other things may.
PATIENCE = 60


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def test_all_parts_come_in_order_and_then_none() -> None:
    ahead = Ahead(part for part in range(100))
    assert [ahead.take(wait=True) for _ in range(100)] == list(range(100))
    assert not ahead.ended
    assert ahead.take(wait=True) is None
    assert ahead.ended
    assert ahead.take(wait=True) is None
    ahead.close()


def test_some_are_taken_ahead_and_no_more() -> None:
    given: list[int] = []

    def parts() -> Iterator[int]:
        for part in range(100):
            given.append(part)
            yield part

    ahead = Ahead(part for part in parts())
    assert given == []
    assert ahead.take(wait=True) == 0
    until(lambda: len(given) == _PARTS + 2)
    time.sleep(0.01)
    assert len(given) == _PARTS + 2
    ahead.close()


def test_what_a_source_fails_at_comes_behind_its_parts() -> None:
    ahead = Ahead(10 // part for part in (2, 1, 0))
    assert [ahead.take(wait=True) for _ in range(2)] == [5, 10]
    with pytest.raises(ZeroDivisionError):
        ahead.take(wait=True)
    assert ahead.ended
    assert ahead.take(wait=True) is None
    ahead.close()


def test_a_source_that_gives_nothing_yet_keeps_no_one() -> None:
    more = threading.Event()
    ahead = Ahead(part for part in range(3) if part == 0 or more.wait(PATIENCE))
    assert ahead.take(wait=True) == 0
    assert ahead.take(wait=False) is None
    assert not ahead.ended
    more.set()
    assert ahead.take(wait=True) == 1
    ahead.close()


def test_its_source_and_its_thread_end_with_it() -> None:
    before, closed = threading.active_count(), threading.Event()

    def parts() -> Iterator[int]:
        try:
            while True:
                yield 1
        finally:
            closed.set()

    ahead = Ahead(part for part in parts())
    assert ahead.take(wait=True) == 1
    ahead.close()
    assert ahead.take(wait=True) is None
    until(lambda: threading.active_count() == before)
    until(closed.is_set)
