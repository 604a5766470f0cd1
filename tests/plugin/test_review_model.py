"""State of the review without Qt: what is stored, when, and what the gallery lists."""

from __future__ import annotations

from collections.abc import Callable, Generator
from pathlib import Path
from threading import Event
from time import sleep
from typing import Any

import numpy as np
import pytest

from napari_pv_inspect.models.history import History
from napari_pv_inspect.review.journal import Journal
from napari_pv_inspect.review.model import ReviewModel
from napari_pv_inspect.review.subject import Subject
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.review import ModuleData, Order, ReviewState, ReviewStore, Verdict, VerdictKind
from tests.waiting import LONG_S, wait_until

OK, A, C = VerdictKind.OK, VerdictKind.CRACK_A, VerdictKind.CRACK_C


class Disk:
    """Stores that fail while the disk is full."""

    def __init__(self) -> None:
        self.full = False
        self.slow_s = 0.0

    def open(self, folder: Path) -> ReviewStore:
        return _Store(folder, self)


class _Store(ReviewStore):
    def __init__(self, folder: Path, disk: Disk) -> None:
        super().__init__(folder)
        self._disk = disk

    def give(self, verdict: Verdict) -> int:
        sleep(self._disk.slow_s)
        if self._disk.full:
            raise InspectionError("Nothing more can be stored: the disk is full.")
        return super().give(verdict)


@pytest.fixture
def disk() -> Disk:
    return Disk()


@pytest.fixture
def subject(tiny_inspection: Inspection) -> Subject:
    found = Subject.of_inspection(tiny_inspection)
    assert found is not None
    return found


@pytest.fixture
def make(disk: Disk, subject: Subject) -> Generator[Callable[..., ReviewModel]]:
    made: list[ReviewModel] = []

    def journal(*calls: Any) -> Journal:
        return Journal(*calls, open_store=disk.open, retry_s=0.05, poll_s=0.05)

    def make(rater: str = "Ada") -> ReviewModel:
        review = ReviewModel(History(), rater, journal)
        review.show(subject)
        made.append(review)
        return review

    yield make
    for review in made:
        review.close()


def settle(review: ReviewModel, until: Callable[[], bool] = lambda: True) -> None:
    assert review.wait(LONG_S)
    wait_until(until, review.collect)


def test_a_verdict_is_shown_at_once_and_then_stored(make: Any, tmp_path: Path) -> None:
    review = make()
    review.attach(tmp_path)
    review.write_note((1, 2), "long one")
    review.give((1, 2), C)
    assert review.verdict((1, 2)).kind is C
    settle(review)
    assert not review.is_pending((1, 2))
    (stored,) = ReviewStore(tmp_path).current()
    assert (stored.cell, stored.kind, stored.rater) == ((1, 2), C, "Ada")
    assert stored.note == "long one"
    assert len(stored.settings) == 12


def test_undo_and_redo_are_those_of_the_store(make: Any, tmp_path: Path) -> None:
    review = make()
    history = review._history
    review.attach(tmp_path)
    review.give((0, 0), OK)
    review.give((0, 0), A)
    history.undo()
    settle(review)
    assert review.verdict((0, 0)).kind is OK
    history.undo()
    settle(review)
    assert review.verdict((0, 0)) is None
    assert ReviewStore(tmp_path).current() == ()
    history.redo()
    history.redo()
    settle(review)
    assert review.verdict((0, 0)).kind is A
    assert [e.action for e in ReviewStore(tmp_path).history()] == [
        "edit", "edit", "undo", "undo", "redo", "redo",
    ]  # fmt: skip


def test_what_was_judged_before_there_is_a_folder_goes_into_it(make: Any, tmp_path: Path) -> None:
    review = make()
    asked: list[str] = []
    review.folder_wanted.connect(asked.append)
    review.give((0, 0), OK)
    review.give((0, 1), A)
    assert len(asked) == 1
    assert review.pending == 2
    assert not review.wait(0.01)
    review.attach(tmp_path)
    settle(review)
    assert [v.kind for v in ReviewStore(tmp_path).current()] == [OK, A]


def test_a_full_disk_is_one_sentence_and_keeps_all_until_there_is_room(
    make: Any, disk: Disk, tmp_path: Path
) -> None:
    review = make()
    sentences: list[str] = []
    review.failed.connect(sentences.append)
    review.attach(tmp_path)
    settle(review)
    disk.full = True
    review.give((0, 0), A)
    review.give((0, 1), OK)
    assert not review.wait(0.4)
    assert len(sentences) == 1
    assert review.is_failing
    assert review.is_pending((0, 0))
    assert review.verdict((0, 0)).kind is A
    disk.full = False
    settle(review)
    assert [v.kind for v in ReviewStore(tmp_path).current()] == [A, OK]
    assert review.pending == 0


