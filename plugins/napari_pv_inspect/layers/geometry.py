"""Fitted grid over the frames; it follows the time slider."""

from __future__ import annotations

import numpy as np
from napari.components import ViewerModel
from napari.layers import Vectors
from numpy.typing import NDArray

from napari_pv_inspect import appearance
from napari_pv_inspect.layers.overlays import grid_of_frames
from napari_pv_inspect.layers.slot import LayerSlot
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["GeometryLayers"]


class GeometryLayers:
    """Keeps the grid layer in step with the model."""

    def __init__(self, viewer: ViewerModel, model: WorkbenchModel) -> None:
        self._model = model
        self._geometry: object = None
        self._grid: list[NDArray[np.float64]] = []
        self._replaced: dict[int, NDArray[np.float64]] = {}
        self._is_hidden = False
        self._grid_slot = LayerSlot(
            viewer,
            Vectors,
            name=appearance.GRID,
            ndim=3,
            edge_width=1.1,
            edge_color=appearance.GRID_COLOUR,
            vector_style="line",
            opacity=0.85,
        )
        model.sequence_changed.connect(self._on_sequence)
        model.inspection_changed.connect(self._on_inspection)
        model.settings_changed.connect(self._hide_or_show)

    def replace_frame(self, frame: int, segments: NDArray[np.float64]) -> None:
        """Show other grid lines in one frame until `show_fitted` is called."""
        shown = self._replaced.get(frame)
        if shown is not None and np.array_equal(shown, segments):
            return
        if frame < len(self._grid):
            self._replaced = {frame: segments}
            self._draw_grid()

    def show_fitted(self) -> None:
        """Show the fitted grid again."""
        if self._replaced:
            self._replaced = {}
            self._draw_grid()

    def bring_back(self) -> None:
        """Show the grid again if the user deleted it."""
        if self._grid_slot.layer is None:
            self._draw_grid()

    def _on_sequence(self, _: FrameSequence | None) -> None:
        self._geometry = None
        self._grid, self._replaced = [], {}
        self._grid_slot.drop()

    def _on_inspection(self, inspection: Inspection | None) -> None:
        if inspection is None:
            return
        # Parts are immutable: the same object means the same picture, and drawing is slow.
        geometry = inspection.registration or inspection.calibration
        if geometry is not None and geometry is not self._geometry:
            self._geometry, self._replaced = geometry, {}
            self._grid = grid_of_frames(inspection)
            self._draw_grid()
        self._hide_or_show()

    def _hide_or_show(self, _: object = None) -> None:
        """Hide the grid of other rows and columns after a run with the new ones has failed."""
        if self._is_hidden is not bool(self._model.why_hidden):
            self._is_hidden = not self._is_hidden
            self._draw_grid()

    def _draw_grid(self) -> None:
        if self._is_hidden:
            self._grid_slot.drop()
            return
        frames = [self._replaced.get(i, segments) for i, segments in enumerate(self._grid)]
        segments = np.concatenate(frames) if frames else np.empty((0, 2, 3))
        if len(segments):
            self._grid_slot.redraw(segments)
        else:
            self._grid_slot.drop()
