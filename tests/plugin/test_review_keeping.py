"""What is said is kept: before there is a folder, in another folder, by whom and with what note."""

from __future__ import annotations

from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from napari_pv_inspect.models.history import History
from napari_pv_inspect.review.journal import Journal
from napari_pv_inspect.review.model import ReviewModel
from napari_pv_inspect.review.subject import Subject
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.review import ModuleData, ReviewStore, Verdict, VerdictKind
from tests.waiting import LONG_S, wait_until

OK, A, B, C = VerdictKind.OK, VerdictKind.CRACK_A, VerdictKind.CRACK_B, VerdictKind.CRACK_C
Make = Callable[..., ReviewModel]


@pytest.fixture
def make(tiny_inspection: Inspection) -> Generator[Make]:
    made: list[ReviewModel] = []
    subject = Subject.of_inspection(tiny_inspection)

    def journal(*calls: Any) -> Journal:
        return Journal(*calls, retry_s=0.05, poll_s=0.05)

    def make(rater: str = "Ada") -> ReviewModel:
        review = ReviewModel(History(), rater, journal)
        review.show(subject)
        made.append(review)
        return review

    yield make
    for review in made:
        review.storage.close()


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    found = tmp_path / "first", tmp_path / "second"
    for folder in found:
        folder.mkdir()
    return found


def until(review: ReviewModel, happened: Callable[[], Any]) -> None:
    wait_until(happened, review.storage.collect)


def line_on(review: ReviewModel) -> Any:
    mask = np.zeros_like(review.cells.marks((1, 1)))
    row = len(mask) // 2
    mask[row : row + 2, 4:-4] = True
    return mask


def test_marks_are_measured_before_there_is_a_folder_and_go_into_it(
    make: Make, tmp_path: Path
) -> None:
    review = make()
    before, mask = review.cells.features((1, 1)).crack_length_cells, line_on(review)
    review.commands.correct((1, 1), mask)
    length = (mask.shape[1] - 8) / review.data.subject.tiles.grid.pixels_per_unit
    until(review, lambda: review.cells.features((1, 1)).crack_length_cells != before)
    assert review.cells.features((1, 1)).crack_length_cells == pytest.approx(length, rel=0.1)
    review.history.undo()
    assert review.cells.features((1, 1)).crack_length_cells == before
    review.history.redo()
    until(review, lambda: review.cells.features((1, 1)).crack_length_cells != before)
    assert review.cells.features((1, 1)).crack_length_cells == pytest.approx(length, rel=0.1)
    review.commands.give((1, 1), B)
    assert review.storage.folder is None
    review.storage.attach(tmp_path)
    assert review.storage.wait(LONG_S)
    (stored,) = ReviewStore(tmp_path).current()
    assert stored.kind is B
    assert stored.crack_length_cells == pytest.approx(length, rel=0.1)
    np.testing.assert_array_equal(ReviewStore(tmp_path).mask((1, 1), "Ada"), mask)


def test_only_the_latest_correction_is_shown_with_its_measures(make: Make) -> None:
    review = make()
    mask = line_on(review)
    for width in (8, 16, 24):
        drawn = mask & (np.arange(mask.shape[1]) < width)
        review.commands.correct((1, 1), drawn)
    length = review.data.subject.measured((1, 1), drawn).crack_length_cells
    until(review, lambda: review.cells.features((1, 1)).crack_length_cells == length)
    np.testing.assert_array_equal(review.cells.marks((1, 1)), drawn)
    # The measures of all three have arrived by then: they are taken in the order of the edits.
    review.storage.collect()
    assert review.cells.features((1, 1)).crack_length_cells == length


