"""The review in the window: keys, gallery, cell view, brush, closing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot
from qtpy.QtCore import QPoint, QPointF, Qt
from qtpy.QtGui import QWheelEvent
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication, QFileDialog, QLineEdit, QMessageBox

from napari_pv_inspect.docks.cell import NO_FRAMES, CellDock
from napari_pv_inspect.docks.gallery_list import BAR, GAP, cell_text
from napari_pv_inspect.docks.large_cell import large_cell
from napari_pv_inspect.live.single_frame import contours
from napari_pv_inspect.napari_internals import main_window
from napari_pv_inspect.review.controller import LITTLE_PATIENCE_S
from napari_pv_inspect.review.journal import Journal
from napari_pv_inspect.workbench import Workbench
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.single_frame import best_frame
from pv_inspect.results.read import read_result
from pv_inspect.results.write import write_result
from pv_inspect.review import ReviewStore, Verdict, VerdictKind
from tests.plugin.reviewing import show, stored

LEFT, RIGHT = Qt.MouseButton.LeftButton, Qt.MouseButton.RightButton
NONE = Qt.KeyboardModifier.NoModifier


def press(widget: Any, key: Any, qtbot: QtBot) -> None:
    widget.window().activateWindow()
    widget.setFocus()
    qtbot.waitUntil(widget.hasFocus)
    QTest.keyClick(widget, key)


def test_a_key_in_the_gallery_stores_the_verdict_and_goes_on(
    saved: Any, qtbot: QtBot, tmp_path: Path
) -> None:
    _, dock, cells = saved
    model = dock.workbench.model
    model.select_cell((0, 0))
    for kind in VerdictKind:
        press(cells.view, kind.key, qtbot)
    stored(dock, qtbot)
    found = ReviewStore(tmp_path / "out").current()
    assert [v.kind for v in found] == list(VerdictKind)
    assert [v.cell for v in found] == [(k // 4, k % 4) for k in range(8)]
    assert model.selected_cell == (2, 0)
    assert dock.verdict.progress.text() == "8 of 12 cells judged"
    dock.workbench.history.undo()
    stored(dock, qtbot)
    assert len(ReviewStore(tmp_path / "out").current()) == 7
    assert dock.verdict.progress.text() == "7 of 12 cells judged"


def test_all_keys_of_the_review_are_in_the_help(saved: Any) -> None:
    _, dock, cells = saved
    cells.open_cell()
    keys = {(key.sequence, key.group) for key in dock.workbench.shortcuts.keys}
    for kind in VerdictKind:
        assert (kind.key.upper(), "Gallery") in keys
        assert (kind.key.upper(), "Cell view") in keys
    assert large_cell(dock.workbench).is_open


def test_letters_in_the_note_are_no_verdicts_and_the_note_goes_with_the_next(
    saved: Any, qtbot: QtBot, tmp_path: Path
) -> None:
    _, dock, cells = saved
    dock.show_page("Review")
    dock.workbench.model.select_cell((1, 1))
    note: QLineEdit = dock.verdict.note
    note.setFocus()
    QTest.keyClicks(note, "back of a crack")
    assert dock.workbench.review.state.cells.progress.judged == 0
    press(cells.view, "b", qtbot)
    stored(dock, qtbot)
    (verdict,) = ReviewStore(tmp_path / "out").current()
    assert (verdict.cell, verdict.kind) == ((1, 1), VerdictKind.CRACK_B)
    assert verdict.note == "back of a crack"
    assert "back of a crack" in cell_text(dock.workbench.review.state, (1, 1))


def test_the_gallery_filters_by_verdict(saved: Any, qtbot: QtBot) -> None:
    _, dock, cells = saved
    review = dock.workbench.review.state
    review.commands.give((0, 2), VerdictKind.CRACK_A)
    cells.filter.setCurrentText("crack A")
    assert [cells.cells.cell(cells.cells.index(k)) for k in range(cells.cells.rowCount())] == [
        (0, 2)
    ]
    cells.filter.setCurrentText("not judged")
    assert cells.cells.rowCount() == 11
    dock.workbench.model.select_cell((0, 0))
    dock.workbench.review.judge(VerdictKind.OK)
    assert cells.cells.rowCount() == 10
    assert dock.workbench.model.selected_cell == (0, 1)
    assert cells.cells.cell(cells.view.currentIndex()) == (0, 1)
    stored(dock, qtbot)


def test_opacity_and_threshold_only_repaint(saved: Any) -> None:
    _, dock, cells = saved
    before = dock.workbench.review.state.cells.features((0, 0))

    def painted() -> int:
        picture = cells.cells.picture((1, 1)).toImage()
        colours = (
            picture.pixelColor(x, y)
            for x in range(picture.width())
            for y in range(picture.height())
        )
        return sum(c.red() > c.blue() for c in colours)

    cells.threshold.setValue(100)
    few = painted()
    cells.threshold.setValue(0)
    assert painted() > few
    cells.opacity.setValue(0)
    assert painted() == 0
    assert dock.workbench.review.state.cells.features((0, 0)) is before


def test_the_first_verdict_on_an_unsaved_inspection_asks_to_save_and_is_kept(
    workbench: Any,
    tiny_inspection: Inspection,
    tmp_path: Path,
    qtbot: QtBot,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, dock, _ = workbench
    show(dock, tiny_inspection)
    asked: list[int] = []

    def choose(*_: Any, **__: Any) -> tuple[str, str]:
        asked.append(1)
        return str(tmp_path / "later"), ""

    monkeypatch.setattr(QFileDialog, "getSaveFileName", choose)
    dock.workbench.model.select_cell((0, 0))
    dock.workbench.review.judge(VerdictKind.CRACK_C)
    dock.workbench.review.judge(VerdictKind.OK)
    assert "2 not stored yet" in dock.verdict.progress.text()
    stored(dock, qtbot)
    assert asked == [1]
    found = ReviewStore(tmp_path / "later").current()
    assert [v.kind for v in found] == [VerdictKind.CRACK_C, VerdictKind.OK]


def test_closing_waits_for_what_is_not_stored_yet(
    saved: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer, dock, _ = saved
    give = ReviewStore.give

    def slow(store: ReviewStore, verdict: Verdict) -> None:
        sleep(0.1)
        give(store, verdict)

    monkeypatch.setattr(ReviewStore, "give", slow)
    for col in range(4):
        dock.workbench.review.state.commands.give((0, col), VerdictKind.OK)
    viewer.close()
    assert len(ReviewStore(tmp_path / "out").current()) == 4


def test_if_nothing_can_be_stored_the_user_decides_about_closing(
    saved: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer, dock, _ = saved
    popups: list[str] = []
    monkeypatch.setattr("napari_pv_inspect.workbench.show_error", popups.append)
    monkeypatch.setattr("napari_pv_inspect.review.controller.PATIENCE_S", 0.1)

    def full(*_: object) -> None:
        raise InspectionError("Nothing more can be stored: the disk is full.")

    monkeypatch.setattr(ReviewStore, "give", full)
    answers = [QMessageBox.StandardButton.Cancel, QMessageBox.StandardButton.Discard]
    monkeypatch.setattr(QMessageBox, "question", lambda *_: answers.pop(0))
    dock.workbench.review.state.commands.give((0, 0), VerdictKind.OK)
    main_window(viewer).close()
    assert main_window(viewer).isVisible(), "Cancel keeps the window"
    assert Workbench.of(viewer) is dock.workbench
    viewer.close()
    assert answers == []
    assert popups == ["Nothing more can be stored: the disk is full."]


def test_a_failure_that_is_known_is_asked_about_at_once(
    saved: Any, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer, dock, _ = saved
    monkeypatch.setattr("napari_pv_inspect.workbench.show_error", lambda _: None)

    def full(*_: object) -> None:
        raise InspectionError("Nothing more can be stored: the disk is full.")

    monkeypatch.setattr(ReviewStore, "give", full)
    discard = QMessageBox.StandardButton.Discard
    monkeypatch.setattr(QMessageBox, "question", lambda *_: discard)
    state = dock.workbench.review.state
    state.commands.give((0, 0), VerdictKind.OK)
    qtbot.waitUntil(lambda: state.storage.is_failing)
    patience: list[float] = []
    wait = state.storage.wait
    monkeypatch.setattr(state.storage, "wait", lambda s: patience.append(s) or wait(s))
    viewer.close()
    assert patience == [LITTLE_PATIENCE_S]


def test_an_attempt_that_fails_ends_the_wait(tmp_path: Path) -> None:
    def fails(_: ReviewStore) -> None:
        raise InspectionError("The disk is full.")

    journal = Journal(lambda _: None, lambda _: None, lambda _: None)
    journal.attach(tmp_path, fails, lambda _: None)
    assert not journal.wait(600)  # far beyond what a test may take
    assert journal.pending == 1
    journal.close(give_up=True)


def test_tiles_of_half_cells_have_their_captions_close_below(
    workbench: Any, tiny_inspection: Inspection
) -> None:
    _, dock, cells = workbench
    show(dock, tiny_inspection)
    tiles = tiny_inspection.tiles
    flat = replace(tiles.grid.layout, cell_aspect=2.0)
    half = replace(tiles, grid=replace(tiles.grid, layout=flat))
    width = cells.cells.thumbnail.width()
    show(dock, replace(tiny_inspection, layout=flat, tiles=half, cracks=None))
    assert cells.cells.thumbnail.width() == width
    height = cells.view.gridSize().height()
    assert height == cells.cells.thumbnail.height() + BAR + GAP
    assert height < 0.6 * width + BAR + GAP


def test_the_camera_stays_when_the_gallery_only_lists_again(
    saved: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, dock, cells = saved
    dock.workbench.model.select_cell((1, 1))
    looked: list[tuple[int, int]] = []
    monkeypatch.setattr(dock.workbench.navigator, "to_cell", lambda *cell: looked.append(cell))
    cells.zoom.setValue(120)
    cells.fit()
    cells.order.setCurrentText("by crack score")
    assert looked == []
    dock.workbench.model.select_cell((0, 2))
    assert looked == [(0, 2)]


def test_verdicts_come_back_with_a_result_folder(
    viewer: Any, tiny_inspection: Inspection, tmp_path: Path, qtbot: Any
) -> None:
    from napari_pv_inspect.application import build

    write_result(tiny_inspection, tmp_path / "out")
    with ReviewStore(tmp_path / "out") as store:
        store.give(Verdict(1, 2, VerdictKind.CRACK_B, "Ben", "seen"))
    dock, cells = build(viewer)
    dock.workbench.model.open_result(read_result(tmp_path / "out"))
    stored(dock, qtbot)
    assert [v.rater for v in dock.workbench.review.state.cells.others((1, 2))] == ["Ben"]
    dock.workbench.model.select_cell((1, 2))
    assert "Ben: crack B (seen)" in cells.caption.text()
    dock.workbench.review.set_rater("Ben")
    stored(dock, qtbot)
    assert dock.verdict.buttons[VerdictKind.CRACK_B].isChecked()
    cells.open_cell()
    view = large_cell(dock.workbench).view
    assert view.frame_panel.sentence == view.bicubic_panel.sentence == NO_FRAMES


@pytest.fixture
def large(saved: Any, qtbot: QtBot) -> tuple[Any, CellDock]:
    """Controls and cell view at the cell in row 2, column 2."""
    _, dock, cells = saved
    dock.workbench.model.select_cell((1, 1))
    cells.open_cell()
    view = large_cell(dock.workbench).view
    qtbot.waitUntil(lambda: view.frame is not None)
    return dock, view


def test_the_cell_view_shows_the_cell_beside_its_best_frame(large: Any) -> None:
    dock, view = large
    assert all(panel.image is not None for panel in view.panels)
    inspection = dock.workbench.model.inspection
    motion = inspection.reconstruction.motion
    frame = best_frame(inspection.registration, inspection.sequence.shape, (1, 1), motion)
    assert frame is not None
    assert inspection.sequence.names[frame] in view.frame_panel.title
    tile = inspection.tiles.tile(1, 1)
    bicubic = view.frame.bicubic
    inner = slice(8, -8), slice(8, -8)
    assert np.corrcoef(tile[inner].ravel(), bicubic[inner].ravel())[0, 1] > 0.8


def test_arrow_keys_go_to_other_cells(large: Any, qtbot: QtBot) -> None:
    dock, view = large
    press(view, Qt.Key.Key_Right, qtbot)
    assert dock.workbench.model.selected_cell == (1, 2)
    press(view, Qt.Key.Key_Down, qtbot)
    assert dock.workbench.model.selected_cell == (2, 2)
    press(view, "k", qtbot)
    assert dock.workbench.review.state.cells.verdict((2, 2)).kind is VerdictKind.OK
    stored(dock, qtbot)


def test_all_pictures_zoom_and_move_together(large: Any) -> None:
    _, view = large
    panel = view.support_panel
    place = QPointF(panel.rect().center()) + QPointF(9, 4)
    before = panel.to_picture().map(place)
    wheel = QWheelEvent(
        place,
        QPointF(panel.mapToGlobal(place.toPoint())),
        QPoint(),
        QPoint(0, 360),
        Qt.MouseButton.NoButton,
        NONE,
        Qt.ScrollPhase.NoScrollPhase,
        False,
    )
    QApplication.sendEvent(panel, wheel)
    after = panel.to_picture().map(place)
    assert (after.x(), after.y()) == pytest.approx((before.x(), before.y()), abs=1e-6)
    assert view.shared.zoom == pytest.approx(1.2**3)
    start = panel.rect().center()
    QTest.mousePress(panel, LEFT, NONE, start)
    QTest.mouseMove(panel, start + QPoint(10, 0))
    QTest.mouseRelease(panel, LEFT, NONE, start + QPoint(10, 0))
    assert view.shared.x < 0.5
    shown = [p.to_picture().map(p.picture_area().center()) for p in view.panels]
    for other in shown[1:]:
        assert (other.x(), other.y()) == pytest.approx((shown[0].x(), shown[0].y()), abs=0.5)


def draw(view: CellDock, button: Any, y: float) -> None:
    """Draw a line across the middle of the cell; ``y`` in parts of its height."""
    panel = view.cell_panel
    h, w = panel.image.height(), panel.image.width()
    start, end = (panel.transform().map(QPointF(x * w, y * h)).toPoint() for x in (0.2, 0.8))
    QTest.mousePress(panel, button, NONE, start)
    QTest.mouseMove(panel, end)
    QTest.mouseRelease(panel, button, NONE, end)


def test_brush_and_eraser_change_the_measured_length_and_can_be_undone(
    large: Any, qtbot: QtBot, tmp_path: Path
) -> None:
    dock, view = large
    state, history = dock.workbench.review.state, dock.workbench.history
    before = state.cells.features((1, 1)).crack_length_cells
    view.bar.drawing.setChecked(True)
    draw(view, LEFT, 0.3)
    assert history.undo_text == "Correct crack marks, row 2, column 2"
    stored(dock, qtbot)
    painted = state.cells.features((1, 1)).crack_length_cells
    assert painted > before + 0.3
    assert f"{painted:.2f} cell widths" in view.caption.text()
    assert ReviewStore(tmp_path / "out").mask((1, 1), state.data.rater) is not None
    view.bar.brush.setValue(15)
    draw(view, RIGHT, 0.3)
    stored(dock, qtbot)
    assert state.cells.features((1, 1)).crack_length_cells < painted - 0.3
    history.undo()
    stored(dock, qtbot)
    assert state.cells.features((1, 1)).crack_length_cells == pytest.approx(painted)
    history.undo()
    stored(dock, qtbot)
    assert state.cells.features((1, 1)).crack_length_cells == before
    assert state.cells.correction((1, 1)) is None


def test_table_and_report_are_written_with_the_module_data(
    saved: Any, qtbot: QtBot, tmp_path: Path
) -> None:
    _, dock, _ = saved
    dock.workbench.review.state.commands.give((0, 0), VerdictKind.INACTIVE)
    dock.export.fields["serial_number"].setText("PV-0815")
    dock.export.fields["current_a"].setText("8,5")
    dock.export.fields["serial_number"].editingFinished.emit()
    dock.export.export.click()
    page = tmp_path / "out" / "review.html"
    qtbot.waitUntil(page.exists)
    assert "PV-0815" in page.read_text()
    assert "inactive_area" in (tmp_path / "out" / "verdicts.csv").read_text()
    assert ReviewStore(tmp_path / "out").module_data().current_a == 8.5
    qtbot.waitUntil(lambda: "review.html" in dock.run.message.text())


def test_a_number_that_is_none_is_one_sentence(saved: Any, monkeypatch: Any) -> None:
    _, dock, _ = saved
    popups: list[str] = []
    monkeypatch.setattr("napari_pv_inspect.workbench.show_error", popups.append)
    dock.export.fields["exposure_s"].setText("long")
    dock.export.fields["exposure_s"].editingFinished.emit()
    assert len(popups) == 1
    assert dock.export.fields["exposure_s"].text() == ""


def test_the_name_of_the_rater_is_remembered(
    saved: Any, make_napari_viewer: Callable[..., Any]
) -> None:
    _, dock, _ = saved
    dock.verdict.rater.setText("Ada")
    dock.verdict.rater.editingFinished.emit()
    assert Workbench.of(make_napari_viewer()).review.state.data.rater == "Ada"


def test_every_control_of_the_review_has_a_tooltip(large: Any) -> None:
    from qtpy.QtWidgets import QAbstractSlider, QAbstractSpinBox, QPushButton

    dock, view = large
    for kind in (QPushButton, QAbstractSpinBox, QAbstractSlider, QLineEdit):
        for control in view.findChildren(kind) + dock.export.findChildren(kind):
            assert control.toolTip() or control.parentWidget().toolTip(), control


def test_outlines_enclose_their_pixels() -> None:
    mask = np.zeros((10, 12), bool)
    mask[4, 2:9] = True
    (line,) = contours(mask)
    x, y = line.T
    assert (x.min(), x.max()) == pytest.approx((2, 9), abs=0.15)
    assert (y.min(), y.max()) == pytest.approx((4, 5), abs=0.15)


def test_opening_the_result_again_goes_on_with_its_frames(
    saved: Any, qtbot: QtBot, tmp_path: Path
) -> None:
    _, dock, cells = saved
    model, state = dock.workbench.model, dock.workbench.review.state
    before = model.inspection
    model.select_cell((1, 1))
    state.commands.give((1, 1), VerdictKind.CRACK_B)
    stored(dock, qtbot)
    dock.workbench.open(tmp_path / "out")
    qtbot.waitUntil(lambda: model.inspection not in (None, before))
    qtbot.waitUntil(lambda: state.cells.verdict((1, 1)) is not None)
    assert state.storage.folder == (tmp_path / "out").resolve()
    model.select_cell((1, 1))
    cells.open_cell()
    view = large_cell(dock.workbench).view
    qtbot.waitUntil(lambda: view.frame is not None)
    stored(dock, qtbot)


def test_another_sequence_does_not_come_over_verdicts_that_are_not_saved_unless_told_to(
    workbench: Any,
    tiny_folder: Path,
    tiny_inspection: Inspection,
    monkeypatch: pytest.MonkeyPatch,
    qtbot: QtBot,
) -> None:
    _, dock, _ = workbench
    show(dock, tiny_inspection)
    asked: list[str] = []
    answers = [QMessageBox.StandardButton.Cancel] * 2 + [QMessageBox.StandardButton.Discard]
    monkeypatch.setattr(
        QMessageBox, "question", lambda *given: asked.append(given[2]) or answers.pop(0)
    )
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_: ("", ""))
    before, state = dock.workbench.model.sequence, dock.workbench.review.state
    state.commands.give((0, 1), VerdictKind.CRACK_A)
    dock.workbench.open(tiny_folder)
    assert not dock.workbench.opener.busy
    dock.workbench.model.change_settings(dark_frame=tiny_folder / "dark.tif")
    assert dock.workbench.model.settings.dark_frame is None
    assert state.cells.verdict((0, 1)).kind is VerdictKind.CRACK_A
    dock.workbench.open(tiny_folder)
    qtbot.waitUntil(lambda: dock.workbench.model.sequence is not before)
    assert state.cells.verdict((0, 1)) is None
    sentence = "1 entries of the review are not stored, because the result was not saved yet."
    assert asked == [f"{sentence} Discard them?"] * 3


def test_the_focus_alone_selects_no_other_cell(saved: Any, qtbot: QtBot) -> None:
    """A verdict given after that would be about a cell that nobody chose."""
    viewer, dock, cells = saved
    state, model = dock.workbench.review.state, dock.workbench.model
    model.select_cell((0, 3))
    state.commands.give((0, 3), VerdictKind.CRACK_A)
    model.select_cell((1, 0))
    state.listing.set_filter((VerdictKind.CRACK_A,))
    assert state.listing.cells == ((0, 3),)
    main_window(viewer).activateWindow()
    cells.view.setFocus()
    qtbot.waitUntil(cells.view.hasFocus)
    assert model.selected_cell == (1, 0)
    QTest.keyClick(cells.view, "c")
    assert state.cells.verdict((1, 0)).kind is VerdictKind.CRACK_C
    assert state.cells.verdict((0, 3)).kind is VerdictKind.CRACK_A
