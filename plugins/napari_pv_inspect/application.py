"""The workbench as an application of its own."""

from __future__ import annotations

from pathlib import Path

import napari

from napari_pv_inspect.docks.gallery import CellsDock
from napari_pv_inspect.docks.inspect import InspectDock
from napari_pv_inspect.tasks.memory import gc_frozen, limit_malloc_arenas

__all__ = ["build", "run"]

TITLE = "pv-inspect"


def build(viewer: napari.Viewer) -> tuple[InspectDock, CellsDock]:
    """Put the docks of the workbench into a window: controls on the right, cells below."""
    inspect, cells = InspectDock(viewer), CellsDock(viewer)
    viewer.window.add_dock_widget(inspect, name="Inspect module", area="right")
    below = viewer.window.add_dock_widget(cells, name="Cells", area="bottom")
    below.hide()
    cells.filled.connect(below.show)
    cells.filled.connect(inspect.workbench.fit_view)
    return inspect, cells


def run(path: Path | None) -> None:
    """Open the window, load ``path`` into it, and return when it is closed."""
    limit_malloc_arenas()
    viewer = napari.Viewer(title=TITLE)
    inspect, _ = build(viewer)
    if path is not None:
        inspect.workbench.open(path)
    with gc_frozen():
        napari.run()