def test_saving_elsewhere_takes_along_what_all_raters_said(
    make: Make, folders: tuple[Path, Path]
) -> None:
    first, second = folders
    mask = np.eye(30, dtype=bool)
    with ReviewStore(first) as store:  # of an earlier session, never shown here
        store.give(Verdict(2, 2, C, "Ben", "from the edge"))
        store.correct((0, 3), "Ben", mask, 1.0, None)
        store.note((0, 1), "Ben", "look again")
        store.describe(ModuleData("S1", 8.5))
    review = make("Ada")
    review.storage.attach(first)
    review.commands.give((0, 0), A)
    review.commands.write_note((1, 0), "typed")
    assert review.storage.wait(LONG_S)
    review.storage.attach(second)
    assert review.cells.verdict((0, 0)).kind is A, "in sight all the time"
    assert review.cells.note((1, 0)) == "typed"
    assert review.storage.wait(LONG_S)
    until(review, lambda: review.cells.others((2, 2)))
    with ReviewStore(second) as store:
        found = {(v.rater, v.cell): (v.kind, v.note) for v in store.current()}
        assert found == {("Ada", (0, 0)): (A, ""), ("Ben", (2, 2)): (C, "from the edge")}
        np.testing.assert_array_equal(store.mask((0, 3), "Ben"), mask)
        assert store.waiting_notes("Ben") == {(0, 1): "look again"}
        assert store.waiting_notes("Ada") == {(1, 0): "typed"}
        assert store.module_data() == ModuleData("S1", 8.5)
    assert len(ReviewStore(first).current()) == 2, "the old folder keeps its own"


def test_saving_elsewhere_never_replaces_what_is_said_there(
    make: Make, folders: tuple[Path, Path]
) -> None:
    first, second = folders
    with ReviewStore(second) as store:
        store.give(Verdict(0, 0, C, "Ada", "there"))
    review = make("Ada")
    said: list[str] = []
    review.storage.failed.connect(said.append)
    review.storage.attach(first)
    review.commands.give((0, 0), A)
    review.commands.give((0, 1), B)
    assert review.storage.wait(LONG_S)
    review.storage.attach(second)
    assert review.storage.wait(LONG_S)
    until(review, lambda: review.cells.verdict((0, 0)).kind is C)
    assert {v.cell: v.kind for v in ReviewStore(second).current()} == {(0, 0): C, (0, 1): B}
    (sentence,) = said
    assert "1 cell already" in sentence
    assert str(first) in sentence


def test_notes_and_marks_that_stay_in_the_other_folder_are_told_and_shown(
    make: Make, folders: tuple[Path, Path]
) -> None:
    first, second = folders
    review = make("Ada")
    mask = line_on(review)
    with ReviewStore(second) as store:
        store.note((0, 0), "Ada", "look again")
        store.give(Verdict(1, 1, C, "Ada"))
    said: list[str] = []
    review.storage.failed.connect(said.append)
    review.storage.attach(first)
    review.commands.give((0, 0), A)
    review.commands.correct((1, 1), mask)
    assert review.storage.wait(LONG_S)
    review.storage.attach(second)
    assert review.storage.wait(LONG_S)
    until(review, lambda: said)
    assert "2 cells already" in said[0]
    assert (review.cells.verdict((0, 0)), review.cells.note((0, 0))) == (None, "look again")
    assert review.cells.verdict((1, 1)).kind is C
    assert review.cells.correction((1, 1)) is None


