"""The newest request wins."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import Event

import pytest

from napari_pv_inspect.tasks.newest_request import NewestWins

LONG = 10.0


@pytest.fixture
def worker() -> Iterator[NewestWins]:
    made = NewestWins("live", "beside")
    yield made
    made.close()


class Task:
    """Work that waits to be let go."""

    def __init__(self, name: str, log: list[str]) -> None:
        self.name, self.log = name, log
        self.begun, self.go_on, self.ended = Event(), Event(), Event()

    def __call__(self, _: Callable[[], bool]) -> bool:
        self.begun.set()
        assert self.go_on.wait(LONG)
        self.log.append(self.name)
        self.ended.set()
        return True


def test_what_waited_is_dropped_for_what_is_newer(worker: NewestWins) -> None:
    log: list[str] = []
    first, stale, newest = (Task(name, log) for name in ("first", "stale", "newest"))
    worker.submit("live", first)
    assert first.begun.wait(LONG)
    worker.submit("live", stale)
    worker.submit("live", newest)
    for task in (first, stale, newest):
        task.go_on.set()
    assert newest.ended.wait(LONG)
    assert log == ["first", "newest"]


def test_the_first_slot_goes_before(worker: NewestWins) -> None:
    log: list[str] = []
    first, beside, live = (Task(name, log) for name in ("first", "beside", "live"))
    worker.submit("live", first)
    assert first.begun.wait(LONG)
    worker.submit("beside", beside)
    worker.submit("live", live)
    for task in (first, beside, live):
        task.go_on.set()
    assert beside.ended.wait(LONG)
    assert log == ["first", "live", "beside"]


def test_what_was_given_up_is_begun_again(worker: NewestWins) -> None:
    log: list[str] = []
    live, begun, done = Task("live", log), Event(), Event()
    live.go_on.set()

    def beside(superseded: Callable[[], bool]) -> bool:
        begun.set()
        while "live" not in log:
            if superseded():
                return False
        log.append("beside")
        done.set()
        return True

    worker.submit("beside", beside)
    assert begun.wait(LONG)
    worker.submit("live", live)
    assert done.wait(LONG)
    assert log == ["live", "beside"]


def test_work_that_fails_does_not_end_the_thread(worker: NewestWins) -> None:
    def fails(_: Callable[[], bool]) -> bool:
        raise RuntimeError("no")

    after = Task("after", [])
    after.go_on.set()
    worker.submit("live", fails)
    worker.submit("beside", after)
    assert after.ended.wait(LONG)


def test_a_closed_worker_tells_its_work_and_takes_no_more() -> None:
    worker, begun, given_up = NewestWins("live"), Event(), Event()

    def endless(superseded: Callable[[], bool]) -> bool:
        begun.set()
        while not superseded():
            pass
        given_up.set()
        return True

    worker.submit("live", endless)
    assert begun.wait(LONG)
    worker.close()
    assert given_up.is_set()
    late = Task("late", [])
    worker.submit("live", late)
    assert not late.begun.wait(0.05)
