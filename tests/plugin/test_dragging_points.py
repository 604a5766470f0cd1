"""The grid follows a dragged point at once; what has not settled is not lost."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot
from qtpy.QtCore import QPoint, QPointF, Qt
from qtpy.QtGui import QWheelEvent
from qtpy.QtWidgets import QApplication

from tests.plugin.napari_mouse import move_to, press, release_at

FRAME, CROSSING = 2, 6


@pytest.fixture
def detected(workbench: Any, replayed: Any) -> tuple[Any, Any, Any, int]:
    """Viewer, dock, points layer and the row of a crossing that is dragged."""
    viewer, dock, _ = workbench
    dock.workbench.live_cell.commit()
    dock.workbench.history.clear()
    dock.workbench.model.revise(replayed.inspection)
    viewer.dims.set_current_step(0, FRAME)
    dock.points.select.click()
    marks = dock.workbench.points.marks
    row = int(np.flatnonzero((marks.frame == FRAME) & (marks.crossing == CROSSING))[0])
    layer = viewer.layers["Crossing points"]
    layer.selected_data = {row}
    press(layer, layer.data[row])
    return viewer, dock, layer, row


def drag_on(layer: Any, row: int, by: tuple[float, float]) -> None:
    move_to(layer, layer.data[row] + np.array([0.0, *by]))


def release(layer: Any, row: int) -> None:
    release_at(layer, layer.data[row].copy())


def lines(viewer: Any, frame: int = FRAME) -> Any:
    grid = viewer.layers["Fitted grid"].data
    return grid[grid[:, 0, 0] == frame].copy()


def test_the_grid_and_the_residual_follow_a_point_before_it_is_let_go(
    detected: Any, qtbot: QtBot
) -> None:
    viewer, dock, layer, row = detected
    before, other, state = lines(viewer), lines(viewer, 3), dock.points.state.text()
    for _ in range(3):
        drag_on(layer, row, (0.5, -0.5))
    qtbot.waitUntil(lambda: not np.array_equal(lines(viewer), before))
    np.testing.assert_array_equal(lines(viewer, 3), other)
    assert dock.points.state.text() != state
    assert "dragged" in dock.lens.residual.text()
    assert not dock.workbench.editor.edits
    assert dock.workbench.history.undo_text is None


def test_the_grid_of_a_dragged_point_is_the_one_that_the_edit_has(
    detected: Any, qtbot: QtBot
) -> None:
    viewer, dock, layer, row = detected
    before = lines(viewer)
    drag_on(layer, row, (1.0, 1.0))
    qtbot.waitUntil(lambda: not np.array_equal(lines(viewer), before))
    held = lines(viewer)
    release(layer, row)
    assert dock.workbench.editor.provisional
    qtbot.waitUntil(lambda: "dragged" not in dock.lens.residual.text())
    np.testing.assert_allclose(lines(viewer), held, atol=1e-3)
    qtbot.waitUntil(lambda: not dock.workbench.recalibration.busy)


def test_one_drag_is_one_undo(detected: Any, qtbot: QtBot) -> None:
    viewer, dock, layer, row = detected
    before, points = lines(viewer), layer.data.copy()
    for _ in range(5):
        drag_on(layer, row, (0.3, 0.2))
        qtbot.wait(20)
    release(layer, row)
    assert dock.workbench.history.undo_text == "Move a crossing point"
    dock.workbench.history.undo()
    assert dock.workbench.history.undo_text is None
    np.testing.assert_array_equal(layer.data, points)
    qtbot.waitUntil(lambda: np.allclose(lines(viewer), before))
    qtbot.waitUntil(lambda: not dock.workbench.recalibration.busy)


def test_a_drag_that_is_taken_back_leaves_the_fitted_grid(detected: Any, qtbot: QtBot) -> None:
    viewer, dock, layer, row = detected
    before = lines(viewer)
    drag_on(layer, row, (2.0, 2.0))
    qtbot.waitUntil(lambda: not np.array_equal(lines(viewer), before))
    viewer.dims.set_current_step(0, 3)
    qtbot.waitUntil(lambda: np.array_equal(lines(viewer), before))
    assert not dock.workbench.editor.edits
    assert "dragged" not in dock.lens.residual.text()


def test_after_closing_a_dragged_point_moves_no_grid(detected: Any, qtbot: QtBot) -> None:
    viewer, dock, layer, row = detected
    before = lines(viewer)
    drag_on(layer, row, (2.0, 2.0))
    qtbot.waitUntil(lambda: not np.array_equal(lines(viewer), before), timeout=2000)
    drag_on(layer, row, (1.0, 0.0))  # its fit is still to come
    dock.workbench.close()
    before = lines(viewer)
    qtbot.wait(120)
    np.testing.assert_array_equal(lines(viewer), before)


def test_undo_takes_back_a_slider_that_has_not_settled_and_nothing_else(workbench: Any) -> None:
    _, dock, _ = workbench
    weight, model = dock.image.form["prior_weight"], dock.workbench.model
    dock.frames.table.tick_wanted.emit(1, False)
    weight.slider.setValue(300)
    assert model.settings.prior_weight is not None
    dock.workbench.history.undo()
    assert model.settings.prior_weight is None
    assert model.settings.skip_frames == (model.sequence.names[1],)
    dock.workbench.history.redo()
    assert model.settings.prior_weight == pytest.approx(weight.value(), rel=0.01)


def test_redo_does_not_bring_back_what_a_slider_has_overtaken(workbench: Any) -> None:
    _, dock, _ = workbench
    model = dock.workbench.model
    dock.image.form["prior_weight"].slider.setValue(300)
    dock.workbench.history.undo()
    dock.image.form["magnification"].slider.setValue(300)
    dock.workbench.history.redo()
    assert model.settings.prior_weight is None
    assert dock.workbench.history.undo_text == "Change magnification"


def test_kappa_can_be_taken_back(workbench: Any) -> None:
    _, dock, _ = workbench
    model = dock.workbench.model
    dock.workbench.history.commit()
    dock.lens.form["kappa"].slider.setValue(100)
    dock.workbench.history.commit()
    dock.lens.form["kappa"].slider.setValue(200)
    dock.workbench.history.undo()
    assert model.settings.kappa == pytest.approx(-0.3, abs=1e-3)
    dock.workbench.history.undo()
    assert model.settings.kappa is None


def test_a_run_takes_over_a_slider_and_a_number_that_is_being_typed(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    _, dock, _ = workbench
    dock.workbench.history.commit()
    dock.image.form["magnification"].slider.setValue(200)
    number = dock.image.form["prior_weight"].number
    dock.show_page("Image")
    dock.window().show()
    number.setFocus()
    number.selectAll()
    qtbot.keyClicks(number, "0.25")
    assert dock.workbench.model.settings.prior_weight is None
    # The focus need not move on every platform.
    if QApplication.focusWidget() is not number:
        number.interpretText()
    dock.run.run.click()
    assert dock.workbench.model.run_settings.prior_weight == pytest.approx(0.25)
    assert "magnification" in dock.workbench.history.undo_text
    qtbot.waitUntil(lambda: dock.workbench.model.inspection is not None)


def test_the_wheel_changes_nothing_without_the_focus(workbench: Any, qtbot: QtBot) -> None:
    _, dock, _ = workbench
    before = dock.workbench.model.settings
    for field in (
        dock.lens.form["kappa"].slider,
        dock.image.form["magnification"].number,
        dock.image.form["prior"],
        dock.module.form["rows"],
    ):
        assert not field.hasFocus()
        turn_wheel(field)
    assert dock.workbench.model.settings == before
    dock.show_page("Image")
    slider = dock.image.form["magnification"].slider
    slider.hasFocus = lambda: True
    turn_wheel(slider)
    assert dock.workbench.model.settings != before


def turn_wheel(field: Any) -> None:
    place = QPointF(field.rect().center())
    event = QWheelEvent(
        place,
        QPointF(field.mapToGlobal(place.toPoint())),
        QPoint(0, 0),
        QPoint(0, 120),
        Qt.MouseButton.NoButton,
        Qt.KeyboardModifier.NoModifier,
        Qt.ScrollPhase.NoScrollPhase,
        False,
    )
    QApplication.sendEvent(field, event)
