"""Only the latest request is answered."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from threading import Event
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from napari_pv_inspect.tasks.latest import BackgroundThread, LatestOnly
from pv_inspect.errors import InspectionError
from tests.waiting import LONG_MS, LONG_S


class Asker:
    """Requests whose answers are noted."""

    def __init__(self, **options: Any) -> None:
        self.answers: list[Any] = []
        self.errors: list[str] = []
        self.requests = LatestOnly(
            self.answers.append, lambda error: self.errors.append(str(error)), **options
        )


class Held:
    """Work that waits to be let go, and counts how often it is done."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer
        self.begun, self.go_on = Event(), Event()
        self.count = 0

    def __call__(self) -> Any:
        self.count += 1
        self.begun.set()
        assert self.go_on.wait(LONG_S)
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


@pytest.fixture
def make(qtbot: QtBot) -> Iterator[Callable[..., Asker]]:
    made: list[Asker] = []

    def make_one(**options: Any) -> Asker:
        made.append(Asker(**options))
        return made[-1]

    yield make_one
    for asker in made:
        asker.requests.close(LONG_S)


def until_idle(asker: Asker, qtbot: QtBot) -> None:
    qtbot.waitUntil(lambda: not asker.requests.busy, timeout=LONG_MS)


def test_a_request_is_answered_in_the_main_thread(make: Any, qtbot: QtBot) -> None:
    asker = make()
    asker.requests.ask(lambda: 3)
    assert asker.requests.busy
    until_idle(asker, qtbot)
    assert asker.answers == [3]


def test_none_is_an_answer_too(make: Any, qtbot: QtBot) -> None:
    asker = make()
    asker.requests.ask(lambda: None)
    until_idle(asker, qtbot)
    assert asker.answers == [None]


def test_a_stale_answer_is_dropped_and_what_waited_is_never_begun(make: Any, qtbot: QtBot) -> None:
    asker = make()
    first, stale, newest = Held("first"), Held("stale"), Held("newest")
    asker.requests.ask(first)
    assert first.begun.wait(LONG_S)
    asker.requests.ask(stale)
    asker.requests.ask(newest)
    for work in (first, stale, newest):
        work.go_on.set()
    until_idle(asker, qtbot)
    assert asker.answers == ["newest"]
    assert (first.count, stale.count, newest.count) == (1, 0, 1)


def test_the_error_of_a_stale_request_is_dropped_as_well(make: Any, qtbot: QtBot) -> None:
    asker = make()
    fails = Held(InspectionError("no"))
    asker.requests.ask(fails)
    assert fails.begun.wait(LONG_S)
    asker.requests.ask(lambda: 1)
    fails.go_on.set()
    until_idle(asker, qtbot)
    assert (asker.answers, asker.errors) == ([1], [])


def test_an_error_is_told_and_the_next_request_is_answered(make: Any, qtbot: QtBot) -> None:
    asker = make(failure="The sum failed")

    def fails() -> None:
        raise ZeroDivisionError("by zero")

    asker.requests.ask(fails)
    until_idle(asker, qtbot)
    assert asker.errors == ["The sum failed (ZeroDivisionError: by zero)."]
    asker.requests.ask(lambda: 1)
    until_idle(asker, qtbot)
    assert asker.answers == [1]


def test_a_burst_of_requests_costs_one(make: Any, qtbot: QtBot) -> None:
    asker = make(delay_ms=30)
    works = [Held(i) for i in range(5)]
    for work in works:
        work.go_on.set()
        asker.requests.ask(work)
    until_idle(asker, qtbot)
    assert asker.answers == [4]
    assert [work.count for work in works] == [0, 0, 0, 0, 1]


def test_a_cancelled_request_is_not_answered_and_a_later_one_is(make: Any, qtbot: QtBot) -> None:
    asker = make()
    cancelled, waiting = Held("cancelled"), Held("waiting")
    asker.requests.ask(cancelled)
    assert cancelled.begun.wait(LONG_S)
    asker.requests.ask(waiting)
    asker.requests.cancel()
    assert not asker.requests.busy
    cancelled.go_on.set()
    waiting.go_on.set()
    asker.requests.ask(lambda: "later")
    until_idle(asker, qtbot)
    assert asker.answers == ["later"]
    assert waiting.count == 0


def test_closing_waits_for_the_work_and_drops_its_answer(make: Any, qtbot: QtBot) -> None:
    asker, ended = make(), Event()
    work = Held("too late")

    def ends() -> Any:
        work()
        ended.set()
        return "too late"

    asker.requests.ask(ends)
    assert work.begun.wait(LONG_S)
    work.go_on.set()
    asker.requests.close(LONG_S)
    assert ended.is_set()
    asker.requests.ask(lambda: "after the end")
    asker.requests.cancel()
    qtbot.wait(20)
    assert (asker.answers, asker.requests.busy) == ([], False)


def test_closing_ends_a_generator_where_it_yields(make: Any, qtbot: QtBot) -> None:
    asker, begun, ended = make(), Event(), Event()

    def endless() -> Generator[None]:
        try:
            while True:
                begun.set()
                yield None
        finally:
            ended.set()

    asker.requests.ask(endless)
    assert begun.wait(LONG_S)
    asker.requests.close(LONG_S)
    assert ended.is_set()


def test_a_generator_brings_all_its_answers(make: Any, qtbot: QtBot) -> None:
    asker = make()
    asker.requests.ask(lambda: (None if i % 2 else i for i in range(6)))
    until_idle(asker, qtbot)
    assert asker.answers == [0, 2, 4]


def test_an_older_request_brings_its_first_answer_where_older_ones_count(
    make: Any, qtbot: QtBot
) -> None:
    asker, begun, go_on = make(older_count=True), Event(), Event()

    def older() -> Generator[int | None]:
        begun.set()
        assert go_on.wait(LONG_S)
        yield None
        yield 1
        yield 2

    asker.requests.ask(older)
    assert begun.wait(LONG_S)
    asker.requests.ask(lambda: 3)
    assert asker.requests.superseded()
    go_on.set()
    until_idle(asker, qtbot)
    assert asker.answers == [1, 3]


def test_on_a_shared_thread_the_first_goes_before_and_interrupts(make: Any, qtbot: QtBot) -> None:
    thread = BackgroundThread()
    first, second = make(thread=thread), make(thread=thread)
    begun, times = Event(), []

    def interrupted() -> Generator[str | None]:
        times.append(len(first.answers))
        begun.set()
        while not urgent.count:
            yield None
        yield "second"

    urgent = Held("first")
    urgent.go_on.set()
    second.requests.ask(interrupted)
    assert begun.wait(LONG_S)
    first.requests.ask(urgent)
    until_idle(second, qtbot)
    assert (first.answers, second.answers) == (["first"], ["second"])
    assert len(times) == 2, "it is begun again"


def test_at_once_a_newer_request_does_not_wait_for_one_that_hangs(make: Any, qtbot: QtBot) -> None:
    asker, hangs = make(at_once=True), Held("old")
    asker.requests.ask(hangs)
    assert hangs.begun.wait(LONG_S)
    asker.requests.ask(lambda: "new")
    until_idle(asker, qtbot)
    assert asker.answers == ["new"]
    hangs.go_on.set()
    qtbot.wait(20)
    assert asker.answers == ["new"]
