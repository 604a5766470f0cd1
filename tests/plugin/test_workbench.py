from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from napari.layers import Image, Points, Vectors
from pytestqt.qtbot import QtBot
from qtpy.QtCore import Qt

from napari_pv_inspect.docks.gallery import BY_CRACKS
from napari_pv_inspect.docks.inspect import InspectDock
from napari_pv_inspect.layers.layer_data import sequence_layer
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.workbench import Workbench
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.sequence.sequence import FrameSequence


def finish(dock: Any, qtbot: QtBot) -> None:
    qtbot.waitUntil(lambda: dock.workbench.model.run_state is RunState.IDLE)


def run(dock: Any, qtbot: QtBot) -> None:
    qtbot.mouseClick(dock.run.run, Qt.MouseButton.LeftButton)
    finish(dock, qtbot)


def test_opening_shows_the_frames_and_prefills_the_layout(workbench: Any) -> None:
    viewer, dock, _ = workbench
    assert [layer.name for layer in viewer.layers] == ["Frames"]
    assert viewer.dims.nsteps[0] == 5
    assert (dock.module.form["rows"].value(), dock.module.form["cols"].value()) == (3, 4)
    assert "5 frames" in dock.headline.text()
    assert "frame_" in viewer.canvas.overlays.text.text


def test_an_unknown_layout_is_guessed_and_asks_to_be_confirmed(
    workbench: Any, tiny_sequence: FrameSequence, qtbot: QtBot
) -> None:
    _, dock, _ = workbench
    dock.workbench.model.open(replace(tiny_sequence, layout_hint={}))
    assert dock.module.form["rows"].value() == 0
    qtbot.waitUntil(lambda: dock.module.form["rows"].value() > 0)
    assert (dock.module.form["rows"].value(), dock.module.form["cols"].value()) == (3, 4)
    assert not dock.module.confirm.isHidden()
    dock.module.form["cols"].setValue(5)
    assert dock.module.confirm.isHidden()