def test_another_rater_appears_and_does_not_count_as_mine(make: Any, tmp_path: Path) -> None:
    mine, other = make("Ada"), make("Ben")
    mine.attach(tmp_path)
    other.attach(tmp_path)
    mine.give((0, 0), OK)
    settle(mine)
    settle(other, lambda: bool(other.others((0, 0))))
    assert other.verdict((0, 0)) is None
    other.give((0, 0), C)
    settle(other)
    settle(mine, lambda: bool(mine.others((0, 0))))
    assert [v.kind for v in mine.others((0, 0))] == [C]
    assert mine.verdict((0, 0)).kind is OK
    assert mine.progress.text == "1 of 12 cells judged"
    other.set_rater("Ada")
    settle(other)
    assert other.verdict((0, 0)).kind is OK


def test_filter_and_order_list_the_cells(make: Any, tmp_path: Path) -> None:
    review = make()
    review.attach(tmp_path)
    assert review.listed == tuple((r, c) for r in range(3) for c in range(4))
    review.give((1, 1), C)
    review.give((2, 3), OK)
    review.set_filter(tuple(VerdictKind))
    assert review.listed == ((1, 1), (2, 3))
    review.set_filter((OK,))
    assert review.listed == ((2, 3),)
    review.set_filter((None,))
    assert len(review.listed) == 10
    review.set_order(Order.CRACK_SCORE)
    scores = [review.features(cell).crack_score for cell in review.listed]
    assert scores == sorted(scores, reverse=True)


def test_next_is_the_following_listed_cell_without_a_verdict(make: Any) -> None:
    review = make()
    review.set_filter((None,))
    review.give((0, 1), OK)
    review.give((0, 0), OK)
    assert review.next_unjudged((0, 0)) == (0, 2)
    assert review.next_unjudged((2, 3)) == (0, 2)


def test_corrected_marks_change_length_are_stored_and_undone(make: Any, tmp_path: Path) -> None:
    review = make()
    review.attach(tmp_path)
    before = review.features((1, 1)).crack_length_cells
    mask = np.zeros_like(review.marks((1, 1)))
    row = len(mask) // 2
    mask[row : row + 2, 4:-4] = True
    review.correct((1, 1), mask)
    np.testing.assert_array_equal(review.marks((1, 1)), mask)
    settle(review)
    after = review.features((1, 1)).crack_length_cells
    expected = (mask.shape[1] - 8) / review.subject.tiles.grid.pixels_per_unit
    assert after == pytest.approx(expected, rel=0.1)
    assert after != before
    np.testing.assert_array_equal(ReviewStore(tmp_path).mask((1, 1), "Ada"), mask)
    review.give((1, 1), A)
    settle(review)
    (stored,) = ReviewStore(tmp_path).current()
    assert stored.crack_length_cells == pytest.approx(after)
    review._history.undo()
    review._history.undo()
    settle(review)
    assert review.correction((1, 1)) is None
    assert review.features((1, 1)).crack_length_cells == before


def test_opening_again_brings_verdicts_marks_module_data_and_the_cell(
    make: Any, tmp_path: Path
) -> None:
    first = make()
    first.attach(tmp_path)
    first.give((2, 0), C)
    first.correct((2, 0), np.eye(*first.marks((2, 0)).shape, dtype=bool))
    first.describe(ModuleData("S1", 8.5))
    first.remember((2, 1))
    settle(first)
    second = make()
    places: list[Any] = []
    second.remembered.connect(places.append)
    second.attach(tmp_path)
    length = first.features((2, 0)).crack_length_cells
    settle(second, lambda: second.features((2, 0)).crack_length_cells == pytest.approx(length))
    assert second.verdict((2, 0)).kind is C
    assert second.correction((2, 0)) is not None
    assert second.module_data == ModuleData("S1", 8.5)
    assert places == [(2, 1)]
    assert ReviewStore(tmp_path).remembered("Ada") == ReviewState("Ada", 2, 1)


def test_a_save_into_another_folder_takes_the_verdicts_along(make: Any, tmp_path: Path) -> None:
    review = make()
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    review.attach(first)
    review.give((0, 0), A)
    settle(review)
    review.attach(second)
    settle(review)
    assert [v.kind for v in ReviewStore(second).current()] == [A]
    assert review.verdict((0, 0)).kind is A


def test_leaving_a_module_stores_what_is_pending(
    make: Any, disk: Disk, subject: Subject, tmp_path: Path
) -> None:
    review = make()
    review.attach(tmp_path)
    disk.slow_s = 0.05
    for col in range(4):
        review.give((0, col), OK)
    review.show(None)
    assert review.verdict((0, 0)) is None
    settle(review)
    assert len(ReviewStore(tmp_path).current()) == 4