def test_what_the_full_disk_refused_goes_into_the_other_folder(
    make: Make, folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = folders
    give = ReviewStore.give

    def refuse(store: ReviewStore, verdict: Verdict) -> int:
        if store.path.parent == first.resolve():
            raise InspectionError("Nothing more can be stored: the disk is full.")
        return give(store, verdict)

    review = make("Ada")
    said: list[str] = []
    review.storage.failed.connect(said.append)
    review.storage.attach(first)
    review.commands.give((0, 0), A)
    assert review.storage.wait(LONG_S)
    monkeypatch.setattr(ReviewStore, "give", refuse)
    review.commands.give((0, 0), C)
    review.commands.give((0, 1), B)
    until(review, lambda: said)
    review.storage.attach(second)
    until(review, lambda: len(ReviewStore(second).current()) == 2)
    assert {v.cell: v.kind for v in ReviewStore(second).current()} == {(0, 0): C, (0, 1): B}
    monkeypatch.setattr(ReviewStore, "give", give)
    assert review.storage.wait(LONG_S)


def test_what_was_judged_before_the_folder_was_known_counts_and_undo_brings_the_earlier_back(
    make: Make, tmp_path: Path
) -> None:
    with ReviewStore(tmp_path) as store:
        store.give(Verdict(0, 0, C, "Ada", "last week"))
        store.give(Verdict(0, 1, OK, "Ada"))
    review = make("Ada")
    said: list[str] = []
    review.storage.failed.connect(said.append)
    review.commands.give((0, 0), A)
    review.storage.attach(tmp_path)
    assert review.storage.wait(LONG_S)
    until(review, lambda: said)
    assert "1 of the cells" in said[0]
    assert {v.cell: v.kind for v in ReviewStore(tmp_path).current()} == {(0, 0): A, (0, 1): OK}
    review.history.undo()
    assert review.storage.wait(LONG_S)
    assert review.cells.verdict((0, 0)).kind is C
    assert review.cells.note((0, 0)) == "last week"


def test_a_note_waits_goes_with_its_verdict_and_returns_when_that_is_undone(
    make: Make, tmp_path: Path
) -> None:
    review = make()
    review.storage.attach(tmp_path)
    review.commands.write_note((0, 0), "dark corner")
    review.commands.give((0, 0), A)
    assert review.cells.verdict((0, 0)).note == "dark corner"
    review.history.undo()
    assert review.cells.note((0, 0)) == "dark corner"
    assert review.storage.wait(LONG_S)
    assert review.cells.note((0, 0)) == "dark corner"
    assert ReviewStore(tmp_path).waiting_notes("Ada") == {(0, 0): "dark corner"}
    review.history.redo()
    review.commands.withdraw((0, 0))
    assert review.storage.wait(LONG_S)
    assert (review.cells.verdict((0, 0)), review.cells.note((0, 0))) == (None, "dark corner")
    again = make()
    again.storage.attach(tmp_path)
    assert again.storage.wait(LONG_S)
    assert again.cells.note((0, 0)) == "dark corner"
    again.commands.give((0, 0), C)
    assert again.storage.wait(LONG_S)
    assert ReviewStore(tmp_path).current()[0].note == "dark corner"


@pytest.mark.parametrize("saved", [True, False])
def test_nothing_is_lost_when_the_rater_changes_and_comes_back(
    make: Make, tmp_path: Path, saved: bool
) -> None:
    review = make("Ada")
    if saved:
        review.storage.attach(tmp_path)
    mask = line_on(review)
    review.commands.give((0, 0), A)
    review.commands.write_note((0, 1), "typed")
    review.commands.correct((1, 1), mask)
    review.set_rater("Ben")
    assert review.cells.verdict((0, 0)) is None
    assert [(v.rater, v.kind) for v in review.cells.others((0, 0))] == [("Ada", A)]
    assert review.cells.note((0, 1)) == ""
    assert review.cells.correction((1, 1)) is None
    review.commands.give((0, 0), C)
    assert review.cells.is_disputed((0, 0))
    if saved:
        assert review.storage.wait(LONG_S)
    review.set_rater("Ada")
    if saved:
        assert review.storage.wait(LONG_S)
    assert review.cells.verdict((0, 0)).kind is A
    assert review.cells.note((0, 1)) == "typed"
    np.testing.assert_array_equal(review.cells.correction((1, 1)), mask)
    assert [(v.rater, v.kind) for v in review.cells.others((0, 0))] == [("Ben", C)]


def test_who_holds_something_typed_is_asked_before_the_rater_changes(make: Make) -> None:
    review = make("Ada")
    review.storage.flush_wanted.connect(lambda: review.commands.write_note((2, 2), "in the line"))
    review.set_rater("Ben")
    assert review.cells.note((2, 2)) == ""
    assert review.data.module_review.rater_review("Ada").notes == {(2, 2): "in the line"}
