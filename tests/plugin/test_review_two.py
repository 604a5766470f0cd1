"""Two raters at one module, a disk that refuses, and a review by keys alone."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import pytest
from pytestqt.qtbot import QtBot
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication

from napari_pv_inspect.docks.gallery_list import cell_text
from napari_pv_inspect.docks.large_cell import large_cell
from napari_pv_inspect.models.history import History
from napari_pv_inspect.napari_internals import main_window
from napari_pv_inspect.review.journal import Journal
from napari_pv_inspect.review.model import ReviewModel
from napari_pv_inspect.review.subject import Subject
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.review import REVIEW_FILE, ReviewStore, VerdictKind, verdicts_csv
from tests.waiting import LONG_S

OK, A, B, C = VerdictKind.OK, VerdictKind.CRACK_A, VerdictKind.CRACK_B, VerdictKind.CRACK_C

OTHER_PROCESS = """
import sys
from pathlib import Path
from pv_inspect.review import ReviewStore, Verdict, VerdictKind
with ReviewStore(Path(sys.argv[1])) as store:
    for line in sys.stdin:
        row, col, kind = line.split()
        store.give(Verdict(int(row), int(col), VerdictKind(kind), "Ben"))
        seen = ",".join(f"{v.rater}:{v.row}:{v.col}:{v.kind.value}" for v in store.current())
        print(seen, flush=True)
