"""The workbench as an application of its own."""

from __future__ import annotations

from pathlib import Path

import napari
from napari.layers import Layer
from qtpy.QtCore import Qt

from napari_pv_inspect.docks.cells import CellsDock
from napari_pv_inspect.docks.inspect import InspectDock
from napari_pv_inspect.reader import get_reader, read_result

__all__ = ["build", "run"]

TITLE = "pv-inspect"


def build(viewer: napari.Viewer) -> tuple[InspectDock, CellsDock]:
    """Put the docks of the workbench into a window: controls on the right, cells below."""
    inspect, cells = InspectDock(viewer), CellsDock(viewer)
    viewer.window.add_dock_widget(inspect, name="Inspect module", area="right")
    # The controls need the whole height, the gallery can do with less width.
    corner, area = Qt.Corner.BottomRightCorner, Qt.DockWidgetArea.RightDockWidgetArea
    viewer.window._qt_window.setCorner(corner, area)
    below = viewer.window.add_dock_widget(cells, name="Cells", area="bottom")
    below.hide()
    cells.filled.connect(below.show)
    cells.filled.connect(inspect.bench.fit_view)
    return inspect, cells


def load(viewer: napari.Viewer, inspect: InspectDock, path: Path) -> None:
    """Open a sequence or a result folder; what is wrong with it becomes a notice."""
    if get_reader(path) is not read_result:
        inspect.bench.open(path)
        return
    for layer in read_result(path):
        if layer[0] is not None:
            viewer.add_layer(Layer.create(*layer))


def run(path: Path | None) -> None:
    """Open the window, load ``path`` into it, and return when it is closed."""
    viewer = napari.Viewer(title=TITLE)
    inspect, _ = build(viewer)
    if path is not None:
        load(viewer, inspect, Path(path))
    napari.run()