def test_detect_draws_points_and_grid_that_follow_the_time_slider(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    viewer, dock, _ = workbench
    qtbot.mouseClick(dock.module.detect, Qt.MouseButton.LeftButton)
    finish(dock, qtbot)
    points, grid = viewer.layers["Crossing points"], viewer.layers["Fitted grid"]
    assert isinstance(points, Points)
    assert isinstance(grid, Vectors)
    n_crossings = replayed.inspection.layout.n_crossings
    for frame in (0, 3):
        viewer.dims.set_current_step(0, frame)
        assert (points.data[:, 0] == frame).sum() == n_crossings
        assert points.ndim == grid.ndim == viewer.dims.ndim
        shown = grid.data[grid.data[:, 0, 0] == frame]
        assert len(shown)
    assert "Module image" not in viewer.layers
    assert "px" in viewer.canvas.overlays.text.text


def test_a_run_shows_module_image_support_cracks_and_cells(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    viewer, dock, cells = workbench
    run(dock, qtbot)
    image = viewer.layers["Module image"]
    np.testing.assert_array_equal(image.data, replayed.inspection.reconstruction.image)
    assert not viewer.layers["Support"].visible
    assert not viewer.layers["Contradictions"].visible
    assert viewer.layers["Cracks"].data.shape == image.data.shape
    assert cells.cells.rowCount() == 12
    assert dock.result.save.isEnabled()
    assert dock.run.progress.value() == dock.run.progress.maximum()
    # The module image lies right of the frames.
    assert image.translate[-1] > 240


def test_intermediate_images_are_shown(workbench: Any, replayed: Any, qtbot: QtBot) -> None:
    viewer, dock, _ = workbench
    replayed.go_on = False
    dock.run.run.click()
    qtbot.waitUntil(lambda: "Module image" in viewer.layers)
    preview = viewer.layers["Module image"]
    assert preview.data.shape[0] < replayed.inspection.reconstruction.image.shape[0]
    assert dock.run.cancel.isEnabled()
    assert not dock.run.run.isEnabled()
    assert 0 < dock.run.progress.value() < dock.run.progress.maximum()
    replayed.go_on = True
    finish(dock, qtbot)
    assert viewer.layers["Module image"] is preview


def test_cancel_brings_the_last_whole_result_back(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    viewer, dock, cells = workbench
    run(dock, qtbot)
    whole = dock.workbench.model.inspection
    replayed.go_on = False
    dock.image.form["prior_weight"].number.setValue(0.5)
    assert "reconstruct" in dock.run.message.text()
    dock.run.run.click()
    qtbot.waitUntil(lambda: viewer.layers["Module image"].data is not whole.reconstruction.image)
    dock.run.cancel.click()
    finish(dock, qtbot)
    assert dock.workbench.model.inspection is whole
    assert viewer.layers["Module image"].data is whole.reconstruction.image
    assert "Cracks" in viewer.layers
    assert cells.cells.rowCount() == 12


def test_kappa_bends_the_shown_grid_and_fit_brings_it_back(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    viewer, dock, _ = workbench
    dock.module.detect.click()
    finish(dock, qtbot)
    viewer.dims.set_current_step(0, 2)
    grid = viewer.layers["Fitted grid"]
    before = grid.data.copy()
    dock.lens.form["kappa"].slider.setValue(40)
    qtbot.waitUntil(lambda: not np.array_equal(grid.data, before))
    others = grid.data[:, 0, 0] != 2
    np.testing.assert_array_equal(grid.data[others], before[before[:, 0, 0] != 2])
    assert "px" in dock.lens.residual.text()
    dock.lens.form["kappa"].automatic.click()
    qtbot.waitUntil(lambda: np.array_equal(grid.data, before))
    assert dock.workbench.model.settings.kappa is None


def test_the_bent_grid_moves_on_with_the_time_slider(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    viewer, dock, _ = workbench
    dock.module.detect.click()
    finish(dock, qtbot)
    grid = viewer.layers["Fitted grid"]
    before = grid.data.copy()
    viewer.dims.set_current_step(0, 0)
    dock.lens.form["kappa"].slider.setValue(40)
    viewer.dims.set_current_step(0, 4)
    qtbot.waitUntil(
        lambda: not np.array_equal(grid.data[grid.data[:, 0, 0] == 4], before[before[:, 0, 0] == 4])
    )
    np.testing.assert_array_equal(grid.data[grid.data[:, 0, 0] == 0], before[before[:, 0, 0] == 0])


@pytest.mark.parametrize(
    "name", ["Frames", "Crossing points", "Fitted grid", "Module image", "Support", "Cracks"]
)
def test_any_layer_may_be_deleted_and_another_run_works(
    workbench: Any, replayed: Any, qtbot: QtBot, name: str
) -> None:
    viewer, dock, cells = workbench
    run(dock, qtbot)
    viewer.layers.remove(name)
    dock.lens.form["kappa"].slider.setValue(100)
    cells.view.setCurrentIndex(cells.cells.index(3))
    qtbot.wait(150)
    run(dock, qtbot)
    if name != "Frames":
        assert "Module image" in viewer.layers


def test_all_layers_may_be_deleted_during_a_run(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    viewer, dock, _ = workbench
    replayed.go_on = False
    dock.run.run.click()
    qtbot.waitUntil(lambda: "Module image" in viewer.layers)
    viewer.layers.clear()
    replayed.go_on = True
    finish(dock, qtbot)
    assert isinstance(viewer.layers["Module image"], Image)


def test_a_click_on_a_cell_moves_the_camera_to_it(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    viewer, dock, cells = workbench
    run(dock, qtbot)
    index = cells.cells.index(5)
    assert cells.cells.cell(index) == (1, 1)
    cells.view.setCurrentIndex(index)
    _, row, col = viewer.scene.camera.center
    image = viewer.layers["Module image"]
    middle = replayed.inspection.reconstruction.grid.to_pixels(np.array([[1.5, 1.5]]))[0]
    y, x = image.data_to_world((middle[1], middle[0]))[-2:]
    assert (row, col) == pytest.approx((y, x), abs=1.0)
    assert "Row 2, column 2" in cells.caption.text()


def test_cells_can_be_sorted_by_crack_score(workbench: Any, replayed: Any, qtbot: QtBot) -> None:
    _, dock, cells = workbench
    run(dock, qtbot)
    cells.order.setCurrentText(BY_CRACKS)
    scores = {(f.row, f.col): f.crack_score for f in replayed.inspection.cracks.cells}
    shown = [scores[cells.cells.cell(cells.cells.index(i))] for i in range(12)]
    assert shown == sorted(shown, reverse=True)


def test_closing_mid_run_stops_the_run(workbench: Any, replayed: Any, qtbot: QtBot) -> None:
    viewer, dock, _ = workbench
    replayed.go_on = False
    dock.run.run.click()
    qtbot.waitUntil(lambda: dock.workbench.model.draft.registration is not None)
    viewer.close()
    assert replayed.closed == 1
    qtbot.wait(100)


@pytest.mark.usefixtures("make_napari_viewer")
def test_the_dock_may_be_closed_mid_run_and_opened_again(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    viewer, dock, _ = workbench
    model = dock.workbench.model
    replayed.go_on = False
    dock.run.run.click()
    qtbot.waitUntil(lambda: model.draft.registration is not None)
    viewer.window.remove_dock_widget(dock)
    dock.deleteLater()
    del dock
    qtbot.wait(50)
    replayed.go_on = True
    qtbot.waitUntil(lambda: model.run_state is RunState.IDLE)
    assert model.inspection.complete
    again = InspectDock(viewer)
    viewer.window.add_dock_widget(again)
    assert again.result.save.isEnabled()
    assert "5 frames" in again.headline.text()


def test_a_layer_of_the_reader_becomes_the_frames_layer(
    workbench: Any, tiny_folder: Path, qtbot: QtBot
) -> None:
    viewer, dock, _ = workbench
    other = FrameSequence.open(tiny_folder)
    data, attributes, _ = sequence_layer(other)
    layer = viewer.add_image(data, **attributes)
    assert dock.workbench.model.sequence is other
    assert layer.visible
    assert list(viewer.layers) == [layer], "the earlier sequence is gone"
    assert layer.name == "Frames"


def test_save_writes_the_result_folder(
    workbench: Any, replayed: Any, qtbot: QtBot, tmp_path: Path
) -> None:
    _, dock, _ = workbench
    run(dock, qtbot)
    dock.save(tmp_path / "out")
    qtbot.waitUntil(lambda: not dock.workbench.saver.busy)
    assert (tmp_path / "out" / "result.json").is_file()


def test_what_can_not_be_opened_or_saved_is_one_sentence_in_the_dock(
    workbench: Any, replayed: Any, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, dock, _ = workbench
    popups: list[str] = []
    monkeypatch.setattr("napari_pv_inspect.workbench.show_error", popups.append)
    dock.workbench.open(tmp_path / "nowhere")
    qtbot.waitUntil(lambda: not dock.workbench.opener.busy)
    assert "nowhere" in dock.run.message.text()
    run(dock, qtbot)
    (tmp_path / "file").write_text("x")
    dock.save(tmp_path / "file" / "out")
    qtbot.waitUntil(lambda: not dock.workbench.saver.busy)
    assert len(popups) == 2
    assert "\n" not in dock.run.message.text()


def test_every_control_has_a_tooltip(workbench: Any) -> None:
    from qtpy.QtWidgets import (
        QAbstractSlider,
        QAbstractSpinBox,
        QComboBox,
        QPushButton,
        QScrollBar,
    )

    _, dock, cells = workbench
    for kind in (QPushButton, QAbstractSpinBox, QComboBox, QAbstractSlider):
        for control in (*dock.findChildren(kind), cells.order):
            if isinstance(control, QScrollBar):
                continue
            told = control.toolTip() or control.parentWidget().toolTip()
            assert told, f"{control} has no tooltip"


def test_one_workbench_per_viewer(workbench: Any, tiny_inspection: Inspection) -> None:
    viewer, dock, _ = workbench
    assert Workbench.of(viewer) is dock.workbench


def test_the_controls_alone_bring_the_gallery_with_the_first_cells(
    viewer: Any, tiny_sequence: FrameSequence, replayed: Any, qtbot: QtBot
) -> None:
    dock = InspectDock(viewer)
    viewer.window.add_dock_widget(dock)
    dock.workbench.model.open(tiny_sequence)
    assert not dock.workbench.has_gallery
    run(dock, qtbot)
    assert "Cells" in viewer.window.dock_widgets


def test_lambda_is_automatic_until_the_user_moves_it_and_can_be_again(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    _, dock, _ = workbench
    model = dock.workbench.model
    assert dock.image.form["prior_weight"].automatic.isChecked()
    dock.image.form["prior_weight"].number.setValue(2.0)
    assert not dock.image.form["prior_weight"].automatic.isChecked()
    assert model.settings.prior_weight == 2.0
    dock.image.form["prior_weight"].automatic.setChecked(True)
    assert model.settings.prior_weight is None
    run(dock, qtbot)
    found = replayed.inspection.reconstruction.prior_weight
    assert dock.image.form["prior_weight"].number.value() == pytest.approx(found, abs=1e-3)
