"""The real application in a real window: what a user does, and the pixels that come of it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pytestqt.qtbot import QtBot
from qtpy.QtCore import Qt

from napari_pv_inspect.appearance import GRID_COLOUR, MEASURED_COLOUR
from napari_pv_inspect.application import build
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.napari_internals import main_window
from napari_pv_inspect.sample import CHECKOUT_SAMPLE
from pv_inspect.sequence.sequence import FrameSequence
from tests.waiting import LONG_S

pytestmark = pytest.mark.xvfb

LEFT = Qt.MouseButton.LeftButton


@pytest.fixture
def app(make_napari_viewer: Callable[..., Any], qtbot: QtBot) -> tuple[Any, Any, Any]:
    """Viewer, controls and gallery in a window of their own."""
    viewer = make_napari_viewer(show=True)
    main_window(viewer).resize(1500, 940)
    dock, cells = build(viewer)
    qtbot.wait(200)
    return viewer, dock, cells


@pytest.fixture
def tiny_app(app: tuple[Any, Any, Any], tiny_sequence: FrameSequence, qtbot: QtBot) -> Any:
    """Return the application with the tiny module open."""
    app[1].workbench.model.open(tiny_sequence)
    app[1].workbench.model.change_settings(magnification=2.0, max_iterations=5)
    qtbot.wait(200)
    return app


def canvas(viewer: Any, qtbot: QtBot) -> NDArray[np.int_]:
    """Pixels of the canvas once all is drawn, (h, w, 3)."""
    qtbot.wait(400)
    return np.asarray(viewer.screenshot(canvas_only=True, flash=False))[..., :3].astype(int)


def share_of_colour(pixels: NDArray[np.int_], colour: str) -> float:
    """Share of pixels within a small distance of a colour."""
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return float((np.abs(pixels - wanted).max(axis=-1) < 40).mean())


def finish(dock: Any, qtbot: QtBot) -> None:
    """Wait for the end of the run."""
    qtbot.waitUntil(lambda: dock.workbench.model.run_state is RunState.IDLE)


def test_the_sample_is_seen_and_its_grid_is_found(app: Any, qtbot: QtBot) -> None:
    if not CHECKOUT_SAMPLE.is_dir():
        pytest.skip("sample_data/ is not in this checkout")
    viewer, dock, _ = app
    qtbot.mouseClick(dock.open_sample, LEFT)
    qtbot.waitUntil(lambda: dock.workbench.model.sequence is not None)
    before = canvas(viewer, qtbot)
    assert before.max() > 150
    assert share_of_colour(before, GRID_COLOUR) < 1e-4
    qtbot.mouseClick(dock.module.detect, LEFT)
    finish(dock, qtbot)
    after = canvas(viewer, qtbot)
    assert share_of_colour(after, GRID_COLOUR) > 0.005
    assert share_of_colour(after, MEASURED_COLOUR) > 0.0005


def test_kappa_moves_the_grid_on_the_screen_and_fit_brings_it_back(
    tiny_app: Any, qtbot: QtBot
) -> None:
    viewer, dock, _ = tiny_app
    qtbot.mouseClick(dock.module.detect, LEFT)
    finish(dock, qtbot)
    dock.workbench.navigator.to_frames()
    straight = canvas(viewer, qtbot)
    for _ in range(30):
        qtbot.keyClick(dock.lens.form["kappa"].slider, Qt.Key.Key_Right)
    bent = canvas(viewer, qtbot)
    moved = np.abs(bent - straight).max(axis=-1) > 60
    assert moved.mean() > 0.002
    qtbot.mouseClick(dock.lens.form["kappa"].automatic, LEFT)
    again = canvas(viewer, qtbot)
    assert (np.abs(again - straight).max(axis=-1) > 60).mean() < moved.mean() / 10


def test_run_cancel_run_again_and_look_at_the_cells(tiny_app: Any, qtbot: QtBot) -> None:
    viewer, dock, cells = tiny_app
    model = dock.workbench.model
    qtbot.mouseClick(dock.run.run, LEFT)
    qtbot.waitUntil(lambda: dock.run.progress.value() > 0)
    qtbot.mouseClick(dock.run.cancel, LEFT)
    finish(dock, qtbot)
    assert model.inspection is None or not model.inspection.complete
    qtbot.mouseClick(dock.run.run, LEFT)
    finish(dock, qtbot)
    assert model.inspection is not None
    assert model.inspection.complete

    dock.workbench.navigator.to_module()
    pixels = canvas(viewer, qtbot)
    height, width = pixels.shape[:2]
    middle = pixels[height // 3 : -height // 3, width // 3 : -width // 3]
    assert middle.mean() > 50, "the module image is not black"

    assert cells.isVisible()
    index = cells.cells.index(6)
    qtbot.mouseClick(cells.view.viewport(), LEFT, pos=cells.view.visualRect(index).center())
    large = canvas(viewer, qtbot)
    assert (np.abs(large - pixels).max(axis=-1) > 30).mean() > 0.1, "the cell is shown large"
    gallery = cells.view.grab().toImage()
    greys = {
        gallery.pixelColor(x, y).lightness()
        for x in range(0, gallery.width(), 7)
        for y in range(0, gallery.height(), 7)
    }
    assert len(greys) > 20, "the gallery shows pictures"


def test_another_lambda_changes_the_module_on_the_screen(tiny_app: Any, qtbot: QtBot) -> None:
    viewer, dock, _ = tiny_app
    qtbot.mouseClick(dock.run.run, LEFT)
    finish(dock, qtbot)
    dock.workbench.navigator.to_cell(1, 1)
    viewer.layers["Cracks"].visible = False
    before = canvas(viewer, qtbot)
    dock.image.form["prior_weight"].number.setValue(10.0)
    qtbot.mouseClick(dock.run.run, LEFT)
    finish(dock, qtbot)
    dock.workbench.navigator.to_cell(1, 1)
    after = canvas(viewer, qtbot)
    assert (np.abs(after - before).max(axis=-1) > 5).mean() > 0.05


CLOSE_MID_RUN = """
import sys
from pathlib import Path
from qtpy.QtCore import QTimer
import napari_pv_inspect
from napari_pv_inspect import application
from napari_pv_inspect.napari_internals import main_window

build = application.build

def build_and_close_mid_run(viewer):
    dock, cells = build(viewer)

    def close(fraction, message):
        if fraction > 0:
            QTimer.singleShot(0, main_window(viewer).close)

    def run():
        if dock.workbench.model.sequence is None:
            QTimer.singleShot(200, run)
            return
        dock.workbench.model.progress_changed.connect(close)
        dock.run.run.click()

    QTimer.singleShot(1000, run)
    return dock, cells

application.build = build_and_close_mid_run
napari_pv_inspect.launch(Path(sys.argv[1]))
print("closed")
"""


def test_launch_returns_cleanly_when_the_window_is_closed_mid_run(tiny_folder: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", CLOSE_MID_RUN, str(tiny_folder)],
        capture_output=True,
        text=True,
        timeout=LONG_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "closed" in done.stdout
    assert "Traceback" not in done.stderr