"""


@pytest.fixture
def ben(saved: Any, tmp_path: Path) -> Generator[Callable[[str], str]]:
    """Another process in which Ben judges; answers with what it sees."""
    process = subprocess.Popen(
        [sys.executable, "-c", OTHER_PROCESS, str(tmp_path / "out")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )

    def say(line: str) -> str:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(f"{line}\n")
        process.stdin.flush()
        return process.stdout.readline().strip()

    yield say
    process.communicate(timeout=LONG_S)


def test_two_processes_see_each_other_and_where_they_differ(
    saved: Any, ben: Callable[[str], str], qtbot: QtBot, tmp_path: Path
) -> None:
    _, dock, cells = saved
    state = dock.workbench.review.state
    state.set_rater("Ada")
    state.commands.give((0, 0), OK)
    state.commands.give((0, 1), A)
    qtbot.waitUntil(lambda: state.storage.pending == 0)
    assert "Ada:0:0:ok" in ben("0 0 crack_c")
    qtbot.waitUntil(lambda: bool(state.cells.others((0, 0))))
    assert state.cells.is_disputed((0, 0))
    assert not state.cells.is_disputed((0, 1))
    assert "the raters differ" in cell_text(state, (0, 0))
    cells.filter.setCurrentText("raters differ")
    assert state.listing.cells == ((0, 0),)
    with ReviewStore(tmp_path / "out") as store:
        table = verdicts_csv(state.data.subject.cracks.cells, store.current())
    assert table.splitlines()[1].startswith("1,1,disagreed,")
    state.commands.give((0, 0), C)
    assert state.listing.cells == ()
    qtbot.waitUntil(lambda: state.storage.pending == 0)
    assert "Ada:0:0:crack_c" in ben("1 1 ok")


def test_a_locked_database_is_one_sentence_and_the_verdict_is_stored_when_it_is_free(
    tiny_inspection: Inspection, tmp_path: Path, qtbot: QtBot
) -> None:
    said: list[str] = []

    def open_store(folder: Path) -> ReviewStore:
        return ReviewStore(folder, busy_s=0.05)

    review = ReviewModel(
        History(), "Ada", lambda *calls: Journal(*calls, open_store=open_store, retry_s=0.05)
    )
    review.storage.failed.connect(said.append)
    review.show(Subject.of_inspection(tiny_inspection))
    review.storage.attach(tmp_path)
    review.commands.give((0, 0), OK)
    assert review.storage.wait(LONG_S)
    blocker = sqlite3.connect(tmp_path / REVIEW_FILE, isolation_level=None)
    blocker.execute("BEGIN EXCLUSIVE")
    review.commands.give((0, 1), A)

    def told() -> bool:
        review.storage.collect()
        return bool(said)

    qtbot.waitUntil(told)
    qtbot.wait(200)
    review.storage.collect()
    assert len(said) == 1, "once, however often it is tried"
    assert "held by another program" in said[0]
    assert review.cells.verdict((0, 1)).kind is A
    assert review.cells.is_pending((0, 1))
    blocker.execute("ROLLBACK")
    blocker.close()
    assert review.storage.wait(LONG_S)
    assert [v.kind for v in ReviewStore(tmp_path).current()] == [OK, A]
    review.storage.close()


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is write-protected for root")
def test_a_write_protected_folder_is_one_sentence_and_keeps_the_verdict(
    tiny_inspection: Inspection, tmp_path: Path, qtbot: QtBot
) -> None:
    said: list[str] = []
    review = ReviewModel(History(), "Ada", lambda *calls: Journal(*calls, retry_s=0.05))
    review.storage.failed.connect(said.append)
    review.show(Subject.of_inspection(tiny_inspection))
    tmp_path.chmod(0o500)
    review.storage.attach(tmp_path)
    review.commands.give((0, 0), OK)

    def told() -> bool:
        review.storage.collect()
        return bool(said)

    qtbot.waitUntil(told)
    assert not review.storage.wait(0.2)
    assert len(said) == 1
    assert review.cells.verdict((0, 0)).kind is OK
    tmp_path.chmod(0o700)
    assert review.storage.wait(LONG_S)
    review.storage.close()


def test_what_stands_in_the_note_is_stored_when_the_window_closes(
    saved: Any, qtbot: QtBot, tmp_path: Path
) -> None:
    viewer, dock, _ = saved
    dock.show_page("Review")
    dock.workbench.model.select_cell((2, 1))
    note = dock.verdict.note
    main_window(viewer).activateWindow()
    note.setFocus()
    qtbot.waitUntil(note.hasFocus)
    QTest.keyClicks(note, "not entered")
    rater = dock.workbench.review.state.data.rater
    viewer.close()
    assert ReviewStore(tmp_path / "out").waiting_notes(rater) == {(2, 1): "not entered"}


def test_what_stands_in_the_note_goes_to_the_rater_who_typed_it(saved: Any, qtbot: QtBot) -> None:
    _, dock, _ = saved
    dock.show_page("Review")
    state = dock.workbench.review.state
    state.set_rater("Ada")
    dock.workbench.model.select_cell((2, 1))
    QTest.keyClicks(dock.verdict.note, "by Ada")
    dock.workbench.review.set_rater("Ben")
    assert dock.verdict.note.text() == ""
    dock.workbench.review.set_rater("Ada")
    assert dock.verdict.note.text() == "by Ada"
    qtbot.waitUntil(lambda: state.storage.pending == 0)


@pytest.mark.parametrize("order", ["by position", "by crack score"])
def test_all_cells_are_judged_by_keys_alone_in_the_listed_order(
    saved: Any, qtbot: QtBot, order: str
) -> None:
    viewer, dock, cells = saved
    state, model = dock.workbench.review.state, dock.workbench.model
    state.commands.give((1, 1), B)  # a filtered cell in between
    cells.order.setCurrentText(order)
    cells.filter.setCurrentText("not judged")
    wanted = state.listing.cells
    assert len(wanted) == 11
    model.select_cell(wanted[0])
    main_window(viewer).activateWindow()
    cells.view.setFocus()
    qtbot.waitUntil(cells.view.hasFocus)
    QTest.keyClick(cells.view, Qt.Key.Key_Return)
    view = large_cell(dock.workbench).view
    qtbot.waitUntil(view.hasFocus)
    judged = []
    for number in range(len(wanted)):
        judged.append(model.selected_cell)
        QTest.keyClick(QApplication.focusWidget(), "kabcf"[number % 5])
        QApplication.processEvents()
        assert view.hasFocus(), "the keyboard is never lost"
        if number == 4:  # to the gallery and back, by keys
            QTest.keyClick(view, "g")
            assert cells.view.hasFocus()
            QTest.keyClick(cells.view, Qt.Key.Key_Return)
            assert view.hasFocus()
    assert tuple(judged) == wanted
    assert state.cells.progress.judged == 12
    qtbot.waitUntil(lambda: state.storage.pending == 0)
