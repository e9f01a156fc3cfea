"""Threads that help with jobs: the order of results, errors, the end."""

import threading
import time
from functools import partial
from typing import Any, NoReturn

import pytest

from canser._threads import Helpers


def running(name: str) -> int:
    return sum(each.name == f"canser {name}" for each in threading.enumerate())


def late(result: int, seconds: float) -> int:
    time.sleep(seconds)
    return result


def fail(kind: type[BaseException]) -> NoReturn:
    raise kind("no")


def check_for_long(helpers: Helpers[Any]) -> None:
    for _ in range(1000):
        helpers.check()
        time.sleep(0.01)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_the_order_of_the_jobs(threads: int) -> None:
    with Helpers[int](threads, "order") as helpers:
        for number in range(20):
            helpers.put(partial(late, number, 0.002 * (number % 3)))
        assert len(helpers) == 20
        assert running("order") == threads - 1
        assert [helpers.take() for _ in range(20)] == list(range(20))
        assert not len(helpers)
    assert running("order") == 0


def test_jobs_are_done_side_by_side_and_by_the_caller_too() -> None:
    who = []
    together = threading.Barrier(3, timeout=10)

    def meet() -> None:
        together.wait()
        who.append(threading.current_thread())

    with Helpers[None](3, "meeting") as helpers:
        for _ in range(3):
            helpers.put(meet)
        for _ in range(3):
            helpers.take()
    assert len(set(who)) == 3
    assert threading.current_thread() in who


@pytest.mark.parametrize("threads", [1, 3])
def test_the_error_of_a_job_is_raised_in_its_turn(threads: int) -> None:
    with Helpers[int](threads, "errors") as helpers:
        helpers.put(partial(late, 1, 0))
        helpers.put(partial(fail, ValueError))
        helpers.put(partial(late, 3, 0))
        assert helpers.take() == 1
        with pytest.raises(ValueError, match="no"):
            helpers.take()
        assert helpers.take() == 3


def test_an_error_is_told_before_its_turn_by_check() -> None:
    with Helpers[int](2, "check") as helpers:
        helpers.check()
        helpers.put(partial(fail, ValueError))
        with pytest.raises(ValueError, match="no"):
            check_for_long(helpers)


def test_an_interrupted_caller_ends_at_once() -> None:
    with Helpers[int](1, "interrupted") as helpers:
        helpers.put(partial(fail, KeyboardInterrupt))
        helpers.put(partial(late, 2, 0))
        with pytest.raises(KeyboardInterrupt):
            helpers.take()
    assert running("interrupted") == 0


def test_jobs_that_are_dropped_have_no_results() -> None:
    with Helpers[int](2, "dropped") as helpers:
        for number in range(5):
            helpers.put(partial(late, number, 0.005))
        helpers.drop()
        assert not len(helpers)
        helpers.put(partial(late, 7, 0))
        assert helpers.take() == 7


def test_without_new_threads_the_caller_does_all(monkeypatch: pytest.MonkeyPatch) -> None:
    def start(_: Any) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", start)
    with Helpers[int](4, "alone") as helpers:
        for number in range(5):
            helpers.put(partial(late, number, 0))
        assert [helpers.take() for _ in range(5)] == list(range(5))
