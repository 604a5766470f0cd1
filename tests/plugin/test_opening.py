from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from napari.layers import Layer
from pytestqt.qtbot import QtBot
from qtpy.QtCore import QMimeData, QPoint, QPointF, Qt, QUrl
from qtpy.QtGui import QDragEnterEvent, QDropEvent
from qtpy.QtWidgets import QApplication, QFileDialog

from napari_pv_inspect.application import build
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.napari_internals import canvas_area, main_window
from napari_pv_inspect.reader import read_result, read_sequence
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.results.session import Session, read_session, write_session
from pv_inspect.results.write import write_result
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Stage

MODULE_LAYERS = {"Module image", "Support", "Contradictions", "Cracks"}


@pytest.fixture
def result_folder(tiny_inspection: Inspection, tmp_path: Path) -> Path:
    folder = tmp_path / "out"
    write_result(tiny_inspection, folder)
    return folder


@pytest.fixture
def app(viewer: Any) -> tuple[Any, Any, Any]:
    return viewer, *build(viewer)


def opened(dock: Any, qtbot: QtBot) -> None:
    qtbot.waitUntil(lambda: not dock.workbench.opener.busy)


def add(viewer: Any, layers: list[Any]) -> None:
    for layer in layers:
        viewer.add_layer(Layer.create(*layer))


def names(viewer: Any) -> set[str]:
    return {layer.name for layer in viewer.layers}


def test_a_result_comes_back_with_its_frames_grid_cells_and_settings(
    app: Any, result_folder: Path, tiny_inspection: Inspection, qtbot: QtBot
) -> None:
    viewer, dock, cells = app
    dock.workbench.open(result_folder)
    opened(dock, qtbot)
    model = dock.workbench.model
    assert names(viewer) == {"Frames", "Fitted grid", "Crossing points"} | MODULE_LAYERS
    assert model.inspection.complete
    assert model.settings == tiny_inspection.settings
    assert dock.image.form["magnification"].value() == 2.0
    assert cells.cells.rowCount() == 12
    assert not model.to_do
    assert dock.steps.next.text() == "Review cells"
    model.change_settings(prior_weight=1.5)
    assert dock.steps.next.text() == "Run from reconstruct"


def test_another_lambda_runs_from_the_stored_geometry(
    app: Any, result_folder: Path, qtbot: QtBot
) -> None:
    _, dock, _ = app
    dock.workbench.open(result_folder)
    opened(dock, qtbot)
    model = dock.workbench.model
    before = model.inspection
    # With the blur that it has: to estimate it again would take longer than all the rest.
    model.change_settings(prior_weight=3.0, psf_sigma_lr_px=before.reconstruction.psf_sigma_lr_px)
    assert dock.workbench.runs.start()
    qtbot.waitUntil(lambda: model.run_state is RunState.IDLE)
    assert model.inspection.complete
    assert model.inspection.registration is before.registration
    assert not np.array_equal(model.inspection.reconstruction.image, before.reconstruction.image)


def test_the_layers_of_the_reader_become_those_of_the_workbench(
    app: Any, result_folder: Path, qtbot: QtBot
) -> None:
    viewer, dock, _ = app
    add(viewer, read_result(result_folder))
    opened(dock, qtbot)
    assert names(viewer) == {"Frames", "Fitted grid", "Crossing points"} | MODULE_LAYERS
    assert len(viewer.layers) == 7


def test_without_its_frames_a_result_is_looked_at_and_one_notice_says_so(
    app: Any, tiny_folder: Path, tmp_path: Path, tiny_inspection: Inspection, qtbot: QtBot
) -> None:
    viewer, dock, cells = app
    out = tmp_path / "out"
    shutil.copytree(tiny_folder, tmp_path / "moved")
    sequence = FrameSequence.open(tmp_path / "moved")
    write_result(replace(tiny_inspection, sequence=sequence), out)
    shutil.rmtree(tmp_path / "moved")
    notices: list[str] = []
    dock.workbench.model.noticed.connect(
        lambda text, error: notices.append(text) if error else None
    )
    add(viewer, read_result(out))
    opened(dock, qtbot)
    assert len(notices) == 1
    assert "no longer at" in notices[0]
    assert names(viewer) == MODULE_LAYERS
    assert cells.cells.rowCount() == 12
    assert dock.image.form["magnification"].value() == 2.0
    assert (dock.module.form["rows"].value(), dock.module.form["cols"].value()) == (3, 4)
    assert not dock.run.run.isEnabled()
    assert dock.steps.next.text() == "Review cells"
    cells.view.setCurrentIndex(cells.cells.index(0))
    image = viewer.layers["Module image"]
    middle = dock.workbench.model.result.need(Reconstruction).grid.to_pixels(
        np.array([[0.5, 0.5]])
    )[0]
    y, x = image.data_to_world((middle[1], middle[0]))
    assert tuple(viewer.scene.camera.center[-2:]) == pytest.approx((y, x), abs=1.0)


