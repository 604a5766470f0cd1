"""Cells of an earlier grid are neither shown nor judged; they come back with what was said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pytestqt.qtbot import QtBot
from qtpy.QtWidgets import QMessageBox

from napari_pv_inspect.docks.large_cell import large_cell
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.napari_internals import main_window
from napari_pv_inspect.review.controller import OTHER_GRID, OTHER_LAYOUT
from napari_pv_inspect.review.data import NO_CELLS
from napari_pv_inspect.review.subject import Subject
from pv_inspect.cells import CellTiles
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.review import ReviewStore, VerdictKind
from tests.plugin.reviewing import show, stored

OK = VerdictKind.OK


@pytest.fixture(autouse=True)
def questions_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    discard = QMessageBox.StandardButton.Discard
    monkeypatch.setattr(QMessageBox, "question", lambda *_: discard)


@pytest.fixture
def judged(workbench: Any, tiny_inspection: Inspection, tmp_path: Path, qtbot: QtBot) -> Any:
    """Dock and gallery with a saved inspection of 3 x 4 cells, one of them judged and large."""
    viewer, dock, cells = workbench
    main_window(viewer).show()
    show(dock, tiny_inspection)
    dock.save(tmp_path / "out")
    qtbot.waitUntil(lambda: dock.workbench.review.state.storage.folder is not None)
    dock.workbench.model.select_cell((2, 3))
    dock.workbench.review.advances = False
    dock.workbench.review.judge(OK)
    stored(dock, qtbot)
    cells.open_cell()
    assert large_cell(dock.workbench).is_open
    return dock, cells


def detected(whole: Inspection, cols: int | None = None) -> Inspection:
    """Return what *Detect grid* leaves of it, with another number of columns."""
    layout = whole.layout if cols is None else replace(whole.layout, cols=cols)
    return Inspection(whole.sequence, whole.settings, layout, whole.crossings)


def narrower(whole: Inspection) -> Inspection:
    """Return a whole inspection of the left three columns."""
    assert whole.reconstruction is not None
    assert whole.tiles is not None
    layout = replace(whole.layout, cols=3)
    made = replace(whole.reconstruction, grid=replace(whole.reconstruction.grid, layout=layout))
    tiles = CellTiles(made.image, made.grid)
    return replace(whole, layout=layout, reconstruction=made, tiles=tiles, cracks=None)


def is_empty(dock: Any, cells: Any, why: str) -> bool:
    state = dock.workbench.review.state
    return (
        state.data.subject is None
        and cells.cells.rowCount() == 0
        and cells.view.message == why
        and dock.verdict.progress.toolTip() == why
        and not dock.verdict.buttons[OK].isEnabled()
        and not dock.export.isEnabled()
        and not large_cell(dock.workbench).is_open
    )


def test_a_grid_of_another_layout_empties_the_review(
    judged: Any, tiny_inspection: Inspection
) -> None:
    dock, cells = judged
    show(dock, detected(tiny_inspection, cols=5))
    assert is_empty(dock, cells, OTHER_LAYOUT)


def test_the_camera_does_not_stay_where_a_cell_was(
    judged: Any, tiny_inspection: Inspection
) -> None:
    dock, _ = judged
    viewer, module = dock.workbench.viewer, dock.workbench.module
    large_cell(dock.workbench).leave()
    dock.workbench.navigator.to_cell(2, 3)
    at_the_cell = viewer.scene.camera.zoom
    show(dock, detected(tiny_inspection))
    assert viewer.scene.camera.zoom == at_the_cell, "the module image is still there"
    show(dock, detected(tiny_inspection, cols=5))
    assert module.placement is None
    assert viewer.scene.camera.zoom < at_the_cell


def test_what_is_not_shown_is_not_judged(
    judged: Any, tiny_inspection: Inspection, tmp_path: Path, qtbot: QtBot
) -> None:
    dock, cells = judged
    show(dock, detected(tiny_inspection, cols=5))
    said: list[str] = []
    dock.workbench.model.noticed.connect(lambda text, _: said.append(text))
    dock.workbench.review.judge(VerdictKind.CRACK_A)
    dock.workbench.review.withdraw()
    cells.open_cell()
    assert said == [OTHER_LAYOUT, OTHER_LAYOUT]
    assert not large_cell(dock.workbench).is_open
    stored(dock, qtbot)
    assert [v.kind for v in ReviewStore(tmp_path / "out").current()] == [OK]


def test_a_grid_that_was_changed_empties_the_review_until_the_cells_are_back(
    judged: Any, tiny_inspection: Inspection, qtbot: QtBot
) -> None:
    dock, cells = judged
    show(dock, detected(tiny_inspection))
    assert is_empty(dock, cells, OTHER_GRID)
    show(dock, tiny_inspection)
    assert cells.cells.rowCount() == 12
    assert cells.view.message == ""
    state = dock.workbench.review.state
    assert state.cells.verdict((2, 3)).kind is OK
    dock.workbench.review.judge(VerdictKind.CRACK_B)
    stored(dock, qtbot)
    assert [v.kind for v in ReviewStore(state.storage.folder).current()] == [VerdictKind.CRACK_B]


def test_what_was_never_saved_comes_back_with_its_cells(
    workbench: Any, tiny_inspection: Inspection
) -> None:
    _, dock, _ = workbench
    dock._on_save = lambda: None
    show(dock, tiny_inspection)
    state = dock.workbench.review.state
    state.commands.give((0, 1), OK)
    show(dock, detected(tiny_inspection, cols=5))
    show(dock, tiny_inspection)
    assert state.cells.verdict((0, 1)).kind is OK
    assert dock.workbench.history.undo_text is not None


def test_the_next_run_of_another_layout_begins_a_review_of_its_own(
    judged: Any, tiny_inspection: Inspection, tmp_path: Path
) -> None:
    dock, cells = judged
    show(dock, detected(tiny_inspection, cols=3))
    show(dock, narrower(tiny_inspection))
    state = dock.workbench.review.state
    assert cells.cells.rowCount() == 9
    assert state.storage.folder is None
    assert state.cells.verdict((2, 3)) is None
    assert dock.workbench.model.selected_cell is None, "it lies beyond the columns"
    assert len(ReviewStore(tmp_path / "out").current()) == 1


def test_cells_stay_while_a_run_of_the_same_layout_goes_on(
    judged: Any, replayed: Any, qtbot: QtBot
) -> None:
    dock, cells = judged
    replayed.go_on = False
    dock.workbench.model.change_settings(prior_weight=0.5)
    dock.run.run.click()
    assert not large_cell(dock.workbench).is_open, "the image grows on the canvas"
    qtbot.waitUntil(lambda: dock.run.progress.value() > 600)
    assert dock.workbench.model.shown.tiles is None
    assert cells.cells.rowCount() == 12
    replayed.go_on = True
    qtbot.waitUntil(lambda: dock.workbench.model.run_state is RunState.IDLE)
    assert cells.cells.rowCount() == 12


def test_another_sequence_has_no_cells_yet(judged: Any, tiny_inspection: Inspection) -> None:
    dock, cells = judged
    show(dock, detected(tiny_inspection, cols=5))
    dock.workbench.model.open(tiny_inspection.sequence)
    assert is_empty(dock, cells, NO_CELLS)
    assert dock.workbench.review.state.storage.folder is None


def test_tiles_of_another_layout_are_no_subject(tiny_inspection: Inspection) -> None:
    other = replace(tiny_inspection.layout, rows=7)
    assert Subject.of_inspection(replace(tiny_inspection, layout=other)) is None


def test_what_the_user_discards_is_not_told_again(
    workbench: Any, tiny_inspection: Inspection
) -> None:
    _, dock, _ = workbench
    dock._on_save = lambda: None
    show(dock, tiny_inspection)
    said: list[str] = []
    state = dock.workbench.review.state
    state.storage.failed.connect(said.append)
    state.commands.give((0, 0), OK)
    assert dock.workbench.opener.may_leave()
    dock.workbench.model.open(tiny_inspection.sequence)
    assert state.storage.pending == 0
    assert said == []


def test_what_is_lost_unasked_is_told(
    workbench: Any, tiny_inspection: Inspection, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, dock, _ = workbench
    dock._on_save = lambda: None
    monkeypatch.setattr("napari_pv_inspect.workbench.show_error", lambda _: None)
    show(dock, tiny_inspection)
    said: list[str] = []
    state = dock.workbench.review.state
    state.storage.failed.connect(said.append)
    state.commands.give((0, 0), OK)
    dock.workbench.model.open(tiny_inspection.sequence)
    assert len(said) == 1
