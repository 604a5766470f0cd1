"""Layers come and go one at a time: napari's list breaks when one is added within another."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from napari.layers import Layer
from pytestqt.qtbot import QtBot

from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.reader import read_result, read_sequence
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.results.write import write_result


@pytest.fixture
def list_view(workbench: Any) -> Any:
    """Return napari's list of layers."""
    return workbench[0].window._qt_viewer.layers


def is_sound(viewer: Any, list_view: Any, qtlog: Any) -> bool:
    """Whether napari's list shows the layers that there are, and Qt had nothing to say."""
    rows = list_view.model().rowCount()
    said = [record.message for record in qtlog.records if "ProxyModel" in record.message]
    assert said == []
    return rows == len(viewer.layers)


def test_the_bent_grid_comes_back_alone_after_all_layers_were_deleted(
    workbench: Any, replayed: Any, qtbot: QtBot, qtlog: Any, list_view: Any
) -> None:
    viewer, dock, _ = workbench
    dock.module.detect.click()
    qtbot.waitUntil(lambda: dock.workbench.model.run_state is RunState.IDLE)
    viewer.layers.clear()
    dock.lens.form["kappa"].slider.setValue(150)
    qtbot.waitUntil(lambda: len(viewer.layers) > 0)
    qtbot.wait(200)
    assert [layer.name for layer in viewer.layers] == ["Fitted grid"]
    assert is_sound(viewer, list_view, qtlog)


def test_layers_of_the_reader_take_the_place_of_ours_one_after_the_other(
    workbench: Any,
    tiny_folder: Path,
    tiny_inspection: Inspection,
    tmp_path: Path,
    qtbot: QtBot,
    qtlog: Any,
    list_view: Any,
) -> None:
    viewer, dock, _ = workbench
    viewer.layers.clear()
    write_result(tiny_inspection, tmp_path / "out")
    layers = [*read_sequence(tiny_folder), *read_result(tmp_path / "out")]
    for _ in range(2):
        for layer in layers:
            viewer.add_layer(Layer.create(*layer))
        qtbot.waitUntil(lambda: not dock.workbench.opener.busy)
    assert len(viewer.layers) == 7
    assert is_sound(viewer, list_view, qtlog)


def test_another_sequence_takes_the_layer_of_the_one_before_away(
    workbench: Any, tiny_folder: Path, qtbot: QtBot, qtlog: Any, list_view: Any
) -> None:
    viewer, dock, _ = workbench
    files = sorted((tiny_folder / "frames").iterdir())
    viewer.dims.set_current_step(0, 4)
    dock.workbench.open(files[:2])
    qtbot.waitUntil(lambda: not dock.workbench.opener.busy)
    assert [layer.name for layer in viewer.layers] == ["Frames"]
    assert len(viewer.layers["Frames"].data) == 2
    assert viewer.dims.nsteps[0] == 2
    assert dock.workbench.frames.frame < 2
    assert is_sound(viewer, list_view, qtlog)


def test_the_image_of_other_rows_and_columns_goes_when_the_grid_of_these_is_found(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    viewer, dock, _ = workbench
    model = dock.workbench.model
    dock.run.run.click()
    qtbot.waitUntil(lambda: model.run_state is RunState.IDLE)
    assert "Module image" in viewer.layers
    model.change_settings(rows=4, cols=3)
    assert "Module image" in viewer.layers
    dock.module.detect.click()
    qtbot.waitUntil(lambda: model.run_state is RunState.IDLE)
    assert not {"Module image", "Cracks", "Support"} & {layer.name for layer in viewer.layers}


def test_look_at_both_brings_all_deleted_layers_back(
    workbench: Any, replayed: Any, qtbot: QtBot, qtlog: Any, list_view: Any
) -> None:
    viewer, dock, _ = workbench
    dock.run.run.click()
    qtbot.waitUntil(lambda: dock.workbench.model.run_state is RunState.IDLE)
    before = {layer.name for layer in viewer.layers}
    assert len(before) == 7
    viewer.layers.clear()
    dock.workbench.navigator.fit()
    assert not viewer.layers
    dock.workbench.navigator.to_all()
    assert {layer.name for layer in viewer.layers} == before
    kept = viewer.layers["Module image"]
    viewer.layers.remove("Cracks")
    dock.workbench.navigator.to_module()
    assert {layer.name for layer in viewer.layers} == before
    assert viewer.layers["Module image"] is kept
    assert is_sound(viewer, list_view, qtlog)


def test_the_frame_is_found_beside_a_layer_of_more_axes(workbench: Any) -> None:
    viewer, dock, _ = workbench
    viewer.add_image(np.zeros((2, 3, 8, 8), np.float32))
    dock.workbench.frames.show(4)
    assert dock.workbench.frames.frame == 4
    assert viewer.dims.current_step[:2] == (0, 4)
