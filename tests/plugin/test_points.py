"""Editing crossing points on the frames, as a user does it."""

from __future__ import annotations

from threading import Event
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot
from qtpy.QtCore import Qt

from napari_pv_inspect import appearance
from napari_pv_inspect.layers.points import COLOURS
from napari_pv_inspect.models.workbench import RunState
from pv_inspect.calibration.calibrate import calibrate
from pv_inspect.settings import Stage
from tests.plugin.napari_mouse import move_to, press, release_at
from tests.waiting import LONG_S


@pytest.fixture
def detected(workbench: Any, replayed: Any, qtbot: QtBot) -> tuple[Any, Any, Any]:
    """Viewer, dock and points layer with the whole tiny inspection open."""
    viewer, dock, _ = workbench
    dock.workbench.model.revise(replayed.inspection)
    viewer.dims.set_current_step(0, 2)
    dock.points.select.click()
    return viewer, dock, viewer.layers["Crossing points"]


def rest(dock: Any, qtbot: QtBot) -> None:
    """Wait until all frames have followed."""
    qtbot.waitUntil(lambda: not dock.workbench.recalibration.busy)


def row_of(dock: Any, frame: int, crossing: int) -> int:
    marks = dock.workbench.points.marks
    return int(np.flatnonzero((marks.frame == frame) & (marks.crossing == crossing))[0])


def drag(layer: Any, rows: list[int], by: tuple[float, float]) -> None:
    """What napari does between the press and the release of the button."""
    layer.selected_data = set(rows)
    centre = layer.data[rows].mean(axis=0)
    press(layer, centre)
    move_to(layer, centre + np.array([0.0, by[0] / 2, by[1] / 2]))
    release_at(layer, centre + np.array([0.0, *by]))


def test_a_dragged_point_is_an_edit_that_the_fit_follows_and_undo_takes_back(
    detected: Any, qtbot: QtBot
) -> None:
    viewer, dock, layer = detected
    workbench, grid = dock.workbench, viewer.layers["Fitted grid"]
    whole = workbench.model.inspection
    before, lines = layer.data.copy(), grid.data.copy()
    row = row_of(dock, 2, 6)
    drag(layer, [row], (3.0, -2.0))
    np.testing.assert_allclose(layer.data[row] - before[row], [0.0, 3.0, -2.0])
    assert str(layer.symbol[row]) == appearance.POINT_SYMBOLS[2]
    np.testing.assert_allclose(layer.border_color[row], COLOURS[2], atol=1e-6)
    fitted = grid.data[:, 0, 0] == 2
    qtbot.waitUntil(lambda: not np.array_equal(grid.data[fitted], lines[fitted]))
    assert "1 edited" in dock.points.state.text()
    assert workbench.editor.provisional
    assert workbench.model.inspection.calibration is None
    rest(dock, qtbot)
    fit = workbench.model.inspection.calibration
    assert fit is not None
    assert not workbench.editor.provisional
    assert workbench.model.to_do == {s for s in Stage if s.index >= Stage.REGISTER.index}
    workbench.history.undo()
    assert workbench.model.inspection is whole
    np.testing.assert_array_equal(layer.data, before)
    np.testing.assert_allclose(grid.data, lines)
    workbench.history.redo()
    assert layer.data[row, 1] == before[row, 1] + 3.0
    assert not workbench.model.inspection.complete
    rest(dock, qtbot)


def test_keys_undo_while_the_canvas_or_the_dock_has_the_focus(detected: Any, qtbot: QtBot) -> None:
    viewer, dock, layer = detected
    drag(layer, [row_of(dock, 2, 6)], (3.0, -2.0))
    shortcut = next(
        s for key, s in dock.workbench.shortcuts.bound.items() if key.sequence == "Ctrl+Z"
    )
    shortcut.activated.emit()
    assert not dock.workbench.editor.edits
    assert viewer.layers.selection.active is layer
    rest(dock, qtbot)


def test_a_deleted_point_is_predicted_and_an_added_one_is_edited(
    detected: Any, qtbot: QtBot
) -> None:
    _, dock, layer = detected
    row = row_of(dock, 2, 6)
    n = len(layer.data)
    layer.selected_data = {row}
    qtbot.mouseClick(dock.points.delete, Qt.MouseButton.LeftButton)
    assert len(layer.data) == n
    assert str(layer.symbol[row]) == appearance.POINT_SYMBOLS[1]
    where = layer.data[row] + [0.0, 0.7, 0.2]
    layer.add(where)
    assert len(layer.data) == n
    np.testing.assert_allclose(layer.data[row], where)
    assert str(layer.symbol[row]) == appearance.POINT_SYMBOLS[2]
    # napari's own key for deleting.
    layer.selected_data = {row}
    layer.remove_selected()
    assert len(layer.data) == n
    assert str(layer.symbol[row]) == appearance.POINT_SYMBOLS[1]
    rest(dock, qtbot)


def test_a_point_far_from_every_crossing_is_refused_in_a_sentence(detected: Any) -> None:
    _, dock, layer = detected
    before, told = layer.data.copy(), []
    undo = dock.workbench.history.undo_text
    dock.workbench.model.noticed.connect(lambda text, _: told.append(text))
    layer.add([2.0, -80.0, -80.0])
    np.testing.assert_array_equal(layer.data, before)
    assert "half a cell" in told[-1]
    assert dock.workbench.history.undo_text == undo