def test_without_a_folder_nobody_asks_the_store_also_after_a_failure(tmp_path: Path) -> None:
    said: list[str] = []
    asked, tried, done = Event(), Event(), Event()
    journal = Journal(said.append, lambda _: asked.set(), lambda _: None, retry_s=0.01, poll_s=0.01)

    def fail() -> None:
        tried.set()
        raise ValueError("no features")

    journal.later(fail, lambda _: None)
    assert tried.wait(5)
    assert not asked.wait(0.2)
    journal.later(done.set, lambda _: None)
    assert done.wait(5)
    journal.attach(tmp_path, lambda _: None, lambda _: None)
    assert journal.wait(5)
    journal.collect()
    assert said == ["The review can't be stored (ValueError: no features)."]
    journal.close(give_up=True)


def test_what_has_time_waits_for_what_has_to_be_stored(tmp_path: Path) -> None:
    seen: list[str] = []
    journal = Journal(lambda _: None, lambda _: None, lambda _: None, poll_s=0.01)
    go_on = Event()
    journal.attach(tmp_path, lambda _: go_on.wait(LONG_S), lambda _: None)
    journal.later(lambda: seen.append("later"), lambda _: None)
    journal.submit(lambda _: seen.append("stored"), lambda _: None)
    assert journal.pending == 2
    go_on.set()
    assert journal.wait(LONG_S)
    wait_until(lambda: len(seen) == 2)
    assert seen == ["stored", "later"]
    journal.close(give_up=True)


def test_jobs_keep_their_order(tmp_path: Path) -> None:
    seen: list[int] = []
    gate = Event()
    journal = Journal(lambda _: None, lambda _: None, lambda _: None, poll_s=0.01)
    for k in range(20):
        journal.submit(lambda _, k=k: gate.wait(5) and seen.append(k), lambda _: None)
    journal.attach(tmp_path, lambda _: seen.append(-1), lambda _: None)
    gate.set()
    assert journal.wait(5)
    assert seen == list(range(-1, 20))
    journal.close(give_up=True)


def test_a_verdict_given_right_after_an_undo_stays_in_sight_and_goes_along(
    make: Any, tmp_path: Path
) -> None:
    """The answer of the store to the undo comes when the next verdict is given already."""
    review = make()
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    review.attach(first)
    review.give((0, 0), A)
    review._history.undo()
    assert review.verdict((0, 0)) is None
    review.give((0, 0), A)
    review.give((0, 1), A)
    review._history.undo()
    review.give((0, 1), C)
    settle(review)
    assert [review.verdict((0, col)).kind for col in range(2)] == [A, C]
    review.give((0, 2), OK)
    review._history.undo()
    review.attach(second)
    settle(review)
    for folder in (first, second):
        assert [v.kind for v in ReviewStore(folder).current()] == [A, C]


def test_undo_while_nothing_is_stored_yet_is_stored_in_order(make: Any, tmp_path: Path) -> None:
    review = make()
    for kind in (OK, A, C):
        review.give((1, 1), kind)
    review._history.undo()
    review._history.undo()
    review._history.redo()
    assert review.verdict((1, 1)).kind is A
    review.attach(tmp_path)
    settle(review)
    assert [v.kind for v in ReviewStore(tmp_path).current()] == [A]
    assert review.verdict((1, 1)).kind is A


def test_undo_in_one_window_leaves_the_edits_of_the_other(make: Any, tmp_path: Path) -> None:
    one, other = make("Ada"), make("Ada")
    said: list[str] = []
    one.failed.connect(said.append)
    for review in (one, other):
        review.attach(tmp_path)
    one.give((0, 0), A)
    one.give((2, 2), OK)
    settle(one)
    other.give((1, 1), C)
    settle(other)
    one._history.undo()
    settle(one)
    stored = {v.cell: v.kind for v in ReviewStore(tmp_path).current()}
    assert stored == {(0, 0): A, (1, 1): C}
    settle(other, lambda: other.verdict((0, 0)) is not None)
    other.give((0, 0), OK)
    settle(other)
    one._history.undo()
    settle(one, lambda: one.verdict((0, 0)) is not None)
    assert one.verdict((0, 0)).kind is OK
    assert ReviewStore(tmp_path).current()[0].kind is OK
    assert said == [
        "Row 1, column 1 was changed in another window meanwhile: what was said there stays."
    ]


def test_undo_takes_back_what_another_rater_did_before_and_not_mine(
    make: Any, tmp_path: Path
) -> None:
    review = make("Ada")
    review.attach(tmp_path)
    review.give((0, 0), A)
    review.set_rater("Ben")
    review.give((0, 0), OK)
    review._history.undo()
    review._history.undo()
    settle(review)
    assert ReviewStore(tmp_path).current() == ()
    review._history.redo()
    settle(review, lambda: bool(review.others((0, 0))))
    assert review.verdict((0, 0)) is None
    assert [(v.rater, v.kind) for v in review.others((0, 0))] == [("Ada", A)]
