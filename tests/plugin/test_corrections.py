"""Corrected marks in the layers of napari and in the gallery."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from qtpy.QtGui import QImage
from qtpy.QtWidgets import QMessageBox

from napari_pv_inspect.appearance import CORRECTED, CRACKS
from napari_pv_inspect.workbench import Workbench
from pv_inspect.inspection.inspection import Inspection

Shown = tuple[Any, Any, Any]
CELL = (1, 1)


@pytest.fixture
def shown(workbench: Any, tiny_inspection: Inspection, monkeypatch: pytest.MonkeyPatch) -> Shown:
    monkeypatch.setattr(
        "napari_pv_inspect.docks.inspect.QFileDialog.getSaveFileName", lambda *_: ("", "")
    )
    monkeypatch.setattr(QMessageBox, "question", lambda *_: QMessageBox.StandardButton.Discard)
    viewer, dock, _ = workbench
    dock.workbench.model.revise(tiny_inspection)
    state = dock.workbench.review.state
    mask = np.zeros_like(state.cells.marks(CELL))
    mask[len(mask) // 2, 4:-4] = True
    return viewer, state, mask


def test_the_corrected_cell_leaves_the_layer_of_the_detector_and_undo_brings_it_back(
    shown: Shown, tiny_inspection: Inspection
) -> None:
    viewer, state, mask = shown
    detected = tiny_inspection.cracks.probability
    where = tiny_inspection.tiles.grid.cell_slices(*CELL)
    before = detected.copy()
    assert CORRECTED not in viewer.layers
    state.commands.correct(CELL, mask)
    corrected = np.asarray(viewer.layers[CORRECTED].data)
    np.testing.assert_array_equal(corrected[where], mask)
    assert corrected.sum() == mask.sum()
    left = np.asarray(viewer.layers[CRACKS].data)
    assert (left[where] == 0).all()
    other = tiny_inspection.tiles.grid.cell_slices(0, 0)
    np.testing.assert_array_equal(left[other], detected[other])
    np.testing.assert_array_equal(detected, before)
    state.history.undo()
    assert CORRECTED not in viewer.layers
    assert viewer.layers[CRACKS].data is detected
    state.history.redo()
    np.testing.assert_array_equal(np.asarray(viewer.layers[CORRECTED].data)[where], mask)


def test_marks_are_those_of_the_rater(shown: Shown) -> None:
    viewer, state, mask = shown
    state.commands.correct(CELL, mask)
    state.set_rater("Ben")
    assert CORRECTED not in viewer.layers
    state.commands.correct((0, 0), mask)
    assert np.asarray(viewer.layers[CORRECTED].data).sum() == mask.sum()


def test_deleted_layers_break_nothing(shown: Shown) -> None:
    viewer, state, mask = shown
    state.commands.correct(CELL, mask)
    viewer.layers.remove(viewer.layers[CRACKS])
    viewer.layers.remove(viewer.layers[CORRECTED])
    state.commands.correct((0, 0), mask)
    assert CRACKS not in viewer.layers, "the user does not want it"
    assert np.asarray(viewer.layers[CORRECTED].data).sum() == 2 * mask.sum()


def test_a_preview_of_another_image_hides_the_marks(shown: Shown) -> None:
    viewer, state, mask = shown
    state.commands.correct(CELL, mask)
    workbench = Workbench.of(viewer)
    workbench.module.preview(np.zeros((20, 30), np.float32))
    assert not viewer.layers[CORRECTED].visible
    workbench.model.revise(workbench.model.inspection)
    assert viewer.layers[CORRECTED].visible
    assert np.asarray(viewer.layers[CORRECTED].data).sum() == mask.sum()


def test_marks_stay_on_the_image_of_the_next_run(shown: Shown, tiny_inspection: Inspection) -> None:
    viewer, state, mask = shown
    state.commands.correct(CELL, mask)
    cracks = tiny_inspection.cracks
    again = replace(cracks, probability=cracks.probability.copy())
    Workbench.of(viewer).model.revise(replace(tiny_inspection, cracks=again))
    assert state.storage.folder is None
    assert np.asarray(viewer.layers[CORRECTED].data).sum() == mask.sum()
    where = tiny_inspection.tiles.grid.cell_slices(*CELL)
    assert (np.asarray(viewer.layers[CRACKS].data)[where] == 0).all()


def test_the_gallery_paints_corrected_marks_in_another_colour(workbench: Any, shown: Shown) -> None:
    _, _, cells = workbench
    _, state, mask = shown

    def colours() -> set[str]:
        picture: QImage = cells.cells.picture(CELL).toImage()
        xs, ys = range(picture.width()), range(picture.height())
        pixels = [picture.pixelColor(x, y) for x in xs for y in ys]
        return {
            "blue" if c.blue() > c.green() else "orange"
            for c in pixels
            if max(c.red(), c.green(), c.blue()) - min(c.red(), c.green(), c.blue()) > 40
        }

    cells.opacity.setValue(100)
    mask[5:9] = True
    state.commands.correct(CELL, mask)
    assert colours() == {"blue"}
    state.commands.correct(CELL, None)
    assert "blue" not in colours()