def test_the_selected_cell_the_frame_and_the_page_come_back(
    app: Any, result_folder: Path, qtbot: QtBot
) -> None:
    viewer, dock, _ = app
    write_session(Session((1, 2), 3, "Frames", (40.0, 50.0), 2.5), result_folder)
    dock.workbench.open(result_folder)
    opened(dock, qtbot)
    assert dock.workbench.model.selected_cell == (1, 2)
    assert viewer.dims.current_step[0] == 3
    assert dock.pages.tabText(dock.pages.currentIndex()) == "Frames"
    qtbot.waitUntil(lambda: viewer.scene.camera.zoom == pytest.approx(2.5))
    dock.workbench.model.select_cell((2, 1))
    qtbot.waitUntil(lambda: read_session(result_folder).cell == (2, 1))


def test_the_session_is_kept_beside_a_saved_result_when_the_window_closes(
    workbench: Any, replayed: Any, qtbot: QtBot, tmp_path: Path
) -> None:
    viewer, dock, _ = workbench
    dock.workbench.runs.start()
    qtbot.waitUntil(lambda: dock.workbench.model.run_state is RunState.IDLE)
    dock.save(tmp_path / "out")
    qtbot.waitUntil(lambda: dock.workbench.session.folder is not None)
    dock.workbench.model.select_cell((0, 3))
    viewer.dims.set_current_step(0, 4)
    viewer.close()
    assert read_session(tmp_path / "out").cell == (0, 3)
    assert read_session(tmp_path / "out").frame == 4


def test_a_result_that_is_being_written_is_whole_when_the_window_has_closed(
    workbench: Any, tiny_inspection: Inspection, tmp_path: Path
) -> None:
    viewer, dock, _ = workbench
    assert dock.workbench.saver.save(tiny_inspection, tmp_path / "out")
    assert not dock.workbench.saver.save(tiny_inspection, tmp_path / "other")
    viewer.close()
    assert (tmp_path / "out" / "result.json").is_file()
    assert not (tmp_path / "other").exists()


def test_a_stored_cell_that_the_module_has_not_is_ignored(
    app: Any, result_folder: Path, qtbot: QtBot
) -> None:
    _, dock, _ = app
    write_session(Session((50, 2), 99, "No such page"), result_folder)
    dock.workbench.open(result_folder)
    opened(dock, qtbot)
    assert dock.workbench.model.selected_cell is None


def drop(viewer: Any, *paths: Path) -> None:
    mime = QMimeData()
    mime.setUrls([QUrl.fromLocalFile(str(path)) for path in paths])
    target = canvas_area(main_window(viewer))
    more = (Qt.DropAction.CopyAction, mime, Qt.MouseButton.LeftButton, Qt.KeyboardModifier(0))
    # Qt delivers a drop only where the drag was let in.
    QApplication.sendEvent(target, QDragEnterEvent(QPoint(5, 5), *more))
    QApplication.sendEvent(target, QDropEvent(QPointF(5, 5), *more))


