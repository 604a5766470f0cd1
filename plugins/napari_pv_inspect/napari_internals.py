"""The parts of napari's window that have no public name, as seen on napari 0.9.2.

Nothing else in the workbench uses a private name of napari: with another release only this file
has to be looked at, and its test says whether it still holds.
"""

from __future__ import annotations

from typing import Any

from napari.components import ViewerModel
from qtpy.QtCore import QObject
from qtpy.QtWidgets import QDialog, QDockWidget, QLayout, QMainWindow, QWidget

__all__ = [
    "SEEN_ON",
    "canvas_area",
    "central_layout",
    "expand_newest_message",
    "layer_docks",
    "main_window",
    "unwrapped",
]

SEEN_ON = (0, 9)
"""Major and minor number of the napari release on which these names were seen."""


def unwrapped(viewer: ViewerModel) -> ViewerModel:
    """Return the viewer behind the proxy that napari gives to plugins."""
    return getattr(viewer, "__wrapped__", viewer)


def main_window(viewer: ViewerModel) -> QMainWindow | None:
    """Return the Qt window of a viewer, None if it has no window."""
    window: QMainWindow | None = getattr(getattr(viewer, "window", None), "_qt_window", None)
    return window


def canvas_area(window: QMainWindow) -> QWidget:
    """Return the widget that holds the canvas, the sliders and the docks of the layers."""
    area: QWidget = _qt_viewer(window)
    return area


def layer_docks(window: QMainWindow) -> tuple[QDockWidget, QDockWidget]:
    """Return the docks with the controls of a layer and with the list of layers."""
    area = _qt_viewer(window)
    return area.dockLayerControls, area.dockLayerList


def central_layout(window: QMainWindow) -> QLayout:
    """Return the layout that the canvas area stands in; other widgets can stand beside it.

    Raises
    ------
    RuntimeError
        If the window was not made by napari.
    """
    centre = window.centralWidget()
    layout = None if centre is None else centre.layout()
    if layout is None:
        raise RuntimeError("the window of napari has no central layout")
    return layout


def expand_newest_message(window: QObject) -> None:
    """Show all of a notification: napari shows as much of it as fits into a line."""
    messages: list[Any] = [
        child for child in window.findChildren(QDialog) if hasattr(child, "toggle_expansion")
    ]
    if messages and not messages[-1].property("expanded"):
        messages[-1].toggle_expansion()


def _qt_viewer(window: QMainWindow) -> Any:
    return window._qt_viewer  # type: ignore[attr-defined]
