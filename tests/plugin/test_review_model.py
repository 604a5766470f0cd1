"""State of the review without Qt: what is stored, when, and what the gallery lists."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path
from threading import Event
from time import sleep
from typing import Any

import numpy as np
import pytest

from napari_pv_inspect.models.history import History
from napari_pv_inspect.review.data import ALL_MARKS, VERDICTS, ReviewChange
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
        review.storage.close()


def store_all(review: ReviewModel, until: Callable[[], bool] = lambda: True) -> None:
    assert review.storage.wait(LONG_S)
    wait_until(until, review.storage.collect)


def test_a_verdict_is_shown_at_once_and_then_stored(make: Any, tmp_path: Path) -> None:
    review = make()
    review.storage.attach(tmp_path)
    review.commands.write_note((1, 2), "long one")
    review.commands.give((1, 2), C)
    assert review.cells.verdict((1, 2)).kind is C
    store_all(review)
    assert not review.cells.is_pending((1, 2))
    (stored,) = ReviewStore(tmp_path).current()
    assert (stored.cell, stored.kind, stored.rater) == ((1, 2), C, "Ada")
    assert stored.note == "long one"
    assert len(stored.settings) == 12


def test_undo_and_redo_are_those_of_the_store(make: Any, tmp_path: Path) -> None:
    review = make()
    history = review.history
    review.storage.attach(tmp_path)
    review.commands.give((0, 0), OK)
    review.commands.give((0, 0), A)
    history.undo()
    store_all(review)
    assert review.cells.verdict((0, 0)).kind is OK
    history.undo()
    store_all(review)
    assert review.cells.verdict((0, 0)) is None
    assert ReviewStore(tmp_path).current() == ()
    history.redo()
    history.redo()
    store_all(review)
    assert review.cells.verdict((0, 0)).kind is A
    assert [e.action for e in ReviewStore(tmp_path).history()] == [
        "edit", "edit", "undo", "undo", "redo", "redo",
    ]  # fmt: skip


def test_what_was_judged_before_there_is_a_folder_goes_into_it(make: Any, tmp_path: Path) -> None:
    review = make()
    asked: list[str] = []
    review.storage.folder_wanted.connect(asked.append)
    review.commands.give((0, 0), OK)
    review.commands.give((0, 1), A)
    assert len(asked) == 1
    assert review.storage.pending == 2
    assert not review.storage.wait(0.01)
    review.storage.attach(tmp_path)
    store_all(review)
    assert [v.kind for v in ReviewStore(tmp_path).current()] == [OK, A]


def test_a_full_disk_is_one_sentence_and_keeps_all_until_there_is_room(
    make: Any, disk: Disk, tmp_path: Path
) -> None:
    review = make()
    sentences: list[str] = []
    review.storage.failed.connect(sentences.append)
    review.storage.attach(tmp_path)
    store_all(review)
    disk.full = True
    review.commands.give((0, 0), A)
    review.commands.give((0, 1), OK)
    assert not review.storage.wait(0.4)
    assert len(sentences) == 1
    assert review.storage.is_failing
    assert review.cells.is_pending((0, 0))
    assert review.cells.verdict((0, 0)).kind is A
    disk.full = False
    store_all(review)
    assert [v.kind for v in ReviewStore(tmp_path).current()] == [A, OK]
    assert review.storage.pending == 0


def test_another_rater_appears_and_does_not_count_as_mine(make: Any, tmp_path: Path) -> None:
    mine, other = make("Ada"), make("Ben")
    mine.storage.attach(tmp_path)
    other.storage.attach(tmp_path)
    mine.commands.give((0, 0), OK)
    store_all(mine)
    store_all(other, lambda: bool(other.cells.others((0, 0))))
    assert other.cells.verdict((0, 0)) is None
    other.commands.give((0, 0), C)
    store_all(other)
    store_all(mine, lambda: bool(mine.cells.others((0, 0))))
    assert [v.kind for v in mine.cells.others((0, 0))] == [C]
    assert mine.cells.verdict((0, 0)).kind is OK
    assert mine.cells.progress.text == "1 of 12 cells judged"
    other.set_rater("Ada")
    store_all(other)
    assert other.cells.verdict((0, 0)).kind is OK


def test_filter_and_order_list_the_cells(make: Any, tmp_path: Path) -> None:
    review = make()
    review.storage.attach(tmp_path)
    assert review.listing.cells == tuple((r, c) for r in range(3) for c in range(4))
    review.commands.give((1, 1), C)
    review.commands.give((2, 3), OK)
    review.listing.set_filter(tuple(VerdictKind))
    assert review.listing.cells == ((1, 1), (2, 3))
    review.listing.set_filter((OK,))
    assert review.listing.cells == ((2, 3),)
    review.listing.set_filter((None,))
    assert len(review.listing.cells) == 10
    review.listing.set_order(Order.CRACK_SCORE)
    scores = [review.cells.features(cell).crack_score for cell in review.listing.cells]
    assert scores == sorted(scores, reverse=True)


def test_next_is_the_following_listed_cell_without_a_verdict(make: Any) -> None:
    review = make()
    review.listing.set_filter((None,))
    review.commands.give((0, 1), OK)
    review.commands.give((0, 0), OK)
    assert review.listing.next_unjudged((0, 0)) == (0, 2)
    assert review.listing.next_unjudged((2, 3)) == (0, 2)


def test_corrected_marks_change_length_are_stored_and_undone(make: Any, tmp_path: Path) -> None:
    review = make()
    review.storage.attach(tmp_path)
    before = review.cells.features((1, 1)).crack_length_cells
    mask = np.zeros_like(review.cells.marks((1, 1)))
    row = len(mask) // 2
    mask[row : row + 2, 4:-4] = True
    review.commands.correct((1, 1), mask)
    np.testing.assert_array_equal(review.cells.marks((1, 1)), mask)
    store_all(review)
    after = review.cells.features((1, 1)).crack_length_cells
    expected = (mask.shape[1] - 8) / review.data.subject.tiles.grid.pixels_per_unit
    assert after == pytest.approx(expected, rel=0.1)
    assert after != before
    np.testing.assert_array_equal(ReviewStore(tmp_path).mask((1, 1), "Ada"), mask)
    review.commands.give((1, 1), A)
    store_all(review)
    (stored,) = ReviewStore(tmp_path).current()
    assert stored.crack_length_cells == pytest.approx(after)
    review.history.undo()
    review.history.undo()
    store_all(review)
    assert review.cells.correction((1, 1)) is None
    assert review.cells.features((1, 1)).crack_length_cells == before


def test_opening_again_brings_verdicts_marks_module_data_and_the_cell(
    make: Any, tmp_path: Path
) -> None:
    first = make()
    first.storage.attach(tmp_path)
    first.commands.give((2, 0), C)
    first.commands.correct((2, 0), np.eye(*first.cells.marks((2, 0)).shape, dtype=bool))
    first.storage.describe(ModuleData("S1", 8.5))
    first.storage.remember((2, 1))
    store_all(first)
    second = make()
    places: list[Any] = []
    second.storage.remembered.connect(places.append)
    second.storage.attach(tmp_path)
    length = first.cells.features((2, 0)).crack_length_cells
    store_all(
        second, lambda: second.cells.features((2, 0)).crack_length_cells == pytest.approx(length)
    )
    assert second.cells.verdict((2, 0)).kind is C
    assert second.cells.correction((2, 0)) is not None
    assert second.storage.module_data == ModuleData("S1", 8.5)
    assert places == [(2, 1)]
    assert ReviewStore(tmp_path).remembered("Ada") == ReviewState("Ada", 2, 1)


def test_a_save_into_another_folder_takes_the_verdicts_along(make: Any, tmp_path: Path) -> None:
    review = make()
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    review.storage.attach(first)
    review.commands.give((0, 0), A)
    store_all(review)
    review.storage.attach(second)
    store_all(review)
    assert [v.kind for v in ReviewStore(second).current()] == [A]
    assert review.cells.verdict((0, 0)).kind is A


def test_leaving_a_module_stores_what_is_pending(
    make: Any, disk: Disk, subject: Subject, tmp_path: Path
) -> None:
    review = make()
    review.storage.attach(tmp_path)
    disk.slow_s = 0.05
    for col in range(4):
        review.commands.give((0, col), OK)
    review.show(None)
    assert review.cells.verdict((0, 0)) is None
    store_all(review)
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
    review.storage.attach(first)
    review.commands.give((0, 0), A)
    review.history.undo()
    assert review.cells.verdict((0, 0)) is None
    review.commands.give((0, 0), A)
    review.commands.give((0, 1), A)
    review.history.undo()
    review.commands.give((0, 1), C)
    store_all(review)
    assert [review.cells.verdict((0, col)).kind for col in range(2)] == [A, C]
    review.commands.give((0, 2), OK)
    review.history.undo()
    review.storage.attach(second)
    store_all(review)
    for folder in (first, second):
        assert [v.kind for v in ReviewStore(folder).current()] == [A, C]


def test_undo_while_nothing_is_stored_yet_is_stored_in_order(make: Any, tmp_path: Path) -> None:
    review = make()
    for kind in (OK, A, C):
        review.commands.give((1, 1), kind)
    review.history.undo()
    review.history.undo()
    review.history.redo()
    assert review.cells.verdict((1, 1)).kind is A
    review.storage.attach(tmp_path)
    store_all(review)
    assert [v.kind for v in ReviewStore(tmp_path).current()] == [A]
    assert review.cells.verdict((1, 1)).kind is A


def test_undo_in_one_window_leaves_the_edits_of_the_other(make: Any, tmp_path: Path) -> None:
    one, other = make("Ada"), make("Ada")
    said: list[str] = []
    one.storage.failed.connect(said.append)
    for review in (one, other):
        review.storage.attach(tmp_path)
    one.commands.give((0, 0), A)
    one.commands.give((2, 2), OK)
    store_all(one)
    other.commands.give((1, 1), C)
    store_all(other)
    one.history.undo()
    store_all(one)
    stored = {v.cell: v.kind for v in ReviewStore(tmp_path).current()}
    assert stored == {(0, 0): A, (1, 1): C}
    store_all(other, lambda: other.cells.verdict((0, 0)) is not None)
    other.commands.give((0, 0), OK)
    store_all(other)
    one.history.undo()
    store_all(one, lambda: one.cells.verdict((0, 0)) is not None)
    assert one.cells.verdict((0, 0)).kind is OK
    assert ReviewStore(tmp_path).current()[0].kind is OK
    assert said == [
        "Row 1, column 1 was changed in another window meanwhile: what was said there stays."
    ]


def test_undo_takes_back_what_another_rater_did_before_and_not_mine(
    make: Any, tmp_path: Path
) -> None:
    review = make("Ada")
    review.storage.attach(tmp_path)
    review.commands.give((0, 0), A)
    review.set_rater("Ben")
    review.commands.give((0, 0), OK)
    review.history.undo()
    review.history.undo()
    store_all(review)
    assert ReviewStore(tmp_path).current() == ()
    review.history.redo()
    store_all(review, lambda: bool(review.cells.others((0, 0))))
    assert review.cells.verdict((0, 0)) is None
    assert [(v.rater, v.kind) for v in review.cells.others((0, 0))] == [("Ada", A)]


class Counted:
    """How often a review tells of changes, and of which."""

    def __init__(self, review: ReviewModel) -> None:
        self.changes: list[ReviewChange] = []
        self.subjects = 0
        review.data.changed.connect(self.changes.append)
        review.data.subject_changed.connect(self._count)
        review.listing.changed.connect(lambda: self.changes.append(ReviewChange()))

    def _count(self, _: Subject | None) -> None:
        self.subjects += 1


def test_each_change_of_a_review_is_told_once(make: Any, subject: Subject, tmp_path: Path) -> None:
    review = make()
    counted = Counted(review)
    mask = np.eye(*review.cells.marks((0, 0)).shape, dtype=bool)
    for change, told in (
        (lambda: review.commands.give((0, 0), A), VERDICTS),
        (lambda: review.commands.write_note((0, 0), "at the edge"), VERDICTS),
        (lambda: review.commands.correct((0, 0), mask), ReviewChange(marks=frozenset({(0, 0)}))),
        (lambda: review.set_rater("Ben"), VERDICTS | ALL_MARKS),
        (lambda: review.commands.withdraw((0, 0)), None),
    ):
        change()
        assert counted.changes == ([] if told is None else [told])
        counted.changes.clear()
    review.show(replace(subject))
    assert (counted.subjects, counted.changes) == (1, [])
    review.empty("Press Run.")
    review.empty("Press Run.")
    assert (counted.subjects, counted.changes) == (2, [])


def test_all_that_is_stored_by_then_is_told_by_one_signal(make: Any, tmp_path: Path) -> None:
    review = make()
    for col in range(4):
        review.commands.give((0, col), OK)
    review.storage.attach(tmp_path)
    counted = Counted(review)
    assert review.storage.wait(10)  # collects once, at its end
    assert counted.changes == [VERDICTS | ALL_MARKS]
    assert not any(review.cells.is_pending((0, col)) for col in range(4))