def test_a_file_of_several_series_asks_which_and_the_setting_answers(
    app: Any,
    tiny_sequence: FrameSequence,
    tmp_path: Path,
    qtbot: QtBot,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, dock, _ = app
    model = dock.workbench.model
    frames = np.stack([tiny_sequence.raw(k) for k in range(4)])
    path = tmp_path / "stack.npz"
    np.savez(path, left=frames, right=frames[:3])
    asked: list[str] = []

    def chosen(*words: Any) -> tuple[list[str], str]:
        asked.extend(map(str, words[1:]))
        return [str(path)], ""

    monkeypatch.setattr(QFileDialog, "getOpenFileNames", chosen)
    notices: list[str] = []
    model.noticed.connect(lambda text, error: notices.append(text) if error else None)
    dock.open_files.click()
    opened(dock, qtbot)
    assert model.sequence is None
    assert "holds 2 series of pictures, 1 'left' (4 of" in notices[0]
    assert "*.npz" in asked[-1]
    model.change_settings(series="right")
    assert dock.reading.form.value_of("series") == "right"
    dock.open_files.click()
    opened(dock, qtbot)
    assert model.sequence is not None
    assert len(model.sequence) == 3


def test_folders_stacks_lists_and_results_can_be_dropped(
    app: Any, tiny_folder: Path, result_folder: Path, tmp_path: Path, qtbot: QtBot
) -> None:
    viewer, dock, _ = app
    model = dock.workbench.model
    files = sorted((tiny_folder / "frames").iterdir())
    stack = tmp_path / "stack.tif"
    tifffile.imwrite(
        stack, np.stack([tifffile.imread(f) for f in files[:3]]), photometric="minisblack"
    )
    for paths, count in (((tiny_folder,), 5), ((stack,), 3), (files[:4], 4), ((result_folder,), 5)):
        drop(viewer, *paths)
        opened(dock, qtbot)
        assert len(model.sequence) == count
    assert model.inspection.complete


def test_a_dropped_folder_without_frames_is_one_sentence_and_an_array_is_left_to_napari(
    app: Any, tmp_path: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer, dock, _ = app
    left: list[Any] = []
    monkeypatch.setattr(
        type(viewer.window._qt_viewer), "_qt_open", lambda _, paths, **__: left.append(paths)
    )
    notices: list[str] = []
    dock.workbench.model.noticed.connect(
        lambda text, error: notices.append(text) if error else None
    )
    (tmp_path / "empty").mkdir()
    (tmp_path / "array").mkdir()
    (tmp_path / "array" / ".zgroup").write_text("{}")
    drop(viewer, tmp_path / "empty")
    opened(dock, qtbot)
    assert len(notices) == 1
    assert "holds no TIFF, PNG" in notices[0]
    assert left == []
    drop(viewer, tmp_path / "array")
    assert len(left) == 1
    assert not dock.workbench.opener.busy


def test_the_newest_of_two_wishes_wins(app: Any, tiny_folder: Path, qtbot: QtBot) -> None:
    _, dock, _ = app
    files = sorted((tiny_folder / "frames").iterdir())
    dock.workbench.open(tiny_folder)
    dock.workbench.open(files[:2])
    opened(dock, qtbot)
    qtbot.wait(300)
    assert len(dock.workbench.model.sequence) == 2


def test_a_layer_of_the_reader_beats_what_is_still_being_opened(
    app: Any, tiny_folder: Path, tiny_sequence: FrameSequence, qtbot: QtBot
) -> None:
    viewer, dock, _ = app
    dock.workbench.open(sorted((tiny_folder / "frames").iterdir())[:2])
    add(viewer, read_sequence(str(tiny_folder)))
    qtbot.wait(500)
    assert len(dock.workbench.model.sequence) == 5


def test_another_dark_frame_reads_the_frames_again_and_a_wrong_one_is_refused(
    app: Any, tiny_folder: Path, tiny_sequence: FrameSequence, tmp_path: Path, qtbot: QtBot
) -> None:
    _, dock, _ = app
    model = dock.workbench.model
    dock.workbench.open(tiny_folder)
    opened(dock, qtbot)
    dark, wrong = tmp_path / "dark.tif", tmp_path / "wrong.tif"
    raw = tiny_sequence.raw(0)
    tifffile.imwrite(dark, np.full_like(raw, 7))
    tifffile.imwrite(wrong, np.zeros((9, 9), raw.dtype))
    model.change_settings(prior_weight=0.7)
    model.change_settings(dark_frame=dark)
    opened(dock, qtbot)
    assert model.sequence.black_level == 7.0
    assert model.settings.prior_weight == 0.7
    assert (model.settings.rows, model.settings.cols) == (3, 4)
    assert Stage.DETECT in model.to_do
    assert dock.reading.form["dark_frame"].name.text() == "dark.tif"
    model.change_settings(dark_frame=wrong)
    opened(dock, qtbot)
    assert model.settings.dark_frame == dark
    assert "wrong.tif" in dock.run.message.text()
    model.change_settings(dark_frame=None)
    opened(dock, qtbot)
    assert model.sequence.black_level == tiny_sequence.black_level


def test_the_dark_frame_of_the_settings_is_used_for_what_napari_reads(
    app: Any, tiny_folder: Path, tiny_sequence: FrameSequence, tmp_path: Path, qtbot: QtBot
) -> None:
    viewer, dock, _ = app
    dark = tmp_path / "dark.tif"
    tifffile.imwrite(dark, np.full_like(tiny_sequence.raw(0), 7))
    dock.workbench.model.change_settings(dark_frame=dark)
    add(viewer, read_sequence(str(tiny_folder)))
    opened(dock, qtbot)
    assert dock.workbench.model.sequence.black_level == 7.0


def test_closing_while_something_is_being_opened_is_quiet(app: Any, tiny_folder: Path) -> None:
    viewer, dock, _ = app
    dock.workbench.open(tiny_folder)
    viewer.close()
    assert dock.workbench.model.sequence is None


def test_two_viewers_hold_two_modules(
    make_napari_viewer: Callable[..., Any], tiny_folder: Path, result_folder: Path, qtbot: QtBot
) -> None:
    first, second = make_napari_viewer(), make_napari_viewer()
    docks = [build(first)[0], build(second)[0]]
    docks[0].workbench.open(tiny_folder)
    docks[1].workbench.open(result_folder)
    for dock in docks:
        opened(dock, qtbot)
    assert docks[0].workbench.model.inspection is None
    assert docks[1].workbench.model.inspection.complete
    first.close()
    docks[1].workbench.model.select_cell((1, 1))
    assert "Module image" in second.layers


def test_the_status_bar_says_when_something_is_open(
    app: Any, result_folder: Path, tmp_path: Path, qtbot: QtBot
) -> None:
    viewer, dock, _ = app
    said: list[str] = []
    dock.workbench.model.noticed.connect(lambda text, _: said.append(text))
    dock.workbench.open(result_folder)
    opened(dock, qtbot)
    name = result_folder.name
    assert said[:2] == [f"Opening {name} ...", f"Opened {name}."]
    assert "Opening" not in viewer.status