def test_points_of_other_frames_can_be_neither_moved_nor_deleted(
    detected: Any, qtbot: QtBot
) -> None:
    viewer, dock, layer = detected
    before = layer.data.copy()
    here, there = row_of(dock, 2, 6), row_of(dock, 3, 6)
    drag(layer, [there], (4.0, 4.0))
    np.testing.assert_array_equal(layer.data, before)
    drag(layer, [here, there], (4.0, 4.0))
    np.testing.assert_array_equal(layer.data[there], before[there])
    np.testing.assert_allclose(layer.data[here], before[here] + [0, 4, 4])
    layer.selected_data = set(range(len(layer.data)))
    layer.remove_selected()
    assert {place[0] for place in dock.workbench.editor.edits.points} == {2}
    dock.workbench.history.undo()
    dock.workbench.history.undo()
    np.testing.assert_array_equal(layer.data, before)
    viewer.dims.set_current_step(0, 0)
    assert dock.workbench.model.inspection.complete


def test_changing_the_frame_in_the_middle_of_a_drag_takes_it_back(detected: Any) -> None:
    viewer, dock, layer = detected
    before, row = layer.data.copy(), row_of(dock, 2, 6)
    layer.selected_data = {row}
    press(layer, layer.data[row])
    move_to(layer, layer.data[row] + [0.0, 9.0, 9.0])
    assert not np.array_equal(layer.data, before)
    viewer.dims.set_current_step(0, 3)
    np.testing.assert_array_equal(layer.data, before)
    assert not layer.selected_data
    assert not dock.workbench.editor.edits


def test_what_else_is_done_to_the_layer_is_taken_back(detected: Any) -> None:
    _, dock, layer = detected
    before = layer.data.copy()
    layer.data = np.append(before, before[:3], axis=0)
    np.testing.assert_array_equal(layer.data, before)
    layer.data = np.zeros((0, 3))
    np.testing.assert_array_equal(layer.data, before)
    assert not dock.workbench.editor.edits


def test_a_tool_brings_the_deleted_layer_back(detected: Any) -> None:
    viewer, dock, layer = detected
    viewer.layers.remove(layer)
    dock.points.delete.click()
    dock.points.add.setChecked(False)
    dock.points.add.click()
    again = viewer.layers["Crossing points"]
    assert again is not layer
    assert again.mode == "add"
    assert viewer.layers.selection.active is again
    again.mode = "pan_zoom"
    assert not dock.points.add.isChecked()


def test_points_rest_while_a_run_goes_on_and_the_run_uses_the_edited_ones(
    detected: Any, replayed: Any, qtbot: QtBot
) -> None:
    _, dock, layer = detected
    row, before = row_of(dock, 2, 6), layer.data.copy()
    drag(layer, [row], (3.0, 0.0))
    rest(dock, qtbot)
    edited = dock.workbench.editor.crossings
    replayed.go_on = False
    dock.run.run.click()
    qtbot.waitUntil(lambda: replayed.starts != [])
    assert replayed.starts[-1].crossings is edited
    assert not layer.editable
    assert not dock.points.select.isEnabled()
    assert not dock.workbench.editor.move(2, {6: (1.0, 1.0)})
    # Undone meanwhile: the run ends with the edited points, the workbench goes on without.
    dock.workbench.history.undo()
    dock.run.cancel.click()
    replayed.go_on = True
    qtbot.waitUntil(lambda: dock.workbench.model.run_state is RunState.IDLE)
    np.testing.assert_allclose(layer.data[row], before[row])


def test_a_new_detection_discards_edits_and_says_so(detected: Any, replayed: Any) -> None:
    from dataclasses import replace

    _, dock, layer = detected
    drag(layer, [row_of(dock, 2, 6)], (3.0, 0.0))
    told: list[str] = []
    dock.workbench.model.noticed.connect(lambda text, _: told.append(text))
    whole = replayed.inspection
    anew = replace(whole, crossings=replace(whole.crossings))
    dock.workbench.model.revise(anew)
    assert "1 edited points" in told[0]
    assert not dock.workbench.editor.edits
    # Undoing an edit of points that are gone changes nothing.
    dock.workbench.history.undo()
    assert dock.workbench.model.inspection is anew


def test_a_new_sequence_forgets_all_edits(detected: Any, tiny_sequence: Any, qtbot: QtBot) -> None:
    viewer, dock, layer = detected
    drag(layer, [row_of(dock, 2, 6)], (3.0, 0.0))
    dock.workbench.model.open(tiny_sequence)
    assert dock.workbench.editor.crossings is None
    assert "Crossing points" not in viewer.layers
    assert not dock.points.select.isEnabled()
    qtbot.wait(400)


def test_a_fit_of_all_frames_is_dropped_if_the_window_closes_meanwhile(
    detected: Any, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, dock, layer = detected
    begun, go_on, ended = Event(), Event(), Event()

    def slow(*given: Any) -> Any:
        begun.set()
        assert go_on.wait(LONG_S)
        fit = calibrate(*given)
        ended.set()
        return fit

    monkeypatch.setattr("napari_pv_inspect.live.recalibration.calibrate", slow)
    drag(layer, [row_of(dock, 2, 6)], (3.0, 0.0))
    qtbot.waitUntil(begun.is_set)
    dock.workbench.close()
    go_on.set()
    assert ended.wait(LONG_S)
    qtbot.wait(50)
    assert not dock.workbench.recalibration.busy
    assert dock.workbench.model.inspection.calibration is None
