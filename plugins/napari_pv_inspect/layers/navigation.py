"""Moves the camera: to the frames, to the module image, to one cell of it."""

from __future__ import annotations

from napari.components import ViewerModel
from psygnal import Signal

from napari_pv_inspect.layers.module import ModuleLayers
from napari_pv_inspect.layers.placement import cell_box
from napari_pv_inspect.models.workbench import WorkbenchModel

__all__ = ["Navigator"]

# Part of the canvas that the target fills.
FILL = 0.9
CELL_FILL = 0.6


class Navigator:
    """Points the camera of a viewer at what the user wants to see.

    Who covers the canvas leaves on `canvas_wanted`, and calls what it gets once it is laid out.
    What the user has deleted comes back on `layers_wanted`.
    """

    canvas_wanted = Signal(object)
    layers_wanted = Signal()

    def __init__(self, viewer: ViewerModel, model: WorkbenchModel, module: ModuleLayers) -> None:
        self._viewer = viewer
        self._model = model
        self._module = module

    def to_all(self) -> None:
        """Show frames and module image side by side."""
        self.layers_wanted.emit()
        self.canvas_wanted.emit(self.fit)
        self.fit()

    def fit(self) -> None:
        """Show all layers that there are; what covers the canvas stays."""
        self._viewer.reset_view()

    def to_frames(self) -> None:
        """Fill the canvas with the frames."""
        if self._model.sequence is not None:
            self.layers_wanted.emit()
            self.canvas_wanted.emit(self.to_frames)
            height, width = self._model.sequence.shape
            self._look_at(height / 2, width / 2, height, width, FILL)

    def to_module(self) -> None:
        """Fill the canvas with the module image."""
        if self._module.placement is not None and self._module.grid is not None:
            self.layers_wanted.emit()
            self.canvas_wanted.emit(self.to_module)
            top, left, height, width = self._module.placement.box(self._module.shape)
            self._look_at(top + height / 2, left + width / 2, height, width, FILL)

    def to_cell(self, row: int, col: int) -> None:
        """Show one cell of the module image large."""
        if self._module.placement is not None and self._module.grid is not None:
            y, x, height, width = cell_box(self._module.grid, self._module.placement, row, col)
            self._look_at(y, x, height, width, CELL_FILL)

    def _look_at(self, y: float, x: float, height: float, width: float, fill: float) -> None:
        canvas_height, canvas_width = self._viewer.canvas.size
        camera = self._viewer.scene.camera
        camera.center = (0.0, y, x)
        camera.zoom = fill * min(canvas_height / height, canvas_width / width)
