"""Where the dock *Live cell* stands: between the canvas and the controls."""

from __future__ import annotations

from functools import partial
from weakref import ref

from qtpy.QtCore import Qt, QTimer
from qtpy.QtWidgets import QDockWidget, QMainWindow, QWidget

from napari_pv_inspect.docks.live_cell import LiveDock
from napari_pv_inspect.napari_internals import canvas_area, main_window
from napari_pv_inspect.widgets.docking import dock_of
from napari_pv_inspect.workbench import Workbench

__all__ = ["show_live_cell"]

# Of the window that the live cell takes, px and share of its width.
MIN_WIDTH, SHARE = 300, 0.26


def show_live_cell(workbench: Workbench, controls: QWidget) -> LiveDock:
    """Show the live cell left of the controls, or bring it back.

    Parameters
    ----------
    workbench : Workbench
    controls : QWidget
        The widget in whose dock the sliders are.
    """
    window = main_window(workbench.viewer)
    if window is None:
        raise RuntimeError("a live cell needs a window")
    for place in window.findChildren(QDockWidget):
        live = place.findChild(LiveDock)
        if live is not None:
            place.show()
            place.raise_()
            _fit_view(workbench, window)
            return live
    live = LiveDock(workbench.viewer)
    place = workbench.viewer.window.add_dock_widget(live, name="Live cell", area="right")
    neighbour = dock_of(controls)
    if neighbour is not None and not neighbour.isFloating():
        window.splitDockWidget(place, neighbour, Qt.Orientation.Horizontal)
        place.visibilityChanged.connect(partial(_narrow, ref(neighbour), neighbour.width()))
        # Qt resizes docks only once they have been laid out; no dock, no call.
        QTimer.singleShot(0, place, partial(_widen, window, place, neighbour))
    # With two docks beside each other the full height is of more use than a wide gallery.
    window.setCorner(Qt.Corner.BottomRightCorner, Qt.DockWidgetArea.RightDockWidgetArea)
    _fit_view(workbench, window)
    return live


def _fit_view(workbench: Workbench, window: QMainWindow) -> None:
    """Show all layers on the narrower canvas, unless a large cell stands in its place."""
    if not canvas_area(window).isHidden():
        workbench.fit_view()


def _narrow(controls: ref[QDockWidget], width: int, shown: bool) -> None:
    """Give the room of a live cell that is closed to the canvas, not to the controls."""
    neighbour = controls()
    place = None if shown or neighbour is None else neighbour.parentWidget()
    if isinstance(place, QMainWindow) and neighbour is not None and neighbour.isVisible():
        QTimer.singleShot(0, neighbour, partial(_resize, place, [neighbour], [width]))


def _widen(window: QMainWindow, place: QDockWidget, neighbour: QDockWidget) -> None:
    wanted = max(MIN_WIDTH, round(SHARE * window.width()))
    _resize(window, [place, neighbour], [wanted, neighbour.width()])


def _resize(window: QMainWindow, docks: list[QDockWidget], widths: list[int]) -> None:
    animated = window.isAnimated()
    # The view is fitted to the canvas right after: it has to have its size by then.
    window.setAnimated(False)
    window.resizeDocks(docks, widths, Qt.Orientation.Horizontal)
    window.setAnimated(animated)
